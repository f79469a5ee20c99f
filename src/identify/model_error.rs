//! What a model leaves because its order is too low.
//!
//! In: the full model and the refined one of a lower order, and the data that both were fitted to. Out: what both leave
//! of the output in simulation, if the lower order leaves clearly more. The full model tells the noise: what the other
//! leaves beyond that follows the input, and does not average out. σ of the refined model counts all of it as noise,
//! and would be too small: it is then not given.
//!
//! What it cannot detect: an error of the order that the full model has too.

use super::data::Segment;
use super::estimated::Estimated;
use super::fit::{InitialState, Kind, compare};

/// Ratio of the mean squares, corrected for the number of coefficients, from which it is told. Of 20 systems of second
/// order, with 1000 samples each and a full model of order 8, the largest ratio is below 1.1 (a test).
const RATIO: f64 = 1.25;
/// Less than this of the output's energy is told by no one: rounding, or a record without noise.
const LEAST_PERCENT: f64 = 1e-4;

/// What two models leave of the output, % of its energy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelError {
    /// The refined model.
    pub refined_percent: f64,
    /// The full one.
    pub full_percent: f64,
}

impl ModelError {
    /// `None` where the refined model leaves hardly more than the full one.
    pub(super) fn of(
        training: &[Segment],
        full: &Estimated,
        refined: &Estimated,
        initial_state: InitialState,
    ) -> Option<Self> {
        let left = |found: &Estimated| {
            let error = compare(&found.model, training, Kind::Simulation(initial_state));
            let free = error.samples.saturating_sub(found.model.parameters().len()).max(1) as f64;
            (error.error_percent, error.error_percent * error.samples as f64 / free)
        };
        let ((refined_percent, refined), (full_percent, full)) = (left(refined), left(full));
        (refined > LEAST_PERCENT && refined > RATIO * full).then_some(Self { refined_percent, full_percent })
    }
}
