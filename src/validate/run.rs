//! One observed run against the desired path.

use super::align::{Alignment, rms};
use super::circle::Circle;
use super::error::ValidateError;
use super::lag::Lag;
use super::lone::lone;
use super::notes;
use super::options::Options;
use super::path::DesiredPath;
use super::pauses::{Mean, Sample};
use super::periods::Periods;
use super::plane::Plane;
use super::response::{Magnitude, Response, Size};
use super::settling::Settling;
use super::start_time::StartFrom;
use super::step::Step;
use super::timing::{Marked, Observed, Timing, WEAK_CORRELATION, all_periods_are_there, marked, timing};
use crate::series::{Frame, Recording};
use crate::source::times::seconds;
use crate::vetoes::VETOED;
use nalgebra::Point3;
use std::f64::consts::TAU;
use std::path::PathBuf;

/// One run evaluated.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Run {
    /// Its place among the runs that were given, from 0.
    pub given: usize,
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
    /// Its σ, seconds, by ticks of the commands, else 0; `None` where it is not known.
    pub start_sd_s: Option<f64>,
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
    /// How many of them a point is the mean of; 1 where it is interpolated.
    pub frames_of_point: f64,
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
        let by_start = TAU * self.frequency_hz * self.start_sd_s?;
        Some(self.phase_deg.and(self.response_sd)?.hypot(by_start))
    }

    /// σ of the magnitude, in parts of it: what noise makes of it, and by how much noise makes the motion too large.
    pub(super) fn magnitude_sd(&self) -> Option<f64> {
        let magnitude = self.magnitude?;
        let coordinates = match magnitude.of {
            Size::CircleRadius => 1.0,
            Size::RmsSize => 3.0,
        };
        let too_large = coordinates * (self.sd_m? / magnitude.observed_m).powi(2) / (2.0 * self.frames_of_point);
        Some(self.response_sd?.hypot(too_large))
    }
}

/// Evaluates one run.
pub(super) fn evaluate(path: &DesiredPath, observed: &Observed<'_>, options: &Options) -> Result<Run, ValidateError> {
    let recording = observed.recording;
    let unusable = |problem: String| ValidateError::Unusable { path: recording.path.clone(), problem };
    let mut said = Vec::new();
    if let Some(why) = &recording.cut {
        said.push(format!("not all of the file can be read: {why}"));
    }

    // 1. the frames, and when the commands were given
    let Marked { marker, name, samples } = marked(recording, options)?;
    let Timing { window, start_from, start_correlation, note, inside, interval_s, start_sd_s } =
        timing(path, observed, &samples, options)?;
    said.extend(note);
    if start_from == StartFrom::Search {
        said.push(notes::start_by_correlation(window.commands < path.commands()));
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
    said.extend(notes::many_left_out(left_out, steps.len()));

    // 3. errors
    let alignment = Alignment::of(&pairs).ok_or_else(|| {
        unusable(format!("the observed points of {name} lie on a line or do not move: nothing can be aligned"))
    })?;
    for step in &mut steps {
        step.aligned = step.observed.map(|point| alignment.apply(&point));
    }
    let (points, wanted): (Vec<Point3<f64>>, Vec<Point3<f64>>) = pairs.iter().copied().unzip();
    let rms_unaligned_m = rms(pairs.iter().map(|(a, b)| (a - b).norm()));

    // 4. magnitude and phase
    let response = Response::of(path, &steps, counted);
    let lag = response.lag.filter(|_| start_from != StartFrom::Search);
    said.extend(response.lacking.clone());

    // 5. basis of the numbers
    let period_s = seconds(pause_ns) * path.points.len() as f64;
    let sd_m = sd_m(&inside, marker);
    let settling = Settling::of(path, &steps, response.plane.as_ref(), sd_m);
    said.extend(settling.as_ref().and_then(Settling::note));
    let frames_per_period = period_s / interval_s;
    let averaged = if interpolated { 1.0 } else { 1.0 - options.average.left_out() };
    let periods = Periods::of(path, counted, options.skip, sd_m, averaged * frames_per_period);
    said.extend(periods.iter().flat_map(|periods| periods.notes(seconds(pause_ns))));
    said.extend(notes::weak_correlation(lag.as_ref()));
    said.extend(notes::other_unit(&points, &wanted));
    said.extend(notes::few_frames(frames_per_period));
    said.extend(response.circle.as_ref().and_then(|circle| notes::far_from_circle(circle, sd_m)));
    said.extend(sd_m.and(notes::lone_period(path, steps.len())));
    let of_runs: Vec<Sample> =
        samples.iter().filter(|(at, _)| (window.start_ns..window.end_ns()).contains(at)).copied().collect();
    let has_place = |frame: &&&Frame| frame.places.get(marker).is_some_and(|place| place.point.is_some());
    let vetoed = |frame: &&&Frame| frame.places.get(marker).is_some_and(|place| place.status == VETOED);
    let seen = inside.iter().filter(has_place).filter(|frame| frame.stamp_ns >= window.at_ns(skipped)).count();
    let sd = response.sd(path, &steps, (sd_m, averaged * seen as f64));
    let (response_sd, wrong_frames) = unless_wrong_frames(sd, &response, &of_runs, window.at_ns(skipped));
    said.extend(wrong_frames);
    Ok(Run {
        given: 0,
        file: recording.path.clone(),
        marker: name,
        pause_s: seconds(pause_ns),
        frequency_hz: 1.0 / period_s,
        start_ns: window.start_ns,
        start_from,
        start_sd_s,
        start_correlation,
        interpolated,
        interval_s,
        frames: inside.len(),
        frames_of_point: (averaged * seconds(pause_ns) / interval_s).max(1.0),
        frames_missed: inside.len() - inside.iter().filter(has_place).count(),
        frames_vetoed: inside.iter().filter(vetoed).count(),
        frames_lost: inside.iter().skip(1).fold(0, |sum: u64, frame| sum.saturating_add(frame.gap)),
        left_out,
        alignment,
        rms_unaligned_m,
        gain: response.gain,
        magnitude: response.magnitude,
        plane: response.plane,
        circle: response.circle,
        lag,
        phase_deg: lag.map(|lag| -360.0 * lag.points / path.points.len() as f64),
        settling,
        periods,
        tangent_rms_rad: tangent_rms_rad(path, recording, skipped, mean),
        scatter_m: scatter_m(counted.iter().flatten()),
        response_sd,
        sd_m,
        notes: said,
        steps,
    })
}

/// σ of a response to frames from `from_ns` on, unless some may be wrong: at the same place of each period they would
/// look like the response. And what is to be said of such frames.
fn unless_wrong_frames(
    sd: Option<f64>,
    response: &Response,
    samples: &[Sample],
    from_ns: i64,
) -> (Option<f64>, Vec<String>) {
    let counted: Vec<Sample> = samples.iter().filter(|(at_ns, _)| *at_ns >= from_ns).copied().collect();
    let lone = lone(&counted);
    let too_far = |sd: f64| lone.zip(response.magnitude).is_some_and(|(lone, size)| lone.mean_m > sd * size.observed_m);
    let repeated = notes::repeated(samples);
    let off_plane = response.plane.as_ref().zip(response.magnitude.as_ref());
    let off_plane = off_plane.and_then(|(plane, magnitude)| notes::far_from_plane(plane, magnitude));
    let sound_sd = sd.filter(|sd| !too_far(*sd) && repeated.is_none() && off_plane.is_none());
    let lone = lone.map(|lone| lone.note(sd.is_some() && sound_sd.is_none()));
    (sound_sd, [repeated, off_plane, lone].into_iter().flatten().collect())
}

/// An observed point and the desired one.
type Pair = (Point3<f64>, Point3<f64>);

/// Those of all commands that have a point.
fn pairs(path: &DesiredPath, steps: &[Step]) -> Result<Vec<Pair>, String> {
    let pairs: Vec<Pair> = steps.iter().filter_map(|step| Some((step.observed?, step.desired))).collect();
    if 2 * pairs.len() < path.points.len() {
        return Err(format!(
            "{} of {} commands have a point, less than half of a period ({} rows of {}); check --pause, --start and \
             --points-per-period",
            pairs.len(),
            steps.len(),
            path.points.len(),
            path.file.display()
        ));
    }
    Ok(pairs)
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

fn scatter_m<'a>(means: impl Iterator<Item = &'a Mean>) -> Option<f64> {
    let several = means.filter(|mean| mean.frames > 1);
    let (squares, free) = several.fold((0.0, 0), |(sum, free), mean| (sum + mean.squares, free + mean.frames - 1));
    (free > 0).then(|| (squares / free as f64).sqrt())
}

fn sd_m(frames: &[&Frame], marker: usize) -> Option<f64> {
    let sds: Vec<f64> = frames.iter().filter_map(|frame| frame.places.get(marker)?.sd_m).collect();
    (!sds.is_empty()).then(|| rms(sds.into_iter()))
}
