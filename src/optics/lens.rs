//! Pinhole and Brown-Conrady distortion with OpenCV's five parameters, or its rational model with eight.
//!
//! x = X/Z, y = Y/Z; r² = x² + y²; radial factor c = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶); x_d = x
//! c + 2 p1 x y + p2 (r² + 2 x²), y_d = y c + p1 (r² + 2 y²) + 2 p2 x y; u = fx x_d + cx, v = fy y_d + cy. Source:
//! Brown, "Close-range camera calibration" (1971); parameter order k1, k2, p1, p2, k3, k4, k5, k6 of OpenCV's calib3d
//! (Claus and Fitzgibbon, CVPR 2005, doi:10.1109/CVPR.2005.43, for rational functions of lenses).

use nalgebra::{Matrix2, Point2, Vector2};

/// Intrinsics of the one camera; the same for all views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Focal length along x and y, pixels.
    pub focal_px: Vector2<f64>,
    /// Principal point, pixels (pixel centres at integers).
    pub principal_point_px: Point2<f64>,
    /// k1, k2, p1, p2, k3 (dimensionless, OpenCV's order).
    pub distortion: [f64; 5],
    /// k4, k5, k6 of the radial factor's denominator: zeros for the five-parameter model.
    pub denominator: [f64; 3],
}

/// Why intrinsics are not usable.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LensError {
    /// A focal length that is not a positive number.
    #[error("focal length is {0} px, expected a positive number")]
    Focal(f64),
    /// A parameter that is not a finite number.
    #[error("{name} is {value}, expected a finite number")]
    NotFinite {
        /// Which parameter.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

/// Newton steps after which undistortion is given up; five suffice within a usable field of view.
const MAX_STEPS: usize = 30;

/// Most halvings of a step to stay in the field; after that the pixel lies outside it.
const MAX_HALVINGS: i32 = 20;

/// A Newton step (normalised coordinates) so small that the next would be below rounding.
const LAST_STEP: f64 = 1e-9;

impl Lens {
    /// Checks that the numbers can describe a lens.
    ///
    /// # Errors
    /// [`LensError`] with the offending value.
    pub fn validate(&self) -> Result<(), LensError> {
        for f in self.focal_px.iter().copied() {
            if !(f.is_finite() && f > 0.0) {
                return Err(LensError::Focal(f));
            }
        }
        let named = [
            ("principal point x", self.principal_point_px.x),
            ("principal point y", self.principal_point_px.y),
            ("distortion k1", self.distortion[0]),
            ("distortion k2", self.distortion[1]),
            ("distortion p1", self.distortion[2]),
            ("distortion p2", self.distortion[3]),
            ("distortion k3", self.distortion[4]),
            ("distortion k4", self.denominator[0]),
            ("distortion k5", self.denominator[1]),
            ("distortion k6", self.denominator[2]),
        ];
        match named.into_iter().find(|(_, value)| !value.is_finite()) {
            Some((name, value)) => Err(LensError::NotFinite { name, value }),
            None => Ok(()),
        }
    }

    /// Whether it has eight parameters, not five.
    pub fn is_rational(&self) -> bool {
        self.denominator != [0.0; 3]
    }

    /// Its coefficients in OpenCV's order: five, or eight where it is rational.
    pub fn coefficients(&self) -> Vec<f64> {
        let denominator: &[f64] = if self.is_rational() { &self.denominator } else { &[] };
        [&self.distortion, denominator].concat()
    }

    /// What ROS and Foxglove call its model: the same coefficients with other names.
    pub(crate) fn ros_name(&self) -> &'static str {
        if self.is_rational() { "rational_polynomial" } else { "plumb_bob" }
    }

    /// The camera matrix, row-major.
    pub(crate) fn matrix(&self) -> [f64; 9] {
        let (f, c) = (self.focal_px, self.principal_point_px);
        [f.x, 0.0, c.x, 0.0, f.y, c.y, 0.0, 0.0, 1.0]
    }

    /// The projection matrix of a camera by itself: [`Lens::matrix`] with a fourth column of zeros.
    pub(crate) fn projection_matrix(&self) -> [f64; 12] {
        let (f, c) = (self.focal_px, self.principal_point_px);
        [f.x, 0.0, c.x, 0.0, 0.0, f.y, c.y, 0.0, 0.0, 0.0, 1.0, 0.0]
    }

    /// The radial factor's denominator, and its derivative with respect to r².
    pub(crate) fn denominator_at(&self, r2: f64) -> (f64, f64) {
        let [k4, k5, k6] = self.denominator;
        (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)), k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))
    }

    /// Normalised coordinates (X/Z, Y/Z) to a pixel.
    pub fn distort(&self, normalised: &Point2<f64>) -> Point2<f64> {
        self.distort_with_jacobian(normalised).0
    }

    /// As [`Lens::distort`], with d pixel / d normalised.
    pub fn distort_with_jacobian(&self, normalised: &Point2<f64>) -> (Point2<f64>, Matrix2<f64>) {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let (x, y) = (normalised.x, normalised.y);
        let r2 = x * x + y * y;
        let mut radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let mut d_radial = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3); // d radial / d r²
        if self.is_rational() {
            let (below, d_below) = self.denominator_at(r2);
            radial /= below;
            d_radial = (d_radial - radial * d_below) / below;
        }
        let xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        let cross = 2.0 * x * y * d_radial + 2.0 * p1 * x + 2.0 * p2 * y;
        let j = Matrix2::new(
            radial + 2.0 * x * x * d_radial + 2.0 * p1 * y + 6.0 * p2 * x,
            cross,
            cross,
            radial + 2.0 * y * y * d_radial + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        let f = self.focal_px;
        (
            Point2::new(f.x * xd + self.principal_point_px.x, f.y * yd + self.principal_point_px.y),
            Matrix2::from_diagonal(&f) * j,
        )
    }

    /// Pixel to normalised coordinates: the inverse of [`Lens::distort`] by Newton, within the field where it has one.
    ///
    /// `None` for a pixel outside that field, where the distortion polynomial folds over.
    pub fn undistort(&self, pixel: &Point2<f64>) -> Option<Point2<f64>> {
        let f = self.focal_px;
        let c = self.principal_point_px;
        let mut guess = Point2::new((pixel.x - c.x) / f.x, (pixel.y - c.y) / f.y);
        if !guess.coords.iter().all(|v| v.is_finite()) {
            return None;
        }
        if self.distortion == [0.0; 5] && !self.is_rational() {
            return Some(guess);
        }
        if !self.is_one_to_one(&guess) {
            guess = Point2::origin(); // with pincushion distortion a pixel may lie outside the field of directions
        }
        for _ in 0..MAX_STEPS {
            let (at, j) = self.distort_with_jacobian(&guess);
            let step = j.try_inverse()? * (at - pixel);
            // Convergence is quadratic: the error left after a step this small is below rounding.
            let last = step.norm() < LAST_STEP;
            guess = (0..MAX_HALVINGS).map(|k| guess - step * 0.5_f64.powi(k)).find(|p| self.is_one_to_one(p))?;
            if last {
                return Some(guess);
            }
        }
        None
    }

    /// Whether the distortion is one-to-one from the centre out to this normalised point. Further out the model folds
    /// directions back into the picture that no camera sees there.
    ///
    /// The radial part must grow all the way, 1 + 3 k1 s + 5 k2 s² + 7 k3 s³ > 0 for s = 0..r²; the tangential part is
    /// small and checked only at the point itself. Of a rational lens N/D it is N D + 2 s (N' D − N D') that must be
    /// positive, and D.
    pub fn is_one_to_one(&self, normalised: &Point2<f64>) -> bool {
        if self.is_rational() {
            return self.rational_grows(normalised.coords.norm_squared())
                && self.distort_with_jacobian(normalised).1.determinant() > 0.0;
        }
        let [k1, k2, _, _, k3] = self.distortion;
        let growth = |s: f64| 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * 7.0 * k3));
        let r2 = normalised.coords.norm_squared();
        // The minimum is at the end or at a root of 3 k1 + 10 k2 s + 21 k3 s². NaN or infinity: there is no such root.
        let (a, b, c) = (21.0 * k3, 10.0 * k2, 3.0 * k1);
        let q = -0.5 * (b + (b * b - 4.0 * a * c).sqrt().copysign(b));
        let grows = |s: f64| !(s > 0.0 && s < r2) || growth(s) > 0.0;
        growth(r2) > 0.0 && grows(q / a) && grows(c / q) && self.distort_with_jacobian(normalised).1.determinant() > 0.0
    }
}

/// The corners of a picture, pixels.
pub(crate) fn corners(size_px: [u32; 2]) -> [Point2<f64>; 4] {
    let [right, bottom] = size_px.map(|size| f64::from(size) - 1.0);
    [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)].map(|(x, y)| Point2::new(x, y))
}

impl Lens {
    /// The first corner of a picture without a direction: there the distortion folds over inside it.
    pub(crate) fn folded_corner(&self, size_px: [u32; 2]) -> Option<Point2<f64>> {
        corners(size_px).into_iter().find(|corner| self.undistort(corner).is_none())
    }

    /// Whether the radial part of a rational lens grows from the centre out to r².
    fn rational_grows(&self, r2: f64) -> bool {
        let [k1, k2, _, _, k3] = self.distortion;
        let [k4, k5, k6] = self.denominator;
        let (above, below) = ([1.0, k1, k2, k3], [1.0, k4, k5, k6]);
        let mut growth = [0.0; 7];
        for (i, n) in above.iter().enumerate() {
            for (j, d) in below.iter().enumerate() {
                // N D, and 2 s (N' D − N D') of the powers i and j.
                growth[i + j] += n * d * (1.0 + 2.0 * (i as f64 - j as f64));
            }
        }
        is_positive(&below, r2) && is_positive(&growth, r2)
    }
}

/// Most halvings of an interval on which a polynomial is checked.
const MAX_PARTS: usize = 12;

/// Whether c₀ + c₁ s + c₂ s² + … is positive for all s from 0 to `end`. Its Bernstein coefficients enclose it; where
/// they do not decide, the interval is halved. A polynomial too close to zero to decide counts as not positive.
fn is_positive(coefficients: &[f64], end: f64) -> bool {
    let n = coefficients.len() - 1;
    let binomial = |n: usize, k: usize| (0..k).fold(1.0, |product, i| product * (n - i) as f64 / (i + 1) as f64);
    let scaled = |i: usize| coefficients[i] * end.powi(i as i32) / binomial(n, i);
    let bernstein: Vec<f64> = (0..=n).map(|j| (0..=j).map(|i| binomial(j, i) * scaled(i)).sum()).collect();
    encloses_positive(bernstein, MAX_PARTS)
}

fn encloses_positive(mut bernstein: Vec<f64>, parts: usize) -> bool {
    if bernstein.iter().all(|b| *b > 0.0) {
        return true;
    }
    let ends = bernstein.first().is_some_and(|b| *b > 0.0) && bernstein.last().is_some_and(|b| *b > 0.0);
    if !ends || parts == 0 {
        return false;
    }
    // De Casteljau: the left half's coefficients come out one by one, the right half's are left.
    let mut left = Vec::with_capacity(bernstein.len());
    for last in (0..bernstein.len()).rev() {
        left.push(bernstein[0]);
        for i in 0..last {
            bernstein[i] = 0.5 * (bernstein[i] + bernstein[i + 1]);
        }
    }
    encloses_positive(left, parts - 1) && encloses_positive(bernstein, parts - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dev_lens() -> Lens {
        Lens {
            focal_px: Vector2::new(2712.4, 2706.9),
            principal_point_px: Point2::new(643.7, 508.2),
            distortion: [-0.11, 0.14, 0.0006, -0.0004, 0.0],
            denominator: [0.0; 3],
        }
    }

    #[test]
    fn a_point_distorted_by_hand() {
        // x = 0.2, y = -0.1, r² = 0.05: c = 1 - 0.0055 + 0.00035 = 0.99485
        // xd = 0.19897 + 2·0.0006·(-0.02) - 0.0004·(0.05 + 0.08) = 0.198894
        // yd = -0.099485 + 0.0006·(0.05 + 0.02) + 2·(-0.0004)·(-0.02) = -0.099427
        let pixel = dev_lens().distort(&Point2::new(0.2, -0.1));
        assert!((pixel.x - (2712.4 * 0.198894 + 643.7)).abs() < 1e-9);
        assert!((pixel.y - (2706.9 * -0.099427 + 508.2)).abs() < 1e-9);
    }

    /// `undistort` undoes `distort` to 1e-9 px over a picture of 1280 by 1024 pixels.
    fn check_inverse(lens: &Lens) {
        for i in 0..=16 {
            for j in 0..=16 {
                let pixel = Point2::new(f64::from(i) * 80.0, f64::from(j) * 64.0);
                let back = lens.distort(&lens.undistort(&pixel).unwrap());
                assert!((back - pixel).amax() < 1e-9, "{pixel} came back as {back}");
            }
        }
    }

    /// The Jacobian at `p` equals central differences.
    fn check_jacobian(lens: &Lens, p: Point2<f64>) {
        let (_, j) = lens.distort_with_jacobian(&p);
        for k in 0..2 {
            let mut step = Vector2::zeros();
            step[k] = 1e-6;
            let diff = (lens.distort(&(p + step)) - lens.distort(&(p - step))) / 2e-6;
            assert!((j.column(k) - diff).amax() < 1e-5);
        }
    }

    #[test]
    fn undistort_inverts_distort_to_1e_9_px_over_the_picture() {
        check_inverse(&dev_lens());
    }

    #[test]
    fn a_folded_polynomial_has_no_direction() {
        let lens = Lens { distortion: [-0.5, 0.0, 0.0, 0.0, 0.0], ..dev_lens() };
        // x(1 - x²/2) peaks at x = 0.816 with 0.544: no direction maps further out.
        assert!(lens.undistort(&Point2::new(643.7 + 2712.4 * 0.6, 508.2)).is_none());
    }

    #[test]
    fn one_to_one_ends_where_the_radial_part_turns_back() {
        let at = |distortion: [f64; 5], x: f64| Lens { distortion, ..dev_lens() }.is_one_to_one(&Point2::new(x, 0.0));
        // 1 - 0.9 x² > 0 up to x = 1.0541.
        assert!(at([-0.3, 0.0, 0.0, 0.0, 0.0], 1.054) && !at([-0.3, 0.0, 0.0, 0.0, 0.0], 1.055));
        // 1 - 1.5 s + 0.5 s² = (1 - s)(1 - s/2): turns back at s = 1 and forward again at s = 2; x = 2 is beyond both.
        let twice = [-0.5, 0.1, 0.0, 0.0, 0.0];
        assert!(at(twice, 0.999) && !at(twice, 1.2) && !at(twice, 2.0));
        // With k1 = 1/3, k3 = -2/7: 1 + s - 2 s³ = 0 at s = 1.
        let third = [1.0 / 3.0, 0.0, 0.0, 0.0, -2.0 / 7.0];
        assert!(at(third, 0.9999) && !at(third, 1.0001));
        // (1 - s²)(1 - s/2) = 1 - s/2 - s² + s³/2: turns back at s = 1 and forward again at s = 2.
        let both = [-1.0 / 6.0, -0.2, 0.0, 0.0, 1.0 / 14.0];
        assert!(at(both, 0.999) && !at(both, 1.001) && !at(both, 2.0));
        // No distortion, and the sample's lens: everywhere.
        assert!(at([0.0; 5], 100.0) && dev_lens().is_one_to_one(&Point2::new(0.9, -0.9)));
    }

    #[test]
    fn a_pincushion_s_edge_is_undistorted_though_it_lies_beyond_the_field_of_directions() {
        // x (1 + 0.5 x² - 0.3 x⁴) grows up to x = 1.2072 (1 + 1.5 s - 1.5 s² = 0) and reaches 1.3177 there; the pixel
        // of x = 1.1 lies at 1.1 · 1.16577 = 1.282347, outside the field of directions.
        let lens = Lens { distortion: [0.5, -0.3, 0.0, 0.0, 0.0], ..dev_lens() };
        let pixel = Point2::new(643.7 + 2712.4 * 1.282347, 508.2);
        let back = lens.undistort(&pixel).unwrap();
        assert!((back - Point2::new(1.1, 0.0)).norm() < 1e-5, "{back}");
    }

    #[test]
    fn numbers_that_are_none_have_no_direction() {
        assert_eq!(dev_lens().undistort(&Point2::new(f64::NAN, 0.0)), None);
        assert_eq!(dev_lens().undistort(&Point2::new(0.0, f64::INFINITY)), None);
        let broken = Lens { distortion: [f64::NAN, 0.0, 0.0, 0.0, 0.0], ..dev_lens() };
        assert_eq!(broken.undistort(&Point2::new(10.0, 10.0)), None);
    }

    #[test]
    fn jacobian_equals_differences() {
        check_jacobian(&dev_lens(), Point2::new(0.17, -0.21));
    }

    /// A wide lens as OpenCV's rational model fits them: numerator and denominator nearly cancel.
    fn wide_lens() -> Lens {
        Lens { distortion: [2.3, 0.9, 3e-4, -2e-4, 0.05], denominator: [2.7, 1.6, 0.2], ..dev_lens() }
    }

    #[test]
    fn a_rational_lens_is_opencvs() {
        use opencv::calib3d::project_points_def;
        use opencv::core::{Mat, Point2f, Point3f, Vector};
        let lens = wide_lens();
        let (f, c) = (lens.focal_px, lens.principal_point_px);
        let matrix = Mat::from_slice_2d(&[[f.x, 0.0, c.x], [0.0, f.y, c.y], [0.0, 0.0, 1.0]]).unwrap();
        let coefficients = Mat::from_slice(&lens.coefficients()).unwrap().clone_pointee();
        let none = Mat::from_slice(&[0.0, 0.0, 0.0]).unwrap().clone_pointee();
        let places: Vec<(f32, f32)> =
            (-4..=4).flat_map(|i| (-4..=4).map(move |j| (i as f32 / 8.0, j as f32 / 8.0))).collect();
        let objects: Vector<Point3f> = places.iter().map(|(x, y)| Point3f::new(*x, *y, 1.0)).collect();
        let mut there = Vector::<Point2f>::new();
        project_points_def(&objects, &none, &none, &matrix, &coefficients, &mut there).unwrap();
        for ((x, y), opencv) in places.iter().zip(there) {
            let ours = lens.distort(&Point2::new(f64::from(*x), f64::from(*y)));
            // OpenCV's are single precision.
            let off = (ours - Point2::new(f64::from(opencv.x), f64::from(opencv.y))).amax();
            assert!(off < 2e-4, "{x} {y}: {off}");
        }
    }

    #[test]
    fn a_rational_lens_with_zeros_below_is_the_one_with_five() {
        let (five, p) = (dev_lens(), Point2::new(0.17, -0.21));
        let nearly = Lens { denominator: [1e-300, 0.0, 0.0], ..five };
        assert!(nearly.is_rational() && !five.is_rational());
        assert_eq!(five.distort_with_jacobian(&p), nearly.distort_with_jacobian(&p));
        assert_eq!((five.coefficients().len(), nearly.coefficients().len()), (5, 8));
        for x in [0.5, 0.9, 1.2, 1.5, 2.5] {
            for distortion in
                [[-0.3, 0.0, 0.0, 0.0, 0.0], [-0.5, 0.1, 0.0, 0.0, 0.0], [-1.0 / 6.0, -0.2, 0.0, 0.0, 1.0 / 14.0]]
            {
                let (five, nearly) = (Lens { distortion, ..five }, Lens { distortion, ..nearly });
                let p = Point2::new(x, 0.0);
                assert_eq!(five.is_one_to_one(&p), nearly.is_one_to_one(&p), "{distortion:?} {x}");
            }
        }
    }

    #[test]
    fn a_rational_lens_is_undone_over_a_wide_picture() {
        let lens = Lens { focal_px: Vector2::new(700.0, 702.0), ..wide_lens() };
        check_inverse(&lens);
        check_jacobian(&lens, Point2::new(0.6, -0.5));
        // A pole of the denominator, 1 − 2 s = 0 at r = 0.7071, ends the field.
        let pole = Lens { distortion: [0.0; 5], denominator: [-2.0, 0.0, 0.0], ..lens };
        assert!(pole.is_one_to_one(&Point2::new(0.7, 0.0)) && !pole.is_one_to_one(&Point2::new(0.72, 0.0)));
        // x / (1 + x²) grows to x = 1.
        let barrel = Lens { distortion: [0.0; 5], denominator: [1.0, 0.0, 0.0], ..lens };
        assert!(barrel.is_one_to_one(&Point2::new(0.999, 0.0)) && !barrel.is_one_to_one(&Point2::new(1.001, 0.0)));
    }

    #[test]
    fn nonsense_is_refused_with_its_value() {
        let mut lens = dev_lens();
        lens.focal_px.y = -3.0;
        assert_eq!(lens.validate(), Err(LensError::Focal(-3.0)));
        let mut lens = dev_lens();
        lens.distortion[1] = f64::NAN;
        assert!(lens.validate().unwrap_err().to_string().contains("k2"));
    }
}
