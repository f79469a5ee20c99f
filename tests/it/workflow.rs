//! `workflow/`: shards of a manifest through the Slurm script and Snakemake, on this machine.

#![cfg(unix)]

use crate::support::python;
use crate::support::{command::*, skipped};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn tree() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn manifest(place: &Place) {
    let samples = sample("");
    let samples = samples.to_str().unwrap().trim_end_matches('/');
    fs::write(place.path("bad.mkv"), "no video").unwrap();
    let lines = format!(
        "recording\tsite\toptions\n{samples}/rest.mkv\tA\t--to 0\n{samples}/circle.mkv\tB\t--to 0\nbad.mkv\tB\t\n"
    );
    fs::write(place.path("runs.tsv"), lines).unwrap();
}

fn shards(python: &str, place: &Place, words: &[&str]) -> Output {
    let script = tree().join("workflow/shards.py");
    Command::new(python).current_dir(place.folder.path()).arg(script).args(words).output().unwrap()
}

#[test]
fn shards_have_all_lines_and_mistakes_are_told_with_theirs() {
    let Some(python) = python::interpreter_with(&["csv"]) else { return };
    let place = Place::new();
    manifest(&place);
    let output = shards(&python, &place, &["split", "runs.tsv", "--into", "shards", "--size", "2"]);
    assert_eq!(ended_with(&output, 0) + &stdout(&output), "2\n");
    assert_eq!(names(&place.path("shards")), ["0000.tsv", "0001.tsv"]);
    let second = fs::read_to_string(place.path("shards/0001.tsv")).unwrap();
    let bad = place.path("bad.mkv");
    assert_eq!(second, format!("recording\tsite\toptions\tname\n{}\tB\t\tbad\n", bad.display()));
    // What would be the same stays untouched.
    let made = fs::metadata(place.path("shards/0000.tsv")).unwrap().modified().unwrap();
    ended_with(&shards(&python, &place, &["split", "runs.tsv", "--into", "shards", "--size", "2"]), 0);
    assert_eq!(fs::metadata(place.path("shards/0000.tsv")).unwrap().modified().unwrap(), made);

    for (text, part) in [
        (&b"video\nx\n"[..], "wrong.tsv:1: no column `recording`"),
        (b"recording\na/x.mkv\nb/x.mkv\n", "wrong.tsv:3: the name 'x' is that of line 2 already"),
        (b"recording\tsite\na\n", "wrong.tsv:2: 1 cells"),
        (b"recording\na\n\xff\n", "wrong.tsv:3: is not text in UTF-8"),
    ] {
        fs::write(place.path("wrong.tsv"), text).unwrap();
        let said = ended_with(&shards(&python, &place, &["split", "wrong.tsv", "--into", "no"]), 2);
        assert!(said.contains(part), "{said}");
    }
}

#[test]
fn the_script_of_the_job_array_settles_a_shard_and_tries_again_what_may_pass() {
    let Some(python) = python::interpreter_with(&["csv"]) else { return };
    let place = Place::new();
    manifest(&place);
    ended_with(&shards(&python, &place, &["split", "runs.tsv", "--into", "shards", "--size", "5"]), 0);
    let array = || {
        let mut command = Command::new("bash");
        command.current_dir(place.folder.path()).arg(tree().join("workflow/slurm_array.sh"));
        command.args(["shards", "runs", "--rig", "rig.toml"]);
        command.envs([("SLURM_ARRAY_TASK_ID", "0"), ("SLURM_CPUS_PER_TASK", "2"), ("CATOPTRA_PAUSE_S", "0")]);
        command.env("CATOPTRA", env!("CARGO_BIN_EXE_catoptra")).env("SLURM_SUBMIT_DIR", tree());
        command.output().unwrap()
    };
    let said = ended_with(&array(), 0);
    assert!(said.contains("error: bad: bad.mkv") || said.contains("bad.mkv: is not a video"), "{said}");
    assert_eq!(names(&place.path("runs")), ["bad", "circle", "rest"]);
    // A disk that was full: done again, and that alone.
    let summary = place.path("runs/rest/summary.json");
    let text = fs::read_to_string(&summary).unwrap();
    let failed = text.replace(r#""failure": null"#, r#""failure": {"message": "disk full", "retryable": true}"#);
    fs::write(&summary, failed).unwrap();
    let wanting = shards(&python, &place, &["settle", "shards/0000.tsv", "runs"]);
    assert_eq!(ended_with(&wanting, 1), "rest: disk full\n");
    ended_with(&array(), 0);
    assert!(fs::read_to_string(&summary).unwrap().contains(r#""failure": null"#));
}

/// Snakemake 9, in the program named by `CATOPTRA_SNAKEMAKE`. The larger trial, which kills it, is
/// `scripts/batch_trial.sh`.
#[test]
fn snakemake_takes_a_manifest_to_tables() {
    let Some(snakemake) = std::env::var_os("CATOPTRA_SNAKEMAKE") else {
        skipped("CATOPTRA_SNAKEMAKE does not name Snakemake 9");
        return;
    };
    let place = Place::new();
    manifest(&place);
    fs::rename(place.path("rig.toml"), place.path("the rig.toml")).unwrap();
    let config = [
        "manifest=runs.tsv".to_owned(),
        "rig=the rig.toml".to_owned(),
        "shard_size=2".to_owned(),
        format!("catoptra={}", env!("CARGO_BIN_EXE_catoptra")),
    ];
    let flow = || {
        let mut command = Command::new(Path::new(&snakemake));
        command.current_dir(place.folder.path()).arg("-s").arg(tree().join("workflow/Snakefile"));
        command.args(["--cores", "2", "--config"]).args(&config).output().unwrap()
    };
    ended_with(&flow(), 0);
    assert_eq!(names(&place.path("study")), ["frames.parquet", "report.html", "run.toml", "runs.parquet"]);
    assert_eq!(names(&place.path("runs")), ["bad", "circle", "rest"]);
    let again = flow();
    assert!(ended_with(&again, 0).contains("Nothing to be done"), "{}", stderr(&again));
}
