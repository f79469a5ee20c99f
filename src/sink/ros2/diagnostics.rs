//! State of the run, for `rqt_robot_monitor` and the like: totals, misses with reasons, drift.

use crate::estimate::Miss;
use crate::log::ros2::messages::{DiagnosticStatus, KeyValue};
use crate::log::schema::messages::Health;
use crate::plural::plural;

const OK: u8 = 0;
const WARN: u8 = 1;
const ERROR: u8 = 2;

/// One status for the frames, one for each quantity, one for drift.
pub(super) fn status(health: &Health, markers: &[String]) -> Vec<DiagnosticStatus> {
    let mut frames = vec![
        value("frames", health.frames),
        value("lost_frames", health.lost_frames),
        value("gaps", health.gaps),
        value("deflections", health.deflections),
    ];
    frames.extend(health.pictures_recorded.map(|n| value("pictures_recorded", n)));
    frames.extend(health.pictures_dropped.map(|n| value("pictures_dropped", n)));
    let lossy = health.lost_frames > 0 || health.pictures_dropped.is_some_and(|n| n > 0);
    let (all, gaps) = (plural(health.frames, "frame"), plural(health.gaps, "gap"));
    let message = format!("{all}, {} lost in {gaps}", health.lost_frames);
    let mut all = vec![one("frames", if lossy { WARN } else { OK }, message, frames)];

    let no_base = Miss::NoBaseFrame.word(&[]);
    for what in markers.iter().map(String::as_str).chain(["tangent", "deflection"]) {
        let misses: Vec<_> = health.misses.iter().filter(|miss| miss.what == what).collect();
        // What a rig without a base frame has not is not missed.
        let missed: u64 = misses.iter().filter(|miss| miss.reason != no_base).map(|miss| miss.frames).sum();
        let level = match missed {
            0 => OK,
            n if n < health.frames => WARN,
            _ => ERROR,
        };
        let message = format!("not measured in {missed} of {}", plural(health.frames, "frame"));
        let message = match missed {
            0 if misses.iter().any(|miss| miss.reason == no_base) => "the rig has no base frame".to_owned(),
            0 => "measured in all frames".to_owned(),
            _ => message,
        };
        all.push(one(what, level, message, misses.iter().map(|miss| value(&miss.reason, miss.frames)).collect()));
    }

    let mut values = Vec::new();
    for alarm in &health.drifts {
        values.push(value(&format!("{} since_ns", alarm.kind), alarm.stamp_ns));
        values.push(value(&format!("{} size_m", alarm.kind), alarm.size_m));
        values.extend(alarm.over_ns.map(|ns| value(&format!("{} over_ns", alarm.kind), ns)));
    }
    let (level, message) = match (health.drifts.iter().rfind(|alarm| alarm.over_ns.is_none()), health.drifts.len()) {
        (Some(alarm), _) => (ERROR, alarm.what.clone()),
        (None, 0) => (OK, "as calibrated".to_owned()),
        (None, n) => (OK, format!("as calibrated again, after {}", plural(n as u64, "drift alarm"))),
    };
    all.push(one("drift", level, message, values));
    all
}

fn one(name: &str, level: u8, message: String, values: Vec<KeyValue>) -> DiagnosticStatus {
    DiagnosticStatus { level, name: format!("catoptra: {name}"), message, hardware_id: "catoptra".to_owned(), values }
}

fn value(key: &str, value: impl ToString) -> KeyValue {
    KeyValue { key: key.to_owned(), value: value.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::schema::messages::{DriftAlarm, MissCount};

    #[test]
    fn a_rig_without_a_base_frame_misses_no_deflection() {
        let miss =
            |reason: &str, frames| MissCount { what: "deflection".to_owned(), reason: reason.to_owned(), frames };
        let deflection = |misses| {
            let health = Health { frames: 100, misses, ..Health::default() };
            let found = status(&health, &[]).into_iter().find(|status| status.name == "catoptra: deflection").unwrap();
            (found.level, found.message)
        };
        assert_eq!(deflection(vec![]), (OK, "measured in all frames".to_owned()));
        assert_eq!(deflection(vec![miss("no_base_frame", 100)]), (OK, "the rig has no base frame".to_owned()));
        let both = vec![miss("no_base_frame", 90), miss("marker_missing", 10)];
        assert_eq!(deflection(both), (WARN, "not measured in 10 of 100 frames".to_owned()));
    }

    #[test]
    fn drift_is_an_error_until_it_is_over() {
        let alarm = |kind: &str, over_ns| DriftAlarm {
            seq: 0,
            stamp_ns: 1,
            kind: kind.to_owned(),
            what: kind.to_owned(),
            view: String::new(),
            size_px: None,
            sd_px: None,
            size_m: 1e-3,
            sd_m: None,
            over_ns,
        };
        let drift = |drifts| {
            let found = status(&Health { drifts, ..Health::default() }, &[]).pop().unwrap();
            (found.level, found.message, found.values.last().map(|v| format!("{} {}", v.key, v.value)))
        };
        let both = drift(vec![alarm("views_disagree", None), alarm("base_moved", Some(9))]);
        assert_eq!((both.0, both.1.as_str()), (ERROR, "views_disagree"));
        let (level, message, last) = drift(vec![alarm("base_moved", Some(9))]);
        assert_eq!((level, message.as_str()), (OK, "as calibrated again, after 1 drift alarm"));
        assert_eq!(last.as_deref(), Some("base_moved over_ns 9"));
    }
}
