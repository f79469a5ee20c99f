//! Atomic replacement of files: a reader finds the old file or the new one, never half of one.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// How the name of a partial file ends.
const PARTIAL: &str = ".new";

/// Writes a file in one step, replacing any that exists.
///
/// # Errors
/// The system's, for example a full disk; the old file is then unchanged.
pub(crate) fn write(place: &Path, bytes: &[u8]) -> io::Result<()> {
    NewFile::write(place, bytes)?.put_in_place()
}

/// A new file beside the one that it will replace; removed again unless it was [put in place](NewFile::put_in_place).
#[derive(Debug)]
#[must_use = "it is removed again unless it is put in place"]
pub(crate) struct NewFile {
    beside: PathBuf,
    place: PathBuf,
}

impl NewFile {
    /// Writes it and flushes it to the disk.
    ///
    /// # Errors
    /// The system's, for example a full disk.
    pub(crate) fn write(place: &Path, bytes: &[u8]) -> io::Result<Self> {
        let (new, mut file) = Self::begin(place)?;
        file.write_all(bytes).and_then(|()| file.sync_all())?;
        Ok(new)
    }

    /// Opens it, for content too large to write at once. The caller must flush it to the disk. Of a link, what it leads
    /// to is replaced; the new file has the old one's permissions.
    ///
    /// # Errors
    /// The system's.
    pub(crate) fn begin(place: &Path) -> io::Result<(Self, File)> {
        let old = fs::canonicalize(place);
        let place = old.as_deref().unwrap_or(place);
        // A rename would put a file in its place.
        if fs::metadata(place).is_ok_and(|old| !old.is_file()) {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "is a device, a pipe or a folder, not a file"));
        }
        let mut beside = place.as_os_str().to_owned();
        beside.push(format!(".{}{PARTIAL}", std::process::id()));
        let new = Self { beside: beside.into(), place: place.to_path_buf() };
        let file = File::create(&new.beside)?;
        if let Ok(old) = fs::metadata(place) {
            fs::set_permissions(&new.beside, old.permissions())?;
        }
        Ok((new, file))
    }

    /// Replaces the old file.
    ///
    /// # Errors
    /// The system's.
    pub(crate) fn put_in_place(self) -> io::Result<()> {
        fs::rename(&self.beside, &self.place)
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        // Fails when the file is already in place, or was never made.
        let _ = fs::remove_file(&self.beside);
    }
}

/// Whether `name` is that of a partial file, which a killed process left beside the file `of`.
pub(crate) fn is_partial(name: &OsStr, of: &str) -> bool {
    let number = name.to_str().and_then(|name| name.strip_prefix(of)?.strip_prefix('.')?.strip_suffix(PARTIAL));
    number.is_some_and(|number| !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit()))
}

/// Names for a file's backup, the preferred first: `.bak`, `.bak2`, … beside it.
pub(crate) fn backup_names(place: &Path) -> impl Iterator<Item = PathBuf> {
    (1_u64..).map(move |n| {
        let mut name = place.as_os_str().to_owned();
        name.push(if n == 1 { ".bak".to_owned() } else { format!(".bak{n}") });
        name.into()
    })
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::{PermissionsExt as _, symlink};

    #[test]
    fn what_is_no_file_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        for place in [Path::new("/dev/null"), folder.path()] {
            let error = write(place, b"new").unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::InvalidInput, "{error}");
        }
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }

    #[test]
    fn what_a_link_leads_to_is_replaced_and_keeps_its_permissions() {
        let folder = tempfile::tempdir().unwrap();
        let (shared, link) = (folder.path().join("shared.toml"), folder.path().join("rig.toml"));
        fs::write(&shared, "old").unwrap();
        fs::set_permissions(&shared, fs::Permissions::from_mode(0o664)).unwrap();
        symlink("shared.toml", &link).unwrap();
        write(&link, b"new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read_to_string(&shared).unwrap(), "new");
        assert_eq!(fs::metadata(&shared).unwrap().permissions().mode() & 0o777, 0o664);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
