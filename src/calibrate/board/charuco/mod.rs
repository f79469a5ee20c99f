//! ChArUco boards: chessboards with a marker in each light square, of which a part is enough.
//!
//! - In: a picture, the board. Out: for each image of the board the corners that are seen, by their true indices, and
//!   whether it is mirrored.
//! - Method: quadrilaterals are read as markers, direct and mirrored (`markers`); those that are where each other's
//!   numbers have them are an image (`layout`). Corners are looked for where markers and corners beside them have them,
//!   and refined in the picture itself (`corners`). The same tests as for chessboards judge them; a corner astray is
//!   dropped.
//! - Why there is none, as far as it can be told: `unread`.
//! - Cannot tell: a board of OpenCV's other layout when the markers of a single row are seen.

mod corners;
mod dictionary;
mod layout;
mod markers;
mod unread;

pub use dictionary::Dictionary;
pub use unread::Unread;

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
use unread::Clues;

/// Fewest corners that say something: a pose and more.
pub(super) const FEWEST: usize = 6;
/// One in so many cells may be read wrong; where markers are tells them apart.
const WRONG: usize = 16;

/// What a ChArUco board has beside its squares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Charuco {
    /// Side of a marker, with its dark rim.
    pub marker_m: f64,
    /// Where its markers are from; they are counted from 0 on.
    pub dictionary: Dictionary,
    /// As OpenCV laid boards out before 4.7, and does with `setLegacyPattern`: where the number of rows of squares is
    /// even, the square at the upper left is light. Where it is odd, nothing is different.
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

/// Finds images of the board: at most one that is not mirrored, the nearest, and mirrored ones, `most` in all. At least
/// one.
///
/// # Errors
/// Why there is none.
pub(super) fn find(
    picture: &Grey,
    board: &Board,
    charuco: &Charuco,
    most: usize,
) -> Result<std::result::Result<Vec<BoardImage>, Unread>> {
    let pixels = pixels(picture)?;
    let layout = charuco.layout(board);
    let quads = quads(&pixels)?;
    let around = layout.plain() / layout.marker;
    let markers = read(picture, &quads, around, charuco.dictionary);
    let images = layout.images(&markers);
    let clues = Clues { picture, quads: &quads, layout: &layout, dictionary: charuco.dictionary, markers: &markers };
    if let Some(wrong) = clues.other_board(&images) {
        return Ok(Err(wrong));
    }
    let (mut found, mut why) = (Vec::new(), None);
    for markers in images.iter().filter(|image| clues.strangers(image) < image.len()) {
        match image(picture, &pixels, &layout, markers)? {
            Ok(image) => found.push(image),
            Err(flaw) => why = why.or(Some(flaw)),
        }
    }
    // The nearest is the direct one; another one that is not mirrored was reflected twice.
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

/// All that quadrilaterals may be in a dictionary, each reading once.
fn read(picture: &Grey, quads: &[Quad], around: f64, dictionary: Dictionary) -> Vec<Marker> {
    let most_wrong = (dictionary.cells().pow(2) / WRONG) as u32;
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
) -> Result<std::result::Result<BoardImage, Unread>> {
    let mirrored = markers.iter().any(|marker| marker.mirrored);
    let corners = Search { picture, pixels, layout, markers }.corners()?;
    let size = layout.squares.map(|n| n - 1);
    let few = |corners: usize| Unread::FewCorners { corners, markers: markers.len() };
    let Some(mut grid) = Grid::part(picture, size, corners, layout.plain(), mirrored) else { return Ok(Err(few(0))) };
    loop {
        let places = grid.seen().map(|((c, r), _)| Point2::new(c as f64, r as f64));
        let count = places.clone().count();
        if count < FEWEST || in_line(places) {
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
            Err(flaw) => return Ok(Err(Unread::Flaw(flaw))),
        }
    }
}
