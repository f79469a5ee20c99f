//! The walls of the tank: their initial positions, and their priors.

use super::error::{RigCalibrationError, surface};
use super::initial::Initial;
use super::options::{RigOptions, Tank};
use crate::calibrate::bundle::prior::Prior;
use crate::calibrate::geometry::{Geometry, Parameter};
use crate::optics::{Lens, Mirror, Plane, PlaneError, Surface, Wall};
use nalgebra::{Isometry3, Point3, Translation3, Vector3};

/// During the search, walls are held near their initial positions, metres, and right angles, radians; the final
/// solution is free of this.
const HOLD_SD: (f64, f64) = (0.05, 3e-3);
/// Manufacturing tolerances of a glass box: squareness, radians, and size, metres.
const SQUARE_SD_RAD: f64 = 3e-3;
const SIZE_SD_M: f64 = 1e-3;
/// How often a mirror beside the tank and the wall before it are placed, each by the other.
const PASSES: usize = 3;
/// Refractive index of water at 589 nm from 0 to 50 °C in steps of 10 °C (CRC Handbook of Chemistry and Physics).
const WATER: [f64; 6] = [1.33395, 1.33369, 1.33299, 1.33192, 1.33051, 1.32894];

/// Names of the mirrors and of their views: without a number if there is only one.
pub(super) fn numbered(name: &str, index: usize, count: usize) -> String {
    if count == 1 { name.to_owned() } else { format!("{name}_{}", index + 1) }
}

/// Where a mirror beside the tank is at first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Beside {
    /// Where it seems to be: water makes boards look nearer in it, and so the mirror.
    AsSeen,
    /// Where it is by what water does, approximately, with the side wall before it.
    BehindWater,
}

/// Initial surfaces, views and poses; walls are `margin_m` in front of the nearest corner.
pub(super) fn first_geometry(
    lens: &Lens,
    start: &Initial,
    options: &RigOptions,
    margin_m: f64,
    way: Beside,
) -> Result<(Geometry, Vec<Isometry3<f64>>), RigCalibrationError> {
    let count = start.mirrors.len();
    let mut surfaces: Vec<(String, Surface)> = Vec::new();
    let mut views = vec![("direct".to_owned(), Vec::new())];
    let seen: Vec<_> = start.pictures.iter().map(|p| &p.views).collect();
    let mut poses: Vec<Isometry3<f64>> = seen.iter().filter_map(|views| Some(views.first()?.as_ref()?.pose)).collect();
    let mut front_wall = None;
    if let Some(tank) = &options.tank {
        let middle = poses.iter().map(|p| p.translation.vector).sum::<Vector3<f64>>() / poses.len().max(1) as f64;
        let normal = -middle.normalize();
        let measured = options.distances_m.iter().find(|(name, ..)| name == "front_wall").map(|(_, d, _)| -d);
        let offset_m = measured.unwrap_or_else(|| outermost(start, &poses, &normal) + margin_m);
        let front = tank.wall(Plane::new(normal, offset_m)?);
        for pose in &mut poses {
            let middle = Point3::from(pose.translation.vector);
            *pose = Translation3::from(front.lengthened(&middle, &Point3::origin()) - middle) * *pose;
        }
        surfaces.push(("front_wall".to_owned(), Surface::Wall(front)));
        front_wall = Some(front);
        views[0].1.push(0);
    }
    for (index, (normal, offset_m)) in start.mirrors.iter().enumerate() {
        let mirror = surfaces.len();
        let mut plane = Plane::new(*normal, *offset_m)?;
        let name = |of: &str| numbered(of, index, count);
        let path = match (&options.tank, &front_wall) {
            (Some(tank), Some(front)) if tank.mirrors_inside => {
                let shown = |apparent: &Point3<f64>| front.lengthened(apparent, &Point3::origin());
                plane = plane_between(start, index + 1, front, shown)?;
                surfaces.push((name("mirror"), Surface::Mirror(Mirror { plane })));
                vec![0, mirror]
            }
            (Some(tank), Some(front)) => {
                let mut side = side_wall(start, &poses, &plane, (tank, front), margin_m, way)?;
                for _ in 0..if way == Beside::AsSeen { 0 } else { PASSES } {
                    let (wall, camera) = (side.as_ref().unwrap_or(front), plane.reflect(&Point3::origin()));
                    let reflected = plane;
                    let shown = |apparent: &Point3<f64>| {
                        reflected.reflect(&wall.lengthened(&reflected.reflect(apparent), &camera))
                    };
                    plane = plane_between(start, index + 1, front, shown)?;
                    side = side_wall(start, &poses, &plane, (tank, front), margin_m, way)?;
                }
                surfaces.push((name("mirror"), Surface::Mirror(Mirror { plane })));
                match side {
                    None => vec![mirror, 0],
                    Some(side) => {
                        surfaces.push((name("side_wall"), Surface::Wall(side)));
                        vec![mirror, mirror + 1]
                    }
                }
            }
            _ => {
                surfaces.push((name("mirror"), Surface::Mirror(Mirror { plane })));
                vec![mirror]
            }
        };
        views.push((numbered("mirror", index, count), path));
    }
    Ok((Geometry { lens: *lens, surfaces, views }, poses))
}

/// The wall at the side through which a mirror beside the tank shows the boards; `None` where it shows them through the
/// front wall. It stands between the boards and what the mirror's rays meet of the mirror.
fn side_wall(
    start: &Initial,
    poses: &[Isometry3<f64>],
    plane: &Plane,
    (tank, front): (&Tank, &Wall),
    margin_m: f64,
    way: Beside,
) -> Result<Option<Wall>, PlaneError> {
    let front = front.outer.normal();
    let middle = poses.iter().map(|p| p.translation.vector).sum::<Vector3<f64>>() / poses.len() as f64;
    // Towards the boards, from the mirror image of the camera.
    let camera = plane.reflect(&Point3::origin());
    let inward = (Point3::from(middle) - camera).normalize();
    if -inward.dot(&front) > std::f64::consts::FRAC_1_SQRT_2 {
        return Ok(None);
    }
    let normal = -(inward - front * front.dot(&inward)).normalize();
    let boards_m = outermost(start, poses, &normal);
    let met_m = corners(start, poses).filter_map(|corner| {
        let (from_camera, from_corner) = (plane.signed_distance(&camera), plane.signed_distance(&corner));
        let met = camera + (corner - camera) * (from_camera / (from_camera - from_corner));
        (from_camera * from_corner < 0.0).then(|| met.coords.dot(&normal))
    });
    let room_m = met_m.fold(f64::INFINITY, f64::min) - boards_m;
    let is_known = way == Beside::BehindWater && room_m > 0.0;
    let offset_m = boards_m + if is_known { margin_m.min(room_m / 2.0) } else { margin_m };
    Ok(Some(tank.wall(Plane::new(normal, offset_m)?)))
}

/// The plane halfway between the boards behind the front wall and their reflections, whose places are `shown` by where
/// they appear.
fn plane_between(
    start: &Initial,
    view: usize,
    front: &Wall,
    shown: impl Fn(&Point3<f64>) -> Point3<f64>,
) -> Result<Plane, PlaneError> {
    let (mut across, mut middles) = (Vector3::zeros(), Vec::new());
    for sorted in &start.pictures {
        let (Some(Some(direct)), Some(Some(image))) = (sorted.views.first(), sorted.views.get(view)) else { continue };
        for (place, _) in &direct.corners {
            let here = front.lengthened(&(direct.pose * place), &Point3::origin());
            let there = shown(&(image.pose * place));
            across += here - there;
            middles.push((here.coords + there.coords) / 2.0);
        }
    }
    let normal = across.normalize();
    let offset = middles.iter().map(|middle| normal.dot(middle)).sum::<f64>() / middles.len().max(1) as f64;
    Plane::new(normal, offset)
}

impl Wall {
    /// Approximate true position of a point that appears at `apparent` through this wall, seen from `eye`: things
    /// behind it appear nearer, by the index.
    fn lengthened(&self, apparent: &Point3<f64>, eye: &Point3<f64>) -> Point3<f64> {
        let behind = (-self.outer.signed_distance(apparent)).max(0.0);
        apparent + (apparent - eye).normalize() * (behind * (self.index_inside - 1.0))
    }
}

/// Extent of the corners of all boards along a direction.
fn outermost(start: &Initial, poses: &[Isometry3<f64>], direction: &Vector3<f64>) -> f64 {
    corners(start, poses).map(|corner| corner.coords.dot(direction)).fold(f64::NEG_INFINITY, f64::max)
}

/// The corners of all boards, in every view that shows them.
fn corners(start: &Initial, poses: &[Isometry3<f64>]) -> impl Iterator<Item = Point3<f64>> {
    start.pictures.iter().zip(poses).flat_map(|(sorted, pose)| {
        sorted.views.iter().flatten().flat_map(|image| &image.corners).map(move |(place, _)| pose * place)
    })
}

impl Tank {
    fn wall(&self, outer: Plane) -> Wall {
        Wall {
            outer,
            thickness_m: self.glass_m,
            index_outside: 1.0,
            index_wall: self.index_glass,
            index_inside: self.index_inside,
        }
    }
}

/// The priors.
pub(super) fn known(geometry: &Geometry, options: &RigOptions) -> Result<Vec<Prior>, RigCalibrationError> {
    let mut known = Vec::new();
    if let Some(covariance) = &options.lens_covariance {
        let factor = covariance.clone().cholesky().ok_or(RigCalibrationError::LensCovariance)?;
        let whitening = factor.l().try_inverse().ok_or(RigCalibrationError::LensCovariance)?;
        let values = Parameter::of_lens(&geometry.lens).iter().map(|parameter| geometry.value(*parameter)).collect();
        known.push(Prior::Lens { values, whitening });
    }
    for (name, distance_m, sd_m) in &options.distances_m {
        let surface = surface(geometry, name)?;
        known.push(Prior::Distance { surface, distance_m: *distance_m, sd_m: *sd_m });
    }
    let Some(tank) = &options.tank else { return Ok(known) };
    if let Some(sd) = options.index_sd {
        known.push(Prior::IndexInside { index: tank.index_inside, sd });
    }
    let Some([width_m, depth_m, _]) = tank.size_m else { return Ok(known) };
    known.extend(pairs_of_walls(geometry).filter_map(|(surfaces, pair)| match pair {
        Pair::Square => Some(Prior::Square { surfaces, sd_rad: SQUARE_SD_RAD }),
        Pair::Opposite => {
            // The front wall is the first one; the opposite wall is at the depth's distance.
            let distance_m = if surfaces[0] == 0 { depth_m } else { width_m };
            Some(Prior::Apart { surfaces, distance_m, sd_m: SIZE_SD_M })
        }
        Pair::SameSide => None,
    }));
    Ok(known)
}

fn walls(geometry: &Geometry) -> impl Iterator<Item = usize> {
    let surfaces = geometry.surfaces.iter().enumerate();
    surfaces.filter(|(_, (_, surface))| matches!(surface, Surface::Wall(_))).map(|(index, _)| index)
}

/// How two walls of a tank, whose normals point outwards, stand to each other.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Pair {
    Square,
    Opposite,
    /// Two mirrors on one side are seen through one wall, each with a wall of its own here.
    SameSide,
}

/// All pairs of walls.
fn pairs_of_walls(geometry: &Geometry) -> impl Iterator<Item = ([usize; 2], Pair)> {
    let normal = |surface: usize| geometry.surfaces[surface].1.plane().normal();
    let pairs = walls(geometry).flat_map(|a| walls(geometry).filter(move |b| *b > a).map(move |b| [a, b]));
    pairs.map(move |[a, b]| {
        let pair = match normal(a).dot(&normal(b)) {
            dot if dot.abs() < std::f64::consts::FRAC_1_SQRT_2 => Pair::Square,
            dot if dot < 0.0 => Pair::Opposite,
            _ => Pair::SameSide,
        };
        ([a, b], pair)
    })
}

/// Priors that keep the search near its start.
pub(super) fn held(geometry: &Geometry) -> Vec<Prior> {
    let distance_m = |surface: usize| geometry.surfaces[surface].1.plane().offset_m().abs();
    walls(geometry)
        .map(|surface| Prior::Distance { surface, distance_m: distance_m(surface), sd_m: HOLD_SD.0 })
        .chain(
            pairs_of_walls(geometry)
                .filter(|(_, pair)| *pair == Pair::Square)
                .map(|(surfaces, _)| Prior::Square { surfaces, sd_rad: HOLD_SD.1 }),
        )
        .collect()
}

/// Refractive index of water; `None` outside 0 to 50 °C.
pub fn water_index(celsius: f64) -> Option<f64> {
    let at = celsius / 10.0;
    let below = (at.floor() as usize).min(WATER.len() - 2);
    let between = at - below as f64;
    (0.0..=5.0).contains(&at).then(|| WATER[below] + (WATER[below + 1] - WATER[below]) * between)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn water_as_the_handbook_has_it() {
        assert_eq!(water_index(20.0), Some(1.33299));
        assert!((water_index(25.0).unwrap() - 1.33245).abs() < 1e-5);
        assert_eq!((water_index(50.0), water_index(-1.0), water_index(51.0)), (Some(1.32894), None, None));
        assert_eq!(water_index(f64::NAN), None);
    }
}
