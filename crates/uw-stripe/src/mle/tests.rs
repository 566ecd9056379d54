//! The model against differences, and a truth met.

use super::*;
use crate::lines::Lines;
use crate::{Axis, View};

const NOISE: NoiseModel =
    NoiseModel { gain_e_per_dn: 10.0, read_noise_dn: 2.0, speckle_contrast: 0.05, full_scale_dn: 65535.0 };

fn lines(values: &[u16]) -> Lines {
    let mut lines = Lines::default();
    let view = View::packed(values, values.len(), 1).unwrap();
    lines.load(&view, None, view.bounds(), Axis::PerRow, NOISE.full_scale_dn);
    lines
}

const START: Start = Start { centre: 40.0, width: 2.2, flux: 5000.0, background: 300.0, from: 20, to: 61 };

#[test]
fn gradients_agree_with_differences() {
    /// Large against the 8e-8 to which Φ is known.
    const STEP: f64 = 1e-3;
    let lines = lines(&[300; 80]);
    let (problem, _) = Problem::new(lines.line(0), &NOISE, START, None).unwrap();
    let mut at: [f64; MOST] = [0.0; MOST];
    at[..7].copy_from_slice(&[40.3, 4000.0, 0.6, 250.0, 30.0, -12.0, 5.0]);
    let values = |at: &[f64; MOST]| {
        let mut all = Vec::new();
        problem.scan::<MOST>(at, |_, _, value, gradient, _| all.push((value, *gradient)));
        all
    };
    for k in 0..MOST {
        let (mut low, mut high) = (at, at);
        let step = STEP * at[k].abs().max(1.0);
        (low[k], high[k]) = (at[k] - step, at[k] + step);
        for ((here, a), b) in values(&at).iter().zip(values(&low)).zip(values(&high)) {
            let slope = (b.0 - a.0) / (2.0 * step);
            assert!((slope - here.1[k]).abs() < 2e-3 * (1.0 + slope.abs()), "{k}: {slope} {}", here.1[k]);
        }
    }
}

#[test]
fn a_stripe_on_a_bent_background_is_met() {
    /// Rounding to whole DN under a peak of 800, px.
    const ROUNDING_PX: f64 = 0.003;
    let centre = 40.37;
    let light = |x: f64| {
        let t = (x - centre) / 2.0;
        let d = (x - 45.0) / 12.0;
        300.0 + 800.0 * (-0.5 * t * t).exp() + 400.0 * (-0.5 * d * d).exp()
    };
    let pixel =
        |i: i32| (0..16).map(|k| light(f64::from(i) + (f64::from(k) + 0.5) / 16.0 - 0.5)).sum::<f64>() / 16.0;
    let values: Vec<u16> = (0..80).map(|i| pixel(i).round() as u16).collect();
    let lines = lines(&values);
    let fit = fit(lines.line(0), &NOISE, START, None, None).unwrap();
    assert!(fit.converged);
    assert!((fit.centre - centre).abs() < ROUNDING_PX, "{fit:?}");
    assert!((fit.width - 2.0).abs() < 0.01, "{}", fit.width);
}
