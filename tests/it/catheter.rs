//! `catoptra catheter` from end to end: shape, reach, currents for a path, and what is refused.

use catoptra::series::CurrentTable;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn catheter(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).arg("catheter").args(args).output().unwrap()
}

fn stdout(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn the_shape_is_told_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let text = stdout(&catheter(folder.path(), &["shape", "--currents", "0mA,0mA,100mA", "-o", "shape.html"]));
    assert!(text.contains("θ           43.950°") && text.contains("1 mA more in"), "{text}");
    assert!(fs::read_to_string(folder.path().join("shape.html")).unwrap().contains("id=\"plot-shape\""));
}

#[test]
fn a_sample_file_is_the_prototype() {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_dynamics/catheter.toml");
    let folder = tempfile::tempdir().unwrap();
    let args = ["shape", "--currents", "0mA,50mA,100mA"];
    let built_in = stdout(&catheter(folder.path(), &args));
    let read = stdout(&catheter(folder.path(), &[&args[..], &["--catheter", sample.to_str().unwrap()]].concat()));
    let line = |text: &str| text.lines().find(|line| line.contains('θ')).map(str::to_owned);
    assert_eq!(line(&built_in), line(&read));
}

#[test]
fn currents_for_a_path_come_as_tables_and_lists_that_say_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["follow", "circle", "--points", "12", "--periods", "2", "--pause", "20ms", "-o", "out"];
    let text = stdout(&catheter(folder.path(), &args));
    assert!(text.contains("RMS 0.000 mm"), "{text}");
    let read = |name: &str| CurrentTable::read(&folder.path().join("out").join(name)).unwrap();
    let (table, list) = (read("currents_20ms.csv"), read("currents_20ms.play"));
    assert_eq!((table.rows.len(), table.coils.join(",")), (25, "x_a,y_a,z_a".to_owned()));
    assert_eq!(list.rows.len(), 25);
    for (a, b) in table.rows.iter().zip(&list.rows) {
        assert_eq!(a.time_ns, b.time_ns);
        assert!(a.values_a.iter().zip(&b.values_a).all(|(a, b)| (a - b).abs() <= 0.5e-6), "{a:?} {b:?}");
    }
    assert!(table.rows[24].values_a.iter().all(|i| *i == 0.0));
    let desired = fs::read_to_string(folder.path().join("out/desired.csv")).unwrap();
    assert_eq!((desired.lines().count(), desired.lines().next()), (13, Some("x_mm,y_mm,z_mm,tan_x,tan_y,tan_z")));
    // Again into the same folder; not into one with other files.
    stdout(&catheter(folder.path(), &args));
    fs::write(folder.path().join("out/notes.txt"), "mine").unwrap();
    let refused = catheter(folder.path(), &args);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("notes.txt, which this command did not write"));
}

#[test]
fn the_reach_is_a_surface() {
    let folder = tempfile::tempdir().unwrap();
    let text = stdout(&catheter(folder.path(), &["reach", "--steps", "3", "-o", "reach"]));
    assert!(text.contains("a surface: a moment along B0 moves nothing"), "{text}");
    let table = fs::read_to_string(folder.path().join("reach/reach.csv")).unwrap();
    assert!(table.lines().count() > 20, "{table}");
}

#[test]
fn what_cannot_be_is_refused_with_what_would_be_right() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("c.toml"), "[tube]\nouter_radius_mm = 1\n").unwrap();
    for (args, code, words) in [
        (&["shape", "--currents", "0mA"][..], 2, "expected three: X,Y,Z such as 0mA,0mA,100mA"),
        (&["shape", "--currents", "0mA,0mA,150mA"], 2, "coil z: 150 mA is beyond the limit of 100 mA"),
        (&["shape", "--currents=-100mA,0mA,0mA"], 3, "the shape becomes unstable"),
        (&["shape", "--currents", "0mA,0mA,1mA", "--catheter", "none.toml"], 2, "cannot read catheter file none.toml"),
        (&["shape", "--currents", "0mA,0mA,1mA", "--catheter", "c.toml"], 2, "missing field"),
        (&["follow", "none.csv", "-o", "out"], 2, "is neither circle nor lemniscate, and no such file"),
        (&["follow", "circle", "--radius", "0mm", "-o", "out"], 2, "is no length above 0"),
    ] {
        let output = catheter(folder.path(), args);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert!(message.contains(words), "`{words}` is not in {message}");
    }
}
