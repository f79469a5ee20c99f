//! Damaged and hostile input of every kind: seeded mutations of sound files, none of which may make the program panic,
//! take long, or exhaust memory. `CATOPTRA_MUTATIONS=N` tries N times as many.

use crate::support::{command::*, fixture};
use catoptra::fuzz::{TARGETS, Target};
use catoptra::sink::{CsvSink, CurrentSample, McapSink, OutputFrame, Sink};
use catoptra::tally::Tally;
use std::io::{Cursor, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// No input may take longer; some machines are slow, or busy.
const LONGEST: Duration = Duration::from_secs(20);
/// Nor may memory grow beyond this, bytes.
const MAX_MEMORY: u64 = 2 << 30;

fn repository(path: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap()
}

/// A live log with currents, and the table of the same run.
fn run(folder: &Path) -> [PathBuf; 2] {
    let [log, table] = ["run.mcap", "run.csv"].map(|name| folder.join(name));
    let rig = fixture::rig();
    let mut tally = Tally::new(&rig);
    let mut sinks: [Box<dyn Sink>; 2] = [
        Box::new(McapSink::create(&log, &rig, &rig.to_toml_string(), "frame = \"base\"").unwrap()),
        Box::new(CsvSink::create(&table, &rig, OutputFrame::Base).unwrap()),
    ];
    for seq in 0..40 {
        let estimate = fixture::eventful(seq, 5_000_000);
        tally.add(&estimate);
        let host_ns = 1_700_000_000_000_000_000 + estimate.stamp.ns;
        let current = CurrentSample { host_ns, arrival_ns: host_ns, seq: Some(seq), current_a: vec![0.1, -0.1] };
        for sink in &mut sinks {
            sink.write(&estimate, None).unwrap();
            sink.write_current(&current).unwrap();
        }
    }
    sinks.iter_mut().for_each(|sink| sink.finish(&tally).unwrap());
    [log, table]
}

/// Sound inputs of a kind.
fn seeds(target: &str, folder: &Path) -> Vec<Vec<u8>> {
    let text = |text: &str| text.as_bytes().to_vec();
    let all = |paths: &[&str]| paths.iter().map(|path| repository(path)).collect::<Vec<_>>();
    match target {
        "rig" => all(&["sample_frames/truth/rig.toml", "calibration/dev_tank/rig.toml"]),
        "rig_import" => all(&[
            "tests/data/cameras/kalibr.yaml",
            "tests/data/cameras/opencv4.yml",
            "tests/data/cameras/opencv_tutorial.yml",
            "tests/data/cameras/ros.yaml",
        ]),
        "series" => {
            let currents = text("t_s,current_a\r\n0.0,0.1\r\n0.4,0.2\r\n");
            let [_, table] = run(folder);
            vec![std::fs::read(table).unwrap(), currents, repository("tests/data/validate/circle.csv")]
        }
        "plant" => all(&["sample_dynamics/plant.toml"]),
        "model" => vec![
            text("num = [17610, 6344]\nden = [1, 4.59, 1.136]\ndelay_s = 0.02\n"),
            text(concat!(
                r#"{"format":"catoptra-model","period_s":0.0166,"input":{"name":"u","unit":"A"},"output":{"name":"y","unit":""},"#,
                r#""arx":{"a":[1.0,-1.5,0.7],"b":[1.0,0.5],"nk":1},"refined":{"num_z":[0.0,1.0,0.5],"den_z":[1.0,-1.5,0.7],"#,
                r#""continuous":{"num":[1.0,2.0],"den":[1.0,3.0,9.0],"delay_s":0.0,"conversion":"zero_order_hold"}}}"#
            )),
        ],
        "currents" => vec![
            text(r#"{"current_a":[0.1,0,-0.1],"seq":7,"host_ns":1700000000123456789}"#),
            text("0.1, 0, -0.1\n1700000000000000000,0.1"),
        ],
        "log" => vec![std::fs::read(&run(folder)[0]).unwrap()],
        "log_windows" => {
            let place = Place::new();
            ended_with(&place.track(&sample("rest.mkv"), &["--to", "0.05", "--record", "windows"]), 0);
            vec![std::fs::read(place.path("out/log.mcap")).unwrap()]
        }
        "board_text" => vec![
            text("9x6:12mm"),
            text("charuco:5x7:12mm:9mm:DICT_4X4_50:legacy"),
            text("1280x1024:bayer_rg8@60"),
            text("udp:127.0.0.1:5006"),
            text("60000/1001"),
        ],
        "board_picture" => {
            let small = image::load_from_memory(&repository("tests/data/charuco/5x7_4x4_50.png")).unwrap();
            let small = small.resize(160, 160, image::imageops::FilterType::Triangle);
            let mut png = Cursor::new(Vec::new());
            small.write_to(&mut png, image::ImageFormat::Png).unwrap();
            let mut pgm = Cursor::new(Vec::new());
            small.to_luma8().write_to(&mut pgm, image::ImageFormat::Pnm).unwrap();
            vec![png.into_inner(), pgm.into_inner()]
        }
        "container" => videos(folder),
        "raw_pipe" => vec![(0..2000_u32).map(|k| (k * 7) as u8).collect()],
        "picture" | "codec" => pictures(),
        other => panic!("no seeds for {other}"),
    }
}

fn videos(folder: &Path) -> Vec<Vec<u8>> {
    use crate::support::encode::{Recording, write};
    let pts: Vec<i64> = (0..20).map(|k| 17 * k).collect();
    let kinds = [("mkv", "libx264", 2), ("mp4", "libx264", 2), ("avi", "mjpeg", 0), ("mkv", "ffv1", 0)];
    let write = |(k, (ending, encoder, b_frames)): (usize, (&str, &'static str, usize))| {
        let path = folder.join(format!("seed{k}.{ending}"));
        let pixel = match encoder {
            "mjpeg" => ffmpeg_the_third::format::Pixel::YUVJ420P,
            _ => ffmpeg_the_third::format::Pixel::YUV420P,
        };
        write(&path, &Recording { pts: &pts, b_frames, encoder, pixel, ..Recording::default() });
        std::fs::read(path).unwrap()
    };
    kinds.into_iter().enumerate().map(write).collect()
}

fn pictures() -> Vec<Vec<u8>> {
    let picture = image::RgbImage::from_fn(40, 30, |x, y| image::Rgb([(x * 6) as u8, (y * 8) as u8, (x ^ y) as u8]));
    use image::ImageFormat::{Bmp, Jpeg, Png, Pnm, Tiff};
    let encoded = |format| {
        let mut bytes = Cursor::new(Vec::new());
        picture.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    };
    [Png, Jpeg, Tiff, Bmp, Pnm].map(encoded).to_vec()
}

/// One of the ways in which files come to be other than they were, or are made to be.
fn mutated(seed: &[u8], random: &mut fastrand::Rng) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..random.usize(1..=4) {
        let at = random.usize(..bytes.len().max(1));
        match random.u8(..10) {
            0 | 1 => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << random.u8(..8);
                }
            }
            2 => bytes.iter_mut().skip(at).take(random.usize(1..64)).for_each(|byte| *byte = random.u8(..)),
            3 => bytes.iter_mut().skip(at).take(4096).for_each(|byte| *byte = 0),
            4 => bytes.truncate(at),
            5 => {
                bytes.drain(at..(at + random.usize(1..200)).min(bytes.len()));
            }
            6 => {
                let piece: Vec<u8> = bytes.iter().skip(at).take(random.usize(1..300)).copied().collect();
                let to = random.usize(..=bytes.len());
                bytes.splice(to..to, piece);
            }
            // Lengths and counts at the edge of what they can be.
            7 => {
                let edge = [0_u64, 1, 0x7fff_ffff, 0xffff_ffff, u64::MAX, 1 << 40][random.usize(..6)];
                bytes.iter_mut().skip(at).zip(edge.to_le_bytes()).for_each(|(byte, edge)| *byte = edge);
            }
            // Numbers of text.
            8 => {
                let number = ["1e308", "-1", "nan", "inf", "1e-320", "99999999999999999999", "\"", "[[[[", ",", "*a"];
                bytes.splice(at..at, number[random.usize(..number.len())].bytes());
            }
            _ => bytes.extend(std::iter::repeat_n(random.u8(..), random.usize(1..100))),
        }
    }
    bytes
}

/// How often each kind is tried in an ordinary run; together they take less than a minute.
fn tries(target: &str) -> usize {
    let times = std::env::var("CATOPTRA_MUTATIONS").ok().and_then(|n| n.parse().ok()).unwrap_or(1);
    times
        * match target {
            "currents" | "board_text" | "codec" | "plant" | "model" | "rig_import" => 400,
            "series" | "raw_pipe" | "picture" => 150,
            "rig" | "log" | "container" => 60,
            // The search for boards takes a second at times.
            _ => 12,
        }
}

/// Most memory that this program has had, bytes.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? * 1024)
}

fn withstands(target: Target, folder: &Path) -> usize {
    let seeds = seeds(target.name, folder);
    let count = tries(target.name);
    let place = folder.join(target.name);
    std::fs::create_dir(&place).unwrap();
    let began = Instant::now();
    for k in 0..count {
        let mut random = fastrand::Rng::with_seed(k as u64);
        let seed = &seeds[k % seeds.len()];
        // The sound ones first: they must be read.
        let bytes = if k < seeds.len() { seed.clone() } else { mutated(seed, &mut random) };
        // What kills the program is found here.
        std::fs::write(folder.join("last"), &bytes).unwrap();
        let one = Instant::now();
        let result = std::panic::catch_unwind(|| (target.read)(&bytes, &place));
        assert!(result.is_ok(), "{}: mutation {k} panics", target.name);
        assert!(one.elapsed() < LONGEST, "{}: mutation {k} takes {:?}", target.name, one.elapsed());
    }
    // Not captured: a run of many shows how far it is.
    let _ = writeln!(std::io::stderr(), "{}: {count} inputs, {:.1} s", target.name, began.elapsed().as_secs_f64());
    count
}

#[test]
fn no_input_makes_it_panic_or_take_long_or_fill_the_memory() {
    let folder = tempfile::tempdir().unwrap();
    let before = peak_memory();
    let count: usize = TARGETS.into_iter().map(|target| withstands(target, folder.path())).sum();
    let memory = peak_memory().zip(before).map_or(0, |(after, before)| after.saturating_sub(before));
    println!("{count} inputs, {} MB", memory >> 20);
    assert!(memory < MAX_MEMORY, "{} MB", memory >> 20);
}

/// What was found once, and must not come back: a name of its kind each (`rig_import-…`).
#[test]
fn what_was_found_before_is_withstood() {
    let folder = tempfile::tempdir().unwrap();
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    let mut count = 0;
    for target in TARGETS {
        let Ok(files) = std::fs::read_dir(corpus.join(target.name)) else { continue };
        for file in files {
            let path = file.unwrap().path();
            let began = Instant::now();
            (target.read)(&std::fs::read(&path).unwrap(), folder.path());
            assert!(began.elapsed() < LONGEST, "{} takes {:?}", path.display(), began.elapsed());
            count += 1;
        }
    }
    assert!(count >= 5, "{count} files");
}
