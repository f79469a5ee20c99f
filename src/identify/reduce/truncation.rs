//! Model order reduction: balanced truncation of the discrete model.
//!
//! In: a model, how many states to keep. Out: the reduced model and all Hankel singular values. States are transformed
//! to coordinates in which they are equally controllable and observable; those with small singular values are removed
//! (Moore, IEEE TAC 26, 1981, doi:10.1109/TAC.1981.1102568). The error of the response is nowhere larger than twice the
//! sum of those removed. Unstable states have no Gramian: they are split off first, kept, and added again.

use crate::identify::IdentifyError;
use crate::identify::model::polynomials::{Polynomials, monic};
use crate::identify::model::state_space::StateSpace;
use crate::identify::reduce::balance::Balanced;
use crate::identify::reduce::gramian::{band_factors, factor};
use crate::plural::are;
use nalgebra::{Complex, DMatrix, DVector, RowDVector};

/// `auto`: bound on the error of the response, as a fraction of its largest value.
const AUTO_ERROR: f64 = 0.05;

/// How states are removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Removal {
    /// Truncated: best at high frequencies, as in the paper.
    #[default]
    Truncate,
    /// Residualised (held at their steady state): keeps the gain at zero frequency (Liu and Anderson, Int. J. Control
    /// 50, 1989, doi:10.1080/00207178908953437).
    MatchDc,
}

/// How far to reduce.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// This many states, including unstable ones; all significant ones, if there are fewer.
    Order(usize),
    /// As few as possible with the error bound below 5 % of the largest response.
    Auto,
}

/// How to reduce.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::identify) struct Reduction {
    /// Target order.
    pub target: Target,
    /// How states are removed.
    pub removal: Removal,
    /// Balance only for these frequencies, radians per sample. Error bound and stability are then not guaranteed.
    pub band: Option<(f64, f64)>,
}

/// A reduced model.
#[derive(Debug, Clone)]
pub struct Reduced {
    /// The model.
    pub model: Polynomials,
    /// Hankel singular values of the stable part over all frequencies, largest first.
    pub hankel: Vec<f64>,
    /// The same for the band alone, when balanced for one.
    pub hankel_in_band: Option<Vec<f64>>,
    /// Unstable states, all kept.
    pub unstable: usize,
    /// The requested order, if the model has fewer significant states.
    pub asked_for_more: Option<usize>,
    /// Bound on the error of the response; infinite when balanced for a band.
    pub error_bound: f64,
}

/// Reduces `model`. Samples of delay beyond the first are kept and do not count as states.
///
/// # Errors
/// [`IdentifyError::NotReduced`] when fewer states are requested than are unstable, or poles lie on the unit circle.
pub(in crate::identify) fn reduce(model: &Polynomials, how: Reduction) -> Result<Reduced, IdentifyError> {
    // A delay would use up states meant for the dynamics.
    let (prompt, beyond) = model.without_delay();
    let reduced = reduce_prompt(&prompt, how)?;
    let nk = reduced.model.nk + beyond;
    Ok(Reduced { model: Polynomials { nk, ..reduced.model }, ..reduced })
}

fn reduce_prompt(model: &Polynomials, how: Reduction) -> Result<Reduced, IdentifyError> {
    let not_reduced = |problem: String| IdentifyError::NotReduced { problem };
    let on_circle = || not_reduced("a pole lies on the unit circle, where balancing does not end".to_owned());
    let (stable, unstable) = split(model).ok_or_else(on_circle)?;
    let stable = stable.triangular();
    // 1. factors of the Gramians, and the singular values of their product
    let whole = factor(&stable.a, &stable.b).zip(factor(&stable.a.transpose(), &stable.c.transpose()));
    let whole = Balanced::of(whole.ok_or_else(on_circle)?.into()).ok_or_else(on_circle)?;
    let in_band = match how.band {
        Some(band) => {
            Some(band_factors(&stable.a, &stable.b, &stable.c, band).and_then(Balanced::of).ok_or_else(on_circle)?)
        }
        None => None,
    };
    let Balanced { into, from, values } = in_band.as_ref().unwrap_or(&whole);
    let rank = into.ncols();
    let tail = |kept: usize| 2.0 * values.iter().skip(kept).sum::<f64>();
    // 2. how many to keep
    let fixed = unstable.order();
    let keep = match how.target {
        Target::Auto => {
            let peak = peak(model);
            (1..rank).find(|kept| tail(*kept) <= AUTO_ERROR * peak).unwrap_or(rank)
        }
        Target::Order(order) => match order.checked_sub(fixed) {
            Some(keep) if order > 0 => keep.min(rank),
            _ => {
                let states = are(fixed as u64, "state");
                return Err(not_reduced(format!("order {order} asked, and {states} unstable and must be kept")));
            }
        },
    };
    // 3. balanced coordinates of all significant states, then the removal
    let balanced = StateSpace { a: from * &stable.a * into, b: from * &stable.b, c: &stable.c * into, d: stable.d };
    let reduced = match how.removal {
        // Nothing is removed: return the model itself, without rounding errors of the transformations.
        _ if keep == stable.order() => model.clone(),
        Removal::Truncate => first(&balanced, keep).sum(&unstable).polynomials(),
        Removal::MatchDc => residual(&balanced, keep).ok_or_else(on_circle)?.sum(&unstable).polynomials(),
    };
    Ok(Reduced {
        model: reduced,
        unstable: fixed,
        asked_for_more: match how.target {
            Target::Order(order) if order > keep + fixed => Some(order),
            _ => None,
        },
        error_bound: if how.band.is_some() { f64::INFINITY } else { tail(keep) },
        hankel_in_band: in_band.map(|b| b.values),
        hankel: whole.values,
    })
}

/// Reduces for a band, or for all frequencies if the band's reduction would be unstable, as the second value tells.
///
/// # Errors
/// As [`reduce`].
pub(in crate::identify) fn reduce_in_band(
    model: &Polynomials,
    how: Reduction,
) -> Result<(Reduced, bool), IdentifyError> {
    let reduced = reduce(model, how)?;
    let outside = reduced.model.poles().iter().filter(|p| p.norm() >= 1.0 || p.re.is_nan()).count();
    if how.band.is_none() || outside <= reduced.unstable {
        return Ok((reduced, false));
    }
    reduce(model, Reduction { band: None, ..how }).map(|reduced| (reduced, true))
}

fn first(system: &StateSpace, keep: usize) -> StateSpace {
    StateSpace {
        a: system.a.view((0, 0), (keep, keep)).into_owned(),
        b: system.b.rows(0, keep).into_owned(),
        c: system.c.columns(0, keep).into_owned(),
        d: system.d,
    }
}

/// The other states follow instantaneously: x₂ = (I − A₂₂)⁻¹ (A₂₁ x₁ + b₂ u).
fn residual(system: &StateSpace, keep: usize) -> Option<StateSpace> {
    let n = system.order();
    let gone = n - keep;
    if gone == 0 {
        return Some(system.clone());
    }
    let part = |i, j, rows, columns| system.a.view((i, j), (rows, columns)).into_owned();
    let (a12, a21, a22) = (part(0, keep, keep, gone), part(keep, 0, gone, keep), part(keep, keep, gone, gone));
    let (b2, c2) = (system.b.rows(keep, gone).into_owned(), system.c.columns(keep, gone).into_owned());
    let settled = (DMatrix::identity(gone, gone) - a22).lu();
    let (by_state, by_input) = (settled.solve(&a21)?, settled.solve(&b2)?);
    let kept = first(system, keep);
    Some(StateSpace {
        a: kept.a + &a12 * &by_state,
        b: kept.b + &a12 * &by_input,
        c: kept.c + &c2 * &by_state,
        d: kept.d + (&c2 * &by_input)[0],
    })
}

/// Largest response on a fine grid up to half the sampling rate.
fn peak(model: &Polynomials) -> f64 {
    const GRID: usize = 4096;
    let at = |k: usize| model.response(std::f64::consts::PI * k as f64 / GRID as f64).norm();
    (0..=GRID).map(at).filter(|v| v.is_finite()).fold(0.0, f64::max)
}

/// The stable and the unstable part, whose sum is the model. `None` when a pole lies on the unit circle.
fn split(model: &Polynomials) -> Option<(StateSpace, StateSpace)> {
    let whole = StateSpace::of(model);
    let none = || StateSpace { a: DMatrix::zeros(0, 0), b: DVector::zeros(0), c: RowDVector::zeros(0), d: 0.0 };
    let poles = model.poles();
    if poles.iter().any(|p| !p.re.is_finite() || (p.norm() - 1.0).abs() < 1e-9) {
        return None;
    }
    let (inside, outside): (Vec<_>, Vec<_>) = poles.iter().partition(|p| p.norm() < 1.0);
    if outside.is_empty() {
        return Some((whole, none()));
    }
    // B/A = N₁/A₁ + N₂/A₂ + d, both strictly proper: one linear equation per power of z.
    let n = model.memory();
    let zeros = n - inside.len() - outside.len();
    let stable = monic(inside.iter().copied().chain(std::iter::repeat_n(Complex::new(0.0, 0.0), zeros)));
    let unstable = monic(outside.iter().copied());
    let (m, k) = (stable.len() - 1, unstable.len() - 1);
    let column = |factor: &[f64], shift: usize| -> DVector<f64> {
        DVector::from_fn(n, |row, _| row.checked_sub(shift).and_then(|i| factor.get(i)).copied().unwrap_or(0.0))
    };
    // Powers z^(n−1) … z^0 of N₁ A₂ + N₂ A₁; N₁ begins at z^(m−1), so its product at z^(n−1).
    let columns: Vec<DVector<f64>> =
        (0..m).map(|s| column(&unstable, s)).chain((0..k).map(|s| column(&stable, s))).collect();
    let system = DMatrix::from_columns(&columns);
    let solution = system.lu().solve(&whole.c.transpose())?;
    let part = |denominator: &[f64], numerator: &[f64], d: f64| {
        let b: Vec<f64> = numerator.iter().zip(&denominator[1..]).map(|(n, a)| n + d * a).collect();
        StateSpace::of(&Polynomials { a: denominator.to_vec(), b: [&[d], b.as_slice()].concat(), nk: 0 })
    };
    let (numerator, rest) = solution.as_slice().split_at(m);
    Some((part(&stable, numerator, whole.d), part(&unstable, rest, 0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO: Reduction = Reduction { target: Target::Order(2), removal: Removal::Truncate, band: None };

    fn fourth_order() -> Polynomials {
        // Poles 0.9, 0.8 ± 0.3i, 0.1.
        let a = monic(
            [0.9, 0.1]
                .map(|r| Complex::new(r, 0.0))
                .into_iter()
                .chain([Complex::new(0.8, 0.3), Complex::new(0.8, -0.3)]),
        );
        Polynomials { a, b: vec![0.2, 0.1, -0.05, 0.01], nk: 1 }
    }

    #[test]
    fn a_first_order_system_by_hand() {
        // P = b²/(1−p²), Q = c²/(1−p²): σ = |bc|/(1−p²).
        let model = Polynomials { a: vec![1.0, -0.5], b: vec![3.0], nk: 1 };
        let reduced = reduce(&model, Reduction { target: Target::Order(1), ..TWO }).unwrap();
        assert!((reduced.hankel[0] - 3.0 / 0.75).abs() < 1e-12);
        assert!((reduced.model.parameters() - model.parameters()).amax() < 1e-12);
    }

    #[test]
    fn the_error_is_within_its_bound_and_dc_is_matched_when_asked() {
        let model = fourth_order();
        for removal in [Removal::Truncate, Removal::MatchDc] {
            let reduced = reduce(&model, Reduction { removal, ..TWO }).unwrap();
            let difference = |k: usize| {
                let angle = std::f64::consts::PI * k as f64 / 500.0;
                (model.response(angle) - reduced.model.response(angle)).norm()
            };
            let worst = (0..=500).map(difference).fold(0.0, f64::max);
            assert!(
                worst <= reduced.error_bound && worst > 0.1 * reduced.error_bound,
                "{removal:?} {worst} {reduced:?}"
            );
            // Of a gain of 22.
            assert_eq!(difference(0) < 1e-9, removal == Removal::MatchDc);
        }
    }

    /// True values by mpmath with 80 digits. slycot is off by 1.4e-3: the coefficients do not determine more digits of
    /// the poles.
    #[test]
    fn slow_poles_close_together_keep_the_digits_that_they_have() {
        const SLOW: [f64; 4] = [5_793_824.202, 825_474.550_9, 33_062.823_38, 191.344_974];
        let poles = [0.9999, 0.9995, 0.998, 0.99].map(|p| Complex::new(p, 0.0));
        let model = Polynomials { a: monic(poles), b: vec![1e-3, -2e-3, 1.2e-3, -1.9e-4], nk: 1 };
        let found = reduce(&model, TWO).unwrap().hankel;
        assert!(found.iter().zip(SLOW).all(|(f, t)| (f / t - 1.0).abs() < 5e-3), "{found:?}");
    }

    #[test]
    fn in_its_band_the_weighted_reduction_is_better() {
        let model = fourth_order();
        let band = (1.5, 2.5);
        let worst = |how: Reduction| {
            let reduced = reduce(&model, how).unwrap().model;
            let off = |k: usize| {
                let angle = band.0 + (band.1 - band.0) * k as f64 / 100.0;
                (model.response(angle) - reduced.response(angle)).norm()
            };
            (0..=100).map(off).fold(0.0, f64::max)
        };
        assert!(worst(Reduction { band: Some(band), ..TWO }) < 0.5 * worst(TWO));
    }

    #[test]
    fn what_is_unstable_is_kept() {
        let unstable = Polynomials { a: vec![1.0, -1.2], b: vec![0.3], nk: 1 };
        let sum = StateSpace::of(&fourth_order()).sum(&StateSpace::of(&unstable)).polynomials();
        let reduced = reduce(&sum, Reduction { target: Target::Order(3), ..TWO }).unwrap();
        assert_eq!((reduced.unstable, reduced.hankel.len()), (1, 4));
        assert!(reduced.model.poles().iter().any(|p| (p - 1.2).norm() < 1e-8));
        let alone = reduce(&fourth_order(), TWO).unwrap();
        assert!(alone.hankel.iter().zip(&reduced.hankel).all(|(a, b)| (a / b - 1.0).abs() < 1e-8));
        assert!(reduce(&unstable, Reduction { target: Target::Order(0), ..TWO }).is_err());
    }

    #[test]
    fn a_model_of_fewer_states_is_kept_as_it_is_and_that_is_said() {
        for order in [4, 5] {
            let kept = reduce(&fourth_order(), Reduction { target: Target::Order(order), ..TWO }).unwrap();
            assert_eq!((kept.model, kept.asked_for_more), (fourth_order(), (order == 5).then_some(5)));
        }
        // A delay is not a state.
        let late = Polynomials { a: vec![1.0, -0.5], b: vec![2.0], nk: 5 };
        let kept = reduce(&late, Reduction { target: Target::Order(1), ..TWO }).unwrap();
        assert_eq!((kept.model, kept.asked_for_more), (late, None));
        // Four states of which one is significant.
        let copies = Polynomials { a: vec![1.0, -1.2, 0.35], b: vec![1.0, -0.7], nk: 1 };
        let kept = reduce(&copies, TWO).unwrap();
        assert_eq!((kept.model.na(), kept.asked_for_more), (1, Some(2)));
        assert!((kept.model.a[1] + 0.5).abs() < 1e-12, "{kept:?}");
    }

    #[test]
    fn a_delay_is_kept_and_costs_no_states() {
        let prompt = reduce(&fourth_order(), TWO).unwrap();
        let late = reduce(&Polynomials { nk: 6, ..fourth_order() }, TWO).unwrap();
        assert_eq!((late.model.nk, late.model.order()), (prompt.model.nk + 5, 2));
        assert_eq!(Polynomials { nk: prompt.model.nk, ..late.model }, prompt.model);
        assert_eq!(late.hankel, prompt.hankel);
    }

    #[test]
    fn nothing_stable_and_no_state_at_all() {
        let gain = Polynomials { a: vec![1.0], b: vec![2.0], nk: 0 };
        let unstable = Polynomials { a: vec![1.0, -1.2], b: vec![0.3], nk: 1 };
        for model in [gain, unstable] {
            for how in [TWO, Reduction { target: Target::Auto, ..TWO }, Reduction { band: Some((0.1, 1.0)), ..TWO }] {
                let kept = reduce(&model, how).unwrap();
                assert_eq!(kept.model, model);
                assert!(kept.hankel.is_empty());
            }
        }
    }

    #[test]
    fn auto_keeps_what_can_be_seen() {
        // A fast mode of hardly any gain beside a slow one.
        let slow = Polynomials { a: vec![1.0, -0.95], b: vec![0.05], nk: 1 };
        let fast = Polynomials { a: vec![1.0, 0.2], b: vec![0.001], nk: 1 };
        let sum = StateSpace::of(&slow).sum(&StateSpace::of(&fast)).polynomials();
        let reduced = reduce(&sum, Reduction { target: Target::Auto, ..TWO }).unwrap();
        assert_eq!(reduced.model.na(), 1);
    }
}
