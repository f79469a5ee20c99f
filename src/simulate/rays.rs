//! The rays that a view's pixels see along, computed once: between the nodes of a grid they are as good as linear.

use crate::optics::Ray;
use crate::rig::View;
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;

/// Distance of the nodes, pixels. Of a lens of 2700 px, 1.5 m away, what is between them is off by less than a
/// micrometre.
const SPACING_PX: f64 = 4.0;

/// Rays of a part of a picture.
#[derive(Debug, Clone)]
pub(super) struct Rays {
    first_px: Point2<f64>,
    columns: usize,
    rows: usize,
    nodes: Vec<Option<Ray>>,
}

impl Rays {
    /// Of a view, in a picture of this size.
    pub(super) fn of(view: &View, size_px: [u32; 2]) -> Self {
        let [width, height] = size_px.map(f64::from);
        let bound = |of: fn(&Point2<f64>) -> f64, most: f64| {
            if view.region_px.is_empty() {
                return (-SPACING_PX, most + SPACING_PX);
            }
            let low = view.region_px.iter().map(of).fold(f64::INFINITY, f64::min);
            let high = view.region_px.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
            (low.max(0.0) - SPACING_PX, high.min(most) + SPACING_PX)
        };
        let (x, y) = (bound(|p| p.x, width), bound(|p| p.y, height));
        let count = |(low, high): (f64, f64)| ((high - low) / SPACING_PX).ceil().max(1.0) as usize + 1;
        let (columns, rows) = (count(x), count(y));
        let node = |i: usize| {
            let at = Point2::new((i % columns) as f64, (i / columns) as f64) * SPACING_PX;
            view.optics.trace(&(at + nalgebra::Vector2::new(x.0, y.0))).ok()
        };
        let nodes = (0..columns * rows).into_par_iter().map(node).collect();
        Self { first_px: Point2::new(x.0, y.0), columns, rows, nodes }
    }

    /// From where to where it goes, x and y, pixels.
    pub(super) fn bounds(&self) -> [(f64, f64); 2] {
        let end = |first: f64, count: usize| (first, first + (count - 1) as f64 * SPACING_PX);
        [end(self.first_px.x, self.columns), end(self.first_px.y, self.rows)]
    }

    /// The ray of a place in the picture; `None` where none arrives, or beside the view.
    pub(super) fn at(&self, x: f64, y: f64) -> Option<Ray> {
        let (x, y) = ((x - self.first_px.x) / SPACING_PX, (y - self.first_px.y) / SPACING_PX);
        if !(x >= 0.0 && y >= 0.0) {
            return None;
        }
        let (i, j) = (x as usize, y as usize);
        if i + 1 >= self.columns || j + 1 >= self.rows {
            return None;
        }
        let node = |i: usize, j: usize| self.nodes.get(j * self.columns + i).copied().flatten();
        let (a, b, c, d) = (node(i, j)?, node(i + 1, j)?, node(i, j + 1)?, node(i + 1, j + 1)?);
        let (f, g) = (x - i as f64, y - j as f64);
        let mix = |a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>, d: Vector3<f64>| {
            (a * (1.0 - f) + b * f) * (1.0 - g) + (c * (1.0 - f) + d * f) * g
        };
        let of = |r: &Ray| r.origin.coords;
        Some(Ray {
            origin: Point3::from(mix(of(&a), of(&b), of(&c), of(&d))),
            direction: mix(a.direction, b.direction, c.direction, d.direction).normalize(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::Rig;
    use std::path::Path;

    #[test]
    fn between_the_nodes_rays_are_those_of_the_path_to_a_tenth_of_a_micrometre() {
        let rig = Rig::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/dev_tank/rig.toml")).unwrap();
        for view in &rig.views {
            let rays = Rays::of(view, rig.camera.size_px);
            let corner = view.region_px[0];
            for k in 0..200 {
                let pixel = corner + nalgebra::Vector2::new(0.37, 0.61) * f64::from(k);
                let (near, exact) = (rays.at(pixel.x, pixel.y).unwrap(), view.optics.trace(&pixel).unwrap());
                let off = near.at(0.4) - exact.at(0.4);
                assert!(off.norm() < 1e-7, "{pixel}: {off}");
            }
        }
    }
}
