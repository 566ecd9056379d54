//! One module a command.

pub mod batch;
pub mod calibrate;
pub mod capture_calibration;
pub mod clean;
pub mod compare;
pub mod completions;
pub mod convert;
pub mod demo;
pub mod devices;
pub mod doctor;
pub mod fit;
pub mod info;
pub mod man;
pub mod merge;
pub mod mesh;
pub mod reconstruct;
pub mod recover;
pub mod report;
pub mod reproduce;
pub mod scan;
pub mod serve;
pub mod shapes;
pub mod simulate;

use anyhow::Context;
use uwscan::io::Overwrite;

use crate::{
    args::{Cli, Command},
    console::Console,
    exit::Outcome,
};

/// Does what was asked for.
///
/// # Errors
/// The command's own.
pub fn run(cli: &Cli, console: &Console) -> anyhow::Result<Outcome> {
    if let Some(threads) = cli.global.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.get());
        pool.build_global().with_context(|| format!("cannot start {threads} threads"))?;
    }
    match &cli.command {
        Command::Demo(args) => demo::run(args, console),
        Command::Calibrate(args) => calibrate::run(args, console),
        Command::CaptureCalibration(args) => capture_calibration::run(args, console),
        Command::Reconstruct(args) => reconstruct::run(args, console),
        Command::Batch(args) => batch::run(args, console),
        Command::Scan(args) => scan::run(args, console),
        Command::Serve(args) => serve::run(args, console),
        Command::Fit(args) => fit::run(args, console),
        Command::Mesh(args) => mesh::run(args, console),
        Command::Shapes(args) => shapes::run(args, console),
        Command::Clean(args) => clean::run(args, console),
        Command::Compare(args) => compare::run(args, console),
        Command::Merge(args) => merge::run(args, console),
        Command::Report(args) => report::run(args, console),
        Command::Reproduce(args) => reproduce::run(args, console),
        Command::Info(args) => info::run(args, console),
        Command::Convert(args) => convert::run(args, console),
        Command::Recover(args) => recover::run(args, console),
        Command::Simulate(args) => simulate::run(args, console),
        Command::Devices(args) => devices::run(args, console),
        Command::Doctor(args) => doctor::run(args, console),
        Command::Completions(args) => completions::run(args),
        Command::Man(args) => man::run(args),
    }
}

/// How the one output of a command is written, and what is told of it.
#[derive(Debug, clap::Args)]
struct WriteArgs {
    /// Replace the output if it exists
    #[arg(long)]
    force: bool,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

impl WriteArgs {
    /// What becomes of an output that exists.
    fn overwrite(&self) -> Overwrite {
        overwrite(self.force)
    }
}

/// What `--force` allows.
fn overwrite(force: bool) -> Overwrite {
    if force { Overwrite::Replace } else { Overwrite::Refuse }
}
