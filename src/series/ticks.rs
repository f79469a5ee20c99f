//! The command clock: a command count visible to the camera, frame by frame.
//!
//! The amplifier displays how many commands it has taken, modulo 4 (the laboratory's), or with a blinking lamp (modulo
//! 2). Where the count changes between two frames, a command was taken between them: its time is known to half a frame
//! on the camera's own clock, independent of the host's.
//!
//! It aliases: if more commands come between two frames than the count can hold, whole cycles are lost.
//! [`Ticks::resolves`] tells whether a pause is long enough.

use super::{Recording, SeriesError};
use crate::source::times::seconds;

/// Commands of a run, at most: 1 kHz for hours.
const MAX_COMMANDS: u64 = 10_000_000;

/// Times of commands from the command count.
#[derive(Debug, Clone, PartialEq)]
pub struct Ticks {
    /// Camera time of each command after the first frame, nanoseconds: the middle of the frames between which the count
    /// changed; commands between the same two frames are spread evenly.
    pub times_ns: Vec<i64>,
    /// Modulus of the count: 2, 4, or more.
    pub modulus: u64,
    /// Usual time between frames, nanoseconds.
    pub interval_ns: i64,
    /// Time between the frames of its first change, nanoseconds.
    pub first_ns: i64,
    /// Longest time between two frames from there to its last change, nanoseconds.
    pub longest_ns: i64,
}

impl Recording {
    /// The times of commands from its frames' ticks; `None` if no frame has one.
    ///
    /// # Errors
    /// When the tick never changes, or counts more commands than a run can have.
    pub fn ticks(&self) -> Result<Option<Ticks>, SeriesError> {
        let seen: Vec<(i64, u64)> = self.frames.iter().filter_map(|f| Some((f.stamp_ns, f.tick?))).collect();
        let (Some(first), Some(most)) = (seen.first(), seen.iter().map(|(_, tick)| *tick).max()) else {
            return Ok(None);
        };
        if seen.iter().all(|(_, tick)| *tick == first.1) {
            return Err(SeriesError::Content {
                path: self.path.clone(),
                problem: format!(
                    "its tick is {} in all {} frames: the count of commands never reached the camera; check the lamp \
                     or line, or remove the column `tick` to go by the clock",
                    first.1,
                    seen.len()
                ),
            });
        }
        let modulus = match most {
            1 => 2,
            2 | 3 => 4,
            more => more.saturating_add(1),
        };
        let mut times_ns = Vec::new();
        let pairs = || seen.iter().zip(seen.iter().skip(1));
        for ((from_ns, from), (to_ns, to)) in pairs() {
            let taken = if to >= from { to - from } else { modulus - from + to };
            if taken > MAX_COMMANDS - times_ns.len() as u64 {
                return Err(SeriesError::Content {
                    path: self.path.clone(),
                    problem: format!(
                        "its tick counts more than {MAX_COMMANDS} commands (from {from} to {to} between two frames, at \
                         {} s): the column `tick` is not a count of commands; remove it to go by the clock",
                        seconds(*to_ns)
                    ),
                });
            }
            let apart_ns = to_ns.saturating_sub(*from_ns) as f64;
            for k in 0..taken {
                let part = (k as f64 + 0.5) / taken as f64;
                times_ns.push(from_ns.saturating_add((apart_ns * part).round() as i64));
            }
        }
        let changes = || pairs().enumerate().filter(|(_, (from, to))| from.1 != to.1).map(|(k, _)| k);
        let (first, last) = (changes().next().unwrap_or(0), changes().next_back().unwrap_or(0));
        let within = pairs().skip(first).take(last - first + 1);
        let apart_ns: Vec<i64> = within.map(|(from, to)| to.0.saturating_sub(from.0)).collect();
        let (first_ns, longest_ns) =
            (apart_ns.first().copied().unwrap_or(0), apart_ns.iter().copied().max().unwrap_or(0));
        let mut intervals: Vec<i64> = pairs().map(|(a, b)| b.0.saturating_sub(a.0)).collect();
        intervals.sort_unstable();
        let interval_ns = intervals.get(intervals.len() / 2).copied().unwrap_or(0);
        Ok(Some(Ticks { times_ns, modulus, interval_ns, first_ns, longest_ns }))
    }
}

impl Ticks {
    /// Whether commands this far apart can be resolved: fewer come between two frames than the modulus.
    pub fn resolves(&self, pause_ns: i64) -> bool {
        self.count_lasts(self.interval_ns, pause_ns)
    }

    /// Whether that also holds where frames are lacking.
    pub fn resolves_all(&self, pause_ns: i64) -> bool {
        self.count_lasts(self.longest_ns, pause_ns)
    }

    fn count_lasts(&self, apart_ns: i64, pause_ns: i64) -> bool {
        // A late frame may include one more.
        apart_ns.saturating_add(pause_ns) < pause_ns.saturating_mul(i64::try_from(self.modulus).unwrap_or(i64::MAX))
    }

    /// σ of the start by the first change alone, nanoseconds: it came at any time between two frames. `None` where they
    /// are so far apart that others may have come before it.
    pub fn first_sd_ns(&self, pause_ns: i64) -> Option<f64> {
        self.count_lasts(self.first_ns, pause_ns).then(|| self.first_ns as f64 / 12_f64.sqrt())
    }

    /// σ of the start of [`Ticks::evenly`], nanoseconds. Where pauses and frames beat, only so many places in a frame
    /// occur, and the line may be off by half of what lies between them.
    pub fn evenly_sd_ns(&self, commands: usize, pause_ns: f64) -> f64 {
        let count = self.times_ns.len().min(commands).max(1);
        let frames = pause_ns / self.interval_ns.max(1) as f64;
        let beats = |places: &usize| {
            let off = frames * *places as f64;
            (off - off.round()).abs() < 0.5 / (count / places) as f64
        };
        let places = (1..count).find(beats).unwrap_or(count);
        self.interval_ns as f64 / 12_f64.sqrt() * (2.0 / (count as f64).sqrt()).max(1.0 / places as f64)
    }

    /// Start and pause (nanoseconds) of `commands` evenly spaced commands, from the first: a line through their times.
    /// `None` for fewer than two.
    pub fn evenly(&self, commands: usize) -> Option<(i64, f64)> {
        let first = *self.times_ns.first()?;
        let points: Vec<(f64, f64)> = self
            .times_ns
            .iter()
            .take(commands)
            .enumerate()
            .map(|(k, ns)| (k as f64, ns.saturating_sub(first) as f64))
            .collect();
        let n = points.len() as f64;
        let (mean_k, mean_t) =
            (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
        let square: f64 = points.iter().map(|p| (p.0 - mean_k).powi(2)).sum();
        let slope = points.iter().map(|p| (p.0 - mean_k) * (p.1 - mean_t)).sum::<f64>() / square;
        let start = first.saturating_add((mean_t - slope * mean_k).round() as i64);
        (points.len() > 1).then_some((start, slope))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_pauses_and_frames_beat_many_ticks_tell_no_more_than_few() {
        let ticks =
            Ticks { times_ns: vec![0; 800], modulus: 4, interval_ns: 16_666_667, first_ns: 0, longest_ns: 16_666_667 };
        let sd_ms = |pause_ms: f64| ticks.evenly_sd_ns(800, pause_ms * 1e6) * 1e-6;
        // 1.2 frames: five places in a frame. 1.203: all.
        assert!((sd_ms(20.0) - 16.667 / 12_f64.sqrt() / 5.0).abs() < 1e-3, "{}", sd_ms(20.0));
        assert!((sd_ms(20.05) - 16.667 / 12_f64.sqrt() * 2.0 / 800_f64.sqrt()).abs() < 1e-3, "{}", sd_ms(20.05));
    }
}
