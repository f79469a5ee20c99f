//! Numbers as a rig file has them: decimals that survive reading and rewriting.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::cmp::Ordering;

/// The rotation nearest to a rounded matrix: the orthogonal factor of its polar decomposition.
pub(super) fn rotation_of(matrix: &Matrix3<f64>) -> UnitQuaternion<f64> {
    let svd = matrix.svd(true, true);
    let nearest = svd.u.zip(svd.v_t).map_or(*matrix, |(u, v_t)| u * v_t);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(nearest));
    UnitQuaternion::new_normalize(rotation.into_inner())
}

/// Metres as mm, with as many decimals as needed, at most nine (1e-12 m).
pub(super) fn millimetres(length_m: f64) -> String {
    decimal(length_m * 1e3, 9)
}

/// A number with at most `decimals` decimals, no trailing zeros, always with a decimal point: `3.2`, `5.0`, `-0.11`.
pub(super) fn decimal(value: f64, decimals: usize) -> String {
    let fixed = format!("{value:.decimals$}");
    let short = match fixed.trim_end_matches('0') {
        whole if whole.ends_with('.') => format!("{whole}0"),
        short => short.to_owned(),
    };
    match short.as_str() {
        "-0.0" => "0.0".to_owned(),
        "NaN" => "nan".to_owned(), // as TOML spells it, so that reading it back can name its place
        _ => short,
    }
}

/// Rounds to the decimals of a direction such that reading (which normalises it exactly again) and writing gives the
/// same digits: a file that is only read and written must not change. Rounding takes the nearest rounded value, reading
/// the nearest unit or orthonormal one, so the distance between the two only shrinks.
pub(super) fn round_stably<const N: usize>(values: [f64; N], read: impl Fn([f64; N]) -> [f64; N]) -> [f64; N] {
    let round = |values: [f64; N]| values.map(|v| (v * 1e12).round() / 1e12);
    let mut at = round(values);
    let mut seen = Vec::new();
    for _ in 0..20 {
        seen.push(at);
        at = round(read(at));
        // Where rounding ties cause a cycle, every start in it must give the same value.
        if let Some(first) = seen.iter().position(|earlier| *earlier == at) {
            let circle = seen.into_iter().skip(first);
            return circle.min_by(|a, b| a.partial_cmp(b).unwrap_or(Ordering::Equal)).unwrap_or(at);
        }
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rounding_leads_in_a_circle_settles_to_one_place_from_everywhere() {
        // Reading turns 1e-12 into 2e-12 and back, everything else into one of them.
        let read = |[v]: [f64; 1]| [if v == 1e-12 { 2e-12 } else { 1e-12 }];
        for start in [0.0, 1e-12, 2e-12, 7e-12] {
            assert_eq!(round_stably([start], read), [1e-12]);
        }
        assert_eq!(round_stably([0.3], |v| v), [0.3]);
    }
}
