//! All runs of an archive: finds them in their folders and makes tables.

use super::tables::{Cells, Table, TableError};
use super::{Measured, RunSummary, SummaryError};
use crate::vetoes::{VetoError, Vetoes};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};

/// Greatest depth of folders searched.
const DEPTH: usize = 4;
/// Rows in memory at a time.
const ROWS: usize = 1 << 16;
const TRACK: &str = "track.csv";

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
    /// Folders with results but no summary: of an unfinished run, or of another command.
    pub(crate) unfinished: Vec<PathBuf>,
    /// Summaries that cannot be read.
    pub(crate) unread: Vec<SummaryError>,
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
    #[error(transparent)]
    Table(#[from] TableError),
    #[error(transparent)]
    Vetoes(#[from] VetoError),
}

impl Study {
    /// All runs in `folders` and below them.
    ///
    /// # Errors
    /// [`StudyError::Io`] when a folder cannot be read.
    pub(crate) fn find(folders: &[PathBuf]) -> Result<Self, StudyError> {
        let mut study = Self::default();
        for folder in folders {
            study.look(folder, 0)?;
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

    fn look(&mut self, folder: &Path, depth: usize) -> Result<(), StudyError> {
        match RunSummary::read(folder) {
            Ok(Some(summary)) => {
                self.runs.push(Run { name: summary.name.clone(), folder: folder.to_owned(), summary });
                return Ok(());
            }
            Ok(None) => {}
            Err(error) => {
                self.unread.push(error);
                return Ok(());
            }
        }
        let io = |source| StudyError::Io { path: folder.to_owned(), source };
        let mut below = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(io)? {
            let entry = entry.map_err(io)?;
            if entry.file_type().map_err(io)?.is_dir() {
                below.push(entry.path());
            }
        }
        if folder.join("log.mcap").exists() || folder.join(TRACK).exists() {
            self.unfinished.push(folder.to_owned());
        } else if depth < DEPTH {
            below.sort();
            below.iter().try_for_each(|folder| self.look(folder, depth + 1))?;
        }
        Ok(())
    }

    /// Columns of the manifests, of all runs together.
    pub(crate) fn manifest_columns(&self) -> BTreeSet<&str> {
        self.runs.iter().flat_map(|run| run.summary.manifest.keys().map(String::as_str)).collect()
    }

    /// The manifests' columns, renamed where they collide with columns of `ours`.
    fn manifest_cells(&self, ours: &[(String, Cells)], rows: &[(&Run, usize)]) -> Vec<(String, Cells)> {
        let taken = |name: &str| ours.iter().any(|(other, _)| other == name);
        let cells = |name: &str| {
            let of = |(run, times): &(&Run, usize)| {
                std::iter::repeat_n(run.summary.manifest.get(name).cloned(), *times).collect::<Vec<_>>()
            };
            Cells::Text(rows.iter().flat_map(of).collect())
        };
        let named = |name: &str| if taken(name) { format!("manifest_{name}") } else { name.to_owned() };
        self.manifest_columns().into_iter().map(|name| (named(name), cells(name))).collect()
    }

    /// Writes the table of all runs, one row each.
    ///
    /// # Errors
    /// [`StudyError`].
    pub(crate) fn write_runs(&self, place: &Path) -> Result<(), StudyError> {
        let mut columns = own_columns(&self.runs);
        let rows: Vec<(&Run, usize)> = self.runs.iter().map(|run| (run, 1)).collect();
        let manifest_cells = self.manifest_cells(&columns, &rows);
        columns.extend(manifest_cells);
        let mut table = Table::begin(place, &columns)?;
        table.add(&columns)?;
        Ok(table.finish()?)
    }

    /// Writes the table of all frames: the rows of every run's table, one run after another; returns their number.
    /// Calls `after_run` after each run.
    ///
    /// # Errors
    /// [`StudyError`].
    pub(crate) fn write_frames(&self, place: &Path, mut after_run: impl FnMut()) -> Result<u64, StudyError> {
        let mut names: Vec<String> = Vec::new();
        for run in self.with_tables() {
            for name in open(&run.folder)?.1 {
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
            let (mut reader, header) = open(&run.folder)?;
            let places: Vec<Option<usize>> =
                names.iter().map(|name| header.iter().position(|other| other == name)).collect();
            let vetoes = Vetoes::read(&run.folder)?;
            let path = run.folder.join(TRACK);
            let wrong = |line: u64, reason: String| StudyError::Track { path: path.clone(), line, reason };
            let mut row = csv::StringRecord::new();
            loop {
                let line = reader.position().line();
                match reader.read_record(&mut row) {
                    Ok(false) => break,
                    Ok(true) => frames.add(run, &row, &places, &vetoes).map_err(|reason| wrong(line, reason))?,
                    Err(error) => return Err(wrong(line, error.to_string())),
                }
                count += 1;
                if frames.rows >= ROWS {
                    table.add(&frames.take(self))?;
                }
            }
            after_run();
        }
        if frames.rows > 0 {
            table.add(&frames.take(self))?;
        }
        table.finish()?;
        Ok(count)
    }

    /// Runs with a table of frames in their folder.
    fn with_tables(&self) -> impl Iterator<Item = &Run> {
        self.runs.iter().filter(|run| run.summary.files.iter().any(|file| file.name == TRACK))
    }
}

/// The table of a run, and its header.
fn open(folder: &Path) -> Result<(csv::Reader<std::fs::File>, Vec<String>), StudyError> {
    let path = folder.join(TRACK);
    let file = std::fs::File::open(&path).map_err(|source| StudyError::Io { path: path.clone(), source })?;
    let mut reader = csv::ReaderBuilder::new().from_reader(file);
    let header = reader.headers().map(|header| header.iter().map(str::to_owned).collect());
    match header {
        Ok(header) => Ok((reader, header)),
        Err(error) => Err(StudyError::Track { path, line: 1, reason: error.to_string() }),
    }
}

/// Rows of the table of frames not written yet.
struct Frames<'a> {
    columns: Vec<(String, Cells)>,
    /// Runs of the rows, with their numbers of rows.
    runs: Vec<(&'a Run, usize)>,
    rows: usize,
    /// Why each is vetoed, if it is.
    vetoes: Vec<Option<String>>,
}

/// The kind of a column of `track.csv`, from its name.
fn kind(name: &str) -> Cells {
    match name {
        "seq" | "stamp_ns" | "gap" => Cells::Whole(Vec::new()),
        _ if name.ends_with("_status") => Cells::Text(Vec::new()),
        _ => Cells::Real(Vec::new()),
    }
}

impl<'a> Frames<'a> {
    fn new(names: &[String]) -> Self {
        let columns = names.iter().map(|name| (name.clone(), kind(name))).collect();
        Self { columns, runs: Vec::new(), rows: 0, vetoes: Vec::new() }
    }

    fn add(
        &mut self,
        run: &'a Run,
        row: &csv::StringRecord,
        places: &[Option<usize>],
        vetoes: &Vetoes,
    ) -> Result<(), String> {
        let number = |name: &str| {
            let at = self.columns.iter().position(|(other, _)| other == name)?;
            row.get(places.get(at).copied()??)?.parse::<i64>().ok()
        };
        let veto = || vetoes.of(u64::try_from(number("seq")?).ok()?, number("stamp_ns")?).map(str::to_owned);
        let veto = veto();
        self.vetoes.push(veto);
        for ((name, cells), place) in self.columns.iter_mut().zip(places) {
            let cell = place.and_then(|place| row.get(place)).filter(|cell| !cell.is_empty());
            let wrong = || format!("{name} is {}, which is no number", cell.unwrap_or_default());
            match cells {
                Cells::Text(cells) => cells.push(cell.map(str::to_owned)),
                Cells::Whole(cells) => cells.push(cell.map(str::parse).transpose().map_err(|_| wrong())?),
                Cells::Real(cells) => cells.push(cell.map(str::parse).transpose().map_err(|_| wrong())?),
                Cells::Flag(cells) => cells.push(None),
            }
        }
        match self.runs.last_mut() {
            Some((last, rows)) if last.folder == run.folder => *rows += 1,
            _ => self.runs.push((run, 1)),
        }
        self.rows += 1;
        Ok(())
    }

    /// The rows, with the names of their runs, vetoes, and the manifests' columns.
    fn take(&mut self, study: &Study) -> Vec<(String, Cells)> {
        let names = self.columns.iter().map(|(name, _)| (name.clone(), kind(name))).collect();
        let own = std::mem::replace(&mut self.columns, names);
        let runs = std::mem::take(&mut self.runs);
        self.rows = 0;
        let of = |(run, times): &(&Run, usize)| std::iter::repeat_n(Some(run.name.clone()), *times).collect::<Vec<_>>();
        let mut columns = vec![("run".to_owned(), Cells::Text(runs.iter().flat_map(of).collect()))];
        columns.extend(own);
        columns.push(("veto".to_owned(), Cells::Text(std::mem::take(&mut self.vetoes))));
        let manifest_cells = study.manifest_cells(&columns, &runs);
        columns.extend(manifest_cells);
        columns
    }
}

/// The columns of the table of runs that are not a manifest's. Date and duration of runs are not included: the same
/// archive gives the same table.
fn own_columns(runs: &[Run]) -> Vec<(String, Cells)> {
    let text = |name: &str, get: &dyn Fn(&Run) -> Option<String>| {
        (name.to_owned(), Cells::Text(runs.iter().map(get).collect()))
    };
    let whole = |name: &str, get: &dyn Fn(&Measured) -> Option<u64>| {
        let cell = |run: &Run| get(run.summary.measured.as_ref()?).and_then(|n| i64::try_from(n).ok());
        (name.to_owned(), Cells::Whole(runs.iter().map(cell).collect()))
    };
    let real = |name: &str, get: &dyn Fn(&Measured) -> Option<f64>| {
        let cell = |run: &Run| get(run.summary.measured.as_ref()?).filter(|value| value.is_finite());
        (name.to_owned(), Cells::Real(runs.iter().map(cell).collect()))
    };
    let stamp = |name: &str, get: &dyn Fn(&Measured) -> i64| {
        let cell = |run: &Run| run.summary.measured.as_ref().map(get);
        (name.to_owned(), Cells::Whole(runs.iter().map(cell).collect()))
    };
    let failed = |run: &Run| run.summary.failure.clone();
    let retryable = Cells::Flag(runs.iter().map(|run| failed(run).map(|failure| failure.retryable)).collect());
    let options = |run: &Run| {
        let words = run.summary.options.iter().map(|(name, value)| format!("{name}={value}"));
        Some(words.collect::<Vec<_>>().join(" "))
    };
    let warnings = |run: &Run| i64::try_from(run.summary.warnings.len() as u64 + run.summary.more_warnings).ok();
    let mut columns = vec![
        text("run", &|run| Some(run.name.clone())),
        text("outcome", &|run| Some(run.summary.outcome.word().to_owned())),
        text("failure", &|run| failed(run).map(|failure| failure.message)),
        ("retryable".to_owned(), retryable),
        text("ends_early", &|run| run.summary.ends_early.clone()),
        text("recording", &|run| Some(run.summary.recording.clone())),
        text("rig", &|run| Some(run.summary.rig.clone())),
        text("options", &options),
        text("recording_sha256", &|run| run.summary.sha256.recording.clone()),
        text("rig_sha256", &|run| run.summary.sha256.rig.clone()),
        text("program_sha256", &|run| run.summary.sha256.program.clone()),
        text("version", &|run| Some(run.summary.version.clone())),
        whole("frames", &|m| Some(m.frames)),
        whole("complete", &|m| Some(m.complete)),
        whole("lost", &|m| Some(m.lost)),
        whole("gaps", &|m| Some(m.gaps)),
        stamp("first_ns", &|m| m.first_ns),
        stamp("last_ns", &|m| m.last_ns),
        text("clock", &|run| run.summary.measured.as_ref().map(|m| m.clock.clone())),
        real("duration_s", &|m| Some(m.duration_s)),
        whole("theta_answered", &|m| Some(m.theta.answered)),
        real("theta_sd_deg", &|m| m.theta.sd_deg),
        real("theta_min_deg", &|m| m.theta.min_deg),
        real("theta_max_deg", &|m| m.theta.max_deg),
        whole("tangent_answered", &|m| Some(m.tangent.answered)),
        real("tangent_sd_deg", &|m| m.tangent.sd_deg),
        real("residual_rms_px", &Measured::largest_rms_px),
        real("residual_mean_px", &Measured::largest_mean_px),
        whole("drift_alarms", &|m| Some(m.drift_alarms.len() as u64)),
        ("warnings".to_owned(), Cells::Whole(runs.iter().map(warnings).collect())),
        whole("damaged_packets", &|m| Some(m.faults.damaged_packets)),
        whole("damaged_pictures", &|m| Some(m.faults.damaged_pictures)),
    ];
    let measured = || runs.iter().filter_map(|run| run.summary.measured.as_ref());
    let markers: BTreeSet<&str> =
        measured().flat_map(|m| m.markers.iter().map(|marker| marker.name.as_str())).collect();
    for name in markers {
        let find = |m: &Measured| m.markers.iter().find(|marker| marker.name == name).cloned();
        columns.push(whole(&format!("{name}_answered"), &|m| Some(find(m)?.answered)));
        columns.push(real(&format!("{name}_sd_mm"), &|m| find(m)?.sd_mm));
    }
    let misses: BTreeSet<(&str, &str)> =
        measured().flat_map(|m| m.misses.iter().map(|miss| (miss.what.as_str(), miss.reason.as_str()))).collect();
    for (what, reason) in misses {
        let count = |m: &Measured| {
            Some(
                m.misses.iter().filter(|miss| miss.what == what && miss.reason == reason).map(|miss| miss.frames).sum(),
            )
        };
        columns.push(whole(&format!("missed_{what}_{reason}"), &count));
    }
    columns
}
