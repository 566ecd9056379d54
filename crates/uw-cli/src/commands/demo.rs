//! `uwscan demo`.

use std::{fmt::Write, path::PathBuf};

use anyhow::Context;
use serde::Serialize;
use uwscan::{
    io::NewFolder,
    pipeline::demo::{BALL_BAR_MM, COVER_BAR_MM, Demo, Found, Points, demo},
};

use crate::{
    commands::overwrite,
    console::Console,
    exit::Outcome,
    output::{self, plus_minus},
    progress::Progress,
};

/// Arguments of `demo`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder to keep captures, truth, calibration, clouds, mesh and report in [default: they are removed]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Replace the output if it exists
    #[arg(long, requires = "output")]
    force: bool,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Record {
    images: usize,
    poses_used: usize,
    reprojection_rms_px: f64,
    stripe_rms_px: f64,
    instrument: Vec<FoundRecord>,
    ball: Vec<FoundRecord>,
    ball_points: PointsRecord,
    cover_points: PointsRecord,
    missed: Vec<String>,
    simulating_seconds: f64,
    working_seconds: f64,
}

#[derive(Serialize)]
struct FoundRecord {
    name: &'static str,
    value: f64,
    sigma: f64,
    truth: f64,
}

#[derive(Serialize)]
struct PointsRecord {
    compared: usize,
    astray: usize,
    median_mm: f64,
    most_mm: f64,
}

impl From<&Found> for FoundRecord {
    fn from(f: &Found) -> Self {
        Self { name: f.name, value: f.value, sigma: f.sigma, truth: f.truth }
    }
}

impl From<Points> for PointsRecord {
    fn from(p: Points) -> Self {
        Self { compared: p.compared, astray: p.astray, median_mm: p.median_mm, most_mm: p.most_mm }
    }
}

/// Runs the demo and prints what it found beside the truth.
///
/// # Errors
/// The job has no result, a figure missed its bar, or the output can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let progress = Progress::new(console);
    let made = match &args.output {
        Some(output) => {
            let folder = NewFolder::begin(output, overwrite(args.force), "calibration.toml")?;
            let made = demo(folder.path(), &progress);
            drop(progress);
            let made = made.map_err(|failure| console.failure(failure.told_by(&folder)))?;
            folder.finish()?;
            made
        }
        None => {
            let folder = tempfile::Builder::new().prefix("uwscan-demo-").tempdir();
            let folder = folder.context("cannot make a temporary folder; give one with -o DIR")?;
            let made = demo(folder.path(), &progress);
            drop(progress);
            made.map_err(|failure| console.failure(failure))?
        }
    };
    let missed = made.missed();
    if args.json {
        output::json(&record(&made, missed.clone()))?;
    } else {
        output::print(text(&made, args.output.as_deref()))?;
    }
    if missed.is_empty() {
        return Ok(Outcome::Done);
    }
    anyhow::bail!("{}", missed.join("; "))
}

fn record(made: &Demo, missed: Vec<String>) -> Record {
    Record {
        images: made.images,
        poses_used: made.poses,
        reprojection_rms_px: made.reprojection_rms_px,
        stripe_rms_px: made.stripe_rms_px,
        instrument: made.instrument.iter().map(Into::into).collect(),
        ball: made.ball.iter().map(Into::into).collect(),
        ball_points: made.ball_points.into(),
        cover_points: made.cover_points.into(),
        missed,
        simulating_seconds: made.simulating.as_secs_f64(),
        working_seconds: made.working.as_secs_f64(),
    }
}

fn text(made: &Demo, kept: Option<&std::path::Path>) -> String {
    let mut text = format!(
        "simulated an instrument that differs from its drawing, and {} images taken with it, {:.1} s\n",
        made.images,
        made.simulating.as_secs_f64()
    );
    text += &format!(
        "calibrated it from {} placements of a chessboard, scanned a ball and a cover in water, measured: {:.1} s\n",
        made.poses,
        made.working.as_secs_f64()
    );
    text += &format!("\n{:32}{:>26}{:>14}{:>12}\n", "", "found", "true", "off");
    rows(&mut text, "instrument", &made.instrument);
    let mut all = |name: &str, p: &Points| {
        // Writing to a string can't fail.
        _ = writeln!(
            text,
            "{name}: {} points, {:.4} mm off in the median, 95 % less than {:.4} mm; {} astray",
            p.compared, p.median_mm, p.most_mm, p.astray
        );
    };
    let (ball, cover) = (&made.ball_points, &made.cover_points);
    all("points of the ball", ball);
    all("points of the cover", cover);
    rows(&mut text, "ball", &made.ball);
    text += &format!(
        "residuals: {:.4} px rms of corners, {:.4} px rms of stripes\n",
        made.reprojection_rms_px, made.stripe_rms_px
    );
    text += &format!("bars: radius within {BALL_BAR_MM} mm, cover's median within {COVER_BAR_MM} mm\n");
    if let Some(kept) = kept {
        text += &format!(
            "{0}: scenes, captures with their truth, calibration.toml, ball.ply, cover.ply, cover-mesh.ply, report.html, and the instrument \
             itself: uwscan scan --config {0}/vehicle.toml\n",
            kept.display()
        );
    }
    text
}

fn rows(text: &mut String, of: &str, found: &[Found]) {
    for f in found {
        let name = format!("{of} {}", f.name);
        let value = plus_minus(f.value, Some(f.sigma));
        _ = writeln!(text, "{name:32}{value:>26}{:>14.6}{:>+12.6}", f.truth, f.value - f.truth);
    }
}
