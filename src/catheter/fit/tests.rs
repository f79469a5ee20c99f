//! Simulated experiments: what they were made with must come back, within its σ.

use super::*;
use crate::catheter::fit::search::Residuals;
use crate::catheter::record::{record, seen};
use crate::testing::random::Random;
use nalgebra::Vector3;

const NOISE: Noise = Noise { point_m: 0.04e-3, angle_rad: 0.15 * std::f64::consts::PI / 180.0, missing: 0.05 };

fn truth() -> (Catheter, f64) {
    let mut catheter = Catheter::prototype();
    let mut delay_s = 0.0;
    for (parameter, value) in [
        (Parameter::Young, 6.3e6),
        (Parameter::Shear, 1.9e6),
        (Parameter::Alignment, -0.12),
        (Parameter::CurvatureX, 0.4),
        (Parameter::CurvatureY, -0.6),
        (Parameter::Damping, 0.02),
        (Parameter::Drag, 1.4),
        (Parameter::Delay, 0.035),
    ] {
        parameter.set(value, &mut catheter, &mut delay_s);
    }
    (catheter, delay_s)
}

/// Holds of 4 s at these currents (mA), from 1 s on.
fn experiment((catheter, delay_s): (Catheter, f64), levels_ma: &[[f64; 3]], accuracy: Accuracy, seed: u64) -> Run {
    let hold_s = 4.0;
    let rows = levels_ma.iter().enumerate().map(|(k, ma)| (1.0 + hold_s * k as f64, Vector3::from(*ma) * 1e-3));
    let commands = Commands::new(&catheter, rows).unwrap();
    let frames = (60.0 * (1.0 + hold_s * levels_ma.len() as f64)) as u64;
    let times = (0..frames).map(|k| k as f64 / 60.0);
    let moments = record(&catheter, &commands.later(delay_s), Vector3::zeros(), times, accuracy).unwrap();
    Run { name: format!("seed {seed}"), commands, sightings: seen(&moments, NOISE, seed), bands: catheter.bands }
}

/// The model's own error is tested elsewhere; here it is the same on both sides, and coarse.
fn accuracy() -> Accuracy {
    Accuracy { functions: [3, 1], longest_link_m: 7e-3, step_s: 4e-3, rho: 0.8 }
}

fn options(parameters: &[Parameter]) -> FitOptions {
    FitOptions {
        parameters: parameters.to_vec(),
        settle_s: 2.0,
        only_still: false,
        accuracy: accuracy(),
        stated_noise: None,
    }
}

const LEVELS: [[f64; 3]; 4] = [[0.0, 50.0, 60.0], [0.0, -50.0, -30.0], [40.0, 20.0, 80.0], [0.0, 0.0, 0.0]];

/// Derivatives of the residuals at the truth.
fn derivatives(catheter: &Catheter, delay_s: f64, runs: &[Run]) -> DMatrix<f64> {
    let parameters = &Parameter::DEFAULT;
    let model = Moving { start: catheter, delay_s, parameters, runs, noise: NOISE, accuracy: accuracy() };
    let at = start_of(catheter, delay_s, parameters);
    let columns: Vec<DVector<f64>> = parameters
        .iter()
        .enumerate()
        .map(|(k, parameter)| {
            let side = |sign: f64| {
                let mut moved = at.clone();
                moved[k] += sign * parameter.step();
                model.at(&moved).unwrap()
            };
            (side(1.0) - side(-1.0)) / (2.0 * parameter.step())
        })
        .collect();
    DMatrix::from_columns(&columns)
}

/// Over 20 seeds the RMS of (found − true)/σ is 1.15, and 92.5 % of the 160 values are within 2 σ; here one seed. The
/// test below sees more of them.
#[test]
fn parameters_of_simulated_experiments_come_back_within_their_sigma() {
    let seeds: u64 = std::env::var("CATOPTRA_SEEDS").ok().and_then(|s| s.parse().ok()).unwrap_or(1);
    let (catheter, delay_s) = truth();
    let truth_of = |p: Parameter| if p == Parameter::Alignment { -0.12 } else { p.of(&catheter, delay_s) };
    let mut all = Vec::new();
    for seed in 0..seeds {
        let run = experiment(truth(), &LEVELS, accuracy(), seed);
        let fit = fit(&Catheter::prototype(), 0.0, &[run], &options(&Parameter::DEFAULT)).unwrap();
        assert_eq!(fit.open, []);
        assert!((fit.noise.point_m / NOISE.point_m - 1.0).abs() < 0.1, "{:?}", fit.noise);
        assert!((fit.misfit - 1.0).abs() < 0.05, "{}", fit.misfit);
        for e in &fit.estimated {
            let z = (e.value - truth_of(e.parameter)) / e.sd;
            println!("{seed} {:?} {} ± {} z {z:.2}", e.parameter, e.value, e.sd);
            all.push(z);
        }
    }
    let rms = (all.iter().map(|z| z * z).sum::<f64>() / all.len() as f64).sqrt();
    println!("RMS z {rms:.2}");
    // Of eight values: 99.9 % of draws are below 1.8. Seed 0 has 1.70, its curvature about x being 3 σ off.
    assert!((0.3..1.8).contains(&rms), "{rms}");
    assert!(all.iter().all(|z| z.abs() < 4.0), "{all:?}");
}

/// As in pictures that a coder repeats while nothing moves.
#[test]
fn noise_is_not_less_than_the_tracker_states() {
    let run = experiment(truth(), &LEVELS, accuracy(), 3);
    let stated = Noise { point_m: 3.0 * NOISE.point_m, angle_rad: 0.5 * NOISE.angle_rad, missing: 0.0 };
    let options =
        FitOptions { only_still: true, stated_noise: Some(stated), ..options(&[Parameter::Young, Parameter::Shear]) };
    let fit = fit(&Catheter::prototype(), 0.0, &[run], &options).unwrap();
    assert!((fit.noise.point_m / stated.point_m - 1.0).abs() < 1e-9, "{:?}", fit.noise);
    assert!((fit.noise.angle_rad / NOISE.angle_rad - 1.0).abs() < 0.1, "{:?}", fit.noise);
}

/// The same for noise of frames that hangs together, and for noise that does not: RMS of (found − true)/σ over 60
/// seeds.
#[test]
fn sigma_covers_noise_that_hangs_together() {
    let (catheter, delay_s) = truth();
    let runs = vec![experiment(truth(), &LEVELS, accuracy(), 0)];
    let by = derivatives(&catheter, delay_s, &runs);
    let covariance = by.tr_mul(&by).cholesky().unwrap().inverse();
    let series = correlated::series(&runs);
    assert_eq!(series.iter().flatten().flatten().max(), Some(&(by.nrows() - 1)));
    for rho in [0.0, 0.9, 0.97] {
        let mut squares = DVector::zeros(Parameter::DEFAULT.len());
        let mut random = Random::new(7);
        for _ in 0..60 {
            let mut noise = DVector::zeros(by.nrows());
            for rows in &series {
                let mut last = random.normal();
                for row in rows {
                    last = rho * last + f64::sqrt(1.0 - rho * rho) * random.normal();
                    row.iter().for_each(|row| noise[*row] = last);
                }
            }
            let off = &covariance * by.tr_mul(&noise);
            let residuals = noise - &by * &off;
            let variance = residuals.norm_squared() / (by.nrows() - by.ncols()) as f64;
            let found = Found {
                coordinates: DVector::zeros(by.ncols()),
                residuals,
                jacobian: by.clone(),
                information: by.tr_mul(&by),
                settled: true,
            };
            let widening = DVector::from_vec(correlated::widening(&found, &covariance, &series));
            let predicted = covariance.diagonal().component_mul(&widening) * variance;
            squares += off.component_mul(&off).component_div(&predicted);
        }
        let rms = (squares / 60.0).map(f64::sqrt);
        // Of 60 seeds their own scatter is 0.09.
        assert!(rms.iter().all(|z| (0.7..1.35).contains(z)), "{rho}: {rms}");
    }
}

/// The estimate that is linear about the truth, for which a seed costs next to nothing: RMS of (found − true)/σ over
/// 100 seeds.
#[test]
fn sigma_is_as_large_as_the_scatter() {
    let (catheter, delay_s) = truth();
    let run = |seed| vec![experiment(truth(), &LEVELS, accuracy(), seed)];
    let runs = run(0);
    let by = derivatives(&catheter, delay_s, &runs);
    let covariance = by.tr_mul(&by).cholesky().unwrap().inverse();
    let moments = moving::moments(&catheter, delay_s, &runs[0], accuracy()).unwrap();
    let there: Vec<bool> = runs[0].sightings.iter().map(|s| s.tip.is_some()).collect();
    let mut squares = DVector::zeros(Parameter::DEFAULT.len());
    for seed in 0..100 {
        let mut left = Vec::new();
        let all = seen(&moments, Noise { missing: 0.0, ..NOISE }, 1000 + seed);
        for ((sighting, moment), _) in all.iter().zip(&moments).zip(&there).filter(|(_, there)| **there) {
            still::push(&mut left, sighting, (&moment.coil, &moment.tip, &moment.tangent), NOISE, 1.0);
        }
        let off = -(&covariance * by.tr_mul(&DVector::from_vec(left)));
        squares += off.component_mul(&off).component_div(&covariance.diagonal());
    }
    let rms = (squares / 100.0).map(f64::sqrt);
    println!("{}", rms.transpose());
    // 0.94 to 1.10; of 100 seeds its own scatter is 0.07.
    assert!(rms.iter().all(|z| (0.7..1.3).contains(z)), "{rms}");
}

#[test]
fn one_coil_at_rest_leaves_twist_alignment_and_motion_open() {
    let mut straight = Catheter::prototype();
    straight.tube.young_pa = 6.3e6;
    // σ of E is 0.01 %: links must be short.
    let fine = Accuracy { longest_link_m: 1e-3, ..accuracy() };
    let run = experiment((straight, 0.0), &[[0.0, 0.0, 60.0], [0.0, 0.0, -60.0]], fine, 3);
    let still = FitOptions { only_still: true, ..options(&Parameter::DEFAULT) };
    let fit = fit(&Catheter::prototype(), 0.0, &[run], &still).unwrap();
    let mut open: Vec<Parameter> = fit.open.iter().map(|o| o.parameter).collect();
    open.sort_unstable();
    let motion = [Parameter::Damping, Parameter::Drag, Parameter::Delay];
    assert_eq!(open, [&[Parameter::Shear, Parameter::Alignment][..], &motion].concat());
    let young = fit.estimated.iter().find(|e| e.parameter == Parameter::Young).unwrap();
    assert!((young.value - 6.3e6).abs() < 3.0 * young.sd && young.sd < 0.01e6, "{young:?}");
}

/// What a tracker sees is counted from the base band, and its tip is the middle of a band.
#[test]
fn a_run_is_fitted_by_the_places_of_its_bands() {
    let mut catheter = Catheter::prototype();
    catheter.tube.young_pa = 6.3e6;
    catheter.bands = Some(Bands { base_m: 6e-3, tip_m: catheter.length_m() - 3e-3 });
    let fine = Accuracy { longest_link_m: 1e-3, ..accuracy() };
    let run = experiment((catheter.clone(), 0.0), &[[0.0, 40.0, 60.0], [0.0, -40.0, -60.0]], fine, 3);
    let options = FitOptions { only_still: true, accuracy: fine, ..options(&[Parameter::Young, Parameter::Shear]) };
    let found = |run: &Run| {
        let fit = fit(&Catheter::prototype(), 0.0, std::slice::from_ref(run), &options).unwrap();
        let doubt = check(&fit.catheter, 0.0, run, fine).unwrap().doubt();
        (fit, doubt)
    };
    let (fit, doubt) = found(&run);
    for (e, truth) in fit.estimated.iter().zip([6.3e6, catheter.tube.shear_pa]) {
        assert!((e.value - truth).abs() < 3.5 * e.sd && e.sd < 0.01 * truth, "{e:?}");
    }
    assert!(fit.misfit < 1.3 && doubt.is_none(), "{} {doubt:?}", fit.misfit);
    // As if it counted from the clamp: the base band is 6 mm off, the tip's by 3 mm more.
    let mut wrong = run;
    wrong.bands = None;
    let base = Vector3::z() * 6e-3;
    for seen in &mut wrong.sightings {
        (seen.coil, seen.tip) = (seen.coil.map(|p| p - base), seen.tip.map(|p| p - base));
    }
    let (fit, doubt) = found(&wrong);
    let doubt = doubt.unwrap();
    assert!(fit.misfit > 10.0 && doubt.contains("in all frames alike the coil is seen -"), "{doubt}");
}

#[test]
fn a_coil_that_is_reversed_is_told_from_the_shapes_at_rest() {
    let mut catheter = Catheter::prototype();
    catheter.tube.young_pa = 6.1e6;
    catheter.tube.shear_pa = 2.1e6;
    let levels = [[0.0, 40.0, 60.0], [0.0, -40.0, 60.0], [30.0, 40.0, -60.0], [30.0, -40.0, -50.0], [20.0, 0.0, 50.0]];
    let fine = Accuracy { longest_link_m: 1e-3, ..accuracy() };
    let run = experiment((catheter.clone(), 0.0), &levels, fine, 3);
    let still = FitOptions { only_still: true, accuracy: fine, ..options(&[Parameter::Young, Parameter::Shear]) };
    let told = |run: Run| match fit(&Catheter::prototype(), 0.0, &[run], &still) {
        Ok(fit) => fit.doubts().join("\n"),
        Err(why) => why.to_string(),
    };
    assert_eq!(told(run.clone()), "");
    let mut reversed = run;
    let rows = levels.iter().enumerate().map(|(k, [x, y, z])| (1.0 + 4.0 * k as f64, Vector3::new(*x, -y, *z) * 1e-3));
    reversed.commands = Commands::new(&catheter, rows).unwrap();
    let told = told(reversed);
    assert!(told.contains("driven by the currents x, −y, z,"), "{told}");
}
