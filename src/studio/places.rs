//! Which files the page may name: those below the starting folder, and those that were named on the command line.

use super::Refusal;
use crate::log::schema::{LOG_FILE, TABLE_FILE};
use crate::source;
use serde::Serialize;
use std::path::{Component, Path, PathBuf};
use std::time::SystemTime;

/// Entries of a folder that are listed.
const MAX_LISTED: usize = 2000;
/// Endings of recordings that are offered; others can be typed.
const RECORDINGS: [&str; 8] = ["mkv", "mp4", "avi", "mov", "webm", "m4v", "mpg", "ts"];

/// The starting folder.
#[derive(Debug)]
pub(crate) struct Places {
    root: PathBuf,
    /// Named on the command line, wherever they are.
    given: Vec<PathBuf>,
}

/// What a folder has.
#[derive(Debug, Serialize, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Entry {
    kind: &'static str,
    name: String,
    path: String,
}

impl Places {
    /// # Errors
    /// When the folder is not there.
    pub(crate) fn below(root: &Path, given: &[PathBuf]) -> std::io::Result<Self> {
        let given = given.iter().filter_map(|path| path.canonicalize().ok()).collect();
        Ok(Self { root: root.canonicalize()?, given })
    }

    /// The starting folder, in words.
    pub(super) fn root(&self) -> String {
        self.root.display().to_string()
    }

    fn is_inside(&self, whole: &Path) -> bool {
        whole.starts_with(&self.root) || self.given.iter().any(|given| whole.starts_with(given))
    }

    /// A file or folder that is there.
    pub(super) fn existing(&self, text: &str) -> Result<PathBuf, Refusal> {
        let path = self.root.join(checked_name(text)?);
        let refused = || {
            let root = self.root.display();
            Refusal::forbidden(format!("{text}: is not below {root}, where the studio was started"))
        };
        // Do not reveal whether something exists outside.
        match path.canonicalize() {
            Ok(whole) if self.is_inside(&whole) => Ok(whole),
            Ok(_) => Err(refused()),
            Err(error) if self.is_inside(&path) && !climbs(&path) => {
                Err(Refusal { status: 404, words: format!("{text}: cannot be read: {error}") })
            }
            Err(_) => Err(refused()),
        }
    }

    /// A file that may be written: in a folder that is there, or one that is there already.
    pub(super) fn to_write(&self, text: &str) -> Result<PathBuf, Refusal> {
        let path = self.root.join(checked_name(text)?);
        if path.exists() || path.is_symlink() {
            return self.existing(text);
        }
        let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else {
            return Err(Refusal::wrong(format!("{text}: expected the name of a file")));
        };
        let folder = self.existing(&folder.to_string_lossy())?;
        Ok(folder.join(name))
    }

    /// As a user in the starting folder writes it.
    pub(super) fn shown(&self, path: &Path) -> String {
        let shown = path.strip_prefix(&self.root).unwrap_or(path);
        if shown.as_os_str().is_empty() { ".".to_owned() } else { shown.display().to_string() }
    }

    /// The whole path of what is shown so.
    pub(super) fn whole(&self, shown: &str) -> String {
        self.root.join(shown).display().to_string()
    }

    /// What a folder has that the page can open, folders first.
    pub(super) fn list(&self, text: &str) -> Result<Vec<Entry>, Refusal> {
        let folder = self.existing(text)?;
        let unread = |error: std::io::Error| Refusal::wrong(format!("{text}: cannot be read: {error}"));
        let mut entries = Vec::new();
        for entry in std::fs::read_dir(&folder).map_err(unread)? {
            let path = entry.map_err(unread)?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
            let kind = match path.is_dir() {
                _ if name.starts_with('.') => continue,
                true if [TABLE_FILE, LOG_FILE].iter().any(|file| path.join(file).is_file()) => "run",
                true if path.join("times.csv").is_file() => "recording",
                true => "folder",
                false if RECORDINGS.contains(&ending.as_str()) => "recording",
                false if ending == "toml" && is_rig(&path) => "rig",
                false => continue,
            };
            entries.push(Entry { kind, name, path: self.shown(&path) });
        }
        entries.sort();
        entries.truncate(MAX_LISTED);
        Ok(entries)
    }
}

fn is_rig(path: &Path) -> bool {
    std::fs::read_to_string(path).is_ok_and(|text| text.contains("[camera]"))
}

/// Whether a path goes up anywhere.
fn climbs(path: &Path) -> bool {
    path.components().any(|part| part == Component::ParentDir)
}

fn checked_name(text: &str) -> Result<&str, Refusal> {
    match text {
        "" => Err(Refusal::wrong("a file is missing: choose one")),
        _ if text.contains('\0') => Err(Refusal::wrong("the name of a file has a zero in it")),
        _ => Ok(text),
    }
}

/// When a file or folder was changed last, and its length: what was read of it holds as long as both are the same.
pub(super) fn changed(path: &Path) -> Option<(SystemTime, u64)> {
    let about = std::fs::metadata(path).ok()?;
    Some((about.modified().ok()?, about.len()))
}

/// The first frame of a recording says whether it can be read.
pub(super) fn opened(
    path: &Path,
    options: source::SourceOptions,
) -> Result<Box<dyn source::FrameSource + Send>, Refusal> {
    source::open(path, options).map_err(Refusal::wrong)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_outside_of_the_starting_folder_can_be_named() {
        let all = tempfile::tempdir().unwrap();
        let root = all.path().join("root");
        std::fs::create_dir_all(root.join("inside")).unwrap();
        std::fs::write(all.path().join("secret.toml"), "[camera]").unwrap();
        std::fs::write(all.path().join("given.toml"), "[camera]").unwrap();
        std::fs::write(root.join("inside/rig.toml"), "[camera]").unwrap();
        let places = Places::below(&root, &[all.path().join("given.toml")]).unwrap();
        let secret = all.path().join("secret.toml");
        assert!(places.existing("inside/rig.toml").is_ok() && places.existing("inside/../inside/rig.toml").is_ok());
        assert!(places.existing(all.path().join("given.toml").to_str().unwrap()).is_ok());
        for outside in
            ["../secret.toml", "inside/../../secret.toml", secret.to_str().unwrap(), "/etc/passwd", "../none"]
        {
            assert_eq!(places.existing(outside).unwrap_err().status, 403, "{outside}");
            assert!(places.to_write(outside).is_err(), "{outside}");
        }
        assert_eq!(places.existing("none.toml").unwrap_err().status, 404);
        assert!(places.to_write("inside/new.toml").unwrap().ends_with("root/inside/new.toml"));
        assert!(places.to_write("../new.toml").is_err() && places.to_write("none/new.toml").is_err());
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(&secret, root.join("link.toml")).unwrap();
            std::os::unix::fs::symlink(all.path().join("new.toml"), root.join("hanging.toml")).unwrap();
            assert!(places.existing("link.toml").is_err() && places.to_write("link.toml").is_err());
            assert!(places.to_write("hanging.toml").is_err(), "through a link to where nothing is yet");
        }
        let listed: Vec<_> = places.list(".").unwrap().into_iter().map(|e| (e.kind, e.name)).collect();
        assert!(listed.contains(&("folder", "inside".to_owned())), "{listed:?}");
    }

    #[test]
    fn runs_are_folders_with_a_table_or_a_log() {
        let root = tempfile::tempdir().unwrap();
        for (folder, file) in [("a", "track.csv"), ("b", "log.mcap"), ("c", "model.json")] {
            std::fs::create_dir(root.path().join(folder)).unwrap();
            std::fs::write(root.path().join(folder).join(file), "").unwrap();
            std::fs::write(root.path().join(folder).join("run.toml"), "").unwrap();
        }
        let listed = Places::below(root.path(), &[]).unwrap().list(".").unwrap();
        let kinds: Vec<_> = listed.iter().map(|entry| (entry.name.as_str(), entry.kind)).collect();
        assert_eq!(kinds, [("c", "folder"), ("a", "run"), ("b", "run")]);
    }
}
