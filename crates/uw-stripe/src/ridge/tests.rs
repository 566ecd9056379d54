//! No bias, sigmas as the scatter, either axis.

use super::*;
use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};

const NOISE: NoiseModel =
    NoiseModel { gain_e_per_dn: 1e6, read_noise_dn: 2.0, speckle_contrast: 0.0, full_scale_dn: 255.0 };

/// A stripe of standard deviation `width` across, its distance from the curve taken square to it; noise of 2 DN.
fn image(size: (usize, usize), centre: &dyn Fn(f64) -> f64, width: f64, seed: Option<u64>) -> Vec<u16> {
    let mut rng = StdRng::seed_from_u64(seed.unwrap_or(0));
    let pixels = (0..size.0 * size.1).map(|i| {
        let (x, y) = ((i % size.0) as f64, (i / size.0) as f64);
        let near = (-120..=120).map(|k| y + 0.1 * f64::from(k));
        let square = near.map(|v| (x - centre(v)).powi(2) + (y - v).powi(2)).fold(f64::MAX, f64::min);
        let error: f64 =
            if seed.is_some() { 2.0 * Distribution::<f64>::sample(&StandardNormal, &mut rng) } else { 0.0 };
        (1000.0 + 150.0 * (-0.5 * square / (width * width)).exp() + error).round() as u16
    });
    pixels.collect()
}

/// Mean error, its RMS, and RMS of error over sigma, at lines away from the border.
fn errors(centre: &dyn Fn(f64) -> f64, width: f64, seed: Option<u64>) -> (f64, f64, f64) {
    const SIZE: (usize, usize) = (140, 90);
    let pixels = image(SIZE, centre, width, seed);
    let view = View::packed(&pixels, SIZE.0, SIZE.1).unwrap();
    let candidates: Vec<_> = (0..SIZE.1).map(|y| (centre(y as f64) + 0.8) as f32).collect();
    let mut points = RidgePoints::default();
    Ridge::new(width, Level::new()).follow(&view, Axis::PerRow, &candidates, &NOISE, &mut points);
    let inner = 12..SIZE.1 - 12;
    let (mut mean, mut square, mut normal) = (0.0, 0.0, 0.0);
    for y in inner.clone() {
        let error = f64::from(points.position[y]) - centre(y as f64);
        mean += error;
        square += error * error;
        normal += (error / f64::from(points.sigma[y])).powi(2);
    }
    let n = inner.len() as f64;
    (mean / n, (square / n).sqrt(), (normal / n).sqrt())
}

#[test]
fn straight_steep_and_bent_stripes_are_met_without_bias() {
    /// Rounding to whole DN of 150 alone, and what the third order leaves of a bend, px.
    const BIAS_PX: f64 = 0.002;
    const RMS_PX: f64 = 0.004;
    for width in [1.2, 2.0] {
        for (name, centre) in [
            ("upright", &(|v: f64| 70.3 + 0.01 * v) as &dyn Fn(f64) -> f64),
            ("steep", &|v| 15.2 + 1.2 * v),
            ("bent", &|v| 70.0 + 30.0 * (v / 25.0).sin()),
            ("arc", &|v| 60.0 + 0.012 * (v - 45.0).powi(2)),
        ] {
            let (mean, rms, _) = errors(centre, width, None);
            assert!(mean.abs() < BIAS_PX && rms < RMS_PX, "{name} {width}: bias {mean}, rms {rms}");
        }
    }
}

#[test]
fn sigmas_are_those_of_the_scatter_and_below_a_single_lines() {
    /// Errors go together along the ridge, so that 8 × 66 lines are some 80 values.
    const WITHIN: std::ops::Range<f64> = 0.8..1.25;
    for slope in [0.02, 1.2] {
        let centre = move |v: f64| 16.3 + slope * v;
        let (mut squares, mut normals) = (0.0, 0.0);
        for seed in 0..8 {
            let (_, rms, normal) = errors(&centre, 2.0, Some(seed));
            (squares, normals) = (squares + rms * rms / 8.0, normals + normal * normal / 8.0);
        }
        assert!(WITHIN.contains(&normals.sqrt()), "slope {slope}: {}", normals.sqrt());
        // A line by itself: σ/A √(2w/√π).
        let single = 2.0 / 150.0 * (2.0 * 2.0 / std::f64::consts::PI.sqrt()).sqrt();
        assert!(squares.sqrt() < 0.8 * single * slope.hypot(1.0), "slope {slope}: {}", squares.sqrt());
    }
}

#[test]
fn columns_are_rows_of_the_transposed_image_and_borders_no_trap() {
    let centre = |v: f64| 3.0 + 0.9 * v;
    let pixels = image((60, 50), &centre, 1.5, Some(3));
    let turned: Vec<u16> = (0..3000).map(|i| pixels[i % 50 * 60 + i / 50]).collect();
    let at = |y| if y == 20 { f32::NAN } else { centre(f64::from(y)) as f32 };
    let candidates: Vec<_> = (0..50).map(at).collect();
    let (mut rows, mut columns) = (RidgePoints::default(), RidgePoints::default());
    let mut ridge = Ridge::new(1.5, Level::new());
    ridge.follow(&View::packed(&pixels, 60, 50).unwrap(), Axis::PerRow, &candidates, &NOISE, &mut rows);
    ridge.follow(&View::packed(&turned, 50, 60).unwrap(), Axis::PerColumn, &candidates, &NOISE, &mut columns);
    let found = rows.position.iter().filter(|p| !p.is_nan()).count();
    assert!(rows.position[20].is_nan() && found >= 38);
    for (a, b) in rows.position.iter().zip(&columns.position) {
        assert!((a.is_nan() && b.is_nan()) || (a - b).abs() < 1e-3, "{a} {b}");
    }
    let (one, strange) = ([7u16; 1], [f32::NAN, 1e9, -5.0]);
    ridge.follow(&View::packed(&one, 1, 1).unwrap(), Axis::PerRow, &strange, &NOISE, &mut rows);
    assert!(rows.position.iter().all(|p| p.is_nan()));
}

#[test]
fn all_levels_give_the_same_bits() {
    let centre = |v: f64| 30.0 + 0.7 * v + 8.0 * (v / 9.0).sin();
    let pixels = image((140, 90), &centre, 1.8, Some(5));
    let view = View::packed(&pixels, 140, 90).unwrap();
    let candidates: Vec<_> = (0..90).map(|y| centre(f64::from(y)) as f32 + 1.2).collect();
    let bits = |level: Level| {
        let mut points = RidgePoints::default();
        Ridge::new(1.8, level).follow(&view, Axis::PerRow, &candidates, &NOISE, &mut points);
        [&points.position, &points.sigma, &points.slope]
            .map(|of| of.iter().map(|v| v.to_bits()).collect::<Vec<_>>())
    };
    let best = bits(Level::new());
    assert!(best[0].iter().filter(|p| !f32::from_bits(**p).is_nan()).count() > 60);
    assert_eq!(best, bits(Level::baseline()));
}
