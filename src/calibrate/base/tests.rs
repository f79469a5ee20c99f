//! Made-up recordings of a known frame, with known noise.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use super::*;
use crate::calibrate::tests::gaussian;
use crate::source::Clock;
use std::collections::BTreeMap;

const BASE_SD_M: f64 = 0.04e-3;
/// σ of a tangent: in the plane of the swing, and across it.
const TANGENT_SD_RAD: [f64; 2] = [2e-3, 3e-3];
const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// The true frame: rows are its axes in the camera frame.
fn axes() -> Matrix3<f64> {
    Rotation3::from_euler_angles(1.4, -0.5, 0.3).into_inner()
}

fn origin() -> Vector3<f64> {
    Vector3::new(-0.1, -0.05, 1.4)
}

/// Deflected by `theta` in the plane and by `across` out of it, and measured with an `error` in σ.
fn tangent(theta: f64, across: f64, error: [f64; 2]) -> Tangent {
    let axes = axes();
    let [x, y, z] = [0, 1, 2].map(|i| axes.row(i).transpose());
    let in_plane = x * theta.cos() - z * theta.sin();
    let exact = (z * theta.cos() + x * theta.sin()) * across.cos() + y * across.sin();
    let direction = exact + in_plane * error[0] * TANGENT_SD_RAD[0] + y * error[1] * TANGENT_SD_RAD[1];
    let covariance =
        in_plane * in_plane.transpose() * TANGENT_SD_RAD[0].powi(2) + y * y.transpose() * TANGENT_SD_RAD[1].powi(2);
    Tangent { direction: direction.normalize(), covariance, bound: covariance }
}

fn stamp(frame: usize) -> Timestamp {
    Timestamp { ns: frame as i64 * 16_666_667, clock: Clock::Container }
}

/// At rest, every frame with the same error.
fn rest(frames: usize, random: &mut impl FnMut() -> f64) -> Observed {
    let position = Position {
        point: (origin() + Vector3::from_fn(|_, _| random()) * BASE_SD_M).into(),
        covariance: Matrix3::identity() * BASE_SD_M.powi(2),
        bound: Matrix3::zeros(),
    };
    let tangent = tangent(0.0, 0.0, [random(), random()]);
    Observed {
        frames,
        base: vec![position; frames],
        tangents: (0..frames).map(|i| (stamp(i), tangent)).collect(),
        first_miss: [None, None],
    }
}

fn still(frames: usize) -> Observed {
    rest(frames, &mut || 0.0)
}

/// A swing through these angles, in and across the plane, without errors.
fn swing(angles: impl Iterator<Item = (f64, f64)>) -> Observed {
    let tangents: Vec<_> =
        angles.enumerate().map(|(i, (theta, across))| (stamp(i), tangent(theta, across, [0.0; 2]))).collect();
    Observed { frames: tangents.len(), tangents, ..Observed::default() }
}

/// `largest`·sin of one and a half periods.
fn sine(frames: usize, largest: f64) -> impl Iterator<Item = (f64, f64)> {
    (0..frames).map(move |i| (largest * (0.05 * i as f64).sin(), 0.0))
}

fn towards(observed: &Observed) -> Field<'_> {
    Field::Swing { observed, first_is_positive: true }
}

/// Rotations about the true axes x, y, z from the true frame to the one found.
fn turns(found: &BaseCalibration) -> Vector3<f64> {
    let rotation = found.base.base_from_camera.rotation.to_rotation_matrix();
    // camera_from_found = camera_from_true · (rotation in the true frame)
    let turn = Rotation3::from_matrix_unchecked(axes()) * rotation.inverse();
    turn.scaled_axis()
}

#[test]
fn the_frame_of_exact_recordings_is_exact() {
    let run = swing(sine(190, 0.6));
    let found = calibrate_base(&still(20), towards(&run)).unwrap();
    assert!(turns(&found).norm() < 1e-9, "{}", turns(&found));
    let origin_in_base = found.base.base_from_camera * Point3::from(origin());
    assert!(origin_in_base.coords.norm() < 1e-12);
    let swing = found.swing.unwrap();
    assert_eq!((swing.measured, swing.first), (190, stamp(2)));
    assert!((swing.range_rad[0] + 0.6).abs() < 1e-3 && (swing.range_rad[1] - 0.6).abs() < 1e-3);
    assert!(!swing.is_one_sided());
    for range_rad in [[-0.1, 0.6], [-0.6, 0.0], [0.3, 0.6]] {
        assert!(Swing { range_rad, ..swing }.is_one_sided(), "{range_rad:?}");
    }

    let b0 = axes().transpose() * Vector3::new(3.0, 0.0, 1.0);
    let found = calibrate_base(&still(20), Field::Known(b0, 0.0)).unwrap();
    assert!(turns(&found).norm() < 1e-9 && (found.base.b0 - b0.normalize()).norm() < 1e-12);
}

/// RMS of error/σ of the frame's rotations about its axes, of the origin's coordinates, and of all rotations together,
/// over recordings in which all frames of a pose share one error.
fn calibrated(angles: &[(f64, f64)], field: impl Fn(&Observed) -> Field<'_>) -> ([f64; 3], [f64; 3], f64) {
    const RUNS: usize = 400;
    let mut random = gaussian(7);
    let ([mut turned, mut moved], mut chi2) = ([Vector3::zeros(); 2], 0.0);
    for _ in 0..RUNS {
        let mut errors: BTreeMap<i64, [f64; 2]> = BTreeMap::new();
        let mut run = swing(angles.iter().copied());
        for ((_, measured), (theta, across)) in run.tangents.iter_mut().zip(angles) {
            let pose = (theta.sin() / DEGREE).round() as i64;
            *measured = tangent(*theta, *across, *errors.entry(pose).or_insert_with(|| [random(), random()]));
        }
        let found = calibrate_base(&rest(25, &mut random), field(&run)).unwrap();
        let over_sd = |error: Vector3<f64>, covariance: &Matrix3<f64>| {
            error.component_div(&covariance.diagonal().map(f64::sqrt)).map(|v| v * v / RUNS as f64)
        };
        turned += over_sd(turns(&found), &found.axes_covariance);
        // Of rank 2 when B0 is exact: then the three rotations are dependent, to first order.
        let information = found.axes_covariance.pseudo_inverse(1e-12).unwrap();
        let (turns, rank) = (turns(&found), found.axes_covariance.rank(1e-12));
        chi2 += turns.dot(&(information * turns)) / (rank * RUNS) as f64;
        assert!((turns - found.axes_covariance * information * turns).norm() < 2e-4);
        moved += over_sd(found.origin.coords - origin(), &found.origin_covariance);
    }
    (turned.map(f64::sqrt).into(), moved.map(f64::sqrt).into(), chi2.sqrt())
}

#[test]
fn predicted_sigmas_are_those_of_many_recordings() {
    let both_sides: Vec<(f64, f64)> = sine(126, 0.5).collect();
    // On one side, an error of z also turns x.
    let one_side: Vec<(f64, f64)> = both_sides.iter().map(|(theta, _)| (theta.abs(), 0.0)).collect();
    let known: fn(&Observed) -> Field<'_> = |_| Field::Known(axes().transpose() * Vector3::new(1.0, 0.0, 0.8), 0.0);
    let found: fn(&Observed) -> Field<'_> = |run| towards(run);
    for (what, angles, field) in
        [("both sides", &both_sides, found), ("one side", &one_side, found), ("known", &both_sides, known)]
    {
        // The last is for all rotations together, with their correlations.
        let (turns, origin, together) = calibrated(angles, field);
        for ratio in turns.into_iter().chain(origin).chain([together]) {
            assert!((0.8..1.25).contains(&ratio), "{what}: {turns:?} {origin:?} {together}");
        }
    }
}

#[test]
fn a_known_field_keeps_its_own_sigma() {
    let field = axes().transpose() * Vector3::x();
    let found = calibrate_base(&still(10), Field::Known(field, 0.01)).unwrap();
    assert!((found.axes_covariance[(2, 2)].sqrt() - 0.01).abs() < 1e-9);
    assert!((found.axes_covariance[(0, 0)].sqrt() - TANGENT_SD_RAD[1]).abs() < 1e-9);
    assert!((found.axes_covariance[(1, 1)].sqrt() - TANGENT_SD_RAD[0]).abs() < 1e-9);
}

#[test]
fn the_sign_is_that_of_the_first_deflection_seen_twice() {
    let away = |observed: &Observed, first_is_positive| {
        let found = calibrate_base(&still(10), Field::Swing { observed, first_is_positive }).unwrap();
        assert!(found.axes_covariance.symmetric_eigenvalues().min() > 0.0);
        (found.base.b0.dot(&axes().row(0).transpose()), found.swing.unwrap())
    };
    let (b0, _) = away(&swing(sine(150, 0.5)), true);
    assert!(b0 > 0.99);
    let (b0, negative) = away(&swing(sine(150, 0.5)), false);
    assert!(b0 < -0.99);
    assert!((negative.range_rad[0] + 0.5).abs() < 1e-3);
    // A single frame to the other side is a mistake, and deflections below 3° do not count.
    let odd = [(0.04, 0.0), (0.04, 0.0), (-0.2, 0.0), (0.0, 0.0)].into_iter().chain(sine(150, 0.5));
    let (b0, found) = away(&swing(odd), true);
    assert!(b0 > 0.99);
    assert_eq!(found.first, stamp(4 + 3));
}

fn refused(rest: &Observed, field: Field<'_>) -> BaseError {
    calibrate_base(rest, field).map(|_| ()).unwrap_err()
}

#[test]
fn motion_at_rest_is_refused_with_its_size() {
    let b0 = Field::Known(axes().transpose() * Vector3::x(), 0.0);
    let mut swinging = still(60);
    for (i, (_, t)) in swinging.tangents.iter_mut().enumerate() {
        *t = tangent(1.0 * DEGREE * (0.5 * i as f64).sin(), 0.0, [0.0; 2]);
    }
    let error = refused(&swinging, b0);
    assert!(matches!(error, BaseError::Moves { quantity: Quantity::Tangent, .. }), "{error}");
    assert!(error.to_string().contains("the coil's direction scatters by 0.71°"), "{error}");

    let mut slipping = still(60);
    for (i, position) in slipping.base.iter_mut().enumerate() {
        position.point.x += 0.3e-3 * i as f64 / 59.0;
    }
    let error = refused(&slipping, b0);
    assert!(matches!(error, BaseError::Drifts { quantity: Quantity::Base, .. }), "{error}");
    assert!(error.to_string().contains("the base band drifts by 0.244 mm"), "{error}");
}

#[test]
fn too_little_measured_is_refused_with_the_reason() {
    let b0 = Field::Known(axes().transpose() * Vector3::x(), 0.0);
    assert!(calibrate_base(&still(5), b0).is_ok());
    let error = refused(&still(4), b0);
    assert!(matches!(error, BaseError::TooFew { run: Run::Rest, measured: 4, frames: 4, .. }), "{error}");
    let mut hidden = still(20);
    hidden.tangents.truncate(9);
    hidden.first_miss[1] = Some(Miss::NotSeen { view: 1 });
    let BaseError::TooFew { quantity: Quantity::Tangent, measured: 9, frames: 20, miss, .. } = refused(&hidden, b0)
    else {
        panic!("9 of 20 are too few")
    };
    assert_eq!(miss, Some(Miss::NotSeen { view: 1 }));
    let mut run = swing(sine(100, 0.5));
    run.frames = 201;
    let error = refused(&still(20), towards(&run));
    assert!(matches!(error, BaseError::TooFew { run: Run::Planar, measured: 100, frames: 201, .. }), "{error}");
}

#[test]
fn swings_without_a_plane_are_refused_with_their_size() {
    let small = swing(sine(150, 4.5 * DEGREE));
    assert!(refused(&still(20), towards(&small)).to_string().contains("deflected from rest by 4.5° at most"));
    // One frame far off is not a swing.
    let mut spike = swing(sine(150, 1.0 * DEGREE));
    spike.tangents[50].1 = tangent(0.5, 0.0, [0.0; 2]);
    assert!(matches!(refused(&still(20), towards(&spike)), BaseError::HardlyMoves { .. }));
    let elliptic =
        |across: f64| swing((0..126).map(move |i| (0.4 * (0.1 * i as f64).sin(), across * (0.1 * i as f64).cos())));
    // Sines are averaged: √((1 − J₀(0.8))/2) is that of 15.9°.
    let error = refused(&still(20), towards(&elliptic(0.06)));
    assert!(matches!(error, BaseError::NotPlanar { .. }), "{error}");
    assert!(
        error.to_string().contains("by 15.9° (RMS) along") && error.to_string().contains("by 2.4° across"),
        "{error}"
    );
    assert!(calibrate_base(&still(20), towards(&elliptic(0.03))).is_ok());
}

#[test]
fn fields_that_give_no_x_are_refused() {
    let rest = still(20);
    let at = |x: f64, z: f64| Field::Known(axes().transpose() * Vector3::new(x, 0.0, z), 0.0);
    let error = refused(&rest, at(0.05, -1.0));
    assert!(
        matches!(error, BaseError::Along { angle_rad, .. } if (angle_rad.to_degrees() - 2.86).abs() < 0.01),
        "{error}"
    );
    assert!(calibrate_base(&rest, at(0.1, -1.0)).is_ok());
    assert!(calibrate_base(&rest, at(1e200, 1e199)).is_ok());
    for nothing in [Vector3::zeros(), Vector3::new(f64::NAN, 0.0, 1.0), Vector3::new(1.0, f64::INFINITY, 0.0)] {
        assert!(matches!(refused(&rest, Field::Known(nothing, 0.0)), BaseError::NoDirection { .. }));
    }
}
