//! Centres, sigmas and rejects against the truth of synthetic scenes.

use crate::scene::{Scene, none, to_u8};
use uw_stripe::{Extractor, Flags, Method, NoiseModel, Options, Stripe, View};

const WIDTH: usize = 160;
const HEIGHT: usize = 500;
/// Settings of the method that these scenes judge; the suite judges the others.
fn precise() -> Options {
    Options { method: Method::Precise, ..Options::default() }
}

/// An error beyond this is a wrong peak, not an inaccurate one, px.
const WRONG_PX: f64 = 3.0;
/// Predicted sigma over actual scatter; the scatter of 500 lines is known to 3 %, the rest is margin for shapes.
const HONEST: std::ops::RangeInclusive<f64> = 0.85..=1.15;
/// RMS error over the bound: a linear background costs some 5 %, noise and width that are estimated the rest.
const ABOVE_BOUND: f64 = 1.15;
/// Standard errors within which a mean error is no bias.
const NO_BIAS: f64 = 3.5;

fn wavy(v: f64) -> f64 {
    80.0 + 0.05 * v + 6.0 * (v / 60.0).sin()
}

fn eight_bit<'a>(
    centre: &'a dyn Fn(f64) -> f64,
    amplitude: &'a dyn Fn(f64, f64) -> f64,
    background: &'a dyn Fn(f64, f64) -> f64,
) -> Scene<'a> {
    Scene {
        width: WIDTH,
        height: HEIGHT,
        centre,
        amplitude,
        sigma: 1.6,
        background,
        electrons_per_dn: 40.0,
        read_noise_dn: 1.0,
        full_scale_dn: 255.0,
    }
}

fn extract(scene: &Scene<'_>, seed: u64, options: Options) -> Stripe {
    let image = scene.render(seed);
    let mut extractor = Extractor::new(options).unwrap();
    if scene.full_scale_dn > 255.0 {
        extractor.extract(View::packed(&image, scene.width, scene.height).unwrap(), None).unwrap().clone()
    } else {
        let image = to_u8(&image);
        extractor.extract(View::packed(&image, scene.width, scene.height).unwrap(), None).unwrap().clone()
    }
}

struct Errors {
    found: f64,
    wrong: f64,
    rms: f64,
    mean: f64,
    standard_error: f64,
    normalised_rms: f64,
}

/// Errors over all lines of several seeds.
fn errors(scene: &Scene<'_>, seeds: std::ops::Range<u64>, options: &Options) -> Errors {
    let (mut e, mut z, mut wrong, mut lines) = (Vec::new(), Vec::new(), 0, 0);
    for seed in seeds {
        let stripe = extract(scene, seed, options.clone());
        lines += stripe.len();
        for m in stripe.measurements() {
            let error = m.position_px - (scene.centre)(m.line as f64);
            if error.abs() > WRONG_PX {
                wrong += 1;
            } else {
                e.push(error);
                z.push(error / m.sigma_px);
            }
        }
    }
    let n = e.len() as f64;
    let rms = |x: &[f64]| (x.iter().map(|v| v * v).sum::<f64>() / n).sqrt();
    let (spread, normalised_rms) = (rms(&e), rms(&z));
    Errors {
        found: n / lines as f64,
        wrong: f64::from(wrong) / lines as f64,
        rms: spread,
        mean: e.iter().sum::<f64>() / n,
        standard_error: spread / n.sqrt(),
        normalised_rms,
    }
}

fn assert_honest(name: &str, e: &Errors, found: f64) {
    assert!(e.found >= found, "{name}: found {}", e.found);
    assert!(e.wrong <= 0.005, "{name}: wrong {}", e.wrong);
    assert!(HONEST.contains(&e.normalised_rms), "{name}: error over sigma has rms {}", e.normalised_rms);
    assert!(e.mean.abs() < NO_BIAS * e.standard_error, "{name}: bias {} ± {}", e.mean, e.standard_error);
}

/// Cramér–Rao bound of the centre with flux, width and constant background unknown, averaged over sub-pixel places, px:
/// inverse of Σ ∂μ ∂μᵀ / v with derivatives by differences of the profile at pixel centres.
fn cramer_rao(scene: &Scene<'_>, amplitude: f64, background: f64) -> f64 {
    const PLACES: usize = 8;
    const STEP: f64 = 1e-4;
    let profile = |x: f64, p: &[f64; 4]| p[1] * (-0.5 * ((x - p[0]) / p[2]).powi(2)).exp() + p[3];
    let mean = (0..PLACES).map(|k| {
        let p = [k as f64 / PLACES as f64, amplitude, scene.sigma, background];
        let mut information = nalgebra::Matrix4::<f64>::zeros();
        for x in -12..=12 {
            let x = f64::from(x);
            let gradient = nalgebra::Vector4::from_fn(|i, _| {
                let (mut low, mut high) = (p, p);
                low[i] -= STEP;
                high[i] += STEP;
                (profile(x, &high) - profile(x, &low)) / (2.0 * STEP)
            });
            let variance = profile(x, &p) / scene.electrons_per_dn + scene.read_noise_dn.powi(2) + 1.0 / 12.0;
            information += gradient * gradient.transpose() / variance;
        }
        information.try_inverse().unwrap()[(0, 0)]
    });
    (mean.sum::<f64>() / PLACES as f64).sqrt()
}

#[test]
fn clean_scene_reaches_the_bound_with_true_sigmas() {
    let bright = |_: f64, _: f64| 150.0;
    let level = |_: f64, _: f64| 4.0;
    let scene = eight_bit(&wavy, &bright, &level);
    let e = errors(&scene, 0..4, &precise());
    assert_honest("clean", &e, 0.995);
    let bound = cramer_rao(&scene, 150.0, 4.0);
    assert!(e.rms < ABOVE_BOUND * bound, "rms {} against {bound}", e.rms);
}

#[test]
fn low_signal_has_true_sigmas() {
    let faint = |_: f64, _: f64| 9.0;
    let level = |_: f64, _: f64| 4.0;
    assert_honest("low", &errors(&eight_bit(&wavy, &faint, &level), 0..4, &precise()), 0.95);
}

#[test]
fn a_floor_that_hides_the_background_biases_nothing() {
    let bright = |_: f64, _: f64| 100.0;
    let below = |_: f64, _: f64| -4.0;
    let e = errors(&eight_bit(&wavy, &bright, &below), 0..4, &precise());
    assert!(e.found >= 0.995 && e.wrong <= 0.005, "found {} wrong {}", e.found, e.wrong);
    // The floor hides the dark half of what the noise is read off: too wide a sigma may come of it, never too narrow a one.
    assert!((0.7..=1.15).contains(&e.normalised_rms), "error over sigma has rms {}", e.normalised_rms);
    assert!(e.mean.abs() < NO_BIAS * e.standard_error, "bias {} ± {}", e.mean, e.standard_error);
}

#[test]
fn twelve_bits_in_sixteen() {
    let bright = |_: f64, _: f64| 1800.0;
    let level = |_: f64, _: f64| 30.0;
    let scene = Scene {
        electrons_per_dn: 2.5,
        read_noise_dn: 2.4,
        full_scale_dn: 4095.0,
        sigma: 1.2,
        ..eight_bit(&wavy, &bright, &level)
    };
    assert_honest("12 bit", &errors(&scene, 0..4, &precise()), 0.995);
}

#[test]
fn saturation_is_masked_not_averaged() {
    let glaring = |_: f64, _: f64| 1.6 * 255.0;
    let level = |_: f64, _: f64| 4.0;
    let scene = eight_bit(&wavy, &glaring, &level);
    let noise =
        NoiseModel { gain_e_per_dn: 40.0, read_noise_dn: 1.0, speckle_contrast: 0.0, full_scale_dn: 255.0 };
    let e = errors(&scene, 0..4, &Options { noise: Some(noise), ..precise() });
    assert_honest("saturated", &e, 0.99);
    let stripe = extract(&scene, 9, precise());
    assert!(stripe.measurements().all(|m| m.flags.contains(Flags::SATURATED)));
    // Not one line is whole: what is not clipped has to tell the noise.
    let (bright, level) = (|_: f64, _: f64| 1.6 * 4095.0, |_: f64, _: f64| 80.0);
    let twelve = Scene {
        electrons_per_dn: 2.5,
        read_noise_dn: 2.4,
        full_scale_dn: 4095.0,
        ..eight_bit(&wavy, &bright, &level)
    };
    assert_honest("saturated, noise from the image", &errors(&twelve, 0..4, &precise()), 0.99);
}

#[test]
fn steep_stripes_are_not_biased() {
    let steep = |v: f64| 20.3 + 1.2 * v;
    let bright = |_: f64, _: f64| 120.0;
    let level = |_: f64, _: f64| 4.0;
    let scene = Scene { height: 100, ..eight_bit(&steep, &bright, &level) };
    assert_honest("steep", &errors(&scene, 0..12, &precise()), 0.99);
}

#[test]
fn haze_adds_no_bias() {
    /// The broad skirt of light scattered forward leans to one side; what a linear background leaves of it, px.
    const HAZE_BIAS_PX: f64 = 0.03;
    let bright = |_: f64, _: f64| 90.0;
    let veil = |u: f64, v: f64| {
        let d = u - wavy(v);
        10.0 + 30.0 * (-d.abs() / 25.0).exp() + 0.1 * u
    };
    let e = errors(&eight_bit(&wavy, &bright, &veil), 0..3, &precise());
    assert!(e.found > 0.99 && e.wrong < 0.005, "found {} wrong {}", e.found, e.wrong);
    assert!(e.mean.abs() < HAZE_BIAS_PX, "bias {}", e.mean);
}

#[test]
fn second_reflections_do_not_win_for_being_brighter_for_a_while() {
    let bright = |_: f64, _: f64| 80.0;
    // Brighter than the stripe on one line of every eleven, somewhere else each time.
    let spots = |u: f64, v: f64| {
        let line = v.round() as i64;
        let at = 20.0 + f64::from((line * 37 % 120) as i32);
        let d = (u - at) / 1.6;
        if line % 11 == 0 { 140.0 * (-0.5 * d * d).exp() + 3.0 } else { 3.0 }
    };
    let e = errors(&eight_bit(&wavy, &bright, &spots), 0..2, &precise());
    assert!(e.wrong <= 0.01, "wrong {}", e.wrong);
    assert!(e.found >= 0.97, "found {}", e.found);
}

#[test]
fn two_stripes_that_nearly_touch_are_not_taken_for_one() {
    // A step in depth: the stripe jumps by six pixels, and on the lines of the step both ends show.
    const STEP_PX: f64 = 7.0;
    let left = |_: f64| 70.3;
    let bright = |_: f64, v: f64| if v < 260.0 { 140.0 } else { 0.0 };
    let right = |u: f64, v: f64| {
        let d = (u - 70.3 - STEP_PX) / 1.1;
        3.0 + if v > 240.0 { 110.0 * (-0.5 * d * d).exp() } else { 0.0 }
    };
    let scene = Scene { sigma: 1.1, ..eight_bit(&left, &bright, &right) };
    let stripe = extract(&scene, 1, precise());
    assert!(stripe.found() * 100 >= 98 * stripe.len());
    for m in stripe.measurements() {
        let off = m.position_px - 70.3;
        let error = off.abs().min((off - STEP_PX).abs());
        assert!(error < 0.15, "between the two: {m:?}");
        assert!(!(243..257).contains(&m.line) || m.flags.contains(Flags::SEVERAL_PEAKS), "{m:?}");
    }
}

#[test]
fn nothing_is_found_where_nothing_is() {
    let dark = |_: f64| -100.0;
    for (name, background) in [
        ("dark", &none as &dyn Fn(f64, f64) -> f64),
        ("grey", &|_, _| 20.0),
        ("gradient", &|u, v| 10.0 + 0.2 * u + 0.1 * v),
        ("step", &|u, _| if u < 80.0 { 15.0 } else { 120.0 }),
    ] {
        for options in [
            precise(),
            Options {
                noise: Some(NoiseModel {
                    gain_e_per_dn: 40.0,
                    read_noise_dn: 1.0,
                    speckle_contrast: 0.0,
                    full_scale_dn: 255.0,
                }),
                ..precise()
            },
        ] {
            let stripe = extract(&eight_bit(&dark, &none, background), 3, options);
            assert!(stripe.found() * 200 <= stripe.len(), "{name}: {} false points", stripe.found());
        }
    }
}

#[test]
fn an_albedo_edge_is_flagged_and_its_lines_can_be_left_out() {
    // Black below row 250; the edge slants, so that the stripe leans on its way over it.
    let black = |u: f64, v: f64| if v - 250.0 + 0.7 * (u - 80.0) > 0.0 { 15.0 } else { 150.0 };
    let straight = |_: f64| 80.2;
    let level = |_: f64, _: f64| 4.0;
    let scene = eight_bit(&straight, &black, &level);
    let stripe = extract(&scene, 5, precise());
    let off: Vec<_> =
        stripe.measurements().filter(|m| (m.position_px - 80.2).abs() > 5.0 * m.sigma_px.max(0.03)).collect();
    assert!(off.is_empty(), "unflagged or too sure: {off:?}");
    let near = |m: &uw_stripe::Measurement| (248..=252).contains(&m.line);
    assert!(stripe.measurements().filter(near).all(|m| m.flags.contains(Flags::EDGE)));
    let far_flagged =
        stripe.measurements().filter(|m| m.line.abs_diff(250) > 20 && m.flags.contains(Flags::EDGE)).count();
    assert!(far_flagged < 10, "{far_flagged} of the smooth lines flagged");
    let strict = extract(&scene, 5, Options { reject_edges: true, ..precise() });
    assert!(!strict.measurements().any(|m| near(&m)));
}

#[test]
fn the_noise_is_read_off_the_images() {
    /// Five parameters a line leave little of each profile to judge the noise by.
    const NOISE_WITHIN: f32 = 1.6;
    let shaded = |_: f64, v: f64| 20.0 + 0.3 * v;
    let level = |_: f64, _: f64| 6.0;
    let scene = Scene { read_noise_dn: 1.5, electrons_per_dn: 15.0, ..eight_bit(&wavy, &shaded, &level) };
    let images: Vec<Vec<u8>> = (0..4).map(|s| to_u8(&scene.render(s))).collect();
    let views = images.iter().map(|i| View::packed(i, scene.width, scene.height).unwrap());
    let noise = Extractor::new(precise()).unwrap().estimate_noise(views).unwrap();
    for signal in [20.0f64, 100.0] {
        let want = 1.5f64.powi(2) + 1.0 / 12.0 + (signal + 6.0) / 15.0;
        let got = noise.variance(signal + 6.0, signal);
        let ratio = (got / want) as f32;
        assert!((1.0 / NOISE_WITHIN..NOISE_WITHIN).contains(&ratio), "{signal}: {got} for {want}, {noise:?}");
    }
}
