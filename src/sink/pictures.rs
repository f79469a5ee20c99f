//! The pictures of a run as a video: FFV1, without loss, or H.264, in Matroska through libav.
//!
//! In: pictures as they were tracked. Out: every picture at its camera time, to the nanosecond, with the tags of its
//! colours. With FFV1 the samples are those that were tracked (packed RGB and NV12 are reordered, nothing is
//! converted), so tracking the video gives the same positions; what σ took from the coder of the source is not in it.
//! Damaged and interlaced pictures are left out: the video cannot mark them. H.264 keeps a picture's subsampling; RGB
//! becomes 4:2:0.
//!
//! libav's muxer counts in milliseconds. Matroska allows finer units (`TimestampScale`, RFC 9559 §5.1.2.9): the file
//! gets stamps in nanoseconds, and the scale in its header is set to match. Every picture is in its own cluster, which
//! is written when the next one begins: a kill loses the last one. Such a file has no index. Where the camera's clock
//! has run longer than libav can read, the first stamp in the file is zero, and a tag (`CATOPTRA_ORIGIN_NS`) has its
//! true value.

use super::clock::Rising;
use super::colour::{ConvertError, FromBgr, ToBgr};
use super::encode::receive;
use super::{Sink, SinkError, settle_written};
use crate::estimate::Estimate;
use crate::source::{
    ChromaSiting, Colour, Matrix, ORIGIN_TAG, Picture, PixelFormat, Plane, Range, Transfer, quiet_libav, url_of,
};
use crate::tally::Tally;
use ffmpeg_the_third as av;
use ffmpeg_the_third::format::Pixel;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// How pictures are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureCodec {
    /// Without loss.
    Ffv1,
    /// With loss.
    H264,
}

/// `TimestampScale`, its length and libav's value of it: a millisecond.
const MILLISECONDS: [u8; 7] = [0x2A, 0xD7, 0xB1, 0x83, 0x0F, 0x42, 0x40];
/// Bytes of the value.
const NANOSECONDS: [u8; 3] = [0, 0, 1];
/// First stamps that are written unchanged: libav reads Matroska's times as `f64`, which hold nanoseconds for 104 days.
const EXACT_NS: RangeInclusive<i64> = 0..=1 << 52;
/// Longest header of a file, bytes.
const HEAD: u64 = 1 << 16;

/// Writes one video of pictures.
pub struct PictureVideo {
    path: PathBuf,
    codec: PictureCodec,
    running: Option<Running>,
    warned: bool,
}

struct Running {
    output: av::format::context::Output,
    encoder: av::encoder::video::Encoder,
    frames: Frames,
    /// Subtracted from every stamp, and recorded in the file.
    origin_ns: i64,
    shown: Rising,
}

/// Makes libav frames from pictures.
struct Frames {
    pixel: Pixel,
    layout: (PixelFormat, [u32; 2]),
    /// For converting RGB to 4:2:0.
    converted: Option<(ToBgr, Vec<u8>, FromBgr)>,
}

impl PictureVideo {
    /// Creates the file (an existing one is replaced). The first picture determines its format.
    ///
    /// # Errors
    /// When the file cannot be written, or libav lacks the encoder.
    pub fn create(path: &Path, codec: PictureCodec) -> Result<Self, SinkError> {
        find(path, codec)?;
        File::create(path).map_err(|source| SinkError::io(path, source))?;
        Ok(Self { path: path.to_owned(), codec, running: None, warned: false })
    }

    fn start(&self, picture: &Picture, stamp_ns: i64) -> Result<Running, SinkError> {
        let path = &self.path;
        let fail = |doing| move |source| SinkError::Video { path: path.clone(), doing, source };
        quiet_libav();
        let mut output = av::format::output_as(url_of(path), "matroska").map_err(fail("opening"))?;
        let codec = find(path, self.codec)?;
        let frames = Frames::for_picture(path, picture, self.codec)?;
        let mut settings = av::codec::Context::new_with_codec(codec).encoder().video().map_err(fail("encoder"))?;
        let [width, height] = picture.size_px();
        settings.set_width(width);
        settings.set_height(height);
        settings.set_format(frames.pixel);
        settings.set_time_base(av::Rational(1, 1_000_000_000));
        // Rate control only.
        settings.set_frame_rate(Some(av::Rational(60, 1)));
        // One intra-coded picture in 60: at most that much can be lost.
        settings.set_gop(if self.codec == PictureCodec::Ffv1 { 1 } else { 60 });
        settings.set_max_b_frames(0);
        if output.format().flags().contains(av::format::Flags::GLOBAL_HEADER) {
            settings.set_flags(av::codec::Flags::GLOBAL_HEADER);
        }
        let mut options = av::Dictionary::new();
        let own: &[(&str, &str)] = match self.codec {
            // Four slices, each with a checksum; at most two threads beside the tracker's.
            PictureCodec::Ffv1 => &[("level", "3"), ("slices", "4"), ("slicecrc", "1"), ("threads", "2")],
            PictureCodec::H264 => &[("preset", "superfast"), ("tune", "zerolatency"), ("crf", "14"), ("threads", "2")],
        };
        let tags = if frames.converted.is_some() {
            tags(CONVERTED, true)
        } else {
            tags(picture.colour(), picture.format().is_yuv())
        };
        for (key, value) in own.iter().copied().chain(tags) {
            options.set(key, value);
        }
        let encoder = settings.open_with(options).map_err(fail("opening the encoder"))?;
        let mut stream = output.add_stream(codec).map_err(fail("adding the stream"))?;
        stream.copy_parameters_from_context(&encoder);
        let origin_ns = if EXACT_NS.contains(&stamp_ns) { 0 } else { stamp_ns };
        if origin_ns != 0 {
            output.metadata_mut().set(ORIGIN_TAG, origin_ns.to_string());
        }
        let mut options = av::Dictionary::new();
        // As for a live stream: nothing is overwritten later. Each cluster has one picture and is passed to the system
        // at once.
        let muxing = [("live", "1"), ("write_crc32", "0"), ("cluster_time_limit", "1"), ("flush_packets", "1")];
        for (key, value) in muxing {
            options.set(key, value);
        }
        output.write_header_with(options).map_err(fail("writing the header"))?;
        count_in_nanoseconds(path).map_err(|source| SinkError::io(path, source))?;
        Ok(Running { output, encoder, frames, origin_ns, shown: Rising::new() })
    }

    /// Adds a picture.
    ///
    /// # Errors
    /// [`SinkError`] when it cannot be encoded or written.
    pub fn add(&mut self, picture: &Picture, stamp_ns: i64) -> Result<(), SinkError> {
        if self.running.is_none() {
            self.running = Some(self.start(picture, stamp_ns)?);
        }
        let Some(running) = &mut self.running else { return Ok(()) };
        let failed = failed(&self.path);
        let mut frame = running.frames.frame(&self.path, picture)?;
        let ns = running.shown.next(
            stamp_ns.saturating_sub(running.origin_ns),
            stamp_ns,
            "a picture is not later than the one before: such pictures are 1 ns apart in the video, and their own \
             times are in the log alone",
        );
        frame.set_pts(Some(ns));
        running.encoder.send_frame(&frame).map_err(failed("encoding"))?;
        running.drain().map_err(failed("writing"))
    }
}

/// Whether a video of such pictures shows what can be measured: it would not say that one is damaged or interlaced, or
/// which parts of it were never recorded.
pub(crate) fn can_hold(picture: &Picture) -> bool {
    !picture.is_damaged() && !picture.is_interlaced() && picture.is_whole()
}

impl Sink for PictureVideo {
    fn write(&mut self, estimate: &Estimate, picture: Option<&Picture>) -> Result<(), SinkError> {
        let picture = picture.ok_or_else(|| SinkError::NoPicture { path: self.path.clone() })?;
        if !can_hold(picture) {
            if !self.warned {
                tracing::warn!(
                    "{}: damaged and interlaced pictures, and those of which a log has only parts, are left out, as \
                     the video cannot say what they are",
                    self.path.display()
                );
                self.warned = true;
            }
            return Ok(());
        }
        self.add(picture, estimate.stamp.ns)
    }

    fn finish(&mut self, _: &Tally) -> Result<(), SinkError> {
        // A run without a picture has an empty file.
        let Some(mut running) = self.running.take() else { return Ok(()) };
        let failed = failed(&self.path);
        let flushed = running.encoder.send_eof().map_err(failed("encoding"));
        let flushed = flushed.and_then(|()| running.drain().map_err(failed("writing")));
        let ended = running.output.write_trailer().map_err(failed("completing"));
        flushed.and(ended)?;
        settle_written(&self.path)
    }
}

impl Running {
    /// Moves finished packets from the encoder into the file.
    fn drain(&mut self) -> Result<(), av::Error> {
        let mut packet = av::Packet::empty();
        while receive(&mut self.encoder, &mut packet)? {
            packet.set_stream(0);
            // The stamps are not rescaled: see the head of this file.
            packet.write(&mut self.output)?;
            end_cluster(&mut self.output)?;
        }
        Ok(())
    }
}

/// The output format of [`FromBgr::for_video`].
const CONVERTED: Colour =
    Colour { matrix: Matrix::Bt709, range: Range::Limited, transfer: Transfer::Bt709, siting: ChromaSiting::Left };

impl Frames {
    fn for_picture(path: &Path, picture: &Picture, codec: PictureCodec) -> Result<Self, SinkError> {
        let unsupported =
            || SinkError::PixelFormat { path: path.to_owned(), format: format!("{:?}", picture.format()) };
        let rgb = matches!(picture.format(), PixelFormat::RgbPlanar | PixelFormat::RgbPacked { .. });
        let pixel = match picture.format() {
            PixelFormat::RgbPlanar | PixelFormat::RgbPacked { .. } if codec == PictureCodec::Ffv1 => Pixel::BGRZ,
            PixelFormat::RgbPlanar | PixelFormat::RgbPacked { .. } => Pixel::YUV420P,
            PixelFormat::Nv12 | PixelFormat::Yuv { chroma_log2: [1, 1] } => Pixel::YUV420P,
            PixelFormat::Yuv { chroma_log2: [1, 0] } => Pixel::YUV422P,
            PixelFormat::Yuv { chroma_log2: [0, 0] } => Pixel::YUV444P,
            PixelFormat::Yuv { chroma_log2: [0, 1] } => Pixel::YUV440P,
            PixelFormat::Yuv { chroma_log2: [2, 0] } if codec == PictureCodec::Ffv1 => Pixel::YUV411P,
            PixelFormat::Yuv { chroma_log2: [2, 2] } if codec == PictureCodec::Ffv1 => Pixel::YUV410P,
            PixelFormat::Yuv { .. } | PixelFormat::Grey => return Err(unsupported()),
        };
        let [width, height] = picture.size_px();
        let converted = if rgb && codec == PictureCodec::H264 {
            let to_yuv = FromBgr::for_video([width, height]);
            let to_yuv =
                to_yuv.map_err(|source| SinkError::Video { path: path.into(), doing: "colour conversion", source })?;
            Some((ToBgr::default(), vec![0; 3 * width as usize * height as usize], to_yuv))
        } else {
            None
        };
        Ok(Self { pixel, layout: (picture.format(), picture.size_px()), converted })
    }

    fn frame(&mut self, path: &Path, picture: &Picture) -> Result<av::frame::Video, SinkError> {
        if (picture.format(), picture.size_px()) != self.layout {
            let words = |(format, [width, height]): (PixelFormat, [u32; 2])| format!("{width}x{height} {format:?}");
            return Err(SinkError::PictureChanged {
                path: path.to_owned(),
                before: words(self.layout),
                after: words((picture.format(), picture.size_px())),
            });
        }
        let [width, height] = picture.size_px();
        if let Some((to_bgr, bgr, to_yuv)) = &mut self.converted {
            let stride = 3 * width as usize;
            let fail = |source| SinkError::Video { path: path.into(), doing: "colour conversion", source };
            to_bgr.convert(picture, bgr, stride).map_err(|error| match error {
                ConvertError::Unsupported(format) => {
                    SinkError::PixelFormat { path: path.into(), format: format!("{format:?}") }
                }
                ConvertError::Av(source) => fail(source),
            })?;
            return to_yuv.convert(bgr, stride).map_err(fail);
        }
        let mut frame = av::frame::Video::new(self.pixel, width, height);
        for (i, plane) in (0..3).filter_map(|i| Some((i, picture.plane(i)?))) {
            // B'G'R'0 in one plane, or three planes.
            let (to, step, first) = if self.pixel == Pixel::BGRZ { (0, 4, 2 - i) } else { (i, 1, 0) };
            let stride = frame.stride(to);
            copy(&plane, frame.data_mut(to), (stride, step, first));
        }
        Ok(frame)
    }
}

/// Copies the samples of a plane to every `step`th byte of rows `stride` apart.
fn copy(plane: &Plane<'_>, to: &mut [u8], (stride, step, first): (usize, usize, usize)) {
    for (row, to) in to.chunks_mut(stride).take(plane.height).enumerate() {
        let from = plane.row(row).unwrap_or_default();
        if plane.step == 1 && step == 1 {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
        } else {
            let to = to.iter_mut().skip(first).step_by(step);
            to.zip(from.iter().step_by(plane.step)).for_each(|(to, from)| *to = *from);
        }
    }
}

/// libav's options for the colour tags.
fn tags(colour: Colour, is_yuv: bool) -> impl Iterator<Item = (&'static str, &'static str)> {
    let matrix = match colour.matrix {
        Matrix::Bt601 => "smpte170m",
        Matrix::Bt709 => "bt709",
        Matrix::Bt2020 => "bt2020nc",
    };
    let range = match colour.range {
        Range::Limited => "tv",
        Range::Full => "pc",
    };
    let transfer = match colour.transfer {
        Transfer::Bt709 => "bt709",
        Transfer::Srgb => "iec61966-2-1",
        Transfer::Linear => "linear",
    };
    let siting = match colour.siting {
        ChromaSiting::Left => "left",
        ChromaSiting::Center => "center",
        ChromaSiting::TopLeft => "topleft",
    };
    let all = [("color_range", range), ("color_trc", transfer)].into_iter();
    all.chain([("colorspace", matrix), ("chroma_sample_location", siting)].into_iter().filter(move |_| is_yuv))
}

/// Passes the last picture to the system, so that a kill does not lose it.
#[allow(unsafe_code, reason = "the binding cannot write the empty packet that asks for it")]
fn end_cluster(output: &mut av::format::context::Output) -> Result<(), av::Error> {
    // SAFETY: the context is valid as long as it is borrowed; without a packet the muxer flushes.
    let code = unsafe { av::ffi::av_write_frame(output.as_mut_ptr(), std::ptr::null_mut()) };
    if code < 0 { Err(av::Error::from(code)) } else { Ok(()) }
}

/// Sets the time scale in the header of the file at `path`.
fn count_in_nanoseconds(path: &Path) -> std::io::Result<()> {
    let mut file = OpenOptions::new().read(true).write(true).open(path)?;
    let mut head = Vec::new();
    (&mut file).take(HEAD).read_to_end(&mut head)?;
    let at = head.windows(MILLISECONDS.len()).position(|bytes| bytes == MILLISECONDS);
    let at = at.ok_or_else(|| std::io::Error::other("libav wrote no TimestampScale of a millisecond into its head"))?;
    let value = at + MILLISECONDS.len() - NANOSECONDS.len();
    file.seek(SeekFrom::Start(value as u64))?;
    file.write_all(&NANOSECONDS)
}

fn find(path: &Path, codec: PictureCodec) -> Result<av::Codec, SinkError> {
    let name = match codec {
        PictureCodec::Ffv1 => "ffv1",
        PictureCodec::H264 => "libx264",
    };
    av::encoder::find_by_name(name)
        .ok_or_else(|| SinkError::NoEncoder { path: path.to_owned(), tried: name.to_owned() })
}

fn failed(path: &Path) -> impl Fn(&'static str) -> Box<dyn Fn(av::Error) -> SinkError> + use<> {
    let path = path.to_owned();
    move |doing| {
        let path = path.clone();
        Box::new(move |source| SinkError::Video { path: path.clone(), doing, source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{FrameSource as _, VideoFile, VideoOptions};
    use crate::testing::fixture;

    #[test]
    fn what_a_video_cannot_mark_is_left_out() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("pictures.mkv");
        let mut video = PictureVideo::create(&path, PictureCodec::Ffv1).unwrap();
        let colour = Colour { matrix: Matrix::Bt709, range: Range::Limited, ..Colour::SRGB };
        let format = PixelFormat::Yuv { chroma_log2: [1, 1] };
        let sound = |value: u8| {
            let planes = vec![vec![value; 32 * 24], vec![128; 16 * 12], vec![128; 16 * 12]];
            Picture::from_planes(32, 24, format, colour, planes).unwrap()
        };
        let pictures = [sound(20), sound(40).marked_damaged(), sound(60).interlaced(true), sound(80)];
        for (seq, picture) in (0..).zip(&pictures) {
            let mut estimate = fixture::complete(seq, 0);
            estimate.stamp.ns = seq as i64 * 16_666_667;
            video.write(&estimate, Some(picture)).unwrap();
        }
        video.finish(&Tally::new(&fixture::rig())).unwrap();
        let mut kept = VideoFile::open(&path, VideoOptions::default()).unwrap();
        let mut seen = Vec::new();
        while let Some(frame) = kept.next_frame().unwrap() {
            seen.push((frame.stamp.ns, frame.picture.plane(0).unwrap().row(0).unwrap()[0]));
        }
        assert_eq!(seen, [(0, 20), (3 * 16_666_667, 80)]);
    }
}
