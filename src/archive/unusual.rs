//! Runs that stand out, by their events or compared with other runs with the same rig.

use super::study::Study;
use super::{Measured, Outcome};
use crate::median::{SD_PER_MEDIAN_DEVIATION, median};
use crate::plural::plural;
use std::collections::BTreeMap;

/// A run that stands out, and why.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct UnusualRun {
    /// Its number in the study.
    pub(crate) run: usize,
    pub(crate) why: Vec<String>,
}

/// Fewest runs with the same rig that define what is usual.
const MIN_RUNS: usize = 5;
/// Distance from the median, in robust standard deviations, beyond which a run is unusual.
const UNUSUAL_SD: f64 = 5.0;

/// A quantity to compare: name, unit, digits, smallest relevant difference, value; and whether small values also stand
/// out.
type Compared = (&'static str, &'static str, usize, f64, fn(&Measured) -> Option<f64>, bool);

const COMPARED: [Compared; 6] = [
    ("σ of θ", "°", 3, 0.01, |m| m.theta.sd_deg, false),
    ("frames without θ", " %", 1, 1.0, missed_percent, false),
    ("RMS residual", " px", 3, 0.02, Measured::largest_rms_px, false),
    ("mean residual", " px", 3, 0.02, Measured::largest_mean_px, false),
    ("largest θ", "°", 1, 1.0, |m| m.theta.max_deg, true),
    ("smallest θ", "°", 1, 1.0, |m| m.theta.min_deg, true),
];

/// Missed frames in percent of all.
pub(crate) fn missed_percent(measured: &Measured) -> Option<f64> {
    let frames = measured.frames as f64;
    (frames > 0.0).then(|| 100.0 * (frames - measured.theta.answered as f64) / frames)
}

/// Runs that stand out, by their events or compared with other runs with the same rig. Failed runs are not included:
/// they have nothing to compare.
pub(crate) fn unusual_runs(study: &Study) -> Vec<UnusualRun> {
    let mut found: BTreeMap<usize, Vec<String>> = BTreeMap::new();
    let mut rigs: BTreeMap<&Option<String>, Vec<(usize, &Measured)>> = BTreeMap::new();
    for (at, run) in study.runs.iter().enumerate() {
        let summary = &run.summary;
        let Some(measured) = summary.measured.as_ref().filter(|_| summary.outcome == Outcome::Tracked) else {
            continue;
        };
        let (lasting, over) = measured.alarms_lasting_and_over();
        let counted = [
            (lasting, "drift alarm", ""),
            (over, "drift alarm", " that ended"),
            (measured.lost, "camera frame", " lost"),
            (measured.faults.damaged_packets, "damaged packet", ""),
            (measured.faults.damaged_pictures, "damaged picture", ""),
        ];
        let counted = counted.into_iter().filter(|(count, ..)| *count > 0);
        let mut why: Vec<String> = counted.map(|(count, what, how)| plural(count, what) + how).collect();
        why.extend(summary.ends_early.is_some().then(|| "ends early".to_owned()));
        if !why.is_empty() {
            found.entry(at).or_default().extend(why);
        }
        rigs.entry(&summary.sha256.rig).or_default().push((at, measured));
    }
    for runs in rigs.values().filter(|runs| runs.len() >= MIN_RUNS) {
        for (name, unit, digits, least, value, both) in COMPARED {
            let values: Vec<(usize, f64)> =
                runs.iter().filter_map(|(at, m)| Some((*at, value(m)?))).filter(|(_, v)| v.is_finite()).collect();
            let middle = median(values.iter().map(|(_, v)| *v)).unwrap_or(0.0);
            let deviation = median(values.iter().map(|(_, v)| (v - middle).abs())).unwrap_or(0.0);
            let limit = (UNUSUAL_SD * (SD_PER_MEDIAN_DEVIATION * deviation)).max(least);
            for (at, v) in values {
                if v - middle > limit || both && middle - v > limit {
                    let why = format!("{name} {v:.digits$}{unit}, usual {middle:.digits$}{unit}");
                    found.entry(at).or_default().push(why);
                }
            }
        }
    }
    found.into_iter().map(|(run, why)| UnusualRun { run, why }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::study::Run;
    use crate::archive::{Alarm, RunSummary};

    fn study(sds_deg: &[f64]) -> Study {
        let run = |sd: &f64| {
            let mut summary = RunSummary::example();
            let measured = summary.measured.as_mut().unwrap();
            measured.theta.sd_deg = Some(*sd);
            Run { name: "a".into(), folder: "a".into(), summary }
        };
        Study { runs: sds_deg.iter().map(run).collect(), ..Study::default() }
    }

    #[test]
    fn a_run_unlike_the_others_with_its_rig_stands_out() {
        let mut study = study(&[0.10, 0.11, 0.105, 0.10, 0.30, 0.107]);
        let found = unusual_runs(&study);
        assert_eq!(found, [UnusualRun { run: 4, why: vec!["σ of θ 0.300°, usual 0.106°".to_owned()] }]);
        // With another rig there is nothing to compare it with.
        study.runs[4].summary.sha256.rig = Some("other".to_owned());
        assert_eq!(unusual_runs(&study), []);
    }

    #[test]
    fn an_alarm_and_an_early_end_stand_out_alone_and_a_failed_run_does_not() {
        let mut study = study(&[0.1, 0.1, 9.0]);
        let alarm = Alarm { kind: "base_moved".into(), at_ns: 3, over_ns: None, size_mm: 1.0, message: "moved".into() };
        let over = Alarm { over_ns: Some(5), ..alarm.clone() };
        study.runs[0].summary.measured.as_mut().unwrap().drift_alarms.extend([alarm, over]);
        study.runs[1].summary.ends_early = Some("cut off".into());
        study.runs[2].summary.outcome = Outcome::Failed;
        study.runs[2].summary.ends_early = Some("cut off".into());
        let found: Vec<_> = unusual_runs(&study).into_iter().map(|o| (o.run, o.why.join(","))).collect();
        assert_eq!(found, [(0, "1 drift alarm,1 drift alarm that ended".to_owned()), (1, "ends early".to_owned())]);
    }
}
