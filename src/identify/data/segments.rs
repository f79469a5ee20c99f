//! Data for identification: evenly sampled segments of input and output.
//!
//! A segment ends where the input is unknown. An output that was not observed is NaN: whatever needs it is left out,
//! but simulations run through it.

/// Parts of the time of a sample in which its input may differ. In each it counts by its mean, so that errors fall with
/// the square of this number: 8 leave up to 0.14 % of the gain of a plant of a tenth of the sampling rate.
pub(crate) const PARTS: usize = 24;

/// A segment of evenly sampled input without holes, and its output.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Segment {
    /// Place of its first sample on the record's grid, from 0.
    pub first: usize,
    /// Time of its first sample, seconds of the record's clock.
    pub start_s: f64,
    /// Input; sample k acts from the time of sample k to that of sample k+1.
    pub input: Vec<f64>,
    /// By how much the input is above that in each part of this time, as long as the input, if it changes between
    /// samples: see `between_samples`.
    pub within: Option<Vec<[f64; PARTS]>>,
    /// Output, as long as the input; NaN where it was not observed.
    pub output: Vec<f64>,
    /// A signal that drives the input and is independent of the output's noise (the coil current), as long as the
    /// input.
    pub instrument: Option<Vec<f64>>,
    /// Change of the input per change of the output's zero, as long as the input, if that zero is not known and is to
    /// be fitted: see `unknown_zero`.
    pub by_zero: Option<Vec<f64>>,
    /// Whether that zero may also drift, by a line over the record.
    pub zero_drifts: bool,
    /// What one σ of the delay that was taken off the commands adds to the input, as long as the input, if that delay
    /// was estimated.
    pub by_delay: Option<Vec<f64>>,
    /// Number of its record among those fitted together.
    pub record: usize,
    /// Whether the system was at rest before: true for the first segment of a record.
    pub from_rest: bool,
}

impl Segment {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.input.len().min(self.output.len())
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of observed outputs.
    pub fn observed(&self) -> usize {
        self.output.iter().filter(|y| !y.is_nan()).count()
    }

    /// The same with commands that act later by so many σ of their delay.
    pub(crate) fn delayed(&self, sds: f64) -> Self {
        let mut segment = self.clone();
        let by_delay = self.by_delay.iter().flatten();
        segment.input.iter_mut().zip(by_delay).for_each(|(input, by_delay)| *input += sds * by_delay);
        segment
    }

    /// Its samples `from..to`.
    pub fn part(&self, from: usize, to: usize, period_s: f64) -> Self {
        let to = to.min(self.len());
        let from = from.min(to);
        Self {
            first: self.first + from,
            start_s: self.start_s + from as f64 * period_s,
            input: self.input[from..to].to_vec(),
            within: self.within.as_ref().map(|w| w[from..to].to_vec()),
            output: self.output[from..to].to_vec(),
            instrument: self.instrument.as_ref().map(|i| i[from..to].to_vec()),
            by_zero: self.by_zero.as_ref().map(|z| z[from..to].to_vec()),
            zero_drifts: self.zero_drifts,
            by_delay: self.by_delay.as_ref().map(|d| d[from..to].to_vec()),
            record: self.record,
            from_rest: self.from_rest && from == 0,
        }
    }
}

/// One recording, cut where samples are missing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Record {
    /// Its name for the user.
    pub name: String,
    /// In order of time.
    pub segments: Vec<Segment>,
}

impl Record {
    /// Whether it has the samples of another, whatever their names.
    pub(crate) fn is_copy_of(&self, other: &Self) -> bool {
        // What was not observed is NaN, which equals nothing.
        let outputs = |segment: &Segment| segment.output.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        let same = |(a, b): (&Segment, &Segment)| a.input == b.input && outputs(a) == outputs(b);
        self.segments.len() == other.segments.len() && self.segments.iter().zip(&other.segments).all(same)
    }

    /// Outputs observed in all segments.
    pub fn observed(&self) -> usize {
        self.segments.iter().map(Segment::observed).sum()
    }

    /// Grid places from the first sample to the last, including holes.
    pub fn span(&self) -> usize {
        self.segments.last().map_or(0, |last| last.first + last.len())
    }

    /// Whether the system was at rest before its first sample.
    pub fn is_from_rest(&self) -> bool {
        self.segments.first().is_some_and(|first| first.from_rest)
    }

    /// The same, taken to begin at rest.
    pub fn at_rest(&self) -> Self {
        let mut same = self.clone();
        if let Some(first) = same.segments.first_mut() {
            first.from_rest = true;
        }
        same
    }

    /// The samples at places `from..to` of the grid.
    pub fn range(&self, from: usize, to: usize, period_s: f64) -> Self {
        let part = |s: &Segment| s.part(from.saturating_sub(s.first), to.saturating_sub(s.first), period_s);
        Self {
            name: format!("{} [{from}:{to}]", self.name),
            segments: self.segments.iter().map(part).filter(|s| !s.is_empty()).collect(),
        }
    }
}

/// Prepared data for identification.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Data {
    /// Seconds between samples, the same for all records.
    pub period_s: f64,
    /// Fitted.
    pub training: Vec<Record>,
    /// Used for validation, not fitted.
    pub validation: Vec<Record>,
}

/// Holes of up to `most` samples filled by a line between their neighbours.
pub(super) fn bridged(signal: &[f64], most: usize) -> Vec<f64> {
    let mut filled = signal.to_vec();
    let known: Vec<usize> = (0..signal.len()).filter(|k| !signal[*k].is_nan()).collect();
    for pair in known.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        if to - from > 1 && to - from - 1 <= most {
            let slope = (signal[to] - signal[from]) / (to - from) as f64;
            (from + 1..to).for_each(|k| filled[k] = signal[from] + slope * (k - from) as f64);
        }
    }
    filled
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_counts_holes() {
        let segment = |first: usize, n: usize| Segment {
            first,
            start_s: first as f64,
            input: (first..first + n).map(|k| k as f64).collect(),
            output: vec![0.0; n],
            from_rest: first == 0,
            ..Segment::default()
        };
        let record = Record { name: "r".into(), segments: vec![segment(0, 10), segment(15, 5)] };
        assert_eq!((record.observed(), record.span()), (15, 20));
        let part = record.range(8, 17, 1.0);
        assert_eq!(part.name, "r [8:17]");
        let inputs: Vec<f64> = part.segments.iter().flat_map(|s| s.input.clone()).collect();
        assert_eq!(inputs, [8.0, 9.0, 15.0, 16.0]);
        assert!(!part.segments[0].from_rest && record.range(0, 3, 1.0).segments[0].from_rest);
        assert_eq!((part.segments[1].first, part.segments[1].start_s), (15, 15.0));
    }
}
