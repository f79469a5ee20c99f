//! Small files that demand huge resources: each is refused quickly, with a message that names it, without affecting
//! others.

use crate::support::command::*;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

fn run(args: &[&str], folder: &Path) -> Output {
    let began = Instant::now();
    // With 4 GB of address space, whatever the machine has.
    let output = Command::new("sh")
        .args(["-c", "ulimit -v 4194304; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_catoptra")])
        .args(args)
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(began.elapsed() < Duration::from_secs(30), "{args:?} takes {:?}", began.elapsed());
    output
}

#[test]
fn a_header_that_asks_for_90_gigabytes_costs_its_picture_and_no_other() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("large.pgm"), "P5 300000 300000 255\n").unwrap();
    let board = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/dev_tank_boards/air.png");
    std::fs::copy(board, folder.path().join("air.png")).unwrap();
    let output = run(
        &["calibrate", "camera", "large.pgm", "air.png", "--board", "9x6:12mm", "--out", "rig.toml"],
        folder.path(),
    );
    let printed = stderr(&output);
    assert!(output.status.code().is_some_and(|code| code <= 3), "{:?} {printed}", output.status);
    assert!(printed.contains("large.pgm") && printed.contains("300000x300000"), "{printed}");
}

/// OpenCV's detector would look at each for seconds.
#[test]
fn large_pictures_that_show_nothing_are_gone_through_soon() {
    let folder = tempfile::tempdir().unwrap();
    image::GrayImage::from_pixel(12_000, 12_000, image::Luma([255])).save(folder.path().join("blank.png")).unwrap();
    let began = Instant::now();
    let output = run(&["calibrate", "camera", "blank.png", "--board", "9x6:12mm", "--out", "rig.toml"], folder.path());
    ended_with(&output, 3);
    assert!(began.elapsed() < Duration::from_secs(10), "{:?}", began.elapsed());
}

#[test]
fn a_yaml_text_that_multiplies_itself_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n".to_owned();
    for k in 1..12 {
        let list = vec![format!("*a{}", k - 1); 9].join(", ");
        bomb += &format!("a{k}: &a{k} [{list}]\n");
    }
    let deep = format!("{}1\n", "a: {".repeat(10_000).replace("a: {", "{a: "));
    for (name, text, expected) in [("bomb.yaml", bomb, "alias"), ("deep.yaml", deep, "recursion limit")] {
        std::fs::write(folder.path().join(name), text).unwrap();
        let output = run(&["rig", "import", name, "--out", "rig.toml"], folder.path());
        ended_with(&output, 2);
        assert!(stderr(&output).contains(name) && stderr(&output).contains(expected), "{}", stderr(&output));
    }
}

#[test]
fn numbers_in_a_rig_that_nothing_can_be_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let text = rig().to_toml_string();
    let line = |key: &str| text.lines().find(|line| line.trim_start().starts_with(key)).unwrap();
    let corners = vec!["[1.0, 1.0], [900.0, 2.0], [500.0, 800.0]"; 40_000].join(", ");
    let cases = [
        (line("planes"), "planes = [[1e300, 0.0, 0.0, 0.0]]".to_owned(), "planes"),
        (line("translation_mm"), "translation_mm = [1e300, 0.0, 0.0]".to_owned(), "translation_mm"),
        (line("offset_mm"), "offset_mm = -1e300".to_owned(), "offset_mm"),
        (line("region_px"), format!("region_px = [{corners}]"), "corners"),
    ];
    for (old, new, expected) in cases {
        let changed = text.replacen(old, &new, 1);
        std::fs::write(folder.path().join("rig.toml"), changed).unwrap();
        let output = run(&["rig", "check", "rig.toml"], folder.path());
        ended_with(&output, 2);
        assert!(stderr(&output).contains(expected), "{}", stderr(&output));
    }
    let views = (0..20).map(|k| format!("[[view]]\nname = \"v{k}\"\npath = []\n\n")).collect::<String>();
    std::fs::write(folder.path().join("rig.toml"), text.replacen("[[view]]", &format!("{views}[[view]]"), 1)).unwrap();
    let output = run(&["rig", "check", "rig.toml"], folder.path());
    ended_with(&output, 2);
    assert!(stderr(&output).contains("8 at most"), "{}", stderr(&output));
}

#[test]
fn sources_of_currents_that_cannot_be_are_wrong_usage() {
    let place = Place::new();
    for (from, expected) in [
        ("file:/dev/zero", "cannot receive currents"),
        ("file:nowhere.csv", "No such file"),
        ("udp:0", "port"),
        ("udp:evil", "port"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_catoptra"))
            .current_dir(place.folder.path())
            .arg("live")
            .arg(sample("rest.mkv"))
            .args(["--realtime", "-o", "live", "--currents", from, "--rig"])
            .arg(&place.rig)
            .output()
            .unwrap();
        ended_with(&output, 2);
        assert!(stderr(&output).contains(expected), "{from}: {}", stderr(&output));
    }
    let output = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .args(["live", "x.mkv", "--rig", "r.toml", "--udp", "127.0.0.1:0"])
        .output()
        .unwrap();
    ended_with(&output, 2);
    assert!(stderr(&output).contains("the port is 0"), "{}", stderr(&output));
}
