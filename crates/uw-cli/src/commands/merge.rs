//! `uwscan merge`.

use std::time::Instant;

use anyhow::anyhow;
use clap::error::ErrorKind;
use serde::Serialize;
use uwscan::{
    cloud::{MergeError, MergeOptions, Merged, PointCloud, averaged, merge},
    io::{Problem, atomic, clouds},
};

use crate::{
    args::usage_error,
    cloud_file::CloudFile,
    commands::{WriteArgs, compare::rows},
    console::Console,
    exit::Outcome,
    output::{self, Lost},
    text::{length, share},
};

/// Arguments of `merge`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Point clouds, each of one sweep, that overlap; the result is in the frame of the first
    #[arg(required = true, num_args = 2.., value_parser = CloudFile::parser())]
    clouds: Vec<CloudFile>,
    /// Cloud to write
    #[arg(short, long, value_name = "FILE", value_parser = CloudFile::parser())]
    output: CloudFile,
    /// The clouds' coordinates agree already to within this distance: look no farther [default: look anywhere]
    #[arg(long, value_name = "MM", value_parser = length)]
    near: Option<f64>,
    /// Share of a cloud's points that must lie on the surface of another one
    #[arg(long, value_name = "SHARE", default_value = "0.2", value_parser = share)]
    overlap: f64,
    /// Make the points in each cube of this size one, at their mean [default: keep all points, where clouds overlap, too]
    #[arg(long, value_name = "MM", value_parser = length)]
    average: Option<f64>,
    /// Write a PLY or PCD as text rather than binary
    #[arg(long)]
    ascii: bool,
    #[command(flatten)]
    written: WriteArgs,
}

#[derive(Serialize)]
struct Record {
    points: usize,
    frame: &'static str,
    clouds: Vec<Placed>,
    pairs: Vec<Pair>,
    warnings: Vec<String>,
    lost: Vec<Lost>,
    seconds: f64,
}

#[derive(Serialize)]
struct Placed {
    file: String,
    points: usize,
    /// Rows of the matrix that moves it into the first one's frame.
    first_from_cloud: [[f64; 4]; 4],
    sigma_shift_mm: [f64; 3],
    sigma_turn_deg: [f64; 3],
}

#[derive(Serialize)]
struct Pair {
    points_of: usize,
    surface_of: usize,
    overlap: f64,
    rms_mm: f64,
    floor_mm: f64,
}

/// Merges, writes the cloud and prints how well they fit.
///
/// # Errors
/// A file can't be read or written, or a cloud does not overlap with the others, or in several ways.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let began = Instant::now();
    let overwrite = args.written.overwrite();
    atomic::check(&args.output.path, overwrite)?;
    if let Some(same) = args.clouds.iter().position(|c| c.path == args.output.path) {
        return Err(usage_error(
            ErrorKind::ArgumentConflict,
            format!("the output is cloud {} itself: give another name", same + 1),
        ));
    }
    let mut problems: Vec<Problem> = Vec::new();
    let mut read: Vec<PointCloud> = Vec::new();
    for file in &args.clouds {
        let (cloud, found) = clouds::read(&file.path)?;
        problems.extend(found);
        read.push(cloud);
    }
    let outcome = console.problems(&problems);
    let options = MergeOptions { least_overlap: args.overlap, near_mm: args.near };
    let merged = merge(&read, &options).map_err(|e| explained(args, &e))?;
    merged.warnings.iter().for_each(|warning| console.warn(warning));
    let cloud = match args.average {
        Some(size) => &averaged(&merged.cloud, size),
        None => &merged.cloud,
    };
    let format = args.output.written_as(args.ascii);
    clouds::write(&args.output.path, overwrite, cloud, format)?;
    let record = Record {
        points: cloud.len(),
        frame: cloud.frame().name(),
        clouds: placed(args, &read, &merged),
        pairs: pairs(&merged),
        warnings: output::warnings(&merged.warnings, &problems),
        lost: output::lost(&problems),
        seconds: began.elapsed().as_secs_f64(),
    };
    if args.written.json {
        output::json(&record)?;
    } else {
        output::print(text(args, &record))?;
    }
    Ok(outcome)
}

/// The error with the name of the file that it is about, or of all, and the option that helps.
fn explained(args: &Args, error: &MergeError) -> anyhow::Error {
    let name = |file: &CloudFile| file.path.display().to_string();
    let about = match error {
        MergeError::NoSurface { index, .. }
        | MergeError::NoOverlap { index, .. }
        | MergeError::Ambiguous { index, .. }
        | MergeError::Undetermined { index, .. } => name(&args.clouds[*index]),
        _ => args.clouds.iter().map(name).collect::<Vec<_>>().join(", "),
    };
    let hint = match error {
        MergeError::Ambiguous { .. } | MergeError::Undetermined { .. } => " (--near MM)",
        _ => "",
    };
    anyhow!("{about}: {error}{hint}")
}

fn placed(args: &Args, read: &[PointCloud], merged: &Merged) -> Vec<Placed> {
    let one = |at: usize| {
        let sigma = |k: usize| merged.covariances[at][(k, k)].sqrt();
        Placed {
            file: args.clouds[at].path.display().to_string(),
            points: read[at].len(),
            first_from_cloud: rows(&merged.poses[at]),
            sigma_shift_mm: std::array::from_fn(|k| sigma(3 + k)),
            sigma_turn_deg: std::array::from_fn(|k| sigma(k).to_degrees()),
        }
    };
    (0..read.len()).map(one).collect()
}

fn pairs(merged: &Merged) -> Vec<Pair> {
    let pair = |pair: &uwscan::cloud::PairResidual| Pair {
        points_of: pair.points_of,
        surface_of: pair.surface_of,
        overlap: pair.overlap,
        rms_mm: pair.rms_mm,
        floor_mm: pair.floor_mm,
    };
    merged.pairs.iter().map(pair).collect()
}

fn text(args: &Args, record: &Record) -> String {
    let kept = match args.average {
        Some(size) => format!("averaged in cubes of {size} mm"),
        None => "all kept".to_owned(),
    };
    let mut text = format!(
        "{}: {} points ({kept}) of {} clouds, {} frame of the first, {:.1} s\n",
        args.output.path.display(),
        record.points,
        record.clouds.len(),
        record.frame,
        record.seconds
    );
    for (at, placed) in record.clouds.iter().enumerate() {
        let [x, y, z] = placed.sigma_shift_mm;
        let [u, v, w] = placed.sigma_turn_deg;
        let pose = match at {
            0 => "stays".to_owned(),
            _ => format!("placed to {x:.4}, {y:.4}, {z:.4} mm and {u:.4}, {v:.4}, {w:.4}° (sigma)"),
        };
        text += &format!("  cloud {}     {} points, {pose}: {}\n", at + 1, placed.points, placed.file);
    }
    for pair in &record.pairs {
        text += &format!(
            "  overlap     {:.1} % of cloud {} on cloud {}: {:.4} mm rms, {:.4} mm beyond what their sigmas tell\n",
            100.0 * pair.overlap,
            pair.points_of + 1,
            pair.surface_of + 1,
            pair.rms_mm,
            pair.floor_mm
        );
    }
    text
}
