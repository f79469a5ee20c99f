//! Text files, and what is wrong with those that are none.

use std::io::{self, ErrorKind};
use std::path::Path;

/// What programs for tables call Unicode.
const UTF_16: &str = "it is text in UTF-16: save it as UTF-8";

/// The text of a file in UTF-8.
///
/// # Errors
/// The system's; [`ErrorKind::InvalidData`] when it is no such text.
pub(crate) fn read(path: &Path) -> io::Result<String> {
    let bytes = std::fs::read(path)?;
    let utf_16 = is_utf_16(&bytes);
    let why = if utf_16 { UTF_16 } else { "it is not text in UTF-8" };
    String::from_utf8(bytes).map_err(|_| io::Error::new(ErrorKind::InvalidData, why))
}

/// Whether bytes begin as text in UTF-16 does.
pub(crate) fn is_utf_16(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff])
}

/// The line of an error in a file of TOML, from 1, and what is wrong there.
pub(crate) fn toml_error(text: &str, error: &toml::de::Error) -> (usize, String) {
    let start = error.span().map_or(0, |span| span.start);
    let line = 1 + text.bytes().take(start).filter(|byte| *byte == b'\n').count();
    let is_comma = |three: &[u8]| matches!(three, [a, b',', b] if a.is_ascii_digit() && b.is_ascii_digit());
    let has_comma = text.lines().nth(line - 1).is_some_and(|line| line.as_bytes().windows(3).any(is_comma));
    let hint = if has_comma && error.message().starts_with("unexpected") {
        " (numbers have a decimal point, not a comma)"
    } else {
        ""
    };
    (line, format!("{}{hint}", error.message()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_in_another_encoding_is_told() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let of = |bytes: &[u8]| {
            std::fs::write(file.path(), bytes).unwrap();
            read(file.path()).map_err(|error| error.to_string())
        };
        assert_eq!(of("θ".as_bytes()).unwrap(), "θ");
        assert_eq!(of(&[0xff, 0xfe, b'a', 0]).unwrap_err(), UTF_16);
        assert!(of(b"caf\xe9").unwrap_err().contains("UTF-8"));
    }

    #[test]
    fn a_decimal_comma_is_told_with_its_line() {
        let of = |text: &str| toml_error(text, &text.parse::<toml::Table>().unwrap_err());
        for text in ["[a]\nb0_t = 3,0\n", "[a]\nfocal_px = [2711,043, 2711,043]\n"] {
            let (line, said) = of(text);
            assert!(line == 2 && said.contains("not a comma"), "{line}: {said}");
        }
        let (line, said) = of("[a]\nb = [1,2\nc = 3\n");
        assert!(line == 3 && !said.contains("comma, not"), "{line}: {said}");
    }
}
