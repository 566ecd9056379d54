//! `uwscan reproduce`.

use std::{path::PathBuf, time::Instant};

use anyhow::Context;
use uwscan::{
    io::NewFolder,
    pipeline::reproduce::{Record, Reproduced, Settings, Summary, reproduce},
};

use crate::{commands::overwrite, console::Console, exit::Outcome, now::now, output, progress::Progress};

/// Arguments of `reproduce`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder to write report.html, report.json and report.csv into
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Draws the instrument and all noise
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
    /// Keep the simulated captures, too, in the folder's captures/ (some hundred megabytes)
    #[arg(long)]
    keep_captures: bool,
    /// Replace the output if it exists
    #[arg(long)]
    force: bool,
    /// Print one JSON object instead of text: what the JSON file holds
    #[arg(long)]
    json: bool,
}

const PAGE: &str = "report.html";

/// Simulates and measures, writes the page, and says how far either method is off.
///
/// # Errors
/// A method has no result, or the output can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let began = Instant::now();
    let folder = NewFolder::begin(&args.output, overwrite(args.force), PAGE)?;
    let settings = Settings { seed: args.seed, made: now() };
    let progress = Progress::new(console);
    let made = if args.keep_captures {
        let captures = folder.path().join("captures");
        std::fs::create_dir(&captures).context("cannot make a folder for the captures")?;
        reproduce(&captures, &settings, &progress)
    } else {
        let captures = tempfile::Builder::new().prefix("uwscan-reproduce-").tempdir();
        let captures = captures.context("cannot make a temporary folder; give --keep-captures")?;
        reproduce(captures.path(), &settings, &progress)
    };
    drop(progress);
    let made: Reproduced = made.map_err(|failure| console.failure(failure.told_by(&folder)))?;
    made.record.warnings.iter().for_each(|warning| console.warn(warning));
    let page = folder.path().join(PAGE);
    made.write(&page, overwrite(false)).map_err(|error| error.told_by(&folder))?;
    folder.finish()?;
    if args.json {
        output::json(&made.record)?;
    } else {
        output::print(text(args, &made.record, began.elapsed().as_secs_f64()))?;
    }
    Ok(Outcome::Done)
}

fn text(args: &Args, record: &Record, seconds: f64) -> String {
    let Record { summary, images, cover, .. } = record;
    let mut text = format!(
        "{}: report.html, report.json, report.csv; {images} images simulated and measured both ways, {seconds:.0} s\n\n\
         largest errors, mm                       paper's method        ours\n",
        args.output.display()
    );
    let mut row = |name: &str, of: fn(&Summary) -> f64| {
        text += &format!("{name:<40}{:>15.3}{:>12.3}\n", of(&summary.paper), of(&summary.ours));
    };
    row("radius of the ball, highest", |s| s.ball_radius_mm[1]);
    row("radius of the ball, lowest", |s| s.ball_radius_mm[0]);
    row("distances between the ball's positions", |s| s.ball_places_mm);
    row("radii of the three balls", |s| s.three_radius_mm);
    row("distances between the three balls", |s| s.three_distance_mm);
    text += &format!("cover: {} points (the paper's: {})\n", cover.points, cover.published_points);
    text
}
