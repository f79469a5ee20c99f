//! Rods with known answers, and the paper's prototype.

use super::load::all_forces;
use super::rod::Section;
use super::*;
use nalgebra::{Point3, Vector3};
use std::f64::consts::PI;

/// A metre of rod of EI = GJ = 1 N·m² with a coil set so short that it does not matter, no weight.
fn rod() -> Catheter {
    let mut catheter = Catheter::prototype();
    catheter.tube.outer_radius_m = 1.0;
    catheter.tube.inner_radius_m = 0.0;
    catheter.tube.young_pa = 4.0 / PI;
    catheter.tube.shear_pa = 2.0 / PI;
    (catheter.flexible_m, catheter.coil_m, catheter.tail_m) = (0.5 - 5e-10, 1e-9, 0.5 - 5e-10);
    catheter.surroundings.gravity_m_s2 = Vector3::zeros();
    catheter
}

fn pushed(catheter: &Catheter, tip_n: Vector3<f64>, tip_nm: Vector3<f64>) -> Shape {
    equilibrium(catheter, &Load { currents_a: Vector3::zeros(), tip_n, tip_nm }).unwrap()
}

#[test]
fn a_small_force_bends_as_beam_theory_says() {
    let shape = pushed(&rod(), Vector3::new(1e-4, 0.0, 0.0), Vector3::zeros());
    assert!((shape.tip.x / (1e-4 / 3.0) - 1.0).abs() < 1e-6, "{}", shape.tip.x);
}

/// Euler's elastica under a force across the unbent rod, from Mattiasson, "Numerical results from large deflection beam
/// and frame problems analysed by means of elliptic integrals" (1981), doi:10.1002/nme.1620170113: F L²/EI, tip across
/// and the way it has come towards the clamp, as parts of L, and its slope.
#[test]
fn a_large_force_bends_as_the_elastica() {
    for (force, across, shorter, slope) in
        [(1.0, 0.30172, 0.05643, 0.46135), (4.0, 0.66996, 0.32894, 1.12124), (10.0, 0.81061, 0.55500, 1.43029)]
    {
        let shape = pushed(&rod(), Vector3::new(force, 0.0, 0.0), Vector3::zeros());
        assert!((shape.tip.x - across).abs() < 6e-6, "{force}: {}", shape.tip.x);
        assert!((1.0 - shape.tip.z - shorter).abs() < 6e-6, "{force}: {}", shape.tip.z);
        let end = shape.tip_frame * Vector3::z();
        assert!((end.x.atan2(end.z) - slope).abs() < 6e-6, "{force}: {}", end.x.atan2(end.z));
    }
}

#[test]
fn a_couple_bends_into_a_circle() {
    let turn = 2.5;
    let shape = pushed(&rod(), Vector3::zeros(), Vector3::new(0.0, turn, 0.0));
    let expected = Point3::new((1.0 - turn.cos()) / turn, 0.0, turn.sin() / turn);
    assert!((shape.tip - expected).norm() < 1e-8, "{}", shape.tip);
}

#[test]
fn a_couple_along_the_rod_twists_it() {
    let mut catheter = rod();
    catheter.tube.shear_pa *= 0.5;
    let shape = pushed(&catheter, Vector3::zeros(), Vector3::new(0.0, 0.0, 0.4));
    assert!((shape.tip_frame.scaled_axis() - Vector3::new(0.0, 0.0, 0.8)).norm() < 1e-9);
    assert!((shape.tip - Point3::new(0.0, 0.0, 1.0)).norm() < 1e-12);
}

/// A straight column buckles under F = π² EI / (4 L²) (Euler); below it stands, beyond it is refused.
#[test]
fn a_column_stands_up_to_eulers_force() {
    let push = |part: f64| {
        let tip_n = Vector3::new(0.0, 0.0, -part * PI * PI / 4.0);
        equilibrium(&rod(), &Load { currents_a: Vector3::zeros(), tip_n, tip_nm: Vector3::zeros() })
    };
    assert!(push(0.999).is_ok());
    let error = push(1.01).map(|shape| shape.tip).unwrap_err().to_string();
    assert!(error.starts_with("at 99 % of the load the shape becomes unstable"), "{error}");
}

#[test]
fn a_finer_integration_changes_nothing() {
    let catheter = Catheter::prototype();
    let load = Load::currents(Vector3::new(0.05, 0.08, 0.1));
    let shape = equilibrium(&catheter, &load).unwrap();
    let forces = all_forces(&catheter, &load);
    let clamp = |finer: usize| catheter.integrate(&shape.tip_frame, &forces, finer);
    let off = |a: &[Section], b: &[Section]| {
        (a[0].point - b[0].point).norm().max(a.last().unwrap().frame.angle_to(&b.last().unwrap().frame) * 0.1)
    };
    let (one, two, four) = (clamp(1), clamp(2), clamp(4));
    assert!(off(&one, &two) < 1e-9, "{:e}", off(&one, &two));
    // Fourth order.
    let order = (off(&one, &two) / off(&two, &four)).log2();
    assert!((3.5..4.5).contains(&order), "{order}");
}

#[test]
fn the_moment_at_the_clamp_balances_all_that_acts() {
    let catheter = Catheter::prototype();
    let load = Load { tip_n: Vector3::new(1e-4, -2e-4, 3e-4), ..Load::currents(Vector3::new(-0.05, 0.08, 0.1)) };
    let shape = equilibrium(&catheter, &load).unwrap();
    let sections = catheter.integrate(&shape.tip_frame, &all_forces(&catheter, &load), 1);
    let coil = sections.iter().find(|s| (s.arc_m - catheter.flexible_m - catheter.coil_m / 2.0).abs() < 1e-9).unwrap();
    let magnetic =
        (coil.frame * (catheter.coils.moment_per_ampere_m2 * load.currents_a)).cross(&catheter.surroundings.b0_t);
    // The rod's centre of mass, by the trapezoidal rule.
    let tube: Vector3<f64> = shape
        .centre_line
        .windows(2)
        .map(|w| (w[0].1.coords + w[1].1.coords) / 2.0 * (w[1].0 - w[0].0))
        .sum::<Vector3<f64>>()
        .cross(&catheter.tube_weight_n_m());
    let expected =
        magnetic + shape.tip.coords.cross(&load.tip_n) + tube + shape.coil.coords.cross(&catheter.coil_weight_n());
    assert!((shape.clamp_nm - expected).norm() < 1e-4 * expected.norm(), "{} {expected}", shape.clamp_nm);
}

#[test]
fn opposite_currents_bend_to_opposite_sides() {
    let catheter = Catheter::prototype();
    let theta =
        |ma: f64| equilibrium(&catheter, &Load::currents(Vector3::new(0.0, 0.0, ma * 1e-3))).unwrap().theta_rad();
    assert!((theta(70.0) + theta(-70.0)).abs() < 1e-9);
    assert!(theta(0.0).abs() < 1e-12);
}

/// The paper has 48° at most (Section III.B). The model has 43.9° with E = 5.39 MPa and 34.4° with 8.22 MPa, the two
/// values its laboratory fitted to other runs; 48° would take 4.5 MPa. The couple counts as much as the stiffness does:
/// 48° needs a fifth more of either.
#[test]
fn the_prototype_bends_about_as_far_as_the_paper_reports() {
    let theta_deg = |young_pa: f64| {
        let mut catheter = Catheter::prototype();
        catheter.tube.young_pa = young_pa;
        equilibrium(&catheter, &Load::currents(Vector3::new(0.0, 0.0, 0.1))).unwrap().theta_rad().to_degrees()
    };
    for (young_pa, expected) in [(5.39e6, 43.9), (8.22e6, 34.4), (4.5e6, 47.9)] {
        assert!((theta_deg(young_pa) - expected).abs() < 0.1, "{young_pa}: {}", theta_deg(young_pa));
    }
}

#[test]
fn the_sensitivity_is_that_of_small_changes_and_has_rank_two() {
    let catheter = Catheter::prototype();
    let load = Load::currents(Vector3::new(0.03, -0.05, 0.06));
    let shape = equilibrium(&catheter, &load).unwrap();
    let by = shape.sensitivity(&catheter).unwrap();
    let step = Vector3::new(2e-5, -1e-5, 3e-5);
    let moved = equilibrium(&catheter, &Load::currents(load.currents_a + step)).unwrap();
    assert!((moved.tip - shape.tip - by.tip_m_a * step).norm() < 1e-8, "{}", (moved.tip - shape.tip).norm());
    let singular = by.tip_m_a.svd(false, false).singular_values;
    assert!(singular[2] < 1e-6 * singular[0] && singular[1] > 1e-2 * singular[0], "{singular}");
}

#[test]
fn currents_beyond_the_limit_are_refused() {
    let error = equilibrium(&Catheter::prototype(), &Load::currents(Vector3::new(0.0, 0.2, 0.0))).unwrap_err();
    assert_eq!(error.to_string(), "coil y: 200 mA is beyond the limit of 100 mA");
}
