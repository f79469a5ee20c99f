//! Inputs that change between samples, as when commands come faster than frames, or not in step with them.
//!
//! A model of samples takes its input to be held at its mean from each sample to the next. To a motion within this time
//! the output answers a little differently: means of a sine are smaller than it is by sinc(f T), and so H(s) would be
//! too large, the more the longer the frames. How an H(s) answers to what the input is beyond its mean is computed, in
//! parts of this time, and taken off the output: then the input is as good as held.

use crate::identify::data::segments::{Data, PARTS, Record, Segment};
use crate::identify::model::continuous::{Continuous, Conversion};
use crate::identify::model::polynomials::Polynomials;

/// Most models whose answers are taken off, one after the other: each is found without what the one before told. The
/// error of their gains falls to a sixth each time where commands reach up to the third part of half the sampling rate.
pub(in crate::identify) const MAX_PASSES: usize = 12;
/// Models agree whose responses differ by no more than this part of the largest: the next would differ by a sixth of
/// that, and σ is rarely below a thousandth.
const SETTLED: f64 = 1e-4;

/// Whether the next model no longer differs from the one before in the frequencies between two, hertz.
pub(in crate::identify) fn is_settled(last: &Continuous, next: &Continuous, (from_hz, to_hz): (f64, f64)) -> bool {
    let responses = [0.0, 0.25, 0.5, 0.75, 1.0].map(|part| {
        let hz = from_hz + part * (to_hz - from_hz);
        (last.response(hz), next.response(hz))
    });
    // An integrator has none at zero.
    let known = || responses.iter().filter(|(last, next)| last.is_finite() && next.is_finite());
    let largest = known().map(|(last, _)| last.norm()).fold(0.0, f64::max);
    known().all(|(last, next)| (next - last).norm() <= SETTLED * largest)
}

/// Whether the input of some segment is known to change between samples.
pub(in crate::identify) fn is_in<'a>(segments: impl IntoIterator<Item = &'a Segment>) -> bool {
    segments.into_iter().any(|segment| segment.within.is_some())
}

/// How an H(s) answers to what inputs do within samples.
pub(in crate::identify) struct Answer {
    /// The model of each part.
    of_parts: Polynomials,
}

impl Answer {
    /// For samples that come every `period_s`. `None` for an H(s) by Tustin's rule: it is wrong about what is fast.
    pub(in crate::identify) fn of(model: &Continuous, period_s: f64) -> Option<Self> {
        (model.conversion == Conversion::Hold).then(|| Self { of_parts: model.sampled(period_s / PARTS as f64) })
    }

    /// A segment without it.
    pub(in crate::identify) fn taken_off(&self, segment: &Segment) -> Segment {
        let mut segment = segment.clone();
        if let Some(within) = &segment.within {
            let input: Vec<f64> = within.iter().flatten().copied().collect();
            let answers = self.of_parts.simulate(&input);
            segment.output.iter_mut().zip(answers.iter().step_by(PARTS)).for_each(|(output, answer)| *output -= answer);
        }
        segment
    }

    /// Data without it.
    pub(in crate::identify) fn taken_off_all(&self, data: &Data) -> Data {
        let of_record = |record: &Record| Record {
            name: record.name.clone(),
            segments: record.segments.iter().map(|segment| self.taken_off(segment)).collect(),
        };
        let of = |records: &[Record]| records.iter().map(of_record).collect();
        Data { period_s: data.period_s, training: of(&data.training), validation: of(&data.validation) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::chain::settings::{Choice, Settings};
    use crate::identify::chain::steps::identify;
    use crate::identify::model::modelled::Role;
    use crate::identify::model::polynomials::Orders;
    use crate::identify::tests::{noise, settings};
    use std::f64::consts::TAU;

    #[test]
    fn models_settle_when_their_responses_do() {
        let model = |gain: f64, den: [f64; 3]| Continuous {
            num: vec![gain],
            den: den.to_vec(),
            delay_s: 0.0,
            conversion: Conversion::Hold,
        };
        let [slow, integrator] = [[1.0, 9.0, 120.0], [1.0, 9.0, 0.0]].map(|den| move |gain| model(gain, den));
        for band_hz in [(0.0, 0.0), (0.1, 4.0)] {
            assert!(is_settled(&slow(300.0), &slow(300.01), band_hz));
            assert!(!is_settled(&slow(300.0), &slow(300.1), band_hz));
        }
        assert!(is_settled(&integrator(300.0), &integrator(300.01), (0.0, 4.0)));
        assert!(!is_settled(&integrator(300.0), &integrator(300.1), (0.0, 4.0)));
    }

    /// Commands that are held for 37/120 of the time between frames, 20 of which come in a second.
    #[test]
    fn commands_between_frames_do_not_raise_the_gain() {
        const FINE: usize = 120;
        const FRAMES: usize = 1600;
        let period_s = 0.05;
        let truth = Continuous {
            num: vec![60.0, 300.0],
            den: vec![1.0, 9.0, 120.0],
            delay_s: 0.0,
            conversion: Conversion::Hold,
        };
        let wave = |t: f64| (1..=24).map(|k| (TAU * 0.15 * f64::from(k) * t + f64::from(k * k)).cos()).sum::<f64>();
        let command = |i: usize| wave((i / 37 * 37) as f64 * period_s / FINE as f64);
        let commands: Vec<f64> = (0..FRAMES * FINE).map(command).collect();
        let output = truth.sampled(period_s / FINE as f64).simulate(&commands);
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        let input: Vec<f64> = commands.chunks(FINE).map(mean).collect();
        let within = commands.chunks(FINE).zip(&input).map(|(part, input)| {
            std::array::from_fn(|i| mean(&part[i * FINE / PARTS..(i + 1) * FINE / PARTS]) - input)
        });
        let segment = Segment {
            output: output.iter().step_by(FINE).zip(noise(3, FRAMES)).map(|(y, e)| y + 0.01 * e).collect(),
            within: Some(within.collect()),
            input,
            from_rest: true,
            ..Segment::default()
        };
        let found = |segment: &Segment, choice: Choice| {
            let record = Record { name: "r".to_owned(), segments: vec![segment.clone()] };
            let data = Data { period_s, training: vec![record], validation: Vec::new() };
            let done = identify(&data, &Settings { commanded: true, ..settings(choice) });
            let refined = done.unwrap().models.into_iter().find(|model| model.role == Role::Refined).unwrap();
            let found = refined.continuous.unwrap().model;
            [0.5, 2.0, 3.5].map(|f| found.response(f).norm() / truth.response(f).norm() - 1.0)
        };
        let fixed = || Choice::Fixed(Orders { na: 2, nb: 2, nk: 1 });
        let known = found(&segment, fixed());
        assert!(known.iter().all(|off| off.abs() < 2e-3), "{known:?}");
        // Whichever delay a search chooses for the full model, the answer is that of the refined one's.
        let candidates = (2..=6).flat_map(|order| [1, 2, 3].map(|nk| Orders { na: order, nb: order, nk })).collect();
        let searched = found(&segment, Choice::Search { candidates, criterion: None });
        assert!(searched.iter().all(|off| off.abs() < 2e-3), "{searched:?}");
        let unknown = found(&Segment { within: None, ..segment }, fixed());
        assert!(unknown[2] > 0.02, "{unknown:?}");
    }
}
