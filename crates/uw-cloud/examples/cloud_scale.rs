//! How time and memory of each operation grow with a cloud, up to ten million points.
//!
//! `cargo run --release -p uw-cloud --example cloud_scale -- [larger] [POINTS…] [OPERATION…]`: operations are `tree`, `normals`, `outliers`, `thin`, `mesh` and `shapes`; all
//! without one. More points lie closer on the same scene, or as close on a larger one (`larger`). One process for all, from the smallest, so that the peak of memory is the largest's. A small cloud is run several times, and the shortest counts.

#![allow(clippy::print_stdout, reason = "the table of figures is what is asked for")]
#![allow(clippy::unwrap_used, reason = "a bench that can't run says so by stopping")]

#[path = "../../../benches/scan/mod.rs"]
mod scan;

use scan::Growth;
use std::time::Instant;
use uw_cloud as cloud;
use uw_cloud::{
    NORMAL_NEIGHBOURS, Neighbours, PointCloud, ShapeOptions, SurfaceOptions, find_shapes, normals,
    sparse_outliers, thinned, triangulate,
};

const OPERATIONS: [&str; 6] = ["tree", "normals", "outliers", "thin", "mesh", "shapes"];

/// Runs of an operation, and seconds after which there is no further one.
const RUNS: usize = 7;
const ENOUGH_S: f64 = 1.0;

/// Peak of the memory that the process has had, GiB, where the system tells (Linux).
fn peak_gib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|rest| rest.split_whitespace().next()?.parse::<f64>().ok());
    kib.unwrap_or(f64::NAN) / f64::from(1 << 20)
}

/// Seconds that this process's threads have had a processor, where the system tells (Linux): others at work on the machine do not count, all of this process's do.
fn worked_s() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return f64::NAN };
    let told = tasks.flatten().filter_map(|task| std::fs::read_to_string(task.path().join("schedstat")).ok());
    told.filter_map(|told| told.split_whitespace().next()?.parse::<f64>().ok()).map(|ns| 1e-9 * ns).sum()
}

/// Runs an operation and returns what came of it, counted.
fn run(operation: &str, cloud: &PointCloud) -> usize {
    match operation {
        "tree" => Neighbours::new(cloud.positions_mm()).unwrap().len(),
        "normals" => normals(cloud, NORMAL_NEIGHBOURS, &[0.0; 3]).unwrap().iter().flatten().count(),
        "outliers" => sparse_outliers(cloud, 3.0).unwrap().iter().filter(|outlier| **outlier).count(),
        "thin" => thinned(cloud, 1.0).len(),
        "mesh" => triangulate(cloud, &SurfaceOptions::default()).unwrap().mesh.triangles().len(),
        _ => find_shapes(cloud, &ShapeOptions::default()).unwrap().shapes.len(),
    }
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let mut sizes: Vec<usize> = words.iter().filter_map(|word| word.parse().ok()).collect();
    if sizes.is_empty() {
        sizes = vec![10_000, 100_000, 1_000_000, 10_000_000];
    }
    let growth = if words.iter().any(|word| word == "larger") { Growth::Larger } else { Growth::Finer };
    let named: Vec<&str> = OPERATIONS.into_iter().filter(|o| words.iter().any(|word| word == o)).collect();
    let operations = if named.is_empty() { OPERATIONS.to_vec() } else { named };
    println!("    points  operation          s   worked s  ns/(n log2 n)     result  peak GiB");
    for points in sizes {
        let cloud = scan::sweep(points, growth);
        let n = cloud.len() as f64;
        for operation in &operations {
            let (mut best, mut least, mut all, mut result) = (f64::INFINITY, f64::INFINITY, 0.0, 0);
            for _ in 0..RUNS {
                let (start, worked) = (Instant::now(), worked_s());
                result = run(operation, &cloud);
                let took = start.elapsed().as_secs_f64();
                (best, all, least) = (best.min(took), all + took, least.min(worked_s() - worked));
                if all > ENOUGH_S {
                    break;
                }
            }
            println!(
                "{:>10}  {operation:<9} {best:>10.4} {least:>10.4} {:>14.3} {result:>10} {:>9.2}",
                cloud.len(),
                1e9 * if least.is_finite() { least } else { best } / (n * n.log2()),
                peak_gib()
            );
        }
    }
}
