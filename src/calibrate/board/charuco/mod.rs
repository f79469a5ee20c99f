//! ChArUco boards: chessboards with a marker in each light square. A part of the board is enough.
//!
//! - In: a picture, the board. Out: for each image of the board the corners that are seen, by their true indices, and
//!   whether it is mirrored.
//! - Method: quadrilaterals are read as markers, direct and mirrored (`markers`); those whose positions agree with
//!   their numbers form an image (`layout`). Corners are predicted from neighbouring markers and corners and refined in
//!   the picture itself (`corners`). They must pass the same tests as chessboards; a stray corner is dropped.
//! - Why there is none, if that can be told: `unread`.
//! - Cannot tell: a board of OpenCV's other layout when the markers of a single row are seen.

mod corners;
mod dictionary;
mod layout;
mod markers;
mod unread;

pub use dictionary::Dictionary;
pub use unread::CharucoNotFound;

use nalgebra::Point2;
use opencv::Result;
use opencv::core::Mat;

use crate::calibrate::board::flat::in_line;
use crate::calibrate::board::grey::Grey;
use crate::calibrate::board::judge::{Flaw, Grid};
use crate::calibrate::board::search::pixels;
use crate::calibrate::board::{Board, BoardImage};
use corners::Search;
use layout::Layout;
use markers::{Marker, Quad, quads};
use unread::Evidence;

/// Fewest useful corners: more than a pose needs.
pub(super) const MIN_CORNERS: usize = 6;
/// One in this many cells may be read wrong; the markers' positions resolve mistakes.
const CELLS_PER_ERROR: usize = 16;

/// What a ChArUco board has in addition to its squares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Charuco {
    /// Side of a marker, with its dark rim.
    pub marker_m: f64,
    /// Dictionary of its markers, which are numbered from 0.
    pub dictionary: Dictionary,
    /// OpenCV's layout before 4.7 and with `setLegacyPattern`: for an even number of rows of squares, the upper left
    /// square is light. For an odd number there is no difference.
    pub legacy: bool,
}

impl Charuco {
    /// How many markers a board has.
    pub(super) fn count(&self, board: &Board) -> usize {
        self.layout(board).count()
    }

    fn layout(&self, board: &Board) -> Layout {
        let squares = [board.columns + 1, board.rows + 1];
        let light_first = self.legacy && squares[1].is_multiple_of(2);
        Layout { squares, light_first, marker: self.marker_m / board.square_m }
    }
}

/// Finds images of the board: at most one direct image, the nearest, and mirrored ones, up to `most` in all and at
/// least one.
///
/// # Errors
/// Why there is none.
pub(super) fn find(
    picture: &Grey,
    board: &Board,
    charuco: &Charuco,
    most: usize,
) -> Result<std::result::Result<Vec<BoardImage>, CharucoNotFound>> {
    let pixels = pixels(picture)?;
    let layout = charuco.layout(board);
    let quads = quads(&pixels)?;
    let around = layout.plain() / layout.marker;
    let markers = read(picture, &quads, around, charuco.dictionary);
    let images = layout.images(&markers);
    let clues = Evidence { picture, quads: &quads, layout: &layout, dictionary: charuco.dictionary, markers: &markers };
    if let Some(wrong) = clues.other_board(&images) {
        return Ok(Err(wrong));
    }
    let (mut found, mut why) = (Vec::new(), None);
    for markers in images.iter().filter(|image| clues.foreign_markers(image) < image.len()) {
        match image(picture, &pixels, &layout, markers)? {
            Ok(image) => found.push(image),
            Err(flaw) => why = why.or(Some(flaw)),
        }
    }
    // The nearest is the direct one; another unmirrored one was reflected twice.
    found.sort_by(|a: &BoardImage, b| {
        let key = |image: &BoardImage| image.mirrored == Some(true);
        key(a).cmp(&key(b)).then(b.corners.len().cmp(&a.corners.len())).then(b.square_px.total_cmp(&a.square_px))
    });
    let direct = found.iter().filter(|image| image.mirrored == Some(false));
    let nearest = direct.map(|image| image.square_px).fold(0.0, f64::max);
    found.retain(|image| image.mirrored == Some(true) || image.square_px >= nearest);
    found.truncate(most);
    if found.is_empty() { Ok(Err(why.unwrap_or_else(|| clues.nothing()))) } else { Ok(Ok(found)) }
}

/// All markers of a dictionary that the quadrilaterals may be, each reading once.
fn read(picture: &Grey, quads: &[Quad], around: f64, dictionary: Dictionary) -> Vec<Marker> {
    let most_wrong = (dictionary.cells().pow(2) / CELLS_PER_ERROR) as u32;
    let mut markers: Vec<Marker> = Vec::new();
    for reading in quads.iter().filter_map(|quad| quad.read(picture, dictionary.cells(), around)) {
        for marker in reading.markers(dictionary, most_wrong) {
            let alike =
                |own: &&mut Marker| own.id == marker.id && own.mirrored == marker.mirrored && own.is_at(&marker);
            match markers.iter_mut().find(alike) {
                // Later ones are from larger pictures.
                Some(own) if own.wrong >= marker.wrong => *own = marker,
                Some(_) => {}
                None => markers.push(marker),
            }
        }
    }
    markers
}

/// The corners of an image of the board.
fn image(
    picture: &Grey,
    pixels: &Mat,
    layout: &Layout,
    markers: &[Marker],
) -> Result<std::result::Result<BoardImage, CharucoNotFound>> {
    let mirrored = markers.iter().any(|marker| marker.mirrored);
    let corners = Search { picture, pixels, layout, markers }.corners()?;
    let size = layout.squares.map(|n| n - 1);
    let few = |corners: usize| CharucoNotFound::FewCorners { corners, markers: markers.len() };
    let Some(mut grid) = Grid::part(picture, size, corners, layout.plain(), mirrored) else { return Ok(Err(few(0))) };
    loop {
        let places = grid.seen().map(|((c, r), _)| Point2::new(c as f64, r as f64));
        let count = places.clone().count();
        if count < MIN_CORNERS || in_line(places) {
            return Ok(Err(few(count)));
        }
        match grid.judge_corners() {
            Ok((_, contrast)) => {
                return Ok(Ok(BoardImage {
                    mirrored: Some(mirrored),
                    square_px: grid.square_px(),
                    edge_px: grid.edge_px(),
                    contrast: contrast.abs(),
                    corners: grid.into_corners(),
                }));
            }
            Err(Flaw::Astray { column, row, .. }) => grid.without(column, row),
            Err(Flaw::Scattered) => return Ok(Err(few(count))),
            Err(flaw) => return Ok(Err(CharucoNotFound::Flaw(flaw))),
        }
    }
}
