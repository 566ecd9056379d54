//! What `benches/peers/clouds.py` compares with other people's programs: this project's fits, normals, shapes and meshes of a cloud's file, timed inside
//! the process.
//!
//! `cargo run --release --example cloud_peers -- CLOUD.ply OUTPUT_FOLDER OPERATION…` prints a line an operation: its name, the shortest time of
//! several runs in seconds, and figures. Normals and meshes go to the folder.

#![allow(clippy::print_stdout, reason = "the table of figures is what is asked for")]
#![allow(clippy::unwrap_used, reason = "a bench that can't run says so by stopping")]

use std::fmt::Write;
use std::path::Path;
use std::time::{Duration, Instant};
use uwscan::cloud::{
    CylinderOptions, NORMAL_NEIGHBOURS, PlaneOptions, PointCloud, ShapeFit, ShapeOptions, SphereOptions,
    SurfaceOptions, find_shapes, fit_cylinder, fit_plane, fit_sphere, normals, triangulate,
};
use uwscan::io::{Overwrite, clouds, meshes};

/// Runs of an operation at least, and the time that they may take all together.
const RUNS: usize = 3;
const TIME: Duration = Duration::from_secs(2);

/// Returns the shortest time of several runs, s, and the last result.
fn timed<T>(run: impl Fn() -> T) -> (f64, T) {
    let began = Instant::now();
    let mut best = f64::INFINITY;
    for runs in 1.. {
        let start = Instant::now();
        let result = std::hint::black_box(run());
        best = best.min(start.elapsed().as_secs_f64());
        if runs >= RUNS && (began.elapsed() > TIME || runs >= 20 * RUNS) {
            return (best, result);
        }
    }
    unreachable!("the loop ends by returning")
}

fn figures(values: impl IntoIterator<Item = f64>) -> String {
    values.into_iter().fold(String::new(), |mut text, value| {
        _ = write!(text, " {value:.9}");
        text
    })
}

fn of_shape(fit: &ShapeFit) -> String {
    match fit {
        ShapeFit::Sphere(fit) => format!(" sphere{}", figures([fit.radius_mm])),
        ShapeFit::Plane(fit) => format!(" plane{}", figures([fit.offset_mm])),
        ShapeFit::Cylinder(fit) => format!(" cylinder{}", figures([fit.radius_mm])),
        _ => String::new(),
    }
}

fn operate(cloud: &PointCloud, operation: &str, folder: &Path) -> (f64, String) {
    match operation {
        "plane" => {
            let (time, fit) = timed(|| fit_plane(cloud, &PlaneOptions::default()).unwrap());
            (time, figures(fit.normal.into_iter().chain([fit.offset_mm])))
        }
        "sphere" => {
            let (time, fit) = timed(|| fit_sphere(cloud, &SphereOptions::default()).unwrap());
            (time, figures([fit.radius_mm].into_iter().chain(fit.center_mm)))
        }
        "cylinder" => {
            let (time, fit) = timed(|| fit_cylinder(cloud, &CylinderOptions::default()).unwrap());
            (time, figures([fit.radius_mm].into_iter().chain(fit.axis_direction)))
        }
        "normals" => {
            let (time, found) = timed(|| normals(cloud, NORMAL_NEIGHBOURS, &[0.0; 3]).unwrap());
            let text = found.iter().fold(String::new(), |mut text, normal| {
                let [x, y, z] = normal.unwrap_or([f64::NAN; 3]);
                _ = writeln!(text, "{x:.9} {y:.9} {z:.9}");
                text
            });
            std::fs::write(folder.join("normals.txt"), text).unwrap();
            (time, figures([found.iter().flatten().count() as f64]))
        }
        "shapes" => {
            let (time, found) = timed(|| find_shapes(cloud, &ShapeOptions::default()).unwrap());
            (time, found.shapes.iter().map(|shape| of_shape(&shape.fit)).collect())
        }
        "mesh" => {
            let (time, surface) = timed(|| triangulate(cloud, &SurfaceOptions::default()).unwrap());
            let path = folder.join("mesh.ply");
            meshes::write(&path, Overwrite::Replace, &surface.mesh, meshes::Format::of(&path).unwrap())
                .unwrap();
            (time, figures([surface.mesh.triangles().len() as f64, surface.mesh.area_mm2()]))
        }
        other => panic!("no operation {other}"),
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [cloud, folder, operations @ ..] = &arguments[..] else {
        panic!("cloud_peers CLOUD.ply OUTPUT_FOLDER OPERATION…");
    };
    let (cloud, _) = clouds::read(Path::new(cloud)).unwrap();
    for operation in operations {
        let (seconds, told) = operate(&cloud, operation, Path::new(folder));
        println!("{operation} {seconds:.9}{told}");
    }
}
