//! Every way from a cloud to a result, on clouds that hold too little: an error that says so, or sigmas that do.

use crate::scene::{gauss, random, uniform};
use uw_cloud::{
    CircleOptions, CloudError, CylinderOptions, FitError, Frame, PlaneOptions, PointCloud, ShapeOptions,
    SphereOptions, SurfaceError, SurfaceOptions, find_shapes, fit_circle, fit_cylinder, fit_plane,
    fit_sphere, triangulate,
};

type Points = Vec<[f64; 3]>;

fn camera(points: Points) -> PointCloud {
    PointCloud::new(Frame::Camera, points)
}

/// What each fit says: its name, and its largest relative sigma or its error.
fn all_fits(points: &Points) -> Vec<(&'static str, Result<f64, FitError>)> {
    let cloud = camera(points.clone());
    let of = |sigma: f64, size: f64| sigma / size;
    vec![
        ("plane", fit_plane(&cloud, &PlaneOptions::default()).map(|f| f.sigma_normal_rad)),
        ("sphere", fit_sphere(&cloud, &SphereOptions::default()).map(|f| of(f.sigma_radius_mm, f.radius_mm))),
        (
            "cylinder",
            fit_cylinder(&cloud, &CylinderOptions::default())
                .map(|f| of(f.sigma_radius_mm, f.radius_mm).max(f.sigma_direction_rad)),
        ),
        (
            "circle",
            fit_circle(&cloud, &CircleOptions::default())
                .map(|f| of(f.sigma_radius_mm, f.radius_mm).max(f.sigma_normal_rad)),
        ),
    ]
}

/// Points on a line in space, in one place, and three of them: no fit claims anything, and there are neither shapes nor surfaces.
#[test]
fn lines_single_places_and_three_points_determine_nothing() {
    let mut random = random(1);
    let exact: Points =
        (0..400).map(|i| [0.3 * f64::from(i), 0.1 * f64::from(i), 700.0 + 0.2 * f64::from(i)]).collect();
    let noisy: Points = exact.iter().map(|p| p.map(|c| c + 0.05 * gauss(&mut random))).collect();
    let clouds = [
        ("line", exact),
        ("noisy line", noisy),
        ("one place", vec![[3.0, -2.0, 700.0]; 400]),
        ("three points", vec![[0.0, 0.0, 700.0], [5.0, 0.0, 700.0], [0.0, 5.0, 701.0]]),
    ];
    for (name, points) in clouds {
        for (shape, result) in all_fits(&points) {
            match result {
                Err(
                    FitError::TooFewPoints { .. }
                    | FitError::Undetermined { .. }
                    | FitError::NotConverged { .. },
                ) => {}
                Err(other) => panic!("{name}, {shape}: {other}"),
                Ok(sigma) => panic!("{name}: a {shape} known to {sigma}"),
            }
        }
        match find_shapes(&camera(points.clone()), &ShapeOptions::default()) {
            Ok(found) => assert!(found.shapes.is_empty(), "{name}: {:?}", found.shapes),
            Err(error) => assert!(matches!(error, FitError::TooFewPoints { .. }), "{name}: {error}"),
        }
        let surface = triangulate(&camera(points), &SurfaceOptions::default());
        match name {
            // They span a triangle.
            "three points" => assert!(!matches!(surface, Err(SurfaceError::Cloud(_)))),
            // Noise makes slivers of a line, and nothing more: a band of its length, three sigmas to either side.
            "noisy line" => {
                let area = surface.map_or(0.0, |s| s.mesh.area_mm2());
                assert!(area < 400.0 * 0.374 * 6.0 * 0.05, "{area} mm²");
            }
            // A line that rounding bends makes slivers, which span nothing.
            _ => assert!(
                matches!(surface, Err(SurfaceError::NoArea | SurfaceError::NothingLeft { .. })),
                "{name}: {surface:?}"
            ),
        }
    }
}

#[test]
fn values_that_are_no_numbers_are_refused_everywhere() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut points: Points =
            (0..300).map(|i| [f64::from(i % 20), f64::from(i / 20), 700.0 + f64::from(i % 7)]).collect();
        points[123][1] = bad;
        let named = |error: &FitError| {
            matches!(error, FitError::Cloud(CloudError::NonFinite { attribute: "position", index: 123 }))
        };
        for (shape, result) in all_fits(&points) {
            assert!(result.as_ref().is_err_and(named), "{shape}: {result:?}");
        }
        let found = find_shapes(&camera(points.clone()), &ShapeOptions::default());
        assert!(found.as_ref().is_err_and(named), "{found:?}");
        let surface = triangulate(&camera(points), &SurfaceOptions::default());
        assert!(
            matches!(surface, Err(SurfaceError::Cloud(CloudError::NonFinite { index: 123, .. }))),
            "{surface:?}"
        );
    }
}

/// A thousand kilometres off nothing but the coordinates' rounding changes, 1e-10 mm a point.
#[test]
fn a_far_origin_changes_no_size() {
    const ROUNDING_MM: f64 = 1e-6;
    let mut random = random(3);
    let mut pipe = |i: usize| {
        let (t, radius) = (uniform(&mut random, 3.3, 5.9), 30.0 + 0.03 * gauss(&mut random));
        [0.1 * i as f64, radius * t.cos(), 700.0 + radius * t.sin()]
    };
    let pipe: Points = (0..1500).map(&mut pipe).collect();
    let ring: Points = (0..400)
        .map(|i| f64::from(i) * 0.012)
        .map(|t| {
            [25.0 * t.cos() + 0.02 * gauss(&mut random), 25.0 * t.sin(), 700.0 + 0.02 * gauss(&mut random)]
        })
        .collect();
    let far = |points: &Points| camera(points.iter().map(|p| p.map(|c| c + 1e6)).collect());
    let tube = |cloud: PointCloud| fit_cylinder(&cloud, &CylinderOptions::default()).unwrap();
    let (a, b) = (tube(camera(pipe.clone())), tube(far(&pipe)));
    assert!((a.radius_mm - b.radius_mm).abs() < ROUNDING_MM, "{} {}", a.radius_mm, b.radius_mm);
    assert!((a.sigma_radius_mm - b.sigma_radius_mm).abs() < ROUNDING_MM);
    let circle = |cloud: PointCloud| fit_circle(&cloud, &CircleOptions::default()).unwrap();
    let (a, b) = (circle(camera(ring.clone())), circle(far(&ring)));
    // A fit stops within a thousandth of a sigma.
    let settled = 0.01 * a.sigma_radius_mm;
    assert!((a.radius_mm - b.radius_mm).abs() < settled, "{} {}", a.radius_mm, b.radius_mm);
    let shape = |cloud: PointCloud, at: f64| {
        let options = ShapeOptions { sensor_mm: [at; 3], ..ShapeOptions::default() };
        let found = find_shapes(&cloud, &options).unwrap();
        assert_eq!(found.shapes.len(), 1);
        found.shapes[0].points.len()
    };
    assert_eq!(shape(camera(pipe.clone()), 0.0), shape(far(&pipe), 1e6));
}

/// A ball before a plate that most points are of: a sphere or a cylinder as flat as that is found to tell nothing, and not sought without end.
#[test]
fn what_is_round_before_a_plate_is_refused_as_undetermined() {
    let mut random = random(4);
    let mut place = |i: usize| {
        let [x, y] = [0; 2].map(|_| uniform(&mut random, -80.0, 80.0));
        let (from_ball, noise) = (x.hypot(y), 0.06 * gauss(&mut random));
        let ball = if from_ball < 25.0 && i.is_multiple_of(2) {
            (625.0 - from_ball * from_ball).sqrt()
        } else {
            0.0
        };
        [x, y, 900.0 + 0.1 * x - ball + noise]
    };
    let cloud = camera((0..4000).map(&mut place).collect());
    let ball = fit_sphere(&cloud, &SphereOptions::default());
    assert!(matches!(ball, Err(FitError::Undetermined { .. })), "{ball:?}");
    let tube = fit_cylinder(&cloud, &CylinderOptions::default());
    assert!(matches!(tube, Err(FitError::Undetermined { .. })), "{tube:?}");
}

/// A pipe before a floor is no small ball: however far off its points lie, none is an outlier among them.
#[test]
fn a_pipe_before_a_floor_is_no_sphere_of_given_radius() {
    const VARIANCE_MM2: f32 = 0.06 * 0.06;
    for seed in 1..5 {
        let mut random = random(seed);
        let mut place = |i: usize| {
            let [x, y] = [-200.0, -150.0].map(|low| uniform(&mut random, low, -low));
            let noise = 0.06 * gauss(&mut random);
            if i.is_multiple_of(3) || x.abs() > 44.0 {
                return [x, y, 1000.0 + noise];
            }
            [x, y, 940.0 - (44.5_f64 * 44.5 - x * x).sqrt() + noise]
        };
        let points: Points = (0..6000).map(&mut place).collect();
        let alike = vec![[VARIANCE_MM2, 0.0, 0.0, VARIANCE_MM2, 0.0, VARIANCE_MM2]; points.len()];
        let cloud = camera(points).with_covariances_mm2(alike).unwrap();
        let ball = fit_sphere(&cloud, &SphereOptions { radius_mm: Some(20.0), ..SphereOptions::default() });
        assert!(ball.is_err(), "seed {seed}: {ball:?}");
    }
}
