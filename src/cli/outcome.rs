//! `--json`: the outcome of a command, as one JSON object on stdout instead of the text.
//!
//! | member | is |
//! |---|---|
//! | `schema` | version of the format, 1 |
//! | `command` | the command, for example `calibrate rig` |
//! | `outcome` | `good`, `failed`, `usage`, `unusable`, `interrupted`, matching the exit code |
//! | `exit_code` | the same as a number |
//! | `error` | what went wrong, or null |
//! | `warnings` | warnings, the first hundred; all are on stderr |
//! | `more_warnings` | how many more there were |
//! | `written` | files that were written |
//! | `results` | what the command found, or null |
//! | `text` | the text printed without `--json` |
//!
//! A command line that cannot be parsed has no outcome: it ends with exit code 2 and text on stderr.

use super::warned::{Warnings, Work};
use super::{Exit, Failure, output};
use parking_lot::Mutex;
use serde_json::{Value, json};
use std::error::Error;
use std::path::Path;
use std::sync::Arc;

const SCHEMA: u32 = 1;

/// Files that this process has written, for its one outcome.
static WRITTEN: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// The command whose outcome is still to be printed, and its warnings.
static RUNNING: Mutex<Option<(String, Arc<Work>)>> = Mutex::new(None);

/// The option.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub(crate) struct Json {
    /// Print one outcome for programs, as JSON
    #[arg(long)]
    json: bool,
}

/// The option, where helps have no line left for it: their text names it.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub(crate) struct HiddenJson {
    /// Print one outcome for programs, as JSON
    #[arg(long, global = true, hide = true)]
    json: bool,
}

impl From<HiddenJson> for Json {
    fn from(hidden: HiddenJson) -> Self {
        Self { json: hidden.json }
    }
}

/// The outcome of a command while it runs.
pub(super) struct Outcome {
    json: bool,
    quiet: bool,
    text: Mutex<String>,
    results: Mutex<Value>,
}

impl Outcome {
    /// Prints part of the text, or keeps it for later.
    pub(super) fn print(&self, text: &str) -> Result<(), Failure> {
        if self.json {
            self.text.lock().push_str(text);
            return Ok(());
        }
        if self.quiet { Ok(()) } else { output::print(text) }
    }

    /// Sets the results; `results` is called only if they are needed.
    ///
    /// # Errors
    /// When there are none, although they are needed.
    pub(super) fn found(&self, results: impl FnOnce() -> Result<Value, Failure>) -> Result<(), Failure> {
        if self.json {
            *self.results.lock() = results()?;
        }
        Ok(())
    }

    /// Sets the results to what a file that was written has; it is read again only if they are needed.
    ///
    /// # Errors
    /// When they are needed and the file cannot be read.
    pub(super) fn found_in(
        &self,
        file: &Path,
        parse: impl FnOnce(&str) -> Result<Value, Box<dyn Error>>,
    ) -> Result<(), Failure> {
        let read = || parse(&std::fs::read_to_string(file)?);
        let cannot = |why| Failure::new(Exit::Failed, format!("{}: cannot be read again: {why}", file.display()));
        self.found(|| read().map_err(cannot))
    }
}

/// Notes that a file was written.
pub(super) fn wrote(path: &Path) {
    WRITTEN.lock().push(path.display().to_string());
}

/// Does the work of `command`, and reports its outcome in the requested form.
pub(super) fn of(
    command: &str,
    json: Json,
    quiet: bool,
    run: impl FnOnce(&Outcome) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let outcome = Outcome { json: json.json, quiet, text: Mutex::default(), results: Mutex::default() };
    let work = Arc::new(Work::new());
    if outcome.json {
        *RUNNING.lock() = Some((command.to_owned(), Arc::clone(&work)));
    }
    let ended = work.within(|| run(&outcome));
    let results = std::mem::take(&mut *outcome.results.lock());
    let text = std::mem::take(&mut *outcome.text.lock());
    print_once(ended.as_ref().map_err(|failure| (failure.exit(), failure.message())).copied(), results, text)?;
    ended
}

/// The command is interrupted and ends at once: prints its outcome, if that is wanted and still to come.
pub(super) fn interrupted() {
    // Without stdout nothing can be printed; the command ends anyway.
    let _ = print_once(Err((Exit::Interrupted, "interrupted".to_owned())), Value::Null, String::new());
}

/// Prints the outcome of the running command, unless that was done.
fn print_once(ended: Result<(), (Exit, String)>, results: Value, text: String) -> Result<(), Failure> {
    let mut running = RUNNING.lock();
    let Some((command, work)) = running.take() else { return Ok(()) };
    let (word, code) = ended.as_ref().map_or_else(|(exit, _)| (exit.word(), exit.code()), |()| ("good", 0));
    let Warnings { warnings, more } = work.warned();
    let whole = json!({
        "schema": SCHEMA,
        "command": command,
        "outcome": word,
        "exit_code": code,
        "error": ended.err().map(|(_, message)| message),
        "warnings": warnings,
        "more_warnings": more,
        "written": std::mem::take(&mut *WRITTEN.lock()),
        "results": results,
        "text": text,
    });
    output::print(&format!("{whole:#}\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_that_are_needed_and_missing_are_a_failure() {
        let outcome = |json| Outcome { json, quiet: true, text: Mutex::default(), results: Mutex::default() };
        let missing =
            |json| outcome(json).found_in(Path::new("missing/model.json"), |text| Ok(serde_json::from_str(text)?));
        let failure = missing(true).unwrap_err();
        assert_eq!(failure.exit(), Exit::Failed);
        assert!(failure.message().starts_with("missing/model.json: cannot be read again: "), "{failure:?}");
        assert!(missing(false).is_ok());
        let good = outcome(true);
        good.found(|| Ok(json!(7))).unwrap();
        assert_eq!(*good.results.lock(), 7);
    }
}
