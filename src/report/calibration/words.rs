//! Formats lengths, angles and directions for a calibration's page.

use super::super::page::signed;
use nalgebra::Vector3;

/// A direction of the camera frame in words, if along one of the axes.
pub(super) fn in_words(direction: &Vector3<f64>) -> Option<&'static str> {
    let names = ["to the left or right", "up or down", "along the line of sight"];
    let axis = direction.iamax();
    names.get(axis).copied().filter(|_| direction[axis].abs() > 0.9)
}

/// The same, with its numbers.
pub(super) fn along(direction: &Vector3<f64>) -> String {
    let [x, y, z] = [direction.x, direction.y, direction.z].map(|c| signed(c, 2));
    match in_words(direction) {
        Some(words) => format!("{words}, ({x}, {y}, {z})"),
        None => format!("along ({x}, {y}, {z}) of the camera frame"),
    }
}

/// Metres as millimetres with two significant digits, and the unit.
pub(super) fn mm(value_m: f64) -> String {
    two_digits(value_m * 1e3, " mm")
}

/// Radians as degrees, likewise.
pub(super) fn degrees(value_rad: f64) -> String {
    two_digits(value_rad.to_degrees(), "°")
}

fn two_digits(value: f64, unit: &str) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let digits = if value > 0.0 { (1.0 - value.log10().floor()).clamp(0.0, 5.0) as usize } else { 0 };
    format!("{value:.digits$}{unit}")
}

/// Metres as millimetres in a column.
pub(super) fn exact_mm(value_m: f64) -> String {
    if value_m.is_finite() { format!("{:.4}", value_m * 1e3) } else { "–".to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_have_two_digits_that_count() {
        let all = [4.8193e-3, 12e-6, 0.13e-3, 2.4e-6, 31.7e-3, 0.0, f64::NAN].map(mm);
        assert_eq!(all, ["4.8 mm", "0.012 mm", "0.13 mm", "0.0024 mm", "32 mm", "0 mm", "–"]);
    }

    #[test]
    fn directions_in_words() {
        assert_eq!(along(&Vector3::new(0.05, -0.04, 0.99)), "along the line of sight, (+0.05, −0.04, +0.99)");
        assert_eq!(in_words(&Vector3::new(-0.95, 0.2, 0.1)), Some("to the left or right"));
        assert_eq!(along(&Vector3::new(0.6, -0.5, 0.62)), "along (+0.60, −0.50, +0.62) of the camera frame");
    }
}
