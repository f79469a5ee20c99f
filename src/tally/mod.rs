//! The one count of a run: how many frames were measured, how well, why the others were not, and whether the rig is
//! still as it was calibrated.
//!
//! Whatever drives a run counts every frame once, in order ([`Tally::add`]); the summary on the terminal, the status
//! line, the report and `/health` are views of it. Counts and ranges are exact; medians need 4 bytes per frame and
//! quantity, so that an hour at 60 Hz with three markers takes 4 MB. [`Totals`] are only the counts, small enough to
//! pass on every second.

pub mod budget;
mod drift;

pub use drift::{Drift, DriftAlarm, Drifted};

use crate::estimate::{Estimate, Miss, Spot, Tick};
use crate::median::median;
use crate::rig::Rig;
use crate::source::times::seconds;

/// Camera time between reports of the totals.
const REPORT_EVERY_NS: u64 = 1_000_000_000;

/// Why frames are missing in a log that is tracked again.
pub(crate) const MISSING_OF_LOG: &str = "lost by the camera, or not in the log";

/// The count of a run.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    /// Frames received.
    pub frames: u64,
    /// Frames in which every marker has a position, and the angle is known if the rig has a base frame.
    pub complete: u64,
    /// Places where camera frames were lost.
    pub gaps: u64,
    /// Camera frames lost there.
    pub lost: u64,
    /// Camera time of the first frame, nanoseconds.
    pub first_ns: i64,
    /// Camera time of the last frame, nanoseconds.
    pub last_ns: i64,
    /// Name of the camera's clock.
    pub clock: &'static str,
    /// One entry per marker, in the rig's order.
    pub markers: Vec<MarkerTally>,
    /// Deflection θ.
    pub theta: AngleTally,
    /// Direction of the coil; its range is not kept.
    pub tangent: AngleTally,
    /// The lamp that shows commands; `None` where none is watched.
    pub ticks: Option<TickTally>,
    /// In order of first occurrence, including that the rig has no base frame.
    misses: Vec<MissCount>,
    /// Camera time of the last report of the totals, nanoseconds.
    reported_ns: Option<i64>,
    /// Whether the rig is still as it was calibrated.
    pub drift: Drift,
    moments: budget::BudgetData,
    views: Vec<String>,
}

/// How often one quantity was missed for one reason.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct MissCount {
    /// A marker's name, `tangent` or `deflection`.
    pub what: String,
    /// The word for the reason ([`Miss::word`]).
    pub reason: String,
    /// How many frames.
    pub frames: u64,
}

/// The counts of a run at one moment.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Totals {
    /// Camera time of the last frame counted, nanoseconds.
    pub stamp_ns: i64,
    /// Frames received.
    pub frames: u64,
    /// Camera frames lost.
    pub lost: u64,
    /// Places where they were lost.
    pub gaps: u64,
    /// Frames with a deflection.
    pub deflections: u64,
    /// What was missing and why, in order of first occurrence.
    pub misses: Vec<MissCount>,
    /// All drift alarms.
    pub alarms: Vec<DriftAlarm>,
}

/// What is missing in a frame, as (what, reason): a marker's name, `tangent` or `deflection`, and the word for the
/// reason. That a rig has no base frame does not count as a miss of a frame.
pub(crate) fn missing(estimate: &Estimate, markers: &[String], views: &[String]) -> Vec<(String, String)> {
    let views: Vec<&str> = views.iter().map(String::as_str).collect();
    let known = |(_, miss): &(&str, &Miss)| **miss != Miss::NoBaseFrame;
    let named = |(what, miss): (&str, &Miss)| (what.to_owned(), miss.word(&views));
    all_misses(estimate, markers.iter().map(String::as_str)).filter(known).map(named).collect()
}

fn all_misses<'a>(
    estimate: &'a Estimate,
    markers: impl Iterator<Item = &'a str>,
) -> impl Iterator<Item = (&'a str, &'a Miss)> {
    let positions = estimate.markers.iter().zip(markers);
    let positions = positions.filter_map(|(m, name)| Some((name, m.position.as_ref().err()?)));
    let tangent = estimate.tangent.as_ref().err().map(|miss| ("tangent", miss));
    let angle = estimate.deflection.as_ref().err().map(|miss| ("deflection", miss));
    positions.chain(tangent).chain(angle)
}

/// A drift alarm for people.
#[derive(Debug, Clone, PartialEq)]
pub struct AlarmInWords {
    /// Camera time, nanoseconds.
    pub ns: i64,
    /// When it was over; `None` while it lasts.
    pub over_ns: Option<i64>,
    /// What is wrong, or was.
    pub what: String,
    /// What it means and what to do.
    pub advice: &'static str,
}

/// One marker.
#[derive(Debug, Default, Clone)]
pub struct MarkerTally {
    /// Its name.
    pub name: String,
    /// Frames with a position.
    pub answered: u64,
    /// σ of a coordinate in every answered frame, mm: f32 keeps an hour of 60 Hz below 1 MB.
    sd_mm: Vec<f32>,
    /// One entry per view, in the rig's order.
    pub views: Vec<ViewTally>,
}

/// One marker in one view.
#[derive(Debug, Default, Clone)]
pub struct ViewTally {
    /// Frames in which it was seen.
    pub seen: u64,
    /// Frames with a residual: the marker was seen here and has a position.
    fitted: u64,
    sum_px: [f64; 2],
    sum_squares_px2: f64,
    /// Frames with a colour separation, and their sum.
    separated: u64,
    sum_separation: f64,
    /// Smallest colour separation.
    pub least_separation: Option<f64>,
    /// Frames with a width, and their sum.
    measured: u64,
    sum_width: f64,
}

/// An angle.
#[derive(Debug, Default, Clone)]
pub struct AngleTally {
    /// Frames in which it is known.
    pub answered: u64,
    sd_deg: Vec<f32>,
    /// Smallest and largest, degrees.
    pub range_deg: Option<(f64, f64)>,
}

/// A lamp that shows commands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TickTally {
    /// Frames in which it was seen.
    pub seen: u64,
    /// How often it changed.
    pub changes: u64,
    /// Least and greatest brightness, stored units.
    pub level: (f64, f64),
    /// The last frame's.
    last: Tick,
}

impl TickTally {
    fn first(tick: Tick) -> Self {
        Self { seen: 0, changes: 0, level: (tick.level, tick.level), last: tick }
    }

    fn add(&mut self, tick: Tick) {
        self.seen += 1;
        self.changes += u64::from(tick.count != self.last.count);
        self.level = (self.level.0.min(tick.level), self.level.1.max(tick.level));
        self.last = tick;
    }

    /// Where the lamp is.
    pub fn spot(&self) -> Spot {
        self.last.spot
    }
}

impl Tally {
    /// The tally of a run with this rig, before its first frame.
    pub fn new(rig: &Rig) -> Self {
        let views = vec![ViewTally::default(); rig.views.len()];
        let marker = |name: &str| MarkerTally { name: name.to_owned(), views: views.clone(), ..MarkerTally::default() };
        Self {
            markers: rig.markers.iter().map(|m| marker(&m.name)).collect(),
            views: rig.views.iter().map(|v| v.name.clone()).collect(),
            drift: Drift::new(rig),
            moments: budget::BudgetData::new(rig),
            ..Self::default()
        }
    }

    /// Counts a frame. Returns whether to report the totals now: a second of camera time has passed since the last
    /// report, or a drift alarm is raised.
    pub fn add(&mut self, estimate: &Estimate) -> bool {
        if self.frames == 0 {
            self.first_ns = estimate.stamp.ns;
            self.clock = estimate.stamp.clock.name();
        }
        self.frames += 1;
        self.last_ns = estimate.stamp.ns;
        self.gaps += u64::from(estimate.gap > 0);
        self.lost += u64::from(estimate.gap);
        for (total, marker) in self.markers.iter_mut().zip(&estimate.markers) {
            if let Ok(position) = &marker.position {
                total.answered += 1;
                push_finite(&mut total.sd_mm, position.sd_m() * 1e3);
            }
            for (total, view) in total.views.iter_mut().zip(&marker.views) {
                let Ok(band) = view else { continue };
                total.seen += 1;
                if band.separation.is_finite() {
                    total.separated += 1;
                    total.sum_separation += band.separation;
                    let least = total.least_separation.map_or(band.separation, |l| l.min(band.separation));
                    total.least_separation = Some(least);
                }
                if band.width.is_finite() {
                    total.measured += 1;
                    total.sum_width += band.width;
                }
                let residual = band.residual_px;
                if marker.position.is_ok() && residual.iter().all(|v| v.is_finite()) {
                    total.fitted += 1;
                    total.sum_px = [total.sum_px[0] + residual.x, total.sum_px[1] + residual.y];
                    total.sum_squares_px2 += residual.norm_squared();
                }
            }
        }
        if let Ok(tangent) = &estimate.tangent {
            self.tangent.answered += 1;
            push_finite(&mut self.tangent.sd_deg, tangent.sd_rad().to_degrees());
        }
        if let Ok(deflection) = &estimate.deflection {
            self.theta.answered += 1;
            push_finite(&mut self.theta.sd_deg, deflection.theta_sd_rad.to_degrees());
            let theta = deflection.theta_rad.to_degrees();
            if theta.is_finite() {
                let (low, high) = self.theta.range_deg.unwrap_or((theta, theta));
                self.theta.range_deg = Some((low.min(theta), high.max(theta)));
            }
        }
        if let Some(tick) = estimate.tick {
            self.ticks.get_or_insert_with(|| TickTally::first(tick)).add(tick);
        }
        self.moments.add(estimate);
        let alarmed = !self.drift.add(estimate).is_empty();
        let angle_known = matches!(estimate.deflection, Ok(_) | Err(Miss::NoBaseFrame));
        self.complete += u64::from(angle_known && estimate.markers.iter().all(|m| m.position.is_ok()));
        self.count_misses(estimate);
        let since = *self.reported_ns.get_or_insert(estimate.stamp.ns);
        let due = alarmed || estimate.stamp.ns.abs_diff(since) >= REPORT_EVERY_NS;
        if due {
            self.reported_ns = Some(estimate.stamp.ns);
        }
        due
    }

    /// The run is over: judges whether the rig is still as it was calibrated, if it was too short for that before.
    pub fn end(&mut self) {
        self.drift.end();
    }

    fn count_misses(&mut self, estimate: &Estimate) {
        let Self { views, markers, misses, .. } = self;
        let views: Vec<&str> = views.iter().map(String::as_str).collect();
        for (what, miss) in all_misses(estimate, markers.iter().map(|marker| marker.name.as_str())) {
            let reason = miss.word(&views);
            match misses.iter_mut().find(|known| known.what == what && known.reason == reason) {
                Some(known) => known.frames += 1,
                None => misses.push(MissCount { what: what.to_owned(), reason, frames: 1 }),
            }
        }
    }

    /// The contribution of each source of error to θ and to the tip in the base frame; `None` without a base frame or a
    /// measurement.
    pub fn budget(&self) -> Option<Vec<budget::Contribution>> {
        let tip = self.markers.get(self.moments.tip()).and_then(MarkerTally::median_sd_mm);
        let noise = self.theta.median_sd_deg().zip(tip).map(|(deg, mm)| (deg.to_radians(), mm * 1e-3));
        self.moments.budget(noise, self.clock)
    }

    /// The counts so far.
    pub fn totals(&self) -> Totals {
        Totals {
            stamp_ns: self.last_ns,
            frames: self.frames,
            lost: self.lost,
            gaps: self.gaps,
            deflections: self.theta.answered,
            misses: self.misses.clone(),
            alarms: self.drift.alarms().to_vec(),
        }
    }

    /// What is missing and why, by name. That the rig has no base frame does not count as a miss of a frame.
    pub fn misses(&self) -> Vec<&MissCount> {
        let no_base = Miss::NoBaseFrame.word(&[]);
        let mut misses: Vec<_> = self.misses.iter().filter(|miss| miss.reason != no_base).collect();
        misses.sort();
        misses
    }

    /// The alarms of [`Tally::drift`] in words.
    pub fn alarms(&self) -> impl Iterator<Item = AlarmInWords> {
        let views: Vec<&str> = self.views.iter().map(String::as_str).collect();
        self.drift.alarms().iter().map(move |alarm| AlarmInWords {
            ns: alarm.stamp.ns,
            over_ns: alarm.over.map(|stamp| stamp.ns),
            what: alarm.words(&views),
            advice: alarm.advice(),
        })
    }

    /// Reasons why `what` is missing, with the number of frames, the most frequent first.
    pub fn reasons(&self, what: &str) -> Vec<(&str, u64)> {
        let of_it = self.misses().into_iter().filter(|miss| miss.what == what);
        let mut reasons: Vec<_> = of_it.map(|miss| (miss.reason.as_str(), miss.frames)).collect();
        reasons.sort_by_key(|(_, frames)| std::cmp::Reverse(*frames));
        reasons
    }

    /// Frames that were skipped because the tracker did not keep up.
    pub fn skipped(&self) -> u64 {
        let overload = Miss::SkippedOverload.word(&[]);
        self.reasons("tangent").into_iter().find(|(word, _)| *word == overload).map_or(0, |(_, frames)| frames)
    }

    /// Camera time from the first frame to the last, seconds.
    pub fn duration_s(&self) -> f64 {
        seconds(self.last_ns.saturating_sub(self.first_ns))
    }

    /// Frames per second over the whole run, including those lost by the camera.
    pub fn rate_hz(&self) -> Option<f64> {
        let duration_s = self.duration_s();
        (self.frames > 1 && duration_s > 0.0).then(|| (self.frames - 1 + self.lost) as f64 / duration_s)
    }
}

impl MarkerTally {
    /// Median σ of a coordinate, mm.
    pub fn median_sd_mm(&self) -> Option<f64> {
        median(self.sd_mm.iter().copied().map(f64::from))
    }
}

impl AngleTally {
    /// Median σ, degrees.
    pub fn median_sd_deg(&self) -> Option<f64> {
        median(self.sd_deg.iter().copied().map(f64::from))
    }
}

impl ViewTally {
    /// RMS residual of one pixel coordinate.
    pub fn rms_px(&self) -> Option<f64> {
        (self.fitted > 0).then(|| (self.sum_squares_px2 / (2 * self.fitted) as f64).sqrt())
    }

    /// Mean residual in u and v, pixels: what does not average out.
    pub fn mean_px(&self) -> Option<[f64; 2]> {
        (self.fitted > 0).then(|| self.sum_px.map(|s| s / self.fitted as f64))
    }

    /// Mean colour separation.
    pub fn mean_separation(&self) -> Option<f64> {
        (self.separated > 0).then(|| self.sum_separation / self.separated as f64)
    }

    /// Mean width over that of a tube of the rig's diameter.
    pub fn mean_width(&self) -> Option<f64> {
        (self.measured > 0).then(|| self.sum_width / self.measured as f64)
    }
}

fn push_finite(list: &mut Vec<f32>, value: f64) {
    if value.is_finite() {
        list.push(value as f32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    #[test]
    fn totals_are_due_every_second_and_count_everything() {
        let mut tally = Tally::new(&fixture::rig());
        let mut due = (0..150).filter(|&seq| tally.add(&fixture::eventful(seq, -500_000_000)));
        // 60 frames per second less the 3 lost before frame 40.
        assert_eq!(due.by_ref().map(|seq| seq + 1).collect::<Vec<_>>(), [58, 118]);
        let totals = tally.totals();
        assert_eq!((totals.frames, totals.lost, totals.gaps, totals.deflections), (150, 3, 1, 120));
        let count = |what: &str, reason: &str| {
            totals.misses.iter().find(|m| m.what == what && m.reason == reason).map_or(0, |m| m.frames)
        };
        assert_eq!(count("tip", "not_seen_mirror"), 15);
        assert_eq!(count("coil", "ambiguous"), 15);
        assert_eq!(count("base", "rays_diverge"), 15);
        assert_eq!(count("tangent", "poor_fit"), 15);
        assert_eq!(count("tangent", "marker_missing"), 15);
        assert_eq!(count("deflection", "marker_missing"), 30);
        assert_eq!(totals.misses.len(), 6);
        assert_eq!(totals.alarms, []);
    }

    #[test]
    fn totals_are_due_at_once_when_views_part() {
        let mut tally = Tally::new(&fixture::rig());
        let due: Vec<u64> = (0..80)
            .filter(|&seq| {
                let mut estimate = fixture::complete(seq, seq as i64 * 8_333_333);
                for band in estimate.markers.iter_mut().flat_map(|m| &mut m.views).flatten() {
                    band.residual_px.x = 1.0;
                }
                tally.add(&estimate)
            })
            .collect();
        // Half a second into the run.
        assert_eq!(due, [59]);
        let alarms = tally.totals().alarms;
        assert_eq!((alarms.len(), alarms[0].seq, alarms[0].stamp.ns), (1, 59, 59 * 8_333_333));
    }

    #[test]
    fn a_rig_without_a_base_is_no_miss_of_a_frame() {
        let mut tally = Tally::new(&fixture::rig());
        let mut estimate = fixture::complete(0, 0);
        estimate.deflection = Err(Miss::NoBaseFrame);
        tally.add(&estimate);
        assert!(tally.misses().is_empty() && tally.complete == 1);
        assert_eq!(tally.totals().misses.len(), 1);
    }

    #[test]
    fn residuals_are_per_coordinate() {
        let view = ViewTally { fitted: 2, sum_px: [0.2, -0.4], sum_squares_px2: 4.0 * 0.09, ..ViewTally::default() };
        assert!((view.rms_px().unwrap() - 0.3).abs() < 1e-12);
        assert_eq!(view.mean_px(), Some([0.1, -0.2]));
    }
}
