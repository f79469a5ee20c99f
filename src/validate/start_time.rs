//! Time of the first command, if it is not given.
//!
//! - From the frames' ticks: the first change of the command count. If commands are slow enough for the count, a line
//!   through the times of all of them gives start and pause, which an amplifier keeps to a few parts in a thousand.
//! - From the coil currents in the log: the first time at which a current differs from the first one logged, or the
//!   first one itself if it is not zero and changes within 1.5 pauses.
//! - Otherwise by a search over the record: the start at which the observed motion correlates best with the whole
//!   commanded one. That absorbs the catheter's lag: such a start gives no phase, and errors also exclude the lag. As
//!   it is late by the lag, the last commands would end after the true ones, where the catheter returns to rest; so the
//!   last half of a period, the largest lag, does not count, unless a single period does.

use super::path::DesiredPath;
use super::pauses::{Sample, Window};
use super::spline::{Curve, Interpolation};
use crate::series::{Current, Recording, SeriesError};
use crate::source::times::seconds;
use nalgebra::Vector3;

/// How the start is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum StartFrom {
    /// It was given.
    Given,
    /// The camera saw the command count change.
    Ticks,
    /// The first change of a coil current in the log.
    Currents,
    /// A search by correlation.
    Search,
}

impl StartFrom {
    /// The word in tables.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Ticks => "ticks",
            Self::Currents => "currents",
            Self::Search => "search",
        }
    }
}

/// Points of the path evaluated for each start.
const POINTS_EVALUATED: usize = 400;
/// Most starts tried in a long record.
const MAX_STARTS: i64 = 10_000;
/// Currents that differ by less count as equal, amperes.
const CURRENT_TOLERANCE_A: f64 = 1e-6;
/// Pauses from ticks that differ from the requested one by more than this fraction belong to other commands.
const PAUSE_TOLERANCE: f64 = 0.05;

/// Start and pause (nanoseconds) from the frames' ticks, and a note about them; `None` without ticks.
pub(super) fn from_ticks(
    recording: &Recording,
    pause_ns: i64,
    commands: usize,
) -> Result<Option<(i64, i64, Option<String>)>, SeriesError> {
    let Some(ticks) = recording.ticks()? else { return Ok(None) };
    let Some(first_ns) = ticks.times_ns.first().copied() else { return Ok(None) };
    if !ticks.resolves(pause_ns) {
        let note = format!(
            "a count of commands modulo {} aliases at this pause: only the start is taken from it",
            ticks.modulus
        );
        return Ok(Some((first_ns, pause_ns, Some(note))));
    }
    let Some((start_ns, measured_ns)) = ticks.evenly(commands) else { return Ok(Some((first_ns, pause_ns, None))) };
    let off = measured_ns / pause_ns as f64 - 1.0;
    if off.abs() > PAUSE_TOLERANCE {
        let note = format!(
            "by the ticks a command was held for {:.3} ms, not {:.3} ms: check --pause; only the start is taken from \
             them",
            measured_ns * 1e-6,
            pause_ns as f64 * 1e-6
        );
        return Ok(Some((first_ns, pause_ns, Some(note))));
    }
    let fewer = (ticks.times_ns.len() < commands)
        .then(|| format!("the ticks count {} commands of {commands}", ticks.times_ns.len()));
    Ok(Some((start_ns, measured_ns.round() as i64, fewer)))
}

/// The first change of a coil current, camera time; or the first current itself if it is not zero and not held longer
/// than a command: then it is one.
pub(super) fn from_currents(currents: &[Current], pause_ns: i64) -> Option<i64> {
    let first = currents.first()?;
    let differs = |current: &&Current| {
        let mut pairs = current.values_a.iter().zip(&first.values_a);
        pairs.any(|(a, b)| (a - b).abs() > CURRENT_TOLERANCE_A) || current.values_a.len() != first.values_a.len()
    };
    let change_ns = currents.iter().find(differs).and_then(|current| current.stamp_ns)?;
    let flows = first.values_a.iter().any(|value| value.abs() > CURRENT_TOLERANCE_A);
    let is_command = |first_ns: &i64| flows && 2 * change_ns.saturating_sub(*first_ns) <= 3 * pause_ns;
    first.stamp_ns.filter(is_command).or(Some(change_ns))
}

/// How many commands there are from a start that was searched for: those that were given even if it is late by half a
/// period. `skip`: periods that do not count.
pub(super) fn commands_after_search(path: &DesiredPath, skip: usize) -> usize {
    let late = if path.periods > skip + 1 { path.points.len() / 2 } else { 0 };
    path.commands() - late
}

/// The start at which the motion correlates best with the path, and that correlation; `None` when the record is shorter
/// than so many commands, or does not move. Accurate to about one point of 200 per period.
pub(super) fn by_search(path: &DesiredPath, samples: &[Sample], pause_ns: i64, commands: usize) -> Option<(i64, f64)> {
    let (first_ns, last_ns) = (samples.first()?.0, samples.last()?.0);
    let window = Window { start_ns: first_ns, pause_ns, commands };
    let slack_ns = last_ns.checked_sub(window.end_ns()).filter(|slack| *slack >= 0)?;
    let times_s = samples.iter().map(|(ns, _)| seconds(ns.saturating_sub(first_ns))).collect();
    let curve = Curve::through(times_s, samples.iter().map(|(_, v)| *v).collect(), Interpolation::Linear);
    let every = window.commands.div_ceil(POINTS_EVALUATED);
    let points: Vec<(f64, Vector3<f64>)> = (0..window.commands)
        .step_by(every)
        .map(|k| ((k as f64 + 0.5) * seconds(pause_ns), path.point(k).coords))
        .collect();
    let best = |from_ns: i64, to_ns: i64, step_ns: i64| {
        let starts = (0..=(to_ns - from_ns) / step_ns).map(|k| from_ns + k * step_ns);
        let scored = starts.filter_map(|ns| Some((correlation(&curve, &points, seconds(ns))?, ns)));
        scored.max_by(|a, b| a.0.total_cmp(&b.0))
    };
    // A long record is searched coarsely first.
    let fine_ns = (pause_ns.saturating_mul(path.points.len() as i64) / 200).max(1);
    let coarse_ns = fine_ns.max(slack_ns / MAX_STARTS);
    let (_, near_ns) = best(0, slack_ns, coarse_ns)?;
    let (from_ns, to_ns) = ((near_ns - coarse_ns).max(0), (near_ns + coarse_ns).min(slack_ns));
    best(from_ns, to_ns, fine_ns).map(|(correlation, ns)| (first_ns + ns, correlation))
}

/// Correlation of the motion from `offset_s` on with the commands; `None` without motion.
fn correlation(curve: &Curve, commands: &[(f64, Vector3<f64>)], offset_s: f64) -> Option<f64> {
    let pairs: Vec<(Vector3<f64>, Vector3<f64>)> =
        commands.iter().filter_map(|(t_s, x)| Some((*x, curve.at(offset_s + t_s)?.0))).collect();
    let count = pairs.len() as f64;
    let (mean_x, mean_y) =
        pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |(a, b), (x, y)| (a + x / count, b + y / count));
    let (mut both, mut xx, mut yy) = (0.0, 0.0, 0.0);
    for (x, y) in &pairs {
        let (x, y) = (x - mean_x, y - mean_y);
        both += x.dot(&y);
        xx += x.norm_squared();
        yy += y.norm_squared();
    }
    let correlation = both / (xx * yy).sqrt();
    correlation.is_finite().then_some(correlation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_first_current_is_a_command_when_it_flows_and_changes_soon() {
        let logged = |currents: &[(i64, f64)]| {
            let of = |(ns, a): &(i64, f64)| Current { host_ns: None, stamp_ns: Some(*ns), values_a: vec![0.0, *a] };
            from_currents(&currents.iter().map(of).collect::<Vec<_>>(), 100)
        };
        assert_eq!(logged(&[(5, 0.0), (100, 0.0), (200, 0.01), (300, 0.02)]), Some(200));
        assert_eq!(logged(&[(200, 0.01), (300, 0.02)]), Some(200));
        assert_eq!(logged(&[(200, 0.01), (900, 0.01), (1000, 0.02)]), Some(1000));
        assert_eq!(logged(&[(200, 0.01), (900, 0.01)]), None);
        assert_eq!(logged(&[]), None);
    }
}
