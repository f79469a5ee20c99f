//! A text table as in the file: cells, and the line of each row.
//!
//! Cells are separated by comma, semicolon or tab, or else by white space, as in the first line. Lines that begin with
//! `#` or `%` and empty lines are left out. The first line is a header unless all its cells are numbers. Numbers may
//! have decimal commas where something else separates cells, or cells are quoted: see [`decimal_commas`].

use super::SeriesError;
use crate::csv_lines::{Lines, open_quote};
use crate::plural::plural;
use crate::rig::nearest;
use crate::source::times::parse_seconds_ns;
use crate::text_file::is_utf_16;
use csv::{ReaderBuilder, Trim};
use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

/// Largest table, bytes: a device such as /dev/zero has no end.
const LARGEST: u64 = 1 << 30;
/// What some programs begin text in UTF-8 with.
const BYTE_ORDER_MARK: &[u8] = "\u{feff}".as_bytes();
/// Bytes examined to tell whether it is text.
const BEGINNING: u64 = 4096;

/// A table.
#[derive(Debug)]
pub(super) struct Sheet {
    pub(super) path: PathBuf,
    /// Names of the columns, if there is a header.
    pub(super) header: Option<Vec<String>>,
    pub(super) width: usize,
    pub(super) rows: Vec<Row>,
    /// Whether the last line is terminated: a killed writer leaves half a line.
    pub(super) last_line_ended: bool,
}

/// A row: its line in the file, from 1, and its cells.
#[derive(Debug)]
pub(super) struct Row {
    pub(super) line: u64,
    pub(super) cells: Vec<String>,
}

/// Words of other programs for what is missing.
const MISSING: [&str; 6] = ["na", "n/a", "null", "none", "-", "?"];

/// Whether a cell is empty or a word for an unknown number.
pub(super) fn is_missing(cell: &str) -> bool {
    cell.is_empty() || cell.eq_ignore_ascii_case("nan") || cell == "-nan"
}

/// What separates the cells of a table with this first line; white space where it is `None`.
///
/// Commas are decimal ones where the cells that semicolons, tabs or blanks separate are numbers with them.
fn separator(first: &str) -> Option<char> {
    let are_decimal = |cells: Vec<&str>| {
        let has_comma = |cell: &&str| decimal_comma(cell.trim()).is_some();
        cells.len() > 1
            && cells.iter().any(has_comma)
            && cells.iter().all(|cell| has_comma(cell) || is_numeric(cell.trim()))
    };
    match [';', '\t'].into_iter().find(|separator| first.contains(*separator)) {
        other if !first.contains(',') => other,
        Some(separator) if are_decimal(first.split(separator).collect()) => Some(separator),
        None if are_decimal(first.split_whitespace().collect()) => None,
        _ => Some(','),
    }
}

/// A number with a decimal comma, with a point.
fn decimal_comma(cell: &str) -> Option<String> {
    let (before, after) = cell.split_once(',')?;
    let is_digit = |character: Option<char>| character.is_some_and(|c| c.is_ascii_digit());
    let number = format!("{before}.{after}");
    (is_digit(after.chars().next()) && !before.contains('.') && number.parse::<f64>().is_ok()).then_some(number)
}

/// Reads numbers with decimal commas, if they are that in the whole table: where some numbers have points, or all
/// commas may part thousands (`1,250`), the cells stay as they are, and no numbers.
fn decimal_commas(rows: &mut [Row]) {
    let may_be_thousands = |cell: &str| {
        let unsigned = cell.trim_start_matches(['+', '-']);
        let (before, after) = unsigned.split_once(',').unwrap_or_default();
        (1..=3).contains(&before.len())
            && !before.starts_with('0')
            && after.len() == 3
            && after.bytes().all(|byte| byte.is_ascii_digit())
    };
    let has_point = |cell: &String| cell.contains('.') && cell.parse::<f64>().is_ok();
    let cells = || rows.iter().flat_map(|row| &row.cells);
    if cells().any(has_point) || !cells().any(|cell| decimal_comma(cell).is_some() && !may_be_thousands(cell)) {
        return;
    }
    for cell in rows.iter_mut().flat_map(|row| &mut row.cells) {
        if let Some(number) = decimal_comma(cell) {
            *cell = number;
        }
    }
}

/// Whether a row has words and no number.
fn is_wordy(row: &Row) -> bool {
    row.cells.iter().all(|cell| is_missing(cell) || !is_numeric(cell)) && !row.cells.iter().all(|cell| is_missing(cell))
}

/// A number or a word for a missing one.
fn is_numeric(cell: &str) -> bool {
    is_missing(cell) || cell.parse::<f64>().is_ok()
}

/// Refuses a first line of numbers and words for missing ones, which is no header, and warns of one that counts.
fn check_first(path: &Path, row: &Row) -> Result<(), SeriesError> {
    let is_word = |cell: &&String| MISSING.iter().any(|word| cell.eq_ignore_ascii_case(word));
    let all_known = row.cells.iter().all(|cell| is_numeric(cell) || is_word(&cell));
    if let Some(word) = row.cells.iter().find(is_word).filter(|_| all_known && row.cells.len() > 1) {
        let problem = format!("`{word}` is not a number; what is missing is empty or `nan`");
        return Err(SeriesError::Line { path: path.to_owned(), line: row.line, problem });
    }
    let counts = |from: usize| row.cells.iter().zip(from..).all(|(cell, number)| *cell == number.to_string());
    if row.cells.len() > 1 && (counts(0) || counts(1)) {
        let cells = row.cells.join(", ");
        tracing::warn!(
            "{}: its first line, {cells}, counts as a row; are these numbers of columns? (in pandas header=False \
             leaves them out)",
            path.display()
        );
    }
    Ok(())
}

impl Sheet {
    /// Reads the table at `path`.
    ///
    /// # Errors
    /// When it cannot be read, is not text, or has no line.
    pub(super) fn read(path: &Path) -> Result<Self, SeriesError> {
        let content = |problem: &str| SeriesError::Content { path: path.to_owned(), problem: problem.to_owned() };
        let text = text_of(path)?;
        let is_data = |line: &str| !line.trim().is_empty() && !line.trim_start().starts_with(['#', '%']);
        let Some(first) = text.lines().find(|line| is_data(line)) else {
            return Err(content("is empty; expected a table of numbers (CSV)"));
        };
        let mut rows = match separator(first) {
            Some(separator) => separated(path, &text, separator as u8)?,
            None => spaced(&text),
        };
        rows.retain(|row| row.cells.len() > 1 || row.cells.iter().any(|cell| !cell.is_empty()));
        decimal_commas(&mut rows);
        if let Some(row) = rows.first() {
            check_first(path, row)?;
        }
        let headed = rows.first().is_some_and(|row| !row.cells.iter().all(|cell| is_numeric(cell)));
        let header = headed.then(|| rows.remove(0).cells);
        let width = header.as_ref().or(rows.first().map(|row| &row.cells)).map_or(0, Vec::len);
        if let (Some(_), [first, second, ..]) = (&header, rows.as_slice())
            && is_wordy(first)
            && !is_wordy(second)
        {
            let problem = "has words under the header, not numbers; if they are units, write them into the names (as \
                           `t_ms`), and begin this line with #";
            return Err(SeriesError::Line { path: path.to_owned(), line: first.line, problem: problem.to_owned() });
        }
        let sheet = Self { path: path.to_owned(), header, width, rows, last_line_ended: text.ends_with(['\n', '\r']) };
        sheet.check_unique_names()?;
        Ok(sheet)
    }

    fn check_unique_names(&self) -> Result<(), SeriesError> {
        let mut names: Vec<&String> = self.header.iter().flatten().filter(|name| !name.is_empty()).collect();
        names.sort_unstable();
        match names.windows(2).find(|pair| matches!(pair, [a, b] if a == b)) {
            Some([twice, _]) => Err(self.wrong(format!("the header has the column `{twice}` twice"))),
            _ => Ok(()),
        }
    }

    /// Rejects rows with a different number of cells than the first line.
    pub(super) fn check_row_widths(&self) -> Result<(), SeriesError> {
        match self.rows.iter().find(|row| row.cells.len() != self.width) {
            Some(row) => Err(self
                .wrong_at(row, format!("has {}, the first line has {}", plural(row.cells.len(), "cell"), self.width))),
            None => Ok(()),
        }
    }

    /// Index of the column with this name, if there is one.
    pub(super) fn find(&self, name: &str) -> Option<usize> {
        self.header.as_ref()?.iter().position(|column| column == name)
    }

    /// Index of a column by its name or, if there is none, by its number from 1.
    pub(super) fn column(&self, name: &str) -> Result<usize, SeriesError> {
        if let Some(index) = self.find(name) {
            return Ok(index);
        }
        let number = name.parse::<usize>().ok();
        if let Some(index) = number.and_then(|n| n.checked_sub(1)).filter(|index| *index < self.width) {
            return Ok(index);
        }
        Err(self.wrong(match (&self.header, number) {
            (_, Some(_)) => format!("has no column {name}; columns are numbered from 1 to {}", self.width),
            (None, None) => {
                format!(
                    "has no header, and so no column `{name}`: write one, or give the column's number, 1 to {}, where \
                     an option asks for it",
                    self.width
                )
            }
            (Some(names), None) => match nearest(name, names.iter().map(String::as_str)) {
                Some(near) if names.len() > 1 => {
                    format!("has no column `{name}`; it has {}: did you mean `{near}`?", names.join(", "))
                }
                _ => format!("has no column `{name}`; it has {}", names.join(", ")),
            },
        }))
    }

    /// Indices of columns that belong together; `None` when there is none of them.
    pub(super) fn all_of(&self, names: [&str; 3]) -> Result<Option<[usize; 3]>, SeriesError> {
        let Some(there) = names.into_iter().find(|name| self.find(name).is_some()) else { return Ok(None) };
        let column = |name: &str| self.find(name).ok_or_else(|| self.wrong(format!("has {there}, but no {name}")));
        Ok(Some([column(names[0])?, column(names[1])?, column(names[2])?]))
    }

    /// A cell as a whole number, exactly.
    pub(super) fn integer(&self, row: &Row, column: usize) -> Result<i64, SeriesError> {
        let cell = row.cells.get(column).map_or("", String::as_str);
        cell.parse().map_err(|_| {
            let (cell, name) = (cell.escape_debug(), self.name_of(column));
            self.wrong_at(row, format!("`{cell}` in column {name} is not a whole number"))
        })
    }

    /// A cell of decimal seconds in nanoseconds, exactly.
    pub(super) fn seconds_ns(&self, row: &Row, column: usize) -> Result<i64, SeriesError> {
        let cell = row.cells.get(column).map_or("", String::as_str);
        parse_seconds_ns(cell).ok_or_else(|| {
            let (cell, name) = (cell.escape_debug(), self.name_of(column));
            self.wrong_at(row, format!("`{cell}` in column {name} is not a time in seconds, such as 0.0166667"))
        })
    }

    /// A cell as a number; `None` when it is missing.
    pub(super) fn number(&self, row: &Row, column: usize) -> Result<Option<f64>, SeriesError> {
        let Some(cell) = row.cells.get(column).filter(|cell| !is_missing(cell)) else { return Ok(None) };
        match cell.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Some(value)),
            _ => Err(self.wrong_at(
                row,
                format!(
                    "`{}` in column {} is not a number; numbers have a decimal point, what is missing is empty or \
                     `nan`",
                    cell.escape_debug(),
                    self.name_of(column)
                ),
            )),
        }
    }

    /// Name of a column in messages.
    pub(super) fn name_of(&self, column: usize) -> String {
        match self.header.as_ref().and_then(|names| names.get(column)) {
            Some(name) => format!("`{name}`"),
            None => (column + 1).to_string(),
        }
    }

    pub(super) fn wrong(&self, problem: String) -> SeriesError {
        SeriesError::Content { path: self.path.clone(), problem }
    }

    pub(super) fn wrong_at(&self, row: &Row, problem: String) -> SeriesError {
        SeriesError::Line { path: self.path.clone(), line: row.line, problem }
    }
}

/// The text of a file, without a byte order mark.
///
/// # Errors
/// When it cannot be read, is not text, or larger than any table.
pub(super) fn text_of(path: &Path) -> Result<String, SeriesError> {
    let content = |problem: &str| SeriesError::Content { path: path.to_owned(), problem: problem.to_owned() };
    let mut bytes = match text_bytes(path) {
        Ok(Ok(bytes)) => bytes,
        Ok(Err(begin)) if is_utf_16(&begin) => return Err(content("is text in UTF-16; save it as UTF-8")),
        Ok(Err(_)) => return Err(content("is not text; expected a table of numbers (CSV)")),
        Err(source) => return Err(SeriesError::Io { path: path.to_owned(), source }),
    };
    if bytes.len() as u64 > LARGEST {
        return Err(content("is larger than 1 GiB; expected a table of numbers (CSV)"));
    }
    if bytes.starts_with(BYTE_ORDER_MARK) {
        bytes.drain(..BYTE_ORDER_MARK.len());
    }
    String::from_utf8(bytes).map_err(|error| {
        let (valid, rest) = error.as_bytes().split_at(error.utf8_error().valid_up_to());
        let line = 1 + valid.iter().filter(|byte| **byte == b'\n').count();
        let byte = rest.first().copied().unwrap_or_default();
        let problem = format!("the byte {byte:#04x} is not text in UTF-8 (it may be Latin-1); save the file as UTF-8");
        SeriesError::Line { path: path.to_owned(), line: line as u64, problem }
    })
}

/// The file's bytes, at most one more than [`LARGEST`]; its beginning alone when that is not text.
fn text_bytes(path: &Path) -> io::Result<Result<Vec<u8>, Vec<u8>>> {
    let mut file = File::open(path)?;
    let mut bytes = Vec::new();
    file.by_ref().take(BEGINNING).read_to_end(&mut bytes)?;
    if bytes.contains(&0) {
        return Ok(Err(bytes));
    }
    file.take(LARGEST - BEGINNING + 1).read_to_end(&mut bytes)?;
    Ok(Ok(bytes))
}

/// Rows of RFC 4180, with this separator.
fn separated(path: &Path, text: &str, separator: u8) -> Result<Vec<Row>, SeriesError> {
    let mut reader = ReaderBuilder::new()
        .delimiter(separator)
        .has_headers(false)
        .flexible(true)
        .trim(Trim::All)
        .from_reader(text.as_bytes());
    let (mut rows, mut lines) = (Vec::new(), Lines::of(text.as_bytes(), None));
    for record in reader.records() {
        let record = record.map_err(|error| SeriesError::Content {
            path: path.to_owned(),
            problem: format!("is not a table: {error}"),
        })?;
        let line = lines.line(record.position());
        if let Some(open) = open_quote(&record) {
            return Err(SeriesError::Line { path: path.to_owned(), line, problem: open.to_owned() });
        }
        if record.get(0).is_some_and(|cell| cell.starts_with(['#', '%'])) {
            continue;
        }
        rows.push(Row { line, cells: record.iter().map(str::to_owned).collect() });
    }
    Ok(rows)
}

/// Rows with cells separated by white space.
fn spaced(text: &str) -> Vec<Row> {
    let lines = (1..).zip(text.lines());
    let data = lines.filter(|(_, line)| !line.trim_start().starts_with(['#', '%']));
    data.map(|(line, text)| Row { line, cells: text.split_whitespace().map(str::to_owned).collect() }).collect()
}
