//! A table that another program writes, read as it grows. Where it is cut or replaced by another file what follows
//! cannot be told from what was read before: that ends the reading with an error instead of losing samples silently.
//! A table that was cut and has grown beyond what was read since is known by its last bytes, which are read again.

use std::fs::{self, File, Metadata};
use std::io::{self, Read, Seek as _, SeekFrom};
use std::path::PathBuf;

/// Bytes that are read again: the last lines, with times that no other rows have.
const AGAIN_BYTES: usize = 1024;

const CUT: &str = "the table was cut while it was read";

/// A file, and the path under which it was opened.
pub(super) struct Followed {
    path: PathBuf,
    file: File,
    opened: Metadata,
    /// Bytes read.
    at: u64,
    /// The last of them.
    last: Vec<u8>,
}

impl Followed {
    pub(super) fn open(path: PathBuf) -> io::Result<Self> {
        let file = File::open(&path)?;
        let opened = file.metadata()?;
        Ok(Self { path, file, opened, at: 0, last: Vec::new() })
    }

    /// What happened to the file so that it cannot be followed, if anything. One that is gone may come back.
    fn broken(&self) -> Option<&'static str> {
        let now = fs::metadata(&self.path).ok().filter(|now| now.is_file() && self.opened.is_file())?;
        if is_other(&self.opened, &now) {
            Some("another file has taken the place of the table")
        } else if now.len() < self.at {
            Some(CUT)
        } else {
            None
        }
    }
}

impl Read for Followed {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.read_on(bytes)?;
        match self.broken().filter(|_| read == Some(0) && !bytes.is_empty()).or(read.is_none().then_some(CUT)) {
            Some(what) => Err(io::Error::other(format!("{what}; append rows to it"))),
            None => Ok(read.unwrap_or(0)),
        }
    }
}

impl Followed {
    /// How many more bytes there are, as many as fit; `None` if those before are no longer what they were.
    fn read_on(&mut self, bytes: &mut [u8]) -> io::Result<Option<usize>> {
        // Pipes and devices are read once.
        if !self.opened.is_file() {
            return self.file.read(bytes).map(Some);
        }
        // With one call: between two the table may be cut.
        let mut again = vec![0; self.last.len() + bytes.len()];
        self.file.seek(SeekFrom::Start(self.at - self.last.len() as u64))?;
        let read = self.file.read(&mut again)?;
        again.truncate(read);
        let Some(new) = again.strip_prefix(self.last.as_slice()) else { return Ok(None) };
        let count = new.len();
        bytes.iter_mut().zip(new).for_each(|(to, from)| *to = *from);
        self.at += count as u64;
        again.drain(..again.len().saturating_sub(AGAIN_BYTES));
        self.last = again;
        Ok(Some(count))
    }
}

#[cfg(unix)]
fn is_other(opened: &Metadata, now: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    (opened.dev(), opened.ino()) != (now.dev(), now.ino())
}

#[cfg(not(unix))]
fn is_other(_: &Metadata, _: &Metadata) -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_that_is_cut_or_replaced_is_an_error_and_one_that_grows_is_not() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("table.csv");
        fs::write(&path, "host_ns,i1\n1,0.1\n").unwrap();
        let mut bytes = [0; 4096];
        let mut cut = Followed::open(path.clone()).unwrap();
        assert_eq!(cut.read(&mut bytes).unwrap(), 17);
        assert_eq!(cut.read(&mut bytes).unwrap(), 0);
        fs::write(&path, "host_ns,i1\n1,0.1\n2,0.2\n").unwrap();
        assert_eq!(cut.read(&mut bytes).unwrap(), 6);
        fs::write(&path, "host_ns,i1\n").unwrap();
        assert!(cut.read(&mut bytes).unwrap_err().to_string().contains("was cut"));

        // Begun anew, and already longer than what was read.
        fs::write(&path, "host_ns,i1\n1,0.1\n2,0.2\n").unwrap();
        let mut anew = Followed::open(path.clone()).unwrap();
        assert_eq!(anew.read(&mut bytes).unwrap(), 23);
        fs::write(&path, "host_ns,i1\n3,0.1\n4,0.2\n5,0.3\n").unwrap();
        assert!(anew.read(&mut bytes).unwrap_err().to_string().contains("was cut"));
        // Written anew with the same rows and more, it goes on; as much as can be taken at once.
        let row = |n: usize| format!("{n:06},0.1\n");
        let rows = |to: usize| "host_ns,i1\n".to_owned() + &(0..to).map(row).collect::<String>();
        fs::write(&path, rows(300)).unwrap();
        let mut long = Followed::open(path.clone()).unwrap();
        let mut read_to = |to: usize| {
            let (mut text, mut few) = (Vec::new(), [0; 700]);
            fs::write(&path, rows(to)).unwrap();
            while let count @ 1.. = long.read(&mut few).unwrap() {
                text.extend(&few[..count]);
            }
            String::from_utf8(text).unwrap()
        };
        assert_eq!(read_to(300), rows(300));
        assert_eq!(read_to(500), (300..500).map(row).collect::<String>());

        fs::write(&path, "host_ns,i1\n").unwrap();
        let mut replaced = Followed::open(path.clone()).unwrap();
        assert_eq!(replaced.read(&mut bytes).unwrap(), 11);
        fs::remove_file(&path).unwrap();
        assert_eq!(replaced.read(&mut bytes).unwrap(), 0);
        let new = place.path().join("new.csv");
        fs::write(&new, "host_ns,i1\n1,0.1\n2,0.2\n").unwrap();
        fs::rename(&new, &path).unwrap();
        assert!(replaced.read(&mut bytes).unwrap_err().to_string().contains("another file"));
    }
}
