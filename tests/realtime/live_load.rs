//! `catoptra live` on a loaded machine: 20 busy loops in separate sessions, like other terminals. They take the whole
//! machine for two minutes: `scripts/robustness.sh` runs them, `make test` does not.

use crate::support::command::*;
use ffmpeg_the_third as av;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const LOOPS: usize = 20;

/// Busy loops, which end by themselves, too.
struct Load(Vec<Child>);

impl Load {
    fn of(longest: Duration) -> Self {
        let until = format!(
            "end=$(( $(date +%s) + {} )); while [ $(date +%s) -lt $end ]; do i=0; while [ $i -lt 20000 ]; do i=$((i + 1)); done; done",
            longest.as_secs()
        );
        let one = |_| Command::new("setsid").args(["sh", "-c", &until]).spawn().unwrap();
        Self((0..LOOPS).map(one).collect())
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        for one in &mut self.0 {
            let _ = one.kill();
            let _ = one.wait();
        }
    }
}

/// The sample many times, one behind the other, without decoding it.
pub(crate) fn looped(times: i64, to: &Path) {
    let mut output = av::format::output(to).unwrap();
    let (mut added, mut decoded) = (0, i64::MIN);
    for k in 0..times {
        let mut input = av::format::input(sample("planar.mkv")).unwrap();
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

fn live(place: &Place, recording: &Path, folder: &str, more: &[&str]) -> Command {
    let mut live = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    live.current_dir(place.folder.path()).arg("-v").arg("live").arg(recording).args([
        "--realtime",
        "-o",
        folder,
        "--rig",
    ]);
    live.arg(&place.rig).args(more);
    live
}

#[test]
#[ignore = "takes the whole machine for a minute"]
fn at_a_load_of_20_no_frame_is_skipped_where_the_system_lets_it_go_first() {
    let place = Place::new();
    let recording = place.path("long.mkv");
    looped(13, &recording);
    let load = Load::of(Duration::from_secs(90));
    let output = live(&place, &recording, "live", &["--duration", "60"]).output().unwrap();
    drop(load);
    let printed = ended_with(&output, 0);
    let table = Table::read(&place.path("live/track.csv"));
    let count = |word: &str| table.rows.iter().filter(|row| row["coil_status"] == word).count();
    let (rows, skipped, jumps) = (table.rows.len(), count("skipped_overload"), count("implausible_motion"));
    let lost: u64 = table.rows.iter().map(|row| row["gap"].parse::<u64>().unwrap()).sum();
    let raised = printed.contains("raised priority") && !printed.contains("within this session only");
    println!("{rows} frames, {skipped} skipped, {lost} lost, {jumps} jumps of 12 seams; first: {raised}");
    // Each is counted; and none is skipped where nothing may go before it.
    assert!(rows > 3300, "{rows} rows in 60 s");
    assert!(!raised || skipped == 0, "{skipped} of {rows} skipped although it goes first");
}

#[test]
#[ignore = "takes the whole machine for a minute"]
fn at_a_load_of_20_a_killed_run_leaves_pictures() {
    let place = Place::new();
    let load = Load::of(Duration::from_secs(180));
    let mut readable = 0;
    for run in 0..10_u64 {
        let folder = format!("run{run}");
        let video = place.path(&folder).join("pictures.mkv");
        let mut live = live(&place, &sample("planar.mkv"), &folder, &["--record", "ffv1"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let began = Instant::now();
        while !video.exists() && began.elapsed() < Duration::from_secs(20) {
            std::thread::sleep(Duration::from_millis(5));
        }
        // A second of pictures and more.
        std::thread::sleep(Duration::from_millis(1000 + 200 * run));
        live.kill().unwrap();
        live.wait().unwrap();
        let frames = catoptra::source::open(&video, Default::default())
            .map_or(0, |mut source| std::iter::from_fn(|| source.next_frame().ok().flatten()).count());
        println!("killed after {:.1} s of pictures: {frames} frames can be read", 1.0 + 0.2 * run as f64);
        readable += usize::from(frames > 0);
    }
    drop(load);
    assert_eq!(readable, 10, "runs with a readable frame");
}
