//! Writes recordings for tests through libav's encoders, so that no other program is needed.

use std::path::Path;

use ffmpeg_the_third as av;

/// A recording to be written.
pub(crate) struct Recording<'a> {
    /// Width and height, pixels.
    pub(crate) size_px: [u32; 2],
    /// Time base of `pts`.
    pub(crate) time_base: (i32, i32),
    /// Presentation times in units of the time base, rising.
    pub(crate) pts: &'a [i64],
    /// B pictures between two others.
    pub(crate) b_frames: usize,
    /// Frames from key frame to key frame.
    pub(crate) group: u32,
    /// Name of libav's encoder.
    pub(crate) encoder: &'a str,
    /// Pixel format of the stream.
    pub(crate) pixel: av::format::Pixel,
    /// Tags: matrix and range.
    pub(crate) colour: (av::color::Space, av::color::Range),
    /// Samples of all planes but the first.
    pub(crate) chroma: u8,
    /// Write the index of an MP4 in front.
    pub(crate) index_first: bool,
}

impl Default for Recording<'_> {
    fn default() -> Self {
        Self {
            size_px: [64, 48],
            time_base: (1, 1000),
            pts: &[],
            b_frames: 2,
            group: 12,
            encoder: "libx264",
            pixel: av::format::Pixel::YUV420P,
            colour: (av::color::Space::BT709, av::color::Range::MPEG),
            chroma: 128,
            index_first: false,
        }
    }
}

/// What came to be written.
pub(crate) struct Written {
    /// Time base of the stream in the file.
    pub(crate) time_base: (i32, i32),
    /// Presentation times in the file, in its time base, rising.
    pub(crate) pts: Vec<i64>,
    /// Whether pictures are stored in another order than shown.
    pub(crate) reordered: bool,
}

impl Written {
    /// Times in nanoseconds, to the nearest.
    pub(crate) fn stamps_ns(&self) -> Vec<i64> {
        let (n, d) = (i128::from(self.time_base.0), i128::from(self.time_base.1));
        let ns = |pts: &i64| (i128::from(*pts) * n * 2_000_000_000 + d).div_euclid(2 * d);
        self.pts.iter().map(|pts| i64::try_from(ns(pts)).unwrap()).collect()
    }
}

/// Luma of frame `i` at (x, y): a pattern that moves, different in every frame.
pub(crate) fn luma(i: usize, x: usize, y: usize) -> u8 {
    (40 + (3 * i + 2 * x + y) % 160) as u8
}

/// Writes the recording; the container follows from the ending of `path`.
pub(crate) fn write(path: &Path, recording: &Recording<'_>) -> Written {
    av::log::set_level(av::log::Level::Quiet);
    let codec = av::encoder::find_by_name(recording.encoder).expect("FFmpeg's libraries with this encoder");
    let mut output = av::format::output(path).unwrap();
    let mut context = av::codec::Context::new_with_codec(codec);
    if output.format().flags().contains(av::format::Flags::GLOBAL_HEADER) {
        context.set_flags(av::codec::Flags::GLOBAL_HEADER);
    }
    let mut encoder = context.encoder().video().unwrap();
    let [w, h] = recording.size_px;
    encoder.set_width(w);
    encoder.set_height(h);
    encoder.set_format(recording.pixel);
    encoder.set_time_base(recording.time_base);
    encoder.set_gop(recording.group);
    encoder.set_max_b_frames(recording.b_frames);
    encoder.set_colorspace(recording.colour.0);
    encoder.set_color_range(recording.colour.1);
    encoder.set_quality(0);
    let mut options = av::Dictionary::new();
    if recording.encoder == "libx264" {
        options.set("preset", "veryfast");
        // B pictures as asked, also where the content would not call for them.
        options.set("x264-params", "scenecut=0:b-adapt=0:threads=1:qp=1:log-level=none");
    }
    let mut encoder = encoder.open_as_with(codec, options).unwrap();
    {
        let mut stream = output.add_stream(codec).unwrap();
        stream.set_time_base(recording.time_base);
        stream.copy_parameters_from_context(&encoder);
    }
    let mut options = av::Dictionary::new();
    if recording.index_first {
        options.set("movflags", "faststart");
    }
    output.write_header_with(options).unwrap();
    let stored = output.stream(0).unwrap().time_base();
    let mut pts = Vec::new();
    let mut collect = |encoder: &mut av::encoder::Video| {
        let mut packet = av::Packet::empty();
        while encoder.receive_packet(&mut packet).is_ok() {
            packet.rescale_ts(recording.time_base, stored);
            packet.set_stream(0);
            pts.push(packet.pts().unwrap());
            packet.write_interleaved(&mut output).unwrap();
        }
    };
    let mut frame = av::frame::Video::new(recording.pixel, w, h);
    for (i, &time) in recording.pts.iter().enumerate() {
        frame = draw(frame, recording.chroma, i);
        frame.set_pts(Some(time));
        encoder.send_frame(&frame).unwrap();
        collect(&mut encoder);
        // The encoder may still hold the frame just sent.
        frame = av::frame::Video::new(recording.pixel, w, h);
    }
    encoder.send_eof().unwrap();
    collect(&mut encoder);
    output.write_trailer().unwrap();
    let reordered = !pts.is_sorted();
    pts.sort_unstable();
    Written { time_base: (stored.0, stored.1), pts, reordered }
}

/// The first plane with the moving pattern, others even.
fn draw(mut frame: av::frame::Video, chroma: u8, i: usize) -> av::frame::Video {
    let (stride, width) = (frame.stride(0), frame.width() as usize);
    let bytes = frame.data(0).len();
    for plane in 1..frame.planes() {
        frame.data_mut(plane).fill(chroma);
    }
    let deep = frame.format().descriptor().is_some_and(|d| d.name().contains("10"));
    for y in 0..bytes / stride {
        for x in 0..width.min(stride) {
            let value = luma(i, x, y);
            if deep {
                let place = y * stride + 2 * x;
                frame.data_mut(0)[place..place + 2].copy_from_slice(&(4 * u16::from(value)).to_le_bytes());
            } else {
                frame.data_mut(0)[y * stride + x] = value;
            }
        }
    }
    frame
}
