//! Whether all periods of a run are alike in time and place.
//!
//! In: the observed points of the periods that count. Out: for each period its phase and the middle of its motion; how
//! much the phase changes from one period to the next, on average (a line through all of them) and at most; and how far
//! the middle moves. Phases are those of the lag behind the motion that all periods have in common (`mean_motion.rs`),
//! not behind the path: a response has another shape than a path with several frequencies, and its lag would depend on
//! which of its points are missing.
//!
//! The commands of all periods are the same, so a steady response has one phase and one middle. A phase that changes
//! evenly means that commands were held longer or shorter than assumed, or that one of the clocks is off; a single
//! step, that a clock jumped or commands were lost; a middle that moves, that the base frame or the camera did. Results
//! of all periods together do not show any of this.
//!
//! What it cannot detect: an error that is the same in all periods, and a step by whole periods. Nor, where the tracker
//! gives no σ, whether a change is more than noise: the notes then say so.

use super::lag::{lag, unwrap};
use super::mean_motion::{Shifted, align};
use super::path::DesiredPath;
use super::pauses::Mean;
use nalgebra::{Point3, Vector3};

/// Changes up to this many σ are noise.
const NOISE: f64 = 4.0;
/// Changes of the phase up to this count as none, degrees: interpolation between few frames alone does so much.
const SAME_DEG: f64 = 1.0;
/// Shifts up to this fraction of the motion's size count as none: the circle becomes larger by a ten-thousandth.
const SAME_PLACE: f64 = 0.02;
/// A period smaller than this fraction of the largest is not one of the motion.
const STILL: f64 = 0.5;
/// With fewer frames per period, interpolation is too coarse to compare periods.
const FEWEST_FRAMES: f64 = 8.0;

/// A period of the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Period {
    /// Its number, from 1, with those left out at the beginning.
    number: usize,
    /// From the mean period.
    phase_deg: f64,
    /// σ of a coordinate of its mean, metres: by the tracker's own noise, where that is known, or by slow errors.
    sd_m: Option<f64>,
    /// Root mean square distance of its points from their mean, metres.
    size_m: f64,
    /// From the common motion, metres.
    offset_m: Vector3<f64>,
}

impl Period {
    /// σ of its phase: errors across the radius, as for the whole run.
    fn phase_sd_deg(&self) -> Option<f64> {
        self.sd_m.map(|sd_m| (sd_m / self.size_m).to_degrees())
    }
}

/// A change from one period to a later one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Change {
    /// Numbers of the two periods.
    between: (usize, usize),
    /// By how much: degrees or metres.
    pub by: f64,
    /// Its σ, by the tracker's noise or by slow errors, where that is known.
    sd: Option<f64>,
}

impl Change {
    /// Whether it is worth a note: without σ by its size alone.
    fn exceeds(&self, least: f64) -> bool {
        self.by.abs() > least && self.sd.is_none_or(|sd| self.by.abs() > NOISE * sd)
    }
}

/// Comparison of the periods of a run.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Periods {
    /// What changes from one to another; `None` with fewer than two that move.
    pub changes: Option<Changes>,
    /// Numbers of periods without motion.
    still: Vec<usize>,
}

/// What changes from period to period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Changes {
    /// Change of the phase over one period, by a line through the phases of all periods, and its σ, degrees.
    pub drift_deg: f64,
    pub drift_sd_deg: Option<f64>,
    /// The same from the first period to the last.
    whole: Change,
    /// Largest change of the phase from one period to the next, degrees.
    pub step: Change,
    /// Largest distance between the middles of two periods, metres.
    pub shift: Change,
    /// Root mean square distance of the points of a period from their mean, on average, metres.
    size_m: f64,
}

impl Periods {
    /// From the points of the commands that count, which begin with a period. `sd_m`: the tracker's σ of a coordinate;
    /// `frames`: camera frames per period. `None` for too few frames.
    pub(super) fn of(
        path: &DesiredPath,
        means: &[Option<Mean>],
        skipped: usize,
        sd_m: Option<f64>,
        frames: f64,
    ) -> Option<Self> {
        let length = path.points.len();
        if frames < FEWEST_FRAMES {
            return None;
        }
        // A σ of 0 says nothing.
        let sd_m = sd_m.filter(|sd_m| *sd_m > 0.0);
        let usual = mean_period(means, length);
        let periods = means.chunks_exact(length).enumerate();
        let all: Vec<Shifted> = periods.filter_map(|(at, means)| shifted(&usual, skipped + at + 1, means)).collect();
        let largest_m = all.iter().map(Shifted::size_m).fold(0.0, f64::max);
        let (mut moving, still): (Vec<Shifted>, Vec<Shifted>) =
            all.into_iter().partition(|period| period.size_m() >= STILL * largest_m);
        let slow_sd_m = align(&mut moving, &path.points).unwrap_or_default();
        let moving = moving.iter().map(|shifted| period(shifted, length, (sd_m, slow_sd_m), frames)).collect();
        Some(Self { changes: Changes::of(moving), still: still.iter().map(|period| period.number).collect() })
    }

    /// Notes about what is not alike, for commands held for `pause_s`.
    pub(super) fn notes(&self, pause_s: f64) -> Vec<String> {
        let changes = self.changes.as_ref();
        let phase = changes.and_then(|changes| changes.phase_note(pause_s));
        [self.still_note(), phase, changes.and_then(Changes::shift_note)].into_iter().flatten().collect()
    }

    fn still_note(&self) -> Option<String> {
        let numbers: Vec<String> = self.still.iter().map(usize::to_string).collect();
        (!numbers.is_empty()).then(|| {
            format!(
                "the marker hardly moves in period {}: check --periods, --pause and the start of the commands",
                numbers.join(", ")
            )
        })
    }
}

impl Changes {
    fn of(mut moving: Vec<Period>) -> Option<Self> {
        let mut phases: Vec<Option<f64>> = moving.iter().map(|period| Some(period.phase_deg)).collect();
        unwrap(&mut phases);
        for (period, phase) in moving.iter_mut().zip(phases.into_iter().flatten()) {
            period.phase_deg = phase;
        }
        let (first, last) = (moving.first()?, moving.last()?);
        let (drift_deg, drift_sd_deg) = line(&moving)?;
        let span = (last.number - first.number) as f64;
        let whole = Change {
            between: (first.number, last.number),
            by: drift_deg * span,
            sd: drift_sd_deg.map(|sd_deg| sd_deg * span),
        };
        let both = |a: Option<f64>, b: Option<f64>| Some(a?.hypot(b?));
        let step = moving.iter().zip(moving.iter().skip(1)).map(|(a, b)| Change {
            between: (a.number, b.number),
            by: b.phase_deg - a.phase_deg,
            sd: both(a.phase_sd_deg(), b.phase_sd_deg()),
        });
        let pairs = moving.iter().enumerate().flat_map(|(k, b)| moving.iter().take(k).map(move |a| (a, b)));
        let shift = pairs.map(|(a, b)| Change {
            between: (a.number, b.number),
            by: (b.offset_m - a.offset_m).norm(),
            // Three coordinates.
            sd: both(a.sd_m, b.sd_m).map(|sd_m| sd_m * 3_f64.sqrt()),
        });
        Some(Self {
            drift_deg,
            drift_sd_deg,
            whole,
            step: step.max_by(|a, b| a.by.abs().total_cmp(&b.by.abs()))?,
            shift: shift.max_by(|a, b| a.by.total_cmp(&b.by))?,
            size_m: moving.iter().map(|period| period.size_m).sum::<f64>() / moving.len() as f64,
        })
    }

    fn phase_note(&self, pause_s: f64) -> Option<String> {
        if !self.whole.exceeds(SAME_DEG) && !self.step.exceeds(SAME_DEG) {
            return None;
        }
        let (Change { between: (first, last), .. }, Change { between: (before, after), by, .. }) =
            (self.whole, self.step);
        // A phase that falls by 360° per period belongs to commands that take twice as long.
        let held_ms = pause_s * (1.0 - self.drift_deg / 360.0) * 1e3;
        Some(format!(
            "the phase is not the same in all periods: from period {first} to {last} it changes by {:+.2}°{} per \
             period, at most by {by:+.1}° (from period {before} to {after}). If evenly, commands were held for \
             {held_ms:.4} ms of the camera's clock, not {:.4} ms: check --pause and the clocks. If at once, a clock \
             jumped or commands were lost. If less and less, leave out more periods with --skip",
            self.drift_deg,
            degrees_of_sd(self.drift_sd_deg),
            pause_s * 1e3
        ))
    }

    fn shift_note(&self) -> Option<String> {
        let Change { between: (before, after), by, sd } = self.shift;
        let unknown = if_unknown(sd);
        self.shift.exceeds(SAME_PLACE * self.size_m).then(|| {
            format!(
                "the middle of the motion is {:.2} mm{unknown} away in period {after} from where it is in period \
                 {before}: camera, base or catheter were moved, or the motion has not settled; errors and magnitude \
                 contain it",
                by * 1e3
            )
        })
    }
}

/// The mean of each command's points over all periods; where there are none, the one before.
fn mean_period(means: &[Option<Mean>], length: usize) -> Vec<Point3<f64>> {
    let of_command = |k: usize| {
        let points: Vec<Vector3<f64>> = means.iter().skip(k).step_by(length).flatten().map(|mean| mean.value).collect();
        (!points.is_empty()).then(|| points.iter().sum::<Vector3<f64>>() / points.len() as f64)
    };
    let known: Vec<Option<Vector3<f64>>> = (0..length).map(of_command).collect();
    let mut last = known.iter().rev().flatten().next().copied().unwrap_or_default();
    let filled = known.into_iter().map(|point| {
        last = point.unwrap_or(last);
        Point3::from(last)
    });
    filled.collect()
}

/// The points of one period, and its lag behind the mean period as a start; `None` if more than half of them are
/// missing.
fn shifted(usual: &[Point3<f64>], number: usize, means: &[Option<Mean>]) -> Option<Shifted> {
    let there = || means.iter().enumerate().filter_map(|(k, mean)| Some((k, mean.as_ref()?)));
    let points: Vec<(usize, Point3<f64>)> = there().map(|(k, mean)| (k, Point3::from(mean.value))).collect();
    if 2 * points.len() < usual.len() {
        return None;
    }
    let later = there().map(|(_, mean)| mean.later).sum::<f64>() / points.len() as f64;
    // Without any motion there is none; such a period does not count.
    let lag = later + lag(usual, &points).map_or(0.0, |lag| lag.points);
    let points = there().map(|(k, mean)| (k as f64 + mean.later, mean.value)).collect();
    Some(Shifted { number, points, lag, offset_m: Vector3::zeros() })
}

/// `sd_m`: of a coordinate in a frame, by the tracker; and in a point, as far as errors are slow.
fn period(shifted: &Shifted, length: usize, (sd_m, slow_sd_m): (Option<f64>, f64), frames: f64) -> Period {
    let points = shifted.points.len() as f64;
    let there = points / length as f64;
    let of_mean = |sd_m: f64| (sd_m / (frames * there).sqrt()).max(slow_sd_m / points.sqrt());
    Period {
        number: shifted.number,
        phase_deg: -360.0 * shifted.lag / length as f64,
        sd_m: sd_m.map(of_mean),
        size_m: shifted.size_m(),
        offset_m: shifted.offset_m,
    }
}

/// Slope of a line through the phases over the periods' numbers, and its σ where that is known, degrees per period;
/// periods then count by the number of their frames, otherwise equally. `None` for fewer than two.
fn line(periods: &[Period]) -> Option<(f64, Option<f64>)> {
    let known = periods.iter().all(|period| period.sd_m.is_some());
    let weight = |period: &Period| period.phase_sd_deg().map_or(1.0, |sd_deg| sd_deg.powi(-2));
    let sum = |of: &dyn Fn(&Period) -> f64| periods.iter().map(|period| weight(period) * of(period)).sum::<f64>();
    let all = sum(&|_| 1.0);
    let (number, phase) = (sum(&|p| p.number as f64) / all, sum(&|p| p.phase_deg) / all);
    let spread = sum(&|p| (p.number as f64 - number).powi(2));
    let slope = sum(&|p| (p.number as f64 - number) * (p.phase_deg - phase)) / spread;
    slope.is_finite().then(|| (slope, known.then(|| spread.sqrt().recip())))
}

/// What follows an angle in a note: its σ, or that there is none.
pub(super) fn degrees_of_sd(sd_deg: Option<f64>) -> String {
    sd_deg.map_or_else(|| if_unknown(sd_deg).to_owned(), |sd_deg| format!(" ± {sd_deg:.2}°"))
}

/// What follows any other quantity, if it has no σ.
pub(super) fn if_unknown(sd: Option<f64>) -> &'static str {
    if sd.is_none() { " (σ is not known)" } else { "" }
}
