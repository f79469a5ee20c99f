//! Every example printed by a `--help` runs exactly as printed, in a folder with the sample.

#![cfg(unix)]

use std::path::Path;
use std::process::Command;
use std::time::Instant;

fn help(words: &[String]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    let output = command.args(words).arg("--help").output().unwrap();
    assert!(output.status.success(), "{words:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// Names of the commands that a help lists.
fn commands(help: &str) -> Vec<String> {
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let names = listed.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    names.filter_map(|line| line.split_whitespace().next()).filter(|name| *name != "help").map(str::to_owned).collect()
}

/// All helps, each before those of its own commands, in the order they list them.
fn all_helps(words: &[String], helps: &mut Vec<String>) {
    let own = help(words);
    let commands = commands(&own);
    helps.push(own);
    for command in commands {
        all_helps(&[words, &[command]].concat(), helps);
    }
}

/// The command that stands after `Example:`, on one line.
fn example(help: &str) -> String {
    let (_, after) = help.split_once("Example:\n").unwrap();
    after.split("\n\n").next().unwrap().replace("\\\n", " ")
}

#[test]
fn every_example_of_every_help_runs_as_printed() {
    let mut helps = Vec::new();
    all_helps(&[], &mut helps);
    assert!(helps.len() >= 12, "{} helps", helps.len());
    let folder = tempfile::tempdir().unwrap();
    for part in ["calibration", "sample_dynamics", "sample_frames", "tests"] {
        let there = Path::new(env!("CARGO_MANIFEST_DIR")).join(part);
        std::os::unix::fs::symlink(there, folder.path().join(part)).unwrap();
    }
    let program = Path::new(env!("CARGO_BIN_EXE_catoptra")).parent().unwrap();
    let path = std::env::join_paths(
        [program.to_path_buf()].into_iter().chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    );
    let mut done: Vec<String> = Vec::new();
    for example in helps.iter().map(|help| example(help)) {
        if done.contains(&example) {
            continue;
        }
        let began = Instant::now();
        let mut shell = Command::new("sh");
        let output = shell
            .current_dir(folder.path())
            .env("PATH", path.as_ref().unwrap())
            .args(["-c", &example])
            .output()
            .unwrap();
        let printed = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{example}\n{printed}");
        println!(
            "{:.1} s: {}",
            began.elapsed().as_secs_f64(),
            example.split_whitespace().collect::<Vec<_>>().join(" ")
        );
        done.push(example);
    }
}
