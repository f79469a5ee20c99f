//! `catoptra calibrate rig`: mirrors and walls from pictures that show a board directly and in the mirrors.
//!
//! In: images of the board in each picture ([`BoardsPicture`]), the lens with its covariance, priors about the tank.
//! Out: surfaces and views of the rig, their covariance, and the residuals of each picture.
//!
//! 1. `start`: which image is which view, and approximate mirrors, as if in air.
//! 2. With a tank, walls are placed between camera and boards: the front wall across the line of sight, and for each
//!    mirror beside the tank the wall in front of it. Several distances are tried.
//! 3. `super::bundle`: adjusts everything jointly. The best attempt counts; a picture that fits much worse than the
//!    others is left out.
//!
//! Assumes that a board is either in the medium behind the walls in all pictures, or in air in all of them.
//! Cannot detect: a wrong refractive index or glass thickness (they trade off against distances), a wrong size of the
//! squares (everything scales with it).

pub(crate) mod diagnostics;
mod error;
pub(crate) mod expected_error;
pub(crate) mod held_out;
pub(crate) mod initial;
mod moved;
mod options;
pub mod points;
mod regions;
pub(crate) mod share;
pub(crate) mod sufficient;
mod taped;
mod walls;

pub use diagnostics::{Diagnostic, diagnose};
pub use error::RigCalibrationError;
pub use expected_error::{Verdict, verdict};
pub use held_out::held_out;
pub use initial::BoardsPicture;
pub use options::{RigOptions, Tank, TapedBoard};
pub use points::{Points, PointsError};
pub use walls::water_index;

use crate::calibrate::board::Board;
use crate::calibrate::bundle::outliers::{UsedPicture, rms, worst_picture};
use crate::calibrate::bundle::prior::Prior;
use crate::calibrate::bundle::shape::Shape;
use crate::calibrate::bundle::{Bundle, Corner, NoSolution, Solution};
use crate::calibrate::geometry::{Parameter, tilt_axes};
use crate::optics::{Lens, OpticalPath};
use crate::rig::{Draft, View};
use error::{FEWEST_PICTURES, surface};
use initial::{Initial, SortedPicture, Unusable, start};
use nalgebra::{Point2, Vector2, Vector3};
use regions::regions;
use sufficient::{check_views, determined};
use taped::Taped;
use walls::{Beside, first_geometry, held, known};

/// Initial distances of walls in front of the nearest corner, metres.
const MARGINS_M: [f64; 3] = [0.03, 0.08, 0.15];

/// Where there is no calibration, a measured distance that is off by this many standard deviations is doubted.
const DOUBT_SD: f64 = 2.0;

/// Relative error of a board's distance from a single view.
const POSE_ERROR: f64 = 0.02;
/// How much further than the tank's size boards may reach by errors of both: a part of it, and metres.
const TANK_TOLERANCE: (f64, f64) = (0.03, 5e-3);

/// The rig's optics with their covariance.
#[derive(Debug, Clone)]
pub struct RigCalibration {
    /// The solution, of the rig alone: boards taped to walls are no part of it.
    pub solution: Solution,
    /// The corners used, without those of taped boards.
    pub corners: Vec<Corner>,
    /// For each picture used, its index among those given and its residuals.
    pub used: Vec<(usize, UsedPicture)>,
    /// Pictures left out, and why.
    pub left_out: Vec<(String, String)>,
    /// Solution and corners with the taped boards, the last of its pictures.
    pub(crate) with_taped: (Solution, Vec<Corner>),
}

/// Calibrates mirrors and walls.
///
/// # Errors
/// [`RigCalibrationError`] when the pictures do not show enough, or are inconsistent.
pub fn calibrate_rig(
    board: &Board,
    lens: &Lens,
    pictures: &[BoardsPicture],
    options: &RigOptions,
) -> Result<RigCalibration, RigCalibrationError> {
    let start = start(board, lens, pictures, options.mirrors)?;
    let places = board.centred_points();
    let target = Target { shape: Shape::flat(&places), words: board.to_string(), board: Some(board) };
    adjusted(&target, lens, start, pictures.iter().map(|p| p.name.clone()).collect(), options)
}

/// Calibrates mirrors and walls from points that were marked by hand or found by other tools.
///
/// # Errors
/// As [`calibrate_rig`].
pub fn calibrate_rig_from_points(
    points: &Points,
    lens: &Lens,
    options: &RigOptions,
) -> Result<RigCalibration, RigCalibrationError> {
    let shape = if points.is_flat() { Shape::flat(points.places()) } else { Shape::rigid() };
    let target = Target { shape, words: "points".to_owned(), board: None };
    adjusted(&target, lens, points.start(lens)?, points.names(), options)
}

/// The target in the pictures.
struct Target<'a> {
    /// Prior of its shape.
    shape: Shape,
    /// For messages.
    words: String,
    /// The board, if it is one; taped boards must be the same.
    board: Option<&'a Board>,
}

/// Adjusts all from `start`. Where that fails, each measured distance is doubted.
fn adjusted(
    target: &Target<'_>,
    lens: &Lens,
    start: Initial,
    names: Vec<String>,
    options: &RigOptions,
) -> Result<RigCalibration, RigCalibrationError> {
    use RigCalibrationError::{BeyondTank, InsufficientPictures, Solve};
    let adjust = |options: &RigOptions| adjusted_as_given(target, lens, start.clone(), &names, options);
    adjust(options).map_err(|why| match why {
        BeyondTank { .. } | InsufficientPictures(_) | Solve(_) => doubted(why, options, adjust),
        other => other,
    })
}

/// The reason why there is no calibration, or the measured distance without which there is one that contradicts it.
fn doubted(
    why: RigCalibrationError,
    options: &RigOptions,
    adjust: impl Fn(&RigOptions) -> Result<RigCalibration, RigCalibrationError>,
) -> RigCalibrationError {
    for (i, (name, given_m, given_sd_m)) in options.distances_m.iter().enumerate() {
        let mut others = options.clone();
        others.distances_m.remove(i);
        let Ok(RigCalibration { solution, .. }) = adjust(&others) else { continue };
        let Ok(surface) = surface(&solution.geometry, name) else { continue };
        let offset = Parameter::Offset { surface };
        let Some(sd_m) = solution.sd(offset) else { continue };
        let found_m = solution.geometry.value(offset).abs();
        if (found_m - given_m).abs() > DOUBT_SD * sd_m.hypot(*given_sd_m) {
            let [given_mm, given_sd_mm, found_mm, sd_mm] = [*given_m, *given_sd_m, found_m, sd_m].map(|m| m * 1e3);
            let name = name.clone();
            return RigCalibrationError::Distance { name, given_mm, given_sd_mm, found_mm, sd_mm, why: Box::new(why) };
        }
    }
    why
}

/// Adjusts all from `start`; pictures that fit much worse than the others are left out.
fn adjusted_as_given(
    target: &Target<'_>,
    lens: &Lens,
    mut start: Initial,
    names: &[String],
    options: &RigOptions,
) -> Result<RigCalibration, RigCalibrationError> {
    let name = |picture: usize| names.get(picture).cloned().unwrap_or_default();
    let reason = |(picture, why): &(usize, Unusable)| (name(*picture), why.to_string());
    let mut left_out: Vec<(String, String)> = start.left_out.iter().map(reason).collect();
    loop {
        if start.pictures.len() < FEWEST_PICTURES {
            return Err(RigCalibrationError::TooFew { found: start.pictures.len(), left_out });
        }
        if start.mirrors.len() < options.mirrors {
            return Err(RigCalibrationError::Mirrors { found: start.mirrors.len(), expected: options.mirrors });
        }
        check_views(&start)?;
        before_wall(target, &start, options, &name)?;
        let names: Vec<String> = start.pictures.iter().map(|sorted| name(sorted.picture)).collect();
        let with_taped = best(target, lens, &start, &names, options)?;
        let (solution, corners) = without_taped(&with_taped, &start);
        let used: Vec<UsedPicture> = names
            .into_iter()
            .enumerate()
            .map(|(picture, name)| UsedPicture {
                name,
                pose: solution.poses[picture],
                corners: by_picture(&corners, &solution, picture),
            })
            .collect();
        let Some((index, off)) = worst_picture(&used) else {
            determined(&solution)?;
            beyond_tank(target, &solution, &corners, options)?;
            let used = start.pictures.iter().map(|s| s.picture).zip(used).collect();
            return Ok(RigCalibration { solution, corners, used, left_out, with_taped });
        };
        let sorted = start.pictures.remove(index);
        left_out.push((name(sorted.picture), off.to_string()));
    }
}

/// Checks for a wall at a measured distance with boards that, by their size, are nearer: light goes straight to the
/// wall, so a board behind it never appears in front of it, whatever its tilt.
fn before_wall(
    target: &Target<'_>,
    start: &Initial,
    options: &RigOptions,
    name: &impl Fn(usize) -> String,
) -> Result<(), RigCalibrationError> {
    let measured = options.distances_m.iter().find(|(name, ..)| name == "front_wall");
    let Some((_, distance_m, sd_m)) = measured.filter(|_| options.tank.is_some()) else { return Ok(()) };
    let nearest = |sorted: &SortedPicture| {
        let image = sorted.views.first()?.as_ref()?;
        image.corners.iter().map(|(place, _)| (image.pose * place).coords.norm()).reduce(f64::min)
    };
    let all = start.pictures.iter().filter_map(|sorted| Some((name(sorted.picture), nearest(sorted)?)));
    match all.min_by(|a, b| a.1.total_cmp(&b.1)) {
        Some((name, nearest_m)) if nearest_m < distance_m * (1.0 - POSE_ERROR) - 3.0 * sd_m => {
            Err(RigCalibrationError::BeforeWall {
                name,
                board: target.words.clone(),
                nearest_mm: nearest_m * 1e3,
                distance_mm: distance_m * 1e3,
            })
        }
        _ => Ok(()),
    }
}

/// Checks that the tank has room for the boards as solved.
fn beyond_tank(
    target: &Target<'_>,
    solution: &Solution,
    corners: &[Corner],
    options: &RigOptions,
) -> Result<(), RigCalibrationError> {
    let Some([width_m, depth_m, height_m]) = options.tank.as_ref().and_then(|tank| tank.size_m) else { return Ok(()) };
    // The front wall is the first surface of a tank.
    let Some((_, front)) = solution.geometry.surfaces.first() else { return Ok(()) };
    let normal = front.plane().normal();
    let span_m = |way: &Vector3<f64>| {
        let along = corners.iter().map(|corner| (solution.poses[corner.picture] * corner.place).coords.dot(way));
        along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)))
    };
    let error = |what: String, tank_m: f64, side| RigCalibrationError::BeyondTank {
        board: target.words.clone(),
        what,
        tank_mm: tank_m * 1e3,
        side,
    };
    let most_m = |size_m: f64| size_m * (1.0 + TANK_TOLERANCE.0) + TANK_TOLERANCE.1;
    let (low, high) = span_m(&normal);
    let front_m = front.plane().offset_m();
    let behind_m = (low - front_m).abs().max((high - front_m).abs());
    if behind_m > most_m(depth_m) {
        return Err(error(format!("{:.0} mm behind the front of front_wall", behind_m * 1e3), depth_m, "deep"));
    }
    // How the walls stand beside the front one is not known to all set-ups: its diagonal is a limit for all.
    let [a, b] = tilt_axes(&normal);
    let across_m = (0..8).map(|k| {
        let (sin, cos) = (f64::from(k) * std::f64::consts::PI / 8.0).sin_cos();
        let (low, high) = span_m(&(a * cos + b * sin));
        high - low
    });
    let (across_m, diagonal_m) = (across_m.fold(0.0, f64::max), width_m.hypot(height_m));
    if across_m > most_m(diagonal_m) {
        return Err(error(format!("over {:.0} mm along front_wall", across_m * 1e3), diagonal_m, "along its diagonal"));
    }
    Ok(())
}

fn by_picture(corners: &[Corner], solution: &Solution, picture: usize) -> Vec<(Point2<f64>, Vector2<f64>)> {
    let all = corners.iter().zip(&solution.residuals_px);
    all.filter(|(corner, _)| corner.picture == picture).map(|(corner, residual)| (corner.pixel, *residual)).collect()
}

/// The best adjustment of those started with walls at several distances.
fn best(
    target: &Target<'_>,
    lens: &Lens,
    start: &Initial,
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
                image.iter().flat_map(move |image| {
                    image.corners.iter().enumerate().map(move |(k, (place, pixel))| Corner {
                        picture,
                        view,
                        place: *place,
                        pixel: *pixel,
                        relative_sd: image.relative_sd.get(k).copied().unwrap_or(1.0),
                    })
                })
            })
        })
        .collect();
    let margins: &[f64] = if options.tank.is_some() { &MARGINS_M } else { &[0.0] };
    // From where a mirror beside the tank seems to be; if no search from there ends, from where water puts it.
    let beside = options.tank.is_some_and(|tank| !tank.mirrors_inside);
    let ways: &[Beside] = if beside { &[Beside::AsSeen, Beside::BehindWater] } else { &[Beside::AsSeen] };
    let starts = ways.iter().flat_map(|way| margins.iter().map(move |margin_m| (*way, *margin_m)));
    let mut best: Result<(Solution, Vec<Corner>), RigCalibrationError> = Err(NoSolution::NotConverged.into());
    for (way, margin_m) in starts {
        if way != Beside::AsSeen && best.is_ok() {
            break;
        }
        let (geometry, poses) = first_geometry(lens, start, options, margin_m, way)?;
        let known = known(&geometry, options)?;
        let mut free: Vec<Parameter> = (0..geometry.surfaces.len()).flat_map(Parameter::of_surface).collect();
        let (names, corners) = (names.to_vec(), seen.clone());
        let shape = target.shape;
        let mut bundle = Bundle { geometry, free: free.clone(), poses, names, corners, known, shape };
        for taped in &options.taped {
            if let Some(board) = target.board {
                Taped::new(board, lens, &bundle.geometry, taped)?.add(&mut bundle);
            }
        }
        let (corners, known) = (bundle.corners.clone(), bundle.known.clone());
        bundle.known.extend(held(&bundle.geometry));
        let rough = bundle.search();
        if options.lens_covariance.is_some() {
            free.extend_from_slice(Parameter::of_lens(lens));
        }
        if options.tank.is_some() && options.index_sd.is_some() {
            free.push(Parameter::IndexInside);
        }
        let solved = rough.and_then(|rough| {
            let Bundle { geometry, poses, names, shape, .. } = rough;
            Bundle { geometry, free, poses, names, corners: corners.clone(), known, shape }.solve()
        });
        let cost = |s: &Solution| rms(s.residuals_px.iter().copied());
        match (solved, &best) {
            (Ok(solved), Ok((found, _))) if cost(&solved) >= cost(found) => {}
            (Ok(solved), _) => best = Ok((solved, corners)),
            (Err(why), Err(_)) => best = Err(why.into()),
            (Err(_), Ok(_)) => {}
        }
    }
    best
}

/// The part of a solution that belongs to the rig: taped boards and their views come last.
fn without_taped((whole, corners): &(Solution, Vec<Corner>), start: &Initial) -> (Solution, Vec<Corner>) {
    let (mut solution, pictures) = (whole.clone(), start.pictures.len());
    let corners: Vec<Corner> = corners.iter().filter(|corner| corner.picture < pictures).copied().collect();
    solution.geometry.views.truncate(1 + start.mirrors.len());
    solution.poses.truncate(pictures);
    solution.names.truncate(pictures);
    solution.clusters.truncate(pictures);
    solution.residuals_px.truncate(corners.len());
    solution.known.retain(|known| !matches!(known, Prior::Taped { .. }));
    (solution, corners)
}

/// The rig file with its mirrors, walls and views replaced by the new ones. Its base frame was found with the old ones
/// and is removed, and what is said of how these were found. Bands keep their colours in views of the same name.
pub fn into_draft(mut draft: Draft, done: &RigCalibration) -> Draft {
    let geometry = &done.solution.geometry;
    draft.camera.lens = geometry.lens;
    draft.surfaces = geometry.surfaces.iter().cloned().collect();
    let optics: Vec<OpticalPath> = (0..geometry.views.len()).map(|view| geometry.path(view)).collect();
    let regions = regions(&done.corners, &optics, draft.camera.size_px);
    let views = geometry
        .views
        .iter()
        .zip(optics.into_iter().zip(regions))
        .map(|((name, path), (optics, region_px))| View {
            name: name.clone(),
            path: path.iter().map(|&surface| geometry.surfaces[surface].0.clone()).collect(),
            optics,
            region_px,
            blur_px: draft.views.iter().find(|known| known.name == *name).and_then(|known| known.blur_px),
        })
        .collect();
    draft.set_views(views);
    draft.base = None;
    for step in ["mirror", "base"] {
        draft.provenance.remove(step);
    }
    draft
}
