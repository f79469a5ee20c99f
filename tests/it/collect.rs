//! `catoptra collect`: the tables have the runs' numbers, and the page links to their reports.

use crate::support::command::*;
use parquet::file::reader::SerializedFileReader;
use parquet::record::{Field, Row};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::Path;
use std::process::Command;

fn rows(path: &Path) -> Vec<BTreeMap<String, Field>> {
    let cells = |row: Row| row.into_columns().into_iter().collect();
    SerializedFileReader::new(File::open(path).unwrap()).unwrap().into_iter().map(|row| cells(row.unwrap())).collect()
}

fn text(field: &Field) -> &str {
    match field {
        Field::Str(text) => text,
        other => panic!("{other:?} is not text"),
    }
}

#[test]
fn all_frames_and_all_runs_are_in_the_tables_with_the_columns_of_the_manifest() {
    let place = Place::new();
    let run = |words: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        command.current_dir(place.folder.path()).args(words.split_whitespace()).output().unwrap()
    };
    let [rest, circle] = ["rest.mkv", "circle.mkv"].map(sample);
    fs::write(place.path("bad.mkv"), "no video").unwrap();
    let manifest = format!(
        "recording,site,frames,options\n{},north,of spring,--to 0.02\n{},south,,--from 0.1 --to 0.13\n\
         bad.mkv,south,,\n",
        rest.display(),
        circle.display()
    );
    fs::write(place.path("runs.csv"), manifest).unwrap();
    ended_with(&run("track --manifest runs.csv --rig rig.toml -o archive/runs --jobs 2"), 1);
    // A run of its own, and one that was begun and not finished.
    ended_with(&run(&format!("track {} --rig rig.toml -o archive/more/alone --to 0", rest.display())), 0);
    fs::create_dir(place.path("archive/cut")).unwrap();
    fs::write(place.path("archive/cut/track.csv"), "seq,t_s\r\n").unwrap();
    let output = run("collect archive -o study");
    let said = ended_with(&output, 0);
    assert!(said.contains("archive/cut: has no summary.json"), "{said}");
    assert!(stdout(&output).contains("4 runs, 5 frames"), "{}", stdout(&output));
    assert!(stdout(&output).contains("bad failed (will not pass): bad.mkv"), "{}", stdout(&output));

    let frames = rows(&place.path("study/frames.parquet"));
    let mut at = 0;
    for (name, folder, site) in
        [("alone", "more/alone", None), ("circle", "runs/circle", Some("south")), ("rest", "runs/rest", Some("north"))]
    {
        for expected in Table::read(&place.path("archive").join(folder).join("track.csv")).rows {
            let found = &frames[at];
            assert_eq!(text(&found["run"]), name);
            match site {
                Some(site) => assert_eq!(text(&found["site"]), site),
                None => assert_eq!(found["site"], Field::Null),
            }
            for (column, cell) in &expected {
                match &found[column] {
                    Field::Null => assert_eq!(cell, "", "{column}"),
                    Field::Str(text) => assert_eq!(cell, text, "{column}"),
                    Field::Long(number) => assert_eq!(cell.parse::<i64>().unwrap(), *number, "{column}"),
                    Field::Double(number) => assert_eq!(cell.parse::<f64>().unwrap(), *number, "{column}"),
                    other => panic!("{column} is {other:?}"),
                }
            }
            assert_eq!(found["veto"], Field::Null);
            assert_eq!(text(&found["frame"]), "base");
            assert_eq!(found.len(), expected.len() + 5);
            at += 1;
        }
    }
    assert_eq!(frames.len(), at);

    let runs = rows(&place.path("study/runs.parquet"));
    let names: Vec<&str> = runs.iter().map(|run| text(&run["run"])).collect();
    assert_eq!(names, ["alone", "bad", "circle", "rest"]);
    assert_eq!((text(&runs[1]["outcome"]), &runs[1]["retryable"]), ("failed", &Field::Bool(false)));
    assert_eq!((&runs[1]["frames"], &runs[3]["frames"]), (&Field::Null, &Field::Long(2)));
    // A column of the manifest never takes the place of ours.
    assert_eq!(text(&runs[3]["manifest_frames"]), "of spring");
    assert_eq!(text(&frames[at - 1]["frames"]), "of spring");
    let summary = fs::read_to_string(place.path("archive/runs/rest/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    let sd = summary["measured"]["theta"]["sd_deg"].as_f64().unwrap();
    assert_eq!(runs[3]["theta_sd_deg"], Field::Double(sd));

    let page = fs::read_to_string(place.path("study/report.html")).unwrap();
    assert!(page.contains("<a class=\"why\" href=\"../archive/runs/circle/report.html\">circle</a>"));
    assert!(page.contains("is not a video that can be read") && page.contains("archive/cut: has no summary.json"));

    // Again: the same tables; and never in the place of something else.
    let before = ["frames", "runs"].map(|name| fs::read(place.path(&format!("study/{name}.parquet"))).unwrap());
    ended_with(&run("collect archive -o study"), 0);
    let after = ["frames", "runs"].map(|name| fs::read(place.path(&format!("study/{name}.parquet"))).unwrap());
    assert!(before == after);
    let said = ended_with(&run("collect archive -o archive/runs/rest"), 2);
    assert!(said.contains("has the results of `catoptra track"), "{said}");
    let said = ended_with(&run("collect study -o other"), 2);
    assert!(said.contains("no summary.json in it or below"), "{said}");

    // A table that lost its last row does not stop the others, and does not pass for a shorter run.
    let table = place.path("archive/runs/circle/track.csv");
    let whole = fs::read_to_string(&table).unwrap();
    let kept: Vec<&str> = whole.split_inclusive('\n').collect();
    fs::write(&table, kept[..kept.len() - 1].concat()).unwrap();
    let output = run("collect archive -o study");
    let said = ended_with(&output, 1);
    assert!(said.contains("circle/track.csv:2: the table has 1 row, summary.json counts 2"), "{said}");
    assert!(said.contains("1 run cannot be read, and is left out"), "{said}");
    assert!(stdout(&output).contains("3 runs, 3 frames"), "{}", stdout(&output));
    let page = fs::read_to_string(place.path("study/report.html")).unwrap();
    assert!(page.contains("the table has 1 row, summary.json counts 2"));
    let said = ended_with(&run("collect archive/runs/circle -o none"), 2);
    assert!(said.contains("no run can be read") && !place.path("none").exists(), "{said}");

    // A rig that was changed under its name is another.
    ended_with(&run(&format!("track {} --rig rig.toml -o two/a --to 0", rest.display())), 0);
    let rig = fs::read_to_string(place.path("rig.toml")).unwrap();
    fs::write(place.path("rig.toml"), rig + "\n# again\n").unwrap();
    ended_with(&run(&format!("track {} --rig rig.toml -o two/b --to 0", rest.display())), 0);
    ended_with(&run("collect two -o both"), 0);
    let page = fs::read_to_string(place.path("both/report.html")).unwrap();
    assert_eq!(page.matches("rig.toml (sha256 ").count(), 2);
}
