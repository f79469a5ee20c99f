//! The frames of all runs, as one table: read from the tables of the runs, some at a time.

use super::{FRAME, Run, Study, StudyError};
use crate::archive::tables::Cells;
use crate::log::schema::{TABLE_FILE, table};
use crate::vetoes::Vetoes;

/// Rows in memory at a time.
const ROWS: usize = 1 << 16;

/// The table of a run, and its header, which has the run's columns.
pub(super) fn open(run: &Run) -> Result<(csv::Reader<std::fs::File>, Vec<String>), StudyError> {
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
pub(super) struct Added {
    pub(super) rows: u64,
    pub(super) vetoes: Vetoes,
    /// Stamps of the vetoed frames, nanoseconds.
    pub(super) vetoed_ns: Vec<i64>,
}

/// Adds the rows of a run to `frames`, whose columns are `names`, and calls `full` when there are many. The frames'
/// numbers rise, and there are as many as the summary counts.
pub(super) fn add_all<'a>(
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
pub(super) struct Frames<'a> {
    columns: Vec<(String, Cells)>,
    /// Runs of the rows, with their numbers of rows.
    runs: Vec<(&'a Run, usize)>,
    pub(super) rows: usize,
    /// Why each is vetoed, if it is.
    vetoes: Vec<Option<String>>,
}

/// The kind of a column of `track.csv`, from its name.
fn kind(name: &str) -> Cells {
    match name {
        table::SEQ | table::STAMP_NS | table::GAP => Cells::Whole(Vec::new()),
        _ if name.ends_with("_status") => Cells::Text(Vec::new()),
        _ => Cells::Real(Vec::new()),
    }
}

impl<'a> Frames<'a> {
    pub(super) fn new(names: &[String]) -> Self {
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
            let wrong = || format!("{name} is {}, which is not a number", cell.unwrap_or_default());
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
    pub(super) fn take(&mut self, study: &Study) -> Vec<(String, Cells)> {
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
