//! [`Tracker`]: one frame in, one estimate out. Composes segment, assign, and the fit of the tube.
//!
//! Blobs are searched in windows around the last positions; when not all markers are found there, in the whole picture.
//! The result is the same either way: a blob counts only when it lies wholly inside its window, and then it is the same
//! one that a search of the whole picture finds.

use crate::estimate::{BandObservation, Estimate, MarkerEstimate, Miss, Position, Spot, Tangent};
use crate::optics::OpticalPath;
use crate::rig::Rig;
use crate::segment::{Blob, Search, SegmentError, Segmenter};
use crate::source::{Frame, NotRecorded, Timestamp, Transfer, Window};
use crate::track::appearance::{FIXED, PER_SEGMENT};
use crate::track::assign::{Assigned, Assigner, direction_of_axes};
use crate::track::coil::deflection;
use crate::track::fit::{Fitting, TubeFit, ViewFit};
use crate::track::image_model::{ImageModel, ModelError};
use crate::track::lamp::Lamp;
use crate::track::last::Last;
use crate::track::light::Encoding;
use crate::track::motion::Motion;
use crate::track::no_fit::NoFit;
use crate::track::scatter::Scatter;
use crate::track::slip::Seen;
use crate::track::stretch::{Group, groups};
use crate::track::tube::{SHAPE, TubeShape};
use crate::track::tube_image::{Sweep, TubeImage};
use crate::track::usual::Usual;
use nalgebra::{Matrix3, Point2, Point3, SMatrix, Vector2, Vector3};
use rayon::prelude::*;

/// Blur assumed for a rig whose blur has not been measured: a sharp lens and square pixels.
const DEFAULT_BLUR_PX: f64 = 0.6;
/// A fit that ends this far from its start has left its band: pixels, and half widths of a tube that is wide in the
/// picture, because it starts from the centre of the visible surface, up to π/4 half widths from that of the band.
const MAX_MOVED: (f64, f64) = (4.0, 1.2);
/// Least separation of a band's fitted colour from its surroundings (1: as learned).
const MIN_SEPARATION: f64 = 0.3;
/// Views disagree when their own shifts exceed this χ² and this many pixels.
const DISAGREEMENT: (f64, f64) = (36.0, 0.7);

/// Residuals and sizes of a band's blobs may exceed the usual by this many standard deviations, all views together;
/// beyond it something is in front of the band, or it is not the band.
const MAX_UNUSUAL_SD: f64 = 4.5;
/// Cap on the size's part: alone it is no evidence, as it also changes with light and motion.
const MAX_SIZE_TERM: f64 = 3.0;

/// Motion blur beyond which blobs may mislead the fit: variance, px², of a motion by two pixels.
const BLURRED_PX2: f64 = 4.0 / 12.0;

/// What a search reads around its window: a cell of two pixels on each side, and what rounds both to whole cells.
const RING_PX: u32 = 4;

/// A fit that continues the last may have inherited its faults when its residual exceeds the usual by this many
/// standard deviations; any fit may have gone astray when it does by this factor.
const CONTINUED_SD: f64 = 2.0;
const UNUSUAL_RESIDUAL: f64 = 1.35;

/// Background beside the tube that is fitted, pixels: as far as blur and neighbourhoods of chroma show the tube. Where
/// models are compared, more of it tells what is noise.
const TRACKED_PX: f64 = 4.0;
const COMPARED_PX: f64 = 5.0;

/// Half-life of observed chroma slips, frames.
const SLIP_FRAMES: f64 = 20.0;

/// How to track.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TrackOptions {
    /// Search whole pictures instead of windows: slower, same numbers.
    pub full_frame: bool,
    /// A lamp in the picture that goes on or off with every command to the coils.
    pub tick_led: Option<Spot>,
}

/// Why a frame cannot be tracked at all.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrackError {
    /// The pictures do not belong to this rig.
    #[error("the picture has {found:?} pixels, but the rig was calibrated for {expected:?}")]
    Size {
        /// Size of the picture.
        found: [u32; 2],
        /// Size in the rig.
        expected: [u32; 2],
    },
    /// The picture cannot be segmented, or the rig has no colours.
    #[error(transparent)]
    Segment(#[from] SegmentError),
}

/// Follows the markers from frame to frame.
pub struct Tracker {
    rig: Rig,
    options: TrackOptions,
    segmenter: Segmenter,
    assigner: Assigner,
    model: ImageModel,
    transfer: Transfer,
    slip: Seen,
    /// Observed offset of chroma from the rig's, pixels.
    mean_slip_px: Vector2<f64>,
    usual: Usual,
    /// Ratio of a band's expected size to its blob's.
    usual_size: Usual,
    /// Scatter of the position of each marker, then of the tangent.
    scatter: Vec<Scatter>,
    /// For each marker that is the reference of a group: its last fit.
    before: Vec<Option<Last>>,
    motion: Motion,
    lamp: Option<Lamp>,
}

/// Blobs of a picture, and which of them each marker is.
struct Found {
    blobs: Vec<Blob>,
    assigned: Vec<Result<Assigned, Miss>>,
}

/// A fitted group with the views it was fitted in.
struct Fitted {
    group: Group,
    views: Vec<usize>,
    result: Result<TubeFit, Miss>,
}

impl Tracker {
    /// A tracker for a rig whose markers' colours have been learned.
    ///
    /// # Errors
    /// When a marker has no colour model.
    pub fn new(rig: &Rig, options: TrackOptions) -> Result<Self, TrackError> {
        let transfer = Transfer::Bt709;
        Ok(Self {
            segmenter: Segmenter::for_rig(rig)?,
            assigner: Assigner::new(rig),
            model: ImageModel {
                encoding: rig.camera.gamma.map_or_else(|| Encoding::new(transfer), Encoding::power),
                blur_px: rig.camera.blur_px.unwrap_or(DEFAULT_BLUR_PX),
                chroma_offset_px: rig.camera.chroma_offset_px,
                error: ModelError::CODED,
            },
            transfer,
            slip: Seen::default(),
            mean_slip_px: Vector2::zeros(),
            usual: Usual::learned(rig),
            usual_size: Usual::new(rig),
            before: vec![None; rig.markers.len()],
            scatter: vec![Scatter::default(); rig.markers.len() + 1],
            motion: Motion::new(rig.markers.len(), rig.catheter.coil),
            lamp: options.tick_led.map(Lamp::new),
            rig: rig.clone(),
            options,
        })
    }

    /// The rig.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Measures one frame. A marker that cannot be measured is a [`Miss`] in the estimate, not an error.
    ///
    /// # Errors
    /// When the picture does not fit the rig.
    pub fn step(&mut self, frame: &Frame) -> Result<Estimate, TrackError> {
        let picture = &frame.picture;
        if picture.size_px() != self.rig.camera.size_px {
            return Err(TrackError::Size { found: picture.size_px(), expected: self.rig.camera.size_px });
        }
        if picture.is_damaged() {
            return Ok(Estimate::missed(frame, &self.rig, &Miss::Damaged));
        }
        if picture.is_interlaced() {
            return Ok(Estimate::missed(frame, &self.rig, &Miss::Interlaced));
        }
        let tick = self.lamp.as_mut().and_then(|lamp| lamp.step(picture));
        Ok(Estimate { tick, ..self.measure(frame)? })
    }

    fn measure(&mut self, frame: &Frame) -> Result<Estimate, TrackError> {
        let picture = &frame.picture;
        if picture.colour().transfer != self.transfer && self.rig.camera.gamma.is_none() {
            self.transfer = picture.colour().transfer;
            self.model.encoding = Encoding::new(self.transfer);
        }
        self.model.error = ModelError::of(picture);
        // A sample that shows what is to its left is located further left.
        let taught = self.rig.camera.chroma_offset_px;
        self.model.chroma_offset_px = [0, 1].map(|axis| taught[axis] - self.mean_slip_px[axis]);
        // 1. blobs and their assignment to markers and views
        let Found { blobs, assigned } = match self.find(frame) {
            Err(SegmentError::NotRecorded(_)) => return Ok(Estimate::missed(frame, &self.rig, &Miss::NotRecorded)),
            found => found?,
        };
        // 2. the tube around them, fitted to the pictures of all views
        let mut fitted = self.fit_groups(frame, &blobs, &assigned, TRACKED_PX);
        self.judge(&mut fitted, &blobs, &assigned);
        self.keep_shapes(frame.stamp, &fitted);
        // 3. positions, tangent, deflection
        let mut estimate = self.estimate(frame, &assigned, &fitted);
        // 4. implausible motion becomes a miss
        self.motion.check(&mut estimate, fitted.iter().map(|f| f.group.members.as_slice()));
        self.widen(&mut estimate);
        if let (Ok(tangent), Some(base)) = (&estimate.tangent, &self.rig.base) {
            estimate.deflection = Ok(deflection(tangent, base));
        }
        for (m, marker) in estimate.markers.iter().enumerate() {
            if let Ok(position) = &marker.position {
                self.assigner.remember(m, position.point, frame.stamp);
            }
        }
        Ok(estimate)
    }

    /// The residual that is usual for a band in each view, RMS in grey values; empty while too few frames were measured,
    /// and for a band that is fitted together with another.
    pub(crate) fn usual_residuals(&self, marker: usize) -> Vec<f64> {
        self.usual.values(marker).unwrap_or_default()
    }

    /// How badly the tube's model fits the picture around the bands (mean ln σ² of the residuals, all groups of equal
    /// weight); `None` when not all could be fitted. Neither uses nor changes the memory.
    pub(crate) fn misfit(&mut self, frame: &Frame) -> Option<f64> {
        let (assigned, fitted) = self.fit_alone(frame)?;
        let misfits =
            fitted.iter().map(|f| f.result.as_ref().map(|fit| fit.misfit).ok()).collect::<Option<Vec<_>>>()?;
        (!misfits.is_empty() && assigned.iter().all(Result::is_ok))
            .then(|| misfits.iter().sum::<f64>() / misfits.len() as f64)
    }

    /// The same for a frame that closely follows another: the motion between them blurs it.
    pub(crate) fn misfit_after(&mut self, before: &Frame, frame: &Frame) -> Option<f64> {
        self.before.fill(None);
        let (_, fitted) = self.fit_alone(before)?;
        self.keep_shapes(before.stamp, &fitted);
        let misfit = self.misfit(frame);
        self.before.fill(None);
        misfit
    }

    /// Finds and fits the bands of a frame without any memory.
    #[expect(clippy::type_complexity, reason = "what `fit_groups` takes and gives")]
    fn fit_alone(&mut self, frame: &Frame) -> Option<(Vec<Result<Assigned, Miss>>, Vec<Fitted>)> {
        let blobs = self.segmenter.all_blobs(&frame.picture).ok()?.to_vec();
        let assigned = Assigner::new(&self.rig).assign(&self.rig, &blobs, frame.stamp);
        let fitted = self.fit_groups(frame, &blobs, &assigned, COMPARED_PX);
        Some((assigned, fitted))
    }

    /// Remembers where the tube is, for later frames.
    fn keep_shapes(&mut self, stamp: Timestamp, fitted: &[Fitted]) {
        for Fitted { group, result, .. } in fitted {
            if let Ok(fit) = result {
                let before = &mut self.before[group.reference];
                *before = Some(Last::new(stamp, group, &fit.shape, before.as_ref()));
            }
        }
    }

    fn find(&mut self, frame: &Frame) -> Result<Found, SegmentError> {
        let picture = &frame.picture;
        let windows = self.assigner.windows(&self.rig, frame.stamp);
        if let Some(windows) = &windows {
            let mut blobs = if self.options.full_frame {
                let all = self.segmenter.all_blobs(picture)?.to_vec();
                let size_px = picture.size_px();
                all.into_iter().filter(|blob| windows.iter().any(|w| w.finds_whole(blob, size_px))).collect()
            } else {
                self.segmenter.blobs(picture, windows)?.to_vec()
            };
            blobs.retain(|blob| !blob.touches_border);
            let assigned = self.assigner.assign(&self.rig, &blobs, frame.stamp);
            if assigned.iter().all(Result::is_ok) {
                return Ok(Found { blobs, assigned });
            }
        }
        let blobs = match self.segmenter.all_blobs(picture) {
            Err(SegmentError::NotRecorded(why)) => return self.find_in_parts(frame, why),
            blobs => blobs?.to_vec(),
        };
        let assigned = self.assigner.assign(&self.rig, &blobs, frame.stamp);
        Ok(Found { blobs, assigned })
    }

    /// Bands that lie whole in the parts of a picture that were recorded: how a log is followed whose beginning is lost
    /// or left out. It counts only when all are there: no other tells what is behind what was not recorded.
    fn find_in_parts(&mut self, frame: &Frame, why: NotRecorded) -> Result<Found, SegmentError> {
        let inner = |part: &Window| Search { marker: None, view: None, window: part.shrunk(RING_PX) };
        let searches = frame.picture.recorded().unwrap_or_default().iter().map(inner);
        let searches: Vec<_> = searches.filter(|search| search.window.pixels() > 0).collect();
        let mut blobs = self.segmenter.blobs(&frame.picture, &searches)?.to_vec();
        blobs.retain(|blob| !blob.touches_border);
        let assigned = self.assigner.assign(&self.rig, &blobs, frame.stamp);
        if assigned.iter().all(Result::is_ok) { Ok(Found { blobs, assigned }) } else { Err(why.into()) }
    }

    fn fit_groups(
        &self,
        frame: &Frame,
        blobs: &[Blob],
        assigned: &[Result<Assigned, Miss>],
        margin_px: f64,
    ) -> Vec<Fitted> {
        let sees = |m: usize, v: usize| assigned[m].as_ref().is_ok_and(|a| a.blobs[v].is_some());
        let views = 0..self.rig.views.len();
        let together = |a: usize, b: usize| views.clone().filter(|&v| sees(a, v) && sees(b, v)).count() >= 2;
        groups(&self.rig, together)
            .into_par_iter()
            .map(|group| {
                let views: Vec<usize> =
                    views.clone().filter(|&v| group.members.iter().all(|&(m, _)| sees(m, v))).collect();
                let result = self.fit_group(frame, (blobs, assigned), &group, &views, margin_px);
                Fitted { group, views, result }
            })
            .collect()
    }

    /// Judges the fits of a frame by the frames before: slip of chroma, usual residuals of the bands, and how much of
    /// them is seen.
    fn judge(&mut self, fitted: &mut [Fitted], blobs: &[Blob], assigned: &[Result<Assigned, Miss>]) {
        self.slip = self.slip.faded(0.5_f64.powf(1.0 / SLIP_FRAMES));
        for fit in fitted.iter().filter_map(|f| f.result.as_ref().ok()) {
            self.slip.add(&fit.slip.beyond(&self.mean_slip_px));
        }
        let variance_px2 = self.slip.variance_px2();
        self.mean_slip_px = self.slip.mean_px();
        let residuals = fitted.iter().flat_map(|Fitted { group, views, result }| {
            let of_views = result.iter().flat_map(|fit| &fit.views);
            views.iter().zip(of_views).map(|(v, view)| (group.reference, *v, view.rms))
        });
        let common = self.usual.common(residuals);
        for Fitted { group, views, result } in fitted {
            let Ok(fit) = result else { continue };
            fit.covariance += fit.slip_covariance * variance_px2;
            // Expected area of the reference band over that of its blob.
            let missing = |v: usize, view: &ViewFit| {
                let blob = assigned[group.reference].as_ref().ok()?.blobs[v]?;
                let knot = view.image.at_arc(0.0);
                let expected = 2.0 * knot.half_width * knot.scale * self.rig.markers[group.reference].length_m;
                Some(expected / blobs[blob].area_px2)
            };
            let sizes: Vec<_> = views.iter().zip(&fit.views).map(|(&v, view)| missing(v, view)).collect();
            let signs = views.iter().zip(&fit.views).zip(&sizes).map(|((&v, view), size)| {
                let of_size =
                    size.map_or(0.0, |size| self.usual_size.above(group.reference, v, size, 0.0)).min(MAX_SIZE_TERM);
                self.usual.above(group.reference, v, view.rms, common).hypot(of_size)
            });
            let signs: Vec<f64> = signs.collect();
            if signs.iter().map(|sign| sign * sign).sum::<f64>().sqrt() > MAX_UNUSUAL_SD
                && let Some((i, _)) = signs.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))
            {
                let view = &fit.views[i];
                let separation = self.least_separation(group, views[i], &view.colours);
                *result = Err(Miss::PoorFit { moved_px: view.residual_px.norm(), separation });
                continue;
            }
            for ((v, view), size) in views.iter().zip(&fit.views).zip(sizes) {
                self.usual.add(group.reference, *v, view.rms);
                if let Some(size) = size {
                    self.usual_size.add(group.reference, *v, size);
                }
            }
        }
    }

    /// Widens covariances to match the scatter of positions and tangent from frame to frame.
    fn widen(&mut self, estimate: &mut Estimate) {
        let (stamp, persisting) = (estimate.stamp, self.model.error.persisting);
        for (marker, scatter) in estimate.markers.iter_mut().zip(&mut self.scatter) {
            if let Ok(position) = &mut marker.position {
                position.covariance *= scatter.add(stamp, position.point.coords, &position.covariance, persisting);
            }
        }
        if let (Ok(tangent), Some(scatter)) = (&mut estimate.tangent, self.scatter.last_mut()) {
            tangent.covariance *= scatter.add(stamp, tangent.direction, &tangent.covariance, persisting);
        }
    }

    fn fit_group(
        &self,
        frame: &Frame,
        (blobs, assigned): (&[Blob], &[Result<Assigned, Miss>]),
        group: &Group,
        views: &[usize],
        margin_px: f64,
    ) -> Result<TubeFit, Miss> {
        let reference = assigned[group.reference].as_ref().map_err(Clone::clone)?;
        let starts = group.members.iter().map(|&(m, s)| Ok((s, assigned[m].as_ref().map_err(Clone::clone)?.point)));
        let starts = starts.collect::<Result<Vec<_>, Miss>>()?;
        let direction = self.start_direction(blobs, assigned, group).ok_or(Miss::NotConverged)?;
        let paths: Vec<&OpticalPath> = views.iter().map(|&v| &self.rig.views[v].optics).collect();
        let ranges: Vec<_> = views.iter().map(|&v| self.seen_range(group, assigned, v)).collect();
        let last = self.before[group.reference].as_ref();
        let before = last.and_then(|last| Some((&last.shape, last.age_s(frame.stamp)?)));
        let sweep = before
            .zip(self.rig.camera.exposure_s)
            .map(|((before, since_s), exposure_s)| Sweep { before: before.clone(), share: exposure_s / since_s });
        let fitting = Fitting {
            stretch: &group.stretch,
            picture: &frame.picture,
            paths: &paths,
            ranges_m: &ranges,
            model: &self.model,
            sweep: sweep.as_ref(),
            margin_px,
        };
        let accepted = |fit: Result<TubeFit, NoFit>| {
            let fit = fit.map_err(|why| match why {
                NoFit::OutOfPicture | NoFit::NotConverged => Miss::NotConverged,
                NoFit::NotRecorded => Miss::NotRecorded,
                NoFit::TooCoarse => Miss::TooCoarse,
            })?;
            self.accept(group, views, &starts, &fit).map(|()| fit)
        };
        let fit_from = |start: &TubeShape| accepted(fitting.fit(start));
        let is_usual = |fit: &TubeFit| {
            let beyond = |(v, view): (&usize, &ViewFit)| self.usual.beyond(group.reference, *v, view.rms);
            views.iter().zip(&fit.views).all(|seen| beyond(seen).is_some_and(|sd| sd < CONTINUED_SD))
        };
        let continued = last.and_then(|last| last.continued(frame.stamp, group)).as_ref().map(fit_from);
        match continued {
            Some(Ok(fit)) if is_usual(&fit) => return Ok(fit),
            _ => {}
        }
        // Blurred or half-hidden blobs tell little about the direction: the previous one may be closer, or the way from
        // the band before.
        let blurred = |fit: &TubeFit| fit.views.iter().any(|view| view.image.at_arc(0.0).swept.sum() > BLURRED_PX2);
        let unusual = |fit: &TubeFit| {
            let ratio = |(v, view): (&usize, &ViewFit)| self.usual.ratio(group.reference, *v, view.rms);
            views.iter().zip(&fit.views).any(|seen| ratio(seen) > UNUSUAL_RESIDUAL)
        };
        let straight = |direction| TubeShape::straight(reference.point, &direction, group.straight_half_m);
        let settled = fitting.settle(&straight(direction));
        let is_same = |fit: &TubeFit| settled.as_ref().is_ok_and(|settled| settled.is_at(fit, &group.stretch));
        match continued {
            Some(Ok(fit)) if !blurred(&fit) && !unusual(&fit) && is_same(&fit) => return Ok(fit),
            _ => {}
        }
        let first = accepted(settled.and_then(|settled| fitting.measure(settled)));
        let (blurred, unusual) = match &first {
            Ok(fit) => (blurred(fit), unusual(fit)),
            Err(miss) => [matches!(miss, Miss::PoorFit { .. } | Miss::NotConverged); 2].into(),
        };
        let previous = before.filter(|_| blurred || unusual);
        let previous = previous.map(|(before, _)| TubeShape { centre: reference.point, ..before.clone() });
        let bent = self.bent_direction(assigned, group.reference).filter(|_| unusual);
        let bent = bent.map(straight);
        let others = [previous, bent].into_iter().flatten().map(|start| fit_from(&start));
        continued.into_iter().chain(others).fold(first, |best, other| match (best, other) {
            (Ok(best), Ok(fit)) if fit.misfit < best.misfit => Ok(fit),
            (Err(_), Ok(fit)) => Ok(fit),
            (best, _) => best,
        })
    }

    /// Direction at a marker of a tube bent uniformly from the marker before, where it hangs as it does at rest: it
    /// turns twice as far as the chord. Without a base frame, the direction of the chord.
    fn bent_direction(&self, assigned: &[Result<Assigned, Miss>], marker: usize) -> Option<Vector3<f64>> {
        let before = assigned.get(marker.checked_sub(1)?)?.as_ref().ok()?;
        let chord = (assigned[marker].as_ref().ok()?.point - before.point).try_normalize(0.0)?;
        let rest = self.rig.base.as_ref().map(|base| base.base_from_camera.inverse() * Vector3::z());
        Some(rest.map_or(chord, |rest| chord * (2.0 * chord.dot(&rest)) - rest))
    }

    /// Arc lengths between which a view shows the tube of a group: where it does not show the next band, whatever hides
    /// that may begin right after this one.
    fn seen_range(&self, group: &Group, assigned: &[Result<Assigned, Miss>], view: usize) -> (f64, f64) {
        let hidden = |m: usize| match assigned.get(m) {
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

    /// Direction of the tube at the reference, base to tip: from its blobs' axes, or along the chord to its neighbours.
    fn start_direction(
        &self,
        blobs: &[Blob],
        assigned: &[Result<Assigned, Miss>],
        group: &Group,
    ) -> Option<Vector3<f64>> {
        let m = group.reference;
        let here = assigned[m].as_ref().ok()?;
        let place = |i: usize| assigned.get(i).and_then(|a| a.as_ref().ok()).map(|a| a.point);
        let before = m.checked_sub(1).and_then(place);
        let chord = match (before, place(m + 1)) {
            (_, Some(next)) => Some(next - here.point),
            (Some(previous), None) => Some(here.point - previous),
            (None, None) => None,
        };
        let axes: Vec<_> = here
            .blobs
            .iter()
            .enumerate()
            .filter_map(|(v, blob)| blob.map(|b| (&self.rig.views[v], blobs[b].axis)))
            .collect();
        match (direction_of_axes(&axes, &here.point), chord) {
            (Some(axis), Some(chord)) => Some(if axis.dot(&chord) < 0.0 { -axis } else { axis }),
            // Without a neighbour the sign is undetermined: along gravity or, failing that, down in the picture.
            (Some(axis), None) => {
                let down =
                    self.rig.base.as_ref().map_or(Vector3::y(), |base| base.base_from_camera.inverse() * Vector3::z());
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
            let separation = self.least_separation(group, v, &view.colours);
            if !(moved <= MAX_MOVED.0.max(MAX_MOVED.1 * knot.half_width) && separation >= MIN_SEPARATION) {
                return Err(Miss::PoorFit { moved_px: moved, separation });
            }
        }
        let chi2: f64 = fit
            .views
            .iter()
            .filter_map(|v| {
                Some((v.residual_px.transpose() * v.residual_covariance_px2.try_inverse()? * v.residual_px)[0])
            })
            .sum();
        let shift = fit.views.iter().map(|v| v.residual_px.norm()).fold(0.0, f64::max);
        if chi2 > DISAGREEMENT.0 && shift > DISAGREEMENT.1 {
            let px_per_m = fit.views.iter().map(|v| v.image.at_arc(0.0).scale).fold(f64::INFINITY, f64::min);
            return Err(Miss::RaysDiverge { distance_m: shift / px_per_m });
        }
        Ok(())
    }

    /// The least [`Self::separation`] of a group's bands in a view.
    fn least_separation(&self, group: &Group, view: usize, colours: &[f64]) -> f64 {
        (0..group.members.len()).map(|i| self.separation(group, i, view, colours)).fold(f64::INFINITY, f64::min)
    }

    /// Separation of a band's fitted colour from the most similar of its neighbours and background.
    fn separation(&self, group: &Group, member: usize, view: usize, colours: &[f64]) -> f64 {
        let Some(model) = self.rig.markers[group.members[member].0].colour(view) else { return 0.0 };
        let rgb = |at: usize| Vector3::from_fn(|c, _| f64::from(self.model.encoding.encode(colours[at + c] as f32).0));
        let segment = |j: usize| FIXED + PER_SEGMENT * j;
        let band = 2 * member + 1;
        let last = group.stretch.layout.segments() - 1;
        let neighbours = [Some(segment(band - 1)), (band < last).then(|| segment(band + 1)), Some(0)];
        let own = rgb(segment(band));
        let apart = neighbours.into_iter().flatten().map(|at| model.separation(&own, &rgb(at)));
        apart.fold(f64::INFINITY, f64::min)
    }

    fn estimate(&self, frame: &Frame, assigned: &[Result<Assigned, Miss>], fitted: &[Fitted]) -> Estimate {
        let mut markers: Vec<MarkerEstimate> = assigned
            .iter()
            .map(|a| {
                let miss = a.as_ref().err().cloned().unwrap_or(Miss::NotConverged);
                MarkerEstimate::missed(&miss, self.rig.views.len())
            })
            .collect();
        let mut tangent = Err(Miss::MarkerMissing);
        for Fitted { group, views, result } in fitted {
            for (i, &(m, s)) in group.members.iter().enumerate() {
                markers[m] = match result {
                    Ok(fit) => self.marker(group, i, s, views, fit),
                    Err(miss) => MarkerEstimate::missed(miss, self.rig.views.len()),
                };
            }
            if group.reference == self.rig.catheter.coil
                && let Ok(fit) = result
            {
                let across = fit.shape.across();
                let turned =
                    |shape: &SMatrix<f64, SHAPE, SHAPE>| across * shape.fixed_view::<2, 2>(3, 3) * across.transpose();
                let (covariance, bound) = (turned(&fit.covariance), turned(&fit.bound));
                tangent = Ok(Tangent { direction: fit.shape.tangent(), covariance, bound });
            }
        }
        let deflection = match &tangent {
            Ok(_) => Err(Miss::NoBaseFrame),
            Err(miss) => Err(miss.clone()),
        };
        let Frame { seq, stamp, gap, host, .. } = *frame;
        Estimate { seq, stamp, gap, host, markers, tangent, deflection, tick: None }
    }

    fn marker(&self, group: &Group, member: usize, s: f64, views: &[usize], fit: &TubeFit) -> MarkerEstimate {
        let (point, _, d) = fit.shape.at(s);
        let covariance: Matrix3<f64> = d * fit.covariance * d.transpose();
        let bound: Matrix3<f64> = d * fit.bound * d.transpose();
        let half = self.rig.markers[group.members[member].0].length_m / 2.0;
        let observed = (0..self.rig.views.len())
            .map(|v| {
                let Some(i) = views.iter().position(|used| *used == v) else {
                    return Err(Miss::NotSeen { view: v });
                };
                let view = &fit.views[i];
                let knot = view.image.at_arc(s);
                let centre = self.rig.views[v].optics.project(&point).map_err(|_| Miss::NotSeen { view: v })?;
                Ok(BandObservation {
                    centre_px: centre + view.residual_px,
                    covariance_px2: view.residual_covariance_px2,
                    axis: knot.along / knot.scale,
                    axis_sd_rad: axis_sd_rad(&view.image, s, &fit.covariance),
                    residual_px: view.residual_px,
                    fit_rms: view.rms,
                    separation: self.separation(group, member, v, &view.colours),
                    outline_px: outline(&view.image, s - half, s + half),
                })
            })
            .collect();
        MarkerEstimate { position: Ok(Position { point, covariance, bound }), views: observed }
    }
}

/// Standard deviation of the axis' direction in the picture, from the covariance of the shape.
fn axis_sd_rad(image: &TubeImage, s: f64, covariance: &SMatrix<f64, SHAPE, SHAPE>) -> f64 {
    // The direction turns by the difference of two neighbouring knots' lateral displacements over their distance.
    let i = (image.knot_of(s).floor().max(0.0) as usize).min(image.knots.len().saturating_sub(2));
    let (a, b) = (&image.knots[i], &image.knots[i + 1]);
    let along = b.pixel - a.pixel;
    let across = nalgebra::RowVector2::new(-along.y, along.x) / along.norm_squared();
    let d = across * (b.d_pixel - a.d_pixel);
    (d * covariance * d.transpose())[0].max(0.0).sqrt()
}

/// Outline of the tube between two arc lengths: down one side, up the other.
fn outline(image: &TubeImage, from_m: f64, to_m: f64) -> Vec<Point2<f64>> {
    const POINTS: usize = 5;
    let side = |sign: f64, i: usize| {
        let s = from_m + (to_m - from_m) * i as f64 / (POINTS - 1) as f64;
        image.beside(image.knot_of(s), sign)
    };
    (0..POINTS).map(|i| side(-1.0, i)).chain((0..POINTS).rev().map(|i| side(1.0, i))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::ColourModel;
    use crate::testing::fixture;
    use crate::testing::two_views::{BLUR_PX, Tube, views};

    /// Coil and tip are fitted together, but each must stay where it was found.
    #[test]
    fn a_fit_that_leaves_one_of_its_bands_is_refused() {
        let mut rig = fixture::rig();
        rig.camera.blur_px = Some(BLUR_PX);
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
        let mut tracker = Tracker::new(&rig, TrackOptions::default()).unwrap();
        tracker.model.encoding = Encoding::new(picture.colour().transfer);
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
            let group = groups(&rig, |a, b| a > 0 && b > 0).remove(0);
            tracker.fit_group(&frame, (&[], &assigned), &group, &[0, 1], TRACKED_PX)
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
