//! The calibration to be expected of a rig that has none: boards in air and in the rig, as `catoptra simulate --boards`
//! draws them, their corners projected, with noise, and adjusted as `calibrate` does.

use super::super::board_poses::{BoardPoses, BoardSet};
use super::super::centre_line::CentreLine;
use super::super::mount::Mount;
use super::super::sensor::Sensor;
use super::CalibrationErrorSource;
use crate::calibrate::board::Board;
use crate::calibrate::bundle::prior::Prior;
use crate::calibrate::bundle::shape::Shape;
use crate::calibrate::bundle::{Bundle, Corner};
use crate::calibrate::geometry::{Geometry, Parameter};
use crate::calibrate::rig::share::recorded_geometry;
use crate::normal::normal;
use crate::optics::Surface;
use crate::rig::{Draft, Rig};
use nalgebra::Point2;

/// Pictures of each kind, the board, and how well its corners are found, pixels.
const PICTURES: usize = 14;
const BOARD: &str = "9x6:12mm";
const CORNER_SD_PX: f64 = 0.06;
/// A wall's distance from the lens is measured with a tape.
const TAPE_SD_M: f64 = 2e-3;

/// The rig with a covariance of its geometry: its own, or that to be expected.
pub(super) fn with_covariance(
    draft: &Draft,
    rig: &Rig,
    mount: &Mount,
    rest: &CentreLine,
) -> (Draft, CalibrationErrorSource) {
    if recorded_geometry(draft).is_some() {
        return (draft.clone(), CalibrationErrorSource::Noted);
    }
    match expected(draft, rig, mount, rest) {
        Ok(with) => (with, CalibrationErrorSource::Expected { pictures: PICTURES, corner_sd_px: CORNER_SD_PX }),
        Err(why) => (draft.clone(), CalibrationErrorSource::Unknown(why)),
    }
}

fn expected(draft: &Draft, rig: &Rig, mount: &Mount, rest: &CentreLine) -> Result<Draft, String> {
    let board: Board = BOARD.parse().map_err(|e: crate::calibrate::board::BoardError| e.to_string())?;
    let geometry = Geometry::of(rig.camera.lens, &draft.surfaces, &rig.views);
    let mut geometry = geometry.ok_or("a view's path has a surface that the rig does not have")?;
    // Pictures in air are another view: nothing is before the camera.
    let air = geometry.views.len();
    geometry.views.push(("air".to_owned(), Vec::new()));
    let around = rest.at(mount.length_m / 2.0).0;
    let places = board.centred_points();
    let mut random = fastrand::Rng::with_seed(11);
    let (mut poses, mut corners) = (Vec::new(), Vec::new());
    for (set, shown) in [(BoardSet::Air, vec![air]), (BoardSet::Rig, (0..air).collect())] {
        let standing = BoardPoses::new(rig, set, around);
        let boards = standing.boards(board.clone(), 0.55, Sensor::IDEAL);
        for pose in standing.poses(&boards, PICTURES, 5).map_err(|e| e.to_string())? {
            for view in &shown {
                let path = geometry.path(*view);
                for place in &places {
                    let at = path.project(&(pose * place)).map_err(|e| e.to_string())?;
                    let mut noise = || CORNER_SD_PX * normal(&mut random);
                    let pixel = Point2::new(at.x + noise(), at.y + noise());
                    corners.push(Corner { picture: poses.len(), view: *view, place: *place, pixel, relative_sd: 1.0 });
                }
            }
            poses.push(pose);
        }
    }
    let used: Vec<usize> = (0..geometry.surfaces.len())
        .filter(|surface| geometry.views.iter().any(|(_, path)| path.contains(surface)))
        .collect();
    let mut free: Vec<Parameter> = used.iter().flat_map(|surface| Parameter::of_surface(*surface)).collect();
    free.extend(Parameter::of_lens(&geometry.lens));
    let walls = used.iter().filter(|surface| {
        // Of the walls that the camera looks at first.
        geometry.views.iter().any(|(_, path)| path.first() == Some(surface))
            && matches!(geometry.surfaces.get(**surface), Some((_, Surface::Wall(_))))
    });
    let known = walls
        .map(|surface| {
            let distance_m = geometry.value(Parameter::Offset { surface: *surface }).abs();
            Prior::Distance { surface: *surface, distance_m, sd_m: TAPE_SD_M }
        })
        .collect();
    let names = (0..poses.len()).map(|k| format!("{k}")).collect();
    let bundle = Bundle { geometry, free, poses, names, corners, known, shape: Shape::flat(&places) };
    let solution = bundle.solve().map_err(|e| e.to_string())?;
    let named = |surface: usize| solution.geometry.surfaces.get(surface).map_or("", |(name, _)| name.as_str());
    let parameters = solution.free.iter().map(|p| toml::Value::String(p.name(named))).collect();
    let rows = solution.covariance.row_iter();
    let covariance = rows.map(|row| toml::Value::Array(row.iter().map(|v| toml::Value::Float(*v)).collect())).collect();
    let mut table = toml::Table::new();
    table.insert("parameters".to_owned(), toml::Value::Array(parameters));
    table.insert("covariance".to_owned(), toml::Value::Array(covariance));
    let mut with = draft.clone();
    with.provenance.insert("rig".to_owned(), toml::Value::Table(table));
    Ok(with)
}
