//! Shapes and meshes of a sweep, beside what anything with a cloud begins with, in the same run: its k-d tree, and normals at all of its points.

mod scan;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scan::Growth;
use std::hint::black_box;
use uwscan::cloud::{
    self, NORMAL_NEIGHBOURS, Neighbours, PointCloud, ShapeOptions, SphereOptions, SurfaceOptions,
    find_shapes, fit_sphere, normals, triangulate,
};

/// The paper's cover has as many.
const POINTS: usize = 36_000;

/// Returns what lies about the largest of the balls: three fifths of it are the ball's.
fn about_a_ball(cloud: &PointCloud) -> PointCloud {
    let near = |p: &[f64; 3]| (p[0] - 60.0).hypot(p[1] + 50.0) < 34.0;
    let chosen: Vec<usize> = (0..cloud.len()).filter(|&i| near(&cloud.positions_mm()[i])).collect();
    cloud.selected(&chosen)
}

fn clouds(c: &mut Criterion) {
    let cloud = scan::sweep(POINTS, Growth::Finer);
    let mut group = c.benchmark_group("clouds");
    group.sample_size(20).throughput(Throughput::Elements(cloud.len() as u64));
    group.bench_function("baseline: k-d tree", |b| {
        b.iter(|| Neighbours::new(black_box(cloud.positions_mm())));
    });
    group.bench_function("baseline: normals", |b| {
        b.iter(|| normals(black_box(&cloud), NORMAL_NEIGHBOURS, &[0.0; 3]));
    });
    group.bench_function("shapes", |b| b.iter(|| find_shapes(black_box(&cloud), &ShapeOptions::default())));
    group.bench_function("mesh", |b| b.iter(|| triangulate(black_box(&cloud), &SurfaceOptions::default())));
    let smooth = SurfaceOptions { smooth: true, ..SurfaceOptions::default() };
    group.bench_function("mesh, smoothed", |b| b.iter(|| triangulate(black_box(&cloud), &smooth)));
    group.bench_function("no sphere: most points lie on the plate", |b| {
        b.iter(|| fit_sphere(black_box(&cloud), &SphereOptions::default()).expect_err("refused"));
    });
    let ball = about_a_ball(&cloud);
    group.throughput(Throughput::Elements(ball.len() as u64));
    group.bench_function("fit of a sphere, cut out with some of the plate", |b| {
        b.iter(|| fit_sphere(black_box(&ball), &SphereOptions::default()).expect("the ball"));
    });
    group.finish();
}

criterion_group!(benches, clouds);
criterion_main!(benches);
