//! `uwscan recover`.

use std::path::PathBuf;

use serde::Serialize;
use uwscan::io::{atomic, recording};

use crate::{
    commands::WriteArgs,
    console::Console,
    exit::Outcome,
    output::{self, Lost},
};

/// Arguments of `recover`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recording that was cut off or damaged
    recording: PathBuf,
    /// Recording to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    written: WriteArgs,
}

#[derive(Serialize)]
struct Record {
    file: String,
    messages: u64,
    bytes: u64,
    warnings: Vec<String>,
    lost: Vec<Lost>,
}

/// Recovers, writes the recording and prints what came out.
///
/// # Errors
/// Nothing can be recovered, or it can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let overwrite = args.written.overwrite();
    atomic::check(&args.output, overwrite)?;
    let recovered = recording::recover(&args.recording, &args.output, overwrite)?;
    let outcome = console.problems(&recovered.problems);
    let file = args.output.display().to_string();
    let (messages, bytes) = (recovered.counts.messages, recovered.counts.bytes);
    if args.written.json {
        output::json(&Record {
            file,
            messages,
            bytes,
            warnings: output::warnings(&[], &recovered.problems),
            lost: output::lost(&recovered.problems),
        })?;
    } else {
        let verdict = match outcome {
            Outcome::Done => "nothing was missing or damaged",
            Outcome::WithLoss => "what is missing or damaged is told above",
        };
        output::print(format!("{file}: {messages} messages recovered, {bytes} bytes; {verdict}\n"))?;
    }
    Ok(outcome)
}
