//! `catoptra identify --planes`: a simulated catheter around a bend, moved by all coils, to one model of both angles.

use nalgebra::Complex;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

fn catoptra(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).args(args).output().unwrap()
}

fn good(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

const ABOUT_A: [f64; 3] = [0.0, 0.01, 0.05];
const SECONDS: u32 = 40;

/// Sines of the side coil across B0 and of the axial one, none of them of both.
fn currents(file: &Path, phase: f64) {
    let mut text = "t_s,x_a,y_a,z_a\r\n".to_owned();
    for k in 0..60 * SECONDS {
        let t = f64::from(k) / 60.0;
        let sum = |first: u32, size: f64| -> f64 {
            let sine = |n: u32| (TAU * 0.15 * f64::from(n) * t + f64::from(n * n) * phase).sin();
            size * (first..40).step_by(2).map(sine).sum::<f64>() / 20_f64.sqrt()
        };
        let (y, z) = (ABOUT_A[1] + sum(1, 4e-3), ABOUT_A[2] + sum(2, 4e-3));
        let _ = write!(text, "{t:.9},0,{y:.9},{z:.9}\r\n");
    }
    std::fs::write(file, text).unwrap();
}

/// Leaves out the first 5 s of a table, in which the catheter comes from rest.
fn without_the_way_there(table: &Path) {
    let text = std::fs::read_to_string(table).unwrap();
    let late = |line: &&str| line.split(',').nth(1).and_then(|t| t.parse::<f64>().ok()).is_none_or(|t| t >= 5.0);
    std::fs::write(table, text.lines().filter(late).map(|line| format!("{line}\n")).collect::<String>()).unwrap();
}

/// Degrees of an angle per ampere of a coil, by a sine of 1 mA about the mean currents.
fn driven(folder: &Path, coil: usize, output: usize, f: f64) -> f64 {
    let mut text = "t_s,x_a,y_a,z_a\r\n".to_owned();
    for k in 0..60 * 30 {
        let t = f64::from(k) / 60.0;
        let mut now = ABOUT_A;
        now[coil] += 1e-3 * (TAU * f * t).sin();
        let _ = write!(text, "{t:.9},{},{},{}\r\n", now[0], now[1], now[2]);
    }
    std::fs::write(folder.join("sine.csv"), text).unwrap();
    good(&catoptra(folder, &["catheter", "run", "sine.csv", "-o", "sine_run.csv"]));
    let table = std::fs::read_to_string(folder.join("sine_run.csv")).unwrap();
    let names: Vec<&str> = table.lines().next().unwrap().split(',').collect();
    let at = |name: &str| names.iter().position(|own| *own == name).unwrap();
    let places = [at("t_s"), at(["tan_x", "tan_y"][output]), at("tan_z")];
    let (mut sum, mut count) = (Complex::new(0.0, 0.0), 0.0);
    // Ten whole seconds, after what is left of the way there has gone.
    for row in table.lines().skip(1) {
        let cells: Vec<&str> = row.split(',').collect();
        let [t, across, along] = places.map(|place| cells[place].parse::<f64>().unwrap());
        if (20.0..30.0 - 1e-6).contains(&t) {
            sum += Complex::from_polar(1.0, -TAU * f * t) * across.atan2(along).to_degrees();
            count += 1.0;
        }
    }
    (sum * 2.0 / count).norm() / 1e-3
}

#[test]
fn both_angles_follow_all_coils_and_the_linearised_rod_agrees() {
    let folder = tempfile::tempdir().unwrap();
    for (name, phase, seed) in [("fitted", 0.7, "1"), ("judging", 1.9, "2")] {
        let table = format!("{name}_currents.csv");
        currents(&folder.path().join(&table), phase);
        let run = ["catheter", "run", &table, "--noise", "0.02,0.06", "--missing", "2", "--seed", seed];
        good(&catoptra(folder.path(), &[&run[..], &["-o", &format!("{name}.csv")]].concat()));
        without_the_way_there(&folder.path().join(format!("{name}.csv")));
    }
    let known = ["--currents", "fitted_currents.csv,judging_currents.csv", "--validate", "judging.csv"];
    let args = [&["identify", "fitted.csv", "--planes", "--order", "1:8"], &known[..], &["-o", "out"]].concat();
    let printed = good(&catoptra(folder.path(), &args));
    println!("{printed}");
    let read = |name: &str| std::fs::read_to_string(folder.path().join("out").join(name)).unwrap();
    let model: serde_json::Value = serde_json::from_str(&read("model.json")).unwrap();
    // The coil that never moves is no input.
    assert_eq!(model["inputs"], serde_json::json!(["y_a", "z_a"]));
    let judged = &model["records"][1];
    assert_eq!(judged["fitted"], false);
    // Noise alone is 0.2 and 2.7 %; the rest across B0 is what is not linear there.
    for kind in ["full", "reduced"] {
        for (output, limit) in [(0, 2.0), (1, 12.0)] {
            let percent = judged["error_percent"][kind][output].as_f64().unwrap();
            assert!(percent < limit, "{kind} {output}: {percent} %");
        }
    }
    assert!(model["reduced"]["a"].as_array().unwrap().len() <= 8, "few states do");
    // The response beside that of the catheter to a small sine of one coil.
    let rows: Vec<Vec<String>> =
        read("response.csv").lines().map(|l| l.split(',').map(str::to_owned).collect()).collect();
    for (coil, column, angle, output) in [("y_a", 1, "theta_y", 1), ("z_a", 2, "theta_x", 0)] {
        for f in [0.2, 1.0] {
            let of = |row: &&Vec<String>| row[1] == coil && row[2] == angle;
            let near = |row: &&Vec<String>| (row[0].parse::<f64>().unwrap() / f).ln().abs();
            let row = rows.iter().skip(1).filter(of).min_by(|a, b| near(a).total_cmp(&near(b))).unwrap();
            let (found, expected): (f64, f64) = (row[5].parse().unwrap(), driven(folder.path(), column, output, f));
            assert!((found / expected - 1.0).abs() < 0.15, "{coil}, {f} Hz: {found} °/A, the catheter {expected}");
        }
    }
    // A record that was fitted cannot judge, nor count twice; and these currents are no amperes.
    let currents = std::fs::read_to_string(folder.path().join("fitted_currents.csv")).unwrap();
    let head = currents.lines().next().unwrap_or_default();
    let in_ma = currents.lines().skip(1).map(|line| {
        let (t, values) = line.split_once(',').unwrap();
        let values: Vec<String> = values.split(',').map(|a| (a.parse::<f64>().unwrap() * 1e3).to_string()).collect();
        format!("{t},{}\n", values.join(","))
    });
    std::fs::write(folder.path().join("ma.csv"), format!("{head}\n{}", in_ma.collect::<String>())).unwrap();
    let again = |records: &[&str], tables: &str| {
        let folder_of_this = records.join("_").replace('.', "_");
        let options = ["--planes", "--order", "4", "--currents", tables, "-o", folder_of_this.as_str()];
        let args = [&["identify"], records, &options];
        let output = catoptra(folder.path(), &args.concat());
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, told) = again(&["fitted.csv", "--validate", "fitted.csv"], "ma.csv,ma.csv");
    assert!(code == Some(0) && told.contains("is used both to fit and to validate"), "{told}");
    assert!(told.contains("ma.csv: holds currents of up to ") && told.contains("are these mA?"), "{told}");
    let (code, told) = again(&["fitted.csv", "fitted.csv"], "ma.csv,ma.csv");
    assert!(code == Some(2) && told.contains("which would count twice"), "{told}");
    let page = read("report.html");
    assert!(page.contains("plot-response-theta_y") && page.contains("plot-0-theta_x") && page.contains("plot-hankel"));
}

#[test]
fn what_both_planes_cannot_be_told_from_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let still = "t_s,y_a,z_a\r\n0,0.01,0.02\r\n1,0.02,0.04\r\n2,0.015,0.03\r\n";
    std::fs::write(folder.path().join("still.csv"), still).unwrap();
    let run = ["catheter", "run", "still.csv", "--coils", "-,y_a,z_a", "--duration", "3s", "-o", "run.csv"];
    good(&catoptra(folder.path(), &run));
    let identify = |more: &[&str]| {
        let args = ["identify", "run.csv", "--planes", "--currents", "still.csv", "-o", "out"];
        catoptra(folder.path(), &[&args[..], more].concat())
    };
    let refused = |output: &Output, what: &str| {
        let printed = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(matches!(output.status.code(), Some(2 | 3)) && printed.contains(what), "{printed}");
    };
    refused(&identify(&["--nk", "0"]), "a current cannot act before it flows");
    refused(&identify(&["--nk", "2:5"]), "the delay is not searched");
    for other in [&["--plant", "plant.toml"][..], &["--detrend", "linear"], &["--nb", "3"], &["--match-dc"]] {
        refused(&identify(other), "cannot be used with");
    }
    std::fs::write(folder.path().join("run.toml"), "frame = \"camera\"\n").unwrap();
    refused(&identify(&[]), "tangents are in the camera frame");
    std::fs::remove_file(folder.path().join("run.toml")).unwrap();
    // The currents step together.
    refused(&identify(&["--order", "6"]), "do not tell the coils apart");
    assert!(!folder.path().join("out").exists());
}
