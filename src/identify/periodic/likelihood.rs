//! B/A fitted to lines by maximum likelihood, with noise on input and output, and their covariance, as observed over
//! the periods.
//!
//! Minimises Σ |A Y − B U|² / (σ_Y² |A|² + σ_U² |B|² − 2 Re(σ_YU² A B*)) (Pintelon and Schoukens, System
//! Identification: A Frequency Domain Approach, 2nd ed., chapters 9 and 12): by damped Gauss-Newton, from given models
//! and from Sanathanan and Koerner's iteration (IEEE TAC 8, 1963, doi:10.1109/TAC.1963.1105517). With a held input the
//! lines of the samples follow B/A exactly, and its H(s) is also the maximum likelihood H(s).

use super::average::{Averaged, Line, MIN_PERIODS};
use crate::identify::estimate::estimated::Estimated;
use crate::identify::estimate::shortest_delay::Delayed;
use crate::identify::model::covariance::Covariance;
use crate::identify::model::polynomials::{Orders, Polynomials};
use crate::identify::solve::descent::{Descent, Lowest};
use crate::identify::solve::regression::{Triangle, solve};
use nalgebra::Complex;

const DESCENT: Descent = Descent { first_damping: 1e-4, tolerance: 1e-14, max_steps: 200 };
/// Rounds of Sanathanan and Koerner's iteration; it need not converge.
const ROUNDS: usize = 20;
/// Rounding noise, relative to both signals.
const ROUNDING: f64 = 1e-12;

/// The result.
#[derive(Debug, Clone)]
pub(crate) struct Found {
    pub(crate) estimated: Estimated,
    deviance: f64,
    /// Residual relative to noise (1).
    pub(crate) left: f64,
    /// σ of `left` for noise alone.
    pub(crate) left_sd: f64,
    pub(crate) steps: usize,
    pub(crate) converged: bool,
}

/// The model of these orders nearest to the lines of all records. `None` when there is no stable initial model, or the
/// lines do not determine it.
pub(crate) fn fit(records: &[Averaged], orders: Orders, initial: &[Polynomials]) -> Option<Found> {
    let lines: Vec<&Line> = records.iter().flat_map(|r| &r.lines).collect();
    let parameters = orders.parameters();
    // Two numbers per line.
    if 2 * lines.len() <= parameters {
        return None;
    }
    let iterated = sanathanan_koerner(&lines, orders);
    let same = |model: &&Polynomials| model.orders() == orders && model.is_stable();
    let all = initial.iter().filter(same).chain(iterated.as_ref().filter(|m| m.is_stable()));
    let allowed = |model: &Polynomials| if model.is_stable() { cost(&lines, model) } else { f64::INFINITY };
    let derivatives = |model: &Polynomials| Some(triangle(&lines, model));
    let Lowest { at: model, cost: least, steps, converged } = all
        .filter_map(|model| DESCENT.run(model.clone(), allowed, derivatives, Polynomials::moved))
        .min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    let solution = solve(triangle(&lines, &model))?;
    // With variances from M periods the residual is larger by (M−1)/(M−2) than with known ones, and the model's
    // covariance by (M−2)/(M−3), which JᵀJ underestimates by another (M−1)/(M−2) (section 10.9).
    let m = records.iter().map(|r| r.periods).min().unwrap_or(MIN_PERIODS).max(MIN_PERIODS) as f64;
    let free = lines.len() as f64 - 0.5 * parameters as f64;
    let left = least / (free * (m - 1.0) / (m - 2.0));
    let left_sd = ((m - 1.0) / (m - 3.0) / free).sqrt();
    // As where the level of the noise is unknown; differences of it scatter as σ does.
    let deviance = 2.0 * free * (m - 3.0) / (m - 2.0) * left.ln();
    // Real and imaginary part have half the variance each. A residual beyond noise widens σ.
    let scale = (0.5 * (m - 1.0) / (m - 3.0) * left.max(1.0)).sqrt();
    let estimated = Estimated {
        covariance: Covariance::from_factor(solution.inverse * scale),
        noise_variance: left,
        samples: lines.len(),
        condition: solution.condition,
        model,
    };
    Some(Found { estimated, deviance, left, left_sd, steps, converged })
}

impl Delayed for Found {
    fn nk(&self) -> usize {
        self.estimated.model.nk
    }

    fn deviance(&self) -> f64 {
        self.deviance
    }
}

fn cost(lines: &[&Line], model: &Polynomials) -> f64 {
    let sum: f64 = lines.iter().map(|line| Residual::of(line, model)).map(|r| r.error.norm_sqr() / r.variance).sum();
    if sum.is_finite() { sum } else { f64::INFINITY }
}

/// A Y − B U for one line.
struct Residual {
    a: Complex<f64>,
    b: Complex<f64>,
    error: Complex<f64>,
    variance: f64,
}

impl Residual {
    fn of(line: &Line, model: &Polynomials) -> Self {
        let backward = Complex::from_polar(1.0, -line.angle);
        let value = |c: &[f64]| c.iter().rev().fold(Complex::new(0.0, 0.0), |sum, c| sum * backward + c);
        let (a, b) = (value(&model.a), value(&model.b) * backward.powu(model.nk as u32));
        let noise = line.output_variance * a.norm_sqr() + line.input_variance * b.norm_sqr()
            - 2.0 * (line.covariance * a * b.conj()).re;
        let rounding = (line.output * a).norm_sqr() + (line.input * b).norm_sqr();
        let error = a * line.output - b * line.input;
        Self { a, b, error, variance: noise.max(0.0) + ROUNDING * ROUNDING * rounding }
    }
}

/// Derivatives of −ε and ε itself, ε = (A Y − B U)/σ: two rows per line.
fn triangle(lines: &[&Line], model: &Polynomials) -> nalgebra::DMatrix<f64> {
    let (na, nb, nk) = (model.na(), model.nb(), model.nk);
    let mut triangle = Triangle::new(na + nb + 1);
    for line in lines {
        let Residual { a, b, error, variance } = Residual::of(line, model);
        let sd = variance.sqrt();
        let derivative = |k: usize| {
            let (by_error, by_variance) = if k < na {
                let z = Complex::from_polar(1.0, -line.angle * (k + 1) as f64);
                let in_a = 2.0 * (a.conj() * z * line.output_variance - line.covariance * z * b.conj()).re;
                (z * line.output, in_a)
            } else {
                let z = Complex::from_polar(1.0, -line.angle * (nk + k - na) as f64);
                let in_b = 2.0 * (b.conj() * z * line.input_variance - line.covariance * a * z.conj()).re;
                (-z * line.input, in_b)
            };
            -(by_error - error * (0.5 * by_variance / variance)) / sd
        };
        let row: Vec<Complex<f64>> = (0..na + nb).map(derivative).chain([error / sd]).collect();
        triangle.push(row.iter().map(|v| v.re));
        triangle.push(row.iter().map(|v| v.im));
    }
    triangle.finish()
}

/// Linear least squares, reweighted by the σ that the previous model predicts.
fn sanathanan_koerner(lines: &[&Line], orders: Orders) -> Option<Polynomials> {
    let Orders { na, nb, nk } = orders;
    let mut best: Option<(f64, Polynomials)> = None;
    let mut model: Option<Polynomials> = None;
    for _ in 0..ROUNDS {
        let mut triangle = Triangle::new(na + nb + 1);
        for line in lines {
            let sd = model.as_ref().map_or_else(|| line.output.norm(), |m| Residual::of(line, m).variance.sqrt());
            let regressor = |k: usize| {
                let lag = if k < na { k + 1 } else { nk + k - na };
                let z = Complex::from_polar(1.0, -line.angle * lag as f64);
                if k < na { -z * line.output / sd } else { z * line.input / sd }
            };
            let row: Vec<Complex<f64>> = (0..na + nb).map(regressor).chain([line.output / sd]).collect();
            triangle.push(row.iter().map(|v| v.re));
            triangle.push(row.iter().map(|v| v.im));
        }
        let Some(solution) = solve(triangle.finish()) else { break };
        let next = Polynomials::of(solution.parameters.as_slice(), na, nk);
        let value = cost(lines, &next);
        // Prefer a stable one, which can be refined.
        let better = |(least, before): &(f64, Polynomials)| (next.is_stable(), -value) > (before.is_stable(), -least);
        if best.as_ref().is_none_or(better) {
            best = Some((value, next.clone()));
        }
        model = Some(next);
    }
    best.map(|(_, model)| model)
}
