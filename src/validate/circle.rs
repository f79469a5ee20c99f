//! The circle nearest to points in a plane.
//!
//! Start: Kåsa's, linear least squares in x² + y² + a x + b y + c (IEEE Trans. Instrum. Meas. 25, 1976,
//! doi:10.1109/TIM.1976.6312298), which is biased towards smaller circles where only an arc is seen. Then Gauss-Newton
//! on the distances of the points from the circle.

use nalgebra::{Matrix3, Point2, Vector2, Vector3};

/// Most steps of the refinement; a handful is usual.
const MAX_STEPS: usize = 100;

/// A circle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Circle {
    /// Its centre.
    pub centre: Point2<f64>,
    /// Its radius, metres.
    pub radius_m: f64,
    /// Root mean square of the points' distances from it, metres.
    pub rms_m: f64,
}

impl Circle {
    /// The circle with the least sum of squared distances of the points from it. `None` for fewer than three points,
    /// points on a line, or if the refinement does not converge.
    pub(crate) fn through(points: &[Point2<f64>]) -> Option<Self> {
        if points.len() < 3 {
            return None;
        }
        // Around their mean and in units of their size, so that the equations are well scaled.
        let count = points.len() as f64;
        let mean = Point2::from(points.iter().map(|p| p.coords).sum::<Vector2<f64>>() / count);
        let scale = (points.iter().map(|p| (p - mean).norm_squared()).sum::<f64>() / count).sqrt();
        if !(scale > 0.0 && scale.is_finite()) {
            return None;
        }
        let scaled: Vec<Vector2<f64>> = points.iter().map(|p| (p - mean) / scale).collect();
        let mut circle = kasa(&scaled)?;
        for _ in 0..MAX_STEPS {
            let step = gauss_newton(&scaled, &circle)?;
            circle += step;
            if step.norm() < 1e-13 * circle.z.abs().max(1.0) {
                break;
            }
        }
        // A line is a circle of infinite radius.
        if !(circle.iter().all(|value| value.is_finite()) && circle.z > 0.0 && circle.z < 1e4) {
            return None;
        }
        let sum: f64 = scaled.iter().map(|p| ((p - circle.xy()).norm() - circle.z).powi(2)).sum();
        Some(Self {
            centre: mean + circle.xy() * scale,
            radius_m: circle.z * scale,
            rms_m: (sum / count).sqrt() * scale,
        })
    }
}

/// Centre and radius by Kåsa's equations.
fn kasa(points: &[Vector2<f64>]) -> Option<Vector3<f64>> {
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for p in points {
        let row = Vector3::new(p.x, p.y, 1.0);
        normal += row * row.transpose();
        right -= row * p.norm_squared();
    }
    // The smallest singular value reveals points on a line.
    let svd = normal.svd(true, true);
    if svd.singular_values.z < 1e-12 * svd.singular_values.x {
        return None;
    }
    let [a, b, c] = svd.solve(&right, 0.0).ok()?.into();
    let centre = Vector2::new(-a / 2.0, -b / 2.0);
    let squared = centre.norm_squared() - c;
    (squared > 0.0).then(|| Vector3::new(centre.x, centre.y, squared.sqrt()))
}

/// One step for centre and radius.
fn gauss_newton(points: &[Vector2<f64>], circle: &Vector3<f64>) -> Option<Vector3<f64>> {
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for p in points {
        let from = p - circle.xy();
        let distance = from.norm();
        let Some(out) = from.try_normalize(1e-12) else { continue };
        let row = Vector3::new(-out.x, -out.y, -1.0);
        normal += row * row.transpose();
        right -= row * (distance - circle.z);
    }
    normal.cholesky().map(|cholesky| cholesky.solve(&right))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn on(k: usize, of: f64, radius: f64) -> Point2<f64> {
        let t = TAU * k as f64 / of;
        Point2::new(0.3 + radius * t.cos(), -0.2 + radius * t.sin())
    }

    #[test]
    fn a_circle_and_an_arc_are_found_exactly() {
        for points in
            [(0..50).map(|k| on(k, 50.0, 0.012)).collect::<Vec<_>>(), (0..20).map(|k| on(k, 200.0, 0.012)).collect()]
        {
            let circle = Circle::through(&points).unwrap();
            assert!((circle.radius_m - 0.012).abs() < 1e-12 && circle.rms_m < 1e-12, "{circle:?}");
            assert!((circle.centre - Point2::new(0.3, -0.2)).norm() < 1e-12);
        }
    }

    #[test]
    fn the_geometric_fit_is_not_drawn_in_by_noise_on_an_arc() {
        let mut random = fastrand::Rng::with_seed(4);
        let (mut kasas, mut geometric) = (0.0, 0.0);
        for _ in 0..200 {
            let noisy: Vec<Point2<f64>> = (0..60)
                .map(|k| on(k, 240.0, 1.0) + Vector2::new(random.f64() - 0.5, random.f64() - 0.5) * 0.1)
                .collect();
            let mean = Point2::from(noisy.iter().map(|p| p.coords).sum::<Vector2<f64>>() / 60.0);
            let around: Vec<Vector2<f64>> = noisy.iter().map(|p| p - mean).collect();
            kasas += kasa(&around).unwrap().z / 200.0;
            geometric += Circle::through(&noisy).unwrap().radius_m / 200.0;
        }
        assert!(kasas < 0.985 && (geometric - 1.0).abs() < 0.01, "{kasas} {geometric}");
    }

    #[test]
    fn a_line_and_a_heap_are_no_circles() {
        let line: Vec<_> = (0..9).map(|k| Point2::new(f64::from(k), 2.0 * f64::from(k))).collect();
        assert_eq!(Circle::through(&line), None);
        assert_eq!(Circle::through(&[Point2::new(1.0, 1.0); 7]), None);
        assert_eq!(Circle::through(&line[..2]), None);
    }
}
