//! Exact triangulation against a plain pinhole's, in the same run: what refraction at both windows costs.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Vector2, Vector3};
use std::hint::black_box;
use uw_geom::{Camera, Distortion, Fan, Galvo, GeomError, Medium, Plane, Port, Ray, Scanner, galvo_frame};

const VOLTAGE: f64 = 0.7;
const ROWS: usize = 576;

/// An instrument like the paper's, windows half a degree off and with a lens that distorts.
fn scanner() -> Result<Scanner, GeomError> {
    let glass = Medium::of_index(1.4906);
    let plane_normal = Vector3::new(0.45f64.cos(), 0.0, 0.45f64.sin());
    let (origin_mm, axes) =
        galvo_frame(&Vector3::new(430.0, 0.0, -13.0), &-Vector3::y(), &plane_normal, &Vector3::z())?;
    let tilted = |x: f64, y: f64| Vector3::new(x, y, (1.0 - x * x - y * y).sqrt());
    Ok(Scanner {
        camera: Camera {
            fx: 1416.0,
            fy: 1422.0,
            cx: 388.0,
            cy: 279.0,
            distortion: Distortion { k1: -0.19, k2: 0.06, p1: -6e-4, p2: -3e-4, k3: 0.0 },
        },
        camera_port: Port::new(tilted(-0.004, 0.003), 9.8, 8.0, glass)?,
        galvo: Galvo {
            origin_mm,
            axes,
            radians_per_volt: 2f64.to_radians(),
            quadratic: 0.0,
            cubic: 0.0,
            reference_v: 0.0,
        },
        fan: Fan {
            apex_mm: Vector3::new(0.0, 0.3, -90.0),
            tilt_rad: 0.002,
            mirror_offset_mm: 0.1,
            mirror_normal_rad: 0.8,
        },
        laser_port: Port::new(tilted(-0.005, 0.004), 35.0, 8.0, glass)?,
    })
}

/// The stripe of an object 800 mm away: a pixel a row.
fn stripe(scanner: &Scanner, water: Medium) -> Result<Vec<Vector2<f64>>, GeomError> {
    let sheet = scanner.sheet(VOLTAGE, water);
    (0..ROWS)
        .map(|row| {
            let along = (row as f64 / ROWS as f64 - 0.5) * 0.35;
            let ray = sheet.ray(along)?;
            scanner.project(&ray.at((800.0 - ray.origin.z) / ray.direction.z), water)
        })
        .collect()
}

fn triangulation(c: &mut Criterion) {
    let water = Medium::of_index(1.3351);
    let scanner = scanner().expect("the instrument is sound");
    let pixels = stripe(&scanner, water).expect("the stripe is in sight");
    let plane: Plane = scanner.sheet(VOLTAGE, water).middle_plane().expect("the sheet has a middle");

    let mut group = c.benchmark_group("triangulation");
    group.throughput(Throughput::Elements(ROWS as u64));
    // What a scanner in air without windows would do: undistort, intersect with a plane.
    group.bench_function("plain_pinhole_plane", |b| {
        b.iter(|| {
            for pixel in &pixels {
                let point = scanner.camera.unproject(black_box(pixel)).ok().and_then(|d| {
                    let ray = Ray { origin: Vector3::zeros(), direction: d };
                    plane.distance_along(&ray).map(|t| ray.at(t))
                });
                black_box(point);
            }
        });
    });
    // The sheet is made ready once an image: part of the time measured.
    group.bench_function("exact", |b| {
        b.iter(|| {
            let exposure = scanner.exposure(black_box(VOLTAGE), water);
            for pixel in &pixels {
                black_box(exposure.as_ref().map(|e| e.triangulate(black_box(pixel))).ok());
            }
        });
    });
    group.bench_function("exact_with_derivatives", |b| {
        b.iter(|| {
            let exposure = scanner.exposure(black_box(VOLTAGE), water);
            for pixel in &pixels {
                black_box(exposure.as_ref().map(|e| e.triangulate_with_derivatives(black_box(pixel))).ok());
            }
        });
    });
    group.bench_function("exact_sheet_not_prepared", |b| {
        b.iter(|| {
            for pixel in &pixels {
                black_box(scanner.triangulate(black_box(pixel), black_box(VOLTAGE), water).ok());
            }
        });
    });
    group.finish();

    let points: Vec<Vector3<f64>> =
        pixels.iter().filter_map(|p| scanner.triangulate(p, VOLTAGE, water).ok()).collect();
    assert_eq!(points.len(), ROWS);
    let mut group = c.benchmark_group("forward_projection");
    group.throughput(Throughput::Elements(ROWS as u64));
    group.bench_function("plain_pinhole", |b| {
        b.iter(|| {
            for point in &points {
                black_box(scanner.camera.project(black_box(point)).ok());
            }
        });
    });
    group.bench_function("exact", |b| {
        b.iter(|| {
            for point in &points {
                black_box(scanner.project(black_box(point), water).ok());
            }
        });
    });
    group.finish();
}

criterion_group!(geometry, triangulation);
criterion_main!(geometry);
