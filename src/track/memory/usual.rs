//! Usual values for a band in a view, to notice when something is wrong: how well the image model fits its pictures,
//! and how large its blob is.
//!
//! An object in front of part of a band, or a coder that did not follow it, leaves residuals that the model cannot
//! explain, or shows less of the band, and shifts it by more than noise would. The logarithm of each quantity is
//! compared with those of earlier frames and their scatter. Residuals of a run's first frames are compared with those
//! that were learned with the rig, apart from a factor common to all bands and views: noise and coding differ between
//! recordings, an object in front of one band does not.
//!
//! Cannot detect: what looks like the band; and, with a rig that has no learned residuals, anything present from the
//! first frame on.

use crate::rig::Rig;
use crate::track::memory::by_band::ByBand;

/// Frames before a level is known, and frames to average over.
const MIN_FRAMES: f64 = 8.0;
/// Frames after which what is far beyond their mean is no chance, although its scatter is not known yet.
const FEW_FRAMES: f64 = 3.0;
const AVERAGED_FRAMES: f64 = 60.0;
/// Frames for which what was learned counts, at most, in a recording that has more noise: what lasts longer may be how
/// it is. Where some band looks as learned, what lasts on another is in front of it.
const COMPARED_FRAMES: u32 = 30;
/// ln of the factor by which all values may exceed what was learned in a recording without more noise.
const SAME_NOISE: f64 = 0.1;
/// Standard deviation of ln(residual) about what was learned.
pub(in crate::track) const LEARNED_SD: f64 = 0.12;
/// Least standard deviation assumed: 5 % or less is chance.
const MIN_SD: f64 = 0.05;
/// Largest standard deviation that can be usual. (A swing in H.264 at crf 28 scatters by 0.18, all else by less.
/// Without a limit what comes slowly becomes usual: each value that is just accepted makes the scatter larger, and the
/// next may exceed the mean by more.)
const MAX_SD: f64 = 0.2;
/// Values beyond this many standard deviations count as if they were there: what comes slowly, as an edge that a band
/// drifts towards, must not become usual by and by. (With 2, pictures blended with those before are refused when the
/// catheter begins to swing; with 2.8, a white edge that creeps by 0.06 pixels in each frame passes.)
const HELD_SD: f64 = 2.5;

#[derive(Debug, Clone, Copy, Default)]
struct Level {
    /// What was learned with the rig, and how often a value clearly exceeded it.
    learned: Option<f64>,
    compared: u32,
    frames: f64,
    mean: f64,
    variance: f64,
}

impl Level {
    /// Mean and scatter of the logarithms, once enough frames were seen.
    fn seen(&self) -> Option<(f64, f64)> {
        (self.frames >= MIN_FRAMES).then(|| (self.mean, self.variance.sqrt().clamp(MIN_SD, MAX_SD)))
    }

    /// The same while few frames were seen: as if they scattered about their mean as about what is learned. Something
    /// may cross in front of a band in a run's first frames.
    fn soon(&self) -> Option<(f64, f64)> {
        let of_few = || (self.mean, LEARNED_SD * (1.0 + 1.0 / self.frames).sqrt());
        self.seen().or_else(|| (self.frames >= FEW_FRAMES).then(of_few))
    }

    /// What was learned, in a recording in which all values exceed that by `common`, as long as it counts.
    fn taught(&self, common: f64) -> Option<f64> {
        let counts = self.compared < COMPARED_FRAMES || common < SAME_NOISE;
        self.learned.filter(|_| counts).map(|learned| learned + common)
    }

    /// Mean and scatter that values are judged by, in a recording in which all exceed what was learned by `common`: of
    /// what was seen, else of what was learned, else of few frames.
    fn in_force(&self, common: f64) -> Option<(f64, f64)> {
        let taught = || Some((self.taught(common)?, LEARNED_SD));
        self.seen().or_else(taught).or_else(|| self.soon())
    }

    /// What is known of enough frames, or what was learned, as if it scattered by chance alone.
    fn usual(&self) -> Option<(f64, f64)> {
        self.seen().or(self.learned.map(|learned| (learned, MIN_SD)))
    }
}

/// For each marker that is the reference of a stretch, in each view.
#[derive(Debug)]
pub(in crate::track) struct Usual {
    levels: ByBand<Level>,
}

impl Usual {
    pub(in crate::track) fn new(rig: &Rig) -> Self {
        Self { levels: ByBand::new(rig, |_, _| Level::default()) }
    }

    /// The same, beginning with the residuals that were learned with the rig.
    pub(in crate::track) fn learned(rig: &Rig) -> Self {
        let level = |m: usize, v: usize| Level {
            learned: rig.markers[m].usual_residuals.get(v).map(|residual| residual.ln()),
            ..Level::default()
        };
        Self { levels: ByBand::new(rig, level) }
    }

    /// ln of the factor by which all values of a frame exceed what was learned: that of the smallest. 0 if nothing was,
    /// and where one is below it: a coder takes noise out of what rests more than out of what moves.
    pub(in crate::track) fn common(&self, values: impl Iterator<Item = (usize, usize, f64)>) -> f64 {
        let beyond = values.filter_map(|(m, v, value)| Some(value.ln() - self.levels.get(m, v)?.learned?));
        beyond.min_by(f64::total_cmp).unwrap_or(0.0).max(0.0)
    }

    /// Standard deviations by which a value exceeds the usual one, where all values of the frame exceed what was
    /// learned by `common`; 0 below it, and while too little is known.
    pub(in crate::track) fn above(&mut self, marker: usize, view: usize, value: f64, common: f64) -> f64 {
        let Some(level) = self.levels.get_mut(marker, view) else { return 0.0 };
        let Some((mean, sd)) = level.in_force(common) else { return 0.0 };
        let taught = level.taught(common).filter(|_| level.seen().is_none());
        if taught.is_some_and(|taught| value.ln() > taught + HELD_SD * LEARNED_SD) {
            level.compared = level.compared.saturating_add(1);
        }
        ((value.ln() - mean) / sd).max(0.0)
    }

    /// ln of the factor by which a value differs from what it is judged by, and the scatter of that; `None` while too
    /// little is known.
    fn off(&self, marker: usize, view: usize, value: f64, common: f64) -> Option<(f64, f64)> {
        let (mean, sd) = self.levels.get(marker, view)?.in_force(common)?;
        Some((value.ln() - mean, sd))
    }

    /// The same by what is known of another marker that looks about alike; 0 if too little is.
    pub(in crate::track) fn above_alike(&self, marker: usize, view: usize, value: f64, common: f64) -> f64 {
        let off = self.off(marker, view, value, common);
        off.map_or(0.0, |(off, sd)| (off / sd.max(LEARNED_SD)).max(0.0))
    }

    /// Standard deviations by which a value exceeds the usual one, negative below it; `None` while too little is known.
    pub(in crate::track) fn off_sd(&self, marker: usize, view: usize, value: f64) -> Option<f64> {
        self.off(marker, view, value, 0.0).map(|(off, sd)| off / sd)
    }

    /// ln of the factor by which a value exceeds what it is judged by, at least 0; `None` while too little is known.
    pub(in crate::track) fn excess(&self, marker: usize, view: usize, value: f64, common: f64) -> Option<f64> {
        self.off(marker, view, value, common).map(|(off, _)| off.max(0.0))
    }

    /// ln of the factor by which a value differs from what was seen, once enough was.
    pub(in crate::track) fn difference(&self, marker: usize, view: usize, value: f64) -> Option<f64> {
        let (mean, _) = self.levels.get(marker, view)?.seen()?;
        Some(value.ln() - mean)
    }

    /// Forgets what was seen for long enough to be compared with. What was learned with the rig counts again.
    pub(in crate::track) fn forget(&mut self) {
        for level in self.levels.iter_mut().filter(|level| level.soon().is_some()) {
            *level = Level { learned: level.learned, ..Level::default() };
        }
    }

    /// Multiplies all that was seen by a factor, given as its ln.
    pub(in crate::track) fn scale(&mut self, ln_factor: f64) {
        self.levels.iter_mut().for_each(|level| level.mean += ln_factor);
    }

    /// Whether enough was seen of a marker in a view.
    pub(in crate::track) fn is_known(&self, marker: usize, view: usize) -> bool {
        self.levels.get(marker, view).is_some_and(|level| level.seen().is_some())
    }

    /// Whether some values exceeded what was learned for as long as it counts.
    pub(in crate::track) fn is_unlike_learned(&self) -> bool {
        self.levels.iter().any(|level| level.compared >= COMPARED_FRAMES)
    }

    /// By which factor a value exceeds the usual or learned one; 1 while neither is known.
    pub(in crate::track) fn ratio(&self, marker: usize, view: usize, value: f64) -> f64 {
        let level = self.levels.get(marker, view);
        level.and_then(Level::usual).map_or(1.0, |(mean, _)| value / mean.exp())
    }

    /// By how many standard deviations a value exceeds the usual or learned one; `None` while neither is known.
    pub(in crate::track) fn beyond(&self, marker: usize, view: usize, value: f64) -> Option<f64> {
        let (mean, sd) = self.levels.get(marker, view)?.usual()?;
        Some((value.ln() - mean) / sd)
    }

    /// The usual value of a marker in each view; `None` where too little is known.
    pub(in crate::track) fn values(&self, marker: usize) -> Option<Vec<f64>> {
        let value = |level: &Level| (level.frames >= MIN_FRAMES).then(|| level.mean.exp());
        self.levels.of_marker(marker)?.iter().map(value).collect()
    }

    /// Adds an accepted value.
    pub(in crate::track) fn add(&mut self, marker: usize, view: usize, value: f64) {
        let Some(level) = self.levels.get_mut(marker, view) else { return };
        let off = value.max(f64::MIN_POSITIVE).ln() - level.mean;
        let off = level.seen().map_or(off, |(_, sd)| off.clamp(-HELD_SD * sd, HELD_SD * sd));
        level.frames = (level.frames + 1.0).min(AVERAGED_FRAMES);
        level.mean += off / level.frames;
        level.variance += (off * off * (1.0 - 1.0 / level.frames) - level.variance) / level.frames;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    #[test]
    fn what_is_twice_the_usual_is_too_much_and_scatter_is_not() {
        let mut usual = Usual::new(&fixture::rig());
        assert!(usual.above(1, 0, 100.0, 0.0) < 1e-12 && usual.values(1).is_none(), "nothing is known yet");
        for i in 0..40 {
            usual.add(1, 0, 4.0 + 0.4 * f64::from(i * 7 % 5 - 2));
        }
        assert!(usual.above(1, 0, 5.2, 0.0) < 4.0 && usual.above(1, 0, 8.0, 0.0) > 4.0);
        assert!(usual.above(1, 1, 8.0, 0.0) < 1e-12 && usual.above(9, 9, 8.0, 0.0) < 1e-12);
    }

    #[test]
    fn what_comes_slowly_does_not_become_usual() {
        let mut usual = Usual::new(&fixture::rig());
        let scattered = |i: i32| 4.0 + 0.1 * f64::from(i * 7 % 5 - 2);
        (0..40).for_each(|i| usual.add(1, 0, scattered(i)));
        for i in 0..40 {
            usual.add(1, 0, scattered(i) * 1.03_f64.powi(i));
        }
        assert!(usual.above(1, 0, scattered(40) * 1.03_f64.powi(40), 0.0) > 4.5);
    }

    #[test]
    fn values_that_are_just_accepted_do_not_widen_the_usual_without_limit() {
        let mut usual = Usual::new(&fixture::rig());
        (0..60).for_each(|i| usual.add(1, 0, 4.0 + 0.1 * f64::from(i * 7 % 5 - 2)));
        let mut value = 4.0;
        // Without the limit the last would be 3e5 times the first.
        for _ in 0..100 {
            while usual.above(1, 0, value * 1.01, 0.0) < 4.4 {
                value *= 1.01;
            }
            usual.add(1, 0, value);
        }
        assert!(value < 5.0 * 4.0, "{value}");
        assert!(usual.above(1, 0, 6.0 * 4.0, 0.0) > 4.5);
    }

    #[test]
    fn a_marker_is_compared_with_another_that_looks_alike() {
        let mut usual = Usual::new(&fixture::rig());
        assert!(!usual.is_known(1, 0) && usual.above_alike(1, 0, 9.0, 0.0) < 1e-12);
        (0..40).for_each(|_| usual.add(1, 0, 4.0));
        assert!(
            usual.is_known(1, 0) && usual.above_alike(1, 0, 5.0, 0.0) < 2.0 && usual.above_alike(1, 0, 8.0, 0.0) > 4.5
        );
    }

    /// As of a tip that is seen alone for the first time, by what was learned of coil and tip, or seen in a few frames.
    #[test]
    fn little_is_enough_to_tell_what_is_far_beyond_it() {
        let mut rig = fixture::rig();
        rig.markers[1].usual_residuals = vec![4.0, 5.0];
        let learned = Usual::learned(&rig);
        assert!(learned.above_alike(1, 0, 5.0, 0.0) < 2.0 && learned.above_alike(1, 0, 8.0, 0.0) > 4.5);
        assert!(learned.above_alike(1, 0, 8.0, 0.7) < 0.1, "the whole recording has more noise");
        let mut usual = Usual::new(&fixture::rig());
        (0..2).for_each(|_| usual.add(1, 0, 4.0));
        assert!(usual.above(1, 0, 12.0, 0.0) < 1e-12, "two frames are too few");
        assert_eq!(usual.excess(1, 0, 12.0, 0.0), None);
        usual.add(1, 0, 4.0);
        assert!(usual.excess(1, 0, 12.0, 0.0).is_some_and(|excess| (excess - 3_f64.ln()).abs() < 1e-9));
        assert!(usual.above(1, 0, 12.0, 0.0) > 4.5 && usual.above_alike(1, 0, 12.0, 0.0) > 4.5);
        assert!(usual.above(1, 0, 5.0, 0.0) < 2.0 && usual.values(1).is_none());
        usual.forget();
        assert!(usual.above(1, 0, 12.0, 0.0) < 1e-12, "at rest they were others");
    }

    #[test]
    fn the_first_frames_are_compared_with_what_was_learned() {
        let mut rig = fixture::rig();
        rig.markers[1].usual_residuals = vec![4.0, 5.0];
        let mut usual = Usual::learned(&rig);
        // Twice the noise in both views is a noisy recording; in one, something is in front of the band.
        let common = usual.common([(1, 0, 8.0), (1, 1, 10.5), (0, 0, 90.0)].into_iter());
        assert!(usual.above(1, 0, 8.0, common) < 0.1 && usual.above(1, 1, 10.5, common) < 1.0);
        // A coder took the noise out of one.
        assert!(usual.common([(1, 0, 1.5), (1, 1, 4.9)].into_iter()) < 1e-12);
        let common = usual.common([(1, 0, 4.2), (1, 1, 9.4)].into_iter());
        assert!(usual.above(1, 1, 9.4, common) > 4.5 && usual.above(1, 0, 4.2, common) < 0.1);
        assert!((usual.ratio(1, 0, 8.0) - 2.0).abs() < 1e-9 && (usual.ratio(0, 0, 8.0) - 1.0).abs() < 1e-9);
        assert!(usual.beyond(1, 0, 4.0).is_some_and(|sd| sd.abs() < 1e-9) && usual.beyond(0, 0, 8.0).is_none());
        assert!(usual.beyond(1, 0, 4.4).is_some_and(|sd| (1.8..2.0).contains(&sd)));
        // What is as learned can be asked for as often as one likes.
        (0..2 * COMPARED_FRAMES).for_each(|_| _ = usual.above(1, 0, 4.4, common));
        assert!(!usual.is_unlike_learned());
        // What lasts is in front of the band, or, in a noisier recording, how this one is; and what was seen counts
        // more than what was learned.
        for _ in 0..COMPARED_FRAMES {
            usual.above(1, 1, 9.4, common);
        }
        assert!(usual.above(1, 1, 9.4, common) > 4.5 && usual.is_unlike_learned());
        assert!(usual.above(1, 1, 12.0, 0.25) < 1e-12);
        (0..8).for_each(|_| usual.add(1, 0, 8.0));
        assert!(usual.above(1, 0, 8.1, 0.0) < 1.0 && (usual.ratio(1, 0, 8.0) - 1.0).abs() < 1e-9);
        assert!(usual.values(1).is_none() && usual.values(0).is_none(), "not known in all views");
    }
}
