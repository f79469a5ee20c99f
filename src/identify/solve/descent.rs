//! Gauss-Newton steps with Levenberg-Marquardt damping, down to a minimum of a sum of squares.
//!
//! In: a start, its cost, and the triangle of derivatives and residual at a place ([`Triangle`](super::regression)).
//! Out: the place of a local minimum. Steps are solved from the triangle: normal equations would lose half the digits.

use crate::identify::solve::regression::solve;
use nalgebra::{DMatrix, DVector};

/// Least damping, and the most, with which a step is too short to change anything.
const DAMPING: (f64, f64) = (1e-12, 1e8);

/// How a search begins and when it ends.
#[derive(Debug, Clone, Copy)]
pub(in crate::identify) struct Descent {
    pub(in crate::identify) first_damping: f64,
    /// Relative decrease of the cost that ends it.
    pub(in crate::identify) tolerance: f64,
    /// Most steps, also those that are not taken because they lead up.
    pub(in crate::identify) max_steps: usize,
}

/// The lowest place found.
#[derive(Debug, Clone)]
pub(in crate::identify) struct Lowest<S> {
    pub(in crate::identify) at: S,
    pub(in crate::identify) cost: f64,
    pub(in crate::identify) steps: usize,
    /// Whether it is a minimum, or the steps did not suffice.
    pub(in crate::identify) converged: bool,
}

impl Descent {
    /// Searches from `start`. `cost` is infinite where the search must not go. `None` when the start has no finite
    /// cost, or a place has no derivatives, or dependent ones.
    pub(in crate::identify) fn run<S>(
        self,
        start: S,
        cost: impl Fn(&S) -> f64,
        triangle: impl Fn(&S) -> Option<DMatrix<f64>>,
        moved: impl Fn(&S, &DVector<f64>) -> S,
    ) -> Option<Lowest<S>> {
        let mut lowest = Lowest { cost: cost(&start), at: start, steps: 0, converged: false };
        if !lowest.cost.is_finite() {
            return None;
        }
        let mut damping = self.first_damping;
        let mut known = None;
        while lowest.steps < self.max_steps && !lowest.converged {
            lowest.steps += 1;
            let here = known.take().map_or_else(|| triangle(&lowest.at), Some)?;
            let trial = moved(&lowest.at, &damped_step(&here, damping)?);
            let trial_cost = cost(&trial);
            if trial_cost < lowest.cost {
                lowest.converged = lowest.cost - trial_cost <= self.tolerance * lowest.cost;
                (lowest.at, lowest.cost) = (trial, trial_cost);
                damping = f64::max(damping * 0.1, DAMPING.0);
            } else {
                // No improvement even with tiny steps: the minimum.
                lowest.converged = damping > DAMPING.1;
                damping *= 10.0;
                known = Some(here);
            }
        }
        Some(lowest)
    }
}

/// Solves with the columns' norms, times √damping, appended below the triangle.
fn damped_step(triangle: &DMatrix<f64>, damping: f64) -> Option<DVector<f64>> {
    let p = triangle.ncols().checked_sub(1)?;
    let mut columns = triangle.clone().resize_vertically(triangle.nrows() + p, 0.0);
    for k in 0..p {
        columns[(triangle.nrows() + k, k)] = triangle.column(k).norm() * f64::sqrt(damping);
    }
    solve(columns).map(|solution| solution.parameters)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DESCENT: Descent = Descent { first_damping: 1e-4, tolerance: 1e-12, max_steps: 100 };

    /// √x seen as 0.1: from 0.5 a whole step leads below zero, where it has no value.
    fn root(descent: Descent, start: f64, derivative: impl Fn(f64) -> f64) -> Option<Lowest<f64>> {
        let residual = |x: f64| 0.1 - x.sqrt();
        let cost = |x: &f64| if *x > 0.0 { residual(*x).powi(2) } else { f64::INFINITY };
        let triangle = |x: &f64| Some(DMatrix::from_row_slice(1, 2, &[derivative(*x), residual(*x)]));
        descent.run(start, cost, triangle, |x, step| x + step[0])
    }

    #[test]
    fn steps_to_where_there_is_no_cost_are_shortened() {
        let found = root(DESCENT, 0.5, |x| 0.5 / x.sqrt()).unwrap();
        assert!(found.converged && (found.at - 0.01).abs() < 1e-9, "{found:?}");
        assert!(found.cost < 1e-18, "{found:?}");
    }

    #[test]
    fn what_has_no_end_or_no_derivatives_is_told() {
        let short = root(Descent { max_steps: 3, ..DESCENT }, 0.5, |x| 0.5 / x.sqrt()).unwrap();
        assert!(!short.converged && short.steps == 3, "{short:?}");
        // With the wrong sign every step leads up, until they are too short to be any.
        let stuck = root(DESCENT, 0.5, |x| -0.5 / x.sqrt()).unwrap();
        assert!(stuck.converged && stuck.at == 0.5, "{stuck:?}");
        assert!(root(DESCENT, -1.0, |_| 1.0).is_none());
        assert!(root(DESCENT, 0.5, |_| 0.0).is_none());
    }
}
