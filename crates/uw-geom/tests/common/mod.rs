//! An instrument like the paper's, real enough that nothing is square, for every test to start from.
#![allow(dead_code, clippy::unwrap_used, reason = "shared by several test binaries; a test may panic")]

use nalgebra::{Vector2, Vector3};
use uw_geom::{Camera, Distortion, Fan, Galvo, Medium, Port, Scanner, galvo_frame};

pub const WATER: f64 = 1.335;

pub fn tilted(x: f64, y: f64) -> Vector3<f64> {
    Vector3::new(x, y, (1.0 - x * x - y * y).sqrt())
}

pub fn window(x: f64, y: f64, distance_mm: f64) -> Port {
    Port::new(tilted(x, y), distance_mm, 8.0, Medium::of_index(1.52)).unwrap()
}

pub fn camera() -> Camera {
    Camera {
        fx: 1416.0,
        fy: 1422.0,
        cx: 388.0,
        cy: 279.0,
        distortion: Distortion { k1: -0.19, k2: 0.06, p1: -6e-4, p2: -3e-4, k3: 0.01 },
    }
}

/// Baseline 400 mm, windows tilted, fan tilted and beside the axis, mirror beside the axis, galvanometer not linear.
pub fn scanner() -> Scanner {
    let plane_normal = Vector3::new(0.45f64.cos(), 0.0, 0.45f64.sin());
    let (origin_mm, axes) = galvo_frame(
        &Vector3::new(400.0, 12.0, -13.0),
        &Vector3::new(0.01, -1.0, 0.02),
        &plane_normal,
        &Vector3::z(),
    )
    .unwrap();
    Scanner {
        camera: camera(),
        camera_port: window(-0.008, 0.005, 10.0),
        galvo: Galvo {
            origin_mm,
            axes,
            radians_per_volt: 0.035,
            quadratic: 2e-5,
            cubic: -1e-5,
            reference_v: -1.6,
        },
        fan: Fan {
            apex_mm: Vector3::new(2.0, 0.3, -60.0),
            tilt_rad: 0.004,
            mirror_offset_mm: 0.2,
            mirror_normal_rad: 0.8,
        },
        laser_port: window(0.006, -0.007, 40.0),
    }
}

/// A stripe pixel: the row, and where in it the sheet at `voltage` shows at `depth_mm`.
pub fn stripe_pixel(
    scanner: &Scanner,
    voltage: f64,
    fan_angle: f64,
    depth_mm: f64,
    outside: Medium,
) -> Vector2<f64> {
    let ray = scanner.sheet(voltage, outside).ray(fan_angle).unwrap();
    scanner.project(&ray.at((depth_mm - ray.origin.z) / ray.direction.z), outside).unwrap()
}
