//! Clouds moved away and brought back, and what cannot be brought back.

use crate::scene::{gauss, random};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rand::rngs::StdRng;
use uw_cloud::{Frame, NearestOnMesh, PointCloud, RegisterError, Start, TriangleMesh, compare, register};

/// Noise of the points along z, mm.
const SIGMA_MM: f64 = 0.05;

/// A relief that no motion maps onto itself.
fn relief(x: f64, y: f64) -> f64 {
    900.0 + 6.0 * (x / 17.0).sin() + 5.0 * (y / 13.0 + x / 40.0).cos() + 0.002 * x * y
}

/// A fine mesh of a height field over ± 60 mm, facing −z.
fn mesh(height: impl Fn(f64, f64) -> f64) -> TriangleMesh {
    const SIDE: u32 = 241;
    let at = |i: u32| f64::from(i) * 0.5 - 60.0;
    let vertices =
        (0..SIDE * SIDE).map(|n| (at(n / SIDE), at(n % SIDE))).map(|(x, y)| [x, y, height(x, y)]).collect();
    let cells = (0..SIDE - 1).flat_map(|i| (0..SIDE - 1).map(move |j| i * SIDE + j));
    let triangles = cells.flat_map(|n| [[n, n + 1, n + SIDE], [n + 1, n + SIDE + 1, n + SIDE]]).collect();
    TriangleMesh::new(Frame::Camera, vertices, triangles).expect("corners are vertices")
}

/// Noisy points of a height field, with their covariances, moved by the inverse of a pose.
fn cloud(height: impl Fn(f64, f64) -> f64, pose: &Isometry3<f64>, random: &mut StdRng) -> PointCloud {
    let mut points = Vec::new();
    for i in 0..50 {
        for j in 0..80 {
            let (x, y) = (f64::from(i) * 1.5 - 37.0, f64::from(j) * 0.9 - 36.0);
            points.push([x, y, height(x, y) + SIGMA_MM * gauss(random)]);
        }
    }
    let variance = (SIGMA_MM * SIGMA_MM) as f32;
    let covariances = vec![[0.0, 0.0, 0.0, 0.0, 0.0, variance]; points.len()];
    let cloud =
        PointCloud::new(Frame::Camera, points).with_covariances_mm2(covariances).expect("one a point");
    cloud.transformed(Frame::Camera, &pose.inverse())
}

fn pose(turn: [f64; 3], shift: [f64; 3]) -> Isometry3<f64> {
    // About the relief's middle, so that a turn is not a shift by its distance.
    let middle = Isometry3::translation(0.0, 0.0, 900.0);
    let rotation = UnitQuaternion::new(Vector3::from(turn));
    middle * Isometry3::from_parts(Vector3::from(shift).into(), rotation) * middle.inverse()
}

/// How far two poses bring the relief's middle and a place 40 mm beside it apart, mm.
fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let place = |p: &Isometry3<f64>, x: f64| p * b.inverse() * Point3::new(x, 0.5 * x, 900.0);
    [0.0, 40.0].iter().map(|&x| (place(a, x) - place(b, x)).norm()).fold(0.0, f64::max)
}

#[test]
fn a_relief_is_brought_back_to_within_what_is_told_of_it() {
    let reference = mesh(relief);
    let tree = NearestOnMesh::new(&reference).unwrap();
    let mut random = random(1);
    let mut chi2 = 0.0;
    const TRIALS: usize = 12;
    for _ in 0..TRIALS {
        let mut small = || gauss(&mut random);
        let truth = pose(
            [0.01 * small(), 0.01 * small(), 0.02 * small()],
            [0.8 * small(), 0.8 * small(), 0.5 * small()],
        );
        let cloud = cloud(relief, &truth, &mut random);
        let found = register(&cloud, &tree, Start::Near(Isometry3::identity(), 10.0), 0.5).unwrap();
        assert!(found.undetermined.is_empty() && found.overlap > 0.95, "{found:?}");
        let error = apart(&found.mesh_from_cloud, &truth);
        // 4000 points of 0.05 mm determine it to a few micrometres; tangents of slopes of about 0.4 cost threefold.
        assert!(error < 0.02, "{error} mm");
        assert!((found.rms_mm / SIGMA_MM - 0.95).abs() < 0.15, "{}", found.rms_mm);
        let middle = Vector3::new(0.0, 0.0, 900.0);
        let difference = (found.mesh_from_cloud * truth.inverse() * Point3::from(middle)).coords - middle;
        chi2 += difference.z.powi(2) / found.covariance[(5, 5)];
    }
    // 99.9 % of chi² of 12 degrees of freedom lies between these.
    assert!(
        (2.2..33.0).contains(&chi2),
        "the height's sigma is what it scatters by: chi² {chi2} of {TRIALS}"
    );
}

#[test]
fn outliers_and_a_part_beyond_the_mesh_have_no_say() {
    let reference = mesh(relief);
    let tree = NearestOnMesh::new(&reference).unwrap();
    let mut random = random(2);
    let truth = pose([0.005, -0.008, 0.01], [6.0, 1.0, 0.3]);
    let base = cloud(relief, &truth, &mut random);
    let mut points = base.positions_mm().to_vec();
    points.iter_mut().step_by(5).for_each(|p| p[2] -= 15.0 + 3.0 * gauss(&mut random).abs());
    let cloud = PointCloud::new(Frame::Camera, points);
    let found = register(&cloud, &tree, Start::Near(Isometry3::identity(), 12.0), 0.3).unwrap();
    assert!(apart(&found.mesh_from_cloud, &truth) < 0.05, "{found:?}");
    assert!((0.6..0.85).contains(&found.overlap), "a fifth is off: {}", found.overlap);
}

#[test]
fn what_slides_is_said_and_left_where_it_was() {
    let flat = mesh(|_, _| 900.0);
    let tree = NearestOnMesh::new(&flat).unwrap();
    let truth = pose([0.004, -0.003, 0.0], [0.7, 0.0, 0.4]);
    let found = register(
        &cloud(|_, _| 900.0, &truth, &mut random(3)),
        &tree,
        Start::Near(Isometry3::identity(), 10.0),
        0.5,
    );
    let found = found.unwrap();
    assert_eq!(found.undetermined.len(), 3, "two shifts and a turn: {:?}", found.undetermined);
    for motion in &found.undetermined {
        assert!(motion.turn[0].abs() + motion.turn[1].abs() + motion.shift[2].abs() < 0.1, "{motion:?}");
    }
    // What is determined is found: the height at the middle and the tilt.
    let moved = found.mesh_from_cloud * truth.inverse() * Point3::new(0.0, 0.0, 900.0);
    assert!((moved.z - 900.0).abs() < 0.01, "{moved}");
}

#[test]
fn any_pose_is_found_where_the_form_tells_it() {
    let reference = mesh(relief);
    let tree = NearestOnMesh::new(&reference).unwrap();
    let truth = pose([2.5, -1.0, 0.7], [-300.0, 120.0, 800.0]);
    let found = register(&cloud(relief, &truth, &mut random(4)), &tree, Start::Anywhere, 0.5).unwrap();
    assert!(apart(&found.mesh_from_cloud, &truth) < 0.02, "{found:?}");
}

#[test]
fn what_does_not_overlap_is_refused() {
    let reference = mesh(relief);
    let tree = NearestOnMesh::new(&reference).unwrap();
    let far = cloud(relief, &pose([0.0; 3], [400.0, 0.0, 0.0]), &mut random(5));
    let start = Start::Near(Isometry3::identity(), 10.0);
    assert!(matches!(register(&far, &tree, start, 0.2), Err(RegisterError::LittleOverlap { .. })));
    let few = PointCloud::new(Frame::Camera, vec![[0.0, 0.0, 900.0]; 5]);
    assert_eq!(register(&few, &tree, start, 0.2), Err(RegisterError::TooFewPoints { got: 5 }));
    let spot = PointCloud::new(Frame::Camera, vec![[0.0, 0.0, 900.0]; 50]);
    assert_eq!(register(&spot, &tree, start, 0.2), Err(RegisterError::OnePlace));
}

#[test]
fn deviations_have_sign_statistics_and_a_histogram() {
    let flat = mesh(|_, _| 900.0);
    let tree = NearestOnMesh::new(&flat).unwrap();
    // Towards −z, where the mesh faces, is outside.
    let mut points: Vec<[f64; 3]> = (0..1001)
        .map(|i| [f64::from(i % 40) - 20.0, f64::from(i / 40) - 12.0, 899.0 - 0.001 * f64::from(i)])
        .collect();
    points.push([500.0, 0.0, 900.0]);
    let sigmas = vec![0.6; points.len()];
    let found = compare(&points, Some(&sigmas), &tree).unwrap();
    assert_eq!((found.compared, found.beyond), (1001, 1));
    assert!(found.deviations_mm[1001].is_nan());
    assert!((found.mean_mm - 1.5).abs() < 1e-9 && (found.quantiles_mm[2] - 1.5).abs() < 1e-9);
    assert!((found.extremes_mm[0] - 1.0).abs() < 1e-9 && (found.extremes_mm[1] - 2.0).abs() < 1e-9);
    // Two sigma are 1.2 mm: the upper four fifths of 1 to 2 mm are beyond.
    assert!((found.beyond_two_sigma.unwrap() - 0.8).abs() < 0.002);
    let histogram = found.histogram();
    assert_eq!(histogram.counts.iter().sum::<usize>(), 1001);
    assert!(compare(&points[1001..], None, &tree).is_none());
}

/// A pipe of 20 mm along x, 900 mm away, with a flange of 35 mm: from where to where along x each radius goes.
const PIPE: [([f64; 2], f64); 3] = [([-60.0, 30.0], 20.0), ([30.0, 40.0], 35.0), ([40.0, 100.0], 20.0)];
const AXIS_MM: f64 = 900.0;
const FLOOR_MM: f64 = 922.0;

/// The pipe's surface, closed at its ends, seen from outside.
fn flanged_pipe() -> TriangleMesh {
    const AROUND: u32 = 96;
    let mut profile = vec![[-60.0, 0.1]];
    for ([from, to], radius) in PIPE {
        let steps = ((to - from) / 2.0) as u32;
        profile.extend((0..=steps).map(|i| [from + (to - from) * f64::from(i) / f64::from(steps), radius]));
    }
    profile.push([100.0, 0.1]);
    let place = |[x, r]: [f64; 2], i: u32| {
        let t = f64::from(i) / f64::from(AROUND) * std::f64::consts::TAU;
        [x, r * t.cos(), AXIS_MM + r * t.sin()]
    };
    let vertices = profile.iter().flat_map(|&p| (0..AROUND).map(move |i| place(p, i))).collect();
    let rings = 0..profile.len() as u32 - 1;
    let quads = rings.flat_map(|r| (0..AROUND).map(move |i| [r * AROUND + i, r * AROUND + (i + 1) % AROUND]));
    let triangles = quads.flat_map(|[a, b]| [[a, a + AROUND, b], [b, a + AROUND, b + AROUND]]).collect();
    TriangleMesh::new(Frame::Camera, vertices, triangles).expect("corners are vertices")
}

/// What a camera at the origin sees of it and of the floor behind, from x = −50 mm to 88 mm.
fn seen_pipe(random: &mut StdRng) -> PointCloud {
    let (mut points, mut pixels) = (Vec::new(), Vec::new());
    for i in 0..90 {
        for j in 0..70 {
            let [u, v] = [(f64::from(i) * 1.55 - 50.0) / 900.0, (f64::from(j) * 1.6 - 55.0) / 900.0];
            let mut depth = FLOOR_MM;
            for ([from, to], radius) in PIPE {
                // |(v z, z − axis)| = radius; then the flange's faces.
                let (a, b, c) = (1.0 + v * v, AXIS_MM, AXIS_MM * AXIS_MM - radius * radius);
                let root = b * b - a * c;
                let side = (b - root.max(0.0).sqrt()) / a;
                if root >= 0.0 && (from..to).contains(&(u * side)) {
                    depth = depth.min(side);
                }
                for face in [from, to] {
                    let z = face / u;
                    if z > 0.0 && (v * z).hypot(z - AXIS_MM) < radius {
                        depth = depth.min(z);
                    }
                }
            }
            points.push([u * depth, v * depth, depth + SIGMA_MM * gauss(random)]);
            pixels.push([(1900.0 * u) as f32, (1900.0 * v) as f32]);
        }
    }
    let variance = (SIGMA_MM * SIGMA_MM) as f32;
    let covariances = vec![[0.0, 0.0, 0.0, 0.0, 0.0, variance]; points.len()];
    let cloud = PointCloud::new(Frame::Camera, points).with_covariances_mm2(covariances);
    cloud.and_then(|cloud| cloud.with_pixels(pixels)).expect("one a point")
}

#[test]
fn a_pipe_before_its_floor_is_found_where_it_is() {
    let reference = flanged_pipe();
    let tree = NearestOnMesh::new(&reference).unwrap();
    let cloud = seen_pipe(&mut random(6));
    for moved in [Isometry3::identity(), pose([0.3, -0.2, 0.9], [40.0, -25.0, 60.0])] {
        // Moved with its sensor, as another frame would have it: then nothing is known of where that was.
        let cloud = if moved == Isometry3::identity() {
            cloud.clone()
        } else {
            let covariances = cloud.covariances_mm2().unwrap().to_vec();
            PointCloud::new(Frame::Camera, cloud.positions_mm().to_vec())
                .with_covariances_mm2(covariances)
                .unwrap()
                .transformed(Frame::Camera, &moved)
        };
        let found = register(&cloud, &tree, Start::Anywhere, 0.2).unwrap();
        // A turn about the axis is not determined: along it any place is as good.
        let back = found.mesh_from_cloud * moved;
        let axis = [-40.0, 35.0, 80.0].map(|x| back * Point3::new(x, 0.0, AXIS_MM));
        for (x, place) in [-40.0, 35.0, 80.0].iter().zip(axis) {
            let off = (place - Point3::new(*x, 0.0, AXIS_MM)).norm();
            assert!(off < 0.2, "{off} mm at {x}: {found:?}");
        }
    }
}
