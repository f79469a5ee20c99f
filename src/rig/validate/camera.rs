//! The camera of a rig file.

use super::super::file::CameraFile;
use super::super::{Camera, RigError};
use super::Check;
use crate::optics::Lens;
use nalgebra::{Point2, Vector2};

/// A chroma sample displaced by more than this belongs to another luma sample.
const LARGEST_CHROMA_OFFSET_PX: f64 = 2.0;
/// Longer than any video camera exposes a picture.
const LONGEST_EXPOSURE_MS: f64 = 1000.0;
/// Longer than any rolling shutter needs.
const LONGEST_READOUT_MS: f64 = 200.0;
/// Powers of light that cameras store.
const GAMMAS: std::ops::RangeInclusive<f64> = 0.2..=1.5;
/// What its chroma samples can reach: no less than the nearest pixels.
const CHROMA_REACHES: std::ops::RangeInclusive<f64> = 0.5..=2.0;

impl Check<'_> {
    pub(super) fn camera(&self, raw: &CameraFile) -> Result<Camera, RigError> {
        for (key, size) in [("camera.width_px", raw.width_px), ("camera.height_px", raw.height_px)] {
            if !(1..=65_535).contains(&size) {
                return Err(self.value(key, size, "1 to 65535"));
            }
        }
        for f in raw.focal_px {
            self.positive("camera.focal_px", f)?;
        }
        self.finite("camera.principal_point_px", &raw.principal_point_px)?;
        self.finite("camera.distortion", &raw.distortion)?;
        let denominator = raw.denominator.unwrap_or_default();
        self.finite("camera.denominator", &denominator)?;
        if let Some(blur) = raw.blur_px {
            self.positive("camera.blur_px", blur)?;
        }
        let offset_px = |key: &str, offset_px: Option<[f64; 2]>| {
            let offset_px = offset_px.unwrap_or_default();
            self.finite(key, &offset_px)?;
            if let Some(offset) = offset_px.iter().find(|v| v.abs() > LARGEST_CHROMA_OFFSET_PX) {
                let expected = format!("{LARGEST_CHROMA_OFFSET_PX} px or less either way");
                return Err(self.value(key, offset, expected));
            }
            Ok(offset_px)
        };
        let chroma_offset_px = offset_px("camera.chroma_offset_px", raw.chroma_offset_px)?;
        let chroma_reach = raw.chroma_reach.unwrap_or([1.0; 2]);
        if let Some(reach) = chroma_reach.iter().find(|reach| !CHROMA_REACHES.contains(*reach)) {
            let expected = format!("numbers from {} to {}", CHROMA_REACHES.start(), CHROMA_REACHES.end());
            return Err(self.value("camera.chroma_reach", reach, expected));
        }
        let colour_offset_px = offset_px("camera.colour_offset_px", raw.colour_offset_px)?;
        if let Some(exposure) = raw.exposure_ms {
            self.positive("camera.exposure_ms", exposure)?;
            self.within("camera.exposure_ms", &[exposure], LONGEST_EXPOSURE_MS)?;
        }
        let exposure_s = raw.exposure_ms.map(|ms| ms / 1e3);
        if let Some(readout) = raw.readout_ms {
            self.within("camera.readout_ms", &[readout], LONGEST_READOUT_MS)?;
        }
        let readout_s = raw.readout_ms.filter(|ms| *ms != 0.0).map(|ms| ms / 1e3);
        let lens = Lens {
            focal_px: Vector2::from(raw.focal_px),
            principal_point_px: Point2::from(raw.principal_point_px),
            distortion: raw.distortion,
            denominator,
        };
        if let Some(gamma) = raw.gamma.filter(|gamma| !GAMMAS.contains(gamma)) {
            let expected = format!("a number from {} to {}", GAMMAS.start(), GAMMAS.end());
            return Err(self.value("camera.gamma", gamma, expected));
        }
        let size_px = [raw.width_px, raw.height_px];
        Ok(Camera {
            size_px,
            lens,
            blur_px: raw.blur_px,
            chroma_offset_px,
            chroma_reach,
            colour_offset_px,
            exposure_s,
            readout_s,
            gamma: raw.gamma,
        })
    }
}
