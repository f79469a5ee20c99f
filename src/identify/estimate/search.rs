//! Search for orders and delay: every candidate is fitted from one factorisation, and judged.
//!
//! In: segments to fit, validation segments, candidates. Out: one row per candidate. All candidates are fitted to the
//! same samples, those that the largest of them can use, so that their losses are comparable. Order and delay are
//! searched together: a delay taken from a scan at low order can make every higher order unstable.

use crate::identify::IdentifyError;
use crate::identify::data::segments::Segment;
use crate::identify::model::polynomials::{Orders, Polynomials};
use crate::identify::model::reproduction::{FitError, InitialState, Kind, compare};
use crate::identify::solve::regression::{Triangle, row, solve};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Of the candidates within this factor of the smallest validation error, the one with the fewest coefficients is best.
const NEAR_BEST: f64 = 1.05;

/// A candidate model and its results.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// Orders and delay.
    pub orders: Orders,
    /// The model.
    pub model: Polynomials,
    /// Mean squared residual of the fit.
    pub loss: f64,
    /// Akaike's criterion, ln V + 2p/N.
    pub aic: f64,
    /// Rissanen's minimum description length, ln V + p ln N / N.
    pub mdl: f64,
    /// One step ahead on the validation data.
    pub prediction: Option<FitError>,
    /// From the input alone on the validation data.
    pub simulation: Option<FitError>,
    /// Modulus of the largest pole.
    pub largest_pole: f64,
}

impl Candidate {
    /// Its value by the criterion: smaller is better. `None` without validation data.
    pub fn value(&self, criterion: Criterion) -> Option<f64> {
        match criterion {
            Criterion::Aic => Some(self.aic),
            Criterion::Mdl => Some(self.mdl),
            Criterion::Prediction => self.prediction.map(|e| e.error_percent),
            Criterion::Simulation => self.simulation.map(|e| e.error_percent),
        }
    }
}

/// Criterion for the best candidate. Unstable ones are never chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Criterion {
    /// Akaike's criterion on the data fitted.
    Aic,
    /// Minimum description length on the data fitted.
    Mdl,
    /// Prediction error on the validation data.
    Prediction,
    /// Simulation error on the validation data.
    Simulation,
}

impl Criterion {
    /// The rule by which [`best`] chooses, for people.
    pub(crate) fn rule(self) -> &'static str {
        match self {
            Self::Aic => "the least by Akaike's criterion",
            Self::Mdl => "the least description length",
            Self::Prediction => "the fewest coefficients within 5 % of the best prediction of the validation data",
            Self::Simulation => "the fewest coefficients within 5 % of the best simulation of the validation data",
        }
    }
}

/// All candidates that `train` determines, in the order given.
///
/// # Errors
/// [`IdentifyError::TooShort`] when `train` has not enough samples for the largest of them.
pub fn search(
    train: &[Segment],
    test: &[Segment],
    initial_state: InitialState,
    candidates: &[Orders],
) -> Result<Vec<Candidate>, IdentifyError> {
    let candidates = &fitting(train, candidates);
    let most = |of: fn(&Orders) -> usize| candidates.iter().map(of).max().unwrap_or(0);
    let first_lag = candidates.iter().map(|o| o.nk).min().unwrap_or(0);
    let lags = most(|o| o.nk + o.nb).saturating_sub(first_lag);
    let largest = Orders { na: most(|o| o.na), nb: lags, nk: first_lag };
    // 1. the triangle of the model that contains them all
    let mut triangle = Triangle::new(largest.parameters() + 1);
    for segment in train {
        for t in largest.memory()..segment.len() {
            triangle.push(row(segment, t, (largest.na, largest.nb, largest.nk)));
        }
    }
    let samples = triangle.rows();
    let widest = most(Orders::parameters);
    if samples <= widest {
        let longest = train.iter().map(Segment::len).max().unwrap_or(0);
        return Err(IdentifyError::TooShort { orders: largest, rows: samples, longest });
    }
    let all = triangle.finish();
    // 2. each candidate from its columns
    let judged = |orders: &Orders| {
        let columns = columns(&all, largest, *orders);
        let solution = solve(columns)?;
        let model = Polynomials::of(solution.parameters.as_slice(), orders.na, orders.nk);
        let (n, p) = (samples as f64, orders.parameters() as f64);
        let loss = solution.residual / n;
        // Without noise the loss may be zero; the penalty then decides.
        let ln_loss = loss.max(f64::MIN_POSITIVE).ln();
        let on_test = |kind| (!test.is_empty()).then(|| compare(&model, test, kind));
        Some(Candidate {
            orders: *orders,
            loss,
            aic: ln_loss + 2.0 * p / n,
            mdl: ln_loss + p * n.ln() / n,
            prediction: on_test(Kind::Prediction),
            simulation: on_test(Kind::Simulation(initial_state)),
            largest_pole: model.largest_pole(),
            model,
        })
    };
    Ok(candidates.par_iter().filter_map(judged).collect())
}

/// Drops the largest candidates, order by order, until the record has more rows than any of them has coefficients; the
/// smallest stay in any case.
fn fitting(train: &[Segment], candidates: &[Orders]) -> Vec<Orders> {
    let mut left = candidates.to_vec();
    loop {
        let memory = left.iter().map(Orders::memory).max().unwrap_or(0);
        let widest = left.iter().map(Orders::parameters).max().unwrap_or(0);
        let narrowest = left.iter().map(Orders::parameters).min().unwrap_or(0);
        let has_past = |s: &Segment, t: usize| s.output[t - memory..=t].iter().all(|y| !y.is_nan());
        let rows: usize =
            train.iter().map(|s| (memory..s.len()).filter(|t| has_past(s, *t)).take(widest + 1).count()).sum();
        if rows > widest || widest == narrowest {
            return left;
        }
        left.retain(|orders| orders.parameters() < widest);
    }
}

/// The columns of one candidate in the triangle of the largest.
fn columns(all: &DMatrix<f64>, largest: Orders, orders: Orders) -> DMatrix<f64> {
    let inputs = largest.na + orders.nk - largest.nk;
    let chosen: Vec<usize> = (0..orders.na).chain(inputs..inputs + orders.nb).chain([largest.parameters()]).collect();
    all.select_columns(&chosen)
}

/// The best stable candidate. `None` when all are unstable, or there are no validation data.
pub(in crate::identify) fn best(candidates: &[Candidate], criterion: Criterion) -> Option<&Candidate> {
    let stable = || candidates.iter().filter(|c| c.largest_pole < 1.0);
    let value = |c: &Candidate| c.value(criterion);
    let smallest = stable().filter_map(value).filter(|v| v.is_finite()).min_by(f64::total_cmp)?;
    let enough = match criterion {
        Criterion::Aic | Criterion::Mdl => smallest,
        Criterion::Prediction | Criterion::Simulation => smallest * NEAR_BEST,
    };
    let good = stable().filter(|c| value(c).is_some_and(|v| v <= enough));
    good.min_by(|x, y| {
        let by = |c: &Candidate| (c.orders.parameters(), c.orders.nk);
        by(x).cmp(&by(y)).then(f64::total_cmp(&value(x).unwrap_or(f64::MAX), &value(y).unwrap_or(f64::MAX)))
    })
}
