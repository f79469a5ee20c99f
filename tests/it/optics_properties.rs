//! Properties that must hold for every rig: tested over random lenses, mirrors, walls, pixels and points, seeded by the
//! test's name.

use crate::support::optics::{Case, DICE, Element, PATHS, build, reference};
use catoptra::optics::{Mirror, OpticalPath, Plane, Surface, Wall};
use nalgebra::{
    Complex, Isometry3, Matrix2, Matrix3x2, Point2, Point3, Translation3, UnitQuaternion, Vector2, Vector3,
};
use proptest::prelude::{TestCaseError, prop_assert};
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

type Verdict = Result<(), TestCaseError>;

/// Runs a property on random cases of each path.
fn for_all(name: &str, paths: &[&[Element]], property: impl Fn(&[Element], &Case) -> Verdict) {
    let mut seed = [0_u8; 32];
    for (i, byte) in name.bytes().enumerate() {
        seed[i % 32] = seed[i % 32].rotate_left(3) ^ byte;
    }
    for elements in paths {
        let config = Config { cases: 150, failure_persistence: None, ..Config::default() };
        let mut runner = TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &seed));
        runner
            .run(&proptest::array::uniform32(0.0..1.0_f64), |dice: [f64; DICE]| match build(elements, &dice) {
                Some(case) => property(elements, &case),
                None => Err(TestCaseError::reject("no valid rig")),
            })
            .unwrap_or_else(|failure| panic!("{name}, path {elements:?}: {failure}"));
    }
}

#[test]
fn project_inverts_trace_to_1e_9_px() {
    for_all("project_inverts_trace", &PATHS, |_, case| {
        let back = case.path.project(&case.point)?;
        prop_assert!((back - case.pixel).norm() < 1e-9, "{} came back as {back}", case.pixel);
        let full = case.path.project_with_jacobian(&case.point)?;
        prop_assert!((full.pixel - case.pixel).norm() < 1e-9);
        let ray = case.path.trace(&case.pixel)?;
        prop_assert!((full.ray.origin - ray.origin).norm() < 1e-12);
        prop_assert!((full.ray.direction - ray.direction).norm() < 1e-12);
        Ok(())
    });
}

#[test]
fn an_answer_is_a_ray_that_light_takes() {
    // Points anywhere around: most are not seen. Those that are must lie on the ray of the pixel they are seen at.
    for_all("an_answer_is_a_ray", &PATHS, |_, case| {
        for k in 0..8 {
            let aside = Vector3::new((k & 1) as f64 - 0.5, ((k >> 1) & 1) as f64 - 0.5, (k >> 2) as f64 - 0.5);
            let point = case.point + aside;
            let Ok(pixel) = case.path.project(&point) else { continue };
            if pixel.coords.norm() > 3000.0 {
                continue; // far outside the picture, where the lens model is no longer inverted
            }
            let ray = case.path.trace(&pixel)?;
            let along = ray.nearest(&point);
            prop_assert!(along > 0.0, "{point} lies {along} m before the last surface");
            prop_assert!((ray.at(along) - point).norm() < 1e-11, "{point} is not on its ray");
        }
        Ok(())
    });
}

#[test]
fn trace_equals_snell_by_angles_and_its_jacobian_the_complex_step() {
    const STEP: f64 = 1e-30;
    for_all("trace_equals_snell", &PATHS, |elements, case| {
        let at = case.path.lens.undistort(&case.pixel).expect("the case is valid");
        let [u, v] = reference::distort(&case.path.lens, at.x.into(), at.y.into());
        prop_assert!((Point2::new(u.re, v.re) - case.pixel).norm() < 1e-9);

        let traced = case.path.trace_with_jacobian(&case.pixel)?;
        let (mut d_origin, mut d_direction, mut d_pixel) = (Matrix3x2::zeros(), Matrix3x2::zeros(), Matrix2::zeros());
        for k in 0..2 {
            let x = Complex::new(at.x, if k == 0 { STEP } else { 0.0 });
            let y = Complex::new(at.y, if k == 1 { STEP } else { 0.0 });
            let (o, d) = reference::trace(elements, case, x, y);
            let pixel = reference::distort(&case.path.lens, x, y);
            for i in 0..3 {
                prop_assert!((o[i].re - traced.ray.origin[i]).abs() < 1e-11);
                prop_assert!((d[i].re - traced.ray.direction[i]).abs() < 1e-11);
                d_origin[(i, k)] = o[i].im / STEP;
                d_direction[(i, k)] = d[i].im / STEP;
            }
            (d_pixel[(0, k)], d_pixel[(1, k)]) = (pixel[0].im / STEP, pixel[1].im / STEP);
        }
        let origin_error = (traced.d_origin * d_pixel - d_origin).norm() / d_origin.norm().max(1.0);
        let direction_error = (traced.d_direction * d_pixel - d_direction).norm() / d_direction.norm();
        prop_assert!(origin_error < 1e-10, "d origin is off by {origin_error:e}");
        prop_assert!(direction_error < 1e-10, "d direction is off by {direction_error:e}");
        Ok(())
    });
}

#[test]
fn jacobian_of_trace_equals_differences() {
    for_all("jacobian_of_trace", &PATHS, |_, case| {
        let traced = case.path.trace_with_jacobian(&case.pixel)?;
        for k in 0..2 {
            let mut step = Vector2::zeros();
            step[k] = 1e-3;
            // A pixel aside may be lost; then there is nothing to compare.
            let (Ok(a), Ok(b)) = (case.path.trace(&(case.pixel - step)), case.path.trace(&(case.pixel + step))) else {
                continue;
            };
            let origin_error = ((b.origin - a.origin) / 2e-3 - traced.d_origin.column(k)).norm();
            let direction_error = ((b.direction - a.direction) / 2e-3 - traced.d_direction.column(k)).norm();
            prop_assert!(origin_error < 1e-5 * traced.d_origin.norm().max(1e-3), "{origin_error:e}");
            prop_assert!(direction_error < 1e-5 * traced.d_direction.norm().max(1e-3), "{direction_error:e}");
        }
        Ok(())
    });
}

#[test]
fn jacobian_of_project_inverts_that_of_trace_and_equals_differences() {
    for_all("jacobian_of_project", &PATHS, |_, case| {
        let seen = case.path.project_with_jacobian(&case.point)?;
        let traced = case.path.trace_with_jacobian(&case.pixel)?;
        let along = traced.ray.nearest(&case.point);
        // Along the ray the pixel stays; across it, d pixel / d point undoes d point / d pixel. That is all six
        // numbers.
        let d_point = traced.d_origin + traced.d_direction * along;
        prop_assert!((seen.d_pixel * d_point - Matrix2::identity()).norm() < 1e-9);
        prop_assert!((seen.d_pixel * traced.ray.direction).norm() < 1e-9 * seen.d_pixel.norm());

        let size = 1e-5 * along.min(0.1);
        for k in 0..3 {
            let mut step = Vector3::zeros();
            step[k] = size;
            let (a, b) = (case.path.project(&(case.point - step))?, case.path.project(&(case.point + step))?);
            let error = ((b - a) / (2.0 * size) - seen.d_pixel.column(k)).norm() / seen.d_pixel.norm();
            prop_assert!(error < 1e-5, "column {k} is off by {error:e}");
        }
        Ok(())
    });
}

#[test]
fn project_equals_the_least_optical_length() {
    for_all("project_equals_fermat", &PATHS, |elements, case| {
        let least = reference::project(elements, case);
        let seen = case.path.project(&case.point)?;
        prop_assert!((least - seen).norm() < 1e-8, "{seen}, by Fermat {least}");
        Ok(())
    });
}

/// Where the ray of a case meets each interface, with a plane's two directions there, and the index before each.
fn crossings(elements: &[Element], case: &Case) -> Vec<(Point3<f64>, Plane, f64)> {
    let mut found = Vec::new();
    let mut index = match (elements.first(), case.path.surfaces.first()) {
        (Some(Element::Out), Some(Surface::Wall(wall))) => wall.index_inside,
        _ => 1.0,
    };
    for (k, (element, surface)) in elements.iter().zip(&case.path.surfaces).enumerate() {
        let so_far = OpticalPath { surfaces: case.path.surfaces[..k].to_vec(), ..case.path.clone() };
        let ray = so_far.trace(&case.pixel).expect("the case is valid");
        let first = match surface {
            Surface::Mirror(mirror) => mirror.plane,
            Surface::Wall(wall) if *element == Element::Out => wall.inner(),
            Surface::Wall(wall) => wall.outer,
        };
        let met = ray.at(-first.signed_distance(&ray.origin) / first.normal().dot(&ray.direction));
        found.push((met, first, index));
        if let Surface::Wall(wall) = surface {
            let until = OpticalPath { surfaces: case.path.surfaces[..=k].to_vec(), ..case.path.clone() };
            let ray = until.trace(&case.pixel).expect("the case is valid");
            found.push((ray.origin, first, wall.index_wall));
            index = if *element == Element::Out { wall.index_outside } else { wall.index_inside };
        }
    }
    found.push((case.point, Plane::new(Vector3::z(), 0.0).expect("a plane"), index));
    found
}

#[test]
fn the_optical_length_is_stationary_and_grows_to_second_order() {
    for_all("fermat_stationarity", &PATHS, |elements, case| {
        let crossings = crossings(elements, case);
        let segments = |points: &[Point3<f64>]| -> f64 {
            std::iter::once(&Point3::origin())
                .chain(points)
                .zip(points)
                .zip(&crossings)
                .map(|((a, b), (_, _, index))| index * (b - a).norm())
                .sum()
        };
        let met: Vec<Point3<f64>> = crossings.iter().map(|(point, ..)| *point).collect();
        let least = segments(&met);
        for k in 0..met.len() - 1 {
            let normal = crossings[k].1.normal();
            // A step small against the shortest neighbouring segment (a pane may be thin), large against rounding.
            let before = if k == 0 { Point3::origin() } else { met[k - 1] };
            let size = 1e-2 * (met[k] - before).norm().min((met[k + 1] - met[k]).norm());
            if size < 1e-5 {
                continue;
            }
            for along in [normal.cross(&Vector3::new(0.3, 0.5, -0.8)).normalize(), normal.cross(&Vector3::y())] {
                let length = |distance: f64| {
                    let mut points = met.clone();
                    points[k] += along * distance;
                    segments(&points)
                };
                let growth = |distance: f64| 0.5 * (length(distance) + length(-distance)) - least;
                // First order: none. Second order: doubling the step makes four times the growth.
                let slope = (length(1e-2 * size) - length(-1e-2 * size)) / (2e-2 * size);
                prop_assert!(slope.abs() < 1e-6, "crossing {k}: slope {slope:e}");
                let ratio = growth(2.0 * size) / growth(size);
                prop_assert!(growth(size) > 0.0 && (ratio - 4.0).abs() < 0.05, "crossing {k}: ratio {ratio}");
            }
        }
        Ok(())
    });
}

#[test]
fn reflecting_twice_is_identity() {
    for_all("reflecting_twice", &[&[Element::Mirror]], |_, case| {
        let Surface::Mirror(Mirror { plane }) = case.path.surfaces[0] else { unreachable!("the path is a mirror") };
        let twice = plane.reflect(&plane.reflect(&case.point));
        prop_assert!((twice - case.point).norm() < 1e-14);
        // A point of the plane stays, and a line's reflection keeps its distances.
        let foot = case.point - plane.normal() * plane.signed_distance(&case.point);
        prop_assert!((plane.reflect(&foot) - foot).norm() < 1e-14);
        prop_assert!(
            (plane.signed_distance(&plane.reflect(&case.point)) + plane.signed_distance(&case.point)).abs() < 1e-14
        );
        Ok(())
    });
}

#[test]
fn without_a_tank_it_is_the_mirrored_pinhole() {
    let paths: [&[Element]; 3] = [&[], &[Element::Mirror], &[Element::Mirror, Element::Mirror]];
    for_all("mirrored_pinhole", &paths, |_, case| {
        // The camera sees the point's image: mirrored in the last mirror first. x' = x - 2 (n·x - d) n.
        let mut image = case.point.coords;
        for surface in case.path.surfaces.iter().rev() {
            let Surface::Mirror(Mirror { plane }) = surface else { unreachable!("no walls here") };
            image -= plane.normal() * (2.0 * (plane.normal().dot(&image) - plane.offset_m()));
        }
        let [u, v] = reference::distort(&case.path.lens, (image.x / image.z).into(), (image.y / image.z).into());
        let seen = case.path.project(&case.point)?;
        prop_assert!((seen - Point2::new(u.re, v.re)).norm() < 1e-10);
        Ok(())
    });
}

#[test]
fn a_tank_of_air_is_no_tank() {
    for_all("tank_of_air", &[&[Element::Mirror, Element::In], &[Element::In]], |_, case| {
        let mut air = case.path.clone();
        for surface in &mut air.surfaces {
            if let Surface::Wall(wall) = surface {
                (wall.index_wall, wall.index_inside) = (1.0, 1.0);
            }
        }
        let mut none = case.path.clone();
        none.surfaces.retain(|surface| matches!(surface, Surface::Mirror(_)));
        let (a, b) = (air.trace(&case.pixel)?, none.trace(&case.pixel)?);
        prop_assert!((a.direction - b.direction).norm() < 1e-14);
        prop_assert!((b.at(b.nearest(&a.origin)) - a.origin).norm() < 1e-13);
        Ok(())
    });
}

#[test]
fn light_goes_the_same_way_back() {
    let paths: [&[Element]; 3] = [&[Element::In], &[Element::Out], &[Element::In, Element::Out]];
    for_all("way_back", &paths, |_, case| {
        let there = case.path.trace(&case.pixel)?;
        let first = OpticalPath { surfaces: Vec::new(), ..case.path.clone() }.trace(&case.pixel)?;
        // A camera in the point that looks back along the ray.
        let turn = UnitQuaternion::rotation_between(&-there.direction, &Vector3::z()).unwrap_or_default();
        let back_from_here: Isometry3<f64> = turn * Translation3::from(-case.point.coords);
        let moved = |surface: &Surface| {
            let Surface::Wall(wall) = surface else { unreachable!("no mirrors here") };
            let normal = back_from_here * wall.outer.normal();
            let place = back_from_here * Point3::from(wall.outer.normal() * wall.outer.offset_m());
            Surface::Wall(Wall { outer: Plane::new(normal, normal.dot(&place.coords)).expect("a plane"), ..*wall })
        };
        let back_path =
            OpticalPath { lens: case.path.lens, surfaces: case.path.surfaces.iter().rev().map(moved).collect() };
        let centre = case.path.lens.principal_point_px;
        let back = back_path.trace(&centre)?;
        let camera = back_from_here * Point3::origin();
        prop_assert!((back.direction + back_from_here * first.direction).norm() < 1e-12);
        prop_assert!((back.at(back.nearest(&camera)) - camera).norm() < 1e-11);
        Ok(())
    });
}
