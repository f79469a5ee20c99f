//! Whether another lens model would fit held-out pictures better.
//!
//! In: boards in pictures. Out: for each [`Model`], the residuals of the corners of held-out pictures.
//!
//! The pictures are split into `FOLDS`, those in which the board lies alike together; each is held out in turn, OpenCV
//! calibrates the lens from the rest, and only the poses of the held-out boards are fitted to their corners. Models
//! with too few or too many parameters leave larger residuals.

use crate::calibrate::board::BoardPicture;
use nalgebra::Point3;
use opencv::calib3d;
use opencv::core::{Mat, MatExprTraitConst, Point2f, Point3f, Size, TermCriteria, TermCriteria_Type, Vector};
use rayon::prelude::*;

const FOLDS: usize = 5;
/// Most steps of a lens's search.
const MAX_STEPS: i32 = 100;
const MIN_STEP: f64 = 1e-9;
/// Another model is better when its residual is below this fraction, smaller for at least half of the pictures, and by
/// that many standard errors in the mean of their logarithms, unless it is far below; one with fewer parameters when
/// that of `own` is not below this fraction of its own.
const BETTER_BELOW: f64 = 0.93;
const FAR_BELOW: f64 = 0.85;
const BETTER_BY_SE: f64 = 2.5;

/// A lens model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Model {
    /// Brown's with five parameters, a rig's default.
    Brown,
    /// OpenCV's rational one with eight, which a rig can also have.
    Rational,
    /// OpenCV's fisheye, Kannala and Brandt's with four.
    Fisheye,
}

impl std::fmt::Display for Model {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Brown => "the five-parameter model",
            Self::Rational => "the rational model with eight parameters",
            Self::Fisheye => "the fisheye model",
        })
    }
}

/// The model that fits held-out pictures clearly better than `own`, or with fewer parameters hardly worse: RMS of a
/// coordinate with `own` and with it, pixels. `clusters`: for each picture, the number of its cluster.
pub(crate) fn better(
    places: &[Point3<f64>],
    used: &[&BoardPicture],
    clusters: &[usize],
    size_px: [u32; 2],
    own: Model,
) -> Option<(Model, f64, f64)> {
    let others = [Model::Brown, Model::Rational, Model::Fisheye].into_iter().filter(|model| *model != own);
    let models: Vec<Model> = std::iter::once(own).chain(others).collect();
    let found: Vec<Option<Vec<f64>>> =
        models.par_iter().map(|model| held_out(places, used, clusters, size_px, *model).ok()).collect();
    let [Some(by_own), others @ ..] = found.as_slice() else { return None };
    let rms = |each: &[f64]| (each.iter().map(|e| e * e).sum::<f64>() / each.len().max(1) as f64).sqrt();
    let clearly = |model: Model, each: &[f64]| {
        if model == Model::Brown && own == Model::Rational {
            return rms(by_own) > BETTER_BELOW * rms(each);
        }
        let closer = each.iter().zip(by_own).filter(|(other, own)| other < own).count();
        let gains: Vec<f64> = each.iter().zip(by_own).map(|(other, own)| (own / other).ln()).collect();
        let part = rms(each) / rms(by_own);
        part < BETTER_BELOW && 2 * closer >= by_own.len() && (part < FAR_BELOW || is_clear(&gains))
    };
    let others = models.into_iter().skip(1).zip(others).filter_map(|(model, each)| Some((model, each.as_ref()?)));
    let better = others.filter(|(model, each)| clearly(*model, each)).min_by(|a, b| rms(a.1).total_cmp(&rms(b.1)))?;
    Some((better.0, rms(by_own), rms(better.1)))
}

/// Whether the mean gain is more than its scatter over pictures explains.
fn is_clear(gains: &[f64]) -> bool {
    let count = gains.len() as f64;
    let mean = gains.iter().sum::<f64>() / count;
    let variance = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (count - 1.0);
    mean > BETTER_BY_SE * (variance / count).sqrt()
}

/// RMS of a coordinate in each picture when held out, in the order of the folds.
fn held_out(
    places: &[Point3<f64>],
    used: &[&BoardPicture],
    clusters: &[usize],
    size_px: [u32; 2],
    model: Model,
) -> opencv::Result<Vec<f64>> {
    let boards: Vec<_> = used.iter().map(|picture| opencv_points(places, picture)).collect();
    let mut all = Vec::with_capacity(boards.len());
    for fold in 0..FOLDS {
        let (mut objects, mut images) = (Vector::<Vector<Point3f>>::new(), Vector::<Vector<Point2f>>::new());
        for (_, (object, image)) in clusters.iter().zip(&boards).filter(|(cluster, _)| *cluster % FOLDS != fold) {
            objects.push(object.clone());
            images.push(image.clone());
        }
        let lens = Found::of(model, &objects, &images, size_px)?;
        for (_, (object, image)) in clusters.iter().zip(&boards).filter(|(cluster, _)| *cluster % FOLDS == fold) {
            all.push(lens.left_px(object, image)?);
        }
    }
    Ok(all)
}

/// The corners that a picture shows, on its board and in the picture.
pub(super) fn opencv_points(places: &[Point3<f64>], picture: &BoardPicture) -> (Vector<Point3f>, Vector<Point2f>) {
    let seen = || picture.image.corners.iter().filter_map(|(i, pixel)| Some((places.get(*i)?, pixel)));
    let place = |(p, _): (&Point3<f64>, _)| Point3f::new(p.x as f32, p.y as f32, p.z as f32);
    (seen().map(place).collect(), seen().map(|(_, p)| Point2f::new(p.x as f32, p.y as f32)).collect())
}

/// OpenCV's flags for one model or the other. By singular values, its default, each step takes several times as long
/// as by LU.
pub(super) fn opencv_flags(is_rational: bool) -> i32 {
    calib3d::CALIB_USE_LU | if is_rational { calib3d::CALIB_RATIONAL_MODEL } else { 0 }
}

/// A lens in OpenCV's form.
struct Found {
    model: Model,
    matrix: Mat,
    distortion: Mat,
}

impl Found {
    fn of(
        model: Model,
        objects: &Vector<Vector<Point3f>>,
        images: &Vector<Vector<Point2f>>,
        size_px: [u32; 2],
    ) -> opencv::Result<Self> {
        let (mut matrix, mut distortion) = (Mat::default(), Mat::default());
        let (mut turns, mut shifts) = (Vector::<Mat>::new(), Vector::<Mat>::new());
        let size = Size::new(size_px[0] as i32, size_px[1] as i32);
        let end = TermCriteria {
            typ: TermCriteria_Type::COUNT as i32 + TermCriteria_Type::EPS as i32,
            max_count: MAX_STEPS,
            epsilon: MIN_STEP,
        };
        let (k, d) = (&mut matrix, &mut distortion);
        match model {
            Model::Fisheye => {
                let flags = calib3d::Fisheye_CALIB_RECOMPUTE_EXTRINSIC | calib3d::Fisheye_CALIB_FIX_SKEW;
                calib3d::calibrate(objects, images, size, k, d, &mut turns, &mut shifts, flags, end)?
            }
            Model::Brown | Model::Rational => {
                let flags = opencv_flags(model == Model::Rational);
                calib3d::calibrate_camera(objects, images, size, k, d, &mut turns, &mut shifts, flags, end)?
            }
        };
        Ok(Self { model, matrix, distortion })
    }

    /// RMS of a coordinate of a board whose pose is fitted.
    fn left_px(&self, object: &Vector<Point3f>, image: &Vector<Point2f>) -> opencv::Result<f64> {
        let (mut turn, mut shift) = (Mat::default(), Mat::default());
        let mut there = Vector::<Point2f>::new();
        let (k, d) = (&self.matrix, &self.distortion);
        if self.model == Model::Fisheye {
            let mut straight = Vector::<Point2f>::new();
            calib3d::fisheye_undistort_points_def(image, &mut straight, k, d)?;
            let unit = Mat::eye(3, 3, opencv::core::CV_64F)?.to_mat()?;
            calib3d::solve_pnp_def(object, &straight, &unit, &Mat::default(), &mut turn, &mut shift)?;
            calib3d::fisheye_project_points_vec_def(object, &mut there, &turn, &shift, k, d)?;
        } else {
            calib3d::solve_pnp_def(object, image, k, d, &mut turn, &mut shift)?;
            calib3d::project_points_def(object, &turn, &shift, k, d, &mut there)?;
        }
        let square = |(a, b): (Point2f, Point2f)| f64::from(a.x - b.x).powi(2) + f64::from(a.y - b.y).powi(2);
        let sum: f64 = image.iter().zip(there.iter()).map(square).sum();
        // Each picture has six pose parameters.
        Ok((sum / (2.0 * image.len() as f64 - 6.0).max(1.0)).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gain_of_one_picture_is_no_gain() {
        assert!(is_clear(&[1.0, 1.2, 0.9, 1.1, 0.8, 1.0]));
        assert!(!is_clear(&[0.0, 0.1, -0.1, 0.0, 6.0, 0.1]));
        // Not known.
        assert!(!is_clear(&[1.0]) && !is_clear(&[]));
    }
}
