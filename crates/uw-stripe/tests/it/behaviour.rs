//! What holds for any image: layout, bookkeeping, bad input.

use crate::scene::{Scene, none, to_u8};
use proptest::prelude::*;
use uw_stripe::{
    Axis, Extractor, Flags, Method, NoiseModel, Options, Pixel, Reject, Roi, Stripe, StripeError, Tracking,
    View,
};

const WIDTH: usize = 90;
const HEIGHT: usize = 60;
const NOISE: NoiseModel =
    NoiseModel { gain_e_per_dn: 40.0, read_noise_dn: 1.0, speckle_contrast: 0.0, full_scale_dn: 255.0 };

/// Every method, with noise and width learned and given.
fn settings() -> Vec<Options> {
    let learned = Method::ALL.map(|method| Options { method, ..Options::default() });
    let given = learned.clone().map(|o| Options { noise: Some(NOISE), width_px: Some(1.3), ..o });
    learned.into_iter().chain(given).collect()
}

fn image() -> Vec<u8> {
    let centre = |v: f64| 40.0 + 0.2 * v;
    let amplitude = |_: f64, _: f64| 120.0;
    let background = |_: f64, _: f64| 5.0;
    to_u8(
        &Scene {
            width: WIDTH,
            height: HEIGHT,
            centre: &centre,
            amplitude: &amplitude,
            sigma: 1.3,
            background: &background,
            electrons_per_dn: 40.0,
            read_noise_dn: 1.0,
            full_scale_dn: 255.0,
        }
        .render(1),
    )
}

fn run(options: Options, view: View<'_, u8>) -> Stripe {
    Extractor::new(options).unwrap().extract(view, None).unwrap().clone()
}

/// Bits of every float, so that NaN equals NaN and nothing else does.
fn bits(s: &Stripe) -> Vec<u32> {
    [&s.position_px, &s.sigma_px, &s.amplitude, &s.width_px, &s.background, &s.chi2, &s.rival_ratio]
        .into_iter()
        .flatten()
        .map(|v| v.to_bits())
        .collect()
}

#[test]
fn columns_of_the_transposed_image_are_its_rows() {
    /// Kernels turn rows and shift columns into the same registers; candidates may differ by a pixel before they are recentred.
    const SAME_PX: f32 = 0.01;
    let pixels = image();
    let turned: Vec<u8> = (0..WIDTH * HEIGHT).map(|i| pixels[i % HEIGHT * WIDTH + i / HEIGHT]).collect();
    for options in settings() {
        let rows = run(options.clone(), View::packed(&pixels, WIDTH, HEIGHT).unwrap());
        let by_columns = Options { axis: Axis::PerColumn, ..options.clone() };
        let columns = run(by_columns, View::packed(&turned, HEIGHT, WIDTH).unwrap());
        assert_eq!(rows.found(), HEIGHT, "{options:?}");
        if options.method == Method::Precise {
            assert_eq!(bits(&rows), bits(&columns));
        }
        for (row, column) in rows.position_px.iter().zip(&columns.position_px) {
            assert!((row - column).abs() < SAME_PX, "{row} {column} {options:?}");
        }
        let [u, v] = columns.axis.uv(3, 1.5);
        assert!((u - 3.0).abs() + (v - 1.5).abs() < f64::EPSILON);
    }
}

#[test]
fn a_stride_changes_nothing() {
    const STRIDE: usize = WIDTH + 13;
    let pixels = image();
    let mut padded = vec![255u8; STRIDE * HEIGHT];
    for (to, from) in padded.chunks_mut(STRIDE).zip(pixels.chunks(WIDTH)) {
        to[..WIDTH].copy_from_slice(from);
    }
    for options in settings() {
        let plain = run(options.clone(), View::packed(&pixels, WIDTH, HEIGHT).unwrap());
        let strided = run(options.clone(), View::new(&padded, WIDTH, HEIGHT, STRIDE).unwrap());
        assert_eq!(bits(&plain), bits(&strided), "{options:?}");
    }
}

#[test]
fn a_region_keeps_image_coordinates_and_names_what_it_leaves_out() {
    let pixels = image();
    let view = View::packed(&pixels, WIDTH, HEIGHT).unwrap();
    let roi = Roi { x: 25, y: 10, width: 50, height: 40 };
    for options in settings().into_iter().filter(|o| o.noise.is_some() && o.method != Method::Ridge) {
        let whole = run(options.clone(), view);
        let part = run(Options { roi: Some(roi), ..options.clone() }, view);
        assert_eq!(part.len(), HEIGHT);
        assert_eq!(part.found(), roi.height, "{options:?}");
        for i in 0..HEIGHT {
            if (10..50).contains(&i) {
                let off = (part.position_px[i] - whole.position_px[i]).abs();
                assert!(off < 0.01, "line {i}: {off} {options:?}");
            } else {
                assert_eq!(part.reject[i], Some(Reject::OutsideRoi));
            }
        }
    }
}

#[test]
fn an_extractor_that_learns_nothing_remembers_nothing() {
    let pixels = image();
    let view = View::packed(&pixels, WIDTH, HEIGHT).unwrap();
    for options in settings().into_iter().filter(|o| o.noise.is_some() || o.method == Method::Precise) {
        let fresh = run(options.clone(), view);
        let mut used = Extractor::new(options.clone()).unwrap();
        let other = vec![200u8; 33 * 7];
        used.extract(View::packed(&other, 33, 7).unwrap(), None).unwrap();
        assert_eq!(bits(&fresh), bits(used.extract(view, None).unwrap()), "{options:?}");
    }
}

/// The table in the documentation of [`Stripe`].
#[test]
fn every_method_fills_what_it_is_documented_to() {
    // A rival on some lines, as far away as every method looks.
    const WIDE: usize = WIDTH + 60;
    let mut pixels = Vec::new();
    for (i, row) in image().chunks_exact(WIDTH).enumerate() {
        pixels.extend_from_slice(row);
        pixels.extend([5; 60]);
        if (20..30).contains(&i) {
            pixels[i * WIDE + 120..][..4].fill(90);
        }
    }
    for options in settings().into_iter().filter(|o| o.noise.is_some()) {
        let (method, stripe) = (options.method, run(options, View::packed(&pixels, WIDE, HEIGHT).unwrap()));
        let judged = matches!(method, Method::Robust | Method::Precise | Method::Ridge);
        for i in (0..HEIGHT).filter(|i| stripe.reject[*i].is_none()) {
            for array in [&stripe.sigma_px, &stripe.amplitude, &stripe.width_px, &stripe.background] {
                assert!(array[i].is_finite(), "{method:?} line {i}");
            }
            assert_eq!(stripe.chi2[i].is_nan(), !judged, "{method:?} line {i}");
            assert_eq!(stripe.rival_ratio[i].is_nan(), !judged, "{method:?} line {i}");
        }
        let rival = |i: usize| stripe.flags[i].contains(Flags::SEVERAL_PEAKS) && stripe.rival_ratio[i] > 0.2;
        assert_eq!((21..29).all(rival), judged, "{method:?}");
    }
}

#[test]
fn a_background_takes_ambient_stripes_away() {
    let ambient = |u: f64, _: f64| 10.0 + 150.0 * (-0.5 * ((u - 70.0) / 2.0).powi(2)).exp();
    let centre = |v: f64| 30.0 + 0.1 * v;
    let amplitude = |_: f64, _: f64| 60.0;
    let mut scene = Scene {
        width: WIDTH,
        height: HEIGHT,
        centre: &centre,
        amplitude: &amplitude,
        sigma: 1.3,
        background: &ambient,
        electrons_per_dn: 40.0,
        read_noise_dn: 1.0,
        full_scale_dn: 255.0,
    };
    let on = to_u8(&scene.render(1));
    scene.amplitude = &none;
    let off = to_u8(&scene.render(2));
    let mut extractor = Extractor::new(Options::default()).unwrap();
    let (on, off) = (View::packed(&on, WIDTH, HEIGHT).unwrap(), View::packed(&off, WIDTH, HEIGHT).unwrap());
    let fooled = extractor.extract(on, None).unwrap().measurements().filter(|m| m.position_px > 60.0).count();
    assert_eq!(fooled, HEIGHT, "the scene is no test without a background");
    let stripe = extractor.extract(on, Some(off)).unwrap();
    assert_eq!(stripe.found(), HEIGHT);
    for m in stripe.measurements() {
        assert!((m.position_px - centre(m.line as f64)).abs() < 5.0 * m.sigma_px, "{m:?}");
    }
}

#[test]
fn useless_calls_say_what_was_needed() {
    let pixels = [0u8; 12];
    assert_eq!(View::packed(&pixels, 4, 4).unwrap_err(), StripeError::SliceTooShort { needed: 16, got: 12 });
    assert_eq!(View::packed(&pixels, 0, 4).unwrap_err(), StripeError::EmptyImage { width: 0, height: 4 });
    assert_eq!(View::new(&pixels, 4, 3, 3).unwrap_err(), StripeError::StrideTooShort { width: 4, stride: 3 });
    let view = View::packed(&pixels, 4, 3).unwrap();
    let small = View::packed(&pixels, 3, 3).unwrap();
    let mut extractor = Extractor::new(Options::default()).unwrap();
    assert!(matches!(extractor.extract(view, Some(small)), Err(StripeError::BackgroundSize { .. })));
    let roi = Some(Roi { x: 2, y: 0, width: usize::MAX, height: 1 });
    let mut extractor = Extractor::new(Options { roi, ..Options::default() }).unwrap();
    assert!(matches!(extractor.extract(view, None), Err(StripeError::RoiOutside { .. })));
    let bad = Options { min_snr: f32::NAN, ..Options::default() };
    assert!(matches!(Extractor::new(bad), Err(StripeError::InvalidOption { name: "min_snr", .. })));
    let wide = Options { width_px: Some(4.6e27), noise: Some(NOISE), ..Options::default() };
    assert!(matches!(Extractor::new(wide), Err(StripeError::InvalidOption { name: "width_px", .. })));
    let mut extractor = Extractor::new(Options::default()).unwrap();
    assert!(matches!(extractor.estimate_noise([view]), Err(StripeError::TooFewForNoise { got: 0, .. })));
}

fn consistent(s: &Stripe) {
    let counted: usize = s.rejected().map(|(_, n)| n).sum();
    assert_eq!(counted + s.found(), s.len());
    for i in 0..s.len() {
        assert_eq!(s.position_px[i].is_nan(), s.reject[i].is_some());
        if s.reject[i].is_none() {
            assert!(s.sigma_px[i] > 0.0 && s.sigma_px[i].is_finite());
            assert!(s.width_px[i] > 0.0 && s.amplitude[i] > 0.0);
        }
    }
}

/// Settings by number: method, direction, what is given, what else is asked for.
fn any_options() -> impl Strategy<Value = Options> {
    let extras = (any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>());
    (0usize..12, any::<bool>(), extras).prop_map(|(k, columns, (track, pool, strict, narrow))| Options {
        axis: if columns { Axis::PerColumn } else { Axis::PerRow },
        track: track.then_some(Tracking { reach_px: 5, full_every: 3 }),
        pool_lines: pool.then_some(2.0),
        reject_edges: strict,
        max_width_px: if narrow { 1.0 } else { 8.0 },
        stripes: 3,
        ..settings()[k].clone()
    })
}

/// Extracts twice, so that buffers and tracks are used again, all stripes, and with a background.
fn try_all<P: Pixel>(options: &Options, view: View<'_, P>) {
    let mut extractor = Extractor::new(options.clone()).unwrap();
    let lines = options.axis.lines(view.width(), view.height());
    for background in [None, None, Some(view)] {
        let stripe = extractor.extract(view, background).unwrap();
        assert_eq!(stripe.len(), lines);
        consistent(stripe);
    }
    let all = extractor.extract_all(view, None).unwrap();
    assert_eq!(all.len(), 3);
    all.iter().for_each(consistent);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn any_image_gives_consistent_entries(
        width in 1usize..150, height in 1usize..40, gap in 0usize..5, sparse in 1u32..20,
        seed in any::<u32>(), options in any_options(),
    ) {
        // Noise of any density: from nearly black, with single bright pixels, to full.
        let stride = width + gap;
        let mut state = u64::from(seed) | 1;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as u32
        };
        let words: Vec<u16> =
            (0..stride * height).map(|_| if next() % sparse == 0 { next() as u16 } else { 0 }).collect();
        let bytes: Vec<u8> = words.iter().map(|w| *w as u8).collect();
        try_all(&options, View::new(&words, width, height, stride).unwrap());
        try_all(&options, View::new(&bytes, width, height, stride).unwrap());
    }

    #[test]
    fn flat_images_hold_no_stripe(
        width in 1usize..150, height in 1usize..40, value in prop_oneof![Just(0u8), Just(255), any::<u8>()],
        options in any_options(),
    ) {
        let pixels = vec![value; width * height];
        let stripe = run(options, View::packed(&pixels, width, height).unwrap());
        prop_assert_eq!(stripe.found(), 0);
    }

    /// A stripe of a single pixel a line, on any size: where it is found, it is that pixel.
    #[test]
    fn one_pixel_stripes_are_that_pixel(
        width in 1usize..150, height in 1usize..40, at in 0usize..150, value in 40u8..=254, ground in 0u8..20,
        options in any_options(),
    ) {
        const WITHIN_PX: f64 = 0.2;
        let columns = options.axis == Axis::PerColumn;
        let at = at % if columns { height } else { width };
        let lit = |i: usize| at == if columns { i / width } else { i % width };
        let pixels: Vec<u8> = (0..width * height).map(|i| if lit(i) { value } else { ground }).collect();
        let stripe = run(options, View::packed(&pixels, width, height).unwrap());
        consistent(&stripe);
        for m in stripe.measurements() {
            prop_assert!((m.position_px - at as f64).abs() < WITHIN_PX, "{:?} for {}", m, at);
        }
    }
}
