//! Columns of any table of numbers.

use super::SeriesError;
use super::sheet::Sheet;
use std::path::Path;

/// Values of three columns.
pub(crate) type Three = [Vec<Option<f64>>; 3];

/// Columns of the table at `path`, in the requested order, one entry per row; `None` where a cell is empty or `nan`.
///
/// The header is optional. A column is given by its name in the header or by its number, from 1 (names take
/// precedence). Cells are separated by comma, semicolon, tab or white space; lines that begin with `#` or `%` are left
/// out.
///
/// # Errors
/// When the file cannot be read, a column is missing (the error names the nearest), rows have different widths, or a
/// cell is not a number; with the line.
pub fn columns(path: &Path, names: &[&str]) -> Result<Vec<Vec<Option<f64>>>, SeriesError> {
    let sheet = Sheet::read(path)?;
    sheet.check_row_widths()?;
    let wanted = names.iter().map(|name| sheet.column(name)).collect::<Result<Vec<_>, _>>()?;
    wanted.into_iter().map(|column| values(&sheet, column)).collect()
}

/// Three columns, and three more that the table has all or none of.
///
/// # Errors
/// As [`columns`].
pub(crate) fn columns_and(
    path: &Path,
    names: [&str; 3],
    more: [&str; 3],
) -> Result<(Three, Option<Three>), SeriesError> {
    let sheet = Sheet::read(path)?;
    sheet.check_row_widths()?;
    let three = |[a, b, c]: [usize; 3]| -> Result<Three, SeriesError> {
        Ok([values(&sheet, a)?, values(&sheet, b)?, values(&sheet, c)?])
    };
    let [a, b, c] = names.map(|name| sheet.column(name));
    Ok((three([a?, b?, c?])?, sheet.all_of(more)?.map(three).transpose()?))
}

/// Seconds in the unit that the name of a column ends in, as `t_ms`, `TIME (msec)`, `time [us]` or `stamp_ns`, or is,
/// as `ms`; of others 1. `min` alone may be a minimum, and `days` anything.
pub(crate) fn unit_s(name: &str) -> f64 {
    let name = name.trim_end_matches([']', ')', ' ']).to_lowercase();
    let last = name.rsplit(['_', ' ', '[', '(', '/', '.']).next().unwrap_or_default();
    match last {
        "ms" | "msec" | "msecs" | "millis" | "milliseconds" => 1e-3,
        "us" | "µs" | "μs" | "usec" | "usecs" | "micros" | "microseconds" => 1e-6,
        "ns" | "nsec" | "nsecs" | "nanos" | "nanoseconds" => 1e-9,
        "min" | "mins" | "minutes" if last != name => 60.0,
        "days" if last != name => 86400.0,
        _ => 1.0,
    }
}

fn values(sheet: &Sheet, column: usize) -> Result<Vec<Option<f64>>, SeriesError> {
    sheet.rows.iter().map(|row| sheet.number(row, column)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn read(text: &str, names: &[&str]) -> Result<Vec<Vec<Option<f64>>>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data.csv");
        fs::write(&path, text).unwrap();
        columns(&path, names).map_err(|error| error.to_string().replace(&path.display().to_string(), "data.csv"))
    }

    #[test]
    fn the_unit_of_a_time_is_in_its_name() {
        for (name, unit) in [
            ("t_ms", 1e-3),
            ("time [us]", 1e-6),
            ("stamp_ns", 1e-9),
            ("Time (ms)", 1e-3),
            ("TIME_MSEC", 1e-3),
            ("t.min", 60.0),
            ("ms", 1e-3),
            ("NS", 1e-9),
        ] {
            assert_eq!(unit_s(name).to_bits(), f64::to_bits(unit), "{name}");
        }
        for name in ["t", "time", "t_s", "min", "items", "columns", "2"] {
            assert_eq!(unit_s(name).to_bits(), f64::to_bits(1.0), "{name}");
        }
    }

    #[test]
    fn by_name_with_what_is_missing() {
        let found = read("t,u, y\r\n0,1.5,\r\n1,nan,-2e-3\r\n\r\n2, NaN ,7\r\n", &["y", "u"]).unwrap();
        assert_eq!(found, [vec![None, Some(-2e-3), Some(7.0)], vec![Some(1.5), None, None]]);
    }

    #[test]
    fn without_a_header_by_number_however_cells_are_separated() {
        for text in [
            "1 2 3\n4 5 6\n",
            "  1\t2\t3\n 4\t5\t6",
            "1,2,3\n4,5,6",
            "1;2;3\n4;5;6\n",
            "% heater\n1 2 3\n# more\n4 5 6",
        ] {
            assert_eq!(read(text, &["3", "1"]).unwrap(), [[Some(3.0), Some(6.0)], [Some(1.0), Some(4.0)]], "{text}");
        }
        assert_eq!(read("u;y\n0.1;0.2\n", &["y", "1"]).unwrap(), [[Some(0.2)], [Some(0.1)]]);
        assert_eq!(read("  1.0e+00   2\n", &["1"]).unwrap(), [[Some(1.0)]]);
        assert_eq!(read("\u{feff}u,y\n1,2\n", &["u"]).unwrap(), [[Some(1.0)]]);
    }

    #[test]
    fn decimal_commas_where_something_else_separates_cells() {
        for text in [
            "t;u\n0;1,5\n1;-2,25e-1\n",
            "t\tu\n0\t1,5\n1\t-2,25e-1\n",
            "0,0;1,5\n1,0;-2,25e-1\n",
            "0,0 1,5\n1,0 -2,25e-1\n",
            "0,0\t1,5\n1,0\t-,225\n",
            "0;1,500\n1;-0,225\n",
            "t,u\n0,\"1,5\"\n1,\"-0,225\"\n",
        ] {
            assert_eq!(read(text, &["2"]).unwrap(), [[Some(1.5), Some(-0.225)]], "{text}");
        }
        assert_eq!(read("0, 1, 2\n3, 4, 5\n", &["2"]).unwrap(), [[Some(1.0), Some(4.0)]]);
        assert_eq!(read("t,\"u; A\"\n0,1\n", &["2"]).unwrap(), [[Some(1.0)]]);
    }

    #[test]
    fn what_is_wrong_is_told_with_its_place() {
        let message = |text: &str, name: &str| read(text, &[name]).unwrap_err();
        assert_eq!(
            message("time,input\n0,1\n", "inpt"),
            "data.csv: has no column `inpt`; it has time, input: did you mean `input`?"
        );
        assert_eq!(message("time,input\n0,1\n", "voltage"), "data.csv: has no column `voltage`; it has time, input");
        assert_eq!(message("0 1\n1 2\n", "3"), "data.csv: has no column 3; columns are numbered from 1 to 2");
        assert_eq!(message("0 1\n", "0"), "data.csv: has no column 0; columns are numbered from 1 to 2");
        assert_eq!(
            message("0 1\n", "u"),
            "data.csv: has no header, and so no column `u`: write one, or give the column's number, 1 to 2, where an \
             option asks for it"
        );
        assert_eq!(message("t,u\n0,1\n1\n", "u"), "data.csv, line 3: has 1 cell, the first line has 2");
        let no_number = "is not a number; numbers have a decimal point, what is missing is empty or `nan`";
        assert_eq!(message("t,u\n0,1\n\n1,a\n", "u"), format!("data.csv, line 4: `a` in column `u` {no_number}"));
        assert_eq!(message("0 1\n1 inf\n", "2"), format!("data.csv, line 2: `inf` in column 2 {no_number}"));
        for (text, cell) in [("t;u\n0;1,5\n1;2.5\n", "1,5"), ("t;u\n0;1,500\n1;2,500\n", "1,500")] {
            assert_eq!(message(text, "u"), format!("data.csv, line 2: `{cell}` in column `u` {no_number}"));
        }
        assert_eq!(
            message("t,u\n# seconds\nms,A\n0,1\n", "u"),
            "data.csv, line 3: has words under the header, not numbers; if they are units, write them into the names \
             (as `t_ms`), and begin this line with #"
        );
        for (text, line) in [
            ("t,u\n0,1\n\n1,\"2\n2,3\n3,4\n", 4),
            ("t,\"u\n0,1\n1,2\n", 1),
            ("t,u\n# by,\"him\n0,1\n1,2\n", 2),
            ("t;u;v\n0;1;\"a\r\nb\"\n1;2;c\n", 2),
        ] {
            let open = "a cell begins with a \" that is not closed in this line: close it or leave it out";
            assert_eq!(message(text, "u"), format!("data.csv, line {line}: {open}"));
        }
        assert_eq!(message("u,u\n1,2\n", "u"), "data.csv: the header has the column `u` twice");
        assert_eq!(message("\n\n", "u"), "data.csv: is empty; expected a table of numbers (CSV)");
    }

    #[test]
    #[cfg(unix)]
    fn a_device_without_an_end_is_no_table() {
        let zeros = columns(Path::new("/dev/zero"), &["u"]).unwrap_err().to_string();
        assert_eq!(zeros, "/dev/zero: is not text; expected a table of numbers (CSV)");
    }

    #[test]
    fn what_is_no_text_or_not_there_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data.csv");
        let missing = columns(&path, &["u"]).unwrap_err();
        assert!(missing.is_io() && missing.is_missing());
        fs::write(&path, b"t,theta (\xb0)\n0,1\n").unwrap();
        let told = "data.csv, line 1: the byte 0xb0 is not text in UTF-8 (it may be Latin-1); save the file as UTF-8";
        assert!(columns(&path, &["t"]).unwrap_err().to_string().ends_with(told));
        fs::write(&path, [0x89, 0x4d, 0xff, 0x00]).unwrap();
        assert!(
            columns(&path, &["u"])
                .unwrap_err()
                .to_string()
                .ends_with("data.csv: is not text; expected a table of numbers (CSV)")
        );
    }
}
