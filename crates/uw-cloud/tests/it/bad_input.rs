//! Clouds that hold no shape, or hardly one: an error that says why, or sigmas that say so; never a panic.

use crate::scene::{Errors, ball_lines, bare, cloud, gauss, random, uniform};
use proptest::prelude::*;
use uw_cloud::{
    CloudError, FitError, Frame, PlaneOptions, PointCloud, SphereFit, SphereOptions, fit_plane, fit_sphere,
};

fn camera(points: Vec<[f64; 3]>) -> PointCloud {
    PointCloud::new(Frame::Camera, points)
}

fn sphere(points: Vec<[f64; 3]>) -> Result<SphereFit, FitError> {
    fit_sphere(&camera(points), &SphereOptions::default())
}

/// Points on a cap of a ball of 20 mm about (0, 0, 700), as far as `half_angle` from its nearest point.
fn cap(count: usize, half_angle: f64, noise_mm: f64, seed: u64) -> Vec<[f64; 3]> {
    let mut random = random(seed);
    (0..count)
        .map(|_| {
            let cosine = uniform(&mut random, half_angle.cos(), 1.0);
            let (sine, turn) =
                ((1.0 - cosine * cosine).sqrt(), uniform(&mut random, 0.0, std::f64::consts::TAU));
            let point = [20.0 * sine * turn.cos(), 20.0 * sine * turn.sin(), 700.0 - 20.0 * cosine];
            point.map(|c| c + noise_mm * gauss(&mut random))
        })
        .collect()
}

#[test]
fn too_few_points_are_counted_without_their_duplicates() {
    let one = [1.0, 2.0, 3.0];
    let few = |needed, got| FitError::TooFewPoints { shape: "sphere", needed, got };
    assert_eq!(sphere(vec![]), Err(few(5, 0)));
    assert_eq!(sphere(vec![one; 100]), Err(few(5, 1)));
    let mut points = cap(4, 1.0, 0.0, 1);
    assert_eq!(sphere(points.repeat(9)), Err(few(5, 4)));
    let with =
        camera(points.clone()).with_covariances_mm2(vec![[1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4]; 4]).unwrap();
    let fit = fit_sphere(&with, &SphereOptions::default()).unwrap();
    assert!((fit.radius_mm - 20.0).abs() < 1e-6, "four points with covariances suffice: {fit:?}");
    assert!(fit.sigma_radius_mm > 0.01, "and their covariances say how well: {fit:?}");
    points.truncate(3);
    let error = fit_plane(&camera(points), &PlaneOptions::default()).unwrap_err();
    assert_eq!(error, FitError::TooFewPoints { shape: "plane", needed: 4, got: 3 });
}

#[test]
fn duplicates_are_left_out_and_counted() {
    let points = cap(300, 1.2, 0.05, 2);
    let once = sphere(points.clone()).unwrap();
    let thrice = sphere(points.repeat(3)).unwrap();
    assert_eq!(thrice.deviations.duplicates, 600);
    assert!((thrice.sigma_radius_mm - once.sigma_radius_mm).abs() < 1e-12, "no sharper for being repeated");
}

#[test]
fn values_that_are_no_numbers_are_named() {
    let mut points = cap(50, 1.0, 0.0, 3);
    points[7][2] = f64::NAN;
    let at_7 = |attribute| FitError::Cloud(CloudError::NonFinite { attribute, index: 7 });
    assert_eq!(sphere(points.clone()), Err(at_7("position")));
    points[7][2] = 1e200;
    assert_eq!(sphere(points.clone()), Err(at_7("position")), "its square is infinite");
    points[7][2] = 690.0;
    let mut covariances = vec![[1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4]; 50];
    covariances[7][3] = f32::INFINITY;
    let with = |c: &Vec<[f32; 6]>| camera(points.clone()).with_covariances_mm2(c.clone()).unwrap();
    assert_eq!(fit_sphere(&with(&covariances), &SphereOptions::default()), Err(at_7("covariance")));
    covariances[7][3] = -1e-4;
    let error = fit_sphere(&with(&covariances), &SphereOptions::default()).unwrap_err();
    assert!(matches!(error, FitError::InvalidCovariance { index: 7, .. }), "{error}");
    for radius_mm in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let options = SphereOptions { radius_mm: Some(radius_mm), ..SphereOptions::default() };
        let error = fit_sphere(&with(&covariances), &options).unwrap_err();
        assert!(matches!(error, FitError::InvalidRadius { .. }), "{error}");
    }
}

/// Points on a line or in a plane, exactly and noisily: noise must not be taken for curvature.
#[test]
fn flat_arrangements_determine_no_sphere_and_lines_no_plane() {
    for noise in [0.0, 1e-9, 1e-3, 0.3] {
        let mut random = random(4);
        let mut noisy = |p: [f64; 3]| p.map(|c| c + noise * gauss(&mut random));
        let line: Vec<_> = (0..200).map(|i| noisy([f64::from(i) * 0.2, f64::from(i) * 0.1, 600.0])).collect();
        let circle: Vec<_> = (0..200).map(|i| f64::from(i) * 0.0314).collect();
        let circle: Vec<_> = circle.iter().map(|t| noisy([20.0 * t.cos(), 20.0 * t.sin(), 600.0])).collect();
        let flat: Vec<_> = (0..400).map(|i| noisy([f64::from(i % 20), f64::from(i / 20), 600.0])).collect();
        let plane = fit_plane(&camera(line.clone()), &PlaneOptions::default());
        assert!(matches!(plane, Err(FitError::Undetermined { .. })), "line, noise {noise}: {plane:?}");
        for (name, points) in [("line", line), ("circle", circle), ("flat", flat)] {
            match sphere(points) {
                Err(FitError::Undetermined { .. } | FitError::NotConverged { .. }) => {}
                Err(other) => panic!("{name}, noise {noise}: {other}"),
                Ok(fit) => assert!(
                    fit.sigma_radius_mm > 0.3 * fit.radius_mm || fit.radius_mm > 1e4,
                    "{name}, noise {noise}: {fit:?}"
                ),
            }
        }
    }
}

/// A cap so small that noise competes with its depth: refused, or sigmas that cover the error.
#[test]
fn small_caps_are_refused_or_honest() {
    for half_angle in [0.02, 0.05, 0.1, 0.2, 0.4] {
        let (mut refused, mut errors) = (0, Errors::default());
        for seed in 0..80 {
            match sphere(cap(400, half_angle, 0.02, seed)) {
                Ok(fit) => {
                    errors.add(1.0 / fit.radius_mm - 0.05, fit.sigma_radius_mm / fit.radius_mm.powi(2));
                }
                Err(FitError::Undetermined { .. } | FitError::NotConverged { .. }) => refused += 1,
                Err(other) => panic!("half angle {half_angle}: {other}"),
            }
        }
        assert!(refused == 80 || errors.normalised() < 1.3, "{half_angle}: {refused} refused, {errors:?}");
        assert!(half_angle < 0.2 || refused == 0, "{half_angle} rad is enough: {refused} refused");
    }
}

#[test]
fn known_radius_on_a_cap_that_does_not_tell_its_side_is_ambiguous() {
    let options = SphereOptions { radius_mm: Some(20.0), ..SphereOptions::default() };
    let error = fit_sphere(&camera(cap(100, 0.03, 0.05, 6)), &options).unwrap_err();
    assert!(matches!(error, FitError::Ambiguous { .. }), "{error}");
    let fit = fit_sphere(&camera(cap(400, 0.6, 0.02, 6)), &options).unwrap();
    assert!((fit.center_mm[2] - 700.0).abs() < 4.0 * fit.sigma_center_mm[2], "{fit:?}");
}

/// A million millimetres off, with the noise's own errors and no others.
#[test]
fn a_far_origin_costs_no_accuracy() {
    let lines = ball_lines([15.0, -20.0, 867.0], 20.0175, 0.09);
    let near = bare(&cloud(&lines, 0.1, &mut random(8)));
    let far = camera(near.positions_mm().iter().map(|p| p.map(|c| c + 1e6)).collect());
    let (near, far) =
        (fit_sphere(&near, &SphereOptions::default()), fit_sphere(&far, &SphereOptions::default()));
    let (near, far) = (near.unwrap(), far.unwrap());
    // Coordinates near 1e6 are rounded to 1e-10 mm.
    assert!((near.radius_mm - far.radius_mm).abs() < 1e-6, "{} {}", near.radius_mm, far.radius_mm);
    assert!((near.center_mm[2] + 1e6 - far.center_mm[2]).abs() < 1e-6);
    assert!((near.sigma_radius_mm - far.sigma_radius_mm).abs() < 1e-6);
}

#[test]
fn exact_points_have_no_deviation() {
    let fit = sphere(cap(1000, 1.3, 0.0, 9)).unwrap();
    assert!((fit.radius_mm - 20.0).abs() < 1e-9 && fit.deviations.rms_mm < 1e-9, "{fit:?}");
    assert_eq!((fit.deviations.points, fit.deviations.outliers), (1000, 0));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Whatever the points and covariances: a result of finite numbers, or an error.
    #[test]
    fn nothing_panics(
        points in prop::collection::vec(
            prop::array::uniform3(prop_oneof![
                -1e3..1e3f64, Just(0.0), Just(1.0), Just(-0.0), -1e99..1e99f64, any::<f64>(), -1e-300..1e-300f64
            ]),
            0..24,
        ),
        covariance in prop::array::uniform6(prop_oneof![Just(0.0f32), 0.0..1e-3f32, -1.0..1.0f32, Just(1e38f32)]),
        with in any::<bool>(),
        radius_mm in prop::option::of(0.1..1e3f64),
    ) {
        let count = points.len();
        let mut cloud = camera(points);
        if with {
            cloud = cloud.with_covariances_mm2(vec![covariance; count]).unwrap();
        }
        if let Ok(fit) = fit_sphere(&cloud, &SphereOptions { radius_mm, seed: 1 }) {
            prop_assert!(fit.radius_mm > 0.0 && fit.radius_mm.is_finite());
            prop_assert!(fit.center_mm.iter().chain(&fit.sigma_center_mm).all(|v| v.is_finite()), "{:?}", fit);
            prop_assert!(fit.covariance_mm2.iter().all(|v| v.is_finite()) && fit.deviations.rms_mm.is_finite());
        }
        if let Ok(fit) = fit_plane(&cloud, &PlaneOptions::default()) {
            prop_assert!(fit.normal.iter().all(|v| v.is_finite()) && fit.offset_mm.is_finite(), "{:?}", fit);
            prop_assert!(fit.covariance.iter().all(|v| v.is_finite()) && fit.deviations.rms_mm.is_finite());
        }
    }
}
