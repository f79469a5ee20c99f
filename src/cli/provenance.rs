//! When a page was made, and by which command line.

use std::time::SystemTime;

/// Name and value, for the facts of a page.
pub(super) fn of_this_run() -> [(String, String); 2] {
    let arguments = std::env::args_os().skip(1).map(|word| quoted(&word.to_string_lossy()));
    let command = std::iter::once("catoptra".to_owned()).chain(arguments).collect::<Vec<_>>().join(" ");
    let made = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
    [("Command".to_owned(), command), ("Made".to_owned(), made.replace('T', " ").replace('Z', " UTC"))]
}

/// A word as a shell takes it back.
fn quoted(word: &str) -> String {
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

    #[test]
    fn the_time_is_told_to_the_second_in_utc() {
        let [_, (name, made)] = of_this_run();
        assert_eq!((name.as_str(), made.len()), ("Made", "2026-11-20 18:23:45 UTC".len()));
    }
}
