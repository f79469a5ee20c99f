//! Counts in words.

use std::fmt::Display;

/// `1 frame`, `2 frames`.
pub(crate) fn plural<N: Display + PartialEq + From<u8>>(n: N, word: &str) -> String {
    if n == N::from(1) { format!("1 {word}") } else { format!("{n} {word}s") }
}

/// `1 frame is`, `2 frames are`.
pub(crate) fn are<N: Copy + Display + PartialEq + From<u8>>(n: N, word: &str) -> String {
    format!("{} {}", plural(n, word), if n == N::from(1) { "is" } else { "are" })
}

#[cfg(test)]
mod tests {
    #[test]
    fn one_is_no_plural() {
        assert_eq!([0_u64, 1, 2].map(|n| super::plural(n, "run")), ["0 runs", "1 run", "2 runs"]);
        assert_eq!([0_u64, 1, 2].map(|n| super::are(n, "run")), ["0 runs are", "1 run is", "2 runs are"]);
    }
}
