//! A V4L2 camera, simulated by a library between the command and the kernel: no camera is needed.
#![cfg(target_os = "linux")]

use crate::support::command::{Place, Table};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The fake driver, compiled; `None` without a C compiler.
fn driver(place: &Place) -> Option<PathBuf> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cameras/fake_v4l2.c");
    let library = place.path("fake_v4l2.so");
    let compiled =
        Command::new("cc").args(["-shared", "-fPIC", "-O1", "-o"]).arg(&library).arg(source).arg("-ldl").status();
    match compiled {
        Ok(status) => {
            assert!(status.success(), "the fake driver does not compile");
            Some(library)
        }
        Err(error) => {
            eprintln!("left out: no C compiler ({error})");
            None
        }
    }
}

fn live(place: &Place, driver: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.current_dir(place.folder.path()).env("LD_PRELOAD", driver).args([
        "-vv",
        "live",
        "/dev/video77",
        "-o",
        "out",
        "--rig",
    ]);
    command.arg(&place.rig).args(args).output().unwrap()
}

#[test]
fn a_v4l2_camera_is_set_up_read_back_counted_and_taken_up_again_after_it_was_unplugged() {
    let place = Place::new();
    let Some(driver) = driver(&place) else { return };
    let output = live(&place, &driver, &["--fps", "50", "--exposure", "8", "--gain", "400", "--duration", "4"]);
    let printed = String::from_utf8_lossy(&output.stderr).into_owned();
    // Grey pictures: all is well but that no marker is seen.
    assert_eq!(output.status.code(), Some(3), "{printed}");
    assert!(printed.contains("gain: 400 requested, the camera uses 100"), "{printed}");
    assert!(printed.contains("white_balance_automatic (0: off): the camera refuses 0"), "{printed}");
    assert!(!printed.contains("exposure: ") && !printed.contains("frame rate: "), "{printed}");
    assert!(printed.contains("the start of the exposure"), "{printed}");
    assert!(printed.contains("is left out (the driver marks it as damaged)"), "{printed}");
    assert!(printed.contains("the camera is lost") && printed.contains("the camera is back"), "{printed}");
    let table = Table::read(&place.path("out/track.csv"));
    // Of buffers 0..60 of the first connection, 20 and 21 never come and 30 is damaged; then the camera is unplugged.
    let gaps: Vec<(usize, &str)> =
        table.rows.iter().map(|row| row["gap"].as_str()).enumerate().filter(|(_, gap)| *gap != "0").collect();
    assert_eq!(gaps[..2], [(20, "2"), (28, "1")], "{printed}");
    assert!(table.rows.len() > 60, "{} rows", table.rows.len());
}
