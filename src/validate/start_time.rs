//! Time of the first command, if it is not given.
//!
//! - From the frames' ticks: the first change of the command count. If commands are slow enough for the count, a line
//!   through the times of all of them gives start and pause, which an amplifier keeps to a few parts in a thousand.
//! - From the coil currents in the log: the time from which on they repeat with the period of the path, as often as it
//!   was commanded. A test pulse before it, a first point that is held, or one without current do not matter. Currents
//!   that do not repeat, or a single period, start at the first change: when a current differs from the first one
//!   logged, or with that one itself if it is not zero and changes within 1.5 pauses.
//! - Otherwise by a search over the record: the start at which the observed motion correlates best with the whole
//!   commanded one. That absorbs the catheter's lag: such a start gives no phase, and errors also exclude the lag. As
//!   it is late by the lag, the last commands would end after the true ones, where the catheter returns to rest; so the
//!   last half of a period, the largest lag, does not count, unless a single period does.

use super::path::DesiredPath;
use super::pauses::{Sample, Window};
use super::spline::{Curve, Interpolation};
use crate::median::median;
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
    /// Coil currents in the log that repeat, or their first change.
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
/// Most commands at the beginning that leave the currents as they were.
const UNCHANGED: i64 = 5;
/// By which part the time of a period may be off.
const PAUSE_OFF: f64 = 0.01;
/// Largest part of the commands that may differ from those of the next period: messages are lost, or late.
const MAX_UNLIKE: f64 = 0.05;
/// Pauses from ticks that differ from the requested one by more than this fraction belong to other commands.
const PAUSE_TOLERANCE: f64 = 0.05;

/// Start and pause, nanoseconds, from the frames' ticks.
#[derive(Debug, Clone)]
pub(super) struct Ticked {
    pub start_ns: i64,
    /// σ of the start; `None` where it may be off by a whole frame.
    pub start_sd_ns: Option<f64>,
    pub pause_ns: i64,
    pub note: Option<String>,
}

/// The commands by the frames' ticks; `None` without ticks.
pub(super) fn from_ticks(recording: &Recording, pause_ns: i64, commands: usize) -> Result<Option<Ticked>, SeriesError> {
    let Some(ticks) = recording.ticks()? else { return Ok(None) };
    let Some(start_ns) = ticks.times_ns.first().copied() else { return Ok(None) };
    let first = |note: Option<String>| Ticked { start_ns, start_sd_ns: ticks.first_sd_ns(pause_ns), pause_ns, note };
    if !ticks.resolves(pause_ns) {
        let note = format!(
            "a count of commands modulo {} aliases at this pause: only the start is taken from it, which may be a \
             frame late; the phase has no σ",
            ticks.modulus
        );
        return Ok(Some(Ticked { start_sd_ns: None, ..first(Some(note)) }));
    }
    if !ticks.resolves_all(pause_ns) {
        let note = format!(
            "{:.3} s without a frame are too long for a count of commands modulo {}: only the start is taken from it, \
             and --pause as it is",
            seconds(ticks.longest_ns),
            ticks.modulus
        );
        return Ok(Some(first(Some(note))));
    }
    let Some((start_ns, measured_ns)) = ticks.evenly(commands) else { return Ok(Some(first(None))) };
    let off = measured_ns / pause_ns as f64 - 1.0;
    if off.abs() > PAUSE_TOLERANCE {
        let note = format!(
            "by the ticks a command was held for {:.3} ms, not {:.3} ms: check --pause; only the start is taken from \
             them",
            measured_ns * 1e-6,
            pause_ns as f64 * 1e-6
        );
        return Ok(Some(first(Some(note))));
    }
    let fewer = (ticks.times_ns.len() < commands)
        .then(|| format!("the ticks count {} commands of {commands}", ticks.times_ns.len()));
    let start_sd_ns = Some(ticks.evenly_sd_ns(commands, measured_ns));
    Ok(Some(Ticked { start_ns, start_sd_ns, pause_ns: measured_ns.round() as i64, note: fewer }))
}

/// The start by the coil currents, camera time, and a note about it; `None` if they never change.
pub(super) fn from_currents(currents: &[Current], path: &DesiredPath, pause_ns: i64) -> Option<(i64, Option<String>)> {
    let change_ns = first_change(currents, pause_ns)?;
    if path.periods < 2 {
        return Some((change_ns, None));
    }
    let Some(Repeating { start_ns, may_be_later }) = Repeating::of(currents, path, pause_ns) else {
        let note = "the currents do not repeat with the period of the path: the start is their first change; check \
                    --pause, --periods and --points-per-period";
        return Some((change_ns, Some(note.to_owned())));
    };
    let note = if may_be_later {
        Some(format!(
            "by the currents the first command is that at {:.3} s, or one of the next: the path begins or ends with \
             the current before it, and the log does not tell where; if it is a later one, give --start",
            seconds(start_ns)
        ))
    } else {
        let is_before = start_ns.saturating_sub(change_ns) > pause_ns / 2;
        is_before.then(|| {
            format!(
                "the currents repeat with the path from {:.3} s on: what they do before, from {:.3} s on, is not part \
                 of it",
                seconds(start_ns),
                seconds(change_ns)
            )
        })
    };
    Some((start_ns, note))
}

/// Commands whose currents repeat from period to period.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Repeating {
    /// The first of them.
    start_ns: i64,
    /// Whether it may be a later one: they repeat from there on as well.
    may_be_later: bool,
}

impl Repeating {
    /// The first command may be a change of the currents, or some commands before it, if they change nothing.
    fn of(currents: &[Current], path: &DesiredPath, pause_ns: i64) -> Option<Self> {
        let mut known: Vec<(i64, &[f64])> =
            currents.iter().filter_map(|current| Some((current.stamp_ns?, &current.values_a[..]))).collect();
        known.sort_by_key(|(ns, _)| *ns);
        let changes: Vec<(i64, &[f64])> =
            known.chunk_by(|a, b| !is_other(a.1, b.1)).filter_map(|equal| equal.first().copied()).collect();
        let length = path.points.len();
        let period_ns = period_ns(&changes, pause_ns.saturating_mul(length as i64));
        let at = |ns: f64| known.get(known.partition_point(|(from_ns, _)| *from_ns as f64 <= ns).checked_sub(1)?);
        let most = ((path.periods - 1) as f64 * length as f64 * MAX_UNLIKE) as usize;
        // How many commands of all periods but the last are not as one period later; `None` if more than `most`, or if
        // in one of them nothing changes, as in a rest, which repeats too.
        let unlike = |start_ns: i64| {
            let mut unlike = 0;
            for period in 0..path.periods {
                let is_last = period + 1 == path.periods;
                let middle_ns =
                    |k: usize| start_ns as f64 + (period as f64 + (k as f64 + 0.5) / length as f64) * period_ns;
                let (begin, mut moves) = (at(middle_ns(0))?, false);
                for k in 0..length {
                    let own = at(middle_ns(k))?;
                    moves |= is_other(own.1, begin.1);
                    unlike += usize::from(!is_last && is_other(own.1, at(middle_ns(k) + period_ns)?.1));
                    if unlike > most {
                        return None;
                    }
                }
                if !moves {
                    return None;
                }
            }
            Some(unlike)
        };
        let starts = changes
            .iter()
            .flat_map(|(ns, _)| (0..=UNCHANGED).map(move |before| ns.saturating_sub(before.saturating_mul(pause_ns))));
        let mut found: Vec<(usize, i64)> = starts.filter_map(|ns| Some((unlike(ns)?, ns))).collect();
        // Of those that repeat best, the first in time.
        found.sort_unstable();
        let (least, first_ns) = *found.first()?;
        let repeats_later =
            found.iter().any(|(unlike, ns)| *unlike == least && ns.saturating_sub(first_ns) > pause_ns / 2);
        // A log of all commands, not of changes alone, tells which is the first of them.
        let quarter_ns = pause_ns.unsigned_abs() / 4;
        let logged = |ns: i64| {
            let near = known.iter().map(|(own_ns, _)| *own_ns).filter(|own_ns| own_ns.abs_diff(ns) < quarter_ns);
            near.min_by_key(|own_ns| own_ns.abs_diff(ns))
        };
        let begins_the_log = logged(first_ns).is_some() && logged(first_ns.saturating_sub(pause_ns)).is_none();
        let may_be_later = repeats_later && !begins_the_log;
        Some(Self { start_ns: logged(first_ns).unwrap_or(first_ns), may_be_later })
    }
}

/// The time after which changes of the currents come again, nanoseconds; `nominal_ns` where they do not. An amplifier
/// keeps a pause to a few parts in a thousand, by which the last of many commands would be taken for its neighbour.
fn period_ns(changes: &[(i64, &[f64])], nominal_ns: i64) -> f64 {
    let off = |a: &(i64, &[f64]), b: &(i64, &[f64])| b.0.saturating_sub(a.0).saturating_sub(nominal_ns);
    let near_ns = (nominal_ns as f64 * PAUSE_OFF) as i64;
    let again = |one: &(i64, &[f64])| {
        let from = changes.partition_point(|other| off(one, other) < -near_ns);
        let near = changes.get(from..)?.iter().take_while(|other| off(one, other) <= near_ns);
        let alike = near.filter(|other| !is_other(one.1, other.1)).map(|other| off(one, other));
        alike.min_by_key(|off| off.unsigned_abs())
    };
    nominal_ns as f64 + median(changes.iter().filter_map(again).map(|off| off as f64)).unwrap_or(0.0)
}

/// Whether currents differ.
fn is_other(a: &[f64], b: &[f64]) -> bool {
    a.len() != b.len() || a.iter().zip(b).any(|(a, b)| (a - b).abs() > CURRENT_TOLERANCE_A)
}

/// The first change of a coil current, camera time; or the first current itself if it is not zero and not held longer
/// than a command: then it is one.
fn first_change(currents: &[Current], pause_ns: i64) -> Option<i64> {
    let first = currents.first()?;
    let differs = |current: &&Current| is_other(&current.values_a, &first.values_a);
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
    use crate::validate::plane::Plane;
    use nalgebra::Point3;

    #[test]
    fn a_first_current_is_a_command_when_it_flows_and_changes_soon() {
        let logged = |currents: &[(i64, f64)]| {
            let of = |(ns, a): &(i64, f64)| Current { host_ns: None, stamp_ns: Some(*ns), values_a: vec![0.0, *a] };
            first_change(&currents.iter().map(of).collect::<Vec<_>>(), 100)
        };
        assert_eq!(logged(&[(5, 0.0), (100, 0.0), (200, 0.01), (300, 0.02)]), Some(200));
        assert_eq!(logged(&[(200, 0.01), (300, 0.02)]), Some(200));
        assert_eq!(logged(&[(200, 0.01), (900, 0.01), (1000, 0.02)]), Some(1000));
        assert_eq!(logged(&[(200, 0.01), (900, 0.01)]), None);
        assert_eq!(logged(&[]), None);
    }

    /// Currents of a path of eight points, seven periods of it, one message for each command; then it returns to rest.
    fn commanded(period_ma: [i32; 8], before: &[(i64, i32)]) -> Vec<Current> {
        let commands = (0..56).map(|k| (1000 + 100 * k as i64, period_ma[k % 8]));
        let all = before.iter().copied().chain(commands).chain([(6600, 0)]);
        let of = |(ns, ma)| Current { host_ns: None, stamp_ns: Some(ns), values_a: vec![f64::from(ma) * 1e-3] };
        all.map(of).collect()
    }

    fn path(periods: usize) -> DesiredPath {
        let points: Vec<Point3<f64>> =
            (0..8).map(|k| Point3::new(f64::from(k).cos(), f64::from(k).sin(), 0.0)).collect();
        let plane = Plane::through(&points).unwrap();
        DesiredPath {
            file: "path.csv".into(),
            points,
            tangents: None,
            periods,
            is_repetition: false,
            plane,
            circle: None,
        }
    }

    #[test]
    fn currents_that_repeat_tell_the_start_whatever_was_before() {
        let (from_zero, from_five) = ([0, 3, 5, 3, 0, -3, -5, -3], [5, 3, 0, -3, -5, -3, 0, 3]);
        let start_ns =
            |period, before: &[(i64, i32)]| from_currents(&commanded(period, before), &path(7), 100).unwrap().0;
        assert_eq!(start_ns(from_zero, &[(200, 0)]), 1000, "the first point has no current");
        assert_eq!(start_ns(from_five, &[(200, 0), (600, 5)]), 1000, "the first point is held");
        assert_eq!(start_ns(from_five, &[(200, 5)]), 1000, "the log begins with the first point");
        assert_eq!(start_ns(from_five, &[(0, 0), (200, 10), (250, 0)]), 1000, "a pulse");
        assert_eq!(start_ns(from_five, &[]), 1000, "nothing");
        assert_eq!(start_ns(from_five, &[(200, 0), (400, 0)]), 1000, "rest");
        assert_eq!(start_ns([0, 0, 5, 3, 0, -3, -5, -3], &[(200, 0)]), 1000, "two points have no current");
        // Messages up to 20 % of a pause late, and one lost.
        let mut late = commanded(from_five, &[(200, 0)]);
        late.iter_mut().skip(2).step_by(3).for_each(|current| current.stamp_ns = current.stamp_ns.map(|ns| ns + 20));
        late.remove(9);
        assert_eq!(from_currents(&late, &path(7), 100).unwrap(), (1000, None));
        let mut after_pulse = commanded(from_five, &[(-10_000, 0), (-9000, 10), (-8900, 0)]);
        after_pulse.remove(12);
        assert_eq!(from_currents(&after_pulse, &path(7), 100).unwrap().0, 1000);
        // Held for 0.5 % longer than asked for: of 56 commands the last is a quarter of one late.
        let mut slow = commanded(from_five, &[(200, 0)]);
        slow.iter_mut()
            .for_each(|current| current.stamp_ns = current.stamp_ns.map(|ns| 1000 + (ns - 1000) * 201 / 200));
        assert_eq!(from_currents(&slow, &path(7), 100).unwrap(), (1000, None));
    }

    #[test]
    fn a_start_that_currents_leave_open_is_told() {
        // Only changes are logged: the first command, without current, is none.
        let mut changes = commanded([0, 3, 5, 3, 0, -3, -5, -3], &[(200, 0)]);
        changes.remove(1);
        let (start_ns, note) = from_currents(&changes, &path(7), 100).unwrap();
        assert_eq!(start_ns, 1000);
        assert!(note.unwrap().contains("or one of the next"));
        // What does not repeat starts at its first change.
        let other = [(0, 0), (700, 4), (800, 1), (900, 7), (1500, 2)].map(|(ns, ma)| (ns, ma));
        let of = |(ns, ma)| Current { host_ns: None, stamp_ns: Some(ns), values_a: vec![f64::from(ma) * 1e-3] };
        let (start_ns, note) = from_currents(&other.map(of), &path(7), 100).unwrap();
        assert_eq!(start_ns, 700);
        assert!(note.unwrap().contains("do not repeat"));
    }
}
