//! Lenses from boards in air: found, and sets that are refused.

use super::{SIZE_PX, board, gaussian, lens};
use crate::calibrate::board::{Board, BoardImage, BoardPicture};
use crate::calibrate::bundle::outliers::LeftOut;
use crate::calibrate::camera::diagnostics::CameraDiagnostic;
use crate::calibrate::camera::models::Model;
use crate::calibrate::camera::turn::Turn;
use crate::calibrate::camera::{CameraCalibration, CameraError, LensModel, calibrate_camera};
use crate::calibrate::geometry::{Geometry, Projector};
use crate::optics::{Lens, OpticalPath};
use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector2, Vector3};

/// Boards in air with the given rotations, each at its own place.
pub(super) fn air(turns: &[[f64; 3]], sd_px: f64) -> Vec<BoardPicture> {
    air_of(board().centred_points(), turns, sd_px, 3)
}

/// The same with corners at other places.
fn air_of(places: Vec<Point3<f64>>, turns: &[[f64; 3]], sd_px: f64, seed: u64) -> Vec<BoardPicture> {
    let mut random = gaussian(seed);
    let geometry = Geometry { lens: lens(), surfaces: Vec::new(), views: vec![("air".into(), Vec::new())] };
    let projector = Projector::new(&geometry, &[]);
    turns
        .iter()
        .enumerate()
        .map(|(i, turn)| {
            let at = |k: usize, half: f64| half * f64::from(i32::try_from((i * k + i / 5) % 5).unwrap() - 2) / 2.0;
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
fn a_sound_picture_takes_the_place_of_one_that_is_off_and_shows_the_same() {
    let mut pictures = air(&TILTS, 0.05);
    let sound = pictures[3].clone();
    for (i, pixel) in &mut pictures[3].image.corners {
        pixel.x += 1.5 * (*i as f64).sin();
    }
    for name in ["again.png", "once_more.png"] {
        pictures.push(BoardPicture { name: name.into(), ..sound.clone() });
    }
    let found = calibrate_camera(&board(), &pictures, LensModel::Five).unwrap();
    let used: Vec<&str> = found.used.iter().map(|picture| picture.name.as_str()).collect();
    assert_eq!(used, ["0.png", "1.png", "2.png", "again.png", "4.png", "5.png", "6.png", "7.png"]);
    assert_eq!(found.left_out[0], ("once_more.png".into(), LeftOut::Duplicate("again.png".into())));
    assert!(matches!(&found.left_out[1], (name, LeftOut::Off { .. }) if name == "3.png"), "{:?}", found.left_out);
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
    assert!(text.starts_with("4.png has 1024x1280 pixels, 0.png has 1280x1024") && text.contains("turned"), "{text}");
    mixed[6].size_px = [1024, 1280];
    let text = error(&mixed).to_string();
    assert!(text.starts_with("4.png (like 6.png) has 1024x1280 pixels"), "{text}");
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
    assert!(!eight.diagnostics.iter().any(|d| matches!(d, CameraDiagnostic::Model { .. })), "{:?}", eight.diagnostics);
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

/// Eight coefficients for a lens with five take up what is the board's or the noise's.
#[test]
fn needless_coefficients_are_told() {
    for seed in 0..3 {
        let pictures = air_of(large().centred_points(), &many_tilts(seed), 0.03, 90 + seed);
        match calibrate_camera(&large(), &pictures, LensModel::Eight) {
            Ok(found) => assert!(
                found.diagnostics.iter().any(|d| matches!(d, CameraDiagnostic::Model { model: Model::Brown, .. })),
                "{seed}: {:?}",
                found.diagnostics
            ),
            Err(why) => assert!(matches!(why, CameraError::Eight(_)), "{seed}: {why}"),
        }
    }
}

/// A board with squares twice as large, which determines a lens well.
fn large() -> Board {
    Board { square_m: 2.0 * board().square_m, ..board() }
}

/// Sixteen tilts to all sides.
fn many_tilts(seed: u64) -> Vec<[f64; 3]> {
    let mut random = gaussian(seed);
    let turn = |i: u32| {
        let (sin, cos) = (f64::from(i) * 2.4).sin_cos();
        let tilt = 0.25 + 0.02 * f64::from(i);
        [tilt * cos, tilt * sin, 0.2 * random()]
    };
    (0..16).map(turn).collect()
}

/// Squares of errors of focal lengths and principal point, in variances, and σ of fx.
fn squares_of_errors(found: &CameraCalibration) -> (f64, f64) {
    let of = |lens: &Lens| [lens.focal_px.x, lens.focal_px.y, lens.principal_point_px.x, lens.principal_point_px.y];
    let off = of(&found.lens).into_iter().zip(of(&lens())).enumerate();
    (
        off.map(|(i, (value, truth))| (value - truth).powi(2) / found.covariance[(i, i)]).sum(),
        found.covariance[(0, 0)].sqrt(),
    )
}

/// Boards curled like an S, with a lifted corner, or stretched: the lens is off by what its σ says, which is hardly
/// larger than with a flat board, and the curl or stretch is told.
#[test]
fn curled_and_stretched_boards_leave_the_lens_as_good_as_its_deviations() {
    const RUNS: u64 = 6;
    let half_m = large().centred_points().iter().map(|p| p.x).fold(0.0, f64::max);
    type Rise = fn(f64, f64) -> f64;
    let s_curl: Rise = |u, _| 0.012 * (u * u * u - 0.6 * u);
    let lifted: Rise = |u, v| 0.006 * (u + 1.5 * v - 0.6).max(0.0).powi(2);
    let flat: Rise = |_, _| 0.0;
    let mut of_flat = 0.0;
    let kinds = [("flat", flat, 0.0), ("S", s_curl, 0.0), ("lifted corner", lifted, 0.0), ("stretched", flat, 0.004)];
    for (kind, rise, stretch) in kinds {
        let (mut squares, mut sd_px) = (0.0, 0.0);
        for seed in 0..RUNS {
            let real = |p: Point3<f64>| {
                let z = half_m * rise(p.x / half_m, p.y / half_m);
                Point3::new(p.x * (1.0 + stretch / 2.0), p.y * (1.0 - stretch / 2.0), z)
            };
            let places = large().centred_points().into_iter().map(real).collect();
            let pictures = air_of(places, &many_tilts(seed), 0.03, 50 + seed);
            let found = calibrate_camera(&large(), &pictures, LensModel::Five).unwrap();
            assert_eq!(found.used.len(), pictures.len(), "{kind}: {:?}", found.left_out);
            let (square, sd) = squares_of_errors(&found);
            squares += square / (4 * RUNS) as f64;
            sd_px += sd / RUNS as f64;
            let told = |what: fn(&CameraDiagnostic) -> bool| found.diagnostics.iter().any(what);
            let bent = told(|d| matches!(d, CameraDiagnostic::Bent { .. }));
            let stretched = told(|d| matches!(d, CameraDiagnostic::Stretched { .. }));
            assert_eq!([bent, stretched], [kind == "S" || kind == "lifted corner", stretch > 0.0], "{kind} {seed}");
        }
        println!("{kind}: z RMS {:.2}, σ of fx {sd_px:.2} px", squares.sqrt());
        assert!((0.6..1.4).contains(&squares.sqrt()), "{kind}: {}", squares.sqrt());
        if kind == "flat" {
            of_flat = sd_px;
        }
        assert!(sd_px < 1.3 * of_flat, "{kind}: {sd_px} px, {of_flat} px with a flat board");
    }
}

/// The second half of the pictures, or every other one, cropped elsewhere, taken with another zoom, or turned by half a
/// turn: the groups are named, and σ covers both lenses.
#[test]
fn pictures_shifted_zoomed_or_turned_are_named_and_widen_the_deviations() {
    type Change = fn(Point2<f64>) -> Point2<f64>;
    let shifted: Change = |p| Point2::new(p.x + 24.0, p.y);
    let zoomed: Change = |p| lens().principal_point_px + (p - lens().principal_point_px) * 1.01;
    let turned: Change = |p| Point2::new(f64::from(SIZE_PX[0]) - 1.0 - p.x, f64::from(SIZE_PX[1]) - 1.0 - p.y);
    for (what, change) in [("shifted", shifted), ("zoomed", zoomed), ("turned", turned)] {
        for every_other in [false, true] {
            let (mut squares, mut clean) = (0.0, 0);
            const RUNS: u64 = 5;
            for seed in 0..RUNS {
                let mut pictures = air_of(large().centred_points(), &many_tilts(seed), 0.03, 70 + seed);
                let half = pictures.len() / 2;
                let changed = |i: usize| if every_other { i % 2 == 1 } else { i >= half };
                for (_, picture) in pictures.iter_mut().enumerate().filter(|(i, _)| changed(*i)) {
                    picture.name = format!("changed {}", picture.name);
                    picture.image.corners.iter_mut().for_each(|(_, pixel)| *pixel = change(*pixel));
                }
                let found = calibrate_camera(&large(), &pictures, LensModel::Five).unwrap();
                let Some(CameraDiagnostic::TwoLenses { names, .. }) = found.diagnostics.first() else {
                    panic!("{what} {every_other} {seed}: {:?}", found.diagnostics)
                };
                let right = names.iter().filter(|name| name.starts_with("changed")).count();
                clean += usize::from(right == names.len() || right == 0);
                squares += squares_of_errors(&found).0 / (4 * RUNS) as f64;
            }
            println!("{what} {every_other}: z RMS {:.2}, {clean} of {RUNS} groups without mistake", squares.sqrt());
            assert!(squares.sqrt() < 1.4, "{what} {every_other}: {}", squares.sqrt());
            assert!(clean >= 4, "{what} {every_other}: {clean} of {RUNS} groups without mistake");
        }
    }
}

/// One of ten pictures taken with another zoom or focus: it is left out, wherever it stands, and the lens is that of
/// the others.
#[test]
fn a_single_picture_of_another_lens_is_left_out() {
    let mut squares = 0.0;
    for (seed, at) in [(0, 9), (1, 0), (2, 4), (3, 8)] {
        let mut pictures = air_of(large().centred_points(), &many_tilts(seed)[6..], 0.03, 70 + seed);
        for (_, pixel) in &mut pictures[at].image.corners {
            *pixel = lens().principal_point_px + (*pixel - lens().principal_point_px) * 1.03;
        }
        let found = calibrate_camera(&large(), &pictures, LensModel::Five).unwrap();
        let [(name, LeftOut::OtherLens { .. })] = found.left_out.as_slice() else {
            panic!("{seed}: {:?}, {:?}", found.left_out, found.diagnostics)
        };
        assert_eq!(*name, pictures[at].name, "{seed}");
        squares += squares_of_errors(&found).0 / 16.0;
    }
    assert!(squares.sqrt() < 1.4, "{}", squares.sqrt());
}

/// Focus moved by a per cent after the third or fourth of eight pictures, too few to find two lenses by themselves.
#[test]
fn a_change_of_focus_among_few_pictures_is_told() {
    for (seed, before) in [(0, 3), (1, 4)] {
        let mut pictures = air_of(large().centred_points(), &many_tilts(seed)[8..], 0.03, 70 + seed);
        for (_, pixel) in pictures.iter_mut().skip(before).flat_map(|picture| &mut picture.image.corners) {
            *pixel = lens().principal_point_px + (*pixel - lens().principal_point_px) * 1.01;
        }
        let found = calibrate_camera(&large(), &pictures, LensModel::Five).unwrap();
        let Some(CameraDiagnostic::TwoLenses { names, lenses: [few, most], .. }) = found.diagnostics.first() else {
            panic!("{seed}: {:?}, {:?}", found.left_out, found.diagnostics)
        };
        assert_eq!(names.len(), before, "{seed}: {names:?}");
        let ratio = most.focal_px.x / few.focal_px.x;
        assert!((1.005..1.015).contains(&ratio), "{seed}: {ratio}");
        let z2 = squares_of_errors(&found).0 / 4.0;
        assert!(z2 < 2.0, "{seed}: {z2}");
    }
}

/// Two or three of sixteen pictures, or half of them, flipped or turned: they are named, with how, the print is not
/// taken to be uneven, and σ covers both lenses.
#[test]
fn pictures_that_were_flipped_or_turned_are_named() {
    let order = large().orders().remove(0);
    for (turn, axes, every) in
        [(Turn::LeftRight, &[0][..], 8), (Turn::TopBottom, &[1][..], 2), (Turn::Half, &[0, 1][..], 6)]
    {
        for seed in 0..3 {
            let mut pictures = air_of(large().centred_points(), &many_tilts(seed), 0.03, 70 + seed);
            let changed: Vec<_> = pictures.iter_mut().skip(1).step_by(every).collect();
            let expected: Vec<String> = changed.iter().map(|picture| picture.name.clone()).collect();
            for (i, pixel) in changed.into_iter().flat_map(|picture| &mut picture.image.corners) {
                axes.iter().for_each(|axis| pixel[*axis] = f64::from(SIZE_PX[*axis]) - 1.0 - pixel[*axis]);
                // A mirror image is found in another order.
                *i = if axes.len() == 1 { order[*i] } else { *i };
            }
            let found = calibrate_camera(&large(), &pictures, LensModel::Five).unwrap();
            let Some(CameraDiagnostic::TwoLenses { names, turn: how, .. }) = found.diagnostics.first() else {
                panic!("{turn} {seed}: {:?}", found.diagnostics)
            };
            assert_eq!(*how, Some(turn), "{seed}");
            assert!(*names == expected || 2 * names.len() == pictures.len(), "{turn} {seed}: {names:?}");
            assert!(!found.diagnostics.iter().any(|d| matches!(d, CameraDiagnostic::Uneven { .. })), "{turn} {seed}");
            let z2 = squares_of_errors(&found).0 / 4.0;
            assert!(z2 < 2.0, "{turn} {seed}: {z2}");
        }
    }
}
