//! Whether detected corners form a board, and how well it can be seen.

mod edge;

use nalgebra::{Matrix3, Point2, Vector2};

use crate::calibrate::board::flat::{homography, map, median_or_nan};
use crate::calibrate::board::grey::Grey;

/// A homography must fit the corners to this fraction of a square (RMS): distortion bends a board no more than that.
const MAX_BEND: f64 = 0.25;
/// Largest distance of a corner from its neighbours' prediction: this fraction of a square, or this many pixels if that
/// is more.
const OUTLIER: (f64, f64) = (0.08, 1.0);
/// Least contrast of dark and light squares, grey values (median).
pub(super) const MIN_CONTRAST: f64 = 8.0;
/// Squares beyond the outermost ones that alternate with this fraction of the board's contrast belong to a larger
/// board.
const CONTINUATION_CONTRAST: f64 = 0.5;
/// How far beyond a line of corners to look, in squares, including for thin ones at the rim.
const BESIDE: [f64; 2] = [0.5, 0.18];
/// Distance of the outline from the corners, in squares: the outer squares and a little of the rim.
const RIM: f64 = 1.2;

/// Why a grid of corners is rejected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Flaw {
    /// A cell that is not a convex quadrilateral with the common orientation.
    #[error("its corners are not in order at column {column}, row {row}")]
    Folded {
        /// Column of the cell, from 0.
        column: usize,
        /// Row of the cell, from 0.
        row: usize,
    },
    /// A grid that is not a flat board.
    #[error("it does not match a flat board: corners are off by {rms_px:.1} px (RMS), squares have {square_px:.1} px")]
    Bent {
        /// RMS distance from the best homography, pixels.
        rms_px: f64,
        /// Side of a square, pixels.
        square_px: f64,
    },
    /// A corner that does not fit in.
    #[error("the corner in column {column}, row {row} is {off_px:.1} px from where its neighbours have it")]
    Astray {
        /// Its column, from 0.
        column: usize,
        /// Its row, from 0.
        row: usize,
        /// How far off, pixels.
        off_px: f64,
    },
    /// Squares that do not alternate between dark and light.
    #[error("dark and light do not alternate at column {column}, row {row}")]
    Colours {
        /// Column of a square, from 0.
        column: usize,
        /// Row of a square, from 0.
        row: usize,
    },
    /// Hardly any contrast between dark and light.
    #[error("its squares differ by {contrast:.0} grey values of 255; {MIN_CONTRAST} are needed")]
    Faint {
        /// Median difference of dark and light squares.
        contrast: f64,
    },
    /// No two whole squares side by side.
    #[error("no two neighbouring squares are seen whole")]
    Scattered,
    /// Part of a larger board.
    #[error("it is only part of a larger board")]
    Larger {
        /// Inner corners visible per row.
        columns: usize,
        /// Inner corners visible per column.
        rows: usize,
    },
}

/// Residual of each corner to a homography, pixels; `None` where none is seen.
type Left = Vec<Option<Vector2<f64>>>;

/// Corners of a grid, row-major, and their picture.
pub(crate) struct Grid<'a> {
    picture: &'a Grey,
    columns: usize,
    rows: usize,
    /// `None` where a corner is not seen.
    corners: Vec<Option<Point2<f64>>>,
    /// Width of a square's plain margin, at least, in squares.
    plain: f64,
    /// Whether the rotation from columns to rows in the picture is opposite to that from x to y.
    mirrored: bool,
}

impl<'a> Grid<'a> {
    /// A whole grid of plain squares. `None` when the number of corners is not columns times rows, there are fewer than
    /// three in a line, or one is outside the picture.
    pub(crate) fn new(picture: &'a Grey, columns: usize, rows: usize, corners: Vec<Point2<f64>>) -> Option<Self> {
        let whole = columns > 2 && rows > 2 && corners.len() == columns * rows;
        let corners: Vec<_> = corners.into_iter().map(Some).collect();
        (whole && corners.iter().flatten().all(|c| picture.at(*c).is_some())).then_some(Self {
            picture,
            columns,
            rows,
            corners,
            plain: 0.5,
            mirrored: false,
        })
    }

    /// A grid with some corners visible, possibly in a mirror, whose squares have print except for a margin of `plain`
    /// (in squares). `None` when the number of corners, seen or not, is not columns times rows.
    pub(crate) fn part(
        picture: &'a Grey,
        [columns, rows]: [usize; 2],
        corners: Vec<Option<Point2<f64>>>,
        plain: f64,
        mirrored: bool,
    ) -> Option<Self> {
        (corners.len() == columns * rows).then_some(Self { picture, columns, rows, corners, plain, mirrored })
    }

    /// The same grid with other corner positions, one for one; `None` as in [`Grid::new`].
    pub(crate) fn with_corners(&self, corners: Vec<Point2<f64>>) -> Option<Self> {
        Self::new(self.picture, self.columns, self.rows, corners)
    }

    /// Columns and rows swapped.
    pub(crate) fn transposed(&self) -> Self {
        let corners = (0..self.columns).flat_map(|c| (0..self.rows).map(move |r| (c, r))).map(|(c, r)| self.at(c, r));
        Self { columns: self.rows, rows: self.columns, corners: corners.collect(), ..*self }
    }

    /// All parts of it with this many columns and rows: where the rim looks like another row of squares, the board is
    /// one of them.
    pub(crate) fn windows(&self, [columns, rows]: [usize; 2]) -> Vec<Self> {
        if columns > self.columns || rows > self.rows {
            return Vec::new();
        }
        let places = (0..=self.rows - rows).flat_map(|r| (0..=self.columns - columns).map(move |c| (c, r)));
        let part = |(left, top): (usize, usize)| {
            let corners = (0..rows).flat_map(|r| (0..columns).map(move |c| (left + c, top + r)));
            let corners: Option<Vec<_>> = corners.map(|(c, r)| self.at(c, r)).collect();
            Self::new(self.picture, columns, rows, corners?)
        };
        places.filter_map(part).collect()
    }

    /// Columns and rows.
    pub(crate) fn size(&self) -> [usize; 2] {
        [self.columns, self.rows]
    }

    /// Visible corners: column and row, pixels.
    pub(crate) fn seen(&self) -> impl Iterator<Item = ((usize, usize), Point2<f64>)> + Clone + '_ {
        let columns = self.columns;
        self.corners.iter().enumerate().filter_map(move |(i, corner)| Some(((i % columns, i / columns), (*corner)?)))
    }

    /// Visible corners with their indices.
    pub(crate) fn into_corners(self) -> Vec<(usize, Point2<f64>)> {
        self.corners.into_iter().enumerate().filter_map(|(i, corner)| Some((i, corner?))).collect()
    }

    /// Removes a corner.
    pub(crate) fn without(&mut self, column: usize, row: usize) {
        if let Some(corner) = self.corners.get_mut(row * self.columns + column) {
            *corner = None;
        }
    }

    /// Corner in column c, row r; `None` where none is seen.
    fn at(&self, c: usize, r: usize) -> Option<Point2<f64>> {
        let inside = c < self.columns && r < self.rows;
        if inside { self.corners.get(r * self.columns + c).copied().flatten() } else { None }
    }

    /// The corners of a square, going around from the upper left.
    fn square(&self, c: usize, r: usize) -> Option<[Point2<f64>; 4]> {
        Some([self.at(c, r)?, self.at(c + 1, r)?, self.at(c + 1, r + 1)?, self.at(c, r + 1)?])
    }

    /// Columns and rows of all squares whose corners are all visible.
    fn squares(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let columns = self.columns - 1;
        (0..self.rows - 1)
            .flat_map(move |r| (0..columns).map(move |c| (c, r)))
            .filter(|(c, r)| self.square(*c, *r).is_some())
    }

    /// Distance of the nearest neighbour of a corner, pixels; infinite where none is seen.
    fn nearest_px(&self, c: usize, r: usize, corner: Point2<f64>) -> f64 {
        let around = [(c.wrapping_sub(1), r), (c + 1, r), (c, r.wrapping_sub(1)), (c, r + 1)];
        let distance = |(c, r): (usize, usize)| Some((self.at(c, r)? - corner).norm());
        around.into_iter().filter_map(distance).fold(f64::INFINITY, f64::min)
    }

    /// Visible corners, each with the distance to its nearest neighbour, pixels.
    pub(crate) fn with_nearest_px(&self) -> impl Iterator<Item = (Point2<f64>, f64)> + '_ {
        self.seen().map(|((c, r), corner)| (corner, self.nearest_px(c, r, corner)))
    }

    /// Side of a square: median of all sides, pixels.
    pub(crate) fn square_px(&self) -> f64 {
        let sides = self.squares().filter_map(|(c, r)| self.square(c, r));
        median_or_nan(sides.flat_map(|[corner, aside, _, below]| [(aside - corner).norm(), (below - corner).norm()]))
    }

    /// Puts the corners in the order that [`super::BoardImage`] describes.
    pub(crate) fn put_in_order(&mut self) {
        // Twice the area of a square's upper left half, negative where it is left-handed.
        let turn = |[corner, aside, _, below]: [Point2<f64>; 4]| (aside - corner).perp(&(below - corner));
        let across: f64 = self.squares().filter_map(|(c, r)| self.square(c, r)).map(turn).sum();
        if across < 0.0 {
            self.corners.chunks_mut(self.columns).for_each(<[_]>::reverse);
        }
        let dark_ends_differ = self.columns % 2 != self.rows % 2;
        let backwards = if dark_ends_differ {
            let light = |(c, r): (usize, usize)| Some(sign(c, r) * self.grey(c as f64 + 0.5, r as f64 + 0.5)?);
            self.squares().filter_map(light).sum::<f64>() > 0.0
        } else {
            let row = |r: usize| Some(self.at(self.columns - 1, r)? - self.at(0, r)?);
            let along: Vector2<f64> = (0..self.rows).filter_map(row).sum();
            along.x < -along.y.abs() * 1e-9 || (along.x.abs() <= along.y.abs() * 1e-9 && along.y < 0.0)
        };
        if backwards {
            self.corners.reverse();
        }
    }

    /// The grey value at a point given in columns and rows within the grid, bilinear from the corners around it.
    fn grey(&self, column: f64, row: f64) -> Option<f64> {
        let c = (column.max(0.0) as usize).min(self.columns - 2);
        let r = (row.max(0.0) as usize).min(self.rows - 2);
        let (u, v) = (column - c as f64, row - r as f64);
        let [corner, aside, across, below] = self.square(c, r)?;
        let (above, beneath) = (corner + u * (aside - corner), below + u * (across - below));
        self.picture.at(above + v * (beneath - above))
    }

    /// The mean grey of a few points in the plain part of a square.
    fn square_grey(&self, c: usize, r: usize) -> Option<f64> {
        let off = 0.5 - self.plain / 2.0;
        let places = [(-off, 0.0), (off, 0.0), (0.0, -off), (0.0, off)];
        let sum: Option<f64> = places.iter().map(|(u, v)| self.grey(c as f64 + 0.5 + u, r as f64 + 0.5 + v)).sum();
        Some(sum? / places.len() as f64)
    }

    /// Outline of its corners, outer squares and a little of the rim: a quadrilateral, or that of the corners alone if
    /// it cannot be built.
    pub(crate) fn outline(&self) -> Vec<Point2<f64>> {
        let (right, bottom) = ((self.columns - 1) as f64, (self.rows - 1) as f64);
        let ends = [(-RIM, -RIM), (right + RIM, -RIM), (right + RIM, bottom + RIM), (-RIM, bottom + RIM)];
        let flat = self.homography();
        let outline: Option<Vec<_>> = ends.iter().map(|(c, r)| map(&flat?, *c, *r)).collect();
        let (last_column, last_row) = (self.columns - 1, self.rows - 1);
        outline.unwrap_or_else(|| {
            let ends = [(0, 0), (last_column, 0), (last_column, last_row), (0, last_row)];
            ends.into_iter().filter_map(|(c, r)| self.at(c, r)).collect()
        })
    }

    /// Mean grey over all squares between corners.
    pub(crate) fn mean_grey(&self) -> f64 {
        let greys: Vec<f64> = self.squares().filter_map(|(c, r)| self.square_grey(c, r)).collect();
        greys.iter().sum::<f64>() / greys.len().max(1) as f64
    }

    /// Checks that this is a board; returns its contrast. Corners must be in order ([`Grid::put_in_order`]).
    pub(crate) fn judge(&self) -> Result<f64, Flaw> {
        let (board_in_picture, contrast) = self.judge_corners()?;
        self.check_end(&board_in_picture, contrast)?;
        Ok(contrast)
    }

    /// Checks that this is a board or part of one; returns the homography from columns and rows to pixels and the
    /// contrast (positive if (0, 0) is dark).
    pub(crate) fn judge_corners(&self) -> Result<(Matrix3<f64>, f64), Flaw> {
        if self.squares().next().is_none() {
            return Err(Flaw::Scattered);
        }
        self.check_order()?;
        let (board_in_picture, off) = self.check_flatness()?;
        let contrast = self.check_colours()?;
        self.check_smoothness(&off)?;
        Ok((board_in_picture, contrast))
    }

    /// Checks that all squares are convex with one orientation.
    fn check_order(&self) -> Result<(), Flaw> {
        let sense = if self.mirrored { -1.0 } else { 1.0 };
        let handed = |(c, r): &(usize, usize)| {
            let Some(around) = self.square(*c, *r) else { return true };
            (0..4).all(|i| {
                let (before, here, after) = (around[(i + 3) % 4], around[i], around[(i + 1) % 4]);
                sense * (here - before).perp(&(after - here)) > 0.0
            })
        };
        match self.squares().find(|square| !handed(square)) {
            Some((column, row)) => Err(Flaw::Folded { column, row }),
            None => Ok(()),
        }
    }

    /// Checks that a homography fits the corners up to distortion; returns it (columns and rows to pixels) and the
    /// residuals, pixels.
    fn check_flatness(&self) -> Result<(Matrix3<f64>, Left), Flaw> {
        let square_px = self.square_px();
        let bent = |rms_px: f64| Flaw::Bent { rms_px, square_px };
        let flat = self.homography().ok_or(bent(f64::INFINITY))?;
        let mut off = vec![None; self.corners.len()];
        for ((c, r), corner) in self.seen() {
            let place = map(&flat, c as f64, r as f64).ok_or(bent(f64::INFINITY))?;
            off[r * self.columns + c] = Some(corner - place);
        }
        let squares = off.iter().flatten().map(Vector2::norm_squared);
        let rms_px = (squares.clone().sum::<f64>() / squares.count() as f64).sqrt();
        if rms_px > MAX_BEND * square_px { Err(bent(rms_px)) } else { Ok((flat, off)) }
    }

    /// Checks that each corner is where its neighbours predict it, as under smooth distortion.
    fn check_smoothness(&self, off: &[Option<Vector2<f64>>]) -> Result<(), Flaw> {
        // Prediction for the corner at `pos` from its line of corners, row or column.
        let expected = |i: usize, pos: usize, step: usize, len: usize| {
            let at = |steps: isize| {
                let inside = pos.checked_add_signed(steps).is_some_and(|pos| pos < len);
                if inside { off.get(i.checked_add_signed(steps * step as isize)?).copied().flatten() } else { None }
            };
            let between = at(-1).zip(at(1)).map(|(a, b)| (a + b) / 2.0);
            let beyond = |way: isize| Some(2.0 * at(way)? - at(2 * way)?);
            between.or_else(|| beyond(1)).or_else(|| beyond(-1))
        };
        // All available predictions must find it astray: beside a stray corner, one of them does.
        let astray = |((column, row), corner): ((usize, usize), Point2<f64>)| {
            let i = row * self.columns + column;
            let here = off.get(i).copied().flatten()?;
            let lines = [expected(i, column, 1, self.columns), expected(i, row, self.columns, self.rows)];
            let off_px = lines.into_iter().flatten().map(|there| (here - there).norm()).reduce(f64::min)?;
            let most = (OUTLIER.0 * self.nearest_px(column, row, corner)).max(OUTLIER.1);
            (off_px > most).then_some(Flaw::Astray { column, row, off_px })
        };
        let off_px = |flaw: &Flaw| if let Flaw::Astray { off_px, .. } = flaw { *off_px } else { 0.0 };
        let worst = self.seen().filter_map(astray).max_by(|a, b| off_px(a).total_cmp(&off_px(b)));
        worst.map_or(Ok(()), Err)
    }

    /// Checks that neighbouring squares differ consistently; returns the median difference.
    fn check_colours(&self) -> Result<f64, Flaw> {
        let grey = |c: usize, r: usize| self.square_grey(c, r).ok_or(Flaw::Colours { column: c, row: r });
        let mut steps = Vec::new();
        for (c, r) in self.squares() {
            let here = grey(c, r)?;
            if self.square(c + 1, r).is_some() {
                steps.push((sign(c, r) * (grey(c + 1, r)? - here), c, r));
            }
            if self.square(c, r + 1).is_some() {
                steps.push((sign(c, r) * (grey(c, r + 1)? - here), c, r));
            }
        }
        if steps.is_empty() {
            return Err(Flaw::Scattered);
        }
        let middle = median_or_nan(steps.iter().map(|s| s.0));
        match steps.iter().find(|s| s.0 * middle <= 0.0) {
            Some((_, column, row)) => Err(Flaw::Colours { column: *column, row: *row }),
            None if middle.abs() < MIN_CONTRAST => Err(Flaw::Faint { contrast: middle.abs() }),
            None => Ok(middle),
        }
    }

    /// Checks that the board ends with the squares around the outermost corners. `contrast`: positive where (0, 0) is
    /// dark.
    fn check_end(&self, board_in_picture: &Matrix3<f64>, contrast: f64) -> Result<(), Flaw> {
        // A few points in a square, so that the noise of one pixel does not decide. Those of one depth lie side by
        // side.
        let grey = |column: f64, row: f64, (across, down): (f64, f64)| {
            let places = [-0.2, -0.1, 0.0, 0.1, 0.2];
            let at = |off: f64| self.picture.at(map(board_in_picture, column + off * across, row + off * down)?);
            Some(places.into_iter().map(at).sum::<Option<f64>>()? / places.len() as f64)
        };
        // Adjacent squares beyond the board: whether the steps between them have the right sign and, together, the
        // right size.
        let alternate = |squares: Vec<(Option<f64>, i64)>| {
            let step = |pair: &[(Option<f64>, i64)]| match pair {
                [(Some(here), place), (Some(next), _)] => {
                    Some(if place % 2 == 0 { 1.0 } else { -1.0 } * (next - here) / contrast)
                }
                _ => None,
            };
            let steps: Option<Vec<f64>> = squares.windows(2).map(step).collect();
            steps.is_some_and(|steps| {
                let mean = steps.iter().sum::<f64>() / steps.len().max(1) as f64;
                mean > CONTINUATION_CONTRAST && steps.iter().all(|step| *step > 0.0)
            })
        };
        let (columns, rows) = (self.columns as i64, self.rows as i64);
        // Outer squares may be thin and are skipped: only those between the first corner and the last count.
        let beyond_column = |c: i64| {
            let depths = BESIDE.map(|depth| if c < 0 { (c + 1) as f64 - depth } else { c as f64 + depth });
            let along = |depth: f64| (0..rows - 1).map(move |r| (grey(depth, r as f64 + 0.5, (0.0, 1.0)), c + r));
            depths.into_iter().any(|depth| alternate(along(depth).collect()))
        };
        let beyond_row = |r: i64| {
            let depths = BESIDE.map(|depth| if r < 0 { (r + 1) as f64 - depth } else { r as f64 + depth });
            let along = |depth: f64| (0..columns - 1).map(move |c| (grey(c as f64 + 0.5, depth, (1.0, 0.0)), c + r));
            depths.into_iter().any(|depth| alternate(along(depth).collect()))
        };
        let count = |goes_on: &dyn Fn(i64) -> bool| (0..50).take_while(|i| goes_on(*i)).count();
        let more_columns = count(&|i| beyond_column(columns + i)) + count(&|i| beyond_column(-2 - i));
        let more_rows = count(&|i| beyond_row(rows + i)) + count(&|i| beyond_row(-2 - i));
        if more_columns + more_rows > 0 {
            return Err(Flaw::Larger { columns: self.columns + more_columns, rows: self.rows + more_rows });
        }
        Ok(())
    }

    /// Columns and rows to pixels, lens distortion ignored.
    fn homography(&self) -> Option<Matrix3<f64>> {
        let pairs: Vec<_> = self.seen().map(|((c, r), corner)| (Point2::new(c as f64, r as f64), corner)).collect();
        homography(&pairs)
    }
}

/// The sign of a square in the chequer.
fn sign(c: usize, r: usize) -> f64 {
    if (c + r).is_multiple_of(2) { 1.0 } else { -1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: f64 = 20.0;

    /// A chequer over the whole picture except for a white rim around 6x5 squares from (40, 40), in slight perspective.
    fn place(c: f64, r: f64) -> Point2<f64> {
        Point2::new(60.0 + SQUARE * c, 60.0 + SQUARE * r) / (1.0 + 0.004 * c + 0.002 * r)
    }

    fn picture(grey: impl Fn(f64, f64) -> u8) -> Grey {
        let samples = (0..240 * 240).map(|i| {
            let (x, y) = (f64::from(i % 240), f64::from(i / 240));
            // place() solved for (c, r).
            let (a, b, d, e) = (SQUARE - 0.004 * x, -0.002 * x, -0.004 * y, SQUARE - 0.002 * y);
            let (c, r) = (
                ((x - 60.0) * e - b * (y - 60.0)) / (a * e - b * d),
                (a * (y - 60.0) - d * (x - 60.0)) / (a * e - b * d),
            );
            grey(c, r)
        });
        Grey::from_samples(240, 240, samples.collect()).unwrap()
    }

    /// A board of 5x4 inner corners.
    fn board(c: f64, r: f64) -> u8 {
        let inside = (-1.0..5.0).contains(&c) && (-1.0..4.0).contains(&r);
        if inside && (c.floor() + r.floor()).rem_euclid(2.0) == 0.0 { 40 } else { 200 }
    }

    fn corners(columns: usize, rows: usize) -> Vec<Point2<f64>> {
        (0..rows).flat_map(|r| (0..columns).map(move |c| place(c as f64, r as f64))).collect()
    }

    fn judged(picture: &Grey, columns: usize, rows: usize, corners: Vec<Point2<f64>>) -> Result<f64, Flaw> {
        Grid::new(picture, columns, rows, corners).unwrap().judge()
    }

    #[test]
    fn a_board_is_one() {
        let contrast = judged(&picture(board), 5, 4, corners(5, 4)).unwrap();
        assert!((contrast - 160.0).abs() < 1.0, "{contrast}");
    }

    #[test]
    fn one_corner_beside_its_place_is_told_by_name() {
        let picture = picture(board);
        for i in 0..20 {
            let mut corners = corners(5, 4);
            corners[i] += Vector2::new(2.5, -2.0);
            match judged(&picture, 5, 4, corners) {
                Err(Flaw::Astray { column, row, off_px }) => {
                    assert_eq!((column, row), (i % 5, i / 5));
                    assert!((1.6..4.0).contains(&off_px), "corner {i}: {off_px} px");
                }
                other => panic!("corner {i}: {other:?}"),
            }
        }
        let mut corners = corners(5, 4);
        corners[7] += Vector2::new(0.5, -0.5);
        assert!(judged(&picture, 5, 4, corners).is_ok(), "noise is no flaw");
    }

    #[test]
    fn corners_out_of_order_a_plane_that_is_none_and_wrong_colours_are_refused() {
        let picture = picture(board);
        let mut swapped = corners(5, 4);
        swapped.swap(6, 7);
        assert!(matches!(judged(&picture, 5, 4, swapped), Err(Flaw::Folded { .. })));

        // Folded along the middle like a sheet: every square is still convex.
        let mut folded = corners(5, 4);
        folded.iter_mut().for_each(|c| c.x += 0.9 * (c.y - 90.0).abs());
        assert!(matches!(judged(&picture, 5, 4, folded), Err(Flaw::Bent { .. })));

        let shifted: Vec<_> = (0..20).map(|i| place((i % 5) as f64 + 0.5, (i / 5) as f64)).collect();
        assert!(matches!(judged(&picture, 5, 4, shifted), Err(Flaw::Colours { .. })));

        let faint = self::picture(|c, r| 100 + board(c, r) / 32);
        assert!(matches!(judged(&faint, 5, 4, corners(5, 4)), Err(Flaw::Faint { .. })));

        // One square painted over.
        let spot =
            self::picture(|c, r| if (1.0..2.0).contains(&c) && (1.0..2.0).contains(&r) { 200 } else { board(c, r) });
        assert!(matches!(judged(&spot, 5, 4, corners(5, 4)), Err(Flaw::Colours { .. })));
    }

    #[test]
    fn a_part_of_a_board_is_told_with_the_size_of_the_whole() {
        let picture = picture(board);
        let whole = Err(Flaw::Larger { columns: 5, rows: 4 });
        assert_eq!(judged(&picture, 3, 4, corners(3, 4)), whole);
        assert_eq!(judged(&picture, 5, 3, corners(5, 3)), whole);
        let middle = (0..9).map(|i| place((i % 3 + 1) as f64, (i / 3 + 1) as f64)).collect();
        let mut grid = Grid::new(&picture, 3, 3, middle).unwrap();
        grid.put_in_order();
        assert_eq!(grid.judge(), whole);
    }

    #[test]
    fn thin_outer_squares_are_seen_beyond_a_part_and_end_a_whole_board() {
        // Its outer squares have a third of their width, as if the print was trimmed.
        let thin = |c: f64, r: f64| {
            let inside = (-0.33..4.33).contains(&c) && (-0.33..3.33).contains(&r);
            if inside { board(c, r) } else { 200 }
        };
        let picture = picture(thin);
        assert!(judged(&picture, 5, 4, corners(5, 4)).is_ok());
        let whole = Err(Flaw::Larger { columns: 5, rows: 4 });
        assert_eq!(judged(&picture, 5, 3, corners(5, 3)), whole);
        assert_eq!(judged(&picture, 3, 4, corners(3, 4)), whole);
    }

    #[test]
    fn noise_does_not_make_a_part_of_a_faint_board_a_whole_one() {
        for seed in 0..40 {
            let mut random = fastrand::Rng::with_seed(seed);
            let faint = |c: f64, r: f64| 100.0 + f64::from(board(c, r)) / 14.0;
            let noise: Vec<f64> = (0..240 * 240).map(|_| (0..12).map(|_| random.f64()).sum::<f64>() - 6.0).collect();
            let next = std::cell::Cell::new(0);
            let picture = picture(|c, r| {
                next.set(next.get() + 1);
                (faint(c, r) + 2.0 * noise[next.get() - 1]).round() as u8
            });
            let whole = Err(Flaw::Larger { columns: 5, rows: 4 });
            assert_eq!(judged(&picture, 5, 3, corners(5, 3)), whole, "seed {seed}");
            assert_eq!(judged(&picture, 3, 4, corners(3, 4)), whole, "seed {seed}");
        }
    }

    #[test]
    fn a_rim_that_looks_like_another_row_leaves_the_board_in_a_window() {
        let picture = picture(board);
        // The fifth row of corners is where the outer squares end.
        let grid = Grid::new(&picture, 5, 5, corners(5, 5)).unwrap();
        assert_eq!(grid.windows([6, 4]).len() + grid.windows([5, 6]).len(), 0);
        let sound = |part: &mut Grid<'_>| {
            part.put_in_order();
            part.judge().is_ok()
        };
        let mut windows = grid.windows([5, 4]);
        let found: Vec<bool> = windows.iter_mut().map(sound).collect();
        assert_eq!(found, [true, false]);
    }
}
