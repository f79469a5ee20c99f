//! The paper's chain on records with known truth, made by scipy, with Eq. 7 inside Eq. 6 (`sample_dynamics`).

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Eq. 7.
const NUM: [f64; 2] = [1.761e4, 6344.0];
const DEN: [f64; 3] = [1.0, 4.59, 1.136];

fn sample(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_dynamics").join(name)
}

fn identify(out: &Path, more: &[&str]) -> Output {
    let records = ["training", "validation_1", "validation_2"];
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.arg("identify").arg(sample("training.csv")).arg("--plant").arg(sample("plant.toml"));
    for record in records {
        command.arg("--currents").arg(sample(&format!("{record}_currents.csv")));
    }
    command.arg("--validate").args([sample("validation_1.csv"), sample("validation_2.csv")]);
    command.arg("-o").arg(out).args(more).output().unwrap()
}

fn model(out: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(out.join("model.json")).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn errors(model: &Value, of: &str, kind: &str) -> Vec<f64> {
    let fits = model["fits"].as_array().unwrap().iter();
    fits.filter(|f| f["model"] == of && f["kind"] == kind).map(|f| f["error_percent"].as_f64().unwrap()).collect()
}

#[test]
fn the_papers_chain_recovers_eq_7_and_fills_table_1() {
    let out = tempfile::tempdir().unwrap();
    let run = identify(out.path(), &["--order", "15", "--bootstrap", "40"]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let found = model(out.path());
    // Table I: the noise of θ alone is 0.007 to 0.02 % of the energy.
    for (of, most) in [("full", 0.06), ("reduced", 0.06), ("refined", 0.025)] {
        let errors = errors(&found, of, "simulation");
        assert!(errors.len() == 3 && errors.iter().all(|e| *e < most), "{of} {errors:?}");
    }
    // H(s): within 4 σ and 0.3 %, the part that averaging the current from frame to frame costs.
    let h = &found["refined"]["continuous"];
    assert_eq!(h["conversion"], "zero_order_hold");
    let [num, den] = ["num", "den"].map(|key| numbers(&h[key]));
    let [num_sd, den_sd] = ["num_standard_errors", "den_standard_errors"].map(|key| numbers(&h[key]));
    assert_eq!((num.len(), den.len()), (2, 3), "{h}");
    let all = num.iter().chain(&den).zip(num_sd.iter().chain(&den_sd)).zip(NUM.iter().chain(&DEN));
    for ((found, sd), truth) in all {
        assert!((found - truth).abs() <= 4.0 * sd + 3e-3 * truth, "{found} ± {sd}, truth {truth}");
    }
    // The bandwidth that this has by each definition, with the intervals around.
    for (definition, truth, extrapolated) in [("minus_3db_re_dc", 0.2117, true), ("phase_minus_45deg", 0.6572, false)] {
        let of = |b: &&Value| b["model"] == "refined" && b["definition"] == definition;
        let bandwidth = found["bandwidths"].as_array().unwrap().iter().find(of).unwrap();
        let f = bandwidth["frequency_hz"].as_f64().unwrap();
        let interval = numbers(&bandwidth["interval_95_hz"]);
        assert!((f / truth - 1.0).abs() < 0.1 && interval[0] < f && f < interval[1], "{bandwidth}");
        // Zero frequency was not excited: below 0.62 Hz the torque of this chirp has 1 % of its energy.
        assert_eq!(bandwidth["extrapolated"], extrapolated, "{bandwidth}");
    }
    for record in found["records"].as_array().unwrap() {
        assert!(record["delay_s"].as_f64().unwrap().abs() < 1e-3, "{record}");
        assert!(record["missed"].as_u64().unwrap() > 0 && record["lost"].as_u64().unwrap() > 0, "{record}");
    }
    for file in [
        "report.html",
        "bode.csv",
        "frequency_response.csv",
        "signals.csv",
        "orders.csv",
        "hankel.csv",
        "residuals.csv",
    ] {
        assert!(out.path().join(file).metadata().unwrap().len() > 100, "{file}");
    }
}

/// Eq. 6 feeds noise back into the input: ARX of the right order is biased by it, instruments made from the current are
/// less.
#[test]
fn instruments_from_the_current_take_bias_away() {
    let of = |estimator: &str| {
        let out = tempfile::tempdir().unwrap();
        let run = identify(out.path(), &["--order", "2", "--nk", "1", "--bootstrap", "0", "--estimator", estimator]);
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        errors(&model(out.path()), "full", "simulation")
    };
    let (arx, iv, oe) = (of("arx"), of("iv"), of("oe"));
    for k in 0..3 {
        assert!(oe[k] < iv[k] && iv[k] < arx[k], "ARX {arx:?}, instruments {iv:?}, output error {oe:?}");
    }
}

#[test]
fn a_delay_that_is_put_in_is_found_and_can_be_taken_out() {
    let out = tempfile::tempdir().unwrap();
    // Commands are said to act 40 ms too early.
    let late = identify(out.path(), &["--order", "2", "--nk", "1", "--bootstrap", "0", "--delay", "-40ms"]);
    assert!(late.status.success(), "{}", String::from_utf8_lossy(&late.stderr));
    let found = model(out.path());
    let delay_s = found["records"][0]["delay_s"].as_f64().unwrap();
    assert!(delay_s.abs() < 5e-4, "{delay_s}");
    let worse = errors(&found, "refined", "simulation")[0];
    let auto = identify(out.path(), &["--order", "2", "--nk", "1", "--bootstrap", "0", "--delay", "auto"]);
    assert!(auto.status.success(), "{}", String::from_utf8_lossy(&auto.stderr));
    let better = errors(&model(out.path()), "refined", "simulation")[0];
    assert!(better < 0.03 && better < 0.3 * worse, "{better} {worse}");
}

/// A table of the sample with one column changed, in `folder`.
fn changed(folder: &Path, name: &str, column: &str, change: impl Fn(usize, f64) -> f64) -> PathBuf {
    let text = std::fs::read_to_string(sample(name)).unwrap();
    let mut lines = text.lines();
    let header = lines.next().unwrap();
    let place = header.split(',').position(|name| name == column).unwrap();
    let row = |(k, line): (usize, &str)| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if let Ok(value) = cells[place].parse() {
            cells[place] = change(k, value).to_string();
        }
        cells.join(",")
    };
    let rows: Vec<String> = lines.enumerate().map(row).collect();
    let path = folder.join(name);
    std::fs::write(&path, format!("{header}\n{}\n", rows.join("\n"))).unwrap();
    path
}

/// H(s) of the refined model, from the training record with these tables; and what was warned of.
fn refined(record: &Path, currents: &Path, more: &[&str]) -> (Vec<f64>, Value, String) {
    let out = tempfile::tempdir().unwrap();
    let run = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .arg("identify")
        .arg(record)
        .arg("--plant")
        .arg(sample("plant.toml"))
        .arg("--currents")
        .arg(currents)
        .args(["--order", "4", "--bootstrap", "0", "-o"])
        .arg(out.path())
        .args(more)
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&run.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(run.status.success(), "{told}");
    let found = model(out.path());
    let h = &found["refined"]["continuous"];
    ([numbers(&h["num"]), numbers(&h["den"])].concat(), found, told)
}

/// The zero of θ and the clock of the currents do not bend H(s), and both are told with their σ.
#[test]
fn a_wrong_zero_and_a_clock_that_drifts_are_found_and_do_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let (record, currents) = (sample("training.csv"), sample("training_currents.csv"));
    let (clean, found, told) = refined(&record, &currents, &[]);
    assert!(!told.contains("zero of θ") && !told.contains("clock of the currents"), "{told}");
    let (zero, sd) = (&found["records"][0]["zero_rad"], &found["records"][0]["zero_standard_error_rad"]);
    assert!(zero.as_f64().unwrap().abs() < 3.3 * sd.as_f64().unwrap(), "{zero} ± {sd}");

    let off = changed(folder.path(), "training.csv", "theta_deg", |_, theta| theta + 0.5);
    let (same, found, told) = refined(&off, &currents, &[]);
    assert!(same.iter().zip(&clean).all(|(a, b)| (a / b - 1.0).abs() < 1e-3), "{same:?}, {clean:?}");
    let zero = found["records"][0]["zero_rad"].as_f64().unwrap().to_degrees();
    assert!((zero - 0.5).abs() < 0.01 && told.contains("the zero of θ is off by 0.50"), "{zero} {told}");
    let (bent, _, _) = refined(&off, &currents, &["--zero", "exact"]);
    assert!((bent.last().unwrap() / clean.last().unwrap() - 1.0).abs() > 0.5, "{bent:?}");

    let fast = changed(folder.path(), "training_currents.csv", "t_s", |_, t| t * (1.0 + 5e-5));
    let (same, found, told) = refined(&record, &fast, &["--delay", "auto"]);
    let ppm = found["records"][0]["currents_clock_ppm"].as_f64().unwrap();
    assert!((ppm - 50.0).abs() < 2.0 && told.contains("clock of the currents seems to run"), "{ppm} {told}");
    assert!(same.iter().zip(&clean).all(|(a, b)| (a / b - 1.0).abs() < 0.02), "{same:?}, {clean:?}");
    let (_, _, told) = refined(&record, &fast, &[]);
    assert!(told.contains("--delay auto moves them by it") && told.contains("before the commands"), "{told}");
    // What a model of second order leaves beyond noise it may have made up for by its delay.
    let accurate = changed(folder.path(), "training.csv", "theta_sd_deg", |_, _| 0.02);
    let (_, _, told) = refined(&accurate, &fast, &[]);
    assert!(told.contains("makes up for what the model lacks") && !told.contains("before the commands"), "{told}");
}

#[test]
fn wrong_units_signs_and_values_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let (record, currents) = (sample("training.csv"), sample("training_currents.csv"));
    let milli = changed(folder.path(), "training_currents.csv", "axial_a", |_, a| 1e3 * a);
    let (_, _, told) = refined(&record, &milli, &[]);
    assert!(told.contains("Eq. 6 needs amperes; are these mA?"), "{told}");
    let turned = changed(folder.path(), "training_currents.csv", "axial_a", |_, a| -a);
    let (_, _, told) = refined(&record, &turned, &[]);
    assert!(told.contains("is the sign of the current or of θ wrong?"), "{told}");
    let wrong = changed(folder.path(), "training.csv", "theta_deg", |k, y| if k == 3000 { -999.0 } else { y });
    let (_, _, told) = refined(&wrong, &currents, &[]);
    assert!(told.contains("the worst -17.435839 at sample 3000"), "{told}");
    let (_, _, told) = refined(&record, &currents, &[]);
    assert!(!told.contains("the output lies") && !told.contains("in radians?"), "{told}");
    let moved = changed(folder.path(), "training.csv", "theta_deg", |k, y| if k >= 3000 { y + 3.0 } else { y });
    let (_, _, told) = refined(&moved, &currents, &[]);
    assert!(told.contains(" s on the output lies +0.0"), "{told}");
    let clipped = changed(folder.path(), "training.csv", "theta_deg", |_, y| y.min(12.0));
    let (_, _, told) = refined(&clipped, &currents, &[]);
    assert!(told.contains("outputs are exactly 0.209440"), "{told}");
}

/// Of three records fitted together, one has currents as of another coil; another one alone is in radians.
#[test]
fn another_gain_and_another_unit_of_the_angle_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let other = changed(folder.path(), "validation_2_currents.csv", "axial_a", |_, a| a / 0.9);
    let told = |records: &[PathBuf], currents: &[PathBuf]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        command.arg("identify").args(records).arg("--plant").arg(sample("plant.toml"));
        for currents in currents {
            command.arg("--currents").arg(currents);
        }
        let output = command.args(["--order", "4", "--bootstrap", "0", "-o"]).arg(folder.path().join("out")).output();
        let text = String::from_utf8_lossy(&output.unwrap().stderr).into_owned();
        std::fs::remove_dir_all(folder.path().join("out")).unwrap_or_default();
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let records = ["training", "validation_1", "validation_2"];
    let [tables, currents] = ["", "_currents"].map(|of| records.map(|record| sample(&format!("{record}{of}.csv"))));
    let alike = told(&tables, &currents);
    assert!(!alike.contains("would fit the common model best"), "{alike}");
    let differ = told(&tables, &[currents[0].clone(), currents[1].clone(), other]);
    assert!(differ.contains("validation_2.csv times 0.9"), "{differ}");
    let radians = changed(folder.path(), "training.csv", "theta_deg", |_, theta| theta.to_radians());
    let radians = told(&[radians], &currents[..1]);
    assert!(radians.contains("is the table's column in radians?"), "{radians}");
}
