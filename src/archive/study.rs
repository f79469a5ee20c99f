//! All runs of an archive: finds them in their folders and makes tables.

use super::tables::{Cells, Table, TableError};
use super::{FileRecord, Measured, Outcome, RunSummary, SummaryError, is_as_recorded};
use crate::log::schema::{LOG_FILE, TABLE_FILE, table};
use crate::plural::plural;
use crate::vetoes::{VetoError, Vetoes};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};

/// Greatest depth of folders searched; what lies deeper is reported.
const DEPTH: usize = 16;
/// Rows in memory at a time.
const ROWS: usize = 1 << 16;
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
    #[error(transparent)]
    Table(#[from] TableError),
    #[error(transparent)]
    Vetoes(#[from] VetoError),
}

impl Study {
    /// All runs in `folders` and below them. Their tables are read completely: one that was damaged after tracking, or
    /// not copied completely, must not pass for a shorter run.
    ///
    /// # Errors
    /// [`StudyError::Io`] when a folder cannot be read.
    pub(crate) fn find(folders: &[PathBuf]) -> Result<Self, StudyError> {
        let mut study = Self::default();
        let (mut known, mut searched) = (BTreeSet::new(), BTreeMap::new());
        for folder in folders {
            study.look(folder, 0, &mut known, &mut searched)?;
        }
        // A folder may have been reached a shorter way afterwards.
        let is_searched = |folder: &PathBuf| folder.canonicalize().is_ok_and(|whole| searched.contains_key(&whole));
        study.too_deep.retain(|folder| !is_searched(folder));
        for run in std::mem::take(&mut study.runs) {
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
        below(folder).map_err(io)?.iter().try_for_each(|folder| self.look(folder, depth + 1, known, searched))
    }

    /// What to say of positions in different frames of reference, if there are any.
    pub(crate) fn mixed_frames(&self) -> Option<String> {
        let mut runs: BTreeMap<String, usize> = BTreeMap::new();
        self.with_tables().filter_map(Run::frame).for_each(|frame| *runs.entry(frame).or_default() += 1);
        let of: Vec<String> =
            runs.iter().map(|(frame, times)| format!("{frame} frame in {}", plural(*times, "run"))).collect();
        let words = "positions and directions are in different frames of reference";
        let advice = format!("compare only those with the same value in column `{FRAME}`");
        (of.len() > 1).then(|| format!("{words} ({}): {advice}", of.join(", ")))
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

/// The table of a run, and its header, which has the run's columns.
fn open(run: &Run) -> Result<(csv::Reader<std::fs::File>, Vec<String>), StudyError> {
    let path = run.folder.join(TABLE_FILE);
    let wrong = |reason: String| StudyError::Track { path: path.clone(), line: 1, reason };
    let file = std::fs::File::open(&path).map_err(|source| StudyError::Io { path: path.clone(), source })?;
    let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(file);
    let header: Vec<String> =
        reader.headers().map_err(|error| wrong(error.to_string()))?.iter().map(str::to_owned).collect();
    for (at, name) in run.columns().iter().enumerate() {
        match header.get(at) {
            Some(found) if found == name => {}
            Some(found) => return Err(wrong(format!("column {} is `{found}`, it should be `{name}`", at + 1))),
            None => return Err(wrong(format!("has no column {}, which should be `{name}`", at + 1))),
        }
    }
    Ok((reader, header))
}

/// The rows of a run that were added.
struct Added {
    rows: u64,
    vetoes: Vetoes,
    /// Stamps of the vetoed frames, nanoseconds.
    vetoed_ns: Vec<i64>,
}

/// Adds the rows of a run to `frames`, whose columns are `names`, and calls `full` when there are many. The frames'
/// numbers rise, and there are as many as the summary counts.
fn add_all<'a>(
    run: &'a Run,
    names: &[String],
    frames: &mut Frames<'a>,
    mut full: impl FnMut(&mut Frames<'a>) -> Result<(), StudyError>,
) -> Result<Added, StudyError> {
    let (mut reader, header) = open(run)?;
    let places: Vec<Option<usize>> = names.iter().map(|name| header.iter().position(|other| other == name)).collect();
    let vetoes = Vetoes::read(&run.folder)?;
    let wrong = |line: u64, reason: String| StudyError::Track { path: run.folder.join(TABLE_FILE), line, reason };
    let mut row = csv::StringRecord::new();
    let (mut count, mut last_seq, mut vetoed_ns) = (0, None, Vec::new());
    loop {
        // The reader's own count lags behind by one at CRLF.
        let line = count + 2;
        if !reader.read_record(&mut row).map_err(|error| wrong(line, error.to_string()))? {
            return match run.wrong_count(count) {
                Some(reason) => Err(wrong(count + 1, reason)),
                None => Ok(Added { rows: count, vetoes, vetoed_ns }),
            };
        }
        if row.len() != header.len() {
            return Err(wrong(line, format!("has {} of the header's {} cells", row.len(), header.len())));
        }
        let (seq, stamp_ns) = frames.add(run, &row, &places, &vetoes).map_err(|reason| wrong(line, reason))?;
        vetoed_ns.extend(vetoes.of(stamp_ns).map(|_| stamp_ns));
        if let Some(last) = last_seq.replace(seq).filter(|last| *last >= seq) {
            return Err(wrong(line, format!("frame {seq} comes after frame {last}; their numbers should rise")));
        }
        count += 1;
        if frames.rows >= ROWS {
            full(frames)?;
        }
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

    /// Adds a row of a run's table; returns number and stamp of the frame.
    fn add(
        &mut self,
        run: &'a Run,
        row: &csv::StringRecord,
        places: &[Option<usize>],
        vetoes: &Vetoes,
    ) -> Result<(i64, i64), String> {
        let number = |name: &str| {
            let at = self.columns.iter().position(|(other, _)| other == name);
            let cell = at.and_then(|at| row.get(places.get(at).copied()??)).unwrap_or_default();
            cell.parse::<i64>().map_err(|_| format!("{name} is `{cell}`, it should be a whole number"))
        };
        let (seq, stamp_ns, _) = (number(table::SEQ)?, number(table::STAMP_NS)?, number(table::GAP)?);
        self.vetoes.push(vetoes.of(stamp_ns).map(str::to_owned));
        for ((name, cells), place) in self.columns.iter_mut().zip(places) {
            let cell = place.and_then(|place| row.get(place)).filter(|cell| !cell.is_empty());
            let wrong = || format!("{name} is {}, which is no number", cell.unwrap_or_default());
            match cells {
                Cells::Text(cells) => cells.push(cell.map(str::to_owned)),
                Cells::Whole(cells) => cells.push(cell.map(str::parse).transpose().map_err(|_| wrong())?),
                Cells::Real(cells) => {
                    let number: Option<f64> = cell.map(str::parse).transpose().map_err(|_| wrong())?;
                    // The words for infinity are numbers to the parser; no measurement is.
                    cells.push(number.map(|n| if n.is_finite() { Ok(n) } else { Err(wrong()) }).transpose()?);
                }
                Cells::Flag(cells) => cells.push(None),
            }
        }
        match self.runs.last_mut() {
            Some((last, rows)) if last.folder == run.folder => *rows += 1,
            _ => self.runs.push((run, 1)),
        }
        self.rows += 1;
        Ok((seq, stamp_ns))
    }

    /// The rows, with the names and frames of reference of their runs, vetoes, and the manifests' columns.
    fn take(&mut self, study: &Study) -> Vec<(String, Cells)> {
        let names = self.columns.iter().map(|(name, _)| (name.clone(), kind(name))).collect();
        let own = std::mem::replace(&mut self.columns, names);
        let runs = std::mem::take(&mut self.runs);
        self.rows = 0;
        let text = |get: fn(&Run) -> Option<String>| {
            Cells::Text(runs.iter().flat_map(|(run, times)| std::iter::repeat_n(get(run), *times)).collect())
        };
        let mut columns =
            vec![("run".to_owned(), text(|run| Some(run.name.clone()))), (FRAME.to_owned(), text(Run::frame))];
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
        text(FRAME, &Run::frame),
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
