//! Single pictures with the results drawn into them as in the overlay video, for pages.

use super::super::colour::{ConvertError, ToBgr};
use super::super::jpeg::{JpegEncoder, Loss};
use super::pen::Canvas;
use super::scene::Scene;
use super::{unit, whole};
use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::source::{Picture, Window};
use opencv::prelude::*;

/// Draws into pictures of the rig's camera.
pub(crate) struct Stills {
    size_px: [u32; 2],
    scene: Scene,
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
    Jpeg(ffmpeg_the_third::Error),
    #[error("no thread for it: {0}")]
    Thread(std::io::Error),
}

impl Stills {
    pub(crate) fn new(rig: &Rig) -> Self {
        Self { size_px: rig.camera.size_px, scene: Scene::new(rig) }
    }

    /// Width and height of the rig's pictures, pixels.
    pub(crate) fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// The picture with outlines, names and the tangent's arrow, cropped to `part`, as a JPEG.
    ///
    /// # Errors
    /// [`StillError`] when the picture is not of the rig's camera, or cannot be converted, drawn into or compressed.
    pub(crate) fn jpeg(&self, picture: &Picture, estimate: &Estimate, part: Window) -> Result<Vec<u8>, StillError> {
        if picture.size_px() != self.size_px {
            return Err(StillError::Size { found: picture.size_px(), expected: self.size_px });
        }
        let [width, height] = self.size_px;
        let mut canvas = Canvas::new([whole(width), whole(height)], unit(height))?;
        ToBgr::quick().convert(picture, canvas.bgr.data_bytes_mut()?, 3 * width as usize).map_err(|e| match e {
            ConvertError::Unsupported(format) => StillError::PixelFormat(format!("{format:?}")),
            ConvertError::Av(error) => StillError::Colour(error),
        })?;
        self.scene.draw(&mut canvas, estimate)?;
        let part = part.clipped(self.size_px);
        let stride = 3 * width as usize;
        let from = part.y0 as usize * stride + 3 * part.x0 as usize;
        let cut = canvas.bgr.data_bytes()?.get(from..).unwrap_or_default();
        let encoder = JpegEncoder::new([part.width(), part.height()], Loss::Little);
        encoder.and_then(|mut encoder| encoder.encode(cut, stride)).map_err(StillError::Jpeg)
    }
}
