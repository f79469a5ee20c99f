//! `vetoes.csv` beside a run: frames that a person does not trust, and why.
//!
//! In: the folder of a run. Out: the frames that are vetoed now. What was measured stays as it is; a veto that is taken
//! back stays in the file, with the row that takes it back. Who reads a run leaves its vetoed frames out, and says how
//! many there were.

use crate::atomic_file;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::SystemTime;

/// The name of the file.
pub(crate) const FILE: &str = "vetoes.csv";
const HEADER: [&str; 5] = ["seq", "stamp_ns", "status", "comment", "written"];
/// The word for a frame that was vetoed.
pub(crate) const VETOED: &str = "vetoed";
const RESTORED: &str = "restored";

/// Two threads do not write at once.
static WRITING: Mutex<()> = Mutex::new(());

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

/// Frames that are vetoed now: number and stamp, and why.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Vetoes(BTreeMap<(u64, i64), String>);

impl Vetoes {
    /// Those of the run in `folder`; none when there is no file.
    ///
    /// # Errors
    /// When the file cannot be read, or is not a table of vetoes.
    pub(crate) fn read(folder: &Path) -> Result<Self, VetoError> {
        let mut standing = BTreeMap::new();
        for veto in rows(folder)? {
            let frame = (veto.seq, veto.stamp_ns);
            if veto.status == VETOED {
                standing.insert(frame, veto.comment);
            } else {
                standing.remove(&frame);
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

    /// Why this frame is vetoed, if it is. A frame of the same number of another recording is another.
    pub(crate) fn of(&self, seq: u64, stamp_ns: i64) -> Option<&str> {
        self.0.get(&(seq, stamp_ns)).map(String::as_str)
    }
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
    let _alone = WRITING.lock();
    let mut all = rows(folder)?;
    all.push(Veto {
        seq,
        stamp_ns,
        status: if vetoed { VETOED } else { RESTORED }.to_owned(),
        comment: comment.to_owned(),
        written: humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
    });
    let path = folder.join(FILE);
    let failed = |error: &dyn std::fmt::Display| VetoError {
        path: path.clone(),
        problem: format!("cannot be written: {error}"),
    };
    let mut writer =
        csv::WriterBuilder::new().has_headers(false).terminator(csv::Terminator::CRLF).from_writer(Vec::new());
    writer.write_record(HEADER).map_err(|e| failed(&e))?;
    for veto in &all {
        writer.serialize(veto).map_err(|e| failed(&e))?;
    }
    let bytes = writer.into_inner().map_err(|e| failed(&e))?;
    atomic_file::write(&path, &bytes).map_err(|e| failed(&e))?;
    Vetoes::read(folder)
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
    csv::Reader::from_reader(bytes.as_slice())
        .deserialize()
        .collect::<Result<_, _>>()
        .map_err(|e: csv::Error| foreign(&e))
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
        assert_eq!((standing.of(9, 6), standing.of(9, 7), standing.of(7, 5)), (Some("bubble"), None, None));
        let written = rows(folder.path()).unwrap();
        assert_eq!((written.len(), written[0].comment.as_str()), (3, "a hand, \"in\" front\n<script>"));
        assert_eq!(Vetoes::beside(&folder.path().join("track.csv")).unwrap(), standing);
        std::fs::write(folder.path().join(FILE), "my,own\ntable,here\n").unwrap();
        let refused = add(folder.path(), (1, 1), true, "x").unwrap_err();
        assert!(refused.to_string().contains("expected a table"), "{refused}");
        assert_eq!(std::fs::read_to_string(folder.path().join(FILE)).unwrap(), "my,own\ntable,here\n");
    }
}
