//! A picture as the camera or decoder delivered it, and how its samples map to places and colours.

use super::jpeg::Steps;
use super::{Quantisation, Window};
use nalgebra::{Matrix3, Vector3};
use parking_lot::Mutex;
use std::sync::Arc;

/// Largest width and height of a picture, pixels: up to it all moments of blobs are exact in 64-bit integers.
pub(crate) const LARGEST_SIDE_PX: u32 = 16_384;

/// How samples are stored, 8 bits each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelFormat {
    /// Planar Y, U, V; chroma subsampled by 2^log2 in x and y (4:2:0 is [1, 1], 4:4:4 is [0, 0]).
    Yuv {
        /// log2 of the chroma subsampling in x and y.
        chroma_log2: [u8; 2],
    },
    /// Y plane, then U and V interleaved, subsampled by 2 in x and y (NV12).
    Nv12,
    /// R, G, B as three planes.
    RgbPlanar,
    /// Interleaved R, G, B with `step` bytes per pixel (3 or 4) and the position of each channel in it.
    RgbPacked {
        /// Bytes per pixel.
        step: u8,
        /// Byte of R, G and B within the pixel.
        order: [u8; 3],
    },
    /// One plane of grey.
    Grey,
}

/// Luma weights of the YUV matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Matrix {
    /// ITU-R BT.601.
    Bt601,
    /// ITU-R BT.709.
    Bt709,
    /// ITU-R BT.2020, non-constant luminance.
    Bt2020,
}

impl Matrix {
    /// Weights of R and B in luma (G has the rest to 1).
    pub fn luma_weights(self) -> (f64, f64) {
        match self {
            Self::Bt601 => (0.299, 0.114),
            Self::Bt709 => (0.2126, 0.0722),
            Self::Bt2020 => (0.2627, 0.0593),
        }
    }
}

/// Range of the stored numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Range {
    /// 16..235 for luma, 16..240 for chroma ("tv").
    Limited,
    /// 0..255 ("pc").
    Full,
}

/// Transfer function from linear light to the stored R'G'B'.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Transfer {
    /// ITU-R BT.709 (and BT.601, BT.2020).
    Bt709,
    /// IEC 61966-2-1 (sRGB).
    Srgb,
    /// Samples are proportional to light.
    Linear,
}

/// Position of a chroma sample relative to its luma samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChromaSiting {
    /// Horizontally on the left luma column, vertically between two rows (MPEG-2, H.264 default).
    Left,
    /// At the centre of its luma samples (JPEG, MPEG-1).
    Center,
    /// On the top left luma sample.
    TopLeft,
}

/// How stored numbers relate to colours, from the stream's own tags.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Colour {
    /// YUV matrix.
    pub matrix: Matrix,
    /// Range.
    pub range: Range,
    /// Transfer function.
    pub transfer: Transfer,
    /// Chroma siting.
    pub siting: ChromaSiting,
}

/// One channel of a picture. Sample (i, j) lies at byte `j·stride + i·step` of `data` and represents the point
/// `(i·scale_x + offset_x, j·scale_y + offset_y)` in pixels.
#[derive(Debug, Clone, Copy)]
pub struct Plane<'a> {
    /// Bytes, starting at sample (0, 0).
    pub data: &'a [u8],
    /// Bytes from row to row.
    pub stride: usize,
    /// Bytes from sample to sample.
    pub step: usize,
    /// Samples in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Pixels per sample, in x and y (1, 2 or 4).
    pub scale: [u32; 2],
    /// Place of sample (0, 0) in pixels.
    pub offset: [f64; 2],
}

impl<'a> Plane<'a> {
    /// The bytes of row `j` (`None` outside), sample (0, j) first.
    pub fn row(&self, j: usize) -> Option<&'a [u8]> {
        if j >= self.height {
            return None;
        }
        let start = j * self.stride;
        self.data.get(start..start + (self.width.checked_sub(1)?) * self.step + 1)
    }
}

/// Affine map from stored channels (Y, U, V or R, G, B) to R', G', B' (0..255): linear·(stored − black).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RgbFromStored {
    /// Linear part.
    pub linear: Matrix3<f64>,
    /// Stored values of black.
    pub black: Vector3<f64>,
}

impl RgbFromStored {
    /// R', G', B' of stored values; not clamped.
    pub fn apply(&self, stored: &Vector3<f64>) -> Vector3<f64> {
        self.linear * (stored - self.black)
    }
}

/// One picture, as it was decoded. Clones share the samples.
#[derive(Clone)]
pub struct Picture {
    width: u32,
    height: u32,
    format: PixelFormat,
    colour: Colour,
    storage: Arc<Storage>,
    quantisation: Option<Box<Quantisation>>,
    pub(super) reads: Reads,
}

/// Which parts of a picture exist, and which were read (`reads.rs`).
#[derive(Debug, Default)]
pub(super) struct Reads {
    /// The parts that were recorded; `None` for all.
    pub(super) there: Option<Vec<Window>>,
    /// Whether what it shows cannot be trusted.
    pub(super) damaged: bool,
    /// Whether it interleaves the rows of two pictures.
    pub(super) interlaced: bool,
    /// Whether it is known to be as a camera or a coder gave it.
    pub(super) as_given: bool,
    pub(super) read: Mutex<Vec<Window>>,
}

impl Clone for Reads {
    /// Of a copy nothing was read yet.
    fn clone(&self) -> Self {
        let Self { there, damaged, interlaced, as_given, read: _ } = self;
        let (there, read) = (there.clone(), Mutex::default());
        Self { there, damaged: *damaged, interlaced: *interlaced, as_given: *as_given, read }
    }
}

impl std::fmt::Debug for Picture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Picture({}x{} {:?} {:?})", self.width, self.height, self.format, self.colour)
    }
}

/// The owner of the samples: what libav decoded is not copied.
enum Storage {
    /// Byte planes without padding between rows.
    Bytes(Vec<Vec<u8>>),
    Decoded(ffmpeg_the_third::frame::Video),
}

/// Why samples do not form a picture.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PictureError {
    /// A plane is missing or has the wrong number of bytes.
    #[error("plane {plane} has {found} bytes, expected {expected} for {width}x{height}")]
    PlaneSize {
        /// Which plane.
        plane: usize,
        /// Bytes found (0: plane missing).
        found: usize,
        /// Bytes expected.
        expected: usize,
        /// Width of the picture.
        width: u32,
        /// Height of the picture.
        height: u32,
    },
    /// A pixel format that needs conversion.
    #[error("pixel format {0} is not supported")]
    Format(String),
    /// Width or height is zero.
    #[error("picture of {0}x{1} pixels")]
    Empty(u32, u32),
}

impl PixelFormat {
    /// How many channels: 3 for colour, 1 for grey.
    pub fn channels(self) -> usize {
        if self == Self::Grey { 1 } else { 3 }
    }

    /// Whether channels are Y, U, V (else R, G, B, or grey).
    pub fn is_yuv(self) -> bool {
        matches!(self, Self::Yuv { .. } | Self::Nv12)
    }

    /// Whether there are fewer samples of chroma than pixels.
    pub(crate) fn is_subsampled(self) -> bool {
        self.chroma_log2() != [0, 0]
    }

    /// Whether each pixel has its own colour.
    pub(crate) fn has_chroma_per_pixel(self) -> bool {
        self != Self::Grey && !self.is_subsampled()
    }

    fn chroma_log2(self) -> [u8; 2] {
        match self {
            Self::Yuv { chroma_log2 } => chroma_log2,
            Self::Nv12 => [1, 1],
            _ => [0, 0],
        }
    }

    /// Storage of channel `i`: plane, first byte in it, bytes per sample, subsampling as log2.
    fn layout(self, i: usize) -> (usize, usize, usize, [u8; 2]) {
        let sub = if i == 0 { [0, 0] } else { self.chroma_log2() };
        match self {
            Self::Yuv { .. } | Self::RgbPlanar => (i, 0, 1, sub),
            Self::Nv12 if i == 0 => (0, 0, 1, sub),
            Self::Nv12 => (1, i - 1, 2, sub),
            Self::RgbPacked { step, order } => (0, usize::from(order[i]), usize::from(step), sub),
            Self::Grey => (0, 0, 1, sub),
        }
    }
}

impl Colour {
    /// sRGB, as in picture files.
    pub const SRGB: Self =
        Self { matrix: Matrix::Bt709, range: Range::Full, transfer: Transfer::Srgb, siting: ChromaSiting::Center };

    /// Channel `i` of a picture in `format` as weights of R', G', B' (0..255 each) and a constant:
    /// stored = weights·rgb + constant. ITU-R BT.709-6 §3, BT.601-7 §2.5.
    pub fn channel_from_rgb(&self, format: PixelFormat, i: usize) -> ([f64; 3], f64) {
        if !format.is_yuv() && format != PixelFormat::Grey {
            let mut w = [0.0; 3];
            w[i] = 1.0;
            return (w, 0.0);
        }
        let (kr, kb) = self.matrix.luma_weights();
        let luma = [kr, 1.0 - kr - kb, kb];
        let (luma_scale, chroma_scale, black) = match self.range {
            Range::Limited => (219.0 / 255.0, 224.0 / 255.0, 16.0),
            Range::Full => (1.0, 1.0, 0.0),
        };
        let difference = |channel: usize, k: f64| {
            let scale = chroma_scale * 0.5 / (1.0 - k);
            let mut w = luma.map(|l| -l * scale);
            w[channel] += scale;
            (w, 128.0)
        };
        match i {
            0 => (luma.map(|l| l * luma_scale), black),
            1 => difference(2, kb),
            _ => difference(0, kr),
        }
    }
}

impl Picture {
    /// A picture from byte planes without padding, one for each stored plane of `format`.
    ///
    /// # Errors
    /// When a plane is missing or has the wrong size.
    pub fn from_planes(
        width: u32,
        height: u32,
        format: PixelFormat,
        colour: Colour,
        planes: Vec<Vec<u8>>,
    ) -> Result<Self, PictureError> {
        if width == 0 || height == 0 {
            return Err(PictureError::Empty(width, height));
        }
        let storage = Arc::new(Storage::Bytes(planes));
        let picture = Self { width, height, format, colour, storage, quantisation: None, reads: Reads::default() };
        for channel in 0..format.channels() {
            let (plane, _, step, _) = format.layout(channel);
            let [w, h] = picture.samples(channel);
            let expected = w * h * step;
            let found = match &*picture.storage {
                Storage::Bytes(planes) => planes.get(plane).map_or(0, Vec::len),
                Storage::Decoded(_) => expected,
            };
            if found != expected {
                return Err(PictureError::PlaneSize { plane, found, expected, width, height });
            }
        }
        Ok(picture)
    }

    /// A dark picture in place of one that could not be decoded.
    pub(crate) fn missing(
        [width, height]: [u32; 2],
        format: PixelFormat,
        colour: Colour,
    ) -> Result<Self, PictureError> {
        let mut picture = Self::from_planes(1, 1, PixelFormat::Grey, colour, vec![vec![0]])?;
        (picture.width, picture.height, picture.format) = (width, height, format);
        let mut planes: Vec<Vec<u8>> = Vec::new();
        for channel in 0..format.channels() {
            let (plane, _, step, _) = format.layout(channel);
            let [w, h] = picture.samples(channel);
            planes.resize(planes.len().max(plane + 1), Vec::new());
            if let Some(bytes) = planes.get_mut(plane) {
                bytes.resize(w * h * step, if format.is_yuv() && channel > 0 { 128 } else { 16 });
            }
        }
        Ok(Self::from_planes(width, height, format, colour, planes)?.marked_damaged())
    }

    /// A decoded frame, without a copy. `format` must be the layout of the frame's own pixel format.
    pub(crate) fn from_decoded(frame: ffmpeg_the_third::frame::Video, format: PixelFormat, colour: Colour) -> Self {
        let (width, height) = (frame.width(), frame.height());
        let storage = Arc::new(Storage::Decoded(frame));
        Self { width, height, format, colour, storage, quantisation: None, reads: Reads::default() }.marked_as_given()
    }

    /// The same picture, which was a JPEG with these quantiser steps, if they are known.
    pub(crate) fn of_jpeg(self, steps: Option<&Steps>) -> Self {
        let Some(steps) = steps else { return self };
        let [luma, cb, cr] = steps.channels;
        // R', G' and B' per Cb and Cr. Rec. ITU-T T.871, 7.
        let (kr, kb) = Matrix::Bt601.luma_weights();
        let (red, blue, kg) = (2.0 - 2.0 * kr, 2.0 - 2.0 * kb, 1.0 - kr - kb);
        let rgb_from_chroma = [[0.0, red], [kb / kg * blue, kr / kg * red], [blue, 0.0]];
        let channels = match self.format {
            format if format.is_yuv() => steps.channels,
            PixelFormat::Grey => [luma; 3],
            // Errors of chroma are common to all pixels of a sample.
            _ => rgb_from_chroma.map(|[of_cb, of_cr]| {
                let chroma = (of_cb * cb).powi(2) + (of_cr * cr).powi(2);
                (luma.powi(2) + steps.chroma_px * chroma).sqrt()
            }),
        };
        let quantisation = Quantisation::of_steps(luma, channels, self.size_px());
        self.quantised(Some(quantisation))
    }

    /// The same picture with its coder's quantisation.
    #[must_use]
    pub fn quantised(mut self, quantisation: Option<Quantisation>) -> Self {
        self.quantisation = quantisation.map(Box::new);
        self
    }

    /// How coarsely its coder quantised it; `None` when unknown or lossless.
    pub fn quantisation(&self) -> Option<&Quantisation> {
        self.quantisation.as_deref()
    }

    /// Width and height, pixels.
    pub fn size_px(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// How samples are stored.
    pub fn format(&self) -> PixelFormat {
        self.format
    }

    /// How stored numbers relate to colours.
    pub fn colour(&self) -> Colour {
        self.colour
    }

    /// The affine map from stored channels to R', G', B' (0..255); `None` for grey.
    pub fn rgb_from_stored(&self) -> Option<RgbFromStored> {
        if self.format == PixelFormat::Grey {
            return None;
        }
        let rows: [([f64; 3], f64); 3] = [0, 1, 2].map(|i| self.colour.channel_from_rgb(self.format, i));
        let stored_from_rgb = Matrix3::from_fn(|i, j| rows[i].0[j]);
        Some(RgbFromStored {
            linear: stored_from_rgb.try_inverse()?,
            black: Vector3::new(rows[0].1, rows[1].1, rows[2].1),
        })
    }

    /// Samples in a row and rows of channel `i`.
    fn samples(&self, i: usize) -> [usize; 2] {
        let (_, _, _, sub) = self.format.layout(i);
        let up = |n: u32, log2: u8| (n as usize + (1 << log2) - 1) >> log2;
        [up(self.width, sub[0]), up(self.height, sub[1])]
    }

    /// Channel `i`: Y, U, V or R, G, B or grey; `None` when the format has no such channel.
    pub fn plane(&self, i: usize) -> Option<Plane<'_>> {
        if i >= self.format.channels() {
            return None;
        }
        let (plane, first, step, sub) = self.format.layout(i);
        let [width, height] = self.samples(i);
        let (bytes, stride) = match &*self.storage {
            Storage::Bytes(planes) => (planes.get(plane)?.as_slice(), width * step),
            Storage::Decoded(frame) => {
                // libav stores planar RGB as G, B, R.
                let plane = if self.format == PixelFormat::RgbPlanar { (plane + 2) % 3 } else { plane };
                (frame.data(plane), frame.stride(plane))
            }
        };
        let middle = |log2: u8| (f64::from(1_u32 << log2) - 1.0) / 2.0;
        let offset = match self.colour.siting {
            ChromaSiting::Left => [0.0, middle(sub[1])],
            ChromaSiting::Center => [middle(sub[0]), middle(sub[1])],
            ChromaSiting::TopLeft => [0.0, 0.0],
        };
        Some(Plane {
            data: bytes.get(first..)?,
            stride,
            step,
            width,
            height,
            scale: [1 << sub[0], 1 << sub[1]],
            offset,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const YUV420: PixelFormat = PixelFormat::Yuv { chroma_log2: [1, 1] };

    /// A step of chroma is worth as much in red and blue as T.871's matrix makes of it.
    #[test]
    fn a_picture_that_was_a_jpeg_has_the_steps_of_its_stored_channels() {
        let steps = Steps { channels: [8.0, 16.0, 16.0], chroma_px: 4.0 };
        let found = |format, planes: &[usize]| {
            let planes = planes.iter().map(|samples| vec![0; *samples]).collect();
            let picture = Picture::from_planes(4, 4, format, Colour::SRGB, planes).unwrap().of_jpeg(Some(&steps));
            picture.quantisation().unwrap().steps_at([3, 3]).unwrap()
        };
        let close = |found: [f64; 3], expected: [f64; 3]| {
            assert!(found.iter().zip(expected).all(|(a, b)| (a / b - 1.0).abs() < 1e-9), "{found:?}, not {expected:?}");
        };
        close(found(PixelFormat::Yuv { chroma_log2: [1, 1] }, &[16, 4, 4]), [8.0, 16.0, 16.0]);
        close(found(PixelFormat::Grey, &[16]), [8.0; 3]);
        let with = |chroma: f64| (64.0 + 4.0 * 256.0 * chroma).sqrt();
        let green = (0.202_008_f64 / 0.587).powi(2) + (0.419_198 / 0.587_f64).powi(2);
        close(found(PixelFormat::RgbPlanar, &[16; 3]), [with(1.402_f64.powi(2)), with(green), with(1.772_f64.powi(2))]);
    }

    #[test]
    fn a_clone_shares_the_samples_and_keeps_its_own_account_of_what_is_read() {
        let picture = Picture::from_planes(4, 4, PixelFormat::Grey, Colour::SRGB, vec![vec![7; 16]]).unwrap();
        let whole = Window::whole([4, 4]);
        picture.declare_read(whole).unwrap();
        let clone = picture.clone();
        assert!(std::ptr::eq(picture.plane(0).unwrap().data, clone.plane(0).unwrap().data));
        assert_eq!((picture.windows_read(0), clone.windows_read(0)), (vec![whole], vec![]));
        let part = Window { x1: 2, ..whole };
        let damaged = picture.of_parts(vec![part]).marked_damaged().clone();
        assert_eq!((damaged.recorded(), damaged.is_damaged()), (Some(&[part][..]), true));
    }

    #[test]
    fn bt709_limited_white_black_and_blue() {
        let colour = Colour { matrix: Matrix::Bt709, range: Range::Limited, ..Colour::SRGB };
        let value = |rgb: [f64; 3]| {
            [0, 1, 2].map(|i| {
                let (w, c) = colour.channel_from_rgb(YUV420, i);
                w[0] * rgb[0] + w[1] * rgb[1] + w[2] * rgb[2] + c
            })
        };
        let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(x, y)| (x - y).abs() < 0.01);
        assert!(near(value([255.0; 3]), [235.0, 128.0, 128.0]));
        assert!(near(value([0.0; 3]), [16.0, 128.0, 128.0]));
        // BT.709: Y = 16 + 219·0.0722, U = 240, V = 128 - 224·0.0722/(2·(1-0.2126))
        assert!(near(value([0.0, 0.0, 255.0]), [31.81, 240.0, 117.73]));
    }

    #[test]
    fn chroma_planes_of_odd_sizes_round_up_and_know_their_place() {
        let picture = Picture::from_planes(
            5,
            3,
            YUV420,
            Colour { siting: ChromaSiting::Left, ..Colour::SRGB },
            vec![vec![0; 15], vec![0; 6], vec![0; 6]],
        )
        .unwrap();
        let u = picture.plane(1).unwrap();
        assert_eq!((u.width, u.height, u.scale, u.offset), (3, 2, [2, 2], [0.0, 0.5]));
        assert!(picture.plane(3).is_none());
        assert_eq!(u.row(1).unwrap().len(), 3);
        assert!(u.row(2).is_none());
    }

    #[test]
    fn a_plane_of_the_wrong_size_is_named() {
        let error = Picture::from_planes(4, 4, PixelFormat::Grey, Colour::SRGB, vec![vec![0; 15]]).unwrap_err();
        assert_eq!(error.to_string(), "plane 0 has 15 bytes, expected 16 for 4x4");
    }
}
