//! Calibration boards, and the detection of their corners in a picture.
//!
//! - In: a [`Grey`] picture, a [`Board`], how many images of it there may be (direct and in mirrors).
//! - Out: a [`BoardImage`] for each that was found: its inner corners to a few hundredths of a pixel, in the board's
//!   order.
//! - Method: chessboards by OpenCV's sector-based detector on the picture at several sizes and on parts of it
//!   (`search`), ChArUco boards by their markers (`charuco`); each corner is then refined in the picture itself, and
//!   anything but a regular grid of alternating dark and light squares is rejected (`judge`).
//! - Assumes that all inner corners of a chessboard are in the picture; of a ChArUco board a part is enough. Lens
//!   distortion may bend the board, but smoothly.
//! - Cannot tell a chessboard from its mirror image (the pattern is mirror symmetric): [`Board::orders`].

mod charuco;
mod flat;
pub(crate) mod grey;
mod judge;
mod search;
mod text;

pub use charuco::{Charuco, CharucoNotFound, Dictionary};
pub use grey::{Grey, GreyError, Rows};
pub use judge::Flaw;

use nalgebra::{Point2, Point3, Vector3};

/// Inner corners along one side, fewest and most. OpenCV's detector needs three.
const CORNERS: std::ops::RangeInclusive<usize> = 3..=99;

/// Sides of squares and markers, metres: print and camera allow no others.
const SIDE_M: std::ops::RangeInclusive<f64> = 1e-6..=10.0;

/// Two pictures whose corners differ by less than this part of a square's side, RMS, tell the same: errors of lens and
/// print are the same in both.
const SAME_PLACE: f64 = 0.1;

/// What is printed on a board.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Pattern {
    /// Dark and light squares.
    Chessboard,
    /// Markers in the light squares.
    Charuco(Charuco),
}

/// A flat calibration board: inner corners and size of a square. Written `9x6:12mm` (inner corners per row x per column
/// : square), or `charuco:5x7:30mm:22mm:DICT_4X4_50` (SQUARES per row x per column : square : marker : dictionary).
#[derive(Debug, Clone, PartialEq)]
pub struct Board {
    /// Inner corners per row.
    pub columns: usize,
    /// Inner corners per column.
    pub rows: usize,
    /// Side of a square.
    pub square_m: f64,
    /// What is printed on it.
    pub kind: Pattern,
}

impl Board {
    /// The inner corners in the board's frame, metres: corner (c, r) has index `r * columns + c` and lies at
    /// `(c, r, 0) * square_m`. Seen from the front, x points right, y down, z into the board.
    pub fn points(&self) -> Vec<Point3<f64>> {
        let place = |i: usize| Point3::new((i % self.columns) as f64, (i / self.columns) as f64, 0.0) * self.square_m;
        (0..self.columns * self.rows).map(place).collect()
    }

    /// The inner corners relative to the board's centre, where a rotation of the pose moves them least.
    pub fn centred_points(&self) -> Vec<Point3<f64>> {
        let points = self.points();
        let centre = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64;
        points.into_iter().map(|p| p - centre).collect()
    }

    /// Possible corner orders of a mirror image: for each order, the corner of [`Board::points`] at each index, if the
    /// direct image of the same board is taken as found. Either columns or rows run backwards; both together would be a
    /// half turn. The colours exclude one of the two when one of columns and rows is odd and the other even. Markers
    /// identify every corner, so there is only the board's own order.
    pub fn orders(&self) -> Vec<Vec<usize>> {
        let (columns, rows) = (self.columns, self.rows);
        if matches!(self.kind, Pattern::Charuco(_)) {
            return vec![(0..columns * rows).collect()];
        }
        let backwards = |columns_too: bool| {
            let corner = |i: usize| {
                let (c, r) = (i % columns, i / columns);
                if columns_too { r * columns + columns - 1 - c } else { (rows - 1 - r) * columns + c }
            };
            (0..columns * rows).map(corner).collect()
        };
        // Reversed, an even number of columns begins with a square of the same colour, an odd one does not.
        match (columns % 2, rows % 2) {
            (0, 1) => vec![backwards(true)],
            (1, 0) => vec![backwards(false)],
            _ => vec![backwards(true), backwards(false)],
        }
    }

    /// # Errors
    /// When it is not a board that can be found with a unique orientation.
    fn check(&self) -> Result<(), BoardError> {
        let (columns, rows, square_m) = (self.columns, self.rows, self.square_m);
        if !SIDE_M.contains(&square_m) {
            return Err(BoardError::SquareSize { square_m });
        }
        match self.kind {
            Pattern::Charuco(own @ Charuco { marker_m, dictionary, .. }) => {
                let many = columns.max(rows) > *CORNERS.end();
                if many || columns.min(rows) < 2 || columns * rows < charuco::MIN_CORNERS {
                    return Err(BoardError::Squares { columns: columns + 1, rows: rows + 1 });
                }
                if !(marker_m > 0.0 && marker_m < square_m) {
                    return Err(BoardError::MarkerSize { marker_m, square_m });
                }
                let markers = own.count(self);
                if markers > dictionary.size() {
                    return Err(BoardError::Markers { markers, dictionary });
                }
            }
            Pattern::Chessboard => {
                if !CORNERS.contains(&columns) || !CORNERS.contains(&rows) {
                    return Err(BoardError::Corners { columns, rows });
                }
                if columns == rows {
                    return Err(BoardError::Square { columns });
                }
            }
        }
        Ok(())
    }
}

/// Finds images of the board, at most `most` and at least one. Those of a chessboard are complete and in order of
/// detection. Of a ChArUco board at most one unmirrored image comes first, the nearest, then mirrored ones, the most
/// complete first.
///
/// # Errors
/// When there is none (with what is there instead, if that can be told), the board cannot be used, or OpenCV fails.
pub fn find_boards(picture: &Grey, board: &Board, most: usize) -> Result<Vec<BoardImage>, BoardError> {
    board.check()?;
    match &board.kind {
        Pattern::Chessboard => search::find(picture, board, most),
        Pattern::Charuco(own) => charuco::find(picture, board, own, most)?
            .map_err(|why| BoardError::NoCharuco { board: board.to_string(), why }),
    }
}

/// A board found in a picture.
#[derive(Debug, Clone)]
pub struct BoardPicture {
    /// The picture's name in messages.
    pub name: String,
    /// Its size, pixels.
    pub size_px: [u32; 2],
    /// The board's corners.
    pub image: BoardImage,
}

/// One image of the board in a picture.
///
/// A ChArUco board's are the visible corners. The corners of a chessboard are in the order of a direct image: in the
/// picture, columns to rows turn in the same sense as x (right) to y (down). If one of columns and rows is odd and the
/// other even, the square between the first two columns and rows is dark, and so is the outer one diagonal to corner 0;
/// otherwise rows run to the right (if vertical: downwards), and which end comes first is arbitrary.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardImage {
    /// Index into [`Board::points`], and position in the picture: pixel (0, 0) is the centre of the top-left one.
    pub corners: Vec<(usize, Point2<f64>)>,
    /// Whether it is a mirror image, where the picture alone tells: it does for a ChArUco board, but not for a
    /// chessboard.
    pub mirrored: Option<bool>,
    /// Side of a square in the picture: median over the board, pixels.
    pub square_px: f64,
    /// Width from 10 to 90 % across the edges of squares, pixels: median over the board, along columns or rows,
    /// whichever is more blurred. A sharp picture has 1.5 to 2.5; corners get worse from a third of a square.
    pub edge_px: f64,
    /// Contrast of dark and light squares: median over the board, grey values from 0 to 255.
    pub contrast: f64,
}

/// Edges wider than this fraction of a square are blurred: the corners of such a board are accurate to tenths of a
/// pixel at best.
const BLURRED: f64 = 0.35;

impl BoardImage {
    /// Whether both show the same corners at the same places, like two pictures of a board at rest.
    pub(crate) fn is_same_as(&self, other: &Self) -> bool {
        let (own, others) = (&self.corners, &other.corners);
        let squares_px2 = || own.iter().zip(others).map(|(a, b)| (a.1 - b.1).norm_squared());
        own.len() == others.len()
            && own.iter().zip(others).all(|(a, b)| a.0 == b.0)
            && (squares_px2().sum::<f64>() / own.len().max(1) as f64).sqrt() < SAME_PLACE * self.square_px
    }

    /// Whether the board is too blurred to calibrate with: compares its edges with its squares.
    pub fn is_blurred(&self) -> bool {
        self.edge_px > BLURRED * self.square_px
    }
}

/// Why no board is found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BoardError {
    /// A text that does not describe a board.
    #[error("`{text}` is not a board: {problem}. Write {}", text::form(.text))]
    Text {
        /// What was given.
        text: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// Too few squares, or too many.
    #[error(
        "a ChArUco board of {columns}x{rows} squares cannot be used: from 3x4 to 100x100 can (squares, not inner \
        corners, are counted for these boards)"
    )]
    Squares {
        /// Per row.
        columns: usize,
        /// Per column.
        rows: usize,
    },
    /// Markers that do not fit into squares.
    #[error("markers of {0} mm in squares of {1} mm: they must be smaller than the squares; the square comes first",
        text::mm(*.marker_m), text::mm(*.square_m))]
    MarkerSize {
        /// Side of a marker.
        marker_m: f64,
        /// Side of a square.
        square_m: f64,
    },
    /// More markers than the dictionary has.
    #[error("the board has {markers} markers, {dictionary} has {} only: is the dictionary right?", .dictionary.size())]
    Markers {
        /// On the board.
        markers: usize,
        /// The dictionary they should be from.
        dictionary: Dictionary,
    },
    /// No such ChArUco board in the picture.
    #[error("no board {board} found{why}")]
    NoCharuco {
        /// As requested.
        board: String,
        /// What is there instead.
        why: CharucoNotFound,
    },
    /// Too few corners, or too many.
    #[error("a board of {columns}x{rows} inner corners cannot be found: from {} to {} per side can (inner corners, \
        where four squares meet: one fewer than squares)", CORNERS.start(), CORNERS.end())]
    Corners {
        /// Per row.
        columns: usize,
        /// Per column.
        rows: usize,
    },
    /// A board that looks the same turned by 90°.
    #[error(
        "a board of {columns}x{columns} inner corners cannot be used: turned by a quarter it looks the same, so that \
        one cannot tell which corner is which; take one with more columns than rows, for example 9x6"
    )]
    Square {
        /// Per row and per column.
        columns: usize,
    },
    /// A square without a valid size.
    #[error("squares of {square_m:e} m: expected 0.001 mm to 10 m")]
    SquareSize {
        /// Side of a square.
        square_m: f64,
    },
    /// No such board in the picture.
    #[error("no board of {columns}x{rows} inner corners found{}", instead(*seen, flaw.as_ref()))]
    NotFound {
        /// Per row, as requested.
        columns: usize,
        /// Per column, as requested.
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
            "; there is a grid of {columns}x{rows}: is the number of corners right (inner ones are counted), and is no \
             part of the board hidden?"
        ),
        (None, Some(flaw)) => format!("; the grid found is not a board: {flaw}"),
        (None, None) => String::new(),
    }
}
