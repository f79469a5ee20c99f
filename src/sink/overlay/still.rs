//! Single pictures with what was found drawn into them, as the overlay video has it: for pages.

use super::super::colour::{ConvertError, ToBgr};
use super::pen::Canvas;
use super::scene::Scene;
use super::{unit, whole};
use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::source::{Picture, Window};
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use opencv::core::{Mat, Rect};
use opencv::prelude::*;

/// Of the JPEG: outlines of one pixel stay sharp.
const QUALITY: u8 = 88;

/// Draws into pictures of the rig's camera.
pub(crate) struct Stills {
    size_px: [u32; 2],
    scene: Scene,
    to_bgr: ToBgr,
}

/// Why there is no drawing.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StillError {
    #[error("the picture has {}x{} pixels, the rig's camera {}x{}", found[0], found[1], expected[0], expected[1])]
    Size { found: [u32; 2], expected: [u32; 2] },
    #[error("no conversion to RGB from {0}")]
    PixelFormat(String),
    #[error("colour conversion: {0}")]
    Colour(ffmpeg_the_third::Error),
    #[error("drawing: {0}")]
    Draw(#[from] opencv::Error),
    #[error("JPEG: {0}")]
    Jpeg(#[from] image::ImageError),
}

impl Stills {
    pub(crate) fn new(rig: &Rig) -> Self {
        Self { size_px: rig.camera.size_px, scene: Scene::new(rig), to_bgr: ToBgr::default() }
    }

    /// The picture with outlines, names and the tangent's arrow, cut to `part`, as a JPEG.
    ///
    /// # Errors
    /// [`StillError`] when the picture is not of the rig's camera, or cannot be converted, drawn into or compressed.
    pub(crate) fn jpeg(&mut self, picture: &Picture, estimate: &Estimate, part: Window) -> Result<Vec<u8>, StillError> {
        if picture.size_px() != self.size_px {
            return Err(StillError::Size { found: picture.size_px(), expected: self.size_px });
        }
        let [width, height] = self.size_px;
        let mut canvas = Canvas::new([whole(width), whole(height)], unit(height))?;
        self.to_bgr.convert(picture, canvas.bgr.data_bytes_mut()?, 3 * width as usize).map_err(|e| match e {
            ConvertError::Unsupported(format) => StillError::PixelFormat(format!("{format:?}")),
            ConvertError::Av(error) => StillError::Colour(error),
        })?;
        self.scene.draw(&mut canvas, estimate)?;
        let part = part.clipped(self.size_px);
        let place = Rect::new(whole(part.x0), whole(part.y0), whole(part.width()), whole(part.height()));
        let cut = Mat::roi(&canvas.bgr, place)?.try_clone()?;
        let rgb: Vec<u8> = cut.data_bytes()?.chunks_exact(3).flat_map(|bgr| bgr.iter().rev().copied()).collect();
        let mut jpeg = Vec::new();
        JpegEncoder::new_with_quality(&mut jpeg, QUALITY).encode(
            &rgb,
            part.width(),
            part.height(),
            ExtendedColorType::Rgb8,
        )?;
        Ok(jpeg)
    }
}
