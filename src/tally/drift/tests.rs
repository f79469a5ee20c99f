//! Made-up runs with residuals and positions of known mean and noise.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking, its own functions too")]

use super::*;
use crate::estimate::Miss;
use crate::testing::fixture;
use crate::testing::random::Random;
use nalgebra::{Vector2, Vector3};

/// A run with residuals of mean ± `mean` in the two views and correlated noise; alarms as (frame, alarm).
fn alarms(frames: u64, change: impl FnMut(&mut Estimate, f64)) -> (Drift, Vec<DriftAlarm>) {
    alarms_of(&fixture::rig(), frames, change)
}

fn alarms_of(rig: &Rig, frames: u64, mut change: impl FnMut(&mut Estimate, f64)) -> (Drift, Vec<DriftAlarm>) {
    let mut drift = Drift::new(rig);
    let mut dice = Random::new(3);
    let mut noise = 0.0;
    let raised = (0..frames)
        .flat_map(|seq| {
            let mut estimate = fixture::complete(seq, seq as i64 * 16_666_667);
            noise = 0.4 * noise + dice.normal() * 0.09;
            change(&mut estimate, noise);
            drift.add(&estimate).to_vec()
        })
        .collect();
    (drift, raised)
}

fn set(estimate: &mut Estimate, mean: f64, noise: f64) {
    for marker in &mut estimate.markers {
        for (view, sign) in marker.views.iter_mut().zip([1.0, -1.0]) {
            view.as_mut().unwrap().residual_px = Vector2::new(0.001, sign * (mean + noise));
        }
    }
}

#[test]
fn noise_and_what_models_leave_is_no_drift() {
    let (_, raised) = alarms(20_000, |estimate, noise| set(estimate, 0.05, noise));
    assert_eq!(raised, []);
    // Rare wild frames, and NaN.
    let (_, raised) = alarms(2_000, |estimate, noise| {
        let wild = if estimate.seq % 50 == 7 { 2.0 } else { 0.0 };
        set(estimate, wild, noise);
        if estimate.seq % 9 == 2 {
            set(estimate, f64::NAN, 0.0);
        }
    });
    assert_eq!(raised, []);
}

#[test]
fn views_that_part_are_told_once_with_their_distance() {
    let (drift, raised) = alarms(900, |estimate, noise| {
        let mean = if (300..600).contains(&estimate.seq) { 0.4 } else { 0.0 };
        set(estimate, mean, noise);
    });
    let [alarm] = raised[..] else { panic!("{raised:?}") };
    assert!((330..480).contains(&alarm.seq), "{alarm:?}");
    // The largest value is kept: 0.4 px in each of two views.
    let [alarm] = drift.alarms()[..] else { panic!("{:?}", drift.alarms()) };
    let Drifted::Views { size_px, sd_px, .. } = alarm.what else { panic!("{alarm:?}") };
    assert!((size_px - 0.8).abs() < 0.1 && sd_px < 0.05, "{alarm:?}");
    let place = fixture::complete(899, 0).markers[0].position.as_ref().unwrap().point;
    let seen = fixture::rig().views[0].optics.project_with_jacobian(&place).unwrap();
    let expected_m = 0.8 / (seen.d_pixel.norm() / 2f64.sqrt());
    assert!((alarm.size_m / expected_m - 1.0).abs() < 0.15, "{alarm:?} instead of {expected_m}");
    assert!(alarm.over.is_some_and(|over| (600..780).contains(&(over.ns / 16_666_667))), "{alarm:?}");
}

#[test]
fn a_run_too_short_for_scatter_is_judged_at_its_end() {
    let at_end = |frames: u64, mean: f64| {
        let (mut drift, raised) = alarms(frames, |estimate, noise| set(estimate, mean, noise));
        assert!(raised.is_empty() && drift.views_limit_px().is_none());
        drift.end();
        drift
    };
    for frames in [1, 9, 10, 25, 59] {
        let drift = at_end(frames, 0.05);
        assert_eq!(drift.alarms(), []);
        let limit_px = drift.views_limit_px().unwrap();
        assert!((0.3..2.0).contains(&limit_px), "{limit_px}");
        let drift = at_end(frames, 1.5);
        let [DriftAlarm { seq, what: Drifted::Views { size_px, sd_px, .. }, .. }] = drift.alarms()[..] else {
            panic!()
        };
        assert!(seq == frames - 1 && (size_px - 3.0).abs() < 0.5 && sd_px < 0.3, "{frames}: {size_px} {sd_px}");
    }
    // A single wild frame in 59 is none.
    let (mut drift, _) =
        alarms(59, |estimate, noise| set(estimate, if estimate.seq == 30 { 12.0 } else { 0.0 }, noise));
    drift.end();
    assert_eq!(drift.alarms(), []);
    // Rays that do not meet.
    let (mut drift, _) = alarms(5, |estimate, _| {
        estimate.markers.iter_mut().for_each(|m| m.position = Err(Miss::RaysDiverge { distance_m: 7e-3 }));
    });
    drift.end();
    assert!(matches!(drift.alarms(), [DriftAlarm { what: Drifted::Apart, .. }]), "{:?}", drift.alarms());
    // Nothing is judged where nothing was seen, nor twice.
    let mut drift = Drift::new(&fixture::rig());
    drift.end();
    assert!(drift.alarms().is_empty() && drift.views_limit_px().is_none());
    let (mut drift, raised) = alarms(300, |estimate, noise| set(estimate, 1.5, noise));
    drift.end();
    assert_eq!((raised.len(), drift.alarms().len()), (1, 1));
}

#[test]
fn a_base_band_elsewhere_is_told_after_a_few_frames() {
    for frames in [1, 12, 59] {
        for (away_m, told) in [(0.1e-3, false), (2e-3, true)] {
            let (mut drift, raised) = alarms(frames, |estimate, noise| {
                set(estimate, 0.0, noise);
                estimate.markers[0].position.as_mut().unwrap().point.x += away_m;
            });
            assert!(raised.is_empty());
            drift.end();
            let found = drift.alarms().iter().map(|a| (matches!(a.what, Drifted::Base { .. }), a.size_m));
            let found: Vec<_> = found.collect();
            assert_eq!(found.len(), usize::from(told), "{frames} {found:?}");
            assert!(found.iter().all(|(base, size_m)| *base && (size_m - 2e-3).abs() < 1e-4), "{found:?}");
            assert!(drift.base_limit_m().is_some_and(|limit_m| limit_m < 1e-3));
        }
    }
}

#[test]
fn an_alarm_lasts_while_nothing_tells_that_it_is_over() {
    let (drift, raised) = alarms(900, |estimate, noise| {
        set(estimate, 0.4, noise);
        if estimate.seq >= 300 {
            estimate.markers.iter_mut().for_each(|marker| marker.position = Err(Miss::MarkerMissing));
        }
    });
    assert_eq!(raised.len(), 1);
    assert!(matches!(drift.alarms(), [DriftAlarm { over: None, .. }]), "{:?}", drift.alarms());
}

#[test]
fn a_second_parting_is_told_again() {
    let (drift, raised) = alarms(1800, |estimate, noise| {
        set(estimate, if estimate.seq / 300 % 2 == 1 { 0.5 } else { 0.0 }, noise);
    });
    assert_eq!((raised.len(), drift.alarms().len()), (3, 3));
}

#[test]
fn rays_that_do_not_meet_at_all_are_told_and_one_strange_thing_is_not() {
    let missing = |estimate: &mut Estimate, markers: &[usize]| {
        for &m in markers {
            estimate.markers[m].position = Err(Miss::RaysDiverge { distance_m: 0.004 });
        }
    };
    let (_, raised) = alarms(300, |estimate, _| missing(estimate, &[1, 2]));
    let [alarm] = raised[..] else { panic!("{raised:?}") };
    assert_eq!((alarm.seq, alarm.what), (59, Drifted::Apart));
    assert!((alarm.size_m - 0.004).abs() < 1e-12);
    let (_, raised) = alarms(300, |estimate, _| missing(estimate, &[2]));
    assert_eq!(raised, []);
}

#[test]
fn less_than_a_second_is_not_judged() {
    let (_, raised) = alarms(59, |estimate, noise| set(estimate, 2.0, noise));
    assert_eq!(raised, []);
    let (_, raised) = alarms(60, |estimate, noise| set(estimate, 2.0, noise));
    assert_eq!(raised.len(), 1);
}

/// Moves the base band away from the origin, mm, along a direction off the axes.
fn shift_base(estimate: &mut Estimate, mm: f64) {
    let along = Vector3::new(2.0, -1.0, 2.0) / 3.0;
    estimate.markers[0].position.as_mut().unwrap().point += along * mm * 1e-3;
}

#[test]
fn a_base_band_away_from_its_origin_is_told_once_with_its_distance() {
    let (drift, raised) = alarms(900, |estimate, noise| {
        set(estimate, 0.0, noise);
        let mm = if (300..600).contains(&estimate.seq) { 0.8 } else { 0.0 };
        shift_base(estimate, mm + noise);
    });
    let [alarm] = raised[..] else { panic!("{raised:?}") };
    assert!((330..480).contains(&alarm.seq), "{alarm:?}");
    let [alarm] = drift.alarms()[..] else { panic!("{:?}", drift.alarms()) };
    assert!((alarm.size_m - 0.8e-3).abs() < 0.05e-3, "{alarm:?}");
    // 0.1 mm for the origin, and as much for the run.
    let Drifted::Base { sd_m } = alarm.what else { panic!("{alarm:?}") };
    assert!((sd_m - 0.1e-3 * 2f64.sqrt()).abs() < 0.02e-3, "{alarm:?}");
    assert!(alarm.over.is_some_and(|over| (600..780).contains(&(over.ns / 16_666_667))), "{alarm:?}");
    let said = alarm.words(&["direct", "mirror"]);
    assert!(
        said.starts_with("the base band stands 0.8") && said.ends_with("`catoptra calibrate base` found it"),
        "{said}"
    );
    assert!(alarm.advice().contains("clamp") && alarm.advice().contains("calibrate mirror --from-markers"));
}

#[test]
fn a_base_band_that_sways_or_rests_within_its_deviation_is_not_told() {
    let (_, raised) = alarms(2_000, |estimate, _| shift_base(estimate, (estimate.seq as f64 * 0.105).sin()));
    assert_eq!(raised, []);
    let (_, raised) = alarms(300, |estimate, _| shift_base(estimate, 0.28));
    assert_eq!(raised, []);
    // Whether the same distance counts depends on the origin's σ in the rig file.
    let known_to = |sd_mm: f64| {
        let mut rig = fixture::rig();
        rig.provenance = toml::from_str(&format!("[base]\norigin_sd_mm = [{sd_mm:?}, {sd_mm:?}, {sd_mm:?}]")).unwrap();
        alarms_of(&rig, 300, |estimate, _| shift_base(estimate, 0.5)).1.len()
    };
    assert_eq!((known_to(0.05), known_to(0.2)), (1, 0));
}

/// 0.3 mm off is what an origin known to 0.2 mm allows, but more than half of the least distance for an alarm.
#[test]
fn the_alarm_of_a_badly_known_origin_ends_too() {
    let mut rig = fixture::rig();
    rig.provenance = toml::from_str("[base]\norigin_sd_mm = [0.2, 0.2, 0.2]").unwrap();
    let (drift, _) = alarms_of(&rig, 900, |estimate, _| {
        shift_base(estimate, if estimate.seq < 300 { 2.0 } else { 0.3 });
    });
    assert!(matches!(drift.alarms(), [DriftAlarm { over: Some(_), .. }]), "{:?}", drift.alarms());
}

#[test]
fn a_rig_without_base_frame_has_no_origin_to_rest_in() {
    let rig = Rig { base: None, ..fixture::rig() };
    let (_, raised) = alarms_of(&rig, 300, |estimate, _| shift_base(estimate, 5.0));
    assert_eq!(raised, []);
}

#[test]
fn views_and_base_band_are_told_apart() {
    let (_, raised) = alarms(600, |estimate, noise| {
        set(estimate, if estimate.seq >= 100 { 0.4 } else { 0.0 }, noise);
        shift_base(estimate, if estimate.seq >= 300 { 2.0 } else { 0.0 });
    });
    let words: Vec<&str> = raised.iter().map(DriftAlarm::word).collect();
    assert_eq!(words, ["views_disagree", "base_moved"]);
    assert!(raised[0].seq < 300 && raised[1].seq >= 300, "{raised:?}");
}
