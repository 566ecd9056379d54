//! Cylinders and circles: no bias, and sigmas that are true; what can't be told is refused.

use crate::scene::{Errors, FOCAL_PX, Line, cloud, gauss, random, uniform};
use uw_cloud::{CircleOptions, CylinderOptions, FitError, Frame, PointCloud, fit_circle, fit_cylinder};

/// Trials of each experiment: the spread of error over sigma is then known to 6 %.
const TRIALS: usize = 150;
/// Error over sigma, root mean square.
const HONEST: std::ops::RangeInclusive<f64> = 0.82..=1.18;
/// A mean is zero within so many of its standard errors, or when it is this share of the sigma that is reported.
const STANDARD_ERRORS: f64 = 3.5;
const NEGLIGIBLE_SIGMAS: f64 = 0.1;

fn assert_honest(what: &str, errors: &Errors) {
    let (mean, error) = (errors.mean(), errors.standard_error());
    assert!(
        mean.abs() <= STANDARD_ERRORS * error || errors.normalised_mean().abs() <= NEGLIGIBLE_SIGMAS,
        "{what}: mean {mean:.5}, standard error {error:.5}"
    );
    let normalised = errors.normalised();
    assert!(
        HONEST.contains(&normalised),
        "{what}: error over sigma {normalised:.3}, spread {:.5}",
        errors.spread()
    );
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    v.map(|c| c / length)
}

/// A pipe: a point of its axis, its direction, its radius.
const PIPE: ([f64; 3], [f64; 3], f64) = ([10.0, -15.0, 800.0], [0.3, 0.94, 0.1], 30.0);

/// Lines that meet the pipe's near side, with the depth where they do.
fn pipe_lines() -> Vec<(Line, f64)> {
    let (point, axis, radius) = (PIPE.0, unit(PIPE.1), PIPE.2);
    let across = |v: [f64; 3]| {
        let along = dot(v, axis);
        [0, 1, 2].map(|k| v[k] - axis[k] * along)
    };
    let mut lines = Vec::new();
    for sheet in -22..=22 {
        for row in -12..=12 {
            let line =
                Line { slope: 0.5125 + 0.0018 * f64::from(sheet), row: f64::from(row * 8 - 25) / FOCAL_PX };
            let a = across([0, 1, 2].map(|k| line.at(0.0)[k] - point[k]));
            let b = across([line.slope, line.row, 1.0]);
            let (aa, ab, bb) = (dot(a, a) - radius * radius, dot(a, b), dot(b, b));
            let root = ab * ab - aa * bb;
            if root > 0.0 {
                lines.push((line, (-ab - root.sqrt()) / bb));
            }
        }
    }
    assert!(lines.len() > 600, "{}", lines.len());
    lines
}

#[test]
fn pipes_are_unbiased_with_true_sigmas() {
    let lines = pipe_lines();
    let axis = unit(PIPE.1);
    for known in [None, Some(PIPE.2)] {
        let mut random = random(31);
        let [mut radius, mut x, mut z, mut tilt] = <[Errors; 4]>::default();
        for _ in 0..TRIALS {
            let cloud = cloud(&lines, 0.2, &mut random);
            let fit =
                fit_cylinder(&cloud, &CylinderOptions { radius_mm: known, ..Default::default() }).unwrap();
            // The truth's point abreast of the fit's.
            let along = dot([0, 1, 2].map(|k| fit.axis_point_mm[k] - PIPE.0[k]), fit.axis_direction);
            let step = along / dot(axis, fit.axis_direction);
            let truth = [0, 1, 2].map(|k| PIPE.0[k] + axis[k] * step);
            radius.add(fit.radius_mm - PIPE.2, fit.sigma_radius_mm.max(1e-300));
            x.add(fit.axis_point_mm[0] - truth[0], fit.sigma_axis_point_mm[0]);
            z.add(fit.axis_point_mm[2] - truth[2], fit.sigma_axis_point_mm[2]);
            tilt.add(fit.axis_direction[2] - axis[2], fit.covariance[(5, 5)].sqrt());
        }
        if known.is_none() {
            assert_honest("radius", &radius);
        } else {
            assert!(radius.spread() < 1e-12, "given, not estimated");
        }
        assert_honest("axis point x", &x);
        assert_honest("axis point z", &z);
        assert_honest("direction z", &tilt);
    }
}

#[test]
fn a_pipe_is_found_among_outliers() {
    let lines = pipe_lines();
    let mut random = random(5);
    for seed in 0..12 {
        let sound = cloud(&lines, 0.1, &mut random);
        let mut points = sound.positions_mm().to_vec();
        let mut covariances = sound.covariances_mm2().unwrap().to_vec();
        for _ in 0..points.len() / 2 {
            let z = uniform(&mut random, 700.0, 900.0);
            let line =
                Line { slope: uniform(&mut random, 0.45, 0.57), row: uniform(&mut random, -0.07, 0.05) };
            let (point, covariance) = line.measured(z, 0.0, 0.1);
            points.push(point);
            covariances.push(covariance);
        }
        let cloud = PointCloud::new(Frame::Camera, points).with_covariances_mm2(covariances).unwrap();
        let fit = fit_cylinder(&cloud, &CylinderOptions { radius_mm: None, seed }).unwrap();
        assert!((fit.radius_mm - PIPE.2).abs() < 5.0 * fit.sigma_radius_mm, "{fit:?}");
        assert!(fit.sigma_radius_mm < 0.1, "{fit:?}");
    }
}

/// Points along a circle with errors of unlike size and direction each.
fn ring_cloud(arc: f64, seed: u64) -> PointCloud {
    let normal = unit(RING.1);
    let first = unit([normal[2], 0.0, -normal[0]]);
    let second = [
        normal[1] * first[2] - normal[2] * first[1],
        normal[2] * first[0] - normal[0] * first[2],
        normal[0] * first[1] - normal[1] * first[0],
    ];
    let mut random = random(seed);
    let (mut points, mut covariances) = (Vec::new(), Vec::new());
    for i in 0..300 {
        let (s, c) = (arc * f64::from(i) / 300.0).sin_cos();
        let error = [0, 1, 2].map(|_| 0.05 * gauss(&mut random));
        // Rank one, in a direction that is another for every point, and a little besides.
        let size = gauss(&mut random);
        points.push([0, 1, 2].map(|k| {
            RING.0[k] + RING.2 * (c * first[k] + s * second[k]) + error[k] * size + 0.01 * gauss(&mut random)
        }));
        let at = |a: usize, b: usize| (error[a] * error[b] + if a == b { 1e-4 } else { 0.0 }) as f32;
        covariances.push([at(0, 0), at(0, 1), at(0, 2), at(1, 1), at(1, 2), at(2, 2)]);
    }
    PointCloud::new(Frame::Camera, points).with_covariances_mm2(covariances).expect("one a point")
}

const RING: ([f64; 3], [f64; 3], f64) = ([5.0, 12.0, 700.0], [0.2, -0.3, -0.9], 25.0);

#[test]
fn circles_are_unbiased_with_true_sigmas() {
    let normal = unit(RING.1);
    for (known, arc) in [(None, 4.0), (None, 1.5), (Some(RING.2), 2.0)] {
        let [mut radius, mut x, mut z, mut tilt] = <[Errors; 4]>::default();
        for seed in 0..TRIALS as u64 {
            let fit =
                fit_circle(&ring_cloud(arc, seed), &CircleOptions { radius_mm: known, ..Default::default() })
                    .unwrap();
            radius.add(fit.radius_mm - RING.2, fit.sigma_radius_mm.max(1e-300));
            x.add(fit.center_mm[0] - RING.0[0], fit.sigma_center_mm[0]);
            z.add(fit.center_mm[2] - RING.0[2], fit.sigma_center_mm[2]);
            tilt.add(fit.normal[0] - normal[0], fit.covariance[(3, 3)].sqrt());
        }
        if known.is_none() {
            assert_honest("radius", &radius);
        }
        assert_honest("centre x", &x);
        assert_honest("centre z", &z);
        assert_honest("normal x", &tilt);
    }
}

/// Reported: of a ring in an exact plane half of the residuals were nil, and their scatter with them.
#[test]
fn a_ring_without_errors_in_one_direction_keeps_its_points() {
    /// Scatter in the other direction, mm, and points of the ring and astray.
    const NOISE_MM: f64 = 0.02;
    const COUNTS: [u32; 2] = [200, 20];
    for ((seed, flat), known) in
        (0..20).flat_map(|s| [(s, true), (s, false)]).zip([None, Some(25.0)].into_iter().cycle())
    {
        let mut random = random(seed);
        let points = (0..COUNTS[0] + COUNTS[1]).map(|i| {
            let (s, c) = (0.04 * f64::from(i)).sin_cos();
            let far = if i < COUNTS[0] { 0.0 } else { f64::from(5 + i % 7) };
            let off = NOISE_MM * gauss(&mut random) + far;
            let (radius, height) = if flat { (25.0 + off, 0.0) } else { (25.0, off) };
            [radius * c, radius * s, 650.0 + height]
        });
        let cloud = PointCloud::new(Frame::Camera, points.collect());
        let fit = fit_circle(&cloud, &CircleOptions { radius_mm: known, ..Default::default() })
            .unwrap_or_else(|e| panic!("{seed} {flat}: {e}"));
        // One of two hundred may scatter by more than what a sound one practically never exceeds.
        let left_out = fit.deviations.outliers as u32 - COUNTS[1];
        assert!(left_out <= 1, "{seed} {flat}: {left_out}");
        // Of a mean of 200 points, five times.
        let bound = 5.0 * NOISE_MM / f64::from(COUNTS[0]).sqrt();
        assert!((fit.radius_mm - 25.0).abs() < bound, "{seed} {flat}: {fit:?}");
        assert!((fit.center_mm[2] - 650.0).abs() < bound && fit.normal[2] < -0.999, "{seed} {flat}: {fit:?}");
    }
}

#[test]
fn arrangements_without_the_shape_are_refused_or_honest() {
    for noise in [0.0, 1e-3, 0.1] {
        let mut random = random(4);
        let mut noisy = |p: [f64; 3]| p.map(|c| c + noise * gauss(&mut random));
        let line: Vec<_> = (0..200).map(|i| noisy([f64::from(i) * 0.2, f64::from(i) * 0.1, 600.0])).collect();
        let flat: Vec<_> = (0..900).map(|i| noisy([f64::from(i % 30), f64::from(i / 30), 600.0])).collect();
        for (name, points) in [("line", &line), ("flat", &flat)] {
            match fit_cylinder(&PointCloud::new(Frame::Camera, points.clone()), &CylinderOptions::default()) {
                Err(
                    FitError::Undetermined { .. }
                    | FitError::NotConverged { .. }
                    | FitError::NoConsensus { .. },
                ) => {}
                Err(other) => panic!("{name}, noise {noise}: {other}"),
                Ok(fit) => assert!(
                    fit.sigma_radius_mm > 0.2 * fit.radius_mm || fit.radius_mm > 1e4,
                    "{name}, noise {noise}: {fit:?}"
                ),
            }
        }
        match fit_circle(&PointCloud::new(Frame::Camera, line), &CircleOptions::default()) {
            Err(
                FitError::Undetermined { .. } | FitError::NotConverged { .. } | FitError::NoConsensus { .. },
            ) => {}
            Err(other) => panic!("line as circle, noise {noise}: {other}"),
            Ok(fit) => {
                assert!(fit.sigma_radius_mm > 0.2 * fit.radius_mm || fit.radius_mm > 1e4, "{noise}: {fit:?}");
            }
        }
    }
    let few = PointCloud::new(Frame::Camera, vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let error = fit_cylinder(&few, &CylinderOptions::default()).unwrap_err();
    assert_eq!(error, FitError::TooFewPoints { shape: "cylinder", needed: 6, got: 3 });
    let error = fit_circle(&few, &CircleOptions::default()).unwrap_err();
    assert_eq!(error, FitError::TooFewPoints { shape: "circle", needed: 7, got: 3 });
}

/// Reported: three heights of a grid, of which those of the first were taken for the plane.
#[test]
fn gridded_heights_are_no_outliers() {
    let points: Vec<_> =
        (0..24).map(|i| [f64::from(i % 6), f64::from(i / 6), 500.0 + 0.01 * f64::from(i * 7 % 3)]).collect();
    let fit =
        uw_cloud::fit_plane(&PointCloud::new(Frame::Camera, points), &uw_cloud::PlaneOptions::default())
            .unwrap();
    assert_eq!(fit.deviations.outliers, 0, "{fit:?}");
    assert!(fit.sigma_offset_mm > 1e-4, "{fit:?}");
}

/// Reported: the fit of known radius to an exact ball did not come to rest.
#[test]
fn an_exact_ball_of_known_radius_converges() {
    for count in [10, 40, 300, 1000] {
        for seed in 0..40 {
            let turn = 2.4 + 0.01 * seed as f64;
            let points = (0..count).map(|i| (turn * f64::from(i), -f64::from(i + 1) / f64::from(count + 1)));
            let points = points.map(|(t, z)| ((1.0 - z * z).sqrt(), t, z));
            let points =
                points.map(|(r, t, z)| [20.0 * r * t.cos(), 20.0 * r * t.sin() - 7.0, 700.0 + 20.0 * z]);
            let cloud = PointCloud::new(Frame::Camera, points.collect());
            let options = uw_cloud::SphereOptions { radius_mm: Some(20.0), seed };
            let fit = uw_cloud::fit_sphere(&cloud, &options)
                .unwrap_or_else(|e| panic!("{count} points, seed {seed}: {e}"));
            assert!((fit.center_mm[2] - 700.0).abs() < 1e-9, "{fit:?}");
        }
    }
}
