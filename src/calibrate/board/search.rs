//! Searches for boards: OpenCV's detector on the picture at several scales and on parts of it, then refinement at full
//! scale.
//!
//! The detector's time is proportional to the pixels it sees, four times as many with its ACCURACY flag, and it finds
//! squares of 6 pixels (4 with the flag). Detections in a smaller picture are as good, because corners are refined in
//! the full one. So small scales come first, and the expensive looks only where boards are missing.

use nalgebra::Point2;
use opencv::core::{
    Mat, Point, Point2f, Rect, Scalar, Size, TermCriteria, TermCriteria_COUNT, TermCriteria_EPS, Vector,
};
use opencv::prelude::*;
use opencv::{Result, calib3d, imgproc};

use crate::calibrate::board::grey::Grey;
use crate::calibrate::board::judge::{Flaw, Grid, MIN_CONTRAST};
use crate::calibrate::board::{Board, BoardError, BoardImage};

/// Long sides of the whole picture as given to the detector, pixels.
pub(super) const SEEN_PX: [i32; 4] = [640, 1280, 2560, 5120];
/// Long side of pictures searched with more effort.
const CLOSE_PX: i32 = 1280;
/// Half the refinement window, as a fraction of the distance to the nearest corner, which it must not reach.
pub(super) const WINDOW: f64 = 0.35;
/// Half the window, smallest and largest, pixels.
pub(super) const WINDOW_PX: (i32, i32) = (2, 11);
/// Largest move of a corner, as a fraction of half its window.
const MAX_MOVED: f64 = 0.3;
/// Corners per side of the smallest grid that the detector finds.
const MIN_CORNERS_PER_SIDE: i32 = 3;
/// False grids after which a look is given up.
const MAX_FALSE_GRIDS: usize = 3;

/// Finds images of a chessboard, at most `most` and at least one, in order of detection.
///
/// # Errors
/// When there is none (with what is there instead, if that can be told), or OpenCV fails.
pub(super) fn find(picture: &Grey, board: &Board, most: usize) -> std::result::Result<Vec<BoardImage>, BoardError> {
    let [width, height] = picture.size_px().map(|n| n as i32);
    // OpenCV takes long on a picture that shows nothing.
    let (darkest, brightest) = picture.samples().iter().fold((u8::MAX, 0), |(a, b), v| (a.min(*v), b.max(*v)));
    if f64::from(brightest.saturating_sub(darkest)) < MIN_CONTRAST {
        return Err(BoardError::NotFound { columns: board.columns, rows: board.rows, seen: None, flaw: None });
    }
    let pixels = pixels(picture)?;
    let mut without_found = pixels.try_clone()?;
    let (mut found, mut seen, mut flaw) = (Vec::new(), None, None);
    for look in search_passes(width, height) {
        if found.len() >= most || (look.only_if_none && !found.is_empty()) {
            break;
        }
        let mut painted = without_found.try_clone()?;
        let mut false_grids = 0;
        while found.len() < most && false_grids < MAX_FALSE_GRIDS {
            let Some(rough) = look.detect(&painted, picture, board)? else { break };
            paint_over(&mut painted, &rough)?;
            let Some(mut grid) = rough.with_corners(refine(&pixels, &rough)?) else { break };
            if let Some(part) = part_of(&grid, board) {
                grid = part;
            }
            grid.put_in_order();
            let as_asked = grid.size() == [board.columns, board.rows];
            match (grid.judge(), as_asked) {
                (Ok(contrast), true) => {
                    paint_over(&mut without_found, &grid)?;
                    found.push(BoardImage {
                        mirrored: None,
                        square_px: grid.square_px(),
                        edge_px: grid.edge_px(),
                        contrast: contrast.abs(),
                        corners: grid.into_corners(),
                    });
                    continue;
                }
                // Near a hidden part, corners are often astray.
                (Ok(_) | Err(Flaw::Astray { .. }), false) => seen = seen.or(Some(grid.size())),
                (Err(Flaw::Larger { columns, rows }), _) => seen = seen.or(Some([columns, rows])),
                (Err(other), true) => flaw = flaw.or(Some(other)),
                (Err(_), false) => {}
            }
            false_grids += 1;
        }
    }
    if found.is_empty() {
        let long_side_first = |[a, b]: [usize; 2]| [a.max(b), a.min(b)];
        let asked = long_side_first([board.columns, board.rows]);
        let seen = seen.map(long_side_first).filter(|seen| *seen != asked);
        return Err(BoardError::NotFound { columns: board.columns, rows: board.rows, seen, flaw });
    }
    Ok(found)
}

/// The board within a larger grid whose rim looks like more squares; `None` if the grid has the right size, or no part
/// of it is a board that ends there.
fn part_of<'a>(grid: &Grid<'a>, board: &Board) -> Option<Grid<'a>> {
    let (asked, turned) = ([board.columns, board.rows], [board.rows, board.columns]);
    if [asked, turned].contains(&grid.size()) {
        return None;
    }
    let parts = grid.windows(asked).into_iter().chain(grid.windows(turned).into_iter().map(|part| part.transposed()));
    parts.into_iter().find_map(|mut part| {
        part.put_in_order();
        part.judge().is_ok().then_some(part)
    })
}

/// A part of the picture, scaled down.
struct SearchPass {
    part: Rect,
    /// At most 1.
    scale: f64,
    flags: i32,
    /// Use only if no board was found at all.
    only_if_none: bool,
}

fn search_passes(width: i32, height: i32) -> Vec<SearchPass> {
    const EQUAL: i32 = calib3d::CALIB_CB_NORMALIZE_IMAGE;
    let look = |part: Rect, seen_px: i32, flags: i32| {
        let scale = (f64::from(seen_px) / f64::from(part.width.max(part.height))).min(1.0);
        SearchPass { part, scale, flags, only_if_none: false }
    };
    let whole = Rect::new(0, 0, width, height);
    let smaller = SEEN_PX.iter().take_while(|seen| **seen < width.max(height));
    let first = SEEN_PX.iter().find(|seen| **seen >= width.max(height));
    let mut search_passes: Vec<SearchPass> = smaller.chain(first).map(|seen| look(whole, *seen, 0)).collect();
    let more = [calib3d::CALIB_CB_LARGER, 0, calib3d::CALIB_CB_ACCURACY, calib3d::CALIB_CB_EXHAUSTIVE];
    search_passes.extend(more.map(|flags| look(whole, CLOSE_PX, EQUAL | flags)));
    // Halves of width and height, overlapping by half: they contain fewer other objects.
    for (i, j) in (0..3).flat_map(|j| (0..3).map(move |i| (i, j))) {
        let part = Rect::new(i * width / 4, j * height / 4, width / 2, height / 2);
        if part.width > 32 && part.height > 32 {
            search_passes.push(SearchPass { only_if_none: true, ..look(part, CLOSE_PX, EQUAL) });
        }
    }
    search_passes
}

impl SearchPass {
    /// A grid in pixels of the whole picture: of the board's size, or with the flag LARGER of any size.
    fn detect<'a>(&self, pixels: &Mat, picture: &'a Grey, board: &Board) -> Result<Option<Grid<'a>>> {
        let (image, scale) = self.seen(pixels)?;
        let (mut corners, mut meta) = (Vector::<Point2f>::new(), Mat::default());
        let (size, flags) = (Size::new(board.columns as i32, board.rows as i32), self.flags);
        let ([columns, rows], found) = if flags & calib3d::CALIB_CB_LARGER == 0 {
            let found = calib3d::find_chessboard_corners_sb(&image, size, &mut corners, flags)?;
            ([size.width, size.height], found)
        } else {
            let least = Size::new(MIN_CORNERS_PER_SIDE, MIN_CORNERS_PER_SIDE);
            let found = calib3d::find_chessboard_corners_sb_with_meta(&image, least, &mut corners, flags, &mut meta)?;
            ([meta.cols(), meta.rows()], found)
        };
        if !found {
            return Ok(None);
        }
        let corners = self.in_whole(&corners, scale);
        let grid = Grid::new(picture, columns.max(0) as usize, rows.max(0) as usize, corners);
        Ok(grid.map(|grid| if [rows, columns] == [size.width, size.height] { grid.transposed() } else { grid }))
    }

    /// The detector's picture, and its true scales along x and y.
    fn seen(&self, picture: &Mat) -> Result<(Mat, [f64; 2])> {
        let part = Mat::roi(picture, self.part)?;
        let size = [self.part.width, self.part.height].map(|n| (f64::from(n) * self.scale).round().max(1.0) as i32);
        let mut seen = Mat::default();
        imgproc::resize(&part, &mut seen, Size::new(size[0], size[1]), 0.0, 0.0, imgproc::INTER_AREA)?;
        let scale = [f64::from(size[0]) / f64::from(self.part.width), f64::from(size[1]) / f64::from(self.part.height)];
        Ok((seen, scale))
    }

    fn in_whole(&self, corners: &Vector<Point2f>, [sx, sy]: [f64; 2]) -> Vec<Point2<f64>> {
        // Pixel centres are at integers: pixel edges, at halves, coincide.
        let place = |c: Point2f| {
            let x = (f64::from(c.x) + 0.5) / sx - 0.5 + f64::from(self.part.x);
            let y = (f64::from(c.y) + 0.5) / sy - 0.5 + f64::from(self.part.y);
            Point2::new(x, y)
        };
        corners.iter().map(place).collect()
    }
}

/// The corners, each refined in a window fitted to the squares around it: the detector's own are three times worse.
fn refine(pixels: &Mat, grid: &Grid) -> Result<Vec<Point2<f64>>> {
    grid.with_nearest_px()
        .map(|(corner, nearest_px)| {
            let half_px = (WINDOW * nearest_px).min(f64::from(WINDOW_PX.1));
            let moved = |to: &Point2<f64>| (to - corner).norm();
            let wide = refined(pixels, corner, half_px)?;
            if moved(&wide) <= MAX_MOVED * half_px {
                return Ok(wide);
            }
            // Attracted by something else in its window, such as the edge of the board beside a thin outer square.
            let narrow = refined(pixels, corner, half_px / 2.0)?;
            Ok(if moved(&narrow) < moved(&wide) { narrow } else { wide })
        })
        .collect()
}

/// A corner refined by OpenCV's classic method in a window of this half width, pixels.
pub(super) fn refined(pixels: &Mat, corner: Point2<f64>, half_px: f64) -> Result<Point2<f64>> {
    let until = TermCriteria::new(TermCriteria_COUNT + TermCriteria_EPS, 60, 1e-4)?;
    let half = (half_px as i32).clamp(WINDOW_PX.0, WINDOW_PX.1);
    let mut one = Vector::from_slice(&[Point2f::new(corner.x as f32, corner.y as f32)]);
    imgproc::corner_sub_pix(pixels, &mut one, Size::new(half, half), Size::new(-1, -1), until)?;
    one.get(0).map(|c| Point2::new(f64::from(c.x), f64::from(c.y)))
}

/// The picture as an OpenCV matrix.
pub(super) fn pixels(picture: &Grey) -> Result<Mat> {
    let [width, height] = picture.size_px().map(|n| n as i32);
    Mat::new_rows_cols_with_data(height, width, picture.samples())?.try_clone()
}

/// Hides a detected board: fills its hull and its outer squares with its mean grey.
fn paint_over(picture: &mut Mat, grid: &Grid) -> Result<()> {
    // The outline of a board seen nearly edge-on may extend far away.
    let near = |x: f64, size: i32| (x.round() as i32).clamp(-size, 2 * size);
    let (width, height) = (picture.cols(), picture.rows());
    let outline: Vector<Point> =
        grid.outline().iter().map(|p| Point::new(near(p.x, width), near(p.y, height))).collect();
    imgproc::fill_convex_poly_def(picture, &outline, Scalar::all(grid.mean_grey()))
}
