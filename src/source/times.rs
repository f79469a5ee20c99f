//! Converts times written by people and containers to whole nanoseconds, without floating point.

use std::fmt;
use std::str::FromStr;

/// Nanoseconds in seconds: the double nearest to the decimal, so that 150 ms prints as 0.15.
pub fn seconds(ns: i64) -> f64 {
    ns as f64 / 1e9
}

/// `count` units of `numerator / denominator` seconds in nanoseconds, rounded to nearest (halves away from zero);
/// `None` when the denominator is not positive or the time exceeds 292 years.
pub fn ticks_to_ns(count: i64, numerator: i64, denominator: i64) -> Option<i64> {
    if denominator <= 0 {
        return None;
    }
    let exact = i128::from(count).checked_mul(i128::from(numerator))?.checked_mul(1_000_000_000)?;
    divide_to_nearest(exact, i128::from(denominator))
}

/// Nanoseconds as decimal seconds, by integer arithmetic: floating point would round 64-bit time stamps.
pub(crate) fn decimal_seconds(ns: i64) -> String {
    let sign = if ns < 0 { "-" } else { "" };
    let magnitude = ns.unsigned_abs();
    format!("{sign}{}.{:09}", magnitude / 1_000_000_000, magnitude % 1_000_000_000)
}

/// Seconds in decimal notation (`12`, `0.0166667`, `-1.5e-3`) in nanoseconds: exact, digits below a nanosecond rounded
/// to nearest; `None` when it is not such a number.
pub fn parse_seconds_ns(text: &str) -> Option<i64> {
    let text = text.trim();
    let (number, exponent) = match text.split_once(['e', 'E']) {
        Some((number, exponent)) => (number, exponent.parse::<i32>().ok().filter(|e| e.unsigned_abs() <= 40)?),
        None => (text, 0),
    };
    let (negative, number) = match number.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, number.strip_prefix('+').unwrap_or(number)),
    };
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    if whole.len() + fraction.len() == 0 || whole.len() + fraction.len() > 36 {
        return None;
    }
    let mut digits = 0_i128;
    for c in whole.chars().chain(fraction.chars()) {
        digits = digits * 10 + i128::from(c.to_digit(10)?);
    }
    if negative {
        digits = -digits;
    }
    let power = 9 + exponent - i32::try_from(fraction.len()).ok()?;
    let scale = 10_i128.checked_pow(power.unsigned_abs());
    match (power >= 0, scale) {
        _ if digits == 0 => Some(0),
        (true, scale) => i64::try_from(digits.checked_mul(scale?)?).ok(),
        (false, Some(scale)) => divide_to_nearest(digits, scale),
        // Less than 10^-38 of its digits' value.
        (false, None) => Some(0),
    }
}

fn divide_to_nearest(value: i128, divisor: i128) -> Option<i64> {
    let (quotient, rest) = (value / divisor, value % divisor);
    let up = rest.abs() >= divisor - rest.abs();
    i64::try_from(if up { quotient + value.signum() } else { quotient }).ok()
}

/// Frames per second as an exact fraction: `60`, `59.94` or `60000/1001`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameRate {
    frames: i64,
    seconds: i64,
}

/// Text that is not a frame rate.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "\"{0}\" is not a frame rate: give frames per second above 0 and up to 1000000, such as 60, 59.94 or 60000/1001"
)]
pub struct FrameRateError(String);

impl FrameRate {
    /// Frames per second.
    pub fn hz(self) -> f64 {
        self.frames as f64 / self.seconds as f64
    }

    /// Frames, and the seconds they take.
    pub fn fraction(self) -> (i64, i64) {
        (self.frames, self.seconds)
    }

    /// Time of frame number `index`, nanoseconds; frame 0 is at 0. `None` beyond 292 years.
    pub fn stamp_ns(self, index: u64) -> Option<i64> {
        ticks_to_ns(i64::try_from(index).ok()?, self.seconds, self.frames)
    }
}

impl FromStr for FrameRate {
    type Err = FrameRateError;

    fn from_str(text: &str) -> Result<Self, FrameRateError> {
        let fraction = || match text.split_once('/') {
            Some((n, d)) => Some((n.trim().parse().ok()?, d.trim().parse().ok()?)),
            // A decimal frame rate is parsed like decimal seconds, in billionths.
            None => Some((parse_seconds_ns(text)?, 1_000_000_000)),
        };
        match fraction() {
            Some((frames, seconds)) if frames > 0 && seconds > 0 && frames / seconds <= 1_000_000 => {
                Ok(Self { frames, seconds })
            }
            _ => Err(FrameRateError(text.to_owned())),
        }
    }
}

impl fmt::Display for FrameRate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.hz())
    }
}

/// Resolution of a stream's time stamps: the largest step that all are multiples of, counted from the first.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Resolution {
    before_ns: Option<i64>,
    step_ns: u64,
    /// Shortest time from a frame to the next.
    shortest_ns: Option<u64>,
}

impl Resolution {
    /// The next stamp, nanoseconds.
    pub(crate) fn add(&mut self, ns: i64) {
        let apart_ns = ns.abs_diff(self.before_ns.replace(ns).unwrap_or(ns));
        if apart_ns > 0 {
            self.step_ns = common(self.step_ns, apart_ns);
            self.shortest_ns = Some(self.shortest_ns.map_or(apart_ns, |shortest| shortest.min(apart_ns)));
        }
    }

    /// σ of a stamp by its rounding, seconds; `None` where all are multiples of the frame interval, as 20 ms at 50
    /// fps: then it does not show.
    pub(crate) fn sd_s(&self) -> Option<f64> {
        let hidden = self.shortest_ns.is_some_and(|shortest| self.step_ns >= shortest.div_ceil(2));
        (!hidden).then(|| self.step_ns as f64 / 1e9 / 12.0_f64.sqrt())
    }
}

/// Greatest common divisor.
fn common(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { common(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_step_of_stamps_is_what_all_are_multiples_of() {
        let of = |stamps: &[i64]| {
            let mut resolution = Resolution::default();
            stamps.iter().for_each(|ns| resolution.add(*ns));
            (resolution.step_ns, resolution.sd_s())
        };
        let (step_ns, sd_s) = of(&[7_000_000, 24_000_000, 40_000_000, 57_000_000]);
        assert_eq!((step_ns, sd_s), (1_000_000, Some(1e-3 / 12.0_f64.sqrt())));
        assert_eq!((of(&[5, 5]).0, of(&[0, 40, 100]).0, of(&[0, 16_666_667, 33_333_333]).0), (0, 20, 1));
        assert_eq!(of(&[0, 20_000_000, 40_000_000]).1, None);
    }

    #[test]
    fn ticks_are_rounded_to_the_nearest_nanosecond() {
        assert_eq!(ticks_to_ns(256, 1, 15360), Some(16_666_667));
        assert_eq!(ticks_to_ns(1, 1, 15360), Some(65_104));
        assert_eq!(ticks_to_ns(-1, 1, 15360), Some(-65_104));
        assert_eq!(ticks_to_ns(17, 1, 1000), Some(17_000_000));
        assert_eq!(ticks_to_ns(1, 1001, 60000), Some(16_683_333));
        assert_eq!(ticks_to_ns(2, 1001, 60000), Some(33_366_667));
        // A day at 90 kHz: a double would still be exact, a float long wrong.
        assert_eq!(ticks_to_ns(86_400 * 90_000 + 1, 1, 90_000), Some(86_400_000_011_111));
        assert_eq!(ticks_to_ns(1, 1, 2_000_000_000), Some(1));
        assert_eq!(ticks_to_ns(i64::MAX, 1, 1), None);
        assert_eq!(ticks_to_ns(1, 1, 0), None);
    }

    #[test]
    fn seconds_are_printed_with_the_digits_they_came_with() {
        for ms in 0..10_000 {
            assert_eq!(format!("{:.3}", seconds(ms * 1_000_000)).parse::<f64>(), Ok(seconds(ms * 1_000_000)));
        }
        assert_eq!(seconds(150_000_000).to_string(), "0.15");
    }

    #[test]
    fn decimal_seconds_are_exact() {
        assert_eq!(parse_seconds_ns("0.017"), Some(17_000_000));
        assert_eq!(parse_seconds_ns(" 1700000000.123456789 "), Some(1_700_000_000_123_456_789));
        assert_eq!(parse_seconds_ns("0.016666666666666666"), Some(16_666_667));
        assert_eq!(parse_seconds_ns("-.5"), Some(-500_000_000));
        assert_eq!(parse_seconds_ns("3."), Some(3_000_000_000));
        assert_eq!(parse_seconds_ns("1e-05"), Some(10_000));
        assert_eq!(parse_seconds_ns("1.25E2"), Some(125_000_000_000));
        assert_eq!(parse_seconds_ns("0.0000000005"), Some(1));
        assert_eq!(parse_seconds_ns("0.00000000049"), Some(0));
        for wrong in ["", ".", "-", "1,5", "0x10", "1 s", "nan", "inf", "1e400", "9999999999999", "--1", "1.2.3"] {
            assert_eq!(parse_seconds_ns(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn frame_rates_give_times_without_drift() {
        let ntsc: FrameRate = "60000/1001".parse().unwrap();
        assert_eq!(ntsc.stamp_ns(60_000), Some(1_001_000_000_000));
        let decimal: FrameRate = "59.94".parse().unwrap();
        assert_eq!(decimal.stamp_ns(5994), Some(100_000_000_000));
        let sixty: FrameRate = "60".parse().unwrap();
        assert_eq!([1, 2, 3].map(|i| sixty.stamp_ns(i)), [Some(16_666_667), Some(33_333_333), Some(50_000_000)]);
        for wrong in ["0", "-60", "60/0", "fast", "1e9", "60 Hz"] {
            assert!(wrong.parse::<FrameRate>().is_err(), "{wrong}");
        }
    }
}
