//! Whether corners that were found are those of a board, and how well it can be seen.

use nalgebra::{DMatrix, Matrix3, Point2, Vector2, Vector3};

use super::super::grey::Grey;

/// A homography must explain the corners to this share of a square (RMS): distortion bends a board, but not more.
const BENT: f64 = 0.25;
/// How far a corner may be from where its neighbours have it: this share of a square, or so many pixels if that is more.
const ASTRAY: (f64, f64) = (0.08, 1.0);
/// Least difference of dark and light squares, grey values (median).
const LEAST_CONTRAST: f64 = 8.0;
/// Squares beyond the outermost ones, alternating with this share of the board's contrast, are part of a larger board.
const GOES_ON: f64 = 0.5;
/// How far its outline is from the corners, in squares: the outer squares and a little of the rim.
const RIM: f64 = 1.2;
/// Steps of a profile across an edge.
const PROFILE: usize = 64;

/// Why a grid of corners is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Flaw {
    /// Cells that are no convex quadrilaterals of one orientation.
    #[error("its corners are not in order at column {column}, row {row}")]
    Folded {
        /// Column of the cell, from 0.
        column: usize,
        /// Row of the cell, from 0.
        row: usize,
    },
    /// A grid that is no flat board.
    #[error("no flat board looks like it: corners are off by {rms_px:.1} px (RMS), squares have {square_px:.1} px")]
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
    /// Squares that are not dark and light in turn.
    #[error("dark and light do not alternate at column {column}, row {row}")]
    Colours {
        /// Column of a square, from 0.
        column: usize,
        /// Row of a square, from 0.
        row: usize,
    },
    /// Hardly any difference of dark and light.
    #[error("its squares differ by {contrast:.0} grey values of 255; {LEAST_CONTRAST} are needed")]
    Faint {
        /// Median difference of dark and light squares.
        contrast: f64,
    },
    /// A part of a larger board.
    #[error("the board goes on beyond it")]
    Larger {
        /// Inner corners in a row that can be seen.
        columns: usize,
        /// Inner corners in a column that can be seen.
        rows: usize,
    },
}

/// Corners of a grid, row by row, and the picture they are in.
pub(super) struct Grid<'a> {
    picture: &'a Grey,
    columns: usize,
    rows: usize,
    corners: Vec<Point2<f64>>,
}

impl<'a> Grid<'a> {
    /// `None` when the number of corners is not columns times rows, there are fewer than three in a line, or one is not in
    /// the picture.
    pub(super) fn new(picture: &'a Grey, columns: usize, rows: usize, corners: Vec<Point2<f64>>) -> Option<Self> {
        let whole = columns > 2 && rows > 2 && corners.len() == columns * rows;
        (whole && corners.iter().all(|c| picture.at(*c).is_some())).then_some(Self { picture, columns, rows, corners })
    }

    /// The same grid with its corners elsewhere, one for one; `None` as in [`Grid::new`].
    pub(super) fn with_corners(&self, corners: Vec<Point2<f64>>) -> Option<Self> {
        Self::new(self.picture, self.columns, self.rows, corners)
    }

    /// Columns for rows.
    pub(super) fn transposed(self) -> Self {
        let corners = (0..self.columns).flat_map(|c| (0..self.rows).map(move |r| (c, r))).map(|(c, r)| self.at(c, r));
        Self { picture: self.picture, columns: self.rows, rows: self.columns, corners: corners.collect() }
    }

    /// Columns and rows.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.columns, self.rows]
    }

    pub(super) fn corners(&self) -> &[Point2<f64>] {
        &self.corners
    }

    pub(super) fn into_corners(self) -> Vec<Point2<f64>> {
        self.corners
    }

    /// Corner in column c, row r; both must be in the grid.
    fn at(&self, c: usize, r: usize) -> Point2<f64> {
        self.corners[r * self.columns + c]
    }

    /// Columns and rows of all squares between corners.
    fn squares(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let columns = self.columns - 1;
        (0..self.rows - 1).flat_map(move |r| (0..columns).map(move |c| (c, r)))
    }

    /// Distance of the nearest neighbours of each corner, pixels.
    pub(super) fn nearest_px(&self) -> Vec<f64> {
        let nearest = |i: usize| {
            let (c, r) = (i % self.columns, i / self.columns);
            let aside =
                [c.checked_sub(1), (c + 1 < self.columns).then_some(c + 1)].into_iter().flatten().map(|c| (c, r));
            let above = [r.checked_sub(1), (r + 1 < self.rows).then_some(r + 1)].into_iter().flatten().map(|r| (c, r));
            aside.chain(above).map(|(c, r)| (self.at(c, r) - self.corners[i]).norm()).fold(f64::INFINITY, f64::min)
        };
        (0..self.corners.len()).map(nearest).collect()
    }

    /// Side of a square: median of all sides, pixels.
    pub(super) fn square_px(&self) -> f64 {
        let sides = self.squares().flat_map(|(c, r)| {
            let corner = self.at(c, r);
            [(self.at(c + 1, r) - corner).norm(), (self.at(c, r + 1) - corner).norm()]
        });
        median(sides.collect())
    }

    /// Puts the corners in the order that [`super::BoardImage`] describes.
    pub(super) fn put_in_order(&mut self) {
        let across: f64 = self.squares().map(|(c, r)| self.turn(c, r)).sum();
        if across < 0.0 {
            self.corners.chunks_mut(self.columns).for_each(<[_]>::reverse);
        }
        let dark_ends_differ = self.columns % 2 != self.rows % 2;
        let backwards = if dark_ends_differ {
            let light = |(c, r): (usize, usize)| Some(sign(c, r) * self.grey(c as f64 + 0.5, r as f64 + 0.5)?);
            self.squares().filter_map(light).sum::<f64>() > 0.0
        } else {
            let along: Vector2<f64> = (0..self.rows).map(|r| self.at(self.columns - 1, r) - self.at(0, r)).sum();
            along.x < -along.y.abs() * 1e-9 || (along.x.abs() <= along.y.abs() * 1e-9 && along.y < 0.0)
        };
        if backwards {
            self.corners.reverse();
        }
    }

    /// Twice the area of a square's upper left half, negative where it is left-handed.
    fn turn(&self, c: usize, r: usize) -> f64 {
        (self.at(c + 1, r) - self.at(c, r)).perp(&(self.at(c, r + 1) - self.at(c, r)))
    }

    /// The grey value at a place given in columns and rows within the grid, bilinear from the corners around it.
    fn grey(&self, column: f64, row: f64) -> Option<f64> {
        let c = (column.max(0.0) as usize).min(self.columns - 2);
        let r = (row.max(0.0) as usize).min(self.rows - 2);
        let (u, v) = (column - c as f64, row - r as f64);
        let along = |r: usize| self.at(c, r) + u * (self.at(c + 1, r) - self.at(c, r));
        self.picture.at(along(r) + v * (along(r + 1) - along(r)))
    }

    /// The mean of a few places around the middle of a square.
    fn square_grey(&self, c: usize, r: usize) -> Option<f64> {
        let places = [(0.0, 0.0), (-0.2, 0.0), (0.2, 0.0), (0.0, -0.2), (0.0, 0.2)];
        let sum: Option<f64> = places.iter().map(|(u, v)| self.grey(c as f64 + 0.5 + u, r as f64 + 0.5 + v)).sum();
        Some(sum? / places.len() as f64)
    }

    /// Its corners and outer squares, and a little of the rim: a quadrilateral, or the corners' own where that is none.
    pub(super) fn outline(&self) -> Vec<Point2<f64>> {
        let (right, bottom) = ((self.columns - 1) as f64, (self.rows - 1) as f64);
        let ends = [(-RIM, -RIM), (right + RIM, -RIM), (right + RIM, bottom + RIM), (-RIM, bottom + RIM)];
        let flat = self.homography();
        let outline: Option<Vec<_>> = ends.iter().map(|(c, r)| map(&flat?, *c, *r)).collect();
        let (last_column, last_row) = (self.columns - 1, self.rows - 1);
        outline.unwrap_or_else(|| {
            vec![self.at(0, 0), self.at(last_column, 0), self.at(last_column, last_row), self.at(0, last_row)]
        })
    }

    /// Over all squares between corners.
    pub(super) fn mean_grey(&self) -> f64 {
        let greys: Vec<f64> = self.squares().filter_map(|(c, r)| self.square_grey(c, r)).collect();
        greys.iter().sum::<f64>() / greys.len().max(1) as f64
    }

    /// Whether this is a board; its contrast. Corners must be in order ([`Grid::put_in_order`]).
    pub(super) fn judge(&self) -> Result<f64, Flaw> {
        self.check_order()?;
        let (board_in_picture, off) = self.check_flatness()?;
        let contrast = self.check_colours()?;
        self.check_smoothness(&off)?;
        self.check_end(&board_in_picture, contrast)?;
        Ok(contrast)
    }

    /// All squares convex and of one orientation.
    fn check_order(&self) -> Result<(), Flaw> {
        let handed = |(c, r): &(usize, usize)| {
            let around = [self.at(*c, *r), self.at(c + 1, *r), self.at(c + 1, r + 1), self.at(*c, r + 1)];
            (0..4).all(|i| {
                let (before, here, after) = (around[(i + 3) % 4], around[i], around[(i + 1) % 4]);
                (here - before).perp(&(after - here)) > 0.0
            })
        };
        match self.squares().find(|square| !handed(square)) {
            Some((column, row)) => Err(Flaw::Folded { column, row }),
            None => Ok(()),
        }
    }

    /// A homography explains the corners up to distortion: it (columns and rows to pixels), and what it leaves, pixels.
    fn check_flatness(&self) -> Result<(Matrix3<f64>, Vec<Vector2<f64>>), Flaw> {
        let square_px = self.square_px();
        let flat = self.homography();
        let place = |c: usize, r: usize| flat.and_then(|h| map(&h, c as f64, r as f64));
        let off: Option<Vec<Vector2<f64>>> = (0..self.corners.len())
            .map(|i| Some(self.corners[i] - place(i % self.columns, i / self.columns)?))
            .collect();
        let (Some(flat), Some(off)) = (flat, off) else {
            return Err(Flaw::Bent { rms_px: f64::INFINITY, square_px });
        };
        let rms_px = (off.iter().map(Vector2::norm_squared).sum::<f64>() / off.len() as f64).sqrt();
        if rms_px > BENT * square_px {
            return Err(Flaw::Bent { rms_px, square_px });
        }
        Ok((flat, off))
    }

    /// Distortion leaves each corner where its neighbours have it.
    fn check_smoothness(&self, off: &[Vector2<f64>]) -> Result<(), Flaw> {
        let nearest = self.nearest_px();
        // What a line of corners, row or column, expects of the one at `pos` in it.
        let expected = |i: usize, pos: usize, step: usize, len: usize| match pos {
            0 => 2.0 * off[i + step] - off[i + 2 * step],
            _ if pos + 1 == len => 2.0 * off[i - step] - off[i - 2 * step],
            _ => (off[i - step] + off[i + step]) / 2.0,
        };
        // Both must find it astray: beside a corner that is, one does.
        let astray = |i: usize| {
            let in_row = expected(i, i % self.columns, 1, self.columns);
            let in_column = expected(i, i / self.columns, self.columns, self.rows);
            let off_px = (off[i] - in_row).norm().min((off[i] - in_column).norm());
            (off_px > (ASTRAY.0 * nearest[i]).max(ASTRAY.1)).then_some((i, off_px))
        };
        let worst = (0..off.len()).filter_map(astray).max_by(|a, b| a.1.total_cmp(&b.1));
        match worst {
            Some((i, off_px)) => Err(Flaw::Astray { column: i % self.columns, row: i / self.columns, off_px }),
            None => Ok(()),
        }
    }

    /// Neighbouring squares differ, always the same way round; the median difference.
    fn check_colours(&self) -> Result<f64, Flaw> {
        let grey = |c: usize, r: usize| self.square_grey(c, r).ok_or(Flaw::Colours { column: c, row: r });
        let mut steps = Vec::new();
        for (c, r) in self.squares() {
            let here = grey(c, r)?;
            if c + 2 < self.columns {
                steps.push((sign(c, r) * (grey(c + 1, r)? - here), c, r));
            }
            if r + 2 < self.rows {
                steps.push((sign(c, r) * (grey(c, r + 1)? - here), c, r));
            }
        }
        let middle = median(steps.iter().map(|s| s.0).collect());
        match steps.iter().find(|s| s.0 * middle <= 0.0) {
            Some((_, column, row)) => Err(Flaw::Colours { column: *column, row: *row }),
            None if middle.abs() < LEAST_CONTRAST => Err(Flaw::Faint { contrast: middle.abs() }),
            None => Ok(middle),
        }
    }

    /// The board ends with the squares around the outermost corners. `contrast`: positive where (0, 0) is dark.
    fn check_end(&self, board_in_picture: &Matrix3<f64>, contrast: f64) -> Result<(), Flaw> {
        let grey = |c: i64, r: i64| self.picture.at(map(board_in_picture, c as f64 + 0.5, r as f64 + 0.5)?);
        // Squares side by side beyond the board, from (c, r) on: whether each step from one to the next has the right sign and size.
        let alternate = |line: &mut dyn Iterator<Item = (i64, i64)>| {
            let squares: Vec<_> =
                line.map(|(c, r)| grey(c, r).map(|g| (g, if (c + r) % 2 == 0 { 1.0 } else { -1.0 }))).collect();
            squares.windows(2).all(|pair| match pair {
                [Some((here, sign)), Some((next, _))] => sign * (next - here) / contrast > GOES_ON,
                _ => false,
            })
        };
        let (columns, rows) = (self.columns as i64, self.rows as i64);
        let beyond_column = |c: i64| alternate(&mut (-1..rows).map(|r| (c, r)));
        let beyond_row = |r: i64| alternate(&mut (-1..columns).map(|c| (c, r)));
        let count = |goes_on: &dyn Fn(i64) -> bool| (0..50).take_while(|i| goes_on(*i)).count();
        let more_columns = count(&|i| beyond_column(columns + i)) + count(&|i| beyond_column(-2 - i));
        let more_rows = count(&|i| beyond_row(rows + i)) + count(&|i| beyond_row(-2 - i));
        if more_columns + more_rows > 0 {
            return Err(Flaw::Larger { columns: self.columns + more_columns, rows: self.rows + more_rows });
        }
        Ok(())
    }

    /// From 10 to 90 % across the edges of squares, pixels: median of those along columns, and of those along rows, the
    /// wider of the two (a picture that moved is blurred in one direction).
    pub(super) fn edge_px(&self) -> f64 {
        let middle = |c: usize, r: usize| Point2::new(c as f64 + 0.5, r as f64 + 0.5);
        let aside = self
            .squares()
            .filter(|(c, _)| c + 2 < self.columns)
            .filter_map(|(c, r)| self.width_px(middle(c, r), Vector2::x(), self.at(c + 1, r + 1) - self.at(c + 1, r)));
        let below = self
            .squares()
            .filter(|(_, r)| r + 2 < self.rows)
            .filter_map(|(c, r)| self.width_px(middle(c, r), Vector2::y(), self.at(c + 1, r + 1) - self.at(c, r + 1)));
        median(aside.collect()).max(median(below.collect()))
    }

    /// Width of one edge, at right angles to it: `from` and `step` (to the middle of the next square) in columns and rows.
    fn width_px(&self, from: Point2<f64>, step: Vector2<f64>, edge: Vector2<f64>) -> Option<f64> {
        let at = |i: usize| from + step * (i as f64 / PROFILE as f64);
        let profile: Option<Vec<f64>> = (0..=PROFILE).map(|i| self.grey(at(i).x, at(i).y)).collect();
        let profile = profile?;
        let (first, last) = (*profile.first()?, *profile.last()?);
        let crossing = |share: f64| {
            let level = |g: f64| (g - first) / (last - first) - share;
            let i = profile.iter().position(|g| level(*g) >= 0.0)?.checked_sub(1)?;
            let (a, b) = (level(*profile.get(i)?), level(*profile.get(i + 1)?));
            Some((i as f64 - a / (b - a)) / PROFILE as f64)
        };
        let cell = |p: Point2<f64>| ((p.x as usize).min(self.columns - 1), (p.y as usize).min(self.rows - 1));
        let ((c, r), (next_c, next_r)) = (cell(from), cell(from + step));
        let middle = |c: usize, r: usize| self.at(c, r).coords.lerp(&self.at(c + 1, r + 1).coords, 0.5);
        let way = middle(next_c, next_r) - middle(c, r);
        Some((crossing(0.9)? - crossing(0.1)?) * way.perp(&edge).abs() / edge.norm())
    }

    /// Columns and rows to pixels, by least squares of the linear equations in normalised coordinates.
    fn homography(&self) -> Option<Matrix3<f64>> {
        let n = self.corners.len() as f64;
        let normal = |mean: Vector2<f64>, spread: f64| {
            Matrix3::new(1.0 / spread, 0.0, -mean.x / spread, 0.0, 1.0 / spread, -mean.y / spread, 0.0, 0.0, 1.0)
        };
        let mean = self.corners.iter().map(|c| c.coords).sum::<Vector2<f64>>() / n;
        let spread = (self.corners.iter().map(|c| (c.coords - mean).norm_squared()).sum::<f64>() / n).sqrt();
        let from_picture = normal(mean, spread);
        let from_board = normal(
            Vector2::new((self.columns - 1) as f64 / 2.0, (self.rows - 1) as f64 / 2.0),
            self.columns.max(self.rows) as f64 / 2.0,
        );
        let mut equations = DMatrix::zeros(2 * self.corners.len(), 9);
        for (i, corner) in self.corners.iter().enumerate() {
            let b = from_board * Vector3::new((i % self.columns) as f64, (i / self.columns) as f64, 1.0);
            let p = from_picture * corner.to_homogeneous();
            for k in 0..3 {
                equations[(2 * i, k)] = b[k];
                equations[(2 * i, 6 + k)] = -p.x * b[k];
                equations[(2 * i + 1, 3 + k)] = b[k];
                equations[(2 * i + 1, 6 + k)] = -p.y * b[k];
            }
        }
        // The eigenvector of the least eigenvalue of the 9x9 normal equations.
        let eigen = (equations.transpose() * &equations).symmetric_eigen();
        let least = eigen.eigenvectors.column(eigen.eigenvalues.imin());
        let normalised = Matrix3::from_row_iterator(least.iter().copied());
        let homography = from_picture.try_inverse()? * normalised * from_board;
        // Its sign is open: positive where corner 0 is, so that it is negative behind the camera.
        Some(homography * homography[(2, 2)].signum())
    }
}

/// The sign of a square's turn in the chequer.
fn sign(c: usize, r: usize) -> f64 {
    if (c + r).is_multiple_of(2) { 1.0 } else { -1.0 }
}

/// A place in columns and rows to pixels; `None` behind the camera.
fn map(board_in_picture: &Matrix3<f64>, column: f64, row: f64) -> Option<Point2<f64>> {
    let p = board_in_picture * Vector3::new(column, row, 1.0);
    (p.z > 0.0).then(|| Point2::new(p.x / p.z, p.y / p.z))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: f64 = 20.0;

    /// A chequer over the whole picture but for a white rim around 6x5 squares from (40, 40) on, in slight perspective.
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

        // Folded along the middle, as a sheet is: every square still convex.
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
}
