//! Parses quantities: a number and its unit.

use crate::source::times::parse_seconds_ns;
use std::time::Duration;

/// A current in amperes; the unit must be there, because a missing one is off by a thousand.
pub(super) fn current_a(text: &str) -> Result<f64, String> {
    const UNITS: &[(&str, f64)] = &[("mA", 1e-3), ("A", 1.0)];
    with_unit(text, UNITS).ok_or_else(|| match text.trim().parse::<f64>() {
        Ok(number) if number.is_finite() => format!("`{text}` has no unit: write {number}mA or {number}A"),
        _ => format!("`{text}` is not a current: write for example 100mA or 0.1A"),
    })
}

/// A current above 0.
pub(super) fn positive_current_a(text: &str) -> Result<f64, String> {
    let value = current_a(text)?;
    if value > 0.0 { Ok(value) } else { Err(format!("`{text}`: the current must be above 0, such as 100mA")) }
}

/// A frequency in hertz; the unit may be left out.
pub(super) fn frequency_hz(text: &str) -> Result<f64, String> {
    let value = with_unit(text, &[("mHz", 1e-3), ("kHz", 1e3), ("Hz", 1.0), ("", 1.0)]);
    value.filter(|hz| *hz > 0.0).ok_or_else(|| format!("`{text}` is not a frequency above 0: write for example 0.5Hz"))
}

const TIMES: &[(&str, f64)] = &[("ms", 1e-3), ("min", 60.0), ("s", 1.0), ("", 1.0)];

/// A time in seconds above 0; without a unit it is seconds.
pub(super) fn duration_s(text: &str) -> Result<f64, String> {
    let value = with_unit(text, TIMES);
    value.filter(|s| *s > 0.0).ok_or_else(|| format!("`{text}` is not a time above 0: write for example 20ms or 300s"))
}

/// A time of mostly some milliseconds, in seconds above 0; without a unit it is seconds, below 1.
pub(super) fn short_s(text: &str) -> Result<f64, String> {
    duration_s(text).and_then(|s| with_clear_unit(text, s))
}

/// The same, also 0 or below.
pub(super) fn signed_short_s(text: &str) -> Result<f64, String> {
    let s = with_unit(text, TIMES).ok_or_else(|| format!("`{text}` is not a time: write for example 20ms or -0.02"))?;
    with_clear_unit(text, s)
}

/// Many write milliseconds without saying so.
fn with_clear_unit(text: &str, s: f64) -> Result<f64, String> {
    let text = text.trim();
    match text.parse::<f64>() {
        Ok(number) if number.abs() >= 1.0 => Err(format!("`{text}`: in which unit? Write {text}ms or {text}s")),
        _ => Ok(s),
    }
}

/// A part of some frames in percent, from 0 to 90; returned as a part of 1.
pub(super) fn part_of_frames(text: &str) -> Result<f64, String> {
    let value = with_unit(text, &[("%", 1e-2), ("", 1e-2)]);
    let part = value.filter(|part| (0.0..=0.9).contains(part));
    part.ok_or_else(|| format!("`{text}` is not a part of the frames from 0 to 90 percent: write for example 5%"))
}

/// A time in seconds, or none: 0.
pub(super) fn duration_or_none_s(text: &str) -> Result<f64, String> {
    if matches!(text.trim(), "0" | "0s" | "0ms") { Ok(0.0) } else { duration_s(text) }
}

/// A time that may be below 0; seconds, with or without their unit, are exact to the nanosecond as stamps are.
pub(super) fn seconds_ns(text: &str) -> Result<i64, String> {
    time_ns(text).ok_or_else(|| "expected a time, such as 12, 3.25s or 20ms".to_owned())
}

/// A time above 0; without a unit it is seconds.
pub(super) fn seconds(text: &str) -> Result<Duration, String> {
    let ns = time_ns(text).and_then(|ns| u64::try_from(ns).ok()).filter(|ns| *ns > 0);
    ns.map(Duration::from_nanos).ok_or_else(|| "expected a time above 0, such as 600, 90s or 10min".to_owned())
}

fn time_ns(text: &str) -> Option<i64> {
    let exact = |text: &str| parse_seconds_ns(text.trim_end());
    // Beyond 2^53 ns, a float is not exact, and not needed: these are days.
    let other = || with_unit(text, TIMES).map(|s| s * 1e9).filter(|ns| ns.abs() < 9e18).map(|ns| ns.round() as i64);
    exact(text).or_else(|| exact(text.strip_suffix('s')?)).or_else(other)
}

/// An exposure in milliseconds above 0; without a unit it is milliseconds.
pub(super) fn exposure_ms(text: &str) -> Result<f64, String> {
    let value = with_unit(text, &[("µs", 1e-3), ("us", 1e-3), ("ms", 1.0), ("s", 1e3), ("", 1.0)]);
    value.filter(|ms| *ms > 0.0).ok_or_else(|| format!("`{text}` is not an exposure above 0: write for example 8.5ms"))
}

/// A change of current, amperes per second.
pub(super) fn slew_a_s(text: &str) -> Result<f64, String> {
    let value = with_unit(text, &[("mA/s", 1e-3), ("A/s", 1.0), ("", 1.0)]);
    value
        .filter(|slew| *slew > 0.0)
        .ok_or_else(|| format!("`{text}` is not a change of current above 0: write for example 2A/s"))
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
        assert_eq!([signed_short_s("-5 ms"), signed_short_s("0")], [Ok(-0.005), Ok(0.0)]);
        assert_eq!([slew_a_s("2A/s"), slew_a_s("0.5")], [Ok(2.0), Ok(0.5)]);
        assert_eq!(["3", "3s", "3000 ms"].map(seconds), [(); 3].map(|()| Ok(Duration::from_secs(3))));
        assert_eq!(["-0.000000001", "-0.000000001s", "2min"].map(seconds_ns), [Ok(-1), Ok(-1), Ok(120_000_000_000)]);
        assert_eq!(["8.5", "8.5ms", "8500µs", "0.0085s"].map(exposure_ms), [(); 4].map(|()| Ok(8.5)));
    }

    #[test]
    fn what_is_none_is_refused_with_an_example() {
        for wrong in ["100", "mA", "1e999A", "nanA", "100 Ω"] {
            assert!(current_a(wrong).unwrap_err().contains("100mA"), "{wrong}");
        }
        assert_eq!(current_a("0").unwrap_err(), "`0` has no unit: write 0mA or 0A");
        assert!(seconds("0s").unwrap_err().contains("above 0") && seconds("1h").is_err() && seconds_ns("s").is_err());
        assert!(exposure_ms("0").unwrap_err().contains("above 0") && exposure_ms("1min").is_err());
        assert!(positive_current_a("0mA").unwrap_err().contains("above 0"));
        assert!(frequency_hz("-1Hz").is_err() && frequency_hz("0.5s").is_err());
        assert!(duration_s("0ms").is_err() && duration_s("1h").is_err());
        assert!(signed_short_s("2m").unwrap_err().contains("20ms"));
        // Seconds by themselves, but not what is as likely milliseconds.
        assert_eq!((short_s("0.02"), short_s("20ms"), short_s("20s")), (Ok(0.02), Ok(0.02), Ok(20.0)));
        assert!([short_s("20"), signed_short_s("-12")].iter().all(|s| s.as_ref().unwrap_err().contains("unit")));
        assert!(slew_a_s("0").is_err() && slew_a_s("1V/s").is_err());
    }
}
