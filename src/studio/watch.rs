//! A live run while it goes on: its last rows, how it goes, and a picture now and then.

use super::{Refusal, Reply, scene, shown};
use crate::estimate::Estimate;
use crate::live::{Latest, NEARLY_FULL_BYTES, RecordSwitch, free_bytes, lower_priority};
use crate::rig::Rig;
use crate::sink::ToBgr;
use crate::source::times::seconds;
use base64::prelude::{BASE64_STANDARD, Engine as _};
use nalgebra::Isometry3;
use parking_lot::Mutex;
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Pictures are no wider, pixels, and no more often, however many pages ask.
const WIDTH_PX: u32 = 640;
const MIN_INTERVAL: Duration = Duration::from_millis(150);

/// A live run.
pub(crate) struct Watch {
    latest: Arc<Latest>,
    rig: Rig,
    source: String,
    folder: String,
    made: Mutex<Made>,
    record: Option<Record>,
}

/// Recording of pictures that the page begins and ends.
struct Record {
    switch: Arc<RecordSwitch>,
    /// How it can be recorded.
    record_words: Vec<&'static str>,
}

/// The picture that was made last, for all pages.
struct Made {
    to_bgr: ToBgr,
    at: Option<Instant>,
    seq: u64,
    reply: Value,
}

impl Watch {
    /// The run of `rig` that leaves its last rows in `latest`.
    pub(crate) fn new(latest: Arc<Latest>, rig: &Rig, source: &str, folder: &str) -> Self {
        let made = Made { to_bgr: ToBgr::quick(), at: None, seq: 0, reply: Value::Null };
        let (rig, source, folder) = (rig.clone(), source.to_owned(), folder.to_owned());
        Self { latest, rig, source, folder, made: Mutex::new(made), record: None }
    }

    /// Pictures of it are recorded, in one of these ways, when `switch` is turned.
    pub(crate) fn recording(mut self, switch: Arc<RecordSwitch>, record_words: Vec<&'static str>) -> Self {
        self.record = Some(Record { switch, record_words });
        self
    }

    /// What does not change.
    pub(super) fn about(&self) -> Value {
        json!({
            "source": self.source,
            "folder": self.folder,
            "size": self.rig.camera.size_px,
            "markers": self.rig.markers.iter().map(|m| &m.name).collect::<Vec<_>>(),
            "views": self.rig.views.iter().map(|v| &v.name).collect::<Vec<_>>(),
            "in_base": self.rig.base.is_some(),
            "hows": self.record.as_ref().map(|record| &record.record_words),
        })
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RowsAsked {
    /// Number of the last row that the page has.
    after: Option<u64>,
    /// Time of the last sample of currents that it has, nanoseconds since 1970, in digits.
    currents_after: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RecordAsked {
    on: bool,
    how: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PictureAsked {
    /// Number of the picture that the page has.
    after: Option<u64>,
}

impl Watch {
    /// Rows that are new, and how it goes.
    pub(super) fn rows(&self, asked: &RowsAsked) -> Reply {
        lower_priority();
        let rows: Vec<Value> = self.latest.rows_after(asked.after).iter().map(|row| self.row(row)).collect();
        let currents_after = asked.currents_after.as_ref().and_then(|ns| ns.parse().ok()).unwrap_or(i64::MIN);
        let currents = self.latest.currents_after(currents_after);
        let status = self.latest.status();
        let ms = |us: u64| us as f64 * 1e-3;
        let recording = self.record.as_ref().map(|record| record.switch.state());
        let free = free_bytes(Path::new(&self.folder));
        Reply::Json(json!({
            "rows": rows,
            "currents": currents.iter().map(|sample| json!({
                "host_ns": sample.host_ns.to_string(), "host_s": seconds(sample.host_ns), "a": sample.current_a,
            })).collect::<Vec<_>>(),
            "status": {
                "frames": status.frames, "rate": status.rate_hz, "lost": status.lost, "skipped": status.skipped,
                "p50_ms": ms(status.latency.p50_us), "p99_ms": ms(status.latency.p99_us),
                "max_ms": ms(status.latency.max_us),
                "silent_s": status.silent.map(|silent| silent.as_secs_f64()),
                "backlog": status.backlog, "unlogged": status.unlogged, "pictures": status.pictures,
                "not_shown": self.latest.missed(),
                "recording": recording,
                "disk_gb": free.map(|bytes| bytes as f64 * 1e-9),
                "disk_nearly_full": free.is_some_and(|bytes| bytes < NEARLY_FULL_BYTES),
                "alarms": status.alarms.iter().map(|alarm| json!({
                    "t_s": seconds(alarm.ns), "over_s": alarm.over_ns.map(seconds),
                    "what": alarm.what, "advice": alarm.advice,
                })).collect::<Vec<_>>(),
                "warnings": status.warnings,
            },
        }))
    }

    fn row(&self, row: &Estimate) -> Value {
        let views: Vec<&str> = self.rig.views.iter().map(|v| v.name.as_str()).collect();
        let to_base = self.rig.base.as_ref().map_or(Isometry3::identity(), |base| base.base_from_camera);
        let tip = row.markers.get(self.rig.tip()).and_then(|m| m.position.as_ref().ok());
        let tip_mm = tip.map(|position| (to_base * position.point * 1e3).coords.map(|v| (v * 1e3).round() / 1e3));
        json!({
            "seq": row.seq,
            "t_s": row.stamp.seconds(),
            // When it was exposed, as the samples of currents say when they flowed.
            "host_s": row.host.map(|host| seconds(host.stamp_ns)),
            "gap": row.gap,
            "theta_deg": row.deflection.as_ref().ok().map(|d| [d.theta_rad, d.theta_sd_rad].map(f64::to_degrees)),
            "status": row.deflection.as_ref().err().map(|miss| miss.plain_words(&views)),
            "tip_mm": tip_mm.map(|p| [p.x, p.y, p.z]),
        })
    }

    /// Begins or ends the recording of pictures.
    pub(super) fn record(&self, asked: &RecordAsked) -> Result<Reply, Refusal> {
        let none = || Refusal::wrong("pictures of this run cannot be recorded from here");
        let record = self.record.as_ref().ok_or_else(none)?;
        if !record.record_words.contains(&asked.how.as_str()) {
            let known = record.record_words.join(", ");
            return Err(Refusal::wrong(format!("{}: expected a way to record, one of {known}", asked.how)));
        }
        if asked.on {
            record.switch.start(&asked.how);
        } else {
            record.switch.stop();
        }
        Ok(Reply::Json(json!(record.switch.state())))
    }

    /// The newest picture, scaled, with the outlines of its bands; nothing when there is none that is newer.
    pub(super) fn picture(&self, asked: &PictureAsked) -> Result<Reply, Refusal> {
        lower_priority();
        let mut made = self.made.lock();
        if made.at.is_none_or(|at| at.elapsed() >= MIN_INTERVAL)
            && let Some((estimate, picture)) = self.latest.picture()
            && (made.at.is_none() || estimate.seq > made.seq)
        {
            let jpeg = shown::jpeg(&mut made.to_bgr, &picture, Some(WIDTH_PX))?;
            let bands: Vec<Value> = estimate
                .markers
                .iter()
                .map(|m| {
                    let band = |view: &Result<_, _>| view.as_ref().ok().map(scene::band);
                    json!(m.views.iter().map(band).collect::<Vec<_>>())
                })
                .collect();
            made.reply = json!({ "seq": estimate.seq, "jpeg": BASE64_STANDARD.encode(jpeg), "bands": bands });
            (made.seq, made.at) = (estimate.seq, Some(Instant::now()));
        }
        match made.at {
            Some(_) if asked.after.is_none_or(|after| made.seq > after) => Ok(Reply::Json(made.reply.clone())),
            _ => Ok(Reply::Nothing),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::HostTime;
    use crate::testing::fixture;

    #[test]
    fn a_row_has_the_rig_s_tip_and_the_time_of_exposure() {
        let mut rig = fixture::rig();
        let mut estimate = fixture::complete(0, 0);
        estimate.host = Some(HostTime { arrival_ns: 5_000_000_000, stamp_ns: 4_000_000_000 });
        let mut row = |end| {
            rig.catheter.end = end;
            Watch::new(Arc::default(), &rig, "", "").row(&estimate)
        };
        let [last, first] = [row(None), row(Some(0))];
        assert_eq!((&last["host_s"], &last["tip_mm"]), (&json!(4.0), &row(Some(2))["tip_mm"]));
        assert!(first["tip_mm"].is_array() && first["tip_mm"] != last["tip_mm"], "{first}");
    }
}
