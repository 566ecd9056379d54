//! Sweeps of one scene brought together.

use crate::scene::{gauss, random};
use nalgebra::{Isometry3, Matrix6, Point3, UnitQuaternion, Vector3, Vector6};
use rand::RngExt;
use rand::rngs::StdRng;
use uw_cloud::{
    Frame, MergeError, MergeOptions, PointCloud, Start, SurfaceOptions, SweepSurface, merge, register_sweep,
    triangulate,
};

/// Noise of the points along z, mm.
const SIGMA_MM: f64 = 0.03;
/// Three predicted sigmas of the last sweep's pose along x, 0.03 mm: over strips as narrow as the overlaps, a shift is nearly a turn.
const POSE_MM: f64 = 0.09;

/// A relief that no motion maps onto itself.
fn relief(x: f64, y: f64) -> f64 {
    900.0 + 6.0 * (x / 17.0).sin() + 5.0 * (y / 13.0 + x / 40.0).cos() + 0.002 * x * y
}

/// A sweep over a range of x, moved by a pose.
fn sweep(x: std::ops::Range<i32>, pose: &Isometry3<f64>, random: &mut StdRng) -> PointCloud {
    let mut points = Vec::new();
    for i in x {
        for j in -50..50 {
            let (x, y) = (f64::from(i) * 0.9, f64::from(j) * 0.8 + 0.3 * f64::from(i % 3));
            points.push([x, y, relief(x, y) + SIGMA_MM * gauss(random)]);
        }
    }
    let count = points.len();
    let variance = (SIGMA_MM * SIGMA_MM) as f32;
    let cloud = PointCloud::new(Frame::Camera, points)
        .with_covariances_mm2(vec![[0.0, 0.0, 0.0, 0.0, 0.0, variance]; count])
        .and_then(|c| c.with_sigmas_mm(vec![SIGMA_MM as f32; count]))
        .expect("one a point");
    cloud.transformed(Frame::Camera, pose)
}

fn pose(turn: [f64; 3], shift: [f64; 3]) -> Isometry3<f64> {
    let middle = Isometry3::translation(0.0, 0.0, 900.0);
    middle
        * Isometry3::from_parts(Vector3::from(shift).into(), UnitQuaternion::new(Vector3::from(turn)))
        * middle.inverse()
}

#[test]
fn three_sweeps_in_a_row_come_together_with_their_covariances() {
    let mut random = random(31);
    let poses = [
        Isometry3::identity(),
        pose([0.02, -0.03, 0.3], [14.0, -6.0, 5.0]),
        pose([-0.04, 0.02, -0.2], [-20.0, 3.0, -8.0]),
    ];
    // Strips of some 30 mm of overlap, two waves of the relief: of narrower ones a shift is hardly told from a turn.
    let ranges = [-60..5, -30..35, 0..65];
    let clouds: Vec<PointCloud> =
        ranges.into_iter().zip(&poses).map(|(x, pose)| sweep(x, pose, &mut random)).collect();
    let near = MergeOptions { near_mm: Some(15.0), ..MergeOptions::default() };
    let merged = merge(&clouds, &near).unwrap();
    assert_eq!(merged.cloud.len(), clouds.iter().map(PointCloud::len).sum::<usize>());
    for (found, truth) in merged.poses.iter().zip(&poses) {
        // Every place of the scene comes back to where the first sweep has it.
        for x in [-30.0, 0.0, 30.0] {
            let place = Point3::new(x, 10.0, relief(x, 10.0));
            let off = (found * truth * place - place).norm();
            assert!(off < POSE_MM, "{off} mm");
        }
    }
    for pair in &merged.pairs {
        assert!(pair.rms_mm < 2.0 * SIGMA_MM, "{pair:?}");
    }
    assert!(merged.pairs.iter().any(|p| (p.points_of, p.surface_of) == (2, 1) && p.overlap > 0.3));
    // Turned along, a variance along z is one along the turned z.
    let last = merged.cloud.covariances_mm2().unwrap().last().unwrap();
    assert!((f64::from(last[5]).sqrt() - SIGMA_MM).abs() < 0.05 * SIGMA_MM, "{last:?}");
    assert!(
        merged.covariances[1][(5, 5)].sqrt() < POSE_MM && merged.warnings.is_empty(),
        "{:?}",
        merged.warnings
    );
}

/// Ratio of scatter to sigma that a prediction is good for. Of 240 degrees of freedom it scatters by 0.05.
const GOOD: std::ops::Range<f64> = 0.8..1.25;
const TRIALS: usize = 40;

/// Two overlapping sweeps, the second one moved by a pose, that tell their covariances or not.
fn pair(away: &Isometry3<f64>, told: bool, random: &mut StdRng) -> [PointCloud; 2] {
    [(-32..28, &Isometry3::identity()), (-28..32, away)].map(|(x, pose)| {
        let cloud = sweep(x, pose, random);
        if told { cloud } else { PointCloud::new(Frame::Camera, cloud.positions_mm().to_vec()) }
    })
}

/// How far a pose brings a place off, turn and shift, in the squares of its covariance; and the shift alone, mm.
fn off(left: &Isometry3<f64>, place: &Vector3<f64>, covariance: &Matrix6<f64>) -> (f64, f64) {
    let (turn, shift) = (left.rotation.scaled_axis(), (left * Point3::from(*place)).coords - place);
    let error = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
    (error.dot(&(covariance.try_inverse().expect("a covariance") * error)), shift.norm())
}

/// What poses scatter by over what is told of them: chi² by its degrees of freedom, of merged pairs whose points tell their covariances or not.
#[test]
fn poses_scatter_by_what_is_told_of_them() {
    let mut random = random(33);
    let away = pose([0.02, -0.01, 0.05], [2.3, -1.1, 0.8]);
    let near = MergeOptions { near_mm: Some(6.0), ..MergeOptions::default() };
    for told in [true, false] {
        let (mut chi2, mut worst) = (0.0, 0.0_f64);
        for _ in 0..TRIALS {
            let merged = merge(&pair(&away, told, &mut random), &near).unwrap();
            let positions = merged.cloud.positions_mm();
            let middle =
                positions.iter().map(|p| Vector3::from(*p)).sum::<Vector3<f64>>() / positions.len() as f64;
            let (square, shift) = off(&(merged.poses[1] * away), &middle, &merged.covariances[1]);
            (chi2, worst) = (chi2 + square, worst.max(shift));
        }
        let ratio = (chi2 / (6 * TRIALS) as f64).sqrt();
        assert!(GOOD.contains(&ratio), "told {told}: scatter over sigma {ratio}");
        // Five thousand pairs of points of 0.04 mm on slopes of about 0.3 determine a shift to some 3 µm.
        assert!(worst < 0.02, "told {told}: {worst} mm");
    }
}

/// As of merged pairs, of a sweep that is laid onto another one and has no surface of its own.
#[test]
fn a_sweep_without_a_surface_scatters_by_what_is_told_of_it() {
    let mut random = random(34);
    let away = pose([0.02, -0.01, 0.05], [2.3, -1.1, 0.8]);
    for told in [true, false] {
        let (mut chi2, mut worst) = (0.0, 0.0_f64);
        for _ in 0..TRIALS {
            let [cloud, other] = pair(&away, told, &mut random);
            let surface = triangulate(&cloud, &SurfaceOptions::default()).unwrap();
            let target = SweepSurface::new(&cloud, &surface).unwrap().expect("an area");
            let start = Start::Near(Isometry3::identity(), 6.0);
            let found = register_sweep(&other, &target, start, 0.2).unwrap();
            let middle = found.mesh_from_cloud * Point3::from(found.middle_mm);
            let (square, shift) = off(&(found.mesh_from_cloud * away), &middle.coords, &found.covariance);
            (chi2, worst) = (chi2 + square, worst.max(shift));
        }
        let ratio = (chi2 / (6 * TRIALS) as f64).sqrt();
        assert!(GOOD.contains(&ratio), "told {told}: scatter over sigma {ratio}");
        // As many pairs, but a turn and a shift of one sweep's middle: ten times 3 µm.
        assert!(worst < 0.03, "told {told}: {worst} mm");
    }
}

/// Points anywhere on a form with one steep hill, some 0.9 mm apart: as the pose goes, many belong to the one or the other of two.
fn scattered(x: std::ops::Range<f64>, pose: &Isometry3<f64>, random: &mut StdRng) -> PointCloud {
    const POINTS: usize = 5000;
    let mut place = || {
        let (x, y) = (random.random_range(x.clone()), random.random_range(-30.0..30.0));
        let hill = 6.0 * (-((x - 20.0_f64).powi(2) + (y + 12.0_f64).powi(2)) / 90.0).exp();
        let height = 700.0 + 4.0 * (x / 11.0).sin() * (y / 17.0).cos() + 0.05 * x + hill;
        [x, y, height + SIGMA_MM * gauss(random)]
    };
    let points = (0..POINTS).map(|_| place()).collect();
    PointCloud::new(Frame::Camera, points).transformed(Frame::Camera, pose)
}

#[test]
fn poses_settle_where_points_lie_anywhere() {
    let mut random = random(35);
    let near = MergeOptions { near_mm: Some(10.0), ..MergeOptions::default() };
    let away = pose([0.0, 0.0, 0.07], [6.0, -3.0, 5.0]);
    for trial in 0..20 {
        let clouds = [
            scattered(-40.0..25.0, &Isometry3::identity(), &mut random),
            scattered(-25.0..40.0, &away, &mut random),
        ];
        let merged = merge(&clouds, &near).unwrap();
        assert!(merged.warnings.is_empty(), "{trial}: {:?}", merged.warnings);
        let place = Point3::new(0.0, 0.0, 700.0);
        let off = (merged.poses[1] * away * place - place).norm();
        // Some two thousand pairs of points on slopes of 0.25 tell a shift to 4 µm, with the turns to twice or thrice that.
        assert!(off < 0.05, "{trial}: {off} mm");
    }
}

#[test]
fn what_does_not_overlap_or_slides_is_refused() {
    let mut random = random(32);
    let still = Isometry3::identity();
    let near = MergeOptions { near_mm: Some(5.0), ..MergeOptions::default() };
    let apart = [sweep(-60..-10, &still, &mut random), sweep(20..65, &still, &mut random)];
    assert_eq!(merge(&apart, &near).unwrap_err(), MergeError::NoOverlap { index: 1, needed: 0.2 });
    assert_eq!(merge(&apart[..1], &near).unwrap_err(), MergeError::TooFew { got: 1 });

    let plate = |shift: f64| {
        let at = |i: i32, j: i32| [f64::from(i) + shift, f64::from(j), 900.0 + 0.01 * f64::from(i)];
        PointCloud::new(Frame::Camera, (0..60).flat_map(|i| (0..60).map(move |j| at(i, j))).collect())
    };
    let plates = [plate(0.0), plate(20.0)];
    match merge(&plates, &MergeOptions::default()) {
        Err(MergeError::Undetermined { index: 1, .. } | MergeError::Ambiguous { index: 1, .. }) => {}
        other => panic!("{other:?}"),
    }
    // Told that they are where they are, they stay there, and it is said.
    let merged = merge(&plates, &near).unwrap();
    assert!(merged.warnings.iter().any(|w| w.contains("does not determine")), "{:?}", merged.warnings);
}
