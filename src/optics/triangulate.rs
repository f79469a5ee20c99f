//! A point from its images in two or more views: the one that minimises the reprojection error in all of them, weighted
//! by their covariances, with its own covariance and the remaining χ².
//!
//! Start: the point nearest to all traced rays. Then Gauss-Newton through `OpticalPath::project`, which converges in
//! two or three steps because the start is already accurate to the noise.

use super::OpticalPath;
use nalgebra::{Matrix2, Matrix3, Point2, Point3, Vector3};

/// One image of the point.
#[derive(Debug, Clone, Copy)]
pub struct Sighting<'a> {
    /// The view's optics.
    pub optics: &'a OpticalPath,
    /// Its pixel.
    pub pixel: Point2<f64>,
    /// Covariance of the pixel, px².
    pub covariance_px2: Matrix2<f64>,
}

/// A triangulated point.
#[derive(Debug, Clone, Copy)]
pub struct Triangulated {
    /// Camera frame, metres.
    pub point: Point3<f64>,
    /// Covariance, m², from the covariances of the pixels.
    pub covariance: Matrix3<f64>,
    /// Weighted sum of squared reprojection errors; 2·views − 3 degrees of freedom.
    pub chi2: f64,
    /// Largest distance between the starting point and a ray, metres: how far the rays miss each other.
    pub ray_distance_m: f64,
}

const STEPS: usize = 4;

/// Triangulates; `None` with fewer than two views, a pixel without a ray, parallel rays, or a point that a view cannot
/// see.
pub fn triangulate(sightings: &[Sighting<'_>]) -> Option<Triangulated> {
    if sightings.len() < 2 {
        return None;
    }
    let rays = sightings.iter().map(|s| s.optics.trace(&s.pixel).ok()).collect::<Option<Vec<_>>>()?;
    let mut across_sum = Matrix3::zeros();
    let mut target = Vector3::zeros();
    for ray in &rays {
        let across = Matrix3::identity() - ray.direction * ray.direction.transpose();
        across_sum += across;
        target += across * ray.origin.coords;
    }
    // Parallel rays leave the direction along them undetermined: of two rays this is 1 − cos α, 1e-4 at 0.8°.
    if across_sum.symmetric_eigenvalues().min() < 1e-4 {
        return None;
    }
    let mut point = Point3::from(across_sum.try_inverse()? * target);
    let ray_distance_m = rays.iter().map(|ray| (point - ray.at(ray.nearest(&point))).norm()).fold(0.0, f64::max);
    let information = sightings.iter().map(|s| s.covariance_px2.try_inverse()).collect::<Option<Vec<_>>>()?;
    for _ in 0..STEPS {
        let (normal, pull, _) = equations(sightings, &information, &point)?;
        point += normal.cholesky()?.solve(&pull);
    }
    let (normal, _, chi2) = equations(sightings, &information, &point)?;
    Some(Triangulated { point, covariance: normal.try_inverse()?, chi2, ray_distance_m })
}

fn equations(
    sightings: &[Sighting<'_>],
    information: &[Matrix2<f64>],
    point: &Point3<f64>,
) -> Option<(Matrix3<f64>, Vector3<f64>, f64)> {
    let mut normal = Matrix3::zeros();
    let mut pull = Vector3::zeros();
    let mut chi2 = 0.0;
    for (sighting, weight) in sightings.iter().zip(information) {
        let seen = sighting.optics.project_with_jacobian(point).ok()?;
        let residual = sighting.pixel - seen.pixel;
        normal += seen.d_pixel.transpose() * weight * seen.d_pixel;
        pull += seen.d_pixel.transpose() * weight * residual;
        chi2 += (residual.transpose() * weight * residual)[0];
    }
    Some((normal, pull, chi2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Lens, Mirror, Plane, Surface, Wall};
    use nalgebra::Vector2;

    fn tank() -> [OpticalPath; 2] {
        let lens = Lens {
            focal_px: Vector2::new(2700.0, 2700.0),
            principal_point_px: Point2::new(640.0, 512.0),
            distortion: [-0.1, 0.1, 0.0, 0.0, 0.0],
            denominator: [0.0; 3],
        };
        let wall = |normal: Vector3<f64>, offset_m| {
            Surface::Wall(Wall {
                outer: Plane::new(normal.normalize(), offset_m).unwrap(),
                thickness_m: 5e-3,
                index_outside: 1.0,
                index_wall: 1.52,
                index_inside: 1.333,
            })
        };
        let mirror =
            Surface::Mirror(Mirror { plane: Plane::new(Vector3::new(-0.7, 0.02, -0.7).normalize(), -1.1).unwrap() });
        [
            OpticalPath { lens, surfaces: vec![wall(Vector3::new(-0.05, 0.04, -1.0), -1.26)] },
            OpticalPath { lens, surfaces: vec![mirror, wall(Vector3::new(1.0, 0.01, -0.05), -0.05)] },
        ]
    }

    fn sightings<'a>(paths: &'a [OpticalPath], point: &Point3<f64>) -> Vec<Sighting<'a>> {
        paths
            .iter()
            .map(|optics| Sighting {
                optics,
                pixel: optics.project(point).unwrap(),
                covariance_px2: Matrix2::identity() * 0.01,
            })
            .collect()
    }

    #[test]
    fn a_projected_point_comes_back_through_water_and_mirror() {
        let paths = tank();
        let point = Point3::new(-0.105, 0.02, 1.39);
        let found = triangulate(&sightings(&paths, &point)).unwrap();
        assert!((found.point - point).norm() < 1e-9);
        assert!(found.chi2 < 1e-9 && found.ray_distance_m < 1e-9);
    }

    #[test]
    fn predicted_covariance_equals_the_spread_under_noise() {
        let paths = tank();
        let point = Point3::new(-0.105, 0.02, 1.39);
        let exact = sightings(&paths, &point);
        let predicted = triangulate(&exact).unwrap().covariance;
        let mut sum = Matrix3::zeros();
        let mut chi2 = 0.0;
        // Deterministic noise of unit variance: all corners of a cube in the four pixel coordinates.
        for corner in 0..16 {
            let sign = |bit: usize| if corner >> bit & 1 == 1 { 0.1 } else { -0.1 };
            let mut noisy = exact.clone();
            noisy[0].pixel += Vector2::new(sign(0), sign(1));
            noisy[1].pixel += Vector2::new(sign(2), sign(3));
            let found = triangulate(&noisy).unwrap();
            let error = found.point - point;
            sum += error * error.transpose() / 16.0;
            chi2 += found.chi2 / 16.0;
        }
        assert!((sum - predicted).norm() < 0.01 * predicted.norm(), "{sum} against {predicted}");
        assert!((chi2 - 1.0).abs() < 0.01, "four coordinates, three unknowns: mean χ² {chi2}");
    }

    #[test]
    fn one_view_or_parallel_rays_give_nothing() {
        let paths = tank();
        let point = Point3::new(-0.105, 0.02, 1.39);
        let both = sightings(&paths, &point);
        assert!(triangulate(&both[..1]).is_none());
        assert!(triangulate(&[both[0], both[0]]).is_none());
    }

    #[test]
    fn rays_that_pass_each_other_say_by_how_much() {
        let paths = tank();
        let mut apart = sightings(&paths, &Point3::new(-0.105, 0.02, 1.39));
        apart[1].pixel.y += 20.0;
        let found = triangulate(&apart).unwrap();
        assert!(found.ray_distance_m > 2e-3 && found.chi2 > 1000.0);
    }
}
