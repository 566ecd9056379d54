//! What holds for any image: layout, bookkeeping, bad input.

use crate::scene::{Scene, none, to_u8};
use proptest::prelude::*;
use uw_stripe::{Axis, Extractor, NoiseModel, Options, Reject, Roi, Stripe, StripeError, View};

const WIDTH: usize = 90;
const HEIGHT: usize = 60;

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
    let pixels = image();
    let turned: Vec<u8> = (0..WIDTH * HEIGHT).map(|i| pixels[i % HEIGHT * WIDTH + i / HEIGHT]).collect();
    let rows = run(Options::default(), View::packed(&pixels, WIDTH, HEIGHT).unwrap());
    let options = Options { axis: Axis::PerColumn, ..Options::default() };
    let columns = run(options, View::packed(&turned, HEIGHT, WIDTH).unwrap());
    assert_eq!(rows.found(), HEIGHT);
    assert_eq!(bits(&rows), bits(&columns));
    let [u, v] = columns.axis.uv(3, 1.5);
    assert!((u - 3.0).abs() + (v - 1.5).abs() < f64::EPSILON);
}

#[test]
fn a_stride_changes_nothing() {
    const STRIDE: usize = WIDTH + 13;
    let pixels = image();
    let mut padded = vec![255u8; STRIDE * HEIGHT];
    for (to, from) in padded.chunks_mut(STRIDE).zip(pixels.chunks(WIDTH)) {
        to[..WIDTH].copy_from_slice(from);
    }
    let plain = run(Options::default(), View::packed(&pixels, WIDTH, HEIGHT).unwrap());
    let strided = run(Options::default(), View::new(&padded, WIDTH, HEIGHT, STRIDE).unwrap());
    assert_eq!(bits(&plain), bits(&strided));
}

#[test]
fn a_region_keeps_image_coordinates_and_names_what_it_leaves_out() {
    let pixels = image();
    let view = View::packed(&pixels, WIDTH, HEIGHT).unwrap();
    let noise = Some(NoiseModel {
        gain_e_per_dn: 40.0,
        read_noise_dn: 1.0,
        speckle_contrast: 0.0,
        full_scale_dn: 255.0,
    });
    let roi = Roi { x: 25, y: 10, width: 50, height: 40 };
    let whole = run(Options { noise, ..Options::default() }, view);
    let part = run(Options { noise, roi: Some(roi), ..Options::default() }, view);
    assert_eq!(part.len(), HEIGHT);
    assert_eq!(part.found(), roi.height);
    for i in 0..HEIGHT {
        if (10..50).contains(&i) {
            assert!((part.position_px[i] - whole.position_px[i]).abs() < 0.01, "line {i}");
        } else {
            assert_eq!(part.reject[i], Some(Reject::OutsideRoi));
        }
    }
}

#[test]
fn an_extractor_remembers_nothing() {
    let pixels = image();
    let view = View::packed(&pixels, WIDTH, HEIGHT).unwrap();
    let fresh = run(Options::default(), view);
    let mut used = Extractor::new(Options::default()).unwrap();
    let other = vec![200u8; 33 * 7];
    used.extract(View::packed(&other, 33, 7).unwrap(), None).unwrap();
    assert_eq!(bits(&fresh), bits(used.extract(view, None).unwrap()));
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
            assert!(s.width_px[i] > 0.0 && s.amplitude[i] > 0.0 && s.chi2[i].is_finite());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_image_gives_consistent_entries(
        width in 1usize..40, height in 1usize..24, gap in 0usize..5, sparse in 1u32..20,
        seed in any::<u32>(), columns in any::<bool>(),
    ) {
        // Noise of any density: from nearly black, with single bright pixels, to full.
        let stride = width + gap;
        let mut state = u64::from(seed) | 1;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as u32
        };
        let pixels: Vec<u16> =
            (0..stride * height).map(|_| if next() % sparse == 0 { next() as u16 } else { 0 }).collect();
        let axis = if columns { Axis::PerColumn } else { Axis::PerRow };
        let mut extractor = Extractor::new(Options { axis, ..Options::default() }).unwrap();
        let view = View::new(&pixels, width, height, stride).unwrap();
        let stripe = extractor.extract(view, None).unwrap();
        prop_assert_eq!(stripe.len(), axis.lines(width, height));
        consistent(stripe);
        consistent(extractor.extract(view, Some(view)).unwrap());
    }

    #[test]
    fn flat_images_hold_no_stripe(width in 1usize..40, height in 1usize..24, value in any::<u8>()) {
        let pixels = vec![value; width * height];
        let stripe = run(Options::default(), View::packed(&pixels, width, height).unwrap());
        prop_assert_eq!(stripe.found(), 0);
    }
}
