//! Periods with known noise: exact without it, and σ compared with the scatter of many records.

use super::*;
use crate::identify::data::segments::{Record, Segment};
use crate::identify::model::bandwidth::{Definition, bandwidth};
use crate::identify::model::continuous::{Continuous, Conversion};
use crate::identify::model::modelled::{Modelled, Role};
use crate::identify::model::polynomials::{Orders, Polynomials, angle};
use crate::identify::reduce::truncation::Target;
use crate::identify::tests::noise;

const PERIOD_S: f64 = 1.0 / 60.0;
const SAMPLES: usize = 240;

/// Eq. 7's poles, made faster so that a short record settles.
fn truth() -> Continuous {
    Continuous { num: vec![12.0, 40.0], den: vec![1.0, 8.0, 30.0], delay_s: 0.0, conversion: Conversion::Hold }
}

/// Sines at lines 2 to 60 with random phases, period after period.
fn multisine(seed: u64, periods: usize) -> Vec<f64> {
    let phases = noise(seed, 60);
    let at =
        |t: usize| (2..60).map(|k| ((k * t % SAMPLES) as f64 * TAU / SAMPLES as f64 + 3.0 * phases[k]).cos()).sum();
    let one: Vec<f64> = (0..SAMPLES).map(at).collect();
    one.iter().copied().cycle().take(periods * SAMPLES).collect()
}

use std::f64::consts::TAU;

fn record(seed: u64, periods: usize, sd_in: f64, sd_out: f64) -> Record {
    let clean = multisine(1, periods);
    let noise_free = truth().sampled(PERIOD_S).simulate(&clean);
    let add = |signal: &[f64], seed: u64, sd: f64| -> Vec<f64> {
        signal.iter().zip(noise(seed, signal.len())).map(|(v, e)| v + sd * e).collect()
    };
    let (input, output) = (add(&clean, seed + 5000, sd_in), add(&noise_free, seed, sd_out));
    Record { name: "r".into(), segments: vec![Segment { input, output, from_rest: true, ..Segment::default() }] }
}

fn every(skip: usize) -> Repeats {
    Repeats { every_s: SAMPLES as f64 * PERIOD_S, skip }
}

fn fit_two(records: &[Record], skip: usize) -> Periodic {
    fit(records, PERIOD_S, every(skip), Target::Order(2), &[1], &[]).unwrap()
}

#[test]
fn without_noise_the_system_comes_back() {
    let found = fit_two(&[record(1, 8, 0.0, 0.0)], 3);
    let off = (found.estimated().model.parameters() - truth().sampled(PERIOD_S).parameters()).amax();
    assert!(off < 1e-8 && found.lines().count() == 58, "{off:e}");
}

#[test]
fn a_delay_and_the_order_are_found() {
    let late = Polynomials { nk: 3, ..truth().sampled(PERIOD_S) };
    let input = multisine(1, 9);
    let output = late.simulate(&input).iter().zip(noise(8, input.len())).map(|(y, e)| y + 0.02 * e).collect();
    let record = Record {
        name: "late".into(),
        segments: vec![Segment { input, output, from_rest: true, ..Segment::default() }],
    };
    let found = fit(&[record], PERIOD_S, every(2), Target::Auto, &[1, 2, 3, 4], &[]).unwrap();
    assert_eq!(found.estimated().model.orders(), Orders { na: 2, nb: 2, nk: 3 });
}

/// A system whose response begins slowly is one of less delay as well, as far as the noise tells: never by chance.
#[test]
fn of_delays_that_do_about_as_well_the_shortest_is_taken_and_the_others_are_named() {
    let lag = Continuous { num: vec![30.0], ..truth() };
    let late = Polynomials { nk: 2, ..lag.sampled(PERIOD_S) };
    let input = multisine(1, 9);
    for seed in 1..=10 {
        let noisy = late.simulate(&input).into_iter().zip(noise(seed, input.len())).map(|(y, e)| y + 0.8 * e);
        let segment = Segment { input: input.clone(), output: noisy.collect(), from_rest: true, ..Segment::default() };
        let record = Record { name: "late".into(), segments: vec![segment] };
        let found = fit(&[record], PERIOD_S, every(1), Target::Order(2), &[1, 2, 3, 4, 5], &[]).unwrap();
        assert!(found.estimated().model.nk == 1 && found.other_delays.contains(&2), "{seed}: {found:?}");
    }
}

/// Noise on both signals, and common noise: mean square of error/σ over many records, 1 ± √(2/150); and how often the
/// intervals of bandwidths contain the truth, 95 ± 1 %.
#[test]
fn sigma_is_as_large_as_the_scatter() {
    const DRAWS: u64 = 150;
    let of_truth = |d| bandwidth(d, |f| truth().response(f), 30.0, (0.5, 15.0)).frequency_hz.unwrap();
    let bandwidths = Definition::ALL.map(of_truth);
    let mut outside = [0; 3];
    for (sd_in, sd_out, periods) in [(0.0, 0.4, 11), (1.5, 0.2, 11), (0.5, 0.4, 7)] {
        let mut sums = [0.0; 4];
        let (mut gain, mut left, mut line) = (0.0, 0.0, 0.0);
        for seed in 1..=DRAWS {
            let found = fit_two(&[record(seed, periods, sd_in, sd_out)], 1);
            let Estimated { model, covariance, .. } = found.estimated().clone();
            left += found.left / DRAWS as f64;
            let mut modelled =
                Modelled::new(Role::Periodic, String::new(), model, Some(covariance), PERIOD_S, (0.5, 15.0));
            modelled.intervals_by_covariance(PERIOD_S, (0.5, 15.0));
            for (outside, (found, truth)) in outside.iter_mut().zip(modelled.bandwidths.iter().zip(bandwidths)) {
                let (low, high) = found.interval_hz.unwrap();
                *outside += usize::from(!(low..high).contains(&truth));
            }
            let point = modelled.bode[150];
            let there = truth().sampled(PERIOD_S).response(angle(point.frequency_hz, PERIOD_S)).norm();
            gain += ((point.magnitude / there).ln() / point.sd.unwrap().0).powi(2) / DRAWS as f64;
            let h = modelled.continuous.unwrap();
            let errors = h.model.parameters().into_iter().zip(truth().parameters()).map(|(f, t)| f - t);
            for (sum, (error, sd)) in sums.iter_mut().zip(errors.zip(h.standard_errors.unwrap())) {
                *sum += (error / sd).powi(2) / DRAWS as f64;
            }
            // The lines' own σ; for ln|H|, variances from few periods have a heavy tail: (M−1)/(M−2) on average.
            let tail = (periods as f64 - 2.0) / (periods as f64 - 3.0);
            let clear: Vec<_> = found.lines().filter_map(|l| Some((l, l.relative_sd()?))).collect();
            let lines = clear.iter().map(|(l, sd)| {
                let truth = truth().sampled(PERIOD_S).response(l.angle);
                ((l.response() / truth).ln().re / sd).powi(2) / tail
            });
            line += lines.sum::<f64>() / (clear.len() as u64 * DRAWS) as f64;
        }
        let what = format!(
            "noise {sd_in}, {sd_out}, {periods} periods: H(s) {sums:?}, gain {gain}, lines {line}, left {left}"
        );
        assert!(sums.iter().chain([&gain]).all(|s| (0.65..1.35).contains(s)), "{what}");
        assert!((0.9..1.1).contains(&left) && (0.85..1.15).contains(&line), "{what}");
    }
    assert!(outside.iter().all(|of_450| (9..=36).contains(of_450)), "{outside:?} of 450");
}

#[test]
fn missing_outputs_and_holes_cost_periods_and_nothing_else() {
    let whole = record(3, 12, 0.0, 0.1);
    let mut holed = whole.clone();
    let segment = &mut holed.segments[0];
    (0..segment.len()).step_by(41).for_each(|t| segment.output[t] = f64::NAN);
    // A segment ends in the fifth period, the next begins 10 samples later.
    let (a, b) = (segment.part(0, 1100, PERIOD_S), segment.part(1110, segment.len(), PERIOD_S));
    holed.segments = vec![a, Segment { from_rest: false, ..b }];
    let (found, all) = (fit_two(&[holed], 2), fit_two(&[whole], 2));
    assert_eq!((found.records[0].periods, found.records[0].left_out, all.records[0].periods), (9, 1, 10));
    let sd = found.estimated().standard_errors();
    let off = found.estimated().model.parameters() - all.estimated().model.parameters();
    assert!(off.iter().zip(sd).all(|(off, sd)| off.abs() < 3.0 * sd), "{off}");
}

/// The mean of fewer outputs varies more, and those that are filled in do not scatter.
#[test]
fn sigma_of_lines_holds_where_outputs_are_missing() {
    const RECORDS: u64 = 120;
    let clean = truth().sampled(PERIOD_S).simulate(&multisine(1, 9));
    let settled = Segment { input: multisine(1, 9), output: clean, from_rest: true, ..Segment::default() };
    let exact = average::average(&[settled], PERIOD_S, every(4).every_s, 4).unwrap().lines;
    let (mut squares, mut count) = (0.0, 0.0);
    for seed in 0..RECORDS {
        let mut record = record(seed, 9, 0.0, 0.1);
        let segment = &mut record.segments[0];
        let missing = noise(seed + 900, segment.len());
        segment.output.iter_mut().zip(missing).filter(|(_, by)| *by > 1.5).for_each(|(y, _)| *y = f64::NAN);
        let found = average::average(&record.segments, PERIOD_S, every(1).every_s, 1).unwrap();
        // With more than a tenth missing a period is left out.
        if found.left_out > 0 {
            continue;
        }
        for (line, exact) in found.lines.iter().zip(&exact) {
            squares += (line.output - exact.output).norm_sqr() / line.output_variance;
            count += 1.0;
        }
    }
    // Of 8 periods, the mean of σ²/s² is 7/6.
    let ratio = squares / count / (7.0 / 6.0);
    assert!(count > 2000.0 && (0.95..1.05).contains(&ratio), "{ratio} of {count}");
}

#[test]
fn a_system_that_has_not_settled_and_one_of_higher_order_are_noticed() {
    let slow = Continuous { den: vec![1.0, 8.05, 0.4], ..truth() };
    let input = multisine(1, 8);
    let clean = slow.sampled(PERIOD_S).simulate(&input);
    let output: Vec<f64> = clean.iter().zip(noise(5, clean.len())).map(|(y, e)| y + 0.02 * e).collect();
    let segment = Segment { input, output, from_rest: true, ..Segment::default() };
    let record_of = |segment| Record { name: "slow".into(), segments: vec![segment] };
    let found = fit(&[record_of(segment)], PERIOD_S, every(0), Target::Order(2), &[1], &[]).unwrap();
    assert!(found.records[0].first_off > 3.0, "{}", found.records[0].first_off);
    let settled = fit_two(&[record(1, 12, 0.0, 0.2)], 3);
    assert!((0.5..1.6).contains(&settled.records[0].first_off), "{}", settled.records[0].first_off);
    let first_order = fit(&[record(1, 12, 0.0, 0.2)], PERIOD_S, every(3), Target::Order(1), &[1], &[]).unwrap();
    assert!(first_order.left > 1.0 + 10.0 * first_order.left_sd, "{} {}", first_order.left, first_order.left_sd);
    assert!(!first_order.explains_lines() && settled.explains_lines(), "{} {}", first_order.left, settled.left);
}

#[test]
fn periods_that_do_not_fit_are_refused_in_words() {
    let of = |every_s: f64, skip: usize| {
        let repeats = Repeats { every_s, skip };
        fit(&[record(1, 8, 0.0, 0.1)], PERIOD_S, repeats, Target::Order(2), &[1], &[]).unwrap_err()
    };
    let broken = of(4.004, 1);
    assert!(broken.contains("is 240.24 samples") && broken.contains("--resample --period 0.01668333"), "{broken}");
    let few = of(4.0, 5);
    assert!(few.contains("3 whole periods of 4 s can be used (5 at the start and 0 with holes are left out)"), "{few}");
}

/// Any input, period after period, and the response of the system.
fn repeated(one: &[f64], periods: usize, sd_in: f64, sd_out: f64, seed: u64) -> Record {
    let clean: Vec<f64> = one.iter().copied().cycle().take(periods * one.len()).collect();
    let add = |signal: &[f64], seed: u64, sd: f64| -> Vec<f64> {
        signal.iter().zip(noise(seed, signal.len())).map(|(v, e)| v + sd * e).collect()
    };
    let output = add(&truth().sampled(PERIOD_S).simulate(&clean), seed + 900, sd_out);
    let input = add(&clean, seed + 1900, sd_in);
    Record { name: "r".into(), segments: vec![Segment { input, output, from_rest: true, ..Segment::default() }] }
}

/// Most lines within 100 times the noise of the input: chosen by their own scatter, the few left gave frequencies 93 %
/// off where it is louder.
#[test]
fn lines_in_noise_count_and_do_not_bias_the_model() {
    const DRAWS: u64 = 60;
    let mut sums = [0.0; 4];
    for seed in 1..=DRAWS {
        let found = fit_two(&[repeated(&noise(seed, SAMPLES), 9, 0.5, 0.02, seed)], 1);
        assert!(found.lines().count() > 90, "{seed}: {}", found.lines().count());
        let Estimated { model, covariance, .. } = found.estimated().clone();
        let h = Modelled::new(Role::Periodic, String::new(), model, Some(covariance), PERIOD_S, (0.5, 15.0));
        let h = h.continuous.unwrap();
        let errors = h.model.parameters().into_iter().zip(truth().parameters()).map(|(f, t)| f - t);
        for (sum, (error, sd)) in sums.iter_mut().zip(errors.zip(h.standard_errors.unwrap())) {
            *sum += (error / sd).powi(2) / DRAWS as f64;
        }
    }
    // The poles follow from few lines here, and 8 periods know their noise badly: up to 2.5 was measured.
    assert!(sums.iter().all(|s| (0.4..3.2).contains(s)), "{sums:?}");
}

#[test]
fn a_period_that_is_not_the_inputs_is_noticed() {
    let check = |record: &Record, samples: usize| {
        unrepeated(&record.segments, PERIOD_S, samples as f64 * PERIOD_S, 1).map(|u| u.multiple.map(|(k, _)| k))
    };
    for seed in 1..=20 {
        for sd_in in [0.0, 0.3, 1.0] {
            let record = repeated(&noise(seed, SAMPLES), 9, sd_in, 0.1, seed);
            assert_eq!(check(&record, SAMPLES), None, "{seed} {sd_in}");
            assert_eq!(check(&record, 2 * SAMPLES), None, "{seed} {sd_in}");
            assert_eq!(check(&record, SAMPLES / 2), Some(Some(2)), "{seed} {sd_in}");
            assert_eq!(check(&record, SAMPLES / 3), Some(Some(3)), "{seed} {sd_in}");
        }
        let never = repeated(&noise(seed, 9 * SAMPLES), 1, 0.0, 0.1, seed);
        assert_eq!(check(&never, SAMPLES), Some(None), "{seed}");
    }
    let record = repeated(&noise(1, SAMPLES), 9, 0.0, 0.1, 1);
    let words = unrepeated(&record.segments, PERIOD_S, 2.0, 1).unwrap().in_words(2.0);
    assert!(words.ends_with("but only 0 % after 2 of them: it repeats every 4 s"), "{words}");
}
