//! An instrument like the paper's, real enough that nothing is square, and scenes for it.

use nalgebra::{UnitQuaternion, Vector3};
use uw_geom::{Camera, Distortion, Fan, Galvo, Medium, Port, Rigid, Scanner, galvo_frame};
use uw_sim::{Ambient, Beam, Body, Instrument, Lens, Object, Scene, Sensor, Surface, Water};

fn window(x: f64, y: f64, distance_mm: f64) -> Port {
    let normal = Vector3::new(x, y, (1.0 - x * x - y * y).sqrt());
    Port::new(normal, distance_mm, 8.0, Medium::of_index(1.52)).unwrap()
}

pub fn instrument() -> Instrument {
    let plane_normal = Vector3::new(0.45f64.cos(), 0.0, 0.45f64.sin());
    let (origin_mm, axes) = galvo_frame(
        &Vector3::new(400.0, 12.0, -13.0),
        &Vector3::new(0.01, -1.0, 0.02),
        &plane_normal,
        &Vector3::z(),
    )
    .unwrap();
    let scanner = Scanner {
        camera: Camera {
            fx: 708.0,
            fy: 711.0,
            cx: 194.0,
            cy: 139.0,
            distortion: Distortion { k1: -0.19, k2: 0.06, p1: -6e-4, p2: -3e-4, k3: 0.01 },
        },
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
    };
    Instrument {
        scanner,
        size: [384, 288],
        beam: Beam {
            half_angle_rad: 0.26,
            middle_rad: 0.0,
            waist_radius_mm: 1.0,
            waist_at_mm: 1000.0,
            wavelength_nm: 532.0,
            level: 1.0,
        },
        lens: Lens { blur_px: 0.6, halo: 0.0, halo_px: 5.0, vignetting: 0.0 },
        sensor: Sensor {
            bits: 8,
            electrons_per_dn: 40.0,
            read_noise_dn: 0.8,
            offset_dn: 10.0,
            speckle: 0.0,
            speckle_px: 0.5,
        },
    }
}

pub fn pose(position_mm: [f64; 3], turn: [f64; 3]) -> Rigid<uw_geom::frame::Camera, Body> {
    Rigid::new(UnitQuaternion::from_scaled_axis(Vector3::from(turn)), position_mm.into())
}

pub fn scene(objects: Vec<Object>) -> Scene {
    let water = Medium::of_index(1.335);
    Scene {
        objects,
        water: Water { laser: water, ambient: water, attenuation_per_mm: 1.2e-4, backscatter_per_mm: 0.0 },
        ambient: Ambient { laser_off: 0.0, laser_on: 0.0 },
        instrument_velocity_mm_s: Vector3::zeros(),
        seed: 5,
    }
}

pub fn matt(name: &str, shape: uw_sim::Shape, position_mm: [f64; 3], turn: [f64; 3]) -> Object {
    Object::fixed(name, shape, pose(position_mm, turn), Surface::matt(0.6))
}
