//! `catoptra excite` from end to end: tables of the paper's chirp and other signals, limits, and refusals.

use crate::support::python;
use catoptra::series::CurrentTable;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn excite(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).arg("excite").args(args).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn made(folder: &Path, args: &[&str]) -> (CurrentTable, String) {
    let output = excite(folder, &[args, &["-o", "i.csv"]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    (CurrentTable::read(&folder.join("i.csv")).unwrap(), String::from_utf8_lossy(&output.stdout).into_owned())
}

#[test]
fn without_options_it_is_the_papers_chirp() {
    let folder = tempfile::tempdir().unwrap();
    let (table, message) = made(folder.path(), &["chirp", "--report"]);
    assert_eq!((table.rows.len(), table.coils.join(",")), (18_001, "current_a".to_owned()));
    let (first, last) = (&table.rows[0], &table.rows[18_000]);
    assert_eq!((first.time_ns, last.time_ns), (0, 300_000_000_000));
    assert_eq!((&first.values_a, &last.values_a), (&vec![0.0], &vec![0.0]));
    let peak = table.rows.iter().fold(0.0_f64, |peak, row| peak.max(row.values_a[0].abs()));
    assert!((peak - 0.1).abs() < 1e-5);
    for part in
        ["peak           100.0 mA", "crest factor   1.41", "largest slew   4.88 A/s", "rows/period    7.5, at 8 Hz"]
    {
        assert!(message.contains(part), "`{part}` is not in {message}");
    }
    let page = fs::read_to_string(folder.path().join("i.html")).unwrap();
    assert!(page.contains("id=\"plot-current\"") && page.contains("id=\"plot-spectrum\""));
}

#[test]
fn limits_are_kept_by_refusing_or_by_cutting_off() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |args: &[&str], words: &str| {
        let output = excite(folder.path(), &[args, &["-o", "i.csv"]].concat());
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(stderr(&output).contains(words), "`{words}` is not in {}", stderr(&output));
        assert!(!folder.path().join("i.csv").exists());
    };
    refused(&["chirp", "--amplitude", "150mA"], "on exceeds the limit of 100.0 mA: an amplitude of 100.0 mA keeps it");
    refused(&["chirp", "--slew", "3A/s"], "an amplitude of 61.4 mA keeps it");
    refused(&["steps", "--levels", "0mA,100mA", "--hold", "0.1s", "--slew", "0.5A/s"], "takes 0.200 s at 0.5 A/s");
    refused(&["multisine", "--period", "20.01s"], "is the nearest");
    refused(&["multisine", "--period", "20s", "--duration", "19s"], "less than the period of 20 s");
    refused(&["chirp", "--to", "31Hz"], "stay below 30 Hz");
    refused(&["chirp", "--amplitude", "100"], "`100` has no unit: write 100mA");
    let output = excite(folder.path(), &["chirp", "--amplitude", "0.0003mA", "-o", "i.play"]);
    assert!(stderr(&output).contains("all of its currents are 0 in the file, whose step is 0.001 mA"));
    assert!(output.status.code() == Some(2) && !folder.path().join("i.play").exists());
    refused(&["chirp", "--coils", "a,a"], "--coils: names of columns, all different");
    // Its readers take these for something else.
    refused(&["chirp", "--coils", "coil_mA"], "--coils: column `coil_mA` is in milliamperes");
    for time in ["host_ns", "unix_s", "stamp_ns"] {
        refused(&["chirp", "--coils", &format!("a,{time}")], &format!("--coils: {time} is read as a time"));
    }
    refused(&["chirp", "--report=i.csv"], "i.csv: table and page have the same name");

    let (table, message) = made(folder.path(), &["chirp", "--amplitude", "150mA", "--slew", "3A/s", "--clip"]);
    assert!(message.contains("limit of current: ") && message.contains("limit of slew: "), "{message}");
    let of_energy = |slew: &str| {
        let clipped = excite(folder.path(), &["chirp", "--slew", slew, "--clip", "-o", "slow.csv"]);
        stderr(&clipped).contains("of the signal's energy is between 0.5 Hz and 8 Hz")
    };
    assert!(!of_energy("3A/s") && of_energy("0.02A/s"));
    let values: Vec<f64> = table.rows.iter().map(|row| row.values_a[0]).collect();
    assert!(values.iter().all(|value| value.abs() <= 0.1 + 1e-9));
    assert!(values.windows(2).all(|pair| (pair[1] - pair[0]).abs() * 60.0 <= 3.0 + 1e-6));
}

#[test]
fn several_coils_have_a_column_each_and_only_a_table_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["steps", "--levels", "-50mA,50mA", "--hold", "1s", "--duration", "4s", "--rate", "10", "--coils"];
    for _ in 0..2 {
        let (table, _) = made(folder.path(), &[args.as_slice(), &["axial_a,side_a"]].concat());
        assert_eq!(table.coils, ["axial_a", "side_a"]);
        assert_eq!((&table.rows[5].values_a, &table.rows[15].values_a), (&vec![-0.05, 0.0], &vec![0.05, 0.0]));
        assert_eq!(table.rows.len(), 41);
    }
    fs::write(folder.path().join("notes.csv"), "Tuesday\n").unwrap();
    let output = excite(folder.path(), &["chirp", "-o", "notes.csv"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("notes.csv: exists and is not a table of this command"), "{}", stderr(&output));
    let recorded = "t_s,axial_a\r\n0.000000,0.012000\r\n0.016667,0.000000\r\n";
    fs::write(folder.path().join("recorded.csv"), recorded).unwrap();
    let output = excite(folder.path(), &["chirp", "-o", "recorded.csv"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("recorded.csv: exists and is not a table of this command"), "{}", stderr(&output));
    assert_eq!(fs::read_to_string(folder.path().join("recorded.csv")).unwrap(), recorded);
    let output = excite(folder.path(), &["chirp", "-o", "none/i.csv"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("there is no such folder"), "{}", stderr(&output));
}

/// Currents to a microampere, times to half a millisecond, which do not add up.
#[test]
fn a_list_for_the_amplifier_plays_the_same_currents() {
    let folder = tempfile::tempdir().unwrap();
    let chirp = ["chirp", "--duration", "20s", "--amplitude", "80mA"];
    let (table, _) = made(folder.path(), &chirp);
    let list = |args: &[&str]| excite(folder.path(), &[&chirp[..], args].concat());
    for _ in 0..2 {
        let output = list(&["--coils", "channel_3,channel_1", "-o", "i.play"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    }
    let played = CurrentTable::read(&folder.path().join("i.play")).unwrap();
    assert_eq!(played.coils, ["channel_1", "channel_2", "channel_3"]);
    assert_eq!(played.rows.len(), table.rows.len());
    for (row, exact) in played.rows.iter().zip(&table.rows) {
        assert!((row.time_ns - exact.time_ns).abs() <= 500_000, "{} ns, {} ns", row.time_ns, exact.time_ns);
        assert!((row.values_a[2] - exact.values_a[0]).abs() <= 0.51e-6 && row.values_a[..2] == [0.0; 2]);
    }
    assert_eq!(played.rows.last().unwrap().values_a, [0.0; 3]);
    let output = list(&["--rate", "1000", "-o", "fast.play"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("its delays are whole milliseconds"), "{}", stderr(&output));
    let output = list(&["--coils", "channel_2,side", "-o", "twice.play"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("all different, as channel_3"), "{}", stderr(&output));
    let step = "1, 35.5, 2000\r\n1, -12.25, 3000\r\n1, 0, 0\r\n";
    let path = "1, 20, 0\r\n2, 35, 500\r\n1, 0, 0\r\n2, 0, 0\r\n";
    for (name, text) in [("notes.play", "Tuesday\n"), ("path.play", path), ("step.play", step)] {
        fs::write(folder.path().join(name), text).unwrap();
        let output = list(&["-o", name]);
        let refused = format!("{name}: exists and is not this very list");
        assert!(stderr(&output).contains(&refused), "{}", stderr(&output));
        assert_eq!(fs::read_to_string(folder.path().join(name)).unwrap(), text);
    }
}

/// scipy makes the same chirps.
#[test]
fn scipy_makes_the_same_chirps() {
    let Some(python) = python::interpreter_with(&["numpy", "scipy"]) else { return };
    let folder = tempfile::tempdir().unwrap();
    for (sweep, method) in [("linear", "linear"), ("log", "logarithmic")] {
        made(folder.path(), &["chirp", "--sweep", sweep, "--duration", "60s", "--from", "0.3Hz", "--to", "9Hz"]);
        let script = format!(
            "import numpy as np, scipy.signal as s\n\
             i = np.loadtxt('i.csv', delimiter=',', skiprows=1)\n\
             t = np.arange(3600) / 60\n\
             e = 0.1 * s.chirp(t, 0.3, 60, 9, method='{method}', phi=-90)\n\
             assert np.abs(i[:-1, 1] - e).max() < 2e-8, np.abs(i[:-1, 1] - e).max()"
        );
        let output = Command::new(&python).current_dir(folder.path()).args(["-c", &script]).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
    }
}

/// What is printed is what the table holds: whole rows, and whole periods or not.
#[test]
fn holds_and_periods_that_are_not_whole_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let steps = ["steps", "--levels", "0mA,50mA", "--duration", "2s", "--rate", "60", "--hold"];
    let (table, message) = made(folder.path(), &[&steps[..], &["0.04s"]].concat());
    assert!(message.contains("0.033333 s each, the whole rows nearest to the 0.04 s asked for"), "{message}");
    let changes = table.rows.windows(2).filter(|pair| pair[0].values_a != pair[1].values_a).map(|pair| pair[1].time_ns);
    let changes: Vec<i64> = changes.collect();
    assert!(changes.windows(2).all(|pair| ((pair[1] - pair[0]) as f64 * 1e-9 - 0.033333).abs() < 1e-5), "{changes:?}");
    let (_, message) = made(folder.path(), &[&steps[..], &["0.05s"]].concat());
    assert!(message.contains("0.05 s each\n"), "{message}");
    let multisine = ["multisine", "--period", "20s", "--duration"];
    let (_, message) = made(folder.path(), &[&multisine[..], &["50s"]].concat());
    assert!(message.contains("20 s; 2.500 of them, the last is cut off"), "{message}");
    let (_, message) = made(folder.path(), &[&multisine[..], &["60s"]].concat());
    assert!(message.contains("20 s\n"), "{message}");
}
