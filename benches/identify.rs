//! All orders and delays of a record of the paper's length, from one factorisation compared with a separate fit for
//! each; and the whole chain. One thread.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a measurement fails by panicking, and prints")]

use catoptra::identify::{Continuous, Conversion, InitialState, Orders, Segment, fit_arx as fit, search};
use std::f64::consts::TAU;
use std::time::Instant;

const PERIOD_S: f64 = 1.0 / 60.0;
const SAMPLES: usize = 18_000;
const ROUNDS: usize = 5;

/// Eq. 7 moved by the paper's chirp, with 0.11° of noise.
fn record(seed: u64) -> Segment {
    let h = Continuous {
        num: vec![1.761e4, 6344.0],
        den: vec![1.0, 4.59, 1.136],
        delay_s: 0.0,
        conversion: Conversion::Hold,
    };
    let chirp = |k: usize| {
        let t = k as f64 * PERIOD_S;
        2.4e-4 * (TAU * (0.5 * t + 7.5 * t * t / 600.0)).sin()
    };
    let input: Vec<f64> = (0..SAMPLES).map(chirp).collect();
    let mut rng = fastrand::Rng::with_seed(seed);
    let mut noise = || 0.0019 * ((0..12).map(|_| rng.f64()).sum::<f64>() - 6.0);
    let output = h.sampled(PERIOD_S).simulate(&input).iter().map(|y| y + noise()).collect();
    Segment { input, output, from_rest: true, ..Segment::default() }
}

/// Shortest of some rounds, seconds.
fn shortest(mut of: impl FnMut()) -> f64 {
    let once = |_| {
        let start = Instant::now();
        of();
        start.elapsed().as_secs_f64()
    };
    (0..ROUNDS).map(once).fold(f64::INFINITY, f64::min)
}

fn main() {
    let (train, test) = ([record(1)], [record(2)]);
    let candidates: Vec<Orders> = (1..=30).flat_map(|n| (0..=5).map(move |nk| Orders { na: n, nb: n, nk })).collect();
    let together = shortest(|| drop(search(&train, &[], InitialState::Rest, &candidates).unwrap()));
    let apart = shortest(|| candidates.iter().for_each(|orders| drop(fit(&train, *orders))));
    let judged = shortest(|| drop(search(&train, &test, InitialState::Rest, &candidates).unwrap()));
    println!("{SAMPLES} samples, orders 1 to 30, delays 0 to 5: {} models", candidates.len());
    println!("  from one factorisation        {together:8.3} s");
    println!("  each from its own             {apart:8.3} s, {:.0} times as long", apart / together);
    println!("  and simulated on another one  {judged:8.3} s");
}
