//! Pictures for people as JPEG, by libav, whose encoder uses vector instructions: a page has three for every recording.
//!
//! In: rows of B'G'R'. Out: a file (JFIF), 4:4:4 where lines are drawn, otherwise 4:2:0.

use ffmpeg_the_third as av;
use multiversion::multiversion;

/// libav's unit of quantiser scales.
const LAMBDA: i32 = 118;

/// Compression loss: libav's quantiser scale, from 2 to 31.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Loss {
    /// One-pixel lines stay sharp.
    Little,
    /// Good enough to look at: four pixels have one colour.
    Some,
}

impl Loss {
    fn scale(self) -> i32 {
        match self {
            Self::Little => 2,
            Self::Some => 4,
        }
    }

    fn format(self) -> av::format::Pixel {
        match self {
            Self::Little => av::format::Pixel::YUVJ444P,
            Self::Some => av::format::Pixel::YUVJ420P,
        }
    }
}

/// Compresses pictures of one size. Starting one takes longer than a picture: libav clears memory for the largest file
/// that there could be.
pub(crate) struct JpegEncoder {
    encoder: av::encoder::Video,
    frame: av::frame::Video,
    loss: Loss,
    /// Two rows of the three channels.
    rows: [[Vec<u8>; 3]; 2],
    halved: Vec<u8>,
}

impl JpegEncoder {
    /// # Errors
    /// libav's.
    pub(crate) fn new([width, height]: [u32; 2], loss: Loss) -> Result<Self, av::Error> {
        let codec = av::encoder::find(av::codec::Id::MJPEG).ok_or(av::Error::EncoderNotFound)?;
        let mut settings = av::codec::Context::new_with_codec(codec).encoder().video()?;
        settings.set_width(width);
        settings.set_height(height);
        settings.set_format(loss.format());
        settings.set_color_range(av::color::Range::JPEG);
        settings.set_time_base(av::Rational(1, 1));
        settings.set_flags(av::codec::Flags::QSCALE);
        settings.set_global_quality(loss.scale() * LAMBDA);
        let mut options = av::Dictionary::new();
        // The same picture gives the same bytes on any machine, and at once: several threads would hold some back.
        options.set("threads", "1");
        options.set("flags", "+bitexact");
        let encoder = settings.open_with(options)?;
        let mut frame = av::frame::Video::new(loss.format(), width, height);
        if frame.planes() < 3 {
            return Err(av::Error::BufferTooSmall);
        }
        frame.set_color_range(av::color::Range::JPEG);
        set_quality(&mut frame, loss);
        let rows = std::array::from_fn(|_| std::array::from_fn(|_| vec![0; width as usize]));
        Ok(Self { encoder, frame, loss, rows, halved: vec![0; width.div_ceil(2) as usize] })
    }

    /// Width and height of its pictures, pixels.
    pub(crate) fn size_px(&self) -> [u32; 2] {
        [self.frame.width(), self.frame.height()]
    }

    /// A file of the picture, rows of B'G'R' with `stride` bytes each.
    ///
    /// # Errors
    /// libav's.
    pub(crate) fn encode(&mut self, bgr: &[u8], stride: usize) -> Result<Vec<u8>, av::Error> {
        self.fill(bgr, stride);
        let number = self.frame.pts().map_or(0, |last| last + 1);
        self.frame.set_pts(Some(number));
        self.encoder.send_frame(&self.frame)?;
        let mut packet = av::Packet::empty();
        self.encoder.receive_packet(&mut packet)?;
        Ok(packet.data().unwrap_or_default().to_vec())
    }

    /// The planes of the picture: BT.601 in full range, as JFIF has it.
    fn fill(&mut self, bgr: &[u8], stride: usize) {
        let Self { frame, loss, rows, halved, .. } = self;
        let mut put = |channel: usize, j: usize, row: &[u8]| {
            let at = j * frame.stride(channel);
            if let Some(to) = frame.data_mut(channel).get_mut(at..at + row.len()) {
                to.copy_from_slice(row);
            }
        };
        for (pair, from) in bgr.chunks(2 * stride).enumerate() {
            for (k, (from, [y, cb, cr])) in from.chunks(stride).zip(&mut *rows).enumerate() {
                to_ycc(from, y, cb, cr);
                put(0, 2 * pair + k, y);
                if *loss == Loss::Little {
                    put(1, 2 * pair + k, cb);
                    put(2, 2 * pair + k, cr);
                }
            }
            if *loss == Loss::Some {
                // Of an odd number of rows the last counts twice.
                let last = usize::from(from.len() > stride);
                for channel in [1, 2] {
                    average(&rows[0][channel], &rows[last][channel], halved);
                    put(channel, pair, halved);
                }
            }
        }
    }
}

/// Means of two rows over two columns each; an odd last column counts twice.
fn average(top: &[u8], bottom: &[u8], means: &mut [u8]) {
    for (mean, (a, b)) in means.iter_mut().zip(top.chunks(2).zip(bottom.chunks(2))) {
        let pair = |row: &[u8]| u16::from(row[0]) + u16::from(row[row.len() - 1]);
        *mean = ((pair(a) + pair(b) + 2) >> 2) as u8;
    }
}

/// A row of them, in whole numbers with 16 bits behind the point: the same on any machine.
#[multiversion(targets("x86_64+avx2"))]
fn to_ycc(bgr: &[u8], y: &mut [u8], cb: &mut [u8], cr: &mut [u8]) {
    const HALF: i32 = 1 << 15;
    const MIDDLE: i32 = (128 << 16) + HALF;
    let (pixels, _) = bgr.as_chunks::<3>();
    for (((&[b, g, r], y), cb), cr) in pixels.iter().zip(y.iter_mut()).zip(cb.iter_mut()).zip(cr.iter_mut()) {
        // Not by `map`, which is not inlined here.
        let (b, g, r) = (i32::from(b), i32::from(g), i32::from(r));
        *y = ((7471 * b + 38470 * g + 19595 * r + HALF) >> 16) as u8;
        // Blue alone, or red, rounds to 256.
        *cb = ((32768 * b - 21710 * g - 11058 * r + MIDDLE) >> 16).min(255) as u8;
        *cr = ((32768 * r - 27439 * g - 5329 * b + MIDDLE) >> 16).min(255) as u8;
    }
}

#[allow(unsafe_code, reason = "the safe wrapper has no call for a frame's quality")]
fn set_quality(frame: &mut av::frame::Video, loss: Loss) {
    // SAFETY: the frame is alive and borrowed mutably; the field is a plain number.
    unsafe { (*frame.as_mut_ptr()).quality = loss.scale() * LAMBDA };
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A red one-pixel line on grey, of odd size, with rows longer than the picture.
    #[test]
    fn a_line_of_one_pixel_keeps_its_place_and_colour() {
        let (width, height, stride) = (61_u32, 37_u32, 200_usize);
        let mut bgr = vec![0; stride * height as usize];
        for y in 0..height as usize {
            for x in 0..width as usize {
                let pixel = if x == 20 { [40, 40, 220] } else { [128; 3] };
                bgr[y * stride + 3 * x..][..3].copy_from_slice(&pixel);
            }
        }
        let encoder = |loss| JpegEncoder::new([width, height], loss).unwrap();
        let mut little = encoder(Loss::Little);
        let file = little.encode(&bgr, stride).unwrap();
        // Nothing of a picture is left in the next.
        assert_ne!(little.encode(&vec![128; bgr.len()], stride).unwrap(), file);
        assert_eq!(little.encode(&bgr, stride).unwrap(), file);
        let read = image::load_from_memory(&file).unwrap().to_rgb8();
        assert_eq!(read.dimensions(), (width, height));
        for (x, expected) in [(5, [128_u8; 3]), (20, [220, 40, 40]), (23, [128; 3]), (60, [128; 3])] {
            let found = read.get_pixel(x, 18).0;
            assert!(found.iter().zip(expected).all(|(a, b)| a.abs_diff(b) < 12), "{x}: {found:?}");
        }
        // Red on the right, to the last column and row of a picture of odd size.
        for (y, row) in bgr.chunks_mut(stride).enumerate() {
            for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
                pixel.copy_from_slice(if x >= 30 && y >= 10 { &[40, 40, 220] } else { &[128; 3] });
            }
        }
        let coarser = encoder(Loss::Some).encode(&bgr, stride).unwrap();
        assert!(coarser.len() < little.encode(&bgr, stride).unwrap().len());
        let read = image::load_from_memory(&coarser).unwrap().to_rgb8();
        let red = [220_u8, 40, 40];
        for (at, expected) in [([5, 18], [128; 3]), ([40, 5], [128; 3]), ([33, 20], red), ([60, 36], red)] {
            let found = read.get_pixel(at[0], at[1]).0;
            assert!(found.iter().zip(expected).all(|(a, b)| a.abs_diff(b) < 12), "{at:?}: {found:?}");
        }
    }
}
