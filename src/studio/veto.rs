//! Vetoes of frames, given and taken back.

use super::desk::Desk;
use super::run::Run;
use super::{Refusal, Reply};
use crate::vetoes::{self, FILE, VetoError, Vetoes};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Longest comment, bytes.
const MAX_COMMENT_BYTES: usize = 500;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Asked {
    run: String,
    row: usize,
    /// Number of the frame that the page shows as this row.
    seq: Option<u64>,
    version: Option<String>,
    vetoed: bool,
    comment: String,
}

/// Vetoes a frame, or takes that back.
pub(super) fn veto(desk: &Desk, asked: &Asked) -> Result<Reply, Refusal> {
    let run = desk.run_as_read(&asked.run, asked.version.as_deref())?;
    let row = run.row(asked.row)?;
    if asked.seq.is_some_and(|seq| seq != row.seq) {
        return Err(Refusal::tracked_again());
    }
    let comment = asked.comment.trim();
    if comment.is_empty() || comment.len() > MAX_COMMENT_BYTES {
        let problem = format!("a comment of {} bytes: expected the reason, in 1 to {MAX_COMMENT_BYTES}", comment.len());
        return Err(Refusal::wrong(problem));
    }
    let standing = vetoes::add(run.folder(), (row.seq, row.stamp_ns), asked.vetoed, comment).map_err(refused)?;
    Ok(Reply::Json(json!({ "vetoes": of_run(&run, &standing), "file": FILE })))
}

/// Frames of a run that are vetoed now, as the page takes them: number, and why. Also what to say of vetoes that are of
/// none of its frames.
pub(super) fn standing(run: &Run) -> Result<(Value, Option<String>), Refusal> {
    let standing = Vetoes::read(run.folder()).map_err(refused)?;
    Ok((of_run(run, &standing), standing.without_frame(run.rows.iter().map(|row| row.stamp_ns))))
}

fn of_run(run: &Run, standing: &Vetoes) -> Value {
    let of_run = run.rows.iter().filter_map(|row| Some((row.seq, standing.of(row.stamp_ns)?)));
    json!(of_run.collect::<BTreeMap<_, _>>())
}

fn refused(error: VetoError) -> Refusal {
    Refusal::wrong(error)
}
