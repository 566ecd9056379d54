//! What can be typed.

use std::{ffi::OsString, num::NonZeroUsize};

use clap::{
    Args, ColorChoice, CommandFactory, FromArgMatches, Parser, Subcommand, ValueEnum, error::ErrorKind,
};

use crate::commands::{
    batch, calibrate, capture_calibration, clean, compare, completions, convert, demo, devices, doctor, fit,
    info, man, merge, mesh, reconstruct, recover, report, reproduce, scan, serve, shapes, simulate,
};

/// Underwater laser-line scanning: calibration, exact refraction, point clouds and measurements.
///
/// Results go to standard output, progress and diagnostics to standard error. An output is there whole or not at
/// all, and an existing file is replaced only with --force.
#[derive(Debug, Parser)]
#[command(name = "uwscan", version, propagate_version = true, max_term_width = 100)]
#[command(
    after_help = "Exit codes: 0 done; 1 failed; 2 wrong usage; 3 done with loss (an input was missing or \
    unreadable, and the rest was used)."
)]
pub struct Cli {
    /// Options of every command.
    #[command(flatten)]
    pub global: Global,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// Options of every command.
#[derive(Debug, Args)]
#[command(next_help_heading = "General options")]
pub struct Global {
    /// Say more: name every lost, rejected and badly fitting image
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Say less: no progress; given twice, no warnings either
    #[arg(short, long, global = true, action = clap::ArgAction::Count, conflicts_with = "verbose")]
    pub quiet: u8,
    /// Colour the diagnostics
    #[arg(long, global = true, value_name = "WHEN", default_value = "auto")]
    pub color: Color,
    /// Work on this many threads [default: one a processor]
    #[arg(long, global = true, value_name = "N", value_parser = threads)]
    pub threads: Option<NonZeroUsize>,
}

/// More threads than any machine that this runs on has: starting thousands takes longer than the work.
const MOST_THREADS: usize = 1024;

fn threads(text: &str) -> Result<NonZeroUsize, String> {
    let number = text.parse().ok().filter(|n: &NonZeroUsize| n.get() <= MOST_THREADS);
    number.ok_or_else(|| format!("give a whole number from 1 to {MOST_THREADS}"))
}

/// When to colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Color {
    /// Where standard error is a terminal and NO_COLOR is not set
    Auto,
    /// Always
    Always,
    /// Never
    Never,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Try all of it on a simulated instrument: calibrate, scan, measure, and compare with the truth
    Demo(demo::Args),
    /// Calibrate the instrument from captures of a chessboard, in air, in water or both
    Calibrate(calibrate::Args),
    /// Capture a chessboard for a calibration: each placement is checked at once, and what is missing is said
    CaptureCalibration(capture_calibration::Args),
    /// Turn a recorded sweep into a point cloud
    Reconstruct(reconstruct::Args),
    /// Reconstruct all recordings of a folder; a second run does what is missing
    Batch(batch::Args),
    /// Drive galvanometer, laser and camera through a sweep: record it, and make points as it goes
    Scan(scan::Args),
    /// Show recordings in a browser, or a vehicle that scans when it is asked to there
    Serve(serve::Args),
    /// Fit one shape to a point cloud, robustly, with uncertainty and deviations
    Fit(fit::Args),
    /// Find spheres, planes and cylinders in a point cloud, and the distances between them
    Shapes(shapes::Args),
    /// Triangulate the surface that a sweep saw
    Mesh(mesh::Args),
    /// Take out outliers, crop, add normals, thin: a cloud made fit for what comes next
    Clean(clean::Args),
    /// Bring overlapping sweeps onto each other, and make them one cloud
    Merge(merge::Args),
    /// Say how far a cloud or mesh lies off a reference mesh, after best-fit alignment
    Compare(compare::Args),
    /// Hand over what was measured: one page with figures, plots and a view in space, and the figures as files
    Report(report::Args),
    /// Say what a file or capture folder holds, and whether it is sound
    Info(info::Args),
    /// Write a capture, cloud or calibration in another format
    Convert(convert::Args),
    /// Make a whole recording of one that was cut off or damaged, and say what is missing
    Recover(recover::Args),
    /// Make images of a scene as this instrument would see it, with the truth beside them
    Simulate(simulate::Args),
    /// Do the paper's experiments on simulated images, by its method and by ours, as one report
    Reproduce(reproduce::Args),
    /// List serial ports and cameras that are attached
    Devices(devices::Args),
    /// Say what is wrong with a vehicle's set-up, and how to mend it
    Doctor(doctor::Args),
    /// Print a shell's completion script
    Completions(completions::Args),
    /// Print the manual page (roff): uwscan man | man -l -
    Man(man::Args),
}

/// What was typed.
///
/// # Errors
/// Wrong usage, and what help and version have to say.
pub fn parse(args: impl IntoIterator<Item = OsString>) -> Result<Cli, clap::Error> {
    let args: Vec<OsString> = args.into_iter().collect();
    let matches = Cli::command().color(color_of_usage(&args)).try_get_matches_from(&args)?;
    Cli::from_arg_matches(&matches)
}

/// A usage error that only the values show, in clap's words and with its exit code.
pub fn usage_error(kind: ErrorKind, message: impl std::fmt::Display) -> anyhow::Error {
    Cli::command().error(kind, message).into()
}

/// The colour that usage errors are to have, which are told before there are parsed arguments.
fn color_of_usage(args: &[OsString]) -> ColorChoice {
    let typed = args.iter().enumerate().find_map(|(at, arg)| match arg.to_str()? {
        "--color" => args.get(at + 1)?.to_str(),
        arg => arg.strip_prefix("--color="),
    });
    match typed {
        Some("always") => ColorChoice::Always,
        Some("never") => ColorChoice::Never,
        _ => ColorChoice::Auto,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_definition_of_the_arguments_holds_together() {
        Cli::command().debug_assert();
    }
}
