//! Fits frame times to an even grid, and cuts a record where samples are missing.
//!
//! In: times as the camera gave them, outputs, some missing. Out: segments of known input. Times are never moved: a
//! sample that comes up to a third of a period early or late counts as the grid's, since the input was integrated up to
//! its real time ([`hold`](super::hold)). Uneven times are refused, or resampled on request.

use crate::identify::data::plant::Plant;
use crate::identify::data::segments::{PARTS, Record, Segment};
use crate::median::upper_median;
use crate::plural::plural;

/// Largest deviation of an interval from whole periods, or else of a sample from its place, in periods.
const TOLERANCE: f64 = 0.25;
const OFF_PLACE: f64 = 0.35;
/// Samples on either side of an uneven interval, and how much later, in periods, those behind it are if times do not go
/// on by the same grid.
const BESIDE: usize = 5;
const SHIFTED: f64 = 0.15;
/// Distance of a sample from the line between the ends, in periods, beyond which the rate may have changed.
const OFF_GRID: f64 = 0.5;
/// Relative difference of the mean intervals before and after that is a change of the rate, and by how many σ of them
/// it must be one: intervals of a program that waits scatter, and their sum wanders off any grid.
const OTHER_RATE: f64 = 0.02;
const OTHER_RATE_SD: f64 = 5.0;
/// Periods by which a new one may be longer than the usual interval, or a multiple of it, and count as that.
const HARDLY_LONGER: f64 = 0.1;
/// Longest interval that resampling bridges, in periods.
const LONGEST_BRIDGED: f64 = 2.5;
/// A step of times that is larger than this part of the usual interval is rough, if more than this part of the
/// intervals is no multiple of that.
const ROUGH: f64 = 0.2;
const MANY_UNEVEN: f64 = 0.1;
/// Part of the times that are multiples of such a step, at least.
const NEARLY_ALL: f64 = 0.95;

/// A raw record, with one entry per sample.
#[derive(Debug, Clone, Default)]
pub(crate) struct Series {
    /// Its name for the user.
    pub name: String,
    /// Seconds, rising.
    pub time_s: Vec<f64>,
    /// The drive from each time to the next: the input, or with `plant` the coil current, amperes.
    pub drive: Vec<Option<f64>>,
    /// By how much the drive is above that in each part of this time; empty where it is not known to change there.
    pub within: Vec<[f64; PARTS]>,
    /// Output at each time.
    pub output: Vec<Option<f64>>,
    /// Computes the input from current and output, by Eq. 6.
    pub plant: Option<Plant>,
    /// Whether the output's zero is to be fitted.
    pub fit_zero: bool,
    /// Whether something was commanded before the first sample: the system need not be at rest there.
    pub moved_before: bool,
}

/// Why times do not form a grid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum GridError {
    /// Too few samples for a grid.
    #[error("{name}: has {}; at least 2 are needed", plural(*samples, "sample"))]
    TooFew {
        /// The record.
        name: String,
        /// How many there are.
        samples: usize,
    },
    /// Times that do not increase.
    #[error("{name}: time goes from {before_s} s to {after_s} s at sample {sample}; it must rise")]
    NotRising {
        /// The record.
        name: String,
        /// Index of the later sample.
        sample: usize,
        /// Seconds.
        before_s: f64,
        /// Seconds.
        after_s: f64,
    },
    /// Resampling would make too many samples.
    #[error("{name}: one sample every {period_s} s makes {samples:.3e} of them: choose a longer --period")]
    TooFine {
        /// The record.
        name: String,
        /// The requested period.
        period_s: f64,
        /// The number of samples it would give.
        samples: f64,
    },
    /// A jump of time that no pause explains.
    #[error(
        "{name}: after sample {sample}, at {before_s} s, the next is {:.6e} s later, {:.3e} periods: a wrong time \
         stamp? Correct or remove it, or use the parts before and behind it as two records",
        after_s - before_s, (after_s - before_s) / period_s
    )]
    Jump {
        /// The record.
        name: String,
        /// Index of the sample before, from 1.
        sample: usize,
        /// Seconds.
        before_s: f64,
        /// Seconds.
        after_s: f64,
        /// The usual interval.
        period_s: f64,
    },
    /// Intervals are not multiples of one period.
    #[error(
        "{name}: samples are not evenly spaced: {interval_s:.6} s between {at_s:.3} s and the next, where a period is \
         {period_s:.6} s ({uneven} of {intervals} intervals are off by more than a quarter of it); resample with \
         --resample"
    )]
    Uneven {
        /// The record.
        name: String,
        /// The worst interval.
        interval_s: f64,
        /// Where it begins.
        at_s: f64,
        /// The usual interval.
        period_s: f64,
        /// Uneven intervals.
        uneven: usize,
        /// All intervals.
        intervals: usize,
    },
    /// The period is another one from some sample on.
    #[error(
        "{name}: samples come every {before_s:.6} s up to {at_s:.3} s, and every {after_s:.6} s after it: one period \
         does not fit both; resample with --resample, or use the parts as two records"
    )]
    RateChanges {
        /// The record.
        name: String,
        /// Where, seconds.
        at_s: f64,
        /// Mean interval before.
        before_s: f64,
        /// Mean interval after.
        after_s: f64,
        /// The usual interval.
        period_s: f64,
    },
}

/// Times on their grid.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Grid {
    /// Period, seconds, by least squares over the whole record.
    pub period_s: f64,
    /// Place of each sample on the grid, from 0.
    pub places: Vec<usize>,
    /// Root mean square of the samples' distance from their places, seconds.
    pub jitter_s: f64,
    /// Places without a sample.
    pub lost: usize,
}

impl Grid {
    /// Finds the grid of a record.
    ///
    /// # Errors
    /// [`GridError`].
    pub(crate) fn of(name: &str, time_s: &[f64]) -> Result<Self, GridError> {
        let usual = usual_interval(name, time_s)?;
        let mut places = vec![0];
        let (mut place, mut uneven, mut worst) = (0, Vec::new(), (0.0, 0));
        for (k, pair) in time_s.windows(2).enumerate() {
            let periods = (pair[1] - pair[0]) / usual;
            let whole = periods.round().max(1.0);
            let off = (periods - whole).abs();
            uneven.extend((off > TOLERANCE).then_some(k));
            if off > worst.0 {
                worst = (off, k);
            }
            place += whole as usize;
            places.push(place);
        }
        // Least squares of time over place, about the means.
        let n = time_s.len() as f64;
        let mean_t = time_s.iter().sum::<f64>() / n;
        let mean_k = places.iter().map(|k| *k as f64).sum::<f64>() / n;
        let pairs = || time_s.iter().zip(&places).map(|(t, k)| (t - mean_t, *k as f64 - mean_k));
        let period_s = pairs().map(|(t, k)| t * k).sum::<f64>() / pairs().map(|(_, k)| k * k).sum::<f64>();
        // Two neighbours that are early and late make an uneven interval, but those around them are on the grid.
        let off_s = || pairs().map(|(t, k)| (t - period_s * k).abs());
        let shifts = |k: &usize| shift_s(time_s, &places, *k, usual).abs() > SHIFTED * usual;
        if uneven.iter().any(shifts) || !uneven.is_empty() && off_s().any(|off_s| off_s > OFF_PLACE * period_s) {
            let (_, k) = worst;
            return Err(GridError::Uneven {
                name: name.to_owned(),
                interval_s: time_s[k + 1] - time_s[k],
                at_s: time_s[k],
                period_s: usual,
                uneven: uneven.len(),
                intervals: places.len() - 1,
            });
        }
        let jitter_s = (off_s().map(|off_s| off_s * off_s).sum::<f64>() / n).sqrt();
        // Where the rate changes, times are farthest from the line between first and last; ends may be as far from the
        // other one.
        let (first_s, last_s) = (time_s[0], time_s[time_s.len() - 1]);
        let mean_s = (last_s - first_s) / place as f64;
        let from_line = time_s.iter().zip(&places).map(|(t, k)| (t - first_s - mean_s * *k as f64).abs());
        let farthest = from_line.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((k, _)) = farthest.filter(|(_, off_s)| *off_s > OFF_GRID * period_s)
            && let Some((before_s, after_s)) = other_rate(time_s, &places, k)
        {
            let at_s = time_s[k];
            return Err(GridError::RateChanges { name: name.to_owned(), at_s, before_s, after_s, period_s: usual });
        }
        Ok(Self { period_s, lost: place + 1 - places.len(), places, jitter_s })
    }
}

/// By how much the samples behind interval `k` are later on the grid than those before it, seconds.
fn shift_s(time_s: &[f64], places: &[usize], k: usize, period_s: f64) -> f64 {
    let mean_s = |samples: std::ops::Range<usize>| {
        let off_s = time_s.iter().zip(places).map(|(t, place)| t - period_s * *place as f64);
        off_s.skip(samples.start).take(samples.len()).sum::<f64>() / samples.len() as f64
    };
    mean_s(k + 1..time_s.len().min(k + 1 + BESIDE)) - mean_s((k + 1).saturating_sub(BESIDE)..k + 1)
}

/// The periods before and after sample `k`, if they differ clearly.
fn other_rate(time_s: &[f64], places: &[usize], k: usize) -> Option<(f64, f64)> {
    // Mean interval, and its variance.
    let mean = |times: &[f64], places: &[usize]| {
        let steps = || times.windows(2).zip(places.windows(2)).map(|(t, k)| (t[1] - t[0], (k[1] - k[0]) as f64));
        let (sum_s, count) = steps().fold((0.0, 0.0), |(sum, count), (step, periods)| (sum + step, count + periods));
        let mean_s: f64 = sum_s / count;
        let squares: f64 = steps().map(|(step, periods)| (step - mean_s * periods).powi(2)).sum();
        (count > 1.0).then_some((mean_s, squares / (count * (count - 1.0))))
    };
    // Sample k belongs to both.
    let (before_s, var) = mean(time_s.get(..=k)?, places.get(..=k)?)?;
    let (after_s, var_after) = mean(time_s.get(k..)?, places.get(k..)?)?;
    let by = (after_s - before_s).abs();
    let differ = by > OTHER_RATE * before_s.min(after_s) && by > OTHER_RATE_SD * (var + var_after).sqrt();
    differ.then_some((before_s, after_s))
}

/// The usual interval: the mean of those near the median, since whole milliseconds have a median of 17 ms at 60 Hz, by
/// which an interval of 13 periods would already be a quarter of one off. The times must rise.
pub(super) fn usual_interval(name: &str, time_s: &[f64]) -> Result<f64, GridError> {
    if time_s.len() < 2 {
        return Err(GridError::TooFew { name: name.to_owned(), samples: time_s.len() });
    }
    if let Some(k) = time_s.windows(2).position(|pair| pair[1] <= pair[0] || !(pair[1] - pair[0]).is_finite()) {
        let (before_s, after_s) = (time_s[k], time_s[k + 1]);
        return Err(GridError::NotRising { name: name.to_owned(), sample: k + 1, before_s, after_s });
    }
    let intervals = time_s.windows(2).map(|pair| pair[1] - pair[0]);
    let median_s = upper_median(intervals.clone()).unwrap_or(f64::NAN);
    let near = intervals.filter(|interval_s| (interval_s / median_s - 1.0).abs() <= TOLERANCE);
    let (sum_s, count) = near.fold((0.0, 0.0), |(sum, count), interval_s| (sum + interval_s, count + 1.0));
    let period_s = sum_s / count;
    // Each place of the grid takes memory, with or without a sample.
    let places = (time_s[time_s.len() - 1] - time_s[0]) / period_s;
    if places > most_places(time_s.len()) {
        let longest = |k: &usize| time_s[k + 1] - time_s[*k];
        let k = (0..time_s.len() - 1).max_by(|a, b| longest(a).total_cmp(&longest(b))).unwrap_or(0);
        let (before_s, after_s) = (time_s[k], time_s[k + 1]);
        return Err(GridError::Jump { name: name.to_owned(), sample: k + 1, before_s, after_s, period_s });
    }
    Ok(period_s)
}

/// The record in segments of known input. With Eq. 6 the input needs the angle: where it is missing, up to `bridge`
/// samples in a row, it is interpolated by a cubic through its neighbours, only for the torque, and counted:
/// `(record, bridged)`. An unobserved output remains missing.
pub(crate) fn cut(series: &Series, grid: &Grid, bridge: usize) -> (Record, usize) {
    let length = grid.places.last().map_or(0, |last| last + 1);
    let (mut output, mut drive) = (vec![None; length], vec![None; length]);
    let mut within = vec![[0.0; PARTS]; if series.within.is_empty() { 0 } else { length }];
    for (k, place) in grid.places.iter().enumerate() {
        output[*place] = series.output[k];
        drive[*place] = series.drive[k];
        if let (Some(to), Some(from)) = (within.get_mut(*place), series.within.get(k)) {
            *to = *from;
        }
    }
    let first_s = series.time_s.first().copied().unwrap_or(0.0);
    let mut angle = output.clone();
    let bridged = if series.plant.is_some() { fill(&mut angle, bridge) } else { 0 };
    let halfway_at = |place: usize| Some(halfway(place.checked_sub(1).and_then(|before| angle[before]), angle[place]?));
    let input_at = |place: usize| match series.plant {
        None => drive[place],
        Some(plant) => Some(plant.torque_nm(drive[place]?, halfway_at(place)?)),
    };
    // What the input is beyond its mean: linear in the drive.
    let within_at = |place: usize, beyond: &[f64; PARTS]| match series.plant {
        None => Some(*beyond),
        Some(plant) => {
            let by_current = plant.torque_by_current(halfway_at(place)?);
            Some(beyond.map(|beyond| by_current * beyond))
        }
    };
    let by_zero_at = |place: usize| match series.plant {
        None => Some(0.0),
        Some(plant) => Some(plant.torque_by_zero(drive[place]?, halfway_at(place)?)),
    };
    let input: Vec<Option<f64>> = (0..length).map(input_at).collect();
    let mut segments: Vec<Segment> = Vec::new();
    let mut begin = 0;
    while let Some(from) = input[begin..].iter().position(Option::is_some).map(|k| begin + k) {
        let to = input[from..].iter().position(Option::is_none).map_or(length, |k| from + k);
        segments.push(Segment {
            first: from,
            start_s: first_s + from as f64 * grid.period_s,
            input: input[from..to].iter().flatten().copied().collect(),
            within: within.get(from..to).map(|within| {
                let of = |(k, beyond): (usize, &[f64; PARTS])| within_at(from + k, beyond).unwrap_or([0.0; PARTS]);
                within.iter().enumerate().map(of).collect()
            }),
            output: output[from..to].iter().map(|y| y.unwrap_or(f64::NAN)).collect(),
            instrument: series.plant.map(|_| drive[from..to].iter().flatten().copied().collect()),
            by_zero: series.fit_zero.then(|| (from..to).filter_map(by_zero_at).collect()),
            zero_drifts: false,
            by_delay: None,
            record: 0,
            // Before the first drive it was zero; before a missed angle it may have been anything.
            from_rest: !series.moved_before && segments.is_empty() && drive[..from].iter().all(Option::is_none),
        });
        begin = to;
    }
    (Record { name: series.name.clone(), segments }, bridged)
}

/// The angle in the middle of the hold that begins here, extrapolated from the last two: it uses no later sample, and
/// is not half a period behind the current's average like the angle at the beginning.
fn halfway(before: Option<f64>, now: f64) -> f64 {
    before.map_or(now, |before| now + 0.5 * (now - before))
}

/// Fills holes of up to `most` outputs with Lagrange's cubic through two samples on each side, or a line where there is
/// only one. Returns how many it filled.
pub(super) fn fill(output: &mut [Option<f64>], most: usize) -> usize {
    let given = output.to_vec();
    let at = |k: i64| usize::try_from(k).ok().and_then(|k| given.get(k).copied().flatten()).map(|y| (k as f64, y));
    let mut filled = 0;
    let mut k = 0;
    while k < given.len() {
        let to = given[k..].iter().position(Option::is_some).map_or(given.len(), |n| k + n);
        let hole = k..to;
        k = to + 1;
        if hole.is_empty() || hole.len() > most || hole.start == 0 || to == given.len() {
            continue;
        }
        let (before, after) = (hole.start as i64, to as i64);
        let mut through: Vec<(f64, f64)> =
            [before - 2, before - 1, after, after + 1].into_iter().filter_map(at).collect();
        if through.len() < 4 {
            through = [before - 1, after].into_iter().filter_map(at).collect();
        }
        for place in hole {
            output[place] = Some(lagrange(&through, place as f64));
            filled += 1;
        }
    }
    filled
}

fn lagrange(points: &[(f64, f64)], x: f64) -> f64 {
    let term = |(i, (xi, yi)): (usize, &(f64, f64))| {
        let others = points.iter().enumerate().filter(|(j, _)| *j != i);
        yi * others.map(|(_, (xj, _))| (x - xj) / (xi - xj)).product::<f64>()
    };
    points.iter().enumerate().map(term).sum()
}

/// Most places of a grid for so many samples: a camera that pauses for a day at 20 Hz has fewer.
fn most_places(samples: usize) -> f64 {
    (2_000_000 + 10 * samples) as f64
}

/// How many samples, no further apart than the record's usually are, fit into a longer period; 1 for one that is hardly
/// longer.
///
/// # Errors
/// As `usual_interval`.
pub(crate) fn coarser(series: &Series, period_s: f64) -> Result<usize, GridError> {
    let usual = usual_interval(&series.name, &series.time_s)?;
    let most = series.time_s.len() as f64;
    Ok((period_s / usual - HARDLY_LONGER).ceil().clamp(1.0, most) as usize)
}

/// A record resampled at even times, by default at its usual interval: outputs by linear interpolation between samples
/// at most 2.5 periods apart, inputs by averaging the held values over the new intervals.
///
/// # Errors
/// All but [`GridError::Uneven`] and [`GridError::RateChanges`].
pub(crate) fn resample(series: &Series, period_s: Option<f64>) -> Result<Series, GridError> {
    let usual = usual_interval(&series.name, &series.time_s)?;
    let period = period_s.unwrap_or(usual);
    let (first, last) = (series.time_s[0], series.time_s[series.time_s.len() - 1]);
    let samples = (last - first) / period;
    if samples > most_places(series.time_s.len()) {
        return Err(GridError::TooFine { name: series.name.clone(), period_s: period, samples });
    }
    let count = ((last - first) / period + 1e-9).floor() as usize + 1;
    let time_s: Vec<f64> = (0..count).map(|k| first + k as f64 * period).collect();
    let after = |t: f64| series.time_s.partition_point(|s| *s <= t + 1e-9 * period);
    let output = |t: &f64| {
        let next = after(*t);
        let (k, known) = (next - 1, |k: usize| series.output.get(k).copied().flatten());
        let t0 = series.time_s[k];
        if (t - t0).abs() <= 1e-9 * period {
            return known(k);
        }
        let t1 = *series.time_s.get(next)?;
        let near = t1 - t0 <= LONGEST_BRIDGED * usual;
        known(k).zip(known(next)).filter(|_| near).map(|(y0, y1)| y0 + (y1 - y0) * (t - t0) / (t1 - t0))
    };
    let held = |values: &dyn Fn(usize) -> Option<f64>, from: f64, to: f64| -> Option<f64> {
        let (mut sum, mut t, mut k) = (0.0, from, after(from) - 1);
        while t < to {
            let until = series.time_s.get(k + 1).copied().unwrap_or(f64::INFINITY).min(to);
            sum += values(k)? * (until - t);
            (t, k) = (until, k + 1);
        }
        Some(sum / (to - from))
    };
    let drive = |t: &f64| held(&|k| series.drive.get(k).copied().flatten(), *t, *t + period);
    Ok(Series {
        name: series.name.clone(),
        output: time_s.iter().map(output).collect(),
        drive: time_s.iter().map(drive).collect(),
        within: Vec::new(),
        plant: series.plant,
        fit_zero: series.fit_zero,
        moved_before: series.moved_before,
        time_s,
    })
}

/// The step that uneven times seem to be rounded to, seconds, if it is a large part of their usual interval. Where rows
/// are missing from even times, intervals are multiples of the usual one.
pub(crate) fn rounded_to(series: &Series) -> Option<f64> {
    let (time_s, usual_s) = (&series.time_s, usual_interval(&series.name, &series.time_s).ok()?);
    let first = *time_s.first()?;
    let steps = [1.0, 0.1, 0.01, 0.001, 1e-4];
    let is_whole = |value: f64| (value - value.round()).abs() < 1e-4;
    // Rows that were put where frames were lost lie between.
    let whole = |step: f64| time_s.iter().filter(|t| is_whole((*t - first) / step)).count();
    let step_s = steps.into_iter().find(|step| whole(*step) as f64 > NEARLY_ALL * time_s.len() as f64)?;
    let pairs = time_s.iter().zip(time_s.iter().skip(1));
    let uneven = pairs.filter(|(a, b)| !is_whole((*b - *a) / usual_s)).count();
    let told = step_s > ROUGH * usual_s && uneven as f64 > MANY_UNEVEN * time_s.len() as f64;
    told.then_some(step_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::tests::noise;

    fn series(time_s: &[f64], of: impl Fn(f64) -> f64) -> Series {
        Series {
            name: "a.csv".into(),
            time_s: time_s.to_vec(),
            drive: time_s.iter().map(|t| Some(10.0 * t)).collect(),
            output: time_s.iter().map(|t| Some(of(*t))).collect(),
            ..Series::default()
        }
    }

    #[test]
    fn whole_milliseconds_of_60_hz_are_a_grid_with_their_lost_frames() {
        let time_s: Vec<f64> =
            (0..600).filter(|k| k % 100 != 50).map(|k| (f64::from(k) * 1000.0 / 60.0).round() / 1000.0).collect();
        let grid = Grid::of("a", &time_s).unwrap();
        assert!((grid.period_s - 1.0 / 60.0).abs() < 1e-7, "{}", grid.period_s);
        assert_eq!((grid.lost, grid.places.last()), (6, Some(&599)));
        assert!((grid.jitter_s - 1e-3 / 12.0_f64.sqrt()).abs() < 5e-5, "{}", grid.jitter_s);
    }

    /// As Matroska has them, with a hole of every length up to a minute.
    #[test]
    fn whole_milliseconds_with_a_long_hole_are_a_grid() {
        for lost in (1..60).chain([100, 1000, 3600]) {
            let there = (0..900).filter(|k| *k < 400 || *k >= 400 + lost).chain(900 + lost..1800 + lost);
            let time_s: Vec<f64> = there.map(|k: u32| (f64::from(k) * 1000.0 / 60.0).round() / 1000.0).collect();
            let grid = Grid::of("a", &time_s).unwrap();
            let all = time_s.last().map(|last| (last * 60.0).round() as usize);
            assert_eq!(grid.places.last().copied(), all, "{lost}");
            assert!((grid.period_s - 1.0 / 60.0).abs() < 1e-6, "{lost}: {}", grid.period_s);
        }
    }

    /// A USB camera's stamps, 1 ms early or late.
    #[test]
    fn neighbours_that_are_early_and_late_are_still_a_grid() {
        let places: Vec<usize> = (0..2000).filter(|k| k % 500 != 77).collect();
        let jitter_s: Vec<f64> = noise(3, 2000).iter().map(|e| 1e-3 * e).collect();
        let stamps = |after_s: f64| -> Vec<f64> {
            let late_s = |k: usize| if k < 1000 { 0.0 } else { after_s };
            places.iter().map(|k| *k as f64 / 60.0 + jitter_s[*k] + late_s(*k)).collect()
        };
        let grid = Grid::of("r", &stamps(0.0)).unwrap();
        assert!((grid.period_s * 60.0 - 1.0).abs() < 1e-5 && grid.lost == 4 && grid.places == places, "{grid:?}");
        assert!((grid.jitter_s - 1e-3).abs() < 1e-4, "{}", grid.jitter_s);
        // A pause of a part of a period moves all that come after.
        assert!(matches!(Grid::of("r", &stamps(0.4 / 60.0)), Err(GridError::Uneven { .. })));
        let uneven = stamps(0.0).windows(2).filter(|t| ((t[1] - t[0]) * 60.0 - 1.0).abs() > TOLERANCE).count();
        assert!(uneven > 4, "{uneven}");
    }

    #[test]
    fn uneven_times_and_times_that_run_back_are_refused() {
        let uneven = Grid::of("a.csv", &[0.0, 1.0, 2.0, 3.4, 4.4, 5.4]).unwrap_err();
        assert_eq!(
            uneven.to_string(),
            "a.csv: samples are not evenly spaced: 1.400000 s between 2.000 s and the next, where a period is 1.000000 \
             s (1 of 5 intervals are off by more than a quarter of it); resample with --resample"
        );
        let back = Grid::of("a.csv", &[0.0, 1.0, 1.0]).unwrap_err();
        assert_eq!(back.to_string(), "a.csv: time goes from 1 s to 1 s at sample 2; it must rise");
        assert!(matches!(Grid::of("a", &[1.0]), Err(GridError::TooFew { .. })));
        assert!(matches!(Grid::of("a", &[0.0, f64::NAN]), Err(GridError::NotRising { .. })));
    }

    #[test]
    fn a_rate_that_changes_midway_is_told_and_times_that_wander_are_not() {
        let mut random = crate::testing::random::Random::new(5);
        let mut times = |interval_s: &dyn Fn(usize) -> f64, scatter: f64| {
            let mut t = 0.0;
            let next = |k: usize| {
                t += interval_s(k) * (1.0 + scatter * random.normal());
                t
            };
            (0..1500).map(next).collect::<Vec<f64>>()
        };
        // 60 to 50 frames per second, and back; 25 to 24.
        for (rates, at) in [([60.0, 50.0, 50.0], 900), ([60.0, 50.0, 60.0], 900), ([25.0, 24.0, 24.0], 900)] {
            let rate = |k: usize| if k < 900 { rates[0] } else { rates[1 + usize::from(k >= 1200)] };
            let time_s = times(&|k| 1.0 / rate(k), 0.02);
            let found = Grid::of("a.csv", &time_s).unwrap_err();
            let GridError::RateChanges { at_s, before_s, .. } = &found else { panic!("{found}") };
            let near = [at, 1200].into_iter().any(|k: usize| (time_s[k] - at_s).abs() < 3.0 / rates[0]);
            assert!(near && found.to_string().contains("use the parts as two records"), "{found}");
            assert!(*at_s > time_s[1000] || (before_s * rates[0] - 1.0).abs() < 0.01, "{found}");
        }
        for _ in 0..50 {
            let wandering = times(&|_| 0.02, 0.06);
            let grid = Grid::of("a.csv", &wandering);
            assert!(matches!(&grid, Ok(_) | Err(GridError::Uneven { .. })), "{grid:?}");
        }
    }

    #[test]
    fn one_wrong_time_stamp_is_named_and_takes_no_memory() {
        let mut time_s: Vec<f64> = (0..100).map(|k| f64::from(k) / 60.0).collect();
        time_s[99] = 9.2e9;
        let jump = Grid::of("a.csv", &time_s).unwrap_err().to_string();
        assert!(jump.starts_with("a.csv: after sample 99, at 1.6333"), "{jump}");
        assert!(jump.contains("a wrong time stamp?"), "{jump}");
        let fine = resample(&series(&[0.0, 1.0, 2.0], |t| t), Some(1e-9)).unwrap_err().to_string();
        assert!(fine.contains("2.000e9 of them: choose a longer --period"), "{fine}");
    }

    #[test]
    fn outputs_may_be_missing_and_inputs_may_not() {
        let times = [0.0, 1.0, 2.0, 3.0, 5.0, 6.0, 7.0, 10.0, 11.0];
        let mut series = series(&times, |t| t);
        series.output[1] = None;
        let grid = Grid::of("a", &times).unwrap();
        // The input of a lost sample is unknown, which makes a hole.
        let (record, bridged) = cut(&series, &grid, 9);
        assert_eq!(record.segments.iter().map(Segment::len).collect::<Vec<_>>(), [4, 3, 2]);
        assert_eq!((bridged, record.segments[1].start_s, record.observed()), (0, 5.0, 8));
        assert!(record.segments[0].output[1].is_nan());
        assert_eq!(record.segments.iter().map(|s| s.from_rest).collect::<Vec<_>>(), [true, false, false]);
    }

    #[test]
    fn the_torque_of_a_missed_angle_is_bridged_and_a_long_hole_cuts() {
        let times: Vec<f64> = (0..20).map(f64::from).collect();
        let cubic = |t: f64| 1e-3 * (t * t * t - 2.0 * t);
        let mut series = series(&times, cubic);
        // Only the weight, so that the torque is −sin θ.
        series.plant = Some(Plant { torque_per_ampere_nm: 0.0, weight_torque_nm: 1.0 });
        series.output[4] = None;
        for hole in 10..14 {
            series.output[hole] = None;
        }
        let grid = Grid::of("a", &times).unwrap();
        let (record, bridged) = cut(&series, &grid, 3);
        assert_eq!((bridged, record.segments.len(), record.observed()), (1, 2, 15));
        let first = &record.segments[0];
        assert!(
            (first.input[4] + (1.5 * cubic(4.0) - 0.5 * cubic(3.0)).sin()).abs() < 1e-12 && first.output[4].is_nan()
        );
        assert_eq!(first.instrument.as_ref().map(Vec::len), Some(first.len()));
        assert!(!record.segments[1].from_rest);
        assert_eq!(cut(&series, &grid, 4).0.segments.len(), 1);
    }

    #[test]
    fn resampled_outputs_lie_between_and_inputs_keep_their_integral() {
        let source = series(&[0.0, 1.0, 2.0, 2.5, 4.0], |t| 3.0 * t);
        let even = resample(&source, None).unwrap();
        assert_eq!(even.time_s, [0.0, 1.0, 2.0, 3.0, 4.0]);
        assert_eq!(even.output.iter().flatten().copied().collect::<Vec<_>>(), [0.0, 3.0, 6.0, 9.0, 12.0]);
        // From 2 to 3: 20 for half a second, then 25.
        assert_eq!(even.drive[2], Some(22.5));
        assert_eq!(even.drive[4], Some(40.0));
    }

    #[test]
    fn rounded_times_are_told_from_exact_ones_with_holes() {
        let times = |at: &dyn Fn(f64) -> f64| (0..300).map(|k| at(f64::from(k))).collect::<Vec<_>>();
        let of = |times: &[f64]| rounded_to(&series(times, |t| t));
        let to = |step: f64, t: f64| (t / step).round() * step;
        assert_eq!(of(&times(&|k| to(0.01, k / 60.0))), Some(0.01));
        assert_eq!(of(&times(&|k| to(0.01, k / 30.0))), Some(0.01));
        let between = [times(&|k| to(0.01, k / 60.0)), vec![6.0 + 1.0 / 3.0]].concat();
        assert_eq!(of(&between), Some(0.01));
        assert_eq!(of(&times(&|k| to(0.001, k / 60.0))), None);
        assert_eq!(of(&times(&|k| k / 60.0)), None);
        let with_holes: Vec<f64> = times(&|k| k / 100.0).into_iter().filter(|t| (t * 7919.0) % 1.0 > 0.15).collect();
        assert!(with_holes.len() < 280 && of(&with_holes).is_none());
    }
}
