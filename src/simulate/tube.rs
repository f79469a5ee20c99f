//! What rays see of a tube: where each meets it, and what part of its cell it covers.
//!
//! The picture is divided into cells, [`FINE`] by [`FINE`] a pixel. The centre line is projected for one thing only: to
//! know which cells may see the tube, and near which place of it. For each of them the cell's own ray is intersected
//! with the tube. Its outline, the ends of bands and the end of the tube are covered in proportion where they cross a
//! cell, as lines that are straight there.

use super::centre_line::CentreLine;
use super::rays::Rays;
use crate::optics::{OpticalPath, Ray};
use nalgebra::{Point2, Point3, Vector2, Vector3};

/// Cells along a pixel.
pub(super) const FINE: usize = 3;

/// Knots of the projected centre line are this far apart, metres.
const SPACING_M: f64 = 2e-3;

/// Newton's steps to the place of the centre line nearest to a ray.
const STEPS: usize = 3;

/// Directions along the line of sight for which the tube's axis counts as across it, at least.
const MIN_SINE: f64 = 0.02;

/// A place of the tube's surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    /// Distance along the tube, metres; the cell sees half of `arc_width_m` to either side.
    pub(super) arc_m: f64,
    pub(super) arc_width_m: f64,
    /// Outwards, length 1.
    pub(super) normal: Vector3<f64>,
    /// Direction of travel of the ray.
    pub(super) sight: Vector3<f64>,
    /// Whether it is the face of the end.
    pub(super) is_end: bool,
}

/// What a cell sees.
#[derive(Debug, Clone)]
pub(super) struct Cell {
    /// Column and row among the cells of the picture.
    pub(super) at: [i32; 2],
    /// Light, times the part that is covered.
    pub(super) light: [f32; 3],
    /// Part that is covered.
    pub(super) cover: f32,
    /// Distance along the ray, metres.
    depth_m: f64,
}

/// A round tube.
#[derive(Debug, Clone, Copy)]
pub(super) struct Solid {
    pub(super) radius_m: f64,
    /// From where to where it goes along its centre line, metres.
    pub(super) from_m: f64,
    pub(super) to_m: f64,
    /// Length over which its end is rounded, as half an ellipsoid, metres; 0 where it is cut straight.
    pub(super) rounding_m: f64,
}

/// A knot of the projected centre line.
struct Knot {
    arc_m: f64,
    pixel: Point2<f64>,
    /// Direction along the axis in the picture.
    along: Vector2<f64>,
    /// Half width in pixels, and pixels per metre along the axis.
    half_px: f64,
    along_px_m: f64,
}

/// Where the middle of a cell is, pixels.
fn pixel_of(cell: i32) -> f64 {
    (f64::from(cell) + 0.5) / FINE as f64 - 0.5
}

/// The cell that a place in the picture is in.
fn cell_of(pixel: f64) -> i32 {
    ((pixel + 0.5) * FINE as f64).floor() as i32
}

impl Solid {
    /// All cells that see something of the tube along `line`; `light` is what a place of it sends.
    pub(super) fn cells(
        &self,
        line: &CentreLine,
        path: &OpticalPath,
        rays: &Rays,
        light: impl Fn(&Place) -> [f32; 3],
    ) -> Vec<Cell> {
        let knots = self.knots(line, path);
        let mut cells: Vec<Cell> = Vec::new();
        let mut known = Known::around(&knots, rays);
        let mut runs = knots.iter().map(Option::as_ref).collect::<Vec<_>>();
        runs.push(None);
        for (k, pair) in runs.windows(2).enumerate() {
            let [Some(a), Some(b)] = pair else { continue };
            let before = k.checked_sub(1).and_then(|k| knots.get(k)).and_then(Option::as_ref);
            let behind = knots.get(k + 2).and_then(Option::as_ref);
            self.stretch(rays, (before, a, b, behind), |at, start_m, scale| {
                let ray = rays.at(pixel_of(at[0]), pixel_of(at[1]))?;
                let (cover, colour, depth_m) = self.seen(line, &ray, start_m, scale, &light)?;
                let cell = Cell { at, light: colour, cover, depth_m };
                let place = known.place(at)?;
                match place.checked_sub(1).and_then(|i| cells.get_mut(i as usize)) {
                    // The tube is seen twice, one part before the other.
                    Some(other) => other.with(&cell),
                    None => {
                        cells.push(cell);
                        *place = u32::try_from(cells.len()).ok()?;
                    }
                }
                Some(())
            });
        }
        cells
    }

    fn knots(&self, line: &CentreLine, path: &OpticalPath) -> Vec<Option<Knot>> {
        let steps = ((self.to_m - self.from_m) / SPACING_M).ceil().max(1.0);
        let mut beside = None;
        (0..=steps as usize)
            .map(|k| {
                let arc_m = self.from_m + (self.to_m - self.from_m) * k as f64 / steps;
                let (place, direction) = line.at(arc_m);
                let seen = match &beside {
                    Some(beside) => path.project_beside(&place, beside),
                    None => path.project_with_jacobian(&place),
                };
                let seen = seen.ok()?;
                beside = Some(seen);
                let along: Vector2<f64> = seen.d_pixel * direction;
                let side = direction.cross(&seen.ray.direction).try_normalize(1e-9)?;
                let along_px_m = along.norm();
                let unit = along.try_normalize(1e-9)?;
                let half_px = (seen.d_pixel * side * self.radius_m).norm();
                Some(Knot { arc_m, pixel: seen.pixel, along: unit, half_px, along_px_m })
            })
            .collect()
    }

    /// Calls `visit` with each cell near the axis from `a` to `b`, a place on the tube near by, and the scales there:
    /// half width and pixels per metre along the axis.
    fn stretch(
        &self,
        rays: &Rays,
        (before, a, b, behind): (Option<&Knot>, &Knot, &Knot, Option<&Knot>),
        mut visit: impl FnMut([i32; 2], f64, (f64, f64)) -> Option<()>,
    ) {
        let way = b.pixel - a.pixel;
        let length = way.norm();
        if !(length > 1e-6 && length < 1e5) {
            return;
        }
        let margin = 2.0 / FINE as f64;
        let reach = a.half_px.max(b.half_px) + margin;
        // At either end of the tube more of it may be seen than its axis goes: its end is a disc.
        let (early, late) = (if before.is_none() { reach } else { 0.0 }, if behind.is_none() { reach } else { 0.0 });
        let corners = [a.pixel - a.along * early, b.pixel + b.along * late];
        let bound = |of: fn(&Point2<f64>) -> f64, (least, most): (f64, f64)| {
            let (low, high) = corners.iter().map(of).fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
            cell_of((low - reach).max(least))..=cell_of((high + reach).min(most))
        };
        let [wide, high] = rays.bounds();
        for row in bound(|p| p.y, high) {
            for column in bound(|p| p.x, wide) {
                let pixel = Point2::new(pixel_of(column), pixel_of(row));
                let (from_a, from_b) = (pixel - a.pixel, pixel - b.pixel);
                // Each cell belongs to one stretch: from the line across the axis at `a` to that at `b`.
                if from_a.dot(&a.along) < -early || from_b.dot(&b.along) >= late {
                    continue;
                }
                if before.is_some() && from_a.dot(&a.along) < 0.0 {
                    continue;
                }
                let aside = (way.x * from_a.y - way.y * from_a.x) / length;
                if aside.abs() > reach {
                    continue;
                }
                let part = from_a.dot(&way) / (length * length);
                let mix = |a: f64, b: f64| a + (b - a) * part.clamp(0.0, 1.0);
                let start_m = a.arc_m + (b.arc_m - a.arc_m) * part;
                visit([column, row], start_m, (mix(a.half_px, b.half_px), mix(a.along_px_m, b.along_px_m)));
            }
        }
    }

    /// What a ray sees of the tube, from a place near by: part of the cell covered, light times that, distance.
    fn seen(
        &self,
        line: &CentreLine,
        ray: &Ray,
        start_m: f64,
        (half_px, along_px_m): (f64, f64),
        light: &impl Fn(&Place) -> [f32; 3],
    ) -> Option<(f32, [f32; 3], f64)> {
        let d = ray.direction;
        let radius_m = self.radius_m;
        // 1. the place of the centre line that the ray passes nearest
        let mut arc_m = start_m;
        for _ in 0..STEPS {
            let (place, along) = line.at(arc_m);
            let off = place - ray.origin;
            let (off, across) = (off - d * off.dot(&d), along - d * along.dot(&d));
            arc_m -= (off.dot(&across) / across.norm_squared().max(MIN_SINE * MIN_SINE)).clamp(-radius_m, radius_m);
        }
        let (place, along) = line.at(arc_m);
        let off = place - ray.origin;
        let towards = off.dot(&d);
        let aside = d * towards - off;
        let distance_m = aside.norm();
        let cell_m = radius_m / (half_px * FINE as f64);
        let outline = 0.5 + (radius_m - distance_m) / cell_m;
        if outline <= 0.0 {
            return None;
        }
        let cover = outline.min(1.0);
        // 2. where it meets the surface, or as near as it comes to it
        let cosine = d.dot(&along);
        let sine = (1.0 - cosine * cosine).sqrt().max(MIN_SINE);
        let mut depth_m = towards - (radius_m * radius_m - distance_m * distance_m).max(0.0).sqrt() / sine;
        let mut met_m = arc_m + (depth_m - towards) * cosine;
        let mut normal = ray.at(depth_m) - line.at(met_m).0;
        // The tube is bent: once more, from its axis there.
        let slope = normal.dot(&d);
        if slope < -0.3 * radius_m {
            depth_m -= (normal.norm_squared() - radius_m * radius_m) / (2.0 * slope);
            let (axis, along) = line.at(met_m);
            met_m += (ray.at(depth_m) - axis).dot(&along);
            normal = ray.at(depth_m) - line.at(met_m).0;
        }
        let arc_width_m = (1.0 / (along_px_m * FINE as f64)).min(radius_m);
        let on_side = |arc_m: f64, normal: Vector3<f64>, is_end: bool| {
            let normal = normal.try_normalize(1e-12).unwrap_or(-d);
            light(&Place { arc_m, arc_width_m, normal, sight: d, is_end })
        };
        let side = on_side(met_m.clamp(self.from_m, self.to_m), normal, false);
        // 3. the ends: beyond the one towards the tip its face may be seen
        let body_m = self.to_m - self.rounding_m;
        let within = (0.5 + (body_m - met_m) / arc_width_m).clamp(0.0, 1.0);
        let began = (0.5 + (met_m - self.from_m) / arc_width_m).clamp(0.0, 1.0);
        let (end, facing) = line.at(body_m);
        let (mut face, mut face_light) = (0.0, [0.0; 3]);
        if within < 1.0 && self.rounding_m > 0.0 {
            let nose = self.nose(&end, &facing, ray);
            face = (0.5 + nose.inside_m / cell_m).clamp(0.0, 1.0) * (1.0 - within);
            face_light = on_side(body_m + nose.along_m, nose.normal, false);
        } else if within < 1.0 && facing.dot(&d) < -MIN_SINE {
            let met = ray.at((end - ray.origin).dot(&facing) / d.dot(&facing));
            let off = met - end;
            // The face is seen obliquely: along the axis' image a cell covers more of it.
            let side = facing.cross(&d).normalize();
            let (across, oblique) = (off.dot(&side), facing.cross(&side).dot(&off) / facing.dot(&d));
            let rim_m = cell_m * across.hypot(oblique) / off.norm().max(1e-9);
            face = (0.5 + (radius_m - off.norm()) / rim_m.max(cell_m)).clamp(0.0, 1.0) * (1.0 - within);
            face_light = on_side(self.to_m, facing, true);
        }
        let side_part = cover * within * began;
        let all = side_part + face;
        if all <= 0.0 {
            return None;
        }
        let light = [0, 1, 2].map(|c| {
            let of = |light: &[f32; 3]| f64::from(light.get(c).copied().unwrap_or_default());
            (of(&side) * side_part + of(&face_light) * face) as f32
        });
        Some((all.min(1.0) as f32, light, depth_m))
    }
}

/// Where a ray meets the rounded end, or comes nearest to it.
struct Nose {
    /// Distance of the ray from its outline, metres, positive inside.
    inside_m: f64,
    /// Distance of the place along the tube from where the rounding begins, metres.
    along_m: f64,
    /// Outwards.
    normal: Vector3<f64>,
}

impl Solid {
    /// The rounded end is half an ellipsoid around `begin`, along `facing`: a sphere where lengths are divided by its
    /// half axes.
    fn nose(&self, begin: &Point3<f64>, facing: &Vector3<f64>, ray: &Ray) -> Nose {
        let (across_m, along_m) = (self.radius_m, self.rounding_m);
        let scaled = |v: Vector3<f64>| {
            let along = facing * v.dot(facing);
            (v - along) / across_m + along / along_m
        };
        let (from, way) = (scaled(ray.origin - begin), scaled(ray.direction));
        let towards = -from.dot(&way) / way.norm_squared();
        let aside = from + way * towards;
        let distance = aside.norm();
        // How fast that distance grows where the ray is moved aside.
        let outwards = scaled(aside / distance.max(1e-12));
        let per_m = (outwards - ray.direction * outwards.dot(&ray.direction)).norm();
        let before = (1.0 - distance * distance).max(0.0).sqrt() / way.norm();
        let met = from + way * (towards - before);
        Nose { inside_m: (1.0 - distance) / per_m.max(1e-12), along_m: met.dot(facing) * along_m, normal: scaled(met) }
    }
}

/// Which cells are there already: one more than the place of each in their list, 0 for none.
struct Known {
    first: [i32; 2],
    size: [usize; 2],
    places: Vec<u32>,
}

impl Known {
    /// Of all that the tube may cover where there are rays.
    fn around(knots: &[Option<Knot>], rays: &Rays) -> Self {
        let [wide, high] = rays.bounds();
        let bound = |of: fn(&Knot) -> f64, (least, most): (f64, f64)| {
            let (low, high) = knots.iter().flatten().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), knot| {
                // Twice: the end may reach beyond its middle, and aside.
                let reach = 2.0 * knot.half_px + 2.0;
                (low.min(of(knot) - reach), high.max(of(knot) + reach))
            });
            let (low, high) = (low.max(least), high.min(most));
            if low < high { (cell_of(low), cell_of(high) + 1) } else { (0, 0) }
        };
        let (x, y) = (bound(|knot| knot.pixel.x, wide), bound(|knot| knot.pixel.y, high));
        let size = [x, y].map(|(low, high)| (high - low) as usize);
        Self { first: [x.0, y.0], size, places: vec![0; size[0] * size[1]] }
    }

    fn place(&mut self, at: [i32; 2]) -> Option<&mut u32> {
        let column = usize::try_from(at[0] - self.first[0]).ok().filter(|column| *column < self.size[0])?;
        let row = usize::try_from(at[1] - self.first[1]).ok()?;
        self.places.get_mut(row * self.size[0] + column)
    }
}

impl Cell {
    /// Lays another part of the tube over this one, or under it.
    fn with(&mut self, other: &Self) {
        let (front, back) =
            if other.depth_m < self.depth_m { (other.clone(), self.clone()) } else { (self.clone(), other.clone()) };
        let left = 1.0 - front.cover;
        let mut light = front.light;
        light.iter_mut().zip(back.light).for_each(|(light, back)| *light += left * back);
        *self = Self { at: self.at, light, cover: front.cover + left * back.cover, depth_m: front.depth_m };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::Rig;
    use std::path::Path;

    /// The tube's outline by sampling: cells are divided once more, each part's ray is inside or not.
    #[test]
    fn what_cells_cover_is_what_rays_within_them_meet() {
        let rig = Rig::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/dev_tank/rig.toml")).unwrap();
        let view = &rig.views[0];
        let rays = Rays::of(view, rig.camera.size_px);
        let direction = Vector3::new(0.3, 0.9, -0.4).normalize();
        let begin = Point3::new(-0.11, -0.02, 1.4);
        let knots: Vec<_> =
            (0..=5).map(|k| (f64::from(k) * 4e-3, begin + direction * (f64::from(k) * 4e-3), direction)).collect();
        let line = CentreLine::through(&knots).unwrap();
        let solid = Solid { radius_m: 1.6e-3, from_m: 0.0, to_m: 20e-3, rounding_m: 0.0 };
        let cells = solid.cells(&line, &view.optics, &rays, |_| [1.0; 3]);
        let meets = |x: f64, y: f64| {
            let ray = rays.at(x, y).unwrap();
            let (d, off) = (ray.direction, ray.origin - begin);
            let (across, start) = (d - direction * d.dot(&direction), off - direction * off.dot(&direction));
            let (a, b, c) = (across.norm_squared(), across.dot(&start), start.norm_squared() - solid.radius_m.powi(2));
            let root = b * b - a * c;
            let near = (-b - root.max(0.0).sqrt()) / a;
            let arc_m = (off + d * near).dot(&direction);
            let faces = [0.0, 20e-3].iter().any(|end: &f64| {
                let met = (end - off.dot(&direction)) / d.dot(&direction);
                (off + d * met - direction * *end).norm() < solid.radius_m && d.dot(&direction) * (end - 10e-3) < 0.0
            });
            root > 0.0 && ((0.0..=20e-3).contains(&arc_m) || faces)
        };
        let (mut covered, mut sampled, mut centre, mut exact) = (0.0, 0.0, Vector2::zeros(), Vector2::zeros());
        let lights: f32 = cells.iter().map(|cell| cell.light[0] - cell.cover).sum();
        assert!(lights.abs() < 1e-3, "white light is as much as is covered");
        for cell in &cells {
            let at = Vector2::new(pixel_of(cell.at[0]), pixel_of(cell.at[1]));
            covered += f64::from(cell.cover);
            centre += at * f64::from(cell.cover);
        }
        let (first, last) = (
            cells.iter().fold([i32::MAX; 2], |m, c| [m[0].min(c.at[0]), m[1].min(c.at[1])]),
            cells.iter().fold([i32::MIN; 2], |m, c| [m[0].max(c.at[0]), m[1].max(c.at[1])]),
        );
        for row in first[1] - 2..=last[1] + 2 {
            for column in first[0] - 2..=last[0] + 2 {
                for part in 0..64 {
                    let fine = |k: i32| (f64::from(k) + 0.5) / 8.0 - 0.5;
                    let at = Vector2::new(
                        pixel_of(column) + fine(part % 8) / FINE as f64,
                        pixel_of(row) + fine(part / 8) / FINE as f64,
                    );
                    if meets(at.x, at.y) {
                        sampled += 1.0 / 64.0;
                        exact += at / 64.0;
                    }
                }
            }
        }
        let off = centre / covered - exact / sampled;
        // Its ends are not as straight within a cell as its sides are.
        assert!(off.norm() < 0.03, "its middle is off by {off} px");
        assert!((covered / sampled - 1.0).abs() < 0.01, "{covered} of {sampled} cells");
    }
}
