//! Streams from a network, served by the test itself: complete, interrupted, changing size, absent.

use crate::support::command::sample;
use crate::support::encode::{Recording, write};
use catoptra::source::host::HostClock;
use catoptra::source::live::Stream;
use catoptra::source::{Clock, FrameSource, VideoFile, VideoOptions};
use std::io::Write as _;
use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Sends the whole file to each who connects, one after the other.
fn served(file: &Path, times: usize) -> SocketAddr {
    served_all(&vec![file; times])
}

/// Each file on a connection of its own.
fn served_all(files: &[&Path]) -> SocketAddr {
    let all: Vec<Vec<u8>> = files.iter().map(|file| std::fs::read(file).unwrap()).collect();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        for bytes in all {
            let (mut connection, _) = listener.accept().unwrap();
            // A reader that has seen enough is no failure.
            let _ = connection.write_all(&bytes);
        }
    });
    address
}

fn stamps(source: &mut dyn FrameSource, count: usize) -> Vec<i64> {
    (0..count).map(|_| source.next_frame().unwrap().unwrap().stamp.ns).collect()
}

#[test]
fn a_stream_gives_the_frames_and_stamps_of_the_recording_it_is_made_of() {
    let address = served(&sample("rest.mkv"), 1);
    let mut stream = Stream::open(&format!("tcp://{address}"), HostClock::start(), Arc::default()).unwrap();
    let mut file = VideoFile::open(sample("rest.mkv"), VideoOptions::default()).unwrap();
    assert_eq!(stream.size_px(), file.size_px());
    for k in 0..20 {
        let (live, recorded) = (stream.next_frame().unwrap().unwrap(), file.next_frame().unwrap().unwrap());
        assert_eq!((live.seq, live.stamp.ns, live.stamp.clock), (k, recorded.stamp.ns, Clock::Stream));
        let host = live.host.unwrap();
        assert!(host.stamp_ns <= host.arrival_ns || k > 0);
        let row = |frame: &catoptra::source::Frame| frame.picture.plane(0).unwrap().row(512).unwrap().to_vec();
        assert_eq!(row(&live), row(&recorded), "frame {k}");
    }
}

#[test]
fn a_stream_that_stops_is_opened_again_and_its_frames_are_counted_on() {
    let file = sample("rest.mkv");
    let frames = {
        let mut all = VideoFile::open(&file, VideoOptions::default()).unwrap();
        std::iter::from_fn(|| all.next_frame().unwrap()).count()
    };
    let address = served(&file, 2);
    let stop = Arc::new(AtomicBool::new(false));
    let mut stream = Stream::open(&format!("tcp://{address}"), HostClock::start(), Arc::clone(&stop)).unwrap();
    let first = stamps(&mut stream, frames);
    let back = stream.next_frame().unwrap().unwrap();
    assert_eq!((back.seq, back.gap), (frames as u64, 0));
    assert_eq!(stream.faults().interruptions, 1);
    // The sender's stamps began anew; those of the run go on, and so does the host's time.
    assert!(back.stamp.ns > *first.last().unwrap(), "{} {first:?}", back.stamp.ns);
    let host = back.host.unwrap();
    assert!(host.stamp_ns <= host.arrival_ns);
    stop.store(true, Ordering::Relaxed);
    assert!(stream.next_frame().unwrap().is_none());
}

#[test]
fn a_stream_that_is_not_there_is_named() {
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let url = format!("tcp://{free}");
    let error = Stream::open(&url, HostClock::start(), Arc::default()).err().unwrap().to_string();
    assert!(error.contains(&url) && error.contains("refused"), "{error}");
}

/// Key frames are seconds apart, and who joins comes between two of them.
#[test]
fn a_stream_joined_between_two_key_frames_begins_with_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("whole.ts");
    let pts: Vec<i64> = (0..60).map(|k| 1500 * (k + 10)).collect();
    let (time_base, size_px) = ((1, 90_000), [320, 240]);
    write(&path, &Recording { pts: &pts, time_base, b_frames: 0, group: 600, size_px, ..Recording::default() });
    let whole = std::fs::read(&path).unwrap();
    // The second half has no key frame.
    let half = whole.len() / 2 / 188 * 188;
    let joined = folder.path().join("joined.ts");
    std::fs::write(&joined, [&whole[half..], &whole].concat()).unwrap();
    let open = |path: &Path| Stream::open(&format!("tcp://{}", served(path, 1)), HostClock::start(), Arc::default());
    let mut stream = open(&joined).unwrap();
    assert_eq!(stream.size_px(), [320, 240]);
    let mut file = VideoFile::open(path, VideoOptions::default()).unwrap();
    for k in 0..20 {
        let (live, recorded) = (stream.next_frame().unwrap().unwrap(), file.next_frame().unwrap().unwrap());
        let host = live.host.unwrap();
        assert_eq!((live.seq, live.stamp.ns, live.gap), (k, recorded.stamp.ns, 0));
        assert!(host.stamp_ns <= host.arrival_ns || k > 0);
    }
    // One that never has a key frame is not taken for one of another size.
    std::fs::write(&joined, &whole[half..]).unwrap();
    let error = open(&joined).err().unwrap().to_string();
    assert!(error.contains("it ended before a key frame"), "{error}");
    // Who has been told to stop does not wait for one.
    let stop = Arc::new(AtomicBool::new(true));
    let error = Stream::open(&format!("tcp://{}", served(&joined, 1)), HostClock::start(), stop).err().unwrap();
    assert!(error.to_string().contains("interrupted before its first frame"), "{error}");
}

/// As senders do that say only after their first packet which time it is.
#[test]
fn frames_before_the_first_time_stamp_are_left_out_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("late.ts");
    let pts: Vec<i64> = (0..100).map(|k| 3600 * (k + 10)).collect();
    write(
        &path,
        &Recording { pts: &pts, time_base: (1, 90_000), b_frames: 0, size_px: [320, 240], ..Recording::default() },
    );
    let mut bytes = std::fs::read(&path).unwrap();
    // The head of a PES packet of video: two flags say that times follow, then the head's length (ISO/IEC 13818-1,
    // 2.4.3.6).
    let head = bytes.windows(4).position(|four| four == [0, 0, 1, 0xe0]).unwrap();
    assert!(bytes[head + 7] & 0x80 != 0 && bytes[head + 8] >= 5);
    let length = usize::from(bytes[head + 8]);
    bytes[head + 7] &= 0x3f;
    bytes[head + 9..head + 9 + length].fill(0xff);
    std::fs::write(&path, &bytes).unwrap();
    let mut stream = Stream::open(&format!("tcp://{}", served(&path, 1)), HostClock::start(), Arc::default()).unwrap();
    let first = stream.next_frame().unwrap().unwrap();
    assert_eq!((first.seq, stream.faults().unstamped, stream.faults().interruptions), (0, 1, 0));
    let second = stream.next_frame().unwrap().unwrap();
    assert_eq!((second.seq, second.gap, second.stamp.ns - first.stamp.ns), (1, 0, 40_000_000));
}

#[test]
fn frames_lost_in_an_interruption_through_which_the_clock_went_on_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let part = |name: &str, frames: std::ops::Range<i64>| {
        let path = folder.path().join(name);
        let pts: Vec<i64> = frames.map(|k| 3600 * (k + 10)).collect();
        write(
            &path,
            &Recording { pts: &pts, time_base: (1, 90_000), b_frames: 0, size_px: [320, 240], ..Recording::default() },
        );
        path
    };
    let (before, after) = (part("before.ts", 0..50), part("after.ts", 90..140));
    let address = served_all(&[&before, &after]);
    let mut stream = Stream::open(&format!("tcp://{address}"), HostClock::start(), Arc::default()).unwrap();
    let mut frames = Vec::new();
    while frames.len() < 60 {
        let frame = stream.next_frame().unwrap().unwrap();
        frames.push((frame.stamp.ns, frame.gap));
    }
    let gaps: Vec<(usize, u32)> = (0..60).map(|k| (k, frames[k].1)).filter(|(_, gap)| *gap > 0).collect();
    assert_eq!((gaps, stream.faults().interruptions), (vec![(50, 40)], 1));
    assert_eq!(frames[50].0 - frames[49].0, 41 * 40_000_000);
}
