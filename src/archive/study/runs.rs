//! The table of runs.

use super::{FRAME, Run};
use crate::archive::Measured;
use crate::archive::tables::Cells;
use std::collections::BTreeSet;

/// The columns of the table of runs that are not a manifest's. Date and duration of runs are not included: the same
/// archive gives the same table.
pub(super) fn own_columns(runs: &[Run]) -> Vec<(String, Cells)> {
    let text = |name: &str, get: &dyn Fn(&Run) -> Option<String>| {
        (name.to_owned(), Cells::Text(runs.iter().map(get).collect()))
    };
    let whole = |name: &str, get: &dyn Fn(&Measured) -> Option<u64>| {
        let cell = |run: &Run| get(run.summary.measured.as_ref()?).and_then(|n| i64::try_from(n).ok());
        (name.to_owned(), Cells::Whole(runs.iter().map(cell).collect()))
    };
    let real = |name: &str, get: &dyn Fn(&Measured) -> Option<f64>| {
        let cell = |run: &Run| get(run.summary.measured.as_ref()?).filter(|value| value.is_finite());
        (name.to_owned(), Cells::Real(runs.iter().map(cell).collect()))
    };
    let stamp = |name: &str, get: &dyn Fn(&Measured) -> i64| {
        let cell = |run: &Run| run.summary.measured.as_ref().map(get);
        (name.to_owned(), Cells::Whole(runs.iter().map(cell).collect()))
    };
    let failed = |run: &Run| run.summary.failure.clone();
    let retryable = Cells::Flag(runs.iter().map(|run| failed(run).map(|failure| failure.retryable)).collect());
    let options = |run: &Run| {
        let words = run.summary.options.iter().map(|(name, value)| format!("{name}={value}"));
        Some(words.collect::<Vec<_>>().join(" "))
    };
    let warnings = |run: &Run| i64::try_from(run.summary.warnings.len() as u64 + run.summary.more_warnings).ok();
    let mut columns = vec![
        text("run", &|run| Some(run.name.clone())),
        text("outcome", &|run| Some(run.summary.outcome.word().to_owned())),
        text("failure", &|run| failed(run).map(|failure| failure.message)),
        ("retryable".to_owned(), retryable),
        text("ends_early", &|run| run.summary.ends_early.clone()),
        text("recording", &|run| Some(run.summary.recording.clone())),
        text("rig", &|run| Some(run.summary.rig.clone())),
        text(FRAME, &Run::frame),
        text("options", &options),
        text("recording_sha256", &|run| run.summary.sha256.recording.clone()),
        text("rig_sha256", &|run| run.summary.sha256.rig.clone()),
        text("program_sha256", &|run| run.summary.sha256.program.clone()),
        text("version", &|run| Some(run.summary.version.clone())),
        whole("frames", &|m| Some(m.frames)),
        whole("complete", &|m| Some(m.complete)),
        whole("lost", &|m| Some(m.lost)),
        whole("gaps", &|m| Some(m.gaps)),
        stamp("first_ns", &|m| m.first_ns),
        stamp("last_ns", &|m| m.last_ns),
        text("clock", &|run| run.summary.measured.as_ref().map(|m| m.clock.clone())),
        real("duration_s", &|m| Some(m.duration_s)),
        whole("theta_answered", &|m| Some(m.theta.answered)),
        real("theta_sd_deg", &|m| m.theta.sd_deg),
        real("theta_min_deg", &|m| m.theta.min_deg),
        real("theta_max_deg", &|m| m.theta.max_deg),
        whole("tangent_answered", &|m| Some(m.tangent.answered)),
        real("tangent_sd_deg", &|m| m.tangent.sd_deg),
        real("residual_rms_px", &Measured::largest_rms_px),
        real("residual_mean_px", &Measured::largest_mean_px),
        whole("drift_alarms", &|m| Some(m.drift_alarms.len() as u64)),
        ("warnings".to_owned(), Cells::Whole(runs.iter().map(warnings).collect())),
        whole("damaged_packets", &|m| Some(m.faults.damaged_packets)),
        whole("damaged_pictures", &|m| Some(m.faults.damaged_pictures)),
    ];
    let measured = || runs.iter().filter_map(|run| run.summary.measured.as_ref());
    let markers: BTreeSet<&str> =
        measured().flat_map(|m| m.markers.iter().map(|marker| marker.name.as_str())).collect();
    for name in markers {
        let find = |m: &Measured| m.markers.iter().find(|marker| marker.name == name).cloned();
        columns.push(whole(&format!("{name}_answered"), &|m| Some(find(m)?.answered)));
        columns.push(real(&format!("{name}_sd_mm"), &|m| find(m)?.sd_mm));
    }
    let misses: BTreeSet<(&str, &str)> =
        measured().flat_map(|m| m.misses.iter().map(|miss| (miss.what.as_str(), miss.reason.as_str()))).collect();
    for (what, reason) in misses {
        let count = |m: &Measured| {
            Some(
                m.misses.iter().filter(|miss| miss.what == what && miss.reason == reason).map(|miss| miss.frames).sum(),
            )
        };
        columns.push(whole(&format!("missed_{what}_{reason}"), &count));
    }
    columns
}
