//! Sigmas with the calibration's part: the true instrument is drawn anew for every artefact, and the 95 % intervals hold the truth
//! as often as they say.
//!
//! `just coverage` takes 1000 artefacts; the suite takes a few.

#![allow(clippy::print_stderr, reason = "the coverage found is told")]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use nalgebra::{DMatrix, DVector, Vector2, Vector3};
use rand::{RngExt, SeedableRng, rngs::StdRng};
use std::collections::BTreeMap;
use uw_calib::{Across, Calibration, GLOBALS, Instrument, Method, Statistics};
use uw_cloud::{
    CloudPoint, Frame, PointCloud, Shape, ShapeFit, ShapeOptions, SphereOptions, find_shapes, fit_sphere,
    relations,
};
use uw_geom::{Camera, Distortion, Fan, Galvo, Medium, Port, Scanner, galvo_frame};
use uwscan::Error;
use uwscan::pipeline::uncertainty::SharedErrors;

const WATER: f64 = 1.335;
/// Stripe noise, px.
const NOISE_PX: f64 = 0.06;
/// Three balls of the artefact: centre and radius, mm.
const BALLS: [([f64; 3], f64); 3] =
    [([60.0, -55.0, 960.0], 30.2), ([-65.0, -15.0, 990.0], 30.166), ([15.0, 65.0, 945.0], 25.0)];
/// Two-sided 95 % of a Gaussian.
const INTERVAL: f64 = 1.959_964;

/// The paper's instrument, roughly; nothing is square.
fn scanner() -> Scanner {
    let port = |x: f64, y: f64, distance_mm: f64| {
        let normal = Vector3::new(x, y, (1.0 - x * x - y * y).sqrt());
        Port::new(normal, distance_mm, 8.0, Medium::of_index(1.52)).unwrap()
    };
    let normal = Vector3::new(0.45f64.cos(), 0.0, 0.45f64.sin());
    let axis = (Vector3::new(430.0, 3.0, -13.0), Vector3::new(0.008, -1.0, -0.002));
    let (origin_mm, axes) = galvo_frame(&axis.0, &axis.1, &normal, &Vector3::z()).unwrap();
    let distortion = Distortion { k1: -0.19, k2: 0.06, p1: -6e-4, p2: -3e-4, k3: 0.01 };
    let fan = Fan {
        apex_mm: Vector3::new(2.0, 0.3, -90.0),
        tilt_rad: 0.004,
        mirror_offset_mm: 0.2,
        mirror_normal_rad: 0.8,
    };
    let galvo =
        Galvo { origin_mm, axes, radians_per_volt: 0.035, quadratic: 2e-6, cubic: -1e-6, reference_v: -1.6 };
    Scanner {
        camera: Camera { fx: 1416.0, fy: 1422.0, cx: 388.0, cy: 279.0, distortion },
        camera_port: port(-0.004, 0.003, 9.8),
        galvo,
        fan,
        laser_port: port(-0.005, 0.004, 35.0),
    }
}

/// Standard deviations of the parameters as a calibration in air and water leaves them, in the order of `uw_calib::NAMES`.
const SIGMAS: [f64; GLOBALS] = [
    0.05, 0.05, 0.05, 0.05, 1e-4, 5e-4, 3e-6, 3e-6, 1e-3, 4e-5, 4e-5, 0.05, 0.05, 5e-4, 1e-4, 1e-10, 4e-5,
    1e-4, 0.05, 0.05, 5e-4, 1e-5, 1e-4, 1e-4, 0.05, 0.05, 0.1, 0.05, 0.1, 1e-4, 0.05, 1e-6, 2e-7, 4e-8,
];

/// A calibration whose covariance is A Aᵀ, with its correlations, and A.
fn calibration() -> (Calibration, DMatrix<f64>) {
    let mut random = StdRng::seed_from_u64(2);
    let mixed = DMatrix::from_fn(GLOBALS, GLOBALS, |i, j| {
        let share = (random.random::<f64>() - 0.5) / (GLOBALS as f64).sqrt() * 2.0;
        SIGMAS[i] * (share + if i == j { 1.0 } else { 0.0 })
    });
    let calibration = Calibration {
        method: Method::Joint,
        instrument: Instrument { scanner: scanner(), water_offset: 0.0, dispersion_offset: 0.0 },
        covariance: Some(&mixed * mixed.transpose()),
        nominal_water_index: Some(WATER),
        across: Across::U,
        image_size: [768, 576],
        statistics: Statistics::default(),
        warnings: Vec::new(),
    };
    (calibration, mixed)
}

fn gauss(random: &mut StdRng) -> f64 {
    // Box and Muller.
    let (a, b): (f64, f64) = (1.0 - random.random::<f64>(), random.random());
    (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

/// The artefact as the true instrument shows it and the calibrated one measures it.
fn scan(truth: &Instrument, calibrated: &Scanner, frame: Frame, random: &mut StdRng) -> PointCloud {
    scan_traced_in(WATER, truth, calibrated, frame, random)
}

/// The same with light traced as in water of another index.
fn scan_traced_in(
    index: f64,
    truth: &Instrument,
    calibrated: &Scanner,
    frame: Frame,
    random: &mut StdRng,
) -> PointCloud {
    let outside = Medium::of_index(WATER + truth.water_offset);
    let nominal = Medium::of_index(index);
    let mut points = Vec::new();
    // From beside the artefact to beside it.
    for row in 0..220 {
        let voltage = -3.0 + 0.018 * f64::from(row);
        let sheet = truth.scanner.sheet(voltage, outside);
        let exposure = calibrated.exposure(voltage, nominal).unwrap();
        for step in -50..=50 {
            let Ok(ray) = sheet.ray(0.002 * f64::from(step)) else { continue };
            let hit = BALLS.iter().filter_map(|&(center, radius)| {
                let arm = ray.origin - Vector3::from(center);
                let along = ray.direction.normalize();
                let (half, rest) = (arm.dot(&along), arm.norm_squared() - radius * radius);
                let root = half * half - rest;
                let point = ray.origin + along * (-half - root.max(0.0).sqrt());
                // Not beyond what the camera sees, nor where light only grazes.
                let normal = (point - Vector3::from(center)) / radius;
                let seen = normal.dot(&point.normalize()) < -0.3 && normal.dot(&along) < -0.3;
                (root > 0.0 && seen).then_some(point)
            });
            let Some(point) = hit.min_by(|a, b| a.z.total_cmp(&b.z)) else { continue };
            let pixel = truth.scanner.project(&point, outside).unwrap();
            let pixel =
                Vector2::new(pixel.x + NOISE_PX * gauss(random), pixel.y).map(|x| f64::from(x as f32));
            let met = exposure.triangulate_with_derivatives(&pixel).unwrap();
            let along = met.per_u * NOISE_PX;
            let covariance = along * along.transpose();
            points.push(CloudPoint {
                position_mm: met.point_mm.into(),
                intensity: 100.0,
                frame_row: row as u32,
                pixel: [pixel.x as f32, pixel.y as f32],
                sigma_mm: along.norm() as f32,
                covariance_mm2: [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
                    .map(|at| covariance[at] as f32),
                shared_mm: None,
            });
        }
    }
    let cloud = PointCloud::from_points(Frame::Camera, &points);
    match frame {
        Frame::Camera => cloud,
        Frame::Galvo => cloud.transformed(Frame::Galvo, &calibrated.camera_from_galvo().inverse().isometry()),
    }
}

/// The points nearest to one of the balls.
fn part(cloud: &PointCloud, ball: usize) -> PointCloud {
    let off = |p: &[f64; 3], ball: usize| {
        let (center, radius) = BALLS[ball];
        ((Vector3::from(*p) - Vector3::from(center)).norm() - radius).abs()
    };
    let of_ball = |p: &[f64; 3]| (0..BALLS.len()).all(|other| off(p, ball) <= off(p, other));
    let points: Vec<CloudPoint> = (0..cloud.len())
        .filter(|&i| of_ball(&cloud.positions_mm()[i]))
        .map(|i| CloudPoint {
            position_mm: cloud.positions_mm()[i],
            intensity: 100.0,
            frame_row: cloud.frame_rows().unwrap()[i],
            pixel: cloud.pixels().unwrap()[i],
            sigma_mm: cloud.sigmas_mm().unwrap()[i],
            covariance_mm2: cloud.covariances_mm2().unwrap()[i],
            shared_mm: None,
        })
        .collect();
    PointCloud::from_points(cloud.frame(), &points)
}

/// Number of artefacts whose interval held the truth, by figure: with the calibration's part, and without.
type Held = BTreeMap<String, [usize; 2]>;

fn count(held: &mut Held, figure: &str, error: f64, sigmas: [f64; 2]) {
    let counts = held.entry(figure.to_owned()).or_default();
    for (count, sigma) in counts.iter_mut().zip(sigmas) {
        *count += usize::from(error.abs() <= INTERVAL * sigma);
    }
}

#[test]
fn intervals_hold_the_truth_as_often_as_they_say() {
    let artefacts: usize = std::env::var("UWSCAN_ARTEFACTS").ok().map_or(60, |n| n.parse().unwrap());
    let (calibration, root) = calibration();
    let calibrated = *calibration.scanner();
    let mut random = StdRng::seed_from_u64(17);
    let mut held = Held::new();
    for artefact in 0..artefacts {
        let draw = &root * DVector::from_fn(GLOBALS, |_, _| gauss(&mut random));
        let truth = calibration.instrument.moved(&std::array::from_fn(|i| draw[i]));
        let cloud = scan(&truth, &calibrated, Frame::Camera, &mut random);
        let mut causes = Vec::new();
        let mut shapes = Vec::new();
        for (ball, (true_center, true_radius)) in BALLS.into_iter().enumerate() {
            let cloud = part(&cloud, ball);
            assert!(cloud.len() > 300, "ball {ball} of artefact {artefact}: {} points", cloud.len());
            let options = SphereOptions { seed: artefact as u64, ..SphereOptions::default() };
            let fit = fit_sphere(&cloud, &options).unwrap();
            let mut shared = SharedErrors::new(&cloud, &calibration).unwrap();
            assert!((shared.index() - WATER).abs() < 1e-6);
            let part = shared.of(&fit.influence).unwrap();
            let total = &part * part.transpose();
            let total = |i: usize| (total[(i, i)] + fit.covariance_mm2[(i, i)]).sqrt();
            causes.push(part);
            count(
                &mut held,
                &format!("radius {ball}"),
                fit.radius_mm - true_radius,
                [total(3), fit.sigma_radius_mm],
            );
            count(
                &mut held,
                &format!("centre z {ball}"),
                fit.center_mm[2] - true_center[2],
                [total(2), fit.sigma_center_mm[2]],
            );
            shapes.push(Shape { fit: ShapeFit::Sphere(fit), points: Vec::new() });
        }
        for relation in relations(&cloud, &shapes, Some(&causes)).distances_mm {
            let [a, b] = [relation.a, relation.b].map(|i| Vector3::from(BALLS[i].0));
            count(
                &mut held,
                &format!("distance {}-{}", relation.a, relation.b),
                relation.value - (a - b).norm(),
                [relation.sigma_total.unwrap(), relation.sigma],
            );
        }
    }
    // 95 % of n: the binomial's standard deviation, as a share.
    let sigma = (0.95 * 0.05 / artefacts as f64).sqrt();
    eprintln!("{artefacts} artefacts; 95 % ± {:.1} % (binomial, 95 % of the time)", 100.0 * INTERVAL * sigma);
    for (figure, counts) in &held {
        let [total, own] = counts.map(|n| n as f64 / artefacts as f64);
        eprintln!(
            "  {figure:<13} {:5.1} % with the calibration, {:5.1} % without",
            100.0 * total,
            100.0 * own
        );
        // The bar of 92 to 98 %, or what chance allows so few artefacts.
        let slack = (3.7 * sigma).max(0.03);
        assert!((total - 0.95).abs() <= slack, "{figure}: {total}");
    }
    let own: Vec<f64> = held.values().map(|n| n[1] as f64 / artefacts as f64).collect();
    assert!(own.iter().any(|&share| share < 0.8), "the calibration's part matters here: {own:?}");
}

#[test]
fn the_galvanometers_frame_moves_with_the_calibration() {
    let (calibration, _) = calibration();
    let calibrated = *calibration.scanner();
    let truth = calibration.instrument;
    let radius = |frame| {
        let cloud = scan(&truth, &calibrated, frame, &mut StdRng::seed_from_u64(5));
        let found = find_shapes(&cloud, &ShapeOptions::default()).unwrap();
        let mut shared = SharedErrors::new(&cloud, &calibration).unwrap();
        let mut parts: Vec<_> = found
            .shapes
            .iter()
            .map(|s| shared.total(&s.fit.covariance(), s.fit.influence()).unwrap())
            .collect();
        parts.sort_by(|a, b| a[(3, 3)].total_cmp(&b[(3, 3)]));
        parts
            .iter()
            .map(|c| (c[(3, 3)].sqrt(), c.fixed_view::<3, 3>(0, 0).trace().sqrt()))
            .collect::<Vec<_>>()
    };
    let (camera, galvo) = (radius(Frame::Camera), radius(Frame::Galvo));
    for ((camera_radius, camera_place), (galvo_radius, galvo_place)) in camera.into_iter().zip(galvo) {
        assert!((camera_radius / galvo_radius - 1.0).abs() < 0.02, "a size knows no frame");
        assert!(
            (camera_place / galvo_place - 1.0).abs() > 0.02,
            "a place does: {camera_place} {galvo_place}"
        );
    }
}

#[test]
fn clouds_of_other_calibrations_are_refused() {
    let (calibration, _) = calibration();
    let cloud =
        scan(&calibration.instrument, calibration.scanner(), Frame::Camera, &mut StdRng::seed_from_u64(5));
    let mut other = calibration.clone();
    other.instrument.scanner.camera.fx *= 1.001;
    assert!(matches!(SharedErrors::new(&cloud, &other), Err(Error::OtherCalibration { .. })));
    let mut without = calibration.clone();
    without.covariance = None;
    assert!(matches!(SharedErrors::new(&cloud, &without), Err(Error::NoCovariance)));
    let bare = PointCloud::new(Frame::Camera, cloud.positions_mm().to_vec());
    assert!(matches!(SharedErrors::new(&bare, &calibration), Err(Error::NoPixels)));
    // Another galvanometer shows in the points' distances from the sheets.
    let mut turned = calibration.clone();
    turned.instrument.scanner.fan.tilt_rad += 0.01;
    let found = find_shapes(&cloud, &ShapeOptions::default()).unwrap();
    let refused = SharedErrors::new(&cloud, &turned).unwrap().of(found.shapes[0].fit.influence());
    assert!(matches!(refused, Err(Error::OtherCalibration { miss_mm }) if miss_mm > 0.01), "{refused:?}");
}

/// An index that reconstruct was given has its own error, whatever the calibration thinks of its water: what it does to a ball's place is that of tracing the same pixels
/// with another index.
#[test]
fn an_index_that_was_given_is_as_uncertain_as_it_is_said_to_be() {
    const STEP: f64 = 1e-4;
    let (calibration, _) = calibration();
    let traced = |index: f64| {
        let mut random = StdRng::seed_from_u64(7);
        let (truth, calibrated) = (&calibration.instrument, calibration.scanner());
        part(&scan_traced_in(index, truth, calibrated, Frame::Camera, &mut random), 0)
    };
    let cloud = traced(WATER);
    let fit = fit_sphere(&cloud, &SphereOptions::default()).unwrap();
    let variance = |mut shared: SharedErrors<'_>| {
        let part = shared.of(&fit.influence).unwrap();
        (&part * part.transpose())[(2, 2)]
    };
    let shared = || SharedErrors::new(&cloud, &calibration).unwrap();
    let [exact, once, twice] = [0.0, STEP, 2.0 * STEP].map(|s| variance(shared().with_index_known_to(s)));
    assert!(((twice - exact) / (once - exact) - 4.0).abs() < 1e-6, "{exact} {once} {twice}");
    let moved = fit_sphere(&traced(WATER + STEP), &SphereOptions::default()).unwrap();
    let by_difference = moved.center_mm[2] - fit.center_mm[2];
    let ratio = (once - exact).sqrt() / by_difference.abs();
    // Which points are outliers, and the noise floor, may change with the step.
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}, {by_difference} mm");
    assert_eq!(shared().other_index(), None);
    let elsewhere = traced(WATER + 0.006);
    let known = SharedErrors::new(&elsewhere, &calibration).unwrap().other_index();
    assert!(known.is_some_and(|known| (known - WATER).abs() < 1e-12), "{known:?}");
}
