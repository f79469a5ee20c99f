//! Lenses from boards in air: found, and sets that are refused.

use super::{SIZE_PX, board, gaussian, lens};
use crate::calibrate::board::{BoardImage, BoardPicture};
use crate::calibrate::bundle::outliers::LeftOut;
use crate::calibrate::camera::{CameraError, LensModel, calibrate_camera};
use crate::calibrate::geometry::{Geometry, Projector};
use crate::optics::{Lens, OpticalPath};
use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion, Vector2, Vector3};

/// Boards in air with the given rotations, each at its own place.
pub(super) fn air(turns: &[[f64; 3]], sd_px: f64) -> Vec<BoardPicture> {
    let (places, mut random) = (board().centred_points(), gaussian(3));
    let geometry = Geometry { lens: lens(), surfaces: Vec::new(), views: vec![("air".into(), Vec::new())] };
    let projector = Projector::new(&geometry, &[]);
    turns
        .iter()
        .enumerate()
        .map(|(i, turn)| {
            let at = |k: usize, half: f64| half * f64::from(i32::try_from((i * k) % 5).unwrap() - 2) / 2.0;
            let middle = Translation3::new(at(1, 0.06), at(2, 0.05), 0.45 + at(3, 0.05));
            let pose = Isometry3::from_parts(middle, UnitQuaternion::from_scaled_axis(Vector3::from(*turn)));
            let mut noisy = |i: usize| {
                (i, projector.pixel(0, &(pose * places[i])).unwrap() + Vector2::new(random(), random()) * sd_px)
            };
            let corners = (0..places.len()).map(&mut noisy).collect();
            let image = BoardImage { corners, mirrored: None, square_px: 40.0, edge_px: 2.0, contrast: 100.0 };
            BoardPicture { name: format!("{i}.png"), size_px: SIZE_PX, image }
        })
        .collect()
}

pub(super) const TILTS: [[f64; 3]; 8] = [
    [0.5, 0.0, 0.0],
    [-0.5, 0.1, 0.3],
    [0.0, 0.5, 0.0],
    [0.1, -0.5, 0.2],
    [0.4, 0.4, 1.5],
    [-0.4, 0.4, 0.0],
    [0.4, -0.4, 0.1],
    [0.0, 0.1, 0.0],
];

#[test]
fn a_lens_is_found_and_pictures_that_mislead_are_left_out_by_name() {
    let mut pictures = air(&TILTS, 0.05);
    pictures.push(BoardPicture { name: "again.png".into(), ..pictures[3].clone() });
    // A board that was bent: some of its corners are off by a pixel.
    let mut bent = air(&[[0.3, 0.2, 0.0]], 0.05).remove(0);
    bent.name = "bent.png".into();
    for (i, pixel) in &mut bent.image.corners {
        pixel.x += 2.0 * (*i as f64).sin();
    }
    pictures.push(bent);
    let mut shaken = air(&[[-0.3, 0.2, 0.0]], 0.05).remove(0);
    shaken.name = "shaken.png".into();
    shaken.image.edge_px = 16.0;
    pictures.insert(0, shaken);
    let mut found = calibrate_camera(&board(), &pictures, LensModel::Five).unwrap();
    assert_eq!(found.used.len(), 8);
    assert_eq!(
        found.left_out.remove(0).1.to_string(),
        "it is blurred: edges 16 px wide on squares of 40 px; hold the board still, focus, more light"
    );
    assert_eq!(found.left_out[0], ("again.png".into(), LeftOut::Duplicate("3.png".into())));
    assert!(matches!(&found.left_out[1], (name, LeftOut::Off { .. }) if name == "bent.png"), "{:?}", found.left_out);
    for (axis, truth) in lens().focal_px.iter().enumerate() {
        let sd = found.covariance[(axis, axis)].sqrt();
        assert!(
            (found.lens.focal_px[axis] - truth).abs() < 3.5 * sd && sd < 10.0,
            "{} ± {sd}",
            found.lens.focal_px[axis]
        );
    }
    assert!((0.04..0.06).contains(&found.corner_sd_px), "{}", found.corner_sd_px);
}

#[test]
fn sets_that_leave_the_lens_open_are_refused_with_the_reason() {
    let error = |pictures: &[BoardPicture]| calibrate_camera(&board(), pictures, LensModel::Five).unwrap_err();
    assert!(matches!(error(&air(&TILTS[..3], 0.05)), CameraError::TooFew { found: 3, .. }));
    assert!(matches!(error(&[]), CameraError::TooFew { found: 0, .. }));
    let same = vec![air(&TILTS[..1], 0.0).remove(0); 9];
    assert!(matches!(error(&same), CameraError::TooFew { found: 1, .. }));
    let parallel = error(&air(&[[0.05, 0.03, 0.0]; 8], 0.05));
    assert!(matches!(parallel, CameraError::Parallel { .. } | CameraError::Open { .. }), "{parallel}");
    // Three tilts, each five times in nearly the same place.
    let mut moved = gaussian(4);
    let bursts: Vec<BoardPicture> = air(&[TILTS[0], TILTS[2], TILTS[3]], 0.05)
        .into_iter()
        .flat_map(|picture| vec![picture; 5])
        .map(|mut picture| {
            let shake = Vector2::new(moved(), moved()) * 5.0;
            picture.image.corners.iter_mut().for_each(|(_, pixel)| *pixel += shake);
            picture
        })
        .collect();
    let alike = error(&bursts);
    assert!(matches!(alike, CameraError::Alike { found: 3, .. }), "{alike}");
    let mut mixed = air(&TILTS, 0.05);
    mixed[4].size_px = [1024, 1280];
    let text = error(&mixed).to_string();
    assert!(text.starts_with("4.png has 1024x1280 pixels, 0.png has 1280x1024"), "{text}");
}

/// A wide lens of the rational model, boards out to the corners: found with eight parameters, and refused with five.
#[test]
fn a_rational_lens_is_found_with_eight_parameters_and_refused_with_five() {
    let wide = Lens {
        focal_px: Vector2::new(620.0, 622.0),
        principal_point_px: Point2::new(633.0, 507.0),
        distortion: [0.9, 0.25, 3e-4, -2e-4, 0.01],
        denominator: [1.25, 0.5, 0.06],
    };
    let path = OpticalPath { lens: wide, surfaces: Vec::new() };
    let places = board().centred_points();
    let mut random = gaussian(77);
    let mut pictures = Vec::new();
    for turn in 0..40 {
        let mut around = |half: f64| half * random().clamp(-1.8, 1.8);
        let tilt = Vector3::new(around(0.35), around(0.35), around(0.8));
        let middle = Translation3::new(around(0.045), around(0.035), 0.06 + around(0.008));
        let pose = Isometry3::from_parts(middle, UnitQuaternion::from_scaled_axis(tilt));
        let pixels: Option<Vec<_>> = places.iter().map(|p| path.project(&(pose * p)).ok()).collect();
        let Some(pixels) = pixels else { continue };
        if pixels.iter().any(|p| !(2.0..1278.0).contains(&p.x) || !(2.0..1022.0).contains(&p.y)) {
            continue;
        }
        let corners =
            pixels.into_iter().enumerate().map(|(i, p)| (i, p + Vector2::new(random(), random()) * 0.05)).collect();
        let image = BoardImage { corners, mirrored: None, square_px: 40.0, edge_px: 2.0, contrast: 100.0 };
        pictures.push(BoardPicture { name: format!("{turn}.png"), size_px: [1280, 1024], image });
    }
    assert!(pictures.len() >= 15, "{}", pictures.len());
    let eight = calibrate_camera(&board(), &pictures, LensModel::Eight).unwrap();
    assert!(eight.lens.is_rational() && eight.covariance.nrows() == 12, "{:?}", eight.lens);
    assert!((0.045..0.055).contains(&eight.corner_sd_px), "{}", eight.corner_sd_px);
    assert!(!eight.diagnostics.iter().any(|d| d.to_string().contains("would show pictures better")));
    // Its coefficients trade off against each other; only the pixels over the field are determined.
    for (x, y) in [(0.0, 0.0), (0.4, 0.3), (-0.6, 0.4), (0.6, -0.55)] {
        let off = (eight.lens.distort(&Point2::new(x, y)) - wide.distort(&Point2::new(x, y))).norm();
        assert!(off < 1.5, "{x} {y}: {off}");
    }
    for (k, (found, truth)) in eight.lens.focal_px.iter().zip(wide.focal_px.iter()).enumerate() {
        let sd = eight.covariance[(k, k)].sqrt();
        assert!((found - truth).abs() < 4.0 * sd, "{found} ± {sd}");
    }
    // Five parameters cannot bend like that: the residual leaves the focal length undetermined.
    let five = calibrate_camera(&board(), &pictures, LensModel::Five).unwrap_err();
    assert!(matches!(five, CameraError::Open { .. }) && five.to_string().contains("--lens 8"), "{five}");
}
