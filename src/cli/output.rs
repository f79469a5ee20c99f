//! Results on stdout and in single files.

use super::results::RUN;
use super::{Exit, Failure, writing};
use crate::atomic_file;
use std::fs::File;
use std::io::{ErrorKind, Read as _, Write as _};
use std::path::Path;

/// Writes a whole result. A reader that stops early (`| head`) is not an error.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::new(Exit::Failed, format!("cannot write to stdout: {e}")))
        }
        _ => Ok(()),
    }
}

/// Refuses to overwrite a file whose text is not `kind`, or to write where there is no folder.
pub(super) fn is_free(path: &Path, is_kind: impl Fn(&str) -> bool, kind: &str) -> Result<(), Failure> {
    let refused = |what: String| Err(Failure::usage(format!("{}: {what}", path.display())));
    let folder = path.parent().filter(|folder| *folder != Path::new(""));
    if folder.is_some_and(|folder| !folder.is_dir()) {
        return refused("there is no such folder to write to".to_owned());
    }
    if path.is_dir() {
        return refused("is a folder; give the name of a file".to_owned());
    }
    let same = |text: String| text.is_empty() || is_kind(&text);
    if path.is_file() && !std::fs::read_to_string(path).is_ok_and(same) {
        return refused(format!("exists and is not {kind}; choose another name"));
    }
    Ok(())
}

/// Whether a file begins so, or is empty.
pub(super) fn begins_with(file: &Path, text: &str) -> bool {
    let mut beginning = Vec::new();
    let read = File::open(file).and_then(|file| file.take(text.len() as u64).read_to_end(&mut beginning));
    read.is_ok() && (beginning.is_empty() || beginning == text.as_bytes())
}

/// The name of a report in a folder of results.
pub(super) const REPORT: &str = "report.html";

/// How each page of this program begins.
pub(super) const PAGE: &str = "<!doctype html>";

/// The same for a page of this program. The report in the folder of a run belongs to it.
pub(super) fn is_free_for_page(path: &Path) -> Result<(), Failure> {
    let is_report = path.file_name().is_some_and(|name| name == REPORT);
    if is_report && path.exists() && path.with_file_name(RUN).exists() {
        let text = format!("{}: is the report of the run in its folder; choose another name", path.display());
        return Err(Failure::usage(text));
    }
    is_free(path, |text| text.starts_with(PAGE), "a page")
}

/// Writes a file in one step; an interrupt waits for it.
pub(super) fn save(path: &Path, text: &(impl AsRef<[u8]> + ?Sized)) -> Result<(), Failure> {
    let _whole = writing::wait();
    atomic_file::write(path, text.as_ref())
        .map_err(|e| Failure::because(Exit::Failed, format!("{}: cannot be written: {e}", path.display()), e))
}
