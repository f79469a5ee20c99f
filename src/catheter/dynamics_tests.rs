//! Motions with known answers.

use super::*;
use nalgebra::{Complex, Point3, Rotation3, Vector3};
use std::f64::consts::{PI, TAU};

const FINE: Accuracy = Accuracy { functions: [5, 2], longest_link_m: 2e-3, step_s: 1e-3, rho: 0.9 };

fn bent(ma: f64) -> Load {
    Load::currents(Vector3::new(0.0, 0.4 * ma * 1e-3, ma * 1e-3))
}

fn free() -> Load {
    Load::currents(Vector3::zeros())
}

/// A metre of rod of EI = GJ = 1 N·m² and 1 kg/m, without weight, fluid, or coils.
fn rod() -> Catheter {
    let mut catheter = Catheter::prototype();
    catheter.tube.outer_radius_m = 0.01;
    catheter.tube.inner_radius_m = 0.0;
    catheter.tube.young_pa = 4.0 / (PI * 1e-8);
    catheter.tube.shear_pa = 2.0 / (PI * 1e-8);
    catheter.tube.density_kg_m3 = 1.0 / (PI * 1e-4);
    (catheter.flexible_m, catheter.coil_m, catheter.tail_m) = (0.999, 5e-4, 5e-4);
    (catheter.coils.mass_kg, catheter.coils.volume_m3) = (0.0, 0.0);
    catheter.surroundings.gravity_m_s2 = Vector3::zeros();
    catheter.surroundings.fluid_kg_m3 = 0.0;
    catheter.motion = Motion { damping_s: 0.0, added_mass: 0.0, drag: 0.0, linear_drag_pa_s: 0.0 };
    catheter
}

fn without_losses() -> Catheter {
    let mut catheter = Catheter::prototype();
    catheter.motion = Motion { damping_s: 0.0, added_mass: 1.0, drag: 0.0, linear_drag_pa_s: 0.0 };
    catheter
}

/// Euler and Bernoulli: ω = λ² √(EI/μL⁴), λ = 1.87510, 4.69409.
#[test]
fn a_cantilever_has_the_frequencies_of_beam_theory() {
    let accuracy = Accuracy { functions: [6, 1], longest_link_m: 0.01, ..FINE };
    let simulation = Simulation::at_rest(&rod(), &free(), accuracy).unwrap();
    let found = simulation.frequencies_rad_s().unwrap();
    // In both planes; torsion is far above.
    for (k, expected) in [3.51602, 3.51602, 22.0345, 22.0345].into_iter().enumerate() {
        assert!((found[k] / expected - 1.0).abs() < 1e-3, "{} {expected}", found[k]);
    }
}

/// A stiff rod that hangs: ω² = m g (L/2) / (m L²/3); the period of a swing of 40° is longer by 1 + θ²/16 + 11 θ⁴/3072.
/// Its joint is the short flexible part at the clamp; the stiff part is the coil set.
#[test]
fn a_stiff_pendulum_swings_as_it_should() {
    let mut catheter = rod();
    (catheter.flexible_m, catheter.coil_m, catheter.tail_m) = (1e-3, 0.998, 1e-3);
    // So soft that its hinge has no say, and too short to count.
    (catheter.tube.young_pa, catheter.tube.shear_pa) = (4e-6 / (PI * 1e-8), 2e-6 / (PI * 1e-8));
    catheter.surroundings.gravity_m_s2 = Vector3::new(0.0, 0.0, 9.80665);
    let pull = |angle: f64| 0.5 * 9.80665 * f64::tan(angle);
    let amplitude = 40_f64.to_radians();
    let aside = Load { tip_n: Vector3::new(pull(amplitude), 0.0, 0.0), ..free() };
    let accuracy = Accuracy { functions: [1, 1], longest_link_m: 0.02, step_s: 2e-3, rho: 1.0 };
    let mut swinging = Simulation::at_rest(&catheter, &aside, accuracy).unwrap().released(&free()).unwrap();
    let theta0 = swinging.moment().theta_rad();
    assert!((theta0 - amplitude).abs() < 0.01, "{}", theta0.to_degrees());
    // The time of four passages through the middle: two periods later than the first but a quarter.
    let mut passages = Vec::new();
    let mut before = theta0;
    for k in 1..2600 {
        swinging.advance(accuracy.step_s, |_, _| free()).unwrap();
        let theta = swinging.moment().theta_rad();
        if before * theta < 0.0 {
            passages.push((k as f64 - theta / (theta - before)) * accuracy.step_s);
        }
        before = theta;
    }
    let period = passages[2] - passages[0];
    let small = TAU * (2.0 / (3.0 * 9.80665_f64)).sqrt();
    let expected = small * (1.0 + theta0.powi(2) / 16.0 + 11.0 * theta0.powi(4) / 3072.0);
    assert!((period / expected - 1.0).abs() < 2e-3, "{period} {expected}");
}

#[test]
fn at_rest_the_chain_has_the_shape_of_the_rod() {
    let catheter = Catheter::prototype();
    for (links_m, within_m) in [(4e-3, 15e-6), (2e-3, 4e-6), (1e-3, 1e-6)] {
        let accuracy = Accuracy { longest_link_m: links_m, ..FINE };
        for load in [bent(90.0), Load { tip_n: Vector3::new(1e-4, -2e-4, 3e-4), ..bent(-60.0) }] {
            let shape = equilibrium(&catheter, &load).unwrap();
            let chain = Simulation::at_rest(&catheter, &load, accuracy).unwrap().moment();
            assert!((chain.tip - shape.tip).norm() < within_m, "{links_m}: {:e}", (chain.tip - shape.tip).norm());
        }
    }
}

/// From one shape at rest to the other, as the currents change: in the end it is that of the equilibrium.
#[test]
fn what_is_left_after_a_long_time_is_the_equilibrium() {
    let catheter = Catheter::prototype();
    let mut simulation = Simulation::at_rest(&catheter, &free(), Accuracy::default()).unwrap();
    simulation.advance(20.0, |_, _| bent(90.0)).unwrap();
    let (there, shape) = (simulation.moment(), equilibrium(&catheter, &bent(90.0)).unwrap());
    let rest = Simulation::at_rest(&catheter, &bent(90.0), Accuracy::default()).unwrap().moment();
    assert!((there.tip - rest.tip).norm() < 1e-8, "{:e}", (there.tip - rest.tip).norm());
    assert!((there.tip - shape.tip).norm() < 10e-6, "{:e}", (there.tip - shape.tip).norm());
}

/// Released in a fluid without drag, its inertia and the weight included. Steps must resolve what moves: of the twist
/// about 900 rad/s.
#[test]
fn without_losses_energy_is_kept() {
    let catheter = without_losses();
    let worst = |load: Load, step_s: f64| {
        let accuracy = Accuracy { step_s, rho: 1.0, functions: [3, 1], longest_link_m: 5e-3 };
        let mut swinging = Simulation::at_rest(&catheter, &load, accuracy).unwrap().released(&free()).unwrap();
        let rest = Simulation::at_rest(&catheter, &free(), accuracy).unwrap().energy().potential_j;
        let total = |s: &Simulation| s.energy().kinetic_j + s.energy().potential_j - rest;
        let start = total(&swinging);
        let mut worst = 0.0_f64;
        for _ in 0..20 {
            swinging.advance(0.05, |_, _| free()).unwrap();
            worst = worst.max((total(&swinging) / start - 1.0).abs());
        }
        worst
    };
    // From 40° in a plane: 1.3e-4 and 3.2e-5.
    let in_plane = Load::currents(Vector3::new(0.0, 0.0, 0.09));
    let (coarse, fine) = (worst(in_plane, 1e-3), worst(in_plane, 5e-4));
    assert!(coarse < 2e-4, "{coarse:e}");
    assert!(fine < 0.3 * coarse, "of second order: {coarse:e} {fine:e}");
    // In space, twisted: 3.9e-4.
    let in_space = worst(bent(30.0), 2.5e-4);
    assert!(in_space < 1e-3, "{in_space:e}");
}

#[test]
fn with_losses_energy_only_falls() {
    let catheter = Catheter::prototype();
    let mut swinging =
        Simulation::at_rest(&catheter, &bent(90.0), Accuracy::default()).unwrap().released(&free()).unwrap();
    let total = |s: &Simulation| s.energy().kinetic_j + s.energy().potential_j;
    let start = total(&swinging);
    let mut before = start;
    for _ in 0..200 {
        swinging.advance(0.005, |_, _| free()).unwrap();
        let now = total(&swinging);
        assert!(now <= before + 1e-12 * start.abs(), "{before:e} {now:e}");
        before = now;
    }
}

/// The tip on its way, with steps and links half as long.
#[test]
fn finer_steps_converge_with_second_order() {
    let catheter = Catheter::prototype();
    let way = |step_s: f64| -> Vec<Point3<f64>> {
        let accuracy = Accuracy { step_s, ..Accuracy::default() };
        let mut simulation = Simulation::at_rest(&catheter, &free(), accuracy).unwrap();
        let ramp = |from: f64, to: f64| bent(90.0 * (0.5 * (from + to) / 0.3).min(1.0));
        (0..10)
            .map(|_| {
                simulation.advance(0.05, ramp).unwrap();
                simulation.moment().tip
            })
            .collect()
    };
    let off = |a: &[Point3<f64>], b: &[Point3<f64>]| a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    let (four, two, one) = (way(4e-3), way(2e-3), way(1e-3));
    let order = (off(&four, &two) / off(&two, &one)).log2();
    assert!((1.6..2.4).contains(&order), "{order}");
    // So much is the error of the usual step.
    assert!(off(&two, &one) < 5e-6, "{:e}", off(&two, &one));
}

/// A circle of 20 µm, each point of it held for a few ms: the tip's motion in its fourth period, beside what the
/// linearised equations make of the same currents.
#[test]
fn a_small_fast_path_has_the_linearised_response() {
    let mut catheter = Catheter::prototype();
    // The tip is the middle of its band, not the tube's end.
    catheter.bands = Some(Bands { base_m: 5e-3, tip_m: catheter.length_m() - 15e-3 });
    let middle = Vector3::new(0.0, 0.03, 0.05);
    let rest = equilibrium(&catheter, &Load::currents(middle)).unwrap().tip;
    let targets: Vec<Target> = (0..50)
        .map(|k| f64::from(k) / 50.0 * TAU)
        .map(|t| Target::Across([rest.x + 2e-5 * t.cos(), rest.y + 2e-5 * t.sin()]))
        .collect();
    let followed = follow(&catheter, &targets).unwrap();
    let about = followed.iter().map(|f| f.currents_a).sum::<Vector3<f64>>() / 50.0;
    let accuracy = Accuracy { step_s: 1e-3, ..Accuracy::default() };
    let linear = Simulation::at_rest(&catheter, &Load::currents(about), accuracy).unwrap();
    for pause_s in [0.03, 0.01, 0.004] {
        let period_s = 50.0 * pause_s;
        // From rest at the mean currents; what that begins with has died away after six seconds.
        let periods = f64::max(6.0 / period_s, 4.0).ceil() as u32;
        let rows: Vec<_> = followed.iter().cycle().take(50 * periods as usize).map(|f| f.currents_a).collect();
        let rows = rows.into_iter().enumerate().map(|(k, currents)| (k as f64 * pause_s, currents));
        let commands = Commands::new(&catheter, rows).unwrap();
        let mut simulation = linear.clone();
        let (mut seen, mut given) = (Vector3::zeros(), Vector3::zeros());
        let samples = 100;
        for k in 0..periods * samples {
            let (from, to) = (f64::from(k), f64::from(k + 1));
            let step = period_s / f64::from(samples);
            simulation.advance(step, |a, b| Load::currents(commands.mean(a, b))).unwrap();
            if k < (periods - 1) * samples {
                continue;
            }
            let wave = |at: f64| Complex::from_polar(2.0 / f64::from(samples), -TAU * at / f64::from(samples));
            seen += (simulation.moment().tip - rest).map(|v| wave(to) * v);
            given += (commands.mean(from * step, to * step) - about).map(|v| wave((from + to) / 2.0) * v);
        }
        let expected = linear.response(1.0 / period_s).unwrap() * given;
        let (ratio, still) = (seen.norm() / expected.norm(), (linear.response(0.0).unwrap() * given).norm());
        let phase = expected.dotc(&seen).arg();
        println!(
            "{pause_s}: {:.3} of the static size, ratio {ratio:.4}, phase {:.3}°",
            seen.norm() / still,
            phase.to_degrees()
        );
        // What the drag's quadratic part adds at this size; at ten times of it 1.5 % and 1.7°.
        assert!((ratio - 1.0).abs() < 5e-3 && phase.abs() < 5e-3, "{pause_s}: {ratio} {phase}");
    }
}

/// Steps that were halved where the current jumps had the tip 0.7 mm off, with some times of the jump.
#[test]
fn a_jump_of_the_current_may_come_anywhere_in_a_step() {
    let mut catheter = Catheter::prototype();
    (catheter.tube.young_pa, catheter.tube.shear_pa) = (5.0e6, 2.1e6);
    catheter.tube.rest_curvature_per_m = Vector3::new(0.4, -0.3, 0.0);
    catheter.coils.moment_per_ampere_m2 =
        Rotation3::from_axis_angle(&Vector3::z_axis(), 4_f64.to_radians()) * catheter.coils.moment_per_ampere_m2;
    catheter.motion.damping_s = 0.014;
    let [before, after] = [[0.01, 0.05, 0.06], [0.04, -0.04, -0.05]].map(Vector3::from);
    let tips = |jump_s: f64, step_s: f64| -> Vec<Point3<f64>> {
        let accuracy = Accuracy { step_s, ..Accuracy::default() };
        let load = |from_s: f64, to_s: f64| {
            let part = ((to_s - jump_s) / (to_s - from_s)).clamp(0.0, 1.0);
            Load::currents(before * (1.0 - part) + after * part)
        };
        let mut simulation = Simulation::at_rest(&catheter, &load(-1.0, 0.0), accuracy).unwrap();
        let mut frame = || {
            simulation.advance(1.0 / 60.0, load).unwrap();
            simulation.moment().tip
        };
        (0..6).map(|_| frame()).collect()
    };
    for jump_s in [0.008, 0.011, 0.012] {
        let pairs = tips(jump_s, 4e-3).into_iter().zip(tips(jump_s, 0.5e-3));
        let off_m = pairs.map(|(coarse, fine)| (coarse - fine).norm()).fold(0.0, f64::max);
        assert!(off_m < 0.26e-3, "{jump_s}: {off_m}");
    }
}
