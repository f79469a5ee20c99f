//! Errors of a command and their exit codes.

use crate::archive::transient::is_transient;
use crate::rig::RigError;
use crate::series::SeriesError;
use std::error::Error;
use std::fmt;
use std::io::{self, ErrorKind};
use std::process::ExitCode;

/// The program's exit code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Exit {
    /// It failed on the way.
    Failed,
    /// Wrong usage, or an input file that is not valid.
    Usage,
    /// The calibration or measurement did not reach a usable result.
    Unusable,
    /// The user, or the system, asked it to end.
    Interrupted,
}

impl Exit {
    /// The number with which the program ends.
    pub(crate) fn code(self) -> u8 {
        match self {
            Self::Failed => 1,
            Self::Usage => 2,
            Self::Unusable => 3,
            Self::Interrupted => 130,
        }
    }

    /// The same as a word, for programs.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Failed => "failed",
            Self::Usage => "usage",
            Self::Unusable => "unusable",
            Self::Interrupted => "interrupted",
        }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

/// Whether a path leads to nothing, or to a folder: an error of usage, not of the system.
pub(super) fn is_wrong_name(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::NotFound | ErrorKind::IsADirectory)
}

/// An error with the exit code it leads to.
#[derive(Debug)]
pub(crate) struct Failure {
    exit: Exit,
    error: Box<dyn Error + Send + Sync>,
}

impl Failure {
    pub(crate) fn new(exit: Exit, error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self { exit, error: error.into() }
    }

    /// Wrong arguments or files.
    pub(crate) fn usage(error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self::new(Exit::Usage, error)
    }

    /// With its own text, which includes `cause`: nothing is printed twice, and the cause is kept.
    pub(crate) fn because(exit: Exit, text: String, cause: impl Error + Send + Sync + 'static) -> Self {
        Self::new(exit, Reworded { text, cause: Box::new(cause) })
    }

    pub(crate) fn exit(&self) -> Exit {
        self.exit
    }

    /// Whether the same run may succeed another time.
    pub(crate) fn is_transient(&self) -> bool {
        is_transient(&*self.error)
    }

    /// The message without the leading word.
    pub(crate) fn message(&self) -> String {
        let said = self.to_string();
        said.split_once(": ").map_or("", |(_, message)| message).trim_end().to_owned()
    }
}

/// An error in other words.
#[derive(Debug, thiserror::Error)]
#[error("{text}")]
struct Reworded {
    text: String,
    #[source]
    cause: Box<dyn Error + Send + Sync>,
}

/// The error and what caused it, a line each; a cause that the line above names already is left out.
impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.exit == Exit::Interrupted { "interrupted" } else { "error" };
        let mut said = without_numbers(&self.error.to_string());
        writeln!(f, "{kind}: {said}")?;
        let mut cause = self.error.source();
        while let Some(error) = cause {
            let because = without_numbers(&error.to_string());
            if !said.contains(&because) {
                writeln!(f, "  because: {because}")?;
            }
            said = because;
            cause = error.source();
        }
        Ok(())
    }
}

/// Without the system's numbers of its errors, whose words are there.
fn without_numbers(text: &str) -> String {
    let mut parts = text.split(" (os error ");
    let mut said = parts.next().unwrap_or_default().to_owned();
    parts.for_each(|part| said += part.split_once(')').map_or("", |(_, rest)| rest));
    said
}

impl From<RigError> for Failure {
    fn from(error: RigError) -> Self {
        let exit = if matches!(error, RigError::Write { .. }) { Exit::Failed } else { Exit::Usage };
        Self::new(exit, error)
    }
}

impl From<SeriesError> for Failure {
    fn from(error: SeriesError) -> Self {
        let exit = if error.is_io() && !error.is_missing() { Exit::Failed } else { Exit::Usage };
        Self::new(exit, error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("{text}")]
    struct Layer {
        text: &'static str,
        source: std::io::Error,
    }

    #[test]
    fn a_cause_is_named_once() {
        let shown =
            |text| Failure::new(Exit::Failed, Layer { text, source: std::io::Error::other("disk full") }).to_string();
        assert_eq!(shown("cannot write a.csv: disk full"), "error: cannot write a.csv: disk full\n");
        let reworded = Failure::because(Exit::Failed, "a: disk full".to_owned(), std::io::Error::other("disk full"));
        assert_eq!(
            (reworded.to_string().as_str(), reworded.message().as_str()),
            ("error: a: disk full\n", "a: disk full")
        );
        assert_eq!(shown("cannot write a.csv"), "error: cannot write a.csv\n  because: disk full\n");
        let missing = Failure::usage("a (No such file (os error 2)), b: Permission denied (os error 13)");
        assert_eq!(missing.message(), "a (No such file), b: Permission denied");
    }
}
