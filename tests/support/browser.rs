//! A browser that the studio is tried in.

use std::path::Path;
use std::process::Command;

/// A browser and a Python that drives it. With both named, by `CATOPTRA_BROWSER` and `CATOPTRA_PYTHON`, they must do;
/// else Debian's Chromium is taken, and where something is missing the test is left out, and says so.
pub(crate) fn browser_and_python() -> Option<(String, String)> {
    let [browser, python] = ["CATOPTRA_BROWSER", "CATOPTRA_PYTHON"].map(|name| std::env::var(name).ok());
    let must = browser.is_some() && python.is_some();
    let browser = browser.unwrap_or_else(|| "/usr/bin/chromium".to_owned());
    let python = python.unwrap_or_else(|| "python3".to_owned());
    let probe = Command::new(&python).args(["-c", "import playwright"]).output();
    let missing = match probe {
        _ if !Path::new(&browser).exists() => format!("there is no browser {browser}"),
        Ok(probe) if probe.status.success() => return Some((browser, python)),
        _ => format!("{python} cannot import playwright; what to install is in the Makefile"),
    };
    assert!(!must, "{missing}");
    super::skipped(&missing);
    None
}
