//! Files that take their place whole: whoever looks finds the old one or the new one, never half of one.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// Writes a file whole, in the place of one that may be there.
///
/// # Errors
/// The system's, a full disk for example; what was there is still there.
pub(crate) fn write(place: &Path, bytes: &[u8]) -> io::Result<()> {
    NewFile::write(place, bytes)?.put_in_place()
}

/// A new file beside the one whose place it is to take; gone again unless it was [put in place](NewFile::put_in_place).
#[derive(Debug)]
pub(crate) struct NewFile {
    beside: PathBuf,
    place: PathBuf,
}

impl NewFile {
    /// Writes it as far as the disk.
    ///
    /// # Errors
    /// The system's, a full disk for example.
    pub(crate) fn write(place: &Path, bytes: &[u8]) -> io::Result<Self> {
        let (new, mut file) = Self::begin(place)?;
        file.write_all(bytes).and_then(|()| file.sync_all())?;
        Ok(new)
    }

    /// Opens it, for what is too large to be written at once. Who writes it sees to it that it reaches the disk.
    ///
    /// # Errors
    /// The system's.
    pub(crate) fn begin(place: &Path) -> io::Result<(Self, File)> {
        let mut beside = place.as_os_str().to_owned();
        beside.push(format!(".{}.new", std::process::id()));
        let new = Self { beside: beside.into(), place: place.to_path_buf() };
        let file = File::create(&new.beside)?;
        Ok((new, file))
    }

    /// Takes its place.
    ///
    /// # Errors
    /// The system's.
    pub(crate) fn put_in_place(self) -> io::Result<()> {
        fs::rename(&self.beside, &self.place)
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        // In place it is no longer here; where it was never made it cannot be removed either.
        let _ = fs::remove_file(&self.beside);
    }
}
