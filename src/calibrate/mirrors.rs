//! `catoptra calibrate rig`: mirrors and walls from pictures that show a board directly and in the mirrors.
//!
//! In: images of the board in each picture ([`BoardsPicture`]), the lens with its covariance, what else is known of the tank.
//! Out: surfaces and views of the rig, their covariance, and what each picture leaves.
//!
//! 1. `start`: which image is which view, about where the mirrors are, as if in air.
//! 2. Where there is a tank, walls are put between camera and boards: the front wall across the line of sight, and for each
//!    mirror beside the tank the wall through which it looks. Several distances are tried.
//! 3. [`super::bundle`]: all at once. The best of the tries counts; a picture that fits much worse than the others is left out.
//!
//! Assumes that a board is either in the medium behind the walls in all pictures, or in air in all of them.
//! Cannot detect: a wrong refractive index or glass thickness (they trade off against distances), a wrong size of the
//! squares (everything scales with it).

use super::board::Board;
use super::bundle::{Bundle, Corner, NoSolution, Solution};
use super::camera::{BoardPicture, UsedPicture, list, rms, worst};
use super::enough::{Lacking, determined, shown};
use super::geometry::{Geometry, Parameter};
use super::known::Known;
use super::regions::regions;
use super::start::{BoardsPicture, Sorted, Start, Unusable, start};
use super::taped::Taped;
use crate::optics::{Lens, Mirror, OpticalPath, Plane, PlaneError, Surface, Wall};
use crate::rig::{Draft, View};
use nalgebra::{DMatrix, Isometry3, Point2, Point3, Translation3, Vector2, Vector3};

/// Fewest pictures with two images of the board.
const FEWEST_PICTURES: usize = 3;
/// Walls are first put this far in front of the nearest corner, metres.
const MARGINS_M: [f64; 3] = [0.03, 0.08, 0.15];
/// While searching, walls are held to where they were put, metres, and to right angles, radians; the answer knows nothing
/// of it.
const HELD: (f64, f64) = (0.05, 3e-3);
/// How square a glass box is, radians, and how true to size, metres: what its makers keep.
const SQUARE_SD_RAD: f64 = 3e-3;
const SIZE_SD_M: f64 = 1e-3;
/// How far off the distance of a board from a single view may be.
const POSE_ERROR: f64 = 0.02;
/// Refractive index of water at 589 nm from 0 to 50 °C in steps of 10 °C (CRC Handbook of Chemistry and Physics).
const WATER: [f64; 6] = [1.33395, 1.33369, 1.33299, 1.33192, 1.33051, 1.32894];

/// A tank of flat walls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tank {
    /// Thickness of its glass, metres.
    pub glass_m: f64,
    /// Index of the glass.
    pub index_glass: f64,
    /// Index of what is in it.
    pub index_inside: f64,
    /// Outer width, depth and height as the camera faces it, metres, when it is a box.
    pub size_m: Option<[f64; 3]>,
    /// The mirrors stand in the water, behind the front wall, instead of beside the tank.
    pub mirrors_inside: bool,
}

/// How to calibrate.
#[derive(Debug, Clone, Default)]
pub struct RigOptions {
    /// How many mirrors.
    pub mirrors: usize,
    /// The tank, if the board was in one.
    pub tank: Option<Tank>,
    /// Covariance of the lens (fx, fy, cx, cy, k1, k2, p1, p2, k3); without it the lens is taken for exact.
    pub lens_covariance: Option<DMatrix<f64>>,
    /// Distances of surfaces from the camera that were measured: name, distance, standard deviation, metres.
    pub distances_m: Vec<(String, f64, f64)>,
    /// Pictures of the board taped flat to the outer face of a wall: the wall's name, the board's image.
    pub taped: Vec<(String, BoardPicture)>,
    /// Standard deviation of the index inside, to let it be fitted; `None` holds it.
    pub index_sd: Option<f64>,
}

/// The rig's optics and how well they are known.
#[derive(Debug, Clone)]
pub struct RigCalibration {
    /// The solution.
    pub solution: Solution,
    /// The corners it explains.
    pub corners: Vec<Corner>,
    /// For each picture that was used, its index among those given and what it leaves.
    pub used: Vec<(usize, UsedPicture)>,
    /// Pictures left out, and why.
    pub left_out: Vec<(String, String)>,
}

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum RigCalibrationError {
    /// Too few usable pictures.
    #[error("{found} pictures show the board directly and in a mirror, at least {FEWEST_PICTURES} are needed, 10 to 20 are good{}", list(.left_out))]
    TooFew {
        /// How many.
        found: usize,
        /// Those that do not, and why.
        left_out: Vec<(String, String)>,
    },
    /// Fewer mirrors than asked for.
    #[error("mirrors that show the board in the pictures: {found}, asked for were {expected} (--mirrors)")]
    Mirrors {
        /// How many.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
    /// Pictures that are not enough.
    #[error(transparent)]
    Lacking(#[from] Lacking),
    /// Boards before the wall behind which they are.
    #[error(
        "by the size of its squares the board ({board}) of {name} is {nearest_mm:.0} mm from the camera, before front_wall at \
         {distance_mm:.0} mm: is one of the two wrong?"
    )]
    BeforeWall {
        /// The picture.
        name: String,
        /// As given.
        board: String,
        /// Distance of the nearest corner.
        nearest_mm: f64,
        /// Distance of the wall, as given.
        distance_mm: f64,
    },
    /// A distance, or a board, of a surface that does not exist.
    #[error("there is no surface `{name}`; there are {known}")]
    NoSurface {
        /// As asked for.
        name: String,
        /// Those there are.
        known: String,
    },
    /// A taped board that is not seen as its wall is.
    #[error("{name}: the board on {wall} is {}", if *.mirrored { "seen directly, that wall in the mirror" } else { "seen in a \
        mirror, that wall directly" })]
    Taped {
        /// The picture.
        name: String,
        /// The wall.
        wall: String,
        /// Whether it should be mirrored.
        mirrored: bool,
    },
    /// OpenCV refused.
    #[error("no first guess: {0}")]
    OpenCv(#[from] opencv::Error),
    /// No plane.
    #[error("no first guess: {0}")]
    Plane(#[from] PlaneError),
    /// The covariance of the lens is none.
    #[error("the covariance of the lens is not positive")]
    LensCovariance,
    /// The adjustment failed.
    #[error(
        "the pictures do not determine the rig ({0}): are tank, distances and mirrors as they were given? If so, take more \
         pictures, tilted to all sides, near and far"
    )]
    Solve(#[from] NoSolution),
}

/// Calibrates mirrors and walls.
///
/// # Errors
/// [`RigCalibrationError`] when the pictures do not show enough, or do not belong together.
pub fn calibrate_rig(
    board: &Board,
    lens: &Lens,
    pictures: &[BoardsPicture],
    options: &RigOptions,
) -> Result<RigCalibration, RigCalibrationError> {
    let mut start = start(board, lens, pictures, options.mirrors)?;
    let name = |picture: usize| pictures.get(picture).map_or_else(String::new, |p| p.name.clone());
    let reason = |(picture, why): &(usize, Unusable)| (name(*picture), why.to_string());
    let mut left_out: Vec<(String, String)> = start.left_out.iter().map(reason).collect();
    loop {
        if start.pictures.len() < FEWEST_PICTURES {
            return Err(RigCalibrationError::TooFew { found: start.pictures.len(), left_out });
        }
        if start.mirrors.len() < options.mirrors {
            return Err(RigCalibrationError::Mirrors { found: start.mirrors.len(), expected: options.mirrors });
        }
        shown(&start)?;
        before_wall(board, &start, options, &name)?;
        let names: Vec<String> = start.pictures.iter().map(|sorted| name(sorted.picture)).collect();
        let (solution, corners) = best(board, lens, &start, &names, options)?;
        let used: Vec<UsedPicture> = names
            .into_iter()
            .enumerate()
            .map(|(picture, name)| UsedPicture {
                name,
                pose: solution.poses[picture],
                corners: by_picture(&corners, &solution, picture),
            })
            .collect();
        let Some((index, off)) = worst(&used) else {
            determined(&solution)?;
            let used = start.pictures.iter().map(|s| s.picture).zip(used).collect();
            return Ok(RigCalibration { solution, corners, used, left_out });
        };
        let sorted = start.pictures.remove(index);
        left_out.push((name(sorted.picture), off.to_string()));
    }
}

/// A wall at a measured distance, and boards that by their size are nearer: light goes straight to the wall, so that a board
/// behind it never seems to be before it, whatever its tilt.
fn before_wall(
    board: &Board,
    start: &Start,
    options: &RigOptions,
    name: &impl Fn(usize) -> String,
) -> Result<(), RigCalibrationError> {
    let measured = options.distances_m.iter().find(|(name, ..)| name == "front_wall");
    let Some((_, distance_m, sd_m)) = measured.filter(|_| options.tank.is_some()) else { return Ok(()) };
    let nearest = |sorted: &Sorted| {
        let image = sorted.views.first()?.as_ref()?;
        image.corners.iter().map(|(place, _)| (image.pose * place).coords.norm()).reduce(f64::min)
    };
    let all = start.pictures.iter().filter_map(|sorted| Some((name(sorted.picture), nearest(sorted)?)));
    match all.min_by(|a, b| a.1.total_cmp(&b.1)) {
        Some((name, nearest_m)) if nearest_m < distance_m * (1.0 - POSE_ERROR) - 3.0 * sd_m => {
            Err(RigCalibrationError::BeforeWall {
                name,
                board: board.to_string(),
                nearest_mm: nearest_m * 1e3,
                distance_mm: distance_m * 1e3,
            })
        }
        _ => Ok(()),
    }
}

fn by_picture(corners: &[Corner], solution: &Solution, picture: usize) -> Vec<(Point2<f64>, Vector2<f64>)> {
    let all = corners.iter().zip(&solution.residuals_px);
    all.filter(|(corner, _)| corner.picture == picture).map(|(corner, residual)| (corner.pixel, *residual)).collect()
}

/// The best of the adjustments that start from walls at several distances.
fn best(
    board: &Board,
    lens: &Lens,
    start: &Start,
    names: &[String],
    options: &RigOptions,
) -> Result<(Solution, Vec<Corner>), RigCalibrationError> {
    let seen: Vec<Corner> = start
        .pictures
        .iter()
        .enumerate()
        .flat_map(|(picture, sorted)| {
            let views = sorted.views.iter().enumerate();
            views.flat_map(move |(view, image)| {
                image.iter().flat_map(|image| &image.corners).map(move |(place, pixel)| Corner {
                    picture,
                    view,
                    place: *place,
                    pixel: *pixel,
                })
            })
        })
        .collect();
    let margins: &[f64] = if options.tank.is_some() { &MARGINS_M } else { &[0.0] };
    let mut best: Result<Solution, RigCalibrationError> = Err(NoSolution::NotConverged.into());
    for margin_m in margins {
        let (geometry, poses) = first_geometry(lens, start, options, *margin_m)?;
        let known = known(&geometry, options)?;
        let mut free: Vec<Parameter> = (0..geometry.surfaces.len()).flat_map(Parameter::of_surface).collect();
        let (names, corners) = (names.to_vec(), seen.clone());
        let mut bundle = Bundle { geometry, free: free.clone(), poses, names, corners, known };
        for (wall, picture) in &options.taped {
            Taped::new(board, lens, &bundle.geometry, wall, picture)?.add(&mut bundle);
        }
        let (corners, known) = (bundle.corners.clone(), bundle.known.clone());
        bundle.known.extend(held(&bundle.geometry));
        let rough = bundle.solve();
        if options.lens_covariance.is_some() {
            free.extend(Parameter::LENS);
        }
        if options.tank.is_some() && options.index_sd.is_some() {
            free.push(Parameter::IndexInside);
        }
        let solved = rough.and_then(|rough| {
            let Solution { geometry, poses, names, .. } = rough;
            Bundle { geometry, free, poses, names, corners, known }.solve()
        });
        let cost = |s: &Solution| rms(s.residuals_px.iter().copied());
        match (solved, &best) {
            (Ok(solved), Ok(found)) if cost(&solved) >= cost(found) => {}
            (Ok(solved), _) => best = Ok(solved),
            (Err(why), Err(_)) => best = Err(why.into()),
            (Err(_), Ok(_)) => {}
        }
    }
    // Taped boards and the views that show them have done their work: they are no part of the rig.
    let mut solution = best?;
    solution.geometry.views.truncate(1 + start.mirrors.len());
    solution.poses.truncate(start.pictures.len());
    solution.names.truncate(start.pictures.len());
    solution.residuals_px.truncate(seen.len());
    solution.known.retain(|known| !matches!(known, Known::Taped { .. }));
    Ok((solution, seen))
}

/// Index of a surface by its name.
pub(super) fn surface(geometry: &Geometry, name: &str) -> Result<usize, RigCalibrationError> {
    geometry.surfaces.iter().position(|(own, _)| own == name).ok_or_else(|| {
        let names: Vec<&str> = geometry.surfaces.iter().map(|(name, _)| name.as_str()).collect();
        RigCalibrationError::NoSurface { name: name.to_owned(), known: names.join(", ") }
    })
}

/// Names of the mirrors and of their views: without a number where there is only one.
fn numbered(name: &str, index: usize, count: usize) -> String {
    if count == 1 { name.to_owned() } else { format!("{name}_{}", index + 1) }
}

/// Surfaces, views and poses to start from; walls `margin_m` in front of the nearest corner.
fn first_geometry(
    lens: &Lens,
    start: &Start,
    options: &RigOptions,
    margin_m: f64,
) -> Result<(Geometry, Vec<Isometry3<f64>>), RigCalibrationError> {
    let count = start.mirrors.len();
    let mut surfaces: Vec<(String, Surface)> = Vec::new();
    let mut views = vec![("direct".to_owned(), Vec::new())];
    let seen: Vec<_> = start.pictures.iter().map(|p| &p.views).collect();
    let mut poses: Vec<Isometry3<f64>> = seen.iter().filter_map(|views| Some(views.first()?.as_ref()?.pose)).collect();
    if let Some(tank) = &options.tank {
        let middle = poses.iter().map(|p| p.translation.vector).sum::<Vector3<f64>>() / poses.len().max(1) as f64;
        let normal = -middle.normalize();
        let measured = options.distances_m.iter().find(|(name, ..)| name == "front_wall").map(|(_, d, _)| -d);
        let offset_m = measured.unwrap_or_else(|| outermost(start, &poses, &normal) + margin_m);
        let front = tank.wall(Plane::new(normal, offset_m)?);
        for pose in &mut poses {
            let middle = Point3::from(pose.translation.vector);
            *pose = Translation3::from(front.lengthened(&middle) - middle) * *pose;
        }
        surfaces.push(("front_wall".to_owned(), Surface::Wall(front)));
        views[0].1.push(0);
    }
    for (index, (normal, offset_m)) in start.mirrors.iter().enumerate() {
        let mirror = surfaces.len();
        let mut plane = Plane::new(*normal, *offset_m)?;
        if options.tank.is_some_and(|tank| tank.mirrors_inside)
            && let Some((_, Surface::Wall(front))) = surfaces.first()
        {
            plane = plane_in_water(start, index + 1, front)?;
        }
        surfaces.push((numbered("mirror", index, count), Surface::Mirror(Mirror { plane })));
        let path = match &options.tank {
            None => vec![mirror],
            Some(tank) if tank.mirrors_inside => vec![0, mirror],
            Some(tank) => {
                let front = surfaces[0].1.plane().normal();
                let middle = poses.iter().map(|p| p.translation.vector).sum::<Vector3<f64>>() / poses.len() as f64;
                // Towards the boards, from the mirror image of the camera.
                let camera = plane.reflect(&Point3::origin());
                let inward = (Point3::from(middle) - camera).normalize();
                if -inward.dot(&front) > std::f64::consts::FRAC_1_SQRT_2 {
                    vec![mirror, 0]
                } else {
                    let normal = -(inward - front * front.dot(&inward)).normalize();
                    let offset_m = outermost(start, &poses, &normal) + margin_m;
                    surfaces.push((
                        numbered("side_wall", index, count),
                        Surface::Wall(tank.wall(Plane::new(normal, offset_m)?)),
                    ));
                    vec![mirror, mirror + 1]
                }
            }
        };
        views.push((numbered("mirror", index, count), path));
    }
    Ok((Geometry { lens: *lens, surfaces, views }, poses))
}

/// The plane halfway between what a board and its reflection behind a wall are when refraction is made good.
fn plane_in_water(start: &Start, view: usize, front: &Wall) -> Result<Plane, PlaneError> {
    let (mut across, mut middles) = (Vector3::zeros(), Vec::new());
    for sorted in &start.pictures {
        let (Some(Some(direct)), Some(Some(image))) = (sorted.views.first(), sorted.views.get(view)) else { continue };
        for (place, _) in &direct.corners {
            let (here, there) = (front.lengthened(&(direct.pose * place)), front.lengthened(&(image.pose * place)));
            across += here - there;
            middles.push((here.coords + there.coords) / 2.0);
        }
    }
    let normal = across.normalize();
    let offset = middles.iter().map(|middle| normal.dot(middle)).sum::<f64>() / middles.len().max(1) as f64;
    Plane::new(normal, offset)
}

impl Wall {
    /// About where a point is that seems to be at `apparent` through this wall: what is behind it seems nearer, by the index.
    fn lengthened(&self, apparent: &Point3<f64>) -> Point3<f64> {
        let behind = (-self.outer.signed_distance(apparent)).max(0.0);
        apparent + apparent.coords.normalize() * (behind * (self.index_inside - 1.0))
    }
}

/// How far the corners of all boards reach along a direction.
fn outermost(start: &Start, poses: &[Isometry3<f64>], direction: &Vector3<f64>) -> f64 {
    let corners = start.pictures.iter().zip(poses).flat_map(|(sorted, pose)| {
        sorted.views.iter().flatten().flat_map(|image| &image.corners).map(move |(place, _)| (pose * place).coords)
    });
    corners.map(|corner| corner.dot(direction)).fold(f64::NEG_INFINITY, f64::max)
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

/// What is known beside the pictures.
fn known(geometry: &Geometry, options: &RigOptions) -> Result<Vec<Known>, RigCalibrationError> {
    let mut known = Vec::new();
    if let Some(covariance) = &options.lens_covariance {
        let factor = covariance.clone().cholesky().ok_or(RigCalibrationError::LensCovariance)?;
        let whitening = factor.l().try_inverse().ok_or(RigCalibrationError::LensCovariance)?;
        let values = Parameter::LENS.map(|parameter| geometry.value(parameter));
        known.push(Known::Lens { values, whitening });
    }
    for (name, distance_m, sd_m) in &options.distances_m {
        let surface = surface(geometry, name)?;
        known.push(Known::Distance { surface, distance_m: *distance_m, sd_m: *sd_m });
    }
    let Some(tank) = &options.tank else { return Ok(known) };
    if let Some(sd) = options.index_sd {
        known.push(Known::IndexInside { index: tank.index_inside, sd });
    }
    let Some([width_m, depth_m, _]) = tank.size_m else { return Ok(known) };
    known.extend(pairs_of_walls(geometry).map(|(surfaces, across)| {
        if across {
            return Known::Square { surfaces, sd_rad: SQUARE_SD_RAD };
        }
        // The front wall is the first one; what is opposite to it is the depth away.
        let distance_m = if surfaces[0] == 0 { depth_m } else { width_m };
        Known::Apart { surfaces, distance_m, sd_m: SIZE_SD_M }
    }));
    Ok(known)
}

fn walls(geometry: &Geometry) -> impl Iterator<Item = usize> {
    let surfaces = geometry.surfaces.iter().enumerate();
    surfaces.filter(|(_, (_, surface))| matches!(surface, Surface::Wall(_))).map(|(index, _)| index)
}

/// All pairs of walls, and whether they stand across each other (else they are opposite).
fn pairs_of_walls(geometry: &Geometry) -> impl Iterator<Item = ([usize; 2], bool)> {
    let normal = |surface: usize| geometry.surfaces[surface].1.plane().normal();
    let pairs = walls(geometry).flat_map(|a| walls(geometry).filter(move |b| *b > a).map(move |b| [a, b]));
    pairs.map(move |[a, b]| ([a, b], normal(a).dot(&normal(b)).abs() < std::f64::consts::FRAC_1_SQRT_2))
}

/// What keeps the search near its start.
fn held(geometry: &Geometry) -> Vec<Known> {
    let distance_m = |surface: usize| geometry.surfaces[surface].1.plane().offset_m().abs();
    walls(geometry)
        .map(|surface| Known::Distance { surface, distance_m: distance_m(surface), sd_m: HELD.0 })
        .chain(
            pairs_of_walls(geometry)
                .filter(|(_, across)| *across)
                .map(|(surfaces, _)| Known::Square { surfaces, sd_rad: HELD.1 }),
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

/// The rig file with the mirrors, walls and views found in place of those it had. Its base frame was found with the old
/// ones and is left out.
pub fn into_draft(mut draft: Draft, done: &RigCalibration) -> Draft {
    let geometry = &done.solution.geometry;
    draft.camera.lens = geometry.lens;
    draft.surfaces = geometry.surfaces.iter().cloned().collect();
    let optics: Vec<OpticalPath> = (0..geometry.views.len()).map(|view| geometry.path(view)).collect();
    let regions = regions(&done.corners, &optics, draft.camera.size_px);
    draft.views = geometry
        .views
        .iter()
        .zip(optics.into_iter().zip(regions))
        .map(|((name, path), (optics, region_px))| View {
            name: name.clone(),
            path: path.iter().map(|&surface| geometry.surfaces[surface].0.clone()).collect(),
            optics,
            region_px,
        })
        .collect();
    draft.base = None;
    draft
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
