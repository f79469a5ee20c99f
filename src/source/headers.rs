//! What the headers of packets state and decoders do not tell: the quantiser of H.265 and AV1, and pictures that are
//! missing in H.264.
//!
//! libav parses these headers for itself, but gives out only what its filter `trace_headers` logs: every element, by
//! name. The coder may deviate from a header's quantiser in parts of the picture. How far is coded with these parts,
//! and not known here.

use super::frame_numbers::FrameNumbers;
use super::messages::logged;
use super::quantisation::{h26x_level, vp9_level};
use ffmpeg_the_third as av;
use ffmpeg_the_third::packet::Ref as _;
use std::collections::BTreeMap;
use std::ptr::{self, NonNull};

/// Reads the headers of a stream's packets.
pub(super) struct Headers {
    tracer: Tracer,
    coder: Coder,
}

/// What the headers have stated so far.
enum Coder {
    H264(FrameNumbers),
    H265(H265),
    Av1(Av1),
}

/// What the headers of a packet state.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub(super) struct Header {
    /// The level (see [`super::Quantisation`]) of the picture that it gives: that of the coarsest slice.
    pub level: Option<u8>,
    /// A picture is missing before it that others are predicted from.
    pub skips_numbers: bool,
}

impl Headers {
    /// `None` when its coder is another one, or this libav cannot trace it.
    pub(super) fn of(stream: &av::format::stream::Stream<'_>) -> Option<Self> {
        let mut coder = match stream.parameters().id() {
            av::codec::Id::H264 => Coder::H264(FrameNumbers::default()),
            av::codec::Id::HEVC => Coder::H265(H265::default()),
            av::codec::Id::AV1 => Coder::Av1(Av1::default()),
            _ => return None,
        };
        // Parameter sets may be stored with the stream.
        let mut tracer = None;
        coder.header(&logged(|| tracer = Tracer::new(stream)));
        Some(Self { tracer: tracer?, coder })
    }

    /// What those of a packet state. Packets are given in the order of the stream.
    pub(super) fn of_packet(&mut self, packet: &av::Packet) -> Header {
        let Self { tracer, coder } = self;
        coder.header(&logged(|| tracer.trace(packet)))
    }

    /// The next packet is read from elsewhere in the stream.
    pub(super) fn jump(&mut self) {
        if let Coder::H264(numbers) = &mut self.coder {
            numbers.jump();
        }
    }
}

/// Whether a stream may skip numbers of pictures without a loss (ITU-T H.264, `gaps_in_frame_num_value_allowed_flag`).
pub(super) fn skips_numbers(stream: &av::format::stream::Stream<'_>) -> bool {
    let states = |line: &String| element(line).is_some_and(|(name, value)| name == SKIPS_NUMBERS && value != 0);
    stream.parameters().id() == av::codec::Id::H264 && logged(|| drop(Tracer::new(stream))).iter().any(states)
}

/// libav's name of that element.
const SKIPS_NUMBERS: &str = "gaps_in_frame_num_allowed_flag";

impl Coder {
    /// Takes the elements in these lines, of one packet.
    fn header(&mut self, lines: &[String]) -> Header {
        let mut header = Header::default();
        let mut numbered = lines.is_empty();
        for (name, value) in lines.iter().filter_map(|line| element(line)) {
            let level = match self {
                Self::H264(numbers) => {
                    numbered |= name == "frame_num";
                    header.skips_numbers |= numbers.is_skipped(name, value);
                    None
                }
                Self::H265(state) => state.level(name, value),
                Self::Av1(state) => state.level(name, value),
            };
            header.level = header.level.max(level);
        }
        // A picture whose number could not be read may have been a reference.
        if let (Self::H264(numbers), false) = (self, numbered) {
            numbers.jump();
        }
        header
    }
}

/// Name and value of an element, in a line as "12    slice_qp_delta    00111 = -3".
fn element(line: &str) -> Option<(&str, i64)> {
    let (left, value) = line.rsplit_once('=')?;
    Some((left.split_whitespace().nth(1)?, value.trim().parse().ok()?))
}

/// ITU-T H.265, 7.3.2.3 and 7.3.6.
#[derive(Default)]
struct H265 {
    /// Of each picture parameter set: the quantiser of its slices, from 26.
    initial: BTreeMap<i64, i64>,
    /// The set that is defined, or that a slice refers to.
    set: i64,
}

impl H265 {
    fn level(&mut self, name: &str, value: i64) -> Option<u8> {
        match name {
            "pps_pic_parameter_set_id" | "slice_pic_parameter_set_id" => self.set = value,
            "init_qp_minus26" => _ = self.initial.insert(self.set, value),
            "slice_qp_delta" => return Some(h26x_level(26 + self.initial.get(&self.set)? + value)),
            _ => {}
        }
        None
    }
}

/// AV1 Bitstream & Decoding Process Specification, 5.9.2.
#[derive(Default)]
struct Av1 {
    /// Levels of the frames that are kept, one of which may be shown later.
    kept: [Option<u8>; 8],
    /// Which of them the current frame replaces, a bit each, and whether it is shown.
    replaces: i64,
    shown: bool,
}

impl Av1 {
    fn level(&mut self, name: &str, value: i64) -> Option<u8> {
        match name {
            // A header begins. A key frame that is shown replaces all without saying so.
            "show_existing_frame" => (self.replaces, self.shown) = (0xff, false),
            "frame_to_show_map_idx" => return *self.kept.get(usize::try_from(value).ok()?)?,
            "show_frame" => self.shown = value != 0,
            "refresh_frame_flags" => self.replaces = value,
            "base_q_idx" => {
                // Its table of steps is VP9's.
                let level = Some(vp9_level(value));
                for (i, kept) in self.kept.iter_mut().enumerate() {
                    if self.replaces >> i & 1 != 0 {
                        *kept = level;
                    }
                }
                return level.filter(|_| self.shown);
            }
            _ => {}
        }
        None
    }
}

/// libav's filter that logs the headers of packets.
struct Tracer(NonNull<av::ffi::AVBSFContext>);

#[allow(unsafe_code, reason = "a filter keeps no thread-local state; it is used by one thread at a time here")]
// SAFETY: only the tracer owns the filter, and it is reached only through `&mut`.
unsafe impl Send for Tracer {}

#[allow(unsafe_code, reason = "the binding does not offer filters of packets")]
impl Tracer {
    /// Logs what is stored with the stream.
    fn new(stream: &av::format::stream::Stream<'_>) -> Option<Self> {
        let parameters = stream.parameters();
        let mut filter = ptr::null_mut();
        // SAFETY: the name is a C string; a filter that is not known is null and not used. Allocation sets `filter` to
        // a valid one or returns an error; the stream owns its parameters, which are copied.
        unsafe {
            let kind = av::ffi::av_bsf_get_by_name(c"trace_headers".as_ptr());
            if kind.is_null() || av::ffi::av_bsf_alloc(kind, &raw mut filter) < 0 {
                return None;
            }
            let tracer = Self(NonNull::new(filter)?);
            let copied = av::ffi::avcodec_parameters_copy((*filter).par_in, parameters.as_ptr());
            (copied >= 0 && av::ffi::av_bsf_init(filter) >= 0).then_some(tracer)
        }
    }

    /// Logs the headers of a packet.
    fn trace(&mut self, packet: &av::Packet) {
        // To the filter an empty packet is the end.
        if packet.size() == 0 {
            return;
        }
        let filter = self.0.as_ptr();
        // SAFETY: the filter is valid as long as `self`. The packet is a new reference to the same data, which the
        // filter only reads; it takes the reference and gives it back, and what is left is freed.
        unsafe {
            let mut passed = av::ffi::av_packet_clone(packet.as_ptr());
            if !passed.is_null() && av::ffi::av_bsf_send_packet(filter, passed) >= 0 {
                while av::ffi::av_bsf_receive_packet(filter, passed) >= 0 {
                    av::ffi::av_packet_unref(passed);
                }
            }
            av::ffi::av_packet_free(&raw mut passed);
        }
    }
}

#[allow(unsafe_code, reason = "frees what libav allocated")]
impl Drop for Tracer {
    fn drop(&mut self) {
        let mut filter = self.0.as_ptr();
        // SAFETY: it was allocated by libav, and nothing else refers to it.
        unsafe { av::ffi::av_bsf_free(&raw mut filter) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn level(coder: &mut Coder, elements: &[(&str, i64)]) -> Option<u8> {
        let line = |(name, value): &(&str, i64)| format!("12          {name}          00111 = {value}\n");
        coder.header(&elements.iter().map(line).collect::<Vec<_>>()).level
    }

    #[test]
    fn a_line_is_an_element_or_none() {
        assert_eq!(element("41          slice_qp_delta            00111 = -3\n"), Some(("slice_qp_delta", -3)));
        assert_eq!(element("Slice Segment Header\n"), None);
        assert_eq!(element("= 3"), None);
        assert_eq!(element("1 a = b"), None);
    }

    #[test]
    fn the_coarsest_slice_counts_from_the_start_of_its_parameter_set() {
        let mut coder = Coder::H265(H265::default());
        let sets = [
            ("pps_pic_parameter_set_id", 0),
            ("init_qp_minus26", 0),
            ("pps_pic_parameter_set_id", 3),
            ("init_qp_minus26", -6),
        ];
        assert_eq!(level(&mut coder, &sets), None);
        let first = ("slice_pic_parameter_set_id", 0);
        assert_eq!(level(&mut coder, &[first, ("slice_qp_delta", 2)]), Some(28));
        let third = ("slice_pic_parameter_set_id", 3);
        assert_eq!(level(&mut coder, &[third, ("slice_qp_delta", 2), third, ("slice_qp_delta", 4)]), Some(24));
        assert_eq!(level(&mut coder, &[("slice_pic_parameter_set_id", 99), ("slice_qp_delta", 4)]), None);
    }

    #[test]
    fn a_frame_that_was_kept_is_shown_with_its_own_level() {
        let mut coder = Coder::Av1(Av1::default());
        let header = ("show_existing_frame", 0);
        let key = level(&mut coder, &[header, ("show_frame", 1), ("base_q_idx", 20)]);
        assert_eq!(key, Some(vp9_level(20)));
        // A frame that is kept for later, and one that is shown, in one packet.
        let hidden = [header, ("show_frame", 0), ("refresh_frame_flags", 4), ("base_q_idx", 60)];
        let shown = [header, ("show_frame", 1), ("refresh_frame_flags", 0), ("base_q_idx", 140)];
        assert_eq!(level(&mut coder, &[hidden, shown].concat()), Some(vp9_level(140)));
        let mut kept = |i: i64| level(&mut coder, &[("show_existing_frame", 1), ("frame_to_show_map_idx", i)]);
        assert_eq!([kept(2), kept(3), kept(8), kept(-1)], [Some(vp9_level(60)), key, None, None]);
    }
}
