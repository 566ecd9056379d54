use crate::render::Scene;
use crate::{errors, find, largest, rms};
use nalgebra::{Rotation3, Vector2};
use std::f64::consts::TAU;
use uw_geom::Distortion;

/// Px by axis; noise of 1.5 grey values on a step of 180 gives 0.004 on squares of 25 px. Half a pixel's
/// confusion is a hundred times that.
const RMS_PX: f64 = 0.006;
/// Px; the mean over 528 corners of a turned board, so any constant offset shows.
const MEAN_PX: f64 = 0.001;

#[test]
fn corners_lie_where_they_were_drawn_at_any_turn() {
    let mut all = Vec::new();
    let (mut squares, mut count) = (0.0, 0);
    for turn in 0..6 {
        let angle = TAU * f64::from(turn) / 6.0 + 0.05;
        let mut scene = Scene {
            rotation: Rotation3::from_euler_angles(0.15, -0.2, angle),
            size: [400, 400],
            seed: turn as u64,
            ..Scene::plain()
        };
        scene.camera.cy = 200.0;
        let detection = find(&scene.render(), scene.inner).unwrap();
        assert!(detection.full && detection.corners.len() == 88, "turned by {angle}: {:?}", detection.seen);
        let errors = errors(&scene, &detection);
        for (error, corner) in errors.iter().zip(&detection.corners) {
            squares += error.dot(&(corner.covariance.try_inverse().unwrap() * error));
            count += 2;
        }
        all.extend(errors);
    }
    let mean = all.iter().sum::<Vector2<f64>>() / all.len() as f64;
    assert!(mean.norm() < MEAN_PX, "mean error {mean}");
    assert!(rms(&all) < RMS_PX, "RMS {}", rms(&all));
    assert!(largest(&all) < 6.0 * RMS_PX, "largest {}", largest(&all));
    // Errors over their predicted sigmas: the covariance is the scatter's, not a guess.
    let spread = (squares / f64::from(count)).sqrt();
    assert!((0.9..1.15).contains(&spread), "spread {spread}");
}

#[test]
fn twelve_bits_are_used() {
    // 40 of 4095 grey values in the step, noise below one: 8 bits would leave 2.5 steps and quantisation
    // noise of 0.3.
    let scene =
        Scene { levels: 4095, dark: 100.0, bright: 140.0, background: 90.0, noise: 0.3, ..Scene::plain() };
    let errors = errors(&scene, &find(&scene.render(), scene.inner).unwrap());
    assert_eq!(errors.len(), 88);
    assert!(rms(&errors) < RMS_PX, "RMS {}", rms(&errors));
}

#[test]
fn a_strong_lens_and_a_steep_view_bias_nothing() {
    let mut camera = Scene::plain().camera;
    camera.fx = 330.0;
    camera.fy = 330.0;
    camera.distortion = Distortion { k1: -0.4, k2: 0.12, ..Distortion::none() };
    for (pitch, yaw) in [(0.0, 0.0), (0.7, 0.2), (-0.3, 0.75), (0.5, -0.6)] {
        let scene = Scene {
            camera,
            rotation: Rotation3::from_euler_angles(pitch, yaw, 0.3),
            position: nalgebra::Vector3::new(0.0, 0.0, 13.5),
            ..Scene::plain()
        };
        let detection = find(&scene.render(), scene.inner).unwrap();
        assert!(detection.full && detection.corners.len() == 88, "{pitch} {yaw}: {:?}", detection.seen);
        let errors = errors(&scene, &detection);
        assert!(rms(&errors) < 3.0 * RMS_PX, "{pitch} {yaw}: RMS {}", rms(&errors));
        assert!(largest(&errors) < 0.15, "{pitch} {yaw}: largest {}", largest(&errors));
    }
}

#[test]
fn blur_low_contrast_and_uneven_light_are_withstood() {
    let plain = Scene::plain;
    let scenes = [
        ("blur", Scene { blur: 3.0, ..plain() }, 0.05),
        (
            "low contrast",
            Scene { dark: 100.0, bright: 112.0, background: 104.0, noise: 1.0, ..plain() },
            0.12,
        ),
        ("light falls to a twentieth", Scene { light_right: 0.05, noise: 0.7, ..plain() }, 0.05),
        ("heavy noise", Scene { noise: 20.0, ..plain() }, 0.15),
    ];
    for (name, scene, limit) in scenes {
        let detection = find(&scene.render(), scene.inner).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(detection.full && detection.corners.len() == 88, "{name}: {:?}", detection.seen);
        let errors = errors(&scene, &detection);
        assert!(rms(&errors) < limit, "{name}: RMS {}", rms(&errors));
    }
}
