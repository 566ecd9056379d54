//! Shapes found in scenes drawn at random: balls and pipes of any size and pose before a floor, as the scanner sees them. What is there is found, nothing else is, and
//! figures are off by what their sigmas say.
//!
//! `UWSCAN_SCENES=1000 cargo test -p uw-cloud hunts -- --nocapture` takes as many; the suite takes a few.

#![allow(clippy::print_stderr, reason = "the rates found are told")]

use crate::scene::{BASELINE_MM, FOCAL_PX, Line, gauss, random, uniform};
use nalgebra::Vector3;
use rand::rngs::StdRng;
use uw_cloud::{Frame, PointCloud, ShapeFit, ShapeOptions, find_shapes};

/// Points of an object that is expected to be found.
const ENOUGH: usize = 400;
/// A figure off by more of its sigmas is wrong: once in 150 000 by chance.
const SIGMAS: f64 = 4.5;

/// Objects that may be missed, small ones mostly and those that noise blurs, and shapes that may be none or wrong, by the objects that are there.
const MISSED: f64 = 0.05;
const FALSE: f64 = 0.01;

#[derive(Debug, Clone, Copy)]
enum Object {
    Ball { center: Vector3<f64>, radius: f64 },
    Pipe { middle: Vector3<f64>, axis: Vector3<f64>, half: f64, radius: f64 },
    Floor { normal: Vector3<f64>, anchor: Vector3<f64> },
}

impl Object {
    /// Depth at which a line of light first meets it.
    fn meets(&self, line: Line) -> Option<f64> {
        let (start, way) = (Vector3::new(-BASELINE_MM, 0.0, 0.0), Vector3::new(line.slope, line.row, 1.0));
        let first = |arm: Vector3<f64>, way: Vector3<f64>, radius: f64| {
            let half = arm.dot(&way) / way.norm_squared();
            let root = half * half - (arm.norm_squared() - radius * radius) / way.norm_squared();
            (root >= 0.0).then(|| -half - root.sqrt())
        };
        match self {
            Self::Ball { center, radius } => first(start - center, way, *radius),
            Self::Pipe { middle, axis, half, radius } => {
                let flat = |v: Vector3<f64>| v - axis * axis.dot(&v);
                let z = first(flat(start - middle), flat(way), *radius)?;
                (axis.dot(&(start + way * z - middle)).abs() <= *half).then_some(z)
            }
            Self::Floor { normal, anchor } => Some(normal.dot(&(anchor - start)) / normal.dot(&way)),
        }
    }

    /// The outward normal at a point of it, its length aside.
    fn outward(&self, point: &Vector3<f64>) -> Vector3<f64> {
        match self {
            Self::Ball { center, .. } => point - center,
            Self::Pipe { middle, axis, .. } => {
                let arm = point - middle;
                arm - axis * axis.dot(&arm)
            }
            Self::Floor { normal, .. } => *normal,
        }
    }

    /// Whether a fit is of it; `None` where it is of something else, else the worst figure in its sigmas.
    fn is_of(&self, fit: &ShapeFit) -> Option<f64> {
        match (self, fit) {
            (Self::Ball { center, radius }, ShapeFit::Sphere(fit)) => {
                let off = (Vector3::from(fit.center_mm) - center).norm();
                (off < 0.5 * radius).then(|| (fit.radius_mm - radius).abs() / fit.sigma_radius_mm)
            }
            (Self::Pipe { middle, axis, radius, .. }, ShapeFit::Cylinder(fit)) => {
                let along = Vector3::from(fit.axis_direction);
                let off = (Vector3::from(fit.axis_point_mm) - middle).cross(axis).norm();
                (along.cross(axis).norm() < 0.2 && off < 0.5 * radius)
                    .then(|| (fit.radius_mm - radius).abs() / fit.sigma_radius_mm)
            }
            (Self::Floor { normal, anchor }, ShapeFit::Plane(fit)) => {
                let own = Vector3::from(fit.normal);
                let off = (own.dot(anchor) + fit.offset_mm).abs();
                (own.cross(normal).norm() < 0.1 && off < 10.0)
                    .then(|| own.cross(normal).norm() / fit.sigma_normal_rad)
            }
            _ => None,
        }
    }
}

fn direction(random: &mut StdRng) -> Vector3<f64> {
    Vector3::from([0, 1, 2].map(|_| gauss(random))).normalize()
}

/// Objects that do not overlap in the sight's directions, and perhaps a floor behind them.
fn objects(random: &mut StdRng) -> Vec<Object> {
    let depth = uniform(random, 700.0, 1000.0);
    let mut all = Vec::new();
    if uniform(random, 0.0, 1.0) < 0.7 {
        let normal = (direction(random) * 0.3 - Vector3::z()).normalize();
        all.push(Object::Floor {
            normal,
            anchor: Vector3::new(0.0, 0.0, depth + uniform(random, 60.0, 120.0)),
        });
    }
    for place in [-70.0, 0.0, 70.0] {
        let at = Vector3::new(place, uniform(random, -20.0, 20.0), depth + uniform(random, -20.0, 20.0));
        match (uniform(random, 0.0, 3.0)) as u32 {
            0 => all.push(Object::Ball { center: at, radius: uniform(random, 10.0, 30.0) }),
            1 => {
                let axis = Vector3::new(0.2 * gauss(random), 1.0, 0.3 * gauss(random)).normalize();
                let (half, radius) = (uniform(random, 25.0, 60.0), uniform(random, 10.0, 28.0));
                all.push(Object::Pipe { middle: at, axis, half, radius });
            }
            _ => {}
        }
    }
    all
}

/// What the scanner measures of them, and which object each point is of.
fn measured(objects: &[Object], sigma_px: f64, random: &mut StdRng) -> (PointCloud, Vec<usize>) {
    let (mut points, mut covariances, mut of) = (Vec::new(), Vec::new(), Vec::new());
    let step = uniform(random, 1.2e-3, 2.4e-3);
    let sheets = (0.36 / step) as i32;
    for sheet in 0..sheets {
        for row in -90..=90 {
            let line = Line { slope: 0.29 + step * f64::from(sheet), row: f64::from(row) * 1.2 / FOCAL_PX };
            let met = objects.iter().enumerate().filter_map(|(i, object)| object.meets(line).map(|z| (z, i)));
            let Some((z, i)) = met.min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
            let point = Vector3::from(line.at(z));
            let outward = objects[i].outward(&point).normalize();
            let way = Vector3::new(line.slope, line.row, 1.0).normalize();
            // Neither the sight nor the light grazes more than the pipeline lets pass.
            let hidden = objects.iter().enumerate().any(|(j, other)| j != i && hides(other, &point));
            if outward.dot(&point.normalize()) > -0.15 || outward.dot(&way) > -0.15 || hidden {
                continue;
            }
            let (position, covariance) = line.measured(z, sigma_px * gauss(random), sigma_px);
            points.push(position);
            covariances.push(covariance);
            of.push(i);
        }
    }
    (PointCloud::new(Frame::Camera, points).with_covariances_mm2(covariances).expect("one a point"), of)
}

/// Whether an object lies between the camera and a point.
fn hides(object: &Object, point: &Vector3<f64>) -> bool {
    let between = |center: &Vector3<f64>, radius: f64| {
        let share = (center.dot(point) / point.norm_squared()).clamp(0.0, 1.0);
        (point * share - center).norm() < radius && (point * share).norm() < point.norm() - 1.0
    };
    match object {
        Object::Ball { center, radius } => between(center, *radius),
        Object::Pipe { middle, axis, half, radius } => {
            (-20..=20).any(|k| between(&(middle + axis * (half * f64::from(k) / 20.0)), *radius))
        }
        Object::Floor { .. } => false,
    }
}

#[test]
fn random_scenes_are_found_whole_and_nothing_else() {
    let scenes: u64 = std::env::var("UWSCAN_SCENES").ok().map_or(24, |n| n.parse().expect("a number"));
    let (mut there, mut missed, mut extra, mut wrong) = (0, Vec::new(), Vec::new(), Vec::new());
    for seed in 0..scenes {
        let mut random = random(5000 + seed);
        let objects = objects(&mut random);
        let sigma_px = uniform(&mut random, 0.03, 0.2);
        let (cloud, of) = measured(&objects, sigma_px, &mut random);
        if cloud.len() < ENOUGH {
            continue;
        }
        let found = find_shapes(&cloud, &ShapeOptions::default()).expect("finite points");
        let mut taken = vec![0; objects.len()];
        for shape in &found.shapes {
            let own = objects.iter().enumerate().find_map(|(i, object)| Some((i, object.is_of(&shape.fit)?)));
            match own {
                Some((i, sigmas)) => {
                    taken[i] += 1;
                    if sigmas > SIGMAS {
                        wrong.push(format!("{seed}: {:?} off by {sigmas:.1} sigmas", objects[i]));
                    }
                    if taken[i] > 1 {
                        extra.push(format!("{seed}: {:?} found again", objects[i]));
                    }
                }
                None => extra.push(format!(
                    "{seed}: a {} of {} points, {:.3} mm rms",
                    shape.fit.kind(),
                    shape.points.len(),
                    shape.fit.deviations().rms_mm
                )),
            }
        }
        for (i, object) in objects.iter().enumerate() {
            let points = of.iter().filter(|&&o| o == i).count();
            if points >= ENOUGH {
                there += 1;
                if taken[i] == 0 {
                    missed.push(format!("{seed}: {object:?} of {points} points, {sigma_px:.3} px"));
                }
            }
        }
    }
    eprintln!(
        "{scenes} scenes, {there} objects: {} missed, {} extra, {} wrong",
        missed.len(),
        extra.len(),
        wrong.len()
    );
    for line in missed.iter().chain(&extra).chain(&wrong) {
        eprintln!("  {line}");
    }
    let share = |count: usize| count as f64 / f64::from(there);
    assert!(share(missed.len()) <= MISSED, "{} missed", missed.len());
    assert!(
        share(extra.len()) <= FALSE && share(wrong.len()) <= FALSE,
        "{} extra, {} wrong",
        extra.len(),
        wrong.len()
    );
}
