//! `catoptra catheter` from end to end: shape, reach, currents for a path, and what is refused.

use catoptra::series::CurrentTable;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn catheter(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).arg("catheter").args(args).output().unwrap()
}

fn stdout(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn the_shape_is_told_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let text = stdout(&catheter(folder.path(), &["shape", "--currents", "0mA,0mA,100mA", "-o", "shape.html"]));
    assert!(text.contains("θ           43.950°") && text.contains("1 mA more in"), "{text}");
    assert!(fs::read_to_string(folder.path().join("shape.html")).unwrap().contains("id=\"plot-shape\""));
}

#[test]
fn a_sample_file_is_the_prototype() {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_dynamics/catheter.toml");
    let folder = tempfile::tempdir().unwrap();
    let args = ["shape", "--currents", "0mA,50mA,100mA"];
    let built_in = stdout(&catheter(folder.path(), &args));
    let read = stdout(&catheter(folder.path(), &[&args[..], &["--catheter", sample.to_str().unwrap()]].concat()));
    let line = |text: &str| text.lines().find(|line| line.contains('θ')).map(str::to_owned);
    assert_eq!(line(&built_in), line(&read));
}

#[test]
fn currents_for_a_path_come_as_tables_and_lists_that_say_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["follow", "circle", "--points", "12", "--periods", "2", "--pause", "20ms", "-o", "out"];
    let text = stdout(&catheter(folder.path(), &args));
    assert!(text.contains("RMS 0.000 mm"), "{text}");
    let read = |name: &str| CurrentTable::read(&folder.path().join("out").join(name)).unwrap();
    let (table, list) = (read("currents_20ms.csv"), read("currents_20ms.play"));
    assert_eq!((table.rows.len(), table.coils.join(",")), (25, "x_a,y_a,z_a".to_owned()));
    assert_eq!(list.rows.len(), 25);
    for (a, b) in table.rows.iter().zip(&list.rows) {
        assert_eq!(a.time_ns, b.time_ns);
        assert!(a.values_a.iter().zip(&b.values_a).all(|(a, b)| (a - b).abs() <= 0.5e-6), "{a:?} {b:?}");
    }
    assert!(table.rows[24].values_a.iter().all(|i| *i == 0.0));
    let desired = fs::read_to_string(folder.path().join("out/desired.csv")).unwrap();
    assert_eq!((desired.lines().count(), desired.lines().next()), (13, Some("x_mm,y_mm,z_mm,tan_x,tan_y,tan_z")));
    // Again into the same folder; not into one with other files.
    stdout(&catheter(folder.path(), &args));
    fs::write(folder.path().join("out/notes.txt"), "mine").unwrap();
    let refused = catheter(folder.path(), &args);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("notes.txt, which this command did not write"));
}

fn refused(folder: &Path, args: &[&str], words: &str) {
    let output = catheter(folder, args);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{args:?}: {message}");
    assert!(message.contains(words), "`{words}` is not in {message}");
}

#[test]
fn what_is_read_or_was_written_by_others_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let sample = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_dynamics").join(name);
    let input = "is an input of this run and would be overwritten";
    fs::create_dir(at("fit")).unwrap();
    fs::copy(sample("catheter.toml"), at("fit/catheter.toml")).unwrap();
    let fit = ["fit", "run.csv", "--currents", "i.csv", "-o", "fit"];
    refused(folder.path(), &[&fit[..], &["--catheter", "fit/catheter.toml"]].concat(), input);
    refused(folder.path(), &fit, "has catheter.toml, which this command did not write");
    assert_eq!(fs::read(at("fit/catheter.toml")).unwrap(), fs::read(sample("catheter.toml")).unwrap());

    let follow = ["follow", "circle", "--points", "3", "--periods", "1", "--pause", "20ms", "-o", "circle"];
    stdout(&catheter(folder.path(), &follow));
    let desired = fs::read(at("circle/desired.csv")).unwrap();
    refused(folder.path(), &["follow", "circle/desired.csv", "-o", "circle"], input);
    let other = "has currents_20ms.";
    refused(folder.path(), &["follow", "circle", "--points", "3", "--pause", "100ms", "-o", "circle"], other);
    refused(folder.path(), &["follow", "circle", "--points", "3", "--pause", "100ms", "-o", "circle"], "these options");
    assert_eq!(fs::read(at("circle/desired.csv")).unwrap(), desired);
    for option in [["--radius", "3mm"], ["--centre", "1mm,1mm"], ["--points", "7"]] {
        let path = ["follow", "circle/desired.csv", "-o", "other"];
        refused(folder.path(), &[&path[..], &option].concat(), "has its own places");
    }
    // Again: its own files are replaced, those of others with their names are not.
    stdout(&catheter(folder.path(), &follow));
    for (name, measured) in [("currents_20ms.play", "1, 55.5, 1000\n"), ("currents_20ms.csv", "t_s,coil\r\n0,0.1\r\n")]
    {
        let own = fs::read(at("circle").join(name)).unwrap();
        fs::write(at("circle").join(name), measured).unwrap();
        refused(folder.path(), &follow, "which this command did not write");
        assert_eq!(fs::read_to_string(at("circle").join(name)).unwrap(), measured);
        fs::write(at("circle").join(name), own).unwrap();
    }
    fs::write(at("circle/desired.csv"), "x_mm,y_mm\n1,2\n").unwrap();
    refused(folder.path(), &follow, "has desired.csv, which this command did not write");

    fs::write(at("i.csv"), "t_s,x_a,y_a,z_a\n0,0,0,0.01\n").unwrap();
    let run = ["run", "i.csv", "--rate", "10Hz", "--duration", "300ms", "-o", "run.csv"];
    for _ in 0..2 {
        stdout(&catheter(folder.path(), &run));
    }
    let table = fs::read_to_string(at("run.csv")).unwrap();
    let measured = table.replacen(",,ok", ",0.031415,ok", 1);
    assert_ne!(table, measured);
    fs::write(at("run.csv"), &measured).unwrap();
    refused(folder.path(), &run, "exists and is not a table of this command");
    assert_eq!(fs::read_to_string(at("run.csv")).unwrap(), measured);
}

/// Times of a clock do not count from a start.
#[test]
fn a_start_that_would_not_be_used_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let run = format!("{}/sample_dynamics/catheter_run.csv", env!("CARGO_MANIFEST_DIR"));
    fs::write(folder.path().join("i.csv"), "stamp_ns,x_a,y_a,z_a\n0,0,0,0.01\n").unwrap();
    let fit = ["fit", &run, "--start", "2s", "-o", "out"];
    for currents in [&[][..], &["--currents", "i.csv"]] {
        refused(folder.path(), &[&fit[..], currents].concat(), "--start: is for tables whose times count from a start");
    }
}

#[test]
fn the_reach_is_a_surface() {
    let folder = tempfile::tempdir().unwrap();
    let text = stdout(&catheter(folder.path(), &["reach", "--steps", "3", "-o", "reach"]));
    assert!(text.contains("a surface: a moment along B0 moves nothing"), "{text}");
    let table = fs::read_to_string(folder.path().join("reach/reach.csv")).unwrap();
    assert!(table.lines().count() > 20, "{table}");
    // Of an even number the middles of the faces, where a coil acts alone, would be left out.
    let even = stdout(&catheter(folder.path(), &["reach", "--steps", "2"]));
    let theta = |text: &str| text.lines().find(|line| line.contains('θ')).unwrap().to_owned();
    assert_eq!(theta(&even), theta(&text));
}

/// A circle beside the axis, run through the model, and judged by `validate`: when each point is held long enough only
/// what the model itself is off by is left (17 µm, most of it that it has not quite come to rest); when it is not, the
/// motion lags behind and is smaller.
#[test]
fn a_path_is_followed_run_and_validated() {
    let folder = tempfile::tempdir().unwrap();
    let path = ["follow", "circle", "--points", "12", "--periods", "2", "--pause", "3s,40ms", "-o", "out"];
    stdout(&catheter(folder.path(), &path));
    let validate = |pause: &str, rate: &str, average: &str| {
        let currents = format!("out/currents_{pause}.csv");
        let table = format!("run_{pause}.csv");
        let text = stdout(&catheter(folder.path(), &["run", &currents, "--rate", rate, "-o", &table]));
        assert!(text.contains("written: run_"), "{text}");
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        let args = ["validate", &table, "--desired", "out/desired.csv", "--pause", pause, "--start", "0"];
        let command = command.current_dir(folder.path()).args(args);
        stdout(&command.args(["--periods", "2", "-o", pause, "--average", average]).output().unwrap());
        let json = fs::read_to_string(folder.path().join(pause).join("validation.json")).unwrap();
        serde_json::from_str::<serde_json::Value>(&json).unwrap()["runs"][0].clone()
    };
    let slow = validate("3000ms", "10Hz", "second-half");
    let off_mm = slow["rms_unaligned_mm"].as_f64().unwrap();
    assert!(off_mm < 0.03, "{off_mm}");
    let fast = validate("40ms", "60Hz", "all");
    let (db, deg) = (fast["magnitude_db"].as_f64().unwrap(), fast["phase_deg"].as_f64().unwrap());
    assert!((-4.5..-2.5).contains(&db) && (-130.0..-80.0).contains(&deg), "{db} dB, {deg}°");
}

/// What a simulated run was made with comes back from `fit`, and a run that was not fitted is predicted.
#[test]
fn a_fit_finds_what_the_run_was_made_with() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_dynamics/catheter.toml");
    let truth = fs::read_to_string(sample).unwrap().replace("young_mpa = 5.39", "young_mpa = 6.1");
    put("truth.toml", &truth);
    put("a.csv", "t_s,x_a,y_a,z_a\n1,0.01,0.05,0.06\n4,0.04,-0.04,-0.05\n7,0,0,0\n");
    put("b.csv", "t_s,x_a,y_a,z_a\n0.5,0.0,-0.02,0.08\n1.5,0.02,0.03,0.03\n");
    for (run, currents, seed) in [("a_run.csv", "a.csv", "1"), ("b_run.csv", "b.csv", "2")] {
        let noise = ["--noise", "0.04,0.15", "--missing", "5", "--seed", seed, "--duration", "9s"];
        stdout(&catheter(
            folder.path(),
            &[&["run", currents, "--catheter", "truth.toml", "-o", run], &noise[..]].concat(),
        ));
    }
    let args = ["a_run.csv", "--currents", "a.csv", "--validate", "b_run.csv", "--validate-currents", "b.csv"];
    let ask = ["--settle", "1500ms", "--parameters", "young,shear,drag", "-o", "out"];
    let text = stdout(&catheter(folder.path(), &[&["fit"], &args[..], &ask[..]].concat()));
    println!("{text}");
    let values = fs::read_to_string(folder.path().join("out/fit.csv")).unwrap();
    for (name, truth) in [("young", 6.1), ("shear", 2.39), ("drag", 1.1)] {
        let row: Vec<&str> = values.lines().find(|line| line.starts_with(name)).unwrap().split(',').collect();
        let (value, sd): (f64, f64) = (row[2].parse().unwrap(), row[3].parse().unwrap());
        // The computed motion has steps of 4 ms here and 2 ms there: some hundredths of a percent.
        assert!((value - truth).abs() < 3.0 * sd + 1e-3 * truth, "{name} {value} {sd}");
    }
    assert!(text.contains("not fitted"), "{text}");
    let page = fs::read_to_string(folder.path().join("out/fit.html")).unwrap();
    assert!(page.contains("id=\"plot-residual-1\""));
    // The result is a catheter, and fits as it stands.
    stdout(&catheter(folder.path(), &["shape", "--currents", "0mA,0mA,50mA", "--catheter", "out/catheter.toml"]));
    // One coil does not tell the twist.
    put("c.csv", "t_s,current_a\n1,0.05\n4,-0.05\n");
    stdout(&catheter(folder.path(), &["run", "c.csv", "--noise", "0.04,0.15", "-o", "c_run.csv", "--duration", "7s"]));
    let ask = ["fit", "c_run.csv", "--currents", "c.csv", "--only-still", "--settle", "1500ms", "--parameters"];
    let refused = catheter(folder.path(), &[&ask[..], &["young,shear", "-o", "open"]].concat());
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(3), "{message}");
    assert!(message.contains("do not determine the shear modulus G: hold currents of the side coil y"), "{message}");
    // Nothing is left to fit, or nothing shows at rest.
    for (parameters, words) in [("shear", "do not determine the shear modulus G"), ("damping", "need the motion too")] {
        let refused = catheter(folder.path(), &[&ask[..], &[parameters, "-o", "none"]].concat());
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(3), "{message}");
        assert!(message.contains(words), "{message}");
    }
}

/// The manual's command: there is one pause at rest, which leaves more open than the search can settle.
#[test]
fn the_sample_run_tells_all_parameters() {
    let folder = tempfile::tempdir().unwrap();
    let sample = |name: &str| format!("{}/sample_dynamics/{name}", env!("CARGO_MANIFEST_DIR"));
    let (run, currents) = (sample("catheter_run.csv"), sample("catheter_currents.csv"));
    let text = stdout(&catheter(folder.path(), &["fit", &run, "--currents", &currents, "-o", "out"]));
    let values = fs::read_to_string(folder.path().join("out/fit.csv")).unwrap();
    for (name, truth) in [("young", 5.39), ("shear", 2.39), ("damping", 10.0), ("drag", 1.1)] {
        let row: Vec<&str> = values.lines().find(|line| line.starts_with(name)).unwrap().split(',').collect();
        let (value, sd): (f64, f64) = (row[2].parse().unwrap(), row[3].parse().unwrap());
        assert!((value - truth).abs() < 3.0 * sd + 1e-3 * truth, "{name} {value} {sd}\n{text}");
    }
}

#[test]
fn what_cannot_be_is_refused_with_what_would_be_right() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("c.toml"), "[tube]\nouter_radius_mm = 1\n").unwrap();
    fs::write(folder.path().join("unix.csv"), "t_s,x_a,y_a,z_a\n1700000000,0,0,0\n1700000001,0,0.05,0\n").unwrap();
    for (args, code, words) in [
        (&["shape", "--currents", "0mA"][..], 2, "expected three: X,Y,Z such as 0mA,0mA,100mA"),
        (&["shape", "--currents", "0mA,0mA,150mA"], 2, "coil z: 150 mA is beyond the limit of 100 mA"),
        (&["shape", "--currents=-100mA,0mA,0mA"], 3, "the shape becomes unstable"),
        (&["shape", "--currents", "0mA,0mA,1mA", "--catheter", "none.toml"], 2, "cannot read catheter file none.toml"),
        (&["shape", "--currents", "0mA,0mA,1mA", "--catheter", "c.toml"], 2, "missing field"),
        (&["run", "unix.csv", "-o", "run.csv"], 2, "unix.csv: its last current is at 1700000001 s, which makes"),
        (&["run", "unix.csv", "--missing", "95%", "-o", "run.csv"], 2, "from 0 to 90 percent: write for example 5%"),
        (&["fit", "a.csv", "--parameters", "young,young", "-o", "out"], 2, "--parameters: young is given twice"),
        (&["follow", "none.csv", "-o", "out"], 2, "is neither circle nor lemniscate, and no such file"),
        (&["follow", "circle", "--radius", "0mm", "-o", "out"], 2, "is not a length above 0"),
        (&["follow", "circle", "--pause", "0.5ms", "-o", "out"], 2, "--pause: at least 1ms"),
        (&["follow", "circle", "--coils", "x,y,host_ns", "-o", "out"], 2, "host_ns is read as a time"),
    ] {
        let output = catheter(folder.path(), args);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert!(message.contains(words), "`{words}` is not in {message}");
    }
}

/// A run as a tracker has it: counted from the base band, to the middle of the tip's.
#[test]
fn a_run_is_fitted_by_the_bands_of_the_catheters_file() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_dynamics/catheter.toml");
    let sample = fs::read_to_string(sample).unwrap();
    put("bare.toml", &sample);
    put("bands.toml", &format!("{sample}\n[bands]\nbase_mm = 6.0\ntip_mm = 116.0\n"));
    put("c.csv", "t_s,x_a,y_a,z_a\n1,0.0,0.05,0.06\n4,0.0,-0.04,-0.05\n7,0,0,0\n");
    let run = ["run", "c.csv", "--catheter", "bands.toml", "--noise", "0.04,0.15", "--duration", "8s", "-o", "run.csv"];
    stdout(&catheter(folder.path(), &run));
    let ask = ["fit", "run.csv", "--currents", "c.csv", "--only-still", "--settle", "1500ms", "--parameters"];
    let fitted = |file: &str, out: &str| {
        catheter(folder.path(), &[&ask[..], &["young,shear", "--catheter", file, "-o", out]].concat())
    };
    let right = fitted("bands.toml", "right");
    let warnings = String::from_utf8_lossy(&right.stderr).into_owned();
    let text = stdout(&right);
    let values = fs::read_to_string(folder.path().join("right/fit.csv")).unwrap();
    for (name, truth) in [("young", 5.39), ("shear", 2.39)] {
        let row: Vec<&str> = values.lines().find(|line| line.starts_with(name)).unwrap().split(',').collect();
        let (value, sd): (f64, f64) = (row[2].parse().unwrap(), row[3].parse().unwrap());
        assert!((value - truth).abs() < 3.5 * sd + 1e-3 * truth, "{name} {value} {sd}\n{text}");
    }
    assert!(!warnings.contains("doubt"), "{warnings}");
    let written = fs::read_to_string(folder.path().join("right/catheter.toml")).unwrap();
    assert!(written.contains("[bands]\nbase_mm = 6.0\ntip_mm = 116.0"), "{written}");
    // A run at rest, whose base is exactly where its band is, too.
    put("zero.csv", "t_s,x_a,y_a,z_a\n0,0,0,0\n4,0,0,0\n");
    stdout(&catheter(folder.path(), &["run", "zero.csv", "--catheter", "bands.toml", "-o", "rest.csv"]));
    let both = ["fit", "run.csv", "rest.csv", "--currents", "c.csv", "zero.csv", "--only-still", "--settle", "1500ms"];
    let both = catheter(folder.path(), &[&both[..], &["--catheter", "bands.toml", "-o", "both"]].concat());
    let warnings = String::from_utf8_lossy(&both.stderr).into_owned();
    assert!(both.status.success() && !warnings.contains("farther"), "{warnings}");
    // Without the bands the fit cannot be right, and says why.
    let warnings = String::from_utf8_lossy(&fitted("bare.toml", "wrong").stderr).into_owned();
    for words in ["nothing says where its bands are", "in all frames alike the coil is seen -"] {
        assert!(warnings.contains(words), "{warnings}");
    }
}
