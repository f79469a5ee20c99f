//! A model with its derived results: response with σ, H(s), bandwidths.

use crate::identify::model::bandwidth::{Bandwidth, Definition, bandwidth};
use crate::identify::model::continuous::{Continuous, Conversion};
use crate::identify::model::covariance::Covariance;
use crate::identify::model::polynomials::{Polynomials, angle, turn};
use nalgebra::Complex;

/// Points in a Bode plot.
const POINTS: usize = 300;
/// Factor by which it begins below the excited band.
const BELOW: f64 = 20.0;

/// Kind of model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Of the order found or requested.
    Full,
    /// The full model, reduced.
    Reduced,
    /// Output error of the reduced model's order, started from it.
    Refined,
    /// Fitted to the lines of averaged periods, by maximum likelihood.
    Periodic,
    /// Not estimated here: a given H(s).
    Given,
}

impl Role {
    /// The model to use is the first of these that exists.
    const LEADING: [Self; 5] = [Self::Periodic, Self::Given, Self::Refined, Self::Reduced, Self::Full];

    /// The model to use, of these with their roles.
    pub(in crate::identify) fn leading<M>(models: &[M], role_of: impl Fn(&M) -> Self) -> Option<&M> {
        Self::LEADING.into_iter().find_map(|role| models.iter().find(|model| role_of(model) == role))
    }

    /// The name in files.
    pub fn word(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Reduced => "reduced",
            Self::Refined => "refined",
            Self::Periodic => "periodic",
            Self::Given => "given",
        }
    }
}

/// The response at one frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodePoint {
    /// Hz.
    pub frequency_hz: f64,
    /// |B/A|.
    pub magnitude: f64,
    /// Unwrapped from the lowest frequency, radians.
    pub phase_rad: f64,
    /// σ of ln|B/A|, and of the phase in radians.
    pub sd: Option<(f64, f64)>,
}

/// H(s) with the errors of its coefficients.
#[derive(Debug, Clone)]
pub struct ContinuousEstimate {
    /// H(s).
    pub model: Continuous,
    /// Standard errors of [`Continuous::parameters`].
    pub standard_errors: Option<Vec<f64>>,
}

/// The response that a bandwidth refers to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BandwidthOf {
    /// H(s).
    Continuous,
    /// That of the samples, including the hold: half a period more delay.
    Samples,
}

impl BandwidthOf {
    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Continuous => "continuous",
            Self::Samples => "samples",
        }
    }

    /// The name for people.
    pub fn words(self) -> &'static str {
        match self {
            Self::Continuous => "H(s)",
            Self::Samples => "samples",
        }
    }
}

/// A bandwidth with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BandwidthEstimate {
    /// The bandwidth of the model.
    pub bandwidth: Bandwidth,
    /// Hz: of averaged periods by their covariance, otherwise by the bootstrap; `None` without it, when it gave too
    /// few, or when the interval is open.
    pub interval_hz: Option<(f64, f64)>,
}

/// A model with its derived results.
#[derive(Debug, Clone)]
pub struct Modelled {
    /// Its role.
    pub role: Role,
    /// How it was estimated, and its order.
    pub title: String,
    /// The model.
    pub model: Polynomials,
    /// Covariance of [`Polynomials::parameters`].
    pub covariance: Option<Covariance>,
    /// Modulus of its largest pole.
    pub largest_pole: f64,
    /// Response from below the excited band to half the sampling rate.
    pub bode: Vec<BodePoint>,
    /// H(s), of reduced models.
    pub continuous: Option<ContinuousEstimate>,
    /// The response that the bandwidths refer to.
    pub bandwidths_are_of: BandwidthOf,
    /// One for each definition.
    pub bandwidths: Vec<BandwidthEstimate>,
}

impl Modelled {
    /// Derives all results from a model and its covariance.
    pub fn new(
        role: Role,
        title: String,
        model: Polynomials,
        covariance: Option<Covariance>,
        period_s: f64,
        excited_hz: (f64, f64),
    ) -> Self {
        let continuous = (role != Role::Full).then(|| continuous(&model, covariance.as_ref(), period_s)).flatten();
        let (bandwidths_are_of, bandwidths) =
            bandwidths_of(continuous.as_ref().map(|h| &h.model), &model, period_s, excited_hz);
        Self {
            role,
            title,
            largest_pole: model.largest_pole(),
            bode: bode(&model, covariance.as_ref(), period_s, excited_hz.0),
            continuous,
            bandwidths_are_of,
            bandwidths: bandwidths.into_iter().map(|b| BandwidthEstimate { bandwidth: b, interval_hz: None }).collect(),
            model,
            covariance,
        }
    }

    /// Removes all that is derived from the covariance.
    pub(in crate::identify) fn forget_sigma(&mut self) {
        self.covariance = None;
        self.bode.iter_mut().for_each(|point| point.sd = None);
        self.bandwidths.iter_mut().for_each(|estimate| estimate.interval_hz = None);
        if let Some(continuous) = &mut self.continuous {
            continuous.standard_errors = None;
        }
    }

    /// Whether simulations remain bounded.
    pub fn is_stable(&self) -> bool {
        self.largest_pole < 1.0
    }

    /// Gives the bandwidths the intervals that follow from the covariance: for a model whose covariance is that of the
    /// data's noise.
    pub(in crate::identify) fn intervals_by_covariance(&mut self, period_s: f64, excited_hz: (f64, f64)) {
        let Some(covariance) = &self.covariance else { return };
        for (k, estimate) in self.bandwidths.iter_mut().enumerate() {
            let bandwidth = |parameters: &[f64]| {
                let moved = Some(self.model.with_parameters(parameters)).filter(Polynomials::is_stable)?;
                bandwidths(self.role, &moved, period_s, excited_hz).get(k)?.frequency_hz
            };
            estimate.interval_hz = covariance.interval_95(self.model.parameters().as_slice(), bandwidth);
        }
    }

    /// Standard errors of [`Polynomials::parameters`].
    pub fn standard_errors(&self) -> Option<Vec<f64>> {
        self.covariance.as_ref().map(Covariance::standard_errors)
    }
}

/// Bandwidths of H(s) if there is an exact one; otherwise of the samples, whose phase includes the hold's half period,
/// as for the full model.
pub(in crate::identify) fn bandwidths(
    role: Role,
    model: &Polynomials,
    period_s: f64,
    excited_hz: (f64, f64),
) -> Vec<Bandwidth> {
    let continuous = (role != Role::Full).then(|| Continuous::of(model, period_s)).flatten();
    bandwidths_of(continuous.as_ref(), model, period_s, excited_hz).1
}

fn bandwidths_of(
    continuous: Option<&Continuous>,
    model: &Polynomials,
    period_s: f64,
    excited_hz: (f64, f64),
) -> (BandwidthOf, Vec<Bandwidth>) {
    let continuous = continuous.filter(|h| h.conversion == Conversion::Hold);
    let of = if continuous.is_some() { BandwidthOf::Continuous } else { BandwidthOf::Samples };
    let response = |f: f64| match continuous {
        Some(h) => h.response(f),
        None => model.response(angle(f, period_s)),
    };
    (of, Definition::ALL.into_iter().map(|d| bandwidth(d, response, 0.5 / period_s, excited_hz)).collect())
}

fn continuous(model: &Polynomials, covariance: Option<&Covariance>, period_s: f64) -> Option<ContinuousEstimate> {
    let found = Continuous::of(model, period_s)?;
    let parameters = |p: &[f64]| {
        let moved = Continuous::of(&model.with_parameters(p), period_s)?;
        (moved.conversion == found.conversion).then(|| moved.parameters())
    };
    let spread = covariance.and_then(|c| c.propagate(model.parameters().as_slice(), parameters));
    Some(ContinuousEstimate { standard_errors: spread.as_ref().map(Covariance::standard_errors), model: found })
}

fn bode(model: &Polynomials, covariance: Option<&Covariance>, period_s: f64, lowest_hz: f64) -> Vec<BodePoint> {
    let nyquist = 0.5 / period_s;
    let from = (lowest_hz / BELOW).clamp(nyquist * 1e-5, nyquist * 0.1);
    let frequencies: Vec<f64> =
        (0..POINTS).map(|k| from * (nyquist / from).powf(k as f64 / (POINTS - 1) as f64)).collect();
    let response = |model: &Polynomials| -> Vec<Complex<f64>> {
        frequencies.iter().map(|f| model.response(angle(*f, period_s))).collect()
    };
    let found = response(model);
    // ln of the ratio to the model itself: gain and phase without jumps.
    let relative = |p: &[f64]| {
        let ratios = response(&model.with_parameters(p)).into_iter().zip(&found).map(|(moved, r)| (moved / r).ln());
        Some(ratios.flat_map(|z| [z.re, z.im]).collect())
    };
    let spread = covariance.and_then(|c| c.propagate(model.parameters().as_slice(), relative));
    let sds = spread.as_ref().map(Covariance::standard_errors);
    let phases = unwrapped(found.iter().map(|r| r.arg()));
    frequencies
        .iter()
        .zip(found.iter().zip(phases))
        .enumerate()
        .map(|(k, (f, (r, phase_rad)))| BodePoint {
            frequency_hz: *f,
            magnitude: r.norm(),
            phase_rad,
            sd: sds.as_ref().map(|sd| (sd[2 * k], sd[2 * k + 1])),
        })
        .collect()
}

/// Unwrapped angles.
pub(crate) fn unwrapped(angles: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut last: Option<f64> = None;
    let follow = |angle: f64| {
        let next = last.map_or(angle, |last| last + turn(last, angle));
        last = Some(next);
        next
    };
    angles.into_iter().map(follow).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::data::segments::Segment;
    use crate::identify::estimate::arx::fit;
    use crate::identify::model::polynomials::{Orders, all_pole};
    use crate::identify::tests::noise;
    use std::f64::consts::TAU;

    /// 2/(0.1 s + 1), drawn many times: errors of H(s) and of the response compared with their σ.
    #[test]
    fn errors_of_h_and_of_the_response_are_as_large_as_predicted() {
        let truth = Continuous { num: vec![20.0], den: vec![1.0, 10.0], delay_s: 0.0, conversion: Conversion::Hold };
        let (period_s, draws) = (0.02, 100);
        let model = truth.sampled(period_s);
        let (mut of_h, mut of_gain) = ([0.0; 2], 0.0);
        for seed in 1..=draws {
            let input = noise(seed, 1000);
            let disturbance = all_pole(&model.a, noise(seed + 500, 1000));
            let output = model.simulate(&input).iter().zip(disturbance).map(|(y, e)| y + 0.2 * e).collect();
            let found =
                fit(&[Segment { input, output, ..Segment::default() }], Orders { na: 1, nb: 1, nk: 1 }).unwrap();
            let all =
                Modelled::new(Role::Reduced, String::new(), found.model, Some(found.covariance), period_s, (1.0, 20.0));
            let h = all.continuous.unwrap();
            let errors = h.model.parameters().into_iter().zip(truth.parameters()).map(|(f, t)| f - t);
            for (sum, (error, sd)) in of_h.iter_mut().zip(errors.zip(h.standard_errors.unwrap())) {
                *sum += (error / sd).powi(2) / draws as f64;
            }
            let point = all.bode[POINTS / 2];
            let gain = model.response(angle(point.frequency_hz, period_s)).norm();
            of_gain += ((point.magnitude / gain).ln() / point.sd.unwrap().0).powi(2) / draws as f64;
        }
        assert!(of_h.iter().chain([&of_gain]).all(|s| (0.6..1.5).contains(s)), "{of_h:?} {of_gain}");
    }

    #[test]
    fn phases_are_followed_over_the_turn() {
        assert_eq!(unwrapped([0.0, -3.0, 3.0]), [0.0, -3.0, 3.0 - TAU]);
    }
}
