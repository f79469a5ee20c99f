//! `--json`: one outcome for programs on stdout, whatever happened.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn run(folder: &Path, words: &str) -> (Output, Value) {
    let tree = Path::new(env!("CARGO_MANIFEST_DIR"));
    let words = words.replace("TREE", tree.to_str().unwrap());
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    let output = command.current_dir(folder).args(words.split_whitespace()).output().unwrap();
    let outcome = serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|e| panic!("{words}: {e}: {}", String::from_utf8_lossy(&output.stdout)));
    (output, outcome)
}

/// Every member is there, and code and word say what the program says.
fn check(output: &Output, outcome: &Value, command: &str, code: i32, word: &str) {
    let names: Vec<&str> = outcome.as_object().unwrap().keys().map(String::as_str).collect();
    let all = [
        "command",
        "error",
        "exit_code",
        "more_warnings",
        "outcome",
        "results",
        "schema",
        "text",
        "warnings",
        "written",
    ];
    assert_eq!(names, all);
    assert_eq!(output.status.code(), Some(code), "{outcome:#}");
    assert_eq!((&outcome["exit_code"], &outcome["outcome"]), (&code.into(), &word.into()));
    assert_eq!((&outcome["command"], &outcome["schema"]), (&command.into(), &1.into()));
    assert_eq!(outcome["error"].is_null(), code == 0, "{outcome:#}");
}

fn written(outcome: &Value, folder: &Path) -> Vec<String> {
    let all = outcome["written"].as_array().unwrap().iter().map(|path| path.as_str().unwrap().to_owned());
    let all: Vec<String> = all.collect();
    for path in &all {
        assert!(folder.join(path).is_file(), "{path}");
    }
    all
}

const CAMERA: &str = "calibrate camera TREE/calibration/dev_tank/intrinsics --board 9x6:12mm --out rig.toml --json";

#[test]
fn a_calibration_gives_the_rig_and_a_failed_one_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let (output, outcome) = run(folder.path(), CAMERA);
    check(&output, &outcome, "calibrate camera", 0, "good");
    assert_eq!(written(&outcome, folder.path()), ["rig.toml"]);
    let rig: toml::Table = std::fs::read_to_string(folder.path().join("rig.toml")).unwrap().parse().unwrap();
    assert_eq!(outcome["results"]["camera"]["focal_px"][0].as_f64(), rig["camera"]["focal_px"][0].as_float());
    assert!(outcome["results"]["provenance"].is_object());
    // The text is that without --json, which begins with the pictures.
    let text = outcome["text"].as_str().unwrap();
    assert!(text.contains("written: rig.toml"), "{text}");

    let (output, outcome) = run(folder.path(), "calibrate camera --json none --board 9x6:12mm --out rig.toml");
    check(&output, &outcome, "calibrate camera", 2, "usage");
    assert!(outcome["error"].as_str().unwrap().contains("none"), "{outcome:#}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("error: "));
    assert_eq!((&outcome["results"], written(&outcome, folder.path()).len()), (&Value::Null, 0));
}

/// The tank is forgotten.
#[test]
fn doubts_of_a_calibration_are_its_warnings_and_said_once() {
    let folder = tempfile::tempdir().unwrap();
    run(folder.path(), CAMERA);
    let command = "calibrate rig TREE/calibration/dev_tank/mirror --board 9x6:12mm --rig rig.toml --json";
    let (output, outcome) = run(folder.path(), command);
    check(&output, &outcome, "calibrate rig", 0, "good");
    let warnings = outcome["warnings"].as_array().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    let doubt = "doubt: corners of the direct view that are neighbours are off together";
    assert!(warnings.iter().any(|warning| warning.as_str().unwrap().starts_with(doubt)), "{outcome:#}");
    assert_eq!(stderr.matches(doubt).count(), 1, "{stderr}");
    assert!(!outcome["text"].as_str().unwrap().contains("doubt:"), "{outcome:#}");
}

#[test]
fn an_identified_model_and_a_validation_are_in_the_outcome() {
    let folder = tempfile::tempdir().unwrap();
    let identify = "identify TREE/sample_dynamics/training.csv --currents TREE/sample_dynamics/training_currents.csv \
                    --plant TREE/sample_dynamics/plant.toml --bootstrap 0 --order 2 --nk 1 -o dynamics --json";
    let (output, outcome) = run(folder.path(), identify);
    check(&output, &outcome, "identify", 0, "good");
    assert!(written(&outcome, folder.path()).contains(&"dynamics/model.json".to_owned()), "{outcome:#}");
    let model = std::fs::read_to_string(folder.path().join("dynamics/model.json")).unwrap();
    assert_eq!(outcome["results"], serde_json::from_str::<Value>(&model).unwrap());

    let validate = "validate TREE/tests/data/validate/20ms.csv TREE/tests/data/validate/5ms.csv --pause 20ms,5ms \
                    --desired TREE/tests/data/validate/circle.csv --start 1.5 -o validation --json";
    let (output, outcome) = run(folder.path(), validate);
    check(&output, &outcome, "validate", 0, "good");
    assert!(written(&outcome, folder.path()).contains(&"validation/validation.json".to_owned()), "{outcome:#}");
    let result = std::fs::read_to_string(folder.path().join("validation/validation.json")).unwrap();
    assert_eq!(outcome["results"], serde_json::from_str::<Value>(&result).unwrap());

    // No table at all.
    std::fs::write(folder.path().join("empty.csv"), "a,b\n").unwrap();
    let (output, outcome) = run(folder.path(), &validate.replace("TREE/tests/data/validate/5ms.csv", "empty.csv"));
    check(&output, &outcome, "validate", 2, "usage");
}

#[cfg(unix)]
#[test]
fn an_interrupted_command_has_an_outcome() {
    let folder = tempfile::tempdir().unwrap();
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_dynamics");
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.current_dir(folder.path()).arg("identify").arg(sample.join("training.csv"));
    command.arg("--currents").arg(sample.join("training_currents.csv")).arg("--plant").arg(sample.join("plant.toml"));
    command.args(["--bootstrap", "100000", "-o", "dynamics", "--json"]).stdout(std::process::Stdio::piped());
    let child = command.spawn().unwrap();
    // It watches for signals from its first moments on, and takes minutes.
    std::thread::sleep(std::time::Duration::from_secs(3));
    assert!(crate::support::command::signal(&child, "INT"));
    let output = child.wait_with_output().unwrap();
    let outcome = serde_json::from_slice(&output.stdout).unwrap();
    check(&output, &outcome, "identify", 130, "interrupted");
    assert!(!folder.path().join("dynamics/model.json").exists());
}
