//! Parses quantities: a number and its unit.

use crate::source::times::parse_seconds_ns;
use std::time::Duration;

/// A current in amperes; the unit must be there, because a missing one is off by a thousand.
pub(super) fn current_a(text: &str) -> Result<f64, String> {
    const UNITS: &[(&str, f64)] = &[("mA", 1e-3), ("A", 1.0)];
    with_unit(text, UNITS).ok_or_else(|| format!("`{text}` is no current: write for example 100mA or 0.1A"))
}

/// A current above 0.
pub(super) fn positive_current_a(text: &str) -> Result<f64, String> {
    let value = current_a(text)?;
    if value > 0.0 { Ok(value) } else { Err(format!("`{text}`: the current must be above 0, such as 100mA")) }
}

/// A frequency in hertz; the unit may be left out.
pub(super) fn frequency_hz(text: &str) -> Result<f64, String> {
    let value = with_unit(text, &[("mHz", 1e-3), ("kHz", 1e3), ("Hz", 1.0), ("", 1.0)]);
    value.filter(|hz| *hz > 0.0).ok_or_else(|| format!("`{text}` is no frequency above 0: write for example 0.5Hz"))
}

const TIMES: &[(&str, f64)] = &[("ms", 1e-3), ("min", 60.0), ("s", 1.0), ("", 1.0)];

/// A time in seconds above 0; without a unit it is seconds.
pub(super) fn duration_s(text: &str) -> Result<f64, String> {
    let value = with_unit(text, TIMES);
    value.filter(|s| *s > 0.0).ok_or_else(|| format!("`{text}` is no time above 0: write for example 20ms or 300s"))
}

/// A time in seconds, or none: 0.
pub(super) fn duration_or_none_s(text: &str) -> Result<f64, String> {
    if matches!(text.trim(), "0" | "0s" | "0ms") { Ok(0.0) } else { duration_s(text) }
}

/// A time in seconds that may be 0 or below.
pub(super) fn signed_duration_s(text: &str) -> Result<f64, String> {
    with_unit(text, TIMES).ok_or_else(|| format!("`{text}` is no time: write for example 20ms or -0.02"))
}

/// A time in plain seconds, exact to the nanosecond as stamps are; it may be below 0.
pub(super) fn seconds_ns(text: &str) -> Result<i64, String> {
    parse_seconds_ns(text).ok_or_else(|| "expected seconds, such as 12 or 3.25".to_owned())
}

/// Plain seconds above 0.
pub(super) fn seconds(text: &str) -> Result<Duration, String> {
    let ns = parse_seconds_ns(text).and_then(|ns| u64::try_from(ns).ok()).filter(|ns| *ns > 0);
    ns.map(Duration::from_nanos).ok_or_else(|| "expected seconds above 0, such as 600".to_owned())
}

/// A change of current, amperes per second.
pub(super) fn slew_a_s(text: &str) -> Result<f64, String> {
    let value = with_unit(text, &[("mA/s", 1e-3), ("A/s", 1.0), ("", 1.0)]);
    value
        .filter(|slew| *slew > 0.0)
        .ok_or_else(|| format!("`{text}` is no change of current above 0: write for example 2A/s"))
}

/// The number, times what its unit stands for; the first unit that the text ends with counts.
fn with_unit(text: &str, units: &[(&str, f64)]) -> Option<f64> {
    let text = text.trim();
    let (number, scale) = units.iter().find_map(|(unit, scale)| Some((text.strip_suffix(unit)?, scale)))?;
    let value = number.trim_end().parse::<f64>().ok()?;
    // Dividing by decimal prefixes is exact where multiplying is not: 20 ms is 0.02 s.
    let value = if *scale < 1.0 { value / (1.0 / scale).round() } else { value * scale };
    value.is_finite().then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_as_people_write_them() {
        assert_eq!([current_a("100mA"), current_a("0.1 A"), current_a("-50mA")], [Ok(0.1), Ok(0.1), Ok(-0.05)]);
        assert_eq!([frequency_hz("0.5Hz"), frequency_hz("8"), frequency_hz("500 mHz")], [Ok(0.5), Ok(8.0), Ok(0.5)]);
        assert_eq!([duration_s("20ms"), duration_s("5min"), duration_s("300")], [Ok(0.02), Ok(300.0), Ok(300.0)]);
        assert_eq!([signed_duration_s("-5 ms"), signed_duration_s("0")], [Ok(-0.005), Ok(0.0)]);
        assert_eq!([slew_a_s("2A/s"), slew_a_s("0.5")], [Ok(2.0), Ok(0.5)]);
    }

    #[test]
    fn what_is_none_is_refused_with_an_example() {
        for wrong in ["100", "mA", "1e999A", "nanA", "100 Ω"] {
            assert!(current_a(wrong).unwrap_err().contains("100mA"), "{wrong}");
        }
        assert!(positive_current_a("0mA").unwrap_err().contains("above 0"));
        assert!(frequency_hz("-1Hz").is_err() && frequency_hz("0.5s").is_err());
        assert!(duration_s("0ms").is_err() && duration_s("1h").is_err());
        assert!(signed_duration_s("2m").unwrap_err().contains("20ms"));
        assert!(slew_a_s("0").is_err() && slew_a_s("1V/s").is_err());
    }
}
