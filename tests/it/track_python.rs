//! The log of a real run, read by independent code: Python decodes every message and finds the numbers of the table.

use crate::support::python::{agreed, compare, interpreter};
use std::path::Path;
use std::process::Command;

#[test]
fn python_finds_the_numbers_of_the_table_in_the_log_of_a_recording() {
    let Some(python) = interpreter() else { return };
    let repository = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (frame, from, to, frames) in [("base", "0.3", "0.6", 19), ("camera", "4.75", "6", 15)] {
        let folder = tempfile::tempdir().unwrap();
        let run = Command::new(env!("CARGO_BIN_EXE_catoptra"))
            .arg("track")
            .arg(repository.join("sample_frames/planar.mkv"))
            .arg("--rig")
            .arg(repository.join("sample_frames/truth/rig.toml"))
            .args(["--frame", frame, "--from", from, "--to", to])
            .arg("-o")
            .arg(folder.path())
            .output()
            .unwrap();
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        let found = compare(&python, &folder.path().join("log.mcap"), &folder.path().join("track.csv"), frame);
        let printed = agreed(&found);
        for part in [
            format!("\"frames\": {frames}"),
            format!("\"/catheter/deflection\": {frames}, \"/catheter/estimate\": {frames}"),
            "\"attachments\": [\"options.toml\", \"rig.toml\", \"topics\"]".to_owned(),
        ] {
            assert!(printed.contains(&part), "{part} is not in {printed}");
        }
    }
}
