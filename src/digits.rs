//! Numbers for people, with the digits that mean something.

/// Most digits of a value behind its first.
const MOST: usize = 9;
/// Digits of a value without σ behind its first.
const USUAL: usize = 6;

/// With so many digits behind the point; what rounds to zero has no sign.
pub(crate) fn fixed(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(magnitude) if magnitude.bytes().all(|b| b == b'0' || b == b'.') => magnitude.to_owned(),
        _ => text,
    }
}

/// How many digits behind its first a value has whose σ has two in all.
pub(crate) fn digits_behind_first(value: f64, sd: f64) -> Option<usize> {
    // As it is after rounding: a σ of 0.0999 is 0.10.
    let power = |value: f64, digits: usize| format!("{value:.digits$e}").split_once('e')?.1.parse::<i32>().ok();
    if !(sd.is_finite() && sd > 0.0 && value.is_finite()) {
        return None;
    }
    let behind = power(value, MOST)? - power(sd, 1)? + 1;
    Some(behind.clamp(0, MOST as i32) as usize)
}

/// A value and its σ, that with two digits and the value to match: `1.7620e4`, `4.5e0`.
pub(crate) fn scientific(value: f64, sd: Option<f64>) -> (String, Option<String>) {
    let digits = sd.and_then(|sd| digits_behind_first(value, sd)).unwrap_or(USUAL);
    (format!("{value:.digits$e}"), sd.map(|sd| format!("{sd:.1e}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rounds_to_zero_has_no_sign() {
        assert_eq!([-0.04, 0.04, -0.06, -0.0].map(|v| fixed(v, 1)), ["0.0", "0.0", "-0.1", "0.0"]);
        assert_eq!(fixed(-10.0, 0), "-10");
        assert_eq!(fixed(f64::NEG_INFINITY, 2), "-inf");
    }

    #[test]
    fn a_value_has_the_digits_of_its_sigma() {
        let text = |value: f64, sd: f64| scientific(value, Some(sd)).0;
        assert_eq!(scientific(1.762_006e4, Some(4.537)), ("1.76201e4".to_owned(), Some("4.5e0".to_owned())));
        assert_eq!(text(-3.216, 0.0999), "-3.22e0");
        assert_eq!(text(-3.216, 0.0099), "-3.2160e0");
        assert_eq!((text(0.02, 5.0).as_str(), text(1.0, 1e-30).as_str()), ("2e-2", "1.000000000e0"));
        assert_eq!(scientific(0.5, None), ("5.000000e-1".to_owned(), None));
    }
}
