//! `uwscan fit`.

use clap::Subcommand;
use serde::Serialize;
use uwscan::{
    cloud::{Deviations, PlaneFit, PlaneOptions, SphereFit, SphereOptions, fit_plane, fit_sphere},
    io::clouds,
};

use crate::{
    cloud_file::CloudFile,
    console::Console,
    exit::Outcome,
    output::{self, plus_minus},
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
    Sphere(SphereArgs),
    /// The plane that most points lie on, its normal towards the sensor
    Plane(CloudArgs),
}

#[derive(Debug, clap::Args)]
struct CloudArgs {
    /// Point cloud: .ply, .xyz or .csv
    #[arg(value_parser = CloudFile::parser())]
    cloud: CloudFile,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct SphereArgs {
    #[command(flatten)]
    cloud: CloudArgs,
    /// The radius, where it is known: only the centre is fitted
    #[arg(long, value_name = "MM", value_parser = radius, allow_negative_numbers = true)]
    radius: Option<f64>,
}

/// A kilometre: no sphere that an instrument sees is larger.
const LARGEST_RADIUS_MM: f64 = 1e6;

fn radius(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(radius) if radius > 0.0 && radius <= LARGEST_RADIUS_MM => Ok(radius),
        Ok(_) => Err(format!("give a positive number of millimetres, at most {LARGEST_RADIUS_MM}")),
        Err(e) => Err(e.to_string()),
    }
}

#[derive(Serialize)]
struct SphereRecord {
    radius_mm: f64,
    center_mm: [f64; 3],
    sigma_radius_mm: f64,
    sigma_center_mm: [f64; 3],
    #[serde(flatten)]
    rest: Rest,
}

#[derive(Serialize)]
struct PlaneRecord {
    normal: [f64; 3],
    offset_mm: f64,
    sigma_normal: [f64; 3],
    sigma_normal_deg: f64,
    sigma_offset_mm: f64,
    #[serde(flatten)]
    rest: Rest,
}

/// What the fits of all shapes tell.
#[derive(Serialize)]
struct Rest {
    points: usize,
    outliers: usize,
    duplicates: usize,
    rms_mm: f64,
    max_outside_mm: f64,
    max_inside_mm: f64,
    scale: Option<f64>,
    floor_mm: Option<f64>,
    frame: &'static str,
    warnings: Vec<String>,
}

impl Rest {
    fn new(d: &Deviations, frame: &'static str, warnings: Vec<String>) -> Self {
        Self {
            points: d.points,
            outliers: d.outliers,
            duplicates: d.duplicates,
            rms_mm: d.rms_mm,
            max_outside_mm: d.max_outside_mm,
            max_inside_mm: d.max_inside_mm,
            scale: d.scale,
            floor_mm: d.floor_mm,
            frame,
            warnings,
        }
    }

    fn text(&self, outside: &str, inside: &str) -> String {
        let mut text = format!(
            "  deviations  {:.4} mm rms, {:.4} mm at most {outside}, {:.4} mm {inside}\n  points      {} ({} outliers, {} \
             duplicates left out), {} frame\n",
            self.rms_mm,
            self.max_outside_mm,
            self.max_inside_mm,
            self.points,
            self.outliers,
            self.duplicates,
            self.frame
        );
        match (self.scale, self.floor_mm) {
            (Some(scale), Some(floor_mm)) => {
                text += &format!(
                    "  scatter     {:.2} times what the points' covariances and a floor of {floor_mm:.4} mm explain\n",
                    scale.sqrt()
                );
            }
            _ => text += "  scatter     is the sigma: the points have no covariances\n",
        }
        text
    }
}

/// Fits, and prints the shape.
///
/// # Errors
/// The cloud can't be read, or holds no such shape.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let source = match &args.shape {
        Shape::Sphere(args) => &args.cloud,
        Shape::Plane(args) => args,
    };
    let (cloud, problems) = clouds::read(&source.cloud.path)?;
    let outcome = console.problems(&problems);
    let of_cloud = |e: uwscan::cloud::FitError| anyhow::anyhow!("{}: {e}", source.cloud.path.display());
    let rest = |d: &Deviations| Rest::new(d, cloud.frame().name(), output::warnings(&[], &problems));
    match &args.shape {
        Shape::Sphere(SphereArgs { radius: radius_mm, .. }) => {
            let options = SphereOptions { radius_mm: *radius_mm, ..SphereOptions::default() };
            let fit = fit_sphere(&cloud, &options).map_err(of_cloud)?;
            let record = sphere(&fit, rest(&fit.deviations));
            print(source.json, &record, || sphere_text(&record, radius_mm.is_some()))?;
        }
        Shape::Plane(_) => {
            let fit = fit_plane(&cloud, &PlaneOptions::default()).map_err(of_cloud)?;
            let record = plane(&fit, rest(&fit.deviations));
            print(source.json, &record, || plane_text(&record))?;
        }
    }
    Ok(outcome)
}

fn print(json: bool, record: &impl Serialize, text: impl FnOnce() -> String) -> anyhow::Result<()> {
    if json { output::json(record) } else { output::print(text()) }
}

fn sphere(fit: &SphereFit, rest: Rest) -> SphereRecord {
    SphereRecord {
        radius_mm: fit.radius_mm,
        center_mm: fit.center_mm,
        sigma_radius_mm: fit.sigma_radius_mm,
        sigma_center_mm: fit.sigma_center_mm,
        rest,
    }
}

fn plane(fit: &PlaneFit, rest: Rest) -> PlaneRecord {
    PlaneRecord {
        normal: fit.normal,
        offset_mm: fit.offset_mm,
        sigma_normal: std::array::from_fn(|i| fit.covariance[(i, i)].max(0.0).sqrt()),
        sigma_normal_deg: fit.sigma_normal_rad.to_degrees(),
        sigma_offset_mm: fit.sigma_offset_mm,
        rest,
    }
}

fn sphere_text(record: &SphereRecord, known: bool) -> String {
    let radius = match known {
        true => format!("{} mm, as given", record.radius_mm),
        false => format!("{} mm", plus_minus(record.radius_mm, Some(record.sigma_radius_mm))),
    };
    format!(
        "sphere\n  radius      {radius}\n  centre      {} mm\n{}",
        vector(record.center_mm, record.sigma_center_mm),
        record.rest.text("outside", "inside")
    )
}

fn plane_text(record: &PlaneRecord) -> String {
    format!(
        "plane\n  normal      {} (± {:.4}° in its least certain direction)\n  offset      {} mm\n{}",
        vector(record.normal, record.sigma_normal),
        record.sigma_normal_deg,
        plus_minus(record.offset_mm, Some(record.sigma_offset_mm)),
        record.rest.text("on the sensor's side", "behind")
    )
}

fn vector(values: [f64; 3], sigmas: [f64; 3]) -> String {
    let components: Vec<String> =
        std::iter::zip(values, sigmas).map(|(value, sigma)| plus_minus(value, Some(sigma))).collect();
    components.join(",  ")
}
