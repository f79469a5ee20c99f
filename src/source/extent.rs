//! Whether a recording's file is complete, from the lengths its container declares.
//!
//! libav reports a cut-off file as a normal end of the stream, so the container itself is read: Matroska (RFC 9559:
//! EBML elements), MP4 and QuickTime (ISO/IEC 14496-12: boxes) and AVI (RIFF chunks). Only headers are read. What this
//! cannot detect: a Matroska file of undeclared length that ends between two elements, and damage inside.

use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom};

/// How much of a file is present.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Extent {
    /// Everything that the container declares.
    Whole,
    /// An MP4 that another one follows, as programs that know nothing of MP4 join them: libav reads the first.
    Several,
    /// The container declares no lengths, or is of an unknown kind.
    Undeclared,
    /// It ends early.
    Short {
        /// Bytes there.
        found_bytes: u64,
        /// Bytes declared, at least.
        declared_bytes: u64,
    },
    /// An MP4 without its index (the `moov` box), which recorders write last.
    NoIndex,
}

/// Reads the lengths in `file`.
///
/// # Errors
/// When reading fails.
pub(crate) fn extent(file: impl Read + Seek) -> io::Result<Extent> {
    let mut walk = Walk::new(file)?;
    let mut magic = [0; 12];
    if !walk.read(&mut magic)? {
        return Ok(Extent::Undeclared);
    }
    walk.seek_to(0)?;
    match magic {
        [0x1A, 0x45, 0xDF, 0xA3, ..] => ebml(&mut walk),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'A', b'V', b'I', b' '] => riff(&mut walk),
        [_, _, _, _, name @ .., _, _, _, _]
            if matches!(&name, b"ftyp" | b"moov" | b"mdat" | b"free" | b"skip" | b"wide" | b"pnot") =>
        {
            boxes(&mut walk)
        }
        _ => Ok(Extent::Undeclared),
    }
}

/// A position in a file of known length.
struct Walk<R> {
    file: BufReader<R>,
    at: u64,
    length: u64,
}

impl<R: Read + Seek> Walk<R> {
    fn new(mut file: R) -> io::Result<Self> {
        let length = file.seek(SeekFrom::End(0))?;
        file.rewind()?;
        Ok(Self { file: BufReader::new(file), at: 0, length })
    }

    /// Fills `bytes`; `false` when the file ends first.
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<bool> {
        match self.file.read_exact(bytes) {
            Ok(()) => {
                self.at += bytes.len() as u64;
                Ok(true)
            }
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(false),
            Err(error) => Err(error),
        }
    }

    fn seek_to(&mut self, at: u64) -> io::Result<()> {
        let by = i128::from(at) - i128::from(self.at);
        self.file.seek_relative(i64::try_from(by).map_err(io::Error::other)?)?;
        self.at = at;
        Ok(())
    }

    /// Skips `size` bytes; reports if the file ends first.
    fn skip(&mut self, size: u64) -> io::Result<Option<Extent>> {
        let end = self.at.saturating_add(size);
        if end > self.length {
            return Ok(Some(self.short(end)));
        }
        self.seek_to(end)?;
        Ok(None)
    }

    fn short(&self, declared_bytes: u64) -> Extent {
        Extent::Short { found_bytes: self.length, declared_bytes }
    }

    /// An EBML number of up to `most` bytes, marker included, and its length in bytes. `Err(extent)` ends the walk.
    fn number(&mut self, most: u32) -> io::Result<Result<(u64, u32), Extent>> {
        let mut first = [0];
        if !self.read(&mut first)? {
            return Ok(Err(self.short(self.at + 1)));
        }
        let more = u8::leading_zeros(first[0]);
        if more >= most {
            return Ok(Err(Extent::Undeclared));
        }
        let mut value = u64::from(first[0]);
        for _ in 0..more {
            if !self.read(&mut first)? {
                return Ok(Err(self.short(self.length + 1)));
            }
            value = value << 8 | u64::from(first[0]);
        }
        Ok(Ok((value, more + 1)))
    }
}

/// Elements of known size are skipped whole, those of unknown size (live recordings) are entered.
fn ebml<R: Read + Seek>(walk: &mut Walk<R>) -> io::Result<Extent> {
    let mut declared = true;
    while walk.at < walk.length {
        let size = match walk.number(4)? {
            Ok(_id) => walk.number(8)?,
            Err(end) => return Ok(end),
        };
        let (marked, bytes) = match size {
            Ok(size) => size,
            Err(end) => return Ok(end),
        };
        let all_ones = (1_u64 << (7 * bytes)) - 1;
        let size = marked & all_ones;
        if size == all_ones {
            declared = false;
        } else if let Some(short) = walk.skip(size)? {
            return Ok(short);
        }
    }
    Ok(if declared { Extent::Whole } else { Extent::Undeclared })
}

fn boxes<R: Read + Seek>(walk: &mut Walk<R>) -> io::Result<Extent> {
    // Recordings in fragments may repeat their head; libav reads all fragments.
    let (mut heads, mut indices, mut fragments) = (0, 0, 0);
    let mut short = None;
    while walk.at < walk.length && short.is_none() {
        let mut head = [0; 8];
        if !walk.read(&mut head)? {
            break;
        }
        let [a, b, c, d, name @ ..] = head;
        let size = match u32::from_be_bytes([a, b, c, d]) {
            0 => walk.length - walk.at,
            1 => {
                let mut long = [0; 8];
                if !walk.read(&mut long)? {
                    break;
                }
                u64::from_be_bytes(long).saturating_sub(16)
            }
            // Not a box: something else follows the last one.
            2..8 => break,
            size => u64::from(size) - 8,
        };
        short = walk.skip(size)?;
        match &name {
            b"ftyp" => heads += 1,
            b"moov" if short.is_none() => indices += 1,
            b"moof" => fragments += 1,
            _ => {}
        }
    }
    Ok(match short {
        _ if indices == 0 => Extent::NoIndex,
        Some(short) => short,
        None if fragments == 0 && heads.max(indices) > 1 => Extent::Several,
        None => Extent::Whole,
    })
}

fn riff<R: Read + Seek>(walk: &mut Walk<R>) -> io::Result<Extent> {
    while walk.at < walk.length {
        let mut head = [0; 8];
        if !walk.read(&mut head)? || head.get(..4) != Some(b"RIFF") {
            break;
        }
        let [_, _, _, _, a, b, c, d] = head;
        let size = u32::from_le_bytes([a, b, c, d]);
        // An unfinished recording: the size is written last.
        if size == 0 || size == u32::MAX {
            return Ok(Extent::Undeclared);
        }
        if let Some(short) = walk.skip(u64::from(size))? {
            return Ok(short);
        }
        // The byte that pads to an even length may be missing at the end.
        if size % 2 == 1 && walk.at < walk.length {
            walk.skip(1)?;
        }
    }
    Ok(Extent::Whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    fn of(bytes: &[u8]) -> Extent {
        extent(Cursor::new(bytes)).unwrap()
    }

    #[test]
    fn matroska_of_declared_length() {
        // EBML header of 2 bytes, Segment of 6.
        let file =
            [&[0x1A, 0x45, 0xDF, 0xA3, 0x82, 0, 0][..], &[0x18, 0x53, 0x80, 0x67, 0x86, 1, 2, 3, 4, 5, 6]].concat();
        assert_eq!(of(&file), Extent::Whole);
        assert_eq!(of(&file[..15]), Extent::Short { found_bytes: 15, declared_bytes: 18 });
    }

    #[test]
    fn matroska_of_a_live_recording_is_searched_to_the_last_element() {
        // Segment and Cluster of unknown size, the cluster with two blocks of 3 bytes.
        let file = [
            &[0x1A, 0x45, 0xDF, 0xA3, 0x80][..],
            &[0x18, 0x53, 0x80, 0x67, 0x01, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF],
            &[0x1F, 0x43, 0xB6, 0x75, 0xFF],
            &[0xA3, 0x83, 1, 2, 3, 0xA3, 0x83, 1, 2, 3],
        ]
        .concat();
        assert_eq!(of(&file), Extent::Undeclared);
        assert_eq!(of(&file[..file.len() - 1]), Extent::Short { found_bytes: 31, declared_bytes: 32 });
        assert_eq!(of(&file[..file.len() - 4]), Extent::Short { found_bytes: 28, declared_bytes: 29 });
        assert_eq!(of(&file[..file.len() - 5]), Extent::Undeclared);
    }

    #[test]
    fn mp4_with_the_index_in_front_at_the_end_and_missing() {
        let head = [0, 0, 0, 12, b'f', b't', b'y', b'p', 0, 0, 0, 0];
        let index = [0, 0, 0, 9, b'm', b'o', b'o', b'v', 7];
        let data = [0, 0, 0, 1, b'm', b'd', b'a', b't', 0, 0, 0, 0, 0, 0, 0, 19, 1, 2, 3];
        let front = [&head[..], &index, &data].concat();
        assert_eq!(of(&front), Extent::Whole);
        assert_eq!(of(&front[..38]), Extent::Short { found_bytes: 38, declared_bytes: 40 });
        let end = [&head[..], &data, &index].concat();
        assert_eq!(of(&end), Extent::Whole);
        assert_eq!(of(&end[..30]), Extent::NoIndex);
        assert_eq!(of(&end[..39]), Extent::NoIndex);
    }

    #[test]
    fn an_mp4_behind_another_is_told() {
        let [head, data, index, fragment] =
            [b"ftyp", b"mdat", b"moov", b"moof"].map(|name| [&[0, 0, 0, 9][..], name, &[7]].concat());
        let recording = [&head[..], &data, &index].concat();
        assert_eq!(of(&recording.repeat(2)), Extent::Several);
        assert_eq!(of(&[&recording[..], &head, &data].concat()), Extent::Several);
        assert_eq!(of(&[&head[..], &index, &fragment, &data].concat().repeat(2)), Extent::Whole);
    }

    #[test]
    fn avi_and_files_of_other_kinds() {
        let avi = [b"RIFF\x06\0\0\0AVI \x01\x02".as_slice(), b"RIFF\x04\0\0\0AVIX"].concat();
        assert_eq!(of(&avi), Extent::Whole);
        assert_eq!(of(&avi[..24]), Extent::Short { found_bytes: 24, declared_bytes: 26 });
        assert_eq!(of(b"a table, or a letter"), Extent::Undeclared);
        assert_eq!(of(b""), Extent::Undeclared);
    }
}
