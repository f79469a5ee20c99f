//! Open-loop runs along a desired path: errors of the catheter, and its response at each speed.
//!
//! The experiment is that of Section IV of the paper: a path with (200) points per period is commanded point by point,
//! each held for a *pause*, for four periods, once for every pause time. In: the desired path and the tracked runs.
//! Out, for each run: errors with and without rigid alignment (Table II), and the response at 1/period as magnitude and
//! phase (Eqs. 8 to 10, Fig. 11).
//!
//! Method, with one file for each step: one observed point per command (`pauses`), rigid alignment (`align`), plane and
//! circle (`plane`, `circle`), lag by cross-correlation in space (`lag`), the start of the commands (`start_time`),
//! comparison of the periods with each other (`settling`, `periods`, `unrepeated`).
//!
//! Conventions. Everything is in the base frame, metres. The error of a run is the root mean square distance in space.
//! A run's alignment maps observed points to desired ones. Phase is negative for a late response: φ = −360° · Δt / T.
//! An observed point belongs to the middle of its pause, so a catheter that followed instantly would have phase 0 and
//! magnitude 0 dB.
//!
//! What it cannot detect. Alignment hides lag on a circle, because a lagging circle equals a rotated one; the error
//! without alignment, the rotation, and the phase (which is measured without alignment) show it. Conversely, a base
//! frame rotated about the circle's axis adds its angle to all phases. An error of the first command's time goes fully
//! into the phase: 1 ms is 0.36° at 1 Hz.

mod align;
mod circle;
mod error;
mod lag;
mod lead;
mod lone;
mod mean_motion;
mod notes;
mod options;
mod path;
mod pauses;
mod periods;
mod plane;
mod response;
mod run;
mod settling;
mod spline;
mod start_time;
mod step;
#[cfg(test)]
mod tests;
mod timing;
mod unrepeated;
mod write;

pub(crate) use error::ValidateError;
pub(crate) use lag::unwrap;
pub(crate) use options::{Average, Options};
pub(crate) use path::DesiredPath;
pub(crate) use response::Size;
pub(crate) use run::Run;
pub(crate) use spline::Interpolation;
pub(crate) use step::Step;
pub(crate) use timing::Observed;
pub(crate) use write::Row;

/// All runs along a path.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Validation {
    /// The desired path.
    pub path: DesiredPath,
    /// How runs were evaluated.
    pub options: Options,
    /// The runs, the shortest pause first.
    pub runs: Vec<Run>,
}

/// Evaluates runs along a path.
///
/// # Errors
/// The first run that does not fit or has too little data.
pub(crate) fn validate(
    path: DesiredPath,
    observed: &[Observed<'_>],
    options: Options,
) -> Result<Validation, ValidateError> {
    if options.skip >= path.periods {
        let problem = format!(
            "is commanded {} times, and {} are left out at the beginning: nothing would be left",
            path.periods, options.skip
        );
        return Err(ValidateError::Path { path: path.file, problem });
    }
    let of_run = |(given, observed)| run::evaluate(&path, observed, &options).map(|run| Run { given, ..run });
    let mut runs = observed.iter().enumerate().map(of_run).collect::<Result<Vec<_>, _>>()?;
    // By rising frequency.
    runs.sort_by(|a, b| b.pause_s.total_cmp(&a.pause_s));
    let mut phases: Vec<Option<f64>> = runs.iter().map(|run| run.phase_deg).collect();
    unwrap(&mut phases);
    for (run, phase) in runs.iter_mut().zip(phases) {
        run.phase_deg = phase;
    }
    if let Some(slowest) = runs.first_mut() {
        slowest.notes.extend(lead::note(slowest));
    }
    runs.reverse();
    Ok(Validation { path, options, runs })
}
