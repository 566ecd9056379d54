//! Any size, stride, content and setting, in 8 and 16 bits: no panic, and one consistent entry a line.
//!
//! `cargo fuzz run --sanitizer none extract`, from the folder of the crate.

#![no_main]

use arbitrary::Arbitrary;
use libfuzzer_sys::fuzz_target;
use uw_stripe::{Axis, Extractor, Method, NoiseModel, Options, Pixel, Roi, Stripe, Tracking, View};

/// Lines and pixels a side; larger images only fuzz slower.
const LARGEST: usize = 96;

#[derive(Debug, Arbitrary)]
struct Input {
    width: u8,
    height: u8,
    gap: u8,
    columns: bool,
    background: bool,
    reject_edges: bool,
    method: u8,
    stripes: u8,
    width_px: Option<f32>,
    track: Option<[u8; 2]>,
    pool_lines: Option<f32>,
    roi: Option<[u8; 4]>,
    noise: Option<[f32; 4]>,
    full_scale_dn: Option<f32>,
    limits: Option<[f32; 3]>,
    pixels: Vec<u8>,
}

fuzz_target!(|input: Input| {
    let size = |v: u8| 1 + usize::from(v) % LARGEST;
    let (width, height) = (size(input.width), size(input.height));
    let stride = width + usize::from(input.gap % 8);
    let mut options = Options {
        axis: if input.columns { Axis::PerColumn } else { Axis::PerRow },
        reject_edges: input.reject_edges,
        method: Method::ALL[usize::from(input.method) % Method::ALL.len()],
        stripes: 1 + usize::from(input.stripes % 16),
        width_px: input.width_px,
        pool_lines: input.pool_lines,
        full_scale_dn: input.full_scale_dn,
        ..Options::default()
    };
    options.track = input
        .track
        .map(|[reach, every]| Tracking { reach_px: usize::from(reach), full_every: u32::from(every) });
    options.roi = input.roi.map(|[x, y, width, height]| {
        let [x, y, width, height] = [x, y, width, height].map(usize::from);
        Roi { x, y, width, height }
    });
    options.noise = input.noise.map(|[gain_e_per_dn, read_noise_dn, speckle_contrast, full_scale_dn]| {
        NoiseModel { gain_e_per_dn, read_noise_dn, speckle_contrast, full_scale_dn }
    });
    if let Some([min_snr, max_width_px, max_sigma_px]) = input.limits {
        (options.min_snr, options.max_width_px, options.max_sigma_px) = (min_snr, max_width_px, max_sigma_px);
    }
    let Ok(mut extractor) = Extractor::new(options) else { return };
    let at = |i: usize| input.pixels.get(i % input.pixels.len().max(1)).copied().unwrap_or(0);
    let bytes: Vec<u8> = (0..stride * height).map(at).collect();
    // Two bytes a pixel, so that all 16 bits occur.
    let words: Vec<u16> =
        (0..stride * height).map(|i| u16::from_le_bytes([at(2 * i), at(2 * i + 1)])).collect();
    run(&mut extractor, &bytes, [width, height, stride], input.background);
    run(&mut extractor, &words, [width, height, stride], input.background);
    // Once more, from used buffers.
    run(&mut extractor, &bytes, [width, height, stride], input.background);
});

fn run<P: Pixel>(
    extractor: &mut Extractor,
    pixels: &[P],
    [width, height, stride]: [usize; 3],
    background: bool,
) {
    let view = View::new(pixels, width, height, stride).expect("the slice was made for it");
    let lines = extractor.options().axis.lines(width, height);
    if let Ok(stripe) = extractor.extract(view, background.then_some(view)) {
        check(stripe, lines);
    }
    if let Ok(stripes) = extractor.extract_all(view, background.then_some(view)) {
        stripes.iter().for_each(|stripe| check(stripe, lines));
    }
}

fn check(stripe: &Stripe, lines: usize) {
    assert_eq!(stripe.len(), lines);
    for i in 0..lines {
        assert_eq!(stripe.position_px[i].is_nan(), stripe.reject[i].is_some(), "line {i}");
        if stripe.reject[i].is_none() {
            assert!(stripe.sigma_px[i] > 0.0 && stripe.sigma_px[i].is_finite(), "line {i}");
            assert!(stripe.width_px[i] > 0.0 && stripe.amplitude[i] > 0.0, "line {i}");
        }
    }
}
