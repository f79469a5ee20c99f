//! Judges the fits of a frame by those of the frames before: what is unusual hides the band, or is not the band.

use crate::estimate::Miss;
use crate::rig::Rig;
use crate::source::PixelFormat;
use crate::track::assign::Found;
use crate::track::compare::band_widths::UsualWidths;
use crate::track::compare::chroma_slip::Seen;
use crate::track::fit::group_fit::{DISAGREEMENT, Fitted};
use crate::track::fit::tube_fit::{TubeFit, ViewFit};
use crate::track::judge::light_change::{FirstColours, Noisier};
use crate::track::memory::at_rest::Stays;
use crate::track::memory::usual::{LEARNED_SD, Usual};
use crate::track::model::functions::Encoding;
use crate::track::model::separation;
use crate::track::model::stretch::{Group, groups};
use nalgebra::Vector2;

/// Residuals and sizes of a band's blobs may exceed the usual by this many standard deviations, all views together;
/// beyond it something is in front of the band, or it is not the band.
const MAX_UNUSUAL_SD: f64 = 4.5;
/// Cap on the size's part: alone it is no evidence, as it also changes with light and motion.
const MAX_SIZE_TERM: f64 = 3.0;
/// Where looks have changed in all views of a band alike: the least excess of residuals, as a part of the largest (0.35
/// and more in H.264 when a swing becomes faster, 0.05 to 0.25 while a wire passes before one view); and how unusual
/// the size of what is seen may be (a post that hid two thirds of a coil gave 3).
const ALIKE: f64 = 1.0 / 3.0;
const WHOLE_SD: f64 = 2.0;
/// How unusual the sizes of all bands in all views may be together: what covers the ends of two bands hides a little of
/// each in both views.
const ALL_SMALLER_SD: f64 = 2.5;
/// Widths, and sizes of bands beside the reference, that differ from the usual by fewer standard deviations are
/// chance.
const CHANCE_SD: f64 = 1.5;

/// Frames over which the disagreement of the views is averaged.
const DISAGREEMENT_FRAMES: f64 = 8.0;
/// Mean disagreement that is no chance: it is 1, with a standard deviation of 0.4.
const MAX_DISAGREEMENT: f64 = 9.0;

/// Refused frames in a row after which something was in front of a band, and accepted ones for which nothing is learned
/// of it then. What hides it by and by looks right again where its edge lies on the tube's own, and must not become
/// usual from there on: a grey bar that crept over a band at rest by 0.03 pixels a frame was refused for 87 frames,
/// then accepted for good, 13 σ off.
const LASTING_REFUSAL: u32 = 8;
const DISTRUSTED_FRAMES: u32 = 300;

/// Half-life of observed chroma slips, frames.
const SLIP_FRAMES: f64 = 20.0;

/// What is known from the frames before.
pub(in crate::track) struct Judge {
    /// Whether looks are expected to change: while a rig's bands are learned.
    lenient: bool,
    /// Residuals of each band in each view, in the light of the first frames: in motion, once the catheter has moved.
    pub usual: Usual,
    stays: Stays,
    first_colours: FirstColours,
    noisier: Noisier,
    /// Ratio of a band's expected size to its blob's: of the reference of a stretch, and of the bands beside it.
    usual_sizes: [Usual; 2],
    /// Widths of each band in each view.
    usual_widths: UsualWidths,
    /// For each marker, the reference of the stretch that it was last part of and whose residuals are known; at first,
    /// of that which it is part of where all bands are seen.
    stretch: Vec<usize>,
    /// For each reference marker.
    refusals: Vec<Refusals>,
    /// Of the fits of each reference marker: mean disagreement of the views, as χ² per degree of freedom.
    disagreement: Vec<f64>,
    slip: Seen,
    /// Observed offset of chroma from the rig's that following frames are fitted with, pixels.
    pub mean_slip_px: Vector2<f64>,
}

/// How a band was refused.
#[derive(Debug, Clone, Copy, Default)]
struct Refusals {
    /// In a row, up to now.
    in_a_row: u32,
    /// Frames for which nothing is learned of it, and it may look otherwise if it does so in all views.
    distrusted: u32,
    /// Whether it looked otherwise in the last frame, and was accepted.
    borne: bool,
}

impl Refusals {
    fn refused(&mut self) {
        self.borne = false;
        self.in_a_row = self.in_a_row.saturating_add(1);
        if self.in_a_row >= LASTING_REFUSAL {
            self.distrusted = DISTRUSTED_FRAMES;
        }
    }

    /// Notes a frame that is accepted although the band looks otherwise: it says nothing for trusting what comes.
    fn borne(&mut self) {
        (self.in_a_row, self.borne) = (0, true);
    }

    /// Notes a frame in which the band looks as usual; returns whether to learn from it.
    fn accepted(&mut self) -> bool {
        (self.in_a_row, self.borne) = (0, false);
        let trusted = self.distrusted == 0;
        self.distrusted = self.distrusted.saturating_sub(1);
        trusted
    }
}

/// The RMS residual of a fit in a view, as it would be in the light of the first frames.
struct Residual {
    /// The band with whose residuals it is compared.
    alike: usize,
    view: usize,
    rms: f64,
}

/// How far chroma lies off what the rig says.
struct Slip {
    variance_px2: f64,
    /// What is common to all bands, beyond what they were fitted with, pixels.
    left_px: Vector2<f64>,
}

/// What in a view speaks against a fit, in standard deviations but for the excess.
struct Sign {
    /// Of the residual beyond the usual.
    of_residual: f64,
    /// ln of the residual over the usual or learned one, at least 0, if that is known.
    excess: Option<f64>,
    /// Of what is seen of the bands: their sizes and widths.
    of_form: f64,
    /// How much smaller each of them looks than usual, or larger if negative.
    smaller: Vec<f64>,
}

impl Sign {
    fn whole(&self) -> f64 {
        self.of_residual.hypot(self.of_form)
    }
}

/// Signs of all views together.
fn sum(signs: impl Iterator<Item = f64>) -> f64 {
    signs.map(|sign| sign * sign).sum::<f64>().sqrt()
}

/// Whether all views look otherwise than before, and about equally so: then the pictures have changed, as a coder's do
/// in faster motion. What is in front of a band hides it in one view. (What clings to it, or is before both views,
/// cannot be told from that.)
fn look_alike(signs: &[Sign]) -> bool {
    let excesses: Option<Vec<f64>> = signs.iter().map(|sign| sign.excess).collect();
    let Some(excesses) = excesses.filter(|excesses| excesses.len() > 1) else { return false };
    let (least, most) = excesses.iter().fold((f64::INFINITY, 0.0_f64), |(l, m), x| (l.min(*x), m.max(*x)));
    let beyond = |(sign, excess): (&Sign, &f64)| ((excess - least) / LEARNED_SD).hypot(sign.of_form);
    let smaller: Vec<f64> = signs.iter().flat_map(|sign| sign.smaller.iter().copied()).collect();
    let all_smaller = smaller.iter().sum::<f64>() / (smaller.len().max(1) as f64).sqrt();
    let whole = all_smaller < ALL_SMALLER_SD && signs.iter().all(|sign| sign.of_form < WHOLE_SD);
    whole && least >= ALIKE * most && sum(signs.iter().zip(&excesses).map(beyond)) <= MAX_UNUSUAL_SD
}

/// Sum of the squares of so many signs up to which they are chance: its mean and 1.8 standard deviations. Each sign is
/// normally distributed and counts above zero only, so its square is 1/2 in the mean, with a variance of 5/4. (Coded
/// pictures differ from frame to frame, as some predict others: with less than this, a quarter of them had a σ that
/// their errors did not have.)
fn chance(signs: usize) -> f64 {
    let signs = signs as f64;
    signs / 2.0 + 1.8 * (1.25 * signs).sqrt()
}

/// For each view, the bands of a group with their expected areas over those of their blobs.
fn sizes(rig: &Rig, found: &Found, group: &Group, views: &[usize], fit: &TubeFit) -> Vec<Vec<(usize, f64)>> {
    let size = |v: usize, view: &ViewFit, &(marker, arc_m): &(usize, f64)| {
        let blob = found.assigned[marker].as_ref().ok()?.blobs[v]?;
        let knot = view.image.at_arc(arc_m);
        let expected = 2.0 * knot.half_width * knot.scale * rig.markers[marker].length_m;
        Some((marker, expected / found.blobs[blob].area_px2))
    };
    let of_view = |(&v, view): (&usize, &ViewFit)| -> Vec<_> {
        group.members.iter().filter_map(|member| size(v, view, member)).collect()
    };
    views.iter().zip(&fit.views).map(of_view).collect()
}

/// For each marker, the reference of its stretch where all bands are seen.
fn whole_stretches(rig: &Rig) -> Vec<usize> {
    let mut stretch: Vec<usize> = (0..rig.markers.len()).collect();
    for group in groups(rig, |_| true) {
        for (marker, _) in group.members {
            if let Some(of_marker) = stretch.get_mut(marker) {
                *of_marker = group.reference;
            }
        }
    }
    stretch
}

impl Judge {
    pub(in crate::track) fn new(rig: &Rig) -> Self {
        Self {
            lenient: false,
            usual: Usual::learned(rig),
            stays: Stays::new(rig),
            first_colours: FirstColours::new(rig),
            noisier: Noisier::default(),
            usual_sizes: [Usual::new(rig), Usual::new(rig)],
            usual_widths: UsualWidths::new(rig),
            stretch: whole_stretches(rig),
            refusals: vec![Refusals::default(); rig.markers.len()],
            disagreement: vec![1.0; rig.markers.len()],
            slip: Seen::default(),
            mean_slip_px: Vector2::zeros(),
        }
    }

    /// A judge of frames in which looks may change from one to the next.
    pub(in crate::track) fn lenient(rig: &Rig) -> Self {
        Self { lenient: true, ..Self::new(rig) }
    }

    /// Forgets how bands looked: they are compared with another image model from now on.
    pub(in crate::track) fn forget_looks(&mut self, rig: &Rig) {
        self.usual.forget();
        self.usual_widths = UsualWidths::new(rig);
    }

    /// Whether a stretch with this reference looked otherwise in the last frame, and was accepted.
    pub(in crate::track) fn looked_otherwise(&self, reference: usize) -> bool {
        self.refusals.get(reference).is_some_and(|refusals| refusals.borne)
    }

    /// Whether the views lastingly disagree about a band.
    pub(in crate::track) fn views_disagree(&self) -> bool {
        self.disagreement.iter().any(|mean| *mean > MAX_DISAGREEMENT)
    }

    /// Adds the slip of chroma and the views' disagreement to the covariances, and refuses fits with unusual residuals
    /// or of too little of a band.
    pub(in crate::track) fn judge(
        &mut self,
        rig: &Rig,
        encoding: &Encoding,
        format: PixelFormat,
        found: &Found,
        fitted: &mut [Fitted],
    ) {
        let slip = self.follow_slip(format, fitted);
        self.follow_motion(fitted);
        let residuals: Vec<_> = fitted.iter().map(|fitted| self.residuals(encoding, fitted)).collect();
        let common = self.usual.common(residuals.iter().flatten().map(|one| (one.alike, one.view, one.rms)));
        self.follow_noise(&residuals);
        for (Fitted { group, views, result, .. }, residuals) in fitted.iter_mut().zip(&residuals) {
            let Ok(fit) = result else { continue };
            self.widen(group.reference, fit, &slip);
            let sizes = sizes(rig, found, group, views, fit);
            let signs = self.signs(group, fit, residuals, &sizes, common);
            let all = sum(signs.iter().map(Sign::whole));
            let changed = self.lenient || self.refusals[group.reference].distrusted > 0;
            let refused = all > MAX_UNUSUAL_SD && !(changed && look_alike(&signs));
            // With an edge before part of a band, errors are about so many times as large as the fit knows. Each view
            // gives two signs, residual and size; of the width, only what is no chance is in the sum. Where all views
            // look otherwise the most that is usual is enough: squares of errors were 0.2 to 0.5 of the expected ones.
            fit.covariance *= 1.0 + (all.min(MAX_UNUSUAL_SD).powi(2) - chance(2 * signs.len())).max(0.0);
            if refused && let Some((i, _)) = signs.iter().enumerate().max_by(|a, b| a.1.whole().total_cmp(&b.1.whole()))
            {
                let view = &fit.views[i];
                let separation = separation::least(rig, encoding, group, views[i], &view.look.colours);
                *result = Err(Miss::PoorFit { moved_px: view.residual_px.norm(), separation });
                self.refusals[group.reference].refused();
            } else if all > MAX_UNUSUAL_SD {
                self.refusals[group.reference].borne();
            } else if self.refusals[group.reference].accepted() {
                self.learn(group, fit, residuals, sizes);
                if views.iter().all(|v| self.usual.is_known(group.reference, *v)) {
                    group.members.iter().for_each(|(marker, _)| self.stretch[*marker] = group.reference);
                }
            }
        }
    }

    /// Notes how far chroma lies off in this frame.
    fn follow_slip(&mut self, format: PixelFormat, fitted: &[Fitted]) -> Slip {
        self.slip = self.slip.faded(0.5_f64.powf(1.0 / SLIP_FRAMES));
        for fit in fitted.iter().filter_map(|f| f.result.as_ref().ok()) {
            fit.views.iter().for_each(|view| self.slip.add(&view.slip.beyond(&self.mean_slip_px)));
        }
        let mean_px = self.slip.mean_px();
        let slip = Slip { variance_px2: self.slip.variance_px2(&mean_px), left_px: mean_px - self.mean_slip_px };
        self.mean_slip_px = self.slip.mean_px_in(format);
        slip
    }

    /// Notes whether all pictures have become noisier, or less noisy.
    fn follow_noise(&mut self, residuals: &[Vec<Residual>]) {
        let differences = |of_fit: &Vec<Residual>| -> Vec<f64> {
            of_fit.iter().filter_map(|one| self.usual.difference(one.alike, one.view, one.rms)).collect()
        };
        let differences: Vec<_> = residuals.iter().map(differences).collect();
        if let Some(ln_factor) = self.noisier.lasting(&differences) {
            self.usual.scale(ln_factor);
        }
    }

    /// Adds to a fit's covariance what its residuals do not tell.
    fn widen(&mut self, reference: usize, fit: &mut TubeFit, slip: &Slip) {
        fit.covariance += fit.slip_covariance * slip.variance_px2;
        // What is common to all bands and was not taken out.
        let moved = fit.moved_by_slip(&slip.left_px);
        fit.covariance += moved * moved.transpose();
        // Views that lastingly disagree do not show one moment, or not what the rig says; chance is 1.
        let mean = &mut self.disagreement[reference];
        let now = (fit.disagreement() / fit.freedom()).min(DISAGREEMENT.0);
        *mean += (now - *mean) / DISAGREEMENT_FRAMES;
        fit.covariance *= (*mean - 1.0).max(1.0);
    }

    /// What speaks against a fit, in each view.
    fn signs(
        &mut self,
        group: &Group,
        fit: &TubeFit,
        residuals: &[Residual],
        sizes: &[Vec<(usize, f64)>],
        common: f64,
    ) -> Vec<Sign> {
        let sign = |((&Residual { alike, view: v, rms }, view), sizes): ((&Residual, &ViewFit), &Vec<(usize, f64)>)| {
            let smaller = sizes.iter().filter_map(|&(marker, size)| {
                let beside = usize::from(marker != group.reference);
                Some((beside, self.usual_sizes[beside].off_sd(marker, v, size)?))
            });
            let smaller: Vec<(usize, f64)> = smaller.collect();
            // The more bands, the larger is the largest by chance.
            let of_sizes = smaller.iter().map(|&(beside, off)| off - [0.0, CHANCE_SD][beside]);
            let of_size = of_sizes.fold(0.0, f64::max).min(MAX_SIZE_TERM);
            let smaller = smaller.into_iter().map(|(_, off)| off).collect();
            let half_px = view.image.at_arc(0.0).half_width;
            let of_widths = group.members.iter().zip(&view.widths).map(|((marker, _), width)| {
                (self.usual_widths.unusual_sd(*marker, v, width, half_px) - CHANCE_SD).max(0.0)
            });
            let of_widths = of_widths.fold(0.0, f64::max);
            let of_residual = if alike == group.reference {
                self.usual.above(alike, v, rms, common)
            } else {
                self.usual.above_alike(alike, v, rms, common)
            };
            let excess = self.usual.excess(alike, v, rms, common);
            Sign { of_residual, excess, of_form: of_size.hypot(of_widths), smaller }
        };
        residuals.iter().zip(&fit.views).zip(sizes).map(sign).collect()
    }

    /// Learns how the bands of a fit look.
    fn learn(&mut self, group: &Group, fit: &TubeFit, residuals: &[Residual], sizes: Vec<Vec<(usize, f64)>>) {
        for ((Residual { view: v, rms, .. }, view), sizes) in residuals.iter().zip(&fit.views).zip(sizes) {
            if !self.stays.is_at_rest() {
                self.usual.add(group.reference, *v, *rms);
            }
            self.first_colours.add((group, *v, view));
            let half_px = view.image.at_arc(0.0).half_width;
            for ((marker, _), width) in group.members.iter().zip(&view.widths) {
                self.usual_widths.add(*marker, *v, width, half_px);
            }
            for (marker, size) in sizes {
                self.usual_sizes[usize::from(marker != group.reference)].add(marker, *v, size);
            }
        }
    }

    /// Notes where the bands are. When they move for the first time, what was seen of them at rest is forgotten.
    fn follow_motion(&mut self, fitted: &[Fitted]) {
        let images = fitted.iter().filter_map(|Fitted { group, views, result, .. }| {
            let images = result.as_ref().ok()?.views.iter().map(|view| view.image.at_arc(0.0).pixel);
            Some((group.reference, views.iter().copied().zip(images).collect()))
        });
        if self.stays.add(images) {
            self.usual.forget();
        }
    }

    /// The residuals of a fit; none if there is no fit.
    fn residuals(&self, encoding: &Encoding, Fitted { group, views, result, .. }: &Fitted) -> Vec<Residual> {
        let of_views = result.iter().flat_map(|fit| &fit.views);
        let one = |(&view, fit): (&usize, &ViewFit)| {
            // Of a band that is alone for the first time, what was seen of it together with others.
            let known = self.usual.is_known(group.reference, view);
            let alike = if known { group.reference } else { self.stretch[group.reference] };
            let difference = self.usual.difference(alike, view, fit.rms);
            let rms = fit.rms * self.first_colours.factor((group, view, fit), encoding, difference);
            Residual { alike, view, rms }
        };
        views.iter().zip(of_views).map(one).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;
    use crate::testing::random::Random;

    #[test]
    fn nothing_is_learned_for_a_while_after_lasting_refusals() {
        let mut refusals = Refusals::default();
        (1..LASTING_REFUSAL).for_each(|_| refusals.refused());
        assert!(refusals.accepted(), "a few are chance");
        (0..LASTING_REFUSAL).for_each(|_| refusals.refused());
        // A lasting change does not wear distrust out.
        (0..2 * DISTRUSTED_FRAMES).for_each(|_| refusals.borne());
        assert!((0..DISTRUSTED_FRAMES).all(|_| !refusals.accepted()) && refusals.accepted());
    }

    /// From the first frame on: later ones may show it alone before it was seen together with the coil often enough.
    #[test]
    fn a_tip_that_is_alone_is_compared_with_coil_and_tip() {
        let mut rig = fixture::rig();
        assert_eq!(whole_stretches(&rig), [0, 1, 2], "nothing is known of their places");
        for (marker, (length_m, centre_m)) in rig.markers.iter_mut().zip([(6e-3, 6e-3), (12e-3, 85e-3), (6e-3, 107e-3)])
        {
            (marker.length_m, marker.centre_m) = (length_m, Some(centre_m));
        }
        assert_eq!(Judge::new(&rig).stretch, [0, 1, 1]);
    }

    #[test]
    fn looks_that_change_in_all_views_are_told_from_what_is_in_front_of_one() {
        let sign = |excess: f64, of_form: f64| Sign {
            of_residual: excess / 0.05,
            excess: Some(excess),
            of_form,
            smaller: vec![0.5; 2],
        };
        assert!(look_alike(&[sign(0.7, 0.0), sign(0.4, 1.0)]), "faster motion");
        assert!(!look_alike(&[sign(0.9, 0.0), sign(0.2, 0.0)]), "a wire before one");
        assert!(!look_alike(&[sign(1.5, 0.0), sign(0.7, 0.0)]), "motion, and a wire");
        assert!(!look_alike(&[sign(0.4, 0.0), sign(0.4, 3.0)]), "half of it is hidden");
        assert!(!look_alike(&[sign(0.4, 0.0)]), "one view cannot tell");
        let covered = |smaller: f64| Sign { smaller: vec![smaller; 2], ..sign(0.4, 1.2) };
        assert!(look_alike(&[covered(1.1), covered(1.1)]));
        assert!(!look_alike(&[covered(1.4), covered(1.4)]), "all bands in all views look smaller");
        let unknown = Sign { excess: None, ..sign(0.4, 0.0) };
        assert!(!look_alike(&[unknown, sign(0.4, 0.0)]), "too little is known");
    }

    #[test]
    fn of_signs_by_chance_one_sum_in_twenty_is_more() {
        let mut random = Random::new(7);
        for signs in [2, 4, 6] {
            let mut sum = || random.normals(signs).iter().map(|sign| sign.max(0.0).powi(2)).sum::<f64>();
            let more = (0..20_000).filter(|_| sum() > chance(signs)).count();
            assert!((800..1400).contains(&more), "{more} of 20 000, {signs} signs");
        }
    }
}
