//! Totals of a run: frames, losses, and misses by reason, told once a second of camera time.

use super::convert::Names;
use super::messages::{Health, MissCount};
use crate::estimate::{Estimate, Miss};

/// Camera time between two reports.
const EVERY_NS: u64 = 1_000_000_000;

/// Counts the frames of a run.
#[derive(Debug, Default)]
pub(super) struct Tally {
    totals: Health,
    reported_ns: Option<i64>,
}

impl Tally {
    /// Counts a frame; the totals when a second has passed since they were told.
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

        let since = *self.reported_ns.get_or_insert(stamp_ns);
        (stamp_ns.abs_diff(since) >= EVERY_NS).then(|| {
            self.reported_ns = Some(stamp_ns);
            &self.totals
        })
    }

    /// The totals so far.
    pub(super) fn totals(&self) -> &Health {
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
    use crate::sink::fixture;

    #[test]
    fn totals_are_told_every_second_and_count_everything() {
        let names = Names::new(&fixture::rig());
        let mut tally = Tally::default();
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
    }
}
