//! `uwscan simulate`.

use std::{path::PathBuf, time::Instant};

use serde::Serialize;
use uwscan::pipeline::simulate::{Simulated, simulate};

use crate::{commands::WriteArgs, console::Console, exit::Outcome, output, progress::Progress};

/// Arguments of `simulate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scene file
    scene: PathBuf,
    /// Capture folder to write, or a recording where the name ends in .mcap
    #[arg(short, long, value_name = "DIR|FILE.mcap")]
    output: PathBuf,
    #[command(flatten)]
    written: WriteArgs,
}

#[derive(Serialize)]
struct Record {
    frames: usize,
    stripe_points: usize,
    truth: String,
    warnings: Vec<String>,
    seconds: f64,
}

/// Simulates, writes the capture and its truth, and prints what there is.
///
/// # Errors
/// The scene can't be read or simulated, or the output can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let began = Instant::now();
    let progress = Progress::new(console);
    let result = simulate(&args.scene, None, &args.output, args.written.overwrite(), &progress);
    drop(progress);
    let Simulated { frames, stripe_points, truth, problems } =
        result.map_err(|failure| console.failure(failure))?;
    let outcome = console.problems(&problems);
    let seconds = began.elapsed().as_secs_f64();
    let truth = truth.display().to_string();
    if args.written.json {
        let warnings = output::warnings(&[], &problems);
        output::json(&Record { frames, stripe_points, truth, warnings, seconds })?;
    } else {
        output::print(format!(
            "{}: {frames} images, {seconds:.1} s\ntruth: {truth}, {stripe_points} exact stripe centres\n",
            args.output.display()
        ))?;
    }
    Ok(outcome)
}
