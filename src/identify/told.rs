//! What the files of a result say beside the result: where it is from.

use super::delay::Delay;
use super::fit::Start;

/// One record as it was read.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RecordTold {
    /// How the user knows it.
    pub name: String,
    /// Whether it was fitted.
    pub training: bool,
    /// Outputs observed.
    pub samples: usize,
    /// Stretches of known input.
    pub stretches: usize,
    /// Seconds from the first sample to the last.
    pub duration_s: f64,
    /// Period before decimation, seconds.
    pub period_s: f64,
    /// Root mean square of the samples' distance from an even grid, seconds.
    pub jitter_s: f64,
    /// Places of the grid without a sample.
    pub lost: usize,
    /// Samples without an output.
    pub missed: usize,
    /// Angles interpolated for the torque.
    pub bridged: usize,
    /// Where simulations of it begin that are shown: a part of a longer record does not begin at rest.
    pub start: Start,
    /// How much later the output is than the commands say.
    pub delay: Option<Delay>,
}

/// All that is told.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Told {
    /// Head of the page.
    pub title: String,
    /// Name of the input.
    pub input: String,
    /// Its unit; empty when not known.
    pub input_unit: String,
    /// Name of the output.
    pub output: String,
    /// Its unit; empty when not known.
    pub output_unit: String,
    /// Where simulations begin.
    pub start: Start,
    /// The records in the order of [`Data`](super::chain::Data): training, then validation.
    pub records: Vec<RecordTold>,
    /// Options of the command: name and value.
    pub settings: Vec<(String, String)>,
}
