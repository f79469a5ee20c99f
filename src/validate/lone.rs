//! Single frames that show something else than the marker.
//!
//! In: places over time. Out: frames that are far from both frames beside them, while these are near each other. A
//! motion that starts or stops suddenly does not do that.
//!
//! What it cannot detect: several wrong frames in a row.

use super::pauses::Sample;
use crate::source::times::seconds;

/// A frame lies alone if it is farther from both neighbours than this many times their own distance,
const FARTHER: f64 = 3.0;
/// and than this many times the usual distance from frame to frame.
const USUAL: f64 = 10.0;

/// Frames that lie alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lone {
    /// How many.
    pub(super) count: usize,
    /// Of how many.
    pub(super) of: usize,
    /// Camera time of the first, nanoseconds.
    pub(super) first_ns: i64,
    /// Largest distance from the nearer neighbour, metres.
    pub(super) farthest_m: f64,
    /// Mean of these distances over all frames, metres: about what they may add to the size of the motion.
    pub(super) mean_m: f64,
}

/// Those of `samples`, which follow each other in time.
pub(super) fn lone(samples: &[Sample]) -> Option<Lone> {
    let steps = samples.iter().zip(samples.iter().skip(1)).map(|((_, a), (_, b))| (b - a).norm());
    let usual_m = crate::median::median(steps)?;
    let alone = samples.windows(3).filter_map(|three| {
        let [(_, before), (stamp_ns, place), (_, after)] = three else { return None };
        let off_m = (place - before).norm().min((place - after).norm());
        let apart_m = (after - before).norm();
        (off_m > FARTHER * apart_m && off_m > USUAL * usual_m).then_some((*stamp_ns, off_m))
    });
    let all: Vec<(i64, f64)> = alone.collect();
    let (first_ns, _) = *all.first()?;
    let farthest_m = all.iter().map(|(_, off_m)| *off_m).fold(0.0, f64::max);
    let mean_m = all.iter().map(|(_, off_m)| off_m).sum::<f64>() / samples.len() as f64;
    Some(Lone { count: all.len(), of: samples.len(), first_ns, farthest_m, mean_m })
}

impl Lone {
    /// For the reader; `without_sd`: magnitude and phase have no σ for them.
    pub(super) fn note(&self, without_sd: bool) -> String {
        format!(
            "{} of {} frames lie alone, up to {:.1} mm from both beside them, the first at {:.3} s: that is not the \
             marker's motion; veto them{}",
            self.count,
            self.of,
            self.farthest_m * 1e3,
            seconds(self.first_ns),
            if without_sd { ". Magnitude and phase have no σ, since they are off by more than that" } else { "" }
        )
    }
}
