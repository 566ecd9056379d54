//! Clouds in which there is no sphere, plane or cylinder: noise, rough ground, surfaces of other forms. And clouds that are nothing but one,
//! exactly.

use crate::scene::{gauss, random, uniform};
use rand::rngs::StdRng;
use std::f64::consts::TAU;
use uw_cloud::{Frame, PointCloud, ShapeFit, ShapeOptions, Shapes, find_shapes};

/// Points of a cloud.
const POINTS: usize = 9000;
/// Noise of a point along the sight, mm, small against every form here.
const NOISE_MM: f64 = 0.03;

fn find(points: Vec<[f64; 3]>) -> Shapes {
    find_shapes(&PointCloud::new(Frame::Camera, points), &ShapeOptions::default()).expect("finite points")
}

fn told(found: &Shapes) -> Vec<String> {
    let of = |s: &uw_cloud::Shape| format!("{} of {} points", s.fit.kind(), s.points.len());
    found.shapes.iter().map(of).collect()
}

/// A height over 120 mm square, seen from above, 800 mm away, with noise.
fn seen(random: &mut StdRng, depth_mm: impl Fn(f64, f64) -> f64) -> Vec<[f64; 3]> {
    (0..POINTS)
        .map(|_| {
            let (x, y) = (uniform(random, -60.0, 60.0), uniform(random, -60.0, 60.0));
            [x, y, 800.0 + depth_mm(x, y) + NOISE_MM * gauss(random)]
        })
        .collect()
}

/// Rough ground: waves of all lengths from 120 mm to 4 mm in all directions, each as high as its length allows at a given steepness.
fn ground(random: &mut StdRng, steepness: f64) -> impl Fn(f64, f64) -> f64 + use<> {
    let waves: Vec<[f64; 4]> = (0..60)
        .map(|i| {
            let length = 120.0 * (4.0_f64 / 120.0).powf(f64::from(i) / 59.0);
            let turn = uniform(random, 0.0, TAU);
            let number = TAU / length;
            [number * turn.cos(), number * turn.sin(), uniform(random, 0.0, TAU), steepness / number / 5.0]
        })
        .collect();
    move |x, y| waves.iter().map(|[a, b, phase, height]| height * (a * x + b * y + phase).sin()).sum()
}

#[test]
fn points_at_random_hold_no_shape() {
    for seed in 0..6 {
        let mut random = random(seed);
        let mut box_of = |half: [f64; 3]| {
            (0..6000)
                .map(|_| half.map(|h| uniform(&mut random, -h, h)))
                .map(|p| [p[0], p[1], p[2] + 800.0])
                .collect()
        };
        for half in [[50.0; 3], [80.0, 40.0, 20.0]] {
            let found = find(box_of(half));
            assert!(found.shapes.is_empty(), "seed {seed}: {:?}", told(&found));
            assert_eq!(found.unassigned_points, 6000);
        }
    }
}

#[test]
fn rough_ground_holds_no_shape() {
    for seed in 0..8 {
        let mut random = random(100 + seed);
        for steepness in [0.3, 1.0] {
            let ground = ground(&mut random, steepness);
            let found = find(seen(&mut random, ground));
            assert!(found.shapes.is_empty(), "seed {seed}, steepness {steepness}: {:?}", told(&found));
        }
    }
}

/// Free forms, each far from its best sphere, plane or cylinder in terms of the noise.
#[test]
fn other_surfaces_hold_no_shape() {
    type Depth = fn(f64, f64) -> f64;
    let forms: [(&str, Depth); 6] = [
        ("a saddle", |x, y| (x * x - y * y) / 120.0),
        ("an egg carton", |x, y| 3.0 * (x / 9.0).sin() * (y / 11.0).sin()),
        ("a paraboloid of two curvatures", |x, y| (x * x + 2.5 * y * y) / 160.0),
        ("a wave that swells", |x, y| (3.0 + 0.02 * x) * (y / 8.0).sin() * 1.5),
        ("a cubic", |x, y| (x * x * x + y * y * x) / 9000.0),
        ("a ring wave", |x, y| 4.0 * (x.hypot(y) / 7.0).cos()),
    ];
    for seed in 0..4 {
        for (name, form) in forms {
            let mut random = random(200 + seed);
            let found = find(seen(&mut random, form));
            assert!(found.shapes.is_empty(), "{name}, seed {seed}: {:?}", told(&found));
        }
    }
}

/// As exact as numbers are: nothing but rounding lies off the shape, and rounding has any pattern.
#[test]
fn exact_shapes_are_found() {
    let at = |i: usize| (f64::from(i as u32) * 2.399_963, (f64::from(i as u32) + 0.5) / 3000.0);
    let ball = |i| {
        let (t, share) = at(i);
        let (z, r) = (-share, (1.0 - share * share).sqrt());
        [20.0 * r * t.cos(), 20.0 * r * t.sin(), 700.0 + 20.0 * z]
    };
    let pipe = |i| {
        let (t, share) = at(i);
        let turn = 0.5 * TAU + 0.4 * TAU * (t / TAU).fract();
        [100.0 * share, 30.0 * turn.cos(), 700.0 + 30.0 * turn.sin()]
    };
    let plate = |i| {
        let (t, share) = at(i);
        let (x, y) = (100.0 * share, 100.0 * (t / TAU).fract());
        [x, y, 700.0 + 0.2 * x - 0.1 * y]
    };
    for offset in [0.0, 1e5] {
        let cloud = |of: &dyn Fn(usize) -> [f64; 3]| (0..3000).map(|i| of(i).map(|c| c + offset)).collect();
        let found = |points: Vec<[f64; 3]>| {
            let options = ShapeOptions { sensor_mm: [offset; 3], ..ShapeOptions::default() };
            let found = find_shapes(&PointCloud::new(Frame::Camera, points), &options).unwrap();
            assert_eq!(found.shapes.len(), 1, "offset {offset}: {:?}", told(&found));
            assert!(found.unassigned_points < 30, "{}", found.unassigned_points);
            found.shapes[0].fit.clone()
        };
        // Coordinates near 1e5 are rounded to 1.5e-11 mm.
        let near = |value: f64, truth: f64| assert!((value - truth).abs() < 1e-8, "{value}, {truth} is true");
        match found(cloud(&ball)) {
            ShapeFit::Sphere(fit) => near(fit.radius_mm, 20.0),
            other => panic!("{}", other.kind()),
        }
        match found(cloud(&pipe)) {
            ShapeFit::Cylinder(fit) => near(fit.radius_mm, 30.0),
            other => panic!("{}", other.kind()),
        }
        match found(cloud(&plate)) {
            ShapeFit::Plane(fit) => near(fit.normal[0].abs(), 0.2 / 1.05_f64.sqrt()),
            other => panic!("{}", other.kind()),
        }
    }
}
