//! Made-up recordings of a tube that swings, with known errors.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::*;
use crate::calibrate::geometry::tests::geometry;
use crate::calibrate::tests::gaussian;
use crate::optics::Surface;

const MIRROR: usize = 1;
const FRAME_SD_PX: f64 = 0.1;
const MODEL_SD_PX: [f64; 2] = [0.03, 0.03];
const LENGTH: KnownLength = KnownLength { markers: [1, 2], length_m: 22e-3, sd_m: 0.05e-3 };

/// A swinging tube with three bands, as seen by a rig, with errors as the adjustment assumes them.
fn swing(seen_by: &Geometry, errors: f64, seed: u64) -> (Vec<Moment>, KnownLength) {
    bending_swing(seen_by, errors, seed, [0.0; 2])
}

/// The same of a tube that bends as it swings: by how much that makes the length shorter at most, metres, and by how
/// much it is taken to do so.
fn bending_swing(seen_by: &Geometry, errors: f64, seed: u64, shorter_m: [f64; 2]) -> (Vec<Moment>, KnownLength) {
    let mut noise = gaussian(seed);
    let model: Vec<Vector2<f64>> =
        (0..6).map(|_| Vector2::new(noise() * MODEL_SD_PX[0], noise() * MODEL_SD_PX[1]) * errors).collect();
    let known = KnownLength { length_m: LENGTH.length_m + errors * noise() * LENGTH.sd_m, ..LENGTH };
    let moments = (0..40)
        .map(|k| {
            let (a, b) = ((f64::from(k) * 0.37).sin() * 0.8, (f64::from(k) * 0.23).cos() * 0.5);
            let coil = Vector3::new(-0.12 + 0.05 * a, 0.02 - 0.01 * a * a, 1.39 + 0.05 * b);
            let direction = Vector3::new(a, 1.0, b).normalize();
            let scatter_m = errors * noise() * 0.02e-3;
            let [really_m, taken_m] = shorter_m.map(|most| most * a * a);
            let chord_m = LENGTH.length_m + scatter_m - really_m;
            let bands = [Vector3::new(-0.12, -0.055, 1.39), coil, coil + direction * chord_m];
            let mut sights = Vec::new();
            for (marker, band) in bands.iter().enumerate() {
                for view in 0..2 {
                    let pixel = seen_by.path(view).project(&Point3::from(*band)).unwrap();
                    let off = Vector2::new(noise(), noise()) * FRAME_SD_PX * errors + model[2 * marker + view];
                    let covariance_px2 = Matrix2::identity() * FRAME_SD_PX.powi(2);
                    sights.push(Sight { marker, view, pixel: pixel + off, covariance_px2, along: Vector2::x() });
                }
            }
            Moment { sights, shorter_m: vec![Some(taken_m)] }
        })
        .collect();
    (moments, known)
}

fn solved(start: Geometry, moments: &[Moment], lengths: &[KnownLength]) -> Option<RayBundleSolution> {
    let meeting = RayBundle {
        geometry: start,
        free: Parameter::of_surface(MIRROR).to_vec(),
        prior_sd: None,
        model_sd_px: vec![MODEL_SD_PX; 3],
        lengths,
        length_scatter_m: 0.02e-3,
        moments,
    };
    meeting.solve()
}

fn bumped(truth: &Geometry) -> Geometry {
    let steps = [0.017, -0.012, 3e-3];
    truth.stepped(&Parameter::of_surface(MIRROR), &steps)
}

/// Rotations up or down and left or right, and shift.
fn error(found: &Geometry, truth: &Geometry) -> [f64; 3] {
    let (found, truth) = (found.surfaces[MIRROR].1.plane(), truth.surfaces[MIRROR].1.plane());
    let turn = truth.normal().cross(&found.normal());
    let [a, b] = crate::calibrate::geometry::tilt_axes(&truth.normal());
    [turn.dot(&a), turn.dot(&b), found.offset_m() - truth.offset_m()]
}

#[test]
fn without_errors_the_mirror_is_found_exactly() {
    let truth = geometry();
    let (moments, known) = swing(&truth, 0.0, 1);
    let start = bumped(&truth);
    assert!(disagreement_px(&start, &moments, 3).unwrap() > 5.0);
    let met = solved(start, &moments, &[known]).unwrap();
    assert!(disagreement_px(&met.geometry, &moments, 3).unwrap() < 1e-3);
    let [a, b, shift_m] = error(&met.geometry, &truth);
    assert!(a.abs() < 1e-5 && b.abs() < 1e-4 && shift_m.abs() < 1e-4, "{a} {b} {shift_m}");
}

#[test]
fn predicted_errors_are_those_made() {
    const RUNS: u64 = 60;
    let truth = geometry();
    let mut squares = [0.0; 3];
    for seed in 0..RUNS {
        let (moments, known) = swing(&truth, 1.0, seed + 1);
        let met = solved(bumped(&truth), &moments, &[known]).unwrap();
        for (i, e) in error(&met.geometry, &truth).into_iter().enumerate() {
            squares[i] += e * e / met.covariance[(i, i)] / RUNS as f64;
        }
    }
    // The σ of a mean of 60 squares is 0.18.
    for (what, square) in ["up or down", "left or right", "shift"].into_iter().zip(squares) {
        assert!((0.6..1.55).contains(&square), "{what}: {square}");
    }
}

#[test]
fn a_length_helps_and_one_place_alone_is_open() {
    let truth = geometry();
    let (moments, known) = swing(&truth, 1.0, 5);
    let with = solved(truth.clone(), &moments, &[known]).unwrap();
    let without = solved(truth.clone(), &moments, &[]).unwrap();
    let [with, without] = [with, without].map(|met| met.covariance[(2, 2)].sqrt());
    assert!(with < 0.9 * without, "{with} {without}");
    // One band that does not move: a rotation and the shift have the same effect on it.
    let still: Vec<Moment> = moments
        .iter()
        .map(|m| Moment { sights: m.sights.iter().filter(|s| s.marker == 0).copied().collect(), ..Moment::default() })
        .collect();
    let alone = solved(truth, &still, &[]);
    let alone = alone.map_or(f64::INFINITY, |met| met.covariance[(2, 2)].sqrt());
    assert!(alone > 0.05, "{alone}");
}

/// In air a scene twice as large, twice as far away, looks the same: how the length varies as the tube bends must not
/// be taken for its scale.
#[test]
fn in_air_rays_do_not_contradict_a_length_whose_shortening_is_misjudged() {
    let mut air = geometry();
    for (_, surface) in &mut air.surfaces {
        if let Surface::Wall(wall) = surface {
            (wall.index_wall, wall.index_inside) = (wall.index_outside, wall.index_outside);
        }
    }
    for seed in 1..=10 {
        let (moments, known) = bending_swing(&air, 1.0, seed, [0.3e-3, 0.2e-3]);
        let found = solved(air.clone(), &moments, &[known]).unwrap();
        if let Some(rays) = found.lengths[0] {
            let off = (rays.length_m - known.length_m).abs() / rays.sd_m.hypot(known.sd_m);
            assert!(off < 3.0, "seed {seed}: {rays:?} against {known:?}, {off:.1} sigma");
        }
    }
}

#[test]
fn a_wrong_length_contradicts_the_rays_and_rays_that_do_not_meet_enlarge_sigma() {
    let truth = geometry();
    let (moments, known) = swing(&truth, 1.0, 3);
    let right = solved(truth.clone(), &moments, &[known]).unwrap();
    let off = |found: &RayBundleSolution, known: &KnownLength| {
        let rays = found.lengths[0].unwrap();
        (rays.length_m - known.length_m).abs() / rays.sd_m.hypot(known.sd_m)
    };
    assert!(off(&right, &known) < 3.5 && (0.7..1.4).contains(&right.misfit), "{right:?}");
    let wrong = KnownLength { length_m: known.length_m + 3e-3, ..known };
    let found = solved(truth.clone(), &moments, &[wrong]).unwrap();
    assert!(off(&found, &wrong) > 4.0, "{:?}, {:.1} sigma", found.lengths[0], off(&found, &wrong));
    // Noise of half a pixel where a tenth is stated.
    let noisy: Vec<Moment> = moments
        .iter()
        .enumerate()
        .map(|(k, moment)| {
            let mut moment = moment.clone();
            for (j, sight) in moment.sights.iter_mut().enumerate() {
                let angle = (k * 7 + j * 3) as f64;
                sight.pixel += Vector2::new(angle.sin(), (1.7 * angle).cos()) * 0.5;
            }
            moment
        })
        .collect();
    let found = solved(truth, &noisy, &[known]).unwrap();
    assert!(found.misfit > 4.0, "{}", found.misfit);
    assert!(found.covariance[(0, 0)] > 3.0 * right.covariance[(0, 0)], "{} {}", found.covariance, right.covariance);
}
