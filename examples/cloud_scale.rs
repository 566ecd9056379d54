//! How time and memory of shapes and meshes grow with a cloud, up to ten million points.
//!
//! `cargo run --release --example cloud_scale -- [POINTS…]`: one process for all, from the smallest, so that the peak of memory is the largest's.

#![allow(clippy::print_stdout, reason = "the table of figures is what is asked for")]
#![allow(clippy::unwrap_used, reason = "a bench that can't run says so by stopping")]

#[path = "../benches/scan/mod.rs"]
mod scan;

use std::time::Instant;
use uwscan::cloud::{ShapeOptions, SurfaceOptions, find_shapes, triangulate};

/// Peak of the memory that the process has had, GiB, where the system tells (Linux).
fn peak_gib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|rest| rest.split_whitespace().next()?.parse::<f64>().ok());
    kib.unwrap_or(f64::NAN) / f64::from(1 << 20)
}

fn main() {
    let asked: Vec<usize> = std::env::args().skip(1).map(|word| word.parse().unwrap()).collect();
    let asked = if asked.is_empty() { vec![10_000, 100_000, 1_000_000, 10_000_000] } else { asked };
    println!("    points   mesh s  ns/(n log2 n)  triangles   shapes s  ns/(n log2 n)  found  peak GiB");
    for points in asked {
        let cloud = scan::sweep(points);
        let n = cloud.len() as f64;
        let by_n_log_n = |seconds: f64| 1e9 * seconds / (n * n.log2());
        let start = Instant::now();
        let surface = triangulate(&cloud, &SurfaceOptions::default()).unwrap();
        let mesh = start.elapsed().as_secs_f64();
        let triangles = surface.mesh.triangles().len();
        drop(surface);
        let start = Instant::now();
        let found = find_shapes(&cloud, &ShapeOptions::default()).unwrap();
        let shapes = start.elapsed().as_secs_f64();
        println!(
            "{:>10} {mesh:>8.3} {:>14.2} {triangles:>10} {shapes:>10.3} {:>14.2} {:>6} {:>9.2}",
            cloud.len(),
            by_n_log_n(mesh),
            by_n_log_n(shapes),
            found.shapes.len(),
            peak_gib()
        );
    }
}
