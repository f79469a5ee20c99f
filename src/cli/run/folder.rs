//! The output folder of a run, and what may be replaced in it.
//!
//! A folder written by this command is recognised by its `run.toml`: recording, rig, options. Results of the same
//! recording are replaced, and files of an earlier run that the new one does not write are removed (an old overlay
//! beside a new log would be misleading). Results of another recording, and files of other origin, are never touched:
//! the run is refused before any work.

use super::super::lock::{Lock, WRITES_RESULTS};
use super::super::output::{REPORT, begins_with};
use super::super::results::{self, Owner, RUN, whole_path};
use super::super::{Exit, Failure};
use super::options::Record;
use crate::archive::{FileRecord, RunSummary, SUMMARY, hash};
use crate::atomic_file;
use crate::log::schema::{LOG_FILE, PICTURES_FILE, TABLE_FILE, pictures_file};
use crate::tally::budget::{Contribution, together};
use crate::vetoes;
use serde::{Deserialize, Serialize};
use std::ffi::OsStr;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

const OVERLAY: &str = "overlay.mp4";
/// In place of the name of a table: stdout.
const STDOUT: &str = "-";
/// How our tables begin.
const TABLE_BEGINS: &str = "seq,t_s,";
/// All files that a run may write into its folder. The summary comes first, so that it is removed before the others.
const ALL: [&str; 7] = [SUMMARY, RUN, LOG_FILE, TABLE_FILE, REPORT, OVERLAY, PICTURES_FILE];

/// The files of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::cli) struct Files {
    pub(in crate::cli) folder: PathBuf,
    pub(in crate::cli) log: PathBuf,
    /// In the folder, or where the user wants it.
    pub(in crate::cli) table: PathBuf,
    pub(in crate::cli) report: PathBuf,
    /// If an overlay is wanted.
    pub(in crate::cli) overlay: Option<PathBuf>,
    /// If a video of the pictures is wanted.
    pub(in crate::cli) pictures: Option<PathBuf>,
}

/// Description of the run: `run.toml`, and the options attached to the log. Options that do not affect results are not
/// included.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::cli) struct Run {
    /// Which command wrote it.
    pub(in crate::cli) command: String,
    pub(in crate::cli) version: String,
    /// Whole path of the recording.
    pub(in crate::cli) recording: String,
    /// Whole path of the rig file.
    pub(in crate::cli) rig: String,
    /// Frame of reference of the table and the report.
    pub(in crate::cli) frame: String,
    pub(in crate::cli) from_s: Option<f64>,
    pub(in crate::cli) to_s: Option<f64>,
    /// Frames per second as stated by the user.
    pub(in crate::cli) fps: Option<String>,
    pub(in crate::cli) full_frame: bool,
    /// What was recorded of the pictures.
    #[serde(default)]
    pub(in crate::cli) record: Option<String>,
    /// Whom the log is for, if not Foxglove.
    #[serde(default)]
    pub(in crate::cli) profile: Option<String>,
    /// Where the lamp is that shows commands.
    #[serde(default)]
    pub(in crate::cli) tick_led: Option<String>,
}

impl Run {
    /// As text.
    pub(in crate::cli) fn to_toml(&self) -> Result<String, Failure> {
        toml::to_string(self).map_err(|e| Failure::new(Exit::Failed, format!("cannot write the run's options: {e}")))
    }
}

/// Whether `table` is, or would be, that of a run in a folder other than `own`.
fn is_of_another_run(table: &Path, own: &Path) -> bool {
    let table = whole_path(table);
    let Some(folder) = table.parent().filter(|folder| *folder != whole_path(own)) else { return false };
    let is_taken = table.exists() || table.file_name().is_some_and(|name| name == TABLE_FILE);
    is_taken && [RUN, LOG_FILE].iter().any(|name| folder.join(name).exists())
}

/// The default folder for results: in the working directory, named after the recording.
pub(in crate::cli) fn default_folder(recording: &Path) -> PathBuf {
    let whole = whole_path(recording);
    let name = if recording.is_dir() { whole.file_name() } else { whole.file_stem() };
    let mut folder = name.unwrap_or(OsStr::new("recording")).to_owned();
    folder.push("-track");
    folder.into()
}

/// Name of the run whose results are in `folder`.
pub(in crate::cli) fn name(folder: &Path) -> String {
    whole_path(folder).file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

impl Files {
    /// Files in `folder`, with the table at `table` if given.
    pub(in crate::cli) fn new(folder: &Path, table: Option<&Path>, overlay: bool) -> Self {
        let file = |name: &str| folder.join(name);
        Self {
            log: file(LOG_FILE),
            table: table.map_or_else(|| file(TABLE_FILE), Path::to_owned),
            report: file(REPORT),
            overlay: overlay.then(|| file(OVERLAY)),
            pictures: None,
            folder: folder.to_owned(),
        }
    }

    /// Also the video of the pictures, if `record` makes one.
    pub(in crate::cli) fn recording(mut self, record: Option<Record>) -> Self {
        self.pictures = record.filter(|record| *record != Record::Windows).map(|_| self.folder.join(PICTURES_FILE));
        self
    }

    /// Whether the table goes to stdout.
    pub(in crate::cli) fn table_on_stdout(&self) -> bool {
        self.table == Path::new(STDOUT)
    }

    fn all(&self) -> impl Iterator<Item = &PathBuf> {
        [&self.log, &self.table, &self.report].into_iter().chain(&self.overlay).chain(&self.pictures)
    }

    /// Makes the folder ready for `run`, whose `inputs` no file may take the place of.
    ///
    /// # Errors
    /// [`Exit::Usage`] when something exists that must not be replaced, [`Exit::Failed`] when the folder cannot be
    /// written, or another process is writing there.
    pub(in crate::cli) fn prepare(&self, run: &Run, inputs: &[&Path]) -> Result<Lock, Failure> {
        let places = self.all().map(PathBuf::as_path).filter(|path| *path != Path::new(STDOUT));
        results::refuse_to_overwrite_inputs(places, inputs)?;
        if inputs.iter().any(|input| input.is_dir() && results::whole_path(input) == results::whole_path(&self.folder))
        {
            let folder = self.folder.display();
            return Err(Failure::usage(format!("{folder}: is the recording itself; choose another folder with -o")));
        }
        let earlier = self.earlier_run(run)?;
        self.places_are_free(earlier.is_some())?;
        let cannot = |path: &Path, e: io::Error| {
            Failure::because(
                Exit::Failed,
                format!("{}: cannot be written: {e}; choose another folder with -o", path.display()),
                e,
            )
        };
        fs::create_dir_all(&self.folder).map_err(|e| cannot(&self.folder, e))?;
        let held = Lock::take(&self.folder, WRITES_RESULTS)?;
        for path in self.partial_files().map_err(|e| cannot(&self.folder, e))? {
            fs::remove_file(&path).map_err(|e| cannot(&path, e))?;
        }
        if let Some(earlier) = earlier {
            if earlier != *run {
                tracing::warn!(
                    "{}: results of an earlier run of this recording, with other options, are replaced",
                    self.folder.display()
                );
            }
            let timed_alike = earlier.fps == run.fps;
            self.set_vetoes_aside(Path::new(&run.recording), timed_alike).map_err(|e| cannot(&self.folder, e))?;
            let videos = self.videos_of_earlier();
            let is_video = |name: &str| name == OVERLAY || videos.iter().any(|video| video == name);
            let names = ALL.into_iter().filter(|name| ![RUN, PICTURES_FILE].contains(name));
            for name in names.chain(videos.iter().map(String::as_str)) {
                let path = self.folder.join(name);
                match fs::remove_file(&path) {
                    Ok(()) if is_video(name) && !self.all().any(|own| *own == path) => {
                        tracing::warn!("{}: of an earlier run, and this one makes none: removed", path.display());
                    }
                    Err(e) if e.kind() != ErrorKind::NotFound => return Err(cannot(&path, e)),
                    _ => {}
                }
            }
        }
        let path = self.folder.join(RUN);
        let text = results::origin(&run.to_toml()?);
        atomic_file::write(&path, text.as_bytes()).map_err(|e| cannot(&path, e))?;
        Ok(held)
    }

    /// Sets vetoes aside that were given when the recording had another content, or its frames other times: they are of
    /// other moments.
    fn set_vetoes_aside(&self, recording: &Path, timed_alike: bool) -> io::Result<()> {
        let file = self.folder.join(vetoes::FILE);
        if !file.exists() {
            return Ok(());
        }
        let earlier = RunSummary::read(&self.folder).ok().flatten().and_then(|summary| summary.sha256.recording);
        let is_other = |then: String| hash::of_recording(recording).is_ok_and(|now| now != then);
        if (!timed_alike || earlier.is_some_and(is_other))
            && let Some(aside) = atomic_file::backup_names(&file).find(|name| !name.exists())
        {
            fs::rename(&file, &aside)?;
            let of = if timed_alike { "an earlier content of this recording" } else { "another --fps" };
            tracing::warn!(
                "{}: of {of}, now in {}: its vetoes do not count; rename it if its frames and their stamps are still \
                 the same",
                file.display(),
                aside.display()
            );
        }
        Ok(())
    }

    /// Partial files that a killed run left beside its own.
    fn partial_files(&self) -> io::Result<Vec<PathBuf>> {
        let mut found = Vec::new();
        for entry in fs::read_dir(&self.folder)? {
            let entry = entry?;
            let name = entry.file_name();
            if [RUN, SUMMARY].iter().any(|file| atomic_file::is_partial(&name, file)) {
                found.push(entry.path());
            }
        }
        Ok(found)
    }

    /// Names of the videos of pictures that are there: one for each time that recording was switched on.
    pub(in crate::cli) fn videos(&self) -> impl Iterator<Item = String> + use<'_> {
        (1..).map(pictures_file).take_while(|name| self.folder.join(name).is_file())
    }

    /// The first of these, and further ones that the summary of an earlier run names: others may be the user's.
    fn videos_of_earlier(&self) -> Vec<String> {
        let files = RunSummary::read(&self.folder).ok().flatten().map_or(Vec::new(), |summary| summary.files);
        let is_named = |name: &String| name == PICTURES_FILE || files.iter().any(|file| file.name == *name);
        self.videos().filter(is_named).collect()
    }

    /// The files that are there, with their sizes and the hash of the table; without the summary.
    ///
    /// # Errors
    /// The system's.
    pub(in crate::cli) fn written(&self) -> io::Result<Vec<FileRecord>> {
        let mut files = Vec::new();
        let one_each = ALL.into_iter().filter(|name| ![SUMMARY, PICTURES_FILE].contains(name)).map(str::to_owned);
        for name in one_each.chain(self.videos()) {
            let path = self.folder.join(&name);
            match fs::metadata(&path) {
                Ok(found) => {
                    let sha256 = if name == TABLE_FILE { Some(hash::of_file(&path)?) } else { None };
                    files.push(FileRecord { name, bytes: found.len(), sha256 });
                }
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
        }
        Ok(files)
    }

    /// Adds the run's error budget to `run.toml`. Where it cannot be written, other files cannot either, and what they
    /// lack must still be told: log and report have the budget too.
    pub(in crate::cli) fn add_budget_or_warn(&self, run: &Run, sources: &[Contribution]) {
        if let Err(failure) = self.add_budget(run, sources) {
            tracing::warn!("{}; the error budget is missing in it", failure.message());
        }
    }

    fn add_budget(&self, run: &Run, sources: &[Contribution]) -> Result<(), Failure> {
        let mut text = results::origin(&run.to_toml()?);
        text += "\n# What each source of error adds to θ and to a coordinate of the tip in the base frame, 1σ.\n";
        text += "[error_budget]\n";
        let all = sources.iter().filter_map(|source| Some((source.name, *source.share.as_ref().ok()?)));
        for (name, (theta_rad, tip_m)) in all.chain([("together", together(sources))]) {
            let key = name.split(',').next().unwrap_or(name).replace(' ', "_");
            text += &format!("{key} = {{ theta_deg = {:.6}, tip_mm = {:.6} }}\n", theta_rad.to_degrees(), tip_m * 1e3);
        }
        let unknown = sources.iter().filter(|source| source.share.is_err()).map(|source| source.name.into());
        let unknown: toml::value::Array = unknown.collect();
        if !unknown.is_empty() {
            text += &format!("# Not in the sum.\nunknown = {}\n", toml::Value::from(unknown));
        }
        let path = self.folder.join(RUN);
        atomic_file::write(&path, text.as_bytes())
            .map_err(|e| Failure::because(Exit::Failed, format!("cannot write {}: {e}", path.display()), e))
    }

    /// Makes the folder ready for a run that cannot be repeated: nothing there is replaced.
    ///
    /// # Errors
    /// As [`Files::prepare`].
    pub(in crate::cli) fn prepare_new(&self, run: &Run, inputs: &[&Path]) -> Result<Lock, Failure> {
        if let Some(there) = ALL.iter().find(|name| self.folder.join(name).symlink_metadata().is_ok()) {
            let text =
                format!("{}: has a {there} of an earlier run; choose another folder with -o", self.folder.display());
            return Err(Failure::usage(text));
        }
        self.prepare(run, inputs)
    }

    /// Refuses a folder that is a file, and a table that would replace another file, unless a run is done `again`.
    fn places_are_free(&self, again: bool) -> Result<(), Failure> {
        let refused = |text: String| Err(Failure::usage(text));
        if self.folder.symlink_metadata().is_ok() && !self.folder.is_dir() {
            let what = if self.folder.exists() { "is a file" } else { "is a link to what is not there" };
            return refused(format!("{}: {what}; choose a folder with -o", self.folder.display()));
        }
        let table = self.table.display();
        if self.table_on_stdout() {
            return Ok(());
        }
        if [Some(&self.log), Some(&self.report), self.overlay.as_ref(), self.pictures.as_ref()]
            .contains(&Some(&self.table))
        {
            return refused(format!("{table}: is another file of this run; choose another with --csv"));
        }
        if self.table.is_dir() {
            return refused(format!("{table}: is a folder; give the name of a file with --csv"));
        }
        // Something other than a regular file, such as /dev/stdout, cannot be lost.
        if self.table != self.folder.join(TABLE_FILE) && self.table.is_file() {
            if !begins_with(&self.table, TABLE_BEGINS) {
                return refused(format!(
                    "{table}: exists and is not a table of this command; choose another with --csv"
                ));
            }
            if !again {
                return refused(format!(
                    "{table}: exists, and nothing in {} says that it is an earlier table of this recording; choose \
                     another with --csv, or move it away",
                    self.folder.display()
                ));
            }
        }
        if is_of_another_run(&self.table, &self.folder) {
            return refused(format!("{table}: is in the folder of another run; choose another with --csv"));
        }
        Ok(())
    }

    /// The run whose results are in the folder, if there is one and it may be replaced by `run`.
    fn earlier_run(&self, run: &Run) -> Result<Option<Run>, Failure> {
        let owner = Owner { command: run.command.clone(), recording: run.recording.clone() };
        let Some(text) = results::earlier_run(&self.folder, &owner, ALL.into_iter())? else { return Ok(None) };
        let earlier = toml::from_str(&text)
            .map_err(|e| Failure::usage(format!("{}: {}", self.folder.join(RUN).display(), e.message())))?;
        Ok(Some(earlier))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(recording: &str) -> Run {
        Run {
            command: "track".into(),
            version: "0.1.0".into(),
            recording: recording.into(),
            rig: "/rig.toml".into(),
            frame: "base".into(),
            from_s: None,
            to_s: Some(1.5),
            fps: Some("60000/1001".into()),
            full_frame: false,
            record: None,
            profile: None,
            tick_led: None,
        }
    }

    #[test]
    fn all_videos_of_pictures_are_listed() {
        let place = tempfile::tempdir().unwrap();
        let files = Files::new(place.path(), None, false);
        for name in ["pictures.mkv", "pictures-2.mkv", "pictures-4.mkv"] {
            fs::write(place.path().join(name), "video").unwrap();
        }
        let names: Vec<String> = files.written().unwrap().into_iter().map(|file| file.name).collect();
        assert_eq!(names, ["pictures.mkv", "pictures-2.mkv"]);
    }

    #[test]
    fn results_of_the_same_recording_are_replaced_and_no_others() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("a/b");
        let files = Files::new(&folder, None, false);
        drop(files.prepare(&run("/a.mkv"), &[]).unwrap());
        fs::write(&files.log, "log").unwrap();
        fs::write(folder.join(OVERLAY), "overlay").unwrap();
        fs::write(folder.join("notes.txt"), "mine").unwrap();

        let refused = files.prepare(&run("/b.mkv"), &[]).unwrap_err();
        assert_eq!(refused.exit(), Exit::Usage);
        assert!(refused.to_string().contains("the results of `catoptra track /a.mkv`"), "{refused}");
        assert_eq!(fs::read_to_string(&files.log).unwrap(), "log");

        let other_options = Run { full_frame: true, ..run("/a.mkv") };
        fs::write(folder.join(vetoes::FILE), "vetoes").unwrap();
        drop(files.prepare(&other_options, &[]).unwrap());
        assert!(!files.log.exists() && !folder.join(OVERLAY).exists());
        // A veto is of a time.
        assert!(folder.join(vetoes::FILE).exists());
        let other_options = Run { fps: Some("30".into()), ..run("/a.mkv") };
        drop(files.prepare(&other_options, &[]).unwrap());
        assert!(!folder.join(vetoes::FILE).exists());
        assert!(folder.join("notes.txt").exists());
        let read: Run = toml::from_str(&fs::read_to_string(folder.join(RUN)).unwrap()).unwrap();
        assert_eq!(read, other_options);
    }

    #[test]
    fn files_of_others_are_not_touched() {
        let place = tempfile::tempdir().unwrap();
        let files = Files::new(place.path(), None, true);
        fs::write(place.path().join("notes.txt"), "mine").unwrap();
        fs::write(&files.table, "mine").unwrap();
        let refused = files.prepare(&run("/a.mkv"), &[]).unwrap_err();
        assert!(refused.to_string().contains("track.csv"), "{refused}");
        fs::remove_file(&files.table).unwrap();
        drop(files.prepare(&run("/a.mkv"), &[]).unwrap());
    }

    #[test]
    fn what_is_read_is_not_written_over() {
        let place = tempfile::tempdir().unwrap();
        let video = place.path().join("a.mkv");
        fs::write(&video, "video").unwrap();
        let files = Files::new(&place.path().join("out"), Some(&video), false);
        let refused = files.prepare(&run("/a.mkv"), &[&video]).unwrap_err();
        assert_eq!(refused.exit(), Exit::Usage);
        assert!(!files.folder.exists());
    }

    #[test]
    fn a_table_elsewhere_replaces_tables_only() {
        let place = tempfile::tempdir().unwrap();
        let table = place.path().join("table.csv");
        let files = Files::new(&place.path().join("out"), Some(&table), false);
        fs::write(&table, "notes").unwrap();
        let refused = files.prepare(&run("/a.mkv"), &[]).unwrap_err();
        assert_eq!(refused.exit(), Exit::Usage);
        assert!(refused.to_string().contains("table.csv") && !files.folder.exists(), "{refused}");
        // A table that nothing says to be of this recording, and then one that is.
        fs::write(&table, "seq,t_s,stamp_ns\r\n").unwrap();
        let refused = files.prepare(&run("/a.mkv"), &[]).unwrap_err();
        assert!(refused.to_string().contains("nothing in") && !files.folder.exists(), "{refused}");
        fs::remove_file(&table).unwrap();
        drop(files.prepare(&run("/a.mkv"), &[]).unwrap());
        fs::write(&table, "seq,t_s,stamp_ns\r\n").unwrap();
        drop(files.prepare(&run("/a.mkv"), &[]).unwrap());
        // A folder with a run, which may still be running, keeps its table.
        let other = place.path().join("other");
        fs::create_dir(&other).unwrap();
        for name in [RUN, LOG_FILE] {
            fs::write(other.join(name), "of another").unwrap();
            for table in [TABLE_FILE, "mine.csv"].map(|name| other.join(name)) {
                fs::write(&table, "seq,t_s,stamp_ns\r\n").unwrap();
                let files = Files::new(&place.path().join("out"), Some(&table), false);
                let refused = files.prepare(&run("/a.mkv"), &[]).unwrap_err();
                assert!(refused.to_string().contains("is in the folder of another run"), "{refused}");
                assert_eq!(fs::read_to_string(&table).unwrap(), "seq,t_s,stamp_ns\r\n");
            }
            fs::remove_file(other.join(name)).unwrap();
        }
        let own = Files::new(&place.path().join("out"), Some(&place.path().join("out/mine.csv")), false);
        drop(own.prepare(&run("/a.mkv"), &[]).unwrap());
        fs::write(&own.table, "seq,t_s,stamp_ns\r\n").unwrap();
        drop(own.prepare(&run("/a.mkv"), &[]).unwrap());
        let log_twice = Files::new(place.path(), Some(&place.path().join(LOG_FILE)), false);
        assert_eq!(log_twice.prepare(&run("/a.mkv"), &[]).unwrap_err().exit(), Exit::Usage);
    }

    #[test]
    #[cfg(unix)]
    fn names_that_are_no_text_stay_apart() {
        use super::super::super::results::unique_text;
        use std::os::unix::ffi::OsStrExt as _;
        let [e, è] = [b"/caf\xe9", b"/caf\xe8"].map(|name| unique_text(Path::new(OsStr::from_bytes(name))));
        assert_ne!(e, è);
        assert_eq!(unique_text(Path::new("/café")), "/café");
    }

    #[test]
    fn the_folder_is_named_after_the_recording() {
        assert_eq!(default_folder(Path::new("/data/day 1/swing.2.mkv")), Path::new("swing.2-track"));
        let place = tempfile::tempdir().unwrap();
        let pictures = place.path().join("pictures.old");
        fs::create_dir(&pictures).unwrap();
        assert_eq!(default_folder(&pictures), Path::new("pictures.old-track"));
    }
}
