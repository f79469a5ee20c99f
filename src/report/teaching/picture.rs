//! Pictures embedded in a page.

use crate::rig::ColourModel;
use crate::source::Picture;
use base64::prelude::{BASE64_STANDARD, Engine as _};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use nalgebra::Vector3;

/// JPEG quality of whole pictures.
const QUALITY: u8 = 85;

/// A picture in R'G'B'.
pub(super) struct Shown {
    pixels: RgbImage,
}

impl Shown {
    /// `None` for a grey picture.
    pub(super) fn of(picture: &Picture) -> Option<Self> {
        let rgb = picture.rgb_from_stored()?;
        let planes = [picture.plane(0)?, picture.plane(1)?, picture.plane(2)?];
        let [width, height] = picture.size_px();
        let pixels = RgbImage::from_fn(width, height, |x, y| {
            let stored = Vector3::from_fn(|c, _| {
                let plane = &planes[c];
                let row = plane.row((y / plane.scale[1]) as usize).unwrap_or_default();
                row.get((x / plane.scale[0]) as usize * plane.step).map_or(0.0, |v| f64::from(*v))
            });
            image::Rgb(rgb.apply(&stored).map(|v| v.round().clamp(0.0, 255.0) as u8).into())
        });
        Some(Self { pixels })
    }

    pub(super) fn size(&self) -> [u32; 2] {
        [self.pixels.width(), self.pixels.height()]
    }

    /// The whole picture, as a data URL.
    pub(super) fn whole(&self) -> Option<String> {
        let mut bytes = Vec::new();
        let [width, height] = self.size();
        let encoder = JpegEncoder::new_with_quality(&mut bytes, QUALITY);
        encoder.write_image(self.pixels.as_raw(), width, height, ExtendedColorType::Rgb8).ok()?;
        Some(format!("data:image/jpeg;base64,{}", BASE64_STANDARD.encode(bytes)))
    }

    /// Part of it, lossless.
    pub(super) fn part(&self, x: u32, y: u32, width: u32, height: u32) -> Option<String> {
        png(&image::imageops::crop_imm(&self.pixels, x, y, width, height).to_image())
    }

    /// The same part as a model sees it: black is 0, the threshold is the darkest green, 1 the brightest.
    pub(super) fn scored(&self, model: &ColourModel, [x, y, width, height]: [u32; 4]) -> Option<String> {
        let part = image::imageops::crop_imm(&self.pixels, x, y, width, height).to_image();
        png(&RgbImage::from_fn(part.width(), part.height(), |x, y| {
            let rgb = Vector3::from(part.get_pixel(x, y).0.map(f64::from));
            let score = model.score(&rgb).clamp(0.0, 1.0);
            let light = (score * 255.0) as u8;
            image::Rgb(if score > 0.5 { [light / 4, light, light / 3] } else { [light; 3] })
        }))
    }
}

fn png(pixels: &RgbImage) -> Option<String> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new(&mut bytes);
    encoder.write_image(pixels.as_raw(), pixels.width(), pixels.height(), ExtendedColorType::Rgb8).ok()?;
    Some(format!("data:image/png;base64,{}", BASE64_STANDARD.encode(bytes)))
}
