//! [`Tracker`]: one frame in, one estimate out. Composes assignment, the fit of the tube, its judgement, the answer.

mod calibration;
mod following;
mod warnings;
mod widening;

use crate::estimate::{Estimate, Miss, Spot};
use crate::rig::Rig;
use crate::segment::SegmentError;
use crate::source::times::Resolution;
use crate::source::{Frame, Picture, PixelFormat, Timestamp, Transfer};
use crate::track::answer;
use crate::track::answer::deflection::deflection;
use crate::track::answer::lateness::Ways;
use crate::track::answer::moved::Moved;
use crate::track::answer::rolling_shutter::Rolling;
use crate::track::answer::scatter::Scatter;
use crate::track::answer::shake::Shake;
use crate::track::assign::{Finder, Found};
use crate::track::compare::interlacing::Fields;
use crate::track::compare::sensor_noise::Grain;
use crate::track::fit::colour_fringes::Fringes;
use crate::track::fit::group_fit::{Fitted, GroupFitting};
use crate::track::fit::last_fit::Last;
use crate::track::judge::{Judge, Motion};
use crate::track::model::functions::Encoding;
use crate::track::model::image_model::{ImageModel, ModelError};
use crate::track::model::mosaic::Interpolated;
use crate::track::recording::blending::Blending;
use crate::track::recording::blocks::Blocks;
use crate::track::recording::chroma_lag::Lag;
use crate::track::recording::copied::Copied;
use crate::track::recording::denoised::Denoised;
use crate::track::recording::diameter::Diameter;
use crate::track::recording::focus::Focus;
use crate::track::recording::lamp::Lamp;
use crate::track::recording::long_exposure::LongExposure;
use crate::track::recording::paired_chroma::Pairs;
use crate::track::recording::picture_order::Order;
use crate::track::recording::repeated_pictures::Repeats;
use crate::track::recording::torn_pictures::Torn;
use nalgebra::Vector2;
use warnings::{
    BLENDED, COLOURS_LAG, COPIED, DENOISED, FOREIGN, FRINGES, LAMP_CHANGED, LONG_EXPOSURE, LOOKS_OTHERWISE, MOVED,
    OTHER_TUBE, OUT_OF_FOCUS, OUT_OF_ORDER, PAIRED_CHROMA, SHAKES, STALLED, SWINGS, TORN, UNLIKE_TAUGHT, UNSTEADY,
    VIEWS_DISAGREE, WOVEN,
};

/// Background beside the tube that is fitted, pixels: as far as blur and neighbourhoods of chroma show the tube. Where
/// models are compared, more of it tells what is noise.
const TRACKED_PX: f64 = 4.0;
const COMPARED_PX: f64 = 5.0;
/// The coil is refused for its looks in so many frames in a row: there is a warning.
const LONG_POOR: u32 = 30;

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

/// What a frame was measured from.
pub(crate) struct Measured {
    found: Found,
    fitted: Vec<Fitted>,
    /// How far the coil moved since it was last seen, pixels.
    moved_px: Option<f64>,
}

/// Follows the markers from frame to frame.
pub struct Tracker {
    rig: Rig,
    finder: Finder,
    model: ImageModel,
    transfer: Transfer,
    judge: Judge,
    /// Scatter of the position of each marker, then of the tangent.
    scatter: Vec<Scatter>,
    stamps: Resolution,
    /// For each marker that is the reference of a group: its last fit.
    before: Vec<Option<Last>>,
    motion: Motion,
    focus: Focus,
    /// In how many of the last frames the coil looked otherwise than before, refused for it or not; `None` before it
    /// was ever seen.
    poor_in_a_row: Option<u32>,
    blending: Blending,
    denoised: Denoised,
    ways: Ways,
    lag: Lag,
    order: Order,
    shake: Shake,
    moved: Moved,
    repeats: Repeats,
    torn: Torn,
    pairs: Pairs,
    blocks: Blocks,
    copied: Copied,
    interpolated: Interpolated,
    grain: Grain,
    fields: Fields,
    fringes: Fringes,
    exposure: LongExposure,
    rolling: Option<Rolling>,
    diameter: Diameter,
    /// What was warned of.
    warned: Vec<&'static str>,
    /// The last frame that was measured.
    latest: Option<(u64, Timestamp)>,
    lamp: Option<Lamp>,
}

impl Tracker {
    /// A tracker for a rig whose markers' colours have been learned.
    ///
    /// # Errors
    /// When a marker has no colour model.
    pub fn new(rig: &Rig, options: TrackOptions) -> Result<Self, TrackError> {
        let transfer = Transfer::Bt709;
        Ok(Self {
            finder: Finder::new(rig, options.full_frame)?,
            model: ImageModel {
                encoding: rig.camera.gamma.map_or_else(|| Encoding::new(transfer), Encoding::power),
                chroma_offset_px: rig.camera.chroma_offset_px,
                chroma_reach: rig.camera.chroma_reach,
                mosaic: None,
                error: ModelError::CODED,
                first_coded: None,
            },
            transfer,
            judge: Judge::new(rig),
            before: vec![None; rig.markers.len()],
            scatter: vec![Scatter::default(); rig.markers.len() + 1],
            stamps: Resolution::default(),
            motion: Motion::new(rig.markers.len(), rig.catheter.coil),
            focus: Focus::of(rig),
            poor_in_a_row: None,
            blending: Blending::default(),
            denoised: Denoised::default(),
            ways: Ways::new(rig.markers.len()),
            lag: Lag::default(),
            order: Order::default(),
            shake: Shake::default(),
            moved: Moved::default(),
            repeats: Repeats::default(),
            torn: Torn::default(),
            pairs: Pairs::default(),
            blocks: Blocks::default(),
            copied: Copied::default(),
            interpolated: Interpolated::default(),
            grain: Grain::default(),
            fields: Fields::default(),
            fringes: Fringes::of(rig),
            exposure: LongExposure::of(rig.camera.exposure_s),
            rolling: Rolling::of(rig),
            diameter: Diameter::of(rig),
            warned: Vec::new(),
            latest: None,
            lamp: options.tick_led.map(Lamp::new),
            rig: rig.clone(),
        })
    }

    /// The same for learning the bands: how they look is not known yet, and may differ from frame to frame.
    ///
    /// # Errors
    /// As [`Tracker::new`].
    pub(crate) fn lenient(rig: &Rig) -> Result<Self, TrackError> {
        Ok(Self { judge: Judge::lenient(rig), ..Self::new(rig, TrackOptions::default())? })
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
        let (estimate, measured) = self.measure(frame)?;
        self.learn(frame, measured);
        Ok(estimate)
    }

    /// Only the measurement, for which somebody may be waiting. What later frames need from it is to be learned before
    /// the next one.
    pub(crate) fn measure(&mut self, frame: &Frame) -> Result<(Estimate, Option<Measured>), TrackError> {
        if let Some((_, before)) = self.latest.replace((frame.seq, frame.stamp)) {
            self.exposure.add(frame.stamp, before);
        }
        let picture = &frame.picture;
        if picture.size_px() != self.rig.camera.size_px {
            return Err(TrackError::Size { found: picture.size_px(), expected: self.rig.camera.size_px });
        }
        let missed = |why: &Miss| Estimate::missed(frame, &self.rig, why);
        if picture.is_damaged() {
            return Ok((missed(&Miss::Damaged), None));
        }
        if picture.is_interlaced() {
            return Ok((missed(&Miss::Interlaced), None));
        }
        let predicted = self.model.is_predicted(picture);
        if self.repeats.is_repeated(picture, frame.stamp, predicted) {
            return Ok((missed(&Miss::Repeated), None));
        }
        if !predicted && self.torn.is_torn(picture, frame.stamp, self.repeats.noise_is_new()) {
            return Ok((missed(&Miss::Damaged), None));
        }
        let tick = self.lamp.as_mut().and_then(|lamp| lamp.step(picture));
        let (estimate, measured) = self.measure_bands(frame)?;
        let estimate = estimate.unwrap_or_else(|why| Estimate::missed(frame, &self.rig, &why));
        Ok((Estimate { tick, ..estimate }, measured))
    }

    /// What later frames need from a measured one: its shapes, and sometimes whether another blur fits it better.
    pub(crate) fn learn(&mut self, frame: &Frame, measured: Option<Measured>) {
        let Some(Measured { found, fitted, moved_px }) = measured else { return };
        self.follow_blur(frame, &found, &fitted, moved_px);
        self.follow_diameter(frame, &found, &fitted);
        self.keep_shapes(frame.stamp, &fitted);
    }

    /// The estimate of a frame, or why there is none.
    fn measure_bands(&mut self, frame: &Frame) -> Result<(Result<Estimate, Miss>, Option<Measured>), TrackError> {
        let picture = &frame.picture;
        if picture.colour().transfer != self.transfer && self.rig.camera.gamma.is_none() {
            self.transfer = picture.colour().transfer;
            self.model.encoding = Encoding::new(self.transfer);
        }
        self.follow_chroma(picture.format());
        // 1. blobs and their assignment to markers and views
        let found = match self.finder.find(&self.rig, frame) {
            Err(SegmentError::NotRecorded(_)) => return Ok((Err(Miss::NotRecorded), None)),
            found => found?,
        };
        self.pairs.add(picture, &found.blobs);
        // A coder that predicts makes noise last itself.
        let tells = picture.is_as_given() && self.base_is_held();
        if tells && !picture.quantisation().is_some_and(|own| own.predicted) {
            let blocks = self.blocks.add(picture, found.windows_of(0), || self.repeats.shows_again(picture));
            self.copied.add(picture, &blocks);
            self.denoised.add(&blocks);
        }
        self.look_for_mosaic(picture, &found);
        let (converted, noisy) = (self.pairs.are_alike(), self.grain.is_sensor());
        self.model.first_coded = self.copied.from().filter(|_| !converted).cloned();
        self.model.error = self.model.error_in(picture, converted, noisy);
        // 2. the tube around them, fitted to the pictures of all views
        let mut fitted = self.fit(frame, &found, TRACKED_PX);
        self.judge.judge(&self.rig, &self.model.encoding, picture.format(), &found, &mut fitted);
        let views = fitted.iter().flat_map(|fitted| &fitted.result).flat_map(|fit| &fit.views);
        views.filter_map(|view| view.grain.as_ref()).for_each(|grain| self.grain.add(grain));
        let moved_px = self.look_at_motion(frame.stamp, &fitted);
        self.widen_by_lag(frame.stamp, &mut fitted);
        for Fitted { group, views, result, .. } in &mut fitted {
            if let Ok(fit) = result {
                self.fringes.follow(group, views, fit);
            }
        }
        if self.fields.are_woven() {
            return Ok((Err(Miss::Interlaced), Some(Measured { found, fitted, moved_px })));
        }
        // 3. positions, tangent, deflection
        let mut estimate = answer::estimate(&self.rig, &self.model.encoding, frame, &found.assigned, &fitted);
        if self.repeats.stands_still(&estimate) {
            return Ok((Err(Miss::Repeated), None));
        }
        self.order.add(&estimate);
        self.diameter.add(&estimate);
        // 4. implausible motion becomes a miss
        self.motion.check(&mut estimate, fitted.iter().map(|f| f.group.members.as_slice()));
        let coil = estimate.markers.get(self.rig.catheter.coil);
        self.poor_in_a_row = match coil.map(|coil| &coil.position) {
            Some(Err(Miss::PoorFit { .. })) => self.poor_in_a_row.map(|frames| frames.saturating_add(1)),
            Some(Ok(_)) if self.judge.looked_otherwise(self.rig.catheter.coil) => {
                self.poor_in_a_row.map(|frames| frames.saturating_add(1))
            }
            Some(Ok(_)) => Some(0),
            _ => self.poor_in_a_row.and(Some(0)),
        };
        self.repeats.notice_stall(&estimate);
        // Before σ is widened: pictures that repeat scatter.
        let at_rest = if self.base_is_held() { found.windows_of(0).count() } else { 0 };
        self.repeats.remember(picture, found.windows(), at_rest, &estimate);
        self.torn.remember(picture, &found, &estimate);
        self.widen(&mut estimate, self.model.is_predicted(picture));
        if let Some(rolling) = &mut self.rolling {
            rolling.correct(&self.rig, &mut estimate);
        }
        if let (Ok(tangent), Some(base)) = (&estimate.tangent, &self.rig.base) {
            estimate.deflection = Ok(deflection(tangent, base));
        }
        for (m, marker) in estimate.markers.iter().enumerate() {
            if let Ok(position) = &marker.position {
                self.finder.remember(m, position.point, frame.stamp);
            }
        }
        Ok((Ok(estimate), Some(Measured { found, fitted, moved_px })))
    }

    /// What to warn of in the pictures so far, each once.
    pub fn warning(&mut self) -> Option<String> {
        let (diameter, stalled, foreign) = (self.diameter.doubt(), self.repeats.stalled(), self.order.foreign());
        let seen = [
            (self.pairs.are_alike(), PAIRED_CHROMA),
            (self.model.first_coded.is_some(), COPIED),
            (self.judge.views_disagree(), VIEWS_DISAGREE),
            (self.judge.usual.is_unlike_learned(), UNLIKE_TAUGHT),
            (self.scatter.iter().any(Scatter::is_unsteady), UNSTEADY),
            (self.shake.is_seen(), SHAKES),
            (self.moved.is_seen(), MOVED),
            (self.moved.swings(), SWINGS),
            (self.focus.has_changed() && self.rig.blurs_px().all(|blur| blur.is_some()), OUT_OF_FOCUS),
            (self.blending.is_seen(), BLENDED),
            (self.denoised.is_seen() && self.model.first_coded.is_none(), DENOISED),
            (self.lag.is_seen(), COLOURS_LAG),
            (self.order.is_wrong(), OUT_OF_ORDER),
            (foreign.is_some(), FOREIGN),
            (self.poor_in_a_row.is_some_and(|frames| frames >= LONG_POOR), LOOKS_OTHERWISE),
            (self.fields.are_woven(), WOVEN),
            (self.fringes.are_seen(), FRINGES),
            (self.exposure.is_seen(), LONG_EXPOSURE),
            (self.lamp.as_ref().is_some_and(Lamp::has_changed), LAMP_CHANGED),
            (stalled.is_some(), STALLED),
            (self.torn.is_seen(), TORN),
            (diameter.is_some(), OTHER_TUBE),
        ];
        let new = seen.into_iter().find(|(seen, what)| *seen && !self.warned.contains(what))?.1;
        self.warned.push(new);
        let noticed = self
            .latest
            .map_or(String::new(), |(seq, stamp)| format!("noticed at frame {seq}, {} s: ", stamp.seconds()));
        let said = match new {
            OTHER_TUBE => diameter,
            STALLED => stalled,
            FOREIGN => foreign.map(|frame| format!("the picture of frame {frame}")),
            _ => None,
        };
        let said = said.unwrap_or_default();
        Some(noticed + &said + new)
    }

    /// Looks for the mosaic of a sensor. What its pixels saw lies where they are, also where the colours lie apart: the
    /// judge adds that to σ.
    fn look_for_mosaic(&mut self, picture: &Picture, found: &Found) {
        self.interpolated.add(picture, &found.blobs);
        self.model.mosaic = self.interpolated.mosaic();
        if self.model.mosaic.is_some() {
            self.model.chroma_offset_px = [0.0; 2];
            self.judge.mean_slip_px = Vector2::zeros();
        }
    }

    /// Takes the offset of chroma that was taught for pictures of this format, less what has been seen since.
    fn follow_chroma(&mut self, format: PixelFormat) {
        let camera = &self.rig.camera;
        let taught = if format.has_chroma_per_pixel() { camera.colour_offset_px } else { camera.chroma_offset_px };
        // A sample that shows what is to its left is located further left.
        self.model.chroma_offset_px = [0, 1].map(|axis| taught[axis] - self.judge.mean_slip_px[axis]);
    }

    fn fit(&self, frame: &Frame, found: &Found, margin_px: f64) -> Vec<Fitted> {
        self.fitting(frame, found, self.focus.blurs_px(), margin_px).fit_all()
    }

    fn fitting<'a>(
        &'a self,
        frame: &'a Frame,
        found: &'a Found,
        blurs_px: &'a [Vector2<f64>],
        margin_px: f64,
    ) -> GroupFitting<'a> {
        let Self { rig, model, judge, before: last, fringes, .. } = self;
        let (base_rests, usual) = (self.shake.is_at_rest(), &judge.usual);
        GroupFitting { rig, model, blurs_px, frame, found, last, usual, fringes, base_rests, margin_px }
    }

    /// Whether the first band is held by the clamp: a coil that comes first moves.
    fn base_is_held(&self) -> bool {
        self.rig.catheter.coil != 0
    }

    /// Remembers where the tube is, for later frames.
    fn keep_shapes(&mut self, stamp: Timestamp, fitted: &[Fitted]) {
        for Fitted { group, views, result, directed } in fitted {
            if let Ok(fit) = result {
                let before = &mut self.before[group.reference];
                *before = Some(Last::fitted(stamp, &group.stretch, views, (fit, *directed), before.as_ref()));
            }
        }
    }
}
