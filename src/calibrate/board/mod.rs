//! Calibration boards, and where their corners are in a picture.
//!
//! - In: a [`Grey`](super::grey::Grey) picture, a [`Board`], how many images of it there may be (direct and by way of mirrors).
//! - Out: a [`BoardImage`] for each that was found: its inner corners to a few hundredths of a pixel, in the board's order.
//! - Method: OpenCV's sector-based detector on the picture at several sizes and on parts of it (`search`), each corner then
//!   refined in the picture itself; what is no regular grid of squares alternating dark and light is refused (`judge`).
//! - Assumes that all inner corners are in the picture. Lens distortion may bend the board, but smoothly.
//! - Cannot tell a chessboard from its mirror image (the pattern is mirror symmetric): [`Board::orders`].

mod flat;
mod judge;
mod search;

pub use judge::Flaw;
pub use search::find_boards;

use super::length_m;
use std::fmt;
use std::str::FromStr;

use nalgebra::{Point2, Point3};

/// Inner corners along one side, fewest and most. OpenCV's detector wants three.
const CORNERS: std::ops::RangeInclusive<usize> = 3..=99;

/// What is printed on a board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Pattern {
    /// Dark and light squares.
    Chessboard,
}

/// A flat calibration board: inner corners and size of a square. Written `9x6:12mm` (columns x rows : square).
#[derive(Debug, Clone, PartialEq)]
pub struct Board {
    /// Inner corners in a row.
    pub columns: usize,
    /// Inner corners in a column.
    pub rows: usize,
    /// Side of a square.
    pub square_m: f64,
    /// What is printed on it.
    pub kind: Pattern,
}

impl Board {
    /// The inner corners in the board's frame, metres: corner (c, r) has index `r * columns + c` and lies at
    /// `(c, r, 0) * square_m`. Looked at from the front, x runs right and y down, z into the board.
    pub fn points(&self) -> Vec<Point3<f64>> {
        let place = |i: usize| Point3::new((i % self.columns) as f64, (i / self.columns) as f64, 0.0) * self.square_m;
        (0..self.columns * self.rows).map(place).collect()
    }

    /// What the corners of a mirror image may be: for each possible order, the corner of [`Board::points`] that stands at
    /// each index, when the direct image of the same board is taken as it was found. Columns run backwards, or rows do; both
    /// together would be half a turn. The colours leave one of the two when one of columns and rows is odd, the other even.
    pub fn orders(&self) -> Vec<Vec<usize>> {
        let (columns, rows) = (self.columns, self.rows);
        let backwards = |columns_too: bool| {
            let corner = |i: usize| {
                let (c, r) = (i % columns, i / columns);
                if columns_too { r * columns + columns - 1 - c } else { (rows - 1 - r) * columns + c }
            };
            (0..columns * rows).map(corner).collect()
        };
        // Backwards, an even number of columns begins with a square of the same colour, an odd one does not.
        match (columns % 2, rows % 2) {
            (0, 1) => vec![backwards(true)],
            (1, 0) => vec![backwards(false)],
            _ => vec![backwards(true), backwards(false)],
        }
    }

    /// # Errors
    /// When it is no board that can be found and told which way round it is.
    fn check(&self) -> Result<(), BoardError> {
        let (columns, rows) = (self.columns, self.rows);
        if !CORNERS.contains(&columns) || !CORNERS.contains(&rows) {
            return Err(BoardError::Corners { columns, rows });
        }
        if columns == rows {
            return Err(BoardError::Square { columns });
        }
        if !(self.square_m > 0.0 && self.square_m.is_finite()) {
            return Err(BoardError::SquareSize { square_m: self.square_m });
        }
        Ok(())
    }
}

impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Twelve digits: 12 mm are not written 12.000000000000002.
        let millimetres = (self.square_m * 1e12).round() / 1e9;
        write!(f, "{}x{}:{millimetres}mm", self.columns, self.rows)
    }
}

impl FromStr for Board {
    type Err = BoardError;

    fn from_str(text: &str) -> Result<Self, BoardError> {
        let wrong = |problem: &'static str| BoardError::Text { text: text.to_owned(), problem };
        if text.to_ascii_lowercase().starts_with("charuco") {
            return Err(wrong("ChArUco boards are not found by this version, chessboards are"));
        }
        let (corners, square) = text.split_once(':').ok_or_else(|| wrong("the size of a square is missing"))?;
        let number = |text: &str| text.trim().parse::<usize>().ok();
        let (columns, rows) = corners
            .split_once(['x', 'X', '×'])
            .and_then(|(c, r)| Some((number(c)?, number(r)?)))
            .ok_or_else(|| wrong("before the colon there must be two whole numbers with an x between them"))?;
        let square_m = length_m(square)
            .ok_or_else(|| wrong("after the colon there must be a length with its unit: mm, cm or m"))?;
        let board = Self { columns, rows, square_m, kind: Pattern::Chessboard };
        board.check().map(|()| board)
    }
}

/// One image of the board in a picture.
///
/// The corners of a chessboard are in the order a direct image has: in the picture, the way from columns to rows turns like
/// the way from x (right) to y (down). Where columns and rows are not both odd or both even, the square between the first
/// two columns and rows is dark, and so is the outer one diagonal to corner 0; else rows run to the right (straight up and down:
/// downwards), and which end comes first means nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardImage {
    /// Index into [`Board::points`], and the place in the picture: pixel (0, 0) is the centre of the top-left one.
    pub corners: Vec<(usize, Point2<f64>)>,
    /// Whether it is a mirror image, where the picture alone tells. A chessboard's does not.
    pub mirrored: Option<bool>,
    /// Side of a square in the picture: median over the board, pixels.
    pub square_px: f64,
    /// From 10 to 90 % of the way from dark to light, across the edges of squares, pixels: median over the board, of columns
    /// or rows, whichever is blurred more. A sharp picture has 1.5 to 2.5; corners get worse from a third of a square on.
    pub edge_px: f64,
    /// From dark to light squares: median over the board, grey values of 0 to 255.
    pub contrast: f64,
}

/// Edges wider than this part of a square are blurred: corners of such a board are good to tenths of a pixel at best.
const BLURRED: f64 = 0.35;

impl BoardImage {
    /// Whether the board is too blurred to calibrate with: its edges, compared with its squares.
    pub fn is_blurred(&self) -> bool {
        self.edge_px > BLURRED * self.square_px
    }
}

/// Why no board is found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BoardError {
    /// Words that do not describe a board.
    #[error(
        "`{text}` is not a board: {problem}. Write COLUMNSxROWS:SQUARE, counting inner corners, for example 9x6:12mm"
    )]
    Text {
        /// What was given.
        text: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// Too few corners, or too many.
    #[error("a board of {columns}x{rows} inner corners cannot be found: from {} to {} a side can (inner corners, where four \
        squares meet: one fewer than squares)", CORNERS.start(), CORNERS.end())]
    Corners {
        /// In a row.
        columns: usize,
        /// In a column.
        rows: usize,
    },
    /// A board that looks the same turned by 90°.
    #[error(
        "a board of {columns}x{columns} inner corners cannot be used: turned by a quarter it looks the same, so that one \
        cannot tell which corner is which; take one with more columns than rows, for example 9x6"
    )]
    Square {
        /// In a row and in a column.
        columns: usize,
    },
    /// A square of no size.
    #[error("squares of {square_m} m: expected a length above 0")]
    SquareSize {
        /// Side of a square.
        square_m: f64,
    },
    /// No such board in the picture.
    #[error("no board of {columns}x{rows} inner corners found{}", instead(*seen, flaw.as_ref()))]
    NotFound {
        /// In a row, as asked for.
        columns: usize,
        /// In a column, as asked for.
        rows: usize,
        /// Columns and rows of a grid that was seen instead.
        seen: Option<[usize; 2]>,
        /// What is wrong with one of this size.
        flaw: Option<Flaw>,
    },
    /// OpenCV fails.
    #[error("OpenCV fails while looking for the board: {0}")]
    OpenCv(#[from] opencv::Error),
}

fn instead(seen: Option<[usize; 2]>, flaw: Option<&Flaw>) -> String {
    match (seen, flaw) {
        (Some([columns, rows]), _) => format!(
            "; there is a grid of {columns}x{rows}: is the number of corners right (inner ones are counted), and is no part \
             of the board hidden?"
        ),
        (None, Some(flaw)) => format!("; the grid that was seen is none: {flaw}"),
        (None, None) => String::new(),
    }
}
