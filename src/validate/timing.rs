//! Which marker of a run follows the path, when its commands were given, and the frames of that time.

use super::error::ValidateError;
use super::options::Options;
use super::path::DesiredPath;
use super::pauses::{Sample, Window, interval_s};
use super::start_time::{self, StartFrom};
use crate::series::{Frame, Recording};
use crate::source::times::seconds;

/// Below this correlation the path explains less than half of the observed motion (its square): it is another motion. A
/// catheter that follows a lemniscate far above its corner still reaches 0.87, most reach 0.99; a circle along a
/// lemniscate 0.63.
pub(super) const WEAK_CORRELATION: f64 = 0.7;

/// An observed run to evaluate.
#[derive(Debug)]
pub(crate) struct Observed<'a> {
    /// The run.
    pub recording: &'a Recording,
    /// How long each command is held, seconds.
    pub pause_s: f64,
    /// Camera time of the first command, if it is known, nanoseconds.
    pub start_ns: Option<i64>,
}

/// The marker that follows the path, and where it was seen.
pub(super) struct Marked {
    pub(super) marker: usize,
    pub(super) name: String,
    pub(super) samples: Vec<Sample>,
}

pub(super) fn marked(recording: &Recording, options: &Options) -> Result<Marked, ValidateError> {
    let wrong = |problem: String| ValidateError::Run { path: recording.path.clone(), problem };
    in_order(&recording.frames).map_err(wrong)?;
    recording.in_base_frame()?;
    let marker = marker(recording, options)?;
    let name = recording.markers.get(marker).cloned().unwrap_or_default();
    let samples: Vec<Sample> = recording
        .frames
        .iter()
        .filter_map(|frame| Some((frame.stamp_ns, frame.places.get(marker)?.point?.coords)))
        .collect();
    if samples.is_empty() {
        let problem = format!("none of its {} frames has a place of {name}", recording.frames.len());
        return Err(ValidateError::Unusable { path: recording.path.clone(), problem });
    }
    Ok(Marked { marker, name, samples })
}

/// When commands were given, and the frames of that time.
pub(super) struct Timing<'a> {
    pub(super) window: Window,
    pub(super) start_from: StartFrom,
    /// Correlation with the path, if it was searched for.
    pub(super) start_correlation: Option<f64>,
    /// A note about the start.
    pub(super) note: Option<String>,
    pub(super) inside: Vec<&'a Frame>,
    /// Usual time between these frames, seconds.
    pub(super) interval_s: f64,
    /// σ of the start, seconds, where the way to find it has one; `None` where that is not known.
    pub(super) start_sd_s: Option<f64>,
}

pub(super) fn timing<'a>(
    path: &DesiredPath,
    observed: &Observed<'a>,
    samples: &[Sample],
    options: &Options,
) -> Result<Timing<'a>, ValidateError> {
    let recording = observed.recording;
    let wrong = |problem: String| ValidateError::Run { path: recording.path.clone(), problem };
    let pause_ns = (observed.pause_s * 1e9).round();
    if !(1.0..1e15).contains(&pause_ns) {
        let must = if pause_ns < 1.0 { "above 0" } else { "below a million seconds" };
        return Err(wrong(format!("a pause of {} s is not valid: it must be {must}", observed.pause_s)));
    }
    let pause_ns = pause_ns as i64;
    let by_ticks = match observed.start_ns {
        Some(_) => None,
        None => start_time::from_ticks(recording, pause_ns, path.commands())?,
    };
    let mut note = by_ticks.as_ref().and_then(|ticked| ticked.note.clone());
    let pause_ns = by_ticks.as_ref().map_or(pause_ns, |ticked| ticked.pause_ns);
    let start_sd_s = by_ticks.as_ref().map_or(Some(0.0), |ticked| Some(ticked.start_sd_ns? * 1e-9));
    let ticked = by_ticks.map(|ticked| (ticked.start_ns, StartFrom::Ticks));
    let logged = || {
        let (ns, about) = start_time::from_currents(&recording.currents, path, pause_ns)?;
        note = about;
        Some((ns, StartFrom::Currents))
    };
    let mut start_correlation = None;
    let after_search = start_time::commands_after_search(path, options.skip);
    let searched = || {
        let (ns, correlation) = start_time::by_search(path, samples, pause_ns, after_search)?;
        start_correlation = Some(correlation);
        Some((ns, StartFrom::Search))
    };
    let given = observed.start_ns.map(|ns| (ns, StartFrom::Given));
    let (start_ns, start_from) = given.or(ticked).or_else(logged).or_else(searched).ok_or_else(|| {
        let (needs, has) = (path.commands() as f64 * seconds(pause_ns), span_s(samples));
        wrong(format!(
            "the start of the commands cannot be found: they take {needs:.3} s, the record has {has:.3} s of motion; \
             give --start, or check --pause and --periods"
        ))
    })?;
    if let Some(correlation) = start_correlation.filter(|correlation| *correlation < WEAK_CORRELATION) {
        return Err(wrong(format!(
            "the start of the commands cannot be found: the motion correlates with the path by {correlation:.2} at \
             best, of 1; {WEAK_CORRELATION} is needed. Does the marker move, along this path, with these axes, --pause \
             and --periods? If so, give --start"
        )));
    }
    let searched = start_from == StartFrom::Search;
    let commands = if searched { after_search } else { path.commands() };
    let window = Window { start_ns, pause_ns, commands };
    let inside: Vec<&Frame> =
        recording.frames.iter().filter(|f| f.stamp_ns >= window.start_ns && f.stamp_ns < window.end_ns()).collect();
    if inside.is_empty() {
        let (first, last) = (recording.frames.first(), recording.frames.last());
        let at = |frame: Option<&Frame>| seconds(frame.map_or(0, |frame| frame.stamp_ns));
        return Err(wrong(format!(
            "no frame is from the time of the commands: these are from {:.3} s to {:.3} s, the frames from {:.3} s to \
             {:.3} s of the camera's clock; check --start",
            seconds(window.start_ns),
            seconds(window.end_ns()),
            at(first),
            at(last)
        )));
    }
    let stamps: Vec<i64> = inside.iter().map(|frame| frame.stamp_ns).collect();
    let interval_s = interval_s(&stamps).ok_or_else(|| ValidateError::Unusable {
        path: recording.path.clone(),
        problem: format!(
            "has a single frame from the time of the commands ({} s to {} s): are its times in seconds?",
            seconds(window.start_ns),
            seconds(window.end_ns())
        ),
    })?;
    Ok(Timing { window, start_from, start_correlation, note, inside, interval_s, start_sd_s })
}

/// Rejects a record that ends before the middle of the last period: either there are fewer periods, and what comes
/// after them is none, or it is not all of the run.
pub(super) fn all_periods_are_there(
    path: &DesiredPath,
    recording: &Recording,
    window: &Window,
) -> Result<(), ValidateError> {
    let last_ns = recording.frames.last().map_or(window.start_ns, |frame| frame.stamp_ns);
    let period_ns = window.at_ns(path.points.len()).saturating_sub(window.start_ns);
    let there = last_ns.saturating_sub(window.start_ns) as f64 / period_ns as f64;
    if there + 0.5 >= path.periods as f64 {
        return Ok(());
    }
    // The last frame is before the end of its period.
    let whole = (there + 0.1).floor();
    Err(ValidateError::Run {
        path: recording.path.clone(),
        problem: format!(
            "the record ends at {:.3} s of the camera's clock, {} periods of commands at {:.3} s: {whole} of them are \
             in it; give --periods {}, or check --pause and --start",
            seconds(last_ns),
            path.periods,
            seconds(window.end_ns()),
            whole.max(1.0)
        ),
    })
}

/// Rejects frames whose times do not increase.
fn in_order(frames: &[Frame]) -> Result<(), String> {
    if frames.is_empty() {
        return Err("has no frame".to_owned());
    }
    match frames.iter().zip(frames.iter().skip(1)).find(|(before, after)| after.stamp_ns <= before.stamp_ns) {
        Some((before, after)) => Err(format!(
            "frame {} ({} s) is not later than frame {} ({} s): {}",
            after.seq,
            seconds(after.stamp_ns),
            before.seq,
            seconds(before.stamp_ns),
            if after.seq <= before.seq {
                "is a row there twice, or in the wrong order?"
            } else {
                "the camera's clock restarted; use the part before or after"
            }
        )),
        None => Ok(()),
    }
}

/// The requested marker, else the tip, else the last.
fn marker(recording: &Recording, options: &Options) -> Result<usize, ValidateError> {
    match &options.marker {
        Some(name) => Ok(recording.marker(name)?),
        None => {
            match recording.markers.iter().position(|name| name == "tip").or(recording.markers.len().checked_sub(1)) {
                Some(index) => Ok(index),
                None => Ok(recording.marker("tip")?),
            }
        }
    }
}

fn span_s(samples: &[Sample]) -> f64 {
    samples.first().zip(samples.last()).map_or(0.0, |(first, last)| seconds(last.0.saturating_sub(first.0)))
}
