//! `uwscan mesh`.

use std::{fmt::Write, time::Instant};

use serde::Serialize;
use uwscan::{
    cloud::{Parameters, Surface, SurfaceOptions, Topology, triangulate},
    io::{atomic, clouds, meshes},
};

use crate::{
    cloud_file::{CloudFile, MeshFile},
    commands::WriteArgs,
    console::Console,
    exit::Outcome,
    output,
    text::{coordinates, many, number},
};

/// Arguments of `mesh`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Point cloud of one sweep
    #[arg(value_parser = CloudFile::parser())]
    cloud: CloudFile,
    /// Mesh to write: .ply, .stl, .obj or .glb
    #[arg(short, long, value_name = "FILE", value_parser = MeshFile::parser())]
    output: MeshFile,
    /// Where the points were seen from, in the cloud's frame, mm [default: its origin]
    #[arg(long, value_name = "X,Y,Z", value_parser = coordinates, allow_hyphen_values = true)]
    sensor: Option<[f64; 3]>,
    /// Leave out triangles that the line of sight or the light meets at this angle to their normal, or a larger one
    #[arg(long, value_name = "DEG", default_value = "85", value_parser = steepest)]
    steepest: f64,
    /// Move each vertex, by its sigma, to what it and its neighbours say together; without it no vertex is moved
    #[arg(long)]
    smooth: bool,
    /// Write a PLY or STL as text rather than binary
    #[arg(long)]
    ascii: bool,
    #[command(flatten)]
    written: WriteArgs,
}

fn steepest(text: &str) -> Result<f64, String> {
    number(text, 45.0, 90.0, "°")
}

#[derive(Serialize)]
struct Record {
    vertices: usize,
    triangles: usize,
    area_mm2: f64,
    boundary_loops: usize,
    boundary_edges: usize,
    components: usize,
    points: usize,
    loose_points: usize,
    shared_places: usize,
    parameters: &'static str,
    left_out: LeftOut,
    /// The largest first.
    holes: Vec<Hole>,
    #[serde(skip_serializing_if = "Option::is_none")]
    smoothed: Option<Moved>,
    frame: &'static str,
    warnings: Vec<String>,
    surface_seconds: f64,
    seconds: f64,
}

#[derive(Serialize)]
struct LeftOut {
    voids: usize,
    grazing: usize,
    steps: usize,
    unseen: usize,
}

/// A border that goes round something open.
#[derive(Serialize)]
struct Hole {
    edges: usize,
    perimeter_mm: f64,
    area_mm2: f64,
    center_mm: [f64; 3],
}

#[derive(Serialize)]
struct Moved {
    vertices: usize,
    rms_mm: f64,
}

/// Holes that the text lists.
const LISTED: usize = 3;

/// Makes the surface, writes it and prints what came out.
///
/// # Errors
/// The cloud can't be read or has no surface, or the mesh can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let began = Instant::now();
    let overwrite = args.written.overwrite();
    atomic::check(&args.output.path, overwrite)?;
    let (cloud, problems) = clouds::read(&args.cloud.path)?;
    let outcome = console.problems(&problems);
    let options = SurfaceOptions {
        sensor_mm: args.sensor,
        steepest_rad: args.steepest.to_radians(),
        smooth: args.smooth,
    };
    let made = Instant::now();
    let surface =
        triangulate(&cloud, &options).map_err(|e| anyhow::anyhow!("{}: {e}", args.cloud.path.display()))?;
    let surface_seconds = made.elapsed().as_secs_f64();
    let topology = surface.mesh.topology();
    let format = args.output.written_as(args.ascii);
    meshes::write(&args.output.path, overwrite, &surface.mesh, format)?;
    let record = record(&surface, &topology, cloud.len(), output::warnings(&[], &problems));
    let record = Record { surface_seconds, seconds: began.elapsed().as_secs_f64(), ..record };
    if args.written.json {
        output::json(&record)?;
    } else {
        output::print(text(args, &record))?;
    }
    Ok(outcome)
}

fn record(surface: &Surface, topology: &Topology, points: usize, warnings: Vec<String>) -> Record {
    Record {
        vertices: surface.mesh.vertices_mm().len(),
        triangles: surface.mesh.triangles().len(),
        area_mm2: surface.mesh.area_mm2(),
        boundary_loops: topology.boundary_loops,
        boundary_edges: topology.boundary_edges,
        components: topology.components,
        points,
        loose_points: surface.loose_points,
        shared_places: surface.shared_places,
        parameters: match surface.parameters {
            Parameters::Image => "image",
            Parameters::Direction => "direction",
        },
        left_out: LeftOut {
            voids: surface.cut.voids,
            grazing: surface.cut.grazing,
            steps: surface.cut.steps,
            unseen: surface.cut.unseen,
        },
        holes: holes(surface),
        smoothed: surface.smoothed.map(|s| Moved { vertices: s.moved, rms_mm: s.rms_mm }),
        frame: surface.mesh.frame().name(),
        warnings,
        surface_seconds: 0.0,
        seconds: 0.0,
    }
}

fn holes(surface: &Surface) -> Vec<Hole> {
    let mut holes: Vec<Hole> = surface
        .mesh
        .boundaries()
        .iter()
        .filter(|border| border.is_hole)
        .map(|border| Hole {
            edges: border.vertices.len(),
            perimeter_mm: border.perimeter_mm,
            area_mm2: border.area_mm2,
            center_mm: border.center_mm,
        })
        .collect();
    holes.sort_by(|a, b| b.area_mm2.total_cmp(&a.area_mm2));
    holes
}

fn text(args: &Args, record: &Record) -> String {
    let seen = match record.parameters {
        "image" => "as the image shows them",
        _ => "by direction from the sensor",
    };
    let mut text = format!(
        "{}: {} triangles on {} vertices, {:.1} mm², {} frame, {:.2} s\n  \
         borders      {} (outer borders and holes) of {} edges, {}\n",
        args.output.path.display(),
        record.triangles,
        record.vertices,
        record.area_mm2,
        record.frame,
        record.seconds,
        many(record.boundary_loops, "loop"),
        record.boundary_edges,
        many(record.components, "part"),
    );
    if !record.holes.is_empty() {
        let of = |hole: &Hole| {
            let [x, y, z] = hole.center_mm;
            format!("{:.1} mm² at {x:.1}, {y:.1}, {z:.1}", hole.area_mm2)
        };
        let listed: Vec<String> = record.holes.iter().take(LISTED).map(of).collect();
        let more = if record.holes.len() > LISTED { "; …" } else { "" };
        _ = writeln!(text, "  holes        {}: {}{more}", record.holes.len(), listed.join("; "));
    }
    _ = writeln!(
        text,
        "  points       {} triangulated {seen}; {} on no triangle, {} in the place of another\n  \
         left out     {} triangles across voids, {} across what was not seen, {} along the line of sight or the light, {} across steps",
        record.points,
        record.loose_points,
        record.shared_places,
        record.left_out.voids,
        record.left_out.unseen,
        record.left_out.grazing,
        record.left_out.steps,
    );
    if let Some(moved) = &record.smoothed {
        _ = writeln!(
            text,
            "  smoothed     {} vertices moved, by {:.4} mm rms; sigmas are those after it",
            moved.vertices, moved.rms_mm
        );
    }
    text
}
