//! `catoptra live` killed at random instants: every frame that was sent to a controller more than a second earlier is
//! in the log, and its picture in log or video if recorded; `catoptra log repair` repairs the log. Six instants;
//! `CATOPTRA_KILLS=50` for more.

use crate::support::command::*;
use std::collections::BTreeSet;
use std::net::UdpSocket;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Kills a live run after `after` of tracking; frames sent to a controller at least a second before, and all that were
/// sent.
fn killed(place: &Place, folder: &str, after: Duration, more: &[&str]) -> (BTreeSet<u64>, BTreeSet<u64>) {
    let controller = UdpSocket::bind("127.0.0.1:0").unwrap();
    controller.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    let mut live = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .current_dir(place.folder.path())
        .arg("live")
        .arg(sample("planar.mkv"))
        .args(["--realtime", "-o", folder, "--udp", &controller.local_addr().unwrap().to_string(), "--rig"])
        .arg(&place.rig)
        .args(more)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut sent: Vec<(Instant, u64)> = Vec::new();
    let mut bytes = [0; 4096];
    while sent.first().is_none_or(|(first, _)| first.elapsed() < after) {
        let length = controller.recv(&mut bytes).unwrap();
        let frame: serde_json::Value = serde_json::from_slice(&bytes[..length]).unwrap();
        sent.push((Instant::now(), frame["seq"].as_u64().unwrap()));
    }
    live.kill().unwrap();
    let end = Instant::now();
    live.wait().unwrap();
    let old = sent.iter().filter(|(at, _)| end - *at >= Duration::from_secs(1)).map(|(_, seq)| *seq);
    (old.collect(), sent.iter().map(|(_, seq)| *seq).collect())
}

/// Sequence numbers of the estimates in a log, finished or not.
fn logged_so_far(log: &Path) -> BTreeSet<u64> {
    so_far(log, "/catheter/estimate")
}

/// Sequence numbers of the frames whose windows are in a log.
fn pictures_so_far(log: &Path) -> BTreeSet<u64> {
    so_far(log, "/camera/windows")
}

/// Number of the last frame in a video that was cut off.
fn shown_so_far(video: &Path) -> Option<u64> {
    let mut source = catoptra::source::open(video, Default::default()).ok()?;
    let last = std::iter::from_fn(|| source.next_frame().ok().flatten()).last()?;
    Some((last.stamp.seconds() * 60.0).round() as u64)
}

fn so_far(log: &Path, topic: &str) -> BTreeSet<u64> {
    let bytes = std::fs::read(log).unwrap();
    let messages = mcap::MessageStream::new_with_options(&bytes, mcap::read::Options::IgnoreEndMagic.into()).unwrap();
    let estimates = messages.map_while(Result::ok).filter(|m| m.channel.topic == topic);
    estimates.map(|m| u64::from(m.sequence)).collect()
}

#[test]
fn all_that_is_older_than_a_second_survives_a_kill_at_any_instant() {
    let kills: u64 = std::env::var("CATOPTRA_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(6);
    let place = Place::new();
    for kill in 0..kills {
        // Spread by the golden ratio over 0.2 to 3.2 seconds.
        let after = Duration::from_secs_f64(0.2 + 3.0 * (kill as f64 * 0.618_034).fract());
        let folder = format!("run{kill}");
        let record: &[&str] = [&[][..], &["--record", "windows"], &["--record", "ffv1"]][kill as usize % 3];
        let (old, sent) = killed(&place, &folder, after, record);
        let log = place.path(&folder).join("log.mcap");
        // A busy machine loses single pictures and has some waiting; but there is one of nearly a second ago.
        let newest = match record.last() {
            Some(&"windows") => pictures_so_far(&log).last().copied(),
            Some(_) => shown_so_far(&log.with_file_name("pictures.mkv")),
            None => old.last().copied(),
        };
        let wanted = old.last().and_then(|seq| seq.checked_sub(20));
        assert!(newest >= wanted, "killed after {after:?}: the last picture is {newest:?}, {wanted:?} was long there");
        let kept = logged_so_far(&log);
        assert!(kept.is_superset(&old), "killed after {after:?}: {:?} are lost", old.difference(&kept));
        // The log may have a frame or two whose datagrams were not read any more.
        let last = sent.last().copied().unwrap_or(0);
        assert!(kept.iter().all(|seq| *seq <= last + 60), "{kept:?} of {last}");

        let repair = Command::new(env!("CARGO_BIN_EXE_catoptra")).args(["log", "repair"]).arg(&log).output().unwrap();
        if kept.is_empty() {
            // Nothing to save: the file is left alone.
            let printed = ended_with(&repair, 1);
            assert!(printed.contains("no message in it can be read"), "{printed}");
            continue;
        }
        ended_with(&repair, 0);
        let info = Command::new(env!("CARGO_BIN_EXE_catoptra")).args(["log", "info"]).arg(&log).output().unwrap();
        let printed = stdout(&info);
        let frames = format!("{} frames", kept.len());
        let lost = "with index\n  it lacks what was lost before it was repaired (it ends without an index)";
        assert!(printed.contains(lost) && printed.contains(&frames), "{printed}");
        assert_eq!(logged(&log).into_iter().map(u64::from).collect::<BTreeSet<_>>(), kept);
    }
}
