//! Bundle adjustment: the geometry and the poses of the board that explain all corners of all pictures best.
//!
//! In: a start, corners seen, prior knowledge. Out: [`Solution`] with the geometry's covariance and what every corner left.
//!
//! Minimised is Σ ρ(|corner − projection| / σ) + Σ ((known − value)/sd)², ρ Huber's, by Levenberg-Marquardt. A picture's six
//! pose parameters meet only the geometry's: they are eliminated (Schur complement), so that the time grows linearly with
//! the number of pictures. σ, the noise of a corner, is taken from the corners themselves and the whole repeated.
//!
//! Covariance of the geometry: the inverse of the reduced normal matrix, all poses free, times σ². It supposes independent
//! errors of the corners, flat mirrors and walls, and a flat board.
//!
//! Source of the method: Triggs et al., "Bundle adjustment: a modern synthesis" (2000), doi:10.1007/3-540-44480-7_21.

use super::geometry::{Geometry, Parameter, Projector};
use super::known::Known;
use crate::optics::NoRay;
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix6, OMatrix, Point2, Point3, Translation3, U6, UnitQuaternion, Vector2, Vector3,
    Vector6,
};

/// Beyond this many σ a corner's weight falls (Huber); a corner further off than [`OUTLIER`] says nothing about σ.
const HUBER: f64 = 2.5;
/// See [`HUBER`].
const OUTLIER: f64 = 4.0;
/// Noise assumed at first, pixels; the least ever assumed (corners made by a program have none).
const START_SD_PX: f64 = 0.5;
const LEAST_SD_PX: f64 = 1e-6;
const MOST_ROUNDS: usize = 6;
const MOST_STEPS: usize = 200;
/// A round ends when the next step promises to lower the cost by less than this part of it, or this.
const ENOUGH: (f64, f64) = (1e-9, 1e-9);

/// A corner of the board in a view of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    /// Index of the picture, that is of the pose.
    pub picture: usize,
    /// Index of the view.
    pub view: usize,
    /// The corner, board frame, metres; the board's frame is best put in its middle.
    pub place: Point3<f64>,
    /// Where it was found.
    pub pixel: Point2<f64>,
}

/// What is to be solved, and where the search starts.
#[derive(Debug, Clone)]
pub struct Bundle {
    /// Lens, surfaces, views.
    pub geometry: Geometry,
    /// What of the geometry may change.
    pub free: Vec<Parameter>,
    /// For each picture, camera_from_board.
    pub poses: Vec<Isometry3<f64>>,
    /// All corners.
    pub corners: Vec<Corner>,
    /// What else is known.
    pub known: Vec<Known>,
}

/// The answer.
#[derive(Debug, Clone)]
pub struct Solution {
    /// Lens, surfaces, views.
    pub geometry: Geometry,
    /// What of the geometry was free, in the order of the covariance.
    pub free: Vec<Parameter>,
    /// Covariance of the free parameters; tilts about [`super::geometry::tilt_axes`] of the solved surfaces.
    pub covariance: DMatrix<f64>,
    /// For each picture, camera_from_board.
    pub poses: Vec<Isometry3<f64>>,
    /// For each corner, found − projected, pixels.
    pub residuals_px: Vec<Vector2<f64>>,
    /// Noise of one coordinate of a corner, pixels.
    pub corner_sd_px: f64,
    /// What else was known.
    pub known: Vec<Known>,
}

/// Why there is no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoSolution {
    /// The start does not show a corner.
    #[error("picture {picture} cannot show the board there: {why}")]
    NotSeen {
        /// Index of the picture.
        picture: usize,
        /// Why.
        why: NoRay,
    },
    /// The corners leave a direction open.
    #[error("the pictures leave the solution open")]
    Singular,
    /// The search did not settle.
    #[error("the search did not settle after {MOST_STEPS} steps")]
    NotConverged,
}

type Coupling = OMatrix<f64, nalgebra::Dyn, U6>;

/// Normal equations in the shape of an arrow: the geometry's block, each picture's own, and what couples them.
struct Normal {
    geometry: DMatrix<f64>,
    geometry_gradient: DVector<f64>,
    pictures: Vec<(Coupling, Matrix6<f64>, Vector6<f64>)>,
    cost: f64,
}

/// A step of all parameters.
struct Step {
    geometry: DVector<f64>,
    poses: Vec<Vector6<f64>>,
    /// By how much it lowers the cost if the problem is linear.
    promised: f64,
}

impl Bundle {
    /// Solves from where `self` starts.
    ///
    /// # Errors
    /// [`NoSolution`] when the start does not show the board, or the pictures do not determine the geometry.
    pub fn solve(mut self) -> Result<Solution, NoSolution> {
        let mut sd_px = START_SD_PX;
        for round in 0.. {
            self.minimise(sd_px)?;
            let residuals_px = self.residuals_px()?;
            let found = self.noise(&residuals_px);
            let settled = (found / sd_px - 1.0).abs() < 0.01 || found == LEAST_SD_PX;
            sd_px = found;
            if settled || round == MOST_ROUNDS {
                break;
            }
        }
        let residuals_px = self.residuals_px()?;
        let (covariance, _) = self.normal(sd_px)?.reduced(0.0).ok_or(NoSolution::Singular)?;
        let covariance = covariance.cholesky().ok_or(NoSolution::Singular)?.inverse();
        Ok(Solution {
            geometry: self.geometry,
            free: self.free,
            covariance,
            poses: self.poses,
            residuals_px,
            corner_sd_px: sd_px,
            known: self.known,
        })
    }

    fn minimise(&mut self, sd_px: f64) -> Result<(), NoSolution> {
        let mut normal = self.normal(sd_px)?;
        let mut damping = 1e-4;
        for _ in 0..MOST_STEPS {
            let Some(step) = normal.step(damping) else {
                // A damped matrix that is not positive is so because of rounding: more damping mends it.
                if damping > 1e6 {
                    return Err(NoSolution::Singular);
                }
                damping *= 10.0;
                continue;
            };
            let small = step.promised < ENOUGH.0 * normal.cost + ENOUGH.1;
            let moved = self.stepped(&step);
            match moved.normal(sd_px) {
                Ok(next) if next.cost <= normal.cost => {
                    *self = moved;
                    normal = next;
                    damping = f64::max(damping * 0.1, 1e-12);
                }
                _ if small => return Ok(()),
                _ => damping *= 10.0,
            }
            if small {
                return Ok(());
            }
        }
        Err(NoSolution::NotConverged)
    }

    fn stepped(&self, step: &Step) -> Self {
        let poses = self.poses.iter().zip(&step.poses).map(|(pose, step)| turned(pose, step)).collect();
        let geometry = self.geometry.stepped(&self.free, step.geometry.as_slice());
        Self { geometry, poses, free: self.free.clone(), corners: self.corners.clone(), known: self.known.clone() }
    }

    fn residuals_px(&self) -> Result<Vec<Vector2<f64>>, NoSolution> {
        let projector = Projector::new(&self.geometry, &[]);
        self.corners
            .iter()
            .map(|corner| {
                let place = self.poses[corner.picture] * corner.place;
                let pixel = projector.pixel(corner.view, &place).map_err(|why| corner.unseen(why))?;
                Ok(corner.pixel - pixel)
            })
            .collect()
    }

    /// σ of a corner's coordinate: first from the median of the residuals, then from all that are no outliers by that one.
    fn noise(&self, residuals_px: &[Vector2<f64>]) -> f64 {
        let unknowns = self.free.len() + 6 * self.poses.len();
        let coordinates = (2 * residuals_px.len()) as f64;
        let freedom = (coordinates - unknowns as f64).max(1.0) / coordinates;
        let mut squares: Vec<f64> = residuals_px.iter().map(Vector2::norm_squared).collect();
        squares.sort_by(f64::total_cmp);
        let median = squares.get(squares.len() / 2).copied().unwrap_or_default();
        // The median of |r|² of two independent Gaussian coordinates is 2 ln 2 σ².
        let limit = OUTLIER.powi(2) * median / (2.0 * std::f64::consts::LN_2);
        let inliers: Vec<f64> = squares.into_iter().filter(|s| *s <= limit).collect();
        let mean = inliers.iter().sum::<f64>() / inliers.len().max(1) as f64;
        (mean / 2.0 / freedom).sqrt().max(LEAST_SD_PX)
    }

    fn normal(&self, sd_px: f64) -> Result<Normal, NoSolution> {
        let n = self.free.len();
        let none = || (Coupling::zeros(n), Matrix6::zeros(), Vector6::zeros());
        let mut normal = Normal {
            geometry: DMatrix::zeros(n, n),
            geometry_gradient: DVector::zeros(n),
            pictures: self.poses.iter().map(|_| none()).collect(),
            cost: 0.0,
        };
        let projector = Projector::new(&self.geometry, &self.free);
        let mut by_geometry = DVector::zeros(n);
        for corner in &self.corners {
            let pose = &self.poses[corner.picture];
            let seen = projector.seen(corner.view, &(pose * corner.place)).map_err(|why| corner.unseen(why))?;
            let residual = (corner.pixel - seen.pixel) / sd_px;
            let length = residual.norm();
            let weight = if length > HUBER { HUBER / length } else { 1.0 };
            normal.cost += if length > HUBER { HUBER * (2.0 * length - HUBER) } else { length * length };
            for axis in 0..2 {
                for (to, d) in by_geometry.iter_mut().zip(&seen.d_parameters) {
                    *to = d[axis] / sd_px;
                }
                let d_place = Vector3::from(seen.d_point.row(axis).transpose()) / sd_px;
                normal.add(
                    &by_geometry,
                    Some((corner.picture, by_pose(pose, &corner.place, &d_place))),
                    residual[axis],
                    weight,
                );
            }
        }
        for known in &self.known {
            for row in known.rows(&self.geometry, &self.poses, &self.free) {
                normal.cost += row.residual * row.residual;
                normal.add(&row.by_geometry, row.by_pose, row.residual, 1.0);
            }
        }
        Ok(normal)
    }
}

impl Corner {
    fn unseen(&self, why: NoRay) -> NoSolution {
        NoSolution::NotSeen { picture: self.picture, why }
    }
}

/// A pose moved by a step: translation in the camera frame, then rotation vector about the board's origin in its own axes.
pub(super) fn turned(pose: &Isometry3<f64>, step: &Vector6<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[3], step[4], step[5]));
    let to = Translation3::from(pose.translation.vector + Vector3::new(step[0], step[1], step[2]));
    Isometry3::from_parts(to, pose.rotation * turn)
}

/// d value / d pose step, from d value / d place of a point of the board.
pub(super) fn by_pose(pose: &Isometry3<f64>, place: &Point3<f64>, d_place: &Vector3<f64>) -> Vector6<f64> {
    let in_board: Vector3<f64> = pose.rotation.inverse() * d_place;
    // d(R exp(ω) p)/dω = −R [p]ₓ, and gᵀ(−R [p]ₓ) = (p × Rᵀg)ᵀ.
    let turn = place.coords.cross(&in_board);
    Vector6::new(d_place.x, d_place.y, d_place.z, turn.x, turn.y, turn.z)
}

impl Normal {
    /// Adds one equation: its derivatives, residual and weight.
    fn add(&mut self, by_geometry: &DVector<f64>, pose: Option<(usize, Vector6<f64>)>, residual: f64, weight: f64) {
        self.geometry.syger(weight, by_geometry, by_geometry, 1.0);
        self.geometry_gradient.axpy(weight * residual, by_geometry, 1.0);
        if let Some((picture, by_pose)) = pose {
            let (coupling, own, gradient) = &mut self.pictures[picture];
            coupling.ger(weight, by_geometry, &by_pose, 1.0);
            own.ger(weight, &by_pose, &by_pose, 1.0);
            *gradient += by_pose * (weight * residual);
        }
    }

    /// The geometry's matrix and gradient after all poses are eliminated, the diagonal raised by `damping`.
    fn reduced(&self, damping: f64) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let mut matrix = self.geometry.clone();
        matrix.fill_upper_triangle_with_lower_triangle();
        for i in 0..matrix.nrows() {
            matrix[(i, i)] *= 1.0 + damping;
        }
        let mut gradient = self.geometry_gradient.clone();
        for (coupling, own, own_gradient) in &self.pictures {
            let inverse = inverse(own, damping)?;
            let through = coupling * inverse;
            matrix.gemm(-1.0, &through, &coupling.transpose(), 1.0);
            gradient.gemv(-1.0, &through, own_gradient, 1.0);
        }
        Some((matrix, gradient))
    }

    fn step(&self, damping: f64) -> Option<Step> {
        let (matrix, gradient) = self.reduced(damping)?;
        let geometry = matrix.cholesky()?.solve(&gradient);
        let mut promised = geometry.dot(&self.geometry_gradient);
        let poses = self
            .pictures
            .iter()
            .map(|(coupling, own, gradient)| {
                let step = inverse(own, damping)? * (gradient - coupling.tr_mul(&geometry));
                promised += step.dot(gradient);
                Some(step)
            })
            .collect::<Option<_>>()?;
        Some(Step { geometry, poses, promised })
    }
}

fn inverse(own: &Matrix6<f64>, damping: f64) -> Option<Matrix6<f64>> {
    let mut damped = *own;
    for i in 0..6 {
        damped[(i, i)] *= 1.0 + damping;
    }
    Some(damped.cholesky()?.inverse())
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::geometry::tests::geometry;
    use super::super::tests::gaussian;
    use super::*;

    /// Twelve small boards in the water, seen directly and in the mirror, and a start that is off.
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
                own.push(Corner { picture: poses.len(), view, place, pixel: pixel + noise });
            }
            if own.len() == 40 {
                corners.extend(own);
                poses.push(pose);
            }
        }
        (poses, corners)
    }

    /// What a laboratory has, a calibrated lens and a tape measure, each `errors` times its standard deviation off.
    fn known(errors: f64, random: &mut impl FnMut() -> f64) -> Vec<Known> {
        let truth = geometry();
        let sd = [3.0, 3.0, 2.0, 2.0, 0.02, 0.3, 5e-4, 5e-4, 1.0];
        let values = std::array::from_fn(|i| truth.value(Parameter::LENS[i]) + errors * sd[i] * random());
        let whitening = DMatrix::from_diagonal(&DVector::from_iterator(9, sd.iter().map(|s: &f64| 1.0 / s)));
        let distance_m = truth.value(Parameter::Offset { surface: 0 }).abs() + errors * 2e-3 * random();
        vec![Known::Lens { values, whitening }, Known::Distance { surface: 0, distance_m, sd_m: 2e-3 }]
    }

    pub(in crate::calibrate) fn bundle(truth: &Geometry, sd_px: f64, errors: f64, seed: u64) -> Bundle {
        let mut random = gaussian(seed);
        let (poses, corners) = pictures(truth, sd_px, &mut random);
        let free: Vec<Parameter> = Parameter::LENS.into_iter().chain((0..3).flat_map(Parameter::of_surface)).collect();
        let off: Vec<f64> = free
            .iter()
            .map(|p| match p {
                Parameter::Focal(_) | Parameter::Principal(_) => 3.0 * random(),
                Parameter::Distortion(_) => 1e-4 * random(),
                Parameter::Tilt { .. } => 4e-3 * random(),
                _ => 3e-3 * random(),
            })
            .collect();
        let poses = poses
            .iter()
            .map(|pose| turned(pose, &Vector6::from_fn(|i, _| if i < 3 { 4e-3 } else { 0.04 } * random())))
            .collect();
        Bundle { geometry: truth.stepped(&free, &off), free, poses, corners, known: known(errors, &mut random) }
    }

    fn error(solved: &Solution, truth: &Geometry) -> DVector<f64> {
        let of = |p: &Parameter| match *p {
            Parameter::Tilt { surface, axis } => {
                let plane = |g: &Geometry| g.surfaces[surface].1.plane().normal();
                let axes = super::super::geometry::tilt_axes(&plane(&solved.geometry));
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
    fn outliers_do_not_pull() {
        let truth = geometry();
        let mut with = bundle(&truth, 0.05, 1.0, 7);
        let clean = with.clone().solve().unwrap();
        for corner in with.corners.iter_mut().step_by(60) {
            corner.pixel.x += 9.0;
        }
        let solved = with.solve().unwrap();
        assert!((solved.corner_sd_px / clean.corner_sd_px - 1.0).abs() < 0.15);
        let whitened = clean.covariance.clone().cholesky().unwrap().inverse();
        let moved = error(&solved, &truth) - error(&clean, &truth);
        let chi2 = moved.dot(&(whitened * &moved)) / moved.len() as f64;
        assert!(chi2 < 0.5, "moved by {chi2} of its covariance");
    }

    /// The spread of every parameter over many calibrations is its predicted σ, and nothing is biased.
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
}
