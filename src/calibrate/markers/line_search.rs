//! The smallest value of a noisy, smooth function of one parameter: bracketed by steps, then the vertex of a parabola.

/// Parameter at the minimum, and the second derivative there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Minimum {
    pub at: f64,
    pub curvature: f64,
}

/// Steps along the parameter before giving up on a bracket.
const MAX_STEPS: usize = 40;

/// Minimises `f` from `start` by steps of `step`, within `range`; `None` when `f` cannot be evaluated at the start.
///
/// At a limit of the range it returns the last point within.
pub(crate) fn minimise(
    start: f64,
    step: f64,
    range: (f64, f64),
    mut f: impl FnMut(f64) -> Option<f64>,
) -> Option<Minimum> {
    let mut middle = (start, f(start)?);
    let mut low = evaluate(start - step, range, &mut f);
    let mut high = evaluate(start + step, range, &mut f);
    for _ in 0..MAX_STEPS {
        if let Some(l) = low.filter(|l| l.1 < middle.1) {
            (high, middle) = (Some(middle), l);
            low = evaluate(middle.0 - step, range, &mut f);
        } else if let Some(h) = high.filter(|h| h.1 < middle.1) {
            (low, middle) = (Some(middle), h);
            high = evaluate(middle.0 + step, range, &mut f);
        } else {
            break;
        }
    }
    let (Some(low), Some(high)) = (low, high) else { return Some(Minimum { at: middle.0, curvature: 0.0 }) };
    let curvature = (low.1 - 2.0 * middle.1 + high.1) / (step * step);
    let slope = (high.1 - low.1) / (2.0 * step);
    let shift = if curvature > 0.0 { (-slope / curvature).clamp(-step, step) } else { 0.0 };
    Some(Minimum { at: middle.0 + shift, curvature })
}

fn evaluate(at: f64, range: (f64, f64), f: &mut impl FnMut(f64) -> Option<f64>) -> Option<(f64, f64)> {
    if !(range.0..=range.1).contains(&at) {
        return None;
    }
    f(at).map(|value| (at, value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_far_from_the_start_is_found_exactly() {
        let found = minimise(0.0, 0.25, (-5.0, 5.0), |x| Some(3.0 * (x - 1.37).powi(2) + 2.0)).unwrap();
        assert!((found.at - 1.37).abs() < 1e-12 && (found.curvature - 6.0).abs() < 1e-9);
    }

    #[test]
    fn the_limit_of_the_range_holds() {
        let found = minimise(0.5, 0.25, (0.0, 1.0), Some).unwrap();
        assert!(found.at.abs() < 1e-12);
    }

    #[test]
    fn nothing_to_evaluate_gives_nothing() {
        assert!(minimise(0.0, 1.0, (-1.0, 1.0), |_| None).is_none());
    }
}
