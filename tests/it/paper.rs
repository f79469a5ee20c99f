//! `make paper-fast`: the paper's experiment without pictures, from currents to the page.

use crate::support::python;
use std::path::Path;
use std::process::Command;

#[test]
fn the_papers_experiment_makes_its_page() {
    let Some(python) = python::interpreter_with(&["json"]) else { return };
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(python);
    command.env("PYTHONDONTWRITEBYTECODE", "1").arg(root.join("scripts/paper.py"));
    command.args(["--catoptra", env!("CARGO_BIN_EXE_catoptra"), "--fast", "-o"]).arg(folder.path());
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let page = std::fs::read_to_string(folder.path().join("paper.html")).unwrap();
    let plots = ["9a", "9b", "10", "11-magni", "11-phase", "12a", "12b", "12c", "12d", "13"];
    for plot in plots {
        assert_eq!(page.matches(&format!("<div id=\"figure-{plot}\"")).count(), 1, "figure {plot}");
    }
    assert!(page.contains("plotly.js v") && page.contains("<h2>Table II") && page.contains("Eq. 7 of the paper"));
    assert!(!page.contains("http-equiv=\"refresh\"") && page.matches("<h2>").count() == 9);
    // Errors of the models, percent: an order that the paper has as well.
    let printed = String::from_utf8_lossy(&output.stdout);
    let cells = |begin: &str| -> Vec<f64> {
        let line = printed
            .lines()
            .find(|line| line.starts_with(begin))
            .unwrap_or_else(|| panic!("{begin} is not in {printed}"));
        line.split('|').filter_map(|cell| cell.trim().parse().ok()).collect()
    };
    let training = cells("| Training");
    let [_, _, order_15, order_2, refined] = training[..] else { panic!("{training:?}") };
    assert!(order_15 < 2.0 && order_15 <= order_2 * 1.01 && refined < 15.0, "{training:?}");
    for shape in ["circle", "lemniscate"] {
        let found = cells(&format!("| {shape}, here"));
        // Fast paths are lost, slow ones are kept: the model that moves is the one that gave the currents.
        assert!(found.len() == 12 && found[0] > 3.0 && found[11] < 0.2, "{shape}: {found:?}");
    }
    let magnitude = cells("| magnitude");
    assert!(magnitude[0] < -1.0 && magnitude[11].abs() < 0.2, "{magnitude:?}");
}
