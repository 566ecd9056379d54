//! What `benches/peers/clouds.py` compares with other people's programs: this project's operations on clouds, timed inside the process.
//!
//! `cargo run --release -p uw-cloud --example cloud_peers -- FOLDER OPERATION…` reads `cloud.f64` of the folder (x, y and z of each point, mm, eight bytes each, the lowest first; `other.f64` is the
//! cloud that `icp` moves onto it), and prints a line an operation: its name, the shortest processor time of several runs in seconds, and figures. Normals, meshes and outliers go to the folder.

#![allow(clippy::print_stdout, reason = "the table of figures is what is asked for")]
#![allow(clippy::unwrap_used, reason = "a bench that can't run says so by stopping")]

use std::fmt::Write;
use std::path::Path;
use std::time::{Duration, Instant};
use uw_cloud::{
    CylinderOptions, Frame, NORMAL_NEIGHBOURS, PlaneOptions, PointCloud, ShapeFit, ShapeOptions,
    SphereOptions, Start, SurfaceOptions, SweepSurface, TriangleMesh, find_shapes, fit_cylinder, fit_plane,
    fit_sphere, normals, register_sweep, sparse_outliers, triangulate,
};

/// Runs of an operation at least, and the time that they may take all together.
const RUNS: usize = 3;
const TIME: Duration = Duration::from_secs(2);

/// Seconds that this process's threads have had a processor (Linux): others at work on the machine do not count.
fn worked_s() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").unwrap();
    let told = tasks.map(|task| std::fs::read_to_string(task.unwrap().path().join("schedstat")).unwrap());
    told.map(|told| 1e-9 * told.split_whitespace().next().unwrap().parse::<f64>().unwrap()).sum()
}

/// Returns the shortest time of several runs, s, and the last result.
fn timed<T>(run: impl Fn() -> T) -> (f64, T) {
    let began = Instant::now();
    let mut best = f64::INFINITY;
    for runs in 1.. {
        let start = worked_s();
        let result = std::hint::black_box(run());
        best = best.min(worked_s() - start);
        if runs >= RUNS && (began.elapsed() > TIME || runs >= 20 * RUNS) {
            return (best, result);
        }
    }
    unreachable!("the loop ends by returning")
}

/// Returns the points of a file.
fn read(path: &Path) -> PointCloud {
    let bytes = std::fs::read(path).unwrap();
    let number = |at: &[u8]| f64::from_le_bytes(at.try_into().unwrap());
    let points = bytes.chunks_exact(24).map(|p| [number(&p[..8]), number(&p[8..16]), number(&p[16..])]);
    PointCloud::new(Frame::Camera, points.collect())
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

/// Writes a mesh's vertices and triangles, and tells how many these are and their area.
fn written(mesh: &TriangleMesh, name: &str, folder: &Path) -> String {
    let places: Vec<u8> = mesh.vertices_mm().iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    std::fs::write(folder.join(format!("{name}.vertices.f64")), places).unwrap();
    let corners: Vec<u8> = mesh.triangles().iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    std::fs::write(folder.join(format!("{name}.triangles.u32")), corners).unwrap();
    figures([mesh.triangles().len() as f64, mesh.area_mm2()])
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
            (time, written(&surface.mesh, operation, folder))
        }
        "smoothed" => {
            // Smoothing asks how sure points are of each other: all alike, which tells nothing.
            let alike = cloud.clone().with_sigmas_mm(vec![1.0; cloud.len()]).unwrap();
            let options = SurfaceOptions { smooth: true, ..SurfaceOptions::default() };
            let (time, surface) = timed(|| triangulate(&alike, &options).unwrap());
            (time, written(&surface.mesh, operation, folder))
        }
        "outliers" => {
            let (time, outliers) = timed(|| sparse_outliers(cloud, 3.0).unwrap());
            let bytes: Vec<u8> = outliers.iter().map(|outlier| u8::from(*outlier)).collect();
            std::fs::write(folder.join("outliers.u8"), bytes).unwrap();
            (time, String::new())
        }
        "icp" => {
            let other = read(&folder.join("other.f64"));
            // From two clouds to the pose: the surface of the one is part of it, as the other program's normals are.
            let (time, found) = timed(|| {
                let surface = triangulate(cloud, &SurfaceOptions::default()).unwrap();
                let target = SweepSurface::new(cloud, &surface).unwrap().unwrap();
                register_sweep(&other, &target, Start::Near(nalgebra::Isometry3::identity(), 5.0), 0.2)
                    .unwrap()
            });
            let pose = found.mesh_from_cloud.to_homogeneous();
            (time, figures(pose.transpose().iter().copied()))
        }
        other => panic!("no operation {other}"),
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, operations @ ..] = &arguments[..] else {
        panic!("cloud_peers FOLDER OPERATION…");
    };
    let cloud = read(&Path::new(folder).join("cloud.f64"));
    for operation in operations {
        let (seconds, told) = operate(&cloud, operation, Path::new(folder));
        println!("{operation} {seconds:.9}{told}");
    }
}
