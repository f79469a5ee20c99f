//! Pictures of a board taken with a camera that runs: by a button, or when the board stands still and a picture of it
//! tells something new.
//!
//! It stands still when no corner moves by a pixel from one look to the next. A picture tells something new when the
//! board is elsewhere, or turned, against every picture so far, and the rig that is calibrated with it has a smaller
//! error to be expected, in the base frame or in the camera frame.

use super::boards::{CalibrationInput, Form, folder, unwritten};
use super::camera::SearchedFrame;
use super::desk::Desk;
use super::{Refusal, Reply};
use crate::calibrate::board::grey::Grey;
use crate::calibrate::board::{BoardImage, find_boards};
use crate::calibrate::rig::expected_error::{Expected, Verdict};
use crate::calibrate::rig::initial::BoardsPicture;
use image::DynamicImage;
use serde::Deserialize;
use serde_json::json;
use std::fs::OpenOptions;
use std::io::{Cursor, ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A board that stands still moves by less, pixels, in this time.
const STILL_PX: f64 = 1.0;
const STILL_FOR: Duration = Duration::from_millis(300);
/// Elsewhere is further than this part of a square, RMS over the corners.
const MIN_DISTANCE: f64 = 0.3;
/// A picture lowers the error to be expected in one of the frames at least by this part.
const MIN_IMPROVEMENT: f64 = 0.02;

/// Looks for the board in the newest frame, and judges whether its picture is worth taking.
pub(super) fn judge(desk: &Desk, form: &Form) -> Result<Reply, Refusal> {
    let camera = desk.camera()?;
    let bench = CalibrationInput::of(desk, form)?;
    let frame = camera.current()?;
    let seen = Instant::now();
    let grey = DynamicImage::from(camera.rgb(&frame)?).into_luma8();
    let (width, height) = grey.dimensions();
    let grey = Grey::from_samples(width, height, grey.into_raw()).ok_or_else(|| Refusal::wrong("no picture"))?;
    let found = find_boards(&grey, &bench.board, bench.most);
    let mut last = camera.looked();
    let images = match found {
        Ok(images) => images,
        Err(error) => {
            *last = None;
            let why = error.to_string();
            return Ok(Reply::Json(json!({ "seq": frame.seq, "images": [], "take": false, "why": why })));
        }
    };
    let before = last.as_ref().filter(|last| moved_px(&last.images, &images).is_some_and(|px| px < STILL_PX));
    // The same frame again says nothing of standing still.
    let since = before.map_or(seen, |last| last.since);
    let is_still = before.is_some_and(|last| last.frame.seq != frame.seq) && seen - since >= STILL_FOR;
    let corners: Vec<Vec<[f64; 2]>> =
        images.iter().map(|image| image.corners.iter().map(|(_, at)| [at.x, at.y]).collect()).collect();
    let seq = frame.seq;
    *last = Some(SearchedFrame { frame, images: images.clone(), since });
    drop(last);
    let (take, why) = match is_still {
        false => (false, "hold the board still".to_owned()),
        true => is_worth_it(&bench, images, [width, height]),
    };
    Ok(Reply::Json(json!({ "seq": seq, "images": corners, "still": is_still, "take": take, "why": why })))
}

/// Whether a picture is worth taking, and why or why not.
fn is_worth_it(bench: &CalibrationInput, images: Vec<BoardImage>, size_px: [u32; 2]) -> (bool, String) {
    if images.len() < bench.most {
        let (seen, most) = (images.len(), bench.most);
        return (false, format!("the board is seen in {seen} of {most} views; show it in all of them"));
    }
    if images.iter().any(BoardImage::is_blurred) {
        return (false, "the board is blurred".to_owned());
    }
    let square_px = images.iter().map(|image| image.square_px).fold(f64::INFINITY, f64::min);
    let is_near =
        |other: &BoardsPicture| rms_px(&other.images, &images).is_some_and(|px| px < MIN_DISTANCE * square_px);
    if let Some(other) = bench.found.iter().find(|other| is_near(other)) {
        return (false, format!("it is where it was in {}: move or turn it", other.name));
    }
    let with = BoardsPicture { name: "the next".to_owned(), size_px, images };
    let all: Vec<BoardsPicture> = bench.found.iter().cloned().chain([with]).collect();
    let errors_mm = |pictures: &[BoardsPicture]| {
        let judged: Option<Verdict> = bench.verdict(pictures).ok().flatten();
        let median_mm = |judged: &Verdict, of: fn(&Expected) -> f64| judged.median_and_worst(of).0 * 1e3;
        judged.map(|judged| [median_mm(&judged, |e| e.relative_m), median_mm(&judged, |e| e.absolute_m)])
    };
    match (errors_mm(&bench.found), errors_mm(&all)) {
        (None, _) => (true, "the board has not been in this position before".to_owned()),
        (Some(_), None) => (false, "with it the rig cannot be calibrated any more".to_owned()),
        (Some(before), Some(after)) => adds(before, after),
    }
}

/// Whether errors in the base frame and in the camera frame, before and after, fall enough; and which of them do.
fn adds(before_mm: [f64; 2], after_mm: [f64; 2]) -> (bool, String) {
    let frames = ["base", "camera"].into_iter().zip(before_mm.into_iter().zip(after_mm));
    let (lower, others): (Vec<_>, Vec<_>) =
        frames.partition(|(_, (before, after))| *after < before * (1.0 - MIN_IMPROVEMENT));
    let listed = |frames: &[(&str, (f64, f64))]| {
        let one = |(frame, (before, after)): &_| format!("from {before:.3} to {after:.3} mm in the {frame} frame");
        frames.iter().map(one).collect::<Vec<_>>().join(", ")
    };
    if lower.is_empty() {
        (false, format!("it adds little: the error to be expected goes {}", listed(&others)))
    } else {
        (true, format!("the error to be expected falls {}", listed(&lower)))
    }
}

/// Squared distances between the same corners of two pictures; `None` when they do not show the same.
fn squares_px2(a: &[BoardImage], b: &[BoardImage]) -> Option<Vec<f64>> {
    let of_both = |a: &BoardImage, b: &BoardImage| -> Vec<f64> {
        let pairs = a.corners.iter().zip(&b.corners);
        pairs.map(|(a, b)| if a.0 == b.0 { (a.1 - b.1).norm_squared() } else { f64::INFINITY }).collect()
    };
    let mut squares = Vec::new();
    for image in a {
        // Images of a chessboard are in no order.
        let same = b.iter().filter(|other| other.corners.len() == image.corners.len());
        let all = same.map(|other| of_both(image, other));
        squares.extend(all.min_by(|p, q| p.iter().sum::<f64>().total_cmp(&q.iter().sum()))?);
    }
    (a.len() == b.len() && !squares.is_empty()).then_some(squares)
}

/// By how much the corner that moved most has moved.
fn moved_px(a: &[BoardImage], b: &[BoardImage]) -> Option<f64> {
    Some(squares_px2(a, b)?.into_iter().fold(0.0, f64::max).sqrt())
}

fn rms_px(a: &[BoardImage], b: &[BoardImage]) -> Option<f64> {
    let squares = squares_px2(a, b)?;
    Some((squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Take {
    folder: String,
    /// The frame that was judged; the newest, where none is named.
    seq: Option<u64>,
}

/// Keeps a picture.
pub(super) fn take(desk: &Desk, asked: &Take) -> Result<Reply, Refusal> {
    desk.verbs()?;
    let camera = desk.camera()?;
    let frame = match asked.seq {
        None => camera.current()?,
        Some(seq) => {
            let looked = camera.looked();
            let frame = looked.as_ref().map(|last| &last.frame).filter(|frame| frame.seq == seq).cloned();
            frame.ok_or_else(|| Refusal::wrong(format!("picture {seq} is not here any more")))?
        }
    };
    let mut png = Vec::new();
    let failed = |error: image::ImageError| Refusal::wrong(format!("PNG: {error}"));
    camera.rgb(&frame)?.write_to(&mut Cursor::new(&mut png), image::ImageFormat::Png).map_err(failed)?;
    let path = write(&folder(desk, &asked.folder)?, &png)?;
    Ok(Reply::Json(json!({ "picture": desk.places.shown(&path) })))
}

/// Writes a picture under the first number that is free.
fn write(folder: &Path, png: &[u8]) -> Result<PathBuf, Refusal> {
    let mut number = 1_u32;
    loop {
        let path = folder.join(format!("camera-{number:03}.png"));
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(mut file) => {
                if let Err(error) = file.write_all(png).and_then(|()| file.sync_all()) {
                    // Half a picture is none.
                    let _ = std::fs::remove_file(&path);
                    return Err(unwritten(&path, &error));
                }
                return Ok(path);
            }
            Err(error) if error.kind() == ErrorKind::AlreadyExists && number < u32::MAX => number += 1,
            Err(error) => return Err(unwritten(&path, &error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_that_helps_in_either_frame_is_taken() {
        let said = |before, after| {
            let (take, why) = adds(before, after);
            format!("{take}: {why}")
        };
        assert_eq!(
            said([0.020, 0.5], [0.018, 0.5]),
            "true: the error to be expected falls from 0.020 to 0.018 mm in the base frame"
        );
        assert_eq!(
            said([0.020, 0.5], [0.021, 0.4]),
            "true: the error to be expected falls from 0.500 to 0.400 mm in the camera frame"
        );
        assert_eq!(
            said([0.020, 0.5], [0.018, 0.4]),
            "true: the error to be expected falls from 0.020 to 0.018 mm in the base frame, from 0.500 to 0.400 mm in \
             the camera frame"
        );
        assert_eq!(
            said([0.020, 0.5], [0.020, 0.495]),
            "false: it adds little: the error to be expected goes from 0.020 to 0.020 mm in the base frame, from 0.500 \
             to 0.495 mm in the camera frame"
        );
    }
}
