//! `uwscan reconstruct`.

use std::{collections::BTreeMap, fmt::Write, path::PathBuf, time::Instant};

use clap::{ValueEnum, error::ErrorKind};
use serde::Serialize;
use uwscan::{
    cloud::Frame,
    io::{Medium, atomic, calibration_toml, clouds},
    pipeline::reconstruct::{Reconstructed, Refraction, Settings, WaterIndex, reconstruct},
    stripe::Method,
};

use crate::{
    args::usage_error,
    cloud_file::CloudFile,
    commands::WriteArgs,
    console::Console,
    exit::Outcome,
    output::{self, Lost},
    progress::Progress,
};

/// Arguments of `reconstruct`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Capture folder or recording (.mcap) of a scan
    capture: PathBuf,
    /// Calibration file of the instrument
    #[arg(short, long, value_name = "FILE")]
    calibration: PathBuf,
    /// Cloud to write: .ply, .pcd, .e57, .las, .laz (binary), .xyz or .csv (text)
    #[arg(short, long, value_name = "FILE", value_parser = CloudFile::parser())]
    output: CloudFile,
    /// How
    #[command(flatten)]
    how: How,
    /// Write a PLY or PCD as text rather than binary
    #[arg(long)]
    ascii: bool,
    #[command(flatten)]
    written: WriteArgs,
}

/// How to reconstruct: the arguments that `reconstruct` and `batch` share.
#[derive(Debug, clap::Args)]
pub struct How {
    /// How a stripe's centre is estimated
    #[arg(long, value_name = "METHOD", default_value = Settings::default().stripe.name())]
    stripe: StripeArg,
    /// How light is traced
    #[arg(long, default_value = "exact")]
    refraction: RefractionArg,
    /// Frame of the points
    #[arg(long, default_value = "camera")]
    frame: FrameArg,
    /// What was outside the windows [default: what the capture says]
    #[arg(long)]
    medium: Option<MediumArg>,
    /// Index of the water at the laser's wavelength, relative to air
    #[arg(long, value_name = "N", value_parser = index, conflicts_with_all = ["temperature", "salinity", "depth"])]
    water_index: Option<f64>,
    /// Temperature of the water, °C
    #[arg(long, value_name = "C", value_parser = temperature, requires_all = ["salinity", "depth"])]
    #[arg(allow_negative_numbers = true)]
    temperature: Option<f64>,
    /// Practical salinity of the water, psu
    #[arg(long, value_name = "PSU", value_parser = salinity, requires_all = ["temperature", "depth"])]
    salinity: Option<f64>,
    /// Depth below the surface, m
    #[arg(long, value_name = "M", value_parser = depth, requires_all = ["temperature", "salinity"])]
    depth: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum StripeArg {
    /// Matched filters at each line's strongest candidate, for speed in clear water
    Fast,
    /// The same at two candidates, neighbours deciding, and likelihood where filters do not suit, or an image with the laser off is subtracted
    Robust,
    /// Maximum likelihood of every line, noise and width from each image by itself
    Precise,
    /// Steger's ridge detector, pooled along the stripe
    Ridge,
    /// Centre of gravity, for comparison
    Cog,
    /// Blais and Rioux's filter, for comparison
    BlaisRioux,
}

impl StripeArg {
    fn method(self) -> Method {
        match self {
            Self::Fast => Method::Fast,
            Self::Robust => Method::Robust,
            Self::Precise => Method::Precise,
            Self::Ridge => Method::Ridge,
            Self::Cog => Method::Cog,
            Self::BlaisRioux => Method::BlaisRioux,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RefractionArg {
    /// Exactly, through both windows
    Exact,
    /// By the paper's approximations
    Paper,
    /// Straight, as if there were neither windows nor water
    None,
}

impl RefractionArg {
    fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Paper => "paper",
            Self::None => "none",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FrameArg {
    /// The camera's: x right, y down, z forward
    Camera,
    /// The galvanometer's: x along its axis, z in the laser plane of the reference voltage
    Galvo,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum MediumArg {
    /// On land
    Air,
    /// Submerged
    Water,
}

/// A number from `low` to `high`, in a unit.
fn number(text: &str, low: f64, high: f64, unit: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (low..=high).contains(&value) => Ok(value),
        Ok(_) => Err(format!("give a number from {low} to {high}{unit}")),
        Err(e) => Err(e.to_string()),
    }
}

fn index(text: &str) -> Result<f64, String> {
    number(text, 1.0, 2.0, "")
}

fn temperature(text: &str) -> Result<f64, String> {
    number(text, -5.0, 60.0, " °C")
}

fn salinity(text: &str) -> Result<f64, String> {
    number(text, 0.0, 100.0, " psu")
}

fn depth(text: &str) -> Result<f64, String> {
    number(text, 0.0, 12_000.0, " m")
}

#[derive(Serialize)]
struct Record<'a> {
    points: usize,
    frames: usize,
    rejected: &'a BTreeMap<&'static str, usize>,
    frame: &'static str,
    stripe: &'static str,
    refraction: &'static str,
    index: f64,
    warnings: Vec<String>,
    lost: Vec<Lost>,
    seconds: f64,
    points_per_second: f64,
    thread_seconds: ThreadSeconds,
}

/// Time in each stage, summed over the threads.
#[derive(Serialize)]
struct ThreadSeconds {
    decode: f64,
    extract: f64,
    triangulate: f64,
    write: f64,
}

/// Reconstructs, writes the cloud and prints what came out.
///
/// # Errors
/// No cloud, or it can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let began = Instant::now();
    let settings = args.how.settings()?;
    let overwrite = args.written.overwrite();
    atomic::check(&args.output.path, overwrite)?;
    let (calibration, mut problems) = calibration_toml::read(&args.calibration)?;
    console.problems(&problems);
    let progress = Progress::new(console);
    let result = reconstruct(&args.capture, &calibration, &settings, &progress);
    drop(progress);
    let mut made = result.map_err(|failure| console.failure(failure))?;
    let outcome = console.problems(&made.problems);
    made.warnings.iter().for_each(|warning| console.warn(warning));
    problems.append(&mut made.problems);
    let written = Instant::now();
    let format = args.output.written_as(args.ascii);
    clouds::write(&args.output.path, overwrite, &made.cloud, format)?;
    let (seconds, write) = (began.elapsed().as_secs_f64(), written.elapsed().as_secs_f64());

    let record = Record {
        points: made.cloud.len(),
        frames: made.frames,
        rejected: &made.rejected,
        frame: made.cloud.frame().name(),
        stripe: args.how.stripe.method().name(),
        refraction: args.how.refraction.name(),
        index: made.index,
        warnings: output::warnings(&made.warnings, &problems),
        lost: output::lost(&problems),
        seconds,
        points_per_second: made.cloud.len() as f64 / seconds.max(f64::MIN_POSITIVE),
        thread_seconds: ThreadSeconds {
            decode: made.spent.decode.as_secs_f64(),
            extract: made.spent.extract.as_secs_f64(),
            triangulate: made.spent.triangulate.as_secs_f64(),
            write,
        },
    };
    if args.written.json {
        output::json(&record)?;
    } else {
        output::print(text(args, &made, &record))?;
    }
    Ok(outcome)
}

impl How {
    /// The settings that were asked for.
    ///
    /// # Errors
    /// Arguments that don't go together.
    pub fn settings(&self) -> anyhow::Result<Settings> {
        let water = match (self.water_index, self.temperature, self.salinity, self.depth) {
            (Some(index), ..) => WaterIndex::Given(index),
            (None, Some(temperature_c), Some(salinity_psu), Some(depth_m)) => {
                WaterIndex::Properties { temperature_c, salinity_psu, depth_m }
            }
            _ => WaterIndex::Calibrated,
        };
        if self.medium == Some(MediumArg::Air) && water != WaterIndex::Calibrated {
            let message =
                "--medium air leaves no water for --water-index, --temperature, --salinity and --depth";
            return Err(usage_error(ErrorKind::ArgumentConflict, message));
        }
        Ok(Settings {
            stripe: self.stripe.method(),
            refraction: match self.refraction {
                RefractionArg::Exact => Refraction::Exact,
                RefractionArg::Paper => Refraction::Paper,
                RefractionArg::None => Refraction::None,
            },
            frame: match self.frame {
                FrameArg::Camera => Frame::Camera,
                FrameArg::Galvo => Frame::Galvo,
            },
            medium: self.medium.map(|medium| match medium {
                MediumArg::Air => Medium::Air,
                MediumArg::Water => Medium::Water,
            }),
            water,
        })
    }
}

fn text(args: &Args, made: &Reconstructed, record: &Record<'_>) -> String {
    let mut text = format!(
        "{}: {} points from {} images, {} frame, {:.1} s ({:.0} points per second)\n\
         stripes: {}\n\
         refraction: {}, index {:.5} outside the windows\n",
        args.output.path.display(),
        record.points,
        record.frames,
        record.frame,
        record.seconds,
        record.points_per_second,
        record.stripe,
        record.refraction,
        record.index,
    );
    if let Some((low, high)) = made.cloud.bounding_box_mm() {
        let size: Vec<String> = std::iter::zip(low, high).map(|(l, h)| format!("{l:.1} to {h:.1}")).collect();
        _ = writeln!(text, "extent: {} mm", size.join(", "));
    }
    let rejects = record.rejected.iter().filter(|(_, count)| **count > 0);
    let rejects: Vec<String> = rejects.map(|(reason, count)| format!("  {count:>8}  {reason}\n")).collect();
    if !rejects.is_empty() {
        text += "rows or columns without a point, by reason\n";
        text += &rejects.concat();
    }
    text
}
