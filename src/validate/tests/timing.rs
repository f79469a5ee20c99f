//! Periods that are not alike, and starts: what is told of them.

use super::super::*;
use super::{CLEAN, CORNER_HZ, START_NS, Spoiled, circle, desired, eight, evaluated, simulate};
use crate::series::{Frame, Recording};
use crate::testing::random::Random;
use nalgebra::{Point3, Vector3};

#[test]
fn a_motion_that_is_not_yet_periodic_is_flagged() {
    let from_rest = Spoiled { run_in: 0, ..CLEAN };
    let flagged = |runs: &[Run]| -> Vec<bool> {
        runs.iter().map(|run| run.notes.iter().any(|note| note.contains("has not become periodic"))).collect()
    };
    let slow = evaluated(circle, 0.15, from_rest, Options::default()).runs;
    let fastest = &slow[0];
    let (last_db, all_db) = (fastest.settling.unwrap().last_db.unwrap(), fastest.magnitude.unwrap().db);
    assert!(flagged(&slow)[0] && last_db < all_db - 1.0, "{last_db} {all_db}");
    // At the longest pause four periods are 80 s.
    assert!(!flagged(&slow)[11]);
    let steady = evaluated(circle, CORNER_HZ, CLEAN, Options::default()).runs;
    assert!(!flagged(&steady).contains(&true));
}

/// The notes of a run that is evaluated from the given start.
fn noted(recording: &Recording, path: DesiredPath, pause_s: f64) -> (Row, String) {
    let observed = [Observed { recording, pause_s, start_ns: Some(START_NS) }];
    let run = validate(path, &observed, Options::default()).unwrap().runs.remove(0);
    (Row::of(&run), run.notes.join("\n"))
}

const NOISY: Spoiled = Spoiled { noise_m: 5e-5, missing: 0.0, seed: 3, run_in: 20 };

#[test]
fn periods_that_are_alike_are_not_doubted() {
    for seed in 1..=5 {
        let spoiled = Spoiled { missing: 0.05, seed, ..NOISY };
        for of in [circle, eight] {
            for run in evaluated(of, CORNER_HZ, spoiled, Options::default()).runs {
                let row = Row::of(&run);
                assert!(run.notes.is_empty(), "{} ms: {:?}", row.pause_ms, run.notes);
                // Besides noise, interpolation where frames are missing: at 1 ms each of them is a tenth of a period.
                let (drift, sd) = (row.phase_drift_deg.unwrap(), row.phase_drift_sd_deg.unwrap());
                assert!(drift.abs() < 4.5 * sd + 0.1, "{} ms: {drift}° ± {sd}°", row.pause_ms);
            }
        }
    }
}

#[test]
fn a_timing_that_drifts_is_told_with_the_pause_that_explains_it() {
    let held_ms =
        |notes: &str| -> f64 { notes.split("held for ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap() };
    // The amplifier holds commands 0.3 % longer; two counted periods after the first are 1.08° later each.
    let slow = simulate(circle, 0.01 * 1.003, CORNER_HZ, NOISY);
    let (row, notes) = noted(&slow, desired(circle), 0.01);
    assert!((row.phase_drift_deg.unwrap() + 1.08).abs() < 0.1, "{:?}", row.phase_drift_deg);
    assert!(notes.contains("from period 2 to 4 it changes by -1."), "{notes}");
    assert!((held_ms(&notes) - 10.03).abs() < 0.002, "{notes}");
    // The camera's clock is 1 % fast.
    let mut fast = simulate(circle, 0.01, CORNER_HZ, NOISY);
    for frame in &mut fast.frames {
        frame.stamp_ns = START_NS + (frame.stamp_ns - START_NS) / 100 * 101;
    }
    let (row, notes) = noted(&fast, desired(circle), 0.01);
    assert!((row.phase_drift_deg.unwrap() + 3.6).abs() < 0.1, "{:?}", row.phase_drift_deg);
    assert!((held_ms(&notes) - 10.1).abs() < 0.002, "{notes}");
    // It jumps by 0.5 s, a quarter of a period, between periods 2 and 3: the last two agree.
    let mut jump = simulate(circle, 0.01, CORNER_HZ, NOISY);
    jump.frames.iter_mut().filter(|f| f.stamp_ns > START_NS + 4_000_000_000).for_each(|f| f.stamp_ns += 500_000_000);
    let (row, notes) = noted(&jump, desired(circle), 0.01);
    // For a quarter of period 3 there is no frame, and the mean period is there that of the two others.
    assert!((row.phase_step_deg.unwrap() + 90.0).abs() < 4.0, "{:?}", row.phase_step_deg);
    assert!(notes.contains("(from period 2 to 3)"), "{notes}");
}

/// Two periods are commanded where four are asked for: of the three that count, one moves.
#[test]
fn periods_without_motion_are_told_where_a_single_one_moves() {
    let mut rests = simulate(circle, 0.01, CORNER_HZ, NOISY);
    let end_ns = START_NS + 4_000_000_000;
    let last = rests.frames.iter().rfind(|frame| frame.stamp_ns < end_ns).unwrap().clone();
    for frame in rests.frames.iter_mut().filter(|frame| frame.stamp_ns >= end_ns) {
        frame.places.clone_from(&last.places);
    }
    let (row, notes) = noted(&rests, desired(circle), 0.01);
    assert!(notes.contains("hardly moves in period 3, 4: check --periods"), "{notes}");
    assert_eq!((row.phase_drift_deg, row.phase_step_deg, row.shift_mm), (None, None, None));
}

/// Tables without σ of the places: nothing is called certain.
#[test]
fn an_unknown_sigma_is_no_sigma_of_0() {
    let without = |mut recording: Recording| {
        recording.frames.iter_mut().flat_map(|frame| &mut frame.places).for_each(|place| place.sd_m = None);
        recording
    };
    let (row, notes) = noted(&without(simulate(circle, 0.01, CORNER_HZ, NOISY)), desired(circle), 0.01);
    assert!(notes.is_empty() && row.phase_drift_deg.is_some(), "{notes}");
    assert_eq!((row.phase_drift_sd_deg, row.phase_sd_deg, row.magnitude_sd_db), (None, None, None));
    // The amplifier holds commands 0.3 % longer, and the middle moves.
    let mut spoiled = without(simulate(circle, 0.01 * 1.003, CORNER_HZ, NOISY));
    for frame in spoiled.frames.iter_mut().filter(|frame| frame.stamp_ns > START_NS + 4_000_000_000) {
        frame.places.iter_mut().filter_map(|place| place.point.as_mut()).for_each(|point| point.y += 0.005);
    }
    let (_, notes) = noted(&spoiled, desired(circle), 0.01);
    assert!(notes.contains("° (σ is not known) per period") && notes.contains("mm (σ is not known) away"), "{notes}");
    let observed = [Observed {
        recording: &without(simulate(circle, 0.02, 50.0, NOISY)),
        pause_s: 0.02,
        start_ns: Some(START_NS + 60_000_000),
    }];
    let run = validate(desired(circle), &observed, Options::default()).unwrap().runs.remove(0);
    assert!(run.notes.iter().any(|note| note.contains("leads the commands by 5.") && note.contains("° (σ is not")));
}

#[test]
fn a_middle_that_moves_is_told() {
    let mut moved = simulate(circle, 0.01, CORNER_HZ, NOISY);
    for frame in moved.frames.iter_mut().filter(|frame| frame.stamp_ns > START_NS + 4_000_000_000) {
        for point in frame.places.iter_mut().filter_map(|place| place.point.as_mut()) {
            point.y += 0.005;
        }
    }
    let (row, notes) = noted(&moved, desired(circle), 0.01);
    assert!((row.shift_mm.unwrap() - 5.0).abs() < 0.1, "{:?}", row.shift_mm);
    assert!(
        notes.contains("mm away in period 3 from where it is in period 2") || notes.contains("in period 4"),
        "{notes}"
    );
    assert!(row.phase_drift_deg.unwrap().abs() < 0.2 && !notes.contains("phase"), "{notes}");
}

#[test]
fn periods_that_are_not_in_the_record_are_refused_and_still_ones_told() {
    let recording = simulate(circle, 0.01, CORNER_HZ, NOISY);
    let with = |periods| DesiredPath { periods, ..desired(circle) };
    let observed = |recording| [Observed { recording, pause_s: 0.01, start_ns: Some(START_NS) }];
    let error = validate(with(8), &observed(&recording), Options::default()).unwrap_err().to_string();
    assert_eq!(
        error,
        "10ms.csv: the record ends at 10.333 s of the camera's clock, 8 periods of commands at 18.346 s: 4 of them are \
         in it; give --periods 4, or check --pause and --start"
    );
    assert!(validate(with(5), &observed(&recording), Options::default()).is_err());
    assert!(noted(&recording, with(4), 0.01).1.is_empty());
    // The record goes on at rest.
    let mut rests = recording.clone();
    let last = rests.frames.last().unwrap().clone();
    rests.frames.extend((1..=240).map(|k| Frame { stamp_ns: last.stamp_ns + k * 16_666_667, ..last.clone() }));
    let (_, notes) = noted(&rests, with(6), 0.01);
    assert!(notes.contains("hardly moves in period 5, 6: check --periods"), "{notes}");
    // The marker is hidden for most of it.
    let mut hidden = recording.clone();
    hidden.frames.iter_mut().filter(|f| f.stamp_ns > START_NS + 5_000_000_000).for_each(|f| f.places[0].point = None);
    let (_, notes) = noted(&hidden, with(4), 0.01);
    assert!(notes.contains("of 600 commands have no point"), "{notes}");
}

#[test]
fn a_start_that_cannot_be_found_is_refused() {
    let with_rest = |of: fn(usize) -> Point3<f64>| {
        let mut recording = simulate(of, 0.01, CORNER_HZ, NOISY);
        let last = recording.frames.last().unwrap().clone();
        recording.frames.extend((1..=120).map(|k| Frame { stamp_ns: last.stamp_ns + k * 16_666_667, ..last.clone() }));
        recording
    };
    let search = |recording: &Recording, of: fn(usize) -> Point3<f64>| {
        let observed = [Observed { recording, pause_s: 0.01, start_ns: None }];
        validate(desired(of), &observed, Options::default())
            .map(|validation| Row::of(&validation.runs[0]).correlation.unwrap())
            .map_err(|error| error.to_string())
    };
    let swapped: fn(usize) -> Point3<f64> = |k| circle(k).coords.yxz().into();
    assert!(search(&with_rest(circle), circle).unwrap() > 0.99);
    assert!(search(&with_rest(eight), eight).unwrap() > 0.9);
    assert!(search(&with_rest(swapped), swapped).unwrap() > 0.99);
    let mut still = with_rest(circle);
    let mut random = Random::new(5);
    for frame in &mut still.frames {
        frame.places[0].point = Some(circle(0) + Vector3::from_fn(|_, _| random.normal()) * 5e-5);
    }
    for (recording, path) in
        [(still, circle as fn(usize) -> _), (with_rest(circle), swapped), (with_rest(circle), eight)]
    {
        let error = search(&recording, path).unwrap_err();
        assert!(
            error.starts_with("10ms.csv: the start of the commands cannot be found: the motion correlates"),
            "{error}"
        );
        assert!(error.contains("0.7 is needed"), "{error}");
    }
}

#[test]
fn a_path_in_another_unit_is_told() {
    let recording = simulate(circle, 0.01, CORNER_HZ, NOISY);
    let (_, notes) = noted(&recording, desired(|k| circle(k) * 1e-3), 0.01);
    assert!(notes.contains("which is hardly the same unit: both must be in mm"), "{notes}");
}

/// A start given too late by 60 ms: the motion seems to come before its commands.
#[test]
fn a_motion_before_its_commands_is_told() {
    let recordings = [0.1, 0.02].map(|pause_s| (pause_s, simulate(circle, pause_s, 50.0, NOISY)));
    let notes = |late_ns: i64| {
        let observed = recordings.iter().map(|(pause_s, recording)| Observed {
            recording,
            pause_s: *pause_s,
            start_ns: Some(START_NS + late_ns),
        });
        let runs = validate(desired(circle), &observed.collect::<Vec<_>>(), Options::default()).unwrap().runs;
        // The slowest is the last.
        runs.iter()
            .rev()
            .map(|run| run.notes.iter().filter(|note| note.contains("leads the commands")).count())
            .collect::<Vec<_>>()
    };
    assert_eq!((notes(0), notes(60_000_000)), (vec![0, 0], vec![1, 0]));
}

/// A start found by search is late by the lag: what comes after the last command must not count.
#[test]
fn a_searched_start_leaves_out_the_return_to_rest() {
    for pause_s in [0.01, 0.02] {
        let mut recording = simulate(circle, pause_s, CORNER_HZ, Spoiled { run_in: 0, ..NOISY });
        // At rest before and after, away from the circle, as without currents; it returns within half a second.
        let last = recording.frames.last().unwrap().clone();
        let middle = (circle(0) + circle(100).coords) / 2.0;
        let (from, rest) = (last.places[0].point.unwrap(), middle);
        let at = |point: Point3<f64>, ns: i64| {
            let mut frame = Frame { stamp_ns: ns, ..last.clone() };
            frame.places[0].point = Some(point);
            frame
        };
        let frame_ns = 16_666_667;
        let before = (1..=60).rev().map(|k| at(circle(0), recording.frames[0].stamp_ns - k * frame_ns));
        let decay = |k: i64| rest + (from - rest) * (-(k as f64) / 10.0).exp();
        let after = (1..=120).map(|k| at(decay(k), last.stamp_ns + k * frame_ns));
        recording.frames = before.chain(recording.frames.clone()).chain(after).collect();
        let run = |start_ns: Option<i64>| {
            let observed = [Observed { recording: &recording, pause_s, start_ns }];
            validate(desired(circle), &observed, Options::default()).unwrap().runs.remove(0)
        };
        let (given, searched) = (run(Some(START_NS)), run(None));
        assert!(searched.start_ns > START_NS + 50_000_000, "{}", searched.start_ns - START_NS);
        let (right, found) = (given.alignment.rms_m, searched.alignment.rms_m);
        assert!(found < 1.1 * right + 1e-5, "{pause_s}: {found} m, with the start given {right} m");
        assert_eq!(searched.steps.len(), 500);
        let notes = searched.notes.join("\n");
        assert!(notes.contains("the last half of a period") && searched.notes.len() == 1, "{notes}");
    }
}
