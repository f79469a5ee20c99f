//! Lines such as `0,4`: two coils, or 0.4 A with a decimal comma.

use crate::sink::CurrentSample;

/// Lines of whole numbers between commas, before the first with a decimal point.
#[derive(Debug, Default)]
pub(super) struct WholeNumbers {
    lines: u64,
    decimal_points: bool,
}

impl WholeNumbers {
    /// Warns of the first such line; `name` of the currents, for the message.
    pub(super) fn take(&mut self, line: &[u8], sample: &CurrentSample, name: &str) {
        if line.starts_with(b"{") {
            return;
        }
        self.decimal_points |= line.contains(&b'.');
        let between_commas = line.contains(&b',') && line.iter().all(|byte| b"-+,0123456789\r".contains(byte));
        if between_commas && !self.decimal_points && sample.current_a.iter().any(|a| *a != 0.0) {
            self.lines += 1;
            if self.lines == 1 {
                tracing::warn!(
                    "{name}: `{}` is taken for {} currents in whole amperes; if the comma is a decimal one, write a \
                     point",
                    String::from_utf8_lossy(line).trim_end().escape_debug(),
                    sample.current_a.len()
                );
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::sample::sample;
    use super::*;

    #[test]
    fn whole_numbers_between_commas_are_doubted_until_there_is_a_decimal_point() {
        for (lines, expected) in [
            (["0,4", "0,2"].as_slice(), 2),
            (&["0,0,0", "0", "1 0", "1, 0"], 0),
            (&["0.5,0", "1,0"], 0),
            (&[r#"{"current_a":[1,0]}"#], 0),
        ] {
            let mut whole_numbers = WholeNumbers::default();
            for line in lines {
                whole_numbers.take(line.as_bytes(), &sample(line.as_bytes(), None, 0, 0).unwrap(), "test");
            }
            assert_eq!(whole_numbers.lines, expected, "{lines:?}");
        }
    }
}
