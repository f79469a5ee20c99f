//! Segmentation of whole 1280x1024 frames for three markers, beside the usual OpenCV script: cvtColor to BGR and HSV, three
//! times inRange, morphologyEx (open) and connectedComponentsWithStats. Same frames, same process, one thread each, runs
//! interleaved; what counts is the ratio.
//!
//! The frames are drawn here: a tank-like scene of greys and browns with noise, six small bands. To measure on recorded frames,
//! name a file of raw I420 frames of 1280x1024: `cargo bench --bench segment -- FILE`.

#![allow(clippy::print_stdout, reason = "a bench prints its result")]
#![allow(clippy::expect_used, reason = "a bench that cannot run is to stop")]

use catoptra::segment::{ClassSamples, Search, Segmenter, Window, learn};
use catoptra::source::{ChromaSiting, Colour, Matrix, Picture, PixelFormat, Range, Transfer};
use nalgebra::Vector3;
use opencv::core::{Mat, MatTraitConst, Scalar, Size};
use opencv::imgproc;
use std::hint::black_box;
use std::time::{Duration, Instant};

const WIDTH: usize = 1280;
const HEIGHT: usize = 1024;
const PIXELS: usize = WIDTH * HEIGHT;
const FRAMES: usize = 40;
const FORMAT: PixelFormat = PixelFormat::Yuv { chroma_log2: [1, 1] };
const COLOUR: Colour =
    Colour { matrix: Matrix::Bt709, range: Range::Limited, transfer: Transfer::Bt709, siting: ChromaSiting::Left };

/// Base, coil, tip, tube, wall, floor.
const COLOURS: [(&str, bool, [f64; 3]); 6] = [
    ("base", true, [136.0, 117.0, 43.0]),
    ("coil", true, [51.0, 105.0, 65.0]),
    ("tip", true, [48.0, 68.0, 120.0]),
    ("tube", false, [190.0, 190.0, 188.0]),
    ("wall", false, [112.0, 112.0, 114.0]),
    ("floor", false, [140.0, 132.0, 122.0]),
];

/// Hue (0..180), saturation and value limits of the three, for OpenCV.
const HSV: [[[f64; 3]; 2]; 3] = [
    [[18.0, 90.0, 60.0], [32.0, 255.0, 255.0]],
    [[55.0, 70.0, 40.0], [85.0, 255.0, 255.0]],
    [[105.0, 90.0, 40.0], [125.0, 255.0, 255.0]],
];

/// One frame both ways: I420 in one piece for OpenCV, and as a picture.
struct Frame {
    i420: Mat,
    picture: Picture,
}

impl Frame {
    fn new(bytes: &[u8]) -> Self {
        let (y, chroma) = bytes.split_at(PIXELS);
        let (u, v) = chroma.split_at(PIXELS / 4);
        let planes = vec![y.to_vec(), u.to_vec(), v.to_vec()];
        let picture = Picture::from_planes(WIDTH as u32, HEIGHT as u32, FORMAT, COLOUR, planes).expect("plane sizes");
        let rows =
            Mat::from_slice(bytes).expect("bytes").reshape(1, (HEIGHT * 3 / 2) as i32).expect("rows").try_clone();
        Self { i420: rows.expect("copy"), picture }
    }
}

fn stored(rgb: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| {
        let (w, c) = COLOUR.channel_from_rgb(FORMAT, i);
        Vector3::from(w).dot(&Vector3::from(rgb)) + c
    })
}

/// Wall, floor, a dark clamp and the tube with its bands in two views; noise on all samples.
fn drawn(seed: u64) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut noise = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        ((state & 7) as f64 + (state >> 32 & 7) as f64 - 7.0) * 0.6
    };
    let colour = |x: usize, y: usize| {
        let along = [(430_usize, 6_usize, 400_usize), (890, 5, 410)].into_iter().find_map(|(centre, width, top)| {
            let bent = centre + (y.saturating_sub(top) * (seed as usize % 40)) / 200;
            (x.abs_diff(bent) * 2 <= width && y >= top).then(|| y - top)
        });
        match along {
            Some(0..12) => COLOURS[0].2,
            Some(150..174) => COLOURS[1].2,
            Some(198..210) => COLOURS[2].2,
            Some(0..210) => COLOURS[3].2,
            _ if x.abs_diff(430) < 9 && (250..396).contains(&y) => [50.0; 3],
            _ => if y < 690 { COLOURS[4].2 } else { COLOURS[5].2 }.map(|c| c * (0.8 + 0.4 * x as f64 / WIDTH as f64)),
        }
    };
    let mut bytes = Vec::with_capacity(PIXELS * 3 / 2);
    for (channel, step) in [(0, 1), (1, 2), (2, 2)] {
        for y in (0..HEIGHT).step_by(step) {
            bytes.extend((0..WIDTH).step_by(step).map(|x| (stored(colour(x, y))[channel] + noise()).round() as u8));
        }
    }
    bytes
}

fn frames() -> (String, Vec<Frame>) {
    // Cargo adds `--bench`.
    match std::env::args().skip(1).find(|a| !a.starts_with('-')) {
        Some(path) => {
            let bytes = std::fs::read(&path).expect("a file of raw I420 frames of 1280x1024");
            (path, bytes.chunks_exact(PIXELS * 3 / 2).take(FRAMES).map(Frame::new).collect())
        }
        None => ("drawn frames".into(), (0..FRAMES as u64).map(|seed| Frame::new(&drawn(seed + 1))).collect()),
    }
}

fn segmenter() -> Segmenter {
    let classes = COLOURS.map(|(name, is_marker, rgb)| ClassSamples {
        name: name.into(),
        is_marker,
        rgb: (0..64).map(|i| Vector3::from(rgb) * (0.9 + 0.2 * f64::from(i) / 63.0)).collect(),
    });
    Segmenter::new(&learn(&classes).expect("colours").models).expect("models")
}

/// The script of today; how many components all masks have.
fn opencv_script(i420: &Mat, scratch: &mut [Mat; 7], kernel: &Mat) -> opencv::Result<i32> {
    let [bgr, hsv, mask, open, labels, stats, centroids] = scratch;
    imgproc::cvt_color_def(i420, bgr, imgproc::COLOR_YUV2BGR_I420)?;
    imgproc::cvt_color_def(bgr, hsv, imgproc::COLOR_BGR2HSV)?;
    let mut count = 0;
    for limits in HSV {
        let [low, high] = limits.map(|[h, s, v]| Scalar::new(h, s, v, 0.0));
        opencv::core::in_range(hsv, &low, &high, mask)?;
        imgproc::morphology_ex_def(mask, open, imgproc::MORPH_OPEN, kernel)?;
        count += imgproc::connected_components_with_stats_def(open, labels, stats, centroids)? - 1;
    }
    Ok(count)
}

fn median(times: &mut [Duration]) -> f64 {
    times.sort_unstable();
    times.get(times.len() / 2).map_or(f64::NAN, Duration::as_secs_f64) * 1e3
}

fn main() -> opencv::Result<()> {
    opencv::core::set_num_threads(1)?;
    let (name, frames) = frames();
    let mut segmenter = segmenter();
    let kernel = imgproc::get_structuring_element_def(imgproc::MORPH_ELLIPSE, Size::new(3, 3))?;
    let mut scratch: [Mat; 7] = std::array::from_fn(|_| Mat::default());
    // What a tracker looks at when it knows where the bands were: six windows of 48 px.
    let windows: Vec<Search> = segmenter
        .all_blobs(&frames[0].picture)
        .expect("colour")
        .iter()
        .map(|b| Search { marker: Some(b.marker), window: Window::around(&b.centre_px, 24.0) })
        .collect();
    let (mut ours, mut windowed, mut theirs) = (Vec::new(), Vec::new(), Vec::new());
    let (mut blobs, mut components) = (0, 0);
    for _ in 0..5 {
        for frame in &frames {
            let start = Instant::now();
            components += black_box(opencv_script(&frame.i420, &mut scratch, &kernel)?);
            theirs.push(start.elapsed());
            let start = Instant::now();
            blobs += black_box(segmenter.all_blobs(&frame.picture)).expect("colour").len();
            ours.push(start.elapsed());
            let start = Instant::now();
            black_box(segmenter.blobs(&frame.picture, &windows)).expect("colour");
            windowed.push(start.elapsed());
        }
    }
    let runs = ours.len();
    let (ours, windowed, theirs) = (median(&mut ours), median(&mut windowed), median(&mut theirs));
    println!("{name}, {WIDTH}x{HEIGHT} 4:2:0, three markers, one thread, median of {runs} interleaved runs");
    println!(
        "OpenCV  cvtColor+inRange+open+connected  {theirs:8.3} ms  {:.1} components a frame",
        f64::from(components) / runs as f64
    );
    println!(
        "catoptra whole frame                     {ours:8.3} ms  {:.1} blobs a frame  {:.1} x faster",
        blobs as f64 / runs as f64,
        theirs / ours
    );
    println!(
        "catoptra {} windows of 48 px              {windowed:8.3} ms  {:.0} x faster",
        windows.len(),
        theirs / windowed
    );
    worst_cases(&mut segmenter)
}

/// Pictures that nothing can be left out of: time must stay bounded.
fn worst_cases(segmenter: &mut Segmenter) -> opencv::Result<()> {
    let full: Vec<u8> = [(0, PIXELS), (1, PIXELS / 4), (2, PIXELS / 4)]
        .into_iter()
        .flat_map(|(channel, n)| std::iter::repeat_n(stored(COLOURS[1].2)[channel].round() as u8, n))
        .collect();
    let mut state = 1_u64;
    let random: Vec<u8> = std::iter::repeat_with(|| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    })
    .take(PIXELS * 3 / 2)
    .collect();
    for (name, bytes) in [("all of one marker's colour", full), ("random samples", random)] {
        let frame = Frame::new(&bytes);
        let mut blobs = 0;
        let mut times: Vec<_> = (0..15)
            .map(|_| {
                let start = Instant::now();
                blobs = black_box(segmenter.all_blobs(&frame.picture)).expect("colour").len();
                start.elapsed()
            })
            .collect();
        println!("worst case, {name:26}    {:8.3} ms  {blobs} blobs", median(&mut times));
    }
    Ok(())
}
