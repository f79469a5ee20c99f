//! `vetoes.csv` beside a run: frames that a person does not trust, and why.
//!
//! In: the folder of a run. Out: the frames that are vetoed now. What was measured stays as it is; a veto that is taken
//! back stays in the file, with the row that takes it back. Who reads a run leaves its vetoed frames out, and says how
//! many there were. A frame is known by its stamp: numbers count from the first frame of a run, and the same recording
//! may be tracked again from another moment on.

use crate::plural::are;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// The name of the file.
pub(crate) const FILE: &str = "vetoes.csv";
const HEADER: [&str; 5] = ["seq", "stamp_ns", "status", "comment", "written"];
/// The word for a frame that was vetoed.
pub(crate) const VETOED: &str = "vetoed";
const RESTORED: &str = "restored";

/// Why vetoes cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", path.display())]
pub struct VetoError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong, and what would be right.
    pub problem: String,
}

/// A row of the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Veto {
    seq: u64,
    stamp_ns: i64,
    /// `vetoed` or `restored`.
    status: String,
    comment: String,
    /// When, by the clock on the wall, UTC.
    written: String,
}

/// Frames that are vetoed now: their stamps in nanoseconds, and why.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Vetoes(BTreeMap<i64, String>);

impl Vetoes {
    /// Those of the run in `folder`; none when there is no file.
    ///
    /// # Errors
    /// When the file cannot be read, or is not a table of vetoes.
    pub(crate) fn read(folder: &Path) -> Result<Self, VetoError> {
        let mut standing = BTreeMap::new();
        for veto in rows(folder)? {
            if veto.status == VETOED {
                standing.insert(veto.stamp_ns, veto.comment);
            } else {
                standing.remove(&veto.stamp_ns);
            }
        }
        Ok(Self(standing))
    }

    /// Those beside the file of a run, a table or a log.
    ///
    /// # Errors
    /// As [`Vetoes::read`].
    pub(crate) fn beside(file: &Path) -> Result<Self, VetoError> {
        file.parent().map_or_else(|| Ok(Self::default()), Self::read)
    }

    /// How many frames.
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// Why the frame with this stamp is vetoed, if it is.
    pub(crate) fn of(&self, stamp_ns: i64) -> Option<&str> {
        self.0.get(&stamp_ns).map(String::as_str)
    }

    /// What to say of the vetoes that are of none of these frames, if there are any: they change nothing.
    pub(crate) fn without_frame(&self, stamps_ns: impl Iterator<Item = i64>) -> Option<String> {
        let found: BTreeSet<i64> = stamps_ns.filter(|stamp_ns| self.0.contains_key(stamp_ns)).collect();
        let lost: Vec<i64> = self.0.keys().filter(|stamp_ns| !found.contains(stamp_ns)).copied().collect();
        let first = lost.first()?;
        let frames = are(lost.len() as u64, "frame");
        let was = "the run may have been tracked again with another span or other times";
        let first = format!("stamp_ns {first}{}", more(lost.len() - 1));
        Some(format!("{FILE}: {frames} vetoed that this run does not have ({first}): {was}"))
    }
}

/// How many more there are, if any.
fn more(count: usize) -> String {
    if count == 0 { String::new() } else { format!(" and {count} more") }
}

/// Vetoes a frame of the run in `folder`, or takes that back.
///
/// # Errors
/// When the file cannot be written, or what is there is not a table of vetoes.
pub(crate) fn add(
    folder: &Path,
    (seq, stamp_ns): (u64, i64),
    vetoed: bool,
    comment: &str,
) -> Result<Vetoes, VetoError> {
    let path = folder.join(FILE);
    let failed = |error: &dyn std::fmt::Display| VetoError {
        path: path.clone(),
        problem: format!("cannot be written: {error}"),
    };
    let mut file = OpenOptions::new().append(true).create(true).open(&path).map_err(|e| failed(&e))?;
    // Until it is closed: another thread or program waits.
    #[cfg(unix)]
    if let Err(error) = rustix::fs::flock(&file, rustix::fs::FlockOperation::LockExclusive) {
        tracing::debug!("{}: cannot be locked: {error}", path.display());
    }
    rows(folder)?;
    let old = std::fs::read(&path).map_err(|e| failed(&e))?;
    let mut writer =
        csv::WriterBuilder::new().has_headers(false).terminator(csv::Terminator::CRLF).from_writer(Vec::new());
    if old.is_empty() {
        writer.write_record(HEADER).map_err(|e| failed(&e))?;
    }
    let veto = Veto {
        seq,
        stamp_ns,
        status: if vetoed { VETOED } else { RESTORED }.to_owned(),
        comment: comment.to_owned(),
        written: humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
    };
    writer.serialize(veto).map_err(|e| failed(&e))?;
    let mut row = writer.into_inner().map_err(|e| failed(&e))?;
    if !matches!(old.last(), None | Some(b'\n')) {
        row.splice(0..0, *b"\r\n");
    }
    append(&mut file, old.len() as u64, &row).map_err(|e| failed(&e))?;
    Vetoes::read(folder)
}

/// Adds to a file of this length, or leaves it as it is.
fn append(file: &mut File, length: u64, bytes: &[u8]) -> std::io::Result<()> {
    let written = file.write_all(bytes).and_then(|()| file.sync_all());
    if written.is_err() {
        // A part of a row would make a table of none of them.
        let _ = file.set_len(length);
    }
    written
}

/// All rows of the file, oldest first; none when there is no file.
fn rows(folder: &Path) -> Result<Vec<Veto>, VetoError> {
    let path = folder.join(FILE);
    let foreign = |what: &dyn std::fmt::Display| {
        let header = HEADER.join(",");
        VetoError { path: path.clone(), problem: format!("{what}; expected a table with the header {header}") }
    };
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(VetoError { path, problem: format!("cannot be read: {error}") }),
    };
    let rows: Vec<Veto> =
        csv::Reader::from_reader(bytes.as_slice()).deserialize().collect::<Result<_, _>>().map_err(|e| foreign(&e))?;
    // A word that is not known may be meant to veto.
    match rows.iter().find(|row| row.status != VETOED && row.status != RESTORED) {
        Some(Veto { stamp_ns, status, .. }) => {
            let problem = format!("the status of stamp_ns {stamp_ns} is `{status}`; expected {VETOED} or {RESTORED}");
            Err(VetoError { path, problem })
        }
        None => Ok(rows),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_veto_is_never_deleted_and_a_foreign_file_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        add(folder.path(), (7, 5), true, "a hand, \"in\" front\n<script>").unwrap();
        add(folder.path(), (9, 6), true, "bubble").unwrap();
        let standing = add(folder.path(), (7, 5), false, "it was another one").unwrap();
        assert_eq!((standing.of(6), standing.of(7), standing.of(5)), (Some("bubble"), None, None));
        let written = rows(folder.path()).unwrap();
        assert_eq!((written.len(), written[0].comment.as_str()), (3, "a hand, \"in\" front\n<script>"));
        assert_eq!(Vetoes::beside(&folder.path().join("track.csv")).unwrap(), standing);
        std::fs::write(folder.path().join(FILE), "my,own\ntable,here\n").unwrap();
        let refused = add(folder.path(), (1, 1), true, "x").unwrap_err();
        assert!(refused.to_string().contains("expected a table"), "{refused}");
        assert_eq!(std::fs::read_to_string(folder.path().join(FILE)).unwrap(), "my,own\ntable,here\n");
    }

    #[test]
    fn none_is_lost_where_two_write_at_once() {
        let folder = tempfile::tempdir().unwrap();
        std::thread::scope(|scope| {
            for writer in 0..2 {
                let folder = folder.path();
                scope.spawn(move || {
                    for k in 0..40 {
                        add(folder, (k, k as i64 * 2 + writer), true, "bubble").unwrap();
                    }
                });
            }
        });
        assert_eq!((rows(folder.path()).unwrap().len(), Vetoes::read(folder.path()).unwrap().len()), (80, 80));
        // As some editors leave it, without an end of its last line.
        let path = folder.path().join(FILE);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.trim_end()).unwrap();
        assert_eq!(add(folder.path(), (0, 0), false, "no").unwrap().len(), 79);
    }

    #[test]
    fn a_veto_is_of_the_moment_whatever_the_number_of_its_frame_and_is_never_passed_over() {
        let folder = tempfile::tempdir().unwrap();
        add(folder.path(), (7, 500), true, "bubble").unwrap();
        add(folder.path(), (9, 600), true, "hand").unwrap();
        // Tracked again from a later moment on, the same frame is number 2.
        let standing = add(folder.path(), (2, 500), false, "no").unwrap();
        assert_eq!((standing.of(500), standing.of(600)), (None, Some("hand")));
        assert_eq!(standing.without_frame([400, 500, 600].into_iter()), None);
        let said = standing.without_frame([400, 500].into_iter()).unwrap();
        assert!(
            said.starts_with("vetoes.csv: 1 frame is vetoed that this run does not have (stamp_ns 600):"),
            "{said}"
        );
        let path = folder.path().join(FILE);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("vetoed,hand", "Veto,hand")).unwrap();
        let refused = Vetoes::read(folder.path()).unwrap_err().to_string();
        assert!(refused.contains("the status of stamp_ns 600 is `Veto`; expected vetoed or restored"), "{refused}");
    }
}
