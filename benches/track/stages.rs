//! Each stage of a frame compared with OpenCV's script on the same frames, one thread each. Each goes through the
//! recording by itself and is timed right after its frame was decoded, as in a program that does nothing else: the
//! caches are as the decoder leaves them. In turns, several times.

use super::opencv_script::{Script, i420};
use super::spread::with_spread;
use super::stopwatch::{Stopwatch, median};
use catoptra::estimate::Estimate;
use catoptra::rig::Rig;
use catoptra::segment::{Search, Segmenter, Window};
use catoptra::source::{self, Frame, Picture, SourceOptions};
use catoptra::track::{TrackOptions, Tracker};
use nalgebra::Vector3;
use std::error::Error;
use std::path::Path;

/// Half the side of the windows for timing segmentation: about the tracker's own, at 60 frames per second and half a
/// millimetre per pixel.
const WINDOW_PX: f64 = 60.0;
/// Times that the recording is gone through, and runs on a worst-case picture each time.
const ROUNDS: usize = 3;
const RUNS: usize = 15;

#[derive(Default)]
struct Times {
    script: Stopwatch,
    decode: Stopwatch,
    segment: Stopwatch,
    segment_windows: Stopwatch,
    step: Stopwatch,
    step_full_frame: Stopwatch,
    /// Of the worst-case pictures: the script and the segmentation.
    worst: [(Stopwatch, Stopwatch); WORST.len()],
}

const WORST: [&str; 2] = ["all of the coil's colour", "random samples"];

/// One round, and what was found in it.
struct Round {
    times: Times,
    frames: usize,
    components: i32,
    blobs: usize,
    size_px: [u32; 2],
}

/// Measures and prints.
pub(crate) fn print(recording: &Path, rig: &Rig) -> Result<(), Box<dyn Error + Send + Sync>> {
    // This one, so that all stages run where the script does.
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build()?;
    let rounds = (0..ROUNDS).map(|_| round(recording, rig, &one_thread)).collect::<Result<Vec<_>, _>>()?;
    let Round { frames, components, blobs, size_px: [width, height], .. } = rounds[0];
    println!(
        "{frames} frames of {width}x{height}, each right after it was decoded, one thread each, medians of its CPU \
         time in each of {ROUNDS} rounds. A frame has"
    );
    println!(
        "{:.2} components in the masks of OpenCV's script and {:.2} blobs in the segmentation.\n",
        f64::from(components) / frames as f64,
        blobs as f64 / frames as f64
    );
    println!("{:42}{:>12}{:>18}{:>27}", "a frame", "Catoptra", "OpenCV's script", "ratio");
    let row = |name: &str, of: &dyn Fn(&Times) -> f64, script: &dyn Fn(&Times) -> f64| {
        let typical = |of: &dyn Fn(&Times) -> f64| median(rounds.iter().map(|round| of(&round.times)));
        let ratio = with_spread(|| rounds.iter().map(|round| script(&round.times) / of(&round.times)), 1);
        println!("{name:42}{:>9.3} ms{:>15.3} ms{ratio:>25} x", typical(of), typical(script));
    };
    let stage = |name: &str, of: &dyn Fn(&Times) -> f64| row(name, of, &|times| times.script.median_ms());
    stage("decoding", &|times| times.decode.median_ms());
    stage("segmentation, whole frame", &|times| times.segment.median_ms());
    stage(&format!("segmentation, windows of {} px", 2.0 * WINDOW_PX), &|times| times.segment_windows.median_ms());
    stage("assignment, fit, tangent: the rest of step", &|times| {
        times.step.median_ms() - times.segment_windows.median_ms()
    });
    stage("Tracker::step", &|times| times.step.median_ms());
    stage("Tracker::step, whole frames searched", &|times| times.step_full_frame.median_ms());
    for (i, name) in WORST.iter().enumerate() {
        let [script, segment]: [&dyn Fn(&Times) -> f64; 2] =
            [&|times| times.worst[i].0.median_ms(), &|times| times.worst[i].1.median_ms()];
        row(&format!("segmentation, {name}"), segment, script);
    }
    Ok(())
}

fn round(recording: &Path, rig: &Rig, one_thread: &rayon::ThreadPool) -> Result<Round, Box<dyn Error + Send + Sync>> {
    let (mut script, mut segmenter) = (Script::new()?, Segmenter::for_rig(rig)?);
    let mut windowed = Tracker::new(rig, TrackOptions::default())?;
    let mut full_frame = Tracker::new(rig, TrackOptions { full_frame: true, ..TrackOptions::default() })?;

    let mut times = Times::default();
    let (mut components, mut blobs) = (0, 0);
    let mut estimates: Vec<Estimate> = Vec::new();
    let mut last = None;
    each_frame(recording, &mut times.decode, |frame| {
        components += script_on(&mut times.script, &mut script, &frame.picture)?;
        Ok(())
    })?;
    each_frame(recording, &mut times.decode, |frame| {
        blobs += times.segment.time(|| segmenter.all_blobs(&frame.picture).map(<[_]>::len))?;
        Ok(())
    })?;
    each_frame(recording, &mut times.decode, |frame| {
        estimates.push(one_thread.install(|| times.step.time(|| windowed.step(frame)))?);
        Ok(())
    })?;
    each_frame(recording, &mut times.decode, |frame| {
        one_thread.install(|| times.step_full_frame.time(|| full_frame.step(frame)))?;
        Ok(())
    })?;
    let mut before = estimates.iter();
    each_frame(recording, &mut times.decode, |frame| {
        if last.replace(frame.picture.clone()).is_some() {
            let windows = before.next().map(windows_around).unwrap_or_default();
            times.segment_windows.time(|| segmenter.blobs(&frame.picture, &windows).map(<[_]>::len))?;
        }
        Ok(())
    })?;
    let (picture, frames) = (last.ok_or("the recording has no frames")?, estimates.len());
    for ((of_script, of_segment), picture) in times.worst.iter_mut().zip(worst_cases(rig, &picture)?) {
        for _ in 0..RUNS {
            script_on(of_script, &mut script, &picture)?;
            of_segment.time(|| segmenter.all_blobs(&picture).map(<[_]>::len))?;
        }
    }
    Ok(Round { times, frames, components, blobs, size_px: picture.size_px() })
}

/// Decodes a recording by one thread, and does something with each frame.
fn each_frame(
    recording: &Path,
    decode: &mut Stopwatch,
    mut run: impl FnMut(&Frame) -> Result<(), Box<dyn Error + Send + Sync>>,
) -> Result<(), Box<dyn Error + Send + Sync>> {
    let mut source = source::open(recording, SourceOptions { decoder_threads: 1, ..SourceOptions::default() })?;
    while let Some(frame) = decode.time(|| source.next_frame())? {
        run(&frame)?;
    }
    Ok(())
}

/// Times OpenCV's script, without the copy of the planes; returns the number of components.
fn script_on(
    times: &mut Stopwatch,
    script: &mut Script,
    picture: &Picture,
) -> Result<i32, Box<dyn Error + Send + Sync>> {
    let planes = i420(picture)?;
    Ok(times.time(|| script.components(&planes))?)
}

/// Windows around the bands' places in a frame.
fn windows_around(estimate: &Estimate) -> Vec<Search> {
    let bands = estimate
        .markers
        .iter()
        .enumerate()
        .flat_map(|(m, found)| found.views.iter().flatten().map(move |band| (m, band)));
    bands
        .map(|(m, band)| Search { marker: Some(m), view: None, window: Window::around(&band.centre_px, WINDOW_PX) })
        .collect()
}

/// Pictures like `like` in which no part can be skipped: their cost is an upper bound for any picture.
fn worst_cases(rig: &Rig, like: &Picture) -> Result<[Picture; WORST.len()], Box<dyn Error + Send + Sync>> {
    let coil =
        rig.markers.get(rig.catheter.coil).and_then(|marker| marker.colour(0)).ok_or("the coil has no colour")?;
    let ([width, height], format, colour) = (like.size_px(), like.format(), like.colour());
    let samples = |i: usize| like.plane(i).map_or(0, |plane| plane.width * plane.height);
    let full = (0..3).map(|i| {
        let (weights, constant) = colour.channel_from_rgb(format, i);
        let stored = coil.rgb.dot(&Vector3::from(weights)) + constant;
        vec![stored.round() as u8; samples(i)]
    });
    let mut random = fastrand::Rng::with_seed(1);
    let noise = (0..3).map(|i| (0..samples(i)).map(|_| random.u8(..)).collect());
    let (full, noise) = (full.collect(), noise.collect());
    let picture = |planes| Picture::from_planes(width, height, format, colour, planes);
    Ok([picture(full)?, picture(noise)?])
}
