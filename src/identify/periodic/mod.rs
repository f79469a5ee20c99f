//! A model from a record whose input repeats, in the frequency domain.
//!
//! ```text
//!  periods ─▶ average ─▶ lines with their noise ─▶ likelihood ─▶ B/A with covariance, and what noise does not explain
//! ```
//! What repeats is the system's response, the rest is noise: no noise model is needed, only that noise is uncorrelated
//! between periods. Feedback (Eq. 6) does no harm, because noise in the input from the output is part of their
//! covariance.
//!
//! It cannot separate non-linear response that repeats with the input; `left` above 1 is a sign of it, and widens σ.

mod average;
mod likelihood;
mod repeating;
#[cfg(test)]
mod tests;

pub(crate) use average::{Averaged, Line};
pub(crate) use repeating::unrepeated;

use crate::identify::data::segments::Record;
use crate::identify::estimate::estimated::{Estimated, Refined};
use crate::identify::estimate::initial_models::initial_models;
use crate::identify::estimate::shortest_delay::shortest;
use crate::identify::model::polynomials::{Orders, Polynomials};
use crate::identify::reduce::truncation::Target;

/// Highest order that `auto` tries.
const MAX_ORDER: usize = 6;

/// Declares that the input repeats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Repeats {
    /// Period, seconds.
    pub every_s: f64,
    /// Periods left out at the beginning of a record, while the system settles.
    pub skip: usize,
}

/// The model, and the data it is based on.
#[derive(Debug, Clone)]
pub struct Periodic {
    /// The model.
    pub refined: Refined,
    /// The records, averaged.
    pub records: Vec<Averaged>,
    /// Residual of the lines relative to noise (1).
    pub left: f64,
    /// σ of `left` for noise alone.
    pub left_sd: f64,
    /// Other delays with which a model explains the lines about as well, samples (nk), rising.
    pub other_delays: Vec<usize>,
}

/// Residual over noise up to which σ, widened by it, is still one of noise: beyond, what the model lacks decides.
const MOST_LEFT: f64 = 4.0;

impl Periodic {
    /// Whether the model leaves hardly more than noise, so that its errors are those of noise.
    pub(crate) fn explains_lines(&self) -> bool {
        self.left < MOST_LEFT
    }

    /// Lines of all records.
    pub fn lines(&self) -> impl Iterator<Item = &Line> {
        self.records.iter().flat_map(|r| &r.lines)
    }
}

/// Fits a model of `target` states to all records, with the shortest of `delays` that explains the lines about as well
/// as any.
/// `others`: additional initial models.
///
/// # Errors
/// A message: the input does not repeat often enough, or its lines do not determine the model.
pub(crate) fn fit(
    records: &[Record],
    period_s: f64,
    repeats: Repeats,
    target: Target,
    delays: &[usize],
    others: &[Polynomials],
) -> Result<Periodic, String> {
    let average = |r: &Record| {
        average::average(&r.segments, period_s, repeats.every_s, repeats.skip).map_err(|e| format!("{}: {e}", r.name))
    };
    let averaged = records.iter().map(average).collect::<Result<Vec<_>, _>>()?;
    let segments: Vec<_> = records.iter().flat_map(|r| r.segments.iter().cloned()).collect();
    let lines = averaged.iter().map(|r| r.lines.len()).sum::<usize>() as f64;
    let orders = match target {
        Target::Order(n) => n..=n,
        Target::Auto => 1..=MAX_ORDER,
    };
    // ln of the residual, plus the penalty for each coefficient (minimum description length).
    let value = |left: f64, parameters: usize| left.ln() + parameters as f64 * (2.0 * lines).ln() / (2.0 * lines);
    let mut best: Option<(f64, Vec<likelihood::Found>)> = None;
    for n in orders {
        let with_delay = |nk: &usize| {
            let orders = Orders { na: n, nb: n, nk: *nk };
            let mut initial = initial_models(&segments, orders);
            initial.extend(others.iter().filter(|m| m.orders() == orders).cloned());
            likelihood::fit(&averaged, orders, &initial)
        };
        let found: Vec<_> = delays.iter().filter_map(with_delay).collect();
        let Some(left) = found.iter().map(|found| found.left).min_by(f64::total_cmp) else { continue };
        let value = value(left, Orders { na: n, nb: n, nk: 0 }.parameters());
        if best.as_ref().is_none_or(|(least, _)| value < *least) {
            best = Some((value, found));
        }
    }
    let (found, other_delays) = best.and_then(|(_, found)| shortest(&found)).ok_or_else(|| {
        format!(
            "{lines} lines stand out of the noise, and no stable model of the order asked for follows from them: a \
             lower order, more periods, or a stronger input may do"
        )
    })?;
    let likelihood::Found { estimated, left, left_sd, steps, converged, .. } = found;
    Ok(Periodic { refined: Refined { estimated, steps, converged }, records: averaged, left, left_sd, other_delays })
}

impl Periodic {
    /// The model with its covariance.
    pub fn estimated(&self) -> &Estimated {
        &self.refined.estimated
    }
}
