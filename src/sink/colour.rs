//! Converts pictures of any format to BGR for drawing, and BGR to encoders' formats, with swscale.
//!
//! In: a [`Picture`] with its matrix and range. Out: interleaved B'G'R', 8 bits, full range. Grey and RGB are copied
//! (grey stretched when its range is limited), YUV is converted with the picture's own matrix. Chroma is interpolated
//! between samples taken at swscale's default siting: up to half a pixel from the picture's, invisible in a drawing.

use crate::source::{Matrix, Picture, PixelFormat, Plane, Range};
use ffmpeg_the_third::format::Pixel;
use ffmpeg_the_third::software::scaling::{Context, Flags};
use ffmpeg_the_third::{Error, ffi, frame};

/// Converts pictures to BGR; keeps its tables and buffers from picture to picture.
#[derive(Default)]
pub(crate) struct ToBgr {
    /// Format that the scaler was made for.
    key: Option<(Pixel, [u32; 2], Matrix, Range)>,
    scaler: Option<Scaler>,
    quick: bool,
}

/// Why a picture could not be converted.
#[derive(Debug)]
pub(crate) enum ConvertError {
    /// Chroma subsampling without a libav format.
    Unsupported(PixelFormat),
    /// What libav said.
    Av(Error),
}

impl From<Error> for ConvertError {
    fn from(error: Error) -> Self {
        Self::Av(error)
    }
}

impl ToBgr {
    /// One that takes a tenth of the time: chroma is that of the nearest sample, and values are rounded to two or so.
    pub(crate) fn quick() -> Self {
        Self { quick: true, ..Self::default() }
    }

    /// Writes the picture as rows of B'G'R' into `bgr`, `stride` bytes per row.
    pub(crate) fn convert(&mut self, picture: &Picture, bgr: &mut [u8], stride: usize) -> Result<(), ConvertError> {
        let pixel = match picture.format() {
            PixelFormat::Grey => {
                let plane = plane(picture, 0)?;
                let stretch = match picture.colour().range {
                    Range::Full => (0.0, 1.0),
                    Range::Limited => (16.0, 255.0 / 219.0),
                };
                let table: Vec<u8> =
                    (0..=255_u8).map(|v| ((f64::from(v) - stretch.0) * stretch.1).round() as u8).collect();
                for channel in 0..3 {
                    interleave(&plane, bgr, stride, channel, |v| table.get(usize::from(v)).copied().unwrap_or(v));
                }
                return Ok(());
            }
            PixelFormat::RgbPlanar | PixelFormat::RgbPacked { .. } => {
                for channel in 0..3 {
                    interleave(&plane(picture, channel)?, bgr, stride, 2 - channel, |v| v);
                }
                return Ok(());
            }
            PixelFormat::Nv12 | PixelFormat::Yuv { chroma_log2: [1, 1] } => Pixel::YUV420P,
            PixelFormat::Yuv { chroma_log2: [1, 0] } => Pixel::YUV422P,
            PixelFormat::Yuv { chroma_log2: [0, 0] } => Pixel::YUV444P,
            PixelFormat::Yuv { chroma_log2: [0, 1] } => Pixel::YUV440P,
            PixelFormat::Yuv { chroma_log2: [2, 0] } => Pixel::YUV411P,
            PixelFormat::Yuv { chroma_log2: [2, 2] } => Pixel::YUV410P,
            other @ PixelFormat::Yuv { .. } => return Err(ConvertError::Unsupported(other)),
        };
        let colour = picture.colour();
        let key = (pixel, picture.size_px(), colour.matrix, colour.range);
        if self.key != Some(key) {
            self.scaler = None;
        }
        let scaler = match &mut self.scaler {
            Some(scaler) => scaler,
            empty => empty.insert(Scaler::new(
                (pixel, colour.matrix, colour.range),
                (Pixel::BGR24, colour.matrix, Range::Full),
                picture.size_px(),
                if self.quick { Flags::FAST_BILINEAR } else { ACCURATE },
            )?),
        };
        self.key = Some(key);
        for channel in 0..3 {
            let plane = plane(picture, channel)?;
            let stride = scaler.from.stride(channel);
            interleave_step(&plane, scaler.from.data_mut(channel), stride, 0, 1, |v| v);
        }
        scaler.run()?;
        let from_stride = scaler.to.stride(0);
        let row_bytes = 3 * scaler.to.width() as usize;
        for (to, from) in bgr.chunks_mut(stride).zip(scaler.to.data(0).chunks(from_stride)) {
            copy_start(to, from, row_bytes);
        }
        Ok(())
    }
}

/// Converts BGR drawings to an encoder's format.
pub(crate) struct FromBgr {
    scaler: Scaler,
    to: Pixel,
}

impl FromBgr {
    /// BT.709, limited range, 4:2:0, as in videos; width and height must be even.
    pub(crate) fn for_video(size_px: [u32; 2]) -> Result<Self, Error> {
        Self::new(Pixel::YUV420P, Matrix::Bt709, Range::Limited, size_px)
    }

    fn new(to: Pixel, matrix: Matrix, range: Range, size_px: [u32; 2]) -> Result<Self, Error> {
        let from = (Pixel::BGR24, matrix, Range::Full);
        Ok(Self { scaler: Scaler::new(from, (to, matrix, range), size_px, ACCURATE)?, to })
    }

    /// A new frame with the drawing: encoders keep references to frames, so none is reused.
    pub(crate) fn convert(&mut self, bgr: &[u8], stride: usize) -> Result<frame::Video, Error> {
        let to_stride = self.scaler.from.stride(0);
        let row_bytes = 3 * self.scaler.from.width() as usize;
        for (to, from) in self.scaler.from.data_mut(0).chunks_mut(to_stride).zip(bgr.chunks(stride)) {
            copy_start(to, from, row_bytes);
        }
        let fresh = allocated(self.to, [self.scaler.from.width(), self.scaler.from.height()])?;
        self.scaler.to = fresh;
        self.scaler.run()?;
        Ok(std::mem::replace(&mut self.scaler.to, frame::Video::empty()))
    }
}

/// Chroma between samples is interpolated, and values are rounded to the nearest.
const ACCURATE: Flags = Flags::BILINEAR.union(Flags::ACCURATE_RND).union(Flags::FULL_CHR_H_INT);

/// A scaler between two buffers that it owns.
struct Scaler {
    context: Context,
    from: frame::Video,
    to: frame::Video,
}

#[allow(unsafe_code, reason = "libswscale keeps no thread-local state; a context is used by one thread at a time here")]
// SAFETY: the context has one owner and is used through `&mut` only.
unsafe impl Send for Scaler {}

impl Scaler {
    fn new(
        from: (Pixel, Matrix, Range),
        to: (Pixel, Matrix, Range),
        size: [u32; 2],
        flags: Flags,
    ) -> Result<Self, Error> {
        let [w, h] = size;
        let mut context = Context::get(from.0, w, h, to.0, w, h, flags)?;
        set_colour(&mut context, (from.1, from.2), (to.1, to.2))?;
        Ok(Self { context, from: allocated(from.0, size)?, to: allocated(to.0, size)? })
    }

    fn run(&mut self) -> Result<(), Error> {
        self.context.run(&self.from, &mut self.to)
    }
}

/// A frame with its buffers: libav reports a failed allocation by omitting them.
fn allocated(pixel: Pixel, [w, h]: [u32; 2]) -> Result<frame::Video, Error> {
    let frame = frame::Video::new(pixel, w, h);
    let planes = if pixel == Pixel::BGR24 { 1 } else { 3 };
    if frame.planes() < planes { Err(Error::BufferTooSmall) } else { Ok(frame) }
}

#[allow(unsafe_code, reason = "the safe wrapper has no call for matrix and range; without it swscale assumes BT.601")]
fn set_colour(context: &mut Context, from: (Matrix, Range), to: (Matrix, Range)) -> Result<(), Error> {
    let table = |matrix| match matrix {
        Matrix::Bt601 => ffi::SWS_CS_ITU601,
        Matrix::Bt709 => ffi::SWS_CS_ITU709,
        Matrix::Bt2020 => ffi::SWS_CS_BT2020,
    };
    // SAFETY: the context is alive and borrowed mutably; the coefficient tables are static arrays of libswscale.
    let answer = unsafe {
        ffi::sws_setColorspaceDetails(
            context.as_mut_ptr(),
            ffi::sws_getCoefficients(table(from.0)),
            i32::from(from.1 == Range::Full),
            ffi::sws_getCoefficients(table(to.0)),
            i32::from(to.1 == Range::Full),
            0,
            1 << 16, // contrast and saturation 1, 16.16 fixed point
            1 << 16,
        )
    };
    if answer < 0 { Err(Error::InvalidData) } else { Ok(()) }
}

fn plane(picture: &Picture, channel: usize) -> Result<Plane<'_>, ConvertError> {
    picture.plane(channel).ok_or(ConvertError::Unsupported(picture.format()))
}

/// Writes a full-size channel into every third byte.
fn interleave(plane: &Plane<'_>, to: &mut [u8], stride: usize, first: usize, value: impl Fn(u8) -> u8) {
    interleave_step(plane, to, stride, first, 3, value);
}

fn interleave_step(
    plane: &Plane<'_>,
    to: &mut [u8],
    stride: usize,
    first: usize,
    step: usize,
    value: impl Fn(u8) -> u8,
) {
    for (j, row) in to.chunks_mut(stride).take(plane.height).enumerate() {
        let Some(samples) = plane.row(j) else { return };
        if step == 1 && plane.step == 1 {
            copy_start(row, samples, plane.width);
            continue;
        }
        let places = row.iter_mut().skip(first).step_by(step).take(plane.width);
        for (place, sample) in places.zip(samples.iter().step_by(plane.step)) {
            *place = value(*sample);
        }
    }
}

/// Copies the first `n` bytes, or as many as there are on both sides.
fn copy_start(to: &mut [u8], from: &[u8], n: usize) {
    let n = n.min(to.len()).min(from.len());
    if let (Some(to), Some(from)) = (to.get_mut(..n), from.get(..n)) {
        to.copy_from_slice(from);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{ChromaSiting, Colour};

    const SIZE: [u32; 2] = [32, 16];

    /// A picture of one colour, its samples computed from the definition of the format.
    fn uniform(format: PixelFormat, colour: Colour, rgb: [f64; 3]) -> Picture {
        let value = |channel: usize| {
            let (w, c) = colour.channel_from_rgb(format, channel);
            (w[0] * rgb[0] + w[1] * rgb[1] + w[2] * rgb[2] + c).round() as u8
        };
        let n = (SIZE[0] * SIZE[1]) as usize;
        let planes = match format {
            PixelFormat::Grey => vec![vec![value(0); n]],
            PixelFormat::RgbPlanar => (0..3).map(|i| vec![value(i); n]).collect(),
            PixelFormat::RgbPacked { step, order } => {
                let mut pixel = vec![0; usize::from(step)];
                (0..3).for_each(|i| pixel[usize::from(order[i])] = value(i));
                vec![pixel.repeat(n)]
            }
            PixelFormat::Nv12 => vec![vec![value(0); n], [value(1), value(2)].repeat(n / 4)],
            PixelFormat::Yuv { chroma_log2: [x, y] } => {
                vec![vec![value(0); n], vec![value(1); n >> (x + y)], vec![value(2); n >> (x + y)]]
            }
        };
        Picture::from_planes(SIZE[0], SIZE[1], format, colour, planes).unwrap()
    }

    #[test]
    fn every_storage_matrix_and_range_gives_the_colour_back() {
        let yuv = |x, y| PixelFormat::Yuv { chroma_log2: [x, y] };
        let formats = [
            yuv(1, 1),
            yuv(1, 0),
            yuv(0, 0),
            yuv(0, 1),
            yuv(2, 0),
            PixelFormat::Nv12,
            PixelFormat::RgbPlanar,
            PixelFormat::RgbPacked { step: 3, order: [0, 1, 2] },
            PixelFormat::RgbPacked { step: 4, order: [2, 1, 0] },
        ];
        let stride = 3 * SIZE[0] as usize;
        let mut bgr = vec![0; stride * SIZE[1] as usize];
        for (mut to_bgr, most) in [(ToBgr::default(), 3.0), (ToBgr::quick(), 4.0)] {
            for (format, matrix, range) in formats.iter().flat_map(|format| {
                let ranges = [Range::Limited, Range::Full];
                let all = [Matrix::Bt601, Matrix::Bt709, Matrix::Bt2020].into_iter();
                all.flat_map(move |matrix| ranges.map(|range| (*format, matrix, range)))
            }) {
                let colour = Colour { matrix, range, siting: ChromaSiting::Left, ..Colour::SRGB };
                for rgb in [[200.0, 40.0, 90.0], [30.0, 160.0, 60.0], [20.0, 60.0, 220.0], [250.0; 3]] {
                    to_bgr.convert(&uniform(format, colour, rgb), &mut bgr, stride).unwrap();
                    for pixel in bgr.chunks(3) {
                        let off = [0, 1, 2].map(|i| (f64::from(pixel[2 - i]) - rgb[i]).abs());
                        assert!(off.iter().all(|o| *o <= most), "{format:?} {colour:?}: {rgb:?} became {pixel:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn grey_is_stretched_by_its_range() {
        let mut bgr = vec![0; 3 * 512];
        let colour = Colour { range: Range::Limited, ..Colour::SRGB };
        let picture = Picture::from_planes(32, 16, PixelFormat::Grey, colour, vec![vec![235; 512]]).unwrap();
        ToBgr::default().convert(&picture, &mut bgr, 96).unwrap();
        assert!(bgr.iter().all(|v| *v == 255));
    }

    #[test]
    fn drawings_become_bt709_limited() {
        let rgb = [200.0, 40.0, 90.0];
        let bgr = [90, 40, 200].repeat(512);
        let frame = FromBgr::for_video(SIZE).unwrap().convert(&bgr, 96).unwrap();
        let colour = Colour { range: Range::Limited, ..Colour::SRGB };
        for channel in 0..3 {
            let (w, c) = colour.channel_from_rgb(PixelFormat::Yuv { chroma_log2: [1, 1] }, channel);
            let expected = w[0] * rgb[0] + w[1] * rgb[1] + w[2] * rgb[2] + c;
            let found = f64::from(frame.data(channel)[5]);
            assert!((found - expected).abs() <= 1.5, "channel {channel}: {found}, expected {expected}");
        }
    }

    #[test]
    fn a_subsampling_without_a_name_is_refused() {
        let format = PixelFormat::Yuv { chroma_log2: [0, 2] };
        let picture = uniform(format, Colour::SRGB, [1.0, 2.0, 3.0]);
        let refused = ToBgr::default().convert(&picture, &mut vec![0; 3 * 512], 96);
        assert!(matches!(refused, Err(ConvertError::Unsupported(f)) if f == format));
    }
}
