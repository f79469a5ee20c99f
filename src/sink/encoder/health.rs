//! `catoptra.Health`: the totals of a run as a message.

use super::convert::Names;
use crate::log::schema::messages::{Health, MissCount};
use crate::sink::PictureCount;
use crate::tally::Totals;

/// The message, with the counts of pictures if any are recorded.
pub(super) fn health(names: &Names, totals: &Totals, pictures: Option<&PictureCount>) -> Health {
    let miss = |miss: &crate::tally::MissCount| MissCount {
        what: miss.what.clone(),
        reason: miss.reason.clone(),
        frames: miss.frames,
    };
    Health {
        stamp_ns: totals.stamp_ns,
        frames: totals.frames,
        lost_frames: totals.lost,
        gaps: totals.gaps,
        deflections: totals.deflections,
        misses: totals.misses.iter().map(miss).collect(),
        drifts: totals.alarms.iter().map(|alarm| names.drift(alarm)).collect(),
        pictures_recorded: pictures.map(PictureCount::recorded),
        pictures_dropped: pictures.map(PictureCount::dropped),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tally::Tally;
    use crate::testing::fixture;

    #[test]
    fn a_message_has_all_the_counts_and_alarms() {
        let rig = fixture::rig();
        let mut tally = Tally::new(&rig);
        for seq in 0..80 {
            let mut estimate = fixture::eventful(seq, -500_000_000);
            for band in estimate.markers.iter_mut().flat_map(|m| &mut m.views).flatten() {
                band.residual_px.x = 1.0;
            }
            tally.add(&estimate);
        }
        let pictures = PictureCount::default();
        pictures.add_recorded();
        let message = health(&Names::new(&rig), &tally.totals(), Some(&pictures));
        assert_eq!((message.frames, message.lost_frames, message.gaps, message.deflections), (80, 3, 1, 64));
        assert_eq!((message.pictures_recorded, message.pictures_dropped), (Some(1), Some(0)));
        let count = |what: &str, reason: &str| {
            message.misses.iter().find(|m| m.what == what && m.reason == reason).map_or(0, |m| m.frames)
        };
        assert_eq!((count("tip", "not_seen_mirror"), count("deflection", "marker_missing")), (8, 16));
        assert_eq!((message.drifts.len(), message.drifts[0].view.as_str()), (1, "direct"));
        assert!((message.drifts[0].size_px.unwrap() - 2.0).abs() < 0.01, "{:?}", message.drifts);
    }
}
