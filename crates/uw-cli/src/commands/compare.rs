//! `uwscan compare`.

use std::{path::PathBuf, time::Instant};

use anyhow::{anyhow, bail};
use clap::ValueEnum;
use nalgebra::Isometry3;
use serde::Serialize;
use uwscan::{
    cloud::{
        AgainstReference, PointCloud, ReferenceOptions, Registration, Start, TriangleMesh,
        compare_with_reference, deviation_color,
    },
    io::{Problem, atomic, clouds, meshes, ply},
};

use crate::{
    commands::WriteArgs,
    console::Console,
    exit::Outcome,
    output::{self, Lost},
    text::{length, share},
};

/// Arguments of `compare`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What was measured: a point cloud or a mesh
    input: PathBuf,
    /// What it should be: a mesh (.stl, .ply, .obj)
    reference: PathBuf,
    /// Write the map of deviations: the points (a cloud of any format) or the mesh (.ply) with a deviation in mm and a colour each
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Compare it where it is, without best-fit alignment
    #[arg(long)]
    no_align: bool,
    /// Align from where it is, which is right to within this distance, rather than from anywhere
    #[arg(long, value_name = "MM", value_parser = length, conflicts_with = "no_align")]
    near: Option<f64>,
    /// Share of the points that must come to lie on the reference
    #[arg(long, value_name = "SHARE", default_value = "0.2", value_parser = share)]
    overlap: f64,
    /// Unit of the reference's coordinates
    #[arg(long, value_name = "UNIT", default_value = "mm")]
    unit: Unit,
    /// Deviation of the colours at either end [default: what 95 % keep within]
    #[arg(long, value_name = "MM", value_parser = length)]
    range: Option<f64>,
    /// Write a PLY or PCD as text rather than binary
    #[arg(long)]
    ascii: bool,
    #[command(flatten)]
    written: WriteArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Unit {
    Mm,
    Cm,
    M,
    In,
}

impl Unit {
    fn mm(self) -> f64 {
        match self {
            Self::Mm => 1.0,
            Self::Cm => 10.0,
            Self::M => 1000.0,
            Self::In => 25.4,
        }
    }
}

#[derive(Serialize)]
struct Record {
    points: usize,
    compared: usize,
    beyond: usize,
    mean_mm: f64,
    median_mm: f64,
    rms_mm: f64,
    robust_sigma_mm: f64,
    within_95_mm: f64,
    max_outside_mm: f64,
    max_inside_mm: f64,
    quantiles: Quantiles,
    within_sigmas: Option<[f64; 3]>,
    histogram: Histogram,
    alignment: Option<Alignment>,
    reference: Reference,
    output: Option<String>,
    color_range_mm: f64,
    warnings: Vec<String>,
    lost: Vec<Lost>,
    seconds: f64,
}

#[derive(Serialize)]
struct Quantiles {
    shares: [f64; 5],
    values_mm: [f64; 5],
}

#[derive(Serialize)]
struct Histogram {
    from_mm: f64,
    width_mm: f64,
    counts: Vec<usize>,
}

/// The alignment, for JSON.
#[derive(Serialize)]
pub struct Alignment {
    /// Rows of the matrix that moves the cloud onto the reference.
    reference_from_cloud: [[f64; 4]; 4],
    sigma_shift_mm: [f64; 3],
    sigma_turn_deg: [f64; 3],
    overlap: f64,
    rms_mm: f64,
    floor_mm: f64,
    undetermined: Vec<String>,
    rivals: usize,
    rounds: usize,
}

impl Alignment {
    /// What is told of a registration.
    pub fn new(found: &Registration) -> Self {
        let sigma = |at: usize| found.covariance[(at, at)].sqrt();
        Self {
            reference_from_cloud: rows(&found.mesh_from_cloud),
            sigma_shift_mm: std::array::from_fn(|k| sigma(3 + k)),
            sigma_turn_deg: std::array::from_fn(|k| sigma(k).to_degrees()),
            overlap: found.overlap,
            rms_mm: found.rms_mm,
            floor_mm: found.floor_mm,
            undetermined: found.undetermined.iter().map(ToString::to_string).collect(),
            rivals: found.rivals.len(),
            rounds: found.rounds,
        }
    }
}

/// The rows of a pose's matrix.
pub fn rows(pose: &Isometry3<f64>) -> [[f64; 4]; 4] {
    let matrix = pose.to_homogeneous();
    std::array::from_fn(|r| std::array::from_fn(|c| matrix[(r, c)]))
}

#[derive(Serialize)]
struct Reference {
    triangles: usize,
    closed: bool,
    boundary_edges: usize,
    flipped_edges: usize,
}

/// What is measured, as it came.
enum Input {
    Cloud(PointCloud),
    Mesh(TriangleMesh),
}

/// Compares, writes the map and prints the statistics.
///
/// # Errors
/// A file can't be read or written, or the input does not come to lie on the reference.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let began = Instant::now();
    let overwrite = args.written.overwrite();
    let mut problems = Vec::new();
    let input = read(args, &mut problems)?;
    if let Some(path) = &args.output {
        check_ending(path, &input)?;
        atomic::check(path, overwrite)?;
    }
    let (reference, more) = meshes::read(&args.reference)?;
    problems.extend(more);
    let reference = scaled(reference, args.unit.mm())?;
    let outcome = console.problems(&problems);
    let points = match &input {
        Input::Cloud(cloud) => cloud.clone(),
        Input::Mesh(mesh) => vertices(mesh)?,
    };
    let align = match (args.no_align, args.near) {
        (true, _) => None,
        (false, Some(reach)) => Some(Start::Near(Isometry3::identity(), reach)),
        (false, None) => Some(Start::Anywhere),
    };
    let options = ReferenceOptions { align, least_overlap: args.overlap };
    let found = compare_with_reference(&points, &reference, &options)
        .map_err(|e| anyhow!("{} against {}: {e}", args.input.display(), args.reference.display()))?;
    found.warnings.iter().for_each(|warning| console.warn(warning));
    let range = args.range.unwrap_or(found.comparison.within_95_mm);
    if let Some(path) = &args.output {
        let deviations = found.comparison.deviations_mm.clone();
        let colors = deviations.iter().map(|d| deviation_color(*d, range)).collect();
        let encoding = if args.ascii { ply::Encoding::Ascii } else { ply::Encoding::Binary };
        match input {
            Input::Cloud(cloud) => {
                let format = clouds::Format::of(path)?;
                let map = cloud.with_deviations_mm(deviations)?.with_colors(colors)?;
                clouds::write(path, overwrite, &map, if args.ascii { format.as_text() } else { format })?;
            }
            Input::Mesh(mesh) => {
                let map = mesh.with_deviations_mm(deviations)?.with_colors(colors)?;
                ply::write_mesh(path, overwrite, &map, encoding)?;
            }
        }
    }
    let mut record = record(args, &reference, &found, range, &problems);
    record.seconds = began.elapsed().as_secs_f64();
    if args.written.json {
        output::json(&record)?;
    } else {
        output::print(text(args, &record))?;
    }
    Ok(outcome)
}

fn read(args: &Args, problems: &mut Vec<Problem>) -> anyhow::Result<Input> {
    if meshes::is_mesh(&args.input)? {
        let (mesh, found) = meshes::read(&args.input)?;
        problems.extend(found);
        return Ok(Input::Mesh(mesh));
    }
    if clouds::Format::of(&args.input).is_err() {
        bail!(
            "{}: this is neither a point cloud, whose name ends in {}, nor a mesh, whose name ends in .ply, .stl or .obj",
            args.input.display(),
            clouds::ENDINGS
        );
    }
    let (cloud, found) = clouds::read(&args.input)?;
    problems.extend(found);
    Ok(Input::Cloud(cloud))
}

fn check_ending(path: &std::path::Path, input: &Input) -> anyhow::Result<()> {
    match input {
        Input::Cloud(_) => {
            clouds::Format::of(path)?;
        }
        Input::Mesh(_) if matches!(meshes::Format::of(path), Ok(meshes::Format::Ply(_))) => {}
        Input::Mesh(_) => bail!("{}: a mesh's map is a PLY: give a name that ends in .ply", path.display()),
    }
    Ok(())
}

/// A mesh's vertices as points, with what is known of them.
fn vertices(mesh: &TriangleMesh) -> anyhow::Result<PointCloud> {
    let cloud = PointCloud::new(mesh.frame(), mesh.vertices_mm().to_vec());
    Ok(match mesh.sigmas_mm() {
        Some(sigmas) => cloud.with_sigmas_mm(sigmas.to_vec())?,
        None => cloud,
    })
}

fn scaled(mesh: TriangleMesh, mm: f64) -> anyhow::Result<TriangleMesh> {
    if mm.total_cmp(&1.0).is_eq() {
        return Ok(mesh);
    }
    let vertices = mesh.vertices_mm().iter().map(|p| p.map(|c| c * mm)).collect();
    Ok(TriangleMesh::new(mesh.frame(), vertices, mesh.triangles().to_vec())?)
}

fn record(
    args: &Args,
    reference: &TriangleMesh,
    found: &AgainstReference,
    range: f64,
    problems: &[Problem],
) -> Record {
    let c = &found.comparison;
    let bins = c.histogram();
    Record {
        points: c.deviations_mm.len(),
        compared: c.compared,
        beyond: c.beyond,
        mean_mm: c.mean_mm,
        median_mm: c.quantiles_mm[2],
        rms_mm: c.rms_mm,
        robust_sigma_mm: c.robust_sigma_mm,
        within_95_mm: c.within_95_mm,
        max_outside_mm: c.extremes_mm[1].max(0.0),
        max_inside_mm: (-c.extremes_mm[0]).max(0.0),
        quantiles: Quantiles { shares: [0.025, 0.25, 0.5, 0.75, 0.975], values_mm: c.quantiles_mm },
        within_sigmas: c.within_sigmas,
        histogram: Histogram { from_mm: bins.from_mm, width_mm: bins.width_mm, counts: bins.counts },
        alignment: found.registration.as_ref().map(Alignment::new),
        reference: Reference {
            triangles: reference.triangles().len(),
            closed: found.topology.is_closed(),
            boundary_edges: found.topology.boundary_edges,
            flipped_edges: found.topology.flipped_edges,
        },
        output: args.output.as_ref().map(|path| path.display().to_string()),
        color_range_mm: range,
        warnings: output::warnings(&found.warnings, problems),
        lost: output::lost(problems),
        seconds: 0.0,
    }
}

fn text(args: &Args, record: &Record) -> String {
    let mut text = format!(
        "{} against {}: {} of {} points beside it, {:.1} s\n  \
         deviations  {:.4} mm rms, {:+.4} mean, {:+.4} median; 95 % within {:.4}\n  \
         extremes    {:.4} mm outside, {:.4} mm inside\n",
        args.input.display(),
        args.reference.display(),
        record.compared,
        record.points,
        record.seconds,
        record.rms_mm,
        record.mean_mm,
        record.median_mm,
        record.within_95_mm,
        record.max_outside_mm,
        record.max_inside_mm,
    );
    if let Some([one, two, three]) = record.within_sigmas {
        text += &format!(
            "  own sigmas  {:.1} % within one, {:.1} % within two, {:.1} % within three\n",
            100.0 * one,
            100.0 * two,
            100.0 * three
        );
    }
    match &record.alignment {
        Some(a) => {
            let [x, y, z] = a.sigma_shift_mm;
            let [u, v, w] = a.sigma_turn_deg;
            text += &format!(
                "  alignment   best fit, {:.1} % of the points on the reference, {:.4} mm rms; sigma {x:.4}, {y:.4}, {z:.4} mm, {u:.4}, {v:.4}, \
                 {w:.4}°\n",
                100.0 * a.overlap,
                a.rms_mm
            );
        }
        None => text += "  alignment   none: compared where it is\n",
    }
    text += &histogram(&record.histogram);
    if let Some(path) = &record.output {
        text += &format!("  map         {path}, colours over ± {:.4} mm\n", record.color_range_mm);
    }
    text
}

/// The histogram, sixteen lines of bars.
fn histogram(histogram: &Histogram) -> String {
    const LINES: usize = 16;
    const WIDEST: usize = 50;
    let bins = histogram.counts.len();
    let lines = LINES.min(bins).max(1);
    let mut sums = vec![0_usize; lines];
    for (at, count) in histogram.counts.iter().enumerate() {
        sums[at * lines / bins] += count;
    }
    let most = sums.iter().copied().max().unwrap_or(0).max(1);
    // Whether four decimals tell one line from the next.
    let told = histogram.width_mm * bins as f64 / lines as f64 >= 1e-4;
    let mut text = String::new();
    for (line, sum) in sums.iter().enumerate() {
        let first = (line * bins).div_ceil(lines);
        let from = histogram.from_mm + first as f64 * histogram.width_mm;
        let from = if told { format!("{from:>+9.4}") } else { format!("{from:>+9.1e}") };
        text += &format!("  {from} mm {sum:>8} {}\n", "#".repeat(sum * WIDEST / most));
    }
    text
}
