//! The suite of scenes that every method is judged on, and the verdict: errors by the bound, bias, found, wrong, honesty of sigma.

use crate::optics::{Camera, Field, Optics};
use uw_stripe::{Axis, Extractor, Method, NoiseModel, Options, Stripe, View};

/// An error beyond this is a wrong peak, not an inaccurate one, px.
pub const WRONG_PX: f64 = 3.0;
/// Standard deviations of the stripes, px.
pub const WIDTHS_PX: [f64; 3] = [1.2, 2.0, 3.0];
/// An 8-bit and a 12-bit camera.
pub const CAMERAS: [Camera; 2] = [
    Camera { electrons_per_dn: 40.0, read_noise_dn: 1.0, full_scale_dn: 255.0 },
    Camera { electrons_per_dn: 2.5, read_noise_dn: 2.4, full_scale_dn: 4095.0 },
];
/// The lens's share of a stripe's width (of variance: half).
const LENS: f64 = std::f64::consts::FRAC_1_SQRT_2;
const WIDTH: usize = 200;
pub const HEIGHT: usize = 300;
pub const MIDDLE: f64 = 0.5 * WIDTH as f64;

/// A scene by name, made for a stripe's width and a camera.
pub struct Case {
    pub name: &'static str,
    pub make: fn(f64, Camera) -> Optics,
}

/// The suite.
pub const CASES: [Case; 13] = [
    Case { name: "clean", make: |w, c| plain(w, c, 0.6) },
    Case {
        name: "low signal",
        make: |w, c| plain(w, c, 8.0 * c.variance(dark(&c)).sqrt() / c.full_scale_dn),
    },
    Case { name: "haze", make: haze },
    Case { name: "haze, long tails", make: haze_with_tails },
    Case { name: "saturated", make: |w, c| plain(w, c, 1.6) },
    Case { name: "second reflection", make: second_reflection },
    Case { name: "steep", make: steep },
    Case { name: "steep, sheared", make: |w, c| Optics { sheared: true, ..steep(w, c) } },
    Case { name: "curved", make: curved },
    Case {
        name: "curved, sheared",
        make: |w, c| Optics { sheared: true, spread_px: 0.0, line_px: w, ..curved(w, c) },
    },
    Case { name: "speckle", make: |w, c| speckle(w, c, 0.25, 2) },
    Case { name: "strong speckle", make: |w, c| speckle(w, c, 0.4, 1) },
    Case { name: "albedo edges", make: albedo_edges },
];

pub fn dark(camera: &Camera) -> f64 {
    camera.full_scale_dn * 4.0 / 255.0
}

pub fn wavy(v: f64) -> f64 {
    MIDDLE - 10.0 + 0.05 * v + 6.0 * (v / 60.0).sin()
}

/// An even stripe of `share` times full scale on an even background.
pub fn plain(sigma_px: f64, camera: Camera, share: f64) -> Optics {
    let (strength, level) = (share * camera.full_scale_dn, dark(&camera));
    Optics {
        width: WIDTH,
        height: HEIGHT,
        camera,
        centre: Box::new(wavy),
        strength: Box::new(move |_, _| strength),
        background: Box::new(move |_, _| level),
        line_px: sigma_px * (1.0 - LENS * LENS).sqrt(),
        spread_px: sigma_px * LENS,
        blur: Box::new(|_| 1.0),
        sheared: false,
        looks: 0,
    }
}

/// A veil of backscatter that decays away from the laser, and a skirt of light scattered forward that rides with the stripe, of
/// `skirt` at a distance from its centre (1 at its top, displaced towards the laser).
fn veiled(sigma_px: f64, camera: Camera, skirt: fn(f64) -> f64) -> Field {
    const DECAY_PX: f64 = 150.0;
    let full = camera.full_scale_dn;
    Box::new(move |u, v| {
        let d = (u - wavy(v)) / sigma_px;
        full * (0.16 * (-u / DECAY_PX).exp() + 0.17 * skirt(d - 2.0))
    })
}

/// The ballistic peak on a Gaussian skirt of six widths, half as high (shape after Thorstensen 2024, doi 10.1364/oe.539546).
fn haze(sigma_px: f64, camera: Camera) -> Optics {
    let background = veiled(sigma_px, camera, |d| (-0.5 * (d / 6.0).powi(2)).exp());
    Optics { background, ..plain(sigma_px, camera, 0.34) }
}

/// The same with a Lorentzian skirt: a narrower top and longer tails.
fn haze_with_tails(sigma_px: f64, camera: Camera) -> Optics {
    let background = veiled(sigma_px, camera, |d| (1.0 + (d / 6.0).powi(2)).recip());
    Optics { background, ..plain(sigma_px, camera, 0.34) }
}

/// Glints half as bright again as the stripe, elsewhere on a fourth of the lines, up to eight lines long.
fn second_reflection(sigma_px: f64, camera: Camera) -> Optics {
    const BLOCK: f64 = 16.0;
    let (full, level) = (camera.full_scale_dn, dark(&camera));
    let background = move |u: f64, v: f64| {
        let block = (v / BLOCK).floor();
        // Any irregular sequence will do.
        let chance = |k: f64| (block * k + 0.37).fract();
        let length = 8.0 * chance(0.618_034);
        let side = if chance(0.414_214) < 0.5 { -1.0 } else { 1.0 };
        let at = wavy(v) + side * (12.0 * sigma_px + 30.0 * chance(0.732_051));
        let t = (u - at) / sigma_px;
        level + if v - block * BLOCK < length { 0.45 * full * (-0.5 * t * t).exp() } else { 0.0 }
    };
    Optics { background: Box::new(background), ..plain(sigma_px, camera, 0.3) }
}

/// A straight stripe of slope 1.2.
fn steep(sigma_px: f64, camera: Camera) -> Optics {
    Optics { height: 110, centre: Box::new(|v| 34.3 + 1.2 * v), ..plain(sigma_px, camera, 0.5) }
}

/// Slopes up to 1.2 and radii down to 21 px.
fn curved(sigma_px: f64, camera: Camera) -> Optics {
    Optics { centre: Box::new(|v| MIDDLE + 30.0 * (v / 25.0).sin()), ..plain(sigma_px, camera, 0.5) }
}

/// A rough surface through a lens whose point-spread (0.4 px: f/16 on pixels of 8 µm, in green) sets the size of the grains.
fn speckle(sigma_px: f64, camera: Camera, spread_px: f64, looks: u32) -> Optics {
    Optics {
        looks,
        spread_px,
        line_px: (sigma_px.powi(2) - spread_px.powi(2)).sqrt(),
        ..plain(sigma_px, camera, 0.3)
    }
}

/// Slanting edges between surfaces of four to one.
fn albedo_edges(sigma_px: f64, camera: Camera) -> Optics {
    let full = camera.full_scale_dn;
    let strength = move |u: f64, v: f64| {
        let bright = ((v + 0.5 * (u - MIDDLE)) / 45.0).rem_euclid(2.0) < 1.0;
        full * if bright { 0.6 } else { 0.15 }
    };
    Optics { strength: Box::new(strength), ..plain(sigma_px, camera, 1.0) }
}

/// What is judged: an extractor's settings, which may rest on the camera, never on the scene.
pub struct Contender {
    pub name: &'static str,
    pub options: fn(&Camera) -> Options,
}

/// The methods of this crate.
pub const CONTENDERS: [Contender; 5] = [
    Contender { name: "fast", options: |camera| given(camera, Method::Fast) },
    Contender { name: "robust", options: |camera| given(camera, Method::Robust) },
    Contender { name: "ridge", options: |camera| given(camera, Method::Ridge) },
    Contender { name: "precise", options: |camera| given(camera, Method::Precise) },
    Contender {
        name: "precise, noise from the image",
        options: |_| Options { method: Method::Precise, ..Options::default() },
    },
];

/// Settings of `method` with the camera's noise given.
fn given(camera: &Camera, method: Method) -> Options {
    Options { method, noise: Some(photon_transfer(camera)), ..Options::default() }
}

/// The noise model that dark and flat frames would show.
pub fn photon_transfer(camera: &Camera) -> NoiseModel {
    NoiseModel {
        gain_e_per_dn: camera.electrons_per_dn as f32,
        read_noise_dn: camera.read_noise_dn as f32,
        speckle_contrast: 0.0,
        full_scale_dn: camera.full_scale_dn as f32,
    }
}

/// The stripe in an image of `camera`, in its own pixel type.
fn extract(options: Options, camera: &Camera, image: &[u16], width: usize, height: usize) -> Stripe {
    let mut extractor = Extractor::new(options).unwrap();
    if camera.full_scale_dn > 255.0 {
        extractor.extract(View::packed(image, width, height).unwrap(), None).unwrap().clone()
    } else {
        let image: Vec<u8> = image.iter().map(|&v| v as u8).collect();
        extractor.extract(View::packed(&image, width, height).unwrap(), None).unwrap().clone()
    }
}

/// Errors of one method over one scene's widths, cameras and seeds.
#[derive(Debug, Default)]
pub struct Score {
    lines: usize,
    found: usize,
    wrong: usize,
    squares: f64,
    by_bound: f64,
    by_sigma: f64,
    /// Mean errors of each width and camera, px, and their standard errors.
    biases: Vec<(f64, f64)>,
}

impl Score {
    /// Share of the lines with a position.
    pub fn found(&self) -> f64 {
        self.found as f64 / self.lines as f64
    }

    /// Share of the lines with a position that is off by more than [`WRONG_PX`].
    pub fn wrong(&self) -> f64 {
        self.wrong as f64 / self.lines as f64
    }

    fn mean(&self, sum: f64) -> f64 {
        sum / (self.found - self.wrong).max(1) as f64
    }

    /// Standard error of the root mean squares, as a share of them.
    pub fn relative_error(&self) -> f64 {
        ((2 * (self.found - self.wrong).max(1)) as f64).sqrt().recip()
    }

    /// Root mean square error, px.
    pub fn rms_px(&self) -> f64 {
        self.mean(self.squares).sqrt()
    }

    /// Root mean square of error over bound.
    pub fn over_bound(&self) -> f64 {
        self.mean(self.by_bound).sqrt()
    }

    /// Predicted sigma over actual scatter.
    pub fn honesty(&self) -> f64 {
        self.mean(self.by_sigma).sqrt().recip()
    }

    /// Mean error of the worst width and camera, px, and its standard error.
    pub fn worst_bias_px(&self) -> (f64, f64) {
        self.biases.iter().copied().max_by(|a, b| a.0.abs().total_cmp(&b.0.abs())).unwrap_or_default()
    }

    /// The table's row.
    pub fn row(&self) -> String {
        let (bias, error) = self.worst_bias_px();
        let (found, wrong) = (100.0 * self.found(), 100.0 * self.wrong());
        let chance = 100.0 * self.relative_error();
        let (rms, over, honesty) = (self.rms_px(), self.over_bound(), self.honesty());
        format!(
            "{found:6.2} % {wrong:5.2} % {rms:8.4} {over:7.3} ±{chance:.1} % {bias:+8.4} ±{error:.4} {honesty:6.3}"
        )
    }
}

/// Heads of [`Score::row`].
pub const HEADS: &str = "   found   wrong  rms, px  /bound         worst bias, px   sigma/scatter";

/// Runs `contenders` over one scene, `seeds` images for each width and camera, rows and columns in turn.
pub fn judge(case: &Case, contenders: &[Contender], seeds: u64) -> Vec<Score> {
    let mut scores: Vec<Score> = contenders.iter().map(|_| Score::default()).collect();
    for (camera, width) in CAMERAS.iter().flat_map(|c| WIDTHS_PX.map(|w| (c, w))) {
        let scene = (case.make)(width, *camera);
        let (w, h) = (scene.width, scene.height);
        let mut errors: Vec<Vec<f64>> = contenders.iter().map(|_| Vec::new()).collect();
        let mut exposure = scene.expose(0);
        // With speckle the bound is that of the light as it fell.
        for seed in 0..seeds {
            if scene.looks > 0 && seed > 0 {
                exposure = scene.expose(seed);
            }
            let bounds = exposure.bounds();
            let image = exposure.shoot(seed + 1);
            let turned: Vec<u16> = (0..w * h).map(|i| image[i % h * w + i / h]).collect();
            for ((contender, score), errors) in contenders.iter().zip(&mut scores).zip(&mut errors) {
                let mut options = (contender.options)(&scene.camera);
                let stripe = if seed % 2 == 0 {
                    options.axis = Axis::PerRow;
                    extract(options, &scene.camera, &image, w, h)
                } else {
                    options.axis = Axis::PerColumn;
                    extract(options, &scene.camera, &turned, h, w)
                };
                score.lines += h;
                for m in stripe.measurements() {
                    let error = m.position_px - (scene.centre)(m.line as f64);
                    score.found += 1;
                    if error.abs() > WRONG_PX {
                        score.wrong += 1;
                        continue;
                    }
                    score.squares += error * error;
                    score.by_bound += (error / bounds[m.line]).powi(2);
                    score.by_sigma += (error / m.sigma_px).powi(2);
                    errors.push(error);
                }
            }
        }
        for (score, errors) in scores.iter_mut().zip(&errors) {
            let n = errors.len().max(1) as f64;
            let mean = errors.iter().sum::<f64>() / n;
            let spread = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n).sqrt();
            score.biases.push((mean, spread / n.sqrt()));
        }
    }
    scores
}
