//! A table that another program writes, read as it grows. Where it is cut or replaced by another file what follows
//! cannot be told from what was read before: that ends the reading with an error instead of losing samples silently.

use std::fs::{self, File, Metadata};
use std::io::{self, Read};
use std::path::PathBuf;

/// A file, and the path under which it was opened.
pub(super) struct Followed {
    path: PathBuf,
    file: File,
    opened: Metadata,
    /// Bytes read.
    at: u64,
}

impl Followed {
    pub(super) fn open(path: PathBuf) -> io::Result<Self> {
        let file = File::open(&path)?;
        let opened = file.metadata()?;
        Ok(Self { path, file, opened, at: 0 })
    }

    /// What happened to the file so that it cannot be followed, if anything. One that is gone may come back.
    fn broken(&self) -> Option<&'static str> {
        let now = fs::metadata(&self.path).ok().filter(|now| now.is_file() && self.opened.is_file())?;
        if is_other(&self.opened, &now) {
            Some("another file has taken the place of the table")
        } else if now.len() < self.at {
            Some("the table was cut while it was read")
        } else {
            None
        }
    }
}

impl Read for Followed {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.file.read(bytes)?;
        self.at += read as u64;
        match self.broken().filter(|_| read == 0 && !bytes.is_empty()) {
            Some(what) => Err(io::Error::other(format!("{what}; append rows to it"))),
            None => Ok(read),
        }
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
