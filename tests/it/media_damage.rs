//! Damaged recordings and pictures, and those of other programs: untrustworthy pictures are not measured, and every
//! frame with a known time has its row.

use crate::support::command::*;
use crate::support::encode::{Recording, write};
use catoptra::sink::{PictureCodec, PictureVideo, Sink};
use catoptra::source::{FrameSource, ImageFolder, ImageTiming, Span, VideoFile, VideoOptions};
use catoptra::tally::Tally;
use ffmpeg_the_third as av;
use std::path::Path;

/// Stamp, whether it is damaged, and the samples of every sound frame.
fn read(path: &Path, decoder_threads: usize) -> Vec<(i64, bool, Vec<u8>)> {
    read_with(path, VideoOptions { decoder_threads, ..VideoOptions::default() })
}

fn read_with(path: &Path, options: VideoOptions) -> Vec<(i64, bool, Vec<u8>)> {
    let mut source = match VideoFile::open(path, VideoOptions { keep_damaged: true, ..options }) {
        Ok(source) => source,
        Err(_) => return Vec::new(),
    };
    let mut frames = Vec::new();
    while let Ok(Some(frame)) = source.next_frame() {
        let plane = frame.picture.plane(0).unwrap();
        let sound_rows = if frame.picture.is_damaged() { 0 } else { plane.height };
        let samples = (0..sound_rows).flat_map(|y| plane.row(y).unwrap().to_vec()).collect();
        frames.push((frame.stamp.ns, frame.picture.is_damaged(), samples));
    }
    frames
}

/// Of frames that are said to be sound, those whose samples are not those of the sound recording.
fn lies(found: &[(i64, bool, Vec<u8>)], sound: &[(i64, bool, Vec<u8>)]) -> usize {
    lies_of_more_than(0, found, sound)
}

/// Of them, those of which more than so many samples are off by more than 8 levels, or any when it is none.
fn lies_of_more_than(samples: usize, found: &[(i64, bool, Vec<u8>)], sound: &[(i64, bool, Vec<u8>)]) -> usize {
    let least = if samples == 0 { 0 } else { 8 };
    let off = |a: &[u8], b: &[u8]| a.iter().zip(b).filter(|(a, b)| a.abs_diff(**b) > least).count();
    let is_other = |frame: &&(i64, bool, Vec<u8>)| {
        let other = sound.iter().find(|other| other.0 == frame.0);
        !frame.1 && other.is_none_or(|other| off(&other.2, &frame.2) > samples)
    };
    found.iter().filter(is_other).count()
}

#[test]
fn a_changed_bit_in_our_own_lossless_video_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pictures.mkv");
    let mut recorder = PictureVideo::create(&path, PictureCodec::Ffv1).unwrap();
    let mut tracker = catoptra::track::Tracker::new(&rig(), Default::default()).unwrap();
    let mut source = VideoFile::open(sample("rest.mkv"), VideoOptions::default()).unwrap();
    for _ in 0..3 {
        let frame = source.next_frame().unwrap().unwrap();
        recorder.write(&tracker.step(&frame).unwrap(), Some(&frame.picture)).unwrap();
    }
    recorder.finish(&Tally::default()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let sound = read(&path, 1);
    assert!(sound.len() == 3 && sound.iter().all(|frame| !frame.1));
    let mut random = fastrand::Rng::with_seed(1);
    let mut noticed = 0;
    for k in 0..40 {
        // Behind the head, in the pictures.
        let at = random.usize(2000..bytes.len() - 100);
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (k % 8);
        std::fs::write(&path, &damaged).unwrap();
        let found = read(&path, 1);
        assert_eq!(lies(&found, &sound), 0, "bit {} of byte {at}", k % 8);
        noticed += usize::from(found.iter().any(|frame| frame.1) || found.len() < sound.len());
    }
    assert!(noticed >= 38, "{noticed} of 40");
}

#[test]
fn the_number_of_threads_does_not_change_what_a_damaged_video_gives() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.mkv");
    let pts: Vec<i64> = (0..60).map(|k| 17 * k).collect();
    for b_frames in [0, 2] {
        write(&path, &Recording { pts: &pts, size_px: [160, 120], b_frames, ..Recording::default() });
        let bytes = std::fs::read(&path).unwrap();
        let sound = read(&path, 1);
        assert_eq!(sound.len(), 60);
        let mut random = fastrand::Rng::with_seed(3);
        let mut with_damage = 0;
        for k in 0..24 {
            let mut damaged = bytes.clone();
            for _ in 0..=k % 3 {
                let at = random.usize(1500..bytes.len() - 600);
                damaged[at] ^= 1 << (k % 8);
            }
            std::fs::write(&path, &damaged).unwrap();
            let one = read(&path, 1);
            for threads in [2, 4] {
                assert_eq!(read(&path, threads), one, "{threads} threads, mutation {k}");
            }
            with_damage += usize::from(one.iter().any(|frame| frame.1));
            // What damages the container may cost whole clusters.
            assert!(one.len() + 20 >= sound.len(), "mutation {k}: {} frames", one.len());
        }
        assert!(with_damage > 12, "{with_damage} of 24");
    }
}

/// The recording without some packets, counted in decoding order.
fn without(packets: std::ops::Range<usize>, recording: &Path, to: &Path) {
    let mut input = av::format::input(recording).unwrap();
    let mut output = av::format::output(to).unwrap();
    let from = {
        let stream = input.streams().best(av::media::Type::Video).unwrap();
        output.add_stream(av::encoder::find(av::codec::Id::None)).unwrap().set_parameters(stream.parameters());
        stream.time_base()
    };
    output.write_header().unwrap();
    let stored = output.stream(0).unwrap().time_base();
    let (mut packet, mut decoded) = (av::Packet::empty(), i64::MIN);
    for k in 0.. {
        if packet.read(&mut input).is_err() {
            break;
        }
        packet.rescale_ts(from, stored);
        decoded = packet.dts().unwrap_or(decoded).max(decoded.saturating_add(1));
        packet.set_dts(Some(decoded));
        packet.set_position(-1);
        packet.set_stream(0);
        if !packets.contains(&k) {
            packet.write_interleaved(&mut output).unwrap();
        }
    }
    output.write_trailer().unwrap();
}

/// As a recorder loses them whose disk is too slow, and as streams begin that are joined later.
#[test]
fn pictures_predicted_from_packets_that_were_lost_are_not_trusted_and_each_has_its_row() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, cut) = (folder.path().join("whole.mkv"), folder.path().join("cut.mkv"));
    let pts: Vec<i64> = (0..60).map(|k| 17 * k).collect();
    for (encoder, b_frames) in [("libx264", 0), ("libx264", 2), ("libx265", 0)] {
        write(&whole, &Recording { pts: &pts, size_px: [160, 120], encoder, b_frames, ..Recording::default() });
        let sound = read(&whole, 1);
        assert!(sound.len() == 60 && sound.iter().all(|frame| !frame.1), "{encoder}");
        let mut damaged = 0;
        // Every packet of a group alone: with B pictures after it, a lost one has the number that the next one has.
        for lost in [0..1, 0..3, 15..17, 27..30].into_iter().chain((24..36).map(|lost| lost..lost + 1)) {
            without(lost.clone(), &whole, &cut);
            for threads in [1, 2] {
                let found = read(&cut, threads);
                let what = format!("{encoder}, {b_frames} B pictures, {lost:?} lost, {threads} threads");
                assert_eq!(lies(&found, &sound), 0, "{what}");
                assert_eq!(found.len(), 60 - lost.len(), "{what}");
                damaged += found.iter().filter(|frame| frame.1).count();
            }
        }
        // Most of a group each time, and no more.
        assert!((80..=2 * 16 * 12).contains(&damaged), "{encoder}, {b_frames} B pictures: {damaged}");
    }
}

#[test]
fn most_damage_in_motion_jpeg_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera.avi");
    let pts: Vec<i64> = (0..20).collect();
    let pixel = av::format::Pixel::YUVJ420P;
    let recording = Recording {
        pts: &pts,
        size_px: [160, 120],
        time_base: (1, 60),
        b_frames: 0,
        encoder: "mjpeg",
        pixel,
        ..Recording::default()
    };
    write(&path, &recording);
    let bytes = std::fs::read(&path).unwrap();
    let sound = read(&path, 2);
    assert!(sound.len() == 20 && sound.iter().all(|frame| !frame.1));
    let mut random = fastrand::Rng::with_seed(5);
    let (mut changed, mut unnoticed, mut large) = (0, 0, 0);
    for k in 0..60 {
        let mut damaged = bytes.clone();
        let at = random.usize(6000..bytes.len() - 600);
        damaged[at] ^= 1 << (k % 8);
        std::fs::write(&path, &damaged).unwrap();
        let found = read(&path, 2);
        let wrong = lies(&found, &sound);
        unnoticed += usize::from(wrong > 0);
        large += usize::from(lies_of_more_than(4 * 64, &found, &sound) > 0);
        changed += usize::from(wrong > 0 || found.iter().any(|frame| frame.1));
    }
    println!("of {changed} damaged recordings {unnoticed} are not noticed, {large} with more than four blocks off");
    // A bit of a coefficient's value leaves the codes in step: that cannot be told from a picture.
    assert!(changed > 30 && unnoticed * 4 < changed * 3, "{unnoticed} of {changed}");
    assert!(large * 6 < changed, "{large} of {changed} with more than four blocks off");
}

#[test]
fn a_picture_that_cannot_be_read_costs_its_frame_and_no_other() {
    let place = Place::new();
    let folder = place.path("pictures");
    pictures("rest.mkv", 4, &folder);
    let bytes = std::fs::read(folder.join("frame2.png")).unwrap();
    std::fs::write(folder.join("frame2.png"), &bytes[..bytes.len() / 2]).unwrap();
    let output = place.track(&folder, &[]);
    ended_with(&output, 0);
    assert!(stderr(&output).contains("frame2.png"), "{}", stderr(&output));
    let table = place.table();
    let status: Vec<&str> = table.rows.iter().map(|row| row["coil_status"].as_str()).collect();
    assert_eq!(status, ["ok", "ok", "damaged", "ok"]);
    assert!(table.rows.iter().all(|row| row["gap"] == "0"));
    // Tracked again from its log the frame is damaged still, not one that was not recorded.
    ended_with(&place.track(&folder, &["--record", "windows"]), 0);
    let first = std::fs::read(place.path("out/track.csv")).unwrap();
    let mut again = std::process::Command::new(env!("CARGO_BIN_EXE_catoptra"));
    again.current_dir(place.folder.path()).args(["track", "out/log.mcap", "-o", "again"]);
    ended_with(&again.output().unwrap(), 0);
    assert!(first == std::fs::read(place.path("again/track.csv")).unwrap());
}

#[test]
fn a_damaged_frame_of_a_video_has_its_row() {
    let place = Place::new();
    let path = place.path("damaged.mkv");
    let mut bytes = std::fs::read(sample("planar.mkv")).unwrap();
    let at = bytes.len() / 3;
    bytes[at..at + 40].iter_mut().for_each(|byte| *byte ^= 0x55);
    std::fs::write(&path, &bytes).unwrap();
    let tables = ["1", "2"].map(|threads| {
        ended_with(&place.track(&path, &["--to", "2.5", "--threads", threads]), 0);
        std::fs::read_to_string(place.path("out/track.csv")).unwrap()
    });
    assert_eq!(tables[0], tables[1], "threads change the answer");
    let table = place.table();
    let damaged = table.rows.iter().filter(|row| row["coil_status"] == "damaged").count();
    let lost: u64 = table.rows.iter().map(|row| row["gap"].parse::<u64>().unwrap()).sum();
    println!("{} rows, {damaged} damaged, {lost} lost", table.rows.len());
    assert!(damaged > 0 && table.rows.len() as u64 + lost >= 150 && lost <= 2, "{damaged} damaged, {lost} lost");
}

#[test]
fn an_avi_whose_pictures_are_reordered_gives_all_of_them_in_turn() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("reordered.avi");
    let pts: Vec<i64> = (0..50).collect();
    // libav states presentation times of MPEG-4's B pictures, and of no others.
    for encoder in ["libx264", "mpeg4"] {
        let recording = Recording { pts: &pts, time_base: (1, 50), encoder, b_frames: 2, ..Recording::default() };
        assert!(write(&path, &recording).reordered);
        let frames = read(&path, 1);
        let stamps: Vec<i64> = frames.iter().map(|frame| frame.0).collect();
        let first = stamps[0];
        assert_eq!(
            stamps.iter().map(|ns| ns - first).collect::<Vec<_>>(),
            (0..50).map(|k| 20_000_000 * k).collect::<Vec<_>>(),
            "{encoder}"
        );
    }
}

/// Where the coded pictures of an AVI or a raw H.264 stream are, without heads and parameters.
fn coded(bytes: &[u8]) -> Vec<std::ops::Range<usize>> {
    if bytes.starts_with(b"RIFF") {
        let [from, to] = [b"movi", b"idx1"].map(|name| bytes.windows(4).position(|four| four == name).unwrap());
        let chunks = (from..to).filter(|at| &bytes[*at..*at + 4] == b"00dc");
        let length = |at: usize| u32::from_le_bytes(bytes[at + 4..at + 8].try_into().unwrap()) as usize;
        return chunks.map(|at| at + 8..at + 8 + length(at)).collect();
    }
    let starts: Vec<usize> =
        (0..bytes.len() - 3).filter(|at| bytes[*at..*at + 3] == [0, 0, 1]).map(|at| at + 3).collect();
    let ends = starts.iter().skip(1).map(|at| at - 3).chain([bytes.len()]);
    starts.iter().zip(ends).map(|(from, to)| *from..to).filter(|unit| matches!(bytes[unit.start] & 31, 1 | 5)).collect()
}

/// The frames of a recording or of a raw stream at 50 Hz.
fn read_timeless(path: &Path, decoder_threads: usize) -> Vec<(i64, bool, Vec<u8>)> {
    let raw = path.extension().is_some_and(|ending| ending == "h264");
    let stated_rate = raw.then(|| "50".parse().unwrap());
    read_with(path, VideoOptions { decoder_threads, stated_rate, ..VideoOptions::default() })
}

/// Each picture in a stream without presentation times is known by its packet, and what follows a key frame has the
/// right time again.
#[test]
fn damage_in_streams_without_times_costs_its_own_pictures_with_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let pts: Vec<i64> = (0..72).collect();
    for (name, encoder, b_frames) in [
        ("raw.h264", "libx264", 0),
        ("reordered.h264", "libx264", 2),
        ("plain.avi", "libx264", 0),
        ("reordered.avi", "libx264", 2),
        ("mpeg4.avi", "mpeg4", 2),
    ] {
        let path = folder.path().join(name);
        let size_px = [160, 120];
        write(&path, &Recording { pts: &pts, size_px, time_base: (1, 50), encoder, b_frames, ..Recording::default() });
        let bytes = std::fs::read(&path).unwrap();
        let sound = read_timeless(&path, 1);
        let stamps = |frames: &[(i64, bool, Vec<u8>)]| frames.iter().map(|frame| frame.0).collect::<Vec<_>>();
        // A raw stream does not tell that it is complete: none of its last B pictures is known to be in its place.
        let certain = if name == "reordered.h264" { 70 } else { 72 };
        assert!(sound.len() == 72 && sound[..certain].iter().all(|frame| !frame.1), "{name}");
        let coded = coded(&bytes);
        assert_eq!(coded.len(), 72, "{name}");
        for at in 25..36 {
            for kind in 0..3 {
                let mut damaged = bytes.clone();
                let picture = &mut damaged[coded[at].clone()];
                let length = picture.len();
                match kind {
                    // Without the head of its slice a raw picture could not be told from the one before.
                    0 => picture[if bytes.starts_with(b"RIFF") { 1 } else { 6 }..].fill(0x55),
                    1 => picture[length / 2..].iter_mut().for_each(|byte| *byte ^= 0x5a),
                    _ => picture[length / 3] ^= 0x10,
                }
                std::fs::write(&path, &damaged).unwrap();
                let found = [1, 2, 4].map(|threads| read_timeless(&path, threads));
                let what = format!("{name}, packet {at}, kind {kind}");
                // A changed bit may leave the stream valid.
                assert!(kind > 0 || lies(&found[0], &sound) == 0, "{what}");
                assert_eq!(stamps(&found[0]), stamps(&sound), "{what}");
                for (frames, threads) in found[1..].iter().zip([2, 4]) {
                    let wrong: Vec<_> =
                        frames.iter().zip(&found[0]).filter(|(a, b)| a != b).map(|(a, _)| a.0).collect();
                    assert!(wrong.is_empty() && frames.len() == 72, "{what}, {threads} threads: {wrong:?}");
                }
            }
        }
    }
}

/// Pictures take the places of packets in turn: what would have been shown before the last ones has not come.
#[test]
fn a_stream_without_times_that_ends_between_two_packets_misplaces_no_picture() {
    let folder = tempfile::tempdir().unwrap();
    let pts: Vec<i64> = (0..40).collect();
    for name in ["whole.h264", "whole.avi"] {
        let (whole, cut) = (folder.path().join(name), folder.path().join(name.replace("whole", "cut")));
        write(&whole, &Recording { pts: &pts, size_px: [160, 120], time_base: (1, 50), ..Recording::default() });
        let bytes = std::fs::read(&whole).unwrap();
        let sound = read_timeless(&whole, 1);
        let mut left_out = 0;
        for picture in coded(&bytes).into_iter().skip(20) {
            std::fs::write(&cut, &bytes[..picture.end]).unwrap();
            let found = read_timeless(&cut, 1);
            let what = format!("{name} up to byte {}", picture.end);
            assert!(lies(&found, &sound) == 0 && found.len() >= 20, "{what}");
            let certain = found.len().saturating_sub(4);
            assert!(found[..certain].iter().all(|frame| !frame.1), "{what}");
            left_out += found.iter().filter(|frame| frame.1).count();
        }
        println!("{name}: {left_out} pictures left out");
    }
}

/// A decoder of several threads tells of a packet that it cannot decode when it has later ones.
#[test]
fn a_broken_packet_of_an_avi_costs_its_own_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.avi");
    let pts: Vec<i64> = (0..50).collect();
    write(&path, &Recording { pts: &pts, time_base: (1, 50), b_frames: 0, ..Recording::default() });
    let sound = read(&path, 1);
    assert_eq!(sound.len(), 50);
    let mut bytes = std::fs::read(&path).unwrap();
    let chunks: Vec<usize> = (0..bytes.len() - 8).filter(|at| &bytes[*at..*at + 4] == b"00dc").collect();
    let at = chunks[20];
    let length = u32::from_le_bytes(bytes[at + 4..at + 8].try_into().unwrap()) as usize;
    bytes[at + 8..at + 8 + length].fill(0x55);
    std::fs::write(&path, &bytes).unwrap();
    let found = [1, 2, 4].map(|threads| read(&path, threads));
    let stamps = |frames: &[(i64, bool, Vec<u8>)]| frames.iter().map(|frame| frame.0).collect::<Vec<_>>();
    for frames in &found {
        assert_eq!(stamps(frames), stamps(&sound));
        assert!(frames.iter().any(|frame| frame.1) && frames == &found[0]);
    }
}

/// The number of frames, the last one's time in seconds, and why the end is early, if it is said to be.
fn read_to_the_end(path: &Path) -> (usize, f64, Option<String>) {
    let mut source = VideoFile::open(path, VideoOptions { keep_damaged: true, ..VideoOptions::default() }).unwrap();
    let (mut frames, mut last_s) = (0, f64::NAN);
    loop {
        match source.next_frame() {
            Ok(Some(frame)) => (frames, last_s) = (frames + 1, frame.stamp.seconds()),
            Ok(None) => return (frames, last_s, None),
            Err(error) => {
                assert!(error.is_early_end(), "{error}");
                return (frames, last_s, Some(error.to_string()));
            }
        }
    }
}

/// A lost sector may hide all that follows from libav, which reports a normal end.
#[test]
fn a_lost_sector_that_ends_a_recording_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("zeroed.mkv");
    let bytes = std::fs::read(sample("planar.mkv")).unwrap();
    let (frames, end_s, early) = read_to_the_end(&sample("planar.mkv"));
    assert!(frames == 300 && early.is_none());
    let mut told = 0;
    for k in 1..12 {
        let mut damaged = bytes.clone();
        let at = k * bytes.len() / 12 / 4096 * 4096;
        damaged[at..at + 4096].fill(0);
        std::fs::write(&path, &damaged).unwrap();
        let (frames, last_s, early) = read_to_the_end(&path);
        // Where libav finds more, frames are missing between.
        assert_eq!(early.is_some(), last_s < end_s - 0.1, "sector at {at}: {frames} frames to {last_s} s, {early:?}");
        assert!(early.as_ref().is_none_or(|why| why.contains("its container is damaged there")), "{early:?}");
        told += usize::from(early.is_some());
    }
    assert!(told >= 1, "none of them ends the recording");
}

/// The frames of an AVI are counted: after a hole all are too early.
#[test]
fn frames_that_are_missing_in_the_middle_of_an_avi_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hole.avi");
    let pts: Vec<i64> = (0..50).collect();
    write(&path, &Recording { pts: &pts, time_base: (1, 50), b_frames: 0, ..Recording::default() });
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!((read_to_the_end(&path).0, read_to_the_end(&path).2), (50, None));
    let chunks: Vec<usize> = (0..bytes.len() - 8).filter(|at| &bytes[*at..*at + 4] == b"00dc").collect();
    let hole = [&bytes[..chunks[20]], &bytes[chunks[23]..]].concat();
    let mut zeroed = bytes.clone();
    zeroed[chunks[20]..chunks[20] + 8].fill(0);
    for (damaged, missing) in [(hole, 3), (zeroed, 1)] {
        std::fs::write(&path, &damaged).unwrap();
        let (.., early) = read_to_the_end(&path);
        let words = format!("of the 50 frames that its header declares {missing} were not found");
        assert!(early.as_ref().is_some_and(|why| why.contains(&words)), "{early:?}");
    }
}

/// Programs that write 25 frames per second into an AVI of 50 leave every second place empty.
#[test]
fn empty_places_of_an_avi_are_no_missing_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("empty.avi");
    let pts: Vec<i64> = (0..50).map(|k| 2 * k).collect();
    write(&path, &Recording { pts: &pts, time_base: (1, 50), b_frames: 0, ..Recording::default() });
    let mut bytes = std::fs::read(&path).unwrap();
    // The last place is empty, too: `dwTotalFrames` in `avih`, `dwLength` in `strh`.
    let after = |name: &[u8]| bytes.windows(4).position(|four| four == name).unwrap() + 8;
    let places = [after(b"avih") + 16, after(b"strh") + 32];
    for (frames, missing) in [
        (99_u32, None),
        (100, None),
        (106, Some("of the 53 frames (in 106 places, one in 2 with a frame) that its header declares 3")),
    ] {
        for at in places {
            bytes[at..at + 4].copy_from_slice(&frames.to_le_bytes());
        }
        std::fs::write(&path, &bytes).unwrap();
        let (found, _, early) = read_to_the_end(&path);
        assert_eq!(found, 50);
        assert!(early.is_some() == missing.is_some(), "{frames}: {early:?}");
        assert!(missing.is_none_or(|words| early.is_some_and(|why| why.contains(words))), "{frames}");
    }
}

/// An edit list says which part of an MP4 is shown.
#[test]
fn what_an_edit_list_leaves_out_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trimmed.mp4");
    let pts: Vec<i64> = (0..120).map(|k| 256 * k).collect();
    write(&path, &Recording { pts: &pts, time_base: (1, 15_360), b_frames: 0, ..Recording::default() });
    assert_eq!(read(&path, 1).len(), 120);
    let mut bytes = std::fs::read(&path).unwrap();
    let list = bytes.windows(4).position(|four| four == b"elst").unwrap();
    // Version and flags, number of entries, then the length of the first in units of the film: milliseconds.
    let length = list + 12;
    assert_eq!(&bytes[length - 4..length], &[0, 0, 0, 1]);
    bytes[length..length + 4].copy_from_slice(&1000_u32.to_be_bytes());
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(read(&path, 1).len(), 60);
}

#[test]
fn a_file_of_many_pictures_is_not_taken_for_one_frame() {
    let folder = tempfile::tempdir().unwrap();
    let picture = image::GrayImage::from_fn(16, 12, |x, y| image::Luma([(x * y) as u8]));
    let mut one = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut one, image::ImageFormat::Tiff).unwrap();
    let one = one.into_inner();
    let path = folder.path().join("stack.tif");
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        let timing = ImageTiming::StatedRate("60".parse().unwrap());
        ImageFolder::open(folder.path(), timing, Span::default()).unwrap().next_frame()
    };
    assert!(read(&one).unwrap().is_some());
    // The directory of the first picture says where that of the second is: once more the same, behind the file.
    let mut two = one.clone();
    let directory = u32::from_le_bytes(two[4..8].try_into().unwrap()) as usize;
    let entries = usize::from(u16::from_le_bytes(two[directory..directory + 2].try_into().unwrap()));
    let next = directory + 2 + 12 * entries;
    let copy = two[directory..next + 4].to_vec();
    let at = two.len() as u32;
    two[next..next + 4].copy_from_slice(&at.to_le_bytes());
    two.extend(copy);
    let error = read(&two).unwrap_err().to_string();
    assert!(error.contains("more than one picture"), "{error}");
}
