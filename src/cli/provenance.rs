//! Date of a page, and its command line.

use crate::shell::quoted;
use crate::source::names::without_credentials;
use std::time::SystemTime;

/// Name and value, for the facts of a page.
pub(super) fn of_this_run() -> [(String, String); 2] {
    of_command(std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()))
}

/// As [`of_this_run`], for the command with these `words` after the program's name; without names and passwords.
pub(super) fn of_command(words: impl Iterator<Item = String>) -> [(String, String); 2] {
    let words = words.map(|word| quoted(&without_credentials(&word)));
    let command = std::iter::once("catoptra".to_owned()).chain(words).collect::<Vec<_>>().join(" ");
    [("Command".to_owned(), command), ("Made".to_owned(), now().replace('T', " ").replace('Z', " UTC"))]
}

/// The time of day, to the second, UTC, as in RFC 3339.
pub(super) fn now() -> String {
    humantime::format_rfc3339_seconds(SystemTime::now()).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_passwords_are_not_told() {
        let words = ["live", "rtsp://bob:secret@camera/a", "-o", "run"].map(str::to_owned);
        let [(_, command), _] = of_command(words.into_iter());
        assert_eq!(command, "catoptra live rtsp://camera/a -o run");
    }

    #[test]
    fn the_time_is_told_to_the_second_in_utc() {
        let [_, (name, made)] = of_this_run();
        assert_eq!((name.as_str(), made.len()), ("Made", "2026-11-20 18:23:45 UTC".len()));
    }
}
