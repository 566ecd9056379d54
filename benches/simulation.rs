//! Time of one simulated frame, on one thread: a scan's and a board's, at the size of the paper's camera and of a current one.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{UnitQuaternion, Vector3};
use std::hint::black_box;
use uwscan::geom::{Camera, Distortion, Fan, Galvo, Medium, Port, Rigid, Scanner, galvo_frame};
use uwscan::sim::{
    Ambient, Beam, Instrument, Lens, Object, Renderer, Scene, Sensor, Shape, Shot, Surface, Texture, Water,
};

fn instrument(size: [u32; 2]) -> Instrument {
    let axis = (Vector3::new(430.0, 0.0, -13.0), Vector3::new(0.0, -1.0, 0.0));
    let (origin_mm, axes) = galvo_frame(&axis.0, &axis.1, &Vector3::new(0.9, 0.0, 0.435), &Vector3::z())
        .expect("a plane that holds the axis");
    let port = |distance| Port::new(Vector3::z(), distance, 8.0, Medium::of_index(1.52)).expect("a window");
    let [w, h] = size.map(f64::from);
    let camera = Camera {
        fx: 1.85 * w,
        fy: 1.85 * w,
        cx: 0.5 * w,
        cy: 0.5 * h,
        distortion: Distortion { k1: -0.19, k2: 0.06, p1: -6e-4, p2: -3e-4, k3: 0.0 },
    };
    let galvo =
        Galvo { origin_mm, axes, radians_per_volt: 0.035, quadratic: 0.0, cubic: 0.0, reference_v: -1.5 };
    let fan = Fan {
        apex_mm: Vector3::new(0.0, 0.0, -90.0),
        tilt_rad: 0.0,
        mirror_offset_mm: 0.0,
        mirror_normal_rad: 0.8,
    };
    Instrument {
        scanner: Scanner { camera, camera_port: port(10.0), galvo, fan, laser_port: port(35.0) },
        size,
        beam: Beam {
            half_angle_rad: 0.26,
            middle_rad: 0.0,
            waist_radius_mm: 0.5,
            waist_at_mm: 1000.0,
            wavelength_nm: 532.0,
            level: 2.0,
        },
        lens: Lens { blur_px: 0.6, halo: 0.0, halo_px: 6.0, vignetting: 0.0 },
        sensor: Sensor {
            bits: 8,
            electrons_per_dn: 40.0,
            read_noise_dn: 0.5,
            offset_dn: 0.0,
            speckle: 0.0,
            speckle_px: 0.5,
        },
    }
}

fn scene() -> Scene {
    let thing = |name: &str, shape, z: f64, surface| {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.15, 0.05));
        Object::fixed(name, shape, Rigid::new(turn, Vector3::new(-130.0, -90.0, z)), surface)
    };
    let board = Surface {
        texture: Texture::Chessboard { inner_corners: [11, 8], square_mm: 24.0, dark: 0.05 },
        ..Surface::matt(0.9)
    };
    let water = Medium::of_index(1.335);
    Scene {
        objects: vec![
            thing("board", Shape::Plane, 980.0, board),
            thing("ball", Shape::Sphere { radius_mm: 40.0 }, 900.0, Surface::matt(0.5)),
        ],
        water: Water { laser: water, ambient: water, attenuation_per_mm: 1.2e-4, backscatter_per_mm: 0.0 },
        ambient: Ambient { laser_off: 0.8, laser_on: 0.0 },
        instrument_velocity_mm_s: Vector3::zeros(),
        seed: 1,
    }
}

fn frames(c: &mut Criterion) {
    let scene = scene();
    let mut group = c.benchmark_group("simulated frame");
    for size in [[768, 576], [1920, 1200]] {
        let instrument = instrument(size);
        let renderer = Renderer::new(&instrument, &scene).expect("a sound scene");
        group.throughput(Throughput::Elements(u64::from(size[0]) * u64::from(size[1])));
        for (name, voltage) in [("stripe", Some(0.4)), ("board", None)] {
            let shot = Shot { frame: 1, seconds: 0.0, voltage };
            // The board's light is all of a board's image, and no part of a stripe's.
            group.bench_function(format!("{name} {}x{}", size[0], size[1]), |b| {
                b.iter(|| match voltage {
                    Some(_) => black_box(renderer.develop(&shot, None)),
                    None => black_box(renderer.take(&shot)),
                });
            });
        }
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10);
    targets = frames
}
criterion_main!(benches);
