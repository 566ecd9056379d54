//! `uwscan fit`.

use clap::Subcommand;
use nalgebra::SMatrix;
use serde::Serialize;
use uwscan::{
    cloud::{
        CircleOptions, CylinderOptions, FitError, Influence, PlaneOptions, SphereOptions, fit_circle,
        fit_cylinder, fit_plane, fit_sphere,
    },
    io::clouds,
};

use crate::{
    cloud_file::CloudFile,
    console::Console,
    exit::Outcome,
    output,
    records::{self, Matrix, Record},
    shared_part::SharedArgs,
};

/// Arguments of `fit`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    shape: Shape,
}

#[derive(Debug, Subcommand)]
enum Shape {
    /// The sphere that most points lie on
    Sphere(RoundArgs),
    /// The plane that most points lie on, its normal towards the sensor
    Plane(CloudArgs),
    /// The cylinder that most points lie on
    Cylinder(RoundArgs),
    /// The circle that most points lie along: an edge, its normal towards the sensor
    Circle(RoundArgs),
}

#[derive(Debug, clap::Args)]
struct CloudArgs {
    /// Point cloud: .ply, .pcd, .xyz, .csv, .e57, .las or .laz
    #[arg(value_parser = CloudFile::parser())]
    cloud: CloudFile,
    #[command(flatten)]
    shared: SharedArgs,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct RoundArgs {
    #[command(flatten)]
    cloud: CloudArgs,
    /// The radius, where it is known: only the rest is fitted
    #[arg(long, value_name = "MM", value_parser = radius, allow_negative_numbers = true)]
    radius: Option<f64>,
}

/// A kilometre: no shape that an instrument sees is larger.
const LARGEST_RADIUS_MM: f64 = 1e6;

fn radius(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(radius) if radius > 0.0 && radius <= LARGEST_RADIUS_MM => Ok(radius),
        Ok(_) => Err(format!("give a positive number of millimetres, at most {LARGEST_RADIUS_MM}")),
        Err(e) => Err(e.to_string()),
    }
}

#[derive(Serialize)]
struct Output {
    #[serde(flatten)]
    record: Record,
    frame: &'static str,
    warnings: Vec<String>,
}

/// Fits, and prints the shape.
///
/// # Errors
/// The cloud or the calibration can't be read, don't belong together, or there is no such shape.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let (source, radius_mm) = match &args.shape {
        Shape::Sphere(args) | Shape::Cylinder(args) | Shape::Circle(args) => (&args.cloud, args.radius),
        Shape::Plane(args) => (args, None),
    };
    let (cloud, mut problems) = clouds::read(&source.cloud.path)?;
    let calibration = source.shared.read(&mut problems)?;
    let outcome = console.problems(&problems);
    let at_cloud = |e: FitError| anyhow::anyhow!("{}: {e}", source.cloud.path.display());
    let mut warnings = Vec::new();
    let mut total = |covariance: &Matrix, influence: &Influence| -> anyhow::Result<Option<Matrix>> {
        let Some(file) = &calibration else { return Ok(None) };
        let path = &source.cloud.path;
        let mut shared = source.shared.errors(path, &cloud, file, console, &mut warnings)?;
        let total = shared.total(covariance, influence);
        total.map(Some).map_err(|e| anyhow::anyhow!("{}: {e}", path.display()))
    };
    let (name, record) = match &args.shape {
        Shape::Sphere(_) => {
            let options = SphereOptions { radius_mm, ..SphereOptions::default() };
            let fit = fit_sphere(&cloud, &options).map_err(at_cloud)?;
            let total = total(&dynamic(&fit.covariance_mm2), &fit.influence)?;
            ("sphere", records::sphere(&fit, total.as_ref()))
        }
        Shape::Plane(_) => {
            let fit = fit_plane(&cloud, &PlaneOptions::default()).map_err(at_cloud)?;
            let total = total(&dynamic(&fit.covariance), &fit.influence)?;
            ("plane", records::plane(&fit, total.as_ref()))
        }
        Shape::Cylinder(_) => {
            let options = CylinderOptions { radius_mm, ..CylinderOptions::default() };
            let fit = fit_cylinder(&cloud, &options).map_err(at_cloud)?;
            let total = total(&dynamic(&fit.covariance), &fit.influence)?;
            ("cylinder", records::cylinder(&fit, total.as_ref()))
        }
        Shape::Circle(_) => {
            let options = CircleOptions { radius_mm, ..CircleOptions::default() };
            let fit = fit_circle(&cloud, &options).map_err(at_cloud)?;
            let total = total(&dynamic(&fit.covariance), &fit.influence)?;
            ("circle", records::circle(&fit, total.as_ref()))
        }
    };
    let frame = cloud.frame().name();
    if source.json {
        output::json(&Output { record, frame, warnings: output::warnings(&warnings, &problems) })?;
    } else {
        output::print(format!("{name}\n{}", record.text(radius_mm.is_some(), frame)))?;
    }
    Ok(outcome)
}

fn dynamic<const N: usize>(covariance: &SMatrix<f64, N, N>) -> Matrix {
    Matrix::from_fn(N, N, |i, j| covariance[(i, j)])
}
