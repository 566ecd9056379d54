//! `uwscan report`.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use uwscan::{
    cloud::Frame,
    pipeline::{
        reconstruct,
        report::{Record, Settings, check, report},
    },
};

use crate::{
    commands::overwrite, console::Console, exit::Outcome, now::now, output, progress::Progress, text::many,
};

/// Arguments of `report`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A capture's stripes are in the report image by image, a cloud's are not known. Captures are reconstructed as \
    `uwscan reconstruct` does by default; for other ways, reconstruct first and report on the cloud.\n\n\
    A file of nominal values is TOML (format = \"uwscan-nominal\", version = 1, tables [[sphere]] with name and radius_mm, \
    [[distance]] with a, b and distance_mm) or CSV (kind,a,b,value_mm)."
)]
pub struct Args {
    /// Capture folders or recordings (.mcap) of scans, and point clouds (.ply, .pcd, .xyz, .csv, .e57, .las, .laz)
    #[arg(required = true, value_name = "SCAN")]
    scans: Vec<PathBuf>,
    /// Calibration file of the instrument: captures need it; to a cloud it adds its part of the uncertainty
    #[arg(short, long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Page to write (.html); figures go beside it as .json and .csv
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Mesh to hold the scans against after best fit: .ply, .stl or .obj
    #[arg(long, value_name = "MESH")]
    reference: Option<PathBuf>,
    /// Nominal radii and distances of the balls of an artefact: .toml or .csv
    #[arg(long, value_name = "FILE")]
    nominal: Option<PathBuf>,
    /// Frame of the points of captures
    #[arg(long, default_value = "camera")]
    frame: FrameArg,
    /// Title of the page
    #[arg(long, value_name = "TEXT")]
    title: Option<String>,
    /// Replace the outputs if they exist
    #[arg(long)]
    force: bool,
    /// Print one JSON object instead of text: what the JSON file holds
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FrameArg {
    /// The camera's
    Camera,
    /// The galvanometer's, as the paper's tables
    Galvo,
}

/// Measures, writes the page and the files beside it, and says where they are.
///
/// # Errors
/// A file is wrong, a capture comes without a calibration, a scan can't be measured, or the outputs can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let overwrite = overwrite(args.force);
    let given = args.scans.iter().chain(&args.calibration).chain(&args.reference).chain(&args.nominal);
    let inputs: Vec<&Path> = given.map(PathBuf::as_path).collect();
    check(&args.output, &inputs, overwrite)?;
    let frame = match args.frame {
        FrameArg::Camera => Frame::Camera,
        FrameArg::Galvo => Frame::Galvo,
    };
    let settings = Settings {
        calibration: args.calibration.clone(),
        reconstruct: reconstruct::Settings { frame, ..reconstruct::Settings::default() },
        reference: args.reference.clone(),
        nominal: args.nominal.clone(),
        title: args.title.clone(),
        made: now(),
        named_from: None,
    };
    let progress = Progress::new(console);
    let result = report(&args.scans, &settings, &progress);
    drop(progress);
    let made = result.map_err(|failure| console.failure(failure))?;
    let outcome = console.problems(&made.problems);
    let files = made.write(&args.output, overwrite)?;
    if args.json {
        output::json(&made.record)?;
    } else {
        let names = files.map(|file| file.display().to_string());
        output::print(format!("{}: {}\n", names.join(", "), text(&made.record)))?;
    }
    Ok(outcome)
}

fn text(record: &Record) -> String {
    let points: usize = record.scans.iter().map(|scan| scan.points).sum();
    let shapes: usize = record.scans.iter().map(|scan| scan.shapes.len()).sum();
    let counts = [many(record.scans.len(), "scan"), many(points, "point"), many(shapes, "shape")];
    counts.join(", ")
}
