//! MATLAB's MAT files, version 5 ("MAT-File Format", MathWorks, R2024a, chapter 1): one variable per column, not
//! compressed.
//!
//! Numbers are columns of doubles, NaN where there is none; whole numbers `int64`, because a double cannot hold
//! nanoseconds since 1970; text a matrix of characters, padded with blanks, as from `char`.

use crate::archive::tables::Cells;

const MI_INT8: u32 = 1;
const MI_UINT16: u32 = 4;
const MI_INT32: u32 = 5;
const MI_UINT32: u32 = 6;
const MI_DOUBLE: u32 = 9;
const MI_INT64: u32 = 12;
const MI_MATRIX: u32 = 14;

const MX_CHAR: u32 = 4;
const MX_DOUBLE: u32 = 6;
const MX_INT64: u32 = 14;

/// The longest name allowed in MATLAB.
const LONGEST_NAME: usize = 63;

/// A file with these columns. Columns whose names differ only in a trailing number, like `current_a_1` and
/// `current_a_2`, stay separate.
///
/// # Errors
/// When one is too large for the format, 2 GB.
pub(super) fn file(columns: &[(String, Cells)]) -> Result<Vec<u8>, String> {
    let mut bytes = format!("MATLAB 5.0 MAT-file, written by catoptra {}", env!("CARGO_PKG_VERSION")).into_bytes();
    bytes.resize(116, b' ');
    bytes.extend([0; 8]);
    bytes.extend(0x0100_u16.to_le_bytes());
    bytes.extend(b"IM");
    let mut names: Vec<String> = Vec::new();
    for (column, cells) in columns {
        let name = variable(column, &names);
        let written = matrix(&name, cells).and_then(|matrix| element(&mut bytes, MI_MATRIX, &matrix));
        written.map_err(|()| format!("{column} has more than 2 GB"))?;
        names.push(name);
    }
    Ok(bytes)
}

/// A valid MATLAB name that is not in `taken`.
fn variable(column: &str, taken: &[String]) -> String {
    let mut name: String = column.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        name.insert(0, 'x');
    }
    name.truncate(LONGEST_NAME - 4);
    let numbered = |n: usize| if n == 1 { name.clone() } else { format!("{name}_{n}") };
    (1..=taken.len() + 1).map(numbered).find(|name| !taken.contains(name)).unwrap_or(name.clone())
}

fn matrix(name: &str, cells: &Cells) -> Result<Vec<u8>, ()> {
    let column = |class: u32, rows: usize, kind: u32, data: Vec<u8>| array(name, class, [rows, 1], kind, &data);
    let doubles = |values: Vec<f64>| {
        let data = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        column(MX_DOUBLE, values.len(), MI_DOUBLE, data)
    };
    match cells {
        Cells::Real(cells) => doubles(cells.iter().map(|cell| cell.unwrap_or(f64::NAN)).collect()),
        Cells::Flag(cells) => {
            doubles(cells.iter().map(|cell| cell.map_or(f64::NAN, |flag| f64::from(u8::from(flag)))).collect())
        }
        Cells::Whole(cells) => match cells.iter().copied().collect::<Option<Vec<i64>>>() {
            Some(all) => {
                let data = all.iter().flat_map(|number| number.to_le_bytes()).collect();
                column(MX_INT64, all.len(), MI_INT64, data)
            }
            // Only doubles can represent a missing value.
            None => doubles(cells.iter().map(|cell| cell.map_or(f64::NAN, |number| number as f64)).collect()),
        },
        Cells::Text(cells) => {
            let lines: Vec<Vec<u16>> =
                cells.iter().map(|cell| cell.as_deref().unwrap_or_default().encode_utf16().collect()).collect();
            let width = lines.iter().map(Vec::len).max().unwrap_or(0);
            // In column-major order.
            let letter = |line: &Vec<u16>, k: usize| line.get(k).copied().unwrap_or(u16::from(b' '));
            let data: Vec<u8> =
                (0..width).flat_map(|k| lines.iter().flat_map(move |line| letter(line, k).to_le_bytes())).collect();
            array(name, MX_CHAR, [lines.len(), width], MI_UINT16, &data)
        }
    }
}

/// Content of a `miMATRIX`, if its data are not too large.
fn array(name: &str, class: u32, size: [usize; 2], kind: u32, data: &[u8]) -> Result<Vec<u8>, ()> {
    let mut bytes = Vec::with_capacity(data.len() + 128);
    let flags: Vec<u8> = [class, 0].iter().flat_map(|word| word.to_le_bytes()).collect();
    let size: Vec<u8> = size.iter().flat_map(|n| i32::try_from(*n).unwrap_or(i32::MAX).to_le_bytes()).collect();
    let parts = [(MI_UINT32, flags.as_slice()), (MI_INT32, &size), (MI_INT8, name.as_bytes()), (kind, data)];
    for (kind, part) in parts {
        element(&mut bytes, kind, part)?;
    }
    Ok(bytes)
}

/// Kind, length, data, and zeros up to a multiple of eight.
fn element(bytes: &mut Vec<u8>, kind: u32, data: &[u8]) -> Result<(), ()> {
    let length = i32::try_from(data.len()).map_err(|_| ())?;
    bytes.extend(kind.to_le_bytes());
    bytes.extend(length.to_le_bytes());
    bytes.extend(data);
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_matlab_takes() {
        let mut taken = Vec::new();
        for (name, expected) in [("t_s", "t_s"), ("3rd-x", "x3rd_x"), ("_a", "x_a"), ("t s", "t_s_2")] {
            let found = variable(name, &taken);
            assert_eq!(found, expected);
            taken.push(found);
        }
        assert_eq!(variable(&"n".repeat(100), &taken).len(), 59);
    }

    /// Its pages of zeros are not touched.
    #[test]
    fn what_is_too_large_is_refused() {
        let rows = 1 << 28;
        assert_eq!(array("a", MX_DOUBLE, [rows, 1], MI_DOUBLE, &vec![0; 8 * rows]), Err(()));
    }

    /// By hand, from the format's description.
    #[test]
    fn a_number_has_the_bytes_that_the_description_has() {
        let bytes = file(&[("ab".to_owned(), Cells::Whole(vec![Some(-2)]))]).unwrap();
        assert_eq!(bytes.get(124..128).unwrap(), [0, 1, b'I', b'M']);
        let expected = [
            &[14, 0, 0, 0, 64, 0, 0, 0][..],
            &[6, 0, 0, 0, 8, 0, 0, 0, 14, 0, 0, 0, 0, 0, 0, 0],
            &[5, 0, 0, 0, 8, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0],
            &[1, 0, 0, 0, 2, 0, 0, 0, b'a', b'b', 0, 0, 0, 0, 0, 0],
            &[12, 0, 0, 0, 8, 0, 0, 0, 0xfe, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff],
        ]
        .concat();
        assert_eq!(bytes.get(128..).unwrap(), expected);
    }
}
