//! Assignment on made-up blobs: exact projections of bands, and of other objects of their colours.

use crate::estimate::Miss;
use crate::rig::{Rig, View};
use crate::segment::{Blob, Window};
use crate::source::{Clock, Timestamp};
use crate::testing::fixture;
use crate::testing::two_views::views;
use crate::track::assign::assigner::Assigner;
use nalgebra::{Isometry3, Matrix2, Point2, Point3, Vector3};

/// Base, coil and tip on a 3.2 mm tube; two views through water, side by side in the picture, 2 px/mm.
fn rig() -> Rig {
    let mut rig = fixture::rig();
    for (view, (optics, x)) in rig.views.iter_mut().zip(views().into_iter().zip([0.0, 160.0])) {
        view.optics = optics;
        view.region_px =
            [(x, -300.0), (x + 159.9, -300.0), (x + 159.9, 500.0), (x, 500.0)].map(|(x, y)| Point2::new(x, y)).to_vec();
    }
    for (marker, (length_m, centre_m)) in rig.markers.iter_mut().zip([(6e-3, 6e-3), (12e-3, 85e-3), (6e-3, 107e-3)]) {
        (marker.length_m, marker.centre_m) = (length_m, Some(centre_m));
    }
    rig
}

/// A tube that hangs straight down, moved aside.
fn places(aside_m: f64) -> [Point3<f64>; 3] {
    [6e-3, 85e-3, 107e-3].map(|s| Point3::new(1e-3 + aside_m, -0.05 + s, 1.35))
}

/// The image in a view of an object of a marker's colour and of `length_m` at a place.
fn blob(rig: &Rig, marker: usize, view: &View, place: Point3<f64>, length_m: f64) -> Blob {
    let seen = view.optics.project_with_jacobian(&place).unwrap();
    let axis = (seen.d_pixel * Vector3::y()).normalize();
    let px_per_m = seen.d_pixel.norm() / 2_f64.sqrt();
    let (length_px, width_px) = (length_m * px_per_m, rig.catheter.diameter_m * px_per_m);
    Blob {
        marker,
        view: None,
        centre_px: seen.pixel,
        covariance_px2: Matrix2::identity() * 0.04,
        axis,
        length_px,
        width_px,
        area_px2: length_px * width_px,
        mean_score: 1.0,
        bounds: Window::around(&seen.pixel, length_px / 2.0),
        touches_border: false,
    }
}

/// An object of a marker's colour and size, in all views.
fn thing(rig: &Rig, marker: usize, place: Point3<f64>) -> Vec<Blob> {
    rig.views.iter().map(|view| blob(rig, marker, view, place, rig.markers[marker].length_m)).collect()
}

fn tube(rig: &Rig, places: [Point3<f64>; 3]) -> Vec<Blob> {
    places.into_iter().enumerate().flat_map(|(m, place)| thing(rig, m, place)).collect()
}

/// The tube with one band hidden in one view.
fn covered(rig: &Rig, marker: usize, view: usize) -> Vec<Blob> {
    let mut blobs = tube(rig, places(0.0));
    blobs.remove(marker * rig.views.len() + view);
    blobs
}

fn at(ms: i64) -> Timestamp {
    Timestamp { ns: ms * 1_000_000, clock: Clock::Container }
}

/// An assigner that saw the tube at time 0.
fn after_a_frame(rig: &Rig) -> Assigner {
    let mut assigner = Assigner::new(rig);
    places(0.0).into_iter().enumerate().for_each(|(m, place)| assigner.remember(m, place, at(0)));
    assigner
}

/// The result: distance of each marker from its true place, millimetres, or its miss.
fn off_mm(assigner: &Assigner, rig: &Rig, blobs: &[Blob]) -> Vec<Result<f64, Miss>> {
    let found = assigner.assign(rig, blobs, at(17));
    found.into_iter().zip(places(0.0)).map(|(found, place)| found.map(|a| (a.point - place).norm() * 1e3)).collect()
}

fn all_found(found: &[Result<f64, Miss>]) -> bool {
    found.iter().all(|f| f.as_ref().is_ok_and(|mm| *mm < 0.05))
}

#[test]
fn the_bands_alone_are_found_with_and_without_memory() {
    let rig = rig();
    let blobs = tube(&rig, places(0.0));
    assert!(all_found(&off_mm(&Assigner::new(&rig), &rig, &blobs)));
    assert!(all_found(&off_mm(&after_a_frame(&rig), &rig, &blobs)));
}

#[test]
fn a_brick_beyond_the_tubes_reach_is_left_out() {
    let rig = rig();
    let mut blobs = thing(&rig, 1, Point3::new(0.03, 0.09, 1.36));
    blobs.extend(thing(&rig, 2, Point3::new(-0.025, -0.03, 1.34)));
    blobs.extend(tube(&rig, places(0.0)));
    assert!(all_found(&off_mm(&Assigner::new(&rig), &rig, &blobs)));
}

#[test]
fn a_reflection_in_one_view_and_a_thing_of_another_size_are_left_out() {
    let rig = rig();
    let mut blobs = tube(&rig, places(0.0));
    // Of the right size, but no ray of the other view meets its own.
    blobs.insert(0, blob(&rig, 1, &rig.views[0], Point3::new(-0.02, 0.02, 1.35), 12e-3));
    // A long rod, away from the coil in both views; its rays meet, but it is four bands long.
    blobs.extend(rig.views.iter().map(|view| blob(&rig, 1, view, Point3::new(0.02, 0.03, 1.35), 48e-3)));
    assert!(all_found(&off_mm(&Assigner::new(&rig), &rig, &blobs)));
}

#[test]
fn a_covered_band_is_missed_in_the_view_that_does_not_show_it() {
    let rig = rig();
    for marker in 0..3 {
        for view in 0..2 {
            for (assigner, remembers) in [(Assigner::new(&rig), false), (after_a_frame(&rig), true)] {
                let found = off_mm(&assigner, &rig, &covered(&rig, marker, view));
                assert_eq!(found[marker], Err(Miss::NotSeen { view }), "marker {marker}");
                // A tip without its neighbour goes on from where it was, or may be any thing of its colour.
                let expected = if marker == 1 && !remembers { 1 } else { 2 };
                assert_eq!(found.iter().filter(|f| f.is_ok()).count(), expected, "{found:?}");
            }
        }
    }
}

/// A brick of the band's colour elsewhere in the view that hides the band: its ray nearly meets the band's, but the
/// reason is that the band is hidden.
#[test]
fn a_brick_elsewhere_is_no_sight_of_a_covered_band() {
    let rig = rig();
    for view in 0..2 {
        let mut blobs = covered(&rig, 1, view);
        blobs.push(blob(&rig, 1, &rig.views[view], Point3::new(0.02, -0.09, 1.36), 12e-3));
        for (assigner, remembers) in [(Assigner::new(&rig), false), (after_a_frame(&rig), true)] {
            let found = off_mm(&assigner, &rig, &blobs);
            assert_eq!(found[1], Err(Miss::NotSeen { view }));
            let alone = found[2] == Err(Miss::Ambiguous { candidates: 2 });
            assert!(found[0].is_ok() && if remembers { found[2].is_ok() } else { alone }, "{found:?}");
        }
    }
}

#[test]
fn two_places_as_good_as_each_other_are_ambiguous_until_one_is_remembered() {
    let rig = rig();
    let mut blobs = tube(&rig, places(0.0));
    // Half way down to the coil, where a bent tube could also have its base.
    blobs.extend(thing(&rig, 0, places(0.0)[0] + Vector3::new(0.0, 0.045, 0.0)));
    let found = off_mm(&Assigner::new(&rig), &rig, &blobs);
    assert_eq!(found[0], Err(Miss::Ambiguous { candidates: 2 }));
    assert!(found[1].is_ok() && found[2].is_ok());
    assert!(all_found(&off_mm(&after_a_frame(&rig), &rig, &blobs)));
}

/// A coder may leave the tip where it was in one view. The tube does not reach from the coil to where the views then
/// meet.
#[test]
fn of_two_bands_that_cannot_both_be_right_the_one_just_seen_is_and_without_memory_neither() {
    let rig = rig();
    let mut blobs = tube(&rig, places(0.0))[..4].to_vec();
    blobs.extend(thing(&rig, 2, places(0.0)[2] + Vector3::new(0.02, 0.0, 0.0)));
    let mut assigner = after_a_frame(&rig);
    assigner.remember(2, places(0.0)[2], at(-130));
    let found = off_mm(&assigner, &rig, &blobs);
    assert!(found[0].is_ok() && found[1].is_ok() && found[2].is_err(), "{found:?}");
    let found = off_mm(&Assigner::new(&rig), &rig, &blobs);
    let ambiguous = Err(Miss::Ambiguous { candidates: 2 });
    assert!(found[0].is_ok() && (found[1] == ambiguous || found[2] == ambiguous), "{found:?}");
    assert!(found[1].is_err() && found[2].is_err(), "{found:?}");
}

#[test]
fn a_third_view_stands_in_for_a_covered_one() {
    let mut rig = rig();
    // The same mirror view again, further to the right in the picture.
    let mut third = View { name: "second mirror".into(), ..rig.views[1].clone() };
    third.optics.lens.principal_point_px.x += 160.0;
    third.region_px.iter_mut().for_each(|corner| corner.x += 160.0);
    rig.views.push(third);
    let found = after_a_frame(&rig).assign(&rig, &covered(&rig, 1, 1), at(17));
    let coil = found[1].as_ref().unwrap();
    assert!(coil.blobs[0].is_some() && coil.blobs[1].is_none() && coil.blobs[2].is_some());
    assert!((coil.point - places(0.0)[1]).norm() < 0.05e-3);
}

#[test]
fn what_was_seen_long_ago_opens_no_window() {
    let rig = rig();
    assert!(Assigner::new(&rig).windows(&rig, at(0)).is_none());
    let assigner = after_a_frame(&rig);
    let windows = assigner.windows(&rig, at(17)).unwrap();
    assert_eq!(windows.len(), 6);
    assert!(assigner.windows(&rig, at(300)).is_none(), "a quarter of a second is too long");
    assert!(assigner.windows(&rig, at(-17)).is_none(), "time that runs backwards is no memory");
}

/// Eight views that share the picture, and many objects of each colour: more combinations than can be tried.
#[test]
fn many_views_of_many_things_are_gone_through_soon() {
    let mut rig = rig();
    let blobs: Vec<Blob> = (0..6).flat_map(|k| tube(&rig, places(4e-3 * f64::from(k)))).collect();
    let views: Vec<View> = rig.views.iter().cycle().take(8).cloned().collect();
    rig.views = views;
    rig.views.iter_mut().for_each(|view| view.region_px.clear());
    let began = std::time::Instant::now();
    assert_eq!(Assigner::new(&rig).assign(&rig, &blobs, at(17)).len(), 3);
    assert!(began.elapsed().as_secs() < 60, "{:?}", began.elapsed());
}

/// The base band rests, and a coil that may be the other's is not taken for the one that is hidden.
#[test]
fn of_two_catheters_the_base_band_is_the_one_at_rest_and_a_hidden_coil_is_not_the_other_s() {
    let mut rig = rig();
    let rest = places(0.0)[0];
    rig.base.as_mut().unwrap().base_from_camera = Isometry3::translation(-rest.x, -rest.y, -rest.z);
    let other = tube(&rig, places(0.03));
    let both = [tube(&rig, places(0.0)), other.clone()].concat();
    assert!(all_found(&off_mm(&after_a_frame(&rig), &rig, &both)));
    assert!(off_mm(&Assigner::new(&rig), &rig, &both)[0].as_ref().is_ok_and(|mm| *mm < 0.05));
    let hidden = [thing(&rig, 0, rest), other].concat();
    let found = off_mm(&after_a_frame(&rig), &rig, &hidden);
    assert!(found[0].as_ref().is_ok_and(|mm| *mm < 0.05), "{found:?}");
    assert!(found[1].is_err() && found[2].is_err(), "{found:?}");
}

/// A thing of the tip's colour stands in view while coil and tip are hidden, and after.
#[test]
fn a_thing_of_the_tip_s_colour_is_not_the_tip_when_coil_and_tip_are_hidden() {
    let mut rig = rig();
    let [rest, _, tip] = places(0.0);
    rig.base.as_mut().unwrap().base_from_camera = Isometry3::translation(-rest.x, -rest.y, -rest.z);
    for (off, reached) in [(Vector3::new(0.02, -0.06, 0.0), true), (Vector3::new(0.01, 0.06, 0.0), false)] {
        let bead = thing(&rig, 2, tip + off);
        let hidden = [thing(&rig, 0, rest), bead.clone()].concat();
        for mut assigner in [Assigner::new(&rig), after_a_frame(&rig)] {
            for frame in 1..30 {
                let found = assigner.assign(&rig, &hidden, at(17 * frame));
                assert!(found[0].is_ok() && found[1].is_err(), "{found:?}");
                let is_ambiguous = matches!(found[2], Err(Miss::Ambiguous { .. }));
                assert!(found[2].is_err() && (is_ambiguous || !reached), "{found:?}");
                assigner.remember(0, rest, at(17 * frame));
            }
            let seen_again = [tube(&rig, places(0.0)), bead.clone()].concat();
            let found = assigner.assign(&rig, &seen_again, at(17 * 30));
            let off = |m: usize| (found[m].as_ref().unwrap().point - places(0.0)[m]).norm();
            assert!((0..3).all(|m| off(m) < 1e-4), "{found:?}");
        }
    }
}
