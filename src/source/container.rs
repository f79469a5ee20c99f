//! Opens a recording's container and decoder, with readable errors.

use std::ffi::OsString;
use std::fs::File;
use std::path::Path;

use ffmpeg_the_third as av;

use super::extent::{Extent, extent};
use super::names::without_credentials;
use super::times::seconds;
use super::{SourceError, Span, messages};

/// libav's names of streams without a container, and of pictures one after another. It gives both a rate of its own.
const RAW_STREAMS: [&str; 21] = [
    "avs2",
    "avs3",
    "cavsvideo",
    "dirac",
    "dnxhd",
    "evc",
    "h261",
    "h263",
    "h264",
    "hevc",
    "image2",
    "image2pipe",
    "ingenient",
    "m4v",
    "mjpeg",
    "mjpeg_2000",
    "mpegvideo",
    "mpjpeg",
    "obu",
    "vc1",
    "vvc",
];

/// libav writes to stderr by itself. What matters is in our errors and warnings, and what it says of packets is heard;
/// the rest shows only when debugging.
pub(crate) fn quiet_libav() {
    let debugging = tracing::enabled!(tracing::Level::DEBUG);
    av::log::set_level(if debugging { av::log::Level::Warning } else { av::log::Level::Quiet });
    messages::listen();
}

/// Whether the data has no container and no times: those that libav gives its pictures are invented.
pub(super) fn is_raw(input: &av::format::context::Input) -> bool {
    let format = input.format();
    RAW_STREAMS.contains(&format.name()) || format.name().ends_with("_pipe")
}

/// Checks the file itself: the operating system's errors are clearer than libav's.
pub(super) fn measure(path: &Path) -> Result<Extent, SourceError> {
    let io = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::NotFound => SourceError::NotFound { path: path.to_path_buf() },
        _ => SourceError::Io { path: path.to_path_buf(), error },
    };
    let file = File::open(path).map_err(io)?;
    if file.metadata().map_err(io)?.is_dir() {
        return Err(SourceError::IsFolder { path: path.to_path_buf() });
    }
    extent(file).map_err(io)
}

/// A file's address for libav, which would take a colon in its path for the end of a protocol's name.
pub(crate) fn url_of(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

pub(super) fn open_input(path: &Path) -> Result<av::format::context::Input, SourceError> {
    let not_a_video = |reason: String| SourceError::NotAVideo { path: path.to_path_buf(), reason };
    // libav shows pictures of a GIF for 0.1 s that have less than 0.02 s. (A delay of 0, which states none, then counts
    // as 0.01 s.)
    let options: av::Dictionary = [("min_delay", "0")].into_iter().collect();
    let input =
        av::format::input_with_dictionary(url_of(path), options).map_err(|error| not_a_video(error.to_string()))?;
    // libav renders plain text as a terminal would.
    match input.format().name() {
        "tty" => Err(not_a_video("it is a text file".to_owned())),
        // It may also take the name for a pattern, and read other files.
        "image2" => Err(not_a_video("it is a picture: pictures are read from a folder".to_owned())),
        _ => Ok(input),
    }
}

/// A network stream, or `-` for standard input. Little is read ahead (and it is kept: probing loses no frame), and a
/// sender that is silent for [`PROBE_TIMEOUT_US`] is given up.
pub(super) fn open_stream(url: &str) -> Result<av::format::context::Input, SourceError> {
    let patience = PROBE_TIMEOUT_US.to_string();
    let options = [
        ("timeout", patience.as_str()),
        ("rw_timeout", patience.as_str()),
        ("rtsp_flags", "prefer_tcp"),
        ("analyzeduration", "100000"),
        ("fpsprobesize", "0"),
    ];
    let address = if url == "-" { "pipe:0" } else { url };
    av::format::input_with_dictionary(address, options.into_iter().collect::<av::Dictionary>())
        .map_err(|error| SourceError::Stream { url: without_credentials(url), reason: error.to_string() })
}

/// Microseconds.
const PROBE_TIMEOUT_US: u32 = 3_000_000;

/// The video stream; cover pictures of audio files do not count.
pub(super) fn best_video<'a>(
    path: &Path,
    input: &'a av::format::context::Input,
) -> Result<av::format::stream::Stream<'a>, SourceError> {
    let stream = input.streams().best(av::media::Type::Video);
    let pictures = |s: &av::format::stream::Stream<'_>| {
        s.parameters().medium() == av::media::Type::Video
            && !s.disposition().contains(av::format::stream::Disposition::ATTACHED_PIC)
    };
    let videos = input.streams().filter(pictures).count();
    if let (Some(stream), 2..) = (&stream, videos) {
        tracing::warn!(
            "{}: has {videos} video streams; the best, number {}, is read, the others are not",
            path.display(),
            stream.index()
        );
    }
    stream.filter(|s| !s.disposition().contains(av::format::stream::Disposition::ATTACHED_PIC)).ok_or_else(|| {
        let kinds: Vec<String> =
            input.streams().map(|s| format!("{:?}", s.parameters().medium()).to_lowercase()).collect();
        let found = if kinds.is_empty() { "no stream at all".to_owned() } else { format!("only {}", kinds.join(", ")) };
        SourceError::NoVideoStream { path: path.to_path_buf(), found }
    })
}

/// The display matrix of pictures shown as they are stored: 3 x 3, in 16.16 fixed point, the last column in 2.30.
fn upright() -> Vec<u8> {
    let one = 1 << 16;
    [one, 0, 0, 0, one, 0, 0, 0, 1 << 30].into_iter().flat_map(i32::to_ne_bytes).collect()
}

/// The configuration record of a stream's codec (libav's "extradata"); empty when there is none.
#[allow(unsafe_code, reason = "the binding does not offer this field")]
pub(super) fn configuration(stream: &av::format::stream::Stream<'_>) -> Vec<u8> {
    let parameters = stream.parameters();
    // SAFETY: the stream owns its parameters, which are not changed here; libav keeps `extradata_size` bytes at
    // `extradata`.
    unsafe {
        let parameters = parameters.as_ptr();
        match usize::try_from((*parameters).extradata_size) {
            Ok(size) if size > 0 && !(*parameters).extradata.is_null() => {
                std::slice::from_raw_parts((*parameters).extradata, size).to_vec()
            }
            _ => Vec::new(),
        }
    }
}

/// Whether a decoder of several threads reports as much damage as one of a single thread. Of the codecs that predict
/// pictures from others only H.264 is known to (see `messages`).
fn reports_with_threads(codec: av::codec::Id) -> bool {
    use av::codec::Id;
    matches!(
        codec,
        Id::H264
            | Id::MJPEG
            | Id::FFV1
            | Id::PNG
            | Id::HUFFYUV
            | Id::FFVHUFF
            | Id::UTVIDEO
            | Id::PRORES
            | Id::DNXHD
            | Id::RAWVIDEO
    )
}

/// Most frames that are stored before one that is shown earlier (H.264).
pub(super) const MAX_REORDERED: i32 = 16;

/// Threads for a decoder, 0 for as many as keep all cores busy. Threads with a picture each wait for those of others:
/// one more than there are cores. Slices of a picture are shared out over the cores alone: with one thread more on two
/// cores, FFV1 took 6 to 12 % longer to decode.
///
/// H.264 with reordered pictures: a thread that gives out the picture of another copies its quantisers, though they may
/// not all be known yet. So pictures are held back until that thread must be done.
#[allow(unsafe_code, reason = "the binding only reads this field")]
fn set_threads(context: &mut av::codec::Context, codec: av::codec::Id, threads: usize) {
    // FFV1 decodes one picture after another, but the slices of each side by side.
    let (kind, spare) = match codec {
        av::codec::Id::FFV1 => (av::threading::Type::Slice, 0),
        _ => (av::threading::Type::Frame, 1),
    };
    let mut threading = av::threading::Config::kind(kind);
    threading.count = match threads {
        _ if !reports_with_threads(codec) => 1,
        0 => std::thread::available_parallelism().map_or(1, |cores| match cores.get() {
            1 => 1,
            cores => cores + spare,
        }),
        threads => threads,
    };
    // SAFETY: the context is valid and not open yet; the decoder takes at least this delay.
    let delay = unsafe { &mut (*context.as_mut_ptr()).has_b_frames };
    if codec == av::codec::Id::H264 && *delay > 0 {
        threading.count = threading.count.min(usize::try_from(MAX_REORDERED - *delay).unwrap_or(0)).max(1);
        if threading.count > 1 {
            *delay += threading.count as i32;
        }
    }
    context.set_threading(threading);
}

pub(super) fn open_decoder(
    path: &Path,
    stream: &av::format::stream::Stream<'_>,
    threads: usize,
    low_delay: bool,
) -> Result<av::decoder::Video, SourceError> {
    let refused = |error: av::Error| SourceError::Decoder {
        path: path.to_path_buf(),
        codec: stream.parameters().id().name().to_owned(),
        reason: error.to_string(),
    };
    if !matches!(stream.parameters().field_order(), av::FieldOrder::Progressive | av::FieldOrder::Unknown) {
        tracing::warn!(
            "{}: the recording is interlaced: odd and even rows were taken at different times, and what moves is not \
             where it seems to be",
            path.display()
        );
    }
    let turned = |data: av::packet::side_data::SideData<'_>| {
        data.kind() == av::packet::side_data::Type::DisplayMatrix && data.data() != upright()
    };
    if stream.side_data().any(turned) {
        tracing::warn!(
            "{}: the recording asks players to turn or mirror its pictures; they are taken as the camera stored them, \
             and pixels of a player that turns them are others",
            path.display()
        );
    }
    let mut context = av::codec::Context::from_parameters(stream.parameters()).map_err(refused)?;
    set_threads(&mut context, stream.parameters().id(), threads);
    if low_delay {
        context.set_flags(av::codec::Flags::LOW_DELAY);
    }
    // Export with every picture how coarsely it was quantised.
    let options: av::Dictionary = [("export_side_data", "venc_params")].into_iter().collect();
    context.decoder().open_as_with(stream.parameters().id(), options).and_then(|opened| opened.video()).map_err(refused)
}

/// How many frames to expect, for a progress bar: from the index, else estimated from length and rate.
pub(super) fn count_hint(
    input: &av::format::context::Input,
    stream: &av::format::stream::Stream<'_>,
    span: Span,
) -> Option<u64> {
    let counted = u64::try_from(stream.frames()).ok().filter(|&n| n > 0);
    let length_s = (input.duration() > 0).then(|| input.duration() as f64 / f64::from(av::ffi::AV_TIME_BASE));
    let rate = stream.avg_frame_rate();
    let rate = (rate.0 > 0 && rate.1 > 0).then(|| f64::from(rate.0) / f64::from(rate.1));
    if span == Span::default() {
        return counted.or_else(|| Some((length_s? * rate?).round() as u64));
    }
    let from_s = span.from_ns.map_or(0.0, seconds);
    let to_s = span.to_ns.map_or(f64::INFINITY, seconds).min(length_s?);
    Some(((to_s - from_s).max(0.0) * rate?).round() as u64)
}
