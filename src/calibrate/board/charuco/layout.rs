//! Which marker is in which square, and sets of markers in a picture with that arrangement: images of the board.
//!
//! Places on the board are in squares, the first inner corner at (0, 0): the square in column C and row R, counted from
//! 0 at the upper left, extends from (C − 1, R − 1) to (C, R).

use nalgebra::{Matrix3, Point2};

use crate::calibrate::board::charuco::markers::Marker;
use crate::calibrate::board::flat::{homography, map};

/// Markers within this many columns and rows predict another one.
const NEAR: f64 = 4.0;
/// How many of them are used, the nearest.
const NEAREST: usize = 5;
/// Largest distance of a marker's corners from their prediction, squares. Its number identifies its square; this
/// separates different images of the board.
const MAX_SHIFT: f64 = 0.5;

/// The squares of a board.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    /// Squares per row and per column.
    pub(super) squares: [usize; 2],
    /// Whether the square at the upper left is light.
    pub(super) light_first: bool,
    /// Side of a marker, in squares.
    pub(super) marker: f64,
}

impl Layout {
    /// Column and row of the square of a marker.
    pub(super) fn square(&self, id: usize) -> Option<(usize, usize)> {
        let [columns, rows] = self.squares;
        let first = usize::from(!self.light_first);
        // Two rows together have one marker per column.
        let (pair, rest) = (id / columns, id % columns);
        let upper = (columns - first).div_ceil(2);
        let (row, column) =
            if rest < upper { (2 * pair, 2 * rest + first) } else { (2 * pair + 1, 2 * (rest - upper) + 1 - first) };
        (row < rows).then_some((column, row))
    }

    /// How many markers it has.
    pub(super) fn count(&self) -> usize {
        let [columns, rows] = self.squares;
        (columns * rows + usize::from(self.light_first)) / 2
    }

    pub(super) fn is_light(&self, column: usize, row: usize) -> bool {
        (column + row).is_multiple_of(2) == self.light_first
    }

    /// Width of the margin between square and marker, in squares.
    pub(super) fn plain(&self) -> f64 {
        (1.0 - self.marker) / 2.0
    }

    /// The centre of a marker.
    pub(super) fn middle(&self, id: usize) -> Option<Point2<f64>> {
        let (column, row) = self.square(id)?;
        Some(Point2::new(column as f64 - 0.5, row as f64 - 0.5))
    }

    /// A marker's corners, as [`Marker::corners`].
    pub(super) fn corners(&self, id: usize) -> Option<[Point2<f64>; 4]> {
        let (middle, half) = (self.middle(id)?, self.marker / 2.0);
        let ends = [(-half, -half), (half, -half), (half, half), (-half, half)];
        Some(ends.map(|(x, y)| middle + nalgebra::Vector2::new(x, y)))
    }

    /// Corners on the board and in the picture, for markers that are on it.
    pub(super) fn pairs<'a>(
        &'a self,
        markers: impl IntoIterator<Item = &'a Marker>,
    ) -> Vec<(Point2<f64>, Point2<f64>)> {
        markers
            .into_iter()
            .filter_map(|marker| Some(self.corners(marker.id)?.into_iter().zip(marker.corners)))
            .flatten()
            .collect()
    }

    /// From the board to the picture around a place, by the nearest markers.
    fn around(&self, markers: &[Marker], place: Point2<f64>) -> Option<Matrix3<f64>> {
        let distance = |marker: &Marker| Some((self.middle(marker.id)? - place).amax()).filter(|d| *d <= NEAR);
        let mut near: Vec<_> = markers.iter().filter_map(|marker| Some((distance(marker)?, marker))).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        homography(&self.pairs(near.into_iter().take(NEAREST).map(|(_, marker)| marker)))
    }

    /// Whether a marker is where the others of an image predict it.
    fn fits(&self, image: &[Marker], marker: &Marker) -> bool {
        let off = || {
            let (middle, corners) = (self.middle(marker.id)?, self.corners(marker.id)?);
            let flat = self.around(image, middle)?;
            let there: Option<Vec<_>> = corners.iter().map(|c| map(&flat, c.x, c.y)).collect();
            let there: [Point2<f64>; 4] = there?.try_into().ok()?;
            let square_px = ((there[1] - there[0]).norm() + (there[3] - there[0]).norm()) / 2.0 / self.marker;
            let off = there.iter().zip(&marker.corners).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            Some(off / square_px)
        };
        image.iter().all(|own| own.id != marker.id) && off().is_some_and(|off| off < MAX_SHIFT)
    }

    /// Images of the board, the one with most markers first: sets of the markers read (one quadrilateral may have
    /// several readings) that are all direct or all mirrored and agree on their places on the board, with at least two
    /// each.
    pub(super) fn images(&self, markers: &[Marker]) -> Vec<Vec<Marker>> {
        let mut left: Vec<&Marker> = markers.iter().filter(|marker| marker.id < self.count()).collect();
        left.sort_by(|a, b| a.wrong.cmp(&b.wrong).then(b.side_px().total_cmp(&a.side_px())));
        let mut images = Vec::new();
        let mut seeds = left.clone();
        while let Some(seed) = seeds.first().copied() {
            let image = self.grown(seed, &left);
            seeds.retain(|other| !image.iter().any(|own| own.id == other.id && own.is_at(other)));
            if image.len() > 1 {
                images.push(image);
            }
        }
        images.sort_by_key(|image: &Vec<Marker>| std::cmp::Reverse(image.len()));
        // A quadrilateral belongs to one image only, the larger one.
        let mut own: Vec<Vec<Marker>> = Vec::new();
        for mut image in images {
            image.retain(|marker| !own.iter().flatten().any(|other| other.is_at(marker)));
            if image.len() > 1 {
                own.push(image);
            }
        }
        own
    }

    /// The markers that fit the seed, and those that fit them in turn.
    fn grown(&self, seed: &Marker, markers: &[&Marker]) -> Vec<Marker> {
        let mut image = vec![seed.clone()];
        loop {
            let before = image.len();
            for marker in markers.iter().filter(|marker| marker.mirrored == seed.mirrored) {
                if self.fits(&image, marker) {
                    image.push((*marker).clone());
                }
            }
            if image.len() == before {
                return image;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The squares as in `getObjPoints` of OpenCV's boards.
    #[test]
    fn markers_are_counted_through_the_light_squares() {
        let squares = |squares, light_first| {
            let layout = Layout { squares, light_first, marker: 0.7 };
            let places: Vec<_> = (0..layout.count()).map(|id| layout.square(id).unwrap()).collect();
            assert_eq!(layout.square(layout.count()), None);
            assert!(places.iter().all(|(c, r)| layout.is_light(*c, *r)));
            places
        };
        assert_eq!(squares([5, 6], false)[..6], [(1, 0), (3, 0), (0, 1), (2, 1), (4, 1), (1, 2)]);
        assert_eq!(squares([5, 6], true)[..6], [(0, 0), (2, 0), (4, 0), (1, 1), (3, 1), (0, 2)]);
        assert_eq!(squares([6, 5], false)[..6], [(1, 0), (3, 0), (5, 0), (0, 1), (2, 1), (4, 1)]);
        assert_eq!(squares([6, 6], true)[..6], [(0, 0), (2, 0), (4, 0), (1, 1), (3, 1), (5, 1)]);
        let counts = [([5, 7], false, 17), ([5, 6], false, 15), ([5, 6], true, 15), ([3, 5], true, 8)];
        for (size, light_first, count) in counts {
            assert_eq!(squares(size, light_first).len(), count);
        }
    }
}
