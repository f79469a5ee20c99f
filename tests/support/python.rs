//! Logs read by independent code: Python's `mcap` with `mcap-protobuf-support`, by `tests/python/read_log.py`.
//!
//! Needs `pip install mcap mcap-protobuf-support websockets numpy scipy`, and other tests need what they name (the
//! Makefile has all), in the interpreter named by `CATOPTRA_PYTHON` or `python3`. Skipped with a message where they are
//! missing; a failure there when `CI=true`.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Output};

/// The interpreter, if it has what reads logs.
pub(crate) fn interpreter() -> Option<String> {
    interpreter_with(&["mcap", "mcap_protobuf", "websockets"])
}

/// The interpreter, if it can import these.
pub(crate) fn interpreter_with(modules: &[&str]) -> Option<String> {
    let python = std::env::var("CATOPTRA_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let modules = modules.join(", ");
    let probe = Command::new(&python).args(["-c", &format!("import {modules}")]).output();
    let missing = match probe {
        Ok(output) if output.status.success() => return Some(python),
        Ok(output) => String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or("").to_owned(),
        Err(error) => error.to_string(),
    };
    let printed = format!("{python} cannot import {modules} ({missing}); what to install is in the Makefile");
    assert!(std::env::var("CI").as_deref() != Ok("true"), "{printed}");
    super::skipped(&printed);
    None
}

/// Decodes every message of a log and compares it with the table, whose frame of reference is `base` or `camera`.
pub(crate) fn compare(python: &str, log: &Path, table: &Path, frame: &str) -> Output {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/read_log.py");
    Command::new(python).arg(script).args([log, table]).args(["--frame", frame]).output().unwrap()
}

/// Fails unless log and table agree; gives what was found.
pub(crate) fn agreed(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}
