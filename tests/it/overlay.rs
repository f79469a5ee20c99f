//! The overlay video, read back with libav: times, frame counts, and the positions of what is drawn.

use crate::support::synthetic;
use catoptra::estimate::Miss;
use catoptra::rig::Rig;
use catoptra::sink::{OverlaySink, Sink, SinkError};
use catoptra::source::{Colour, Picture, PixelFormat};
use catoptra::tally::Tally;
use ffmpeg_the_third as av;
use nalgebra::Point2;
use std::path::Path;

const GROUND: u8 = 110;

fn grey_picture(size_px: [u32; 2]) -> Picture {
    let [w, h] = size_px;
    let plane = vec![GROUND; (w * h) as usize];
    Picture::from_planes(w, h, PixelFormat::Grey, Colour::SRGB, vec![plane]).unwrap()
}

/// The same rig with a small picture, for tests that do not look at places.
fn small(mut rig: Rig, size_px: [u32; 2]) -> Rig {
    rig.camera.size_px = size_px;
    rig
}

struct Decoded {
    /// Presentation times, microseconds.
    times_us: Vec<i64>,
    frames: Vec<av::frame::Video>,
    comment: Option<String>,
}

fn decode(path: &Path) -> Decoded {
    let mut input = av::format::input(path).unwrap();
    let comment = input.metadata().get("comment").map(str::to_owned);
    // libav does not name a track that holds nothing.
    let Some(stream) = input.streams().best(av::media::Type::Video) else {
        return Decoded { times_us: Vec::new(), frames: Vec::new(), comment };
    };
    let base = stream.time_base();
    let mut decoder = av::codec::Context::from_parameters(stream.parameters()).unwrap().decoder().video().unwrap();
    let (mut times_us, mut frames) = (Vec::new(), Vec::new());
    let mut take = |decoder: &mut av::decoder::Video| loop {
        let mut frame = av::frame::Video::empty();
        if decoder.receive_frame(&mut frame).is_err() {
            break;
        }
        let us = i128::from(frame.pts().unwrap()) * i128::from(base.numerator()) * 1_000_000;
        assert_eq!(us % i128::from(base.denominator()), 0, "the time base holds whole microseconds");
        times_us.push((us / i128::from(base.denominator())) as i64);
        frames.push(frame);
    };
    for (_, packet) in input.packets().map(Result::unwrap) {
        decoder.send_packet(&packet).unwrap();
        take(&mut decoder);
    }
    decoder.send_eof().unwrap();
    take(&mut decoder);
    Decoded { times_us, frames, comment }
}

/// Luma at a place (limited range).
fn luma(frame: &av::frame::Video, x: f64, y: f64) -> f64 {
    f64::from(frame.data(0)[y.round() as usize * frame.stride(0) + x.round() as usize])
}

/// Cb and Cr at a place.
fn chroma(frame: &av::frame::Video, x: f64, y: f64) -> [f64; 2] {
    let (x, y) = (x.round() as usize / 2, y.round() as usize / 2);
    [1, 2].map(|plane| f64::from(frame.data(plane)[y * frame.stride(plane) + x]))
}

/// Runs `stamps` through the sink; the frame number is the index.
fn write(path: &Path, rig: &Rig, stamps_ns: &[i64]) {
    let mut sink = OverlaySink::create(path, rig).unwrap();
    for (k, stamp) in stamps_ns.iter().enumerate() {
        let mut estimate = synthetic::swing(rig, k as u64, *stamp);
        let step_ns = if k > 0 { stamp - stamps_ns[k - 1] } else { 0 };
        estimate.gap = ((step_ns as f64 / 16_666_667.0).round() as u32).saturating_sub(1);
        sink.write(&estimate, Some(&grey_picture(rig.camera.size_px))).unwrap();
    }
    sink.finish(&Tally::default()).unwrap();
}

#[test]
fn every_frame_keeps_its_time_through_gaps_and_varying_intervals() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("over:lay.mp4"); // a colon must not be taken for a protocol
    let rig = small(synthetic::rig(), [320, 240]);
    // Starts late, sixtieths that are no whole microseconds, two gaps, an odd interval at the end.
    let mut stamps_ns: Vec<i64> =
        [0, 1, 2, 3, 7, 8, 9, 200, 201].map(|k: i64| 3_033_333_333 + k * 50_000_000 / 3).into();
    stamps_ns.push(7_000_000_499);
    write(&path, &rig, &stamps_ns);
    let decoded = decode(&path);
    let expected: Vec<i64> = stamps_ns.iter().map(|ns| (ns + 500) / 1000).collect();
    assert_eq!(decoded.times_us, expected);
    assert_eq!(decoded.comment, None);
}

#[test]
fn a_clock_that_started_long_ago_is_moved_and_the_move_is_written_down() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("live.mp4");
    let start = 1_700_000_000_123_456_789_i64;
    write(&path, &small(synthetic::rig(), [320, 240]), &[start, start + 16_666_667, start + 50_000_000]);
    let decoded = decode(&path);
    assert_eq!(decoded.times_us, [0, 16_667, 50_000]);
    assert!(decoded.comment.unwrap().contains("1700000000123456789 ns"));
}

#[test]
fn outlines_names_arrows_and_strip_are_drawn_and_the_bands_stay_visible() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("overlay.mp4");
    let rig = synthetic::rig();
    let stamps: Vec<i64> = (0..15).map(|k| k * 50_000_000 / 3).collect();
    write(&path, &rig, &stamps);
    let decoded = decode(&path);
    let frame = decoded.frames.last().unwrap();
    assert_eq!((frame.width(), frame.height()), (1280, 1228));
    let estimate = synthetic::swing(&rig, 14, stamps[14]);
    let ground = luma(frame, 20.0, 20.0);
    assert!((ground - (16.0 + 219.0 / 255.0 * f64::from(GROUND))).abs() < 2.0);

    for (i, marker) in estimate.markers.iter().enumerate() {
        for view in marker.views.iter().map(|v| v.as_ref().unwrap()) {
            let outline = &view.outline_px;
            // Lines are one pixel wide, chroma samples two: some place on the edge shows the colour.
            let colourful = (0..=10).map(|k| {
                let at = outline[0] + (outline[1] - outline[0]) * (f64::from(k) / 10.0);
                let [cb, cr] = chroma(frame, at.x, at.y);
                (cb - 128.0).hypot(cr - 128.0)
            });
            let most = colourful.fold(0.0, f64::max);
            assert!(most > 8.0, "marker {i}: no colour on the outline, {most} at most");
            // Open crosses: between the outline and the centre of the widest band nothing is painted over.
            if i == 1 {
                let change = (luma(frame, view.centre_px.x, view.centre_px.y) - ground).abs();
                assert!(change < 45.0, "the centre of the band is covered: {change}");
            }
        }
    }

    // The arrow: beyond the last marker, along the tangent, in both views.
    let tangent = estimate.tangent.as_ref().unwrap().direction;
    let coil = estimate.markers[1].position.as_ref().unwrap().point;
    for view in &rig.views {
        let on: Point2<f64> = view.optics.project(&(coil + tangent * (0.025 + 0.004 + 0.006))).unwrap();
        assert!(luma(frame, on.x, on.y) > 200.0, "no arrow in {}", view.name);
        let beyond = view.optics.project(&(coil + tangent * 0.07)).unwrap();
        assert!((luma(frame, beyond.x, beyond.y) - ground).abs() < 3.0, "the arrow in {} is too long", view.name);
    }

    // The strip is dark, and in its graph the curve's newest point is at the right, at the height of θ.
    assert!(luma(frame, 5.0, 1220.0) < 45.0);
    let bright = |x: f64| (1040..1190).filter(|y| luma(frame, x, f64::from(*y)) > 110.0).count();
    assert!((600..880).any(|x| bright(f64::from(x)) > 0), "no curve in the graph");
}

#[test]
fn what_is_missing_is_not_drawn_and_said() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("missing.mp4");
    let rig = synthetic::rig();
    let mut sink = OverlaySink::create(&path, &rig).unwrap();
    let estimate = synthetic::swing(&rig, 0, 0);
    let place = estimate.markers[1].views[1].as_ref().unwrap().clone();
    let arrow = estimate.tangent.as_ref().unwrap().direction * 0.035
        + estimate.markers[1].position.as_ref().unwrap().point.coords;
    let missing = synthetic::without_marker(estimate, 1, Miss::NotSeen { view: 1 });
    sink.write(&missing, Some(&grey_picture(rig.camera.size_px))).unwrap();
    sink.finish(&Tally::default()).unwrap();
    let decoded = decode(&path);
    let frame = &decoded.frames[0];
    let ground = luma(frame, 20.0, 20.0);
    let edge = nalgebra::center(&place.outline_px[0], &place.outline_px[1]);
    assert!((luma(frame, edge.x, edge.y) - ground).abs() < 3.0);
    let on = rig.views[0].optics.project(&arrow.into()).unwrap();
    assert!((luma(frame, on.x, on.y) - ground).abs() < 3.0, "an arrow without a tangent");
    // "θ missing" and the reason are written in orange: low Cb, high Cr.
    let orange = (0..130).flat_map(|x| (520..560).map(move |y| (x, y))).filter(|(x, y)| {
        let [cb, cr] = chroma(frame, f64::from(2 * x), f64::from(2 * y));
        cb < 110.0 && cr > 150.0
    });
    assert!(orange.count() > 50);
}

#[test]
fn a_run_that_ends_at_once_or_after_an_interrupt_leaves_a_valid_file() {
    let dir = tempfile::tempdir().unwrap();
    let rig = small(synthetic::rig(), [320, 240]);
    for frames in [0_usize, 1, 2, 40] {
        let path = dir.path().join(format!("{frames}.mp4"));
        let stamps: Vec<i64> = (0..frames as i64).map(|k| k * 50_000_000 / 3).collect();
        write(&path, &rig, &stamps);
        assert_eq!(decode(&path).frames.len(), frames);
    }
    let mut sink = OverlaySink::create(&dir.path().join("twice.mp4"), &rig).unwrap();
    sink.finish(&Tally::default()).unwrap();
    sink.finish(&Tally::default()).unwrap();
    assert!(sink.write(&synthetic::swing(&rig, 0, 0), Some(&grey_picture([320, 240]))).is_err());
}

#[test]
fn odd_and_tiny_pictures_and_nonsense_numbers_are_survived() {
    let dir = tempfile::tempdir().unwrap();
    for size in [[321, 241], [33, 17], [1, 1]] {
        let rig = small(synthetic::rig(), size);
        let path = dir.path().join(format!("{}.mp4", size[0]));
        let mut sink = OverlaySink::create(&path, &rig).unwrap();
        let mut estimate = synthetic::swing(&rig, 0, 0);
        let band = estimate.markers[0].views[0].as_mut().unwrap();
        band.centre_px.x = f64::NAN;
        band.outline_px[2].y = f64::INFINITY;
        estimate.deflection.as_mut().unwrap().theta_rad = f64::NAN;
        sink.write(&estimate, Some(&grey_picture(size))).unwrap();
        sink.finish(&Tally::default()).unwrap();
        let decoded = decode(&path);
        assert_eq!(decoded.frames.len(), 1);
        assert!([decoded.frames[0].width(), decoded.frames[0].height()].iter().all(|n| n.is_multiple_of(2)));
    }
}

#[test]
fn what_cannot_be_written_is_named() {
    let rig = synthetic::rig();
    let dir = tempfile::tempdir().unwrap();
    let nowhere = dir.path().join("missing").join("overlay.mp4");
    let error = OverlaySink::create(&nowhere, &rig).err().unwrap();
    assert!(matches!(&error, SinkError::Io { path, .. } if *path == nowhere), "{error}");

    let path = dir.path().join("overlay.mp4");
    let mut sink = OverlaySink::create(&path, &rig).unwrap();
    let error = sink.write(&synthetic::swing(&rig, 0, 0), Some(&grey_picture([640, 480]))).unwrap_err();
    assert!(error.to_string().contains("640x480") && error.to_string().contains("1280x1024"), "{error}");
}
