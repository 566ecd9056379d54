//! `uwscan batch`.

use std::{fmt::Write, path::PathBuf, time::Instant};

use serde::Serialize;
use uwscan::{
    io::batch::{ResultRecord, Status},
    pipeline::batch::{Batch, batch},
};

use crate::{commands::reconstruct::How, console::Console, exit::Outcome, output, progress::Progress};

/// Arguments of `batch`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder with capture folders and recordings (.mcap), in its folders too
    folder: PathBuf,
    /// Calibration file of the instrument
    #[arg(short, long, value_name = "FILE")]
    calibration: PathBuf,
    /// Folder for the clouds (.ply), one a recording, and table.csv; results of an earlier run in it are kept where they follow from the same
    /// input, calibration, settings and version
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// How
    #[command(flatten)]
    how: How,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Record<'a> {
    recordings: usize,
    done: usize,
    with_loss: usize,
    failed: usize,
    skipped: usize,
    kept: usize,
    points: usize,
    table: String,
    results: &'a [ResultRecord],
    warnings: Vec<String>,
    seconds: f64,
}

/// Failures that the text names; the table has all.
const TOLD: usize = 10;

/// Makes the clouds, and prints what became of each recording.
///
/// # Errors
/// There is no recording, none of them became a cloud, or results can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let began = Instant::now();
    let settings = args.how.settings()?;
    let progress = Progress::new(console);
    let result = batch(&args.folder, &args.calibration, &args.output, settings, &progress);
    drop(progress);
    let made = result.map_err(|failure| console.failure(failure))?;
    console.problems(&made.problems);
    let count = |status: Status| made.records.iter().filter(|r| r.status == status).count();
    let record = Record {
        recordings: made.records.len(),
        done: count(Status::Done),
        with_loss: count(Status::WithLoss),
        failed: count(Status::Failed),
        skipped: count(Status::Skipped),
        kept: made.kept,
        points: made.records.iter().map(|r| r.points).sum(),
        table: made.table.display().to_string(),
        results: &made.records,
        warnings: output::warnings(&[], &made.problems),
        seconds: began.elapsed().as_secs_f64(),
    };
    if args.json {
        output::json(&record)?;
    } else {
        output::print(text(args, &made, &record))?;
    }
    match (record.done + record.with_loss, record.failed, record.with_loss) {
        (0, 1.., _) => {
            Err(anyhow::anyhow!("{}: none of its recordings became a cloud", args.folder.display()))
        }
        (_, 0, 0) => Ok(Outcome::Done),
        _ => Ok(Outcome::WithLoss),
    }
}

fn text(args: &Args, made: &Batch, record: &Record<'_>) -> String {
    let mut text = format!(
        "{}: {} points from {} of {} recordings, {} kept from before, {:.1} s\n",
        args.output.display(),
        record.points,
        record.done + record.with_loss,
        record.recordings,
        record.kept,
        record.seconds
    );
    for (status, count) in [
        (Status::Failed, record.failed),
        (Status::WithLoss, record.with_loss),
        (Status::Skipped, record.skipped),
    ] {
        if count > 0 {
            _ = writeln!(text, "{}: {count}", status.name());
        }
        for r in made.records.iter().filter(|r| r.status == status).take(TOLD) {
            _ = writeln!(text, "  {}: {}", r.recording, r.message);
        }
    }
    _ = writeln!(text, "table: {}", record.table);
    text
}
