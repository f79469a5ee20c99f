//! Which bytes can be the head of a record.
//!
//! A damaged head makes one record of another, or swallows those that follow. A chunk tells from its inside, too, that
//! it is one, and how long it is.

use mcap::records::op;

/// Code and length before every record.
pub(super) const HEAD: u64 = 9;
/// Our records are much shorter: a greater length is damage.
const LONGEST_RECORD: u64 = 1 << 30;
/// The same for the content of a compressed chunk.
pub(super) const LARGEST_CHUNK: u64 = 1 << 28;
/// As many bytes tell a record's kind.
pub(super) const TELLING: u64 = 64;
/// Length of the last record of a log.
const FOOTER: u64 = 20;

/// What a head says.
pub(super) enum Head {
    /// A record of this code and length.
    Record(u8, u64),
    /// A chunk of this length. `mended`: its code or length is another, the rest is a chunk's.
    Chunk { length: u64, mended: bool },
    /// No record begins here.
    None,
    /// One does, but is longer than the file.
    Unfinished,
}

/// The head that `bytes` begin with, with `left` to the file's end.
pub(super) fn read(bytes: &[u8], left: u64) -> Head {
    let Some((code, said)) = bytes.first().copied().zip(number(bytes, 1)) else { return Head::Unfinished };
    let fits = |length: u64| length <= left.saturating_sub(HEAD) && length <= LONGEST_RECORD;
    match chunk_length(bytes) {
        Some(length) if fits(length) && (code == op::CHUNK || said == length) => {
            return Head::Chunk { length, mended: code != op::CHUNK || said != length };
        }
        _ => {}
    }
    match code {
        // Codes from 0x80 are private to other programs.
        0 | 0x10..0x80 => Head::None,
        _ if !fits(said) => Head::Unfinished,
        op::CHUNK => Head::Chunk { length: said, mended: false },
        op::DATA_END if said != 4 => Head::None,
        op::FOOTER if !is_footer(bytes, left) => Head::None,
        _ => Head::Record(code, said),
    }
}

/// Whether bytes look like the beginning of a chunk, the end of the data, or the end of a log, with `left` to the
/// file's end.
pub(super) fn is_plausible(bytes: &[u8], left: u64) -> bool {
    match bytes.first() {
        Some(&op::CHUNK) => is_chunk(bytes, left),
        Some(&op::DATA_END) => {
            let next = bytes.get(HEAD as usize + 4);
            number(bytes, 1) == Some(4) && next.is_some_and(|code| (op::HEADER..=op::DATA_END).contains(code))
        }
        Some(&op::FOOTER) => is_footer(bytes, left),
        _ => false,
    }
}

/// Whether they look like the beginning of a chunk.
pub(super) fn is_chunk(bytes: &[u8], left: u64) -> bool {
    bytes.first() == Some(&op::CHUNK)
        && number(bytes, 1)
            .is_some_and(|length| length <= left.saturating_sub(HEAD) && chunk_length(bytes) == Some(length))
}

fn is_footer(bytes: &[u8], left: u64) -> bool {
    let end = (HEAD + FOOTER) as usize..;
    // The magic behind it may be cut off.
    let ends = (HEAD + FOOTER..=HEAD + FOOTER + mcap::MAGIC.len() as u64).contains(&left)
        || bytes.get(end).is_some_and(|rest| rest.starts_with(mcap::MAGIC));
    number(bytes, 1) == Some(FOOTER) && ends
}

/// The length of a chunk according to its inside; `None` if that is no chunk's.
fn chunk_length(bytes: &[u8]) -> Option<u64> {
    let times = number(bytes, 9)? <= number(bytes, 17)?;
    let size = number(bytes, 25)?;
    let name = short(bytes, 37)?;
    let named = match name {
        0 => true,
        3 => bytes.get(41..44) == Some(b"lz4"),
        4 => bytes.get(41..45) == Some(b"zstd"),
        _ => false,
    };
    if !(times && named && size <= LARGEST_CHUNK) {
        return None;
    }
    let head = 8 + 8 + 8 + 4 + 4 + u64::from(name) + 8;
    number(bytes, 41 + name as usize)?.checked_add(head)
}

fn number(bytes: &[u8], at: usize) -> Option<u64> {
    bytes.get(at..)?.first_chunk().map(|eight| u64::from_le_bytes(*eight))
}

fn short(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|four| u32::from_le_bytes(*four))
}
