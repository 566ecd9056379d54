use crate::render::{Image, Random, Scene};
use crate::{errors, find, largest};
use nalgebra::{Rotation3, Vector3};
use proptest::prelude::*;
use uw_calib::{Chessboard, label_capture};

/// Px; corners beside a spot of glare may lose accuracy, but no wrong one may pass for one.
const BESIDE_GLARE_PX: f64 = 0.25;

#[test]
fn glare_on_corners_leaves_the_others_labelled() {
    let scene = Scene { rotation: Rotation3::from_euler_angles(0.2, 0.1, 0.4), ..Scene::plain() };
    let mut image = scene.render();
    for (col, row, radius) in [(3, 3, 9.0), (4, 3, 20.0), (8, 5, 14.0)] {
        let at = scene.corner(col, row);
        image.disc([at.x + 3.0, at.y], radius, 255);
    }
    let detection = find(&image, scene.inner).unwrap();
    assert!(detection.full, "{:?}", detection.seen);
    assert!((80..=85).contains(&detection.corners.len()), "{} corners", detection.corners.len());
    assert!(largest(&errors(&scene, &detection)) < BESIDE_GLARE_PX);
}

#[test]
fn a_hidden_part_leaves_a_partial_view() {
    let scene = Scene { rotation: Rotation3::from_euler_angles(0.0, 0.0, 0.02), ..Scene::plain() };
    let mut image = scene.render();
    // Everything left of the fourth column of corners is covered.
    let edge = (0..8).map(|row| scene.corner(3, row).x).fold(f64::INFINITY, f64::min) as usize - 6;
    for row in 0..scene.size[1] {
        image.data[row * scene.size[0]..][..edge].fill(90);
    }
    let detection = find(&image, scene.inner).unwrap();
    assert!(!detection.full);
    assert_eq!(detection.seen, [8, 8]);
    assert_eq!(detection.corners.len(), 64);
    assert!(largest(&errors(&scene, &detection)) < BESIDE_GLARE_PX);
    let board = Chessboard::new(11, 8, 1.0).unwrap();
    assert!(label_capture(vec![Ok(detection.clone())], &board).is_err());
    let whole = find(&scene.render(), scene.inner);
    assert_eq!(label_capture(vec![Ok(detection), whole], &board).unwrap().iter().flatten().count(), 2);
}

#[test]
fn a_board_cut_by_the_border_is_partial() {
    let scene = Scene { position: Vector3::new(6.0, -2.0, 20.0), ..Scene::plain() };
    let detection = find(&scene.render(), scene.inner).unwrap();
    assert!(!detection.full && detection.corners.len() > 30, "{:?}", detection.seen);
    assert!(largest(&errors(&scene, &detection)) < BESIDE_GLARE_PX);
}

#[test]
fn a_background_full_of_false_corners_is_told_apart() {
    let scene = Scene {
        position: Vector3::new(0.0, 0.0, 27.0),
        rotation: Rotation3::from_euler_angles(0.0, 0.0, 0.02),
        ..Scene::plain()
    };
    let board = scene.render();
    let mut random = Random(7);
    let mut image = Image { data: vec![110; board.data.len()], size: board.size, levels: 255 };
    // Small checks at random places, of random size and turn: true saddles, but no lattice.
    for _ in 0..250 {
        let (x, y) = (random.uniform() * 400.0, random.uniform() * 320.0);
        let (angle, size) = (random.uniform() * 3.0, 5.0 + random.uniform() * 9.0);
        let (sin, cos) = angle.sin_cos();
        for row in 0..320 {
            for col in 0..400 {
                let (dx, dy) = (col as f64 - x, row as f64 - y);
                let (s, t) = (cos * dx + sin * dy, cos * dy - sin * dx);
                if s.abs().max(t.abs()) < size {
                    image.data[row * 400 + col] = if s * t > 0.0 { 190 } else { 30 };
                }
            }
        }
    }
    let (first, last) = (scene.corner(0, 0), scene.corner(10, 7));
    let pitch = (last.x - first.x) / 10.0;
    for row in 0..320 {
        for col in 0..400 {
            let (u, v) = (col as f64, row as f64);
            if u > first.x - 1.5 * pitch
                && u < last.x + 1.5 * pitch
                && v > first.y - 1.5 * pitch
                && v < last.y + 1.5 * pitch
            {
                image.data[row * 400 + col] = board.data[row * 400 + col];
            }
        }
    }
    let detection = find(&image, scene.inner).unwrap();
    assert!(detection.full && detection.corners.len() == 88, "{:?}", detection.seen);
    assert!(largest(&errors(&scene, &detection)) < BESIDE_GLARE_PX);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any pose that shows the whole board with squares of 10 px and more is found whole and labelled without
    /// a mirror.
    #[test]
    fn any_pose_is_labelled(
        roll in 0.0..std::f64::consts::TAU, pitch in -0.8..0.8_f64, yaw in -0.8..0.8_f64,
        shift in prop::array::uniform2(-1.0..1.0_f64), distance in 21.0..26.0_f64,
        cols in 4_usize..11, rows in 4_usize..9, k1 in -0.4..0.1_f64,
    ) {
        let mut scene = Scene {
            size: [420, 400],
            inner: [cols, rows],
            rotation: Rotation3::from_euler_angles(pitch, yaw, 0.0) * Rotation3::from_euler_angles(0.0, 0.0, roll),
            position: Vector3::new(shift[0], shift[1], distance),
            ..Scene::plain()
        };
        scene.camera.distortion.k1 = k1;
        scene.camera.cy = 200.0;
        let pitch_px = |a: [usize; 2], b: [usize; 2]| (scene.corner(a[0], a[1]) - scene.corner(b[0], b[1])).norm();
        let smallest = (0..cols - 1).flat_map(|c| (0..rows - 1).map(move |r| [c, r]))
            .flat_map(|[c, r]| [pitch_px([c, r], [c + 1, r]), pitch_px([c, r], [c, r + 1])]);
        prop_assume!(smallest.fold(f64::INFINITY, f64::min) > 10.0);
        let image = scene.render();
        let detection = find(&image, scene.inner);
        let detection = match detection { Ok(d) => d, Err(e) => return Err(TestCaseError::fail(e.to_string())) };
        prop_assert!(detection.full && detection.corners.len() == cols * rows, "{:?} of {cols} x {rows}", detection.seen);
        prop_assert!(largest(&errors(&scene, &detection)) < BESIDE_GLARE_PX);
    }
}
