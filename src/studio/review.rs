//! A run that is over: what was measured over time, and each frame with what was found in it.

use super::desk::Desk;
use super::reel::Reel;
use super::run::{Row, Run};
use super::{Refusal, Reply, scene, veto};
use crate::estimate::{Miss, plain_words};
use crate::sink::Origin;
use crate::source::times::seconds;
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RunAsked {
    run: String,
}

/// Four digits behind the point are more than a plot shows, and less than half as much to send.
fn short(value: f64) -> Value {
    let value = (value * 1e4).round() / 1e4;
    if value.is_finite() { json!(value) } else { Value::Null }
}

/// All of a run, column by column.
pub(super) fn run(desk: &Desk, asked: &RunAsked) -> Result<Reply, Refusal> {
    let run = desk.run(&asked.run)?;
    let first_ns = run.rows.first().map_or(0, |row| row.stamp_ns);
    let mut reasons: Vec<String> = Vec::new();
    let mut miss = Vec::with_capacity(run.rows.len());
    for row in &run.rows {
        let known = row.theta.is_some();
        let word = run.word(row);
        let at = (!known).then(|| {
            reasons.iter().position(|reason| *reason == word).unwrap_or_else(|| {
                reasons.push(word);
                reasons.len() - 1
            })
        });
        miss.push(at);
    }
    let residual = |m: usize, v: usize| -> Vec<Value> {
        let of = |row: &Row| row.bands.get(m).and_then(|views| views.get(v)?.as_ref()).map(|seen| seen.residual_px);
        run.rows.iter().map(|row| of(row).map_or(Value::Null, short)).collect()
    };
    let residuals: Vec<Value> = (0..run.markers.len())
        .flat_map(|m| (0..run.views.len()).map(move |v| (m, v)))
        .map(|(m, v)| json!({ "band": run.markers.get(m), "view": run.views.get(v), "px": residual(m, v) }))
        .collect();
    let theta = |pick: fn(&(f64, f64)) -> f64| -> Vec<Value> {
        run.rows.iter().map(|row| row.theta.as_ref().map_or(Value::Null, |t| short(pick(t).to_degrees()))).collect()
    };
    let origin = Origin::of_first(first_ns);
    // To the microsecond.
    let to_us_s = |ns: i64| (origin.elapsed_ns(ns) / 1000) as f64 / 1e6;
    let alarm = |(ns, over_ns, what): &(i64, Option<i64>, String)| {
        let over_s = over_ns.map(|ns| origin.elapsed_s(ns));
        json!({ "t_s": origin.elapsed_s(*ns), "over_s": over_s, "what": what })
    };
    let (vetoes, vetoes_of_none) = veto::standing(&run)?;
    Ok(Reply::Json(json!({
        "run": asked.run,
        "version": run.version(),
        "recording": run.recording,
        "rig": run.rig_path,
        "markers": run.markers,
        "views": run.views,
        "first_s": seconds(first_ns),
        "t_s": run.rows.iter().map(|row| json!(to_us_s(row.stamp_ns))).collect::<Vec<_>>(),
        "theta_deg": theta(|t| t.0),
        "sd_deg": theta(|t| t.1),
        "seq": run.rows.iter().map(|row| row.seq).collect::<Vec<_>>(),
        "miss": miss,
        "reasons": reasons.iter().map(|word| plain_words(word)).collect::<Vec<_>>(),
        "gap": run.rows.iter().map(|row| row.gap).collect::<Vec<_>>(),
        "residuals": residuals,
        "alarms": run.alarms.iter().map(alarm).collect::<Vec<_>>(),
        "cut": run.cut,
        "vetoes": vetoes,
        "vetoes_of_none": vetoes_of_none,
        "set_up": run.rig.as_ref().map(scene::set_up),
        "note": run.note,
    })))
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameAsked {
    run: String,
    row: usize,
    version: Option<String>,
}

/// One frame of a run: what was found in it, and which picture it is.
pub(super) fn frame(desk: &Desk, asked: &FrameAsked) -> Result<Reply, Refusal> {
    let run = desk.run_as_read(&asked.run, asked.version.as_deref())?;
    let row = run.row(asked.row)?;
    let bands: Vec<Value> = run
        .markers
        .iter()
        .enumerate()
        .map(|(m, name)| {
            let views: Vec<Value> = (0..run.views.len())
                .map(|v| {
                    row.bands.get(m).and_then(|views| views.get(v)?.as_ref()).map_or(Value::Null, |seen| {
                        json!({
                            "centre": seen.centre_px, "sd_px": seen.sd_px, "residual_px": seen.residual_px,
                            "separation": seen.separation, "outline": seen.outline_px,
                        })
                    })
                })
                .collect();
            let word = row.statuses.get(m).map_or("", String::as_str);
            json!({
                "name": name, "status": plain_words(word), "ok": word == "ok",
                "sd_mm": row.sd_m.get(m).copied().flatten().map(|sd| sd * 1e3), "views": views,
            })
        })
        .collect();
    // A run is worth looking through without its recording, too.
    let picture = picture(desk, &run, row.stamp_ns);
    Ok(Reply::Json(json!({
        "seq": row.seq,
        "stamp_ns": row.stamp_ns.to_string(),
        "theta_deg": row.theta.map(|t| t.0.to_degrees()),
        "sd_deg": row.theta.map(|t| t.1.to_degrees()),
        "status": plain_words(&run.word(row)),
        "bands": bands,
        "recording": picture.as_ref().ok().map(|(recording, _)| recording),
        "frame": picture.as_ref().ok().map(|(_, frame)| frame),
        "no_picture": picture.as_ref().err().map(|refusal| refusal.words.clone()),
        "wait": picture.as_ref().err().is_some_and(|refusal| refusal.status == 503),
        "scene": run.rig.as_ref().map(|rig| scene::light(rig, &row.places)),
    })))
}

/// The recording, and the number of the frame with this time.
fn picture(desk: &Desk, run: &Run, stamp_ns: i64) -> Result<(String, usize), Refusal> {
    let found = |reel: &Reel, frame: usize| (desk.places.shown(reel.path()), frame);
    let reading = |path: &Path| Refusal { status: 503, words: format!("{} is being read", path.display()) };
    let recording =
        run.recording.as_deref().ok_or_else(|| Refusal::wrong("the run does not say of which recording it is"))?;
    // What a camera took is gone, but for what was recorded with the run; a file in its place is there.
    if run.live && desk.places.existing(recording).is_err() {
        if let Some(path) = run.pictures_of(stamp_ns) {
            let reel = desk.reel_at(path, None)?;
            if let Some(frame) = reel.at(stamp_ns) {
                return Ok(found(&reel, frame));
            }
            if !reel.indexed().done {
                return Err(reading(path));
            }
        }
        return Err(Refusal::wrong("the picture of this frame was not recorded (catoptra live --record)"));
    }
    let reel = desk.reel_at(&desk.places.existing(recording)?, run.stated_rate)?;
    if let Some(tracked) = run.recording_sha256() {
        match reel.sha256() {
            None => return Err(reading(reel.path())),
            Some(now) if now.as_ref() != Some(&tracked) => {
                let changed = "has another content than when it was tracked: track it again, or bring the old one back";
                return Err(Refusal::wrong(format!("{recording}: {changed}")));
            }
            Some(_) => {}
        }
    }
    match reel.at(stamp_ns) {
        Some(frame) => Ok(found(&reel, frame)),
        None if !reel.indexed().done => Err(reading(reel.path())),
        None => Err(Refusal::wrong(format!("{recording}: the picture of this frame is {}", Miss::Damaged.word(&[])))),
    }
}
