//! A grey picture from a file, for finding boards.

use std::io::{Cursor, ErrorKind};
use std::path::{Path, PathBuf};

use image::{DynamicImage, ImageDecoder, ImageReader};
use nalgebra::Point2;

use crate::source::jpeg;

/// Why a picture cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GreyError {
    /// No such file.
    #[error("{}: no such picture", path.display())]
    NotFound {
        /// The requested path.
        path: PathBuf,
    },
    /// The operating system refuses.
    #[error("{}: cannot be read: {source}", path.display())]
    Io {
        /// The requested path.
        path: PathBuf,
        /// Its reason.
        source: std::io::Error,
    },
    /// Not a picture that can be decoded.
    #[error("{}: is not a readable picture, or is incomplete ({source}); PNG, JPEG, TIFF, BMP and PNM are \
        read", path.display())]
    Undecodable {
        /// The file.
        path: PathBuf,
        /// The decoder's reason.
        source: image::ImageError,
    },
    /// More pixels than any camera has.
    #[error("{}: declares {width}x{height} pixels; up to {} million are read", path.display(), MAX_PX / 1_000_000)]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Width it declares, pixels.
        width: u32,
        /// Height it declares, pixels.
        height: u32,
    },
    /// Damaged samples.
    #[error("{}: is damaged ({what}): copy it again, or leave it out", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: &'static str,
    },
    /// A file that was not copied completely.
    #[error("{}: the file ends before the picture does: copy it again, or leave it out", path.display())]
    CutOff {
        /// The file.
        path: PathBuf,
    },
}

/// The largest sensors have 151 million pixels.
const MAX_PX: u64 = 160_000_000;

/// Orientation in which a picture is read, if its EXIF data specify a rotation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Rows {
    /// Rotated as specified, as viewers show it.
    #[default]
    AsShown,
    /// The sensor's own, as recordings and [folders of pictures](crate::source::ImageFolder) are read.
    AsStored,
}

/// 8-bit samples, row-major without padding; grey values as stored (not linear light).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grey {
    width: u32,
    height: u32,
    samples: Vec<u8>,
}

impl Grey {
    /// `None` when the number of samples is not width times height, or 0.
    pub fn from_samples(width: u32, height: u32, samples: Vec<u8>) -> Option<Self> {
        let fits = u64::from(width) * u64::from(height) == samples.len() as u64;
        (fits && !samples.is_empty()).then_some(Self { width, height, samples })
    }

    /// Reads PNG, JPEG, TIFF, BMP or PNM, whatever its extension: grey or colour (luma of BT.709), transparency
    /// ignored. Samples of more than 8 bits are scaled so that the brightest, but for one in a thousand, become
    /// 255: sensors of 10 or 12 bits often fill only the lower part of 16.
    ///
    /// # Errors
    /// [`GreyError`], which names the file.
    pub fn load(path: &Path, rows: Rows) -> Result<Self, GreyError> {
        let undecodable = |source| GreyError::Undecodable { path: path.to_path_buf(), source };
        let io = |source: std::io::Error| match source.kind() {
            ErrorKind::NotFound => GreyError::NotFound { path: path.to_path_buf() },
            _ => GreyError::Io { path: path.to_path_buf(), source },
        };
        let bytes = std::fs::read(path).map_err(io)?;
        if jpeg::is_cut_off(&bytes) {
            return Err(GreyError::CutOff { path: path.to_path_buf() });
        }
        if let Some(what) = jpeg::examine(&bytes).damage {
            return Err(GreyError::Damaged { path: path.to_path_buf(), what });
        }
        let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(io)?;
        let mut decoder = reader.into_decoder().map_err(undecodable)?;
        let (width, height) = decoder.dimensions();
        if u64::from(width) * u64::from(height) > MAX_PX {
            return Err(GreyError::TooLarge { path: path.to_path_buf(), width, height });
        }
        let orientation = decoder.orientation().map_err(undecodable)?;
        let mut decoded = DynamicImage::from_decoder(decoder).map_err(undecodable)?;
        if rows == Rows::AsShown {
            decoded.apply_orientation(orientation);
        }
        let (width, height) = (decoded.width(), decoded.height());
        let deep = decoded.color().bytes_per_pixel() > decoded.color().channel_count();
        let samples = if deep { to_eight_bits(&decoded.into_luma16()) } else { decoded.into_luma8().into_raw() };
        Ok(Self { width, height, samples })
    }

    /// Width and height, pixels.
    pub fn size_px(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Row by row.
    pub fn samples(&self) -> &[u8] {
        &self.samples
    }

    /// The grey value at a point, bilinear between pixel centres; `None` outside them.
    pub(crate) fn at(&self, place: Point2<f64>) -> Option<f64> {
        let (x, y) = (place.x.floor(), place.y.floor());
        let sample = |x: f64, y: f64| {
            let inside = (0.0..f64::from(self.width)).contains(&x) && (0.0..f64::from(self.height)).contains(&y);
            let index = y as usize * self.width as usize + x as usize;
            if inside { self.samples.get(index).map(|s| f64::from(*s)) } else { None }
        };
        let (u, v) = (place.x - x, place.y - y);
        let row = |y: f64| {
            let left = sample(x, y)?;
            if u > 0.0 { Some(left + u * (sample(x + 1.0, y)? - left)) } else { Some(left) }
        };
        let above = row(y)?;
        if v > 0.0 { Some(above + v * (row(y + 1.0)? - above)) } else { Some(above) }
    }
}

fn to_eight_bits(samples: &[u16]) -> Vec<u8> {
    // A few stray bright samples (hot pixels, glints) would leave all else dark.
    let mut sorted = samples.to_vec();
    let last = (samples.len() * 999).div_ceil(1000).saturating_sub(1);
    let brightest = if samples.is_empty() { 1 } else { u32::from(*sorted.select_nth_unstable(last).1).max(1) };
    samples.iter().map(|s| ((u32::from(*s) * 255 + brightest / 2) / brightest).min(255) as u8).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_stray_bright_sample_does_not_darken_the_picture() {
        let mut samples: Vec<u16> = (0..4000).map(|i| if i % 2 == 0 { 100 } else { 1000 }).collect();
        let plain = to_eight_bits(&samples);
        samples[7] = 65_535;
        assert_eq!((plain[0], plain[1]), (26, 255));
        assert_eq!(to_eight_bits(&samples), plain);
        assert_eq!(to_eight_bits(&[0, 500, 1000]), [0, 128, 255]);
        assert!(to_eight_bits(&[]).is_empty());
    }
}
