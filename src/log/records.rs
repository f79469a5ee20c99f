//! The records of a log, one after the other, chunks opened; a log that was cut off gives all that is whole.

use super::LogError;
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

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

/// The records of one log.
pub(crate) struct Records {
    path: PathBuf,
    file: BufReader<File>,
    reader: LinearReader,
    opcode: u8,
    data: Vec<u8>,
    ended: bool,
    extent: Option<Extent>,
}

impl Records {
    /// Opens the log at `path`.
    ///
    /// # Errors
    /// When it cannot be read.
    pub(crate) fn open(path: &Path) -> Result<Self, LogError> {
        let file = File::open(path).map_err(|source| LogError::Io { path: path.to_owned(), source })?;
        let options = LinearReaderOptions::default().with_record_length_limit(LONGEST_RECORD);
        Ok(Self {
            path: path.to_owned(),
            file: BufReader::with_capacity(1 << 16, file),
            reader: LinearReader::new_with_options(options),
            opcode: 0,
            data: Vec::new(),
            ended: false,
            extent: None,
        })
    }

    /// The next record; `None` after the last whole one, when [`Records::extent`] tells how far the log goes.
    ///
    /// # Errors
    /// When the file cannot be read, or is no MCAP file.
    pub(crate) fn next(&mut self) -> Result<Option<Record<'_>>, LogError> {
        if self.extent.is_none() {
            self.extent = self.advance()?;
        }
        if self.extent.is_some() {
            return Ok(None);
        }
        // Parsed once before, to find damage.
        Ok(mcap::parse_record(self.opcode, &self.data).ok())
    }

    /// How far the log goes, once its last record has been given.
    pub(crate) fn extent(&self) -> Option<&Extent> {
        self.extent.as_ref()
    }

    /// Goes to the next record, or to the end.
    fn advance(&mut self) -> Result<Option<Extent>, LogError> {
        let lost = |source| LogError::Io { path: self.path.clone(), source };
        let cut = |why: String| Ok(Some(Extent::Cut { why }));
        while let Some(event) = self.reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let got = read(&mut self.file, self.reader.insert(wanted)).map_err(lost)?;
                    self.reader.notify_read(got);
                }
                Ok(LinearReadEvent::Record { data, opcode }) => {
                    self.opcode = opcode;
                    self.data.clear();
                    self.data.extend_from_slice(data);
                    return match mcap::parse_record(opcode, &self.data) {
                        Ok(record) => {
                            self.ended |= matches!(record, Record::Footer(_));
                            Ok(None)
                        }
                        Err(error) => cut(error.to_string()),
                    };
                }
                Err(McapError::BadMagic) if !self.ended => return Err(LogError::NotMcap { path: self.path.clone() }),
                Err(_) if self.ended => return Ok(Some(Extent::Whole)),
                Err(McapError::UnexpectedEof) => return cut("it ends without an index".to_owned()),
                Err(error) => return cut(error.to_string()),
            }
        }
        if self.ended { Ok(Some(Extent::Whole)) } else { cut("it ends without an index".to_owned()) }
    }
}

/// Gives every record of the log at `path` to `take`.
///
/// # Errors
/// When the file cannot be read, is no MCAP file, or `take` fails.
pub(crate) fn each(path: &Path, mut take: impl FnMut(&Record<'_>) -> Result<(), LogError>) -> Result<Extent, LogError> {
    let mut records = Records::open(path)?;
    while let Some(record) = records.next()? {
        take(&record)?;
    }
    let cut = || Extent::Cut { why: "it ends without an index".to_owned() };
    Ok(records.extent().cloned().unwrap_or_else(cut))
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
