//! The model against differences, and a truth met.

use super::likelihood::{Form, Group};
use super::pixels::Pixels;
use super::problem::Problem;
use super::wide::{Row, V, WIDE};
use super::*;
use crate::lines::{Line, Lines};
use crate::{Axis, View};
use fearless_simd::{Level, SimdBase, dispatch};

const NOISE: NoiseModel =
    NoiseModel { gain_e_per_dn: 10.0, read_noise_dn: 2.0, speckle_contrast: 0.05, full_scale_dn: 65535.0 };

fn lines(values: &[u16]) -> Lines {
    let mut lines = Lines::default();
    let view = View::packed(values, values.len(), 1).unwrap();
    lines.load(&view, None, view.bounds(), Axis::PerRow, NOISE.full_scale_dn);
    lines
}

const SEED: Seed = Seed { centre: 40.0, width: 2.2, flux: 5000.0, background: 300.0 };
const COMMON: Common<'_> = Common { noise: &NOISE, width: None };

/// Expected values in the pixels of a line, and their derivatives by the parameters.
fn model(at: &[f64; MOST]) -> Vec<(f64, [f64; MOST])> {
    let lines = lines(&[300; 80]);
    let problem = Problem::new(lines.line(0), &NOISE, SEED, 20..61, None).unwrap();
    let mut pixels = Pixels::default();
    pixels.pack([(lines.line(0), &problem.window); WIDE], &Weights::of(&NOISE));
    dispatch!(Level::new(), simd => {
        let group = Group::new(simd, [&problem; WIDE], V::splat(simd, SEED.centre), &pixels, Weights::of(&NOISE));
        let at: [V<_>; MOST] = std::array::from_fn(|k| V::splat(simd, at[k]));
        let mut form = Form::of(simd, &at);
        let rows = group.rows.clone();
        let of = |v| Row::from(v).0[3];
        rows.map(|p| {
            let place = group.place(p);
            let mut polynomials = [V::splat(simd, 0.0); 2 * DEGREE + 1];
            group.polynomials(place, DEGREE, &mut polynomials);
            let mut value = of(Group::background(&at, &polynomials));
            let mut gradient = [0.0; MOST];
            (LEVEL..MOST).for_each(|k| gradient[k] = of(polynomials[k - LEVEL]));
            if let Some(profile) = form.profile(simd, place) {
                value += of(profile.signal);
                (0..LEVEL).for_each(|k| gradient[k] = of(profile.gradient[k]));
            }
            (value, gradient)
        })
        .collect()
    })
}

#[test]
fn gradients_agree_with_differences() {
    /// Large against the 8e-8 to which Φ is known.
    const STEP: f64 = 1e-3;
    let mut at: [f64; MOST] = [0.0; MOST];
    at[..7].copy_from_slice(&[40.3, 4000.0, 0.6, 250.0, 30.0, -12.0, 5.0]);
    let here = model(&at);
    assert_eq!(here.len(), 41);
    for k in 0..MOST {
        let (mut low, mut high) = (at, at);
        let step = STEP * at[k].abs().max(1.0);
        (low[k], high[k]) = (at[k] - step, at[k] + step);
        for ((here, a), b) in here.iter().zip(model(&low)).zip(model(&high)) {
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
    let fit = Fitter::new(Level::new()).one(SEED, &lines.line(0), COMMON).unwrap();
    assert!(fit.converged);
    assert!((fit.centre - centre).abs() < ROUNDING_PX, "{fit:?}");
    assert!((fit.width - 2.0).abs() < 0.01, "{}", fit.width);
}

/// Lines as different as a stripe on haze, one at full scale, one on a floor, a narrow one and noise.
fn various() -> Vec<Vec<u16>> {
    let stripe = |height: f64, width: f64, haze: f64| {
        let light = move |i: i32| {
            let (t, d) = ((f64::from(i) - 40.2) / width, (f64::from(i) - 44.0) / 11.0);
            20.0 + height * (-0.5 * t * t).exp() + haze * (-0.5 * d * d).exp()
        };
        (0..80).map(|i| light(i).min(65535.0) as u16).collect::<Vec<_>>()
    };
    let noise = (0..80u64).map(|i| (300 + i * i * 7919 % 41) as u16).collect();
    let floor = stripe(900.0, 1.5, 0.0).iter().map(|v| v.saturating_sub(40)).collect();
    vec![stripe(800.0, 2.0, 500.0), stripe(90000.0, 2.4, 0.0), floor, stripe(3000.0, 0.6, 0.0), noise]
}

#[test]
fn a_fit_is_the_same_whatever_it_shares_its_vector_with() {
    struct Mixed(Vec<Lines>);
    impl Source for Mixed {
        fn line(&self, k: usize) -> Line<'_> {
            self.0[k % self.0.len()].line(0)
        }
    }
    let all = Mixed(various().iter().map(|values| lines(values)).collect());
    let mut levels = vec![Level::baseline(), Level::new()];
    #[cfg(target_arch = "x86_64")]
    levels.extend(Level::new().as_avx2().map(Level::Avx2));
    let mut want: Vec<String> = Vec::new();
    for level in levels {
        let mut fitter = Fitter::new(level);
        let mut fits = Vec::new();
        // A seed that is missing has no fit, and a group that is not full no other results.
        let seeds = (0..19).map(|k| (k != 4).then_some(SEED));
        let residuals = fitter.fit_with_residuals(seeds, &all, COMMON, &mut fits);
        assert!(fits[4].is_none() && residuals[4].is_empty());
        assert!(fits[0].is_some_and(|fit| fit.freedom > 10.0) && residuals[0].len() > 30);
        assert!(fits[1].is_some_and(|fit| fit.saturated > 3));
        for k in 0..5 {
            let seed = SEED;
            let alone = fitter.one(seed, &all.line(k), COMMON);
            fitter.fit((0..19).map(|_| Some(seed)), &all, COMMON, &mut fits);
            let [alone, first, last] = [&alone, &fits[k], &fits[k + 10]].map(|fit| format!("{fit:?}"));
            assert_eq!(alone, first, "{k}");
            assert_eq!(alone, last, "{k}");
            if want.len() <= k {
                want.push(alone);
            } else {
                assert_eq!(alone, want[k], "{level:?}: {k}");
            }
        }
    }
}

#[test]
fn pixels_that_say_nothing_make_no_fit() {
    // All at full scale, and far more light is expected: no pixel is surprised.
    let lines = lines(&[65535; 80]);
    let seed = Seed { background: 80000.0, ..SEED };
    let fit = Fitter::new(Level::new()).one(seed, &lines.line(0), COMMON);
    assert!(fit.is_none(), "{fit:?}");
}
