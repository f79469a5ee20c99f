//! What `catoptra identify` says about data and options that cannot be used.

use crate::support::random::Random;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Command;

const COLUMNS: [&str; 6] = ["--input", "u", "--output", "y", "--time", "t"];
const SECOND: [&str; 4] = ["--order", "2", "--nk", "1"];

/// Time, input, output; with the cells that `of` makes of them.
fn table(folder: &Path, name: &str, rows: usize, of: impl Fn(usize, f64, f64, f64) -> [String; 3]) {
    let mut text = "t,u,y\n".to_owned();
    let (mut y1, mut y2, mut u1, mut random) = (0.0, 0.0, 0.0, Random::new(1));
    for k in 0..rows {
        // What no short rule repeats.
        let u = 2.0 * random.uniform() - 1.0;
        let y = 1.5 * y1 - 0.7 * y2 + u1 + 0.1 * (1.7 * k as f64).sin();
        (y2, y1, u1) = (y1, y, u);
        writeln!(text, "{}", of(k, k as f64 * 0.01, u, y).join(",")).unwrap();
    }
    fs::write(folder.join(name), text).unwrap();
}

fn good(folder: &Path) {
    table(folder, "good.csv", 400, |_, t, u, y| [t, u, y].map(|v| v.to_string()));
}

/// Exit code, and what was said.
fn identify(folder: &Path, args: &[&[&str]]) -> (i32, String) {
    let args = args.concat();
    let mut program = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    program.current_dir(folder).arg("identify").args(&args);
    if !args.contains(&"--model") && !args.contains(&"--bootstrap") {
        program.args(["--bootstrap", "0"]);
    }
    let output = program.output().unwrap();
    (output.status.code().unwrap_or(-1), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[track_caller]
fn refused(folder: &Path, args: &[&[&str]], code: i32, says: &[&str]) {
    let (found, message) = identify(folder, &[args, &[&["-o", "refused"]]].concat());
    assert_eq!(found, code, "{message}");
    for part in says {
        assert!(message.contains(part), "{part} is not in: {message}");
    }
    assert!(!folder.join("refused").exists());
}

#[test]
fn data_that_cannot_be_used() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let texts = |t: f64, u: f64, y: f64| [t, u, y].map(|v| v.to_string());
    table(folder, "still_u.csv", 100, |_, t, _, y| texts(t, 1.5, y));
    table(folder, "still_y.csv", 100, |_, t, u, _| texts(t, u, 0.1));
    refused(folder, &[&["still_u.csv"], &COLUMNS], 2, &["still_u.csv: the input is 1.5 in all samples"]);
    refused(folder, &[&["still_y.csv"], &COLUMNS], 2, &["still_y.csv: the output is 0.1 in all samples"]);
    refused(folder, &[&["."], &COLUMNS], 2, &[".: is a folder; give the log or table in it"]);
    good(folder);
    let twice: [&str; 6] = ["--input", "y", "--output", "y", "--time", "t"];
    refused(folder, &[&["good.csv"], &twice], 2, &["--input y and --output y have the same values in all rows"]);
    let repeats: [&str; 2] = ["--repeats", "0.5s"];
    let says = "% of the input's power changes from one such period to the next, and it repeats no better";
    refused(folder, &[&["good.csv"], &COLUMNS, &repeats], 3, &["good.csv: --repeats 0.5s: ", says]);
    table(folder, "short.csv", 8, |_, t, u, y| texts(t, u, y));
    let fifteen: [&str; 4] = ["--order", "15", "--nk", "1"];
    refused(
        folder,
        &[&["short.csv"], &COLUMNS, &fifteen],
        2,
        &["short.csv: 30 coefficients", "8 samples", "lower orders"],
    );
    table(folder, "head.csv", 0, |_, t, u, y| texts(t, u, y));
    refused(folder, &[&["head.csv"], &COLUMNS], 2, &["head.csv: has 0 samples; at least 2"]);
    table(folder, "missed.csv", 50, |_, t, u, _| [t.to_string(), u.to_string(), String::new()]);
    refused(folder, &[&["missed.csv"], &COLUMNS], 2, &["missed.csv: no sample has both input and output"]);
    table(folder, "back.csv", 50, |k, t, u, y| texts(if k == 30 { 0.0 } else { t }, u, y));
    refused(
        folder,
        &[&["back.csv"], &COLUMNS],
        2,
        &["back.csv: time goes from 0.29 s to 0 s at sample 30; it must rise"],
    );
    table(folder, "uneven.csv", 50, |k, t, u, y| texts(t + if k > 20 { 0.004 } else { 0.0 }, u, y));
    refused(folder, &[&["uneven.csv"], &COLUMNS], 2, &["uneven.csv: samples are not evenly spaced", "--resample"]);
    table(folder, "no_time.csv", 50, |k, t, u, y| {
        [if k == 5 { String::new() } else { t.to_string() }, u.to_string(), y.to_string()]
    });
    refused(folder, &[&["no_time.csv"], &COLUMNS], 2, &["no_time.csv: the time of row 6 is missing"]);
    table(folder, "text.csv", 50, |k, t, u, y| {
        [t.to_string(), if k == 7 { "abc".to_owned() } else { u.to_string() }, y.to_string()]
    });
    refused(folder, &[&["text.csv"], &COLUMNS], 2, &["text.csv, line 9: `abc` in column `u` is not a number"]);
    good(folder);
    table(folder, "slow.csv", 100, |_, t, u, y| texts(2.0 * t, u, y));
    refused(
        folder,
        &[&["good.csv", "slow.csv"], &COLUMNS],
        2,
        &["slow.csv: samples are 0.020000 s apart, and 0.010000 s in good.csv"],
    );
    refused(folder, &[&["nowhere.csv"], &COLUMNS], 2, &["nowhere.csv"]);
    // The same column twice explains itself; nothing else can be told of it.
    let same = ["good.csv", "--input", "u", "--output", "u", "--period", "0.01"];
    refused(folder, &[&same, &SECOND], 2, &["good.csv: --input u and --output u have the same values in all rows"]);
}

#[test]
fn options_that_cannot_be_followed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    good(folder);
    let with = |more: &[&str], code, says: &[&str]| refused(folder, &[&["good.csv"], &COLUMNS, more], code, says);
    with(&["--train", "0:500"], 2, &["good.csv: has 400 samples, and 0:500 were asked for"]);
    with(&["--train", "0:200", "--test", "300:401"], 2, &["good.csv: has 400 samples, and 300:401"]);
    with(
        &["--test", "300:400"],
        2,
        &["--test 300:400: without --train all of the record is fitted", "add --train A:B"],
    );
    with(&["--train", "5:5"], 2, &["`5:5` is not a range of samples: write 0:500"]);
    with(&["--train", "0:4", "--order", "2", "--nk", "1"], 2, &["good.csv [0:4]: 4 coefficients", "4 samples"]);
    let judged = ["good.csv [398:400]: no stretch", "more than 2 samples", "judge by more"];
    with(&["--train", "0:300", "--test", "398:400", "--order", "1:3", "--nk", "1"], 2, &judged);
    with(&["--decimate", "100"], 2, &["good.csv: --decimate 100 leaves nothing", "1100 samples", "has 400"]);
    with(&["--decimate", "18446744073709551615"], 2, &["--decimate", "1..=10000"]);
    with(&["--bridge", "1000000000"], 2, &["--bridge", "0..=100000"]);
    with(&["--order", "0"], 2, &["--order 0"]);
    with(&["--na", "2"], 2, &["--na and --nb go together"]);
    with(&["--select", "simulation"], 2, &["no data to judge by; give --validate or --test"]);
    with(&["--reduce", "0"], 2, &["`0` is not an order"]);
    // Of logs only: not taken silently.
    for more in [["--currents", "a.csv"], ["--delay", "20ms"], ["--coil", "1"], ["--plant", "plant.toml"]] {
        with(&more, 2, &["cannot be used with"]);
    }
    // Nothing is fitted with --model.
    for more in [
        &["--train", "0:200"][..],
        &["--reduce", "2"],
        &["--match-dc"],
        &["--all-frequencies"],
        &["--estimator", "oe"],
        &["--bootstrap", "10"],
    ] {
        with(&[&["--model", "eq7"][..], more].concat(), 2, &["cannot be used with"]);
    }
    refused(
        folder,
        &[&["good.csv", "--input", "current", "--period", "0.01"]],
        2,
        &["good.csv: has the camera's times", "add --resample"],
    );
    refused(
        folder,
        &[&["good.csv", "--input", "v", "--output", "y", "--period", "0.01"]],
        2,
        &["no column `v`; it has t, u, y"],
    );
    refused(
        folder,
        &[&["good.csv", "--input", "9", "--output", "y", "--period", "0.01"]],
        2,
        &["no column 9; columns are numbered from 1 to 3"],
    );
    refused(folder, &[&["good.csv", "--input", "u", "--output", "y"]], 2, &["give --period S, or --time COLUMN"]);
    refused(folder, &[&["good.csv"]], 2, &["good.csv: what moves it?"]);
    refused(folder, &[&["good.csv", "--plant", "nowhere.toml"]], 2, &["nowhere.toml"]);
    fs::write(folder.join("plant.toml"), "turns = 100\nare_mm2 = 8\n").unwrap();
    refused(
        folder,
        &[&["good.csv", "--plant", "plant.toml"]],
        2,
        &["plant.toml:2: unknown field `are_mm2`", "the keys are"],
    );
}

#[test]
fn folders_that_are_none_and_folders_with_an_earlier_result() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    good(folder);
    fs::write(folder.join("file"), "mine").unwrap();
    let (code, message) = identify(folder, &[&["good.csv"], &COLUMNS, &SECOND, &["-o", "file"]]);
    assert!(code == 2 && message.contains("file: is a file; choose a folder with -o"), "{message}");
    assert_eq!(fs::read_to_string(folder.join("file")).unwrap(), "mine");
    // A search leaves a table of orders; a result without a search must not stand beside it.
    let (code, message) =
        identify(folder, &[&["good.csv"], &COLUMNS, &["--order", "1:3", "--nk", "1", "-o", "result"]]);
    assert!(code == 0 && folder.join("result/orders.csv").exists(), "{message}");
    fs::write(folder.join("result/notes.txt"), "mine").unwrap();
    let (code, message) = identify(folder, &[&["good.csv"], &COLUMNS, &SECOND, &["-o", "result"]]);
    assert!(code == 0 && !folder.join("result/orders.csv").exists(), "{message}");
    assert!(folder.join("result/notes.txt").exists() && folder.join("result/residuals.csv").exists());
}

#[test]
fn nothing_is_written_over_that_is_not_a_result_of_the_same_record() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    good(folder);
    // Its own input.
    fs::copy(folder.join("good.csv"), folder.join("signals.csv")).unwrap();
    let before = fs::read(folder.join("signals.csv")).unwrap();
    let (code, message) = identify(folder, &[&["signals.csv"], &COLUMNS, &SECOND, &["-o", "."]]);
    assert!(
        code == 2 && message.contains("signals.csv: is an input of this run and would be overwritten"),
        "{message}"
    );
    assert_eq!(fs::read(folder.join("signals.csv")).unwrap(), before);
    // The page of another command.
    fs::create_dir(folder.join("run")).unwrap();
    fs::write(folder.join("run/report.html"), "of track").unwrap();
    fs::write(folder.join("run/run.toml"), "command = \"track\"\nrecording = \"/a.mkv\"\n").unwrap();
    let (code, message) = identify(folder, &[&["good.csv"], &COLUMNS, &SECOND, &["-o", "run"]]);
    assert!(code == 2 && message.contains("has the results of `catoptra track /a.mkv`"), "{message}");
    assert_eq!(fs::read_to_string(folder.join("run/report.html")).unwrap(), "of track");
}

#[test]
fn one_wrong_time_stamp_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let texts = |t: f64, u: f64, y: f64| [t, u, y].map(|v| v.to_string());
    table(folder, "late.csv", 50, |k, t, u, y| texts(if k == 49 { 9.2e9 } else { t }, u, y));
    refused(folder, &[&["late.csv"], &COLUMNS], 2, &["late.csv: after sample 49, at 0.48 s", "a wrong time stamp?"]);
    // The same in a run of the tracker.
    let mut run = "t_s,theta_deg\n".to_owned();
    let mut currents = "t_s,a\n".to_owned();
    for k in 0..50 {
        let t = if k == 49 { 9.2e9 } else { f64::from(k) / 60.0 };
        writeln!(run, "{t:.6},{}", k % 7).unwrap();
        writeln!(currents, "{:.6},{}", f64::from(k) / 60.0, f64::from(k % 5) * 0.01).unwrap();
    }
    fs::write(folder.join("run.csv"), run).unwrap();
    fs::write(folder.join("currents.csv"), currents).unwrap();
    let of_run = ["run.csv", "--currents", "currents.csv", "--input", "current"];
    refused(folder, &[&of_run], 2, &["run.csv: after sample 49", "a wrong time stamp?"]);
}

#[test]
fn times_in_another_unit_are_asked_about() {
    let folder = tempfile::tempdir().unwrap();
    // (At 1 kHz in milliseconds, too.)
    for (times, apart, unit) in [
        (1e2, "1.0000", "milliseconds"),
        (1e3, "10.0000", "milliseconds"),
        (1e6, "10000.0000", "microseconds"),
        (1e9, "10000000.0000", "nanoseconds"),
    ] {
        table(folder.path(), "t.csv", 400, |_, t, u, y| [t * times, u, y].map(|v| v.to_string()));
        let (code, message) = identify(folder.path(), &[&["t.csv", "-o", "out"], &COLUMNS, &SECOND]);
        assert!(code == 0 && message.contains(&format!("{apart} s apart: are the times {unit}?")), "{code}: {message}");
    }
    let (_, message) = identify(folder.path(), &[&["t.csv", "--model", "out/model.json", "-o", "applied"], &COLUMNS]);
    assert!(message.contains("are the times nanoseconds?"), "{message}");
}

#[test]
fn a_fit_in_an_unknown_state_begins_there() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // y(t) = 0.995 y(t−1) + 0.1 u(t−1), from 5 on.
    let (mut y, mut u1, mut seed) = (5.0, 0.0, 1_u32);
    let mut text = "t,u,y\n".to_owned();
    for k in 0..300 {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let u = f64::from(seed >> 8) / f64::from(1 << 23) - 1.0;
        y = 0.995 * y + 0.1 * u1;
        u1 = u;
        writeln!(text, "{},{u},{}", f64::from(k) * 0.01, y + 0.05 * (2.3 * f64::from(k * k)).sin()).unwrap();
    }
    fs::write(folder.join("swing.csv"), text).unwrap();
    let first = ["--order", "1", "--nk", "1", "--estimator", "oe", "-o"];
    let pole = |start: &str| {
        let (code, message) = identify(folder, &[&["swing.csv"], &COLUMNS, &first, &[start, "--start", start]]);
        assert_eq!(code, 0, "{message}");
        model(folder, start)["full"]["a"][1].as_f64().unwrap()
    };
    assert!((pole("estimated") + 0.995).abs() < 1e-3, "{}", pole("estimated"));
    assert!((pole("rest") + 0.995).abs() > 1e-3);
}

#[test]
fn a_delay_is_no_state_of_the_reduced_model() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    good(folder);
    let mut late = "t,u,y\n".to_owned();
    let text = fs::read_to_string(folder.join("good.csv")).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|line| line.split(',').collect()).collect();
    // The output comes six samples later.
    for (k, row) in rows.iter().enumerate().skip(6) {
        writeln!(late, "{},{},{}", row[0], row[1], rows[k - 6][2]).unwrap();
    }
    fs::write(folder.join("late.csv"), late).unwrap();
    let (code, message) = identify(folder, &[&["late.csv"], &COLUMNS, &["--order", "3", "--nk", "7", "-o", "late"]]);
    assert_eq!(code, 0, "{message}");
    let (code, message) = identify(folder, &[&["good.csv"], &COLUMNS, &["--order", "3", "--nk", "1", "-o", "prompt"]]);
    assert_eq!(code, 0, "{message}");
    let (late, prompt) = (model(folder, "late"), model(folder, "prompt"));
    assert_eq!((late["reduced"]["order"].clone(), late["reduced"]["delay_samples"].clone()), (2.into(), 7.into()));
    assert!((late["continuous"]["delay_s"].as_f64().unwrap() - 0.06).abs() < 1e-9);
    let poles = |m: &serde_json::Value| m["reduced"]["largest_pole"].as_f64().unwrap();
    assert!((poles(&late) - poles(&prompt)).abs() < 0.02, "{} {}", poles(&late), poles(&prompt));
}

#[test]
fn what_was_fitted_is_no_judge() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    good(folder);
    let overlap = ["--train", "0:200", "--test", "150:400", "-o", "result"];
    let (code, message) = identify(folder, &[&["good.csv"], &COLUMNS, &SECOND, &overlap]);
    assert!(code == 0 && message.contains("--train and --test share samples 150 to 199"), "{message}");
    let (code, message) =
        identify(folder, &[&["good.csv", "-o", "result"], &COLUMNS, &SECOND, &["--validate", "good.csv"]]);
    assert!(code == 0 && message.contains("good.csv is used both to fit and to validate"), "{message}");
    fs::copy(folder.join("good.csv"), folder.join("copy.csv")).unwrap();
    let (code, message) =
        identify(folder, &[&["good.csv", "-o", "result"], &COLUMNS, &SECOND, &["--validate", "copy.csv"]]);
    assert!(code == 0 && message.contains("copy.csv is used both to fit and to validate"), "{message}");
    let (code, message) = identify(folder, &[&["good.csv", "copy.csv"], &COLUMNS, &SECOND, &["-o", "twice"]]);
    assert!(code == 2 && message.contains("copy.csv: holds the samples of good.csv"), "{message}");
}

/// Every number of a result, null where there is none.
fn model(folder: &Path, name: &str) -> serde_json::Value {
    serde_json::from_slice(&fs::read(folder.join(name).join("model.json")).unwrap()).unwrap()
}

#[test]
fn an_unstable_model_is_said_to_be_so_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // y(t) = 1.05 y(t−1) + u(t−1), and the same with a second state inside the circle.
    for (name, a, args) in [("one", [1.05, 0.0], ["1", "1", "1"]), ("two", [1.55, -0.525], ["2", "1", "1"])] {
        let (mut y1, mut y2, mut u1) = (0.0, 0.0, 0.0);
        let mut text = String::new();
        for k in 0..200 {
            let (u, y) = (f64::from((k * k) % 17) - 8.0, a[0] * y1 + a[1] * y2 + u1);
            (y2, y1, u1) = (y1, y, u);
            writeln!(text, "{u} {y}").unwrap();
        }
        fs::write(folder.join(name), text).unwrap();
        let [na, nb, nk] = args;
        let orders = [name, "--input", "1", "--output", "2", "--period", "0.01", "--na", na, "--nb", nb, "--nk", nk];
        let (code, message) = identify(folder, &[&orders, &["-o", &format!("{name}_out")]]);
        assert!(code == 3 && message.contains("unstable"), "{message}");
        let model = model(folder, &format!("{name}_out"));
        assert_eq!(model["arx"]["stable"], false);
        assert!((model["arx"]["largest_pole"].as_f64().unwrap() - 1.05).abs() < 1e-9);
        assert_eq!(model["reduced"]["unstable_states_kept"], 1);
    }
}

#[test]
fn a_gain_and_a_model_of_fewer_states_than_asked_are_whole() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    good(folder);
    let (code, message) =
        identify(folder, &[&["good.csv"], &COLUMNS, &["--na", "0", "--nb", "1", "--nk", "0", "-o", "gain"]]);
    assert_eq!(code, 0, "{message}");
    let gain = model(folder, "gain");
    assert_eq!(
        (gain["reduced"]["continuous"]["num"].clone(), gain["hankel_singular_values"].clone()),
        (gain["arx"]["b"].clone(), serde_json::json!([]))
    );
    let (code, message) =
        identify(folder, &[&["good.csv"], &COLUMNS, &["--na", "1", "--nb", "1", "--nk", "1", "-o", "one"]]);
    assert!(code == 0 && message.contains("has only 1 state that matters"), "{message}");
    let one = model(folder, "one");
    assert_eq!((one["reduced"]["order"].clone(), one["reduced"]["den_z"].clone()), (1.into(), one["arx"]["a"].clone()));
    assert!(one["continuous"]["num"][0].as_f64().is_some());
}

/// A table of times that disagree with --period is read as asked, with a question.
#[test]
fn a_period_that_contradicts_the_tables_times_is_told() {
    let folder = tempfile::tempdir().unwrap();
    good(folder.path());
    let told = |period: &str, out: &str| {
        let columns = ["good.csv", "--input", "u", "--output", "y", "--period", period, "-o", out];
        let (code, message) = identify(folder.path(), &[&columns, &SECOND]);
        assert_eq!(code, 0, "{message}");
        message.contains("--period says 0.1 s from row to row, its column t 0.010000")
    };
    assert!(told("0.1", "wrong") && !told("0.01", "right"));
}

/// 40/(s² + 4 s + 40), moved by an input that is held for a sample: fewer samples, by either way, find it.
#[test]
fn fewer_samples_have_the_same_response() {
    const STEPS: u32 = 50;
    let folder = tempfile::tempdir().unwrap();
    let step = 1.0 / (60.0 * f64::from(STEPS));
    let (mut text, mut y, mut speed, mut random) = ("t,u,y\n".to_owned(), 0.0, 0.0, Random::new(2));
    for k in 0..3600 {
        let u = (0.1 * f64::from(k)).sin() + 2.0 * random.uniform() - 1.0;
        writeln!(text, "{},{u},{}", f64::from(k) / 60.0, y + 0.002 * random.normal()).unwrap();
        for _ in 0..STEPS {
            // By the state in the middle of the step.
            let force = |y: f64, speed: f64| 40.0 * (u - y) - 4.0 * speed;
            let (half_y, half_speed) = (y + 0.5 * step * speed, speed + 0.5 * step * force(y, speed));
            (y, speed) = (y + step * half_speed, speed + step * force(half_y, half_speed));
        }
    }
    fs::write(folder.path().join("held.csv"), text).unwrap();
    for (k, fewer) in [&["--decimate", "3"][..], &["--resample", "--period", "0.05"]].into_iter().enumerate() {
        let out = format!("out{k}");
        let (code, message) = identify(folder.path(), &[&["held.csv"], &COLUMNS, fewer, &SECOND, &["-o", &out]]);
        assert_eq!(code, 0, "{message}");
        let model = fs::read_to_string(folder.path().join(&out).join("model.json")).unwrap();
        let model: serde_json::Value = serde_json::from_str(&model).unwrap();
        let of = |name: &str, at: usize| model["continuous"][name][at].as_f64().unwrap();
        // Averages that are held instead: 1.1 % too much.
        for (name, at, truth) in [("num", 1, 40.0), ("den", 1, 4.0), ("den", 2, 40.0)] {
            assert!((of(name, at) / truth - 1.0).abs() < 4e-3, "{fewer:?}: {name} {at} {}", of(name, at));
        }
    }
}
