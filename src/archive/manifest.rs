//! [`Manifest`]: a table of recordings, one per line.
//!
//! Text in UTF-8; tabs between the cells, or commas where the first line has no tab. The first line names the columns:
//!
//! | column | meaning |
//! |---|---|
//! | `recording` | video, folder of pictures or log; relative paths start at the manifest's folder |
//! | `rig` | the rig file, also relative; optional if the command or the log provides it |
//! | `name` | name of the run and of its folder; by default the recording's name without extension |
//! | `options` | options of `track` for this line only, as on the command line |
//!
//! Further columns are passed on unchanged. A cell may be in quotes (`"`), and ends in its line. Empty lines are
//! skipped. Everything is checked first: a mistake in any line is reported with its number, and nothing is started.

use crate::csv_lines::{Lines, open_quote};
use crate::plural::plural;
use std::collections::{BTreeMap, HashMap};
use std::io;
use std::path::{Path, PathBuf};

const RECORDING: &str = "recording";
const RIG: &str = "rig";
const NAME: &str = "name";
const OPTIONS: &str = "options";
/// Names of folders have at most 255 bytes on most file systems.
const LONGEST_NAME: usize = 200;

/// A recording in the list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Entry {
    /// Line in the manifest, from 1.
    pub(crate) line: u64,
    pub(crate) name: String,
    pub(crate) recording: PathBuf,
    pub(crate) rig: Option<PathBuf>,
    /// As written.
    pub(crate) options: String,
    /// Further columns that are not empty.
    pub(crate) columns: BTreeMap<String, String>,
}

/// A list of recordings with unique names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Manifest {
    pub(crate) entries: Vec<Entry>,
}

/// Why a manifest cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ManifestError {
    /// The file system reports an error.
    #[error("{}: cannot be read: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    /// A line is wrong.
    #[error("{}:{line}: {reason}", path.display())]
    Line { path: PathBuf, line: u64, reason: String },
}

/// The default name of a run of `recording`: its file name without extension.
pub(crate) fn default_name(recording: &Path) -> String {
    // Of `.` and `..` it is that of the folder that they are.
    let whole = std::fs::canonicalize(recording).ok().filter(|_| recording.file_name().is_none());
    let recording = whole.as_deref().unwrap_or(recording);
    let name = if recording.is_dir() { recording.file_name() } else { recording.file_stem() };
    name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// Checks that `name` can be a folder directly in the folder for the results.
///
/// # Errors
/// What is wrong, and what would be right.
pub(crate) fn is_name(name: &str) -> Result<(), String> {
    let what = if name.is_empty() {
        "is empty"
    } else if name.contains(['/', '\\']) {
        "leads to another folder"
    } else if name.starts_with('.') {
        "begins with a dot"
    } else if name.chars().any(char::is_control) {
        "has control characters in it"
    } else if name.len() > LONGEST_NAME {
        "is longer than 200 bytes"
    } else {
        return Ok(());
    };
    Err(format!("the name {name:?} {what}; it becomes that of a folder: write something like swing_07"))
}

/// The columns of a manifest.
struct Columns {
    recording: usize,
    rig: Option<usize>,
    name: Option<usize>,
    options: Option<usize>,
    others: Vec<(usize, String)>,
}

impl Columns {
    fn of(header: &csv::StringRecord) -> Result<Self, String> {
        let names: Vec<&str> = header.iter().map(str::trim).collect();
        for (k, name) in names.iter().enumerate() {
            if name.is_empty() {
                return Err(format!("column {} has no name", k + 1));
            }
            if names.iter().take(k).any(|other| other == name) {
                return Err(format!("there are two columns `{name}`"));
            }
        }
        let at = |wanted: &str| names.iter().position(|name| *name == wanted);
        let found = names.join("`, `");
        let separated = if found.contains(';') { ", with tabs or commas between them" } else { "" };
        let missing =
            || format!("no column `{RECORDING}`, only `{found}`; the first line names the columns{separated}");
        let own = [RECORDING, RIG, NAME, OPTIONS];
        let others = names.iter().enumerate().filter(|(_, name)| !own.contains(name));
        Ok(Self {
            recording: at(RECORDING).ok_or_else(missing)?,
            rig: at(RIG),
            name: at(NAME),
            options: at(OPTIONS),
            others: others.map(|(k, name)| (k, (*name).to_owned())).collect(),
        })
    }

    fn entry(&self, line: u64, cells: &csv::StringRecord, folder: &Path) -> Result<Entry, String> {
        let cell = |k: usize| cells.get(k).map(str::trim).filter(|cell| !cell.is_empty());
        let optional = |k: Option<usize>| k.and_then(cell);
        let recording = cell(self.recording).ok_or("the recording is missing")?;
        let recording = folder.join(recording);
        let name = match self.name {
            Some(k) => cell(k).ok_or("the name is missing")?.to_owned(),
            None => default_name(&recording),
        };
        is_name(&name)?;
        let others = self.others.iter().filter_map(|(k, name)| Some((name.clone(), cell(*k)?.to_owned())));
        Ok(Entry {
            line,
            name,
            rig: optional(self.rig).map(|rig| folder.join(rig)),
            options: optional(self.options).unwrap_or_default().to_owned(),
            columns: others.collect(),
            recording,
        })
    }
}

impl Manifest {
    /// Reads a manifest.
    ///
    /// # Errors
    /// [`ManifestError`], with the number of the line.
    pub(crate) fn read(path: &Path) -> Result<Self, ManifestError> {
        let read = |source| ManifestError::Read { path: path.to_owned(), source };
        let bytes = std::fs::read(path).map_err(read)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Self::parse(&bytes, folder).map_err(|(line, reason)| ManifestError::Line {
            path: path.to_owned(),
            line,
            reason,
        })
    }

    /// As [`Manifest::read`]; paths are relative to `folder`. Errors have their line.
    fn parse(bytes: &[u8], folder: &Path) -> Result<Self, (u64, String)> {
        let text = std::str::from_utf8(bytes).map_err(|error| {
            let before = bytes.get(..error.valid_up_to()).unwrap_or_default();
            let line = 1 + before.iter().filter(|byte| **byte == b'\n').count() as u64;
            (line, "is not text in UTF-8; save the table as UTF-8".to_owned())
        })?;
        let first = text.lines().next().unwrap_or_default();
        let tabs = first.contains('\t') || !first.contains(',');
        let mut reader = csv::ReaderBuilder::new()
            .delimiter(if tabs { b'\t' } else { b',' })
            .flexible(true)
            .has_headers(false)
            .from_reader(text.as_bytes());
        let mut columns = None;
        let mut width = 0;
        let mut entries: Vec<Entry> = Vec::new();
        let mut lines: HashMap<String, u64> = HashMap::new();
        let mut passed = Lines::of(text.as_bytes(), None);
        for record in reader.records() {
            let record = record.map_err(|error| (passed.line(error.position()), error.to_string()))?;
            let line = passed.line(record.position());
            let wrong = |reason: String| (line, reason);
            if let Some(open) = open_quote(&record) {
                return Err(wrong(open.to_owned()));
            }
            if record.iter().all(|cell| cell.trim().is_empty()) {
                continue;
            }
            let Some(columns) = &columns else {
                columns = Some(Columns::of(&record).map_err(wrong)?);
                width = record.len();
                continue;
            };
            if record.len() != width {
                let between = if tabs { "tabs" } else { "commas" };
                let cells = plural(record.len(), "cell");
                let counted = format!("{cells}, the first line names {width} columns ({between} between)");
                return Err(wrong(counted));
            }
            let entry = columns.entry(line, &record, folder).map_err(wrong)?;
            if let Some(other) = lines.insert(entry.name.clone(), line) {
                let cure = if columns.name.is_some() { "give another" } else { "add a column `name`" };
                return Err(wrong(format!("the name {:?} is that of line {other} already; {cure}", entry.name)));
            }
            entries.push(entry);
        }
        match entries.is_empty() {
            true => Err((1, format!("names no recording; the first line names the columns, `{RECORDING}` and others"))),
            false => Ok(Self { entries }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write as _;

    fn parsed(text: &str) -> Result<Manifest, (u64, String)> {
        Manifest::parse(text.as_bytes(), Path::new("/data"))
    }

    #[test]
    fn columns_in_any_order_and_others_are_carried_along() {
        let text = "\u{feff}site\trecording\trig\toptions\tname\tnote\r\nA\ta/1.mkv\t/r.toml\t--from 1\tone\t\r\n\r\n";
        let manifest = parsed(text).unwrap();
        let expected = Entry {
            line: 2,
            name: "one".into(),
            recording: "/data/a/1.mkv".into(),
            rig: Some("/r.toml".into()),
            options: "--from 1".into(),
            columns: [("site".to_owned(), "A".to_owned())].into(),
        };
        assert_eq!(manifest.entries, [expected]);
    }

    #[test]
    fn commas_are_as_good_and_the_name_is_that_of_the_recording() {
        let manifest = parsed("recording,operator\n\"a, b.mkv\",\"E\"\n/c.2.mkv,F\n").unwrap();
        let names: Vec<_> = manifest.entries.iter().map(|e| (e.name.as_str(), e.recording.to_str().unwrap())).collect();
        assert_eq!(names, [("a, b", "/data/a, b.mkv"), ("c.2", "/c.2.mkv")]);
        assert_eq!(parsed("recording\nx.mkv\n").unwrap().entries.len(), 1);
    }

    #[test]
    fn every_mistake_is_told_with_its_line() {
        for (text, line, part) in [
            ("", 1, "names no recording"),
            ("recording\trig\n", 1, "names no recording"),
            ("video\trig\na.mkv\tr\n", 1, "no column `recording`, only `video`, `rig`"),
            ("recording\t\na.mkv\tr\n", 1, "column 2 has no name"),
            ("recording\trig\trig\na\tb\tc\n", 1, "two columns `rig`"),
            ("recording\trig\na.mkv\tr\nb.mkv\n", 3, "1 cell, the first line names 2 columns (tabs between)"),
            ("recording\trig\na.mkv\tr\n\tr\n", 3, "the recording is missing"),
            ("recording\tname\na\tx\n\nb\ty\nc\tx\n", 5, "\"x\" is that of line 2 already; give another"),
            ("recording\nday1/a.mkv\nday2/a.mkv\n", 3, "is that of line 2 already; add a column `name`"),
            ("recording\tname\na\t../x\n", 2, "leads to another folder"),
            ("recording\tname\na\t..\n", 2, "begins with a dot"),
            ("recording\tname\na\t/etc\n", 2, "leads to another folder"),
            ("recording\tname\na\t\n", 2, "the name is missing"),
            ("recording\n..\n", 2, "the name"),
            ("recording\tnote\na\t\"bubble\nb\tfine\nc\t2\" tube\n", 2, "begins with a \" that is not closed"),
            ("recording,note\na,x\nb,\"12 o'clock\n", 3, "begins with a \" that is not closed"),
        ] {
            let (found, reason) = parsed(text).unwrap_err();
            assert!(found == line && reason.contains(part), "{text:?}: {found}: {reason}");
        }
        let (line, reason) = Manifest::parse(b"recording\na.mkv\nb\xe9.mkv\n", Path::new("")).unwrap_err();
        assert!(line == 3 && reason.contains("UTF-8"), "{line}: {reason}");
        let long = parsed(&format!("recording\tname\na\t{}\n", "x".repeat(201))).unwrap_err();
        assert!(long.1.contains("longer than 200 bytes"), "{}", long.1);
    }

    #[test]
    fn a_hundred_thousand_lines_are_read_and_the_last_is_judged_too() {
        let mut text = "recording\tsite\n".to_owned();
        (0..100_000).for_each(|k| writeln!(text, "run{k}.mkv\tA").unwrap());
        assert_eq!(parsed(&text).unwrap().entries.len(), 100_000);
        text += "run7.mkv\tA\n";
        assert_eq!(parsed(&text).unwrap_err().0, 100_002);
    }
}
