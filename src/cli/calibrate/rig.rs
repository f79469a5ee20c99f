//! `catoptra calibrate rig`: pictures of a board in a mirror to mirrors, walls and views.

use super::super::progress::during;
use super::super::{Exit, Failure, provenance};
use super::pictures::{self, SearchedPicture};
use super::{Length, can_be_written, save, save_page};
use crate::calibrate::board::{Board, BoardPicture, Grey, Rows};
use crate::calibrate::bundle::{NoSolution, surface_sd};
use crate::calibrate::geometry::Parameter;
use crate::calibrate::rig::diagnostics::diagnose;
use crate::calibrate::rig::expected_error::{Verdict, verdict};
use crate::calibrate::rig::held_out::{HeldOut, LengthErrors, held_out};
use crate::calibrate::rig::initial::BoardsPicture;
use crate::calibrate::rig::{
    Points, RigCalibration, RigCalibrationError, RigOptions, Tank, calibrate_rig, calibrate_rig_from_points,
    into_draft, water_index,
};
use crate::report::calibration::{self, CalibrationInfo};
use crate::rig::Draft;
use nalgebra::Point3;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Largest ratio between the points' residuals and their stated σ, either way.
const SD_RATIO_TOLERANCE: f64 = 1.5;
/// Prior σ of the index when it is fitted.
const INDEX_SD: f64 = 5e-3;

#[derive(Debug, clap::Args)]
pub(super) struct RigArgs {
    /// Pictures that show the board directly and in the mirror, or a folder of them
    #[arg(value_name = "PICTURES", required_unless_present = "points")]
    pictures: Vec<PathBuf>,
    /// In place of pictures: marked points, columns picture, view, u_px, v_px, x_mm, y_mm, z_mm (sd_px)
    #[arg(long, value_name = "POINTS.csv", conflicts_with_all = ["pictures", "board", "walls"])]
    points: Option<PathBuf>,
    /// The board: inner corners in a row and in a column, size of a square; or, counting SQUARES, a ChArUco board:
    /// charuco:5x7:30mm:22mm:DICT_4X4_50 (square, marker, dictionary; `:legacy` after it for OpenCV's old pattern)
    #[arg(long, value_name = "9x6:12mm", required_unless_present = "points")]
    board: Option<Board>,
    /// The rig file with the camera, from `catoptra calibrate camera`
    #[arg(long, value_name = "RIG.toml")]
    pub(super) rig: PathBuf,
    /// How many mirrors
    #[arg(long, value_name = "N", default_value_t = 1)]
    mirrors: usize,
    /// Thickness of the tank's glass; without it, the board was in air
    #[arg(long, value_name = "5mm", value_parser = Length::from_str)]
    glass: Option<Length>,
    /// The tank is a box: outer width, depth and height as the camera faces it
    #[arg(long, value_name = "WxDxHmm", requires = "glass")]
    tank: Option<BoxSize>,
    /// The mirrors stand in the tank
    #[arg(long, requires = "glass")]
    mirrors_inside: bool,
    /// Refractive index of the glass (acrylic: 1.49)
    #[arg(long, value_name = "N", default_value_t = 1.52, requires = "glass")]
    index_glass: f64,
    /// Temperature of the water, °C, from which its index follows
    #[arg(long, value_name = "°C", default_value_t = 20.0, requires = "glass")]
    temperature: f64,
    /// Let the index of the water be fitted: it trades off against distances
    #[arg(long, requires = "glass")]
    fit_index: bool,
    /// Measured distance of a surface's plane from the lens, and its σ; may be repeated
    #[arg(long = "distance", value_name = "NAME=1265mm:2mm")]
    distances: Vec<Distance>,
    /// A picture of the board taped flat to the outer face of a wall; may be repeated
    #[arg(long = "wall", value_name = "NAME=PICTURE", value_parser = wall_arg)]
    walls: Vec<(String, PathBuf)>,
    /// Rig file to write [default: the one given by --rig]
    #[arg(long, short, value_name = "RIG.toml")]
    out: Option<PathBuf>,
}

/// Outer size of a box, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
struct BoxSize([f64; 3]);

impl FromStr for BoxSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("`{text}` is not a box: write WIDTHxDEPTHxHEIGHT with a unit, for example 254x254x267mm");
        let unit = text.trim().trim_start_matches(|c: char| c.is_ascii_digit() || c == '.' || c == 'x');
        let numbers = text.trim().strip_suffix(unit).unwrap_or_default();
        let sides: Vec<f64> = numbers
            .split('x')
            .map(|side| format!("{side}{unit}").parse::<Length>().map(|length| length.0).map_err(|_| wrong()))
            .collect::<Result<_, _>>()?;
        sides.try_into().map(Self).map_err(|_| wrong())
    }
}

#[derive(Debug, Clone, PartialEq)]
struct Distance {
    name: String,
    distance_m: f64,
    sd_m: f64,
}

impl FromStr for Distance {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a distance: write NAME=DISTANCE:σ, for example front_wall=1265mm:2mm");
        let (name, rest) = text.split_once('=').ok_or_else(wrong)?;
        let (distance, sd) = rest.split_once(':').ok_or_else(wrong)?;
        let length = |text: &str| text.parse::<Length>().map(|l| l.0).map_err(|_| wrong());
        Ok(Self { name: name.trim().to_owned(), distance_m: length(distance)?, sd_m: length(sd)? })
    }
}

fn wall_arg(text: &str) -> Result<(String, PathBuf), String> {
    let wrong = || format!("`{text}` is not a wall: write NAME=PICTURE, for example front_wall=taped.png");
    let (name, picture) = text.split_once('=').ok_or_else(wrong)?;
    Ok((name.trim().to_owned(), picture.into()))
}

impl RigArgs {
    /// The rig file to write.
    pub(super) fn out(&self) -> &PathBuf {
        self.out.as_ref().unwrap_or(&self.rig)
    }
}

pub(super) fn run(args: &RigArgs, quiet: bool, print: impl Fn(&str) -> Result<(), Failure>) -> Result<(), Failure> {
    let out = args.out();
    can_be_written(out)?;

    let draft = Draft::load(&args.rig)?;
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
    print(&describe(&seen, &done, judged.as_ref(), &options))?;
    print(&describe_held_out(&held))?;
    for astray in pictures::astray(done.used.iter().map(|(_, picture)| picture), done.solution.corner_sd_px) {
        tracing::warn!("{astray}");
    }
    let warnings = other_sd(&seen, &done).into_iter().chain(shared_pictures(&draft, searched)?);
    for warning in warnings.chain(other_squares(&seen, &draft)) {
        tracing::warn!("{warning}");
    }
    let doubts: Vec<String> = diagnose(&done, &held).iter().map(ToString::to_string).collect();
    doubts.iter().for_each(|doubt| tracing::warn!("doubt: {doubt}"));
    let page = calibration::page(&info(args, out, &seen, &done), &done, judged.as_ref(), &held);
    let mut rig = into_draft(draft, &done);
    rig.provenance.insert("rig".into(), provenance(&seen, &done, judged.as_ref(), doubts)?.into());
    let written = save(&rig, out)?;
    print(&format!("\n{written}\n"))?;
    let page_path = out.with_extension("calibration.html");
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
        let points = Points::read(file, args.mirrors).map_err(Failure::usage)?;
        return Ok(Seen::Points { file: file.clone(), points });
    }
    let Some(board) = args.board.clone() else {
        return Err(Failure::usage("give --board with the pictures, or --points in place of both"));
    };
    for (name, path) in &args.walls {
        for found in pictures::search(std::slice::from_ref(path), &board, 1, quiet)? {
            fits(&found, args, draft)?;
            let unseen = |why: &String| Failure::new(Exit::Unusable, format!("{}: {why}", found.path.display()));
            let image = found.images.as_ref().map_err(unseen)?.first().cloned();
            let picture = image.map(|image| BoardPicture { name: found.name.clone(), size_px: found.size_px, image });
            options.taped.extend(picture.map(|picture| (name.clone(), picture)));
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

pub(super) fn options(args: &RigArgs, draft: &Draft) -> Result<RigOptions, Failure> {
    if args.mirrors == 0 {
        return Err(Failure::usage("--mirrors 0: a rig needs a mirror, one or more"));
    }
    let tank = args
        .glass
        .map(|glass| {
            if !(1.0..=3.0).contains(&args.index_glass) {
                return Err(Failure::usage(format!("--index-glass {}: expected 1 to 3", args.index_glass)));
            }
            let index_inside = water_index(args.temperature)
                .ok_or_else(|| Failure::usage(format!("--temperature {}: expected 0 to 50 °C", args.temperature)))?;
            Ok(Tank {
                glass_m: glass.0,
                index_glass: args.index_glass,
                index_inside,
                size_m: args.tank.map(|size| size.0),
                mirrors_inside: args.mirrors_inside,
            })
        })
        .transpose()?;
    Ok(RigOptions {
        mirrors: args.mirrors,
        tank,
        lens_covariance: draft.lens_covariance(),
        distances_m: args.distances.iter().map(|d| (d.name.clone(), d.distance_m, d.sd_m)).collect(),
        taped: Vec::new(),
        index_sd: args.fit_index.then_some(INDEX_SD),
    })
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
    let rows = solution.covariance.row_iter().map(|row| row.iter().copied().collect::<Vec<f64>>().into());
    table.insert("covariance".into(), rows.collect::<Vec<toml::Value>>().into());
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

fn describe(seen: &Seen, done: &RigCalibration, judged: Option<&Verdict>, options: &RigOptions) -> String {
    let mut text = pictures::table(seen.searched(), done.used.iter().map(|(_, picture)| picture), &done.left_out);
    let solution = &done.solution;
    let _ = writeln!(
        text,
        "\n{} of {} pictures used, corners good to {}\n\nsurface      normal                          σ  of noise      \
         offset mm       σ  of noise",
        done.used.len(),
        seen.pictures(),
        pictures::rms(solution.corner_sd_px)
    );
    for (surface, (name, optics)) in solution.geometry.surfaces.iter().enumerate() {
        let plane = optics.plane();
        let n = plane.normal();
        let (tilt, offset) = surface_sd(surface, |parameter| solution.sd(parameter));
        let (tilt_by_noise, offset_by_noise) = surface_sd(surface, |parameter| {
            Some(solution.sd_in(&solution.noise_covariance, parameter)?.min(solution.sd(parameter)?))
        });
        let degrees = |sd: Option<f64>| sd.map_or("fixed".to_owned(), |sd| format!("{:.3}°", sd.to_degrees()));
        let mm = |sd: Option<f64>| sd.map_or("fixed".to_owned(), |sd| format!("{:.2}", sd * 1e3));
        let _ = writeln!(
            text,
            "{name:<12} {:+.5} {:+.5} {:+.5}   {:>7}   {:>7}   {:>12.2}  {:>6}  {:>8}",
            n.x,
            n.y,
            n.z,
            degrees(tilt),
            degrees(tilt_by_noise),
            plane.offset_m() * 1e3,
            mm(offset),
            mm(offset_by_noise)
        );
    }
    if options.lens_covariance.is_none() {
        text +=
            "\nthe rig file has no covariance of the lens (calibrate camera writes it): the lens is taken as exact\n";
    }
    if options.index_sd.is_some() {
        let _ = writeln!(
            text,
            "\nindex of the water {:.4} ± {}: it trades off against distances, a thermometer knows it better",
            solution.geometry.value(Parameter::IndexInside),
            solution.sd(Parameter::IndexInside).map_or("fixed".to_owned(), |sd| format!("{sd:.4}"))
        );
    }
    match judged {
        Some(judged) => text += &describe_verdict(judged),
        None => text += "\nno verdict: the boards fill no volume that two views see\n",
    }
    text
}

fn describe_verdict(judged: &Verdict) -> String {
    let line = |what: &str, (median_m, worst_m): (f64, f64)| {
        format!("{what:<34} {:>8.3}   {:>8.3}\n", median_m * 1e3, worst_m * 1e3)
    };
    let [low, high] = judged.filled;
    let side = |axis: usize| format!("{:.0} to {:.0}", low[axis] * 1e3, high[axis] * 1e3);
    let mut text = format!(
        "\nin the boards' volume, x {}, y {}, z {} mm of the camera frame (outside of it, errors grow quickly):\n\
         expected error in space, mm (1σ)     median      worst place\n",
        side(0),
        side(1),
        side(2)
    );
    text += &line("of the camera frame (all together)", judged.median_and_worst(|e| e.absolute_m));
    text += &line("of the base frame, displacements", judged.median_and_worst(|e| e.relative_m));
    let (median_rad, worst_rad) = judged.angle_rad;
    let _ = writeln!(text, "{:<34} {:>8.4}°  {:>8.4}°", "of angles", median_rad.to_degrees(), worst_rad.to_degrees());
    text += &line("of a single corner, random", judged.median_and_worst(|e| e.random_m));
    let (direction, sd_m) = judged.weakest;
    let _ = writeln!(
        text,
        "weakest: everything together along ({:+.2}, {:+.2}, {:+.2}), by {:.2} mm; positions in the base frame and \
         angles do not see it",
        direction.x,
        direction.y,
        direction.z,
        sd_m * 1e3
    );
    for (frame, best) in [("base", judged.helpful_relative()), ("camera", judged.helpful_absolute())] {
        if let Some(best) = best.first() {
            let (what, relative_mm, absolute_mm) = (&best.what, best.relative_m * 1e3, best.absolute_m * 1e3);
            let _ = writeln!(
                text,
                "what would help most in the {frame} frame: {what} (base frame {relative_mm:.4} mm, camera frame \
                 {absolute_mm:.2} mm)"
            );
        }
    }
    text
}

/// Lines about the check on held-out pictures.
fn describe_held_out(held: &[Result<HeldOut, NoSolution>]) -> String {
    let mut text = String::new();
    let edges = LengthErrors::of(held.iter().flatten().flat_map(|h| &h.edges));
    let diagonals = LengthErrors::of(held.iter().flatten().flat_map(|h| &h.diagonals));
    if let (Some(edges), Some(diagonals)) = (edges, diagonals) {
        let _ = writeln!(
            text,
            "held out in turn, {} edges of {:.1} mm are off by {:.3} mm RMS (corner noise explains {:.3}), {} \
             diagonals of {:.1} mm by {:.3} mm ({:.3})",
            edges.count,
            edges.nominal_m * 1e3,
            edges.rms_m * 1e3,
            edges.noise_m * 1e3,
            diagonals.count,
            diagonals.nominal_m * 1e3,
            diagonals.rms_m * 1e3,
            diagonals.noise_m * 1e3
        );
    }
    let failed = held.iter().filter(|held| held.is_err()).count();
    if failed > 0 {
        let _ = writeln!(
            text,
            "{failed} of {} pictures could not be held out: without each of them the rig is open",
            held.len()
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_that_cannot_be_held_out_are_counted() {
        let held = HeldOut { edges: Vec::new(), diagonals: Vec::new(), scale: None, rays_m: Vec::new() };
        assert_eq!(describe_held_out(&[Ok(held.clone())]), "");
        let told = describe_held_out(&[Ok(held), Err(NoSolution::Singular), Err(NoSolution::NotConverged)]);
        assert!(told.starts_with("2 of 3 pictures could not be held out"), "{told}");
    }

    #[test]
    fn boxes_and_distances_as_people_write_them() {
        let size = "254x250.5x267mm".parse::<BoxSize>().unwrap().0;
        assert!((size[0] - 0.254).abs() < 1e-12 && (size[1] - 0.2505).abs() < 1e-12 && (size[2] - 0.267).abs() < 1e-12);
        let distance = "front_wall=1265mm:2mm".parse::<Distance>().unwrap();
        assert_eq!(distance.name, "front_wall");
        assert!((distance.distance_m - 1.265).abs() < 1e-12 && (distance.sd_m - 2e-3).abs() < 1e-12);
        for text in ["254x254mm", "254x254x267", "254x254x267x1mm", "axbxcmm", "254x-1x2mm"] {
            assert!(text.parse::<BoxSize>().unwrap_err().contains("254x254x267mm"), "{text}");
        }
        for text in ["front_wall", "front_wall=12mm", "front_wall=12:2mm", "front_wall=12mm:0mm"] {
            assert!(text.parse::<Distance>().unwrap_err().contains("1265mm:2mm"), "{text}");
        }
    }
}
