//! The records of a log, one after another, with chunks opened; damaged parts are left out and listed ([`Condition`]).
//!
//! In: a log, whole, cut off or damaged, its chunks plain or compressed (lz4, zstd). Out: every record whose checksum
//! holds. A chunk with a wrong checksum is left out entirely. Where heads are invalid (`heads.rs`) the file is searched
//! for the next chunk. What this cannot detect: damage in a chunk that was written without a checksum, if it leaves
//! valid records and the log has no checksum of its data.

use super::LogError;
use super::condition::{Condition, Damage};
use super::heads::{self, HEAD, Head, LARGEST_CHUNK, TELLING, is_chunk, is_plausible};
use super::schema::TOPICS_ATTACHMENT;
use crate::catch_panic::catch_panic;
use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::{BTreeSet, VecDeque};
use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Most damaged places listed; further ones are counted.
const MAX_LISTED: usize = 100;
/// So many heads in a row are no chance.
const IN_A_ROW: usize = 3;
/// Metadata record that a repair adds, and its key for what was lost.
pub(super) const REPAIR: &str = "catoptra.repair";
pub(super) const LOST: &str = "lost";
/// Reason given for a log without an index.
const NO_INDEX: &str = "it ends without an index";

/// The records of one log.
pub(crate) struct Records {
    path: PathBuf,
    file: BufReader<File>,
    length: u64,
    /// Where the next record begins.
    at: u64,
    /// Checksum of all bytes so far; `None` once some were read out of order, and after the data section.
    checksum: Option<crc32fast::Hasher>,
    /// Remaining records of the last chunk.
    opened: VecDeque<(u8, Vec<u8>)>,
    current: (u8, Vec<u8>),
    ended: bool,
    /// Log time of the last message, nanoseconds.
    last_ns: Option<u64>,
    /// Channels whose record was read.
    channels: BTreeSet<u16>,
    /// Whether schemas and channels were looked for in the rest of the file.
    searched: bool,
    /// Messages so far, and how many there are according to the statistics.
    messages: u64,
    counted: Option<u64>,
    /// Whether some had no checksum of their own.
    unchecked: bool,
    /// Whether the end of the data was read.
    data_ended: bool,
    condition: Condition,
}

/// What was found at the top level of the file.
enum Found {
    Record(u8, Vec<u8>),
    /// A chunk, and whether its head is damaged.
    Chunk(Vec<u8>, bool),
    /// Invalid data; the file is searched from here.
    Nonsense(String),
    End(Option<String>),
}

impl Records {
    /// Opens the log at `path`.
    ///
    /// # Errors
    /// When it cannot be read, or is not an MCAP file.
    pub(crate) fn open(path: &Path) -> Result<Self, LogError> {
        let lost = |source| LogError::Io { path: path.to_owned(), source };
        if path.is_dir() {
            return Err(lost(io::Error::new(ErrorKind::IsADirectory, "it is a folder; give the log in it")));
        }
        let mut file = File::open(path).map_err(lost)?;
        let length = file.seek(SeekFrom::End(0)).map_err(lost)?;
        file.rewind().map_err(lost)?;
        let mut file = BufReader::with_capacity(1 << 16, file);
        let mut magic = [0; mcap::MAGIC.len()];
        let whole = file.read_exact(&mut magic);
        let mut checksum = crc32fast::Hasher::new();
        checksum.update(&magic);
        let mut records = Self {
            path: path.to_owned(),
            file,
            length,
            at: magic.len() as u64,
            checksum: Some(checksum),
            opened: VecDeque::new(),
            current: (0, Vec::new()),
            ended: false,
            last_ns: None,
            channels: BTreeSet::new(),
            searched: false,
            messages: 0,
            counted: None,
            unchecked: false,
            data_ended: false,
            condition: Condition::default(),
        };
        if whole.is_err() || magic != mcap::MAGIC && !records.is_log_all_the_same().map_err(lost)? {
            return Err(LogError::NotMcap { path: path.to_owned() });
        }
        Ok(records)
    }

    /// Whether a file whose first bytes are not those of a log is one by its other bytes: records follow, or it ends as
    /// logs do.
    fn is_log_all_the_same(&mut self) -> io::Result<bool> {
        let mut end = Vec::new();
        self.seek_to(self.length.saturating_sub(mcap::MAGIC.len() as u64))?;
        self.file.read_to_end(&mut end)?;
        let is_log = end == mcap::MAGIC || self.records_follow()?;
        self.seek_to(self.at)?;
        self.damaged_without_loss(0, "the first bytes are not those of a log");
        self.checksum = None;
        Ok(is_log)
    }

    /// The next record; `None` after the last one. Schemas and channels whose first record is damaged come before the
    /// first message that needs them: they are repeated at the end of a log.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(crate) fn next(&mut self) -> Result<Option<Record<'_>>, LogError> {
        loop {
            if let Some(record) = self.opened.pop_front() {
                self.current = record;
                match parsed(self.current.0, &self.current.1) {
                    None => self.damaged(self.at, "a record cannot be understood".to_owned()),
                    Some(Record::Message { header, .. })
                        if !self.searched && !self.channels.contains(&header.channel_id) =>
                    {
                        self.search_topics()?;
                    }
                    Some(Record::Channel(channel)) => {
                        self.channels.insert(channel.id);
                        break;
                    }
                    Some(_) => break,
                }
                continue;
            }
            if self.ended {
                return Ok(None);
            }
            self.advance().map_err(|source| LogError::Io { path: self.path.clone(), source })?;
        }
        let record = parsed(self.current.0, &self.current.1);
        match &record {
            Some(Record::Message { header, .. }) => {
                self.last_ns = Some(header.log_time);
                self.messages += 1;
                for damage in self.condition.damage.iter_mut().rev().take_while(|damage| damage.between_ns.1.is_none())
                {
                    damage.between_ns.1 = self.last_ns;
                }
            }
            Some(Record::Statistics(statistics)) => self.counted = Some(statistics.message_count),
            Some(Record::Metadata(metadata)) if metadata.name == REPAIR => {
                self.condition.repaired.extend(metadata.metadata.get(LOST).cloned());
            }
            _ => {}
        }
        Ok(record)
    }

    /// Puts all schemas and channels of the file before the current record.
    fn search_topics(&mut self) -> Result<(), LogError> {
        self.searched = true;
        let mut all = Self { searched: true, ..Self::open(&self.path)? };
        let (mut before, mut copied) = (VecDeque::new(), VecDeque::new());
        while let Some(record) = all.next()? {
            if let Record::Attachment { header, data, .. } = record
                && header.name == TOPICS_ATTACHMENT
            {
                let topics = plain_records(&data).filter(|(code, _)| is_topic(*code));
                copied.extend(topics.map(|(code, body)| (code, body.to_vec())));
            }
            if is_topic(all.current.0) {
                before.push_back(std::mem::take(&mut all.current));
            }
        }
        // The first of a number counts: copies are for those that were not found.
        before.append(&mut copied);
        before.push_back(std::mem::take(&mut self.current));
        before.append(&mut self.opened);
        self.opened = before;
        Ok(())
    }

    /// How much of the log can be trusted, as far as read.
    pub(crate) fn condition(&self) -> &Condition {
        &self.condition
    }

    /// Reads one record of the file, or skips a damaged part.
    fn advance(&mut self) -> io::Result<()> {
        let at = self.at;
        match self.found()? {
            Found::Chunk(body, mended) => match opened(&body) {
                Ok(Opened { records, checked }) => {
                    self.unchecked |= !checked;
                    self.opened.extend(records);
                    if mended {
                        self.damaged_without_loss(at, "the head of a chunk is damaged; its messages are all there");
                    }
                }
                Err(what) => {
                    self.damaged(at, what);
                    self.go_on_within(at)?;
                }
            },
            Found::Record(op::DATA_END, body) => self.check_data(at, &body),
            Found::Record(op::FOOTER, body) => self.finish(at, &body)?,
            Found::Record(code, body) => match parsed(code, &body) {
                Some(_) if !self.go_on_within(at)? => {
                    self.unchecked |= code == op::MESSAGE;
                    self.opened.push_back((code, body));
                }
                Some(_) => self.damaged(at, "the length of a record is damaged".to_owned()),
                None => {
                    self.damaged(at, "a record cannot be understood, or its checksum differs".to_owned());
                    self.go_on_within(at)?;
                }
            },
            Found::Nonsense(what) => {
                let cut = self.length - at < HEAD || what == NO_INDEX;
                match self.search(at + 1..self.length, is_plausible)? {
                    Some(next) => {
                        self.damaged(at, format!("{} bytes are not records", next - at));
                        self.at = next;
                    }
                    None => {
                        let records = self.of_unfinished_chunk(at)?;
                        self.opened.extend(records);
                        self.condition.cut = Some(if cut { NO_INDEX.to_owned() } else { what });
                        self.ended = true;
                    }
                }
                self.checksum = None;
            }
            Found::End(why) => {
                self.condition.cut = why;
                self.ended = true;
            }
        }
        Ok(())
    }

    /// If the record at `at` that was just read has swallowed a chunk, goes on there. One that records follow is as
    /// long as it says: it may hold anything, a log too.
    fn go_on_within(&mut self, at: u64) -> io::Result<bool> {
        if self.records_follow()? {
            return Ok(false);
        }
        let Some(chunk) = self.search(at + 1..self.at, is_chunk)? else { return Ok(false) };
        self.at = chunk;
        self.checksum = None;
        Ok(true)
    }

    /// Whether there are records from here on: a chunk, the end of the data or of the log, or some in a row.
    fn records_follow(&mut self) -> io::Result<bool> {
        let mut at = self.at;
        for _ in 0..IN_A_ROW {
            let telling = self.telling(at)?;
            let left = self.length.saturating_sub(at);
            match heads::read(&telling, left) {
                _ if is_plausible(&telling, left) => return Ok(true),
                Head::Record(_, length) if length > 0 => at += HEAD + length,
                _ => return Ok(false),
            }
        }
        Ok(true)
    }

    /// The first bytes of a record.
    fn telling(&mut self, at: u64) -> io::Result<Vec<u8>> {
        self.seek_to(at)?;
        let mut telling = Vec::new();
        (&mut self.file).take(TELLING).read_to_end(&mut telling)?;
        Ok(telling)
    }

    /// Reads the record at the current position.
    fn found(&mut self) -> io::Result<Found> {
        let left = self.length.saturating_sub(self.at);
        if left == 0 {
            return Ok(Found::End(Some(NO_INDEX.to_owned())));
        }
        let telling = self.telling(self.at)?;
        let (code, length, chunk) = match heads::read(&telling, left) {
            Head::Record(code, length) => (code, length, None),
            Head::Chunk { length, mended } => (op::CHUNK, length, Some(mended)),
            Head::None => return Ok(Found::Nonsense(format!("at byte {} there is no record", self.at))),
            Head::Unfinished => return Ok(Found::Nonsense(NO_INDEX.to_owned())),
        };
        self.seek_to(self.at + HEAD)?;
        let mut body = vec![0; length as usize];
        self.file.read_exact(&mut body)?;
        if code != op::DATA_END
            && let Some(checksum) = &mut self.checksum
        {
            checksum.update(telling.get(..HEAD as usize).unwrap_or_default());
            checksum.update(&body);
        }
        self.at += HEAD + length;
        Ok(match chunk {
            Some(mended) => Found::Chunk(body, mended),
            None => Found::Record(code, body),
        })
    }

    /// The complete records of the unfinished chunk at `at`, whose checksum was not written yet; none if it is not a
    /// chunk or is compressed.
    fn of_unfinished_chunk(&mut self, at: u64) -> io::Result<Vec<(u8, Vec<u8>)>> {
        // Times, size and checksum of its records, the (empty) name of the compression, and their size.
        const CHUNK_HEAD: usize = 8 + 8 + 8 + 4 + 4 + 8;
        let mut bytes = Vec::new();
        self.seek_to(at)?;
        (&mut self.file).take(LARGEST_CHUNK).read_to_end(&mut bytes)?;
        let plain = bytes.get(HEAD as usize + 28..HEAD as usize + 32) == Some(&[0; 4]);
        if bytes.first() != Some(&op::CHUNK) || !plain {
            return Ok(Vec::new());
        }
        let records = plain_records(bytes.get(HEAD as usize + CHUNK_HEAD..).unwrap_or_default());
        let sound = records
            .take_while(|(code, body)| (is_topic(*code) || *code == op::MESSAGE) && parsed(*code, body).is_some());
        Ok(sound.map(|(code, body)| (code, body.to_vec())).collect())
    }

    fn seek_to(&mut self, at: u64) -> io::Result<()> {
        let now = self.file.stream_position()?;
        let by = i128::from(at) - i128::from(now);
        self.file.seek_relative(i64::try_from(by).map_err(io::Error::other)?)
    }

    /// Notes a damaged place whose messages are left out.
    fn damaged(&mut self, at: u64, what: String) {
        self.note(at, what, true);
    }

    /// Notes a damaged place without messages.
    fn damaged_without_loss(&mut self, at: u64, what: &str) {
        self.note(at, what.to_owned(), false);
    }

    fn note(&mut self, at: u64, what: String, loses_messages: bool) {
        if self.condition.damage.len() == MAX_LISTED {
            self.condition.more_damage += 1;
            self.condition.more_losses += u64::from(loses_messages);
        } else {
            self.condition.damage.push(Damage { at, what, between_ns: (self.last_ns, None), loses_messages });
        }
    }

    /// Checks the checksum of the data section, which also covers records without their own.
    fn check_data(&mut self, at: u64, body: &[u8]) {
        self.data_ended = true;
        let saved = body.first_chunk().map_or(0, |bytes| u32::from_le_bytes(*bytes));
        let computed = self.checksum.take().map(crc32fast::Hasher::finalize);
        if saved == 0 || computed.is_none_or(|computed| computed == saved) || !self.condition.damage.is_empty() {
            return;
        }
        if self.unchecked {
            let what = "the checksum of the data differs, and messages have none of their own: some may be wrong";
            self.damaged(at, what.to_owned());
        } else {
            let what = "the checksum of the data differs: an index, metadata or unused bits are damaged, the messages' \
                        own checksums are right";
            self.damaged_without_loss(at, what);
        }
    }

    /// Checks what the end of a log says of it.
    fn finish(&mut self, at: u64, footer: &[u8]) -> io::Result<()> {
        self.ended = true;
        let sound = self.check_summary(at, footer)?;
        let is_told = self.condition.lost().is_some();
        if let Some(counted) = self.counted.filter(|counted| sound && !is_told && *counted > self.messages) {
            self.damaged(at, format!("the index counts {counted} messages, {} are there", self.messages));
        } else if !self.data_ended && self.condition.damage.is_empty() {
            self.damaged_without_loss(at, "the end of the data is not marked");
        }
        self.check_end()
    }

    /// Checks the checksum of index and statistics; returns whether it is right, or none was written.
    fn check_summary(&mut self, at: u64, body: &[u8]) -> io::Result<bool> {
        let Ok(Record::Footer(footer)) = mcap::parse_record(op::FOOTER, body) else {
            self.damaged_without_loss(at, "the footer cannot be understood");
            return Ok(false);
        };
        if footer.summary_crc == 0 {
            return Ok(true);
        }
        let start = if footer.summary_start == 0 { at } else { footer.summary_start };
        // Up to the checksum itself, the last field of the footer.
        let end = self.at - 4;
        let mut checksum = crc32fast::Hasher::new();
        if start <= at {
            self.seek_to(start)?;
            let mut rest = end - start;
            let mut bytes = [0; 4096];
            while rest > 0 {
                let part = bytes.get_mut(..rest.min(4096) as usize).unwrap_or_default();
                self.file.read_exact(part)?;
                checksum.update(part);
                rest -= part.len() as u64;
            }
        }
        let right = start <= at && checksum.finalize() == footer.summary_crc;
        if !right {
            self.damaged_without_loss(at, "the index is damaged, the messages are not");
        }
        Ok(right)
    }

    fn check_end(&mut self) -> io::Result<()> {
        const MAGIC: usize = mcap::MAGIC.len();
        let mut end = Vec::new();
        self.seek_to(self.at)?;
        (&mut self.file).take(2 * MAGIC as u64).read_to_end(&mut end)?;
        let after = self.at + MAGIC as u64;
        if end.get(MAGIC..).is_some_and(|next| next == mcap::MAGIC) {
            let more = self.length - after;
            self.damaged(after, format!("another log begins, and {more} bytes are not read: split the file there"));
        } else if end != mcap::MAGIC {
            self.damaged_without_loss(self.at, "the file does not end as logs do, the messages are not damaged");
        }
        Ok(())
    }

    /// The first place there that looks `like` what is searched for.
    fn search(&mut self, places: Range<u64>, like: fn(&[u8], u64) -> bool) -> io::Result<Option<u64>> {
        const BLOCK: u64 = 1 << 16;
        let mut start = places.start;
        while start < places.end {
            let count = BLOCK.min(places.end - start);
            self.seek_to(start)?;
            let mut block = Vec::new();
            (&mut self.file).take(count + TELLING).read_to_end(&mut block)?;
            for (k, at) in (start..start + count.min(block.len() as u64)).enumerate() {
                let rest = block.get(k..).unwrap_or_default();
                if like(rest, self.length - at) {
                    return Ok(Some(at));
                }
            }
            start += count;
        }
        Ok(None)
    }
}

/// Codes and contents of whole records, one after another.
pub(crate) fn plain_records(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        let ([code, length @ ..], after) = bytes.split_first_chunk::<{ HEAD as usize }>()?;
        let body;
        (body, bytes) = after.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
        Some((*code, body))
    })
}

fn is_topic(code: u8) -> bool {
    [op::SCHEMA, op::CHANNEL].contains(&code)
}

/// A record, unless invalid. (The library panics on an attachment that is too short for its checksum.)
fn parsed(code: u8, body: &[u8]) -> Option<Record<'_>> {
    catch_panic(|| mcap::parse_record(code, body).ok()).flatten()
}

/// A chunk that was opened.
struct Opened {
    records: Vec<(u8, Vec<u8>)>,
    /// Whether it has a checksum.
    checked: bool,
}

/// The records of a chunk.
fn opened(body: &[u8]) -> Result<Opened, String> {
    let Some(Record::Chunk { header, .. }) = parsed(op::CHUNK, body) else {
        return Err("a chunk cannot be understood".to_owned());
    };
    if header.uncompressed_size > LARGEST_CHUNK {
        return Err(format!("a chunk declares {} bytes", header.uncompressed_size));
    }
    if !matches!(header.compression.as_str(), "" | "lz4" | "zstd") {
        return Err(format!("a chunk is compressed as `{}`, which is not known", header.compression.escape_debug()));
    }
    let checked = header.uncompressed_crc != 0;
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(LARGEST_CHUNK as usize);
    let length = (body.len() as u64).to_le_bytes();
    let mut bytes = [op::CHUNK].as_slice().chain(length.as_slice()).chain(body);
    let read = || {
        let mut reader = LinearReader::new_with_options(options);
        let mut records = Vec::new();
        while let Some(event) = reader.next_event() {
            match event.map_err(|error| reason(&error))? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let got = bytes.read(reader.insert(wanted)).map_err(|error| error.to_string())?;
                    reader.notify_read(got);
                }
                LinearReadEvent::Record { data, opcode } => records.push((opcode, data.to_vec())),
            }
        }
        Ok(Opened { records, checked })
    };
    catch_panic(read).unwrap_or_else(|| Err("a chunk cannot be understood".to_owned()))
}

fn reason(error: &McapError) -> String {
    match error {
        McapError::BadChunkCrc { .. } => "the checksum of a chunk differs: its messages are left out".to_owned(),
        other => format!("a chunk cannot be read ({other}): its messages are left out"),
    }
}

/// Gives every record of the log at `path` to `take`.
///
/// # Errors
/// When the file cannot be read, is not an MCAP file, or `take` fails.
pub(crate) fn each<E: From<LogError>>(
    path: &Path,
    mut take: impl FnMut(&Record<'_>) -> Result<(), E>,
) -> Result<Condition, E> {
    let mut records = Records::open(path)?;
    while let Some(record) = records.next()? {
        take(&record)?;
    }
    Ok(records.condition)
}
