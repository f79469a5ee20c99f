//! What repeated measurements gave.

use super::stopwatch::median;

/// The median of values, and the least and the largest.
pub(crate) fn with_spread<V: Iterator<Item = f64>>(values: impl Fn() -> V, digits: usize) -> String {
    let (low, high) = values().fold((f64::INFINITY, 0.0_f64), |(low, high), value| (low.min(value), high.max(value)));
    format!("{:.digits$} ({low:.digits$} to {high:.digits$})", median(values()))
}
