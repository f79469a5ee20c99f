//! `catoptra completions` and `catoptra man`: shell completions and manual pages.

use super::{Cli, Exit, Failure, output};
use clap::CommandFactory as _;
use clap_complete::Shell;
use std::path::PathBuf;

/// Arguments of `catoptra completions`.
#[derive(Debug, clap::Args)]
pub(super) struct CompletionsArgs {
    /// The shell
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

/// Arguments of `catoptra man`.
#[derive(Debug, clap::Args)]
pub(super) struct ManArgs {
    /// Folder for the pages, such as ~/.local/share/man/man1; created if missing
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

pub(super) fn completions(args: &CompletionsArgs) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "catoptra", &mut script);
    output::print(&String::from_utf8_lossy(&script))
}

pub(super) fn man(args: &ManArgs) -> Result<(), Failure> {
    let folder = &args.folder;
    if folder.is_file() {
        return Err(Failure::usage(format!("{}: is a file; give a folder", folder.display())));
    }
    std::fs::create_dir_all(folder)
        .and_then(|()| clap_mangen::generate_to(Cli::command().disable_help_subcommand(true), folder))
        .map_err(|e| Failure::new(Exit::Failed, format!("cannot write manual pages to {}: {e}", folder.display())))?;
    output::print(&format!("written: {}, and a page for each command\n", folder.join("catoptra.1").display()))
}
