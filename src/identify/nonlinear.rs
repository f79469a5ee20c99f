//! Whether a record says that the system is not linear: an amplifier that saturates, a dead zone, backlash.
//!
//! A long ARX model, with a constant, has room for any linear response and colour of the noise: what is left is white.
//! It is tested for four signals that no linear model makes from the input (a score test, Ljung, System Identification,
//! 2nd ed., section 16.4; static elements before and after a linear system: Hammerstein and Wiener models): the part
//! of the input beyond half of its largest value, the direction in which it last changed, and both of the simulated
//! output. If the system is linear each has a coefficient of zero, and its ratio to σ is normal.
//!
//! Cannot tell: which of input and output it is about, where one follows the other; what little noise hides in a record
//! that is sampled much faster than it moves; an input of two levels, whose amplitude is always the same.

use super::colour::Colour;
use super::data::{Record, Segment};
use super::model::Polynomials;
use super::regression::{Triangle, row, solve};
use nalgebra::{DMatrix, DVector};
use std::fmt;

/// Order of the model, and rows for each of its coefficients.
const ORDER: usize = 20;
const ROWS_PER_COEFFICIENT: usize = 10;
/// Ratio to σ beyond which a coefficient is told: chance is beyond in two records of a million.
const SIGNIFICANT_SD: f64 = 5.0;
/// Changes of the gain, and widths as a part of the signal's range, that are told.
const LEAST_CHANGE: f64 = 0.05;
const LEAST_WIDTH: f64 = 0.01;
/// Of a test signal, the part that the linear model cannot make, below which nothing can be told.
const LEAST_OWN: f64 = 1e-7;
/// Where a large amplitude begins, as a part of the largest.
const LARGE: f64 = 0.5;

/// What is not linear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Element {
    /// The gain beyond half of the largest amplitude, less that below it, over the mean gain.
    Gain(f64),
    /// The difference between rising and falling, as a part of the signal's range.
    Width(f64),
}

/// What a record says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nonlinear {
    /// The signal on which it depends: `input` or `output`.
    pub of: &'static str,
    /// What is not linear about it.
    pub element: Element,
    /// Its size over its σ, with its sign.
    pub sigmas: f64,
}

impl fmt::Display for Nonlinear {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { of, element, sigmas } = self;
        let sigmas = sigmas.abs();
        match element {
            Element::Gain(change) => {
                let percent = 100.0 * change.abs();
                let (more, why) = if *change < 0.0 {
                    ("smaller", "does the amplifier, or something in the way, limit it?")
                } else {
                    ("larger", "is there a dead zone, or friction?")
                };
                write!(
                    f,
                    "beyond half of the largest {of} the gain is {percent:.0} % {more} than below it ({sigmas:.0} σ): \
                     {why} A linear model holds for one amplitude"
                )
            }
            Element::Width(width) => write!(
                f,
                "what the output does depends on whether the {of} rises or falls, by {:.1} % of its range \
                 ({sigmas:.0} σ): is there backlash, friction, or hysteresis?",
                100.0 * width
            ),
        }
    }
}

/// The most significant of the four, if any is. `model` is a stable one of the record.
pub(super) fn nonlinear(model: &Polynomials, record: &Record) -> Option<Nonlinear> {
    let long = Long::of(record, model.nk)?;
    let Polynomials { a, b, nk } = &long.model;
    let input: Vec<Vec<f64>> = record.segments.iter().map(|s| s.input.clone()).collect();
    let output: Vec<Vec<f64>> = input.iter().map(|u| model.simulate(u)).collect();
    // An element before the system acts through B, one behind it through A.
    let before = Polynomials { a: vec![1.0], b: b.clone(), nk: *nk };
    let behind = Polynomials { a: vec![1.0], b: a.clone(), nk: 0 };
    let both = [("input", &input, before), ("output", &output, behind)];
    let tests = both.iter().flat_map(|(of, signal, through)| {
        let range = Range::of(signal);
        let beyond = |v: &f64| {
            let from_middle = v - range.middle;
            (from_middle.abs() - LARGE * range.largest).max(0.0).copysign(from_middle)
        };
        let amplitude: Vec<Vec<f64>> = signal.iter().map(|s| s.iter().map(beyond).collect()).collect();
        let direction: Vec<Vec<f64>> = signal.iter().map(|s| directions(s)).collect();
        let acting = |signal: Vec<Vec<f64>>| signal.iter().map(|s| through.simulate(s)).collect::<Vec<_>>();
        let gain = long.coefficient(&acting(amplitude)).map(|(g, sigmas)| (Element::Gain(g), sigmas));
        let width = |g: f64| Element::Width(2.0 * g.abs() / range.width);
        let width = long.coefficient(&acting(direction)).map(|(g, sigmas)| (width(g), sigmas));
        let large = |element: &Element| match element {
            Element::Gain(change) => change.abs() > LEAST_CHANGE,
            Element::Width(width) => *width > LEAST_WIDTH,
        };
        [gain, width].into_iter().flatten().filter(move |(element, _)| large(element)).map(|(e, z)| (*of, e, z))
    });
    let told = tests.filter(|(.., sigmas)| sigmas.abs() > SIGNIFICANT_SD);
    let (of, element, sigmas) = told.max_by(|a, b| a.2.abs().total_cmp(&b.2.abs()))?;
    Some(Nonlinear { of, element, sigmas })
}

/// The extent of a signal.
struct Range {
    middle: f64,
    largest: f64,
    width: f64,
}

impl Range {
    fn of(signal: &[Vec<f64>]) -> Self {
        let values = || signal.iter().flatten();
        let middle = values().sum::<f64>() / values().count().max(1) as f64;
        let (low, high) = values().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        Self { middle, largest: (high - middle).max(middle - low), width: high - low }
    }
}

/// Whether a signal last rose, 1, or fell, −1; 0 before it changes.
fn directions(signal: &[f64]) -> Vec<f64> {
    let (mut last, mut direction) = (signal.first().copied().unwrap_or(0.0), 0.0);
    let mut next = |value: &f64| {
        if *value != last {
            direction = (value - last).signum();
        }
        last = *value;
        direction
    };
    signal.iter().map(&mut next).collect()
}

/// A long model of one record, and what it was fitted to.
struct Long<'a> {
    segments: &'a [Segment],
    model: Polynomials,
    /// What it leaves of the output; NaN where there is no row.
    residual: Vec<Vec<f64>>,
}

impl<'a> Long<'a> {
    fn of(record: &'a Record, nk: usize) -> Option<Self> {
        let model = Polynomials { a: Vec::new(), b: Vec::new(), nk };
        let mut long = Self { segments: &record.segments, model, residual: Vec::new() };
        let parameters = long.solved(|_, _| None)?;
        let (linear, _) = parameters.as_slice().split_at_checked(2 * ORDER)?;
        long.model = Polynomials::of(linear, ORDER, nk);
        long.residual = long.left(&parameters, |_, _| None);
        Some(long)
    }

    /// Past outputs and inputs, a constant, and the output of every sample with a full past.
    fn rows(&self, segment: &'a Segment) -> impl Iterator<Item = (usize, Vec<f64>)> + use<'a> {
        let nk = self.model.nk;
        (ORDER + nk..segment.len()).map(move |t| {
            let mut row: Vec<f64> = row(segment, t, (ORDER, ORDER, nk)).collect();
            row.insert(2 * ORDER, 1.0);
            (t, row)
        })
    }

    /// Coefficients of the least-squares model of the output, or of another signal that `of` gives.
    fn solved(&self, of: impl Fn(usize, usize) -> Option<f64>) -> Option<DVector<f64>> {
        let mut triangle = Triangle::new(2 * ORDER + 2);
        for (k, segment) in self.segments.iter().enumerate() {
            for (t, mut row) in self.rows(segment) {
                // Without an output there is no row.
                if let (Some(value), Some(last)) = (of(k, t), row.last_mut().filter(|y| !y.is_nan())) {
                    *last = value;
                }
                triangle.push(row);
            }
        }
        if triangle.rows() < ROWS_PER_COEFFICIENT * (2 * ORDER + 1) {
            return None;
        }
        solve(triangle.finish()).map(|solution| solution.parameters)
    }

    /// What the model with these coefficients leaves of the output, or of another signal; NaN where there is no row.
    fn left(&self, parameters: &DVector<f64>, of: impl Fn(usize, usize) -> Option<f64>) -> Vec<Vec<f64>> {
        let part = |(k, segment): (usize, &'a Segment)| {
            let mut left = vec![f64::NAN; segment.len()];
            for (t, row) in self.rows(segment) {
                let modelled: f64 = row.iter().zip(parameters.iter()).map(|(r, p)| r * p).sum();
                let observed = row.last().copied().unwrap_or(f64::NAN);
                // NaN stays NaN.
                left[t] = of(k, t).map_or(observed, |value| value + 0.0 * observed) - modelled;
            }
            left
        };
        self.segments.iter().enumerate().map(part).collect()
    }

    /// The coefficient of a further signal, and its ratio to σ for a residual of any colour.
    fn coefficient(&self, signal: &[Vec<f64>]) -> Option<(f64, f64)> {
        let value = |k: usize, t: usize| signal.get(k)?.get(t).copied();
        let whole: f64 = signal.iter().flatten().map(|v| v * v).sum();
        let own = self.left(&self.solved(value)?, value);
        let mut left = self.residual.clone();
        let seen = || own.iter().flatten().copied().filter(|v| !v.is_nan());
        let (square, rows) = (seen().map(|v| v * v).sum::<f64>(), seen().count());
        if square.is_nan() || square <= LEAST_OWN * LEAST_OWN * whole {
            return None;
        }
        let pairs = own.iter().flatten().zip(left.iter().flatten());
        let coefficient = pairs.map(|(c, e)| c * e).filter(|v| !v.is_nan()).sum::<f64>() / square;
        left.iter_mut().flatten().zip(own.iter().flatten()).for_each(|(e, c)| *e -= coefficient * c);
        let squares: f64 = left.iter().flatten().filter(|e| !e.is_nan()).map(|e| e * e).sum();
        let sd = (squares / (rows - 2 * ORDER - 2) as f64).sqrt();
        let columns = own.iter().map(|part| {
            let known = part.iter().map(|v| if v.is_nan() { 0.0 } else { *v });
            DMatrix::from_iterator(part.len(), 1, known)
        });
        let columns: Vec<DMatrix<f64>> = columns.collect();
        let factor = Colour::of(&left).factor(&columns, &DMatrix::from_element(1, 1, square.sqrt().recip()));
        let sigmas = coefficient / (sd * factor.norm());
        sigmas.is_finite().then_some((coefficient, sigmas))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;
    use std::f64::consts::TAU;

    const SAMPLES: usize = 3000;

    fn model() -> Polynomials {
        Polynomials { a: vec![1.0, -1.6, 0.68], b: vec![0.05, 0.03], nk: 1 }
    }

    fn chirp() -> Vec<f64> {
        let at = |t: f64| (TAU * (0.2 * t + 4.0 * t * t / 50.0)).sin();
        (0..SAMPLES).map(|k| at(k as f64 / 60.0)).collect()
    }

    /// Levels that are held for `hold` samples.
    fn levels(hold: usize, seed: u64, level: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut random = Random::new(seed);
        let levels: Vec<f64> = (0..SAMPLES / hold).map(|_| level(2.0 * random.uniform() - 1.0)).collect();
        levels.into_iter().flat_map(|level| vec![level; hold]).collect()
    }

    /// What a record says whose input was `input`, while `real` acted.
    fn found(input: Vec<f64>, real: impl Fn(&[f64]) -> Vec<f64>, noise: f64, seed: u64) -> Option<Nonlinear> {
        let mut random = Random::new(seed);
        let clean = model().simulate(&real(&input));
        let output = clean.iter().enumerate().map(|(k, y)| {
            let noisy = y + noise * random.normal();
            if k % 97 == 50 { f64::NAN } else { noisy }
        });
        let segment = Segment { output: output.collect(), input, from_rest: true, ..Segment::default() };
        nonlinear(&model(), &Record { name: "r".to_owned(), segments: vec![segment] })
    }

    #[test]
    fn of_linear_records_nothing_is_told() {
        for seed in 1..=6 {
            let coarse = chirp().iter().map(|u| (u * 16.0).round() / 16.0).collect();
            let inputs =
                [chirp(), coarse, levels(30, seed, |u| u), levels(5, seed, f64::signum), levels(1, seed, |u| u)];
            for (k, input) in inputs.into_iter().enumerate() {
                let noise = [0.002, 0.02, 0.1][seed as usize % 3];
                assert_eq!(found(input, <[f64]>::to_vec, noise, seed), None, "input {k}, seed {seed}");
            }
        }
    }

    #[test]
    fn saturation_and_a_dead_zone_are_told() {
        let each = |of: fn(f64) -> f64| move |u: &[f64]| u.iter().map(|v| of(*v)).collect::<Vec<f64>>();
        for seed in 1..=3 {
            for input in [chirp(), levels(6, seed, |u| u)] {
                let clipped = found(input.clone(), each(|u| u.clamp(-0.8, 0.8)), 0.02, seed).unwrap();
                assert!(matches!(clipped.element, Element::Gain(change) if change < -0.1), "{clipped:?}");
                let dead = found(input.clone(), each(|u| u - u.clamp(-0.2, 0.2)), 0.02, seed).unwrap();
                assert!(matches!(dead.element, Element::Gain(change) if change > 0.1), "{dead:?}");
            }
        }
    }
}
