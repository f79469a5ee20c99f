//! The records of a log, one after the other, chunks opened; a log that was cut off gives all that is whole.

use super::LogError;
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

/// No record of ours comes near: a length beyond is damage.
const LONGEST_RECORD: usize = 1 << 30;

/// How far a log goes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Extent {
    /// To its proper end.
    Whole,
    /// It was cut off, or is damaged.
    Cut {
        /// How that shows.
        why: String,
    },
}

/// Gives every record of the log at `path` to `take`.
///
/// # Errors
/// When the file cannot be read, is no MCAP file, or `take` fails.
pub(crate) fn each(path: &Path, mut take: impl FnMut(&Record<'_>) -> Result<(), LogError>) -> Result<Extent, LogError> {
    let lost = |source| LogError::Io { path: path.to_owned(), source };
    let mut file = BufReader::with_capacity(1 << 16, File::open(path).map_err(lost)?);
    let options = LinearReaderOptions::default().with_record_length_limit(LONGEST_RECORD);
    let mut reader = LinearReader::new_with_options(options);
    let mut ended = false;
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let got = read(&mut file, reader.insert(wanted)).map_err(lost)?;
                reader.notify_read(got);
            }
            Ok(LinearReadEvent::Record { data, opcode }) => match mcap::parse_record(opcode, data) {
                Ok(record) => {
                    ended |= matches!(record, Record::Footer(_));
                    take(&record)?;
                }
                Err(error) => return Ok(Extent::Cut { why: error.to_string() }),
            },
            Err(McapError::BadMagic) if !ended => return Err(LogError::NotMcap { path: path.to_owned() }),
            Err(_) if ended => return Ok(Extent::Whole),
            Err(McapError::UnexpectedEof) => return Ok(Extent::Cut { why: "it ends without an index".to_owned() }),
            Err(error) => return Ok(Extent::Cut { why: error.to_string() }),
        }
    }
    Ok(if ended { Extent::Whole } else { Extent::Cut { why: "it ends without an index".to_owned() } })
}

/// Reads what there is; interrupted calls are made again.
fn read(file: &mut impl Read, into: &mut [u8]) -> io::Result<usize> {
    loop {
        match file.read(into) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            other => return other,
        }
    }
}
