//! Damaged logs: every changed bit is detected or has no effect, and intact parts are recovered.

use crate::support::{command::*, fixture};
use catoptra::log::{Info, Repaired, repair};
use catoptra::series::Recording;
use catoptra::sink::{CurrentSample, McapSink, Sink};
use catoptra::tally::Tally;
use mcap::records::op::{CHUNK, MESSAGE};
use mcap::{Compression, WriteOptions, Writer};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

const FRAMES: u64 = 300;
/// Of the log whose heads are damaged bit by bit: some chunks.
const FEW_FRAMES: u64 = 130;

fn command(verb: &str, log: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).args(["log", verb]).arg(log).output().unwrap()
}

/// A live run with currents, 60 frames per second.
fn run(folder: &Path, frames: u64) -> PathBuf {
    let path = folder.join("log.mcap");
    let rig = fixture::rig();
    let mut tally = Tally::new(&rig);
    let mut log = McapSink::create(&path, &rig, "# the rig\n", "frame = \"base\"\n").unwrap();
    for seq in 0..frames {
        let estimate = fixture::eventful(seq, 5_000_000);
        log.write(&estimate, None).unwrap();
        if tally.add(&estimate) {
            log.write_totals(&tally.totals()).unwrap();
        }
        let host_ns = 1_700_000_000_000_000_000 + estimate.stamp.ns;
        let current_a = vec![0.1 + 1e-3 * seq as f64, -0.1];
        log.write_current(&CurrentSample { host_ns, arrival_ns: host_ns, seq: Some(seq), current_a }).unwrap();
    }
    log.finish(&tally).unwrap();
    path
}

/// The same in a folder of its own, with its bytes, and read back.
fn written(frames: u64) -> (TempDir, PathBuf, Vec<u8>, Recording) {
    let folder = tempfile::tempdir().unwrap();
    let path = run(folder.path(), frames);
    let (bytes, whole) = (std::fs::read(&path).unwrap(), Recording::read(&path).unwrap());
    (folder, path, bytes, whole)
}

/// The frames and currents of `part` are among those of `all`, as they were.
fn is_part_of(part: &Recording, all: &Recording) -> bool {
    part.frames.iter().all(|frame| all.frames.contains(frame)) && part.currents.iter().all(|c| all.currents.contains(c))
}

#[test]
fn every_changed_bit_is_noticed_and_none_changes_a_number() {
    let (_folder, path, bytes, whole) = written(FRAMES);
    assert!(
        whole.cut.is_none() && whole.frames.len() as u64 == FRAMES && Info::read(&path).unwrap().condition.is_whole()
    );
    let mut random = fastrand::Rng::with_seed(2);
    let (mut silent, mut changed) = (Vec::new(), Vec::new());
    for _ in 0..150 {
        let bit = random.usize(8 * 8..8 * bytes.len());
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        std::fs::write(&path, &damaged).unwrap();
        match (Info::read(&path), Recording::read(&path)) {
            (Ok(info), Ok(read)) => {
                if info.condition.is_whole() {
                    silent.push(bit);
                }
                if !is_part_of(&read, &whole) || (read.cut.is_none() && read.frames.len() as u64 != FRAMES) {
                    changed.push(bit);
                }
            }
            // Refused as a whole, with its reason.
            (Err(_), Err(_)) => {}
            (info, read) => panic!("bit {bit}: {info:?}, {:?}", read.map(|r| r.frames.len())),
        }
    }
    assert!(silent.is_empty() && changed.is_empty(), "silent {silent:?}, changed {changed:?}");
}

/// Code, place and length of the records outside chunks, with their heads.
fn top_level(bytes: &[u8]) -> Vec<(u8, usize, usize)> {
    let mut at = mcap::MAGIC.len();
    let mut all = Vec::new();
    while at + 9 < bytes.len() {
        let length = 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        all.push((bytes[at], at, length));
        at += length;
    }
    all
}

/// A head that is damaged makes another record of one, or a longer one that swallows what follows.
#[test]
fn a_changed_bit_in_a_head_costs_its_chunk_at_most_and_what_it_costs_is_told() {
    let (_folder, path, bytes, whole) = written(FEW_FRAMES);
    let records = top_level(&bytes);
    let last_chunk = records.iter().rfind(|(code, ..)| *code == CHUNK).unwrap();
    let mut kinds: Vec<_> = records.iter().filter(|record| record.1 > bytes.len() / 3).chain(&records).collect();
    kinds.dedup_by_key(|(_, at, _)| *at);
    let mut seen = std::collections::BTreeSet::new();
    kinds.retain(|(code, ..)| seen.insert(*code));
    assert!(kinds.len() > 8, "{kinds:?}");
    let mut cost = 0;
    for (code, at, _) in kinds.into_iter().chain([last_chunk]) {
        for bit in 8 * at..8 * (at + 9) {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            std::fs::write(&path, &damaged).unwrap();
            let context = format!("bit {} of the head of a record {code:#04x} at byte {at}", bit - 8 * at);
            let (info, read) = (Info::read(&path).unwrap(), Recording::read(&path).unwrap());
            assert!(!info.condition.is_whole() && is_part_of(&read, &whole), "{context}");
            let lost = whole.frames.len() - read.frames.len();
            assert!(lost <= if *code == CHUNK { 40 } else { 0 }, "{context}: {lost} frames lost");
            if lost > 0 {
                cost += 1;
                assert!(info.condition.damage.iter().any(|damage| damage.loses_messages), "{context}: {info:?}");
                assert!(matches!(repair(&path).unwrap(), Repaired::Mended { .. }), "{context}");
                assert!(Recording::read(&path).unwrap().cut.is_some(), "{context}");
                std::fs::remove_file(path.with_extension("mcap.bak")).unwrap();
            }
        }
    }
    println!("{cost} of the bits cost a chunk");
}

/// A log in a private record is none of ours.
#[test]
fn a_log_within_a_log_is_not_entered() {
    let (_folder, path, bytes, whole) = written(FRAMES);
    let records = top_level(&bytes);
    let (_, at, _) = records.iter().filter(|(code, ..)| *code == CHUNK).nth(3).unwrap();
    let mut private = vec![0x80];
    private.extend((bytes.len() as u64).to_le_bytes());
    private.extend(&bytes);
    let mut with = bytes.clone();
    with.splice(at..at, private);
    std::fs::write(&path, &with).unwrap();
    let read = Recording::read(&path).unwrap();
    assert_eq!(read.frames.len(), whole.frames.len());
    let condition = Info::read(&path).unwrap().condition;
    assert!(condition.damage.iter().all(|damage| !damage.loses_messages), "{condition:?}");
}

/// Messages outside chunks have no checksum of their own.
#[test]
fn of_messages_without_checksums_none_is_said_to_be_right() {
    let (folder, _, bytes, _) = written(FRAMES);
    let plain = folder.path().join("plain.mcap");
    let options = WriteOptions::new().use_chunks(false).compression(None);
    let mut writer = Writer::with_options(std::fs::File::create(&plain).unwrap(), options).unwrap();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        writer.write(&message.unwrap()).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    assert!(Info::read(&plain).unwrap().condition.is_whole());
    let mut damaged = std::fs::read(&plain).unwrap();
    let (_, at, length) = top_level(&damaged).into_iter().filter(|(code, ..)| *code == MESSAGE).nth(20).unwrap();
    damaged[at + length - 3] ^= 1;
    std::fs::write(&plain, damaged).unwrap();
    let condition = Info::read(&plain).unwrap().condition;
    assert!(condition.damage.iter().any(|damage| damage.loses_messages), "{condition:?}");
}

#[test]
fn what_lies_behind_a_hole_is_saved() {
    let (folder, path, bytes, whole) = written(FRAMES);
    let messages = Info::read(&path).unwrap().topics.iter().map(|topic| topic.messages).sum::<u64>();
    for (kept, part) in (1..).zip([0.02, 0.3, 0.55, 0.8]) {
        let hole = (bytes.len() as f64 * part) as usize;
        let mut damaged = bytes.clone();
        damaged[hole..hole + 4096].fill(0);
        std::fs::write(&path, &damaged).unwrap();
        let printed = stdout(&command("info", &path));
        assert!(printed.contains("damaged at byte") && printed.contains("log repair"), "{printed}");
        let Repaired::Mended { messages: saved, unknown, condition, kept_as } = repair(&path).unwrap() else {
            panic!("the damage at {part} is not noticed")
        };
        // A hole of 4 KiB lies in one chunk of half a second, or in two.
        assert!(saved * 10 > messages * 7 && unknown == 0, "{part}: {saved} of {messages}");
        assert!(!condition.damage.is_empty() && condition.cut.is_none(), "{condition:?}");
        let name = if kept == 1 { "log.mcap.bak".to_owned() } else { format!("log.mcap.bak{kept}") };
        assert_eq!(kept_as, folder.path().join(name));
        assert_eq!(std::fs::read(&kept_as).unwrap(), damaged, "the damaged log is kept");
        let mended = Recording::read(&path).unwrap();
        assert!(is_part_of(&mended, &whole), "{part}");
        // It does not seem whole, although it is in order.
        let lost = format!("at byte {}", condition.damage[0].at);
        assert!(mended.cut.as_ref().is_some_and(|cut| cut.contains("repaired") && cut.contains(&lost)), "{mended:?}");
        let printed = stdout(&command("info", &path));
        assert!(printed.contains(&lost) && !printed.contains("complete"), "{printed}");
        assert!(Info::read(&path).unwrap().condition.is_whole());
        assert_eq!(repair(&path).unwrap(), Repaired::WasWhole);
    }
}

#[test]
fn a_log_that_lacks_its_last_bytes_lacks_no_message() {
    let (_folder, path, bytes, whole) = written(FRAMES);
    for cut in [1, 5, 8] {
        std::fs::write(&path, &bytes[..bytes.len() - cut]).unwrap();
        assert!(matches!(repair(&path).unwrap(), Repaired::Mended { .. }));
        let mended = Recording::read(&path).unwrap();
        assert!(mended.cut.is_none() && mended.frames == whole.frames, "{cut}: {:?}", mended.cut);
        std::fs::remove_file(path.with_extension("mcap.bak")).unwrap();
    }
}

#[test]
fn a_log_whose_index_alone_was_damaged_lacks_nothing_once_repaired() {
    let (_folder, path, bytes, whole) = written(FRAMES);
    let mut damaged = bytes.clone();
    let at = damaged.len() - 40;
    damaged[at] ^= 1;
    std::fs::write(&path, &damaged).unwrap();
    assert!(Recording::read(&path).unwrap().cut.is_some());
    assert!(matches!(repair(&path).unwrap(), Repaired::Mended { .. }));
    let mended = Recording::read(&path).unwrap();
    assert!(mended.cut.is_none() && mended.frames == whole.frames, "{:?}", mended.cut);
    assert!(stdout(&command("info", &path)).contains("complete, with index"));
    // It is as robust as before, and no larger.
    let mended = std::fs::read(&path).unwrap();
    let chunks = |log: &[u8]| mcap::Summary::read(log).unwrap().unwrap().chunk_indexes.len();
    assert!(chunks(&mended).abs_diff(chunks(&bytes)) <= 1, "{} of {}", chunks(&mended), chunks(&bytes));
    assert!(mended.len() < bytes.len() * 11 / 10, "{} of {} bytes", mended.len(), bytes.len());
}

/// Names and schemas of all topics are in the first chunk, and once more at the end.
#[test]
fn a_damaged_first_chunk_costs_its_messages_and_no_others() {
    let (folder, path, bytes, whole) = written(FRAMES);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let chunks = summary.chunk_indexes.len();
    assert!(chunks > 3, "{chunks} chunks");
    let first = summary.chunk_indexes.iter().min_by_key(|chunk| chunk.chunk_start_offset).unwrap();
    let mut damaged = bytes.clone();
    damaged[(first.chunk_start_offset + first.chunk_length / 2) as usize] ^= 1;
    std::fs::write(&path, &damaged).unwrap();
    let info = Info::read(&path).unwrap();
    assert!(info.frames * 10 > FRAMES * 7, "{} frames", info.frames);
    assert_eq!(info.condition.damage.len(), 1, "{:?}", info.condition);
    let read = Recording::read(&path).unwrap();
    assert!(read.frames.len() as u64 == info.frames && is_part_of(&read, &whole) && !read.currents.is_empty());
    let table = folder.path().join("log.csv");
    let words = ["log", "convert", path.to_str().unwrap(), "--profile", "csv", "-o", table.to_str().unwrap()];
    ended_with(&Command::new(env!("CARGO_BIN_EXE_catoptra")).args(words).output().unwrap(), 0);
    assert_eq!(std::fs::read_to_string(&table).unwrap().lines().count() as u64, info.frames + 1);
}

/// Of a killed log the end with the second copy of its topics is missing: there is one more near its beginning.
#[test]
fn a_killed_log_with_a_damaged_first_chunk_keeps_all_others() {
    let (folder, path, bytes, whole) = written(FRAMES);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let mut places: Vec<_> = summary.chunk_indexes.iter().map(|c| (c.chunk_start_offset, c.chunk_length)).collect();
    places.sort_unstable();
    let ((first, length), (last, _)) = (places[0], places[places.len() - 1]);
    let (first, end) = (first as usize, (first + length) as usize);
    for hole in [first + length as usize / 2..first + length as usize / 2 + 1, first..end.min(first + 4096)] {
        let mut damaged = bytes[..last as usize].to_vec();
        damaged[hole].iter_mut().for_each(|byte| *byte = !*byte);
        std::fs::write(&path, &damaged).unwrap();
        let info = Info::read(&path).unwrap();
        assert!(info.frames * 10 > FRAMES * 7, "{} frames", info.frames);
        assert!(matches!(repair(&path).unwrap(), Repaired::Mended { unknown: 0, .. }));
        let read = Recording::read(&path).unwrap();
        assert!(read.frames.len() as u64 == info.frames && is_part_of(&read, &whole) && !read.currents.is_empty());
        std::fs::remove_file(folder.path().join("log.mcap.bak")).unwrap();
    }
}

#[test]
fn a_log_whose_first_bytes_are_damaged_is_read_and_repaired() {
    let (folder, path, bytes, whole) = written(FRAMES);
    let cut = &bytes[..bytes.len() * 2 / 3];
    for (log, zeros) in [(bytes.as_slice(), 1), (bytes.as_slice(), 200), (cut, 1)] {
        let mut damaged = log.to_vec();
        damaged[..zeros].fill(0);
        std::fs::write(&path, &damaged).unwrap();
        let info = Info::read(&path).unwrap();
        assert!(info.condition.summary().unwrap().contains("at byte 0 the first bytes are not those"), "{info:?}");
        ended_with(&command("repair", &path), 0);
        let read = Recording::read(&path).unwrap();
        assert!(read.frames.len() as u64 == info.frames && is_part_of(&read, &whole), "{zeros} zeros");
        assert!(info.frames == FRAMES || log.len() < bytes.len(), "{zeros} zeros: {}", info.frames);
        std::fs::remove_file(folder.path().join("log.mcap.bak")).unwrap();
    }
    for other in [std::fs::read(sample("rest.mkv")).unwrap(), vec![0; 4000], bytes[..6].to_vec()] {
        std::fs::write(&path, other).unwrap();
        ended_with(&command("repair", &path), 2);
    }
}

#[test]
fn a_log_behind_a_log_is_told_and_counts_as_lost() {
    let (_folder, path, bytes, _) = written(FRAMES);
    std::fs::write(&path, [bytes.as_slice(), &bytes].concat()).unwrap();
    let info = Info::read(&path).unwrap();
    let said = info.condition.summary().unwrap();
    let expected = format!("another log begins, and {} bytes are not read", bytes.len());
    assert!(info.frames == FRAMES && said.contains(&expected), "{said}");
    assert!(matches!(repair(&path).unwrap(), Repaired::Mended { .. }));
    let lacks = Info::read(&path).unwrap().condition.summary().unwrap();
    assert!(lacks.contains("it lacks what was lost") && lacks.contains("another log begins"), "{lacks}");
}

/// The same log in chunks that are compressed, as other programs write them.
fn compressed(from: &Path, to: &Path, compression: Compression) {
    let bytes = std::fs::read(from).unwrap();
    let options = WriteOptions::new().compression(Some(compression)).chunk_size(Some(100_000));
    let mut writer = Writer::with_options(std::fs::File::create(to).unwrap(), options).unwrap();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        writer.write(&message.unwrap()).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn a_compressed_log_is_read_and_repaired_as_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = run(folder.path(), FRAMES);
    let whole = Recording::read(&path).unwrap();
    for compression in [Compression::Zstd, Compression::Lz4] {
        let packed = folder.path().join("packed.mcap");
        compressed(&path, &packed, compression);
        let read = Recording::read(&packed).unwrap();
        assert!(read.frames == whole.frames && read.currents == whole.currents && read.cut.is_none());
        let bytes = std::fs::read(&packed).unwrap();
        std::fs::write(&packed, &bytes[..bytes.len() * 2 / 3]).unwrap();
        let output = command("repair", &packed);
        ended_with(&output, 0);
        let saved = Recording::read(&packed).unwrap();
        assert!(saved.frames.len() as u64 > FRAMES / 3 && is_part_of(&saved, &whole), "{}", stdout(&output));
        std::fs::remove_file(folder.path().join("packed.mcap.bak")).unwrap();
    }
}

#[test]
fn a_log_without_a_message_that_can_be_read_is_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut bytes = mcap::MAGIC.to_vec();
    bytes.extend([3; 5000]);
    std::fs::write(&path, &bytes).unwrap();
    let output = command("repair", &path);
    ended_with(&output, 1);
    assert!(stderr(&output).contains("no message in it can be read"), "{}", stderr(&output));
    assert_eq!(std::fs::read(&path).unwrap(), bytes);
    assert_eq!(names(folder.path()), ["log.mcap"]);
}

#[test]
fn topics_of_other_programs_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.mcap");
    let mut writer = Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
    let channel = writer.add_channel(0, "/other", "json", &Default::default()).unwrap();
    for sequence in 0..50 {
        let header = mcap::records::MessageHeader { channel_id: channel, sequence, log_time: 1, publish_time: 1 };
        writer.write_to_known_channel(&header, b"{}").unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 100]).unwrap();
    let output = command("repair", &path);
    ended_with(&output, 0);
    assert!(stdout(&output).contains("50 messages recovered"), "{}", stdout(&output));
}

#[test]
fn a_log_that_is_being_written_is_not_repaired() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = McapSink::create(&path, &fixture::rig(), "", "").unwrap();
    for seq in 0..90 {
        log.write(&fixture::complete(seq, seq as i64 * 16_666_667), None).unwrap();
    }
    let printed = stdout(&command("info", &path));
    assert!(printed.contains("is still being written") && !printed.contains("repair"), "{printed}");
    let output = command("repair", &path);
    ended_with(&output, 1);
    assert!(stderr(&output).contains("is still being written"), "{}", stderr(&output));
    assert_eq!(names(folder.path()), ["log.mcap"]);
    log.finish(&Tally::default()).unwrap();
    assert!(stdout(&command("repair", &path)).contains("is complete"));
}

#[test]
fn a_changed_bit_in_a_schema_is_no_panic_and_names_do_not_steer_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let path = run(folder.path(), FRAMES);
    // Chunks without checksums: what is damaged in them can be anything.
    let bytes = std::fs::read(&path).unwrap();
    let plain = folder.path().join("plain.mcap");
    let mut random = fastrand::Rng::with_seed(11);
    for k in 0..60 {
        let options =
            WriteOptions::new().compression(None).calculate_chunk_crcs(false).calculate_data_section_crc(false);
        let mut writer = Writer::with_options(std::fs::File::create(&plain).unwrap(), options).unwrap();
        let first = mcap::MessageStream::new(&bytes).unwrap().next().unwrap().unwrap();
        let schema = first.channel.schema.clone().unwrap();
        let mut data = schema.data.to_vec();
        let bit = random.usize(..8 * data.len());
        data[bit / 8] ^= 1 << (bit % 8);
        let schema = writer.add_schema(&schema.name, &schema.encoding, &data).unwrap();
        let topic = if k == 0 { "/catheter/estimate\u{1b}[2J" } else { "/catheter/estimate" };
        writer.add_channel(schema, topic, "protobuf", &Default::default()).unwrap();
        let channel = writer.add_channel(schema, "/catheter/estimate", "protobuf", &Default::default()).unwrap();
        let header = mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 1, publish_time: 1 };
        writer.write_to_known_channel(&header, &first.data).unwrap();
        writer.finish().unwrap();
        drop(writer);
        if k == 0 {
            let output = command("info", &plain);
            ended_with(&output, 0);
            assert!(!output.stdout.contains(&0x1b) && stdout(&output).contains("\\u{1b}"), "{}", stdout(&output));
        }
        let _ = (Info::read(&plain), Recording::read(&plain));
    }
}

#[test]
fn a_row_without_a_time_is_left_out_and_is_not_at_time_0() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(run(folder.path(), FRAMES)).unwrap();
    let timeless = folder.path().join("timeless.mcap");
    let mut writer = Writer::new(std::fs::File::create(&timeless).unwrap()).unwrap();
    let rows: Vec<_> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap)
        .filter(|message| message.channel.topic == "/catheter/estimate")
        .take(5)
        .collect();
    let schema = rows[0].channel.schema.clone().unwrap();
    // Of another version: its time has another name.
    let mut data = schema.data.to_vec();
    let mut renamed = 0;
    for at in 0..data.len() - 8 {
        if &data[at..at + 8] == b"stamp_ns" {
            data[at..at + 8].copy_from_slice(b"stamp_us");
            renamed += 1;
        }
    }
    assert!(renamed > 0);
    for (schema_data, from, to) in [(data, 0, 2), (schema.data.to_vec(), 2, 5)] {
        let id = writer.add_schema(&schema.name, &schema.encoding, &schema_data).unwrap();
        let channel = writer.add_channel(id, "/catheter/estimate", "protobuf", &Default::default()).unwrap();
        for (row, sequence) in rows[from..to].iter().zip(from..) {
            let header = mcap::records::MessageHeader {
                channel_id: channel,
                sequence: sequence as u32,
                log_time: row.log_time,
                publish_time: row.publish_time,
            };
            writer.write_to_known_channel(&header, &row.data).unwrap();
        }
    }
    writer.finish().unwrap();
    let info = Info::read(&timeless).unwrap();
    assert_eq!((info.frames, info.not_later), (3, 0));
    assert!(info.span_ns.unwrap().0 > 0);
    let series = Recording::read(&timeless).unwrap();
    assert_eq!(series.frames.iter().map(|frame| frame.seq).collect::<Vec<_>>(), [2, 3, 4]);
    let cut = series.cut.unwrap();
    assert!(cut.contains("message 0 cannot be decoded (it has no time) and is left out"), "{cut}");
}

#[test]
fn a_damaged_window_costs_its_frame_and_no_other() {
    let place = Place::new();
    ended_with(&place.track(&sample("planar.mkv"), &["--to", "2", "--record", "windows"]), 0);
    let log = place.path("out/log.mcap");
    let whole = place.table();
    let bytes = std::fs::read(&log).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    // Where chunks end depends on the machine's speed; the first and the last are damaged on any. Nearly all of a large
    // one is the samples of windows.
    let large: Vec<_> = summary.chunk_indexes.iter().filter(|chunk| chunk.chunk_length > 100_000).collect();
    assert!(large.len() > 2);
    for chunk in large {
        let middle = (chunk.chunk_start_offset + chunk.chunk_length / 2) as usize;
        // One changed bit in some thousands unpacks to the same content: then the next byte is damaged.
        let costs_messages = (middle..middle + 4).any(|at| {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x10;
            std::fs::write(&log, &damaged).unwrap();
            let again = Command::new(env!("CARGO_BIN_EXE_catoptra"))
                .current_dir(place.folder.path())
                .arg("track")
                .arg(&log)
                .args(["-o", "again"])
                .output()
                .unwrap();
            ended_with(&again, 0);
            assert!(stderr(&again).contains("the log is damaged"), "{}", stderr(&again));
            !stderr(&again).contains("own checksums are right")
        });
        assert!(costs_messages);
        only_some_are_lost(&Table::read(&place.path("again/track.csv")), &whole);
    }
}

/// Frames of a damaged log: those that are there are as in the whole log.
fn only_some_are_lost(read: &Table, whole: &Table) {
    // A chunk may hold windows and rows, or windows alone.
    let unseen = read.rows.iter().filter(|row| row["coil_status"] == "not_recorded").count();
    assert!(!read.rows.is_empty() && read.rows.len() < whole.rows.len() + unseen, "{} rows", read.rows.len());
    assert!(unseen < whole.rows.len() / 2, "{unseen} of {} rows without windows", whole.rows.len());
    // Where chunks end depends on the machine's speed: the damaged one may be the first, the last, or between.
    let position = |row: usize| {
        let stamp = &read.rows[row]["stamp_ns"];
        whole.rows.iter().position(|other| &other["stamp_ns"] == stamp).unwrap()
    };
    let lost: usize = read.rows[1..].iter().map(|row| row["gap"].parse::<usize>().unwrap()).sum();
    let spanned = position(read.rows.len() - 1) - position(0) + 1;
    assert_eq!(read.rows.len() + lost, spanned, "{lost} lost");
    for row in read.rows.iter().filter(|row| row["gap"] == "0" && !row["theta_deg"].is_empty()) {
        let same = whole.rows.iter().find(|other| other["stamp_ns"] == row["stamp_ns"]).unwrap();
        let apart = row["theta_deg"].parse::<f64>().unwrap() - same["theta_deg"].parse::<f64>().unwrap();
        assert!(apart.abs() < 0.2, "{}: {apart}°", row["t_s"]);
    }
}
