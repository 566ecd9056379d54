//! `uwscan completions`.

use clap::CommandFactory;
use clap_complete::Shell;

use crate::{args::Cli, exit::Outcome, output};

/// Arguments of `completions`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Prints the script.
///
/// # Errors
/// Standard output can't be written.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    // Into memory first: the generator panics where it can't write.
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "uwscan", &mut script);
    output::print(script)?;
    Ok(Outcome::Done)
}
