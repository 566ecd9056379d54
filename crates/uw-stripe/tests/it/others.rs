//! Scenes that the methods were not made on: other widths, cameras, borders, hazes, glints, gaps, ends, defocus, saturation, hot pixels.

use crate::optics::{Camera, Optics};
use crate::suite::{Case, HEIGHT, MIDDLE, dark, plain, wavy};

/// The scenes.
pub const OTHERS: [Case; 14] = [
    Case { name: "narrow", make: |w, c| plain(0.65 * w, c, 0.6) },
    Case { name: "wide", make: |w, c| plain(2.0 * w, c, 0.6) },
    Case { name: "other cameras", make: |w, c| plain(w, other(c), 0.5) },
    Case { name: "near the border", make: near_the_border },
    Case { name: "uneven veil", make: uneven_veil },
    Case { name: "several glints", make: several_glints },
    Case { name: "dark gaps", make: |w, c| lit(w, c, |v| (v / 60.0).fract() > 0.2) },
    Case { name: "ends halfway", make: |w, c| lit(w, c, |v| v < 0.6 * HEIGHT as f64) },
    Case { name: "defocus along", make: defocus },
    Case { name: "saturated threefold", make: |w, c| plain(w, c, 3.0) },
    Case { name: "shaded", make: |w, c| shaded(w, c, 0.02) },
    Case { name: "hot pixels", make: |w, c| with_hot_pixels(plain(w, c, 0.5)) },
    Case {
        name: "hot pixels, low signal",
        make: |w, c| {
            let faint = 8.0 * c.variance(dark(&c)).sqrt() / c.full_scale_dn;
            with_hot_pixels(plain(w, c, faint))
        },
    },
    Case { name: "shaded, textured", make: |w, c| shaded(w, c, 0.1) },
];

/// A camera of a third of the gain, or of three times, and more noise.
fn other(camera: Camera) -> Camera {
    if camera.full_scale_dn > 255.0 {
        Camera { electrons_per_dn: 8.0, read_noise_dn: 6.0, ..camera }
    } else {
        Camera { electrons_per_dn: 13.0, read_noise_dn: 0.6, ..camera }
    }
}

/// Between 4 and 6 widths from the image's first pixel.
fn near_the_border(sigma_px: f64, camera: Camera) -> Optics {
    let centre = move |v: f64| sigma_px * (5.0 + (v / 50.0).sin());
    Optics { centre: Box::new(centre), ..plain(sigma_px, camera, 0.5) }
}

/// Light of a lamp at the side that falls off fast, on water that scatters the laser into a skirt of ten widths.
fn uneven_veil(sigma_px: f64, camera: Camera) -> Optics {
    let full = camera.full_scale_dn;
    let background = move |u: f64, v: f64| {
        let d = (u - wavy(v)) / sigma_px;
        full * (0.3 * (-u / 45.0).exp() + 0.1 * (-0.5 * ((d + 3.0) / 10.0).powi(2)).exp() + 0.02)
    };
    Optics { background: Box::new(background), ..plain(sigma_px, camera, 0.3) }
}

/// Three glints at once, up to twice as bright as the stripe, on a third of the lines.
fn several_glints(sigma_px: f64, camera: Camera) -> Optics {
    const BLOCK: f64 = 15.0;
    let (full, level) = (camera.full_scale_dn, dark(&camera));
    let background = move |u: f64, v: f64| {
        let block = (v / BLOCK).floor();
        let chance = |k: f64| (block * k + 0.61).fract();
        let glint = |k: f64, side: f64, share: f64| {
            let at = wavy(v) + side * (12.0 * sigma_px + 35.0 * chance(k));
            let t = (u - at) / (0.8 * sigma_px);
            share * full * (-0.5 * t * t).exp()
        };
        let on = v - block * BLOCK < 5.0;
        let light = glint(0.618_034, 1.0, 0.5) + glint(0.732_051, -1.0, 0.35) + glint(0.414_214, 1.0, 0.2);
        level + if on { light } else { 0.0 }
    };
    Optics { background: Box::new(background), ..plain(sigma_px, camera, 0.25) }
}

/// Lit on some lines only: the others send no light back.
fn lit(sigma_px: f64, camera: Camera, on: fn(f64) -> bool) -> Optics {
    let strength = 0.5 * camera.full_scale_dn;
    Optics {
        strength: Box::new(move |_, v| if on(v) { strength } else { 0.0 }),
        ..plain(sigma_px, camera, 0.5)
    }
}

/// In focus at a third of the image, half as wide again at its end.
fn defocus(sigma_px: f64, camera: Camera) -> Optics {
    let blur = |v: f64| 1.0 + 0.75 * ((v / HEIGHT as f64) - 0.33).abs();
    Optics { blur: Box::new(blur), ..plain(sigma_px, camera, 0.4) }
}

/// Brightness that falls to a fifth along the stripe, on a surface with a texture of this amplitude; a coarse one moves the light itself.
fn shaded(sigma_px: f64, camera: Camera, texture: f64) -> Optics {
    let full = camera.full_scale_dn;
    let strength = move |u: f64, v: f64| {
        let texture = 1.0 + texture * (0.9 * u + 0.4 * v).sin() * (0.23 * v - 0.31 * (u - MIDDLE)).sin();
        full * 0.7 * (-1.6 * v / HEIGHT as f64).exp() * texture
    };
    Optics { strength: Box::new(strength), ..plain(sigma_px, camera, 0.7) }
}

/// One pixel in a thousand shows a third of full scale to all of it, as hot ones of a long exposure do.
fn with_hot_pixels(scene: Optics) -> Optics {
    const SHARE: f64 = 1e-3;
    let full = scene.camera.full_scale_dn;
    let background = move |u: f64, v: f64| {
        // Any irregular sequence will do.
        let chance = (u.round() * 12.9898 + v.round() * 78.233).sin() * 43_758.545;
        let chance = chance - chance.floor();
        (scene.background)(u, v) + if chance < SHARE { full * (0.33 + 0.67 * chance / SHARE) } else { 0.0 }
    };
    Optics { background: Box::new(background), ..scene }
}
