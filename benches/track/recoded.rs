//! The same recording by another coder.

use ffmpeg_the_third as av;
use std::error::Error;
use std::path::Path;

/// Decodes a recording and encodes it again, in the same colours.
pub(crate) fn recoded(recording: &Path, coder: &str, to: &Path) -> Result<(), Box<dyn Error + Send + Sync>> {
    let mut input = av::format::input(recording)?;
    let (index, time_base, parameters) = {
        let stream = input.streams().best(av::media::Type::Video).ok_or("no video")?;
        (stream.index(), stream.time_base(), av::codec::Context::from_parameters(stream.parameters())?)
    };
    let mut decoder = parameters.decoder().video()?;
    let codec = av::encoder::find_by_name(coder).ok_or("no such coder")?;
    let mut encoder = av::codec::Context::new_with_codec(codec).encoder().video()?;
    encoder.set_width(decoder.width());
    encoder.set_height(decoder.height());
    encoder.set_format(decoder.format());
    encoder.set_time_base(time_base);
    encoder.set_color_range(decoder.color_range());
    encoder.set_colorspace(decoder.color_space());
    // Best quality; slices, as recorders write them, and limited range in a JPEG.
    let options = match coder {
        "mjpeg" => [("qmin", "2"), ("qmax", "2"), ("strict", "-1")].into_iter().collect::<av::Dictionary>(),
        _ => [("level", "3"), ("slices", "4")].into_iter().collect(),
    };
    let mut encoder = encoder.open_as_with(codec, options)?;
    let mut output = av::format::output(to)?;
    let mut stream = output.add_stream(codec)?;
    stream.set_time_base(time_base);
    stream.copy_parameters_from_context(&encoder);
    output.write_header()?;
    let stored = output.stream(0).ok_or("no stream")?.time_base();
    let mut write = |encoder: &mut av::encoder::Video| -> Result<(), av::Error> {
        let mut packet = av::Packet::empty();
        while encoder.receive_packet(&mut packet).is_ok() {
            packet.rescale_ts(time_base, stored);
            packet.set_stream(0);
            packet.write_interleaved(&mut output)?;
        }
        Ok(())
    };
    let mut picture = av::frame::Video::empty();
    let mut pass_on = |decoder: &mut av::decoder::Video| -> Result<(), av::Error> {
        while decoder.receive_frame(&mut picture).is_ok() {
            let stamp = picture.timestamp();
            picture.set_pts(stamp);
            picture.set_kind(av::picture::Type::None);
            encoder.send_frame(&picture)?;
            write(&mut encoder)?;
        }
        Ok(())
    };
    for packet in input.packets() {
        let (stream, packet) = packet?;
        if stream.index() == index {
            decoder.send_packet(&packet)?;
            pass_on(&mut decoder)?;
        }
    }
    decoder.send_eof()?;
    pass_on(&mut decoder)?;
    encoder.send_eof()?;
    write(&mut encoder)?;
    output.write_trailer()?;
    Ok(())
}
