//! The estimators and the search, on simulated records.

use crate::identify::IdentifyError;
use crate::identify::chain::settings::{Choice, Estimator, Settings};
use crate::identify::chain::steps::identify;
use crate::identify::checks::diagnostic::Diagnostic;
use crate::identify::data::segments::{Data, Record, Segment};
use crate::identify::estimate::arx::fit;
use crate::identify::estimate::estimated::Estimated;
use crate::identify::estimate::search::{self, Criterion, best};
use crate::identify::estimate::{instrumental, output_error};
use crate::identify::model::polynomials::{Orders, Polynomials, all_pole};
use crate::identify::model::reproduction::InitialState;
use crate::identify::reduce::truncation::{Removal, Target};
use crate::identify::solve::regression::row;
use crate::testing::random::Random;
use nalgebra::DMatrix;
use std::f64::consts::TAU;

/// White noise of variance 1.
pub(crate) fn noise(seed: u64, n: usize) -> Vec<f64> {
    Random::new(seed).normals(n)
}

fn truth() -> Polynomials {
    Polynomials { a: vec![1.0, -1.5, 0.7], b: vec![1.0, 0.5], nk: 1 }
}

/// ARX: noise goes through 1/A.
fn arx_data(seed: u64, n: usize, sd: f64) -> Segment {
    let input = noise(seed, n);
    let disturbance = all_pole(&truth().a, noise(seed + 1000, n));
    let output = truth().simulate(&input).iter().zip(disturbance).map(|(y, e)| y + sd * e).collect();
    Segment { input, output, from_rest: true, ..Segment::default() }
}

fn oe_data(seed: u64, n: usize, sd: f64) -> Segment {
    let input = noise(seed, n);
    let output = truth().simulate(&input).iter().zip(noise(seed + 1000, n)).map(|(y, e)| y + sd * e).collect();
    Segment { input, output, from_rest: true, ..Segment::default() }
}

const ORDERS: Orders = Orders { na: 2, nb: 2, nk: 1 };

#[test]
fn without_noise_the_coefficients_are_exact() {
    let found = fit(&[arx_data(1, 200, 0.0)], ORDERS).unwrap();
    assert!((found.model.parameters() - truth().parameters()).amax() < 1e-12, "{found:?}");
}

/// Mean square of error/σ over 200 draws: 1 ± √(2/200).
fn scatter(estimate: impl Fn(u64) -> Estimated) -> Vec<f64> {
    const DRAWS: u64 = 200;
    let mut sums = vec![0.0; 4];
    for seed in 1..=DRAWS {
        let found = estimate(seed);
        let error = found.model.parameters() - truth().parameters();
        for ((sum, error), sd) in sums.iter_mut().zip(error.iter()).zip(found.standard_errors()) {
            *sum += (error / sd).powi(2) / DRAWS as f64;
        }
    }
    sums
}

#[test]
fn errors_are_as_large_as_predicted() {
    let arx = scatter(|seed| fit(&[arx_data(seed, 500, 0.5)], ORDERS).unwrap());
    assert!(arx.iter().all(|s| (0.7..1.35).contains(s)), "ARX {arx:?}");
    let start = fit(&[oe_data(1, 500, 0.0)], ORDERS).unwrap().model;
    let oe = scatter(|seed| output_error::refine(&[oe_data(seed, 500, 1.0)], &start).unwrap().estimated);
    assert!(oe.iter().all(|s| (0.7..1.35).contains(s)), "output error {oe:?}");
    let iv = scatter(|seed| instrumental::refine(&[oe_data(seed, 500, 1.0)], &start).unwrap().estimated);
    assert!(iv.iter().all(|s| (0.7..1.35).contains(s)), "instrumental {iv:?}");
}

/// Noise at the output that is similar from sample to sample, as a tracker's or that of a vibration.
#[test]
fn errors_of_output_error_are_as_large_as_predicted_in_coloured_noise() {
    let start = fit(&[oe_data(1, 500, 0.0)], ORDERS).unwrap().model;
    let coloured = |seed: u64| {
        let input = noise(seed, 500);
        let disturbance = all_pole(&[1.0, -0.9], noise(seed + 1000, 500));
        let output = truth().simulate(&input).iter().zip(disturbance).map(|(y, e)| y + 0.4 * e).collect();
        Segment { input, output, from_rest: true, ..Segment::default() }
    };
    let found = scatter(|seed| output_error::refine(&[coloured(seed)], &start).unwrap().estimated);
    assert!(found.iter().all(|s| (0.7..1.5).contains(s)), "{found:?}");
}

/// Two records whose outputs have zeros of their own, each with a hole; the input follows the zero.
fn with_zeros(seed: u64) -> Vec<Segment> {
    const WEIGHT: f64 = 0.1;
    let zeros = noise(seed + 2000, 2);
    let record = |record: usize, zero: f64| {
        let whole = oe_data(seed + 5000 * record as u64, 400, 1.0);
        let response = truth().simulate(&[WEIGHT; 400]);
        let output = whole.output.iter().zip(response).map(|(y, r)| y + 10.0 * zero * (1.0 + r)).collect();
        let whole = Segment { output, by_zero: Some(vec![WEIGHT; 400]), record, ..whole };
        [whole.part(0, 250, 1.0), whole.part(260, 400, 1.0)]
    };
    zeros.into_iter().enumerate().flat_map(|(k, zero)| record(k, zero)).collect()
}

#[test]
fn errors_are_as_large_as_predicted_whatever_the_zeros_are() {
    let start = fit(&[oe_data(1, 500, 0.0)], ORDERS).unwrap().model;
    let found = scatter(|seed| output_error::refine(&with_zeros(seed), &start).unwrap().estimated);
    assert!(found.iter().all(|s| (0.7..1.35).contains(s)), "{found:?}");
    // Taken for exact they bend the model.
    let exact = |seed| with_zeros(seed).into_iter().map(|s| Segment { by_zero: None, ..s }).collect::<Vec<_>>();
    let bent = scatter(|seed| output_error::refine(&exact(seed), &start).unwrap().estimated);
    assert!(bent.iter().any(|s| *s > 3.0), "{bent:?}");
}

/// Means or lines were taken off input and output that no state of rest has.
#[test]
fn errors_are_as_large_as_predicted_where_an_offset_and_a_drift_are_left() {
    let start = fit(&[oe_data(1, 500, 0.0)], ORDERS).unwrap().model;
    let off = |seed: u64, [offset, slope]: [f64; 2]| {
        let mut segment = oe_data(seed, 500, 1.0);
        segment.output.iter_mut().enumerate().for_each(|(t, y)| *y += offset + slope * t as f64);
        let segment = Segment { by_zero: Some(vec![0.0; 500]), zero_drifts: true, ..segment };
        output_error::refine(&[segment], &start).unwrap().estimated
    };
    let found = scatter(|seed| off(seed, [3.0, 0.02]));
    assert!(found.iter().all(|s| (0.7..1.35).contains(s)), "{found:?}");
    // Whatever they are.
    let [one, other] = [[0.0, 0.0], [-20.0, 0.1]].map(|line| off(1, line));
    let apart = (one.model.parameters() - other.model.parameters())
        .component_div(&nalgebra::DVector::from_vec(one.covariance.standard_errors()));
    assert!(apart.amax() < 1e-3, "{apart}");
}

pub(crate) fn settings(choice: Choice) -> Settings {
    Settings {
        choice,
        estimator: Estimator::Arx,
        initial_state: InitialState::Rest,
        target: Target::Order(2),
        removal: Removal::default(),
        all_frequencies: false,
        bootstrap: 0,
        repeats: None,
        commanded: false,
        doubtful: false,
    }
}

fn records(segment: Segment) -> Vec<Record> {
    vec![Record { name: "record".to_owned(), segments: vec![segment] }]
}

/// The commands act later than told by a random multiple of σ of their delay, 5 % of a sample.
#[test]
fn sigma_of_the_delay_is_in_that_of_the_model() {
    let mut squares = [[0.0; 4]; 2];
    for seed in 0..40 {
        let input = all_pole(&[1.0, -0.8], noise(seed, 1000));
        let before = |k: usize| k.checked_sub(1).and_then(|k| input.get(k)).copied().unwrap_or_default();
        let by_delay: Vec<f64> = input.iter().enumerate().map(|(k, u)| 0.05 * (before(k) - u)).collect();
        let output = truth().simulate(&input).iter().zip(noise(seed + 1000, 1000)).map(|(y, e)| y + 0.1 * e).collect();
        let off = noise(seed + 2000, 1)[0];
        let told: Vec<f64> = input.iter().zip(&by_delay).map(|(u, by_delay)| u + off * by_delay).collect();
        let segment = Segment { input: told, output, by_delay: Some(by_delay), from_rest: true, ..Segment::default() };
        let without = output_error::refine(std::slice::from_ref(&segment), &truth()).unwrap().estimated;
        let again = |delayed: &[Segment], model: &Polynomials| Some(output_error::nearest(delayed, model).ok()?.model);
        let with = without.clone().with_delays(&[segment], again);
        for (found, squares) in [with, without].iter().zip(&mut squares) {
            let off = found.model.parameters() - truth().parameters();
            let each = off.iter().zip(found.standard_errors());
            squares.iter_mut().zip(each).for_each(|(sum, (off, sd))| *sum += (off / sd).powi(2) / 40.0);
        }
    }
    assert!(squares[0].iter().all(|z2| (0.3..2.0).contains(z2)), "{squares:?}");
    assert!(squares[1].iter().any(|z2| *z2 > 9.0), "{squares:?}");
}

/// As with milliamperes for amperes.
#[test]
fn a_record_to_judge_by_in_other_units_is_told() {
    let told = |factor: f64| {
        let mut judging = oe_data(2, 500, 0.1);
        judging.input.iter_mut().for_each(|u| *u *= factor);
        let training = records(oe_data(1, 500, 0.1));
        let data = Data { training, validation: records(judging), period_s: 0.02 };
        let found = identify(&data, &settings(Choice::Fixed(ORDERS))).unwrap();
        found.diagnostics.iter().any(|d| matches!(d, Diagnostic::StrangeRecord { .. }))
    };
    assert!(told(1000.0) && told(-1.0) && !told(1.0));
}

/// A slow input tells a full model of many coefficients little about the delay, and the refined one all.
#[test]
fn the_refined_model_finds_its_own_delay() {
    let truth = Polynomials { a: vec![1.0, -1.887, 0.916], b: vec![0.03, 0.028], nk: 1 };
    let orders = (1..=8).flat_map(|n| (1..=5).map(move |nk| Orders { na: n, nb: n, nk }));
    let settings = settings(Choice::Search { candidates: orders.collect(), criterion: None });
    for seed in 1..=4 {
        let chirp = |t: f64| (TAU * (0.2 + 0.047 * t) * t).sin();
        let input: Vec<f64> = (0..1500).map(|k| chirp(f64::from(k) * 0.02)).collect();
        let output = truth.simulate(&input).iter().zip(noise(seed, 1500)).map(|(y, e)| y + 0.1 * e).collect();
        let segment = Segment { input, output, from_rest: true, ..Segment::default() };
        let data = Data { training: records(segment), period_s: 0.02, ..Data::default() };
        let found = identify(&data, &settings).unwrap().refined.unwrap().estimated;
        assert_eq!(found.model.nk, 1, "{seed}");
        let error = found.model.parameters() - truth.parameters();
        let z: Vec<f64> = error.iter().zip(found.standard_errors()).map(|(e, sd)| e / sd).collect();
        assert!(z.iter().all(|z| z.abs() < 4.0), "{seed}: {z:?}");
    }
}

/// Noise of a fifth of the output hides a sample of delay: the shortest is taken, and the other is told.
#[test]
fn of_delays_that_explain_about_as_well_the_shortest_is_taken() {
    // 40/(s² + 4 s + 40) at 60 Hz.
    let truth = Polynomials { a: vec![1.0, -1.924_768, 0.935_507], b: vec![0.005_429, 0.005_310], nk: 1 };
    let orders = (1..=8).flat_map(|n| (1..=5).map(move |nk| Orders { na: n, nb: n, nk }));
    let settings = settings(Choice::Search { candidates: orders.collect(), criterion: None });
    let found = |seed: u64, part: f64| {
        let input: Vec<f64> = noise(seed, 300).into_iter().flat_map(|level| [level; 6]).collect();
        let clean = truth.simulate(&input);
        let sd = part * (clean.iter().map(|y| y * y).sum::<f64>() / clean.len() as f64).sqrt();
        let output = clean.iter().zip(noise(seed + 100, clean.len())).map(|(y, e)| y + sd * e).collect();
        let segment = Segment { input, output, from_rest: true, ..Segment::default() };
        let data = Data { training: records(segment), period_s: 1.0 / 60.0, ..Data::default() };
        let done = identify(&data, &settings).unwrap();
        let told = done.diagnostics.iter().any(|d| matches!(d, Diagnostic::OtherDelays { nk: 1, .. }));
        (done.refined.unwrap().estimated.model.nk, told)
    };
    assert!((1..=12).all(|seed| found(seed, 0.2) == (1, true)));
    assert!((1..=3).all(|seed| found(seed, 0.02) == (1, false)));
}

#[test]
fn white_noise_on_the_output_biases_arx_and_not_the_refined() {
    let data = [oe_data(7, 20_000, 1.0)];
    let off = |found: &Estimated| (found.model.parameters() - truth().parameters()).amax();
    let arx = fit(&data, ORDERS).unwrap();
    assert!(off(&arx) > 0.1, "{:?}", arx.model);
    let oe = output_error::refine(&data, &arx.model).unwrap();
    assert!(oe.converged && off(&oe.estimated) < 0.02, "{oe:?}");
    let iv = instrumental::refine(&data, &arx.model).unwrap();
    assert!(iv.converged && off(&iv.estimated) < 0.02, "{iv:?}");
}

#[test]
fn segments_count_as_one_record_and_holes_cost_only_the_rows_behind_them() {
    let whole = arx_data(3, 400, 0.0);
    let parts = [whole.part(0, 150, 1.0), whole.part(160, 400, 1.0)];
    let found = fit(&parts, ORDERS).unwrap();
    assert_eq!(found.samples, 148 + 238);
    assert!((found.model.parameters() - truth().parameters()).amax() < 1e-12);
    let refined =
        output_error::refine(&parts, &Polynomials { a: vec![1.0, -1.4, 0.6], b: vec![0.8, 0.4], nk: 1 }).unwrap();
    assert!((refined.estimated.model.parameters() - truth().parameters()).amax() < 1e-9, "{refined:?}");
}

#[test]
fn the_search_finds_order_and_delay() {
    let delayed = |seed| {
        let mut s = arx_data(seed, 3000, 0.3);
        let n = s.len();
        s.output = [&[0.0; 2], &s.output[..n - 2]].concat();
        s
    };
    let candidates: Vec<Orders> = (1..=8).flat_map(|n| (0..=5).map(move |nk| Orders { na: n, nb: n, nk })).collect();
    let all = search::search(&[delayed(1)], &[delayed(2)], InitialState::Rest, &candidates).unwrap();
    assert_eq!(all.len(), 48);
    for criterion in [Criterion::Mdl, Criterion::Simulation, Criterion::Prediction] {
        let best = best(&all, criterion).unwrap();
        assert_eq!(best.orders, Orders { na: 2, nb: 2, nk: 3 }, "{criterion:?}");
    }
    // Each candidate equals a separate fit to the same rows.
    let one = all.iter().find(|c| c.orders == Orders { na: 3, nb: 3, nk: 2 }).unwrap();
    let train = delayed(1);
    let same_rows = fit(&[train.part(12 - 4, 3000, 1.0)], one.orders).unwrap();
    assert!((one.model.parameters() - same_rows.model.parameters()).amax() < 1e-10);
}

#[test]
fn digits_are_kept_where_normal_equations_lose_them() {
    // A slow system sampled fast: neighbouring outputs are nearly equal.
    let slow = Polynomials { a: vec![1.0, -2.9985, 2.997_001_2, -0.998_501_2], b: vec![1e-3], nk: 1 };
    let input = noise(5, 4000);
    let output = slow.simulate(&input);
    let data = [Segment { input, output, from_rest: true, ..Segment::default() }];
    let orders = Orders { na: 3, nb: 1, nk: 1 };
    let found = fit(&data, orders).unwrap();
    assert!(found.condition > 1e6, "condition {:.1e}", found.condition);
    let by_qr = (found.model.parameters() - slow.parameters()).amax();
    let normal = normal_equations(&data[0], orders);
    let by_normal = (normal - slow.parameters()).amax();
    assert!(by_qr < 1e-8 && by_normal > 100.0 * by_qr, "QR {by_qr:.1e}, normal equations {by_normal:.1e}");
}

fn normal_equations(segment: &Segment, orders: Orders) -> nalgebra::DVector<f64> {
    let p = orders.parameters();
    let mut sums = DMatrix::zeros(p + 1, p + 1);
    for t in orders.memory()..segment.len() {
        let row: Vec<f64> = row(segment, t, (orders.na, orders.nb, orders.nk)).collect();
        let row = nalgebra::DVector::from_vec(row);
        sums += &row * row.transpose();
    }
    let (left, right) = (sums.view((0, 0), (p, p)).into_owned(), sums.view((0, p), (p, 1)).column(0).into_owned());
    left.lu().solve(&right).unwrap()
}

#[test]
fn what_the_data_do_not_tell_is_said() {
    let still = Segment { input: vec![1.0; 100], output: vec![2.0; 100], from_rest: true, ..Segment::default() };
    assert!(matches!(fit(&[still], ORDERS), Err(IdentifyError::Dependent { .. })));
    let short = arx_data(1, 5, 0.0);
    assert!(matches!(fit(&[short], ORDERS), Err(IdentifyError::TooShort { rows: 3, longest: 5, .. })));
}
