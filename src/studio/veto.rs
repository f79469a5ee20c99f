//! `vetoes.csv` beside a run: frames that a person does not trust, and why. What was measured stays as it is; a veto
//! that is taken back stays in the file, with the row that takes it back.

use super::desk::Desk;
use super::{Refusal, Reply};
use crate::whole_file;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use std::time::SystemTime;

const FILE: &str = "vetoes.csv";
const HEADER: [&str; 5] = ["seq", "stamp_ns", "status", "comment", "written"];
/// A comment is shorter, bytes.
const LONGEST: usize = 500;
const VETOED: &str = "vetoed";
const RESTORED: &str = "restored";

/// Two pages do not write at once.
static WRITING: Mutex<()> = Mutex::new(());

/// A row of the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Veto {
    seq: u64,
    stamp_ns: i64,
    /// `vetoed` or `restored`.
    status: String,
    comment: String,
    /// When, by the clock on the wall, UTC.
    written: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Asked {
    run: String,
    row: usize,
    vetoed: bool,
    comment: String,
}

/// Vetoes a frame, or takes that back.
pub(super) fn veto(desk: &Desk, asked: &Asked) -> Result<Reply, Refusal> {
    let run = desk.run(&asked.run)?;
    let beyond = || Refusal::wrong(format!("row {}: the run has {}", asked.row, run.rows.len()));
    let row = run.rows.get(asked.row).ok_or_else(beyond)?;
    let comment = asked.comment.trim();
    if comment.is_empty() || comment.len() > LONGEST {
        let problem = format!("a comment of {} bytes: expected the reason, in 1 to {LONGEST}", comment.len());
        return Err(Refusal::wrong(problem));
    }
    let veto = Veto {
        seq: row.seq,
        stamp_ns: row.stamp_ns,
        status: if asked.vetoed { VETOED } else { RESTORED }.to_owned(),
        comment: comment.to_owned(),
        written: humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
    };
    add(run.folder(), veto)?;
    Ok(Reply::Json(json!({ "vetoes": standing(run.folder())?, "file": FILE })))
}

fn add(folder: &Path, veto: Veto) -> Result<(), Refusal> {
    let _alone = WRITING.lock();
    let mut all = read(folder)?;
    all.push(veto);
    let path = folder.join(FILE);
    let failed = |error: &dyn std::fmt::Display| Refusal {
        status: 500,
        words: format!("{}: cannot be written: {error}", path.display()),
    };
    let mut writer =
        csv::WriterBuilder::new().has_headers(false).terminator(csv::Terminator::CRLF).from_writer(Vec::new());
    writer.write_record(HEADER).map_err(|e| failed(&e))?;
    for veto in &all {
        writer.serialize(veto).map_err(|e| failed(&e))?;
    }
    let bytes = writer.into_inner().map_err(|e| failed(&e))?;
    whole_file::write(&path, &bytes).map_err(|e| failed(&e))
}

/// All rows of the file, oldest first; none when there is no file.
fn read(folder: &Path) -> Result<Vec<Veto>, Refusal> {
    let path = folder.join(FILE);
    let foreign = |what: &dyn std::fmt::Display| {
        let header = HEADER.join(",");
        Refusal::wrong(format!("{}: {what}; expected a table with the header {header}", path.display()))
    };
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(foreign(&error)),
    };
    csv::Reader::from_reader(bytes.as_slice())
        .deserialize()
        .collect::<Result<_, _>>()
        .map_err(|e: csv::Error| foreign(&e))
}

/// Frames that are vetoed now: number, and why.
pub(super) fn standing(folder: &Path) -> Result<BTreeMap<u64, String>, Refusal> {
    let mut standing = BTreeMap::new();
    for veto in read(folder)? {
        match veto.status.as_str() {
            VETOED => standing.insert(veto.seq, veto.comment),
            _ => standing.remove(&veto.seq),
        };
    }
    Ok(standing)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_veto_is_never_deleted_and_a_foreign_file_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let veto = |seq: u64, status: &str, comment: &str| Veto {
            seq,
            stamp_ns: 5,
            status: status.to_owned(),
            comment: comment.to_owned(),
            written: "2026-01-01T00:00:00Z".to_owned(),
        };
        add(folder.path(), veto(7, VETOED, "a hand, \"in\" front\n<script>")).unwrap();
        add(folder.path(), veto(9, VETOED, "bubble")).unwrap();
        add(folder.path(), veto(7, RESTORED, "it was another one")).unwrap();
        assert_eq!(standing(folder.path()).unwrap(), BTreeMap::from([(9, "bubble".to_owned())]));
        let rows = read(folder.path()).unwrap();
        assert_eq!((rows.len(), rows[0].comment.as_str()), (3, "a hand, \"in\" front\n<script>"));
        std::fs::write(folder.path().join(FILE), "my,own\ntable,here\n").unwrap();
        assert!(add(folder.path(), veto(1, VETOED, "x")).unwrap_err().words.contains("expected a table"));
        assert_eq!(std::fs::read_to_string(folder.path().join(FILE)).unwrap(), "my,own\ntable,here\n");
    }
}
