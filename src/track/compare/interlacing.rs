//! Notices two fields woven into one picture that is not marked as interlaced, as grabbers and converters write it:
//! even and odd rows show different moments, so a band that moves has no single position.
//!
//! Method. The residuals of the fit tell by how much the even rows show the tube further across than all rows do: their
//! mean with a sign for each row, over the change for a shift of one pixel. That is half the distance of the fields: a
//! quarter of the way since the last picture, or half of it where every row was taken from a full picture, always to
//! the same side. No mosaic, sharpening or coder shifts rows in proportion to a motion. So frames in which the coil
//! moves across itself by a few pixels vote.
//!
//! Cannot detect: fields before the votes are in; what hardly moves; pictures that were resized afterwards.

/// Motion across the tube of frames that vote, pixels: of a shorter one fields are hardly apart, of a longer one the
/// rows do not show one band any more.
const MOTION_PX: std::ops::Range<f64> = 1.0..5.0;
/// Shift of the even rows over that motion beyond which fields are woven: half of what is least.
const LEAST_SHIFT: f64 = 0.125;
/// Standard deviations of its noise that such a shift must exceed.
const CLEAR_SD: f64 = 4.0;
/// Votes for one order of the fields, less those against it; each view has one in every frame. Measured: nine in ten of
/// woven pictures are for one, and none of 11 000 of others.
const MAJORITY: i32 = 6;

/// By how much the even rows of a picture show the tube further across: sums over the samples of a view.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::track) struct RowShift {
    /// Σ ±w r t and Σ w t²: weights, residuals, changes for a shift of one pixel across the tube.
    pull: f64,
    information: f64,
}

impl RowShift {
    /// Adds samples: Σ ±w r t, even rows with +, and Σ w t².
    pub(super) fn add(&mut self, pull: f32, information: f32) {
        self.pull += f64::from(pull);
        self.information += f64::from(information);
    }
}

/// The votes so far.
#[derive(Debug, Default)]
pub(in crate::track) struct Fields {
    /// For even rows that are ahead over those that are behind.
    ahead: i32,
}

impl Fields {
    /// Adds a view of a frame: its shift, and how far its tube has moved across itself since the last one, pixels.
    pub(in crate::track) fn add(&mut self, shift: &RowShift, across_px: f64) {
        if !MOTION_PX.contains(&across_px.abs()) || shift.information <= 0.0 {
            return;
        }
        let (even_px, sd_px) = (shift.pull / shift.information, shift.information.powf(-0.5));
        if even_px.abs() > (LEAST_SHIFT * across_px.abs()).max(CLEAR_SD * sd_px) {
            self.ahead += if even_px * across_px > 0.0 { 1 } else { -1 };
        } else {
            self.ahead -= self.ahead.signum();
        }
        self.ahead = self.ahead.clamp(-2 * MAJORITY, 2 * MAJORITY);
    }

    /// Whether two moments are woven together.
    pub(in crate::track) fn are_woven(&self) -> bool {
        self.ahead.abs() >= MAJORITY
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// After some frames of two views in which the even rows are ahead by a part of each motion.
    fn are_woven(frames: usize, part: f64, motion_px: f64) -> bool {
        const SD_PX: f64 = 0.03;
        let (mut fields, mut random) = (Fields::default(), Random::new(2));
        for i in 0..2 * frames {
            // A swing.
            let across_px = motion_px * if i / 10 % 2 == 0 { 1.0 } else { -0.8 };
            let information = SD_PX.powi(-2);
            let pull = (part * across_px + SD_PX * random.normal()) * information;
            fields.add(&RowShift { pull, information }, across_px);
        }
        fields.are_woven()
    }

    #[test]
    fn rows_shifted_in_proportion_to_a_motion_are_fields_of_either_order() {
        for part in [-0.5, -0.25, 0.25, 0.5] {
            assert!(are_woven(4, part, 2.0), "{part}");
            assert!(!are_woven(2, part, 2.0), "{part}: too soon");
        }
    }

    #[test]
    fn noise_small_motions_and_a_shift_of_its_own_are_no_fields() {
        for motion_px in [0.5, 1.2, 2.0, 4.0, 9.0] {
            assert!(!are_woven(200, 0.0, motion_px) && !are_woven(200, 0.05, motion_px), "{motion_px} px");
        }
        // A shift that does not follow the motion, larger than any mosaic's.
        let mut fields = Fields::default();
        for i in 0..200 {
            fields.add(&RowShift { pull: 400.0, information: 1000.0 }, if i / 4 % 2 == 0 { 2.0 } else { -2.0 });
            assert!(!fields.are_woven());
        }
    }
}
