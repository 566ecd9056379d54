//! `uwscan calibrate`.

use std::{path::PathBuf, time::Instant};

use clap::ValueEnum;
use serde::Serialize;
use uwscan::{
    calib::Method,
    io::{atomic, calibration_toml},
    pipeline::{
        calibrate::{Calibrated, Settings, calibrate},
        report,
    },
};

use crate::{
    commands::overwrite,
    console::Console,
    exit::Outcome,
    figures::{Figures, Remains, figures_text, method_name, remains_text},
    now::now,
    output::{self, Lost},
    progress::Progress,
};

/// Arguments of `calibrate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Capture folders or recordings (.mcap) of a chessboard, in air, in water or both
    #[arg(required = true, value_name = "CAPTURE")]
    captures: Vec<PathBuf>,
    /// Rig file in place of the captures' own
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// How to calibrate
    #[arg(long, default_value = "joint")]
    method: MethodArg,
    /// Calibration file to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Page to write besides (.html): residuals, coverage, placements, correlations, rejected images, advice; figures beside it as .json and .csv
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Replace the outputs if they exist
    #[arg(long)]
    force: bool,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum MethodArg {
    /// One adjustment of everything together, with exact refraction
    Joint,
    /// The paper's steps one after the other, on land, windows neglected: for comparison
    Paper,
}

#[derive(Serialize)]
struct Record<'a> {
    method: &'static str,
    #[serde(flatten)]
    remains: Remains<'a>,
    #[serde(flatten)]
    values: Figures,
    sigmas: Option<Figures>,
    warnings: Vec<String>,
    lost: Vec<Lost>,
    seconds: f64,
}

/// Calibrates, writes the file and prints what came out.
///
/// # Errors
/// No calibration, or it can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let began = Instant::now();
    let overwrite = overwrite(args.force);
    atomic::check(&args.output, overwrite)?;
    if let Some(page) = &args.report {
        report::check(page, &[], overwrite)?;
    }
    let method = match args.method {
        MethodArg::Joint => Method::Joint,
        MethodArg::Paper => Method::Paper,
    };
    let settings = Settings { rig: args.rig.clone(), method };
    let progress = Progress::new(console);
    let result = calibrate(&args.captures, &settings, &progress);
    drop(progress);
    let calibrated = result.map_err(|failure| console.failure(failure))?;
    let outcome = console.problems(&calibrated.problems);
    calibrated.file.calibration.warnings.iter().for_each(|warning| console.warn(warning));
    calibration_toml::write(&args.output, overwrite, &calibrated.file)?;
    if let Some(page) = &args.report {
        report::write_calibration_report(&calibrated, now(), page, overwrite)?;
    }
    let seconds = began.elapsed().as_secs_f64();

    let calibration = &calibrated.file.calibration;
    if args.json {
        let quantities = calibration.quantities();
        output::json(&Record {
            method: method_name(calibration.method),
            remains: Remains::new(&calibration.statistics),
            values: Figures::values(&quantities),
            sigmas: Figures::sigmas(calibration, &quantities),
            warnings: output::warnings(&calibration.warnings, &calibrated.problems),
            lost: output::lost(&calibrated.problems),
            seconds,
        })?;
    } else {
        output::print(text(args, &calibrated, seconds, console.verbose()))?;
    }
    Ok(outcome)
}

fn text(args: &Args, calibrated: &Calibrated, seconds: f64, all: bool) -> String {
    let calibration = &calibrated.file.calibration;
    let s = &calibration.statistics;
    format!(
        "{}: calibrated by the {} method from {} board poses in {} images, {seconds:.1} s\n{}{}",
        args.output.display(),
        method_name(calibration.method),
        s.poses_used,
        s.frames_used,
        remains_text(s, all),
        figures_text(calibration, &calibration.quantities()),
    )
}
