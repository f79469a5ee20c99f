//! [`RigError`]: what is wrong with a rig file, in terms of the file.

use std::path::PathBuf;

/// Why a rig file cannot be read, used or written.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The file cannot be read.
    #[error("cannot read rig file {}", file.display())]
    Read {
        /// Which file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not TOML, or a value of the wrong type, or a missing key.
    #[error("{}:{line}: {message}", file.display())]
    Syntax {
        /// Which file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What the parser expected.
        message: String,
    },
    /// An unknown key.
    #[error("{}:{line}: unknown key `{key}`, {advice}", file.display())]
    UnknownKey {
        /// Which file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// The key.
        key: String,
        /// The nearest known key, or all of them when none is close.
        advice: String,
    },
    /// A value that cannot be right.
    #[error("{}: {key} = {value}: expected {expected}", file.display())]
    Value {
        /// Which file.
        file: PathBuf,
        /// Path of the key, e.g. `surfaces.front.normal`.
        key: String,
        /// The value, as the file would write it.
        value: String,
        /// What would be right.
        expected: String,
    },
    /// A key that is missing, or that does not belong to this kind of entry.
    #[error("{}: {key}: {problem}", file.display())]
    Key {
        /// Which file.
        file: PathBuf,
        /// Path of the key.
        key: String,
        /// What is wrong.
        problem: String,
    },
    /// The file cannot be written.
    #[error("cannot write rig file {}", file.display())]
    Write {
        /// Which file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// The candidate nearest to a mistyped word: fewest single-letter edits, and fewer than half its letters.
pub(crate) fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| (strsim::levenshtein(word, candidate), candidate))
        .min_by_key(|(distance, _)| *distance)
        .filter(|(distance, candidate)| 2 * distance <= word.chars().count().max(candidate.chars().count()))
        .map(|(_, candidate)| candidate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_near_is_suggested() {
        let known = ["focal_px", "width_px", "distortion"];
        assert_eq!(nearest("focal_pix", known), Some("focal_px"));
        assert_eq!(nearest("distorsion", known), Some("distortion"));
        assert_eq!(nearest("banana", known), None);
    }
}
