//! A motion that comes before its commands.

use super::periods::degrees_of_sd;
use super::run::Run;
use super::timing::WEAK_CORRELATION;

/// σ of the phase beyond which it is not chance.
const SIGNIFICANT_SD: f64 = 4.0;
/// A smaller lead is not told, degrees: where frames lie in their pauses makes so much.
const LEAST_DEG: f64 = 0.5;

/// The note about the slowest run, whose lag is the smallest and whose phase cannot be that of another turn.
pub(super) fn note(run: &Run) -> Option<String> {
    // The phase of another motion means nothing.
    run.lag.filter(|lag| lag.correlation >= WEAK_CORRELATION)?;
    let phase_deg = run.phase_deg?;
    // A start that may be a frame late explains it.
    run.start_sd_s?;
    let sd_deg = run.phase_sd().map(f64::to_degrees);
    (phase_deg > LEAST_DEG && sd_deg.is_none_or(|sd_deg| phase_deg > SIGNIFICANT_SD * sd_deg)).then(|| {
        format!(
            "the motion leads the commands by {phase_deg:.2}°{}, which no catheter does: is the start of the commands \
             late (--start), or is the base frame or the coil turned about the path's axis? All phases are wrong by \
             that",
            degrees_of_sd(sd_deg)
        )
    })
}
