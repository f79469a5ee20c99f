//! Pictures in which a board was looked for: none is searched twice.

use super::Refusal;
use super::places::changed;
use crate::calibrate::board::grey::{Grey, Rows};
use crate::calibrate::board::{Board, BoardImage, find_boards};
use parking_lot::Mutex;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

/// What is kept at most.
const MAX_KEPT: usize = 400;

/// What was found in pictures: nothing is searched twice.
#[derive(Default)]
pub(super) struct Boards(Mutex<Vec<Arc<Searched>>>);

/// A picture in which the board was looked for.
pub(super) struct Searched {
    path: PathBuf,
    changed: Option<(SystemTime, u64)>,
    board: String,
    most: usize,
    pub(super) size_px: [u32; 2],
    pub(super) images: Result<Vec<BoardImage>, String>,
}

impl Boards {
    pub(super) fn search(&self, path: &Path, board: &Board, most: usize) -> Result<Arc<Searched>, Refusal> {
        let changed = changed(path);
        let words = board.to_string();
        let lock = || self.0.lock();
        let same = |s: &&Arc<Searched>| s.path == path && s.changed == changed && s.board == words && s.most == most;
        if let Some(known) = lock().iter().find(same) {
            return Ok(Arc::clone(known));
        }
        let grey = Grey::load(path, Rows::AsStored).map_err(Refusal::wrong)?;
        let images = find_boards(&grey, board, most).map_err(|error| error.to_string());
        let size_px = grey.size_px();
        let found = Arc::new(Searched { path: path.to_owned(), changed, board: words, most, size_px, images });
        let mut all = lock();
        if all.len() >= MAX_KEPT {
            all.remove(0);
        }
        all.push(Arc::clone(&found));
        Ok(found)
    }
}
