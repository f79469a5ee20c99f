//! All runs of an archive: finds them in their folders and makes tables.

mod cautions;
mod frames;
mod runs;

use super::tables::{Cells, Table, TableError};
use super::{FileRecord, Outcome, RunSummary, SummaryError, is_as_recorded};
use crate::atomic_file::NewFile;
use crate::log::schema::{LOG_FILE, TABLE_FILE, table};
use crate::plural::plural;
use crate::vetoes::VetoError;
use frames::{Frames, add_all, open};
use runs::own_columns;
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};

/// Greatest depth of folders searched; what lies deeper is reported.
const DEPTH: usize = 16;
/// The option, and the column, that tells the frame of reference of positions and directions.
const FRAME: &str = "frame";

/// A run of the archive.
#[derive(Debug, Clone)]
pub(crate) struct Run {
    /// Unique name.
    pub(crate) name: String,
    pub(crate) folder: PathBuf,
    pub(crate) summary: RunSummary,
}

/// An archive.
#[derive(Debug, Default)]
pub(crate) struct Study {
    /// Sorted by folder.
    pub(crate) runs: Vec<Run>,
    /// Folders with results but no summary: of unfinished runs.
    pub(crate) unfinished: Vec<PathBuf>,
    /// Why runs are left out.
    pub(crate) left_out: Vec<LeftOut>,
    /// Folders that lie too deep to be searched.
    pub(crate) too_deep: Vec<PathBuf>,
    /// What to say of the vetoes of runs.
    pub(crate) vetoes: Vec<String>,
}

/// Why a run is left out of the archive.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LeftOut {
    /// Its summary cannot be read.
    #[error(transparent)]
    Summary(#[from] SummaryError),
    /// Its table of frames cannot be read, or is not the one that its summary describes.
    #[error(transparent)]
    Table(#[from] StudyError),
}

/// Why the tables of a study cannot be made.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StudyError {
    /// A folder cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    /// The table of a run was changed.
    #[error("{}:{line}: {reason}; track the recording again", path.display())]
    Track { path: PathBuf, line: u64, reason: String },
    /// It can be read, and has other content than its summary says.
    #[error(
        "{}: was changed since it was written: its SHA-256 is not that in summary.json; restore it, or track the \
         recording again", path.display()
    )]
    Changed { path: PathBuf },
    /// The user, or the system, asked it to end.
    #[error("nothing is written, and earlier results are as they were")]
    Interrupted,
    #[error(transparent)]
    Table(#[from] TableError),
    #[error(transparent)]
    Vetoes(#[from] VetoError),
}

impl Study {
    /// All runs in `folders` and below them. Their tables are read completely: one that was damaged after tracking, or
    /// not copied completely, must not pass for a shorter run. `go_on` is asked before each.
    ///
    /// # Errors
    /// [`StudyError::Io`] when one of the folders cannot be read; those below it are left out. That of `go_on`.
    pub(crate) fn find(folders: &[PathBuf], go_on: impl Fn() -> Result<(), StudyError>) -> Result<Self, StudyError> {
        let mut study = Self::default();
        let (mut known, mut searched) = (BTreeSet::new(), BTreeMap::new());
        for folder in folders {
            study.look(folder, 0, &mut known, &mut searched)?;
        }
        // A folder may have been reached a shorter way afterwards.
        let is_searched = |folder: &PathBuf| folder.canonicalize().is_ok_and(|whole| searched.contains_key(&whole));
        study.too_deep.retain(|folder| !is_searched(folder));
        // Whatever the order in which the folders were given.
        study.runs.sort_by(|a, b| a.folder.cmp(&b.folder));
        for run in std::mem::take(&mut study.runs) {
            go_on()?;
            match check(&run) {
                Ok(vetoes) => {
                    study.vetoes.extend(vetoes);
                    study.runs.push(run);
                }
                Err(error) => study.left_out.push(error.into()),
            }
        }
        let mut seen: BTreeMap<String, u32> = BTreeMap::new();
        study.runs.iter().for_each(|run| *seen.entry(run.name.clone()).or_default() += 1);
        for run in &mut study.runs {
            if seen.get(&run.name).is_some_and(|times| *times > 1) {
                run.name = run.folder.display().to_string();
            }
        }
        Ok(study)
    }

    /// Folders with results that are `known` already, by their whole paths, do not count twice. Links are followed:
    /// what was `searched`, at which depth, is searched again only from nearer, so that a circle of links ends.
    fn look(
        &mut self,
        folder: &Path,
        depth: usize,
        known: &mut BTreeSet<PathBuf>,
        searched: &mut BTreeMap<PathBuf, usize>,
    ) -> Result<(), StudyError> {
        let io = |source| StudyError::Io { path: folder.to_owned(), source };
        let whole = folder.canonicalize().map_err(io)?;
        if searched.get(&whole).is_some_and(|before| *before <= depth) {
            return Ok(());
        }
        if depth > DEPTH {
            self.too_deep.push(folder.to_owned());
            return Ok(());
        }
        searched.insert(whole.clone(), depth);
        let below = below(folder).map_err(io)?;
        if !known.contains(&whole) {
            let results = match RunSummary::read(folder) {
                Ok(Some(summary)) => {
                    self.runs.push(Run { name: summary.name.clone(), folder: folder.to_owned(), summary });
                    true
                }
                Err(error) => {
                    self.left_out.push(error.into());
                    true
                }
                Ok(None) if folder.join(LOG_FILE).exists() || folder.join(TABLE_FILE).exists() => {
                    self.unfinished.push(folder.to_owned());
                    true
                }
                Ok(None) => false,
            };
            if results {
                known.insert(whole);
            }
        }
        for folder in below {
            // Only that folder is left out, with what is in it.
            if let Err(error) = self.look(&folder, depth + 1, known, searched) {
                self.left_out.push(error.into());
            }
        }
        Ok(())
    }

    /// Columns of the manifests, of all runs together.
    pub(crate) fn manifest_columns(&self) -> BTreeSet<&str> {
        self.runs.iter().flat_map(|run| run.summary.manifest.keys().map(String::as_str)).collect()
    }

    /// The manifests' columns, renamed where they collide with columns of `ours`.
    fn manifest_cells(&self, ours: &[(String, Cells)], rows: &[(&Run, usize)]) -> Vec<(String, Cells)> {
        let manifest = self.manifest_columns();
        let is_ours = |name: &str| ours.iter().any(|(other, _)| other == name);
        let cells = |name: &str| {
            let of = |(run, times): &(&Run, usize)| {
                std::iter::repeat_n(run.summary.manifest.get(name).cloned(), *times).collect::<Vec<_>>()
            };
            Cells::Text(rows.iter().flat_map(of).collect())
        };
        let named = |name: &str| {
            let mut new = name.to_owned();
            while is_ours(&new) || (new != name && manifest.contains(new.as_str())) {
                new = format!("manifest_{new}");
            }
            new
        };
        manifest.iter().copied().map(|name| (named(name), cells(name))).collect()
    }

    /// Writes the table of all runs, one row each, beside its place.
    ///
    /// # Errors
    /// [`StudyError`].
    pub(crate) fn write_runs(&self, place: &Path) -> Result<NewFile, StudyError> {
        let mut columns = own_columns(&self.runs);
        let rows: Vec<(&Run, usize)> = self.runs.iter().map(|run| (run, 1)).collect();
        let manifest_cells = self.manifest_cells(&columns, &rows);
        columns.extend(manifest_cells);
        let mut table = Table::begin(place, &columns)?;
        table.add(&columns)?;
        Ok(table.complete()?)
    }

    /// Writes the table of all frames beside its place: the rows of every run's table, one run after another; returns
    /// their number too. Calls `after_run` after each run, and stops when it gives an error.
    ///
    /// # Errors
    /// [`StudyError`].
    pub(crate) fn write_frames(
        &self,
        place: &Path,
        mut after_run: impl FnMut() -> Result<(), StudyError>,
    ) -> Result<(u64, NewFile), StudyError> {
        let mut names: Vec<String> = Vec::new();
        for run in self.with_tables() {
            for name in open(run)?.1 {
                if !names.contains(&name) {
                    names.push(name);
                }
            }
        }
        let mut frames = Frames::new(&names);
        let empty = frames.take(self);
        let mut table = Table::begin(place, &empty)?;
        let mut count = 0;
        for run in self.with_tables() {
            count += add_all(run, &names, &mut frames, |frames| Ok(table.add(&frames.take(self))?))?.rows;
            after_run()?;
        }
        if frames.rows > 0 {
            table.add(&frames.take(self))?;
        }
        Ok((count, table.complete()?))
    }

    /// Runs with a table of frames in their folder.
    fn with_tables(&self) -> impl Iterator<Item = &Run> {
        self.runs.iter().filter(|run| run.has_table())
    }
}

/// The folders in a folder, and those that links in it lead to, sorted.
fn below(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut below = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            below.push(path);
        }
    }
    below.sort();
    Ok(below)
}

impl Run {
    /// Whether it has a table of frames in its folder.
    fn has_table(&self) -> bool {
        self.table().is_some()
    }

    /// What its summary says of its table, if that is in its folder.
    fn table(&self) -> Option<&FileRecord> {
        self.summary.files.iter().find(|file| file.name == TABLE_FILE)
    }

    /// Frame of reference of its positions and directions.
    fn frame(&self) -> Option<String> {
        self.summary.options.get(FRAME).cloned()
    }

    /// The columns that its table begins with; later versions may add more.
    fn columns(&self) -> Vec<String> {
        let markers = self.summary.measured.iter().flat_map(|m| &m.markers).map(|marker| marker.name.as_str());
        match self.summary.measured {
            Some(_) => table::header(markers, self.summary.options.contains_key("tick_led")),
            // It failed before its first frame, and its markers are not known.
            None => table::FIRST.map(str::to_owned).to_vec(),
        }
    }

    /// Why this number of rows is not that of its frames, if so.
    fn wrong_count(&self, rows: u64) -> Option<String> {
        let frames = self.summary.measured.as_ref()?.frames;
        // The table of a failed run may end with the frame for which there was no space.
        let fits = if self.summary.outcome == Outcome::Failed { rows <= frames } else { rows == frames };
        (!fits).then(|| format!("the table has {}, summary.json counts {frames}", plural(rows, "row")))
    }
}

/// Reads the table of a run completely, if it has one; returns what to say of vetoes that are of none of its frames.
fn check(run: &Run) -> Result<Option<String>, StudyError> {
    if !run.has_table() {
        return Ok(None);
    }
    let names = open(run)?.1;
    let forget = |frames: &mut Frames<'_>| {
        *frames = Frames::new(&names);
        Ok(())
    };
    let added = add_all(run, &names, &mut Frames::new(&names), forget)?;
    let table = run.table().filter(|table| table.sha256.is_some());
    if table.is_some_and(|table| !is_as_recorded(&run.folder, table)) {
        return Err(StudyError::Changed { path: run.folder.join(TABLE_FILE) });
    }
    let lost = added.vetoes.without_frame(added.vetoed_ns.into_iter());
    Ok(lost.map(|said| format!("{}: {said}", run.folder.display())))
}
