//! What an image has to do whatever the scene.

use crate::rig::{instrument, matt, pose, scene};
use nalgebra::{Vector2, Vector3};
use uw_sim::shape::{Mesh, Span};
use uw_sim::{Along, Motion, Object, Renderer, Shape, Shot, Surface, Texture};

const VOLTAGE: f64 = 0.4;

fn shot(voltage: Option<f64>) -> Shot {
    Shot { frame: 3, seconds: 0.0, voltage }
}

fn floor() -> Object {
    matt("floor", Shape::Plane, [0.0, 0.0, 1000.0], [0.1, 0.2, 0.0])
}

fn ball(z: f64) -> Object {
    matt("ball", Shape::Sphere { radius_mm: 40.0 }, [5.0, -10.0, z], [0.0; 3])
}

#[test]
fn the_curve_is_where_triangulation_says_and_on_the_surface() {
    let (instrument, scene) = (instrument(), scene(vec![ball(900.0), floor()]));
    let renderer = Renderer::new(&instrument, &scene).unwrap();
    let curve = renderer.curve(0.0, VOLTAGE, Along::Rows).unwrap();
    assert!(curve.len() > 200 && curve.iter().any(|p| p.object == 0), "{} points", curve.len());
    for p in &curve {
        let point = instrument.scanner.triangulate(&p.pixel, VOLTAGE, scene.water.laser).unwrap();
        // Rounding of the search, 1e-10 px, across 1.4 mm a pixel.
        assert!((point - p.point_mm).norm() < 1e-7, "{p:?}");
        if p.object == 0 {
            assert!(((p.point_mm - Vector3::new(5.0, -10.0, 900.0)).norm() - 40.0).abs() < 1e-9);
        }
    }
}

#[test]
fn the_middle_of_the_light_is_on_the_curve_where_the_surface_is_even() {
    let (instrument, scene) = (instrument(), scene(vec![floor()]));
    let renderer = Renderer::new(&instrument, &scene).unwrap();
    let image = renderer.expected_dn(&shot(Some(VOLTAGE)), None).unwrap();
    let curve = renderer.curve(0.0, VOLTAGE, Along::Rows).unwrap();
    let width = instrument.size[0] as usize;
    let mut worst = 0.0_f64;
    for p in curve.iter().filter(|p| p.pixel.y > 5.0 && p.pixel.y < 282.0) {
        let row = &image[p.pixel.y as usize * width..][..width];
        let sum: f32 = row.iter().sum();
        let mean = row.iter().enumerate().map(|(u, x)| u as f32 * x).sum::<f32>() / sum;
        worst = worst.max((f64::from(mean) - p.pixel.x).abs());
    }
    // The sheet's two sides stand at slightly different distances and brightness: a part of 1e-3 of the width.
    println!("worst {worst:.5} px");
    assert!(curve.len() > 270 && worst < 0.01, "{worst} px");
}

/// The bounds and steps of the renderer (mask, interpolation, quarters of a pixel) against a scene of nothing but edges, sampled anew 24 × 24
/// times a pixel by a coarse image of a finer camera.
#[test]
fn a_finer_camera_sees_the_same_light() {
    const FINER: u32 = 6;
    // An outline that runs along the pixels is placed to an eighth of one at worst; the lens spreads that over two and a half.
    const EDGE: f32 = 0.05;
    let coarse = instrument();
    let board = Surface {
        texture: Texture::Chessboard { inner_corners: [9, 7], square_mm: 20.0, dark: 0.05 },
        ..Surface::matt(0.9)
    };
    let board_pose = pose([-80.0, -60.0, 960.0], [0.1, -0.15, 0.05]);
    let mut scene = scene(vec![ball(880.0), Object::fixed("board", Shape::Plane, board_pose, board)]);
    scene.ambient.laser_off = 0.8;
    let mut fine = coarse.clone();
    let k = f64::from(FINER);
    fine.size = coarse.size.map(|n| n * FINER);
    fine.lens.blur_px = coarse.lens.blur_px * k;
    let c = &mut fine.scanner.camera;
    (c.fx, c.fy) = (c.fx * k, c.fy * k);
    (c.cx, c.cy) = ((c.cx + 0.5) * k - 0.5, (c.cy + 0.5) * k - 0.5);
    for voltage in [Some(VOLTAGE), None] {
        let image = |instrument| {
            let renderer = Renderer::new(instrument, &scene).unwrap();
            renderer.expected_dn(&shot(voltage), renderer.ambient(0.0).as_ref()).unwrap()
        };
        let (few, many) = (image(&coarse), image(&fine));
        let (width, wide) = (coarse.size[0] as usize, fine.size[0] as usize);
        let peak = few.iter().copied().fold(0.0, f32::max);
        let (mut worst, mut square) = (0.0_f32, 0.0_f64);
        for (k, value) in few.iter().enumerate() {
            let (u, v) = (k % width * FINER as usize, k / width * FINER as usize);
            let block = (0..FINER as usize).flat_map(|j| &many[(v + j) * wide + u..][..FINER as usize]);
            let mean = block.sum::<f32>() / (FINER * FINER) as f32;
            worst = worst.max((mean - value).abs() / peak);
            square += f64::from((mean - value) / peak).powi(2);
        }
        let rms = (square / few.len() as f64).sqrt();
        println!("laser {}: worst {worst:.5}, rms {rms:.6} of the peak", voltage.is_some());
        assert!(worst < EDGE && rms < 0.001, "{worst} {rms}");
    }
}

#[test]
fn nothing_is_lit_behind_what_stands_in_the_light() {
    let instrument = instrument();
    let lit = |objects| {
        let scene = scene(objects);
        let renderer = Renderer::new(&instrument, &scene).unwrap();
        let curve = renderer.curve(0.0, VOLTAGE, Along::Rows).unwrap();
        let image = renderer.expected_dn(&shot(Some(VOLTAGE)), None).unwrap();
        (curve, image.iter().sum::<f32>())
    };
    let (open, light) = lit(vec![floor()]);
    // A bar across the laser's way, out of the camera's sight.
    let bar = matt("bar", Shape::Block { half_mm: [90.0, 20.0, 2.0] }, [250.0, 0.0, 300.0], [0.0; 3]);
    let (shadowed, less) = lit(vec![floor(), bar]);
    assert!(shadowed.len() + 20 < open.len(), "{} of {} rows", shadowed.len(), open.len());
    let share = shadowed.len() as f32 / open.len() as f32;
    assert!((less / light - share).abs() < 0.05, "{} of the light, {share} of the rows", less / light);
    assert!(shadowed.iter().all(|p| p.object == 0));
}

#[test]
fn haze_lies_on_the_lasers_side_of_the_stripe_and_grows_with_the_water() {
    let instrument = instrument();
    let mut hazy = scene(vec![floor()]);
    let image = |scene: &uw_sim::Scene| {
        Renderer::new(&instrument, scene).unwrap().expected_dn(&shot(Some(VOLTAGE)), None).unwrap()
    };
    let clear = image(&hazy);
    hazy.water.backscatter_per_mm = 1e-3;
    let once = image(&hazy);
    hazy.water.backscatter_per_mm = 2e-3;
    let twice = image(&hazy);
    let renderer = Renderer::new(&instrument, &hazy).unwrap();
    let curve = renderer.curve(0.0, VOLTAGE, Along::Rows).unwrap();
    let width = instrument.size[0] as usize;
    for p in curve.iter().filter(|p| p.pixel.y > 20.0 && p.pixel.y < 268.0).step_by(10) {
        let at =
            |image: &[f32], off: f64| image[p.pixel.y as usize * width + (p.pixel.x + off).round() as usize];
        // The laser stands at positive x: before the surface its light is seen to the right.
        let (near, far) = (at(&once, 12.0), at(&once, -12.0));
        assert!(near > 0.1 && far <= 0.0 && at(&clear, 12.0) <= 0.0, "{near} {far}");
        assert!((at(&twice, 12.0) / near - 2.0).abs() < 1e-3);
    }
}

#[test]
fn noise_is_of_the_stated_size_and_of_the_frames_own_seed() {
    let mut instrument = instrument();
    instrument.size = [64, 64];
    (instrument.scanner.camera.cx, instrument.scanner.camera.cy) = (31.5, 31.5);
    let mut lit = scene(vec![matt("wall", Shape::Plane, [0.0, 0.0, 800.0], [0.0; 3])]);
    lit.ambient.laser_off = 0.7;
    let renderer = Renderer::new(&instrument, &lit).unwrap();
    let ambient = renderer.ambient(0.0);
    let expected = f64::from(renderer.expected_dn(&shot(None), ambient.as_ref()).unwrap()[64 * 32 + 32]);
    let take = |frame| renderer.take(&Shot { frame, ..shot(None) }).unwrap();
    assert_eq!(take(1), take(1));
    assert_ne!(take(1).data, take(2).data);
    let values: Vec<f64> = (0..60).map(|frame| f64::from(take(frame).data[64 * 32 + 32])).collect();
    let all: Vec<f64> = (0..8).flat_map(|frame| take(frame).data).map(f64::from).collect();
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    // 60 values of a standard deviation of 1.9: 0.25 is their mean's.
    assert!((mean(&values) - expected - 10.0).abs() < 1.0, "{} {expected}", mean(&values));
    let m = mean(&all);
    let variance = all.iter().map(|x| (x - m).powi(2)).sum::<f64>() / all.len() as f64;
    // Shot noise, read noise, steps of one; the wall is a little uneven by attenuation.
    let predicted = expected / 40.0 + 0.8 * 0.8 + 1.0 / 12.0;
    assert!((variance / predicted - 1.0).abs() < 0.08, "{variance} {predicted}");
}

#[test]
fn speckle_has_its_contrast_before_blur_and_keeps_the_light() {
    let mut instrument = instrument();
    instrument.lens.blur_px = 0.0;
    let scene = scene(vec![floor()]);
    let image = |instrument: &uw_sim::Instrument| {
        Renderer::new(instrument, &scene).unwrap().expected_dn(&shot(Some(VOLTAGE)), None).unwrap()
    };
    let even = image(&instrument);
    (instrument.sensor.speckle, instrument.sensor.speckle_px) = (0.5, 2.0);
    let grainy = image(&instrument);
    let ratios: Vec<f64> =
        even.iter().zip(&grainy).filter(|(e, _)| **e > 20.0).map(|(e, g)| f64::from(g / e)).collect();
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    let contrast = (ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / ratios.len() as f64).sqrt();
    // Grains of two pixels: some hundred of them along the stripe.
    assert!((mean - 1.0).abs() < 0.12 && (contrast - 0.5).abs() < 0.12, "{mean} {contrast}");
}

#[test]
fn things_are_where_their_motion_has_brought_them() {
    let instrument = instrument();
    let velocity = Vector3::new(40.0, -10.0, 100.0);
    let mut moving = scene(vec![ball(850.0)]);
    moving.objects[0].motion = Motion { velocity_mm_s: velocity, turn_rad_s: Vector3::zeros() };
    let mut there = scene(vec![ball(850.0)]);
    let centre = Vector3::new(5.0, -10.0, 850.0) + velocity * 0.2;
    there.objects[0].camera_from_body = pose([centre.x, centre.y, centre.z], [0.0; 3]);
    let curve = |scene: &uw_sim::Scene, seconds| {
        let renderer = Renderer::new(&instrument, scene).unwrap();
        renderer.curve(seconds, VOLTAGE, Along::Rows).unwrap()
    };
    let (a, b) = (curve(&moving, 0.2), curve(&there, 0.0));
    assert!(a.len() > 20 && a.len() == b.len(), "{} {}", a.len(), b.len());
    assert!(a.iter().zip(&b).all(|(a, b)| (a.pixel - b.pixel).norm() < 1e-7));
    // The instrument's own motion is the same seen from the other side.
    let mut passing = scene(vec![ball(850.0)]);
    passing.instrument_velocity_mm_s = -velocity;
    let c = curve(&passing, 0.2);
    assert!(c.iter().zip(&b).all(|(a, b)| (a.pixel - b.pixel).norm() < 1e-7));
}

/// A sphere of triangles against the sphere: no nearer than the triangles' sag, and nothing missed.
#[test]
fn a_mesh_is_met_where_its_triangles_are() {
    let (rings, sectors, radius) = (40_u32, 80_u32, 40.0);
    let mut vertices = Vec::new();
    for i in 0..=rings {
        for j in 0..sectors {
            let polar = std::f64::consts::PI * f64::from(i) / f64::from(rings);
            let around = std::f64::consts::TAU * f64::from(j) / f64::from(sectors);
            let (s, c) = polar.sin_cos();
            vertices.push([radius * s * around.cos(), radius * s * around.sin(), radius * c]);
        }
    }
    let mut triangles = Vec::new();
    for i in 0..rings {
        for j in 0..sectors {
            let at = |i: u32, j: u32| i * sectors + j % sectors;
            triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    let mesh = Shape::Mesh(Mesh::new(&vertices, &triangles).unwrap());
    let sphere = Shape::Sphere { radius_mm: radius };
    let span = Span { beyond: 0.0, within: f64::INFINITY };
    let mut met = 0;
    for k in 0..2000 {
        let spot = Vector2::new(f64::from(k % 50) - 24.6, f64::from(k / 50) - 19.3) * 1.4;
        let direction = Vector3::new(spot.x, spot.y, 200.0).normalize();
        let ray = uw_geom::Ray { origin: Vector3::new(0.0, 0.0, -200.0), direction };
        match (sphere.meet(&ray, span), mesh.meet(&ray, span)) {
            (Some(a), Some(b)) => {
                met += 1;
                let slant = a.normal.dot(&direction).abs();
                // Sag of a chord of 2π/80: r (1 − cos(π/80)), twice over for the other way.
                let sag = 2.0 * radius * (1.0 - (std::f64::consts::PI / 80.0).cos()) / slant;
                assert!(
                    (b.distance_mm - a.distance_mm) > -1e-9
                        && b.distance_mm - a.distance_mm < 1.5 * sag + 0.02
                );
            }
            (Some(a), None) => assert!(a.normal.dot(&direction).abs() < 0.1, "missed in the middle"),
            (None, Some(_)) => panic!("triangles lie within the sphere"),
            (None, None) => {}
        }
    }
    assert!(met > 500, "{met}");
    assert!(Mesh::new(&vertices, &[[0, 1, 99_999]]).is_err() && Mesh::new(&vertices, &[]).is_err());
}

#[test]
fn figures_that_no_instrument_or_scene_has_are_refused() {
    let good = (instrument(), scene(vec![floor()]));
    let mut bad = Vec::new();
    type Spoil = fn(&mut uw_sim::Instrument, &mut uw_sim::Scene);
    let spoils: [Spoil; 6] = [
        |i, _| i.lens.blur_px = f64::NAN,
        |i, _| i.beam.waist_radius_mm = 0.0,
        |i, _| i.sensor.bits = 17,
        |_, s| s.objects[0].surface.albedo = 1.5,
        |_, s| s.water.attenuation_per_mm = -1.0,
        |_, s| s.objects[0].shape = Shape::Sphere { radius_mm: -2.0 },
    ];
    for spoil in spoils {
        let (mut i, mut s) = good.clone();
        spoil(&mut i, &mut s);
        bad.push(Renderer::new(&i, &s).err());
    }
    assert!(bad.iter().all(Option::is_some), "{bad:?}");
    // Beyond the window there is no light, and that is said.
    let renderer = Renderer::new(&good.0, &good.1).unwrap();
    assert!(renderer.take(&shot(Some(30.0))).is_err());
}
