//! A discrete system of several inputs and outputs: x(t+1) = A x(t) + B u(t), y(t) = C x(t).

use super::Motion;
use crate::identify::reduce::balance::Balanced;
use crate::identify::reduce::gramian::{band_factors, factor};
use crate::identify::solve::decompositions::{eigenvalues, svd};
use nalgebra::{Complex, DMatrix, DVector};

/// Less than this part of the largest is rounding.
const LEAST: f64 = 1e-12;

/// A, B and C.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct System {
    pub(crate) a: DMatrix<f64>,
    pub(crate) b: DMatrix<f64>,
    pub(crate) c: DMatrix<f64>,
}

impl System {
    /// Number of states.
    pub(crate) fn order(&self) -> usize {
        self.a.nrows()
    }

    /// Outputs, a row a sample, from a state under these inputs, a row a sample.
    pub(crate) fn run(&self, start: &DVector<f64>, input: &DMatrix<f64>) -> DMatrix<f64> {
        let mut output = DMatrix::zeros(input.nrows(), self.c.nrows());
        let mut state = start.clone();
        for (mut row, u) in output.row_iter_mut().zip(input.row_iter()) {
            row.copy_from(&(&self.c * &state).transpose());
            state = &self.a * state + &self.b * u.transpose();
        }
        output
    }

    /// Outputs from the state that fits the record best; `None` when there is none, or they grow without end.
    pub(crate) fn simulated(&self, record: &Motion) -> Option<DMatrix<f64>> {
        let n = self.order();
        let forced = self.run(&DVector::zeros(n), &record.input);
        // What each state leaves behind, while it lasts.
        let (mut normal, mut target) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let mut seen = self.c.clone();
        for (measured, forced) in record.output.row_iter().zip(forced.row_iter()) {
            for (k, (y, f)) in measured.iter().zip(forced.iter()).enumerate() {
                if y.is_finite() {
                    let row = seen.row(k).transpose();
                    target += &row * (y - f);
                    normal += &row * row.transpose();
                }
            }
            seen *= &self.a;
            if !seen.amax().is_finite() || seen.amax() < LEAST * self.c.amax() {
                break;
            }
        }
        let normal = svd(normal)?;
        let start = normal.solve(&target, LEAST * normal.singular_values.max()).ok()?;
        let output = self.run(&start, &record.input);
        output.iter().all(|v| v.is_finite()).then_some(output)
    }

    /// The response to sines of `omega` radians per sample: a row per output, a column per input.
    pub(crate) fn response(&self, omega: f64) -> Option<DMatrix<Complex<f64>>> {
        let complex = |matrix: &DMatrix<f64>| matrix.map(|v| Complex::new(v, 0.0));
        let n = self.order();
        let resolvent = DMatrix::identity(n, n) * Complex::from_polar(1.0, omega) - complex(&self.a);
        Some(complex(&self.c) * resolvent.lu().solve(&complex(&self.b))?)
    }

    /// Whether all poles lie within the unit circle.
    pub(crate) fn is_stable(&self) -> bool {
        eigenvalues(&self.a).is_some_and(|poles| poles.iter().all(|pole| pole.norm() < 1.0))
    }

    /// Coordinates in which states are driven and seen alike, for a band of frequencies (radians per sample) or for
    /// all; `None` when the system is not stable.
    pub(crate) fn balanced(&self, band: Option<(f64, f64)>) -> Option<Balanced> {
        if !self.is_stable() {
            return None;
        }
        Balanced::of(match band {
            Some(band) => band_factors(&self.a, &self.b, &self.c, band)?,
            None => [factor(&self.a, &self.b)?, factor(&self.a.transpose(), &self.c.transpose())?],
        })
    }

    /// The first `keep` states of these coordinates; all, if there are fewer.
    pub(crate) fn truncated(&self, to: &Balanced, keep: usize) -> Self {
        let keep = keep.min(to.into.ncols());
        let (into, from) = (to.into.columns(0, keep), to.from.rows(0, keep));
        Self { a: from * &self.a * into, b: from * &self.b, c: &self.c * into }
    }
}
