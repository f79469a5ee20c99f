//! A flat board in a picture, ignoring lens distortion: the homography from points on it to pixels.

use crate::median::upper_median;
use nalgebra::{DMatrix, Matrix2, Matrix3, Point2, Vector2, Vector3};

/// Points with a smaller extent in one direction (RMS, squares) are in a line.
const LINE_TOLERANCE: f64 = 0.1;

/// From points on the board to pixels, by least squares of the linear equations in normalised coordinates. The third
/// coordinate of a mapped point is positive in front of the camera. `None` with fewer than four pairs, or when all are
/// in a line.
pub(super) fn homography(pairs: &[(Point2<f64>, Point2<f64>)]) -> Option<Matrix3<f64>> {
    if pairs.len() < 4 || in_line(pairs.iter().map(|(place, _)| *place)) {
        return None;
    }
    let normal = |points: &dyn Fn(usize) -> Point2<f64>| {
        let (mean, scatter) = scatter((0..pairs.len()).map(points));
        let spread = scatter.trace().sqrt();
        Matrix3::new(1.0 / spread, 0.0, -mean.x / spread, 0.0, 1.0 / spread, -mean.y / spread, 0.0, 0.0, 1.0)
    };
    let (from_board, from_picture) = (normal(&|i| pairs[i].0), normal(&|i| pairs[i].1));
    let mut equations = DMatrix::zeros(2 * pairs.len(), 9);
    for (i, (place, pixel)) in pairs.iter().enumerate() {
        let b = from_board * place.to_homogeneous();
        let p = from_picture * pixel.to_homogeneous();
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
    // Its sign is free: made positive at the centre of the points, so that it is negative behind the camera.
    let (mean, _) = scatter(pairs.iter().map(|(place, _)| *place));
    let sign = (homography * Point2::from(mean).to_homogeneous()).z.signum();
    Some(homography * sign)
}

/// A point in columns and rows to pixels; `None` behind the camera.
pub(super) fn map(board_in_picture: &Matrix3<f64>, column: f64, row: f64) -> Option<Point2<f64>> {
    let p = board_in_picture * Vector3::new(column, row, 1.0);
    (p.z > 0.0).then(|| Point2::new(p.x / p.z, p.y / p.z))
}

/// Whether all points, in squares, are in a line, which determines no pose.
pub(super) fn in_line(places: impl Iterator<Item = Point2<f64>> + Clone) -> bool {
    let (_, scatter) = scatter(places);
    !scatter.symmetric_eigenvalues().iter().all(|square| *square > LINE_TOLERANCE * LINE_TOLERANCE)
}

/// Mean and covariance of points.
fn scatter(points: impl Iterator<Item = Point2<f64>> + Clone) -> (Vector2<f64>, Matrix2<f64>) {
    let count = points.clone().count() as f64;
    let mean = points.clone().map(|p| p.coords).sum::<Vector2<f64>>() / count;
    let off = points.map(|p| p.coords - mean);
    (mean, off.map(|d| d * d.transpose()).sum::<Matrix2<f64>>() / count)
}

/// The upper median; NaN of none, which passes no comparison.
pub(super) fn median_or_nan(values: impl IntoIterator<Item = f64>) -> f64 {
    upper_median(values).unwrap_or(f64::NAN)
}
