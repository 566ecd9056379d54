//! The model against an independent ray-traced simulator's truth (tests/data/README.md): other code, other derivation of the
//! sheet (real apex and mirror instead of a virtual apex), three instruments, air and water.
#![allow(clippy::unwrap_used, reason = "tests")]

use nalgebra::{Rotation3, Unit, Vector2, Vector3};
use std::collections::BTreeMap;
use uw_geom::{Camera, Distortion, Fan, Galvo, Medium, Port, Scanner, galvo_frame};

/// The truth's pixels are 32-bit floats: half a unit in the last place is 3e-5 px below 1024 and 6e-5 px above, and the
/// point's own rounding (3e-5 mm at 1 m) is up to 1e-4 px more.
const PIXEL_TOLERANCE: f64 = 1.5e-4;
/// That pixel rounding across a triangulation angle of 20 to 30° (up to 2 mm of depth a pixel), plus the point's.
const POINT_TOLERANCE_MM: f64 = 3e-4;
/// The point's rounding as an angle at the fan's apex.
const SINE_TOLERANCE: f64 = 1.5e-7;
/// The simulator's own frame, to the rounding of figures near 500.
const FRAME_TOLERANCE: f64 = 1e-9;

type Figures = BTreeMap<String, Vec<f64>>;

fn read(name: &str) -> String {
    std::fs::read_to_string(format!("{}/tests/data/{name}", env!("CARGO_MANIFEST_DIR"))).unwrap()
}

fn rigs() -> BTreeMap<String, Figures> {
    let mut rigs: BTreeMap<String, Figures> = BTreeMap::new();
    for line in read("simulated_rigs.csv").lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let values = fields[2].split(' ').map(|v| v.parse().unwrap()).collect();
        rigs.entry(fields[0].into()).or_default().insert(fields[1].into(), values);
    }
    rigs
}

fn vector(figures: &Figures, name: &str) -> Vector3<f64> {
    Vector3::from_column_slice(&figures[name])
}

/// The instrument in our terms: the real apex mirrored at the reference voltage, in the galvanometer frame.
fn scanner(f: &Figures) -> (Scanner, Medium) {
    let c = &f["camera"];
    let d = &f["distortion_k1_k2_p1_p2_k3"];
    let [degrees_per_volt, c2, c3, reference_v] = f["galvo_degrees_per_volt_c2_c3_reference"][..] else {
        panic!()
    };
    let (axis_point, axis) = (vector(f, "axis_point_mm"), Unit::new_normalize(vector(f, "axis_direction")));
    let at = |v: f64| (v * (degrees_per_volt + v * (c2 + v * c3))).to_radians();
    let mirror_normal = Rotation3::from_axis_angle(&axis, at(reference_v)) * vector(f, "mirror_normal_at_0v");
    let offset = f["mirror_offset_mm"][0];
    let mirrored = |v: Vector3<f64>| v - mirror_normal * 2.0 * v.dot(&mirror_normal);

    let fan_normal = mirrored(vector(f, "laser_fan_normal"));
    let (origin_mm, axes) = galvo_frame(&axis_point, &axis, &fan_normal, &Vector3::z()).unwrap();
    assert!((origin_mm - vector(f, "frame_origin_mm")).norm() < FRAME_TOLERANCE);
    for (ours, theirs) in axes.column_iter().zip(["frame_x", "frame_y", "frame_z"]) {
        assert!((ours - vector(f, theirs)).norm() < FRAME_TOLERANCE, "{theirs}");
    }

    let apex = axis_point + mirrored(vector(f, "laser_apex_mm") - axis_point) - origin_mm;
    let (normal, m) = (axes.transpose() * fan_normal, axes.transpose() * mirror_normal);
    assert!(normal.z.abs() < FRAME_TOLERANCE);
    let camera_glass = &f["camera_port_distance_thickness_index"];
    let laser_glass = &f["laser_port_offset_thickness_index"];
    let laser_window = vector(f, "laser_port_normal");
    let scanner = Scanner {
        camera: Camera {
            fx: c[0],
            fy: c[1],
            cx: c[2],
            cy: c[3],
            distortion: Distortion { k1: d[0], k2: d[1], p1: d[2], p2: d[3], k3: d[4] },
        },
        camera_port: Port::new(
            vector(f, "camera_port_normal"),
            camera_glass[0],
            camera_glass[1],
            Medium::of_index(camera_glass[2]),
        )
        .unwrap(),
        galvo: Galvo {
            origin_mm,
            axes,
            radians_per_volt: degrees_per_volt.to_radians(),
            quadratic: c2.to_radians(),
            cubic: c3.to_radians(),
            reference_v,
        },
        fan: Fan {
            apex_mm: axes.transpose() * apex,
            tilt_rad: (normal.x / normal.y).atan(),
            mirror_offset_mm: offset,
            mirror_normal_rad: m.y.atan2(m.z),
        },
        laser_port: Port::new(
            laser_window,
            laser_glass[0] - laser_window.dot(&origin_mm),
            laser_glass[1],
            Medium::of_index(laser_glass[2]),
        )
        .unwrap(),
    };
    (scanner, Medium::of_index(f["outside_index"][0]))
}

#[test]
fn pixels_and_points_are_those_of_the_simulator() {
    let scanners: BTreeMap<String, (Scanner, Medium)> =
        rigs().iter().map(|(name, figures)| (name.clone(), scanner(figures))).collect();
    let mut worst: BTreeMap<String, (usize, f64, f64, f64)> = BTreeMap::new();
    for line in read("simulated_points.csv").lines().skip(1) {
        let (capture, numbers) = line.split_once(',').unwrap();
        let n: Vec<f64> = numbers.split(',').map(|v| v.parse().unwrap()).collect();
        let (voltage, uv, xyz) = (n[0], Vector2::new(n[1], n[2]), Vector3::new(n[3], n[4], n[5]));
        let (scanner, outside) = &scanners[capture];
        let seen = scanner.observe(&xyz, voltage, *outside).unwrap();
        let point = scanner.triangulate(&uv, voltage, *outside).unwrap();
        let w = worst.entry(capture.into()).or_insert((0, 0.0, 0.0, 0.0));
        w.0 += 1;
        w.1 = w.1.max((seen.pixel - uv).norm());
        w.2 = w.2.max((point - xyz).norm());
        w.3 = w.3.max(seen.off_sheet.abs());
    }
    assert_eq!(worst.len(), scanners.len());
    for (capture, (points, pixel, point, off_sheet)) in &worst {
        assert!(*points >= 100, "{capture}: {points} points");
        assert!(*pixel < PIXEL_TOLERANCE, "{capture}: {pixel} px");
        assert!(*point < POINT_TOLERANCE_MM, "{capture}: {point} mm");
        assert!(*off_sheet < SINE_TOLERANCE, "{capture}: {off_sheet}");
    }
}
