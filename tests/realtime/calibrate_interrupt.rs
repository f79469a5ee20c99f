//! The rig file after `catoptra calibrate` is cut short: by Ctrl-C, or a full disk.

#![cfg(unix)]

use crate::support::command;
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;
use tempfile::TempDir;

const CAMERA: [&str; 4] = ["--board", "9x6:12mm", "--out", "rig.toml"];
const RIG: [&str; 6] = ["--board", "9x6:12mm", "--rig", "rig.toml", "--glass", "5mm"];

fn pictures(of: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/dev_tank").join(of).to_str().unwrap().to_owned()
}

fn command(place: &Path, verb: &str, of: &str, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.current_dir(place).args(["calibrate", verb, &pictures(of)]).args(args);
    command
}

/// A folder with a calibrated lens in `rig.toml`.
fn place() -> TempDir {
    let place = tempfile::tempdir().unwrap();
    let output = command(place.path(), "camera", "intrinsics", &CAMERA).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    place
}

/// All files of a folder and what is in them.
fn files(place: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let paths = std::fs::read_dir(place).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = paths.map(|path| (path.clone(), std::fs::read(path).unwrap())).collect();
    files.sort();
    files
}

/// Signals after `wait`; the output.
fn interrupted(mut run: Command, signal: &str, wait: Duration) -> Output {
    let child = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    std::thread::sleep(wait);
    // It may be done already.
    let _ = command::signal(&child, signal);
    child.wait_with_output().unwrap()
}

#[test]
fn ctrl_c_ends_with_130_and_leaves_all_files_as_they_were() {
    let place = place();
    std::fs::write(place.path().join("rig.toml.bak"), "an older state").unwrap();
    let before = files(place.path());
    let runs: [(&str, &str, &[&str], &str); 3] =
        [("camera", "intrinsics", &CAMERA, "INT"), ("rig", "mirror", &RIG, "INT"), ("rig", "mirror", &RIG, "TERM")];
    for (verb, of, args, signal) in runs {
        // A machine that is busy takes longer to begin; before that the system ends the program.
        let waits = (0..6).map(|i| Duration::from_millis(150 << i));
        let mut outputs = waits.map(|wait| interrupted(command(place.path(), verb, of, args), signal, wait));
        let output = outputs.find(|output| output.status.signal().is_none()).unwrap();
        assert_eq!(output.status.code(), Some(130), "{verb} {signal}: {}", String::from_utf8_lossy(&output.stderr));
        assert!(String::from_utf8_lossy(&output.stderr).contains("interrupted"));
        assert!(files(place.path()) == before, "{verb} {signal} changed something");
    }
}

/// Whenever it comes, the file is the old one or the new one, and nothing else lies about.
#[test]
fn a_signal_at_any_time_leaves_the_old_rig_or_the_new_one() {
    let place = place();
    let old = std::fs::read(place.path().join("rig.toml")).unwrap();
    let mut ends = Vec::new();
    for i in 1..=12 {
        std::fs::write(place.path().join("rig.toml"), &old).unwrap();
        let run = command(place.path(), "camera", "intrinsics", &CAMERA);
        let output = interrupted(run, "INT", Duration::from_millis(60 * i));
        let code = output.status.code();
        // Before the program has begun the system ends it.
        let ended = matches!(code, Some(0 | 130)) || output.status.signal() == Some(2);
        assert!(ended, "{:?}: {}", output.status, String::from_utf8_lossy(&output.stderr));
        for (path, bytes) in files(place.path()) {
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            assert!(name == "rig.toml" || name.starts_with("rig.toml.bak"), "{name}");
            // The same lens from the same pictures: the new file is the old one but for the last digits.
            assert!(bytes.ends_with(old.split_at(old.len() - 20).1), "{name} is not whole");
        }
        ends.push(code);
    }
    assert!(ends.contains(&Some(130)), "{ends:?}");
}

/// Files that cannot grow beyond a kilobyte, as on a full disk: neither rig nor backup have changed.
#[test]
fn a_full_disk_leaves_rig_and_backup_as_they_were() {
    let place = place();
    std::fs::write(place.path().join("rig.toml.bak"), "an older state").unwrap();
    let before = files(place.path());
    for (verb, of, args) in [("camera", "intrinsics", &CAMERA[..]), ("rig", "mirror", &RIG[..])] {
        let calibrate = command(place.path(), verb, of, args);
        let mut limited = Command::new("sh");
        limited.current_dir(place.path()).args(["-c", "trap '' XFSZ; ulimit -f 1; exec \"$@\"", "sh"]);
        let output = limited.arg(calibrate.get_program()).args(calibrate.get_args()).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("rig.toml"), "{said}");
        assert!(files(place.path()) == before, "{verb} changed something: {said}");
    }
}

/// Whatever has the name of a backup already stays what it is.
#[test]
fn a_backup_takes_the_place_of_nothing() {
    let place = place();
    let rig = std::fs::read(place.path().join("rig.toml")).unwrap();
    std::fs::create_dir(place.path().join("rig.toml.bak")).unwrap();
    std::fs::write(place.path().join("rig.toml.bak2"), "an older state").unwrap();
    let output = command(place.path(), "rig", "mirror", &RIG).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(std::fs::read(place.path().join("rig.toml.bak3")).unwrap(), rig);
    assert_eq!(std::fs::read_to_string(place.path().join("rig.toml.bak2")).unwrap(), "an older state");
    assert!(place.path().join("rig.toml.bak").is_dir());
}

#[test]
fn the_rig_before_is_kept_beside_the_new_one() {
    let place = place();
    let old = std::fs::read(place.path().join("rig.toml")).unwrap();
    let output = command(place.path(), "rig", "mirror", &RIG).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(std::fs::read(place.path().join("rig.toml.bak")).unwrap(), old);
    assert_ne!(std::fs::read(place.path().join("rig.toml")).unwrap(), old);
}
