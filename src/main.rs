//! The command `catoptra`: arguments in, exit code out.

fn main() -> std::process::ExitCode {
    catoptra::cli::run()
}
