//! What the points of a cloud share does not average out: not in a fit, nor between shapes.

use crate::scene::{Line, ball_lines, cloud, random};
use uw_cloud::{PointCloud, ShapeFit, ShapeOptions, SphereOptions, find_shapes, fit_sphere, relations};

const BALLS: [([f64; 3], f64); 2] = [([50.0, -20.0, 860.0], 25.0), ([-60.0, 20.0, 880.0], 30.0)];
/// By so much a ball's points lie further out where what they share is off by one standard deviation, mm.
const SWELLS_MM: f64 = 0.05;

fn balls(balls: &[([f64; 3], f64)]) -> PointCloud {
    let lines: Vec<(Line, f64)> = balls.iter().flat_map(|&(c, r)| ball_lines(c, r, 0.12)).collect();
    cloud(&lines, 0.1, &mut random(5))
}

/// The cloud with a step of each point.
fn sharing(cloud: &PointCloud, step: impl Fn(&[f64; 3]) -> [f64; 3]) -> PointCloud {
    let steps = cloud.positions_mm().iter().map(|p| step(p).map(|c| c as f32)).collect();
    cloud.clone().with_shared_mm(steps).expect("one a point")
}

/// Away from the middle of the ball that it is of.
fn outwards(p: &[f64; 3]) -> [f64; 3] {
    let off = |(center, _): &([f64; 3], f64)| [0, 1, 2].map(|k| p[k] - center[k]);
    let way = |d: [f64; 3]| d.iter().map(|c| c * c).sum::<f64>().sqrt();
    let near = BALLS.iter().map(off).min_by(|a, b| way(*a).total_cmp(&way(*b))).expect("a ball");
    near.map(|c| c / way(near) * SWELLS_MM)
}

#[test]
fn a_ball_whose_points_share_a_swelling_is_as_unsure_of_its_radius() {
    let alone = balls(&BALLS[..1]);
    let shared = sharing(&alone, outwards);
    let [before, after] =
        [&alone, &shared].map(|cloud| fit_sphere(cloud, &SphereOptions::default()).unwrap());
    assert!((before.radius_mm - after.radius_mm).abs() < 1e-12);
    let expected = before.sigma_radius_mm.hypot(SWELLS_MM);
    assert!(before.sigma_radius_mm < 0.2 * SWELLS_MM, "{before:?}");
    assert!((after.sigma_radius_mm / expected - 1.0).abs() < 0.02, "{after:?} for {expected}");
    // The centre stays where it is.
    for (a, b) in after.sigma_center_mm.iter().zip(before.sigma_center_mm) {
        assert!(*a < b + 0.1 * SWELLS_MM, "{after:?}");
    }
}

#[test]
fn what_moves_both_balls_alike_leaves_their_distance() {
    const STEP_MM: f64 = 0.02;
    let alone = balls(&BALLS);
    let sigma = |cloud: &PointCloud| {
        let found = find_shapes(cloud, &ShapeOptions::default()).unwrap();
        let balls = found.shapes.iter().filter(|s| matches!(s.fit, ShapeFit::Sphere(_))).count();
        assert_eq!((balls, found.shapes.len()), (2, 2));
        relations(cloud, &found.shapes, None).distances_mm[0].sigma
    };
    let (own, along) = (sigma(&alone), |p: &[f64; 3]| [STEP_MM.copysign(p[0]), 0.0, 0.0]);
    let together = sigma(&sharing(&alone, |_| [STEP_MM, 0.0, 0.0]));
    assert!((together / own - 1.0).abs() < 0.05, "{together} for {own}");
    let apart = sigma(&sharing(&alone, along));
    // Along x lie 110 of the 119 mm between them.
    let expected = own.hypot(2.0 * STEP_MM * 110.0 / (110.0_f64.powi(2) + 40.0_f64.powi(2) + 400.0).sqrt());
    assert!((apart / expected - 1.0).abs() < 0.05, "{apart} for {expected}");
}
