//! Whether the input of a record repeats with the period given.
//!
//! Compares the input with itself a period later: half the mean square of the difference is the power that does not
//! repeat, noise or a wrong period. If it repeats better after several periods, the period is wrong.

use crate::identify::data::segments::Segment;

/// Part of the input's power that may differ from period to period, as noise does.
const MOST: f64 = 0.8;
/// Part that is looked at for a longer period.
const LOOKED_AT: f64 = 0.1;
/// Most periods after which it may repeat.
const MOST_PERIODS: usize = 100;
/// Part of this, and of the power, that a longer period may leave at most: noise is the same for any, and changes by
/// chance.
const CLEARLY_LESS: f64 = 0.8;
const LITTLE: f64 = 0.6;

/// An input that does not repeat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Unrepeated {
    /// Power that changes from period to period, as a part of the input's.
    pub(crate) part: f64,
    /// How many periods after which it repeats better, and the part that changes then.
    pub(crate) multiple: Option<(usize, f64)>,
}

impl Unrepeated {
    /// What a person can do about a period of `repeats_s`.
    pub(crate) fn in_words(&self, repeats_s: f64) -> String {
        let changes =
            format!("{:.0} % of the input's power changes from one such period to the next", 100.0 * self.part);
        match self.multiple {
            Some((periods, part)) => format!(
                "{changes}, but only {:.0} % after {periods} of them: it repeats every {} s",
                100.0 * part,
                repeats_s * periods as f64
            ),
            None => format!("{changes}, and it repeats no better after several: without --repeats any input will do"),
        }
    }
}

/// `None` where the input repeats every `repeats_s`, except for noise, or too little is recorded to tell.
/// The first `skip` periods do not count.
pub(crate) fn unrepeated(segments: &[Segment], period_s: f64, repeats_s: f64, skip: usize) -> Option<Unrepeated> {
    let samples = repeats_s / period_s;
    let from = segments.first()?.first.saturating_add((skip as f64 * samples).round() as usize);
    let end = segments.last().map(|s| s.first + s.len())?;
    let part = |periods: usize| changing(segments, from, (periods as f64 * samples).round() as usize);
    let once = part(1)?;
    let longest = ((end.saturating_sub(from) as f64 / samples / 2.0).floor() as usize).min(MOST_PERIODS);
    let longest = if once > LOOKED_AT { longest } else { 1 };
    let longer = (2..=longest).filter_map(|periods| Some((periods, part(periods)?)));
    let best = longer.min_by(|a, b| a.1.total_cmp(&b.1));
    let better = best.filter(|(_, part)| *part < LITTLE.min(CLEARLY_LESS * once));
    // Of its multiples the shortest.
    let multiple = better.and_then(|(periods, least)| {
        let as_good = |k: &usize| part(*k).is_some_and(|part| part < least + 0.5 * (once - least));
        (2..=periods).find(as_good).and_then(|k| Some((k, part(k)?)))
    });
    (multiple.is_some() || once > MOST).then_some(Unrepeated { part: once, multiple })
}

/// Half the mean square of the input's change over `lag` samples, relative to its variance.
fn changing(segments: &[Segment], from: usize, lag: usize) -> Option<f64> {
    let (mut pairs, mut change, mut sum, mut squares) = (0.0, 0.0, 0.0, 0.0);
    for segment in segments {
        let counted = segment.input.get(from.saturating_sub(segment.first)..).unwrap_or_default();
        for (now, later) in counted.iter().zip(counted.iter().skip(lag)) {
            pairs += 2.0;
            change += (later - now).powi(2);
            sum += now + later;
            squares += now * now + later * later;
        }
    }
    let variance = squares / pairs - (sum / pairs).powi(2);
    (pairs >= lag as f64 && variance > 0.0).then(|| change / pairs / variance)
}
