//! Fuzzes the kind of input that this program is named after (see `catoptra::fuzz`).
#![no_main]

use catoptra::fuzz::TARGETS;
use libfuzzer_sys::fuzz_target;
use std::sync::OnceLock;
use tempfile::TempDir;

fuzz_target!(|data: &[u8]| {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| tempfile::tempdir().expect("a folder for files"));
    let target = TARGETS.iter().find(|target| target.name == env!("CARGO_BIN_NAME")).expect("a target of this name");
    (target.read)(data, folder.path());
});
