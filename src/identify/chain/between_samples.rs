//! Inputs that change between samples, as when commands come faster than frames, or not in step with them.
//!
//! A model of samples takes its input to be held at its mean from each sample to the next. To a motion within this time
//! the output answers a little differently: means of a sine are smaller than it is by sinc(f T), and so H(s) would be
//! too large, the more the longer the frames. How an H(s) answers to what the input is beyond its mean is computed, in
//! parts of this time, and taken off the output: then the input is as good as held.

use crate::identify::data::segments::{Data, PARTS, Record, Segment};
use crate::identify::model::continuous::Continuous;

/// Whether an input is known to change between samples.
pub(super) fn are_in(data: &Data) -> bool {
    let records = data.training.iter().chain(&data.validation);
    records.flat_map(|record| &record.segments).any(|segment| segment.within.is_some())
}

/// The data without what inputs within samples do to the outputs, by H(s).
pub(super) fn taken_off(data: &Data, model: &Continuous) -> Data {
    let fine = model.sampled(data.period_s / PARTS as f64);
    let without = |segment: &Segment| {
        let mut segment = segment.clone();
        if let Some(within) = &segment.within {
            let input: Vec<f64> = within.iter().flatten().copied().collect();
            let answers = fine.simulate(&input);
            segment.output.iter_mut().zip(answers.iter().step_by(PARTS)).for_each(|(output, answer)| *output -= answer);
        }
        segment
    };
    let of = |records: &[Record]| -> Vec<Record> {
        let of = |record: &Record| Record {
            name: record.name.clone(),
            segments: record.segments.iter().map(without).collect(),
        };
        records.iter().map(of).collect()
    };
    Data { period_s: data.period_s, training: of(&data.training), validation: of(&data.validation) }
}
