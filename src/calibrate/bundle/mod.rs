//! Bundle adjustment: the geometry and the poses of the board that best fit all corners of all pictures.
//!
//! In: an initial state, detected corners, priors. Out: [`Solution`] with the geometry's covariance and the residual of
//! every corner.
//!
//! Minimised is Σ ρ(|corner − projection| / σ) + w Σ ((known − value)/sd)², ρ Huber's (`least_squares.rs`): the
//! geometry is shared by all pictures, and so is the board's shape (`shape.rs`), the six parameters of its pose belong
//! to one picture each. σ, the noise of a corner, is estimated from the corners themselves and the whole repeated.
//! Last, the board's print is held where it is believed to be (`print.rs`).
//!
//! The covariance of the geometry has all poses free. It assumes that errors of pictures are independent, but not those
//! of the corners within one, nor of pictures in which the board lies alike (`clusters.rs`): a board that is not quite
//! flat, blur and an imperfect lens model correlate them. Where such errors make the pictures less informative than the
//! noise of their corners suggests, the priors get correspondingly more weight, and the whole is repeated.

pub(crate) mod clusters;
pub(crate) mod outliers;
pub(crate) mod pose;
mod print;
pub(crate) mod prior;
pub(crate) mod shape;

use crate::calibrate::bundle::clusters::{Clustered, Part, alike};
use crate::calibrate::bundle::prior::{Equation, Prior};
use crate::calibrate::geometry::{Geometry, Parameter, Projector};
use crate::calibrate::least_squares::{End, Equations, Loss, Observations, Row, SearchError, Step, minimise};
use crate::median::upper_median;
use crate::optics::NoRay;
use nalgebra::{DMatrix, DVector, Isometry3, Point2, Point3, Vector2, Vector3};
use pose::{by_pose, turned};
use print::Believed;
use shape::Shape;

/// Corners further off than this many σ are not used to estimate σ.
const OUTLIER: f64 = 4.0;
/// Noise assumed initially, pixels, and the least ever assumed (synthetic corners have none).
const START_SD_PX: f64 = 0.5;
const MIN_SD_PX: f64 = 1e-6;
const MAX_ROUNDS: usize = 6;
/// Rounds end when noise and weight of the priors change by less than these fractions.
const ROUND_TOLERANCE: (f64, f64) = (0.01, 0.1);
/// End of a round.
const END: End = End { tolerance: (1e-9, 1e-9), max_steps: 200 };
/// End of a round with a rational lens: its numerator and denominator trade off along a long flat valley. The remaining
/// distance is a thousandth of σ.
const RATIONAL_END: End = End { tolerance: (1e-7, 1e-6), max_steps: 2000 };

/// A corner of the board in a view of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    /// Index of the picture, and so of the pose.
    pub picture: usize,
    /// Index of the view.
    pub view: usize,
    /// The corner, board frame, metres; the board's frame is best placed at its centre.
    pub place: Point3<f64>,
    /// Its detected position.
    pub pixel: Point2<f64>,
    /// σ of its coordinates over [`Solution::corner_sd_px`]: 1 if all corners are equally accurate.
    pub relative_sd: f64,
}

/// The problem, and the start of the search.
#[derive(Debug, Clone)]
pub(crate) struct Bundle {
    /// Lens, surfaces, views.
    pub geometry: Geometry,
    /// Free parameters of the geometry.
    pub free: Vec<Parameter>,
    /// For each picture, camera_from_board.
    pub poses: Vec<Isometry3<f64>>,
    /// For each picture, its name in messages.
    pub names: Vec<String>,
    /// All corners.
    pub corners: Vec<Corner>,
    /// Priors.
    pub known: Vec<Prior>,
    /// The board's shape, found with the rest.
    pub shape: Shape,
}

/// The solution.
#[derive(Debug, Clone)]
pub struct Solution {
    /// Lens, surfaces, views.
    pub geometry: Geometry,
    /// Free parameters of the geometry, in the order of the covariance.
    pub free: Vec<Parameter>,
    /// Covariance of `free`; tilts are about [`super::geometry::tilt_axes`] of the solved surfaces.
    pub covariance: DMatrix<f64>,
    /// The covariance for independent corners: the part of noise. The rest comes from the model.
    pub noise_covariance: DMatrix<f64>,
    /// The covariance according to the search, with pictures and priors weighted as they were.
    pub(crate) weighted_covariance: DMatrix<f64>,
    /// For each picture, its cluster: those in which the board lies alike, see [`clusters::alike`].
    pub(crate) clusters: Vec<usize>,
    /// For each cluster, what it says of the unknowns, see [`Clustered::parts`].
    pub(crate) parts: Vec<Part>,
    /// See [`Clustered::whitening`].
    pub(crate) whitening: DMatrix<f64>,
    /// Ratio of the variance to that of independent corners, over all directions of the parameters; 1 or more.
    pub design_effect: f64,
    /// For each picture, camera_from_board.
    pub poses: Vec<Isometry3<f64>>,
    /// For each picture, its name in messages.
    pub names: Vec<String>,
    /// For each corner, found − projected, pixels.
    pub residuals_px: Vec<Vector2<f64>>,
    /// Noise of one coordinate of a corner, pixels.
    pub corner_sd_px: f64,
    /// Priors that were used.
    pub known: Vec<Prior>,
    /// The board's shape.
    pub shape: Shape,
    /// Covariance of all its parameters.
    pub shape_covariance: DMatrix<f64>,
}

/// Why there is no solution.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoSolution {
    /// The initial state does not show a corner.
    #[error("the board cannot be seen in {picture}, {why}")]
    NotSeen {
        /// The picture's name.
        picture: String,
        /// Why.
        why: NoRay,
    },
    /// The corners leave a direction undetermined.
    #[error("the pictures do not determine the solution")]
    Singular,
    /// The search did not converge.
    #[error("the search did not converge")]
    NotConverged,
}

/// State of the search.
#[derive(Clone)]
struct State {
    geometry: Geometry,
    poses: Vec<Isometry3<f64>>,
    shape: Shape,
    /// The board's print, if it is held.
    held: Option<[f64; shape::PRINTS]>,
}

impl Bundle {
    /// Solves, starting from `self`.
    ///
    /// # Errors
    /// [`NoSolution`] when the initial state does not show the board, or the pictures do not determine the geometry.
    pub(crate) fn solve(self) -> Result<Solution, NoSolution> {
        let (mut at, mut sd_px) = self.searched(START_SD_PX, 1.0, self.start())?;
        let mut known = self.clustered(&at, sd_px, 1.0)?;
        let mut prior_weight = 1.0;
        for _ in 0..MAX_ROUNDS {
            if self.known.is_empty() || (known.design_effect / prior_weight - 1.0).abs() < ROUND_TOLERANCE.1 {
                break;
            }
            // If another weight fails, the current solution stands: its covariance holds for any weight.
            let weight = known.design_effect;
            let Ok((next, next_sd_px)) = self.searched(sd_px, weight, at.clone()) else { break };
            let Ok(next_known) = self.clustered(&next, next_sd_px, weight) else { break };
            (at, sd_px, known, prior_weight) = (next, next_sd_px, next_known, weight);
        }
        // The board's shape comes last.
        let free = self.free.len();
        if let Some(held) = self.held(&at, sd_px, &known, prior_weight) {
            (at, sd_px, known) = held;
        }
        let of_free = |all: &DMatrix<f64>| all.view((0, 0), (free, free)).into_owned();
        Ok(Solution {
            covariance: of_free(&known.covariance),
            noise_covariance: of_free(&known.noise),
            weighted_covariance: of_free(&known.weighted),
            shape: at.shape,
            shape_covariance: known.covariance.view((free, free), (shape::PARAMETERS, shape::PARAMETERS)).into_owned(),
            clusters: known.clusters,
            parts: known.parts,
            whitening: known.whitening,
            design_effect: known.design_effect,
            residuals_px: self.residuals_px(&at)?,
            corner_sd_px: sd_px,
            geometry: at.geometry,
            poses: at.poses,
            free: self.free,
            names: self.names,
            known: self.known,
        })
    }

    /// With the print as it is believed to be: the state, the noise of a corner, and the uncertainty. `None` for a
    /// rigid set of points, or if the search fails: the solution with the print as found stands, its σ holds.
    fn held(&self, at: &State, sd_px: f64, found: &Clustered, prior_weight: f64) -> Option<(State, f64, Clustered)> {
        if at.shape.is_rigid() {
            return None;
        }
        let print = Believed::of(found, &at.shape, self.free.len())?;
        // Of everything else, the uncertainty where it fits best: what is not believed of the print is no error of the
        // pictures. A print that was free has made them fit better than they should.
        let mut held = State { held: Some(at.shape.print()), ..at.clone() };
        let mut known = self.clustered(&held, sd_px, prior_weight).ok()?;
        known.covariance *= (found.design_effect / known.design_effect).max(1.0);
        held.held = Some(print.print);
        let (next, sd_px) = self.searched(sd_px, prior_weight, held).ok()?;
        // The print is none of the noise of single corners.
        known.covariance += &print.covariance;
        known.weighted += &print.covariance;
        Some((next, sd_px, known))
    }

    /// As [`Self::solve`], without covariances: the end of the search, as the start of another.
    ///
    /// # Errors
    /// As [`Self::solve`].
    pub(crate) fn search(self) -> Result<Self, NoSolution> {
        let (State { geometry, poses, shape, .. }, _) = self.searched(START_SD_PX, 1.0, self.start())?;
        Ok(Self { geometry, poses, shape, ..self })
    }

    /// Found − projected in the state of `self`, for each corner.
    pub(crate) fn left_px(&self) -> Result<Vec<Vector2<f64>>, NoSolution> {
        self.residuals_px(&self.start())
    }

    fn start(&self) -> State {
        State { geometry: self.geometry.clone(), poses: self.poses.clone(), shape: self.shape, held: None }
    }

    /// The minimum cost, and the noise of a corner there; `sd_px` is the noise assumed initially.
    fn searched(&self, mut sd_px: f64, prior_weight: f64, mut at: State) -> Result<(State, f64), NoSolution> {
        let becomes_rational = self.free.iter().any(|parameter| matches!(parameter, Parameter::Denominator(_)));
        let end = if self.geometry.lens.is_rational() || becomes_rational { RATIONAL_END } else { END };
        for _ in 0..=MAX_ROUNDS {
            let equations = |at: &State| self.equations(at, sd_px, prior_weight);
            (at, _) = minimise(end, at, equations, |at, step| Ok(self.stepped(at, step)))?;
            let found = self.noise(&self.residuals_px(&at)?, at.shape.is_rigid());
            let converged = (found / sd_px - 1.0).abs() < ROUND_TOLERANCE.0 || found == MIN_SD_PX;
            sd_px = found;
            if converged {
                break;
            }
        }
        Ok((at, sd_px))
    }

    fn clustered(&self, at: &State, sd_px: f64, prior_weight: f64) -> Result<Clustered, NoSolution> {
        let equations = self.equations(at, sd_px, prior_weight)?;
        Clustered::of(&equations, &self.clusters(at), prior_weight).ok_or(NoSolution::Singular)
    }

    fn clusters(&self, at: &State) -> Vec<usize> {
        alike(&at.poses, self.corners.iter().map(|corner| corner.place))
    }

    fn stepped(&self, at: &State, step: &Step) -> State {
        let pose = |(pose, own): (&Isometry3<f64>, &DVector<f64>)| turned(pose, &own.fixed_rows::<6>(0).into_owned());
        let (by_geometry, by_shape) = step.shared.as_slice().split_at(self.free.len());
        State {
            geometry: at.geometry.stepped(&self.free, by_geometry),
            poses: at.poses.iter().zip(&step.own).map(pose).collect(),
            shape: at.shape.stepped(by_shape),
            held: at.held,
        }
    }

    fn residuals_px(&self, at: &State) -> Result<Vec<Vector2<f64>>, NoSolution> {
        let projector = Projector::new(&at.geometry, &[]);
        self.corners
            .iter()
            .map(|corner| {
                let place = at.poses[corner.picture] * at.shape.place(&corner.place);
                let pixel = projector.pixel(corner.view, &place).map_err(|why| self.unseen(corner, why))?;
                Ok(corner.pixel - pixel)
            })
            .collect()
    }

    fn unseen(&self, corner: &Corner, why: NoRay) -> NoSolution {
        NoSolution::NotSeen { picture: self.names.get(corner.picture).cloned().unwrap_or_default(), why }
    }

    /// σ of a corner's coordinate: from all residuals that are no outliers.
    fn noise(&self, residuals_px: &[Vector2<f64>], is_rigid: bool) -> f64 {
        let of_shape = if is_rigid { 0 } else { shape::PARAMETERS };
        let unknowns = self.free.len() + of_shape + 6 * self.poses.len();
        let coordinates = (2 * residuals_px.len()) as f64;
        let freedom = (coordinates - unknowns as f64).max(1.0) / coordinates;
        let inliers = inliers(residuals_px, &self.corners);
        let mean = inliers.iter().map(|(_, square)| square).sum::<f64>() / inliers.len().max(1) as f64;
        (mean / 2.0 / freedom).sqrt().max(MIN_SD_PX)
    }

    fn equations(&self, at: &State, sd_px: f64, prior_weight: f64) -> Result<Equations, NoSolution> {
        let shared = self.free.len() + shape::PARAMETERS;
        let mut observations = Observations::new(shared, at.poses.iter().map(|_| 6));
        let projector = Projector::new(&at.geometry, &self.free);
        let mut by_shared = [0, 1].map(|_| Vec::with_capacity(shared));
        for corner in &self.corners {
            let sd_px = sd_px * corner.relative_sd;
            let pose = &at.poses[corner.picture];
            let place = at.shape.place(&corner.place);
            let seen = projector.seen(corner.view, &(pose * place)).map_err(|why| self.unseen(corner, why))?;
            let residual = (corner.pixel - seen.pixel) / sd_px;
            let by_place = seen.d_point * pose.rotation.to_rotation_matrix().into_inner();
            by_shared.iter_mut().for_each(Vec::clear);
            let by_shape = at.shape.moves(&corner.place).into_iter().map(|by| by_place * by);
            for d in seen.d_parameters.into_iter().chain(by_shape) {
                by_shared.iter_mut().zip(&d).for_each(|(row, d)| row.push(d / sd_px));
            }
            let by_pose = [0, 1].map(|axis| {
                let d_place = Vector3::from(seen.d_point.row(axis).transpose()) / sd_px;
                by_pose(pose, &place, &d_place)
            });
            let row =
                |axis: usize| Row { residual: residual[axis], shared: &by_shared[axis], own: by_pose[axis].as_slice() };
            observations.add(Some(corner.picture), &[row(0), row(1)], Loss::Robust);
        }
        let weight = prior_weight.sqrt();
        for known in &self.known {
            for Equation { residual, by_geometry, by_pose } in known.rows(&at.geometry, &at.poses, &self.free) {
                let by_shared = (by_geometry * weight).resize_vertically(shared, 0.0);
                let by_pose = by_pose.map(|(picture, by_pose)| (picture, by_pose * weight));
                let own = by_pose.as_ref().map_or(&[][..], |(_, by_pose)| by_pose.as_slice());
                let row = Row { residual: residual * weight, shared: by_shared.as_slice(), own };
                observations.add(by_pose.map(|(picture, _)| picture), &[row], Loss::Squared);
            }
        }
        for (i, (value, sd)) in at.shape.priors(at.held).enumerate() {
            let mut by_shared = DVector::zeros(shared);
            by_shared[self.free.len() + i] = weight / sd;
            let row = Row { residual: -value * weight / sd, shared: by_shared.as_slice(), own: &[] };
            observations.add(None, &[row], Loss::Squared);
        }
        Ok(observations.equations())
    }
}

impl Solution {
    /// σ of a parameter; `None` if it was fixed.
    pub(crate) fn sd(&self, parameter: Parameter) -> Option<f64> {
        self.sd_in(&self.covariance, parameter)
    }

    /// The same by another covariance of the free parameters.
    pub(crate) fn sd_in(&self, covariance: &DMatrix<f64>, parameter: Parameter) -> Option<f64> {
        let at = self.free.iter().position(|free| *free == parameter)?;
        Some(covariance.get((at, at))?.sqrt())
    }

    /// The problem with only some of the pictures, by their indices, starting from here.
    pub(crate) fn of_pictures(&self, pictures: &[usize], corners: &[Corner]) -> Bundle {
        let now = |old: usize| pictures.iter().position(|picture| *picture == old);
        let known = self.known.iter().filter_map(|known| match *known {
            Prior::Taped { picture, surface, thickness_m, sd_m, half_m } => {
                Some(Prior::Taped { picture: now(picture)?, surface, thickness_m, sd_m, half_m })
            }
            _ => Some(known.clone()),
        });
        Bundle {
            geometry: self.geometry.clone(),
            free: self.free.clone(),
            poses: pictures.iter().filter_map(|i| self.poses.get(*i).copied()).collect(),
            names: pictures.iter().filter_map(|i| self.names.get(*i).cloned()).collect(),
            corners: corners.iter().filter_map(|c| Some(Corner { picture: now(c.picture)?, ..*c })).collect(),
            known: known.collect(),
            shape: self.shape,
        }
    }
}

/// View and squared residual, in units of the corner's own σ, of the corners that are no outliers beside the median of
/// their view: an image in a mirror may have more noise than the direct one.
pub(crate) fn inliers(residuals_px: &[Vector2<f64>], corners: &[Corner]) -> Vec<(usize, f64)> {
    let in_own = |(r, corner): (&Vector2<f64>, &Corner)| (corner.view, r.norm_squared() / corner.relative_sd.powi(2));
    let mut squares: Vec<(usize, f64)> = residuals_px.iter().zip(corners).map(in_own).collect();
    let views = squares.iter().map(|(view, _)| view + 1).max().unwrap_or_default();
    let of_view = |of: usize| squares.iter().filter(move |(view, _)| *view == of).map(|(_, square)| *square);
    let medians: Vec<f64> = (0..views).map(|view| upper_median(of_view(view)).unwrap_or_default()).collect();
    // The median of |r|² of two independent Gaussian coordinates is 2 ln 2 σ².
    squares.retain(|(view, square)| *square <= OUTLIER.powi(2) * medians[*view] / (2.0 * std::f64::consts::LN_2));
    squares
}

/// σ of a surface's normal, by the tilt that is known less, radians, and of its distance, metres, from the σ of
/// parameters; `None` for what was fixed.
pub(crate) fn surface_sd(surface: usize, sd: impl Fn(Parameter) -> Option<f64>) -> (Option<f64>, Option<f64>) {
    let [a, b, offset_m] = Parameter::of_surface(surface).map(sd);
    // One that is not a number must not be passed over.
    let larger = |a: f64, b: f64| if a.is_nan() || a > b { a } else { b };
    (a.into_iter().chain(b).reduce(larger), offset_m)
}

impl From<SearchError<Self>> for NoSolution {
    fn from(error: SearchError<Self>) -> Self {
        match error {
            SearchError::Start(why) => why,
            SearchError::Singular => Self::Singular,
            SearchError::NotConverged => Self::NotConverged,
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::calibrate::geometry::tests::geometry;
    use crate::calibrate::tests::gaussian;
    use crate::whitening::chi_square;
    use nalgebra::{Translation3, UnitQuaternion, Vector6};

    #[test]
    fn a_fixed_parameter_has_no_sd_and_the_worse_tilt_counts() {
        let of = |a: Option<f64>, b: Option<f64>, offset: Option<f64>| {
            surface_sd(3, |parameter| match parameter {
                Parameter::Tilt { surface: 3, axis: 0 } => a,
                Parameter::Tilt { surface: 3, axis: 1 } => b,
                Parameter::Offset { surface: 3 } => offset,
                _ => None,
            })
        };
        assert_eq!(of(Some(0.1), Some(0.3), Some(2.0)), (Some(0.3), Some(2.0)));
        assert_eq!(of(Some(0.2), None, None), (Some(0.2), None));
        assert_eq!(of(None, None, Some(0.0)), (None, Some(0.0)));
        for tilts in [(f64::NAN, 0.1), (0.1, f64::NAN)] {
            assert!(of(Some(tilts.0), Some(tilts.1), None).0.unwrap().is_nan());
        }
    }

    /// Twelve small boards in the water, seen directly and in the mirror, and an inaccurate start.
    fn pictures(
        geometry: &Geometry,
        sd_px: f64,
        random: &mut impl FnMut() -> f64,
    ) -> (Vec<Isometry3<f64>>, Vec<Corner>) {
        let mut poses = Vec::new();
        let mut corners = Vec::new();
        while poses.len() < 12 {
            let mut around = |middle: f64, half: f64| middle + half * random().clamp(-2.0, 2.0);
            let turn = Vector3::new(around(0.0, 0.35), around(0.6, 0.3), around(0.0, 0.5));
            let middle = Translation3::new(around(-0.12, 0.02), around(0.0, 0.03), around(1.38, 0.02));
            let pose = Isometry3::from_parts(middle, UnitQuaternion::from_scaled_axis(turn));
            let mut own = Vec::new();
            for (view, (x, y)) in (0..2).flat_map(|v| (0..5).flat_map(move |x| (0..4).map(move |y| (v, (x, y))))) {
                let place = Point3::new(0.016 * (f64::from(x) - 2.0), 0.016 * (f64::from(y) - 1.5), 0.0);
                let Ok(pixel) = geometry.path(view).project(&(pose * place)) else { break };
                let noise = Vector2::new(random(), random()) * sd_px;
                own.push(Corner { picture: poses.len(), view, place, pixel: pixel + noise, relative_sd: 1.0 });
            }
            if own.len() == 40 {
                corners.extend(own);
                poses.push(pose);
            }
        }
        (poses, corners)
    }

    /// Typical priors of a laboratory, a calibrated lens and a tape measure, each off by `errors` standard deviations.
    fn known(errors: f64, random: &mut impl FnMut() -> f64) -> Vec<Prior> {
        let truth = geometry();
        let sd = [3.0, 3.0, 2.0, 2.0, 0.02, 0.3, 5e-4, 5e-4, 1.0];
        let values = (0..9).map(|i| truth.value(Parameter::LENS[i]) + errors * sd[i] * random()).collect();
        let whitening = DMatrix::from_diagonal(&DVector::from_iterator(9, sd.iter().map(|s: &f64| 1.0 / s)));
        let distance_m = truth.value(Parameter::Offset { surface: 0 }).abs() + errors * 2e-3 * random();
        vec![Prior::Lens { values, whitening }, Prior::Distance { surface: 0, distance_m, sd_m: 2e-3 }]
    }

    pub(crate) fn bundle(truth: &Geometry, sd_px: f64, errors: f64, seed: u64) -> Bundle {
        let mut random = gaussian(seed);
        let (poses, corners) = pictures(truth, sd_px, &mut random);
        let free: Vec<Parameter> =
            Parameter::LENS.into_iter().take(9).chain((0..3).flat_map(Parameter::of_surface)).collect();
        let off: Vec<f64> = free
            .iter()
            .map(|p| match p {
                Parameter::Focal(_) | Parameter::Principal(_) => 3.0 * random(),
                Parameter::Distortion(_) => 1e-4 * random(),
                Parameter::Tilt { .. } => 4e-3 * random(),
                _ => 3e-3 * random(),
            })
            .collect();
        let poses: Vec<_> = poses
            .iter()
            .map(|pose| turned(pose, &Vector6::from_fn(|i, _| if i < 3 { 4e-3 } else { 0.04 } * random())))
            .collect();
        let names = (0..poses.len()).map(|i| format!("{i:02}.png")).collect();
        let shape = Shape::flat(corners.iter().map(|c| &c.place));
        Bundle {
            geometry: truth.stepped(&free, &off),
            free,
            poses,
            names,
            corners,
            known: known(errors, &mut random),
            shape,
        }
    }

    fn error(solved: &Solution, truth: &Geometry) -> DVector<f64> {
        let of = |p: &Parameter| match *p {
            Parameter::Tilt { surface, axis } => {
                let plane = |g: &Geometry| g.surfaces[surface].1.plane().normal();
                let axes = crate::calibrate::geometry::tilt_axes(&plane(&solved.geometry));
                plane(truth).cross(&plane(&solved.geometry)).dot(&axes[axis])
            }
            p => solved.geometry.value(p) - truth.value(p),
        };
        DVector::from_iterator(solved.free.len(), solved.free.iter().map(of))
    }

    #[test]
    fn without_noise_the_truth_is_found() {
        let truth = geometry();
        let solved = bundle(&truth, 0.0, 0.0, 1).solve().unwrap();
        assert!(solved.corner_sd_px < 1e-5, "{}", solved.corner_sd_px);
        for (parameter, error) in solved.free.iter().zip(error(&solved, &truth).iter()) {
            let limit = if matches!(parameter, Parameter::Focal(_) | Parameter::Principal(_)) { 1e-3 } else { 1e-4 };
            assert!(error.abs() < limit, "{parameter:?} is off by {error}");
        }
    }

    #[test]
    fn a_picture_that_cannot_show_the_board_is_named() {
        let mut behind = bundle(&geometry(), 0.0, 0.0, 1);
        behind.poses[3].translation.vector.z = -1.0;
        let error = behind.solve().unwrap_err().to_string();
        assert!(error.starts_with("the board cannot be seen in 03.png, "), "{error}");
    }

    #[test]
    fn outliers_do_not_pull() {
        let truth = geometry();
        let mut with = bundle(&truth, 0.05, 1.0, 7);
        let clean = with.clone().solve().unwrap();
        for corner in with.corners.iter_mut().step_by(60) {
            corner.pixel.x += 9.0;
        }
        let solved = with.solve().unwrap();
        assert!((solved.corner_sd_px / clean.corner_sd_px - 1.0).abs() < 0.15);
        let moved = error(&solved, &truth) - error(&clean, &truth);
        let chi2 = chi_square(&moved, clean.covariance).unwrap() / moved.len() as f64;
        assert!(chi2 < 0.5, "moved by {chi2} of its covariance");
    }

    /// The scatter of every parameter over many calibrations equals its predicted σ, without bias.
    #[test]
    fn predicted_deviations_are_those_of_many_calibrations() {
        const RUNS: u64 = 150;
        let truth = geometry();
        let solved: Vec<Solution> = (0..RUNS)
            .map(|seed| bundle(&truth, 0.1, 1.0, 100 + seed).solve().unwrap_or_else(|e| panic!("{seed}: {e}")))
            .collect();
        let normalised: Vec<DVector<f64>> =
            solved.iter().map(|s| error(s, &truth).component_div(&s.covariance.diagonal().map(f64::sqrt))).collect();
        for (i, parameter) in solved[0].free.iter().enumerate() {
            let mean = |of: &dyn Fn(f64) -> f64| normalised.iter().map(|n| of(n[i])).sum::<f64>() / RUNS as f64;
            let (bias, spread) = (mean(&|e| e), mean(&|e| e * e).sqrt());
            assert!((0.8..1.25).contains(&spread), "{parameter:?} scatters by {spread:.2} of its predicted deviation");
            assert!(bias.abs() < 3.5 / (RUNS as f64).sqrt(), "{parameter:?} is off by {bias:.2} on average");
        }
    }

    /// With correlated errors of each picture's corners, a smooth field across its boards, the predicted σ still equals
    /// the scatter of many calibrations, for a dozen pictures and for few, and noise alone explains only a part.
    #[test]
    fn deviations_hold_when_the_corners_of_a_picture_are_off_together() {
        const RUNS: u64 = 40;
        let truth = geometry();
        for pictures in [8, 12] {
            let (mut squares, mut by_noise, mut effect) = (0.0, 0.0, 0.0);
            for seed in 0..RUNS {
                let mut bundle = bundle(&truth, 0.05, 1.0, 500 + seed);
                let mut random = gaussian(9000 + seed);
                let fields: Vec<[f64; 20]> = (0..24).map(|_| std::array::from_fn(|_| 0.05 * random())).collect();
                for corner in &mut bundle.corners {
                    let (u, v) = (corner.place.x / 0.032, corner.place.y / 0.024);
                    let by = [1.0, u, v, u * v, u * u, v * v, u * u * u, v * v * v, u * u * v, u * v * v];
                    let field = &fields[2 * corner.picture + corner.view];
                    let along = |i: usize| by.iter().zip(&field[10 * i..]).map(|(b, f)| b * f).sum::<f64>();
                    corner.pixel += Vector2::new(along(0), along(1));
                }
                bundle.corners.retain(|corner| corner.picture < pictures);
                bundle.poses.truncate(pictures);
                bundle.names.truncate(pictures);
                let solved = bundle.solve().unwrap();
                let off = error(&solved, &truth);
                let count = (off.len() as u64 * RUNS) as f64;
                for i in 0..off.len() {
                    squares += off[i].powi(2) / solved.covariance[(i, i)] / count;
                    by_noise += off[i].powi(2) / solved.noise_covariance[(i, i)] / count;
                }
                effect += solved.design_effect / RUNS as f64;
            }
            let (z, by_noise) = (squares.sqrt(), by_noise.sqrt());
            println!("{pictures} pictures: z RMS {z:.2}, by noise {by_noise:.2}, design effect {effect:.1}");
            assert!((0.75..1.3).contains(&z), "{pictures} pictures: {z}");
            assert!(by_noise > 1.15 * z && effect > 1.5, "{by_noise}, {effect}");
        }
    }

    /// Shows a board of this shape: corners are displaced as seen from the approximate poses of a flat one.
    fn show(bundle: &mut Bundle, truth: &Geometry, shape: &Shape) {
        let projector = Projector::new(truth, &[]);
        let flat = bundle.clone().solve().unwrap();
        for corner in &mut bundle.corners {
            let pose = flat.poses[corner.picture];
            let of = |place: Point3<f64>| projector.pixel(corner.view, &(pose * place)).unwrap();
            corner.pixel += of(shape.place(&corner.place)) - of(corner.place);
        }
    }

    /// A bent board is recognised: the bend is found to within its σ, and the geometry is as good as with a flat one.
    #[test]
    fn a_bent_board_is_found_and_does_not_bend_the_geometry() {
        const RUNS: u64 = 20;
        let truth = geometry();
        let (mut of_shape, mut of_geometry) = (0.0, 0.0);
        for seed in 0..RUNS {
            let mut bundle = bundle(&truth, 0.02, 1.0, 700 + seed);
            let bent = bundle.shape.stepped(&[2e-4, -1e-4, 1e-4]);
            show(&mut bundle, &truth, &bent);
            let flat = bundle.solve().unwrap();
            for i in 0..3 {
                let off = flat.shape.bend_m()[i] - bent.bend_m()[i];
                of_shape += off * off / flat.shape_covariance[(i, i)] / (3 * RUNS) as f64;
            }
            let off = error(&flat, &truth);
            of_geometry += (0..off.len()).map(|i| off[i].powi(2) / flat.covariance[(i, i)]).sum::<f64>()
                / (off.len() as u64 * RUNS) as f64;
            assert!(flat.shape_covariance[(0, 0)].sqrt() < 8e-5, "{}", flat.shape_covariance);
        }
        println!("z RMS {:.2} of the shape, {:.2} of the geometry", of_shape.sqrt(), of_geometry.sqrt());
        assert!((0.7..1.35).contains(&of_shape.sqrt()) && (0.7..1.3).contains(&of_geometry.sqrt()));
    }

    /// A print stretched clearly, hardly visibly, or not at all leaves the geometry as good as its σ, which is that of
    /// a square one, whichever it is.
    #[test]
    fn a_stretched_print_does_not_stretch_the_geometry() {
        const RUNS: u64 = 12;
        let truth = geometry();
        let mut of_square_m = 0.0;
        for stretch in [0.0, 1e-3, 3e-3, 1e-2] {
            let (mut squares, mut sd_m) = (0.0, 0.0);
            for seed in 0..RUNS {
                let mut bundle = bundle(&truth, 0.1, 1.0, 800 + seed);
                let mut step = [0.0; shape::PARAMETERS];
                step[shape::PRINT] = stretch;
                let stretched = bundle.shape.stepped(&step);
                show(&mut bundle, &truth, &stretched);
                let solved = bundle.solve().unwrap();
                let off = error(&solved, &truth);
                squares += (0..off.len()).map(|i| off[i].powi(2) / solved.covariance[(i, i)]).sum::<f64>()
                    / (off.len() as u64 * RUNS) as f64;
                let mirror = solved.free.iter().position(|p| *p == Parameter::Offset { surface: 1 }).unwrap();
                sd_m += solved.covariance[(mirror, mirror)].sqrt() / RUNS as f64;
            }
            let z = squares.sqrt();
            println!("stretched by {stretch}: z RMS {z:.2}, σ of the mirror {:.2} mm", 1e3 * sd_m);
            assert!((0.7..1.3).contains(&z), "stretched by {stretch}: {z}");
            if stretch == 0.0 {
                of_square_m = sd_m;
            }
            assert!(sd_m < 1.1 * of_square_m, "stretched by {stretch}: {sd_m} m, {of_square_m} m of a square print");
        }
    }

    /// An uneven print, along its rows, across them, or both, clearly, hardly visibly or not at all, leaves the
    /// geometry as good as its σ.
    #[test]
    fn an_uneven_print_does_not_bend_the_geometry() {
        const RUNS: u64 = 12;
        let truth = geometry();
        for uneven in [0.0, 1e-4, 3e-4, 8e-4] {
            let (mut squares, mut of_print) = (0.0, 0.0);
            for seed in 0..RUNS {
                let mut bundle = bundle(&truth, 0.05, 1.0, 900 + seed);
                let mut random = gaussian(1900 + seed);
                let mut step = [0.0; shape::PARAMETERS];
                bundle.shape = bundle.shape.that_may_be_uneven();
                step[shape::UNEVEN_TERMS].fill_with(|| uneven * bundle.shape.half_m() * random());
                let shape = bundle.shape.stepped(&step);
                show(&mut bundle, &truth, &shape);
                let solved = bundle.solve().unwrap();
                let mean = |of: &DVector<f64>, covariance: &DMatrix<f64>| {
                    (0..of.len()).map(|i| of[i].powi(2) / covariance[(i, i)]).sum::<f64>() / of.len() as f64
                };
                squares += mean(&error(&solved, &truth), &solved.covariance) / RUNS as f64;
                let terms = shape::UNEVEN_TERMS;
                let off = DVector::from_row_slice(solved.shape.uneven_m()) - DVector::from_row_slice(shape.uneven_m());
                let own = solved.shape_covariance.view((terms.start, terms.start), (terms.len(), terms.len()));
                of_print += mean(&off, &own.into_owned()) / RUNS as f64;
            }
            println!("uneven by {uneven}: z RMS {:.2}, of the print {:.2}", squares.sqrt(), of_print.sqrt());
            assert!((0.7..1.3).contains(&squares.sqrt()), "uneven by {uneven}: {squares}");
            // Of single kinds: hardly visible ones are believed to be even.
            assert!(of_print.sqrt() < 1.7, "uneven by {uneven}: {of_print}");
        }
    }
}
