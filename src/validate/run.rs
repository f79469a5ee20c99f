//! One observed run against the desired path.

use super::align::{Alignment, rms};
use super::circle::Circle;
use super::error::ValidateError;
use super::lag::{Lag, lag};
use super::lone::lone;
use super::mean_motion::filled;
use super::options::Options;
use super::path::DesiredPath;
use super::pauses::{Mean, Sample};
use super::periods::Periods;
use super::plane::Plane;
use super::settling::Settling;
use super::start_time::StartFrom;
use super::step::Step;
use super::timing::{Marked, Observed, Timing, WEAK_CORRELATION, all_periods_are_there, marked, timing};
use super::unrepeated;
use crate::series::{Frame, Recording};
use crate::source::times::seconds;
use crate::vetoes::VETOED;
use nalgebra::{Point3, Vector3};
use std::path::PathBuf;

/// An axis along which the desired path moves by less than this fraction of the largest has no gain.
const STILL_AXIS: f64 = 0.02;
/// Sizes of motion and path that differ by more than this factor are hardly in the same unit.
const OTHER_UNIT: f64 = 20.0;
/// More commands than this fraction without a point are noted.
const MANY_LEFT_OUT: f64 = 0.25;
/// Points that lie further than this fraction of the radius from their circle (RMS) are noted.
const FAR_FROM_CIRCLE: f64 = 0.05;
/// Distances up to this many σ of a coordinate are noise.
const NOISE: f64 = 3.0;
/// More frames than this fraction with the place of the one before are noted.
const MANY_REPEATED: f64 = 0.2;
/// Frames per period below which amplitudes suffer.
const FEW_FRAMES: f64 = 8.0;

/// The sizes whose ratio is the magnitude.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Size {
    /// Radii of the fitted circles, Eq. 8 of the paper.
    CircleRadius,
    /// Root mean square distances of the points from their mean, for paths that are not circles.
    RmsSize,
}

impl Size {
    /// The word in tables.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::CircleRadius => "circle_radius",
            Self::RmsSize => "rms_size",
        }
    }
}

/// Magnitude of the response.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Magnitude {
    /// 20 log10(observed / desired).
    pub db: f64,
    /// What is compared.
    pub of: Size,
    /// Size of the observed points, metres.
    pub observed_m: f64,
    /// Size of the desired points, metres.
    pub desired_m: f64,
}

/// One run evaluated.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Run {
    /// Its file.
    pub file: PathBuf,
    /// The marker that followed the path.
    pub marker: String,
    /// How long each command is held, seconds.
    pub pause_s: f64,
    /// 1 over the period, Hz.
    pub frequency_hz: f64,
    /// Camera time of the first command, nanoseconds.
    pub start_ns: i64,
    /// How that is known.
    pub start_from: StartFrom,
    /// Correlation with the path at a start that was searched for.
    pub start_correlation: Option<f64>,
    /// Whether points are interpolated, because the pause is shorter than the frame interval, instead of averaged.
    pub interpolated: bool,
    /// Usual time between camera frames, seconds.
    pub interval_s: f64,
    /// Camera frames while the commands were given.
    pub frames: usize,
    /// Of these, frames without the marker's position.
    pub frames_missed: usize,
    /// Of these, frames that a person has vetoed.
    pub frames_vetoed: usize,
    /// Camera frames lost among them.
    pub frames_lost: u64,
    /// Commands that count, in order.
    pub steps: Vec<Step>,
    /// Of these, commands without a point.
    pub left_out: usize,
    /// Rotation and translation from observed to desired, and the remaining error.
    pub alignment: Alignment,
    /// Root mean square error without alignment, metres.
    pub rms_unaligned_m: f64,
    /// Ratio of the standard deviations of observed and desired coordinate; `None` for an axis along which the path
    /// does not move.
    pub gain: [Option<f64>; 3],
    /// Size of the response.
    pub magnitude: Option<Magnitude>,
    /// The plane of the observed points.
    pub plane: Option<Plane>,
    /// The circle in it, if the path is a circle.
    pub circle: Option<Circle>,
    /// Its lag, unless the start was searched for.
    pub lag: Option<Lag>,
    /// Phase, degrees: negative for a late response. Unwrapped over rising frequency by [`super::validate`].
    pub phase_deg: Option<f64>,
    /// How far the motion still is from a periodic one; `None` with fewer than two periods.
    pub settling: Option<Settling>,
    /// Whether all periods are alike; `None` with too few frames.
    pub periods: Option<Periods>,
    /// Root mean square angle between observed and desired direction of the coil, radians, where the path has
    /// directions.
    pub tangent_rms_rad: Option<f64>,
    /// Root mean square distance of frames from the mean of their pause, metres: noise, and motion within the pause.
    pub scatter_m: Option<f64>,
    /// The tracker's σ of a coordinate, root mean square, metres.
    pub sd_m: Option<f64>,
    /// What noise makes of the magnitude, in parts of it, and of the phase, radians: the larger of what `sd_m` gives
    /// and of what does not repeat. `None` with fewer than two periods.
    pub response_sd: Option<f64>,
    /// Notes about this run for the reader.
    pub notes: Vec<String>,
}

impl Run {
    /// σ of the phase, radians, where it means something.
    pub(super) fn phase_sd(&self) -> Option<f64> {
        self.lag.filter(|lag| lag.correlation >= WEAK_CORRELATION)?;
        self.phase_deg.and(self.response_sd)
    }

    /// σ of the magnitude, in parts of it: what noise makes of it, and by how much noise makes the motion too large.
    pub(super) fn magnitude_sd(&self) -> Option<f64> {
        let magnitude = self.magnitude?;
        let coordinates = match magnitude.of {
            Size::CircleRadius => 1.0,
            Size::RmsSize => 3.0,
        };
        let frames_of_point = (self.pause_s / self.interval_s).max(1.0);
        let too_large = coordinates * (self.sd_m? / magnitude.observed_m).powi(2) / (2.0 * frames_of_point);
        Some(self.response_sd?.hypot(too_large))
    }
}

/// Evaluates one run.
pub(super) fn evaluate(path: &DesiredPath, observed: &Observed<'_>, options: &Options) -> Result<Run, ValidateError> {
    let recording = observed.recording;
    let unusable = |problem: String| ValidateError::Unusable { path: recording.path.clone(), problem };
    let mut notes = Vec::new();
    if let Some(why) = &recording.cut {
        notes.push(format!("not all of the file can be read: {why}"));
    }

    // 1. the frames, and when the commands were given
    let Marked { marker, name, samples } = marked(recording, options)?;
    let Timing { window, start_from, start_correlation, note, inside, interval_s } =
        timing(path, observed, &samples, options)?;
    notes.extend(note);
    if start_from == StartFrom::Search {
        notes.push(
            "the start was found by correlation, which absorbs the lag: there is no phase, and errors are without it \
             too"
            .to_owned()
                + if window.commands < path.commands() {
                    "; the last half of a period, where so late a start leads beyond the commands, is left out"
                } else {
                    "; the end of the only period that counts may lie beyond the commands"
                },
        );
    }
    let pause_ns = window.pause_ns;

    // 2. one point per command
    let interpolated = seconds(pause_ns) < interval_s;
    let mean = |samples: &[Sample]| {
        if interpolated {
            window.interpolated(samples, interval_s, options.interpolation)
        } else {
            window.averaged(samples, options.average.left_out())
        }
    };
    let skipped = options.skip * path.points.len();
    let means = mean(&samples);
    let counted = means.get(skipped..).unwrap_or_default();
    let numbered = means.iter().enumerate().skip(skipped);
    let mut steps: Vec<Step> = numbered.map(|(k, mean)| step(path, pause_ns, k, mean.as_ref())).collect();
    let pairs = pairs(path, &steps).map_err(unusable)?;
    let left_out = steps.len() - pairs.len();
    all_periods_are_there(path, recording, &window)?;
    notes.extend(many_left_out(left_out, steps.len()));

    // 3. errors
    let alignment = Alignment::of(&pairs).ok_or_else(|| {
        unusable(format!("the observed points of {name} lie on a line or do not move: nothing can be aligned"))
    })?;
    for step in &mut steps {
        step.aligned = step.observed.map(|point| alignment.apply(&point));
    }
    let rms_unaligned_m = rms(pairs.iter().map(|(a, b)| (a - b).norm()));

    // 4. magnitude and phase
    let (points, wanted): (Vec<Point3<f64>>, Vec<Point3<f64>>) = pairs.iter().copied().unzip();
    let plane = Plane::through(&points).map(|plane| plane.along(&path.plane));
    let circle = path
        .circle
        .and(plane)
        .and_then(|plane| Circle::through(&points.iter().map(|point| plane.flat(point)).collect::<Vec<_>>()));
    let places: Vec<Option<Point3<f64>>> = steps.iter().map(|step| step.observed).collect();
    let whole = filled(&path.points, &places);
    notes.extend(whole.is_none().then(|| lacking(path, &places)));
    // All points, where missing ones can be filled in.
    let numbered: Vec<(usize, Point3<f64>)> = match &whole {
        Some(whole) => steps.iter().map(|step| step.k).zip(whole.iter().copied()).collect(),
        None => steps.iter().filter_map(|step| Some((step.k, step.observed?))).collect(),
    };
    let (moved, meant): (Vec<Point3<f64>>, Vec<Point3<f64>>) =
        numbered.iter().map(|(k, point)| (*point, path.point(*k))).unzip();
    let magnitude = magnitude(path, &moved, &meant, circle.as_ref());
    let lag = if start_from == StartFrom::Search { None } else { lag_of(path, &numbered, counted) };
    let phase_deg = lag.map(|lag| -360.0 * lag.points / path.points.len() as f64);

    // 5. basis of the numbers
    let period_s = seconds(pause_ns) * path.points.len() as f64;
    let sd_m = sd_m(&inside, marker);
    let settling = Settling::of(path, &steps, plane.as_ref(), sd_m);
    notes.extend(settling.as_ref().and_then(Settling::note));
    let frames_per_period = period_s / interval_s;
    let periods = Periods::of(path, counted, options.skip, sd_m, frames_per_period);
    notes.extend(periods.iter().flat_map(|periods| periods.notes(seconds(pause_ns))));
    notes.extend(weak_correlation(lag.as_ref()));
    notes.extend(other_unit(&points, &wanted));
    notes.extend(few_frames(frames_per_period));
    notes.extend(circle.as_ref().and_then(|circle| far_from_circle(circle, sd_m)));
    notes.extend(sd_m.and(lone_period(path, steps.len())));
    // Wrong frames at the same place of each period would look like the response.
    let of_runs: Vec<Sample> =
        samples.iter().filter(|(at, _)| (window.start_ns..window.end_ns()).contains(at)).copied().collect();
    let lone = lone(&of_runs);
    let has_place = |frame: &&&Frame| frame.places.get(marker).is_some_and(|place| place.point.is_some());
    let vetoed = |frame: &&&Frame| frame.places.get(marker).is_some_and(|place| place.status == VETOED);
    let seen = inside.iter().filter(has_place).filter(|frame| frame.stamp_ns >= window.at_ns(skipped)).count();
    let sd = whole.as_ref().and(response_sd(path, &steps, (sd_m, seen), magnitude.as_ref()));
    let too_far = |sd: f64| lone.zip(magnitude).is_some_and(|(lone, size)| lone.mean_m > sd * size.observed_m);
    let repeated = repeated(&of_runs);
    let sound_sd = sd.filter(|sd| !too_far(*sd) && repeated.is_none());
    notes.extend(repeated);
    notes.extend(lone.map(|lone| lone.note(sd.is_some() && sound_sd.is_none())));
    Ok(Run {
        file: recording.path.clone(),
        marker: name,
        pause_s: seconds(pause_ns),
        frequency_hz: 1.0 / period_s,
        start_ns: window.start_ns,
        start_from,
        start_correlation,
        interpolated,
        interval_s,
        frames: inside.len(),
        frames_missed: inside.len() - inside.iter().filter(has_place).count(),
        frames_vetoed: inside.iter().filter(vetoed).count(),
        frames_lost: inside.iter().skip(1).fold(0, |sum: u64, frame| sum.saturating_add(frame.gap)),
        left_out,
        alignment,
        rms_unaligned_m,
        gain: gain(&moved, &meant),
        magnitude,
        plane,
        circle,
        lag,
        phase_deg,
        settling,
        periods,
        tangent_rms_rad: tangent_rms_rad(path, recording, skipped, mean),
        scatter_m: scatter_m(counted.iter().flatten()),
        response_sd: sound_sd,
        sd_m,
        notes,
        steps,
    })
}

/// An observed point and the desired one.
type Pair = (Point3<f64>, Point3<f64>);

/// Those of all commands that have a point.
fn pairs(path: &DesiredPath, steps: &[Step]) -> Result<Vec<Pair>, String> {
    let pairs: Vec<Pair> = steps.iter().filter_map(|step| Some((step.observed?, step.desired))).collect();
    if 2 * pairs.len() < path.points.len() {
        return Err(format!(
            "{} of {} commands have a point, less than half of a period of {}; check --pause and --start",
            pairs.len(),
            steps.len(),
            path.points.len()
        ));
    }
    Ok(pairs)
}

/// What a hole in the motion means.
fn lacking(path: &DesiredPath, observed: &[Option<Point3<f64>>]) -> String {
    let length = path.points.len();
    let unseen = (0..length).filter(|k| observed.iter().skip(*k).step_by(length).all(Option::is_none)).count();
    format!(
        "{unseen} of the {length} commands of a period have no point in any of them: magnitude, gain and phase are \
         those of the part that was seen, and have no σ"
    )
}

/// How much later than the path the points are, with the numbers of their commands.
fn lag_of(path: &DesiredPath, numbered: &[(usize, Point3<f64>)], counted: &[Option<Mean>]) -> Option<Lag> {
    let lag = lag(&path.points, numbered)?;
    // Frames that lie late in their pauses show what comes later than their middle.
    let later: Vec<f64> = counted.iter().flatten().map(|mean| mean.later).collect();
    Some(Lag { points: lag.points + later.iter().sum::<f64>() / later.len().max(1) as f64, ..lag })
}

fn weak_correlation(lag: Option<&Lag>) -> Option<String> {
    let weak = lag.filter(|lag| lag.correlation < WEAK_CORRELATION)?;
    Some(format!("the motion hardly correlates with the path ({:.2}): its phase means little", weak.correlation))
}

fn many_left_out(left_out: usize, commands: usize) -> Option<String> {
    (left_out as f64 > MANY_LEFT_OUT * commands as f64).then(|| {
        format!(
            "{left_out} of {commands} commands have no point: the marker was not seen, or frames were lost, or the \
            record ends"
        )
    })
}

/// Sizes that are not those of one unit.
fn other_unit(observed: &[Point3<f64>], desired: &[Point3<f64>]) -> Option<String> {
    let (observed_m, desired_m) = (spread(observed).norm(), spread(desired).norm());
    let ratio = observed_m / desired_m;
    let close = (OTHER_UNIT.recip()..=OTHER_UNIT).contains(&ratio);
    (!close).then(|| {
        format!(
            "the motion has a size of {:.3} mm, the path one of {:.3} mm, which is hardly the same unit: both must be \
             in mm (or the marker does not move)",
            observed_m * 1e3,
            desired_m * 1e3
        )
    })
}

/// A circle whose radius is hardly the size of the motion, by more than noise of `sd_m` in each coordinate.
fn far_from_circle(circle: &Circle, sd_m: Option<f64>) -> Option<String> {
    let beyond_noise = sd_m.is_none_or(|sd_m| circle.rms_m > NOISE * sd_m);
    (beyond_noise && circle.rms_m > FAR_FROM_CIRCLE * circle.radius_m).then(|| {
        format!(
            "the points lie {:.3} mm (RMS) from their circle with a radius of {:.3} mm: the motion is not a circle, \
             and its magnitude is only that of the circle nearest to it",
            circle.rms_m * 1e3,
            circle.radius_m * 1e3
        )
    })
}

fn lone_period(path: &DesiredPath, commands: usize) -> Option<String> {
    (commands < 2 * path.points.len()).then(|| {
        "fewer than two periods count, so nothing shows what does not repeat: magnitude and phase have no σ (record \
         more periods, or leave fewer out with --skip)"
            .to_owned()
    })
}

/// That many frames have exactly the place of the one before.
fn repeated(samples: &[Sample]) -> Option<String> {
    let same = samples.iter().zip(samples.iter().skip(1)).filter(|(one, next)| one.1 == next.1).count();
    (same as f64 > MANY_REPEATED * samples.len() as f64).then(|| {
        format!(
            "{same} of {} frames have exactly the place of the one before: places are new more seldom than there are \
             frames, which makes the motion late, or are rounded; magnitude and phase have no σ",
            samples.len()
        )
    })
}

fn few_frames(per_period: f64) -> Option<String> {
    (per_period < FEW_FRAMES).then(|| format!("{per_period:.1} camera frames per period: too few for a good amplitude"))
}

fn step(path: &DesiredPath, pause_ns: i64, k: usize, mean: Option<&Mean>) -> Step {
    Step {
        k,
        t_s: seconds(pause_ns) * k as f64,
        desired: path.point(k),
        observed: mean.map(|mean| Point3::from(mean.value)),
        aligned: None,
        frames: mean.map_or(0, |mean| mean.frames),
    }
}

/// Standard deviations of each coordinate of a set of points.
fn spread(points: &[Point3<f64>]) -> Vector3<f64> {
    let count = points.len() as f64;
    let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / count;
    let squares = points.iter().map(|p| (p.coords - mean).component_mul(&(p.coords - mean))).sum::<Vector3<f64>>();
    (squares / count).map(f64::sqrt)
}

/// Ratio of the spreads of each coordinate, observed to desired.
fn gain(observed: &[Point3<f64>], desired: &[Point3<f64>]) -> [Option<f64>; 3] {
    let (observed, desired) = (spread(observed), spread(desired));
    let largest = desired.max();
    [0, 1, 2].map(|axis| (desired[axis] > STILL_AXIS * largest).then(|| observed[axis] / desired[axis]))
}

fn magnitude(
    path: &DesiredPath,
    observed: &[Point3<f64>],
    desired: &[Point3<f64>],
    circle: Option<&Circle>,
) -> Option<Magnitude> {
    let (of, observed_m, desired_m) = match (path.circle, circle) {
        (Some(desired), Some(observed)) => (Size::CircleRadius, observed.radius_m, desired.radius_m),
        (Some(_), None) => return None,
        (None, _) => (Size::RmsSize, spread(observed).norm(), spread(desired).norm()),
    };
    let db = 20.0 * (observed_m / desired_m).log10();
    db.is_finite().then_some(Magnitude { db, of, observed_m, desired_m })
}

/// RMS angle between observed and desired directions.
fn tangent_rms_rad(
    path: &DesiredPath,
    recording: &Recording,
    skipped: usize,
    mean: impl Fn(&[Sample]) -> Vec<Option<Mean>>,
) -> Option<f64> {
    path.tangents.as_ref()?;
    let samples: Vec<Sample> =
        recording.frames.iter().filter_map(|frame| Some((frame.stamp_ns, frame.tangent?))).collect();
    let angles: Vec<f64> = mean(&samples)
        .iter()
        .enumerate()
        .skip(skipped)
        .filter_map(|(k, mean)| Some(mean.as_ref()?.value.angle(&path.tangent(k)?)))
        .collect();
    (!angles.is_empty()).then(|| rms(angles.into_iter()))
}

/// σ of a size and of a turn, from `frames` places with independent errors of `sd_m` in each coordinate (one coordinate
/// of each counts, along the radius for the one and across it for the other), and from what does not repeat. `None`
/// with fewer than two periods, in which nothing shows what does not repeat.
fn response_sd(
    path: &DesiredPath,
    steps: &[Step],
    (sd_m, frames): (Option<f64>, usize),
    magnitude: Option<&Magnitude>,
) -> Option<f64> {
    let independent_m = sd_m? / (frames as f64).sqrt();
    let sd_m = unrepeated::sd_m(path, steps)?.max(independent_m);
    Some(sd_m / magnitude?.observed_m).filter(|sd| sd.is_finite())
}

fn scatter_m<'a>(means: impl Iterator<Item = &'a Mean>) -> Option<f64> {
    let several = means.filter(|mean| mean.frames > 1);
    let (squares, free) = several.fold((0.0, 0), |(sum, free), mean| (sum + mean.squares, free + mean.frames - 1));
    (free > 0).then(|| (squares / free as f64).sqrt())
}

fn sd_m(frames: &[&Frame], marker: usize) -> Option<f64> {
    let sds: Vec<f64> = frames.iter().filter_map(|frame| frame.places.get(marker)?.sd_m).collect();
    (!sds.is_empty()).then(|| rms(sds.into_iter()))
}
