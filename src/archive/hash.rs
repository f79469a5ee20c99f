//! SHA-256 of what a run is made from.

use sha2::{Digest as _, Sha256};
use std::fs::{self, File};
use std::io::{self, BufReader};
use std::path::Path;

/// Bytes read at a time: memory stays small for any recording.
const PIECE: usize = 1 << 20;

/// SHA-256 of some bytes, in hexadecimal.
pub(crate) fn of_bytes(bytes: &[u8]) -> String {
    format!("{:x}", Sha256::digest(bytes))
}

/// SHA-256 of a file.
///
/// # Errors
/// The system's, when it cannot be read.
pub(crate) fn of_file(path: &Path) -> io::Result<String> {
    let mut hash = Sha256::new();
    io::copy(&mut BufReader::with_capacity(PIECE, File::open(path)?), &mut hash)?;
    Ok(format!("{:x}", hash.finalize()))
}

/// SHA-256 of a recording: of the file, or of the names and hashes of all files in a folder of pictures, sorted by
/// name. Hidden files and subfolders do not count.
///
/// # Errors
/// The system's, when it cannot be read, or is neither a file nor a folder.
pub(crate) fn of_recording(path: &Path) -> io::Result<String> {
    let found = fs::metadata(path)?;
    if found.is_file() {
        return of_file(path);
    }
    // A pipe would be waited for.
    if !found.is_dir() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "is neither a file nor a folder"));
    }
    let mut names = Vec::new();
    for entry in fs::read_dir(path)? {
        let name = entry?.file_name();
        let hidden = name.as_encoded_bytes().starts_with(b".");
        if !hidden && fs::metadata(path.join(&name))?.is_file() {
            names.push(name);
        }
    }
    names.sort();
    let mut hash = Sha256::new();
    for name in names {
        hash.update(name.as_encoded_bytes());
        hash.update([0]);
        hash.update(of_file(&path.join(&name))?);
        hash.update([b'\n']);
    }
    Ok(format!("{:x}", hash.finalize()))
}

/// SHA-256 of this program as it runs, even if its file has been replaced since.
///
/// # Errors
/// The system's, when the program cannot be read.
pub(crate) fn of_program() -> io::Result<String> {
    let running = Path::new("/proc/self/exe");
    if running.exists() { of_file(running) } else { of_file(&std::env::current_exe()?) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The well-known hash of empty input.
    const NOTHING: &str = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";

    #[test]
    fn a_file_has_the_hash_of_its_bytes() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("a");
        fs::write(&file, vec![7; PIECE + 3]).unwrap();
        assert_eq!(of_recording(&file).unwrap(), of_bytes(&vec![7; PIECE + 3]));
        assert_eq!(of_bytes(b""), NOTHING);
        assert!(of_recording(&place.path().join("b")).is_err());
    }

    #[test]
    fn a_folder_has_another_hash_when_a_picture_or_a_name_is_another() {
        let place = tempfile::tempdir().unwrap();
        let put = |name: &str, text: &str| fs::write(place.path().join(name), text).unwrap();
        put("1.png", "a");
        put("2.png", "b");
        let first = of_recording(place.path()).unwrap();
        put(".hidden", "x");
        assert_eq!(of_recording(place.path()).unwrap(), first);
        put("2.png", "c");
        let second = of_recording(place.path()).unwrap();
        fs::rename(place.path().join("2.png"), place.path().join("3.png")).unwrap();
        assert!(second != first && of_recording(place.path()).unwrap() != second);
    }
}
