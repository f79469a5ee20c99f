//! Records that are fitted together and have different gains.
//!
//! The model has their mean, and σ of noise says nothing of the difference. Method: a factor of the simulated output is
//! fitted to each record; its σ is the jackknife's over parts of the record (Efron, The Jackknife, the Bootstrap and
//! Other Resampling Plans, 1982, doi:10.1137/1.9781611970319), which holds for noise of any colour that is shorter than
//! a part.

use super::diagnostic::Diagnostic;
use crate::identify::data::segments::Record;
use crate::identify::estimate::arx;
use crate::identify::model::polynomials::{Orders, Polynomials};
use crate::identify::model::reproduction::free_response;

/// Parts of a record, and least samples of a part.
const PARTS: usize = 10;
const PART_SAMPLES: usize = 20;
/// Fewer parts do not tell σ.
const FEWEST_PARTS: usize = 5;
/// Gains that differ by more than this many σ are different, if by this part of them at least.
const SIGNIFICANT_SD: f64 = 5.0;
const LEAST: f64 = 0.005;
/// Difference that is told whatever its σ, as part of the gains.
const LARGE: f64 = 0.03;

/// Whether gains of the records differ, as `model` tells. What the states contribute with which records begin is no
/// gain.
pub(super) fn record_gains(model: &Polynomials, training: &[Record]) -> Option<Diagnostic> {
    let common = Extremes::of(model, training)?;
    // Where records contradict each other, the common model is nearly nothing, and its factors tell nothing.
    let own = if common.certain { None } else { of_one_record(model, training) };
    let certain = [Some(&common), own.as_ref()].into_iter().flatten().any(|extremes| extremes.certain);
    (certain || common.part > LARGE).then_some(Diagnostic::Gains { records: common.records, certain })
}

/// The least and the largest gain.
struct Extremes {
    records: [(String, f64); 2],
    /// Their difference as part of the larger; infinite for different signs.
    part: f64,
    /// Whether that is beyond noise.
    certain: bool,
}

impl Extremes {
    /// `None` with fewer than two gains.
    fn of(model: &Polynomials, training: &[Record]) -> Option<Self> {
        let gains = training.iter().filter_map(|record| Some((record.name.clone(), Gain::of(model, record)?)));
        let gains: Vec<(String, Gain)> = gains.collect();
        let least = gains.iter().min_by(|a, b| a.1.value.total_cmp(&b.1.value))?;
        let most = gains.iter().max_by(|a, b| a.1.value.total_cmp(&b.1.value))?;
        let apart = most.1.value - least.1.value;
        let part = if least.1.value > 0.0 { apart / most.1.value } else { f64::INFINITY };
        let sd = least.1.sd.zip(most.1.sd).map(|(a, b)| a.hypot(b));
        let certain = part > LEAST && sd.is_some_and(|sd| apart > SIGNIFICANT_SD * sd);
        let records = [least, most].map(|(name, gain)| (name.clone(), gain.value));
        (gains.len() > 1).then_some(Self { records, part, certain })
    }
}

/// The gains by an ARX model of the first record alone, of the orders of `model`.
fn of_one_record(model: &Polynomials, training: &[Record]) -> Option<Extremes> {
    let orders = Orders { na: model.a.len().checked_sub(1)?, nb: model.b.len(), nk: model.nk };
    let own = arx::fit(&training.first()?.segments, orders).ok()?.model;
    if own.is_stable() { Extremes::of(&own, training) } else { None }
}

/// The factor with which the model's output fits a record best.
struct Gain {
    value: f64,
    /// `None` for a short record.
    sd: Option<f64>,
}

impl Gain {
    /// `None` where there is none, without motion or with an output that overflows.
    fn of(model: &Polynomials, record: &Record) -> Option<Self> {
        let mut products: Vec<(f64, f64)> = Vec::new();
        for segment in &record.segments {
            let modelled = model.simulate(&segment.input);
            let free = free_response(model, segment, &modelled).unwrap_or_else(|| vec![0.0; modelled.len()]);
            let forced = segment.output.iter().zip(free).map(|(y, free)| y - free);
            let pairs = forced.zip(modelled).filter(|(y, _)| !y.is_nan());
            products.extend(pairs.map(|(y, m)| (y * m, m * m)));
        }
        let sums = |part: &[(f64, f64)]| part.iter().fold((0.0, 0.0), |(p, e), (ym, mm)| (p + ym, e + mm));
        let (product, energy) = sums(&products);
        let value = Some(product / energy).filter(|value| value.is_finite())?;
        let parts = (products.len() / PART_SAMPLES).min(PARTS);
        let without = products.chunks(products.len().div_ceil(parts.max(1)).max(1)).map(|part| {
            let (p, e) = sums(part);
            (product - p) / (energy - e)
        });
        let variance = without.map(|gain| (gain - value).powi(2)).sum::<f64>() * (1.0 - 1.0 / parts as f64);
        let sd = (parts >= FEWEST_PARTS && variance.is_finite()).then(|| variance.sqrt());
        Some(Self { value, sd })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::data::segments::Segment;
    use crate::identify::tests::noise;

    /// Records of these gains and numbers of samples, with noise that lasts for ten samples.
    fn told(seed: u64, records: &[(f64, usize)]) -> Option<bool> {
        told_by(&model(), seed, records)
    }

    fn model() -> Polynomials {
        Polynomials { a: vec![1.0, -1.890_75, 0.904_38], b: vec![0.006_93, 0.006_7], nk: 1 }
    }

    fn told_by(by: &Polynomials, seed: u64, records: &[(f64, usize)]) -> Option<bool> {
        let model = model();
        let record = |(index, &(gain, samples)): (usize, &(f64, usize))| {
            let input = noise(seed + 10 * index as u64 + 1, samples);
            let mut last = 0.0;
            let output =
                model.simulate(&input).into_iter().zip(noise(seed + 10 * index as u64 + 2, samples)).map(|(y, e)| {
                    last = 0.9 * last + 0.01 * e;
                    gain * y + last
                });
            let output = output.collect();
            let segment = Segment { input, output, from_rest: true, ..Segment::default() };
            Record { name: index.to_string(), segments: vec![segment] }
        };
        let records: Vec<Record> = records.iter().enumerate().map(record).collect();
        record_gains(by, &records).map(|told| {
            let Diagnostic::Gains { records, certain } = told else { panic!("{told:?}") };
            assert!(records[0].1 <= records[1].1);
            certain
        })
    }

    #[test]
    fn gains_that_differ_beyond_noise_are_told_and_noise_is_not() {
        for seed in 0..40 {
            assert_eq!(told(100 * seed, &[(1.0, 3000), (1.0, 2000), (1.0, 1500)]), None, "{seed}");
            assert_eq!(told(100 * seed, &[(1.0, 3000), (1.1, 3000)]), Some(true), "{seed}");
            assert_eq!(told(100 * seed, &[(1.0, 3000), (-1.0, 3000)]), Some(true), "{seed}");
        }
        // The model of both is nothing.
        let nothing = Polynomials { b: vec![1e-5, -2e-5], ..model() };
        assert_eq!(told_by(&nothing, 1, &[(1.0, 3000), (-1.0, 3000)]), Some(true));
        assert_ne!(told_by(&nothing, 1, &[(1.0, 3000), (1.0, 3000)]), Some(true));
        // Too short to tell σ.
        assert_eq!(told(1, &[(1.0, 90), (1.5, 90)]), Some(false));
        assert_eq!(told(1, &[(1.0, 3000)]), None);
    }
}
