//! A run from its table: this program's ([`crate::sink::CsvSink`]), or another with the same column names.
//!
//! Required are a time (`stamp_ns` or `t_s`) and either `theta_deg` or the three coordinates of a marker (`tip_x_mm`,
//! …; `x_mm` without a name is the tip's). Everything else is optional.

use super::sheet::{Row, Sheet, is_missing};
use super::{Frame, OK, Place, Recording, SeriesError};
use crate::log::schema::table as columns;
use crate::sink::OutputFrame;
use crate::source::times::seconds;
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// Marker of coordinates without a name.
const UNNAMED: &str = "tip";
const M_PER_MM: f64 = 1e-3;
/// Times that are written twice span the same, but for this fraction.
const SAME_SPAN: f64 = 0.01;

/// Columns of a marker.
struct Marker {
    name: String,
    xyz: [usize; 3],
    sd: Option<usize>,
    status: Option<usize>,
}

/// Reads the table at `path`.
pub(super) fn read(path: &Path) -> Result<Recording, SeriesError> {
    let mut sheet = Sheet::read(path)?;
    let cut = partial_last_line(&mut sheet);
    sheet.check_row_widths()?;
    let stamp = sheet.find(columns::STAMP_NS);
    let t_s = sheet.find(columns::T_S);
    if stamp.or(t_s).is_none() {
        return Err(sheet.wrong(format!("has no times of frames: expected a column stamp_ns or t_s{}", there(&sheet))));
    }
    let markers = markers(&sheet)?;
    markers.iter().try_for_each(|marker| marker.check_status(&sheet))?;
    let theta = sheet.find(columns::THETA_DEG);
    if markers.is_empty() && theta.is_none() {
        let expected =
            "has nothing that was measured: expected a column theta_deg, or a place as tip_x_mm, tip_y_mm, tip_z_mm";
        return Err(sheet.wrong(format!("{expected}{}", there(&sheet))));
    }
    let tangent = sheet.all_of(columns::TANGENT)?;
    let others = [columns::THETA_SD_DEG, columns::TANGENT_SD_DEG, columns::SEQ, columns::GAP, columns::TICK];
    let [theta_sd, tangent_sd, seq, gap, tick] = others.map(|name| sheet.find(name));
    let angle = |row: &Row, column: Option<usize>| -> Result<Option<f64>, SeriesError> {
        let degrees = column.map(|column| sheet.number(row, column)).transpose()?.flatten();
        Ok(degrees.map(f64::to_radians))
    };
    let count = |row: &Row, column: Option<usize>, otherwise: u64| -> Result<u64, SeriesError> {
        let Some(column) = column else { return Ok(otherwise) };
        u64::try_from(sheet.integer(row, column)?)
            .map_err(|_| sheet.wrong_at(row, format!("the count in column {} is negative", sheet.name_of(column))))
    };
    let tick_of = |row: &Row| -> Result<Option<u64>, SeriesError> {
        let there = tick.filter(|column| row.cells.get(*column).is_some_and(|cell| !is_missing(cell)));
        there.map(|_| count(row, tick, 0)).transpose()
    };
    let mut frames: Vec<Frame> = Vec::with_capacity(sheet.rows.len());
    same_times(&sheet)?;
    for (index, row) in (0..).zip(&sheet.rows) {
        let stamp_ns = match (stamp, t_s) {
            (Some(column), _) => sheet.integer(row, column)?,
            (None, Some(column)) => sheet.seconds_ns(row, column)?,
            (None, None) => 0,
        };
        let number = count(row, seq, index)?;
        // Where it is not told how many were lost, the frames' numbers tell.
        let lost = frames.last().map_or(0, |before| number.saturating_sub(before.seq).saturating_sub(1));
        frames.push(Frame {
            seq: number,
            stamp_ns,
            host_ns: None,
            gap: count(row, gap, lost)?,
            theta_rad: angle(row, theta)?,
            theta_sd_rad: angle(row, theta_sd)?,
            theta_status: None,
            places: markers.iter().map(|marker| marker.place(&sheet, row)).collect::<Result<_, _>>()?,
            tangent: tangent.map(|columns| vector(&sheet, row, columns)).transpose()?.flatten(),
            tangent_sd_rad: angle(row, tangent_sd)?,
            tick: tick_of(row)?,
        });
    }
    Ok(Recording {
        path: path.to_owned(),
        clock: None,
        reference: reference(path),
        markers: markers.into_iter().map(|marker| marker.name).collect(),
        frames,
        currents: Vec::new(),
        cut,
        vetoed: 0,
        currents_lost: 0,
    })
}

/// Refuses a table whose two columns of times do not run alike: one is in another unit.
fn same_times(sheet: &Sheet) -> Result<(), SeriesError> {
    let (Some(stamp), Some(t_s)) = (sheet.find(columns::STAMP_NS), sheet.find(columns::T_S)) else { return Ok(()) };
    let (Some(first), Some(last)) = (sheet.rows.first(), sheet.rows.last()) else { return Ok(()) };
    let by_stamps_ns = sheet.integer(last, stamp)?.saturating_sub(sheet.integer(first, stamp)?);
    // Only stamps are used: seconds may be missing.
    let (Ok(from_ns), Ok(to_ns)) = (sheet.seconds_ns(first, t_s), sheet.seconds_ns(last, t_s)) else { return Ok(()) };
    let by_seconds_ns = to_ns.saturating_sub(from_ns);
    if by_stamps_ns.abs_diff(by_seconds_ns) as f64 <= SAME_SPAN * by_stamps_ns.unsigned_abs() as f64 {
        return Ok(());
    }
    Err(sheet.wrong(format!(
        "its rows span {} s by stamp_ns and {} s by t_s: one of them is in another unit (nanoseconds and seconds are \
         expected)",
        seconds(by_stamps_ns),
        seconds(by_seconds_ns)
    )))
}

/// The last line of a table whose writer was killed; it is left out.
fn partial_last_line(sheet: &mut Sheet) -> Option<String> {
    let width = sheet.width;
    let (rows, last) = (sheet.rows.len(), sheet.rows.last()?);
    let ours = sheet.header.as_ref()?.starts_with(&columns::FIRST.map(str::to_owned));
    let torn = !sheet.last_line_ended && (ours || last.cells.len() != width) && rows > 1;
    let line = last.line;
    torn.then(|| {
        sheet.rows.pop();
        format!("the last line ({line}) is incomplete; it is left out")
    })
}

/// The columns that exist, for a message.
fn there(sheet: &Sheet) -> String {
    sheet.header.as_ref().map_or("; it has no header".to_owned(), |names| format!("; it has {}", names.join(", ")))
}

fn markers(sheet: &Sheet) -> Result<Vec<Marker>, SeriesError> {
    let mut markers = Vec::new();
    for column in sheet.header.iter().flatten() {
        let Some(prefix) =
            column.strip_suffix(columns::PLACE_MM[0]).filter(|prefix| prefix.is_empty() || prefix.ends_with('_'))
        else {
            continue;
        };
        let named = columns::PLACE_MM.map(|axis| format!("{prefix}{axis}"));
        let Some(xyz) = sheet.all_of(named.each_ref().map(String::as_str))? else { continue };
        let name = prefix.strip_suffix('_').unwrap_or(UNNAMED).to_owned();
        let [sd, status] = [columns::PLACE_SD_MM, columns::PLACE_STATUS].map(|of| sheet.find(&format!("{prefix}{of}")));
        markers.push(Marker { name, xyz, sd, status });
    }
    Ok(markers)
}

impl Marker {
    fn place(&self, sheet: &Sheet, row: &Row) -> Result<Place, SeriesError> {
        let point = vector(sheet, row, self.xyz)?.map(|mm| Point3::from(mm * M_PER_MM));
        let sd_mm = self.sd.map(|column| sheet.number(row, column)).transpose()?.flatten();
        if let Some(sd_mm) = sd_mm.filter(|sd_mm| *sd_mm < 0.0) {
            let problem = format!("σ of the marker's position is {sd_mm} mm: a standard deviation is not negative");
            return Err(sheet.wrong_at(row, problem));
        }
        let known = || if point.is_some() { OK } else { "missing" }.to_owned();
        let status = self.word(row).map_or_else(known, String::to_owned);
        // Another program may leave there what was last measured, or a guess.
        let point = point.filter(|_| status.eq_ignore_ascii_case(OK));
        Ok(Place { point, sd_m: sd_mm.map(|mm| mm * M_PER_MM), status })
    }

    /// The row's status, if it has one.
    fn word<'a>(&self, row: &'a Row) -> Option<&'a String> {
        self.status.and_then(|column| row.cells.get(column)).filter(|word| !word.is_empty())
    }

    /// Refuses a column of statuses of which no row says that its place counts.
    fn check_status(&self, sheet: &Sheet) -> Result<(), SeriesError> {
        let mut words = sheet.rows.iter().filter_map(|row| self.word(row)).peekable();
        let (Some(column), Some(first)) = (self.status, words.peek().copied()) else { return Ok(()) };
        let has_places =
            || sheet.rows.iter().any(|row| row.cells.get(self.xyz[0]).is_some_and(|cell| !is_missing(cell)));
        if words.any(|word| word.eq_ignore_ascii_case(OK)) || !has_places() {
            return Ok(());
        }
        let name = sheet.name_of(column);
        Err(sheet.wrong(format!(
            "no row has `{OK}` in column {name} (the first has `{first}`), so no place would count; name the column \
             otherwise if it says something else"
        )))
    }
}

/// Three cells; `None` when all are missing.
fn vector(sheet: &Sheet, row: &Row, columns: [usize; 3]) -> Result<Option<Vector3<f64>>, SeriesError> {
    let [x, y, z] = [sheet.number(row, columns[0])?, sheet.number(row, columns[1])?, sheet.number(row, columns[2])?];
    match (x, y, z) {
        (Some(x), Some(y), Some(z)) => Ok(Some(Vector3::new(x, y, z))),
        (None, None, None) => Ok(None),
        _ => {
            let missing = columns.into_iter().find(|column| row.cells.get(*column).is_none_or(|cell| is_missing(cell)));
            let name = missing.map_or_else(String::new, |column| sheet.name_of(column));
            Err(sheet.wrong_at(row, format!("one of three coordinates is missing, in column {name}")))
        }
    }
}

/// Frame of reference from the `run.toml` beside one of our tables; `None` without one.
fn reference(path: &Path) -> Option<OutputFrame> {
    let path = path.with_file_name("run.toml");
    let read = match std::fs::read_to_string(&path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return None,
        read => read.map_err(|error| error.to_string()),
    };
    let stated = read.and_then(|text| text.parse::<toml::Table>().map_err(|error| error.message().to_owned()));
    match stated {
        Ok(run) => match run.get("frame")?.as_str()? {
            "base" => Some(OutputFrame::Base),
            "camera" => Some(OutputFrame::Camera),
            _ => None,
        },
        Err(why) => {
            tracing::warn!("{}: cannot be read ({why}): the table may be in the camera's frame", path.display());
            None
        }
    }
}
