//! The least-squares plane of points in space.

use nalgebra::{DMatrix, Point2, Point3, Vector3};

/// A plane with axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Plane {
    /// The mean of the points.
    pub centre: Point3<f64>,
    /// Unit normal.
    pub normal: Vector3<f64>,
    /// Unit axes in the plane; right-handed together with the normal.
    pub axes: [Vector3<f64>; 2],
    /// Root mean square of the points' distances from it, metres.
    pub rms_m: f64,
}

impl Plane {
    /// The plane through the mean of the points with the least sum of squared distances: the singular vector of the
    /// smallest singular value. `None` for fewer than three points, or where they lie on one line.
    pub(crate) fn through(points: &[Point3<f64>]) -> Option<Self> {
        if points.len() < 3 {
            return None;
        }
        let centre = Point3::from(points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64);
        let centred = DMatrix::from_fn(3, points.len(), |row, k| points.get(k).map_or(0.0, |p| (p - centre)[row]));
        let svd = centred.svd(true, false);
        let u = svd.u?;
        let values = &svd.singular_values;
        if !(values[0] > 0.0 && values[1] > 1e-6 * values[0]) {
            return None;
        }
        let first = Vector3::new(u[(0, 0)], u[(1, 0)], u[(2, 0)]);
        let second = Vector3::new(u[(0, 1)], u[(1, 1)], u[(2, 1)]);
        let rms_m = values[2] / (points.len() as f64).sqrt();
        Some(Self { centre, normal: first.cross(&second), axes: [first, second], rms_m })
    }

    /// The same plane with its axes as close as possible to another's, and its normal to the same side.
    pub(crate) fn along(self, other: &Self) -> Self {
        let normal = if self.normal.dot(&other.normal) < 0.0 { -self.normal } else { self.normal };
        let flat = other.axes[0] - normal * normal.dot(&other.axes[0]);
        // Perpendicular planes may have no such axis.
        let Some(first) = flat.try_normalize(1e-9) else { return self };
        Self { normal, axes: [first, normal.cross(&first)], ..self }
    }

    /// A point's coordinates in the plane, from its centre.
    pub(crate) fn flat(&self, point: &Point3<f64>) -> Point2<f64> {
        let from = point - self.centre;
        Point2::new(from.dot(&self.axes[0]), from.dot(&self.axes[1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    #[test]
    fn a_tilted_plane_is_found_with_the_distance_of_its_points() {
        let turn = Rotation3::from_euler_angles(0.3, 0.8, -0.5);
        let points: Vec<Point3<f64>> = (0..100)
            .map(|k| {
                let t = f64::from(k) * 0.1 * std::f64::consts::TAU;
                let off = if k % 2 == 0 { 1e-4 } else { -1e-4 };
                turn * Point3::new(0.01 * t.cos(), 0.006 * t.sin(), off) + Vector3::new(0.1, 0.2, 0.3)
            })
            .collect();
        let plane = Plane::through(&points).unwrap();
        assert!((plane.normal.dot(&(turn * Vector3::z())).abs() - 1.0).abs() < 1e-6);
        assert!((plane.rms_m - 1e-4).abs() < 1e-7);
        assert!((plane.axes[0].cross(&plane.axes[1]) - plane.normal).norm() < 1e-12);
        assert!((plane.flat(&(plane.centre + plane.axes[1] * 0.002)) - Point2::new(0.0, 0.002)).norm() < 1e-15);
    }

    #[test]
    fn lines_and_single_points_have_no_plane() {
        let line: Vec<_> = (0..9).map(|k| Point3::new(f64::from(k), 1.0, 2.0 * f64::from(k))).collect();
        assert_eq!(Plane::through(&line), None);
        assert_eq!(Plane::through(&[Point3::origin(); 5]), None);
        assert_eq!(Plane::through(&line[..2]), None);
    }

    #[test]
    fn axes_follow_those_of_another_plane() {
        let of = |turn: Rotation3<f64>| {
            let points = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -0.9)].map(|(x, y)| turn * Point3::new(x, y, 0.0));
            Plane::through(&points).unwrap()
        };
        let (flat, tilted) = (of(Rotation3::identity()), of(Rotation3::from_euler_angles(0.2, 0.1, 2.5)));
        let along = tilted.along(&flat);
        assert!(along.axes[0].dot(&flat.axes[0]) > 0.95 && along.axes[1].dot(&flat.axes[1]) > 0.95);
        assert!(along.normal.dot(&flat.normal) > 0.9 && (along.axes[0].dot(&along.normal)).abs() < 1e-12);
    }
}
