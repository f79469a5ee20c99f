//! `catoptra calibrate camera`: the lens from pictures of a board in air.
//!
//! In: the corners of a board in pictures without mirror and water. Out: the lens with its covariance, and each
//! picture's residuals.
//!
//! OpenCV's `calibrateCamera` gives the start; the solution and its covariance come from our own bundle adjustment
//! (OpenCV's standard deviations are wrong in older versions). A picture whose corners fit much worse than those of the
//! others, or that was taken with another lens, is left out, with the reason. Sets that do not determine the lens are
//! refused: too few pictures, all boards parallel.
//!
//! Remaining doubts about the lens are among its [`diagnostics`].
//!
//! Cannot detect: squares of another size than stated (the lens does not depend on it, distances do).

mod changed;
pub mod diagnostics;
pub mod models;
#[cfg(test)]
mod real_boards;
pub mod turn;
mod turned;
mod two_lenses;

use crate::calibrate::board::{Board, BoardImage, BoardPicture};
use crate::calibrate::bundle::outliers::{LeftOut, UsedPicture, left_out_lines, worst_picture};
use crate::calibrate::bundle::pose::{pose_from_opencv, spread_rad};
use crate::calibrate::bundle::shape::{PRINT, Shape};
use crate::calibrate::bundle::{Bundle, Corner, NoSolution, Solution};
use crate::calibrate::geometry::{Geometry, Parameter};
use crate::optics::Lens;
use crate::plural::plural;
use changed::{Changed, changed};
use diagnostics::CameraDiagnostic;
use models::Model;
use nalgebra::{DMatrix, DVector, Isometry3, Point2, Point3, Vector2};
use opencv::calib3d;
use opencv::core::{Mat, MatTraitConst, Point2f, Point3f, Size, TermCriteria, TermCriteria_Type, Vector};
use turned::turned;
use two_lenses::{TwoLenses, before_and_after, in_any_order};

/// Fewest pictures: three boards at different tilts determine a lens without distortion; with it, five are the minimum.
const FEWEST_PICTURES: usize = 5;
/// Boards that all differ less in direction leave the focal length undetermined.
const MIN_TILT_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// A focal length with a larger relative σ counts as unknown.
const MIN_KNOWN: f64 = 0.02;

/// Number of distortion coefficients of a lens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LensModel {
    /// k1, k2, p1, p2, k3.
    #[default]
    Five,
    /// The same and k4, k5, k6 of the rational model: for wide angles, with boards reaching the corners.
    Eight,
}

impl LensModel {
    fn coefficients(self) -> usize {
        match self {
            Self::Five => 5,
            Self::Eight => 8,
        }
    }

    /// Focal length and principal point, and the coefficients.
    fn parameters(self) -> Vec<Parameter> {
        Parameter::LENS.into_iter().take(4 + self.coefficients()).collect()
    }
}

/// The lens and its uncertainty.
#[derive(Debug, Clone)]
pub struct CameraCalibration {
    /// Size of the pictures, pixels.
    pub size_px: [u32; 2],
    /// The lens.
    pub lens: Lens,
    /// Covariance of fx, fy, cx, cy, k1, k2, p1, p2, k3, and k4, k5, k6 of a rational lens.
    pub covariance: DMatrix<f64>,
    /// The covariance for independent corners: the part of noise. The rest comes from the model.
    pub noise_covariance: DMatrix<f64>,
    /// Ratio of the variance to that of independent corners, over all parameters; 1 or more.
    pub design_effect: f64,
    /// Noise of one coordinate of a corner, pixels.
    pub corner_sd_px: f64,
    /// The board's shape, and the covariance of its parameters; lengths in metres.
    pub shape: Shape,
    /// See `shape`.
    pub shape_covariance: DMatrix<f64>,
    /// For each picture used: its name, the board's pose (camera_from_board, origin at the board's centre), each
    /// corner's position in the picture and its residual, pixels.
    pub used: Vec<UsedPicture>,
    /// Pictures left out, and why.
    pub left_out: Vec<(String, LeftOut)>,
    /// Reasons to doubt the lens.
    pub diagnostics: Vec<CameraDiagnostic>,
}

impl CameraCalibration {
    /// σ of the stretch of the board's print.
    pub fn stretch_sd(&self) -> f64 {
        self.shape_covariance[(PRINT, PRINT)].sqrt()
    }
}

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// Pictures of several sizes.
    #[error(
        "{name}{} has {}x{} pixels, {first} has {}x{}: all pictures must come from the camera as it will be used, and \
         as it stored them, neither resized nor turned{}", others(.alike), found[0], found[1], expected[0], expected[1],
        if found[0] == expected[1] && found[1] == expected[0] { " by a viewer or a converter" } else { "" }
    )]
    Sizes {
        /// A picture.
        name: String,
        /// Other pictures of this size.
        alike: Vec<String>,
        /// Its size.
        found: [u32; 2],
        /// The first picture.
        first: String,
        /// Its size.
        expected: [u32; 2],
    },
    /// Too few pictures with a board.
    #[error(
        "the board was found in {}, at least {FEWEST_PICTURES} are needed, 10 to 20 are good{}",
        plural(*.found, "different picture"), left_out_lines(.left_out)
    )]
    TooFew {
        /// How many.
        found: usize,
        /// Those left out, and why.
        left_out: Vec<(String, LeftOut)>,
    },
    /// Too few places of the board.
    #[error(
        "in {used} pictures the board lies in only {found} clearly different places: at least {FEWEST_PICTURES} are \
         needed, 10 to 20 are good; move and tilt it by more than a square from one picture to the next"
    )]
    Alike {
        /// Pictures.
        used: usize,
        /// Different places and tilts.
        found: usize,
    },
    /// All boards are parallel.
    #[error(
        "all boards are within {spread_deg:.0}° of parallel: the focal length cannot be told from the distance; tilt \
         the board by 30° and more, to all sides"
    )]
    Parallel {
        /// Largest angle between two boards.
        spread_deg: f64,
    },
    /// The pictures do not determine the lens.
    #[error(
        "the pictures leave the focal length open by {sd_px:.0} px of {focal_px:.0}: tilt the board more, fill the \
         picture; a wide angle may want --lens 8"
    )]
    Open {
        /// Standard deviation.
        sd_px: f64,
        /// Value.
        focal_px: f64,
    },
    /// Eight coefficients of distortion are too many.
    #[error(
        "the pictures determine five coefficients of distortion, but not eight ({0}): calibrate with --lens 5; a wide \
         angle needs boards out to the corners"
    )]
    Eight(NoSolution),
    /// OpenCV failed.
    #[error("no initial estimate of the lens: {0}")]
    Start(#[from] opencv::Error),
    /// The adjustment failed.
    #[error(
        "the pictures do not determine the lens ({0}): tilt the board more, to all sides, and fill the picture with it"
    )]
    Solve(#[from] NoSolution),
}

/// Further names, in brackets.
fn others(names: &[String]) -> String {
    if names.is_empty() { String::new() } else { format!(" (like {})", names.join(", ")) }
}

/// Calibrates the lens.
///
/// # Errors
/// [`CameraError`] when the pictures are inconsistent or do not determine the lens.
pub fn calibrate_camera(
    board: &Board,
    pictures: &[BoardPicture],
    model: LensModel,
) -> Result<CameraCalibration, CameraError> {
    let first = pictures.first().ok_or(CameraError::TooFew { found: 0, left_out: Vec::new() })?;
    if let Some(other) = pictures.iter().find(|p| p.size_px != first.size_px) {
        return Err(CameraError::Sizes {
            name: other.name.clone(),
            alike: pictures
                .iter()
                .filter(|p| p.size_px == other.size_px && p.name != other.name)
                .map(|p| p.name.clone())
                .collect(),
            found: other.size_px,
            first: first.name.clone(),
            expected: first.size_px,
        });
    }
    let (mut used, mut left_out) = usable(pictures);
    loop {
        if used.len() < FEWEST_PICTURES {
            return Err(CameraError::TooFew { found: used.len(), left_out });
        }
        let adjusted = |model| adjust(board, &used, first.size_px, model);
        let (even, corners) = adjusted(model).map_err(|why| match why {
            CameraError::Solve(why) if model == LensModel::Eight && adjusted(LensModel::Five).is_ok() => {
                CameraError::Eight(why)
            }
            why => why,
        })?;
        if even.parts.len() < FEWEST_PICTURES {
            return Err(CameraError::Alike { used: used.len(), found: even.parts.len() });
        }
        let all: Vec<usize> = (0..used.len()).collect();
        let uneven = Bundle { shape: even.shape.that_may_be_uneven(), ..even.of_pictures(&all, &corners) }.solve();
        let is_open = uneven.is_err();
        let solved = uneven.unwrap_or_else(|_| even.clone());
        let of_pictures = by_picture(&solved, &used);
        let lenses = match worst_picture(&of_pictures) {
            Some(worst) => Err(worst),
            None => lenses(board, &solved, &even, &corners, first.size_px),
        };
        let (worst, off) = match lenses {
            Err(worst) => worst,
            Ok(two) => {
                // An uneven print makes up for two lenses: where there are two, it is not known.
                let (solved, of_pictures) = match two {
                    Some(_) => (even.clone(), by_picture(&even, &used)),
                    None => (solved, of_pictures),
                };
                let mut done = conclude(&solved, of_pictures, left_out, first.size_px)?;
                if let Some(two) = &two {
                    widen(&mut done, two);
                }
                done.diagnostics = diagnose(board, &used, &done, &solved, two);
                done.diagnostics.extend(is_open.then_some(CameraDiagnostic::TakenForEven));
                return Ok(done);
            }
        };
        let name = used.remove(worst).name.clone();
        // What was left out because it shows the same is judged in its place.
        let same = LeftOut::Duplicate(name.clone());
        let again = left_out.iter().position(|(_, why)| *why == same);
        if let Some((other, _)) = again.map(|at| left_out.remove(at)) {
            for (_, why) in left_out.iter_mut().filter(|(_, why)| *why == same) {
                *why = LeftOut::Duplicate(other.clone());
            }
            if let Some(other) = pictures.iter().find(|picture| picture.name == other) {
                used.insert(worst, other);
            }
        }
        left_out.push((name, off));
    }
}

/// All pictures except those that are blurred or duplicate an earlier one.
fn usable(pictures: &[BoardPicture]) -> (Vec<&BoardPicture>, Vec<(String, LeftOut)>) {
    let (mut used, mut left_out): (Vec<&BoardPicture>, _) = (Vec::new(), Vec::new());
    for picture in pictures {
        let BoardImage { edge_px, square_px, .. } = picture.image;
        let same = used.iter().find(|other| other.image.is_same_as(&picture.image)).map(|other| other.name.clone());
        match same {
            _ if picture.image.is_blurred() => {
                left_out.push((picture.name.clone(), LeftOut::Blurred { edge_px, square_px }))
            }
            _ if picture.image.mirrored == Some(true) => left_out.push((picture.name.clone(), LeftOut::Mirrored)),
            Some(other) => left_out.push((picture.name.clone(), LeftOut::Duplicate(other))),
            None => used.push(picture),
        }
    }
    (used, left_out)
}

/// Groups of pictures with different lenses, those for which there is most evidence; as an error, the one picture that
/// has another lens, which is to be left out.
fn lenses(
    board: &Board,
    solved: &Solution,
    even: &Solution,
    corners: &[Corner],
    size_px: [u32; 2],
) -> Result<Option<TwoLenses>, (usize, LeftOut)> {
    let found = [turned(board, solved, even, corners, size_px), in_any_order(solved, even, corners)];
    let most = found.into_iter().flatten().max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, two)| two);
    if let Some(turned) = most.as_ref().filter(|two| two.turn.is_some()) {
        return Ok(Some(turned.clone()));
    }
    let changed = changed(even, corners);
    // With a single picture of another lens, many splits in two seem to have two: then the others have one.
    let is_alone = |others: &[usize]| {
        most.is_none() || {
            let others = even.of_pictures(others, corners);
            others.clone().solve().is_ok_and(|solved| in_any_order(&solved, &solved, &others.corners).is_none())
        }
    };
    if let Some(Changed { groups: [single, others], chance, is_single: true, .. }) = &changed
        && let Some(picture) = single.first()
        && is_alone(others)
    {
        return Err((*picture, LeftOut::OtherLens { chance: *chance }));
    }
    let changed = changed.filter(|changed| !changed.is_single);
    let by_order = changed.map(|Changed { groups, lenses, .. }| TwoLenses { groups, lenses, turn: None });
    Ok(most.or_else(|| before_and_after(even, corners)).or(by_order))
}

/// Where pictures have two lenses, the one found is neither: its error is about its distance from them.
fn widen(done: &mut CameraCalibration, two: &TwoLenses) {
    let values = |lens: Lens| {
        let geometry = Geometry { lens, surfaces: Vec::new(), views: Vec::new() };
        let of_lens = Parameter::of_lens(&lens);
        DVector::from_iterator(of_lens.len(), of_lens.iter().map(|p| geometry.value(*p)))
    };
    for lens in two.lenses {
        let off = values(lens) - values(done.lens);
        done.covariance += &off * off.transpose() / two.lenses.len() as f64;
    }
}

/// The most serious first.
fn diagnose(
    board: &Board,
    used: &[&BoardPicture],
    done: &CameraCalibration,
    solved: &Solution,
    two: Option<TwoLenses>,
) -> Vec<CameraDiagnostic> {
    let places = board.centred_points();
    let mut all = Vec::new();
    match two {
        Some(TwoLenses { groups, lenses: [a, b], turn }) => {
            let smaller = usize::from(groups[1].len() < groups[0].len());
            let names = groups[smaller].iter().filter_map(|i| solved.names.get(*i).cloned()).collect();
            all.push(CameraDiagnostic::TwoLenses { names, lenses: if smaller == 0 { [a, b] } else { [b, a] }, turn });
        }
        // With two lenses no model is right.
        None => {
            let own = if done.lens.is_rational() { Model::Rational } else { Model::Brown };
            if let Some((model, own_px, other_px)) = models::better(&places, used, &solved.clusters, done.size_px, own)
            {
                all.push(CameraDiagnostic::Model { model, own, own_px, other_px });
            }
        }
    }
    all.extend(diagnostics::diagnose(done, &places));
    all
}

/// With a print that is taken to be even.
fn adjust(
    board: &Board,
    used: &[&BoardPicture],
    size_px: [u32; 2],
    model: LensModel,
) -> Result<(Solution, Vec<Corner>), CameraError> {
    let places = board.centred_points();
    let corners: Vec<Corner> = used
        .iter()
        .enumerate()
        .flat_map(|(picture, p)| p.image.corners.iter().map(move |(i, pixel)| (picture, *i, *pixel)))
        .filter_map(|(picture, i, pixel)| {
            Some(Corner { picture, view: 0, place: *places.get(i)?, pixel, relative_sd: 1.0 })
        })
        .collect();
    let bundle = |start_model: LensModel, free: Vec<Parameter>| -> Result<Bundle, CameraError> {
        let (lens, poses) = start(&places, used, size_px, start_model)?;
        let spread = spread_rad(&poses);
        if spread < MIN_TILT_RAD {
            return Err(CameraError::Parallel { spread_deg: spread.to_degrees() });
        }
        let geometry = Geometry { lens, surfaces: Vec::new(), views: vec![("air".to_owned(), Vec::new())] };
        let names = used.iter().map(|picture| picture.name.clone()).collect();
        let shape = Shape::flat(&places);
        Ok(Bundle { geometry, free, poses, names, corners: corners.clone(), known: Vec::new(), shape })
    };
    let solved = match bundle(model, model.parameters())?.solve() {
        // OpenCV's rational lens may fold, or have a pole, just where the boards end: it is one of many that fit as
        // well. With k4 alone there is one, and it is smooth there.
        Err(NoSolution::NotSeen { .. }) if model == LensModel::Eight => {
            let smooth = Parameter::LENS.into_iter().take(10).collect();
            let smooth = bundle(LensModel::Five, smooth)?.search()?;
            Bundle { free: model.parameters(), ..smooth }.solve()?
        }
        solved => solved?,
    };
    Ok((solved, corners))
}

/// OpenCV's solution, as the start.
fn start(
    places: &[Point3<f64>],
    used: &[&BoardPicture],
    size_px: [u32; 2],
    model: LensModel,
) -> Result<(Lens, Vec<Isometry3<f64>>), CameraError> {
    let (mut objects, mut images) = (Vector::<Vector<Point3f>>::new(), Vector::<Vector<Point2f>>::new());
    for picture in used {
        let (object, image) = models::opencv_points(places, picture);
        objects.push(object);
        images.push(image);
    }
    let (mut matrix, mut distortion) = (Mat::default(), Mat::default());
    let (mut turns, mut shifts) = (Vector::<Mat>::new(), Vector::<Mat>::new());
    let size = Size::new(size_px[0] as i32, size_px[1] as i32);
    let flags = models::opencv_flags(model == LensModel::Eight);
    let end = TermCriteria {
        typ: TermCriteria_Type::COUNT as i32 + TermCriteria_Type::EPS as i32,
        max_count: 30,
        epsilon: f64::EPSILON,
    };
    let (k, d) = (&mut matrix, &mut distortion);
    calib3d::calibrate_camera(&objects, &images, size, k, d, &mut turns, &mut shifts, flags, end)?;
    let at = |row, column| matrix.at_2d::<f64>(row, column).copied();
    let mut lens = Lens {
        focal_px: Vector2::new(at(0, 0)?, at(1, 1)?),
        principal_point_px: Point2::new(at(0, 2)?, at(1, 2)?),
        distortion: [0.0; 5],
        denominator: [0.0; 3],
    };
    let coefficients = lens.distortion.iter_mut().chain(&mut lens.denominator).take(model.coefficients());
    for (i, to) in coefficients.enumerate() {
        *to = *distortion.at::<f64>(i as i32)?;
    }
    let poses = turns
        .iter()
        .zip(&shifts)
        .map(|(turn, shift)| pose_from_opencv(&turn, &shift))
        .collect::<opencv::Result<_>>()?;
    Ok((lens, poses))
}

fn by_picture(solved: &Solution, used: &[&BoardPicture]) -> Vec<UsedPicture> {
    let mut residuals = solved.residuals_px.iter();
    used.iter()
        .zip(&solved.poses)
        .map(|(picture, pose)| {
            let corners = picture.image.corners.iter().zip(residuals.by_ref()).map(|(c, r)| (c.1, *r)).collect();
            UsedPicture { name: picture.name.clone(), pose: *pose, corners }
        })
        .collect()
}

fn conclude(
    solved: &Solution,
    used: Vec<UsedPicture>,
    left_out: Vec<(String, LeftOut)>,
    size_px: [u32; 2],
) -> Result<CameraCalibration, CameraError> {
    for axis in 0..2 {
        let (sd_px, focal_px) = (solved.covariance[(axis, axis)].sqrt(), solved.geometry.lens.focal_px[axis]);
        if sd_px.is_nan() || sd_px > MIN_KNOWN * focal_px {
            return Err(CameraError::Open { sd_px, focal_px });
        }
    }
    Ok(CameraCalibration {
        size_px,
        lens: solved.geometry.lens,
        covariance: solved.covariance.clone(),
        noise_covariance: solved.noise_covariance.clone(),
        design_effect: solved.design_effect,
        corner_sd_px: solved.corner_sd_px,
        shape: solved.shape,
        shape_covariance: solved.shape_covariance.clone(),
        used,
        left_out,
        diagnostics: Vec::new(),
    })
}
