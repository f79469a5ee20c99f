//! What is found in an archive, and its tables.

use super::study::{Study, StudyError};
use super::{FileRecord, Outcome, RunSummary, hash};
use crate::log::schema::{LOG_FILE, TABLE_FILE, table};
use parquet::file::reader::SerializedFileReader;
use parquet::record::RowAccessor as _;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// The header of a run with a marker, and three rows.
fn track(marker: &str) -> String {
    let header = table::header([marker].into_iter(), false);
    let mut text = header.join(",") + "\r\n";
    for seq in 0..3 {
        let cells = header.iter().map(|name| match name.as_str() {
            "seq" | "stamp_ns" => seq.to_string(),
            "gap" => "0".to_owned(),
            name if name.ends_with("_status") => "ok".to_owned(),
            _ => format!("{seq}.5"),
        });
        let _ = write!(text, "{}\r\n", cells.collect::<Vec<_>>().join(","));
    }
    text
}

fn summary(name: &str, marker: &str, frame: &str) -> RunSummary {
    let mut summary = RunSummary { name: name.to_owned(), ..RunSummary::example() };
    let measured = summary.measured.as_mut().unwrap();
    (measured.frames, measured.markers[0].name) = (3, marker.to_owned());
    summary.options = [("frame".to_owned(), frame.to_owned())].into();
    summary
}

fn save(archive: &Path, summary: &RunSummary, track: &str) {
    let folder = archive.join(&summary.name);
    fs::create_dir_all(&folder).unwrap();
    summary.write(&folder).unwrap();
    fs::write(folder.join(TABLE_FILE), track).unwrap();
}

/// The good run's name and its number of frames in the table, and why the other is left out.
fn collected(spoil: impl Fn(&str) -> String) -> (Vec<String>, u64, Vec<String>) {
    let archive = tempfile::tempdir().unwrap();
    save(archive.path(), &summary("good", "tip", "base"), &track("tip"));
    save(archive.path(), &summary("other", "tip", "base"), &spoil(&track("tip")));
    let study = Study::find(&[archive.path().to_owned()], || Ok(())).unwrap();
    let (frames, _) = study.write_frames(&archive.path().join("frames.parquet"), || Ok(())).unwrap();
    let names = study.runs.iter().map(|run| run.name.clone()).collect();
    let why = study.left_out.iter().map(|error| error.to_string().rsplit_once('/').unwrap().1.to_owned());
    (names, frames, why.collect())
}

#[test]
fn a_table_that_is_not_the_one_its_summary_describes_leaves_its_run_out() {
    assert_eq!(collected(str::to_owned), (vec!["good".to_owned(), "other".to_owned()], 6, Vec::new()));
    // Line ends, and columns of later versions, are no damage.
    assert_eq!(collected(|text| text.replace("\r\n", "\n")).1, 6);
    assert_eq!(collected(|text| text.replace("0.5", "inf")).0, ["good"]);
    assert_eq!(collected(|text| text.replace("gap\r", "gap,new\r").replace(",0\r", ",0,7\r")).1, 6);
    let lines = |text: &str, range: std::ops::Range<usize>| -> String {
        text.split_inclusive('\n').skip(range.start).take(range.len()).collect()
    };
    type Spoil = Box<dyn Fn(&str) -> String>;
    let cases: [(&str, Spoil); 9] = [
        ("track.csv:3: the table has 2 rows, summary.json counts 3", Box::new(move |text| lines(text, 0..3))),
        ("track.csv:1: the table has 0 rows, summary.json counts 3", Box::new(move |text| lines(text, 0..1))),
        ("track.csv:1: has no column 1, which should be `seq`", Box::new(|_| String::new())),
        (
            "track.csv:5: frame 0 comes after frame 2; their numbers should rise",
            Box::new(move |text| text.to_owned() + &lines(text, 1..4)),
        ),
        ("track.csv:4: has 12 of the header's 17 cells", Box::new(|text| text[..text.len() - 20].to_owned())),
        (
            "track.csv:1: column 8 is `tip_x_m`, it should be `tip_x_mm`",
            Box::new(|text| text.replace("tip_x_mm", "tip_x_m")),
        ),
        (
            "track.csv:1: column 4 is `theta_sd_deg`, it should be `theta_deg`",
            Box::new(|text| text.replacen("theta_deg,", "", 1).replace(".5,ok", ",ok")),
        ),
        ("track.csv:3: theta_deg is 1;5, which is not a number", Box::new(|text| text.replacen(",1,1.5", ",1,1;5", 1))),
        ("track.csv:4: seq is ``, it should be a whole number", Box::new(|text| text.replace("\n2,", "\n,"))),
    ];
    for (reason, spoil) in cases {
        let (names, frames, why) = collected(spoil);
        assert_eq!((names.as_slice(), frames), (["good".to_owned()].as_slice(), 3), "{reason}");
        assert!(why.len() == 1 && why[0].starts_with(reason), "{reason}: {why:?}");
    }
}

#[test]
fn a_table_with_other_numbers_than_were_hashed_leaves_its_run_out() {
    let archive = tempfile::tempdir().unwrap();
    let mut run = summary("run", "tip", "base");
    let table = track("tip");
    run.files = vec![FileRecord {
        name: TABLE_FILE.to_owned(),
        bytes: table.len() as u64,
        sha256: Some(hash::of_bytes(table.as_bytes())),
    }];
    save(archive.path(), &run, &table);
    let find = || Study::find(&[archive.path().to_owned()], || Ok(())).unwrap();
    assert_eq!((find().runs.len(), find().left_out.len()), (1, 0));
    save(archive.path(), &run, &table.replace("1.5", "1.6"));
    let study = find();
    assert_eq!((study.runs.len(), study.left_out.len()), (0, 1));
    let why = study.left_out[0].to_string();
    assert!(why.contains("run/track.csv: was changed since it was written"), "{why}");
}

#[test]
fn a_run_counts_once_however_often_its_folder_is_named() {
    let archive = tempfile::tempdir().unwrap();
    for name in ["day1/a", "day1/b", "day2/c"] {
        save(archive.path(), &summary(name, "tip", "base"), &track("tip"));
    }
    fs::create_dir(archive.path().join("unfinished")).unwrap();
    fs::write(archive.path().join("unfinished").join(LOG_FILE), "").unwrap();
    let named = ["day1/b", "day1/../day1/b", "day1", "", "unfinished"].map(|name| archive.path().join(name));
    let study = Study::find(&named, || Ok(())).unwrap();
    let mut names: Vec<&str> = study.runs.iter().map(|run| run.name.as_str()).collect();
    names.sort_unstable();
    assert_eq!((names, study.unfinished.len()), (vec!["day1/a", "day1/b", "day2/c"], 1));
}

#[test]
fn the_table_of_a_run_without_space_may_end_early() {
    let archive = tempfile::tempdir().unwrap();
    let mut full = summary("full", "tip", "base");
    full.measured.as_mut().unwrap().frames = 4;
    full.outcome = Outcome::Failed;
    save(archive.path(), &full, &track("tip"));
    assert_eq!(Study::find(&[archive.path().to_owned()], || Ok(())).unwrap().runs.len(), 1);
    full.outcome = Outcome::Tracked;
    save(archive.path(), &full, &track("tip"));
    assert_eq!(Study::find(&[archive.path().to_owned()], || Ok(())).unwrap().left_out.len(), 1);
}

#[test]
#[cfg(unix)]
fn runs_are_found_deep_down_behind_links_and_below_other_runs_and_what_is_too_deep_is_told() {
    use std::os::unix::fs::symlink;
    let archive = tempfile::tempdir().unwrap();
    let put = |place: &str, name: &str| {
        let folder = archive.path().join(place);
        fs::create_dir_all(&folder).unwrap();
        save(&folder, &summary(name, "tip", "base"), &track("tip"));
    };
    put("all/site/2026/11/26/rig/day", "deep");
    put("all", "outer");
    put("all/outer/again", "inner");
    put("disk", "linked");
    put(&format!("all{}", "/d".repeat(16)), "too deep");
    symlink(archive.path().join("disk"), archive.path().join("all/link")).unwrap();
    symlink(archive.path().join("disk/linked"), archive.path().join("all/link to run")).unwrap();
    symlink(archive.path().join("all"), archive.path().join("all/site/circle")).unwrap();
    symlink(archive.path().join("nowhere"), archive.path().join("all/broken")).unwrap();
    let study = Study::find(&[archive.path().join("all")], || Ok(())).unwrap();
    let mut names: Vec<&str> = study.runs.iter().map(|run| run.name.as_str()).collect();
    names.sort_unstable();
    assert_eq!(names, ["deep", "inner", "linked", "outer"]);
    assert_eq!(study.too_deep, [archive.path().join(format!("all{}/too deep", "/d".repeat(16)))]);
}

#[test]
fn every_row_tells_its_frame_of_reference_and_rigs_have_their_own_markers() {
    let archive = tempfile::tempdir().unwrap();
    save(archive.path(), &summary("a", "tip", "base"), &track("tip"));
    save(archive.path(), &summary("b", "ring", "base"), &track("ring"));
    let find = || Study::find(&[archive.path().to_owned()], || Ok(())).unwrap();
    let of_frames = |study: &Study| study.cautions().into_iter().find(|said| said.contains("frames of reference"));
    assert_eq!(of_frames(&find()), None);
    save(archive.path(), &summary("c", "tip", "camera"), &track("tip"));
    let study = find();
    let said = of_frames(&study).unwrap();
    assert!(said.contains("(base frame in 2 runs, camera frame in 1 run)"), "{said}");
    let table = archive.path().join("frames.parquet");
    let (count, new) = study.write_frames(&table, || Ok(())).unwrap();
    new.put_in_place().unwrap();
    assert_eq!(count, 9);
    let rows = SerializedFileReader::new(fs::File::open(&table).unwrap()).unwrap();
    let frames: Vec<String> = rows.into_iter().map(|row| row.unwrap().get_string(1).unwrap().clone()).collect();
    assert_eq!(frames, ["base", "base", "base", "base", "base", "base", "camera", "camera", "camera"]);
}

#[test]
fn an_interrupted_study_leaves_what_was_there() {
    let archive = tempfile::tempdir().unwrap();
    let place = tempfile::tempdir().unwrap();
    save(archive.path(), &summary("a", "tip", "base"), &track("tip"));
    save(archive.path(), &summary("b", "tip", "base"), &track("tip"));
    let table = place.path().join("frames.parquet");
    fs::write(&table, "earlier").unwrap();
    let study = Study::find(&[archive.path().to_owned()], || Ok(())).unwrap();
    let mut runs = 0;
    let after_run = || {
        runs += 1;
        Err(StudyError::Interrupted)
    };
    assert!(matches!(study.write_frames(&table, after_run), Err(StudyError::Interrupted)));
    assert_eq!((runs, fs::read_to_string(&table).unwrap().as_str()), (1, "earlier"));
    // Nor is a whole one in its place before it is put there.
    let new = study.write_frames(&table, || Ok(())).unwrap();
    assert_eq!(fs::read_to_string(&table).unwrap(), "earlier");
    drop(new);
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
}

#[test]
fn copies_other_builds_and_tables_elsewhere_are_told() {
    let archive = tempfile::tempdir().unwrap();
    let mut first = summary("a", "tip", "base");
    first.sha256.recording = Some("r".to_owned());
    save(archive.path(), &first, &track("tip"));
    let find = || Study::find(&[archive.path().to_owned()], || Ok(())).unwrap();
    assert_eq!(find().cautions(), Vec::<String>::new());
    let copy = RunSummary { name: "b".to_owned(), ..first.clone() };
    save(archive.path(), &copy, &track("tip"));
    let said = find().cautions();
    assert!(
        matches!(&said[..], [one] if one.contains("1 run of the same recording (or live), rig and options")),
        "{said:?}"
    );
    let mut other = RunSummary { name: "b".to_owned(), version: "0.0.1".to_owned(), ..first };
    other.sha256.recording = Some("s".to_owned());
    other.files.retain(|file| file.name != "track.csv");
    save(archive.path(), &other, &track("tip"));
    let said = find().cautions();
    assert!(
        matches!(&said[..], [builds, tables] if builds.contains("2 different builds")
            && tables.contains("the table of 1 run was written elsewhere")),
        "{said:?}"
    );
}

#[test]
fn copies_of_live_runs_are_known_by_their_tables() {
    let archive = tempfile::tempdir().unwrap();
    let said = |second: &str| {
        for (name, table) in [("a", track("tip")), ("b", second.to_owned())] {
            let mut run = summary(name, "tip", "base");
            run.sha256.recording = None;
            let (bytes, sha256) = (table.len() as u64, Some(hash::of_bytes(table.as_bytes())));
            run.files = vec![FileRecord { name: TABLE_FILE.to_owned(), bytes, sha256 }];
            save(archive.path(), &run, &table);
        }
        Study::find(&[archive.path().to_owned()], || Ok(())).unwrap().cautions()
    };
    assert_eq!(said(&track("tip").replace("1.5", "1.6")), Vec::<String>::new());
    let said = said(&track("tip"));
    assert!(matches!(&said[..], [one] if one.contains("1 run of the same recording (or live)")), "{said:?}");
}

#[test]
fn a_column_of_the_manifest_never_takes_the_name_of_another() {
    let archive = tempfile::tempdir().unwrap();
    let mut run = summary("run", "tip", "base");
    let given = [("run", "mine"), ("manifest_run", "other"), ("gain", "3")];
    run.manifest = given.map(|(name, cell)| (name.to_owned(), cell.to_owned())).into();
    save(archive.path(), &run, &track("tip"));
    let path = archive.path().join("runs.parquet");
    Study::find(&[archive.path().to_owned()], || Ok(())).unwrap().write_runs(&path).unwrap().put_in_place().unwrap();
    let reader = SerializedFileReader::new(fs::File::open(path).unwrap()).unwrap();
    let row = reader.into_iter().next().unwrap().unwrap();
    let cells: std::collections::BTreeMap<_, _> =
        row.get_column_iter().map(|(n, c)| (n.clone(), c.to_string())).collect();
    assert_eq!(cells.len(), row.len());
    let cell = |name: &str| cells[name].trim_matches('"').to_owned();
    assert_eq!(["run", "manifest_manifest_run", "manifest_run", "gain"].map(cell), ["run", "mine", "other", "3"]);
}
