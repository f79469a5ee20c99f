//! The summary of a run: a table of plain text.

use super::folder::Files;
use crate::digits::fixed;
use crate::estimate::plain_words;
use crate::log::is_log;
use crate::pipeline::Summary;
use crate::plural::plural;
use crate::rig::Rig;
use crate::source::times::seconds;
use crate::tally::budget::{together, together_name};
use crate::tally::{AlarmInWords, MISSING_OF_LOG, Tally, TickTally};
use std::fmt::{self, Write as _};
use std::path::{Path, PathBuf};

/// Prints a warning for every alarm beyond the first `known` ones; returns the number of alarms.
pub(in crate::cli) fn new_alarms(tally: &Tally, recording: &str, known: usize) -> usize {
    tally.alarms().skip(known).for_each(|alarm| warn_of_alarm(&alarm, recording));
    tally.drift.alarms().len()
}

/// A view that shows less than this fraction of the bands has no part in the result.
const IDLE: f64 = 0.05;

/// A warning for one alarm of `source`.
pub(in crate::cli) fn warn_of_alarm(alarm: &AlarmInWords, source: &str) {
    let AlarmInWords { ns, what, advice, .. } = alarm;
    tracing::warn!("{source}: at {:.3} s: {what}: {advice}", seconds(*ns));
}

/// The summary of a run of `recording`.
pub(in crate::cli) fn summary(
    out: &mut String,
    recording: &str,
    run: &Summary,
    files: &Files,
    rig: &Rig,
) -> fmt::Result {
    let tally = &run.tally;
    writeln!(out, "{recording}: {}", received(tally, is_log(Path::new(recording))))?;
    let name_width = tally.markers.iter().map(|m| m.name.chars().count()).max().unwrap_or(0).max(10);
    writeln!(out, "\n  {:name_width$}  answered           median σ", "")?;
    let mut row = |name: &str, answered: u64, sd: Option<f64>, unit: &str, rest: String| {
        let sd = sd.map_or(String::new(), |sd| format!("{sd:.3}{unit}"));
        let line =
            format!("  {name:<name_width$}  {answered:>8}  {:>7}  {sd:<10}{rest}", share(answered, tally.frames));
        writeln!(out, "{}", line.trim_end())
    };
    for marker in &tally.markers {
        row(&marker.name, marker.answered, marker.median_sd_mm(), " mm", reasons(tally, &marker.name))?;
    }
    row("tangent", tally.tangent.answered, tally.tangent.median_sd_deg(), "°", reasons(tally, "tangent"))?;
    if rig.base.is_some() {
        let range = tally.theta.range_deg.map(|(low, high)| format!("from {}° to {}°", fixed(low, 1), fixed(high, 1)));
        row("deflection", tally.theta.answered, tally.theta.median_sd_deg(), "°", range.unwrap_or_default())?;
    }
    for (view, seen, answered) in idle_views(rig, tally) {
        writeln!(
            out,
            "\nview {view} shows bands in {seen} of {answered} places that the other views give: it does not count; \
             has its mirror moved since the calibration (the views that are left cannot tell), or does something hide \
             it?"
        )?;
    }
    if let Some(sources) = tally.budget() {
        writeln!(out, "\n  error budget, 1σ                 θ      tip, a coordinate")?;
        let line = |name: &str, (theta_rad, tip_m): (f64, f64)| {
            format!("  {name:<26}  {:>8.4}°  {:>10.4} mm", theta_rad.to_degrees(), tip_m * 1e3)
        };
        for source in &sources {
            match &source.share {
                Ok(share) => writeln!(out, "{}", line(source.name, *share))?,
                Err(why) => writeln!(out, "  {:<26}  not known: {why}", source.name)?,
            }
        }
        writeln!(out, "{}", line(together_name(&sources), together(&sources)))?;
    }
    if let Some(ticks) = &tally.ticks {
        let TickTally { seen, changes, level: (low, high), .. } = ticks;
        let (changed, frames) = (plural(*changes, "change"), plural(*seen, "frame"));
        writeln!(out, "\n  tick       {changed} in {frames}, brightness {low:.0} to {high:.0} of 255")?;
        let at = ticks.spot();
        if *changes == 0 && 2 * *seen < tally.frames {
            let unseen = plural(tally.frames - seen, "frame");
            writeln!(
                out,
                "the lamp at {at} is not in {unseen}: a log with windows keeps only what was looked at when it was \
                 written"
            )?;
        } else if *changes == 0 {
            writeln!(
                out,
                "the lamp at {at} never changed: is it there (--tick-led x,y,r; the overlay shows the disc), does it \
                 go on and off with every command, and were there any? Without changes there are no times of commands"
            )?;
        }
    }
    for AlarmInWords { ns, over_ns, what, advice } in tally.alarms() {
        let until = over_ns.map_or("on".to_owned(), |ns| format!("to {:.3} s", seconds(ns)));
        writeln!(out, "\nfrom {:.3} s {until} {what}: {advice}", seconds(ns))?;
    }
    let took_s = run.elapsed.as_secs_f64();
    writeln!(out, "\ntracked in {took_s:.1} s, {:.0} frames per second", tally.frames as f64 / took_s.max(1e-9))?;
    writeln!(out, "results in {}", files.folder.display())?;
    let videos: Vec<PathBuf> = files.videos().map(|name| files.folder.join(name)).collect();
    let named: [(Option<&PathBuf>, &str); 4] = [
        (Some(&files.table), "one row per frame"),
        (Some(&files.report), "to look at, in a browser"),
        (files.overlay.as_ref(), "the recording with what was found drawn into it"),
        (Some(&files.log), "everything, for Foxglove and programs"),
    ];
    let named = named.into_iter().filter_map(|(path, what)| Some((path?, what)));
    let named = named.chain(videos.iter().map(|path| (path, "pictures, to be tracked again")));
    // Every error of a file names it.
    let failed: Vec<String> = run.sink_failures.iter().map(ToString::to_string).collect();
    let is_broken = |path: &Path| failed.iter().any(|said| said.contains(&*path.to_string_lossy()));
    for (path, what) in named {
        let on_stdout = path == &files.table && files.table_on_stdout();
        if !on_stdout && std::fs::metadata(path).is_ok_and(|found| found.is_file() && found.len() == 0) {
            continue;
        }
        let what = if is_broken(path) { "not complete: it could not be written to its end" } else { what };
        let shown = if on_stdout {
            "stdout".into()
        } else {
            path.strip_prefix(&files.folder).unwrap_or(path).to_string_lossy()
        };
        writeln!(out, "  {shown:<12}  {what}")?;
    }
    Ok(())
}

/// Frames and gaps. Of a log that is tracked again frames may be missing in the file as well.
fn received(tally: &Tally, of_log: bool) -> String {
    let frames = match tally.frames {
        0 => return "no frame".to_owned(),
        1 => return format!("1 frame, at {:.3} s", seconds(tally.first_ns)),
        n => format!("{n} frames, {:.3} s to {:.3} s", seconds(tally.first_ns), seconds(tally.last_ns)),
    };
    let lost = match (tally.lost, tally.gaps) {
        (0, _) => "none lost between them".to_owned(),
        (lost, gaps) if of_log => {
            format!("{lost} are missing between them in {}: {MISSING_OF_LOG}", plural(gaps, "gap"))
        }
        (lost, 1) => format!("{lost} lost between them in 1 gap"),
        (lost, gaps) => format!("{lost} lost between them in {gaps} gaps"),
    };
    format!("{frames}; {lost}")
}

fn share(part: u64, whole: u64) -> String {
    match whole {
        0 => String::new(),
        _ => format!("{:.1} %", 100.0 * part as f64 / whole as f64),
    }
}

/// Why `what` is missing, and in how many frames: `12 not seen in mirror, 1 ambiguous`.
fn reasons(tally: &Tally, what: &str) -> String {
    let said: Vec<_> =
        tally.reasons(what).iter().map(|(word, frames)| format!("{frames} {}", plain_words(word))).collect();
    said.join(", ")
}

/// Views beyond the two that a position needs that show hardly any of the bands: their names, how many they show, and
/// of how many.
fn idle_views<'a>(rig: &'a Rig, tally: &Tally) -> Vec<(&'a str, u64, u64)> {
    let answered: u64 = tally.markers.iter().map(|marker| marker.answered).sum();
    let seen = |v: usize| tally.markers.iter().filter_map(|marker| Some(marker.views.get(v)?.seen)).sum::<u64>();
    let views = rig.views.iter().enumerate().map(|(v, view)| (view.name.as_str(), seen(v), answered));
    let is_idle = |(_, seen, answered): &(&str, u64, u64)| (*seen as f64) < IDLE * *answered as f64;
    views.filter(|view| rig.views.len() > 2 && is_idle(view)).collect()
}

/// Why the run is unusable, if so: a marker was never located, or the coil's direction was never measured.
pub(in crate::cli) fn unusable(rig: &Rig, tally: &Tally) -> Option<String> {
    let never: Vec<_> = tally.markers.iter().filter(|m| m.answered == 0).map(|m| m.name.as_str()).collect();
    let frames = match tally.frames {
        0 => return None,
        1 => "the only frame".to_owned(),
        n => format!("any of {n} frames"),
    };
    if never.is_empty() {
        let why = reasons(tally, "tangent");
        let coil = &rig.markers.get(rig.catheter.coil)?.name;
        return (tally.tangent.answered == 0)
            .then(|| format!("the direction of marker {coil} is not known in {frames} ({why})"));
    }
    let mut said = String::new();
    for name in never {
        let why = tally.reasons(name);
        let list = reasons(tally, name);
        let likely = match why.first().map_or("", |(word, _)| word) {
            word if word.starts_with("not_seen_") => {
                let view = word.trim_start_matches("not_seen_");
                format!(
                    "it is hidden or outside the region of view {view}, or light and colours are not those that \
                     `catoptra calibrate markers` learned"
                )
            }
            "not_recorded" => {
                "the log holds parts of its pictures, and not those: track it with the rig it was recorded \
                 with"
                    .to_owned()
            }
            "too_coarse" => "record with less compression: without losses, or H.264 at crf 14".to_owned(),
            "interlaced" => {
                "record progressive video, or make a frame of each field (ffmpeg: `-vf bwdif=send_field`); if all rows \
                 are of one moment after all, say so (`-vf setfield=prog`)"
                    .to_owned()
            }
            "repeated" => "camera or recorder show pictures twice: record at the camera's own rate".to_owned(),
            "damaged" => "the recording is damaged: copy it again".to_owned(),
            "rays_diverge" => "the rig is that of another recording, camera, mirror or tank have moved since the \
                calibration, the pictures are mirrored, turned or scaled, or another thing has its colour"
                .to_owned(),
            "ambiguous" => "other things of its colour are in the views: cover them, or draw the regions \
                tighter"
                .to_owned(),
            _ => "light and colours are not those that `catoptra calibrate markers` learned, or the rig's lengths are \
                  not those of the catheter"
                .to_owned(),
        };
        let before = if said.is_empty() { "" } else { "\n" };
        said += &format!("{before}marker {name} was not located in {frames} ({list}); likely {likely}");
    }
    Some(said)
}
