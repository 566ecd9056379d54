//! The sheet of light: closed forms, another route to each answer, the mirror, the galvanometer's frame.
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use common::{WATER, scanner, stripe_pixel, window};
use nalgebra::{Matrix3, Rotation3, Unit, Vector2, Vector3};
use proptest::prelude::*;
use std::f64::consts::PI;
use uw_geom::{
    Camera, Distortion, Fan, Galvo, GeomError, Medium, Port, Ray, Scanner, Sheet, galvo_frame,
    rotation_about_x,
};

/// Rounding of a few dozen operations on numbers near 1.
const ROUNDING: f64 = 1e-12;
/// Rounding on figures near 1000 mm, through a triangulation angle of tens of degrees; it grows with distance squared.
const ROUNDING_MM: f64 = 1e-8;

/// A fan whose plane holds x and leans by `lean` from z towards y, behind a window square to z.
fn leaning_fan(lean: f64, glass: f64, outside: f64) -> Sheet {
    Sheet {
        apex_mm: Vector3::new(5.0, -7.0, 2.0),
        normal: Vector3::new(0.0, lean.cos(), -lean.sin()),
        port: Port::new(Vector3::z(), 100.0, 8.0, Medium::of_index(glass)).unwrap(),
        outside: Medium::of_index(outside),
    }
}

/// The meeting by brute force: bracket every change of sign of `off_sheet` along the ray, bisect the first.
fn bracketed(sheet: &Sheet, ray: &Ray) -> Option<f64> {
    let off = |t: f64| sheet.off_sheet(&ray.at(t)).ok();
    // From where the ray is in front of the window, in steps that grow.
    let outer_face = (sheet.port.distance_mm + sheet.port.thickness_mm
        - (ray.origin - sheet.apex_mm).dot(&sheet.port.normal))
        / ray.direction.dot(&sheet.port.normal);
    let stations: Vec<f64> = (0..800).map(|i| outer_face.max(0.0) + 1e-6 * 1.035f64.powi(i)).collect();
    for pair in stations.windows(2) {
        let (mut low, mut high) = (pair[0], pair[1]);
        if let (Some(a), Some(b)) = (off(low), off(high))
            && a * b <= 0.0
        {
            for _ in 0..200 {
                let middle = 0.5 * (low + high);
                if off(middle)? * a > 0.0 { low = middle } else { high = middle }
            }
            return Some(0.5 * (low + high));
        }
    }
    None
}

proptest! {
    /// The closed forms of PAPER.md §4, with x along the fan's trace on the window: the outside directions lie on an
    /// elliptic cone and lean by tan θ_w(φ) = sin θ / √((n² − 1)/cos²φ + cos²θ), whatever the glass.
    #[test]
    fn refracted_fan_lies_on_the_elliptic_cone(
        lean in 0.05..1.2f64, phi in -1.2..1.2f64, n in 1.0..1.6f64, glass in 1.0..1.9f64,
    ) {
        let d = leaning_fan(lean, glass, n).ray(phi).unwrap().direction;
        let s = lean.sin();
        let cone = (n * n - 1.0) * d.x * d.x + (n * n / (s * s) - 1.0) * d.y * d.y - d.z * d.z;
        prop_assert!(cone.abs() < ROUNDING * n * n / (s * s), "{cone}");
        let tangent = s / ((n * n - 1.0) / phi.cos().powi(2) + lean.cos().powi(2)).sqrt();
        prop_assert!((d.y / d.z - tangent).abs() < ROUNDING * (1.0 + tangent), "{}", d.y / d.z - tangent);
    }

    #[test]
    fn rays_of_the_sheet_lie_on_it(voltage in -4.0..4f64, angle in -1.0..1f64, reach in 0.1..3000f64, n in 1.0..1.5f64) {
        let sheet = scanner().sheet(voltage, Medium::of_index(n));
        let point = sheet.ray(angle).unwrap().at(reach);
        prop_assert!(sheet.off_sheet(&point).unwrap().abs() < ROUNDING);
    }

    /// Point + voltage → pixel, pixel + voltage → the point.
    #[test]
    fn triangulation_and_projection_undo_each_other(
        voltage in -3.0..3f64, angle in -0.3..0.3f64, depth in 300.0..3000f64, n in 1.0..1.4f64,
    ) {
        let (scanner, outside) = (scanner(), Medium::of_index(n));
        let ray = scanner.sheet(voltage, outside).ray(angle).unwrap();
        let point = ray.at((depth - ray.origin.z) / ray.direction.z);
        // In sight of this camera, generously.
        prop_assume!(point.x.abs() < 0.5 * depth && point.y.abs() < 0.5 * depth);
        let seen = scanner.observe(&point, voltage, outside).unwrap();
        prop_assert!(seen.off_sheet.abs() < ROUNDING);
        let rounding_mm = ROUNDING_MM * (1.0 + (depth / 1000.0).powi(2));
        let back = scanner.triangulate(&seen.pixel, voltage, outside).unwrap();
        prop_assert!((back - point).norm() < rounding_mm, "{}", (back - point).norm());
        let exposure = scanner.exposure(voltage, outside).unwrap();
        prop_assert!((exposure.triangulate(&seen.pixel).unwrap() - point).norm() < rounding_mm);
    }

    /// Any ray against any fan: what is found is the meeting, what is not found isn't there.
    #[test]
    fn meeting_is_that_of_a_brute_force_search(
        lean in -1.2..1.2f64, n in 1.0..1.6f64, glass in 1.0..1.9f64,
        from in prop::array::uniform3(-300.0..300f64), to in prop::array::uniform3(-0.9..0.9f64),
    ) {
        let sheet = leaning_fan(lean, glass, n);
        let ray = Ray {
            origin: Vector3::new(from[0], from[1] * 2.0, from[2]),
            direction: Vector3::new(to[0], to[1], 1.0).normalize(),
        };
        match (sheet.intersect(&ray), bracketed(&sheet, &ray)) {
            (Ok(point), Some(t)) => {
                let error = (point - ray.at(t)).norm();
                // Rounding grows with how shallowly ray and sheet meet; one that grazes may meet twice.
                let second = sheet.off_sheet(&point).unwrap().abs() < ROUNDING && (point - ray.origin).norm() > t;
                prop_assert!(error < 1e-7 * (1.0 + t) || second, "{error} at {t}");
            }
            (Err(GeomError::NoIntersection), None) => {}
            // Beyond the search's stations, or on its far side of a shallow meeting.
            (Ok(point), None) => {
                let t = (point - ray.origin).norm();
                prop_assert!(sheet.off_sheet(&point).unwrap().abs() < 1e-9 && t > 4e5, "{point} {t}");
            }
            (found, expected) => prop_assert!(false, "{found:?} but {expected:?}"),
        }
    }

    /// A real apex and a real mirror, offset from its axis, turned and reflected: the sheet that the model makes of it.
    #[test]
    fn virtual_apex_is_the_real_one_in_the_real_mirror(voltage in -5.0..5f64, offset in -1.0..1f64, apex_x in -5.0..5f64) {
        let base = scanner();
        let scanner = Scanner { fan: Fan { mirror_offset_mm: offset, apex_mm: Vector3::new(apex_x, 0.3, -60.0), ..base.fan }, ..base };
        let (fan, galvo) = (scanner.fan, scanner.galvo);
        let mirror = |angle: f64| rotation_about_x(angle) * Vector3::new(0.0, fan.mirror_normal_rad.sin(), fan.mirror_normal_rad.cos());
        let reflect = |p: Vector3<f64>, m: Vector3<f64>, e: f64| p - m * 2.0 * (p.dot(&m) - e);
        // The real apex: the virtual one of a mirror through the axis, reflected back at the reference voltage.
        let real = reflect(fan.apex_mm, mirror(0.0), 0.0);
        let real_normal = reflect(Vector3::new(fan.tilt_rad.sin(), fan.tilt_rad.cos(), 0.0), mirror(0.0), 0.0);
        let m = mirror(galvo.mirror_angle(voltage));
        let sheet = scanner.sheet(voltage, Medium::air());
        let apex = galvo.origin_mm + galvo.axes * reflect(real, m, offset);
        prop_assert!((sheet.apex_mm - apex).norm() < ROUNDING * 1000.0);
        prop_assert!((sheet.normal - galvo.axes * reflect(real_normal, m, 0.0)).norm() < ROUNDING);
        // The window stays where it is.
        let face = |p: &Port, from: &Vector3<f64>| p.normal.dot(from) + p.distance_mm;
        prop_assert!((face(&sheet.port, &sheet.apex_mm) - face(&scanner.laser_port, &galvo.origin_mm)).abs() < ROUNDING * 1000.0);
    }

    /// FORMATS §3: x along the axis, z in the plane and outwards, y = z × x, origin the axis's point closest to the camera.
    #[test]
    fn galvo_frame_keeps_its_conventions(
        point in prop::array::uniform3(-500.0..500f64), axis in prop::array::uniform3(-1.0..1f64),
        normal in prop::array::uniform3(-1.0..1f64), outwards in prop::array::uniform3(-1.0..1f64), along in -1e3..1e3f64,
    ) {
        let [point, axis, normal, outwards] = [point, axis, normal, outwards].map(Vector3::from);
        prop_assume!(axis.norm() > 0.1 && axis.cross(&normal).norm() > 0.05);
        let (origin, axes) = galvo_frame(&point, &(axis * 3.0), &(normal * 5.0), &outwards).unwrap();
        prop_assert!((axes.transpose() * axes - Matrix3::identity()).norm() < ROUNDING);
        prop_assert!((axes.determinant() - 1.0).abs() < ROUNDING);
        let (x, y, z) = (axes.column(0), axes.column(1), axes.column(2));
        prop_assert!((x - axis.normalize()).norm() < ROUNDING && (y - z.cross(&x)).norm() < ROUNDING);
        prop_assert!(z.dot(&normal).abs() < ROUNDING && z.dot(&outwards) >= 0.0);
        prop_assert!((origin - point).cross(&x).norm() < ROUNDING * 1e3 && origin.norm() <= (point + axis * along).norm() + ROUNDING_MM);
    }
}

/// A mirror surface e beside its axis moves the virtual apex by 2e along the mirror's normal, at every voltage.
#[test]
fn mirror_offset_shifts_the_apex_by_twice_itself() {
    let base = scanner();
    let without = Scanner { fan: Fan { mirror_offset_mm: 0.0, ..base.fan }, ..base };
    for voltage in [-4.0, -1.6, 0.0, 3.0] {
        let shift =
            base.sheet(voltage, Medium::air()).apex_mm - without.sheet(voltage, Medium::air()).apex_mm;
        let axis = Unit::new_normalize(base.galvo.axes.column(0).into_owned());
        let at_reference = base.galvo.axes * Vector3::new(0.0, 0.8f64.sin(), 0.8f64.cos());
        let normal = Rotation3::from_axis_angle(&axis, base.galvo.mirror_angle(voltage)) * at_reference;
        assert!((shift - normal * 0.4).norm() < ROUNDING * 1000.0, "{voltage} V: {shift}");
    }
}

/// The beam that the mirror turns into z comes from the camera's side, however baseline, axis and beam lie.
#[test]
fn the_lasers_body_lies_on_the_cameras_side_by_design() {
    for (sense, lean) in [(1.0, -0.44), (-1.0, -0.44), (1.0, 0.3), (-1.0, 0.3)] {
        for twelfth in 0..12 {
            let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), f64::from(twelfth) * PI / 6.0);
            let axis = turn * Vector3::new(0.02, sense, 0.01);
            let beam = turn * Vector3::new(lean, 0.0, 0.9);
            let point = turn * Vector3::new(400.0, 12.0, -13.0);
            let (origin_mm, axes) = galvo_frame(&point, &axis, &axis.cross(&beam), &beam).unwrap();
            let galvo = Galvo { origin_mm, axes, ..scanner().galvo };
            let (s, c) = galvo.mirror_normal_rad().sin_cos();
            let (z, normal) = (axes.column(2), axes * Vector3::new(0.0, s, c));
            let before = z - normal * (2.0 * z.dot(&normal));
            assert!(before.dot(&z).abs() < ROUNDING, "{twelfth}, {sense}, {lean}");
            assert!(before.dot(&origin_mm) > 0.5 * origin_mm.norm(), "{twelfth}, {sense}, {lean}");
        }
    }
}

#[test]
fn mirror_angle_is_the_polynomial_from_the_reference() {
    let galvo = scanner().galvo;
    let at = |v: f64| 0.035 * v + 2e-5 * v * v - 1e-5 * v * v * v;
    for voltage in [-10.0, -1.6, 0.0, 2.5, 10.0] {
        assert!((galvo.mirror_angle(voltage) - (at(voltage) - at(-1.6))).abs() < ROUNDING);
    }
    assert!(galvo.mirror_angle(-1.6).abs() < ROUNDING);
}

/// A rising voltage turns the beam about +x of the galvanometer frame by twice the mirror's angle.
#[test]
fn beam_turns_by_twice_the_mirror_about_the_axis() {
    let s = scanner();
    let at = |v: f64| s.sheet(v, Medium::air()).normal;
    let axis = Unit::new_normalize(s.galvo.axes.column(0).into_owned());
    let turned =
        Rotation3::from_axis_angle(&axis, 2.0 * (s.galvo.mirror_angle(2.0) - s.galvo.mirror_angle(-1.0)))
            * at(-1.0);
    assert!((turned - at(2.0)).norm() < ROUNDING);
}

/// Square to the window the fan stays a plane, leaning it does not: PAPER.md §3 gives millimetres in the field of view.
#[test]
fn sheet_is_flat_only_when_square_to_its_window() {
    let off = |lean: f64| {
        let sheet = leaning_fan(lean, 1.52, WATER);
        let plane = sheet.middle_plane().unwrap();
        (-10..=10)
            .map(|i| {
                let ray = sheet.ray(f64::from(i) * 0.025).unwrap();
                plane.distance_mm(&ray.at((900.0 - ray.origin.z) / ray.direction.z)).abs()
            })
            .fold(0.0, f64::max)
    };
    assert!(off(0.0) < ROUNDING_MM);
    assert!((2.0..10.0).contains(&off(0.45)), "{}", off(0.45));
}

#[test]
fn what_cannot_be_seen_is_an_error() {
    let (s, water) = (scanner(), Medium::of_index(WATER));
    let pixel = stripe_pixel(&s, 0.0, 0.05, 800.0, water);
    assert!(s.triangulate(&pixel, 0.0, water).is_ok());
    // NaN anywhere.
    for bad in [Vector2::new(f64::NAN, 10.0), Vector2::new(10.0, f64::NAN), Vector2::repeat(f64::INFINITY)] {
        assert!(matches!(s.triangulate(&bad, 0.0, water), Err(GeomError::Undistortable { .. })));
        assert!(s.triangulate_with_derivatives(&bad, 0.0, water).is_err());
    }
    for voltage in [f64::NAN, f64::INFINITY] {
        assert!(s.triangulate(&pixel, voltage, water).is_err());
        assert!(s.exposure(voltage, water).is_err());
    }
    for index in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
        assert!(s.triangulate(&pixel, 0.0, Medium::of_index(index)).is_err(), "{index}");
    }
    for bad in [
        Vector3::repeat(f64::NAN),
        Vector3::new(0.0, f64::INFINITY, 900.0),
        Vector3::new(0.0, 0.0, f64::INFINITY),
    ] {
        assert!(s.observe(&bad, 0.0, water).is_err(), "{bad}");
    }
    // Behind a window, and behind the camera.
    for z in [15.0, 0.0, -500.0] {
        let error = s.project(&Vector3::new(1.0, 2.0, z), water).unwrap_err();
        assert!(
            matches!(error, GeomError::BehindWindow { behind_mm } if (behind_mm - (18.0 - z)).abs() < 1.0),
            "{error}"
        );
    }
    assert!(s.camera.project(&Vector3::new(0.0, 0.0, -1.0)).is_err());
    // Pixels past the turning point of the radial curve: r (1 − 0.3 r²) never gets beyond 0.703.
    let barrel = Distortion { k1: -0.3, ..Distortion::none() };
    let camera = Camera { distortion: barrel, ..s.camera };
    assert!(camera.unproject(&Vector2::new(388.0 + 1416.0 * 0.702, 279.0)).is_ok());
    assert!(
        barrel.is_one_to_one_at(&Vector2::new(1.05, 0.0))
            && !barrel.is_one_to_one_at(&Vector2::new(0.0, 1.06))
    );
    let error = camera.unproject(&Vector2::new(388.0 + 1416.0 * 0.704, 279.0)).unwrap_err();
    assert!(matches!(error, GeomError::Undistortable { .. }), "{error}");
    // A ray that leaves the sheet behind it.
    let away =
        Ray { origin: Vector3::new(-100.0, 0.0, 20.0), direction: Vector3::new(-0.9, 0.0, 0.19f64.sqrt()) };
    assert!(matches!(s.sheet(0.0, water).intersect(&away), Err(GeomError::NoIntersection)));
    // A fan along its window; an apex in front of it.
    let sheet = s.sheet(0.0, water);
    let along = Sheet { normal: sheet.port.normal, ..sheet };
    let ahead = Sheet { port: Port { distance_mm: -1.0, ..sheet.port }, ..sheet };
    let ray = s.pixel_ray(&pixel, water).unwrap();
    assert!(matches!(along.intersect(&ray), Err(GeomError::NotThroughWindow { .. })));
    assert!(along.ray(0.0).is_err() && along.middle_plane().is_err());
    assert!(matches!(ahead.intersect(&ray), Err(GeomError::Invalid { .. })));
    assert!(ahead.off_sheet(&Vector3::new(0.0, 0.0, 800.0)).is_err() && ahead.ray(0.0).is_err());
}

#[test]
fn impossible_figures_are_refused() {
    let glass = Medium::of_index(1.5);
    assert!(Port::new(Vector3::new(0.0, 0.0, 1.1), 10.0, 8.0, glass).is_err());
    assert!(Port::new(Vector3::repeat(f64::NAN), 10.0, 8.0, glass).is_err());
    assert!(Port::new(Vector3::z(), -1.0, 8.0, glass).is_err());
    assert!(Port::new(Vector3::z(), 1.0, f64::NAN, glass).is_err());
    assert!(Port::new(Vector3::z(), 1.0, 8.0, Medium::of_index(0.9)).is_err());
    let (p, z, nan) = (Vector3::new(1.0, 2.0, 3.0), Vector3::z(), Vector3::repeat(f64::NAN));
    for (point, axis, normal) in [
        (p, Vector3::zeros(), z),
        (p, z, z),
        (p, nan, z),
        (p, z, nan),
        (nan, z, Vector3::x()),
        (p, z, Vector3::zeros()),
    ] {
        assert!(matches!(galvo_frame(&point, &axis, &normal, &z), Err(GeomError::Invalid { .. })));
    }
    let window = window(0.0, 0.0, 10.0);
    assert!(window.ray_out(&Vector3::zeros(), &Vector3::zeros(), glass).is_err());
    assert!(window.ray_out(&Vector3::zeros(), &Vector3::x(), glass).is_err());
}
