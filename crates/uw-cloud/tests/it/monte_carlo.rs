//! Errors over many noisy measurements of one truth: no bias, and sigmas that are true.

use crate::scene::{BASELINE_MM, Errors, FOCAL_PX, Line, ball_lines, bare, cloud, gauss, random, uniform};
use rand::rngs::StdRng;
use uw_cloud::{Frame, PlaneFit, PlaneOptions, PointCloud, SphereFit, SphereOptions, fit_plane, fit_sphere};

/// The paper's ball.
const RADIUS_MM: f64 = 20.0175;
/// Trials of each experiment: the spread of error over sigma is then known to 4 %.
const TRIALS: usize = 300;
/// Error over sigma, root mean square.
const HONEST: std::ops::RangeInclusive<f64> = 0.85..=1.15;
/// A mean is zero when it lies within so many of its standard errors…
const STANDARD_ERRORS: f64 = 3.5;
/// … or is this share of the sigma that is reported.
const NEGLIGIBLE_SIGMAS: f64 = 0.1;

/// Errors of a sphere's radius and centre over many trials.
#[derive(Debug, Default)]
struct Ball {
    radius: Errors,
    center: [Errors; 3],
}

impl Ball {
    fn add(&mut self, fit: &SphereFit, center: [f64; 3]) {
        self.radius.add(fit.radius_mm - RADIUS_MM, fit.sigma_radius_mm);
        for (k, errors) in self.center.iter_mut().enumerate() {
            errors.add(fit.center_mm[k] - center[k], fit.sigma_center_mm[k]);
        }
    }
}

fn assert_unbiased_and_honest(what: &str, errors: &Errors) {
    let (mean, error) = (errors.mean(), errors.standard_error());
    assert!(
        mean.abs() <= STANDARD_ERRORS * error || errors.normalised_mean().abs() <= NEGLIGIBLE_SIGMAS,
        "{what}: mean {mean:.5} with standard error {error:.5}, spread {:.5}",
        errors.spread()
    );
    let normalised = errors.normalised();
    assert!(
        HONEST.contains(&normalised),
        "{what}: error over sigma {normalised:.3}, spread {:.5}",
        errors.spread()
    );
}

/// Returns the errors over `trials` of fits to the ball at a depth, each cloud passed through `change`.
fn ball_errors(
    center: [f64; 3],
    sheet_step_deg: f64,
    sigma_px: f64,
    options: SphereOptions,
    change: impl Fn(PointCloud, &mut StdRng) -> PointCloud,
) -> Ball {
    let lines = ball_lines(center, RADIUS_MM, sheet_step_deg);
    let mut random = random(3);
    let mut errors = Ball::default();
    for _ in 0..TRIALS {
        let cloud = change(cloud(&lines, sigma_px, &mut random), &mut random);
        errors.add(&fit_sphere(&cloud, &options).expect("a ball"), center);
    }
    errors
}

fn assert_ball(what: &str, errors: &Ball) {
    assert_unbiased_and_honest(&format!("{what}, radius"), &errors.radius);
    for (axis, errors) in "xyz".chars().zip(&errors.center) {
        assert_unbiased_and_honest(&format!("{what}, centre {axis}"), errors);
    }
}

/// Some 3600 points, as the paper has them on its nearest ball.
#[test]
fn near_ball_is_unbiased_with_true_sigmas() {
    let errors = ball_errors([15.0, -20.0, 667.0], 0.067, 0.2, SphereOptions::default(), |cloud, _| {
        assert!((3300..3900).contains(&cloud.len()), "{}", cloud.len());
        cloud
    });
    assert_ball("667 mm, 0.2 px", &errors);
}

/// Some 1200 points, as the paper has them on its farthest ball.
#[test]
fn far_ball_is_unbiased_with_true_sigmas() {
    for sigma_px in [0.1, 0.2] {
        let errors =
            ball_errors([15.0, -20.0, 1067.0], 0.09, sigma_px, SphereOptions::default(), |cloud, _| {
                assert!((1100..1300).contains(&cloud.len()), "{}", cloud.len());
                cloud
            });
        assert_ball(&format!("1067 mm, {sigma_px} px"), &errors);
    }
}

/// The same points without their covariances: the bias that the covariances take away.
#[test]
fn unweighted_far_ball_comes_out_too_small() {
    let errors =
        ball_errors([15.0, -20.0, 1067.0], 0.09, 0.2, SphereOptions::default(), |cloud, _| bare(&cloud));
    let (mean, error) = (errors.radius.mean(), errors.radius.standard_error());
    assert!(mean < -STANDARD_ERRORS * error, "{mean:.5} with standard error {error:.5}");
    assert!((-0.05..-0.005).contains(&mean), "{mean:.5} mm");
}

#[test]
fn known_radius_leaves_the_centre_unbiased() {
    let options = SphereOptions { radius_mm: Some(RADIUS_MM), ..SphereOptions::default() };
    let errors = ball_errors([15.0, -20.0, 1067.0], 0.09, 0.2, options, |cloud, _| cloud);
    assert_eq!((errors.radius.mean(), errors.radius.spread()), (0.0, 0.0), "given, not estimated");
    for (axis, errors) in "xyz".chars().zip(&errors.center) {
        assert_unbiased_and_honest(&format!("centre {axis}"), errors);
    }
}

/// What no covariance tells: a rough surface, and covariances half as large in sigma as the noise that there is.
#[test]
fn sigmas_stay_true_for_a_rough_ball_and_for_covariances_too_small() {
    const ROUGHNESS_MM: f64 = 0.03;
    let rough = |cloud: PointCloud, random: &mut StdRng| {
        let covariances = cloud.covariances_mm2().unwrap().to_vec();
        let moved =
            cloud.positions_mm().iter().map(|p| p.map(|c| c + ROUGHNESS_MM * gauss(random))).collect();
        PointCloud::new(Frame::Camera, moved).with_covariances_mm2(covariances).unwrap()
    };
    let errors = ball_errors([15.0, -20.0, 1067.0], 0.09, 0.1, SphereOptions::default(), rough);
    assert_ball("rough", &errors);

    let understated = |cloud: PointCloud, _: &mut StdRng| {
        let covariances = cloud.covariances_mm2().unwrap().iter().map(|c| c.map(|c| c / 4.0)).collect();
        cloud.with_covariances_mm2(covariances).unwrap()
    };
    let errors = ball_errors([15.0, -20.0, 1067.0], 0.09, 0.1, SphereOptions::default(), understated);
    assert_ball("understated", &errors);
}

/// Scale and floor are named for what they are: 4 in variance, 0.05 mm.
#[test]
fn scale_and_floor_are_told_apart() {
    const ROUGHNESS_MM: f64 = 0.05;
    let lines = ball_lines([15.0, -20.0, 667.0], RADIUS_MM, 0.067);
    let mut random = random(5);
    let cloud = cloud(&lines, 0.2, &mut random);
    let covariances: Vec<_> = cloud.covariances_mm2().unwrap().iter().map(|c| c.map(|c| c / 4.0)).collect();
    let moved =
        cloud.positions_mm().iter().map(|p| p.map(|c| c + ROUGHNESS_MM * gauss(&mut random))).collect();
    let cloud = PointCloud::new(Frame::Camera, moved).with_covariances_mm2(covariances).unwrap();
    let deviations = fit_sphere(&cloud, &SphereOptions::default()).unwrap().deviations;
    let (scale, floor) = (deviations.scale.unwrap(), deviations.floor_mm.unwrap());
    assert!(
        (scale - 4.0).abs() < 0.6,
        "scale {scale}, 4 is true; 3600 points tell it to 3 % with the floor known"
    );
    assert!((floor - ROUGHNESS_MM).abs() < 0.015, "floor {floor} mm");
}

/// Four tenths of outliers all about the ball, and a few strays far away.
#[test]
fn ball_is_found_among_four_tenths_of_outliers() {
    let center = [15.0, -20.0, 867.0];
    let lines = ball_lines(center, RADIUS_MM, 0.09);
    let mut random = random(11);
    let mut errors = Ball::default();
    for trial in 0..60 {
        let mut points = Vec::new();
        let mut covariances = Vec::new();
        for (line, z) in &lines {
            let (point, covariance) = line.measured(*z, 0.1 * gauss(&mut random), 0.1);
            points.push(point);
            covariances.push(covariance);
        }
        let outliers = points.len() * 2 / 3;
        for i in 0..outliers {
            let reach = if i % 50 == 0 { 5000.0 } else { 60.0 };
            let z = (center[2] + uniform(&mut random, -reach, reach)).max(100.0);
            let line = Line {
                slope: (center[0] + BASELINE_MM + uniform(&mut random, -reach, reach)) / z,
                row: (center[1] + uniform(&mut random, -reach, reach)) / z,
            };
            let (point, covariance) = line.measured(z, 0.0, 0.1);
            points.push(point);
            covariances.push(covariance);
        }
        let cloud = PointCloud::new(Frame::Camera, points).with_covariances_mm2(covariances).unwrap();
        let options = SphereOptions { seed: trial, ..SphereOptions::default() };
        let fit = fit_sphere(&cloud, &options).unwrap();
        // Outliers within the noise of the surface stay, and cannot be told: some 2 % of them.
        assert!(
            fit.deviations.outliers as f64 > 0.95 * outliers as f64,
            "{:?} of {outliers}",
            fit.deviations
        );
        errors.add(&fit, center);
        let bare_fit = fit_sphere(&bare(&cloud), &options).unwrap();
        assert!((bare_fit.radius_mm - RADIUS_MM).abs() < 0.15, "without covariances, {bare_fit:?}");
    }
    assert!(errors.radius.normalised() < 1.4, "error over sigma {:.3}", errors.radius.normalised());
    assert!(
        errors.radius.mean().abs() < 3.5 * errors.radius.standard_error(),
        "mean {}",
        errors.radius.mean()
    );
}

/// A plane n·p + d = 0 seen through some 600 lines, noisy along them.
fn plane_cloud(normal: [f64; 3], offset: f64, sigma_px: f64, random: &mut StdRng) -> PointCloud {
    let lines: Vec<(Line, f64)> = (0..20)
        .flat_map(|sheet| (0..30).map(move |row| (sheet, row)))
        .filter_map(|(sheet, row)| {
            let line =
                Line { slope: 0.35 + 0.01 * f64::from(sheet), row: f64::from(row * 8 - 120) / FOCAL_PX };
            let across = normal[0] * line.slope + normal[1] * line.row + normal[2];
            let z = (normal[0] * BASELINE_MM - offset) / across;
            (z > 100.0 && z < 5000.0).then_some((line, z))
        })
        .collect();
    assert!(lines.len() > 300, "{}", lines.len());
    cloud(&lines, sigma_px, random)
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    v.map(|c| c / length)
}

/// A board facing the scanner, one turned away, and one nearly along the laser.
#[test]
fn planes_are_unbiased_with_true_sigmas() {
    for (normal, offset) in
        [([0.05, 0.1, -1.0], 900.0), ([-0.6, 0.3, -1.0], 700.0), ([1.0, 0.1, -0.3], 240.0)]
    {
        let normal = unit(normal);
        let mut random = random(17);
        let mut errors: [Errors; 4] = Default::default();
        for _ in 0..TRIALS {
            let cloud = plane_cloud(normal, offset, 0.2, &mut random);
            let fit: PlaneFit = fit_plane(&cloud, &PlaneOptions::default()).unwrap();
            let (estimate, truth) = ([fit.normal, [fit.offset_mm, 0.0, 0.0]], [normal, [offset, 0.0, 0.0]]);
            for k in 0..4 {
                let error = estimate[k / 3][k % 3] - truth[k / 3][k % 3];
                errors[k].add(error, fit.covariance[(k, k)].sqrt());
            }
            assert!((fit.sigma_offset_mm - fit.covariance[(3, 3)].sqrt()).abs() < 1e-12);
        }
        for (k, errors) in errors.iter().enumerate() {
            assert_unbiased_and_honest(&format!("plane {normal:?}, parameter {k}"), errors);
        }
    }
}

#[test]
fn plane_is_found_among_half_outliers() {
    let normal = unit([0.05, 0.1, -1.0]);
    let mut random = random(23);
    for trial in 0..60 {
        let cloud = plane_cloud(normal, 900.0, 0.1, &mut random);
        let mut points = cloud.positions_mm().to_vec();
        let mut covariances = cloud.covariances_mm2().unwrap().to_vec();
        for _ in 0..points.len() * 11 / 10 {
            let z = uniform(&mut random, 500.0, 1300.0);
            let line =
                Line { slope: uniform(&mut random, 0.35, 0.55), row: uniform(&mut random, -0.06, 0.06) };
            let (point, covariance) = line.measured(z, 0.0, 0.1);
            points.push(point);
            covariances.push(covariance);
        }
        let cloud = PointCloud::new(Frame::Camera, points).with_covariances_mm2(covariances).unwrap();
        let fit = fit_plane(&cloud, &PlaneOptions { seed: trial, ..PlaneOptions::default() }).unwrap();
        let cosine: f64 = (0..3).map(|k| fit.normal[k] * normal[k]).sum();
        let angle = cosine.clamp(-1.0, 1.0).acos();
        assert!(angle < 4.5 * fit.sigma_normal_rad, "{angle} rad, sigma {}", fit.sigma_normal_rad);
        assert!((fit.offset_mm - 900.0).abs() < 4.5 * fit.sigma_offset_mm, "{fit:?}");
    }
}
