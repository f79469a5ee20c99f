//! `catoptra identify` against numpy and scipy, and against python-control and slycot if installed: the same records,
//! identified by other methods. tests/python/identify.py makes them and compares.

use crate::support::python;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn script(python: &str, verb: &str, folder: &Path) -> Output {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/identify.py");
    Command::new(python).arg(script).arg(verb).arg(folder).output().unwrap()
}

fn message(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn other_methods_find_the_same_and_a_changed_digit_is_found() {
    let Some(python) = python::interpreter_with(&["numpy", "scipy"]) else { return };
    let folder = tempfile::tempdir().unwrap();
    let made = script(&python, "make", folder.path());
    assert!(made.status.success(), "{}", message(&made));
    let cases: Value = serde_json::from_slice(&std::fs::read(folder.path().join("cases.json")).unwrap()).unwrap();
    for case in cases.as_array().unwrap() {
        let args = case["args"].as_array().unwrap().iter().map(|arg| arg.as_str().unwrap());
        let mut program = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        let output = program.current_dir(folder.path()).args(["-q", "identify"]).args(args).output().unwrap();
        assert!(output.status.success(), "{case}: {}", message(&output));
    }
    let checked = script(&python, "check", folder.path());
    let differences = String::from_utf8_lossy(&checked.stdout).into_owned();
    assert!(checked.status.success(), "{differences}\n{}", message(&checked));
    eprintln!("{differences}{}", message(&checked));
    // It can fail: one coefficient off by 2e-6 of itself.
    let path = folder.path().join("direct/model.json");
    let mut model: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let coefficient = model["arx"]["a"][1].as_f64().unwrap();
    model["arx"]["a"][1] = (coefficient * (1.0 + 2e-6)).into();
    std::fs::write(&path, model.to_string()).unwrap();
    let checked = script(&python, "check", folder.path());
    assert!(
        !checked.status.success() && message(&checked).contains("direct, ARX coefficients"),
        "{}",
        message(&checked)
    );
}
