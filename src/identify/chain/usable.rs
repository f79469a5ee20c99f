//! Checks before anything is fitted: whether the signals move, whether they repeat as is said, and whether the
//! validation data can judge.

use crate::identify::IdentifyError;
use crate::identify::chain::settings::{Choice, Settings};
use crate::identify::data::segments::{Data, Record, Segment};
use crate::identify::periodic::{self, Repeats};

/// Largest values with which sums of squares can be computed.
const USABLE: std::ops::Range<f64> = 1e-100..1e100;

/// Input, output and the current behind the input must change: a torque of a constant current is the output's own.
pub(super) fn moves(records: &[Record]) -> Result<(), IdentifyError> {
    let name = records.iter().map(|r| r.name.as_str()).collect::<Vec<_>>().join(", ");
    type Signal = fn(&Segment) -> &[f64];
    let signals: [(&'static str, Signal); 3] = [
        ("input", |s| &s.input),
        ("output", |s| &s.output),
        ("coil's current", |s| s.instrument.as_deref().unwrap_or_default()),
    ];
    let has_current = records.iter().flat_map(|r| &r.segments).any(|s| s.instrument.is_some());
    for (what, signal) in signals.into_iter().take(if has_current { 3 } else { 2 }) {
        let all = records.iter().flat_map(|r| &r.segments).flat_map(|s| signal(s).iter().copied());
        let values = all.filter(|v| !v.is_nan());
        let Some(first) = values.clone().next() else { return Err(IdentifyError::Nothing { name }) };
        if values.clone().all(|v| v == first) {
            return Err(IdentifyError::Still { name, what, value: first });
        }
        let largest = values.map(f64::abs).fold(0.0, f64::max);
        if !USABLE.contains(&largest) {
            return Err(IdentifyError::OutOfRange { name, what, largest });
        }
    }
    Ok(())
}

/// Checks that the input of each record repeats, where it is said to.
pub(super) fn repeats(data: &Data, settings: &Settings) -> Result<(), IdentifyError> {
    let Some(Repeats { every_s, skip }) = settings.repeats else { return Ok(()) };
    for record in &data.training {
        if let Some(unrepeated) = periodic::unrepeated(&record.segments, data.period_s, every_s, skip) {
            let problem = unrepeated.in_words(every_s);
            return Err(IdentifyError::NotRepeated { name: record.name.clone(), every_s, problem });
        }
    }
    Ok(())
}

/// Checks that the validation data, if any, have samples that the largest model can predict.
pub(super) fn can_judge(validation: &[Segment], choice: &Choice) -> Result<(), IdentifyError> {
    let largest = match choice {
        Choice::Fixed(orders) => Some(orders),
        Choice::Search { candidates, .. } => candidates.iter().max_by_key(|orders| orders.memory()),
    };
    match (largest, validation.iter().map(Segment::len).max()) {
        (Some(orders), Some(longest)) if longest <= orders.memory() => {
            Err(IdentifyError::TooShortToJudge { orders: *orders, longest })
        }
        _ => Ok(()),
    }
}
