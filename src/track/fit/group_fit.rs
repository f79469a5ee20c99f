//! Fits each group of bands of a frame: from which starts, and which fit counts.
//!
//! A fit continues the last one where the motion is known and its residuals stay usual. Otherwise it starts from the
//! blobs; where these are blurred or their fit is unusual, also from the last direction and from the way a bent tube
//! takes, and the best counts.

use crate::estimate::Miss;
use crate::rig::Rig;
use crate::source::Frame;
use crate::track::assign::{Assigned, Found, direction_of_axes};
use crate::track::compare::no_fit::NoFit;
use crate::track::fit::colour_fringes::Fringes;
use crate::track::fit::last_fit::Last;
use crate::track::fit::tube_fit::{Fitting, TubeFit, ViewFit};
use crate::track::memory::usual::Usual;
use crate::track::model::image_model::ImageModel;
use crate::track::model::separation;
use crate::track::model::stretch::{Group, groups};
use crate::track::model::tube_image::Sweep;
use crate::track::model::tube_shape::TubeShape;
use crate::track::recording::long_exposure::LONGEST_EXPOSURE;
use nalgebra::{Point3, Vector2, Vector3};
use rayon::prelude::*;
use std::borrow::Cow;

/// A fit that ends this far from its start has left its band: pixels, and half widths of a tube that is wide in the
/// picture, because it starts from the centre of the visible surface, up to π/4 half widths from that of the band.
const MAX_MOVED: (f64, f64) = (4.0, 1.2);
/// Least separation of a band's fitted colour from its surroundings (1: as learned).
const MIN_SEPARATION: f64 = 0.3;
/// Views disagree when their own shifts exceed this χ² and this many pixels.
pub(in crate::track) const DISAGREEMENT: (f64, f64) = (36.0, 0.7);

/// Motion blur beyond which blobs may mislead the fit: variance, px², of a motion by two pixels.
const BLURRED_PX2: f64 = 4.0 / 12.0;

/// A fit that continues the last may have inherited its faults when its residual exceeds the usual by this many
/// standard deviations; any fit may have gone astray when it does by this factor.
const CONTINUED_SD: f64 = 2.0;
const UNUSUAL_RESIDUAL: f64 = 1.35;
/// Oldest shape that tells how a picture is blurred by the way from there, seconds: a few lost frames, but not half a
/// swing.
const SWEEP_AGE_S: f64 = 0.14;

/// A fitted group with the views it was fitted in.
pub(in crate::track) struct Fitted {
    pub group: Group,
    pub views: Vec<usize>,
    pub result: Result<TubeFit, Miss>,
    /// Whether it is known which way along the tube the tip is.
    pub directed: bool,
}

/// What the groups of a frame are fitted from.
pub(in crate::track) struct GroupFitting<'a> {
    pub rig: &'a Rig,
    pub model: &'a ImageModel,
    /// Of each view of the rig.
    pub blurs_px: &'a [Vector2<f64>],
    pub frame: &'a Frame,
    pub found: &'a Found,
    /// For each marker that is the reference of a group: its last fit.
    pub last: &'a [Option<Last>],
    pub usual: &'a Usual,
    pub fringes: &'a Fringes,
    /// Whether the base band is known not to move.
    pub base_rests: bool,
    /// Background beside the tube that is fitted, pixels.
    pub margin_px: f64,
}

impl GroupFitting<'_> {
    /// Fits all groups.
    pub(in crate::track) fn fit_all(&self) -> Vec<Fitted> {
        let sees = |m: usize, v: usize| self.found.assigned[m].as_ref().is_ok_and(|a| a.blobs[v].is_some());
        let views = 0..self.rig.views.len();
        let together = |all: &[usize]| views.clone().filter(|&v| all.iter().all(|m| sees(*m, v))).count() >= 2;
        let fit = |group: Group| {
            let sees_all = |v: &usize| group.members.iter().all(|&(m, _)| sees(m, *v));
            let views: Vec<usize> = views.clone().filter(sees_all).collect();
            Fitted { result: self.fit(&group, &views), directed: self.is_directed(&group), group, views }
        };
        groups(self.rig, together).into_par_iter().map(fit).collect()
    }

    /// Fits a group in the views that show all of it.
    fn fit(&self, group: &Group, views: &[usize]) -> Result<TubeFit, Miss> {
        let starts = group.members.iter().map(|&(m, s)| Ok((s, self.assigned(m)?.point)));
        let starts = starts.collect::<Result<Vec<_>, Miss>>()?;
        let reference = self.assigned(group.reference)?.point;
        let direction = self.start_direction(group).ok_or(Miss::NotConverged)?;
        let last = self.last(group);
        let looks_apart = self.fringes.look_at(group, views);
        let fitting = Fitting { looks_apart, ..self.fitting(group, views, None) };
        let accepted = |fit: Result<TubeFit, NoFit>| {
            let fit = fit.map_err(|why| match why {
                NoFit::OutOfPicture | NoFit::NotConverged => Miss::NotConverged,
                NoFit::NotRecorded => Miss::NotRecorded,
                NoFit::TooCoarse => Miss::TooCoarse,
            })?;
            self.accept(group, views, &starts, &fit).map(|()| fit)
        };
        let fit_from = |start: &TubeShape| accepted(fitting.fit(start));
        let continued = last.and_then(|last| {
            let start = last.continued(self.frame.stamp)?;
            Some(match last.looks(&group.stretch, views) {
                Some(looks) => accepted(fitting.follow(&start, looks)),
                None => fit_from(&start),
            })
        });
        match continued {
            Some(Ok(fit)) if self.is_usual(group, views, &fit) => return Ok(fit),
            _ => {}
        }
        let straight = |direction| TubeShape::straight(reference, &direction, group.straight_half_m);
        let settled = fitting.settle(&straight(direction));
        let unusual = |fit: &TubeFit| self.is_unusual(group, views, fit);
        let is_same = |fit: &TubeFit| settled.as_ref().is_ok_and(|settled| settled.is_at(fit, &group.stretch));
        match continued {
            Some(Ok(fit)) if !is_blurred(&fit) && !unusual(&fit) && is_same(&fit) => return Ok(fit),
            _ => {}
        }
        let first = accepted(settled.and_then(|settled| fitting.measure(settled)));
        // Blurred or half-hidden blobs tell little about the direction: the previous one may be closer, or the way from
        // the band before.
        let (blurred, unusual) = match &first {
            Ok(fit) => (is_blurred(fit), unusual(fit)),
            Err(miss) => [matches!(miss, Miss::PoorFit { .. } | Miss::NotConverged); 2].into(),
        };
        let previous = self.before(group).filter(|_| blurred || unusual);
        let previous = previous.map(|(before, _)| TubeShape { centre: reference, ..before.clone() });
        let bent = self.bent_direction(group.reference).filter(|_| unusual).map(straight);
        let others = [previous, bent].into_iter().flatten().map(|start| fit_from(&start));
        continued.into_iter().chain(others).fold(first, better)
    }

    /// Fits a group that was fitted once more, as with another model, or blurred by another share of the way since the
    /// last fit.
    pub(in crate::track) fn again(&self, fitted: &Fitted, share: Option<f64>) -> Option<TubeFit> {
        let fit = fitted.result.as_ref().ok()?;
        self.fitting(&fitted.group, &fitted.views, share).follow(&fit.shape, &fit.looks()).ok()
    }

    /// What a group is fitted to.
    fn fitting<'b>(&'b self, group: &'b Group, views: &[usize], share: Option<f64>) -> Fitting<'b> {
        let Self { rig, frame, model, blurs_px, margin_px, .. } = *self;
        let sweep = self.last(group).and_then(|last| {
            let since_s = last.age_within_s(SWEEP_AGE_S, frame.stamp)?;
            // Stamps may be closer together than the frames.
            let share = share.or_else(|| Some((rig.camera.exposure_s? / since_s).min(LONGEST_EXPOSURE)))?;
            Some(Sweep { before: last.shape.clone(), share })
        });
        Fitting {
            stretch: &group.stretch,
            picture: &frame.picture,
            paths: views.iter().map(|&v| &rig.views[v].optics).collect(),
            blurs_px: if views.iter().copied().eq(0..blurs_px.len()) {
                Cow::Borrowed(blurs_px)
            } else {
                views.iter().map(|&v| blurs_px[v]).collect()
            },
            ranges_m: views.iter().map(|&v| self.seen_range(group, v)).collect(),
            model,
            sweep,
            rests: self.base_rests && matches!(group.members[..], [(0, _)]),
            margin_px,
            looks_apart: false,
        }
    }

    /// Its last fit, unless that may lie the other way round and a neighbour shows it now.
    fn last(&self, group: &Group) -> Option<&Last> {
        self.last[group.reference].as_ref().filter(|last| last.directed || self.chord(group).is_none())
    }

    /// Its last shape, and how long ago that was, seconds, if recent enough.
    fn before(&self, group: &Group) -> Option<(&TubeShape, f64)> {
        let last = self.last(group)?;
        Some((&last.shape, last.age_s(self.frame.stamp)?))
    }

    /// Whether the residuals of a fit are as usual, as far as that is known.
    fn is_usual(&self, group: &Group, views: &[usize], fit: &TubeFit) -> bool {
        let beyond = |(v, view): (&usize, &ViewFit)| self.usual.beyond(group.reference, *v, view.rms);
        views.iter().zip(&fit.views).all(|seen| beyond(seen).is_some_and(|sd| sd < CONTINUED_SD))
    }

    /// Whether they are so large that it may have gone astray.
    fn is_unusual(&self, group: &Group, views: &[usize], fit: &TubeFit) -> bool {
        let ratio = |(v, view): (&usize, &ViewFit)| self.usual.ratio(group.reference, *v, view.rms);
        views.iter().zip(&fit.views).any(|seen| ratio(seen) > UNUSUAL_RESIDUAL)
    }

    fn assigned(&self, marker: usize) -> Result<&Assigned, Miss> {
        self.found.assigned[marker].as_ref().map_err(Clone::clone)
    }

    /// Where a marker is, if there is one of this number and it was found.
    fn place(&self, marker: usize) -> Option<Point3<f64>> {
        Some(self.found.assigned.get(marker)?.as_ref().ok()?.point)
    }

    /// Direction of gravity in the camera frame, if the base is known: that of a tube at rest.
    fn down(&self) -> Option<Vector3<f64>> {
        self.rig.base.as_ref().map(|base| base.base_from_camera.inverse() * Vector3::z())
    }

    /// Direction at a marker of a tube bent uniformly from the marker before, where it hangs as it does at rest: it
    /// turns twice as far as the chord. Without a base frame, the direction of the chord.
    fn bent_direction(&self, marker: usize) -> Option<Vector3<f64>> {
        let chord = (self.place(marker)? - self.place(marker.checked_sub(1)?)?).try_normalize(0.0)?;
        Some(self.down().map_or(chord, |rest| chord * (2.0 * chord.dot(&rest)) - rest))
    }

    /// Arc lengths between which a view shows the tube of a group: where it does not show the next band, whatever hides
    /// that may begin right after this one.
    fn seen_range(&self, group: &Group, view: usize) -> (f64, f64) {
        let hidden = |m: usize| match self.found.assigned.get(m) {
            None => false,
            Some(Ok(a)) => a.blobs[view].is_none(),
            Some(Err(Miss::NotSeen { view: missing })) => *missing == view,
            Some(Err(_)) => true,
        };
        let last = group.members.last().map_or(group.reference, |m| m.0);
        let (from, to) = group.stretch.range_m;
        let beside = group.stretch.layout.rings_m.last().map_or(to, |ring| ring + group.stretch.radius_m);
        (from, if hidden(last + 1) { to.min(beside) } else { to })
    }

    /// From the reference to the next band, or from the one before.
    fn chord(&self, group: &Group) -> Option<Vector3<f64>> {
        let m = group.reference;
        let here = self.place(m)?;
        match (m.checked_sub(1).and_then(|m| self.place(m)), self.place(m + 1)) {
            (_, Some(next)) => Some(next - here),
            (Some(previous), None) => Some(here - previous),
            (None, None) => None,
        }
    }

    /// Whether a neighbour tells which way the tip is, or did a moment ago. With a base frame the tube is within 90° of
    /// where it rests; of a single band nothing else is ever known.
    fn is_directed(&self, group: &Group) -> bool {
        let before = || self.before(group).is_some() && self.last(group).is_some_and(|last| last.directed);
        self.chord(group).is_some() || self.rig.base.is_some() || self.rig.markers.len() == 1 || before()
    }

    /// Direction of the tube at the reference, base to tip: from its blobs' axes, or along the chord to its neighbours.
    fn start_direction(&self, group: &Group) -> Option<Vector3<f64>> {
        let here = self.found.assigned[group.reference].as_ref().ok()?;
        let chord = self.chord(group);
        let seen = here.blobs.iter().zip(&self.rig.views);
        let axes: Vec<_> =
            seen.filter_map(|(blob, view)| blob.map(|blob| (view, self.found.blobs[blob].axis))).collect();
        match (direction_of_axes(&axes, &here.point), chord) {
            (Some(axis), Some(chord)) => Some(if axis.dot(&chord) < 0.0 { -axis } else { axis }),
            // Without a neighbour the sign is that of a moment ago, or undetermined: along gravity or, failing that,
            // down in the picture.
            (Some(axis), None) => {
                let before = self.before(group).map(|(before, _)| before.tangent());
                let down = before.or_else(|| self.down()).unwrap_or_else(Vector3::y);
                Some(if axis.dot(&down) < 0.0 { -axis } else { axis })
            }
            (None, chord) => chord,
        }
    }

    /// Whether the fit is still on the bands it started from, given as arc lengths and positions, and all views agree.
    fn accept(&self, group: &Group, views: &[usize], starts: &[(f64, Point3<f64>)], fit: &TubeFit) -> Result<(), Miss> {
        for (&v, view) in views.iter().zip(&fit.views) {
            let pixel = |point| self.rig.views[v].optics.project(&point).map_err(|_| Miss::NotConverged);
            let mut moved: f64 = 0.0;
            for &(s, start) in starts {
                moved = moved.max((pixel(fit.shape.at(s).0)? - pixel(start)?).norm());
            }
            let knot = view.image.at_arc(0.0);
            let separation = separation::least(self.rig, &self.model.encoding, group, v, &view.look.colours);
            if !(moved <= MAX_MOVED.0.max(MAX_MOVED.1 * knot.half_width) && separation >= MIN_SEPARATION) {
                return Err(Miss::PoorFit { moved_px: moved, separation });
            }
        }
        let shift = fit.views.iter().map(|v| v.residual_px.norm()).fold(0.0, f64::max);
        if fit.disagreement() > DISAGREEMENT.0 && shift > DISAGREEMENT.1 {
            let px_per_m = fit.views.iter().map(|v| v.image.at_arc(0.0).scale).fold(f64::INFINITY, f64::min);
            return Err(Miss::RaysDiverge { distance_m: shift / px_per_m });
        }
        Ok(())
    }
}

/// Whether the band moved far during the exposure.
fn is_blurred(fit: &TubeFit) -> bool {
    fit.views.iter().any(|view| view.image.at_arc(0.0).swept.sum() > BLURRED_PX2)
}

/// The one that fits the pictures better.
fn better(best: Result<TubeFit, Miss>, other: Result<TubeFit, Miss>) -> Result<TubeFit, Miss> {
    match (best, other) {
        (Ok(best), Ok(fit)) if fit.misfit < best.misfit => Ok(fit),
        (Err(_), Ok(fit)) => Ok(fit),
        (best, _) => best,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::ColourModel;
    use crate::source::Timestamp;
    use crate::testing::fixture;
    use crate::testing::two_views::{BLUR_PX, Tube, views};
    use crate::track::model::functions::Encoding;
    use crate::track::model::image_model::ModelError;

    /// Coil and tip are fitted together, but each must stay where it was found.
    #[test]
    fn a_fit_that_leaves_one_of_its_bands_is_refused() {
        let mut rig = fixture::rig();
        rig.views.iter_mut().zip(views()).for_each(|(view, optics)| view.optics = optics);
        let colours = [[0.02, -0.02, 0.0], [-0.01, 0.02, -0.01], [-0.01, -0.01, 0.02]];
        for ((marker, (length_m, centre_m)), weights) in
            rig.markers.iter_mut().zip([(6e-3, 6e-3), (12e-3, 85e-3), (6e-3, 107e-3)]).zip(colours)
        {
            (marker.length_m, marker.centre_m) = (length_m, Some(centre_m));
            marker.colours = vec![ColourModel::linear(weights.into(), 0.0, Vector3::zeros())];
        }
        let tube = Tube::along(Vector3::new(0.1, 1.0, 0.05));
        let picture = tube.picture(crate::simulate::Sensor::default(), 5);
        let model = ImageModel {
            encoding: Encoding::new(picture.colour().transfer),
            chroma_offset_px: rig.camera.chroma_offset_px,
            chroma_reach: rig.camera.chroma_reach,
            mosaic: None,
            error: ModelError::CODED,
            first_coded: None,
        };
        let frame = Frame {
            seq: 0,
            stamp: Timestamp { ns: 0, clock: crate::source::Clock::Container },
            gap: 0,
            host: None,
            picture,
        };
        let fit_with_tip_at = |tip: Point3<f64>| {
            let at = |point| Ok(Assigned { point, blobs: vec![None, None] });
            let assigned = [Err(Miss::NotSeen { view: 0 }), at(tube.centre), at(tip)];
            let group = groups(&rig, |all| all.iter().all(|m| *m > 0)).remove(0);
            let found = Found { blobs: Vec::new(), assigned: assigned.into() };
            let (last, usual) = (vec![None; rig.markers.len()], Usual::new(&rig));
            let (rig, model, frame, found, last, usual) = (&rig, &model, &frame, &found, &last[..], &usual);
            let blurs_px = &[Vector2::repeat(BLUR_PX); 2];
            let (fringes, base_rests, margin_px) = (&Fringes::of(rig), false, 4.0);
            GroupFitting { rig, model, blurs_px, frame, found, last, usual, fringes, base_rests, margin_px }
                .fit(&group, &[0, 1])
        };
        let tip = tube.centre + tube.direction * 22e-3;
        assert!(fit_with_tip_at(tip).is_ok());
        let miss = fit_with_tip_at(tip + Vector3::new(2.5e-3, 0.0, 0.0)).unwrap_err();
        assert!(
            matches!(miss, Miss::PoorFit { moved_px, separation } if moved_px > 4.0 && separation > 0.3),
            "{miss:?}"
        );
    }
}
