//! Long recordings.

use ffmpeg_the_third as av;
use std::path::Path;

/// A recording many times, one behind the other, without decoding it.
pub(crate) fn looped(recording: &Path, times: i64, to: &Path) {
    let mut output = av::format::output(to).unwrap();
    let (mut added, mut decoded) = (0, i64::MIN);
    for k in 0..times {
        let mut input = av::format::input(recording).unwrap();
        let (index, from) = {
            let stream = input.streams().best(av::media::Type::Video).unwrap();
            if k == 0 {
                output.add_stream(av::encoder::find(av::codec::Id::None)).unwrap().set_parameters(stream.parameters());
                output.write_header().unwrap();
            }
            (stream.index(), stream.time_base())
        };
        let stored = output.stream(0).unwrap().time_base();
        let mut last = 0;
        let mut packet = av::Packet::empty();
        while packet.read(&mut input).is_ok() {
            if packet.stream() != index {
                continue;
            }
            packet.rescale_ts(from, stored);
            last = last.max(packet.pts().unwrap());
            packet.set_pts(packet.pts().map(|pts| pts + added));
            // Where two meet, the first of the next is decoded before the last of this is shown.
            decoded = packet.dts().map_or(decoded, |dts| dts + added).max(decoded.saturating_add(1));
            packet.set_dts(Some(decoded));
            packet.set_position(-1);
            packet.set_stream(0);
            packet.write_interleaved(&mut output).unwrap();
        }
        // Matroska counts milliseconds; 17 more is a frame.
        added += last + 17;
    }
    output.write_trailer().unwrap();
}
