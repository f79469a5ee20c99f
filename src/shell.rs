//! Command lines as a person would type them.

/// A word quoted for a shell.
pub(crate) fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./=:,@%+".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_where_a_shell_would_cut_them() {
        assert_eq!(
            ["a.mkv", "day 1/it's.mkv", "", "--b0=1,0,0"].map(quoted),
            ["a.mkv", r"'day 1/it'\''s.mkv'", "''", "--b0=1,0,0"]
        );
    }
}
