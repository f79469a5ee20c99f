//! Output folders that record the origin of their results.
//!
//! `run.toml` in a folder says which command wrote it and of which recordings. Results of the same recordings are
//! replaced; results of others, foreign files, and input files are never touched.

use super::lock::{Lock, WRITES_RESULTS};
use super::{Exit, Failure, writing};
use crate::archive::SUMMARY;
use crate::atomic_file;
use crate::log::schema::{LOG_FILE, TABLE_FILE};
use parking_lot::ReentrantMutexGuard;
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// The file that records the origin of a folder's results.
pub(super) const RUN: &str = "run.toml";

/// Origin of results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Owner {
    /// Which command wrote them.
    pub(super) command: String,
    /// Whole path of the recording, or of all of them.
    pub(super) recording: String,
}

/// The text of `run.toml` for a run as TOML. Write it in one step: half of it would not identify the folder.
pub(super) fn origin(run: &str) -> String {
    format!("# Origin of these results.\n{run}")
}

/// Links that are followed to something that does not exist; more are a circle.
const MAX_LINKS: usize = 40;

/// The absolute path of something, without links. It is the same when the thing itself is gone for the moment: results
/// are recognised by the path of their recording.
pub(super) fn whole_path(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path_of_missing(path, MAX_LINKS))
}

/// As [`whole_path`], of something that does not exist: the part of the path that does is resolved.
fn path_of_missing(path: &Path, links: usize) -> PathBuf {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let (Some(parent), Some(name)) = (absolute.parent(), absolute.file_name()) else { return absolute };
    match (fs::read_link(&absolute), links.checked_sub(1)) {
        (Ok(target), Some(left)) => path_of_missing(&parent.join(target), left),
        _ => parent.canonicalize().unwrap_or_else(|_| path_of_missing(parent, links)).join(name),
    }
}

/// A path as unique text: invalid UTF-8 bytes are escaped.
pub(super) fn unique_text(path: &Path) -> String {
    path.to_str().map_or_else(|| format!("{path:?}"), str::to_owned)
}

/// Whether files can be made in a folder, which need not exist yet, as far as the system tells beforehand.
pub(super) fn may_write_in(folder: &Path) -> io::Result<()> {
    let here = Path::new(".");
    let nearest = folder.ancestors().find(|folder| folder.exists()).unwrap_or(here);
    if !nearest.is_dir() {
        return Err(ErrorKind::NotADirectory.into());
    }
    #[cfg(unix)]
    rustix::fs::access(nearest, rustix::fs::Access::WRITE_OK)?;
    Ok(())
}

fn cannot_write(path: &Path, why: io::Error) -> Failure {
    Failure::new(Exit::Failed, format!("{}: cannot be written: {why}; choose another folder with -o", path.display()))
}

/// That the run to which a log or table belongs goes on, or was broken off, if its folder says so.
pub(super) fn unfinished(file: &Path) -> Option<String> {
    let is_of_run = [LOG_FILE, TABLE_FILE].iter().any(|name| file.file_name().is_some_and(|own| own == *name));
    let text = fs::read_to_string(file.with_file_name(RUN)).ok().filter(|_| is_of_run)?;
    let owner: Owner = toml::from_str(&text).ok()?;
    let unfinished = owner.command == "track" && !file.with_file_name(SUMMARY).exists();
    unfinished.then(|| {
        let file = file.display();
        format!("{file}: its run is not finished, or was broken off (it has no {SUMMARY} yet): what is there is used")
    })
}

/// Refuses to write what is read.
///
/// # Errors
/// [`Exit::Usage`] when one of `files` is one of `inputs`.
pub(super) fn refuse_to_overwrite_inputs<'a>(
    mut files: impl Iterator<Item = &'a Path>,
    inputs: &[&Path],
) -> Result<(), Failure> {
    let taken = |path: &&Path| path.exists() && inputs.iter().any(|input| whole_path(path) == whole_path(input));
    match files.find(taken) {
        Some(input) => {
            let refused = format!("{}: is an input of this run and would be overwritten", input.display());
            Err(Failure::usage(refused))
        }
        None => Ok(()),
    }
}

/// The text of the `run.toml` in `folder`, if there are results in it that may be replaced by those of `owner`. `all`:
/// what the command may write there.
///
/// # Errors
/// [`Exit::Usage`] when the folder is a file, or has other results.
pub(super) fn earlier_run<'a>(
    folder: &Path,
    owner: &Owner,
    mut all: impl Iterator<Item = &'a str>,
) -> Result<Option<String>, Failure> {
    if folder.exists() && !folder.is_dir() {
        return Err(Failure::usage(format!("{}: is a file; choose a folder with -o", folder.display())));
    }
    let refused = |what: String| {
        let advice = "choose another folder with -o, or move them away";
        Err(Failure::usage(format!("{}: {what}: {advice}", folder.display())))
    };
    let text = fs::read_to_string(folder.join(RUN)).ok();
    let earlier = text.and_then(|text| Some((toml::from_str::<Owner>(&text).ok()?, text)));
    match earlier {
        Some((earlier, text)) if earlier == *owner => Ok(Some(text)),
        Some((earlier, _)) => {
            refused(format!("has the results of `catoptra {} {}`", earlier.command, earlier.recording))
        }
        None => match all.find(|name| folder.join(name).exists()) {
            Some(name) => refused(format!("has a {name} that this command did not write")),
            None => Ok(None),
        },
    }
}

/// The folder of a command that computes from recordings: checked before the work, used when there are results.
#[derive(Debug)]
pub(super) struct Results<'a> {
    pub(super) folder: &'a Path,
    pub(super) command: &'static str,
    pub(super) recordings: &'a [PathBuf],
    /// Everything that is read.
    pub(super) inputs: Vec<&'a Path>,
    /// Names of all files that may be written.
    pub(super) files: Vec<String>,
}

/// Content of `run.toml`.
#[derive(Debug, Serialize, Deserialize)]
struct Run {
    #[serde(flatten)]
    owner: Owner,
    version: String,
    /// Files that were written, so that a later run can remove those it does not write.
    files: Vec<String>,
}

/// Results are being written: others must not write there, and an interrupt waits.
#[must_use = "it holds as long as this lives"]
pub(super) struct Writing {
    _folder: Lock,
    _whole: ReentrantMutexGuard<'static, ()>,
}

impl Results<'_> {
    fn owner(&self) -> Owner {
        let all: Vec<String> = self.recordings.iter().map(|path| unique_text(&whole_path(path))).collect();
        Owner { command: self.command.to_owned(), recording: all.join(", ") }
    }

    /// Refuses a folder in which something would be lost, or nothing can be written; writes nothing.
    ///
    /// # Errors
    /// [`Exit::Usage`]; [`Exit::Failed`] when the folder cannot be written.
    pub(super) fn check(&self) -> Result<(), Failure> {
        self.earlier()?;
        may_write_in(self.folder).map_err(|e| cannot_write(self.folder, e))
    }

    fn earlier(&self) -> Result<Option<String>, Failure> {
        let places: Vec<PathBuf> = self.files.iter().map(|name| self.folder.join(name)).collect();
        refuse_to_overwrite_inputs(places.iter().map(PathBuf::as_path), &self.inputs)?;
        earlier_run(self.folder, &self.owner(), self.files.iter().map(String::as_str))
    }

    /// Makes the folder, removes the files of an earlier run of the same, and says whose it is. An interrupt waits, and
    /// the folder is held, as long as what is returned.
    ///
    /// # Errors
    /// As [`Results::check`]; [`Exit::Failed`] when the folder cannot be written.
    pub(super) fn take(&self) -> Result<Writing, Failure> {
        let folder = self.hold()?;
        let whole = writing::wait();
        self.remove_earlier(&folder)?;
        self.claim(&folder)?;
        Ok(Writing { _folder: folder, _whole: whole })
    }

    /// Makes the folder; what an earlier run wrote stays. It is held as long as what is returned.
    ///
    /// # Errors
    /// As [`Results::take`].
    pub(super) fn hold(&self) -> Result<Lock, Failure> {
        self.earlier()?;
        fs::create_dir_all(self.folder).map_err(|e| cannot_write(self.folder, e))?;
        Lock::take(self.folder, WRITES_RESULTS)
    }

    fn remove_earlier(&self, _held: &Lock) -> Result<(), Failure> {
        let earlier = self.earlier()?;
        let earlier = earlier.and_then(|text| toml::from_str::<Run>(&text).ok());
        // Only plain names: files elsewhere were not written here.
        let is_name = |name: &&String| Path::new(name.as_str()).file_name().is_some_and(|only| only == name.as_str());
        for name in earlier.iter().flat_map(|run| &run.files).filter(is_name) {
            let path = self.folder.join(name);
            match fs::remove_file(&path) {
                Err(e) if e.kind() != ErrorKind::NotFound => return Err(cannot_write(&path, e)),
                _ => {}
            }
        }
        Ok(())
    }

    /// Says whose the folder is, which is held.
    ///
    /// # Errors
    /// [`Exit::Failed`] when it cannot be written.
    pub(super) fn claim(&self, _held: &Lock) -> Result<(), Failure> {
        let version = env!("CARGO_PKG_VERSION").to_owned();
        let run = Run { owner: self.owner(), version, files: self.files.clone() };
        let text =
            toml::to_string(&run).map_err(|e| Failure::new(Exit::Failed, format!("cannot describe the run: {e}")))?;
        let path = self.folder.join(RUN);
        atomic_file::write(&path, origin(&text).as_bytes()).map_err(|e| cannot_write(&path, e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_without_summary_is_not_finished() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        let table = folder.path().join(TABLE_FILE);
        assert_eq!(unfinished(&table), None);
        put(RUN, "command = \"track\"\nrecording = \"/a.mkv\"\nrig = \"/r.toml\"\n");
        assert!(unfinished(&table).unwrap().contains("is not finished"));
        assert_eq!(unfinished(&folder.path().join("other.csv")), None);
        put(SUMMARY, "{}");
        assert_eq!(unfinished(&table), None);
    }

    fn results<'a>(folder: &'a Path, recordings: &'a [PathBuf], files: &[&str]) -> Results<'a> {
        let inputs = recordings.iter().map(PathBuf::as_path).collect();
        let files = files.iter().map(|name| (*name).to_owned()).collect();
        Results { folder, command: "identify", recordings, inputs, files }
    }

    #[test]
    fn results_of_the_same_recordings_are_replaced_and_nothing_else() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("out");
        let (a, b) = ([place.path().join("a.csv")], [place.path().join("b.csv")]);
        let first = results(&folder, &a, &["model.json", "orders.csv"]);
        first.check().unwrap();
        assert!(!folder.exists());
        first.take().map(drop).unwrap();
        fs::write(folder.join("orders.csv"), "old").unwrap();
        fs::write(folder.join("notes.txt"), "mine").unwrap();
        let other = results(&folder, &b, &["model.json"]).check().unwrap_err();
        assert!(other.exit() == Exit::Usage && other.to_string().contains("a.csv"), "{other}");
        let writing = results(&folder, &a, &["model.json"]).take().unwrap();
        assert!(writing::waits());
        drop(writing);
        assert!(!folder.join("orders.csv").exists() && folder.join("notes.txt").exists());
    }

    #[test]
    #[cfg(unix)]
    fn what_is_gone_has_the_path_that_it_had() {
        let place = tempfile::tempdir().unwrap();
        let real = place.path().join("disk/day 1");
        fs::create_dir_all(&real).unwrap();
        fs::write(real.join("a.mkv"), "video").unwrap();
        let link = |to: &Path, name: &str| {
            let link = place.path().join(name);
            std::os::unix::fs::symlink(to, &link).unwrap();
            link
        };
        let (file, folder) = (link(&real.join("a.mkv"), "a.mkv"), link(&place.path().join("disk"), "data"));
        let paths = [real.join("a.mkv"), file, folder.join("day 1/a.mkv")];
        let whole = || paths.each_ref().map(|path| whole_path(path));
        let before = whole();
        fs::remove_file(&paths[0]).unwrap();
        assert_eq!(whole(), before);
        // As when a disk is not mounted.
        fs::remove_dir_all(place.path().join("disk")).unwrap();
        assert_eq!(whole(), before);
        assert_eq!(whole_path(Path::new("no such file")), std::env::current_dir().unwrap().join("no such file"));
        let circle = place.path().join("circle");
        std::os::unix::fs::symlink(&circle, &circle).unwrap();
        assert!(whole_path(&circle).ends_with("circle"));
    }

    #[test]
    fn what_is_read_and_what_others_wrote_is_refused() {
        let place = tempfile::tempdir().unwrap();
        let input = [place.path().join("signals.csv")];
        fs::write(&input[0], "t,u,y\n").unwrap();
        let over_input = results(place.path(), &input, &["signals.csv"]).check().unwrap_err().to_string();
        assert!(over_input.contains("is an input of this run"), "{over_input}");
        fs::write(place.path().join("report.html"), "of another command").unwrap();
        let foreign = results(place.path(), &input, &["report.html"]).check().unwrap_err().to_string();
        assert!(foreign.contains("has a report.html that this command did not write"), "{foreign}");
        let file = results(&input[0], &input, &[]).check().unwrap_err().to_string();
        assert!(file.contains("is a file; choose a folder with -o"), "{file}");
        let beyond = results(&input[0].join("out"), &input, &[]).check().unwrap_err().to_string();
        assert!(beyond.contains("cannot be written"), "{beyond}");
    }
}
