//! Windows: limits that are known exactly, reversibility, and forward projection by another route.
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use common::{WATER, camera, scanner, tilted, window};
use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;
use uw_geom::{GeomError, Medium, Port, Scanner, refract};

/// Rounding of a few dozen operations on numbers near 1, or relative to the larger number.
const ROUNDING: f64 = 1e-12;
/// The same on figures near 1000 mm.
const ROUNDING_MM: f64 = 1e-9;
/// The same on figures near 1000 px.
const ROUNDING_PX: f64 = 1e-9;

fn direction(angle: f64, turn: f64) -> Vector3<f64> {
    Vector3::new(angle.sin() * turn.cos(), angle.sin() * turn.sin(), angle.cos())
}

/// The forward projection's equation by bisection: q with h₀q + Σ hᵢ q/√(nᵢ² + (nᵢ² − 1) q²) = r.
fn bisect_q(port: &Port, depth: f64, outside: f64, r: f64) -> f64 {
    let side = |q: f64| {
        let layer = |h: f64, n: f64| h * q / (n * n + (n * n - 1.0) * q * q).sqrt();
        port.distance_mm * q + layer(port.thickness_mm, port.glass.index) + layer(depth, outside)
    };
    let (mut low, mut high) = (0.0, 1e6);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if side(middle) < r { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

proptest! {
    /// Reversibility to 1e-12 up to 85° in air: a ray traced out comes back to the direction it left in.
    #[test]
    fn a_ray_out_is_seen_where_it_came_from(
        angle in 0.0..85f64, turn in 0.0..6.3f64, outside in 1.0..1.6f64, glass in 1.0..1.8f64,
        distance in 0.5..60f64, thickness in 0.0..20f64, reach in 1.0..3000f64,
        tilt in prop::array::uniform2(-0.4..0.4f64),
    ) {
        let port = Port::new(tilted(tilt[0], tilt[1]), distance, thickness, Medium::of_index(glass)).unwrap();
        let outside = Medium::of_index(outside);
        let across = port.normal.cross(&Vector3::x()).normalize();
        let d = nalgebra::Rotation3::new(port.normal * turn) * (port.normal * angle.to_radians().cos() + across * angle.to_radians().sin());
        let centre = Vector3::new(3.0, -4.0, 5.0);
        let ray = port.ray_out(&centre, &(d * 7.0), outside).unwrap();
        prop_assert!((ray.direction.norm() - 1.0).abs() < ROUNDING);
        let back = port.air_direction(&centre, &ray.at(reach), outside).unwrap();
        // The part along the normal is 1 by convention, so that errors grow with 1/cos² in the tangent: compare the angle.
        let error = back.cross(&d).norm() / back.norm();
        prop_assert!(error < ROUNDING, "{error}");
    }

    /// The same as a camera does it: pixel → ray → point → pixel.
    #[test]
    fn a_pixel_is_seen_where_it_is(u in -20.0..790f64, v in -20.0..600f64, reach in 1.0..5000f64, index in 1.0..1.5f64) {
        let (scanner, outside) = (scanner(), Medium::of_index(index));
        let pixel = Vector2::new(u, v);
        let point = scanner.pixel_ray(&pixel, outside).unwrap().at(reach);
        let back = scanner.project(&point, outside).unwrap();
        prop_assert!((back - pixel).norm() < ROUNDING * 1000.0, "{}", (back - pixel).norm());
    }

    /// `ray_out` is Snell's law at the inner face and again at the outer face.
    #[test]
    fn a_window_is_two_refractions(angle in 0.0..89f64, turn in 0.0..6.3f64, outside in 1.0..1.6f64, glass in 1.0..1.8f64) {
        let port = Port { glass: Medium::of_index(glass), ..window(0.1, -0.2, 12.0) };
        let d = nalgebra::Rotation3::rotation_between(&Vector3::z(), &port.normal).unwrap() * direction(angle.to_radians(), turn);
        let outside = Medium::of_index(outside);
        let ray = port.ray_out(&Vector3::zeros(), &d, outside).unwrap();
        let in_glass = refract(&d, &port.normal, Medium::air(), port.glass).unwrap();
        let out = refract(&in_glass, &port.normal, port.glass, outside).unwrap();
        prop_assert!((ray.direction - out).norm() < ROUNDING);
        let exit = d * (12.0 / d.dot(&port.normal)) + in_glass * (8.0 / in_glass.dot(&port.normal));
        prop_assert!((ray.origin - exit).norm() < ROUNDING * exit.norm());
    }

    #[test]
    fn two_half_panes_are_one(angle in 0.0..85f64, turn in 0.0..6.3f64, outside in 1.0..1.6f64) {
        let (whole, outside) = (window(0.05, 0.02, 10.0), Medium::of_index(outside));
        let d = direction(angle.to_radians(), turn);
        prop_assume!(d.dot(&whole.normal) > 0.05);
        let half = Port { thickness_mm: 4.0, ..whole };
        // Through the first half into more glass, then through the second half out of it: a pane that starts in glass has
        // no air in front and its ray begins inside, so trace it by hand.
        let in_first = half.ray_out(&Vector3::zeros(), &d, whole.glass).unwrap();
        let second = in_first.at(4.0 / in_first.direction.dot(&whole.normal));
        let out = refract(&in_first.direction, &whole.normal, whole.glass, outside).unwrap();
        let ray = whole.ray_out(&Vector3::zeros(), &d, outside).unwrap();
        prop_assert!((ray.origin - second).norm() < ROUNDING * second.norm() && (ray.direction - out).norm() < ROUNDING);
    }

    #[test]
    fn forward_projection_solves_its_equation(
        r in 0.0..20_000f64, turn in 0.0..6.3f64, depth in 0.01..3000f64, outside in 1.0..1.6f64,
    ) {
        let port = window(0.0, 0.0, 10.0);
        let point = Vector3::new(r * turn.cos(), r * turn.sin(), 18.0 + depth);
        let d = port.air_direction(&Vector3::zeros(), &point, Medium::of_index(outside)).unwrap();
        let (q, expected) = (d.x.hypot(d.y), bisect_q(&port, depth, outside, r));
        prop_assert!((q - expected).abs() <= ROUNDING * expected.max(1e-3), "{q} {expected}");
        prop_assert!((d.z - 1.0).abs() < ROUNDING);
    }

    /// All indices 1: the windows are not there.
    #[test]
    fn without_refraction_it_is_a_pinhole_and_a_plane(
        u in 0.0..768f64, v in 0.0..576f64, depth in 100.0..2000f64, voltage in -3.0..3f64,
    ) {
        let air = |port: Port| Port { glass: Medium::air(), ..port };
        let s = scanner();
        let s = Scanner { camera_port: air(s.camera_port), laser_port: air(s.laser_port), ..s };
        let pixel = Vector2::new(u, v);
        let d = camera().unproject(&pixel).unwrap();
        let point = d * depth;
        prop_assert!((s.project(&point, Medium::air()).unwrap() - pixel).norm() < ROUNDING_PX);
        let ray = s.pixel_ray(&pixel, Medium::air()).unwrap();
        prop_assert!(ray.origin.cross(&d).norm() < ROUNDING_MM && ray.direction.cross(&d).norm() < ROUNDING);
        let sheet = s.sheet(voltage, Medium::air());
        let plane = uw_geom::Plane::through(&sheet.apex_mm, &sheet.normal).unwrap();
        let sine = sheet.off_sheet(&point).unwrap();
        let distance = plane.distance_mm(&point) / (point - sheet.apex_mm).norm();
        prop_assert!((sine - distance).abs() < ROUNDING);
        let t = -plane.distance_mm(&Vector3::zeros()) / plane.normal.dot(&d);
        if t > 200.0 && t < 20_000.0 {
            let met = s.triangulate(&pixel, voltage, Medium::air()).unwrap();
            prop_assert!((met - d * t).norm() < ROUNDING * 100.0 * t * t / 1000.0, "{}", (met - d * t).norm());
        }
    }
}

/// PAPER.md §3: a window in air moves the viewpoint forward by t (1 − 1/n).
#[test]
fn glass_in_air_moves_the_viewpoint() {
    /// Third-order terms of the shift at the small angle below.
    const PARAXIAL_MM: f64 = 1e-4;
    let port = Port::new(Vector3::z(), 10.0, 8.0, Medium::of_index(1.52)).unwrap();
    let ray = port.ray_out(&Vector3::zeros(), &Vector3::new(0.003, 0.0, 1.0), Medium::air()).unwrap();
    let viewpoint = ray.origin.z - ray.origin.x * ray.direction.z / ray.direction.x;
    assert!((viewpoint - 8.0 * (1.0 - 1.0 / 1.52)).abs() < PARAXIAL_MM, "{viewpoint}");
    assert!((viewpoint - 2.7).abs() < 0.05);
}

/// With the centre on the window itself light reaches no farther than the critical angle: an error, not a number.
#[test]
fn beyond_the_critical_angle_of_a_centre_on_the_window() {
    let port = Port::new(Vector3::z(), 0.0, 0.0, Medium::air()).unwrap();
    let water = Medium::of_index(WATER);
    let reach = 100.0 / (WATER * WATER - 1.0).sqrt();
    let seen = |r: f64| port.air_direction(&Vector3::zeros(), &Vector3::new(r, 0.0, 100.0), water);
    let d = seen(reach * 0.99).unwrap();
    let expected = bisect_q(&port, 100.0, WATER, reach * 0.99);
    assert!((d.x / expected - 1.0).abs() < 1e-9, "{} {expected}", d.x);
    for r in [reach, reach * 1.01, reach * 100.0] {
        assert!(matches!(seen(r), Err(GeomError::TotalReflection { .. })), "{r}");
    }
}

#[test]
fn into_an_outside_thinner_than_air_there_is_total_reflection() {
    let port = window(0.0, 0.0, 10.0);
    let error = port.ray_out(&Vector3::zeros(), &direction(1.2, 0.3), Medium::of_index(0.8)).unwrap_err();
    assert!(matches!(error, GeomError::TotalReflection { .. }), "{error}");
}
