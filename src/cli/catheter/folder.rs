//! The folder of a command's results: what may be replaced in it.

use super::super::output::begins_with;
use super::super::results::refuse_to_overwrite_inputs;
use super::super::{Exit, Failure};
use crate::series::{CurrentTable, play};
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// What tells a file of these commands from one of the user's.
#[derive(Debug, Clone, Copy)]
pub(super) enum Own {
    /// How it begins.
    Begins(&'static str),
    /// A table of currents of `follow`.
    Currents,
    /// The list of that table, which is beside it: lists do not say who wrote them.
    List,
}

impl Own {
    /// Whether a file is one, or empty.
    fn is(self, file: &Path) -> bool {
        match self {
            Self::Begins(text) => begins_with(file, text),
            Self::Currents => fs::read_to_string(file).is_ok_and(|text| text.is_empty() || are_own_currents(&text)),
            Self::List => {
                let table = file.with_extension("csv");
                let Ok(own) = CurrentTable::read(&table) else { return false };
                let list = play::write(own.rows.iter().map(|row| (row.time_ns, row.values_a.as_slice())));
                Self::Currents.is(&table) && fs::read_to_string(file).is_ok_and(|text| text == list)
            }
        }
    }
}

/// Whether all numbers have the digits of a table of `follow`, and the last currents are zero.
fn are_own_currents(text: &str) -> bool {
    let mut lines = text.split_terminator("\r\n");
    let headed = lines.next().is_some_and(|header| header.starts_with("t_s,") && header.split(',').count() == 4);
    let exact = |cell: &str| cell.split_once('.').is_some_and(|(_, digits)| digits.len() == 9);
    let mut last = "";
    headed
        && lines.all(|line| {
            last = line;
            line.split(',').count() == 4 && line.split(',').all(exact)
        })
        && last.split(',').skip(1).all(|cell| cell == "0.000000000")
}

/// Makes the folder; refuses one that has other files than those of this command, or something that is read. `own`: the
/// names of its files, and what they are.
pub(super) fn prepare(folder: &Path, own: &[(impl AsRef<str>, Own)], inputs: &[&Path]) -> Result<(), Failure> {
    let refused = |what: String| Failure::usage(format!("{}: {what}", folder.display()));
    let failed = |e: std::io::Error| Failure::new(Exit::Failed, format!("{}: {e}", folder.display()));
    if folder.exists() && !folder.is_dir() {
        return Err(refused("is a file; give the name of a folder".to_owned()));
    }
    let places: Vec<PathBuf> = own.iter().map(|(name, _)| folder.join(name.as_ref())).collect();
    refuse_to_overwrite_inputs(places.iter().map(PathBuf::as_path), inputs)?;
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries.collect::<Result<Vec<_>, _>>().map_err(failed)?,
        Err(e) if e.kind() == ErrorKind::NotFound => Vec::new(),
        Err(e) => return Err(failed(e)),
    };
    for entry in entries {
        let name = entry.file_name();
        if !own.iter().any(|(own, is)| name == own.as_ref() && is.is(&entry.path())) {
            return Err(refused(format!(
                "has {}, which this command did not write, or not with these options; give another folder",
                name.display()
            )));
        }
    }
    fs::create_dir_all(folder).map_err(failed)
}
