//! Pictures as a browser shows them.

use super::Refusal;
use crate::sink::{ConvertError, ToBgr};
use crate::source::Picture;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, RgbImage};

/// Of the JPEG: good enough to see single pixels, small enough to scrub.
const QUALITY: u8 = 88;
/// The narrowest that a picture is made, pixels.
const NARROWEST: u32 = 64;

/// A picture, whole, in the colours of a browser.
pub(super) fn rgb(to_bgr: &mut ToBgr, picture: &Picture) -> Result<RgbImage, Refusal> {
    let [width, height] = picture.size_px();
    let mut samples = bgr(to_bgr, picture)?;
    samples.chunks_exact_mut(3).for_each(|pixel| pixel.reverse());
    RgbImage::from_raw(width, height, samples).ok_or_else(|| Refusal::wrong("a picture without pixels"))
}

fn bgr(to_bgr: &mut ToBgr, picture: &Picture) -> Result<Vec<u8>, Refusal> {
    let [width, height] = picture.size_px();
    let stride = 3 * width as usize;
    let mut bgr = vec![0; stride * height as usize];
    to_bgr.convert(picture, &mut bgr, stride).map_err(|error| {
        Refusal::wrong(match error {
            ConvertError::Unsupported(format) => format!("no conversion to RGB from {format:?}"),
            ConvertError::Av(error) => format!("colour conversion: {error}"),
        })
    })?;
    Ok(bgr)
}

/// A picture as JPEG; every second, third, … pixel of it, so that it is no wider than `width`, if that is given.
pub(super) fn jpeg(to_bgr: &mut ToBgr, picture: &Picture, width: Option<u32>) -> Result<Vec<u8>, Refusal> {
    let [w, h] = picture.size_px();
    let stride = 3 * w as usize;
    let bgr = bgr(to_bgr, picture)?;
    let step = width.map_or(1, |width| w.div_ceil(width.max(NARROWEST))).max(1) as usize;
    let (rows, columns) = (h.div_ceil(step as u32), w.div_ceil(step as u32));
    let mut rgb = Vec::with_capacity(3 * rows as usize * columns as usize);
    for row in bgr.chunks_exact(stride).step_by(step) {
        rgb.extend(row.chunks_exact(3).step_by(step).flat_map(|bgr| bgr.iter().rev().copied()));
    }
    encoded(&rgb, columns, rows)
}

/// A picture of a file as JPEG.
pub(super) fn jpeg_of(picture: &RgbImage) -> Result<Vec<u8>, Refusal> {
    encoded(picture.as_raw(), picture.width(), picture.height())
}

fn encoded(rgb: &[u8], width: u32, height: u32) -> Result<Vec<u8>, Refusal> {
    let mut jpeg = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut jpeg, QUALITY);
    let failed = |error| Refusal::wrong(format!("JPEG: {error}"));
    encoder.encode(rgb, width, height, ExtendedColorType::Rgb8).map_err(failed)?;
    Ok(jpeg)
}
