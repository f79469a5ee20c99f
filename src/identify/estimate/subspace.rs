//! Subspace identification: states from the data, without a search.
//!
//! In: segments, orders. Out: a model B/A of these orders. The information of past inputs and outputs about future
//! outputs, beyond that of future inputs, spans the state space; its shift gives A (PO-MOESP; Verhaegen, Automatica 30,
//! 1994, doi:10.1016/0005-1098(94)90229-1; with `Weight::Canonical` the directions are weighted as in Larimore's CVA,
//! by their noise). The coefficients of B follow by least squares on the simulated output, from rest or not.
//!
//! There are no local minima, and unlike ARX a low-order model is not biased by noise on the output; but nothing is
//! minimised, so it is only an initial model. An unstable A cannot be simulated and is not returned. Feedback from the
//! output's noise to the input biases it.

use crate::identify::data::segments::Segment;
use crate::identify::estimate::output_error::{self, Derivatives};
use crate::identify::model::polynomials::{Orders, Polynomials};
use crate::identify::model::state_space::characteristic;
use crate::identify::solve::decompositions::{eigenvalues, svd};
use crate::identify::solve::regression::{Triangle, solve};
use nalgebra::DMatrix;

/// Samples of past and of future: per order, and at least.
const REACH: (usize, usize) = (4, 12);
/// Most rows; a longer record is thinned.
const MAX_ROWS: usize = 40_000;

/// Weighting of the directions of the future.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Weight {
    /// Equal weights.
    None,
    /// By the scatter of the future outputs: those with less noise count more.
    Canonical,
}

/// A stable model of these orders. `None` when the record is too short, the states cannot be found, or A is unstable.
pub(super) fn fit(segments: &[Segment], orders: Orders, weight: Weight) -> Option<Polynomials> {
    let Orders { na: n, nb, nk } = orders;
    if n == 0 {
        return None;
    }
    let reach = (REACH.0 * n).max(REACH.1);
    let r = triangle(segments, reach, nk)?;
    // Columns: future inputs, past inputs and outputs, future outputs. The rows below the future inputs have these
    // projected out.
    let future = 3 * reach;
    let by_past = r.view((reach, future), (2 * reach, reach)).transpose();
    let directions = |scaled: DMatrix<f64>| Some(svd(scaled)?.u?.columns(0, n).into_owned());
    let observed = match weight {
        Weight::None => directions(by_past)?,
        Weight::Canonical => {
            // The future outputs without the part of the future inputs.
            let all = r.view((reach, future), (3 * reach, reach)).into_owned().qr().r();
            all.tr_mul(&directions(all.tr_solve_upper_triangular(&by_past)?)?)
        }
    };
    // Γ shifted by a sample is Γ A.
    let (upper, lower) = (observed.rows(0, reach - 1).into_owned(), observed.rows(1, reach - 1).into_owned());
    let factors = upper.qr();
    let a = factors.r().solve_upper_triangular(&(factors.q().transpose() * lower))?;
    if eigenvalues(&a)?.iter().any(|pole| pole.norm().is_nan() || pole.norm() >= 1.0) {
        return None;
    }
    numerator(segments, &Polynomials { a: characteristic(&a), b: vec![0.0; nb], nk })
}

/// The triangle of all windows: `reach` each of future inputs, past inputs, past outputs and future outputs.
fn triangle(segments: &[Segment], reach: usize, nk: usize) -> Option<DMatrix<f64>> {
    let windows = |s: &Segment| s.len().saturating_sub(2 * reach + nk.max(1) - 1);
    let stride = segments.iter().map(windows).sum::<usize>().div_ceil(MAX_ROWS).max(1);
    let mut triangle = Triangle::new(4 * reach);
    // The input that first acts on the output of sample t is that of sample t − nk; with nk above 1 it is shifted so
    // that the window fits.
    let late = nk.max(1) - 1;
    for segment in segments {
        for start in (0..windows(segment)).step_by(stride) {
            let (past, now) = (start + late, start + late + reach);
            let outputs = |from: usize| segment.output[from..from + reach].iter().copied();
            let inputs = |from: usize| segment.input[from - late..from - late + reach].iter().copied();
            triangle.push(inputs(now).chain(inputs(past)).chain(outputs(past)).chain(outputs(now)));
        }
    }
    (triangle.rows() > 4 * reach).then(|| triangle.finish())
}

/// The coefficients of B for this A: the simulated output is linear in them.
fn numerator(segments: &[Segment], poles: &Polynomials) -> Option<Polynomials> {
    let na = poles.na();
    // At B = 0 the residual is the output itself.
    let rows = output_error::linearised(segments, poles, Derivatives::OfModel);
    let rows: Vec<_> = rows.into_iter().map(|rows| rows.remove_columns(0, na)).collect();
    let b = solve(output_error::triangle(segments, &rows))?.parameters;
    b.iter().all(|b| b.is_finite()).then(|| Polynomials { b: b.as_slice().to_vec(), ..poles.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::tests::noise;

    fn truth(nk: usize) -> Polynomials {
        // Poles 0.95, 0.8 ± 0.4i.
        Polynomials { a: vec![1.0, -2.55, 2.32, -0.76], b: vec![0.3, -0.1, 0.05], nk }
    }

    fn record(nk: usize, seed: u64, n: usize, sd: f64) -> Segment {
        let input = noise(seed, n);
        let clean = truth(nk).simulate(&input);
        let output = clean.iter().zip(noise(seed + 1000, n)).map(|(y, e)| y + sd * e).collect();
        Segment { input, output, from_rest: true, ..Segment::default() }
    }

    #[test]
    fn without_noise_any_system_is_recovered_from_rest_or_not() {
        for nk in [0, 1, 3] {
            for weight in [Weight::None, Weight::Canonical] {
                let whole = record(nk, 1, 600, 0.0);
                let part = Segment { from_rest: false, ..whole.part(100, 600, 1.0) };
                let mut holed = whole.clone();
                (0..600).step_by(97).for_each(|t| holed.output[t] = f64::NAN);
                for segment in [whole, part, holed] {
                    let truth = truth(nk);
                    let found = fit(&[segment], truth.orders(), weight);
                    // Weighting by noise is meaningless without noise: it may find nothing, but nothing wrong.
                    let Some(found) = found else {
                        assert_eq!(weight, Weight::Canonical, "nk {nk}");
                        continue;
                    };
                    let off = (found.parameters() - truth.parameters()).amax();
                    assert!(off < 1e-8, "nk {nk} {weight:?}: {off:e}");
                }
            }
        }
    }

    #[test]
    fn noise_on_the_output_does_not_bias_it_as_it_does_arx() {
        let record = record(1, 7, 20_000, 1.0);
        let orders = truth(1).orders();
        let of = |model: &Polynomials| (model.parameters() - truth(1).parameters()).amax();
        let by_arx = of(&crate::identify::estimate::arx::fit(std::slice::from_ref(&record), orders).unwrap().model);
        for weight in [Weight::None, Weight::Canonical] {
            let found = of(&fit(std::slice::from_ref(&record), orders, weight).unwrap());
            assert!(found < 0.15 * by_arx, "{weight:?}: {found}, ARX {by_arx}");
        }
    }

    #[test]
    fn what_is_too_short_or_unstable_gives_nothing() {
        assert!(fit(&[record(1, 1, 40, 0.0)], truth(1).orders(), Weight::None).is_none());
        let unstable = Polynomials { a: vec![1.0, -1.02], b: vec![1.0], nk: 1 };
        let input = noise(3, 300);
        let output = unstable.simulate(&input);
        let segment = Segment { input, output, from_rest: true, ..Segment::default() };
        assert!(fit(&[segment], unstable.orders(), Weight::None).is_none());
    }
}
