//! `catoptra calibrate markers` as a user runs it: what a rig without colours learns from a click near each band, how
//! well that works on another recording, and refusals.

use crate::support::truth;
use crate::support::truth::score::{Limits, Score};
use crate::support::truth::{frames, recording, track, untaught_rig};
use catoptra::rig::Rig;
use catoptra::track::TrackOptions;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

const BASE: &str = "base@431,408:6mm";
const COIL: &str = "coil@431,565:12mm";
const TIP: &str = "tip@430,607:6mm";

/// A folder with the sample's rig as it is before its markers are known: no colours, no places along the tube, no blur.
struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("bare.toml"), untaught_rig()).unwrap();
        Self { folder }
    }

    fn learned(&self) -> PathBuf {
        self.folder.path().join("learned.toml")
    }

    fn calibrate(&self, args: &[&str]) -> Output {
        catoptra(self.folder.path(), &[&["calibrate", "markers"], args].concat())
    }

    fn pick(&self, run: &str, picks: [&str; 3]) -> Output {
        let video = recording(run);
        let [base, coil, tip] = picks;
        let args = ["--rig", "bare.toml", "--out", "learned.toml", "--tube", "3.2mm", "--pick", base, "--pick", coil];
        self.calibrate(&[&[video.to_str().unwrap()], &args[..], &["--pick", tip]].concat())
    }
}

fn catoptra(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).args(args).output().unwrap()
}

/// Fails unless the run ended with this exit code; gives what it said on stderr.
fn ended_with(output: &Output, code: i32) -> String {
    let said = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(output.status.code(), Some(code), "{said}{}", String::from_utf8_lossy(&output.stdout));
    said
}

#[test]
fn markers_learned_from_clicks_measure_another_recording() {
    let bench = Bench::new();
    let output = bench.pick("planar", [BASE, COIL, TIP]);
    ended_with(&output, 0);
    println!("{}", String::from_utf8_lossy(&output.stdout));
    let check = catoptra(bench.folder.path(), &["rig", "check", "learned.toml"]);
    ended_with(&check, 0);

    let rig = Rig::load(&bench.learned()).unwrap();
    let blur_px = rig.camera.blur_px.unwrap();
    assert!((0.4..0.7).contains(&blur_px), "blur {blur_px} px");
    // Chroma of the recording lies between the luma columns, its tag says on them: half a pixel to the right.
    let [right, down] = rig.camera.chroma_offset_px;
    assert!((right - 0.5).abs() < 0.1 && down.abs() < 0.1, "chroma offset {right}, {down} px");
    assert_eq!(rig.catheter.end_rounding_m, None, "it is cut straight");
    let centres_mm: Vec<f64> = rig.markers.iter().map(|m| m.centre_m.unwrap() * 1e3).collect();
    // By construction of the catheter.
    let [upper_mm, lower_mm] = [centres_mm[1] - centres_mm[0], centres_mm[2] - centres_mm[1]];
    assert!((lower_mm - 22.0).abs() < 0.15, "coil to tip {lower_mm} mm");
    assert!((upper_mm - 79.0).abs() < 0.3, "base to coil {upper_mm} mm");
    let markers = rig.provenance["markers"].as_table().unwrap();
    let sd_mm: Vec<f64> = markers["spacing_sd_mm"].as_array().unwrap().iter().filter_map(|v| v.as_float()).collect();
    for (sd, error) in sd_mm.iter().zip([upper_mm - 79.0, lower_mm - 22.0]) {
        assert!(error.abs() < 4.0 * sd, "{error} mm off with a σ of {sd} mm");
    }
    assert_eq!(markers["recording"].as_str(), Some("planar.mkv"));

    let estimates = track(&rig, TrackOptions::default(), frames("circle"));
    let score = Score::of(&rig, "circle", &estimates, &truth::truth("circle"));
    println!("{}", score.table());
    Limits::PROMISED.hold_for(&score);
}

/// By construction the bands are 79 and 22 mm apart.
#[test]
fn places_that_were_given_stay_and_the_others_are_measured_from_them() {
    for (given_mm, expected_mm) in
        [([Some(12.0), None, Some(113.0)], [12.0, 91.0, 113.0]), ([None, None, Some(113.0)], [12.0, 91.0, 113.0])]
    {
        let bench = Bench::new();
        let mut rig: toml::Table = untaught_rig().parse().unwrap();
        rig.remove("provenance");
        let markers = rig["marker"].as_array_mut().unwrap();
        for (marker, given) in markers.iter_mut().zip(given_mm) {
            marker.as_table_mut().unwrap().extend(given.map(|mm: f64| ("centre_mm".to_owned(), mm.into())));
        }
        std::fs::write(bench.folder.path().join("bare.toml"), rig.to_string()).unwrap();
        ended_with(&bench.pick("rest", [BASE, COIL, TIP]), 0);
        let rig = Rig::load(&bench.learned()).unwrap();
        for ((marker, given), expected) in rig.markers.iter().zip(given_mm).zip(expected_mm) {
            let at_mm = marker.centre_m.unwrap() * 1e3;
            let limit_mm = if given.is_some() { 1e-9 } else { 0.5 };
            assert!((at_mm - expected).abs() < limit_mm, "{} at {at_mm} mm, expected {expected}", marker.name);
        }
        assert_eq!(rig.provenance["markers"]["places"].as_str(), Some("partly given"));
    }
}

/// What an earlier run measured is measured again; what was written by hand, before or since, stays.
#[test]
fn of_bands_that_are_taught_again_only_what_was_given_stays() {
    let bench = Bench::new();
    let bare = bench.folder.path().join("bare.toml");
    let mut rig: toml::Table = untaught_rig().parse().unwrap();
    rig.remove("provenance");
    std::fs::write(&bare, rig.to_string()).unwrap();
    let taught = |at_mm: [(usize, Option<f64>); 2]| {
        let mut rig: toml::Table = std::fs::read_to_string(&bare).unwrap().parse().unwrap();
        let markers = rig["marker"].as_array_mut().unwrap();
        for (band, at_mm) in at_mm {
            markers[band].as_table_mut().unwrap().extend(at_mm.map(|mm| ("centre_mm".to_owned(), mm.into())));
        }
        std::fs::write(&bare, rig.to_string()).unwrap();
        ended_with(&bench.pick("rest", [BASE, COIL, TIP]), 0);
        std::fs::copy(bench.learned(), &bare).unwrap();
        Rig::load(&bench.learned()).unwrap().markers.iter().map(|m| m.centre_m.unwrap() * 1e3).collect::<Vec<_>>()
    };
    let first = taught([(0, Some(12.0)), (1, None)]);
    assert!((first[1] - 91.0).abs() < 0.5, "{first:?}");
    let moved = taught([(0, Some(22.0)), (1, None)]);
    assert!((moved[0] - 22.0).abs() < 1e-9 && (moved[1] - first[1] - 10.0).abs() < 1e-3, "{moved:?}");
    let corrected = taught([(0, Some(22.0)), (1, Some(101.3))]);
    assert!((corrected[1] - 101.3).abs() < 1e-9, "{corrected:?}");
}

/// In any direction, in any view, in another frame; on a rig that has learned before, too.
#[test]
fn picks_beside_the_bands_teach_and_teach_the_same_again() {
    let bench = Bench::new();
    let video = recording("rest");
    let run = |rig: &str, out: &str, more: &[&str]| {
        let args = [video.to_str().unwrap(), "--rig", rig, "--out", out, "--tube", "3.2mm"];
        let output = bench.calibrate(&[&args, more].concat());
        ended_with(&output, 0);
        std::fs::read_to_string(bench.folder.path().join(out)).unwrap()
    };
    let pick = |picks: [&str; 3]| -> Vec<String> {
        picks.iter().flat_map(|p| ["--pick".to_owned(), (*p).to_owned()]).collect()
    };
    let taught = |rig: &str, out: &str, picks: [&str; 3], more: &[&str]| {
        let picks = pick(picks);
        run(rig, out, &[&picks.iter().map(String::as_str).collect::<Vec<_>>()[..], more].concat())
    };
    let aside = ["base@434,410.5:6mm", "coil@426.2,563.5:12mm", "tip@427.5,604.5:6mm"];
    let first = taught("bare.toml", "a.toml", aside, &[]);
    assert_eq!(first, taught("bare.toml", "b.toml", aside, &[]));
    assert_eq!(first, taught("a.toml", "c.toml", aside, &[]), "what was learned before goes nowhere");
    let mirrored = ["base@mirror:894,416:6mm", "coil@mirror:885,547:12mm", "tip@mirror:890,579:6mm"];
    let later = taught("bare.toml", "d.toml", mirrored, &["--at", "0.2"]);
    let [a, d] = [first, later].map(|text| Rig::from_toml_str(&text, Path::new("rig.toml")).unwrap());
    for (a, d) in a.markers.iter().zip(&d.markers) {
        assert!((a.centre_m.unwrap() - d.centre_m.unwrap()).abs() < 0.1e-3);
    }
    let page = std::fs::read_to_string(bench.folder.path().join("a.markers.html")).unwrap();
    assert!(page.contains("<svg class=\"picture\"") && page.contains("data:image/jpeg;base64,"));
}

#[test]
fn picks_in_another_order_are_told() {
    let bench = Bench::new();
    let said = ended_with(&bench.pick("rest", [BASE, TIP, COIL]), 2);
    assert!(said.contains("in the order base, tip, coil") && said.contains("from the clamp to the tip"), "{said}");
    let text = std::fs::read_to_string(bench.folder.path().join("bare.toml")).unwrap();
    let mut table: toml::Table = text.parse().unwrap();
    table.remove("marker");
    table.remove("catheter");
    std::fs::write(bench.folder.path().join("bare.toml"), table.to_string()).unwrap();
    let said = ended_with(&bench.pick("rest", [BASE, TIP, COIL]), 3);
    assert!(said.contains("fold back"), "{said}");
}

#[test]
fn a_failure_leaves_a_page() {
    let bench = Bench::new();
    let said = ended_with(&bench.pick("rest", [BASE, COIL, "tip@560,480:6mm"]), 3);
    assert!(said.contains("see learned.markers.html for what was found"), "{said}");
    let page = std::fs::read_to_string(bench.folder.path().join("learned.markers.html")).unwrap();
    assert!(page.contains("Not learned: nothing like a band of 6.0 mm"), "what the page says first");
}

#[test]
fn a_tube_of_another_thickness_is_noticed() {
    let bench = Bench::new();
    let video = recording("rest");
    let args = [video.to_str().unwrap(), "--rig", "bare.toml", "--out", "learned.toml", "--tube", "2mm"];
    let output = bench.calibrate(&[&args[..], &["--pick", BASE, "--pick", COIL, "--pick", TIP]].concat());
    let said = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(said.contains("mm thick, not 2.00 mm"), "{said}");
}

#[test]
fn a_band_of_another_length_is_noticed() {
    let bench = Bench::new();
    let output = bench.pick("rest", [BASE, "coil@431,565:6mm", TIP]);
    let said = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let told = said.split("band `coil` looks about ").nth(1).and_then(|rest| rest.split_once(" mm long, not 6.0 mm"));
    let looks: Option<f64> = told.and_then(|(mm, _)| mm.parse().ok());
    assert!(looks.is_some_and(|mm| mm >= 9.0), "{said}");
    // Half a millimetre is one pixel.
    let output = bench.pick("planar", [BASE, "coil@431,565:12.5mm", TIP]);
    let said = ended_with(&output, 0);
    let looks = said.matches("mm long, not").count();
    assert!(looks == 1 && said.contains("band `coil` looks 12.0 mm long, not 12.5 mm"), "{said}");
    let output = bench.pick("planar", [BASE, COIL, "tip@430,607:7.7mm"]);
    let said = ended_with(&output, 0);
    let looks = ["band `tip` looks 6.", "band `tip` looks about 6"].iter().any(|looks| said.contains(looks));
    assert!(looks && said.contains("not 7.7 mm"), "{said}");
}

#[test]
fn a_region_of_the_command_line_is_in_the_rig() {
    let bench = Bench::new();
    let video = recording("rest");
    let args = [video.to_str().unwrap(), "--rig", "bare.toml", "--out", "learned.toml", "--tube", "3.2mm"];
    let more = ["--region", "mirror:760,300-1000,720", "--pick", BASE, "--pick", COIL, "--pick", TIP];
    ended_with(&bench.calibrate(&[&args[..], &more].concat()), 0);
    let rig = Rig::load(&bench.learned()).unwrap();
    let corners: Vec<(f64, f64)> = rig.views[1].region_px.iter().map(|p| (p.x, p.y)).collect();
    assert_eq!(corners, [(760.0, 300.0), (1000.0, 300.0), (1000.0, 720.0), (760.0, 720.0)]);
}

#[test]
fn bands_that_are_none_or_not_to_be_told_apart_are_refused_and_nothing_is_written() {
    let bench = Bench::new();
    for (what, picks, word) in [
        ("two picks on one band", [BASE, COIL, "tip@431,558:6mm"], "tip"),
        ("the bare tube", [BASE, "coil@431,480:12mm", TIP], "coil"),
        ("the background", [BASE, COIL, "tip@560,480:6mm"], "tip"),
    ] {
        let said = ended_with(&bench.pick("rest", picks), 3);
        assert!(said.contains(word), "{what}: {said}");
        assert!(!bench.learned().exists(), "{what}");
    }
}

#[test]
fn wrong_arguments_are_named() {
    let bench = Bench::new();
    let large = std::fs::read_to_string(bench.folder.path().join("bare.toml")).unwrap();
    let large = large.replace("width_px = 1280", "width_px = 1920").replace("height_px = 1024", "height_px = 1200");
    std::fs::write(bench.folder.path().join("large.toml"), large).unwrap();
    let video = recording("rest");
    let video = video.to_str().unwrap();
    let (rig, tube) = (["--rig", "bare.toml"], ["--tube", "3.2mm"]);
    let picks = ["--pick", BASE, "--pick", COIL, "--pick", TIP];
    let cases: [(&[&[&str]], &str); 14] = [
        (&[&[video], &rig, &picks], "--tube"),
        (&[&[video], &rig, &["--tube", "3.2"], &picks], "3.2mm"),
        (&[&[video], &rig, &tube], "--pick"),
        (&[&[video], &rig, &tube, &["--pick", "base@431:6mm"]], "NAME@X,Y:LENGTH"),
        (&[&[video], &rig, &tube, &picks[..5], &["tip@1300,607:6mm"]], "1280x1024"),
        (&[&[video], &rig, &tube, &picks, &["--view", "left"]], "direct, mirror"),
        (&[&[video], &["--rig", "none.toml"], &tube, &picks], "none.toml"),
        (&[&["none.mkv"], &rig, &tube, &picks], "none.mkv"),
        (
            &[&[video], &rig, &tube, &picks[..5], &["tip@880,600:6mm"]],
            "view `direct`; it is in view `mirror`: write --pick NAME@mirror:X,Y",
        ),
        (
            &[&[video], &rig, &tube, &picks, &["--coil", "coils"]],
            "coils: no such band of this command; picked are base, coil, tip",
        ),
        (
            &[&[video], &rig, &tube, &picks, &["--end", "coil"]],
            "the last marker along the tube, \"tip\" (with the bands",
        ),
        (&[&[video], &rig, &tube, &picks, &["--pick", TIP]], "two picks of this band in view direct"),
        (&[&[video], &rig, &tube, &picks, &["--out", "none/rig.toml"]], "none/rig.toml: there is no such folder"),
        (
            &[&[video], &["--rig", "large.toml"], &tube, &picks],
            "1280x1024 pixels, but the camera in large.toml has 1920x1200",
        ),
    ];
    for (args, word) in cases {
        let said = ended_with(&bench.calibrate(&args.concat()), 2);
        assert!(said.contains(word), "{word} is not in {said}");
    }
}

#[test]
fn the_stiff_part_that_was_given_is_in_the_rig() {
    let bench = Bench::new();
    let video = recording("rest");
    let args = [video.to_str().unwrap(), "--rig", "bare.toml", "--out", "learned.toml", "--tube", "3.2mm"];
    let picks = ["--rigid", "15mm", "--pick", BASE, "--pick", COIL, "--pick", TIP];
    ended_with(&bench.calibrate(&[&args[..], &picks].concat()), 0);
    assert_eq!(Rig::load(&bench.learned()).unwrap().catheter.rigid_m, Some(0.015));
    // Longer than what is left of the tube, before any frame is read.
    let picks = ["--rigid", "14cm", "--pick", BASE, "--pick", COIL, "--pick", TIP];
    let said = ended_with(&bench.calibrate(&[&args[..], &picks].concat()), 2);
    assert!(said.contains("--rigid 140.0 mm: expected at most 100 mm"), "{said}");
}

#[test]
fn a_recording_that_ends_early_is_learned_from_as_far_as_it_goes() {
    let bench = Bench::new();
    let whole = std::fs::read(recording("planar")).unwrap();
    std::fs::write(bench.folder.path().join("cut.mkv"), &whole[..200_000]).unwrap();
    let args = ["cut.mkv", "--rig", "bare.toml", "--out", "learned.toml", "--tube", "3.2mm"];
    let picks = ["--pick", BASE, "--pick", COIL, "--pick", TIP];
    let said = ended_with(&bench.calibrate(&[&args[..], &picks].concat()), 0);
    assert!(said.contains("cut.mkv: the recording ends early"), "{said}");
    assert!(Rig::load(&bench.learned()).unwrap().markers.iter().all(|m| m.colours.len() == 2));
}

#[test]
fn the_recording_and_other_files_are_not_taken_for_a_rig_to_replace() {
    let bench = Bench::new();
    let video = bench.folder.path().join("rest.mkv");
    std::fs::copy(recording("rest"), &video).unwrap();
    let before = std::fs::read(&video).unwrap();
    let args = ["rest.mkv", "--rig", "bare.toml", "--tube", "3.2mm", "--out", "rest.mkv"];
    let picks = ["--pick", BASE, "--pick", COIL, "--pick", TIP];
    let said = ended_with(&bench.calibrate(&[&args[..], &picks].concat()), 2);
    assert!(said.contains("rest.mkv: exists and is not a rig file"), "{said}");
    assert_eq!(std::fs::read(&video).unwrap(), before);
    assert!(!bench.folder.path().join("rest.mkv.bak").exists());
}
