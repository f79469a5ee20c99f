//! Disks that fill up under a live run: pictures stop first, estimates continue, the user is told, and everything
//! written can be read.
//!
//! A limit on the size of files needs no rights; a small disk of its own (tmpfs) needs root, and is visibly skipped
//! without.

#![cfg(target_os = "linux")]

use crate::support::{command::*, skipped};
use catoptra::log::Info;
use catoptra::source::{Frame, FrameSource, LogWindows, SourceError, Span};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Mutex, PoisonError};

/// One run at a time: what is tested here is disks, not processors.
static ALONE: Mutex<()> = Mutex::new(());

/// `catoptra live` on the sample at its own pace, 5 s, results in `out`; `before` is what a shell does first.
fn live(place: &Place, out: &Path, before: &str, args: &str) -> Output {
    let run = format!(
        "{before} exec '{}' live '{}' --realtime --rig '{}' -o '{}' {args}",
        env!("CARGO_BIN_EXE_catoptra"),
        sample("planar.mkv").display(),
        place.rig.display(),
        out.display()
    );
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    Command::new("sh").args(["-c", &run]).current_dir(place.folder.path()).output().unwrap()
}

/// A disk of `bytes`, gone with the value; `None` without root.
struct Disk(PathBuf);

impl Disk {
    fn new(place: &Place, bytes: u64) -> Option<Self> {
        let at = place.path("disk");
        std::fs::create_dir(&at).unwrap();
        let size = format!("size={bytes}");
        let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(&at).output();
        if mounted.is_ok_and(|done| done.status.success()) {
            return Some(Self(at));
        }
        skipped("a small disk can be made by root only");
        None
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).output();
    }
}

/// Numbers of the estimates in a log, finished or not.
fn logged_so_far(log: &Path) -> Vec<u32> {
    let bytes = std::fs::read(log).unwrap();
    let messages = mcap::MessageStream::new_with_options(&bytes, mcap::read::Options::IgnoreEndMagic.into()).unwrap();
    let estimates = messages.map_while(Result::ok).filter(|m| m.channel.topic == "/catheter/estimate");
    estimates.map(|m| m.sequence).collect()
}

#[test]
fn a_video_that_meets_a_limit_ends_there_and_every_row_is_written() {
    let place = Place::new();
    let out = place.path("out");
    // 6 MB in blocks of 512 bytes: report and log fit, 60 pictures do not.
    let output = live(&place, &out, "ulimit -f 12000;", "--record ffv1");
    let printed = ended_with(&output, 1);
    assert!(printed.contains("pictures.mkv") && printed.contains("no more pictures are recorded"), "{printed}");
    assert_eq!(printed.matches("no more pictures are recorded").count(), 1, "{printed}");
    assert_eq!(place.frames_in_all_files(), 300);
    assert!(stdout(&output).contains("lost to the recording"), "{}", stdout(&output));

    // What is in the video gives the numbers of the run, nearly.
    let video = out.join("pictures.mkv");
    let again = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .current_dir(place.folder.path())
        .arg("track")
        .arg(&video)
        .args(["-o", "again", "--rig"])
        .arg(&place.rig)
        .output()
        .unwrap();
    ended_with(&again, 0);
    let (first, again) = (place.table().rows, Table::read(&place.path("again/track.csv")).rows);
    assert!((10..60).contains(&again.len()), "{} pictures", again.len());
    for row in &again {
        let same = first.iter().find(|first| first["stamp_ns"] == row["stamp_ns"]).unwrap();
        // Where chroma sits is measured over all frames of a run, and these are fewer: how many depends on the load.
        let number = |cell: &str| cell.parse::<f64>().unwrap();
        for (column, most) in [("theta_deg", number(&same["theta_sd_deg"])), ("tip_x_mm", 0.05)] {
            let [before, now] = [same, row].map(|row| number(&row[column]));
            assert!((now - before).abs() < most, "{column}: {now}, {before} before, at most {most} apart");
        }
    }
}

#[test]
fn pictures_stop_while_there_is_room_for_the_log() {
    let place = Place::new();
    let Some(disk) = Disk::new(&place, 18_000_000) else { return };
    let out = disk.0.join("out");
    let output = live(&place, &out, "", "--record windows --keep-free 0.013");
    let printed = ended_with(&output, 0);
    assert_eq!(printed.matches("no more pictures are recorded, the log continues").count(), 1, "{printed}");
    let log = out.join("log.mcap");
    assert_eq!(logged(&log), (0..300).collect::<Vec<_>>());
    let topics = Info::read(&log).unwrap().topics;
    let pictures = topics.iter().find(|topic| topic.name == "/camera/windows").unwrap().messages;
    assert!((20..280).contains(&pictures), "{pictures} pictures");
    assert!(stdout(&output).contains(&format!("{pictures} pictures recorded, ")), "{}", stdout(&output));
    // None of the last ones; a slow machine loses some before.
    let mut source = LogWindows::open(&log, Span::default()).unwrap();
    let something = |frame: &Frame| frame.picture.recorded().is_some_and(|parts| !parts.is_empty());
    let with: Vec<bool> = std::iter::from_fn(|| source.next_frame().unwrap()).map(|frame| something(&frame)).collect();
    assert_eq!((with.len(), with.iter().filter(|with| **with).count() as u64), (300, pictures));
    assert!(with.iter().rposition(|with| *with).unwrap() < 290, "{with:?}");
}

#[test]
fn a_full_disk_is_told_and_what_was_written_before_is_read() {
    let place = Place::new();
    let Some(disk) = Disk::new(&place, 500_000) else { return };
    let out = disk.0.join("out");
    let output = live(&place, &out, "", "");
    let printed = ended_with(&output, 1);
    assert!(printed.contains("log.mcap") && printed.contains("No space left"), "{printed}");
    assert!(stdout(&output).contains("results in"), "{}", stdout(&output));
    // Of three seconds, the estimates until the disk was full.
    let kept = logged_so_far(&out.join("log.mcap"));
    assert!(kept.len() > 60, "{} rows", kept.len());
    assert_eq!(kept, (0..kept.len() as u32).collect::<Vec<_>>());
    let repaired = place.path("repaired.mcap");
    std::fs::copy(out.join("log.mcap"), &repaired).unwrap();
    let mended = Command::new(env!("CARGO_BIN_EXE_catoptra")).args(["log", "repair"]).arg(&repaired).output().unwrap();
    ended_with(&mended, 0);
    assert_eq!(logged(&repaired).len(), kept.len());
}

/// Pictures and log on a disk that both fill: without room kept for the log, both end; what is there is still read.
#[test]
fn without_room_kept_for_it_the_log_ends_with_the_pictures_and_both_are_read() {
    let place = Place::new();
    let Some(disk) = Disk::new(&place, 9_000_000) else { return };
    let out = disk.0.join("out");
    let output = live(&place, &out, "", "--record ffv1 --keep-free 0.000001");
    let printed = ended_with(&output, 1);
    assert!(printed.contains("pictures.mkv") && printed.contains("log.mcap"), "{printed}");
    let rows: BTreeSet<u32> = logged_so_far(&out.join("log.mcap")).into_iter().collect();
    assert!(rows.len() > 20, "{} rows", rows.len());
    let mut video = catoptra::source::open(out.join("pictures.mkv"), Default::default()).unwrap();
    let mut pictures = 0;
    let end = loop {
        match video.next_frame() {
            Ok(Some(_)) => pictures += 1,
            Ok(None) => break None,
            Err(error) => break Some(error),
        }
    };
    assert!(pictures > 20, "{pictures} pictures");
    assert!(matches!(end, None | Some(SourceError::Truncated { .. })), "{end:?}");
}
