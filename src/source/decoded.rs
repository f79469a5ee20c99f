//! From libav's decoded frames to pictures: pixel formats, colour tags, and the reduction to 8 bits.

use std::path::PathBuf;

use ffmpeg_the_third::codec::Id;
use ffmpeg_the_third::format::Pixel;
use ffmpeg_the_third::frame::Video;
use ffmpeg_the_third::software::scaling;
use ffmpeg_the_third::{chroma, color};

use super::last_coded::LastCoded;
use super::quantisation::Stated;
use super::{ChromaSiting, Colour, Matrix, Picture, PixelFormat, Quantisation, Range, SourceError, Transfer};

/// Makes pictures of one stream's frames. Frames in a format of [`Picture`] are kept without a copy.
pub(crate) struct PictureMaker {
    path: PathBuf,
    converter: Option<Converter>,
    /// Chroma siting of frames that do not state it.
    siting: ChromaSiting,
    /// Whether the coder loses nothing to speak of, so that no quantisation need be assumed where none is stated.
    loses_little: bool,
    /// Whether the decoder has told how coarsely a picture was quantised.
    tells_steps: bool,
    /// Whether it predicts pictures without numbering them.
    numbers_nothing: bool,
    last_coded: LastCoded,
    warned: Vec<&'static str>,
}

/// Whether a coder is lossless, or made for editing and so fine that its errors stay below those of the image model
/// (measured: docs/formats.md). The steps of Motion JPEG are read from its tables.
fn loses_little(codec: Id) -> bool {
    let is_lossless = matches!(
        codec,
        Id::RAWVIDEO | Id::WRAPPED_AVFRAME | Id::V210 | Id::V308 | Id::V408 | Id::V410 | Id::Y41P | Id::AYUV | Id::R210
    ) || matches!(
        codec,
        Id::FFV1 | Id::HUFFYUV | Id::FFVHUFF | Id::UTVIDEO | Id::MAGICYUV | Id::LAGARITH | Id::SHEERVIDEO | Id::LJPEG
    ) || matches!(
        codec,
        Id::PNG | Id::APNG | Id::TIFF | Id::BMP | Id::PPM | Id::PGM | Id::DPX | Id::TARGA | Id::SGI | Id::QTRLE
    ) || matches!(codec, Id::ZLIB | Id::MSZH | Id::ZMBV | Id::LOCO | Id::VBLE | Id::CLLC);
    is_lossless || matches!(codec, Id::PRORES | Id::DNXHD | Id::CFHD | Id::JPEG2000 | Id::MJPEG)
}

/// Whether a coder predicts pictures from others without numbering them: where one was lost after coding, its decoder
/// cannot know.
fn numbers_nothing(codec: Id) -> bool {
    matches!(codec, Id::VP8 | Id::AV1 | Id::MPEG4 | Id::MPEG1VIDEO | Id::MPEG2VIDEO | Id::H263 | Id::FLV1 | Id::THEORA)
        || matches!(codec, Id::MSMPEG4V1 | Id::MSMPEG4V2 | Id::MSMPEG4V3 | Id::WMV1 | Id::WMV2 | Id::WMV3 | Id::VC1)
}

/// swscale from one format and size to another.
struct Converter(scaling::Context);

#[allow(unsafe_code, reason = "libswscale keeps no thread-local state; a context is used by one thread at a time here")]
// SAFETY: only the converter owns the context, and it is reached only through `&mut`.
unsafe impl Send for Converter {}

impl PictureMaker {
    pub(crate) fn new(path: PathBuf, codec: Id) -> Self {
        let siting = match codec {
            Id::MJPEG | Id::MPEG1VIDEO => ChromaSiting::Center,
            _ => ChromaSiting::Left,
        };
        let loses_little = loses_little(codec);
        let (converter, last_coded, warned) = (None, LastCoded::default(), Vec::new());
        let (tells_steps, numbers_nothing) = (false, numbers_nothing(codec));
        Self { path, converter, siting, loses_little, tells_steps, numbers_nothing, last_coded, warned }
    }

    /// Sets the chroma siting of frames that do not state it, overriding the codec's default.
    #[cfg(feature = "gstreamer")]
    pub(crate) fn set_default_siting(&mut self, siting: ChromaSiting) {
        self.siting = siting;
    }

    /// The picture in `frame`.
    ///
    /// # Errors
    /// [`SourceError::PixelFormat`], [`SourceError::Matrix`].
    pub(crate) fn picture(&mut self, frame: Video) -> Result<Picture, SourceError> {
        self.picture_stating(frame, None)
    }

    /// The same of one whose packet stated this of its quantiser.
    pub(crate) fn picture_stating(&mut self, frame: Video, stated: Option<Stated>) -> Result<Picture, SourceError> {
        let colour = self.colour(&frame)?;
        let interlaced = frame.is_interlaced();
        let by_decoder = Quantisation::of(&frame, bits(frame.format()));
        let (frame, format) = self.stored(frame)?;
        let size_px = [frame.width(), frame.height()];
        let picture = Picture::from_decoded(frame, format, colour).interlaced(interlaced);
        let by_block = match (by_decoder, stated) {
            (None, Some(Stated::Jpeg(steps))) => return Ok(picture.of_jpeg(Some(&steps))),
            (None, Some(Stated::Level(level))) => Some(Quantisation::of_level(level, size_px)),
            (by_decoder, _) => by_decoder,
        };
        self.tells_steps |= by_block.is_some();
        let quantisation = match by_block {
            Some(stated) => Some(self.last_coded.quantisation(&picture, stated)),
            None => (!self.loses_little).then(|| self.assumed(size_px)),
        };
        Ok(picture.quantised(quantisation))
    }

    /// Pictures are missing before a frame at this time.
    pub(super) fn are_missing_before(&mut self, frame: &Video, at_s: f64) {
        if self.numbers_nothing && !frame.is_key() && self.first("loss") {
            tracing::warn!(
                "{}: pictures are missing before {at_s} s, and their coder does not number them: if a recorder or \
                 network lost them after coding, those up to the next key frame are wrong",
                self.path.display()
            );
        }
    }

    /// How the picture of a frame will be stored; `None` when it cannot be.
    pub(super) fn layout(&mut self, frame: &Video) -> Option<(PixelFormat, Colour)> {
        let pixel = frame.format();
        let format = native(pixel).or(convertible(pixel).map(|(_, format)| format))?;
        Some((format, self.colour(frame).ok()?))
    }

    /// A frame in a format of [`Picture`].
    fn stored(&mut self, frame: Video) -> Result<(Video, PixelFormat), SourceError> {
        let pixel = frame.format();
        if let Some(format) = native(pixel) {
            // Formats stored bottom row first have a negative stride: swscale flips them.
            let upright = (0..frame.planes()).all(|i| frame.stride(i).cast_signed() > 0);
            return Ok((if upright { frame } else { self.convert(&frame, pixel)? }, format));
        }
        let Some((reduced, format)) = convertible(pixel) else {
            return Err(self.unsupported(pixel));
        };
        if is_deep(pixel) && self.first("depth") {
            tracing::warn!(
                "{}: pixel format {} is reduced to 8 bits ({}) by swscale",
                self.path.display(),
                name(pixel),
                name(reduced)
            );
        }
        Ok((self.convert(&frame, reduced)?, format))
    }

    /// Quantisation where the coder quantises but the decoder does not report it. (libav's decoders of MPEG-2 and
    /// MPEG-4 report it for all pictures but the last.)
    fn assumed(&mut self, size_px: [u32; 2]) -> Quantisation {
        if !self.tells_steps && self.first("quantisation") {
            tracing::warn!(
                "{}: how coarsely its coder quantised is not known; σ assumes what is usual for H.264 at crf 22",
                self.path.display()
            );
        }
        Quantisation::assumed(size_px)
    }

    fn convert(&mut self, frame: &Video, to: Pixel) -> Result<Video, SourceError> {
        let (from, w, h) = (frame.format(), frame.width(), frame.height());
        let fits = self.converter.as_ref().is_some_and(|Converter(c)| {
            let (i, o) = (c.input(), c.output());
            (i.format, i.width, i.height, o.format) == (from, w, h, to)
        });
        if !fits {
            let flags = scaling::Flags::POINT | scaling::Flags::ACCURATE_RND | scaling::Flags::BITEXACT;
            let context =
                scaling::Context::get(from, w, h, to, w, h, flags).map_err(|_no_converter| self.unsupported(from))?;
            self.converter = Some(Converter(context));
        }
        let mut converted = Video::empty();
        match self.converter.as_mut().map(|Converter(c)| c.run(frame, &mut converted)) {
            Some(Ok(())) => Ok(converted),
            _ => Err(self.unsupported(from)),
        }
    }

    fn unsupported(&self, pixel: Pixel) -> SourceError {
        SourceError::PixelFormat { path: self.path.clone(), format: name(pixel) }
    }

    /// Whether `what` occurs for the first time.
    fn first(&mut self, what: &'static str) -> bool {
        let first = !self.warned.contains(&what);
        if first {
            self.warned.push(what);
        }
        first
    }

    fn colour(&mut self, frame: &Video) -> Result<Colour, SourceError> {
        let pixel = name(frame.format());
        let is_yuv = ["yuv", "yuyv", "yvyu", "uyvy", "nv", "p0"].iter().any(|start| pixel.starts_with(start));
        Ok(Colour {
            matrix: if is_yuv { self.matrix(frame)? } else { Matrix::Bt709 },
            range: match frame.color_range() {
                color::Range::JPEG => Range::Full,
                color::Range::MPEG => Range::Limited,
                color::Range::Unspecified if is_yuv && !pixel.starts_with("yuvj") => Range::Limited,
                color::Range::Unspecified => Range::Full,
            },
            transfer: self.transfer(frame, is_yuv),
            siting: self.siting(frame),
        })
    }

    fn matrix(&mut self, frame: &Video) -> Result<Matrix, SourceError> {
        Ok(match frame.color_space() {
            color::Space::BT709 => Matrix::Bt709,
            // FCC's weights differ from BT.601's by a thousandth.
            color::Space::BT470BG | color::Space::SMPTE170M | color::Space::FCC => Matrix::Bt601,
            color::Space::BT2020NCL => Matrix::Bt2020,
            color::Space::Unspecified | color::Space::Reserved => {
                let (matrix, number) =
                    if frame.height() >= 720 { (Matrix::Bt709, "BT.709") } else { (Matrix::Bt601, "BT.601") };
                if self.first("matrix") {
                    tracing::warn!(
                        "{}: the recording does not say its YUV matrix; {number} is taken, as is usual for {} rows",
                        self.path.display(),
                        frame.height()
                    );
                }
                matrix
            }
            other => return Err(SourceError::Matrix { path: self.path.clone(), matrix: format!("{other:?}") }),
        })
    }

    fn transfer(&mut self, frame: &Video, is_yuv: bool) -> Transfer {
        use color::TransferCharacteristic as T;
        match frame.color_transfer_characteristic() {
            // RGB comes from cameras and from programs that render for a screen, YUV from video.
            T::Unspecified if !is_yuv => Transfer::Srgb,
            T::BT709 | T::SMPTE170M | T::BT2020_10 | T::BT2020_12 | T::Unspecified => Transfer::Bt709,
            T::IEC61966_2_1 => Transfer::Srgb,
            T::Linear => Transfer::Linear,
            other => {
                if self.first("transfer") {
                    tracing::warn!("{}: transfer function {other:?} is taken for BT.709's", self.path.display());
                }
                Transfer::Bt709
            }
        }
    }

    fn siting(&mut self, frame: &Video) -> ChromaSiting {
        match frame.chroma_location() {
            chroma::Location::Left => ChromaSiting::Left,
            chroma::Location::Center => ChromaSiting::Center,
            chroma::Location::TopLeft => ChromaSiting::TopLeft,
            chroma::Location::Unspecified => self.siting,
            other => {
                if self.first("siting") {
                    tracing::warn!("{}: chroma siting {other:?} is taken for left", self.path.display());
                }
                ChromaSiting::Left
            }
        }
    }
}

/// Whether the decoder marked this frame as damaged.
#[allow(unsafe_code, reason = "the binding does not offer this field")]
pub(crate) fn is_damaged(frame: &Video) -> bool {
    // SAFETY: a frame owns a valid AVFrame as long as it lives; an integer is read.
    frame.is_corrupt() || unsafe { (*frame.as_ptr()).decode_error_flags } != 0
}

/// Whether the container says that the frame of this packet is not to be shown.
#[allow(unsafe_code, reason = "the binding does not know this flag")]
pub(crate) fn is_left_out(packet: &ffmpeg_the_third::Packet) -> bool {
    use ffmpeg_the_third::packet::Ref as _;
    // SAFETY: a packet owns a valid AVPacket as long as it lives; an integer is read.
    unsafe { (*packet.as_ptr()).flags & ffmpeg_the_third::ffi::AV_PKT_FLAG_DISCARD != 0 }
}

/// libav's name.
pub(crate) fn name(pixel: Pixel) -> String {
    pixel.descriptor().map_or_else(|| "none".to_owned(), |d| d.name().to_owned())
}

/// Formats that are read as they are.
fn native(pixel: Pixel) -> Option<PixelFormat> {
    let yuv = |x, y| PixelFormat::Yuv { chroma_log2: [x, y] };
    let packed = |step, order| PixelFormat::RgbPacked { step, order };
    Some(match pixel {
        Pixel::YUV420P | Pixel::YUVJ420P | Pixel::YUVA420P => yuv(1, 1),
        Pixel::YUV422P | Pixel::YUVJ422P | Pixel::YUVA422P => yuv(1, 0),
        Pixel::YUV444P | Pixel::YUVJ444P | Pixel::YUVA444P => yuv(0, 0),
        Pixel::YUV440P | Pixel::YUVJ440P => yuv(0, 1),
        Pixel::YUV411P | Pixel::YUVJ411P => yuv(2, 0),
        Pixel::YUV410P => yuv(2, 2),
        Pixel::NV12 => PixelFormat::Nv12,
        Pixel::GRAY8 => PixelFormat::Grey,
        Pixel::GBRP | Pixel::GBRAP => PixelFormat::RgbPlanar,
        Pixel::RGB24 => packed(3, [0, 1, 2]),
        Pixel::BGR24 => packed(3, [2, 1, 0]),
        Pixel::RGBA | Pixel::RGBZ => packed(4, [0, 1, 2]),
        Pixel::BGRA | Pixel::BGRZ => packed(4, [2, 1, 0]),
        Pixel::ARGB | Pixel::ZRGB => packed(4, [1, 2, 3]),
        Pixel::ABGR | Pixel::ZBGR => packed(4, [3, 2, 1]),
        _ => return None,
    })
}

/// More than 8 bits per sample: the 8-bit format of the same layout. Packed 4:2:2: the same samples in planes.
fn convertible(pixel: Pixel) -> Option<(Pixel, PixelFormat)> {
    let name = name(pixel);
    let layout = name.trim_end_matches("le").trim_end_matches("be").trim_end_matches(|c: char| c.is_ascii_digit());
    let to = match (name.as_str(), layout) {
        ("yuyv422" | "uyvy422" | "yvyu422", _) => Pixel::YUV422P,
        (_, "yuv420p" | "yuva420p") => Pixel::YUV420P,
        (_, "yuv422p" | "yuva422p") => Pixel::YUV422P,
        (_, "yuv444p" | "yuva444p") => Pixel::YUV444P,
        (_, "yuv440p") => Pixel::YUV440P,
        (_, "gbrp" | "gbrap") => Pixel::GBRP,
        (_, "gray") => Pixel::GRAY8,
        ("p010le" | "p010be" | "p012le" | "p012be" | "p016le" | "p016be", _) => Pixel::NV12,
        ("bayer_rggb8" | "bayer_bggr8" | "bayer_grbg8" | "bayer_gbrg8", _) => Pixel::RGB24,
        ("rgb48le" | "rgb48be", _) => Pixel::RGB24,
        ("bgr48le" | "bgr48be", _) => Pixel::BGR24,
        ("rgba64le" | "rgba64be", _) => Pixel::RGBA,
        ("bgra64le" | "bgra64be", _) => Pixel::BGRA,
        _ => return None,
    };
    native(to).map(|format| (to, format))
}

/// Bits of a sample, among the formats that coders of video store.
fn bits(pixel: Pixel) -> i32 {
    let name = name(pixel);
    let plain = name.trim_end_matches("le").trim_end_matches("be");
    plain.rsplit(|c: char| !c.is_ascii_digit()).next().and_then(|digits| digits.parse().ok()).unwrap_or(8)
}

/// Whether samples have more than 8 bits, among the convertible formats.
fn is_deep(pixel: Pixel) -> bool {
    use Pixel::{BAYER_BGGR8, BAYER_GBRG8, BAYER_GRBG8, BAYER_RGGB8, UYVY422, YUYV422, YVYU422};
    !matches!(pixel, YUYV422 | UYVY422 | YVYU422 | BAYER_RGGB8 | BAYER_BGGR8 | BAYER_GRBG8 | BAYER_GBRG8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deep_formats_become_the_8_bit_format_of_the_same_layout_and_others_are_refused() {
        let deep = [Pixel::YUV420P, Pixel::YUV422P10LE, Pixel::P010LE, Pixel::GRAY12LE, Pixel::GRAY8];
        assert_eq!(deep.map(bits), [8, 10, 10, 12, 8]);
        let to = |pixel| convertible(pixel).map(|(to, _)| to);
        assert_eq!(to(Pixel::YUV420P10LE), Some(Pixel::YUV420P));
        assert_eq!(to(Pixel::YUV444P12BE), Some(Pixel::YUV444P));
        assert_eq!(to(Pixel::GBRP10LE), Some(Pixel::GBRP));
        assert_eq!(to(Pixel::GRAY16LE), Some(Pixel::GRAY8));
        assert_eq!(to(Pixel::P010LE), Some(Pixel::NV12));
        assert_eq!(to(Pixel::RGB48BE), Some(Pixel::RGB24));
        for other in [Pixel::PAL8, Pixel::MonoBlack, Pixel::RGB565LE, Pixel::NV16, Pixel::None, Pixel::VAAPI] {
            assert_eq!(to(other), None, "{other:?}");
            assert_eq!(native(other), None, "{other:?}");
        }
    }

    fn maker() -> PictureMaker {
        PictureMaker::new("test.mkv".into(), Id::H264)
    }

    #[test]
    fn a_coder_is_lossy_unless_it_is_known_not_to_be() {
        let quantised = |codec| {
            let mut maker = PictureMaker::new("test.mkv".into(), codec);
            maker.picture(Video::new(Pixel::YUV420P, 16, 8)).unwrap().quantisation().is_some()
        };
        for codec in [Id::HEVC, Id::AV1, Id::RV40, Id::DVVIDEO, Id::H264, Id::MSMPEG4V3] {
            assert!(quantised(codec), "{codec:?}");
        }
        for codec in [Id::RAWVIDEO, Id::FFV1, Id::PRORES, Id::MJPEG] {
            assert!(!quantised(codec), "{codec:?}");
        }
    }

    #[test]
    fn ten_bits_are_reduced_to_eight() {
        let mut frame = Video::new(Pixel::YUV420P10LE, 16, 8);
        for plane in 0..3 {
            for sample in frame.data_mut(plane).chunks_exact_mut(2) {
                sample.copy_from_slice(&(4 * (50 + 40 * plane as u16)).to_le_bytes());
            }
        }
        let picture = maker().picture(frame).unwrap();
        assert_eq!(picture.format(), PixelFormat::Yuv { chroma_log2: [1, 1] });
        for (i, value) in [50, 90, 130].into_iter().enumerate() {
            let plane = picture.plane(i).unwrap();
            assert!(plane.row(plane.height - 1).unwrap().iter().all(|&v| v == value), "{i}");
        }
    }

    #[test]
    fn packed_yuyv_is_taken_apart_without_a_change() {
        let mut frame = Video::new(Pixel::YUYV422, 16, 4);
        for (i, pair) in frame.data_mut(0).chunks_exact_mut(4).enumerate() {
            pair.copy_from_slice(&[i as u8, 100, i as u8 + 1, 200]);
        }
        let picture = maker().picture(frame).unwrap();
        assert_eq!(picture.plane(0).unwrap().row(0).unwrap()[..4], [0, 1, 1, 2]);
        assert_eq!(picture.plane(1).unwrap().row(3).unwrap()[..8], [100; 8]);
        assert_eq!(picture.plane(2).unwrap().row(3).unwrap()[..8], [200; 8]);
    }

    #[test]
    fn planar_rgb_gives_red_green_and_blue_in_that_order() {
        let mut frame = Video::new(Pixel::GBRP, 8, 8);
        for (plane, value) in [20, 30, 10].into_iter().enumerate() {
            frame.data_mut(plane).fill(value);
        }
        let picture = maker().picture(frame).unwrap();
        assert_eq!([0, 1, 2].map(|i| picture.plane(i).unwrap().data[0]), [10, 20, 30]);
    }

    #[test]
    fn colour_tags_are_read_and_missing_ones_follow_convention() {
        let tags = |frame: Video| maker().picture(frame).unwrap().colour();
        let plain = tags(Video::new(Pixel::YUV420P, 64, 48));
        let convention = Colour {
            matrix: Matrix::Bt601,
            range: Range::Limited,
            transfer: Transfer::Bt709,
            siting: ChromaSiting::Left,
        };
        assert_eq!(plain, convention);
        assert_eq!(tags(Video::new(Pixel::YUV420P, 64, 720)).matrix, Matrix::Bt709);
        assert_eq!(tags(Video::new(Pixel::YUVJ420P, 64, 48)).range, Range::Full);
        let rgb = tags(Video::new(Pixel::RGB24, 64, 48));
        assert_eq!((rgb.range, rgb.transfer), (Range::Full, Transfer::Srgb));
        assert_eq!(
            [Pixel::YUYV422, Pixel::UYVY422, Pixel::YVYU422].map(|p| tags(Video::new(p, 64, 48))),
            [convention; 3]
        );
        let mut tagged = Video::new(Pixel::YUV420P, 64, 48);
        tagged.set_color_space(color::Space::BT2020NCL);
        tagged.set_color_range(color::Range::JPEG);
        tagged.set_color_transfer_characteristic(color::TransferCharacteristic::Linear);
        let expected = Colour {
            matrix: Matrix::Bt2020,
            range: Range::Full,
            transfer: Transfer::Linear,
            siting: ChromaSiting::Left,
        };
        assert_eq!(tags(tagged), expected);
        let mut other = Video::new(Pixel::YUV420P, 64, 48);
        other.set_color_space(color::Space::YCGCO);
        assert!(matches!(maker().picture(other), Err(SourceError::Matrix { .. })));
        let jpeg =
            PictureMaker::new("test.avi".into(), Id::MJPEG).picture(Video::new(Pixel::YUVJ420P, 64, 48)).unwrap();
        assert_eq!(jpeg.colour().siting, ChromaSiting::Center);
    }
}
