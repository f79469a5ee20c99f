//! Line numbers of CSV records, for messages.
//!
//! A record's position is that of the end of the one before: line ends, empty lines and comments may be in between.

use csv::{Position, StringRecord};

/// Counts the lines of a text, from 1.
pub(crate) struct Lines<'a> {
    text: &'a [u8],
    /// What begins a line that is no record.
    comment: Option<u8>,
    at: usize,
    line: u64,
}

impl<'a> Lines<'a> {
    /// Of the text that is read, with the reader's setting for comments.
    pub(crate) fn of(text: &'a [u8], comment: Option<u8>) -> Self {
        Self { text, comment, at: 0, line: 1 }
    }

    /// The line on which the record of a position begins; positions must not decrease from call to call.
    pub(crate) fn line(&mut self, position: Option<&Position>) -> u64 {
        let byte = position.map_or(0, Position::byte);
        let mut to = usize::try_from(byte).unwrap_or(self.text.len()).max(self.at);
        let rest = |at: usize| self.text.get(at..).unwrap_or_default();
        let is_end = |byte: &u8| b"\r\n".contains(byte);
        loop {
            to += rest(to).iter().take_while(|byte| is_end(byte)).count();
            // Behind a line end: the rest of a record may look like a comment.
            let begins_line = to == 0 || rest(to - 1).first().is_some_and(is_end);
            if !begins_line || self.comment.is_none() || rest(to).first().copied() != self.comment {
                break;
            }
            to += rest(to).iter().take_while(|byte| !is_end(byte)).count();
        }
        let passed = self.text.get(self.at..to).unwrap_or_default();
        self.line += passed.iter().filter(|byte| **byte == b'\n').count() as u64;
        self.at = to;
        self.line
    }
}

/// What is wrong with a record whose cells have line ends: a quote that is not closed takes the following lines into
/// its cell, and their records with it.
pub(crate) fn open_quote(record: &StringRecord) -> Option<&'static str> {
    let is_open = record.iter().any(|cell| cell.contains(['\n', '\r']));
    is_open.then_some("a cell begins with a \" that is not closed in this line: close it or leave it out")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(text: &str, comment: Option<u8>) -> Vec<u64> {
        let mut reader = csv::ReaderBuilder::new().comment(comment).flexible(true).from_reader(text.as_bytes());
        let mut lines = Lines::of(text.as_bytes(), comment);
        reader.records().map(|record| lines.line(record.unwrap().position())).collect()
    }

    #[test]
    fn a_record_is_on_the_line_where_people_see_it() {
        assert_eq!(lines("a,b\n1,2\n3,4\n", None), [2, 3]);
        assert_eq!(lines("a,b\r\n1,2\r\n\r\n\r\n3,4\r\n5,6", None), [2, 5, 6]);
        assert_eq!(lines("# made by hand\na,b\n# first\n\n#second\r\n1,2\n3,#4\n5,6\n", Some(b'#')), [6, 7, 8]);
    }
}
