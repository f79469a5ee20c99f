//! The catheter in motion under currents that change.
//!
//! The equations of motion are those of the chain (`links.rs`). They are integrated by the generalised-α method: of
//! second order, stable at any step for small motions, and high frequencies are damped by the factor ρ∞ each step; with
//! ρ∞ = 1 nothing is. Each step is solved by Newton's method to [`NEWTON_TOLERANCE`]; a step that does not
//! converge is halved.
//!
//! Source of the method: Chung and Hulbert (1993), doi:10.1115/1.2900803, in the form of Arnold and Brüls (2007),
//! doi:10.1007/s11044-007-9084-0.

use super::equilibrium::equilibrium;
use super::error::CatheterError;
use super::links::{At, Chain, Energy, ExternalLoad};
use super::load::Load;
use super::model::Catheter;
use nalgebra::linalg::LU;
use nalgebra::{Complex, DMatrix, DVector, Dyn, Matrix3, Point3, Vector3};

/// A step is solved when the bend changes by less than this over the whole rod, radians.
const NEWTON_TOLERANCE: f64 = 1e-10;
const MAX_STEPS: usize = 12;
/// How often a change may be larger than the one before, in a step: once or twice it is where currents jump. (Halving
/// such steps costs more than it saves: the method's own acceleration belongs to one length of step, and the tip was
/// 0.8 mm off at steps of 4 ms.)
const MAX_GROWTHS: u32 = 4;
/// Newton's matrix is kept for the next step while the change falls to this part of it or less each time.
const KEEP_MATRIX_BELOW: f64 = 0.1;
/// Perturbation of differences, radians over the whole rod.
const PERTURBATION: f64 = 1e-6;
/// A step is halved this often before it is given up.
const MAX_HALVINGS: u32 = 8;

/// How finely motion is computed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accuracy {
    /// Smooth functions for bends and twist of the flexible part and of the tail.
    pub functions: [usize; 2],
    /// Longest rigid link, metres.
    pub longest_link_m: f64,
    /// Longest step of time, seconds.
    pub step_s: f64,
    /// By what factor each step damps the highest frequencies, 0 to 1.
    pub rho: f64,
}

impl Default for Accuracy {
    /// Shapes at rest within 10 µm of [`equilibrium`]'s for the prototype, and a step of 2 ms (tests).
    fn default() -> Self {
        Self { functions: [4, 2], longest_link_m: 3e-3, step_s: 2e-3, rho: 0.8 }
    }
}

/// Where the markers are at one moment, and how the catheter points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Since the beginning, seconds.
    pub time_s: f64,
    /// Middle of the base band, or without bands the clamp ([`Catheter::origin_m`]).
    pub base: Point3<f64>,
    /// Middle of the coil set.
    pub coil: Point3<f64>,
    /// Direction of the tube there, towards the tip; length 1.
    pub tangent: Vector3<f64>,
    /// The tip: end of the tube, or middle of the tip's band ([`Catheter::tip_m`]).
    pub tip: Point3<f64>,
    /// How fast the end of the tube moves, m/s.
    pub tip_velocity_m_s: Vector3<f64>,
}

impl Moment {
    /// θ, radians.
    pub fn theta_rad(&self) -> f64 {
        self.tangent.x.atan2(self.tangent.z)
    }
}

/// The catheter at one moment, and how it goes on.
#[derive(Debug, Clone)]
pub struct Simulation {
    catheter: Catheter,
    accuracy: Accuracy,
    chain: Chain,
    state: State,
    load: Load,
    /// The factorised iteration matrix of Newton's method, and the step it was made for.
    matrix: Option<(LU<f64, Dyn, Dyn>, f64)>,
}

#[derive(Debug, Clone)]
struct State {
    time_s: f64,
    q: DVector<f64>,
    rate: DVector<f64>,
    acceleration: DVector<f64>,
    /// The method's own acceleration, between the steps.
    between: DVector<f64>,
}

/// Constants of the method.
struct Alpha {
    m: f64,
    f: f64,
    beta: f64,
    gamma: f64,
}

impl Alpha {
    fn new(rho: f64) -> Self {
        let rho = rho.clamp(0.0, 1.0);
        let (m, f) = ((2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0));
        let gamma = 0.5 + f - m;
        Self { m, f, beta: 0.25 * (0.5 + gamma).powi(2), gamma }
    }

    /// What rates and accelerations change by when unknowns do.
    fn factors(&self, step_s: f64) -> (f64, f64) {
        (self.gamma / (self.beta * step_s), (1.0 - self.m) / (self.beta * step_s * step_s * (1.0 - self.f)))
    }
}

impl Simulation {
    /// At rest under `load`.
    ///
    /// # Errors
    /// [`CatheterError`] when there is no such shape.
    pub fn at_rest(catheter: &Catheter, load: &Load, accuracy: Accuracy) -> Result<Self, CatheterError> {
        let shape = equilibrium(catheter, load)?;
        let chain = Chain::new(catheter, accuracy.functions, accuracy.longest_link_m);
        let none = DVector::zeros(chain.unknowns());
        let q = chain.nearest(catheter, |arc_m| shape.curvature(arc_m));
        let state = State { time_s: 0.0, q, rate: none.clone(), acceleration: none.clone(), between: none };
        let mut new = Self { catheter: catheter.clone(), accuracy, chain, state, load: *load, matrix: None };
        new.settle()?;
        Ok(new)
    }

    /// The same motion from here on, with the load changed at once.
    ///
    /// # Errors
    /// When the matrix of inertia is singular: a catheter without mass.
    pub fn released(mut self, load: &Load) -> Result<Self, CatheterError> {
        self.load = *load;
        self.start()?;
        Ok(self)
    }

    fn acting(&self, load: &Load) -> ExternalLoad {
        ExternalLoad {
            moment_am2: self.catheter.coils.moment_per_ampere_m2 * load.currents_a,
            tip_n: load.tip_n,
            tip_nm: load.tip_nm,
        }
    }

    /// Newton's method for a shape that does not move.
    fn settle(&mut self) -> Result<(), CatheterError> {
        let acting = self.acting(&self.load);
        let none = DVector::zeros(self.chain.unknowns());
        let length_m = self.catheter.length_m();
        let mut change = f64::INFINITY;
        for _ in 0..MAX_STEPS {
            let left = self.chain.residual((&self.state.q, &none, &none), &acting);
            let matrix = self.derivative(&self.state, &acting, (1.0, 0.0, 0.0));
            let Some(step) = matrix.lu().solve(&-left) else { break };
            self.state.q += &step;
            change = step.amax() * length_m;
            if change < NEWTON_TOLERANCE {
                return Ok(());
            }
        }
        Err(CatheterError::NotConverged { percent: 100.0, residual_rad: change })
    }

    /// Accelerations that belong to state and load.
    fn start(&mut self) -> Result<(), CatheterError> {
        let acting = self.acting(&self.load);
        let State { q, rate, .. } = &self.state;
        let none = DVector::zeros(self.chain.unknowns());
        let left = self.chain.residual((q, rate, &none), &acting);
        let inertia = self.derivative(&self.state, &acting, (0.0, 0.0, 1.0));
        let solved = inertia.lu().solve(&-left);
        let found = solved.ok_or(CatheterError::Motion { time_s: self.state.time_s })?;
        (self.state.acceleration, self.state.between) = (found.clone(), found);
        Ok(())
    }

    /// Derivative of the residual when unknowns, rates and accelerations change by these factors.
    fn derivative(
        &self,
        state: &State,
        acting: &ExternalLoad,
        (by, by_rate, by_acceleration): (f64, f64, f64),
    ) -> DMatrix<f64> {
        let count = self.chain.unknowns();
        let largest = by.abs().max(by_rate.abs() * 1e-3).max(by_acceleration.abs() * 1e-6).max(f64::MIN_POSITIVE);
        let size = PERTURBATION / self.catheter.length_m() / largest;
        let mut matrix = DMatrix::zeros(count, count);
        let mut moved = state.clone();
        for k in 0..count {
            let mut at = |side: f64| {
                moved.q[k] = state.q[k] + side * size * by;
                moved.rate[k] = state.rate[k] + side * size * by_rate;
                moved.acceleration[k] = state.acceleration[k] + side * size * by_acceleration;
                self.chain.residual((&moved.q, &moved.rate, &moved.acceleration), acting)
            };
            let column = (at(1.0) - at(-1.0)) / (2.0 * size);
            at(0.0);
            matrix.set_column(k, &column);
        }
        matrix
    }

    /// Goes on for `duration_s`; `load` gives what acts on average from one time to another, seconds since the
    /// beginning.
    ///
    /// Steps are equal and not longer than [`Accuracy::step_s`].
    ///
    /// # Errors
    /// [`CatheterError::Motion`] when a step does not settle however short it is.
    pub fn advance(&mut self, duration_s: f64, load: impl Fn(f64, f64) -> Load) -> Result<(), CatheterError> {
        let steps = (duration_s / self.accuracy.step_s - 1e-9).ceil().max(1.0);
        let (from_s, step_s) = (self.state.time_s, duration_s / steps);
        for k in 1..=steps as usize {
            self.step(from_s + k as f64 * step_s, step_s, 0, &load)?;
        }
        Ok(())
    }

    /// One step to `end_s`, or more where Newton's method does not converge.
    fn step(
        &mut self,
        end_s: f64,
        step_s: f64,
        halvings: u32,
        load: &impl Fn(f64, f64) -> Load,
    ) -> Result<(), CatheterError> {
        // Forces count at the ends of a step: what acts on average around each.
        self.load = load(end_s - step_s / 2.0, end_s + step_s / 2.0);
        let before = self.state.clone();
        if self.solve(step_s) {
            self.state.time_s = end_s;
            return Ok(());
        }
        self.state = before;
        self.matrix = None;
        if halvings == MAX_HALVINGS {
            return Err(CatheterError::Motion { time_s: self.state.time_s });
        }
        let half_s = step_s / 2.0;
        self.step(end_s - half_s, half_s, halvings + 1, load)?;
        self.step(end_s, half_s, halvings + 1, load)
    }

    /// One step by Newton's method; whether it converged.
    fn solve(&mut self, step_s: f64) -> bool {
        let alpha = Alpha::new(self.accuracy.rho);
        let (by_rate, by_acceleration) = alpha.factors(step_s);
        let acting = self.acting(&self.load);
        let length_m = self.catheter.length_m();
        // 1. as if accelerations stayed zero
        let old = &self.state;
        let between = (&old.acceleration * alpha.f - &old.between * alpha.m) / (1.0 - alpha.m);
        let mut new = old.clone();
        new.q += &old.rate * step_s + (&old.between * (0.5 - alpha.beta) + &between * alpha.beta) * (step_s * step_s);
        new.rate += (&old.between * (1.0 - alpha.gamma) + &between * alpha.gamma) * step_s;
        new.acceleration.fill(0.0);
        // 2. Newton's steps; the matrix of the step before serves while it serves well
        let mut last = f64::INFINITY;
        let mut grew = 0;
        for _ in 0..2 * MAX_STEPS {
            let left = self.chain.residual((&new.q, &new.rate, &new.acceleration), &acting);
            if self.matrix.as_ref().is_none_or(|(_, of)| (of - step_s).abs() > 1e-9 * step_s) {
                self.matrix = Some((self.derivative(&new, &acting, (1.0, by_rate, by_acceleration)).lu(), step_s));
            }
            let Some(change) = self.matrix.as_ref().and_then(|(matrix, _)| matrix.solve(&-left)) else { return false };
            new.q += &change;
            new.rate += &change * by_rate;
            new.acceleration += &change * by_acceleration;
            let size = change.amax() * length_m;
            if !size.is_finite() {
                return false;
            }
            if size < NEWTON_TOLERANCE {
                let State { acceleration, between: old_between, .. } = &self.state;
                new.between = (&new.acceleration * (1.0 - alpha.f) + acceleration * alpha.f - old_between * alpha.m)
                    / (1.0 - alpha.m);
                self.state = new;
                return true;
            }
            if size > KEEP_MATRIX_BELOW * last {
                if size > last {
                    grew += 1;
                    if grew > MAX_GROWTHS {
                        return false;
                    }
                }
                self.matrix = None;
            }
            last = size;
        }
        false
    }

    /// The moment it is at.
    pub fn moment(&self) -> Moment {
        let (places, tip_velocity_m_s) = self.chain.places(&self.state.q, &self.state.rate);
        let coil_m = self.catheter.flexible_m + self.catheter.coil_m / 2.0;
        let from_coil = |at: &&At| (at.arc_m - coil_m).abs();
        let coil = places.iter().min_by(|a, b| from_coil(a).total_cmp(&from_coil(b)));
        Moment {
            time_s: self.state.time_s,
            base: at(&places, self.catheter.origin_m()).into(),
            coil: coil.map_or_else(Point3::origin, |at| at.point.into()),
            tangent: coil.map_or_else(Vector3::z, |at| at.frame.column(2).into_owned()),
            tip: at(&places, self.catheter.tip_m()).into(),
            tip_velocity_m_s,
        }
    }

    /// The centre line where it is: distances from the clamp, places and directions, from the clamp to the tip.
    pub fn centre_line(&self) -> Vec<(f64, Point3<f64>, Vector3<f64>)> {
        let (places, _) = self.chain.places(&self.state.q, &self.state.rate);
        let ahead = places.iter().skip(1).chain(places.last());
        // Links are straight; where two meet, the line has the direction between theirs. The first place is the clamp.
        let along = |at: &At| at.frame.column(2).into_owned();
        let direction = |k: usize, at: &At, next: &At| if k == 0 { along(at) } else { along(at) + along(next) };
        let lines = places.iter().zip(ahead).enumerate();
        lines.map(|(k, (at, next))| (at.arc_m, at.point.into(), direction(k, at, next).normalize())).collect()
    }

    /// Kinetic and potential energy.
    pub fn energy(&self) -> Energy {
        self.chain.energy(&self.state.q, &self.state.rate, &self.acting(&self.load))
    }

    /// Angular frequencies (rad/s) of small motions about where it is, without damping, the lowest first.
    ///
    /// # Errors
    /// When the matrix of inertia is singular: a catheter without mass.
    pub fn frequencies_rad_s(&self) -> Result<Vec<f64>, CatheterError> {
        let [stiffness, _, inertia] = self.linear();
        let solved = inertia.lu().solve(&stiffness).ok_or(CatheterError::Motion { time_s: self.state.time_s })?;
        let mut found: Vec<f64> = solved.complex_eigenvalues().iter().map(|value| value.re.max(0.0).sqrt()).collect();
        found.sort_by(f64::total_cmp);
        Ok(found)
    }

    /// How the tip follows small sines of the currents about where it is, metres per ampere: rows x, y, z, columns
    /// coils; the drag only as far as it is linear.
    ///
    /// # Errors
    /// When the equations are singular: at a resonance without losses.
    pub fn response(&self, frequency_hz: f64) -> Result<Matrix3<Complex<f64>>, CatheterError> {
        let singular = || CatheterError::Motion { time_s: self.state.time_s };
        let omega = std::f64::consts::TAU * frequency_hz;
        let [stiffness, damping, inertia] = self.linear();
        let matrix = DMatrix::from_fn(stiffness.nrows(), stiffness.ncols(), |i, j| {
            Complex::new(stiffness[(i, j)] - omega * omega * inertia[(i, j)], omega * damping[(i, j)])
        });
        let solver = matrix.lu();
        let none = DVector::zeros(self.chain.unknowns());
        let tip = |q: &DVector<f64>| at(&self.chain.places(q, &none).0, self.catheter.tip_m());
        let mut response = Matrix3::zeros();
        for coil in 0..3 {
            // The couple is linear in the currents.
            let left = |by_a: f64| {
                let mut load = self.load;
                load.currents_a[coil] += by_a;
                self.chain.residual((&self.state.q, &none, &none), &self.acting(&load))
            };
            let push = (left(-1.0) - left(1.0)) / 2.0;
            let moved = solver.solve(&push.map(Complex::from)).ok_or_else(singular)?;
            let along = |part: DVector<f64>| {
                let size = PERTURBATION / self.catheter.length_m() / part.amax().max(f64::MIN_POSITIVE);
                (tip(&(&self.state.q + &part * size)) - tip(&(&self.state.q - &part * size))) / (2.0 * size)
            };
            let (real, imaginary) = (along(moved.map(|v| v.re)), along(moved.map(|v| v.im)));
            response.set_column(coil, &real.zip_map(&imaginary, Complex::new));
        }
        Ok(response)
    }

    /// Stiffness, damping (drag only as far as it is linear) and inertia of small motions about where it is.
    fn linear(&self) -> [DMatrix<f64>; 3] {
        let none = DVector::zeros(self.chain.unknowns());
        let still = State { rate: none.clone(), acceleration: none, ..self.state.clone() };
        let acting = self.acting(&self.load);
        [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)].map(|by| self.derivative(&still, &acting, by))
    }
}

/// The place of a point on the line so far from the clamp: a place ends a straight link, the last one the tube.
fn at(places: &[At], arc_m: f64) -> Vector3<f64> {
    let end = places.iter().find(|at| at.arc_m >= arc_m).or(places.last());
    end.map_or_else(Vector3::zeros, |at| at.point + at.frame.column(2) * (arc_m - at.arc_m))
}
