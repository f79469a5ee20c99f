//! How well a model reproduces a record: simulated from the input alone, and predicted one step ahead.
//!
//! Error as in the paper: energy of the difference in percent of the energy of the observed signal, 100 Σ(y−ŷ)²/Σy².
//! Fit as common elsewhere: 100 (1 − ‖y−ŷ‖/‖y−ȳ‖). Both for the signals as identified, with trends removed.

use crate::identify::data::segments::Segment;
use crate::identify::model::polynomials::Polynomials;
use crate::identify::solve::decompositions::svd;
use nalgebra::DMatrix;

/// The initial state of a segment is estimated from at most this many samples.
const STATE_SAMPLES: usize = 1024;

/// The initial state of a simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum InitialState {
    /// At rest; where a segment begins after a hole, as [`InitialState::Estimated`].
    #[default]
    Rest,
    /// The state that fits the segment best, by least squares.
    Estimated,
}

/// Kind of comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Output from input alone.
    Simulation(InitialState),
    /// Output one step ahead, from what was observed before.
    Prediction,
}

/// Size of the difference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitError {
    /// 100 Σ(y−ŷ)²/Σy².
    pub error_percent: f64,
    /// 100 (1 − ‖y−ŷ‖/‖y−ȳ‖).
    pub fit_percent: f64,
    /// Root mean square of the difference, unit of the output.
    pub rms: f64,
    /// Samples compared.
    pub samples: usize,
}

/// Compares all segments. NaN where there is nothing to compare, or the observed signal is zero; infinite where an
/// unstable model overflowed.
pub(in crate::identify) fn compare(model: &Polynomials, segments: &[Segment], kind: Kind) -> FitError {
    let mut sums = Sums::default();
    for segment in segments {
        let modelled = output(model, segment, kind);
        let observed = &segment.output[segment.len() - modelled.len()..segment.len()];
        match kind {
            Kind::Simulation(_) => sums.add(observed, &modelled),
            // Without a full past nothing is predicted.
            Kind::Prediction => {
                let both = observed.iter().zip(&modelled).filter(|(_, m)| !m.is_nan());
                let (observed, modelled): (Vec<f64>, Vec<f64>) = both.unzip();
                sums.add(&observed, &modelled);
            }
        }
    }
    sums.error()
}

/// Output of the model for one segment. A prediction is shorter than the segment by the model's memory, at its
/// beginning.
pub(crate) fn output(model: &Polynomials, segment: &Segment, kind: Kind) -> Vec<f64> {
    match kind {
        Kind::Prediction => model.predict(&segment.input, &segment.output),
        Kind::Simulation(InitialState::Rest) if segment.from_rest => model.simulate(&segment.input),
        Kind::Simulation(_) => from_fitted_state(model, segment),
    }
}

/// What the model leaves of the output in simulation, from rest if the segment begins there; NaN where it is missing.
pub(in crate::identify) fn left(model: &Polynomials, segment: &Segment) -> Vec<f64> {
    let modelled = output(model, segment, Kind::Simulation(InitialState::Rest));
    segment.output.iter().zip(modelled).map(|(y, m)| y - m).collect()
}

/// The factor with which a model's output would fit best, Σ y ŷ / Σ ŷ².
pub(in crate::identify) fn best_gain(model: &Polynomials, segments: &[Segment], initial_state: InitialState) -> f64 {
    let (mut product, mut energy) = (0.0, 0.0);
    for segment in segments {
        let modelled = output(model, segment, Kind::Simulation(initial_state));
        for (y, m) in segment.output.iter().zip(&modelled).filter(|(y, _)| !y.is_nan()) {
            product += y * m;
            energy += m * m;
        }
    }
    product / energy
}

fn from_fitted_state(model: &Polynomials, segment: &Segment) -> Vec<f64> {
    let mut output = model.simulate(&segment.input);
    if let Some(free) = free_response(model, segment, &output) {
        output.iter_mut().zip(&free).for_each(|(y, free)| *y += free);
    }
    output
}

/// The contribution of a segment's initial state to the output from rest, `simulated`, by least squares. Every state of
/// B/A acts as the response of 1/A to one of the first [`Polynomials::memory`] samples. Of a segment that is shorter
/// some state explains everything. `None` when the numbers overflow, or there is no state.
pub(in crate::identify) fn free_response(
    model: &Polynomials,
    segment: &Segment,
    simulated: &[f64],
) -> Option<Vec<f64>> {
    let states = model.memory();
    if states == 0 {
        return None;
    }
    if segment.len() < states {
        let left = segment.output.iter().zip(simulated).map(|(y, m)| if y.is_nan() { 0.0 } else { y - m });
        return Some(left.collect());
    }
    let at = model.free_responses(segment.len());
    let reach = segment.len().min(STATE_SAMPLES);
    // The last column is the residual.
    let columns = DMatrix::from_fn(reach, states + 1, |t, column| match column {
        _ if segment.output[t].is_nan() => 0.0,
        last if last == states => segment.output[t] - simulated[t],
        state => at(t, state),
    });
    if columns.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let r = columns.qr().r();
    let svd = svd(r.view((0, 0), (states, states)).into_owned())?;
    // Slow poles make neighbouring responses nearly equal: components that the data do not determine are set to zero.
    let tolerance = svd.singular_values.max() * 1e-12;
    let state = svd.solve(&r.view((0, states), (states, 1)), tolerance).ok()?;
    let free = |t: usize| state.iter().enumerate().map(|(k, x)| x * at(t, k)).sum();
    state.iter().all(|x| x.is_finite()).then(|| (0..segment.len()).map(free).collect())
}

/// Sums over pairs of observed and modelled values; missing outputs are left out.
#[derive(Debug, Default)]
struct Sums {
    difference: f64,
    energy: f64,
    total: f64,
    samples: usize,
}

impl Sums {
    fn add(&mut self, observed: &[f64], modelled: &[f64]) {
        for (y, m) in observed.iter().zip(modelled).filter(|(y, _)| !y.is_nan()) {
            self.difference += (y - m) * (y - m);
            self.energy += y * y;
            self.total += y;
            self.samples += 1;
        }
    }

    fn error(&self) -> FitError {
        let n = self.samples as f64;
        let difference = if self.difference.is_nan() { f64::INFINITY } else { self.difference };
        let about_mean = self.energy - self.total * self.total / n;
        FitError {
            error_percent: 100.0 * difference / self.energy,
            fit_percent: 100.0 * (1.0 - (difference / about_mean).sqrt()),
            rms: (difference / n).sqrt(),
            samples: self.samples,
        }
    }
}

/// The error between two signals of the same length.
#[cfg(test)]
fn between(observed: &[f64], modelled: &[f64]) -> FitError {
    let mut sums = Sums::default();
    sums.add(observed, modelled);
    sums.error()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> Polynomials {
        Polynomials { a: vec![1.0, -1.6, 0.68], b: vec![0.3, 0.1], nk: 2 }
    }

    fn segment(from: usize) -> Segment {
        let input: Vec<f64> = (0..400).map(|t| f64::from(t * t % 11) - 5.0).collect();
        let output = model().simulate(&input);
        Segment { input, output, from_rest: true, ..Segment::default() }.part(from, 400, 1.0)
    }

    #[test]
    fn errors_by_hand() {
        let error = between(&[1.0, 2.0, 3.0], &[1.0, 2.0, 4.0]);
        assert!((error.error_percent - 100.0 / 14.0).abs() < 1e-12);
        assert!((error.fit_percent - 100.0 * (1.0 - (1.0_f64 / 2.0).sqrt())).abs() < 1e-12);
        assert!((error.rms - (1.0_f64 / 3.0).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_segment_from_the_middle_needs_its_state_and_finds_it() {
        let part = segment(100);
        assert!(!part.from_rest);
        let rest = between(&part.output, &model().simulate(&part.input));
        let fitted = compare(&model(), &[part], Kind::Simulation(InitialState::Rest));
        assert!(rest.error_percent > 0.1, "{rest:?}");
        assert!(fitted.error_percent < 1e-20, "{fitted:?}");
    }

    #[test]
    fn from_rest_nothing_is_fitted() {
        let mut whole = segment(0);
        whole.output[0] += 1.0;
        let rest = output(&model(), &whole, Kind::Simulation(InitialState::Rest));
        assert_eq!(rest, model().simulate(&whole.input));
        let fitted = output(&model(), &whole, Kind::Simulation(InitialState::Estimated));
        assert!((fitted[0] - rest[0]).abs() > 0.1);
    }

    #[test]
    fn an_unstable_model_is_infinitely_wrong_not_a_number() {
        let model = Polynomials { a: vec![1.0, -9.0], b: vec![1.0], nk: 1 };
        let error = compare(&model, &[segment(0)], Kind::Simulation(InitialState::Rest));
        assert_eq!(error.error_percent, f64::INFINITY);
    }
}
