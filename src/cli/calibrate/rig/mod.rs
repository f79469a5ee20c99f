//! `catoptra calibrate rig`: pictures of a board in a mirror to mirrors, walls and views.

mod args;
mod words;

pub(super) use args::{RigArgs, options};

use super::super::progress::during;
use super::super::{Exit, Failure, provenance};
use super::pictures::{self, SearchedPicture};
use super::{can_be_written, page_beside, save, save_page};
use crate::calibrate::board::{Board, BoardPicture, Grey, Rows};
use crate::calibrate::rig::diagnostics::diagnose;
use crate::calibrate::rig::expected_error::{Verdict, verdict};
use crate::calibrate::rig::held_out::held_out;
use crate::calibrate::rig::initial::BoardsPicture;
use crate::calibrate::rig::{
    Points, RigCalibration, RigCalibrationError, RigOptions, TapedBoard, calibrate_rig, calibrate_rig_from_points,
    into_draft,
};
use crate::report::calibration::{self, CalibrationInfo};
use crate::rig::{Draft, matrix_note};
use args::{BoxSize, Distance, TapedTo};
use nalgebra::Point3;
use std::path::{Path, PathBuf};

/// Largest ratio between the points' residuals and their stated σ, either way.
const SD_RATIO_TOLERANCE: f64 = 1.5;
/// Key of measured distances in the rig's provenance.
const DISTANCES: &str = "distances";

pub(super) fn run(args: &RigArgs, quiet: bool, print: impl Fn(&str) -> Result<(), Failure>) -> Result<(), Failure> {
    let out = args.out();
    can_be_written(out)?;
    let page_path = page_beside(out, "calibration")?;

    let draft = Draft::load(&args.rig)?.with_own_lens(&args.rig)?;
    let mut options = options(args, &draft)?;
    let seen = seen(args, &draft, &mut options, quiet)?;
    let searched = seen.searched();
    let lens = &draft.camera.lens;
    let done = during("solving for mirrors and walls", quiet, || match &seen {
        Seen::Boards { board, found, .. } => calibrate_rig(board, lens, found, &options),
        Seen::Points { points, .. } => calibrate_rig_from_points(points, lens, &options),
    });
    let done = done.map_err(|error| print(&pictures::not_found(searched)).err().unwrap_or_else(|| failure(error)))?;
    let judged = during("judging the errors over the working volume", quiet, || {
        verdict(&done.solution, &done.corners, &seen.places())
    });
    let held = during("leaving out each picture in turn", quiet, || held_out(&done));
    print(&words::describe(&seen, &done, judged.as_ref(), &options))?;
    print(&words::describe_held_out(&held))?;
    for astray in pictures::astray(done.used.iter().map(|(_, picture)| picture), done.solution.corner_sd_px) {
        tracing::warn!("{astray}");
    }
    let warnings = other_sd(&seen, &done).into_iter().chain(shared_pictures(&draft, searched)?);
    for warning in warnings.chain(other_squares(&seen, &draft)) {
        tracing::warn!("{warning}");
    }
    let diagnostics = diagnose(&done, &held);
    let doubts: Vec<String> = diagnostics.iter().map(ToString::to_string).collect();
    doubts.iter().for_each(|doubt| tracing::warn!("doubt: {doubt}"));
    let page = calibration::page(&info(args, out, &seen, &done), &done, judged.as_ref(), &held, &diagnostics);
    let mut rig = into_draft(draft.clone(), &done);
    let left_out = without_colours(&draft, &rig).into_iter().chain(without_base(&draft));
    for said in left_out.chain(without_distances(&draft, args)) {
        tracing::warn!("{said}");
    }
    let mut provenance = provenance(&seen, &done, judged.as_ref(), doubts)?;
    if !args.distances.is_empty() {
        let distances = args.distances.iter().map(|distance| distance.to_string().into());
        provenance.insert(DISTANCES.into(), toml::Value::Array(distances.collect()));
    }
    rig.provenance.insert("rig".into(), provenance.into());
    let written = save(&rig, out)?;
    print(&format!("\n{written}\n"))?;
    save_page(&page, &page_path)?;
    print(&format!("         {} (how good it is, for a browser)\n", page_path.display()))
}

/// The data that the rig is calibrated from.
enum Seen {
    /// Boards in pictures.
    Boards { board: Board, searched: Vec<SearchedPicture>, found: Vec<BoardsPicture> },
    /// A table of points.
    Points { file: PathBuf, points: Points },
}

impl Seen {
    fn searched(&self) -> &[SearchedPicture] {
        match self {
            Self::Boards { searched, .. } => searched,
            Self::Points { .. } => &[],
        }
    }

    fn places(&self) -> Vec<Point3<f64>> {
        match self {
            Self::Boards { board, .. } => board.centred_points(),
            Self::Points { points, .. } => points.places().to_vec(),
        }
    }

    fn pictures(&self) -> usize {
        match self {
            Self::Boards { searched, .. } => searched.len(),
            Self::Points { points, .. } => points.names().len(),
        }
    }
}

/// Says that the lens was calibrated with a board of as many corners, but with squares of another size.
fn other_squares(seen: &Seen, draft: &Draft) -> Option<String> {
    let Seen::Boards { board, .. } = seen else { return None };
    let before: Board = draft.provenance.get("camera")?.get("board")?.as_str()?.parse().ok()?;
    let is_alike = Board { square_m: board.square_m, ..before.clone() } == *board;
    (is_alike && before != *board).then(|| {
        format!(
            "the lens was calibrated with the board {before}, and this is {board}: is it one board, measured twice?"
        )
    })
}

/// Searches the pictures for boards, including those taped to walls, or reads the points.
fn seen(args: &RigArgs, draft: &Draft, options: &mut RigOptions, quiet: bool) -> Result<Seen, Failure> {
    if let Some(file) = &args.points {
        let size_px = draft.camera.size_px;
        let points = Points::read(file, args.mirrors, size_px).map_err(Failure::usage)?;
        if points.may_be_of_smaller_pictures(size_px) {
            tracing::warn!(
                "{}: all points lie in the upper left of the pictures of {} x {} px: were they marked on pictures that \
                 were shown smaller?",
                file.display(),
                size_px[0],
                size_px[1]
            );
        }
        return Ok(Seen::Points { file: file.clone(), points });
    }
    let Some(board) = args.board.clone() else {
        return Err(Failure::usage("give --board with the pictures, or --points in place of both"));
    };
    for TapedTo { wall, picture, thickness_m } in &args.walls {
        for found in pictures::search(std::slice::from_ref(picture), &board, 1, quiet)? {
            fits(&found, args, draft)?;
            let unseen = |why: &String| Failure::new(Exit::Unusable, format!("{}: {why}", found.path.display()));
            let image = found.images.as_ref().map_err(unseen)?.first().cloned();
            let picture = image.map(|image| BoardPicture { name: found.name.clone(), size_px: found.size_px, image });
            let taped = |picture| TapedBoard { wall: wall.clone(), picture, thickness_m: *thickness_m };
            options.taped.extend(picture.map(taped));
        }
    }
    let searched = pictures::search(&args.pictures, &board, args.mirrors + 1, quiet)?;
    for picture in &searched {
        fits(picture, args, draft)?;
    }
    let found = searched
        .iter()
        .filter_map(|s| {
            Some(BoardsPicture { name: s.name.clone(), size_px: s.size_px, images: s.images.as_ref().ok()?.clone() })
        })
        .collect();
    Ok(Seen::Boards { board, searched, found })
}

/// Information about the run for the page.
fn info(args: &RigArgs, out: &Path, seen: &Seen, done: &RigCalibration) -> CalibrationInfo {
    let mm = |length_m: f64| format!("{:.2} mm", length_m * 1e3);
    let searched = seen.searched();
    let mut settings = vec![match seen {
        Seen::Boards { board, .. } => ("Board".to_owned(), board.to_string()),
        Seen::Points { file, .. } => ("Points".to_owned(), file.display().to_string()),
    }];
    if let Some(glass) = args.glass {
        let size = args.tank.map_or(String::new(), |BoxSize(sides)| format!("{}, ", sides.map(mm).join(" x ")));
        settings.push(("Tank".to_owned(), format!("{size}glass {} of index {}", mm(glass.0), args.index_glass)));
        settings.push(("Water".to_owned(), format!("{} °C", args.temperature)));
    }
    for Distance { name, distance_m, sd_m } in &args.distances {
        settings.push((format!("Distance of {name}"), format!("{} ± {}", mm(*distance_m), mm(*sd_m))));
    }
    let not_found = searched.iter().filter_map(|s| Some((s.name.clone(), s.images.as_ref().err()?.clone()))).collect();
    for TapedTo { wall, thickness_m, .. } in &args.walls {
        settings.push((format!("Board on {wall}"), format!("print {} in front of it", mm(*thickness_m))));
    }
    settings.extend(provenance::of_this_run());
    // Read again: all pictures kept in memory would be gigabytes.
    let again = |name: String| {
        let picture = searched.iter().find(|s| s.name == name)?;
        let grey = Grey::load(&picture.path, Rows::AsStored).map_err(|error| error.to_string());
        Some((name, grey))
    };
    let boards = calibration::shown(done).into_iter().filter_map(again).collect();
    CalibrationInfo { rig: out.display().to_string(), settings, not_found, boards }
}

/// Checks that pictures have the size that the lens was calibrated for.
fn fits(picture: &SearchedPicture, args: &RigArgs, draft: &Draft) -> Result<(), Failure> {
    let (found, expected) = (picture.size_px, draft.camera.size_px);
    if found == expected {
        return Ok(());
    }
    let (path, rig) = (picture.path.display(), args.rig.display());
    let [found, expected] = [found, expected].map(|[width, height]| format!("{width}x{height}"));
    Err(Failure::usage(format!(
        "{path} has {found} pixels, but {rig} was calibrated for {expected}: pictures must be as the camera stored \
         them, neither resized nor turned"
    )))
}

/// A warning when points are not as accurate as they were stated to be.
fn other_sd(seen: &Seen, done: &RigCalibration) -> Option<String> {
    let Seen::Points { points, .. } = seen else { return None };
    let (given_px, found_px) = (points.given_sd_px()?, done.solution.corner_sd_px);
    let is_as_stated = (1.0 / SD_RATIO_TOLERANCE..SD_RATIO_TOLERANCE).contains(&(found_px / given_px));
    (!is_as_stated).then(|| {
        format!(
            "points were stated to be good to {given_px:.2} px, but are off by {found_px:.2}: σ are based on the latter"
        )
    })
}

/// Says which bands have lost their colours: they had none for one of the new views.
fn without_colours(before: &Draft, after: &Draft) -> Option<String> {
    let pairs = before.markers.iter().zip(&after.markers);
    let lost = pairs.filter(|(before, after)| !before.colours.is_empty() && after.colours.is_empty());
    let lost: Vec<&str> = lost.map(|(marker, _)| marker.name.as_str()).collect();
    let names = |draft: &Draft| draft.views.iter().map(|view| view.name.as_str()).collect::<Vec<_>>().join(", ");
    (!lost.is_empty()).then(|| {
        format!(
            "the colours of {} are left out: they were not learned for all of the views, which are now {}; teach the \
             bands again (catoptra calibrate markers)",
            lost.join(", "),
            names(after)
        )
    })
}

/// Says that the base frame was measured with the rig as it was.
fn without_base(before: &Draft) -> Option<String> {
    let left_out = "the base frame ([base]) is left out: it was measured with the rig as it was; measure it again \
                    (catoptra calibrate base)";
    before.base.is_some().then(|| left_out.to_owned())
}

/// Says which measured distances the rig had and has no more.
fn without_distances(before: &Draft, args: &RigArgs) -> Option<String> {
    let had = before.provenance.get("rig")?.get(DISTANCES)?.as_array()?;
    let had: Vec<&str> = had.iter().filter_map(toml::Value::as_str).collect();
    (!had.is_empty() && args.distances.is_empty()).then(|| {
        let again = had.iter().map(|distance| format!("--distance {distance}")).collect::<Vec<_>>().join(" ");
        format!("measured distances of the rig as it was are not used: if they are still right, add {again}")
    })
}

/// A warning when pictures were already used for the lens.
fn shared_pictures(draft: &Draft, searched: &[SearchedPicture]) -> Result<Option<String>, Failure> {
    let of_lens = draft.provenance.get("camera").and_then(|camera| camera.get("inputs_sha256")?.as_table());
    let Some(of_lens) = of_lens else { return Ok(None) };
    let mut names = Vec::new();
    for picture in searched.iter().filter(|picture| picture.images.is_ok()) {
        let hash = pictures::hash_of(&picture.path)?;
        if of_lens.values().any(|known| known.as_str() == Some(&hash)) {
            names.push(picture.name.as_str());
        }
    }
    Ok((!names.is_empty()).then(|| {
        format!(
            "{} of the pictures served for the lens too, so that what is wrong in them counts twice and σ are too \
             small: take others ({})",
            names.len(),
            names.join(", ")
        )
    }))
}

fn failure(error: RigCalibrationError) -> Failure {
    let exit = if matches!(error, RigCalibrationError::NoSurface { .. }) { Exit::Usage } else { Exit::Unusable };
    Failure::new(exit, error)
}

fn provenance(
    seen: &Seen,
    done: &RigCalibration,
    judged: Option<&Verdict>,
    doubts: Vec<String>,
) -> Result<toml::Table, Failure> {
    let mut table = match seen {
        Seen::Boards { board, searched, .. } => pictures::provenance("rig", board, searched)?,
        Seen::Points { file, .. } => pictures::provenance_of_points("rig", file)?,
    };
    let solution = &done.solution;
    table.insert("corner_sd_px".into(), solution.corner_sd_px.into());
    let surface = |index: usize| solution.geometry.surfaces.get(index).map_or("", |(name, _)| name.as_str());
    let names = solution.free.iter().map(|p| toml::Value::from(p.name(surface)));
    table.insert("parameters".into(), names.collect::<Vec<_>>().into());
    table.insert("covariance".into(), matrix_note(&solution.covariance));
    let noise: Vec<toml::Value> = solution.noise_covariance.diagonal().iter().map(|v| v.sqrt().into()).collect();
    table.insert("sd_by_noise".into(), noise.into());
    if let Some(judged) = judged {
        let corners =
            judged.filled.map(|corner| toml::Value::from(corner.iter().map(|m| m * 1e3).collect::<Vec<f64>>()));
        table.insert("volume_mm".into(), corners.to_vec().into());
    }
    table.insert("doubts".into(), doubts.into());
    Ok(table)
}
