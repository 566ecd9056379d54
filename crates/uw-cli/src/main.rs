//! The `uwscan` command: arguments, progress, exit codes, text and JSON. What it does is done by the library.

mod args;
mod cloud_file;
mod commands;
mod console;
mod exit;
mod figures;
mod listening;
mod now;
mod output;
mod progress;
mod records;
mod shared_part;
mod signals;
mod text;

use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = match args::parse(std::env::args_os()) {
        Ok(cli) => cli,
        // Help and version come this way, too; clap knows each one's stream and code.
        Err(e) => e.exit(),
    };
    let console = console::Console::new(&cli.global);
    exit::code(commands::run(&cli, &console), &console)
}
