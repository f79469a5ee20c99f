//! What is identified from: evenly sampled stretches of input and output.

/// A stretch of evenly sampled input and output without a hole.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Segment {
    /// Time of its first sample, seconds of the record's clock.
    pub start_s: f64,
    /// Input; sample k acts from the time of sample k to that of sample k+1.
    pub input: Vec<f64>,
    /// Output, as long as the input.
    pub output: Vec<f64>,
    /// A signal that moves the input and knows nothing of the output's noise (the coil current), as long as the input.
    pub instrument: Option<Vec<f64>>,
    /// Whether the system was at rest before: true for the first stretch of a record.
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

    /// The samples `from..to` of it.
    pub fn part(&self, from: usize, to: usize, period_s: f64) -> Self {
        let to = to.min(self.len());
        let from = from.min(to);
        Self {
            start_s: self.start_s + from as f64 * period_s,
            input: self.input[from..to].to_vec(),
            output: self.output[from..to].to_vec(),
            instrument: self.instrument.as_ref().map(|i| i[from..to].to_vec()),
            from_rest: self.from_rest && from == 0,
        }
    }
}

/// One recording, cut where samples are missing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Record {
    /// How the user knows it.
    pub name: String,
    /// In the order of time.
    pub segments: Vec<Segment>,
}

impl Record {
    /// Samples in all stretches.
    pub fn len(&self) -> usize {
        self.segments.iter().map(Segment::len).sum()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
