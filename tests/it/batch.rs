//! Many recordings in one command: `track --manifest`, `--resume`, and other files beside the results.

use crate::support::{command::*, skipped};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

/// A folder with the sample's rig and a manifest; the command is run in it.
struct Archive(Place);

/// Three short runs that work, an unreadable one and one of another size.
const LINES: &str = "\
rest\tA\tSAMPLES/rest.mkv\t--to 0.02
circle\tB\tSAMPLES/circle.mkv\t--from 0.1 --to 0.13 --frame camera
unread\tB\tunread.mkv\t
none\tA\tnone.mkv\t
planar\tA\tSAMPLES/planar.mkv\t--to 0.02
";

impl Archive {
    fn new() -> Self {
        Self::with(LINES)
    }

    fn with(lines: &str) -> Self {
        let archive = Self(Place::new());
        fs::write(archive.path("unread.mkv"), "no video").unwrap();
        let samples = sample("");
        let lines = lines.replace("SAMPLES", samples.to_str().unwrap().trim_end_matches('/'));
        fs::write(archive.path("runs.tsv"), format!("name\tsite\trecording\toptions\n{lines}")).unwrap();
        archive
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path(name)
    }

    fn command(&self, words: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        command.current_dir(self.0.folder.path()).args(words.split_whitespace());
        command
    }

    fn run(&self, words: &str) -> Output {
        self.command(words).output().unwrap()
    }

    /// `track --manifest runs.tsv --rig rig.toml -o runs`, and more.
    fn track(&self, words: &str) -> Output {
        self.run(&format!("track --manifest runs.tsv --rig rig.toml -o runs {words}"))
    }

    fn summary(&self, run: &str) -> serde_json::Value {
        let text = fs::read_to_string(self.path("runs").join(run).join("summary.json")).unwrap();
        serde_json::from_str(&text).unwrap()
    }

    /// Names of the runs that a dry run would do, each with the reason.
    fn planned(&self, words: &str) -> BTreeMap<String, String> {
        let output = self.track(&format!("--dry-run --resume {words}"));
        ended_with(&output, 0);
        let printed = stdout(&output);
        let lines = printed.lines().filter_map(|line| line.strip_prefix("track\t")?.split_once('\t'));
        lines.map(|(name, why)| (name.to_owned(), why.to_owned())).collect()
    }
}

/// All files below a folder without what tells the time of day, by their names.
fn timeless(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).unwrap().map(Result::unwrap) {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let mut bytes = fs::read(&path).unwrap();
            if path.ends_with("summary.json") {
                let mut summary: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
                let times = ["finished", "elapsed_s"].map(|name| summary.as_object_mut().unwrap().remove(name));
                assert!(times.iter().all(Option::is_some));
                bytes = summary.to_string().into_bytes();
            } else if path.ends_with("report.html") {
                let text = String::from_utf8(bytes).unwrap();
                let (before, after) = text.split_once("<td>Made</td><td>").unwrap();
                bytes = format!("{before}{}", after.get("2026-11-20 18:23:45 UTC".len()..).unwrap()).into_bytes();
            }
            files.insert(path.strip_prefix(folder).unwrap().to_owned(), bytes);
        }
    }
    files
}

#[test]
fn one_failure_does_not_stop_the_rest_and_each_folder_is_as_if_tracked_alone() {
    let archive = Archive::new();
    let output = archive.track("--jobs 2");
    let said = ended_with(&output, 1);
    assert!(said.contains("error: unread: unread.mkv: is not a video"), "{said}");
    assert!(said.contains("error: none: none.mkv: no such file or folder"), "{said}");
    assert!(said.contains("2 of 5 recordings failed"), "{said}");
    assert!(stdout(&output).contains("3 recordings tracked"), "{}", stdout(&output));

    assert_eq!(names(&archive.path("runs")), ["circle", "none", "planar", "rest", "unread"]);
    let whole = ["log.mcap", "report.html", "run.toml", "summary.json", "track.csv"];
    assert_eq!(names(&archive.path("runs/rest")), whole);
    assert_eq!(names(&archive.path("runs/unread")), ["run.toml", "summary.json"]);

    // Alone, with the same options.
    let alone = archive.run(&format!(
        "track {} --rig rig.toml -o alone --from 0.1 --to 0.13 --frame camera --threads 2",
        sample("circle.mkv").display()
    ));
    ended_with(&alone, 0);
    assert_eq!(estimates(&archive.path("runs/circle/log.mcap")), estimates(&archive.path("alone/log.mcap")));
    for file in ["track.csv", "run.toml"] {
        let [one, other] = ["runs/circle", "alone"].map(|folder| fs::read(archive.path(folder).join(file)).unwrap());
        assert!(one == other, "{file}");
    }
    let [mut one, other] = ["runs/circle", "alone"].map(|folder| {
        let text = fs::read_to_string(archive.path(folder).join("summary.json")).unwrap();
        serde_json::from_str::<serde_json::Value>(&text).unwrap()
    });
    assert_eq!(one["manifest"]["site"], "B");
    for what in ["sha256", "options", "outcome", "recording", "rig", "warnings"] {
        assert_eq!(one[what], other[what], "{what}");
    }
    assert_eq!(one["measured"].take(), other["measured"]);

    let summary = archive.summary("unread");
    assert_eq!((&summary["outcome"], &summary["failure"]["retryable"]), (&"failed".into(), &false.into()));
    assert!(summary["sha256"]["recording"].is_string() && summary["measured"].is_null(), "{summary}");
    assert!(archive.summary("none")["sha256"]["recording"].is_null());
    let summary = archive.summary("planar");
    assert_eq!((&summary["measured"]["frames"], &summary["measured"]["theta"]["answered"]), (&2.into(), &2.into()));
    let rig = fs::read(&archive.0.rig).unwrap();
    let sha256 = |bytes: &[u8]| -> String {
        use sha2::Digest as _;
        sha2::Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
    };
    assert_eq!(summary["sha256"]["rig"], sha256(&rig).as_str());
    assert_eq!(summary["sha256"]["recording"], sha256(&fs::read(sample("planar.mkv")).unwrap()).as_str());
    assert_eq!(summary["sha256"]["program"], sha256(&fs::read(env!("CARGO_BIN_EXE_catoptra")).unwrap()).as_str());
}

#[test]
fn what_is_done_is_left_out_until_something_changes() {
    let archive = Archive::new();
    assert_eq!(archive.planned("").values().collect::<Vec<_>>(), ["new"; 5]);
    assert!(!archive.path("runs").exists(), "a dry run writes nothing");
    ended_with(&archive.track("--jobs 2"), 1);
    assert_eq!(archive.planned(""), BTreeMap::new());
    // Failures that do not pass are not tried again, and are failures still.
    let before = timeless(&archive.path("runs"));
    let again = archive.track("--resume");
    assert!(ended_with(&again, 1).contains("error: none: as before: none.mkv"), "{}", stderr(&again));
    assert!(stdout(&again).contains("3 skipped"), "{}", stdout(&again));
    assert!(timeless(&archive.path("runs")) == before);

    let planned = |name: &str| archive.planned("").remove(name).unwrap_or_else(|| "left out".to_owned());
    // A recording that has come, a file that has gone, a summary that has gone or was cut off.
    fs::copy(sample("rest.mkv"), archive.path("none.mkv")).unwrap();
    assert_eq!(planned("none"), "recording changed");
    fs::remove_file(archive.path("runs/rest/log.mcap")).unwrap();
    assert_eq!(planned("rest"), "log.mcap is gone or changed");
    fs::remove_file(archive.path("runs/planar/summary.json")).unwrap();
    assert_eq!(planned("planar"), "begun and not finished");
    fs::write(archive.path("runs/unread/summary.json"), "{").unwrap();
    assert!(planned("unread").starts_with("its summary cannot be used"), "{}", planned("unread"));
    // A number in a table, without changing its length.
    let table = archive.path("runs/circle/track.csv");
    let written = fs::read_to_string(&table).unwrap();
    fs::write(&table, written.replace(",ok,", ",no,")).unwrap();
    assert_eq!(planned("circle"), "track.csv is gone or changed");
    fs::write(&table, written).unwrap();
    // Another program, and a failure that passes.
    let circle = archive.path("runs/circle/summary.json");
    let text = fs::read_to_string(&circle).unwrap();
    let program = archive.summary("circle")["sha256"]["program"].as_str().unwrap().to_owned();
    fs::write(&circle, text.replace(&program, &"0".repeat(64))).unwrap();
    assert_eq!(planned("circle"), "program changed");
    let failed = r#""failure": {"message": "disk full", "retryable": true}"#;
    fs::write(&circle, text.replace(r#""failure": null"#, failed)).unwrap();
    assert_eq!(planned("circle"), "failed before, may pass now: disk full");
    fs::write(&circle, &text).unwrap();
    assert_eq!(planned("circle"), "left out");
    // Options of all, and the rig.
    assert_eq!(archive.planned("--overlay")["circle"], "options changed");
    let rig = fs::read_to_string(&archive.0.rig).unwrap();
    fs::write(&archive.0.rig, rig + "\n# moved\n").unwrap();
    assert_eq!(planned("circle"), "rig changed");
    assert_eq!(planned("none"), "recording, rig changed");
}

#[test]
fn what_the_manifest_says_of_a_run_is_brought_up_to_date_without_tracking_it() {
    let archive = Archive::with("rest\tA\tSAMPLES/rest.mkv\t--to 0\n");
    ended_with(&archive.track(""), 0);
    let table = fs::metadata(archive.path("runs/rest/track.csv")).unwrap().modified().unwrap();
    let manifest = fs::read_to_string(archive.path("runs.tsv")).unwrap();
    fs::write(archive.path("runs.tsv"), manifest.replace("\tA\t", "\tB\t")).unwrap();
    ended_with(&archive.track("--resume"), 0);
    assert_eq!(archive.summary("rest")["manifest"]["site"], "B");
    assert_eq!(fs::metadata(archive.path("runs/rest/track.csv")).unwrap().modified().unwrap(), table);
}

/// At moments all over the run: while folders are made, while frames are tracked, between summaries.
#[test]
#[cfg(unix)]
fn killed_at_any_time_and_resumed_the_results_are_those_of_an_undisturbed_run() {
    let lines: String = (0..4)
        .map(|k| format!("run{k}\tA\tSAMPLES/circle.mkv\t--from 0.{k}1 --to 0.{k}3\n"))
        .chain(["unread\tB\tunread.mkv\t\n".to_owned()])
        .collect();
    let archive = Archive::with(&lines);
    let began = std::time::Instant::now();
    ended_with(&archive.track("--jobs 2 --resume"), 1);
    let took = began.elapsed();
    fs::rename(archive.path("runs"), archive.path("undisturbed")).unwrap();
    let undisturbed = timeless(&archive.path("undisturbed"));

    let mut killed = 0;
    for part in [0.02, 0.1, 0.3, 0.5, 0.8] {
        let mut command = archive.command("track --manifest runs.tsv --rig rig.toml -o runs --jobs 2 --resume");
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        std::thread::sleep(Duration::from_secs_f64(took.as_secs_f64() * part));
        // SIGKILL.
        child.kill().unwrap();
        killed += usize::from(child.wait().unwrap().code().is_none());
    }
    assert!(killed >= 3, "{killed} killed");
    // What a process that was killed while it wrote a summary leaves behind.
    let torn = archive.path("runs/run0");
    fs::create_dir_all(&torn).unwrap();
    fs::write(torn.join("summary.json.4711.new"), "{\"schema\"").unwrap();
    let _ = fs::remove_file(torn.join("summary.json"));
    ended_with(&archive.track("--jobs 2 --resume"), 1);
    let resumed = timeless(&archive.path("runs"));
    assert_eq!(resumed.keys().collect::<Vec<_>>(), undisturbed.keys().collect::<Vec<_>>());
    for (name, bytes) in &undisturbed {
        assert!(resumed[name] == *bytes, "{}", name.display());
    }
}

#[test]
fn results_of_another_recording_are_not_touched_and_the_rest_goes_on() {
    let archive = Archive::with("rest\tA\tSAMPLES/rest.mkv\t--to 0\ncircle\tA\tSAMPLES/circle.mkv\t--to 0\n");
    ended_with(
        &archive.run(&format!("track {} --rig rig.toml -o runs/rest --to 0", sample("planar.mkv").display())),
        0,
    );
    fs::create_dir(archive.path("runs/circle")).unwrap();
    fs::write(archive.path("runs/circle/track.csv"), "mine").unwrap();
    let before = timeless(&archive.path("runs"));
    let said = ended_with(&archive.track(""), 1);
    assert!(
        said.contains("error: rest: runs/rest: has the results of `catoptra track") && said.contains("planar.mkv"),
        "{said}"
    );
    assert!(said.contains("error: circle: runs/circle: has a track.csv that this command did not write"), "{said}");
    assert!(timeless(&archive.path("runs")) == before);
}

#[test]
fn bad_manifests_and_wrong_usage_are_told_before_anything_is_done() {
    let archive = Archive::new();
    let refused = |manifest: &[u8], part: &str| {
        fs::write(archive.path("runs.tsv"), manifest).unwrap();
        let said = ended_with(&archive.track(""), 2);
        assert!(said.contains(part), "{said}");
        assert!(!archive.path("runs").exists());
    };
    refused(b"video\trig\na\tb\n", "runs.tsv:1: no column `recording`");
    refused(b"recording\tname\na\tx\nb\tx\n", "runs.tsv:3: the name \"x\" is that of line 2 already");
    refused(b"recording\tname\na\t../x\n", "runs.tsv:2: the name \"../x\" leads to another folder");
    refused(b"recording\na\n\xff\n", "runs.tsv:3: is not text in UTF-8");
    refused(b"recording\toptions\na\t--to 1\nb\t--from x\n", "runs.tsv:3: options `--from x`");
    let mut long = b"recording\tname\n".to_vec();
    (0..100_000).for_each(|k| long.extend(format!("a.mkv\tr{k}\n").into_bytes()));
    long.extend(b"a.mkv\tr5\n");
    refused(&long, "runs.tsv:100002: the name \"r5\" is that of line 7 already");
    for (words, part) in [
        ("track a.mkv b.mkv --rig rig.toml", "with -o"),
        ("track d/a.mkv e/a.mkv --rig rig.toml -o runs", "have the same name, a"),
        ("track a.mkv b.mkv --rig rig.toml -o rig.toml", "is a file"),
        ("track a.mkv b.mkv --rig rig.toml -o runs --csv", "--csv is for one recording"),
        ("track a.mkv --manifest runs.tsv -o runs", "cannot be used with"),
        ("track --manifest none.tsv -o runs", "none.tsv: cannot be read"),
    ] {
        let said = ended_with(&archive.run(words), 2);
        assert!(said.contains(part), "{words}: {said}");
    }
}

#[test]
fn a_bad_rig_fails_the_recordings_that_need_it_and_no_others() {
    let archive = Archive::new();
    let (rest, circle) = (sample("rest.mkv"), sample("circle.mkv"));
    fs::write(archive.path("bad.toml"), "[camera").unwrap();
    let manifest =
        format!("recording\trig\toptions\n{}\tbad.toml\t\n{}\trig.toml\t--to 0\n", rest.display(), circle.display());
    fs::write(archive.path("runs.tsv"), manifest).unwrap();
    let said = ended_with(&archive.run("track --manifest runs.tsv -o runs"), 1);
    assert!(said.contains("error: rest: bad.toml"), "{said}");
    let summary = archive.summary("rest");
    assert_eq!((&summary["failure"]["retryable"], &summary["sha256"]["rig"].is_string()), (&false.into(), &true));
    assert_eq!(archive.summary("circle")["outcome"], "tracked");
}

/// As when a disk is not mounted while a batch is resumed, or the rig is being written.
#[test]
fn complete_results_stay_when_recording_or_rig_are_not_there_for_a_moment() {
    let archive = Archive::with("rest\tA\trest.mkv\t--to 0\n");
    fs::copy(sample("rest.mkv"), archive.path("rest.mkv")).unwrap();
    ended_with(&archive.track(""), 0);
    let before = timeless(&archive.path("runs"));
    for (file, reason) in
        [("rest.mkv", "rest.mkv: no such file or folder"), ("rig.toml", "cannot read rig file rig.toml")]
    {
        fs::rename(archive.path(file), archive.path("away")).unwrap();
        for words in ["", "--resume"] {
            let said = ended_with(&archive.track(words), 1);
            let kept = "; the results of an earlier run are kept in runs/rest";
            assert!(said.contains(&format!("error: rest: {reason}")) && said.contains(kept), "{said}");
            assert!(timeless(&archive.path("runs")) == before, "{file}");
        }
        fs::rename(archive.path("away"), archive.path(file)).unwrap();
    }
    assert_eq!(archive.planned(""), BTreeMap::new());
    // What is not complete is replaced by the reason, also when the manifest's path is relative.
    fs::rename(archive.path("rest.mkv"), archive.path("away")).unwrap();
    fs::remove_file(archive.path("runs/rest/track.csv")).unwrap();
    let said = ended_with(&archive.track(""), 1);
    assert!(!said.contains("choose another folder"), "{said}");
    assert_eq!(archive.summary("rest")["outcome"], "failed");
}

/// Opening a pipe waits for whoever writes into it, for ever.
#[test]
#[cfg(unix)]
fn a_recording_that_is_no_file_is_refused() {
    let archive = Archive::with("pipe\tA\tpipe.mkv\t\n");
    assert!(Command::new("mkfifo").arg(archive.path("pipe.mkv")).status().unwrap().success());
    let refused = "pipe.mkv: cannot be read: is neither a file nor a folder";
    assert!(ended_with(&archive.track(""), 1).contains(refused));
    let said = ended_with(&archive.run("track pipe.mkv --rig rig.toml"), 2);
    assert!(said.contains("pipe.mkv: is neither a file nor a folder"), "{said}");
}

/// A disk of its own that is too small; gone with the value.
#[cfg(target_os = "linux")]
struct Disk(PathBuf);

#[cfg(target_os = "linux")]
impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).output();
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_disk_that_is_full_for_one_run_stops_that_run_only_and_it_may_pass() {
    let archive = Archive::with(
        "rest\tA\tSAMPLES/rest.mkv\t--to 0\ncircle\tA\tSAMPLES/circle.mkv\t--to 0.05\nplanar\tB\tSAMPLES/planar.mkv\t--to 0\n",
    );
    let place = archive.path("runs/circle");
    fs::create_dir_all(&place).unwrap();
    // Larger than the log of a few frames, smaller than a report.
    let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", "size=1m", "tmpfs"]).arg(&place).output();
    if !mounted.is_ok_and(|done| done.status.success()) {
        skipped("a small disk can be made by root only");
        return;
    }
    let disk = Disk(place);
    let said = ended_with(&archive.track("--jobs 1"), 1);
    assert!(said.contains("error: circle: ") && said.contains("No space left on device"), "{said}");
    for run in ["rest", "planar"] {
        assert_eq!(archive.summary(run)["outcome"], "tracked");
    }
    // What of a summary fits says so; a run without one is done again as well.
    if disk.0.join("summary.json").exists() {
        assert_eq!(archive.summary("circle")["failure"]["retryable"], true);
    }
    assert_eq!(archive.planned("").keys().collect::<Vec<_>>(), ["circle"]);
    drop(disk);
    ended_with(&archive.track("--resume"), 0);
    assert_eq!(archive.summary("circle")["outcome"], "tracked");
}

#[test]
fn one_recording_that_is_resumed_stays_in_its_folder() {
    let archive = Archive::new();
    let recording = sample("rest.mkv");
    let words = format!("track {} --rig rig.toml --to 0.02 -o out", recording.display());
    ended_with(&archive.run(&words), 0);
    let undisturbed = fs::read(archive.path("out/track.csv")).unwrap();
    // As after a kill: no summary, and a table that ends in the middle of a row.
    fs::remove_file(archive.path("out/summary.json")).unwrap();
    fs::write(archive.path("out/track.csv"), &undisturbed[..undisturbed.len() / 2]).unwrap();
    let planned = archive.run(&format!("{words} --resume --dry-run"));
    assert!(stdout(&planned).contains("track\tout\tbegun and not finished"), "{}", stdout(&planned));
    ended_with(&archive.run(&format!("{words} --resume")), 0);
    assert_eq!(fs::read(archive.path("out/track.csv")).unwrap(), undisturbed);
    assert_eq!(names(&archive.path("out")), ["log.mcap", "report.html", "run.toml", "summary.json", "track.csv"]);
    // And now there is nothing left to do.
    let again = archive.run(&format!("{words} --resume"));
    assert!(stdout(&again).contains("1 skipped"), "{}", stdout(&again));
    let refused = archive.run(&format!("{words} --resume --csv=else.csv"));
    assert!(ended_with(&refused, 2).contains("--csv does not go with --resume"));
}
