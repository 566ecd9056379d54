//! `uwscan shapes`.

use std::{fmt::Write, num::NonZeroUsize, time::Instant};

use serde::Serialize;
use uwscan::{
    cloud::{Relation, Relations, Shape, ShapeOptions, find_shapes, relations},
    io::clouds,
};

use crate::{
    cloud_file::CloudFile,
    console::Console,
    exit::Outcome,
    output,
    records::{self, Matrix, with_total},
    shared_part::SharedArgs,
    text::{many, positive},
};

/// Arguments of `shapes`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Point cloud: .ply, .pcd, .xyz, .csv, .e57, .las or .laz
    #[arg(value_parser = CloudFile::parser())]
    cloud: CloudFile,
    /// At most so many shapes, those with the most points
    #[arg(long, value_name = "N", value_parser = positive::<NonZeroUsize>)]
    max: Option<NonZeroUsize>,
    #[command(flatten)]
    shared: SharedArgs,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Output {
    shapes: Vec<Found>,
    distances_mm: Vec<Distance>,
    angles_deg: Vec<Angle>,
    points: usize,
    unassigned_points: usize,
    frame: &'static str,
    warnings: Vec<String>,
    seconds: f64,
}

#[derive(Serialize)]
struct Found {
    kind: &'static str,
    #[serde(flatten)]
    record: records::Record,
}

/// Between two shapes by their places in the list, from 0.
#[derive(Serialize)]
struct Distance {
    a: usize,
    b: usize,
    distance_mm: f64,
    sigma_mm: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_total_mm: Option<f64>,
}

#[derive(Serialize)]
struct Angle {
    a: usize,
    b: usize,
    angle_deg: f64,
    sigma_deg: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_total_deg: Option<f64>,
}

/// Distances and angles that are listed unless all are asked for.
const LISTED: usize = 20;

/// Finds the shapes, and prints them.
///
/// # Errors
/// The cloud or the calibration can't be read, or don't belong together.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let (cloud, mut problems) = clouds::read(&args.cloud.path)?;
    let calibration = args.shared.read(&mut problems)?;
    let outcome = console.problems(&problems);
    let path = args.cloud.path.display();
    let began = Instant::now();
    let options = ShapeOptions { max: args.max.map(NonZeroUsize::get), ..ShapeOptions::default() };
    let found = find_shapes(&cloud, &options).map_err(|e| anyhow::anyhow!("{path}: {e}"))?;
    let mut warnings = Vec::new();
    let parts = match &calibration {
        Some(file) => {
            let of_cloud = |e: uwscan::Error| anyhow::anyhow!("{path}: {e}");
            let mut shared = args.shared.errors(&args.cloud.path, &cloud, file, console, &mut warnings)?;
            let parts = found.shapes.iter().map(|shape| shared.of(shape.fit.influence()));
            Some(parts.collect::<Result<Vec<_>, _>>().map_err(of_cloud)?)
        }
        None => None,
    };
    let between = relations(&cloud, &found.shapes, parts.as_deref());
    let seconds = began.elapsed().as_secs_f64();
    let record = |(at, shape): (usize, &Shape)| {
        let total = parts.as_ref().map(|parts: &Vec<Matrix>| {
            let part = &parts[at];
            shape.fit.covariance() + part * part.transpose()
        });
        let record = records::shape(&shape.fit, total.as_ref())?;
        Some(Found { kind: shape.fit.kind(), record })
    };
    let output = Output {
        shapes: found.shapes.iter().enumerate().filter_map(record).collect(),
        distances_mm: between.distances_mm.iter().map(distance).collect(),
        angles_deg: between.angles_rad.iter().map(angle).collect(),
        points: cloud.len(),
        unassigned_points: found.unassigned_points,
        frame: cloud.frame().name(),
        warnings: output::warnings(&warnings, &problems),
        seconds,
    };
    if args.json {
        output::json(&output)?;
    } else {
        output::print(text(&output, &between, console.verbose()))?;
    }
    Ok(outcome)
}

fn distance(r: &Relation) -> Distance {
    Distance { a: r.a, b: r.b, distance_mm: r.value, sigma_mm: r.sigma, sigma_total_mm: r.sigma_total }
}

fn angle(r: &Relation) -> Angle {
    Angle {
        a: r.a,
        b: r.b,
        angle_deg: r.value.to_degrees(),
        sigma_deg: r.sigma.to_degrees(),
        sigma_total_deg: r.sigma_total.map(f64::to_degrees),
    }
}

fn text(output: &Output, between: &Relations, all: bool) -> String {
    let listed = if all { usize::MAX } else { LISTED };
    let mut text = format!(
        "{} in {} points, {} of them of none, {} frame, {:.2} s\n",
        many(output.shapes.len(), "shape"),
        output.points,
        output.unassigned_points,
        output.frame,
        output.seconds
    );
    for (at, found) in output.shapes.iter().enumerate() {
        _ = write!(text, "{at}: {}\n{}", found.kind, found.record.text(false, output.frame));
    }
    let name = |at: usize| format!("{at} ({})", output.shapes.get(at).map_or("", |found| found.kind));
    for (title, relations, unit, scale) in [
        ("distances", &between.distances_mm, " mm", 1.0),
        ("angles", &between.angles_rad, "°", 180.0 / std::f64::consts::PI),
    ] {
        if !relations.is_empty() {
            _ = writeln!(text, "{title}");
        }
        for r in relations.iter().take(listed) {
            let value = with_total(r.value * scale, r.sigma * scale, r.sigma_total.map(|s| s * scale));
            _ = writeln!(text, "  {} to {}  {value}{unit}", name(r.a), name(r.b));
        }
        if let Some(more @ 1..) = relations.len().checked_sub(listed) {
            _ = writeln!(text, "  and {more} more; --verbose or --json has them");
        }
    }
    text
}
