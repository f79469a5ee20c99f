//! Follows what the coil's motion, and some fits made in other ways too, tell of the pictures (blur, blending, lag,
//! woven fields) and of the tube's diameter.

use super::{TRACKED_PX, Tracker};
use crate::source::{Frame, Timestamp};
use crate::track::assign::Found;
use crate::track::fit::group_fit::Fitted;
use crate::track::fit::tube_fit::TubeFit;
use crate::track::memory::trials::LONGEST_STEP_S;
use crate::track::model::tube_shape::TubeShape;
use crate::track::recording::diameter::Diameter;
use crate::track::recording::focus::Focus;
use nalgebra::Vector2;

/// Blurs that may be taken for another diameter of the tube, over that of the pictures.
const OTHER_BLURS: [f64; 3] = [0.7, 1.4, 1.8];

impl Tracker {
    /// What the motion of the coil since the last frame tells of the pictures; how far it was, pixels, if it was seen.
    pub(super) fn look_at_motion(&mut self, stamp: Timestamp, fitted: &[Fitted]) -> Option<f64> {
        let (of_coil, fit) = self.of_coil(fitted)?;
        self.denoised.pixel_m = fit.pixel_m();
        let ways_px = self.ways_px(stamp, of_coil, fit)?;
        self.lag.begin(&ways_px);
        for ((v, view), way_px) in of_coil.views.iter().zip(&fit.views).zip(&ways_px) {
            let [across, _] = view.image.at_arc(0.0).axes();
            self.fields.add(&view.rows, across.dot(way_px));
            self.lag.add(*v, &view.slip, way_px);
        }
        Some(ways_px.iter().map(Vector2::norm).fold(0.0, f64::max))
    }

    /// Fits the coil of some frames with less and with more blur too, of the lens or of the motion, and follows it.
    pub(super) fn follow_blur(&mut self, frame: &Frame, found: &Found, fitted: &[Fitted], moved_px: Option<f64>) {
        let (Some((of_coil, fit)), Some(moved_px)) = (self.of_coil(fitted), moved_px) else { return };
        // In blended pictures what moves looks out of focus.
        let tries = if self.blending.is_seen() {
            [None, None]
        } else {
            self.focus.tries(frame.stamp, moved_px, self.diameter.is_right())
        };
        if tries.iter().any(Option::is_some) {
            let with =
                |blurs_px: &Vec<Vector2<f64>>| self.fitting(frame, found, blurs_px, TRACKED_PX).again(of_coil, None);
            let tried = tries.each_ref().map(|less_and_more| both(less_and_more.as_ref()?, with));
            if self.focus.moves(&of_coil.views, fit, &tried) {
                self.begin_resting();
            }
        } else if let Some(ways) = self.blending.tries(frame.stamp, moved_px) {
            let with =
                |way: &f64| self.fitting(frame, found, self.focus.blurs_px(), TRACKED_PX).again(of_coil, Some(*way));
            if let Some([less, more]) = both(&ways, with)
                && self.blending.add([less.misfit, more.misfit])
            {
                self.focus = Focus::of(&self.rig);
                self.begin_resting();
            }
        }
    }

    /// Fits the coil of some frames with another diameter too, if the bands do not look as wide as the rig's tube.
    pub(super) fn follow_diameter(&mut self, frame: &Frame, found: &Found, fitted: &[Fitted]) {
        let (Some(times), Some((of_coil, fit))) = (self.diameter.tried(), self.of_coil(fitted)) else { return };
        let mut group = of_coil.group.clone();
        group.stretch.radius_m *= times;
        let other = Fitted { group, views: of_coil.views.clone(), result: Ok(fit.clone()), directed: true };
        let blurs_px = self.focus.blurs_px();
        let Some(fit) = self.fitting(frame, found, blurs_px, TRACKED_PX).again(&other, None) else { return };
        let blurred = OTHER_BLURS.iter().filter_map(|times| {
            let blurs_px: Vec<_> = blurs_px.iter().map(|blur_px| blur_px * *times).collect();
            self.fitting(frame, found, &blurs_px, TRACKED_PX).again(of_coil, None)
        });
        let blurred: Vec<TubeFit> = blurred.collect();
        self.diameter.add_tried(&fit, &blurred);
    }

    /// With another blur the base band moves with the model, not with the camera, and bands look otherwise.
    fn begin_resting(&mut self) {
        self.judge.forget_looks(&self.rig);
        self.shake.forget();
        self.moved.forget();
        self.diameter = Diameter::of(&self.rig);
    }

    /// The coil's group, if it was fitted.
    fn of_coil<'f>(&self, fitted: &'f [Fitted]) -> Option<(&'f Fitted, &'f TubeFit)> {
        let shows_coil = |fitted: &&Fitted| fitted.group.members.iter().any(|(m, _)| *m == self.rig.catheter.coil);
        let of_coil = fitted.iter().find(shows_coil)?;
        Some((of_coil, of_coil.result.as_ref().ok()?))
    }

    /// How far a group's reference has moved in each view since it was last seen, pixels; `None` if that is too long
    /// ago.
    pub(super) fn ways_px(&self, stamp: Timestamp, fitted: &Fitted, fit: &TubeFit) -> Option<Vec<Vector2<f64>>> {
        let last = self.before[fitted.group.reference].as_ref()?;
        last.age_within_s(LONGEST_STEP_S, stamp)?;
        let way_px = |view: &usize| {
            let pixel = |shape: &TubeShape| self.rig.views[*view].optics.project(&shape.centre).ok();
            Some(pixel(&fit.shape)? - pixel(&last.shape)?)
        };
        fitted.views.iter().map(way_px).collect()
    }
}

/// Fits with less and with more of something, at the same time.
fn both<T: Sync>([less, more]: &[T; 2], with: impl Fn(&T) -> Option<TubeFit> + Sync) -> Option<[TubeFit; 2]> {
    let (less, more) = rayon::join(|| with(less), || with(more));
    Some([less?, more?])
}
