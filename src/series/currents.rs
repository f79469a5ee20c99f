//! Tables of coil currents: those followed by `catoptra live --currents file:`, and those written by `catoptra excite`.
//!
//! One column is the time, all others are coils, amperes; of several times the first of these counts:
//!
//! | column | time |
//! |---|---|
//! | `host_ns`, `unix_s` | the host's clock, since 1970: mapped to the camera's by the frames of a live run |
//! | `stamp_ns` | the camera's clock, nanoseconds |
//! | `t_s` | seconds since a start that is not in the table; if not given either, from the frames' ticks if there are any, else taken for the camera's clock with a notice |

use super::sheet::Sheet;
use super::{Current, Recording, SeriesError};
use crate::source::current_columns::{CurrentColumns, TimeColumn};
use crate::source::times::{decimal_seconds, seconds};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Clock of the times in a table of currents.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CurrentClock {
    /// The host's clock, since 1970.
    Host,
    /// The camera's clock.
    Camera,
    /// Since a start that is not in the table.
    Start,
}

/// Currents of all coils from a moment on.
#[derive(Debug, Clone, PartialEq)]
pub struct CurrentRow {
    /// When, nanoseconds on the table's clock.
    pub time_ns: i64,
    /// One entry per coil, amperes.
    pub values_a: Vec<f64>,
}

/// A table of coil currents.
#[derive(Debug, Clone, PartialEq)]
pub struct CurrentTable {
    /// The file it was read from.
    pub path: PathBuf,
    /// Clock of its times.
    pub clock: CurrentClock,
    /// Names of the coils' columns, in the order of [`CurrentRow::values_a`].
    pub coils: Vec<String>,
    /// The rows, with increasing times.
    pub rows: Vec<CurrentRow>,
}

/// Camera times of the rows, from ticks.
struct Ticked {
    times_ns: Vec<i64>,
    /// Whether ticks give the first time alone.
    start_only: bool,
}

impl CurrentTable {
    /// Reads a table of text, see [`CurrentTable::read`].
    pub(super) fn of_sheet(path: &Path) -> Result<Self, SeriesError> {
        let sheet = Sheet::read(path)?;
        sheet.check_row_widths()?;
        let names = sheet.header.as_deref().unwrap_or_default();
        let columns = CurrentColumns::of(names).map_err(|problem| sheet.wrong(problem))?;
        let coils: Vec<String> = columns.coils.iter().filter_map(|column| names.get(*column).cloned()).collect();
        let clock = match columns.times {
            TimeColumn::HostNs | TimeColumn::UnixSeconds => CurrentClock::Host,
            TimeColumn::StampNs => CurrentClock::Camera,
            TimeColumn::StartSeconds => CurrentClock::Start,
        };
        let mut rows: Vec<CurrentRow> = Vec::with_capacity(sheet.rows.len());
        for row in &sheet.rows {
            let time_ns = match columns.times {
                TimeColumn::HostNs | TimeColumn::StampNs => sheet.integer(row, columns.time)?,
                TimeColumn::UnixSeconds | TimeColumn::StartSeconds => sheet.seconds_ns(row, columns.time)?,
            };
            if let Some(before) = rows.last().filter(|before| before.time_ns >= time_ns) {
                let (now, then) = (seconds(time_ns), seconds(before.time_ns));
                return Err(
                    sheet.wrong_at(row, format!("its time, {now} s, is not later than the one before, {then} s"))
                );
            }
            let value = |column: &usize| {
                sheet.number(row, *column)?.ok_or_else(|| {
                    sheet.wrong_at(row, format!("the current in column {} is missing", sheet.name_of(*column)))
                })
            };
            rows.push(CurrentRow { time_ns, values_a: columns.coils.iter().map(value).collect::<Result<_, _>>()? });
        }
        if rows.is_empty() {
            return Err(sheet.wrong("has a header and no row".to_owned()));
        }
        Ok(Self { path: path.to_owned(), clock, coils, rows })
    }

    /// The currents on the camera's clock of `recording`. Times counted from a start begin at `start_ns` of that clock;
    /// without it they are taken for that clock's own, which [`CurrentTable::assumption`] states.
    ///
    /// # Errors
    /// When the table has the host's times and no frame relates them to the camera's.
    pub fn on_camera_clock(&self, recording: &Recording, start_ns: Option<i64>) -> Result<Vec<Current>, SeriesError> {
        let host = self.clock == CurrentClock::Host;
        let clocks = recording.clocks().filter(|_| host);
        if host && clocks.is_none() {
            let problem = format!(
                "has times of the host, and {} does not tell how these stand to the camera's: give the log of a live \
                 run, or a table with stamp_ns or t_s",
                recording.path.display()
            );
            return Err(SeriesError::Content { path: self.path.clone(), problem });
        }
        if let Some(Ticked { times_ns, .. }) = self.by_ticks(recording, start_ns)? {
            let current = |(row, ns): (&CurrentRow, i64)| Current {
                host_ns: None,
                stamp_ns: Some(ns),
                values_a: row.values_a.clone(),
            };
            return Ok(self.rows.iter().zip(times_ns).map(current).collect());
        }
        let start_ns = if self.clock == CurrentClock::Start { start_ns.unwrap_or(0) } else { 0 };
        let stamp = |time_ns: i64| match &clocks {
            Some(clocks) => clocks.camera_ns(time_ns),
            None => time_ns.saturating_add(start_ns),
        };
        let current = |row: &CurrentRow| Current {
            host_ns: host.then_some(row.time_ns),
            stamp_ns: Some(stamp(row.time_ns)),
            values_a: row.values_a.clone(),
        };
        Ok(self.rows.iter().map(current).collect())
    }

    /// As text: `t_s`, seconds from the start, and one column per coil, amperes.
    pub(crate) fn to_text(&self) -> String {
        let mut text = format!("t_s,{}\r\n", self.coils.join(","));
        for row in &self.rows {
            text += &decimal_seconds(row.time_ns);
            for value in &row.values_a {
                let _ = write!(text, ",{value}"); // into text it cannot fail
            }
            text += "\r\n";
        }
        text
    }

    /// Camera times of the rows by the recording's ticks: if times count from a start that is not given. If the count
    /// resolves the commands, each row gets the time at which it was taken; otherwise the first tick is the start.
    fn by_ticks(&self, recording: &Recording, start_ns: Option<i64>) -> Result<Option<Ticked>, SeriesError> {
        if self.clock != CurrentClock::Start || start_ns.is_some() {
            return Ok(None);
        }
        let Some(ticks) = recording.ticks()? else { return Ok(None) };
        let (Some(first), Some(tick_ns)) = (self.rows.first(), ticks.times_ns.first()) else { return Ok(None) };
        let pairs = self.rows.iter().zip(self.rows.iter().skip(1));
        let closest = pairs.map(|(a, b)| b.time_ns.saturating_sub(a.time_ns)).min().unwrap_or(i64::MAX);
        if !ticks.resolves(closest) {
            let shift = tick_ns.saturating_sub(first.time_ns);
            let times_ns = self.rows.iter().map(|row| row.time_ns.saturating_add(shift)).collect();
            return Ok(Some(Ticked { times_ns, start_only: true }));
        }
        if ticks.times_ns.len() != self.rows.len() {
            let problem = format!(
                "has {} rows, and {} counts {} commands by its ticks: one row is one command; give the list \
                 that was sent, or the start",
                self.rows.len(),
                recording.path.display(),
                ticks.times_ns.len()
            );
            return Err(SeriesError::Content { path: self.path.clone(), problem });
        }
        Ok(Some(Ticked { times_ns: ticks.times_ns, start_only: false }))
    }

    /// What is assumed about the table's times for this recording, in words.
    pub fn assumption(&self, recording: &Recording, start_ns: Option<i64>) -> Option<String> {
        match self.by_ticks(recording, start_ns) {
            Ok(Some(Ticked { start_only: false, .. })) => {
                return Some("commands have the times at which the frames' tick counts them".to_owned());
            }
            Ok(Some(Ticked { start_only: true, .. })) => {
                let words = "the first command has the time at which the frames' tick first changes, the others follow \
                    as in the table: they are too close for the tick to count them";
                return Some(words.to_owned());
            }
            // Nothing is assumed where the currents have no times.
            Err(_) => return None,
            Ok(None) => {}
        }
        match (self.clock, start_ns) {
            (CurrentClock::Host, _) => {
                Some("host's times, late by the least delay from exposure to arrival".to_owned())
            }
            (CurrentClock::Camera, _) => None,
            (CurrentClock::Start, None) => Some("t_s is taken for the camera's clock: no start was given".to_owned()),
            // As given.
            (CurrentClock::Start, Some(_)) => None,
        }
    }
}
