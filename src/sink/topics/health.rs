//! Totals of a run: frames, losses, misses by reason and whether the rig is still as it was calibrated, told once a second of camera time.

use super::convert::Names;
use super::messages::{Health, MissCount};
use crate::estimate::{Estimate, Miss};
use crate::rig::Rig;
use crate::sink::PictureCount;
use crate::tally::Drift;
use std::sync::Arc;

/// Camera time between two reports.
const EVERY_NS: u64 = 1_000_000_000;

/// Counts the frames of a run.
#[derive(Debug, Default)]
pub(super) struct Tally {
    totals: Health,
    reported_ns: Option<i64>,
    drift: Drift,
    pictures: Option<Arc<PictureCount>>,
}

impl Tally {
    /// For runs with this rig.
    pub(super) fn new(rig: &Rig) -> Self {
        Self { drift: Drift::new(rig), ..Self::default() }
    }

    /// Counts a frame; the totals when a second has passed since they were told, or when a drift alarm is raised.
    pub(super) fn count(&mut self, names: &Names, estimate: &Estimate) -> Option<&Health> {
        let stamp_ns = estimate.stamp.ns;
        self.totals.stamp_ns = stamp_ns;
        self.totals.frames += 1;
        self.totals.lost_frames += u64::from(estimate.gap);
        self.totals.gaps += u64::from(estimate.gap > 0);
        self.totals.deflections += u64::from(estimate.deflection.is_ok());
        for (index, marker) in estimate.markers.iter().enumerate() {
            self.miss(&names.marker(index), names, &marker.position);
        }
        self.miss("tangent", names, &estimate.tangent);
        self.miss("deflection", names, &estimate.deflection);

        let alarmed = !self.drift.add(estimate).is_empty();
        self.totals.drifts = self.drift.alarms().iter().map(|alarm| names.drift(alarm)).collect();

        self.count_now();
        let since = *self.reported_ns.get_or_insert(stamp_ns);
        (alarmed || stamp_ns.abs_diff(since) >= EVERY_NS).then(|| {
            self.reported_ns = Some(stamp_ns);
            &self.totals
        })
    }

    /// Pictures are recorded too, and counted there.
    pub(super) fn count_pictures(&mut self, count: Arc<PictureCount>) {
        self.pictures = Some(count);
    }

    fn count_now(&mut self) {
        if let Some(pictures) = &self.pictures {
            self.totals.pictures_recorded = Some(pictures.recorded());
            self.totals.pictures_dropped = Some(pictures.dropped());
        }
    }

    /// The totals so far.
    pub(super) fn totals(&mut self) -> &Health {
        self.count_now();
        &self.totals
    }

    fn miss<T>(&mut self, what: &str, names: &Names, result: &Result<T, Miss>) {
        if result.is_ok() {
            return;
        }
        let reason = names.word(result);
        match self.totals.misses.iter_mut().find(|m| m.what == what && m.reason == reason) {
            Some(known) => known.frames += 1,
            None => self.totals.misses.push(MissCount { what: what.to_owned(), reason, frames: 1 }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    #[test]
    fn totals_are_told_every_second_and_count_everything() {
        let names = Names::new(&fixture::rig());
        let mut tally = Tally::new(&fixture::rig());
        let told: Vec<u64> = (0..150)
            .filter_map(|seq| tally.count(&names, &fixture::eventful(seq, -500_000_000)).map(|h| h.frames))
            .collect();
        // 60 frames a second less the 3 lost before frame 40.
        assert_eq!(told, [58, 118]);
        let totals = tally.totals();
        assert_eq!((totals.frames, totals.lost_frames, totals.gaps, totals.deflections), (150, 3, 1, 120));
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
        assert_eq!(totals.drifts, []);
    }

    #[test]
    fn views_that_part_are_told_at_once() {
        let names = Names::new(&fixture::rig());
        let mut tally = Tally::new(&fixture::rig());
        let mut told = (0..80).filter_map(|seq| {
            let mut estimate = fixture::complete(seq, seq as i64 * 8_333_333);
            for band in estimate.markers.iter_mut().flat_map(|m| &mut m.views).flatten() {
                band.residual_px.x = 1.0;
            }
            tally.count(&names, &estimate).cloned()
        });
        // Half a second into the run.
        let health = told.next().unwrap();
        assert_eq!((health.frames, health.drifts.len(), health.drifts[0].view.as_str()), (60, 1, "direct"));
        assert!((health.drifts[0].size_px.unwrap() - 2.0).abs() < 0.01, "{:?}", health.drifts);
        assert_eq!(health.drifts[0].stamp_ns, 59 * 8_333_333);
        assert_eq!(told.next(), None);
    }
}
