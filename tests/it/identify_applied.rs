//! Saved models on other records, and periods of a multisine, as a user runs them.

use catoptra::identify::{Continuous, Conversion};
use serde_json::Value;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn sample(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_dynamics").join(name)
}

fn catoptra(args: &[&str], paths: &[(&str, &Path)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.args(args);
    for (option, path) in paths {
        if !option.is_empty() {
            command.arg(option);
        }
        command.arg(path);
    }
    command.output().unwrap()
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// On the records of `sample_dynamics` Eq. 7 is the truth: noise of θ alone is left.
#[test]
fn eq_7_is_applied_to_a_record_and_a_wrong_sign_is_seen() {
    let out = tempfile::tempdir().unwrap();
    let (record, currents) = (sample("validation_1.csv"), sample("validation_1_currents.csv"));
    let plant = sample("plant.toml");
    let apply = |folder: &Path, model: &Path| {
        let paths: [(&str, &Path); 5] =
            [("", &record), ("--currents", &currents), ("--plant", &plant), ("--model", model), ("-o", folder)];
        catoptra(&["identify"], &paths)
    };
    let good = out.path().join("good");
    let run = apply(&good, Path::new("eq7"));
    assert!(run.status.success(), "{}", said(&run));
    let found = json(&good.join("applied.json"));
    let fit = &found["fits"][0];
    assert_eq!((fit["model"].as_str(), fit["kind"].as_str()), (Some("given"), Some("simulation")), "{found}");
    assert!(fit["error_percent"].as_f64().unwrap() < 0.03, "{fit}");
    assert!((found["gains"][0]["gain"].as_f64().unwrap() - 1.0).abs() < 5e-3, "{found}");
    // Of the read, not of a fit.
    for (setting, told) in [("detrend", true), ("zero", true), ("estimator", false), ("bootstrap", false)] {
        assert_eq!(found["settings"].get(setting).is_some(), told, "{setting}");
    }
    for file in ["report.html", "signals.csv", "bode.csv"] {
        assert!(good.join(file).metadata().unwrap().len() > 1000, "{file}");
    }
    assert!(!good.join("model.json").exists());
    // H(s) with another sign and half the gain.
    let wrong = out.path().join("h.toml");
    std::fs::write(&wrong, "num = [-8805, -3172]\nden = [1, 4.59, 1.136]\n").unwrap();
    let run = apply(&out.path().join("bad"), &wrong);
    assert!(run.status.success() && said(&run).contains("would fit best multiplied by -2.0"), "{}", said(&run));
    let missing = apply(&out.path().join("none"), Path::new("nowhere.json"));
    assert_eq!(missing.status.code(), Some(2));
    assert!(said(&missing).contains("cannot read model nowhere.json"), "{}", said(&missing));
}

/// A system sampled at 60 Hz, its input a sum of sines that repeats every 4 s.
fn multisine(folder: &Path, periods: usize) -> (PathBuf, Continuous) {
    let truth =
        Continuous { num: vec![12.0, 40.0], den: vec![1.0, 8.0, 30.0], delay_s: 0.0, conversion: Conversion::Hold };
    let one: Vec<f64> = (0..240)
        .map(|t| (2..60).map(|k| (std::f64::consts::TAU * f64::from(k * t) / 240.0 + f64::from(k * k)).cos()).sum())
        .collect();
    let input: Vec<f64> = one.iter().copied().cycle().take(240 * periods).collect();
    let clean = truth.sampled(1.0 / 60.0).simulate(&input);
    let mut random = crate::support::random::Random::new(5);
    let noise = random.normals(clean.len());
    let mut table = "u,y\n".to_owned();
    for ((u, y), e) in input.iter().zip(&clean).zip(noise) {
        writeln!(table, "{u},{}", y + 0.3 * e).unwrap();
    }
    let path = folder.join("multisine.csv");
    std::fs::write(&path, table).unwrap();
    (path, truth)
}

#[test]
fn periods_of_a_multisine_give_h_within_its_sigma_and_serve_other_records() {
    let folder = tempfile::tempdir().unwrap();
    let (table, truth) = multisine(folder.path(), 14);
    let columns = ["identify", "--input", "u", "--output", "y", "--period", "0.016666666666666666"];
    let out = folder.path().join("model");
    let run = catoptra(
        &[&columns[..], &["--order", "2", "--bootstrap", "60", "--repeats", "4s:2"]].concat(),
        &[("", &table), ("-o", &out)],
    );
    assert!(run.status.success(), "{}", said(&run));
    let model = json(&out.join("model.json"));
    let periodic = &model["periodic"];
    assert_eq!(model["continuous"]["model"], "periodic");
    assert_eq!((&periodic["records"][0]["periods"], &periodic["records"][0]["lines"]), (&12.into(), &58.into()));
    let left = periodic["left_over_noise"].as_f64().unwrap();
    assert!((0.6..1.5).contains(&left), "{periodic}");
    let numbers = |v: &Value| v.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect::<Vec<_>>();
    let h = &periodic["continuous"];
    for (key, truth) in [("num", &truth.num), ("den", &truth.den)] {
        let sd = numbers(&h[format!("{key}_standard_errors")]);
        for ((found, truth), sd) in numbers(&h[key]).iter().zip(truth).zip(sd) {
            assert!((found - truth).abs() <= 4.0 * sd && sd < 0.2 * truth, "{key}: {found} ± {sd}, truth {truth}");
        }
    }
    let lines = std::fs::read_to_string(out.join("lines.csv")).unwrap();
    assert_eq!(lines.lines().count(), 59);
    let bandwidth = model["bandwidths"].as_array().unwrap().iter().find(|b| b["model"] == "periodic").unwrap();
    assert!(bandwidth["interval_95_hz"].is_array(), "{bandwidth}");
    // The model serves again.
    let again = folder.path().join("again");
    let applied = catoptra(&columns, &[("", &table), ("--model", &out.join("model.json")), ("-o", &again)]);
    assert!(applied.status.success(), "{}", said(&applied));
    let applied = json(&again.join("applied.json"));
    assert_eq!(applied["leading"], "periodic");
    let errors = |of: &Value, model: &str| {
        let fits = of["fits"].as_array().unwrap();
        let one = fits.iter().find(|f| f["model"] == model && f["kind"] == "simulation").unwrap();
        one["error_percent"].as_f64().unwrap()
    };
    for of in ["full", "reduced", "refined", "periodic"] {
        assert!((errors(&applied, of) / errors(&model, of) - 1.0).abs() < 1e-9, "{of}");
    }
    // A period that is none, in words.
    let wrong = catoptra(
        &[&columns[..], &["--order", "2", "--repeats", "4.003s"]].concat(),
        &[("", &table), ("-o", &folder.path().join("wrong"))],
    );
    assert_eq!(wrong.status.code(), Some(2));
    assert!(said(&wrong).contains("is 240.18 samples"), "{}", said(&wrong));
}
