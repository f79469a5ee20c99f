//! Whether the rig has the diameter of another tube: then all bands look wider, or narrower, in all views alike.
//!
//! In: the widths of bands over that of the rig's tube (band_widths.rs). They tell a large difference too small: beyond
//! the blur of an edge nothing is known of what lies outside of the tube. So where their median over all bands and
//! views is not 1, the coil's stretch is fitted once more in some frames, with the diameter that they tell, until they
//! agree. An object in front, an edge beside a band, or what is glued around one of them, changes few widths, and then
//! they scatter. Blur that is not noticed as such makes all bands wider; so the same frames are fitted with the rig's
//! diameter and another blur, and the pictures decide.
//!
//! Cannot tell: a tube of another diameter from tape around all bands, nor from a wrong scale of all views.

use crate::estimate::Estimate;
use crate::median::median;
use crate::rig::Rig;
use crate::track::fit::tube_fit::TubeFit;
use crate::track::memory::by_band::ByBand;

/// Frames over which a width is averaged, and the fewest that count: by then it is known whether the pictures are more
/// blurred than those on which the bands were taught (focus.rs), which makes bands wider.
const AVERAGED_FRAMES: f64 = 100.0;
const MIN_FRAMES: f64 = 60.0;
/// Widths that are needed: two bands in two views.
const MIN_WIDTHS: usize = 4;
/// Departure of their median from 1 with which other diameters are tried, and with which they agree.
const TRIED: f64 = 0.02;
const AGREED: f64 = 0.01;
/// Frames that are fitted with each, how far the next is, over what the widths say, and how many there are at most.
const TRIES: usize = 3;
const AHEAD: f64 = 1.5;
const MAX_ROUNDS: usize = 12;
/// Least departure that is told, of the diameter: light and shade on a round tube, blur and chroma leave 7 % with the
/// right one. The mean departure of single widths from their median is at most this part of it.
const LEAST: f64 = 0.1;
const MAX_SPREAD: f64 = 0.25;

/// The diameter that the bands show.
pub(in crate::track) struct Diameter {
    rig_m: f64,
    /// The mean width of each band in each view.
    widths: ByBand<Mean>,
    /// The diameter that is tried, over the rig's.
    times: f64,
    tries: Vec<Tried>,
    rounds: usize,
    /// Mean departure of the widths from their median with the diameter that fits, once it is found.
    spread: Option<f64>,
    /// Whether that fits better than another blur.
    is_better: bool,
}

/// A frame fitted with another diameter.
struct Tried {
    /// How far the widths are beyond that of the tube, in every view.
    beyond: Vec<f64>,
    /// By how much its misfit is below the least of those with another blur.
    better: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    frames: f64,
    mean: f64,
}

impl Diameter {
    pub(in crate::track) fn of(rig: &Rig) -> Self {
        let (rig_m, widths) = (rig.catheter.diameter_m, ByBand::new(rig, |_, _| Mean::default()));
        Self { rig_m, widths, times: 1.0, tries: Vec::new(), rounds: 0, spread: None, is_better: false }
    }

    /// Adds what a frame shows.
    pub(in crate::track) fn add(&mut self, estimate: &Estimate) {
        for (m, marker) in estimate.markers.iter().enumerate() {
            let seen = marker.views.iter().enumerate().filter_map(|(v, view)| Some((v, view.as_ref().ok()?.width)));
            for (v, width) in seen.filter(|(_, width)| width.is_finite()) {
                if let Some(mean) = self.widths.get_mut(m, v) {
                    mean.frames = (mean.frames + 1.0).min(AVERAGED_FRAMES);
                    mean.mean += (width - mean.mean) / mean.frames;
                }
            }
        }
    }

    /// The diameter with which the coil is to be fitted once more, over the rig's, if it is.
    pub(in crate::track) fn tried(&self) -> Option<f64> {
        if self.spread.is_some() || self.rounds == MAX_ROUNDS {
            return None;
        }
        let known = self.widths.iter().filter(|mean| mean.frames >= MIN_FRAMES);
        let widths: Vec<f64> = known.map(|mean| mean.mean).collect();
        let width = median(widths.iter().copied()).filter(|_| widths.len() >= MIN_WIDTHS)?;
        (self.rounds > 0 || (width - 1.0).abs() > TRIED).then_some(self.times)
    }

    /// Adds that fit, and those with the rig's diameter and another blur.
    pub(in crate::track) fn add_tried(&mut self, fit: &TubeFit, blurred: &[TubeFit]) {
        let beyond = fit.views.iter().flat_map(|view| {
            let half_px = view.image.at_arc(0.0).half_width;
            view.widths.iter().map(move |width| width.beyond_px / half_px)
        });
        let least = blurred.iter().map(|fit| fit.misfit).fold(f64::INFINITY, f64::min);
        self.add_one(Tried { beyond: beyond.collect(), better: least - fit.misfit });
    }

    fn add_one(&mut self, tried: Tried) {
        if tried.beyond.len() < MIN_WIDTHS || !tried.beyond.iter().all(|width| width.is_finite()) {
            return;
        }
        self.tries.push(tried);
        if self.tries.len() < TRIES {
            return;
        }
        let tries = std::mem::take(&mut self.tries);
        self.rounds += 1;
        let all = || tries.iter().flat_map(|tried| &tried.beyond).copied();
        let Some(off) = median(all()) else { return };
        if off.abs() < AGREED {
            self.spread = Some(all().map(|one| (one - off).abs()).sum::<f64>() / all().count() as f64);
            self.is_better = tries.iter().map(|tried| tried.better).sum::<f64>() > 0.0;
        }
        self.times *= 1.0 + (AHEAD * off).clamp(-LEAST, LEAST);
    }

    /// Whether enough was seen to know that nothing is wrong with the rig's.
    pub(in crate::track) fn is_right(&self) -> bool {
        let known = self.widths.iter().filter(|mean| mean.frames > MIN_FRAMES).count();
        known >= MIN_WIDTHS && self.tried().is_none() && self.doubt().is_none()
    }

    /// What is wrong with the rig's diameter, if anything is.
    pub(in crate::track) fn doubt(&self) -> Option<String> {
        let (off, rig_mm) = (self.times - 1.0, self.rig_m * 1e3);
        if off.abs() < LEAST || self.spread? > MAX_SPREAD * off.abs() || !self.is_better {
            return None;
        }
        let how = if off > 0.0 { "wider" } else { "narrower" };
        Some(format!(
            "the bands are {:.0} % {how} in all views than the rig's tube diameter of {rig_mm:.1} mm says: {:.1} mm \
             would fit",
            100.0 * off.abs(),
            rig_mm * self.times
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    /// What is said where bands are so wide, over the rig's tube, and show that part of a difference.
    fn doubt(widths: [f64; 4], part: f64) -> Option<String> {
        doubt_if(widths, part, 0.1)
    }

    /// The same where that fits so much better than another blur.
    fn doubt_if(widths: [f64; 4], part: f64, better: f64) -> Option<String> {
        let mut diameter = Diameter::of(&fixture::rig());
        let shown = |width: f64, times: f64| part * (width / times - 1.0);
        for seq in 0..110 {
            let mut estimate = fixture::complete(seq, 0);
            let bands = estimate.markers.iter_mut().skip(1).flat_map(|marker| &mut marker.views).flatten();
            bands.zip(widths).for_each(|(band, width)| band.width = 1.0 + shown(width, 1.0));
            diameter.add(&estimate);
            if let Some(times) = diameter.tried() {
                let beyond = widths.iter().map(|width| shown(*width, times)).collect();
                diameter.add_one(Tried { beyond, better });
            }
        }
        diameter.doubt()
    }

    #[test]
    fn another_diameter_is_told_with_that_which_would_fit() {
        let rig_mm = fixture::rig().catheter.diameter_m * 1e3;
        for part in [0.4, 0.8] {
            for times in [0.7_f64, 0.85, 1.2, 1.4] {
                let said = doubt([times, times + 0.01, times - 0.01, times], part).unwrap();
                let fits_mm = said.split(" mm would fit").next().unwrap().rsplit(' ').next().unwrap();
                assert!((fits_mm.parse::<f64>().unwrap() / rig_mm / times - 1.0).abs() < 0.04, "{times}: {said}");
                assert!(said.contains(if times > 1.0 { "wider" } else { "narrower" }), "{said}");
            }
            assert_eq!([0.93, 1.0, 1.07].map(|times| doubt([times; 4], part)), [None, None, None]);
        }
    }

    #[test]
    fn what_changes_some_widths_is_no_other_tube() {
        // Something beside one band in both views, or beside all in one view; or it is not known.
        assert_eq!(doubt([1.4, 1.3, 1.0, 1.01], 0.5), None);
        assert_eq!(doubt([1.25, 1.0, 1.3, 1.01], 0.5), None);
        assert_eq!(doubt([f64::NAN; 4], 0.5), None);
        // Blur makes all of them wider.
        assert_eq!(doubt_if([1.2; 4], 0.5, -0.1), None);
    }
}
