//! Residual analysis: correlation of a model's residuals with themselves and with the input.
//!
//! White residuals have no correlation at any lag but 0; residuals that a better model could explain correlate with the
//! input at lags 0 and above. They do so below lag 0 if the input was computed from the output, as by Eq. 6. Bounds
//! contain 99 % of the values when there is no correlation (Ljung, 2nd ed., section 16.6).

use crate::identify::data::segments::Segment;
use crate::identify::model::polynomials::{Noise, Polynomials};
use crate::identify::model::reproduction::{InitialState, Kind, output};

/// Lags evaluated.
const LAGS: usize = 25;
/// Most lags whose correlation widens the bound.
const MAX_BOUND_LAGS: usize = 400;
/// 99 % of a normal distribution lie within this many σ.
const SIGMAS_99: f64 = 2.576;

/// Fraction of correlations that may exceed the 99 % bound before it is reported.
const MAX_OUTSIDE: f64 = 0.1;

/// Correlations of residuals.
#[derive(Debug, Clone, PartialEq)]
pub struct Residuals {
    /// Autocorrelation, lags 0 to 25, 1 at lag 0.
    pub auto: Vec<f64>,
    /// Contains 99 % of [`Residuals::auto`], if white.
    pub auto_bound: f64,
    /// Correlation coefficients with the input, lags −25 to 25.
    pub cross: Vec<f64>,
    /// Contains 99 % of [`Residuals::cross`], if nothing is left to explain.
    pub cross_bound: f64,
    /// Root mean square, unit of the output.
    pub rms: f64,
    /// Samples.
    pub samples: usize,
}

/// Residuals of a segment, and the inputs at their times.
struct SegmentResiduals<'a> {
    residual: Vec<f64>,
    input: &'a [f64],
}

impl Residuals {
    /// Residuals according to the noise model: with noise at the equation, errors of the one-step predictions; with
    /// noise at the output, those of the simulation. `None` when there are not many more samples than lags.
    pub fn of(model: &Polynomials, segments: &[Segment], noise: Noise) -> Option<Self> {
        let memory = model.memory();
        let pairs: Vec<SegmentResiduals<'_>> = segments
            .iter()
            .filter(|s| s.len() > memory)
            .map(|s| {
                let modelled = match noise {
                    Noise::Equation => model.predict(&s.input, &s.output),
                    Noise::Output => output(model, s, Kind::Simulation(InitialState::Rest)).split_off(memory),
                };
                let left = s.output[memory..].iter().zip(&modelled).map(|(y, m)| y - m);
                SegmentResiduals { residual: left.collect(), input: &s.input[memory..s.len()] }
            })
            .collect();
        let samples: usize = pairs.iter().map(|p| p.residual.iter().filter(|e| !e.is_nan()).count()).sum();
        if samples < 4 * LAGS {
            return None;
        }
        let n = samples as f64;
        let inputs: usize = pairs.iter().map(|p| p.input.len()).sum();
        let mean = pairs.iter().flat_map(|p| p.input.iter()).sum::<f64>() / inputs as f64;
        // Σ x(t) y(t+lag) over all segments.
        let sum = |lag: usize, of: &dyn Fn(&SegmentResiduals<'_>, usize) -> f64| -> f64 {
            // Without a full past a sample has no residual.
            pairs.iter().map(|p| (lag..p.residual.len()).map(|t| of(p, t)).filter(|v| !v.is_nan()).sum::<f64>()).sum()
        };
        let (ee, uu) = (sum(0, &|p, t| p.residual[t] * p.residual[t]), sum(0, &|p, t| (p.input[t] - mean).powi(2)));
        let auto: Vec<f64> = (0..=LAGS).map(|lag| sum(lag, &|p, t| p.residual[t] * p.residual[t - lag]) / ee).collect();
        let input: Vec<f64> =
            (0..=LAGS).map(|lag| sum(lag, &|p, t| (p.input[t] - mean) * (p.input[t - lag] - mean)) / uu).collect();
        let scale = (ee * uu).sqrt();
        let later = |lag: usize| sum(lag, &|p, t| p.residual[t] * (p.input[t - lag] - mean)) / scale;
        let earlier = |lag: usize| sum(lag, &|p, t| p.residual[t - lag] * (p.input[t] - mean)) / scale;
        let cross = (1..=LAGS).rev().map(earlier).chain((0..=LAGS).map(later)).collect();
        // Variance of the estimate when the two are independent: Σ ρ_e ρ_u / N over all lags. Both may extend far
        // beyond the lags shown.
        let further = (samples / 4).min(MAX_BOUND_LAGS);
        let beyond = (LAGS + 1..further).map(|lag| {
            let auto = sum(lag, &|p, t| p.residual[t] * p.residual[t - lag]) / ee;
            auto * sum(lag, &|p, t| (p.input[t] - mean) * (p.input[t - lag] - mean)) / uu
        });
        let shown = auto.iter().zip(&input).skip(1).map(|(a, u)| a * u);
        let both: f64 = 1.0 + 2.0 * shown.chain(beyond).sum::<f64>();
        Some(Self {
            auto,
            auto_bound: SIGMAS_99 / n.sqrt(),
            cross,
            cross_bound: SIGMAS_99 * (both.max(1e-12) / n).sqrt(),
            rms: (ee / n).sqrt(),
            samples,
        })
    }

    /// Whether no more of them exceed their bounds than chance explains.
    pub fn look_white(&self) -> bool {
        ![self.auto_outside(), self.cross_outside(), self.fed_back()].into_iter().any(too_many)
    }

    /// The lag of an element of [`Residuals::cross`].
    pub fn cross_lag(index: usize) -> i64 {
        index as i64 - LAGS as i64
    }

    /// Number of lags 1 to 25 beyond the bound, and the total.
    pub fn auto_outside(&self) -> (usize, usize) {
        (self.auto.iter().skip(1).filter(|r| r.abs() > self.auto_bound).count(), LAGS)
    }

    /// Number of lags 0 to 25 beyond the bound, which the model did not explain, and the total.
    pub fn cross_outside(&self) -> (usize, usize) {
        (self.cross.iter().skip(LAGS).filter(|r| r.abs() > self.cross_bound).count(), LAGS + 1)
    }

    /// Number of lags −25 to −1 beyond the bound, which was fed back into the input, and the total.
    pub fn fed_back(&self) -> (usize, usize) {
        (self.cross.iter().take(LAGS).filter(|r| r.abs() > self.cross_bound).count(), LAGS)
    }
}

/// Whether `outside` of `of` lags are more than chance explains.
pub(in crate::identify) fn too_many((outside, of): (usize, usize)) -> bool {
    outside as f64 > MAX_OUTSIDE * of as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::estimate::arx::fit;
    use crate::identify::model::polynomials::{Orders, all_pole};
    use crate::identify::tests::noise;

    fn data(through: &[f64]) -> Segment {
        let truth = Polynomials { a: vec![1.0, -1.5, 0.7], b: vec![1.0, 0.5], nk: 1 };
        let input = noise(11, 5000);
        let disturbance = all_pole(through, noise(12, 5000));
        let output = truth.simulate(&input).iter().zip(disturbance).map(|(y, e)| y + 0.3 * e).collect();
        Segment { input, output, from_rest: true, ..Segment::default() }
    }

    #[test]
    fn the_right_model_leaves_white_residuals_and_a_smaller_one_does_not() {
        let segments = [data(&[1.0, -1.5, 0.7])];
        let of = |na, nb| {
            let model = fit(&segments, Orders { na, nb, nk: 1 }).unwrap().model;
            Residuals::of(&model, &segments, Noise::Equation).unwrap()
        };
        let right = of(2, 2);
        assert!(right.auto_outside().0 <= 1 && right.cross_outside().0 <= 1, "{right:?}");
        assert!((right.rms - 0.3).abs() < 0.01 && right.auto[0] == 1.0);
        let small = of(1, 1);
        assert!(small.auto_outside().0 > 5 && small.cross_outside().0 >= 1, "{small:?}");
    }

    #[test]
    fn white_noise_on_the_output_is_white_where_the_model_has_it_there() {
        let truth = Polynomials { a: vec![1.0, -1.5, 0.7], b: vec![1.0, 0.5], nk: 1 };
        let segments = [data(&[1.0])];
        let at_output = Residuals::of(&truth, &segments, Noise::Output).unwrap();
        assert!(at_output.auto_outside().0 <= 1 && (at_output.rms - 0.3).abs() < 0.01, "{at_output:?}");
        let at_equation = Residuals::of(&truth, &segments, Noise::Equation).unwrap();
        assert!(at_equation.auto_outside().0 >= 2 && at_equation.rms > 0.5, "{at_equation:?}");
    }

    #[test]
    fn feedback_shows_below_lag_0() {
        let mut segment = data(&[1.0, -1.5, 0.7]);
        let noisy: Vec<f64> = noise(12, 5000);
        segment.input.iter_mut().zip([0.0].iter().chain(&noisy)).for_each(|(u, e)| *u += e);
        let truth = Polynomials { a: vec![1.0, -1.5, 0.7], b: vec![1.0, 0.5], nk: 1 };
        let disturbance = all_pole(&truth.a, noisy);
        segment.output = truth.simulate(&segment.input).iter().zip(disturbance).map(|(y, e)| y + 0.3 * e).collect();
        let found = Residuals::of(&truth, &[segment], Noise::Equation).unwrap();
        assert!(found.fed_back().0 >= 1 && found.cross[LAGS - 1].abs() > 0.3, "{found:?}");
    }
}
