//! One result whatever the processor: values recorded on x86-64, met on others (`just neon` runs this file as aarch64 code).

use uw_stripe::{Axis, Extractor, Method, NoiseModel, Options, View};

const SIZE: (usize, usize) = (160, 96);
/// Vectors give the same bits everywhere; their filters, and the likelihood, come from the mathematical library, whose last bit differs.
const LAST_BIT_PX: f64 = 2e-5;
const NOISE: NoiseModel =
    NoiseModel { gain_e_per_dn: 40.0, read_noise_dn: 1.0, speckle_contrast: 0.0, full_scale_dn: 255.0 };
/// Position and sigma, px, summed over the lines.
const RECORDED: [(Method, [f64; 2]); 6] = [
    (Method::Fast, [7202.66867, 1.85780]),
    (Method::Robust, [7202.72421, 1.66590]),
    (Method::Precise, [7202.66518, 2.10631]),
    (Method::Ridge, [7202.65220, 0.83822]),
    (Method::Cog, [7202.20180, 3.35099]),
    (Method::BlaisRioux, [7202.58984, 1.66577]),
];

/// A stripe with a dim copy beside it, in noise of whole numbers: nothing that another mathematical library could round otherwise.
fn image(turned: bool) -> Vec<u8> {
    let mut state = 1u64;
    let mut noise = || {
        let mut sum = 0.0;
        for _ in 0..12 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (state >> 40) as f64 / f64::from(1u32 << 24);
        }
        1.5 * (sum - 6.0)
    };
    let mut pixels = vec![0; SIZE.0 * SIZE.1];
    for line in 0..SIZE.1 {
        let centre = 60.3 + 0.31 * line as f64;
        let bell = |x: f64, at: f64| (1.0 + (x - at).powi(2) / 16.0).powi(-4);
        for x in 0..SIZE.0 {
            let light = 150.0 * bell(x as f64, centre) + 30.0 * bell(x as f64, centre + 31.0) + 9.0;
            let at = if turned { x * SIZE.1 + line } else { line * SIZE.0 + x };
            pixels[at] = (light + noise()).round().clamp(0.0, 255.0) as u8;
        }
    }
    pixels
}

#[test]
fn the_recorded_figures_are_met() {
    for (method, recorded) in RECORDED {
        for (axis, turned) in [(Axis::PerRow, false), (Axis::PerColumn, true)] {
            let pixels = image(turned);
            let (width, height) = if turned { (SIZE.1, SIZE.0) } else { SIZE };
            let options =
                Options { method, axis, noise: Some(NOISE), width_px: Some(2.0), ..Options::default() };
            let mut extractor = Extractor::new(options).unwrap();
            let stripe = extractor.extract(View::packed(&pixels, width, height).unwrap(), None).unwrap();
            assert_eq!(stripe.found(), SIZE.1, "{method:?} {axis:?}");
            let sums = stripe.measurements().fold([0.0; 2], |s, m| [s[0] + m.position_px, s[1] + m.sigma_px]);
            for (sum, recorded) in sums.iter().zip(recorded) {
                let off = (sum - recorded).abs() / SIZE.1 as f64;
                assert!(off < LAST_BIT_PX, "{method:?} {axis:?}: {sums:?} for {recorded:?}");
            }
        }
    }
}
