//! `calibration/dev_tank/rig.toml`, the rig of the sample: its script reproduces it, and its accuracy is compared with
//! the true rig's.

use crate::support::truth;
use crate::support::truth::score::rms_and_aligned;
use crate::support::truth::{MARKERS, Truth, file, frames, track, truth};
use catoptra::calibrate::base::{Field, Observed, calibrate_base};
use catoptra::estimate::Estimate;
use catoptra::rig::{Base, Rig};
use catoptra::tally::Drift;
use catoptra::track::TrackOptions;
use nalgebra::{UnitVector3, Vector3};
use std::process::Command;
use toml::Value;

const RIG: &str = "calibration/dev_tank/rig.toml";

fn calibrated() -> Rig {
    Rig::load(&file(RIG)).unwrap()
}

/// All values of a file, each with its key.
fn leaves(key: String, value: &Value, to: &mut Vec<(String, Value)>) {
    match value {
        Value::Table(table) => table.iter().for_each(|(name, value)| leaves(format!("{key}.{name}"), value, to)),
        Value::Array(list) => list.iter().enumerate().for_each(|(i, value)| leaves(format!("{key}.{i}"), value, to)),
        _ => to.push((key, value.clone())),
    }
}

/// How far a number may be off on another machine, whose OpenCV may find corners a hundredth of a pixel elsewhere: a
/// twentieth of σ of the calibration, or what no measurement notices. `None`: no number that means something by itself.
fn tolerance(key: &str) -> Option<f64> {
    // The first that fits counts.
    const BY_KEY: [(&str, f64); 32] = [
        ("sd_by_noise", 0.1),
        ("board_bend_mm", 0.02),
        ("board_stretch", 1e-4),
        ("board_uneven_mm", 0.005),
        ("camera.gamma", 0.02),
        ("usual_residuals", 0.1),
        ("volume_mm", 0.5),
        (".distortion.0", 3e-4),
        (".distortion.1", 9e-3),
        (".distortion.4", 9e-2),
        (".distortion", 1e-5),
        ("focal_px", 0.1),
        ("principal_point_px", 0.1),
        (".normal", 1e-4),
        ("offset_mm", 0.1),
        // Cut on a grid of 4 px.
        ("region_px", 8.0),
        ("centre_mm", 0.05),
        // The last number of a plane is its bias.
        ("planes.0.3", 0.02),
        ("planes.1.3", 0.02),
        ("planes.2.3", 0.02),
        ("planes.3.3", 0.02),
        ("planes", 2e-4),
        (".rgb", 1.0),
        ("blur_px", 0.02),
        ("chroma_offset_px", 0.02),
        (".rotation", 5e-4),
        ("translation_mm", 1.0),
        (".b0", 5e-4),
        ("_sd_", 0.01),
        ("gap", 0.01),
        // What was given.
        ("_mm", 0.0),
        (".index_", 0.0),
    ];
    BY_KEY.iter().find(|(part, _)| key.contains(part)).map(|(_, tolerance)| *tolerance)
}

/// On the machine that made it the file is the same to the byte.
#[test]
fn the_script_makes_the_rig_that_is_here() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("made.toml");
    let run = Command::new(file("calibration/dev_tank/make_rig"))
        .arg(&out)
        .env("CATOPTRA", env!("CARGO_BIN_EXE_catoptra"))
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names, ["made.toml"], "nothing else is left behind");

    let [made, kept] = [out, file(RIG)].map(|path| {
        let mut all = Vec::new();
        leaves(String::new(), &std::fs::read_to_string(path).unwrap().parse().map(Value::Table).unwrap(), &mut all);
        all
    });
    let keys = |all: &[(String, Value)]| all.iter().map(|(key, _)| key.clone()).collect::<Vec<_>>();
    assert_eq!(keys(&made), keys(&kept));
    let mut numbers = 0;
    for ((key, made), (_, kept)) in made.iter().zip(&kept) {
        let (Some(made), Some(kept)) = (made.as_float(), kept.as_float()) else {
            assert_eq!(made, kept, "{key}");
            continue;
        };
        if key.contains("covariance") {
            // What lies beside the diagonal may come out as anything near zero.
            let parts: Vec<&str> = key.rsplit('.').take(2).collect();
            assert!(parts[0] != parts[1] || (made / kept - 1.0).abs() < 0.05, "{key}: {made}, here {kept}");
            continue;
        }
        let within = tolerance(key).unwrap_or_else(|| panic!("{key}: what may it be off?"));
        assert!((made - kept).abs() <= within, "{key}: {made}, here {kept}, may be off by {within}");
        numbers += 1;
    }
    assert!(numbers > 80, "{numbers}");
}

#[test]
fn it_is_found_to_be_in_order() {
    let out = Command::new(env!("CARGO_BIN_EXE_catoptra")).args(["rig", "check"]).arg(file(RIG)).output().unwrap();
    assert_eq!((out.status.code(), out.stderr.as_slice()), (Some(0), b"".as_slice()));
    let text = String::from_utf8(out.stdout).unwrap();
    assert!(text.trim_end().ends_with("no warnings"), "{text}");
}

/// A recording as a rig sees it, and its truth.
struct Run {
    estimates: Vec<Estimate>,
    truth: Vec<Truth>,
}

impl Run {
    fn of(rig: &Rig, run: &str, step: usize) -> Self {
        let estimates = track(rig, TrackOptions::default(), frames(run).step_by(step));
        Self { estimates, truth: truth(run).into_iter().step_by(step).collect() }
    }

    fn observed(&self) -> Observed {
        Observed {
            frames: self.estimates.len(),
            base: self.estimates.iter().map(|e| e.markers[0].position.clone().unwrap()).collect(),
            tangents: self.estimates.iter().map(|e| (e.stamp, e.tangent.clone().unwrap())).collect(),
            first_miss: [None, None],
        }
    }
}

/// Errors, RMS: millimetres and degrees.
struct Worth {
    in_camera_mm: f64,
    aligned_mm: f64,
    /// In each one's own base frame, as `calibrate base` measures it, for each marker.
    in_base_mm: [f64; 3],
    tangent_in_base_deg: f64,
    tangent_in_camera_deg: f64,
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    (sum / count).sqrt()
}

/// Fails when a frame is not answered whole.
fn worth(run: &Run, own: &Base, exact: &Base) -> Worth {
    let points = |m: usize| {
        let pairs = run.estimates.iter().zip(&run.truth);
        pairs.map(move |(e, t)| (e.markers[m].position.as_ref().unwrap().point, t.points[m]))
    };
    let tangents =
        || run.estimates.iter().zip(&run.truth).map(|(e, t)| (e.tangent.as_ref().unwrap().direction, t.tangent));
    let (found, expected): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) =
        (0..MARKERS.len()).flat_map(points).map(|(p, t)| (p.coords * 1e3, t.coords * 1e3)).unzip();
    let [in_camera_mm, aligned_mm] = rms_and_aligned(&found, &expected);
    let in_base =
        |m: usize| rms(points(m).map(|(p, t)| (own.base_from_camera * p - exact.base_from_camera * t).norm() * 1e3));
    let in_base_deg = |(p, t): (Vector3<f64>, UnitVector3<f64>)| {
        (own.base_from_camera * p).angle(&(exact.base_from_camera * t.into_inner())).to_degrees()
    };
    Worth {
        in_camera_mm,
        aligned_mm,
        in_base_mm: [0, 1, 2].map(in_base),
        tangent_in_base_deg: rms(tangents().map(in_base_deg)),
        tangent_in_camera_deg: rms(tangents().map(|(p, t)| p.angle(&t).to_degrees())),
    }
}

/// σ of places in the camera frame, all together, that the verdict of this calibration gives (median over the volume),
/// mm.
const PREDICTED_MM: f64 = 2.04;
/// By how much the calibrated rig may be worse than the true one.
const WORSE: (f64, f64) = (0.02, 0.05);

#[test]
fn tracking_with_it_is_as_good_as_with_the_true_rig() {
    let (calibrated, exact) = (calibrated(), truth::rig());
    let [own, truly] = [&calibrated, &exact].map(|rig| {
        let [rest, planar, circle] =
            [("rest", 1), ("planar", 3), ("circle", 2)].map(|(run, step)| Run::of(rig, run, step));
        // Both measure their base frame: what the frame of a single recording at rest is off is no matter of the rig's.
        let swing = Field::Swing { observed: &planar.observed(), first_is_positive: true };
        let base = calibrate_base(&rest.observed(), swing).unwrap().base;
        let raised = [&rest, &planar, &circle].map(|run| {
            let mut drift = Drift::new(rig);
            run.estimates.iter().map(|estimate| drift.add(estimate).len()).sum::<usize>()
        });
        assert_eq!(raised, [0; 3], "no drift alarm");
        [("planar", planar), ("circle", circle)]
            .map(|(name, run)| (name, worth(&run, &base, exact.base.as_ref().unwrap())))
    });
    for ((run, own), (_, truly)) in own.iter().zip(&truly) {
        println!(
            "\n{run}.mkv            calibrated   true rig\naligned, mm         {:.4}   {:.4}\nin the base frame, mm {:.3?}   {:.3?}\n\
             tangent in it, °    {:.3}   {:.3}\ntangent, °          {:.3}   {:.3}\nin the camera frame, mm {:.3}   {:.3}",
            own.aligned_mm,
            truly.aligned_mm,
            own.in_base_mm,
            truly.in_base_mm,
            own.tangent_in_base_deg,
            truly.tangent_in_base_deg,
            own.tangent_in_camera_deg,
            truly.tangent_in_camera_deg,
            own.in_camera_mm,
            truly.in_camera_mm
        );
        assert!(own.aligned_mm < truly.aligned_mm + WORSE.0, "{run}");
        for (own, truly) in own.in_base_mm.iter().zip(truly.in_base_mm) {
            assert!(*own < truly + WORSE.0, "{run}: {own}, {truly} mm in the base frame");
        }
        assert!(own.tangent_in_base_deg < truly.tangent_in_base_deg + WORSE.1, "{run}");
        assert!(own.tangent_in_camera_deg < truly.tangent_in_camera_deg + WORSE.1, "{run}");
        assert!(own.in_camera_mm < 1.5 * PREDICTED_MM, "{run}: {} mm in the camera frame", own.in_camera_mm);
    }
}
