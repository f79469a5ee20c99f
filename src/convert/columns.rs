//! Makes table rows from messages, and writes them to the three kinds of files.

use super::mat;
use super::{ConvertError, free};
use crate::archive::tables::{Cells, Table};
use crate::atomic_file::NewFile;
use crate::digits::fixed;
use crate::log::schema::messages::{Estimate, Marker};
use crate::log::schema::table;
use crate::sink::OutputFrame;
use crate::source::times::{decimal_seconds, seconds};
use csv::{Terminator, Writer, WriterBuilder};
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

/// Rows written together to a Parquet file.
const PIECE: usize = 1 << 14;

/// A cell.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Cell {
    Text(String),
    Whole(i64),
    /// A number, if known and finite, and its decimals in text; without them as many as needed.
    Real(Option<f64>, Option<usize>),
    /// A time in nanoseconds, written in seconds.
    Seconds(i64),
}

impl Cell {
    fn text(self) -> String {
        match self {
            Self::Text(text) => text,
            Self::Whole(number) => number.to_string(),
            Self::Real(value, decimals) => match (value.filter(|value| value.is_finite()), decimals) {
                (None, _) => String::new(),
                (Some(value), Some(decimals)) => fixed(value, decimals),
                (Some(value), None) => value.to_string(),
            },
            Self::Seconds(ns) => decimal_seconds(ns),
        }
    }

    fn empty(&self) -> Cells {
        match self {
            Self::Text(_) => Cells::Text(Vec::new()),
            Self::Whole(_) => Cells::Whole(Vec::new()),
            Self::Real(..) | Self::Seconds(_) => Cells::Real(Vec::new()),
        }
    }

    fn onto(self, column: &mut Cells) {
        match (self, column) {
            (Self::Text(text), Cells::Text(cells)) => cells.push(Some(text)),
            (Self::Whole(number), Cells::Whole(cells)) => cells.push(Some(number)),
            (Self::Real(value, _), Cells::Real(cells)) => cells.push(value.filter(|value| value.is_finite())),
            (Self::Seconds(ns), Cells::Real(cells)) => cells.push(Some(seconds(ns))),
            // All cells of a column have the kind of the first.
            _ => {}
        }
    }
}

/// Names of the columns of a frame, with one for the tick or without.
pub(super) fn names(estimate: &Estimate, ticks: bool) -> Vec<String> {
    table::header(estimate.markers.iter().map(|marker| marker.name.as_str()), ticks)
}

/// The row of a frame, as in the run's table; `None` when positions or directions are unknown in `frame`.
/// `ticks`: whether there is a column for them.
pub(super) fn row(estimate: &Estimate, frame: OutputFrame, ticks: bool) -> Option<Vec<Cell>> {
    let seq = i64::try_from(estimate.seq).unwrap_or(i64::MAX);
    let mut cells = vec![Cell::Whole(seq), Cell::Seconds(estimate.stamp_ns), Cell::Whole(estimate.stamp_ns)];
    let angles = estimate.deflection.as_ref();
    let angles = angles.map(|a| [a.theta_rad, a.theta_sd_rad, a.polar_rad, a.azimuth_rad]);
    cells.extend((0..4).map(|k| Cell::Real(angles.and_then(|a| a.get(k).map(|rad| rad.to_degrees())), Some(6))));
    for marker in &estimate.markers {
        cells.extend(place(marker, frame)?);
    }
    let direction = match (&estimate.tangent, frame) {
        (None, _) => None,
        (Some(tangent), OutputFrame::Camera) => Some((tangent.in_camera, tangent.sd_rad)),
        (Some(tangent), OutputFrame::Base) => Some((tangent.in_base?, tangent.sd_rad)),
    };
    let cell = |value: Option<f64>, decimals: usize| Cell::Real(value, Some(decimals));
    cells.extend([
        cell(direction.map(|(t, _)| t.x), 7),
        cell(direction.map(|(t, _)| t.y), 7),
        cell(direction.map(|(t, _)| t.z), 7),
        cell(direction.map(|(_, sd)| sd.to_degrees()), 6),
        Cell::Whole(i64::from(estimate.gap)),
    ]);
    cells.extend(ticks.then(|| cell(estimate.tick.map(f64::from), 0)));
    Some(cells)
}

fn place(marker: &Marker, frame: OutputFrame) -> Option<[Cell; 5]> {
    let place = match (&marker.position, frame) {
        (None, _) => None,
        (Some(position), OutputFrame::Camera) => Some((position.in_camera_m, position.sd_m)),
        (Some(position), OutputFrame::Base) => Some((position.in_base_m?, position.sd_m)),
    };
    let mm = |m: Option<f64>| Cell::Real(m.map(|m| m * 1e3), Some(6));
    Some([
        mm(place.map(|(p, _)| p.x)),
        mm(place.map(|(p, _)| p.y)),
        mm(place.map(|(p, _)| p.z)),
        mm(place.map(|(_, sd)| sd)),
        Cell::Text(marker.status.word.clone()),
    ])
}

/// A file of rows; it appears in its place only when what [finishing](Rows::finish) it gives is put there.
pub(super) struct Rows {
    names: Vec<String>,
    columns: Vec<(String, Cells)>,
    kind: Kind,
}

enum Kind {
    Csv {
        path: PathBuf,
        new: NewFile,
        writer: Box<Writer<BufWriter<File>>>,
    },
    Parquet {
        table: Box<Table>,
        waiting: usize,
    },
    /// Written at the end, variable by variable.
    Mat,
}

/// Rows that are complete.
pub(super) enum Finished {
    /// On the disk, beside their place.
    Beside(NewFile),
    /// The columns, for a file that has others, too.
    Columns(Vec<(String, Cells)>),
}

/// Kind of file.
#[derive(Debug, Clone, Copy)]
pub(super) enum FileKind {
    Csv,
    Parquet,
    Mat,
}

impl Rows {
    /// Begins a file whose columns have the kinds of `first`.
    pub(super) fn begin(kind: FileKind, path: &Path, names: Vec<String>, first: &[Cell]) -> Result<Self, ConvertError> {
        free(path)?;
        let columns: Vec<(String, Cells)> = names.iter().cloned().zip(first.iter().map(Cell::empty)).collect();
        let kind = match kind {
            FileKind::Csv => {
                let lost = |source| ConvertError::Write { path: path.to_owned(), source };
                let (new, file) = NewFile::begin(path).map_err(lost)?;
                let mut writer = WriterBuilder::new().terminator(Terminator::CRLF).from_writer(BufWriter::new(file));
                writer.write_record(&names).map_err(|error| lost(io::Error::from(error)))?;
                Kind::Csv { path: path.to_owned(), new, writer: Box::new(writer) }
            }
            FileKind::Parquet => Kind::Parquet { table: Box::new(Table::begin(path, &columns)?), waiting: 0 },
            FileKind::Mat => Kind::Mat,
        };
        Ok(Self { names, columns, kind })
    }

    /// Number of columns.
    pub(super) fn width(&self) -> usize {
        self.names.len()
    }

    /// Adds a row.
    pub(super) fn add(&mut self, row: Vec<Cell>) -> Result<(), ConvertError> {
        if let Kind::Csv { path, writer, .. } = &mut self.kind {
            let written = writer.write_record(row.into_iter().map(Cell::text));
            return written.map_err(|e| ConvertError::Write { path: path.clone(), source: io::Error::from(e) });
        }
        row.into_iter().zip(&mut self.columns).for_each(|(cell, (_, column))| cell.onto(column));
        if let Kind::Parquet { table, waiting } = &mut self.kind {
            *waiting += 1;
            if *waiting == PIECE {
                *waiting = 0;
                table.add(&self.columns)?;
                self.columns.iter_mut().for_each(|(_, cells)| clear(cells));
            }
        }
        Ok(())
    }

    /// Completes the file, which is not yet in its place.
    pub(super) fn finish(self) -> Result<Finished, ConvertError> {
        match self.kind {
            Kind::Csv { path, new, writer } => {
                let lost = |source| ConvertError::Write { path: path.clone(), source };
                let buffer = writer.into_inner().map_err(|error| lost(error.into_error()))?;
                let file = buffer.into_inner().map_err(|error| lost(error.into_error()))?;
                file.sync_all().map_err(lost)?;
                Ok(Finished::Beside(new))
            }
            Kind::Parquet { mut table, waiting } => {
                if waiting > 0 {
                    table.add(&self.columns)?;
                }
                Ok(Finished::Beside(table.complete()?))
            }
            Kind::Mat => Ok(Finished::Columns(self.columns)),
        }
    }
}

fn clear(cells: &mut Cells) {
    match cells {
        Cells::Text(cells) => cells.clear(),
        Cells::Whole(cells) => cells.clear(),
        Cells::Real(cells) => cells.clear(),
        Cells::Flag(cells) => cells.clear(),
    }
}

/// Writes a MAT file with all columns.
pub(super) fn write_mat(path: &Path, columns: &[(String, Cells)]) -> Result<(), ConvertError> {
    let lost = |source| ConvertError::Write { path: path.to_owned(), source };
    let bytes = mat::file(columns).map_err(|reason| lost(io::Error::other(reason)))?;
    crate::atomic_file::write(path, &bytes).map_err(lost)
}
