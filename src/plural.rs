//! Counts in words.

use std::fmt::Display;

/// `1 frame`, `2 frames`.
pub(crate) fn plural<N: Display + PartialEq + From<u8>>(n: N, word: &str) -> String {
    if n == N::from(1) { format!("1 {word}") } else { format!("{n} {word}s") }
}

#[cfg(test)]
mod tests {
    #[test]
    fn one_is_no_plural() {
        assert_eq!([0_u64, 1, 2].map(|n| super::plural(n, "run")), ["0 runs", "1 run", "2 runs"]);
    }
}
