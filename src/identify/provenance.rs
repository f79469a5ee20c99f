//! Where a result is from: names, units and settings, and a summary of each record as it was read.

use super::delay::Delay;
use super::fit::InitialState;

/// One record as it was read.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct RecordSummary {
    /// Its name, as the user gave it.
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
    pub initial_state: InitialState,
    /// How much later the output is than the commands say.
    pub delay: Option<Delay>,
}

/// Where a result is from.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Provenance {
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
    pub initial_state: InitialState,
    /// The records in the order of [`Data`](super::data::Data): training, then validation.
    pub records: Vec<RecordSummary>,
    /// Options of the command: name and value.
    pub settings: Vec<(String, String)>,
}
