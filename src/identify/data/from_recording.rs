//! From a recording to a series: θ at camera times, and the current that the amplifier held between them.
//!
//! In: frames and commands of the coils on the camera's clock. Out: one entry for each camera frame, including lost
//! ones, with the current averaged from this frame to the next. The last command is assumed to be held to the end.

use crate::identify::data::grid::{Grid, GridError, Series};
use crate::identify::data::hold::Held;
use crate::identify::data::plant::Plant;
use crate::identify::data::segments::PARTS;
use crate::plural::plural;
use crate::series::{Current, Frame, Recording};

/// Interval, in periods, beyond which frames were lost.
const GAP_PERIODS: f64 = 1.5;
const S_PER_NS: f64 = 1e-9;
/// What commands do between frames is left out where it changes the gain by no more than this part.
const NEGLIGIBLE: f64 = 1e-5;
/// A last command that is longer than this before the first frame has another clock, seconds.
const LONGEST_BEFORE_S: f64 = 60.0;

/// Why a recording cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RecordedError {
    /// It has no frame.
    #[error("{name}: has no frame")]
    NoFrame {
        /// The recording.
        name: String,
    },
    /// θ is missing in all frames.
    #[error("{name}: θ was measured in none of {frames} frames ({why}); look at the run's report for the reasons")]
    NeverMeasured {
        /// The recording.
        name: String,
        /// How many frames.
        frames: usize,
        /// The first reason.
        why: String,
    },
    /// No commands.
    #[error(
        "{name}: has no coil currents; record them with `catoptra live --currents`, or give a table of them with \
         --currents"
    )]
    NoCurrents {
        /// The recording.
        name: String,
    },
    /// Commands, but none on the camera's clock.
    #[error(
        "{name}: has {} of coil currents, but no frame with the host's time (`host_stamp_ns`), by which they would be \
         brought to the camera's clock; give a table of them on that clock with --currents",
        plural(*samples as u64, "sample")
    )]
    NoCommonClock {
        /// The recording.
        name: String,
        /// How many there are.
        samples: usize,
    },
    /// A coil that does not exist.
    #[error(
        "{name}: has currents of {}, and coil {coil} was asked for; they are counted from 0", plural(*coils, "coil")
    )]
    NoCoil {
        /// The recording or table.
        name: String,
        /// The number of coils.
        coils: usize,
        /// The requested one.
        coil: usize,
    },
    /// A command that is none.
    #[error("{name}: the current of coil {coil} at {at_s:.3} s of the camera's clock is not a number")]
    NotANumber {
        /// The recording or table.
        name: String,
        /// Which coil.
        coil: usize,
        /// When, seconds.
        at_s: f64,
    },
    /// No frame has a current.
    #[error(
        "{name}: frames are from {:.3} s to {:.3} s and commands from {:.3} s to {:.3} s of the camera's clock: they \
         do not overlap; say with --delay how much later the commands acted",
        frames_s.0, frames_s.1, commands_s.0, commands_s.1
    )]
    ClocksApart {
        /// The recording.
        name: String,
        /// First and last frame, seconds.
        frames_s: (f64, f64),
        /// First and last command, seconds.
        commands_s: (f64, f64),
    },
    /// Frame times do not form a grid.
    #[error(transparent)]
    Grid(#[from] GridError),
}

/// θ over time.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Observed {
    /// The file.
    pub name: String,
    /// Camera time of the first frame, nanoseconds; times count from it.
    pub zero_ns: i64,
    /// Seconds since the first frame.
    pub time_s: Vec<f64>,
    /// Radians.
    pub theta_rad: Vec<Option<f64>>,
}

impl Observed {
    /// Reads θ from a recording.
    ///
    /// # Errors
    /// When there is no frame, or no frame with θ.
    pub(crate) fn of(recording: &Recording) -> Result<Self, RecordedError> {
        Self::of_angle(recording, |frame| frame.theta_rad)
    }

    /// The same with another angle of a frame in place of θ.
    ///
    /// # Errors
    /// As [`Observed::of`].
    pub(crate) fn of_angle(
        recording: &Recording,
        angle_rad: impl Fn(&Frame) -> Option<f64>,
    ) -> Result<Self, RecordedError> {
        let name = recording.path.display().to_string();
        let frames = &recording.frames;
        let Some(first) = frames.first() else { return Err(RecordedError::NoFrame { name }) };
        let theta_rad: Vec<Option<f64>> = frames.iter().map(angle_rad).collect();
        if theta_rad.iter().all(Option::is_none) {
            let status = first
                .theta_status
                .clone()
                .or_else(|| first.places.iter().map(|p| p.status.clone()).find(|s| s != "ok"));
            let why = status.unwrap_or_else(|| "no reason is given".to_owned());
            return Err(RecordedError::NeverMeasured { name, frames: frames.len(), why });
        }
        let zero_ns = first.stamp_ns;
        Ok(Self {
            name,
            zero_ns,
            time_s: frames.iter().map(|f| f.stamp_ns.saturating_sub(zero_ns) as f64 * S_PER_NS).collect(),
            theta_rad,
        })
    }

    /// The commands of one coil, on the clock of [`Observed::time_s`]. `name`: the source of the currents.
    ///
    /// # Errors
    /// When there are none, or none of this coil.
    pub(crate) fn commands(&self, name: &str, currents: &[Current], coil: usize) -> Result<Held, RecordedError> {
        let none = || RecordedError::NoCurrents { name: name.to_owned() };
        let coils = currents.iter().map(|c| c.values_a.len()).max().ok_or_else(none)?;
        let missing = || RecordedError::NoCoil { name: name.to_owned(), coils, coil };
        let command = |c: &Current| {
            let t = c.stamp_ns?.saturating_sub(self.zero_ns) as f64 * S_PER_NS;
            Some((t, c.values_a.get(coil).copied()))
        };
        let all = currents.iter().filter_map(command).map(|(t, value)| value.map(|v| (t, v)).ok_or_else(missing));
        let all = all.collect::<Result<Vec<_>, _>>()?;
        if let Some((at_s, _)) = all.iter().find(|(_, value)| !value.is_finite()) {
            let at_s = at_s + self.zero_ns as f64 * S_PER_NS;
            return Err(RecordedError::NotANumber { name: name.to_owned(), coil, at_s });
        }
        if all.is_empty() {
            return Err(RecordedError::NoCommonClock { name: name.to_owned(), samples: currents.len() });
        }
        Ok(Held::new(all))
    }

    /// The series: the drive is in amperes if `plant` converts it to torque, otherwise in the unit of `commands`.
    /// Commands act `delay_s` after their times.
    ///
    /// # Errors
    /// When frame times do not rise, or no frame has a current.
    pub(crate) fn series(&self, commands: &Held, plant: Option<Plant>, delay_s: f64) -> Result<Series, RecordedError> {
        let usual = crate::identify::data::grid::usual_interval(&self.name, &self.time_s)?;
        // What acts for less than a frame hardly moves it.
        let moved_before = self.time_s.first().is_some_and(|first| commands.acted_before(first - delay_s - usual));
        let mut series = Series { name: self.name.clone(), plant, moved_before, ..Series::default() };
        let mut integrals = commands.integrals();
        let mut push = |from: f64, to: f64, theta: Option<f64>| {
            series.time_s.push(from);
            series.drive.push(integrals.mean_from_rest(from - delay_s, to - delay_s));
            series.output.push(theta);
        };
        for (k, (t, theta)) in self.time_s.iter().zip(&self.theta_rad).enumerate() {
            let next = self.time_s.get(k + 1).copied().unwrap_or(t + usual);
            let periods = (next - t) / usual;
            let whole = if periods < GAP_PERIODS { 1 } else { periods.round() as usize };
            let step = (next - t) / whole as f64;
            for lost in 0..whole {
                let from = t + lost as f64 * step;
                push(from, from + step, if lost == 0 { *theta } else { None });
            }
        }
        let (first, last) = commands.span_s().unwrap_or_default();
        if series.drive.iter().all(Option::is_none) || last + delay_s < -LONGEST_BEFORE_S {
            let on_camera = |s: f64| s + self.zero_ns as f64 * S_PER_NS;
            let end = self.time_s.last().copied().unwrap_or(0.0);
            return Err(RecordedError::ClocksApart {
                name: self.name.clone(),
                frames_s: (on_camera(0.0), on_camera(end)),
                commands_s: (on_camera(first), on_camera(last)),
            });
        }
        Ok(series)
    }

    /// Adds to a series of these commands how they change between its samples, if that matters. Returns by what part a
    /// model of means would have too large a gain: a sine's mean is smaller by s = sinc(f T), and what it is beyond has
    /// the power 1 − s² of its own; over that of the means, s², this is 1/s² − 1.
    pub(crate) fn add_within(&self, series: &mut Series, commands: &Held, delay_s: f64) -> f64 {
        let mut integrals = commands.integrals();
        let beyond = |(from, to): (f64, f64)| {
            let part_s = (to - from) / PARTS as f64;
            let begin = integrals.since_rest(from - delay_s);
            let mean = (integrals.since_rest(to - delay_s) - begin) / (to - from);
            let mut before = begin;
            std::array::from_fn(|i| {
                let here = integrals.since_rest(from - delay_s + (i + 1) as f64 * part_s);
                let in_part = (here - before) / part_s;
                before = here;
                in_part - mean
            })
        };
        let times = series.time_s.iter().copied();
        series.within = times.clone().zip(times.skip(1)).map(beyond).collect();
        // What the last sample's input does is not seen any more.
        series.within.resize(series.time_s.len(), [0.0; PARTS]);
        let known = || series.drive.iter().flatten();
        let mean = known().sum::<f64>() / known().count() as f64;
        let of_means = known().map(|drive| (drive - mean).powi(2)).sum::<f64>();
        let of_changes = series.within.iter().flatten().map(|beyond| beyond * beyond).sum::<f64>() / PARTS as f64;
        let part = of_changes / of_means;
        // Without any motion of the means it is no number.
        if part.is_nan() || part <= NEGLIGIBLE {
            series.within.clear();
        }
        part
    }

    /// The frames from `from_s` on.
    pub(crate) fn from(&self, from_s: f64) -> Self {
        let first = self.time_s.partition_point(|t| *t < from_s);
        Self {
            name: self.name.clone(),
            zero_ns: self.zero_ns,
            time_s: self.time_s.iter().skip(first).copied().collect(),
            theta_rad: self.theta_rad.iter().skip(first).copied().collect(),
        }
    }

    /// The grid of the camera's frames.
    ///
    /// # Errors
    /// [`GridError`].
    pub(crate) fn grid(&self) -> Result<Grid, GridError> {
        Grid::of(&self.name, &self.time_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::series::Place;
    use std::path::PathBuf;

    fn recording(stamps_ms: &[i64], theta: impl Fn(usize) -> Option<f64>) -> Recording {
        let frame = |(k, ms): (usize, &i64)| Frame {
            seq: k as u64,
            stamp_ns: ms * 1_000_000,
            host_ns: None,
            gap: 0,
            theta_rad: theta(k),
            theta_sd_rad: None,
            theta_status: theta(k).map_or(Some("not_seen_mirror".to_owned()), |_| Some("ok".to_owned())),
            places: Vec::<Place>::new(),
            tangent: None,
            tangent_sd_rad: None,
            tick: None,
        };
        Recording {
            path: PathBuf::from("run.mcap"),
            clock: None,
            reference: None,
            markers: Vec::new(),
            frames: stamps_ms.iter().enumerate().map(frame).collect(),
            currents: Vec::new(),
            cut: None,
            vetoed: 0,
            currents_lost: 0,
        }
    }

    fn command(ms: i64, a: f64) -> Current {
        Current { host_ns: None, stamp_ns: Some(ms * 1_000_000), values_a: vec![9.0, a] }
    }

    #[test]
    fn currents_are_averaged_from_frame_to_frame_and_lost_frames_have_their_place() {
        let observed = Observed::of(&recording(&[1000, 1010, 1040, 1050], |k| (k != 1).then_some(k as f64))).unwrap();
        let commands = [command(1000, 1.0), command(1005, 3.0), command(1025, -1.0)];
        let held = observed.commands("c", &commands, 1).unwrap();
        let series = observed.series(&held, None, 0.0).unwrap();
        assert_eq!(series.output, [Some(0.0), None, None, None, Some(2.0), Some(3.0)]);
        let drive: Vec<f64> = series.drive.iter().flatten().map(|d| (d * 1e9).round() / 1e9).collect();
        assert_eq!(drive, [2.0, 3.0, 1.0, -1.0, -1.0, -1.0]);
        // Later by 5 ms: zero before the first command, which comes in the middle of a frame; by 15 ms, nothing is
        // known of the frame before that one.
        let late = observed.series(&held, None, 0.005).unwrap();
        assert!((late.drive[0].unwrap() - 0.5).abs() < 1e-9 && (late.drive[1].unwrap() - 3.0).abs() < 1e-9);
        let later = observed.series(&held, None, 0.015).unwrap();
        assert!(later.drive[0].is_none() && (later.drive[1].unwrap() - 0.5).abs() < 1e-9, "{:?}", later.drive);
    }

    /// In whole milliseconds 40 frames of 60 Hz are 39 of the median, 17 ms.
    #[test]
    fn a_long_hole_has_as_many_places_as_frames_were_lost() {
        let stamps: Vec<i64> = (0..300)
            .filter(|k| !(100..139).contains(k))
            .map(|k| (f64::from(k) * 1000.0 / 60.0).round() as i64)
            .collect();
        let observed = Observed::of(&recording(&stamps, |_| Some(0.0))).unwrap();
        let held = observed.commands("c", &[command(0, 1.0)], 1).unwrap();
        let series = observed.series(&held, None, 0.0).unwrap();
        assert_eq!(series.output.len(), 300);
        assert!(series.output[100..139].iter().all(Option::is_none) && series.output[139].is_some());
    }

    #[test]
    fn what_cannot_be_used_is_explained() {
        let never = Observed::of(&recording(&[0, 10], |_| None)).unwrap_err().to_string();
        assert!(never.starts_with("run.mcap: θ was measured in none of 2 frames (not_seen_mirror)"), "{never}");
        assert!(Observed::of(&recording(&[], |_| None)).unwrap_err().to_string().ends_with("has no frame"));
        let observed = Observed::of(&recording(&[5000, 5010], |_| Some(0.0))).unwrap();
        assert!(matches!(observed.commands("c", &[], 0), Err(RecordedError::NoCurrents { .. })));
        let unrelated = Current { host_ns: Some(1), stamp_ns: None, values_a: vec![0.1] };
        let no_clock = observed.commands("c", &[unrelated], 0).unwrap_err().to_string();
        assert!(no_clock.contains("has 1 sample of coil currents"), "{no_clock}");
        assert!(matches!(observed.commands("c", &[command(0, 1.0)], 2), Err(RecordedError::NoCoil { coils: 2, .. })));
        let lacking = observed.commands("c", &[command(5000, 1.0), command(5002, f64::NAN)], 1).unwrap_err();
        assert!(lacking.to_string().contains("coil 1 at 5.002 s"), "{lacking}");
        let held = observed.commands("c", &[command(9000, 1.0), command(9500, 1.0)], 1).unwrap();
        let apart = observed.series(&held, None, 0.0).unwrap_err().to_string();
        assert!(apart.contains("from 5.000 s to 5.010 s and commands from 9.000 s to 9.500 s"), "{apart}");
        // Commands from zero, frames since 1970.
        let observed = Observed::of(&recording(&[1_000_000, 1_000_010], |_| Some(0.0))).unwrap();
        let held = observed.commands("c", &[command(0, 1.0), command(500, 2.0)], 1).unwrap();
        assert!(matches!(observed.series(&held, None, 0.0), Err(RecordedError::ClocksApart { .. })));
        assert!(observed.series(&held, None, 990.0).is_ok());
    }
}
