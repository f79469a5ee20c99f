//! `catoptra calibrate mirror` as a user runs it: a bumped mirror is corrected from an ordinary recording, and a
//! recording that does not determine it is refused.

use crate::support::command::{Place, ended_with, sample, stdout};
use crate::support::moved_mirror::moved;
use crate::support::truth::score::rms_and_aligned;
use crate::support::truth::{frames, rig, track, truth};
use catoptra::calibrate::geometry::tilt_axes;
use catoptra::optics::Surface;
use catoptra::rig::check::{Warning, check};
use catoptra::rig::{Draft, Rig};
use catoptra::tally::{Drift, Drifted};
use catoptra::track::TrackOptions;
use std::path::Path;
use std::process::{Command, Output};

fn calibrate(place: &Place, run: &str, args: &[&str]) -> Output {
    calibrate_rig(place, "rig.toml", run, args)
}

fn calibrate_rig(place: &Place, rig: &str, run: &str, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.current_dir(place.folder.path()).args(["calibrate", "mirror", "--from-markers"]).arg(sample(run));
    command.args(["--rig", rig]).args(args).output().unwrap()
}

/// Turn up or down and left or right, degrees, and shift, mm, of the mirror from the truth.
fn error(found: &Rig) -> [f64; 3] {
    let plane = |rig: &Rig| rig.surfaces["side_mirror"].plane();
    let (found, truth) = (plane(found), plane(&rig()));
    let turn = truth.normal().cross(&found.normal());
    let [a, b] = tilt_axes(&truth.normal());
    let degrees = [a, b].map(|axis| turn.dot(&axis).to_degrees());
    [degrees[0], degrees[1], (found.offset_m() - truth.offset_m()) * 1e3]
}

/// As written into the rig file: of the turns, degrees, and of the shift, mm.
fn sd(found: &Rig) -> [f64; 3] {
    let table = found.provenance["mirror"].as_table().unwrap();
    let turns = table["turned_sd_deg"].as_array().unwrap();
    [turns[0].as_float().unwrap(), turns[1].as_float().unwrap(), table["shifted_sd_mm"].as_float().unwrap()]
}

/// How far the bands of circle.mkv are off, RMS, and after the best rigid alignment, mm; no frame may be missed, nor
/// the views disagree.
fn circle_with(rig: &Rig) -> [f64; 2] {
    let estimates = track(rig, TrackOptions::default(), frames("circle"));
    let mut drift = Drift::new(rig);
    for estimate in &estimates {
        drift.add(estimate);
    }
    // The base frame is that of the mirror as it was: it is to be measured anew.
    assert!(drift.alarms().iter().all(|alarm| matches!(alarm.what, Drifted::Base { .. })), "{:?}", drift.alarms());
    let (mut places, mut expected) = (Vec::new(), Vec::new());
    for (estimate, truth) in estimates.iter().zip(truth("circle")) {
        for (marker, point) in estimate.markers.iter().zip(truth.points) {
            places.push(marker.position.as_ref().unwrap().point.coords * 1e3);
            expected.push(point.coords * 1e3);
        }
    }
    rms_and_aligned(&places, &expected)
}

#[test]
fn a_bumped_mirror_is_put_right_and_tracking_with_it_is_as_good_as_before() {
    // Up by 1° and back by 3 mm: nothing can be tracked. The same to the other sides.
    let [_, true_mm] = circle_with(&rig());
    for (turn_deg, shift_mm) in [([1.0, 0.0], 3.0), ([-0.6, 0.8], -3.0)] {
        let place = Place::with(&moved(&rig(), turn_deg, shift_mm));
        let before = std::fs::read_to_string(&place.rig).unwrap();
        let output = calibrate(&place, "planar.mkv", &[]);
        ended_with(&output, 0);
        println!("{}", stdout(&output));
        assert_eq!(std::fs::read_to_string(place.path("rig.toml.bak")).unwrap(), before);

        let found = Rig::load(&place.rig).unwrap();
        let (error, sd) = (error(&found), sd(&found));
        println!("errors {error:?}, σ {sd:?}");
        for (i, most) in [0.02, 0.2, 3.5].into_iter().enumerate() {
            assert!(error[i].abs() < 3.5 * sd[i] && sd[i] < most, "{i}: {} ± {}", error[i], sd[i]);
        }
        // Nothing else was touched.
        let mut same = rig();
        same.surfaces.insert("side_mirror".into(), found.surfaces["side_mirror"]);
        same.provenance.clone_from(&found.provenance);
        assert_eq!(found.to_toml_string(), same.to_toml_string());

        let [rms_mm, aligned_mm] = circle_with(&found);
        println!(
            "circle.mkv: {rms_mm:.2} mm RMS, {aligned_mm:.3} mm after alignment; {true_mm:.3} mm with the true rig"
        );
        assert!(aligned_mm < 0.1 && aligned_mm < true_mm + 0.03, "{aligned_mm} mm, {true_mm} mm with the true rig");
    }
}

/// The new mirror has its own covariance, and the base frame measured with the old one is doubted until it is measured.
#[test]
fn the_covariance_is_that_of_the_new_mirror_and_the_base_frame_is_doubted() {
    let calibrated = Rig::load(&crate::support::truth::file("calibration/dev_tank/rig.toml")).unwrap();
    let place = Place::with(&moved(&calibrated, [1.0, 0.0], 3.0));
    let noted = |path: &Path| {
        let draft = Draft::load(path).unwrap();
        let doubted = check(&draft).unwrap().warnings.contains(&Warning::BaseBeforeMirror);
        (
            ["mirror_offset_m", "mirror_tilt_1_rad", "front_wall_offset_m"].map(|name| draft.noted_sd(name).unwrap()),
            doubted,
        )
    };
    let (before, doubted) = noted(&place.rig);
    assert!(!doubted);
    ended_with(&calibrate(&place, "planar.mkv", &[]), 0);
    let ([offset, tilt, wall], doubted) = noted(&place.rig);
    let [_, turn_deg, shift_mm] = sd(&Rig::load(&place.rig).unwrap());
    println!("σ of the mirror's offset {} m before, {offset} m now", before[0]);
    assert!((offset * 1e3 - shift_mm).abs() < 1e-3 && (tilt.to_degrees() - turn_deg).abs() < 1e-4, "{offset} {tilt}");
    assert!(offset > before[0] && wall == before[2] && doubted);
    let mut base = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    base.current_dir(place.folder.path()).args(["calibrate", "base"]).arg(sample("rest.mkv"));
    ended_with(&base.args(["--rig", "rig.toml"]).output().unwrap(), 0);
    assert!(!noted(&place.rig).1);
}

#[test]
fn a_mirror_that_stands_where_the_rig_says_stays_there() {
    let place = Place::new();
    let output = calibrate(&place, "circle.mkv", &["--length", "coil-tip=22mm:0.02mm", "--out", "new.toml"]);
    ended_with(&output, 0);
    let found = Rig::load(&place.path("new.toml")).unwrap();
    assert_eq!(Rig::load(&place.rig).unwrap(), rig(), "the rig that was read is left alone");
    // A move within its σ is none: a place known from boards is not given up for one from bands.
    assert_eq!(found.surfaces["side_mirror"], rig().surfaces["side_mirror"]);
    let printed = stdout(&output);
    assert!(printed.contains("the mirror has not moved"), "{printed}");
    for part in
        ["turned up or down", "shifted along its normal", "length coil-tip 22.00 ± 0.02 mm", "written: new.toml"]
    {
        assert!(printed.contains(part), "{part} is not in {printed}");
    }
}

#[test]
fn what_leaves_the_mirror_open_is_refused_and_nothing_is_written() {
    let place = Place::with(&moved(&rig(), [0.5, 0.5], 3.0));
    let before = std::fs::read_to_string(&place.rig).unwrap();
    // At rest all bands stay where they are.
    let said = ended_with(&calibrate(&place, "rest.mkv", &[]), 3);
    assert!(said.contains("leaves the mirror open") && said.contains("nothing was written"), "{said}");
    // One band, that hardly moves.
    let mut one = moved(&rig(), [0.5, 0.5], 3.0);
    one.markers.truncate(1);
    (one.catheter.coil, one.catheter.end) = (0, None);
    one.save(&place.path("one.toml")).unwrap();
    let said = ended_with(&calibrate_rig(&place, "one.toml", "planar.mkv", &[]), 3);
    assert!(said.contains("nothing was written"), "{said}");
    assert_eq!(std::fs::read_to_string(&place.rig).unwrap(), before);
    assert!(!place.path("rig.toml.bak").exists());
}

#[test]
fn wrong_arguments_are_named() {
    let place = Place::new();
    for (args, words) in [
        (&["--mirror", "front_wall"][..], ["no mirror `front_wall`", "side_mirror"]),
        (&["--length", "coil-top=22mm"], ["coil-top", "base, coil, tip"]),
        (&["--length", "22mm"], ["22mm", "coil-tip=22mm:0.05mm"]),
    ] {
        let said = ended_with(&calibrate(&place, "rest.mkv", args), 2);
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
    }
    let mut rig = rig();
    rig.views[0].region_px.clear();
    let place = Place::with(&rig);
    let said = ended_with(&calibrate(&place, "rest.mkv", &[]), 2);
    assert!(said.contains("view `direct` has no region_px"), "{said}");
    let mut in_air = crate::support::truth::rig();
    in_air.surfaces.retain(|_, surface| matches!(surface, Surface::Mirror(_)));
    in_air.views.iter_mut().for_each(|view| view.path.retain(|name| in_air.surfaces.contains_key(name)));
    let place = Place::with(&in_air);
    let said = ended_with(&calibrate(&place, "planar.mkv", &["--length", "none"]), 2);
    assert!(said.contains("State a length with --length"), "{said}");
}
