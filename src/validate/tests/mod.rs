mod paths;
mod timing;

use super::start_time::StartFrom;
use super::*;
use crate::series::{Current, Frame, Place, Recording};
use crate::sink::OutputFrame;
use crate::testing::random::Random;
use nalgebra::{Point3, Rotation3, Vector3};
use std::f64::consts::TAU;
use std::fmt::Write as _;

/// The paper's pause times, ms.
const PAUSES_MS: [f64; 12] = [1.0, 3.0, 5.0, 8.0, 10.0, 12.0, 15.0, 18.0, 20.0, 25.0, 50.0, 100.0];
/// A catheter as slow as the paper's: corner at 1.3 Hz.
const CORNER_HZ: f64 = 1.3;
const RADIUS_M: f64 = 0.0125;
const START_NS: i64 = 2_345_678_901;

/// A circle in a tilted plane.
fn circle(k: usize) -> Point3<f64> {
    let t = TAU * k as f64 / 200.0;
    Rotation3::from_euler_angles(0.2, -0.1, 0.4) * Point3::new(RADIUS_M * t.cos(), RADIUS_M * t.sin(), 0.0)
        + Vector3::new(0.002, -0.001, 0.045)
}

/// A lemniscate.
fn eight(k: usize) -> Point3<f64> {
    let t = TAU * k as f64 / 200.0;
    Point3::new(0.015 * t.sin(), 0.008 * (2.0 * t).sin(), 0.05 - 0.001 * t.cos())
}

fn desired(of: fn(usize) -> Point3<f64>) -> DesiredPath {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("circle.csv");
    let mut text = "x_mm,y_mm,z_mm\n".to_owned();
    for k in 0..200 {
        let p = of(k).coords * 1e3;
        writeln!(text, "{},{},{}", p.x, p.y, p.z).unwrap();
    }
    std::fs::write(&file, text).unwrap();
    DesiredPath::read(&file, None, None).unwrap()
}

/// Faults of a simulated run.
#[derive(Clone, Copy)]
struct Spoiled {
    noise_m: f64,
    missing: f64,
    seed: u64,
    /// Periods commanded before the first one that counts.
    run_in: usize,
}

const CLEAN: Spoiled = Spoiled { noise_m: 0.0, missing: 0.0, seed: 0, run_in: 20 };

/// Four periods of commands, each held for a pause, followed by a first-order lag (exactly, for any pause), observed at
/// 60 Hz.
fn simulate(of: fn(usize) -> Point3<f64>, pause_s: f64, corner_hz: f64, spoiled: Spoiled) -> Recording {
    let mut random = Random::new(spoiled.seed);
    let rate = TAU * corner_hz;
    let mut state = of(0);
    let settle = |state: Point3<f64>, to: Point3<f64>, s: f64| to + (state - to) * (-rate * s).exp();
    for k in 0..200 * spoiled.run_in {
        state = settle(state, of(k), pause_s);
    }
    let mut frames = Vec::new();
    let mut frame_s = 0.0041;
    for k in 0..800 {
        let began_s = k as f64 * pause_s;
        while frame_s < began_s + pause_s {
            let place = settle(state, of(k), frame_s - began_s);
            let noise = Vector3::from_fn(|_, _| random.normal()) * spoiled.noise_m;
            let seen = random.uniform() >= spoiled.missing;
            frames.push(Frame {
                seq: frames.len() as u64,
                stamp_ns: START_NS + (frame_s * 1e9_f64).round() as i64,
                host_ns: None,
                gap: 0,
                theta_rad: None,
                theta_sd_rad: None,
                theta_status: None,
                places: vec![Place {
                    point: seen.then_some(place + noise),
                    sd_m: seen.then_some(5e-5),
                    status: if seen { "ok" } else { "ambiguous" }.to_owned(),
                }],
                tangent: None,
                tangent_sd_rad: None,
                tick: None,
            });
            frame_s += 1.0 / 60.0;
        }
        state = settle(state, of(k), pause_s);
    }
    Recording {
        path: format!("{}ms.csv", pause_s * 1e3).into(),
        clock: None,
        reference: Some(OutputFrame::Base),
        markers: vec!["tip".to_owned()],
        frames,
        currents: Vec::new(),
        cut: None,
        vetoed: 0,
        currents_lost: 0,
    }
}

fn evaluated(of: fn(usize) -> Point3<f64>, corner_hz: f64, spoiled: Spoiled, options: Options) -> Validation {
    let recordings: Vec<(f64, Recording)> =
        PAUSES_MS.iter().map(|ms| (ms * 1e-3, simulate(of, ms * 1e-3, corner_hz, spoiled))).collect();
    let observed: Vec<Observed<'_>> = recordings
        .iter()
        .map(|(pause_s, recording)| Observed { recording, pause_s: *pause_s, start_ns: Some(START_NS) })
        .collect();
    validate(desired(of), &observed, options).unwrap()
}

/// Magnitude (dB) and phase (degrees) of a first-order lag.
fn truth(hz: f64, corner_hz: f64) -> (f64, f64) {
    let ratio = hz / corner_hz;
    (-10.0 * (1.0 + ratio * ratio).log10(), -ratio.atan().to_degrees())
}

#[test]
fn a_pause_time_is_a_frequency() {
    let validation = evaluated(circle, CORNER_HZ, CLEAN, Options::default());
    let pauses: Vec<f64> = validation.runs.iter().map(|run| (run.pause_s * 1e3).round()).collect();
    assert_eq!(pauses, PAUSES_MS);
    for run in &validation.runs {
        assert!((run.frequency_hz - 1.0 / (200.0 * run.pause_s)).abs() < 1e-12);
        assert_eq!(run.interpolated, run.pause_s < 1.0 / 60.0);
        assert_eq!(run.steps.len(), 600);
    }
    assert_eq!(validation.runs[0].frequency_hz, 5.0);
}

#[test]
fn magnitude_and_phase_of_lagged_circles_without_noise() {
    let validation = evaluated(circle, CORNER_HZ, CLEAN, Options::default());
    for run in &validation.runs {
        let (db, deg) = truth(run.frequency_hz, CORNER_HZ);
        let (found_db, found_deg) = (run.magnitude.unwrap().db, run.phase_deg.unwrap());
        println!("{:>5} ms: {:+.4} dB, {:+.3}°", run.pause_s * 1e3, found_db - db, found_deg - deg);
        assert!((found_db - db).abs() < 0.01, "{}: {found_db} dB, {db} dB", run.pause_s);
        // At 50 and 100 ms frames keep their positions within the pause, here 4 ms before its middle on average.
        assert!((found_deg - deg).abs() < 0.2, "{}: {found_deg}°, {deg}°", run.pause_s);
        assert_eq!(run.magnitude.unwrap().of, Size::CircleRadius);
    }
}

#[test]
fn magnitude_and_phase_with_noise_and_missing_frames() {
    for seed in 1..=5 {
        let spoiled = Spoiled { noise_m: 5e-5, missing: 0.05, seed, ..CLEAN };
        let validation = evaluated(circle, CORNER_HZ, spoiled, Options::default());
        for run in &validation.runs {
            let (db, deg) = truth(run.frequency_hz, CORNER_HZ);
            let (found_db, found_deg) = (run.magnitude.unwrap().db, run.phase_deg.unwrap());
            println!(
                "{:>5} ms: {:+.4} dB, {:+.3}°, {} left out",
                run.pause_s * 1e3,
                found_db - db,
                found_deg - deg,
                run.left_out
            );
            assert!((found_db - db).abs() < 0.05, "{}: {found_db} dB, {db} dB", run.pause_s);
            assert!((found_deg - deg).abs() < 0.5, "{}: {found_deg}°, {deg}°", run.pause_s);
            assert!(run.frames_missed > 0 || run.frames < 60);
        }
    }
}

#[test]
fn straight_lines_between_frames_cost_amplitude() {
    let options = Options { interpolation: Interpolation::Linear, ..Options::default() };
    let validation = evaluated(circle, CORNER_HZ, CLEAN, options);
    let run = &validation.runs[0];
    let error_db = run.magnitude.unwrap().db - truth(5.0, CORNER_HZ).0;
    assert!((-0.25..-0.12).contains(&error_db), "{error_db} dB");
}

#[test]
fn the_second_half_of_a_pause_is_nearer_and_its_phase_the_same() {
    let late = Options { average: Average::SecondHalf, ..Options::default() };
    let (all, second) =
        (evaluated(circle, CORNER_HZ, CLEAN, Options::default()), evaluated(circle, CORNER_HZ, CLEAN, late));
    for (all, second) in all.runs.iter().zip(&second.runs).filter(|(run, _)| run.pause_s > 0.03) {
        // A quarter of a pause is short compared with this catheter's lag: 0.0125 s to 0.12 s.
        assert!(
            second.rms_unaligned_m < 0.95 * all.rms_unaligned_m,
            "{} {}",
            second.rms_unaligned_m,
            all.rms_unaligned_m
        );
        let (_, deg) = truth(second.frequency_hz, CORNER_HZ);
        assert!((second.phase_deg.unwrap() - deg).abs() < 0.3, "{:?}, {deg}", second.phase_deg);
    }
}

/// The amplifier holds each point 0.3 % longer than asked, and its start is not given: ticks give it, to a fraction of
/// a frame.
#[test]
fn ticks_give_start_and_pause() {
    let true_pause_s = 0.05 * 1.003;
    let mut recording = simulate(circle, true_pause_s, CORNER_HZ, CLEAN);
    let count = |ns: i64| ((ns - START_NS) as f64 * 1e-9 / true_pause_s).floor() as i64 + 2;
    // Frames before the first command show the count before it.
    let mut before = recording.frames[0].clone();
    (before.stamp_ns, before.tick) = (START_NS - 12_000_000, Some(1));
    for frame in &mut recording.frames {
        frame.tick = Some(count(frame.stamp_ns).rem_euclid(4) as u64);
    }
    recording.frames.insert(0, before);
    let evaluate = |recording: &Recording, pause_s: f64, start_ns: Option<i64>| {
        let observed = [Observed { recording, pause_s, start_ns }];
        validate(desired(circle), &observed, Options::default()).unwrap().runs.remove(0)
    };
    let run = evaluate(&recording, 0.05, None);
    assert_eq!((run.start_from, &run.notes), (StartFrom::Ticks, &Vec::new()));
    assert!((run.start_ns - START_NS).abs() < 1_000_000, "{}", run.start_ns - START_NS);
    assert!((run.pause_s - true_pause_s).abs() < 2e-6, "{}", run.pause_s);
    let (_, deg) = truth(run.frequency_hz, CORNER_HZ);
    assert!((run.phase_deg.unwrap() - deg).abs() < 0.3, "{:?} {deg}", run.phase_deg);
    // With the requested pause, commands and frames drift apart, by 0.12 s at the end.
    let drifted = evaluate(&recording, 0.05, Some(START_NS));
    assert!((drifted.phase_deg.unwrap() - deg).abs() > 1.0, "{:?} {deg}", drifted.phase_deg);
    // Modulo 4 cannot resolve commands 4 ms apart.
    let aliased = start_time::from_ticks(&recording, 4_000_000, 800).unwrap().unwrap();
    assert!(aliased.note.unwrap().contains("modulo 4 aliases at this pause") && aliased.start_sd_ns.is_none());
    // Six lost frames hide whole counts.
    let mut holed = recording.clone();
    holed.frames.drain(900..918);
    let run = evaluate(&holed, 0.05, None);
    assert!(run.notes.iter().any(|note| note.contains("are too long for a count")), "{:?}", run.notes);
    assert!((run.start_ns - START_NS).abs() < 17_000_000 && run.start_sd_s.unwrap() > 4e-3, "{run:?}");
    // Commands may have come before the first that shows.
    holed.frames.drain(1..18);
    assert_eq!(evaluate(&holed, 0.05, None).start_sd_s, None);
    // A count that never changes is not a clock.
    for frame in &mut recording.frames {
        frame.tick = Some(1);
    }
    let observed = [Observed { recording: &recording, pause_s: 0.05, start_ns: None }];
    let error = validate(desired(circle), &observed, Options::default()).unwrap_err().to_string();
    assert!(error.contains("its tick is 1 in all"), "{error}");
}

#[test]
fn a_start_from_rest_shows_in_the_first_period() {
    let from_rest = Spoiled { run_in: 0, ..CLEAN };
    let fastest = |skip| {
        let validation = evaluated(circle, CORNER_HZ, from_rest, Options { skip, ..Options::default() });
        let errors =
            validation.runs.iter().map(|run| (run.magnitude.unwrap().db - truth(run.frequency_hz, CORNER_HZ).0).abs());
        let errors: Vec<f64> = errors.collect();
        assert!(errors.iter().all(|error| *error <= errors[0]), "{errors:?}");
        errors[0]
    };
    let (all, without_first) = (fastest(0), fastest(1));
    println!("{all:.2} dB with the first period, {without_first:.2} dB without it");
    assert!(all > 2.0 * without_first && without_first > 0.05);
}

#[test]
fn alignment_absorbs_a_pure_lag_on_a_circle_and_the_rest_of_the_result_shows_it() {
    // A catheter that follows exactly, 25 points late: 45°.
    let late = |k: usize| circle((k + 175) % 200);
    let recording = simulate(late, 0.1, 1e4, CLEAN);
    let observed = [Observed { recording: &recording, pause_s: 0.1, start_ns: Some(START_NS) }];
    let run = validate(desired(circle), &observed, Options::default()).unwrap().runs.remove(0);
    assert!(run.alignment.rms_m < 1e-8, "{} m", run.alignment.rms_m);
    assert!((run.rms_unaligned_m - 2.0 * RADIUS_M * (TAU / 16.0).sin()).abs() < 1e-8, "{} m", run.rms_unaligned_m);
    let (angle, axis) = run.alignment.angle_axis();
    assert!((angle.to_degrees() - 45.0).abs() < 1e-4, "{}°", angle.to_degrees());
    assert!((axis.unwrap().dot(&run.plane.unwrap().normal).abs() - 1.0).abs() < 1e-6);
    // This one jumps from point to point; the phase counts as for one that moves on within a pause, here up to 0.15°
    // apart.
    assert!((run.phase_deg.unwrap() + 45.0).abs() < 0.15 && run.magnitude.unwrap().db.abs() < 1e-4);
    for gain in run.gain {
        assert!(gain.is_none_or(|gain| (gain - 1.0).abs() < 1e-3));
    }
}

#[test]
fn a_lemniscate_has_a_size_and_says_so() {
    let validation = evaluated(eight, CORNER_HZ, CLEAN, Options::default());
    assert_eq!(validation.path.circle, None);
    for run in &validation.runs {
        let magnitude = run.magnitude.unwrap();
        assert_eq!((magnitude.of, run.circle), (Size::RmsSize, None));
        assert!(run.alignment.rms_m <= run.rms_unaligned_m + 1e-12);
    }
    let slowest = validation.runs.last().unwrap();
    assert!(slowest.magnitude.unwrap().db.abs() < 0.05 && slowest.rms_unaligned_m < 1e-3);
    // Errors grow with speed, as in Table II.
    assert!(validation.runs[0].alignment.rms_m > 5.0 * slowest.alignment.rms_m);
}

#[test]
fn missing_frames_leave_points_out_and_are_counted() {
    let mut recording = simulate(circle, 0.018, CORNER_HZ, CLEAN);
    let (from, to) = (START_NS + 8_000_000_000, START_NS + 8_200_000_000);
    recording.frames.retain(|frame| frame.stamp_ns < from || frame.stamp_ns >= to);
    for frame in &mut recording.frames {
        if frame.stamp_ns >= to && frame.stamp_ns < to + 17_000_000 {
            frame.gap = 12;
        }
    }
    let observed = [Observed { recording: &recording, pause_s: 0.018, start_ns: Some(START_NS) }];
    let run = validate(desired(circle), &observed, Options::default()).unwrap().runs.remove(0);
    assert_eq!((run.frames_lost, run.frames_missed), (12, 0));
    assert!((10..=12).contains(&run.left_out), "{}", run.left_out);
    assert_eq!(run.steps.iter().filter(|s| s.observed.is_none()).count(), run.left_out);
    assert_eq!(Row::of(&run).points_left_out, run.left_out);
}

#[test]
fn noise_and_the_trackers_own_sigma_are_told() {
    let spoiled = Spoiled { noise_m: 5e-5, missing: 0.0, seed: 1, ..CLEAN };
    let recording = simulate(circle, 0.1, CORNER_HZ, spoiled);
    let observed = [Observed { recording: &recording, pause_s: 0.1, start_ns: Some(START_NS) }];
    let run = validate(desired(circle), &observed, Options::default()).unwrap().runs.remove(0);
    // Three coordinates of noise, and 0.4 mm of motion in each pause.
    assert!((8e-5..2e-4).contains(&run.scatter_m.unwrap()), "{:?}", run.scatter_m);
    assert!((run.sd_m.unwrap() - 5e-5).abs() < 1e-12);
}

#[test]
fn the_start_is_taken_from_currents_or_searched_for() {
    let pause_s = 0.02;
    let mut recording = simulate(circle, pause_s, CORNER_HZ, Spoiled { run_in: 0, ..CLEAN });
    // Two seconds of rest before and after.
    let rest = |from_ns: i64, point: Point3<f64>| {
        (0..120).map(move |k| Frame {
            stamp_ns: from_ns + k * 16_666_667,
            places: vec![Place { point: Some(point), sd_m: None, status: "ok".to_owned() }],
            ..blank()
        })
    };
    let (first, last) = (recording.frames[0].clone(), recording.frames.last().unwrap().clone());
    let mut frames: Vec<Frame> = rest(first.stamp_ns - 120 * 16_666_667, first.places[0].point.unwrap()).collect();
    frames.append(&mut recording.frames);
    frames.extend(rest(last.stamp_ns + 16_666_667, last.places[0].point.unwrap()));
    recording.frames = frames;

    let one = |recording: &Recording, start_ns| {
        let observed = [Observed { recording, pause_s, start_ns }];
        validate(desired(circle), &observed, Options::default()).unwrap().runs.remove(0)
    };
    let found = one(&recording, None);
    assert_eq!((found.start_from, found.phase_deg), (StartFrom::Search, None));
    assert!(found.notes[0].contains("absorbs the lag"), "{:?}", found.notes);
    // It is late by the catheter's lag: 10° at 0.25 Hz is 0.12 s.
    let late_s = (found.start_ns - START_NS) as f64 * 1e-9;
    assert!((0.08..0.16).contains(&late_s), "{late_s} s");

    let current = |ns: i64, a: f64| Current { host_ns: Some(ns), stamp_ns: Some(ns), values_a: vec![0.0, a] };
    recording.currents =
        vec![current(5, 0.0), current(START_NS - 9, 0.0), current(START_NS, 0.01), current(START_NS + 1, 0.0)];
    let logged = one(&recording, None);
    assert_eq!((logged.start_from, logged.start_ns), (StartFrom::Currents, START_NS));
    let given = one(&recording, Some(START_NS + 5));
    assert_eq!((given.start_from, given.start_ns), (StartFrom::Given, START_NS + 5));
    assert!((logged.phase_deg.unwrap() - truth(0.25, CORNER_HZ).1).abs() < 0.2, "{:?}", logged.phase_deg);
}

fn blank() -> Frame {
    Frame {
        seq: 0,
        stamp_ns: 0,
        host_ns: None,
        gap: 0,
        theta_rad: None,
        theta_sd_rad: None,
        theta_status: None,
        places: Vec::new(),
        tangent: None,
        tangent_sd_rad: None,
        tick: None,
    }
}

#[test]
fn what_cannot_be_used_is_told_with_its_numbers() {
    let good = simulate(circle, 0.02, CORNER_HZ, CLEAN);
    let refused = |recording: &Recording, pause_s: f64, start_ns: Option<i64>, options: Options| {
        let observed = [Observed { recording, pause_s, start_ns }];
        validate(desired(circle), &observed, options).unwrap_err().to_string()
    };
    let message = |change: fn(&mut Recording), start| {
        let mut recording = good.clone();
        change(&mut recording);
        refused(&recording, 0.02, start, Options::default())
    };
    let given = Some(START_NS);
    assert_eq!(message(|r| r.frames.clear(), given), "20ms.csv: has no frame");
    let all_missed = |r: &mut Recording| r.frames.iter_mut().for_each(|f| f.places[0].point = None);
    assert_eq!(message(all_missed, given), "20ms.csv: none of its 960 frames has a place of tip");
    assert!(message(|r| r.frames.swap(3, 4), given).contains("is not later than frame"));
    assert!(message(|r| r.reference = Some(OutputFrame::Camera), given).contains("in the camera frame"));
    assert!(message(|r| r.markers.clear(), given).contains("has no places of markers"));
    let other = message(|_| {}, Some(START_NS + 100_000_000_000));
    assert_eq!(
        other,
        "20ms.csv: no frame is from the time of the commands: these are from 102.346 s to 118.346 s, the frames from \
         2.350 s to 18.333 s of the camera's clock; check --start"
    );
    let short = message(|r| r.frames.truncate(500), None);
    assert!(short.contains("they take 16.000 s, the record has 8.317 s of motion; give --start"), "{short}");
    let half = message(|r| r.frames.truncate(280), given);
    assert!(half.contains("of 600 commands have a point, less than half of a period (200 rows of "), "{half}");
    let still = |r: &mut Recording| r.frames.iter_mut().for_each(|f| f.places[0].point = Some(Point3::origin()));
    assert!(message(still, given).contains("lie on a line or do not move"));
    assert_eq!(
        refused(&good, 0.0, given, Options::default()),
        "20ms.csv: a pause of 0 s is not valid: it must be above 0"
    );
    let marker = Options { marker: Some("coil".to_owned()), ..Options::default() };
    assert!(refused(&good, 0.02, given, marker).contains("has no marker `coil`; it has tip"));
    let skip = Options { skip: 4, ..Options::default() };
    assert!(refused(&good, 0.02, given, skip).contains("is commanded 4 times, and 4 are left out"));
}

#[test]
fn directions_of_the_coil_are_compared_where_the_path_has_them() {
    let mut recording = simulate(circle, 0.05, CORNER_HZ, CLEAN);
    let (desired_tangent, tilt) = (Vector3::new(0.1, 0.0, 1.0).normalize(), 0.03);
    for frame in &mut recording.frames {
        frame.tangent = Some(Rotation3::from_axis_angle(&Vector3::y_axis(), tilt) * desired_tangent);
    }
    let mut path = desired(circle);
    let of = |path: DesiredPath| {
        let observed = [Observed { recording: &recording, pause_s: 0.05, start_ns: Some(START_NS) }];
        validate(path, &observed, Options::default()).unwrap().runs.remove(0).tangent_rms_rad
    };
    assert_eq!(of(path.clone()), None);
    path.tangents = Some(vec![desired_tangent; 200]);
    assert!((of(path).unwrap() - tilt).abs() < 1e-9);
}

#[test]
fn results_as_files_have_an_entry_a_run() {
    let validation = evaluated(circle, CORNER_HZ, CLEAN, Options::default());
    let csv = validation.csv().unwrap();
    assert_eq!(csv.lines().count(), 13);
    assert!(csv.starts_with("file,marker,pause_ms,frequency_hz,start_s,"));
    let json: serde_json::Value = serde_json::from_str(&validation.json().unwrap()).unwrap();
    assert_eq!((json["runs"].as_array().unwrap().len(), &json["path"]["points_per_period"]), (12, &200.into()));
    assert!((json["path"]["circle_radius_mm"].as_f64().unwrap() - 12.5).abs() < 1e-9);
    let table = validation.table();
    assert!(
        table.starts_with("| Pause time (ms) | 1 | 3 | 5 | 8 | 10 | 12 | 15 | 18 | 20 | 25 | 50 | 100 |\n|---|"),
        "{table}"
    );
    assert!(table.contains("| circle RMSE (mm) | "));
    let points = validation.runs[3].points_csv();
    assert_eq!(points.lines().count(), 601);
    assert!(points.lines().nth(1).unwrap().starts_with("200,1.600000000,"), "{points}");
}

/// Squares of the errors of magnitude and phase over their σ, on average over many runs whose noise lasts for a while:
/// each frame takes over `lasting` of the noise of the one before.
fn squares_over_sigma(lasting: f64, runs: u64) -> f64 {
    let evaluated = |recording: &Recording| {
        let observed = [Observed { recording, pause_s: 0.01, start_ns: Some(START_NS) }];
        let row = validate(desired(circle), &observed, Options::default()).unwrap().runs.remove(0);
        (row.magnitude.unwrap().db, row.phase_deg.unwrap(), row.response_sd.unwrap())
    };
    let clean = simulate(circle, 0.01, CORNER_HZ, CLEAN);
    let (true_db, true_deg, _) = evaluated(&clean);
    let mut sum = 0.0;
    for seed in 0..runs {
        let mut random = Random::new(seed);
        let mut recording = clean.clone();
        let mut noise = Vector3::zeros();
        for point in recording.frames.iter_mut().flat_map(|frame| &mut frame.places).filter_map(|p| p.point.as_mut()) {
            let new = Vector3::from_fn(|_, _| random.normal() * 5e-5);
            noise = noise * lasting + new * (1.0 - lasting * lasting).sqrt();
            *point += noise;
        }
        let (db, deg, sd) = evaluated(&recording);
        let (size, turn) = (10_f64.powf((db - true_db) / 20.0) - 1.0, (deg - true_deg).to_radians());
        sum += (size * size + turn * turn) / (sd * sd);
    }
    sum / (2 * runs) as f64
}

/// By the tracker's own σ alone it would be 1 and 15: (1 − ρ²) / (1 − 2 ρ cos ω + ρ²) at 0.5 Hz, 60 frames per second.
#[test]
fn sigma_of_the_response_counts_noise_that_persists() {
    for lasting in [0.0, 0.9] {
        let squares = squares_over_sigma(lasting, 100);
        assert!((0.4..1.7).contains(&squares), "{lasting}: {squares}");
    }
}

/// Every 40th frame is another spot: the fitted circle was eight times too large, with a σ of 0.03 dB.
#[test]
fn frames_that_show_something_else_are_told_and_leave_no_sigma() {
    let evaluate = |recording: &Recording, pause_s: f64| {
        let observed = [Observed { recording, pause_s, start_ns: Some(START_NS) }];
        validate(desired(circle), &observed, Options::default()).unwrap().runs.remove(0)
    };
    for pause_ms in [5.0, 20.0, 100.0] {
        let spoiled = Spoiled { noise_m: 5e-5, missing: 0.05, seed: 3, run_in: 0 };
        let mut recording = simulate(circle, pause_ms * 1e-3, CORNER_HZ, spoiled);
        let good = evaluate(&recording, pause_ms * 1e-3);
        assert!(good.response_sd.is_some() && !good.notes.iter().any(|note| note.contains("lie alone")));
        for point in recording.frames.iter_mut().step_by(40).filter_map(|f| f.places[0].point.as_mut()) {
            point.x += 0.06;
        }
        let run = evaluate(&recording, pause_ms * 1e-3);
        assert!(run.response_sd.is_none(), "{pause_ms}: {:?}", run.response_sd);
        let note = run.notes.iter().find(|note| note.contains("lie alone")).unwrap();
        assert!(note.contains("have no σ") && note.contains("mm from both"), "{note}");
    }
}

#[test]
fn a_wrong_frame_of_the_period_that_does_not_count_changes_nothing() {
    let spoiled = Spoiled { noise_m: 5e-5, missing: 0.0, seed: 3, run_in: 0 };
    let mut recording = simulate(circle, 0.02, CORNER_HZ, spoiled);
    let evaluate = |recording: &Recording| {
        let observed = [Observed { recording, pause_s: 0.02, start_ns: Some(START_NS) }];
        let run = validate(desired(circle), &observed, Options::default()).unwrap().runs.remove(0);
        (run.magnitude, run.response_sd, run.notes)
    };
    let good = evaluate(&recording);
    assert!(good.1.is_some());
    let in_first_period = |frame: &&mut Frame| (START_NS..START_NS + 2_000_000_000).contains(&frame.stamp_ns);
    let frame = recording.frames.iter_mut().filter(in_first_period).nth(60).unwrap();
    frame.places[0].point.as_mut().unwrap().x += 0.05;
    assert_eq!(evaluate(&recording), good);
}

/// Zeros where nothing was seen: three in a row are not alone, and made the circle four times too large.
#[test]
fn points_far_from_their_plane_are_told_and_leave_no_sigma() {
    let spoiled = Spoiled { noise_m: 5e-5, missing: 0.0, seed: 3, run_in: 0 };
    let mut recording = simulate(circle, 0.02, CORNER_HZ, spoiled);
    for frame in &mut recording.frames[300..303] {
        frame.places[0].point = Some(Point3::new(0.0, 0.0, -0.1));
    }
    let observed = [Observed { recording: &recording, pause_s: 0.02, start_ns: Some(START_NS) }];
    let run = validate(desired(circle), &observed, Options::default()).unwrap().runs.remove(0);
    let note = run.notes.iter().find(|note| note.contains("from their plane")).unwrap();
    assert!(note.contains("have no σ") && run.response_sd.is_none(), "{note}");
}
