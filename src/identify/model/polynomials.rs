//! A discrete transfer function B(q)/A(q): simulation, one-step prediction, frequency response and poles.
//!
//! Convention: `y(t) + a₁ y(t−1) + … + a_na y(t−na) = b₀ u(t−nk) + … + b_{nb−1} u(t−nk−nb+1)`. `a` includes the leading
//! 1, `b` does not include the zeros of the delay. Everything before the first sample is zero: the system was at rest.

use crate::identify::solve::decompositions::eigenvalues;
use nalgebra::{Complex, DMatrix, DVector};
use std::f64::consts::{PI, TAU};

/// Orders and delay of a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Orders {
    /// Past outputs.
    pub na: usize,
    /// Inputs.
    pub nb: usize,
    /// Delay, samples.
    pub nk: usize,
}

impl Orders {
    /// Parameters to be estimated.
    pub fn parameters(&self) -> usize {
        self.na + self.nb
    }

    /// Samples without a full past at the beginning of a segment.
    pub fn memory(&self) -> usize {
        memory(self.na, self.nb, self.nk)
    }
}

/// Where noise enters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Noise {
    /// At the equation, A y = B u + e.
    Equation,
    /// At the output, y = B/A u + e.
    Output,
}

/// B(q)/A(q) with `nk` samples of delay.
#[derive(Debug, Clone, PartialEq)]
pub struct Polynomials {
    /// 1, a₁ … a_na.
    pub a: Vec<f64>,
    /// b₀ … b_{nb−1}; the first multiplies u(t−nk).
    pub b: Vec<f64>,
    /// Delay, samples.
    pub nk: usize,
}

impl Polynomials {
    /// Its orders and delay.
    pub fn orders(&self) -> Orders {
        Orders { na: self.na(), nb: self.nb(), nk: self.nk }
    }

    /// Number of past outputs.
    pub fn na(&self) -> usize {
        self.a.len().saturating_sub(1)
    }

    /// Number of inputs.
    pub fn nb(&self) -> usize {
        self.b.len()
    }

    /// Past samples needed for a prediction; also the number of states, including those of a delay.
    pub fn memory(&self) -> usize {
        memory(self.na(), self.nb(), self.nk)
    }

    /// The same without the samples of delay beyond the first, and their number. They are not dynamics: the first is
    /// the hold's own.
    pub fn without_delay(&self) -> (Self, usize) {
        let beyond = self.nk.saturating_sub(1);
        (Self { nk: self.nk - beyond, ..self.clone() }, beyond)
    }

    /// Number of states, without samples of delay beyond the first.
    pub fn order(&self) -> usize {
        self.without_delay().0.memory()
    }

    /// a₁ … a_na, then b₀ … b_{nb−1}: the order of every parameter vector and covariance.
    pub fn parameters(&self) -> DVector<f64> {
        DVector::from_iterator(self.na() + self.nb(), self.a.iter().skip(1).chain(&self.b).copied())
    }

    /// The same orders and delay with these parameters, in the order of [`Polynomials::parameters`].
    pub fn with_parameters(&self, parameters: &[f64]) -> Self {
        Self::of(parameters, self.na(), self.nk)
    }

    /// The same orders and delay with parameters moved by a step.
    pub(in crate::identify) fn moved(&self, step: &DVector<f64>) -> Self {
        self.with_parameters((self.parameters() + step).as_slice())
    }

    /// From a parameter vector whose first `na` entries are those of A.
    pub fn of(parameters: &[f64], na: usize, nk: usize) -> Self {
        let (a, b) = parameters.split_at(na.min(parameters.len()));
        Self { a: [&[1.0], a].concat(), b: b.to_vec(), nk }
    }

    /// Output for this input from rest, as long as the input.
    pub fn simulate(&self, input: &[f64]) -> Vec<f64> {
        let driven = moving_sum(&self.b, self.nk, input);
        all_pole(&self.a, driven)
    }

    /// Output one step ahead, from earlier inputs and outputs. The first [`Polynomials::memory`] have no full past and
    /// are left out: the result is that much shorter than the data.
    pub fn predict(&self, input: &[f64], output: &[f64]) -> Vec<f64> {
        let driven = moving_sum(&self.b, self.nk, input);
        let past = |t: usize| -> f64 { self.a.iter().skip(1).zip(output[..t].iter().rev()).map(|(a, y)| a * y).sum() };
        (self.memory()..output.len().min(driven.len())).map(|t| driven[t] - past(t)).collect()
    }

    /// Contribution of initial state `state` to the output at sample `t`, up to `length` samples: responses of 1/A to a
    /// unit at one of the first [`Polynomials::memory`] samples.
    pub fn free_responses(&self, length: usize) -> impl Fn(usize, usize) -> f64 + use<> {
        let mut impulse = vec![0.0; length];
        if let Some(first) = impulse.first_mut() {
            *first = 1.0;
        }
        let response = all_pole(&self.a, impulse);
        move |t, state| t.checked_sub(state).map_or(0.0, |t| response[t])
    }

    /// Value at `angle` radians per sample: 2π f T.
    pub fn response(&self, angle: f64) -> Complex<f64> {
        let backward = Complex::from_polar(1.0, -angle);
        polynomial(&self.b, backward) * backward.powu(self.nk as u32) / polynomial(&self.a, backward)
    }

    /// Gain at zero frequency; infinite for an integrator.
    pub fn gain(&self) -> f64 {
        self.b.iter().sum::<f64>() / self.a.iter().sum::<f64>()
    }

    /// Roots of A in z. Poles of a delay at zero are not included.
    pub fn poles(&self) -> Vec<Complex<f64>> {
        roots(&self.a)
    }

    /// Modulus of the largest pole; zero without poles, infinite when they were not found, so that no such model is
    /// used.
    pub fn largest_pole(&self) -> f64 {
        let moduli = self.poles().into_iter().map(|p| if p.re.is_nan() { f64::INFINITY } else { p.norm() });
        moduli.fold(0.0, f64::max)
    }

    /// Whether all poles are inside the unit circle.
    pub fn is_stable(&self) -> bool {
        self.largest_pole() < 1.0
    }
}

/// Past samples needed for a prediction.
pub(in crate::identify) fn memory(na: usize, nb: usize, nk: usize) -> usize {
    na.max((nb + nk).saturating_sub(1))
}

/// Radians per sample at `frequency_hz`.
pub(in crate::identify) fn angle(frequency_hz: f64, period_s: f64) -> f64 {
    TAU * frequency_hz * period_s
}

/// From one angle to the next the short way round, from −π to below π.
pub(super) fn turn(from: f64, to: f64) -> f64 {
    (to - from + PI).rem_euclid(TAU) - PI
}

/// c₀ + c₁ x + c₂ x² + …
fn polynomial(ascending: &[f64], x: Complex<f64>) -> Complex<f64> {
    ascending.iter().rev().fold(Complex::new(0.0, 0.0), |sum, c| sum * x + c)
}

/// Roots of c₀ xⁿ + c₁ xⁿ⁻¹ + … + cₙ, as eigenvalues of its companion matrix; trailing zeros of `descending` are roots
/// at 0 and left out, leading zeros do not count. NaN when they are not found, for example for NaN coefficients.
pub(crate) fn roots(descending: &[f64]) -> Vec<Complex<f64>> {
    let first = descending.iter().position(|c| *c != 0.0).unwrap_or(descending.len());
    let end = descending.iter().rposition(|c| *c != 0.0).map_or(0, |last| last + 1);
    let Some((lead, rest)) = descending.get(first..end).and_then(<[f64]>::split_first) else { return Vec::new() };
    let n = rest.len();
    if n == 0 {
        return Vec::new();
    }
    let companion = DMatrix::from_fn(n, n, |row, column| match row {
        0 => -rest[column] / lead,
        _ => f64::from(u8::from(row == column + 1)),
    });
    eigenvalues(&companion).unwrap_or_else(|| vec![Complex::new(f64::NAN, f64::NAN); n])
}

/// Coefficients of Π(z − root), highest power first; roots come with their conjugates.
pub(in crate::identify) fn monic(of: impl IntoIterator<Item = Complex<f64>>) -> Vec<f64> {
    let mut product = vec![Complex::new(1.0, 0.0)];
    for root in of {
        product.push(Complex::new(0.0, 0.0));
        for k in (1..product.len()).rev() {
            let lower = product[k - 1];
            product[k] -= lower * root;
        }
    }
    product.iter().map(|c| c.re).collect()
}

/// Σ b_j u(t − delay − j), zero before the first sample.
fn moving_sum(b: &[f64], delay: usize, input: &[f64]) -> Vec<f64> {
    let at = |t: usize| -> f64 {
        t.checked_sub(delay).map_or(0.0, |t| b.iter().zip(input[..=t].iter().rev()).map(|(b, u)| b * u).sum())
    };
    (0..input.len()).map(at).collect()
}

/// y(t) = x(t) − a₁ y(t−1) − …, in place.
pub(in crate::identify) fn all_pole(a: &[f64], mut signal: Vec<f64>) -> Vec<f64> {
    for t in 0..signal.len() {
        let (past, now) = signal.split_at_mut(t);
        if let Some(now) = now.first_mut() {
            *now -= a.iter().skip(1).zip(past.iter().rev()).map(|(a, y)| a * y).sum::<f64>();
        }
    }
    signal
}

#[cfg(test)]
mod tests {
    use super::*;

    fn second_order() -> Polynomials {
        Polynomials { a: vec![1.0, -1.5, 0.7], b: vec![1.0, 0.5], nk: 1 }
    }

    #[test]
    fn an_impulse_by_hand() {
        // y0 = 0, y1 = 1, y2 = 1.5 + 0.5, y3 = 1.5·2 − 0.7·1
        let y = second_order().simulate(&[1.0, 0.0, 0.0, 0.0]);
        assert_eq!(y, [0.0, 1.0, 2.0, 2.3]);
    }

    #[test]
    fn prediction_of_its_own_output_is_exact() {
        let model = second_order();
        let u: Vec<f64> = (0..50).map(|t| f64::from(t * t % 7) - 3.0).collect();
        let y = model.simulate(&u);
        let predicted = model.predict(&u, &y);
        assert_eq!(predicted.len(), 48);
        assert!(predicted.iter().zip(&y[2..]).all(|(p, y)| (p - y).abs() < 1e-12));
    }

    #[test]
    fn poles_gain_and_response_by_hand() {
        let model = second_order();
        // z² − 1.5 z + 0.7: 0.75 ± i √(0.7 − 0.5625)
        let poles = model.poles();
        assert!(poles.iter().all(|p| (p.re - 0.75).abs() < 1e-12 && (p.im.abs() - 0.1375_f64.sqrt()).abs() < 1e-12));
        assert!((model.largest_pole() - 0.7_f64.sqrt()).abs() < 1e-12);
        assert!((model.gain() - 7.5).abs() < 1e-12);
        assert!((model.response(0.0) - 7.5).norm() < 1e-12);
        // At the Nyquist frequency q⁻¹ = −1: B = −(1 − 0.5), A = 1 + 1.5 + 0.7.
        assert!((model.response(std::f64::consts::PI) + 0.5 / 3.2).norm() < 1e-12);
    }

    #[test]
    fn a_leading_zero_is_no_degree_and_a_last_one_a_root_at_zero() {
        assert!(roots(&[]).is_empty() && roots(&[2.0]).is_empty() && roots(&[0.0, 0.0]).is_empty());
        assert_eq!(roots(&[0.0, 1.0, -0.5, 0.0]), [Complex::new(0.5, 0.0)]);
    }
}
