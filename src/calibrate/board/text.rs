//! Parses and formats descriptions of boards.

use std::fmt;
use std::str::FromStr;

use crate::calibrate::any_length_m;
use crate::calibrate::board::{Board, BoardError, Charuco, Pattern, SIDE_M};

/// The expected form, for a text that is not a board.
pub(super) fn form(text: &str) -> &'static str {
    if is_charuco(text) {
        "charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY, counting squares (not inner corners), for example \
         charuco:5x7:30mm:22mm:DICT_4X4_50"
    } else {
        "COLUMNSxROWS:SQUARE, counting inner corners, for example 9x6:12mm, or \
         charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY, counting squares"
    }
}

fn is_charuco(text: &str) -> bool {
    text.trim_start().to_ascii_lowercase().starts_with("charuco")
}

/// `9x6`.
fn two_numbers(text: &str) -> Option<(usize, usize)> {
    let number = |text: &str| text.trim().parse::<usize>().ok();
    text.split_once(['x', 'X', '×']).and_then(|(c, r)| Some((number(c)?, number(r)?)))
}

impl FromStr for Board {
    type Err = BoardError;

    fn from_str(text: &str) -> Result<Self, BoardError> {
        let board = if is_charuco(text) { charuco(text) } else { chessboard(text) };
        let board = board.map_err(|problem| BoardError::Text { text: text.to_owned(), problem })?;
        board.check().map(|()| board)
    }
}

/// A side of a square or a marker; `missing` is what is wrong when it is no length.
fn side_m(text: &str, missing: &'static str) -> Result<f64, &'static str> {
    match any_length_m(text).ok_or(missing)? {
        side_m if SIDE_M.contains(&side_m) => Ok(side_m),
        side_m if side_m > 0.0 => Err("lengths must be from 0.001 mm to 10 m"),
        _ => Err("lengths must be above 0"),
    }
}

fn chessboard(text: &str) -> Result<Board, &'static str> {
    let (corners, square) = text.split_once(':').ok_or("the size of a square is missing")?;
    let (columns, rows) =
        two_numbers(corners).ok_or("before the colon there must be two whole numbers with an x between them")?;
    let square_m = side_m(square, "after the colon there must be a length with its unit: mm, cm or m")?;
    Ok(Board { columns, rows, square_m, kind: Pattern::Chessboard })
}

fn charuco(text: &str) -> Result<Board, &'static str> {
    let fields: Vec<&str> = text.split(':').map(str::trim).collect();
    if !fields.first().is_some_and(|word| word.eq_ignore_ascii_case("charuco")) {
        return Err("its first part must be the word charuco");
    }
    let (size, square, marker, dictionary, legacy) = match fields[..] {
        [_, size, square, marker, dictionary] => (size, square, marker, dictionary, false),
        [_, size, square, marker, dictionary, "legacy"] => (size, square, marker, dictionary, true),
        [_, _, _, _, _, _] => return Err("after the dictionary nothing but `:legacy` may follow"),
        _ => return Err("it has five parts, with colons between them"),
    };
    let (columns, rows) =
        two_numbers(size).ok_or("its second part must be two whole numbers with an x between them")?;
    let (Some(columns), Some(rows)) = (columns.checked_sub(1), rows.checked_sub(1)) else {
        return Err("it must have squares");
    };
    let length = |text: &str| side_m(text, "sizes of square and marker must be lengths with unit: mm, cm or m");
    let (square_m, marker_m) = (length(square)?, length(marker)?);
    let unknown = "its dictionary is not known; OpenCV's DICT_4X4_50, DICT_5X5_100, DICT_6X6_250, DICT_7X7_1000 and so \
                   on are, DICT_ARUCO_ORIGINAL and DICT_ARUCO_MIP_36h12";
    let dictionary = dictionary.parse().map_err(|()| unknown)?;
    Ok(Board { columns, rows, square_m, kind: Pattern::Charuco(Charuco { marker_m, dictionary, legacy }) })
}

/// In millimetres to twelve digits, so that 12 mm is not written 12.000000000000002.
pub(super) fn mm(length_m: f64) -> f64 {
    (length_m * 1e12).round() / 1e9
}

impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { columns, rows, square_m, kind } = self;
        match kind {
            Pattern::Chessboard => write!(f, "{columns}x{rows}:{}mm", mm(*square_m)),
            Pattern::Charuco(Charuco { marker_m, dictionary, legacy }) => {
                let (columns, rows) = (columns + 1, rows + 1);
                write!(f, "charuco:{columns}x{rows}:{}mm:{}mm:{dictionary}", mm(*square_m), mm(*marker_m))?;
                if *legacy { write!(f, ":legacy") } else { Ok(()) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_that_cannot_be_are_told() {
        let refused = |text: &str| text.parse::<Board>().unwrap_err().to_string();
        for text in ["9x6:0mm", "9x6:-1cm", "charuco:9x6:12mm:0mm:DICT_4X4_50"] {
            assert!(refused(text).contains(": lengths must be above 0."), "{}", refused(text));
        }
        for text in ["9x6:1e300mm", "9x6:11m", "9x6:1e-5mm", "9x6:1e-320mm", "charuco:9x6:12mm:1e-9mm:DICT_4X4_50"] {
            assert!(refused(text).contains(": lengths must be from 0.001 mm to 10 m."), "{}", refused(text));
        }
        // As many corners as no number holds.
        let huge = refused("charuco:9999999999x9999999999:12mm:9mm:DICT_4X4_50");
        assert!(huge.starts_with("a ChArUco board of 9999999999x9999999999 squares cannot"), "{huge}");
        assert!(refused("9x6:nanmm").contains("a length with its unit"), "{}", refused("9x6:nanmm"));
        let built = Board { square_m: 1e300, .."9x6:12mm".parse().unwrap() };
        assert_eq!(built.check().unwrap_err().to_string(), "squares of 1e300 m: expected 0.001 mm to 10 m");
        assert!(refused("9x6:12").contains("a length with its unit"), "{}", refused("9x6:12"));
        for text in ["charucofoo:9x6:12mm:9mm:DICT_4X4_50", "charuco_legacy:9x6:12mm:9mm:DICT_4X4_50"] {
            assert!(refused(text).contains("its first part must be the word charuco"), "{}", refused(text));
        }
        let large = refused("charuco:9x6:12mm:13mm:DICT_4X4_50");
        assert!(large.starts_with("markers of 13 mm in squares of 12 mm: "), "{large}");
    }
}
