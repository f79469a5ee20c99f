//! Origin of a result: names, units and settings, and a summary of each record as read.

use crate::identify::estimate::clock_delay::Delay;
use crate::identify::estimate::unknown_zero::Zero;
use crate::identify::model::reproduction::InitialState;

/// One record as read.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct RecordSummary {
    /// Its name, as the user gave it.
    pub name: String,
    /// Whether it was fitted.
    pub training: bool,
    /// Outputs observed.
    pub samples: usize,
    /// Segments of known input.
    pub segments: usize,
    /// Seconds of all its segments, without holes.
    pub duration_s: f64,
    /// Period before decimation, seconds.
    pub period_s: f64,
    /// Root mean square of the samples' distance from an even grid, seconds.
    pub jitter_s: f64,
    /// Places of the grid without a sample.
    pub lost: usize,
    /// Samples without an output.
    pub missed: usize,
    /// Whether rows seem to have been lost or written twice, without times that tell, or commands to be lacking.
    pub doubtful: bool,
    /// Of these, frames that a person has vetoed.
    pub vetoed: usize,
    /// Angles interpolated for the torque.
    pub bridged: usize,
    /// Initial state of the simulations shown: a part of a longer record does not begin at rest.
    pub initial_state: InitialState,
    /// Delay of the output after the commands.
    pub delay: Option<Delay>,
    /// Zero of θ, taken off where it is off.
    pub zero: Option<Zero>,
}

/// Origin of a result.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Provenance {
    /// Title of the page.
    pub title: String,
    /// Name of the input.
    pub input: String,
    /// Its unit; empty when unknown.
    pub input_unit: String,
    /// Name of the output.
    pub output: String,
    /// Its unit; empty when unknown.
    pub output_unit: String,
    /// Initial state of simulations.
    pub initial_state: InitialState,
    /// The records in the order of [`Data`](crate::identify::data::segments::Data): training, then validation.
    pub records: Vec<RecordSummary>,
    /// Options of the command: name and value.
    pub settings: Vec<(String, String)>,
}
