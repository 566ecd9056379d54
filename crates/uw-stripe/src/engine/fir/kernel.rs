//! What the matched filters of one level are: least squares over a window, rounded to whole numbers, and what they read of stripes.

use nalgebra::{SMatrix, SVector};

use crate::special::normal;

/// Offset the filters are made for, px.
pub(super) const PHASE: f64 = 0.25;
/// Half a window, in widths: where shot noise dominates, what lies beyond holds 0.5 % of the information.
const REACH_WIDTHS: f64 = 3.2;
/// Distance from the offset up to which a filter is still matched well enough, in widths: five hundredths are lost at its end.
pub(super) const BELIEVED_WIDTHS: f64 = 0.5;
/// Degree of the polynomial that inverts t.
pub(super) const DEGREE: usize = 5;

/// Coefficients by rising powers.
pub(super) type Polynomial = [f32; DEGREE + 1];

/// Filters at one level, split in what is odd and what is even in k, in whole numbers: sums are exact whatever their order.
#[derive(Debug)]
pub(super) struct Kernel {
    /// For each pair of pixels, the taps of the first and, above 16 bits, of the second: of shift and height, odd and even.
    pub(super) taps: Vec<[[i32; 2]; 2]>,
    /// The same for what the model lacks: slope of the background and width.
    pub(super) extra: Vec<[[i32; 2]; 2]>,
    /// What one is in the taps of shift, height, slope, width.
    pub(super) unit: [f32; 4],
    /// Variances of the two for unit variance that is even, follows the stripe, follows its square.
    pub(super) extra_noise: [[f32; 3]; 2],
    /// Shift of the centre by a background that slopes by its height a pixel.
    pub(super) lean: f32,
    /// Shift from t, and its derivative.
    pub(super) shift: Polynomial,
    pub(super) rate: Polynomial,
    /// What the two read by the height on a stripe that lacks nothing, from t.
    pub(super) expected: [Polynomial; 2],
    /// Range of t that the polynomial holds for.
    pub(super) range: [f32; 2],
    /// Variance of D for unit variance that is even over the pixels, follows the stripe, follows its square.
    pub(super) noise: [f32; 3],
    /// Share of a shift beside the offset that is lacking, by the logarithm of width that is read.
    pub(super) lacking: f32,
    /// The height's tap in the middle.
    pub(super) peak: f32,
}

/// A stripe of height 1 and width `w` centred on `c` at pixel k, and its derivative by c: integrated over the pixel.
pub(crate) fn profile(k: f64, c: f64, w: f64) -> (f64, f64) {
    let ((low_density, low), (high_density, high)) = (normal((k - 0.5 - c) / w), normal((k + 0.5 - c) / w));
    let unit = (2.0 * std::f64::consts::PI).sqrt();
    (unit * w * (high - low), -unit * (high_density - low_density))
}

/// Pixels on either side of the place: fewer than five tell less than five shapes.
pub(super) fn half(width: f64) -> usize {
    ((REACH_WIDTHS * width + 0.5).ceil() as usize).max(2)
}

/// Shapes that a window is made of: height, shift, background; slope of the background and width, which the plain filters leave out.
const SHAPES: usize = 5;
const PLAIN: usize = 3;

impl Kernel {
    /// Filters of a width for windows of `half` pixels on either side, with the variance 1 + ρ g + κ g².
    pub(super) fn new(width: f64, half: usize, rho: f64, kappa: f64) -> Self {
        let taps = 2 * half + 1;
        let shapes: Vec<SVector<f64, SHAPES>> = (0..taps)
            .map(|i| {
                let k = i as f64 - half as f64;
                let (g, shift) = profile(k, PHASE, width);
                let step = 1e-3;
                // The height goes with 1/width at a given flux; here it is the shape of a given height that widens.
                let wider =
                    profile(k, PHASE, width * (1.0 + step)).0 - profile(k, PHASE, width * (1.0 - step)).0;
                SVector::from([g, shift, 1.0, k, wider / (2.0 * step)])
            })
            .collect();
        let weight = |r: &SVector<f64, SHAPES>| 1.0 / (1.0 + rho * r[0] + kappa * r[0] * r[0]);
        let mut normal = SMatrix::<f64, SHAPES, SHAPES>::zeros();
        for r in &shapes {
            normal += r * r.transpose() * weight(r);
        }
        // Shapes of which none is a sum of the others over five pixels and more: singular only where rounding makes them so.
        let plain =
            normal.fixed_view::<PLAIN, PLAIN>(0, 0).into_owned().try_inverse().unwrap_or_else(SMatrix::zeros);
        let full = normal.try_inverse().unwrap_or_else(SMatrix::zeros);
        let mut filters: Vec<[f64; 4]> = shapes
            .iter()
            .map(|r| {
                let few = plain * r.fixed_rows::<PLAIN>(0) * weight(r);
                let all = full * r * weight(r);
                [few[1], few[0], all[3], all[4]]
            })
            .collect();
        // All that follows is of the filters as they are in whole numbers.
        let whole: [Whole; 4] = std::array::from_fn(|which| Whole::of(&mut filters, which));
        let noise = |which: usize| {
            let mut sums = [0.0f32; 3];
            for (f, r) in filters.iter().zip(&shapes) {
                for (sum, power) in sums.iter_mut().zip([1.0, r[0], r[0] * r[0]]) {
                    *sum += (f[which] * f[which] * power) as f32;
                }
            }
            sums
        };
        let (shift, expected, range) = inversion(width, half, &filters);
        let lacking = lacking(width, half, &filters, (&shift, &expected[1]));
        let rate = std::array::from_fn(|k| if k < DEGREE { shift[k + 1] * (k + 1) as f32 } else { 0.0 });
        Self {
            taps: (0..=half).map(|j| [whole[0].taps[j], whole[1].taps[j]]).collect(),
            extra: (0..=half).map(|j| [whole[2].taps[j], whole[3].taps[j]]).collect(),
            unit: whole.each_ref().map(|w| w.unit),
            peak: filters[half][1] as f32,
            extra_noise: [noise(2), noise(3)],
            lean: filters.iter().zip(&shapes).map(|(f, r)| f[0] * r[3]).sum::<f64>() as f32,
            shift,
            rate,
            expected,
            range,
            noise: noise(0),
            lacking,
        }
    }
}

/// A filter in whole numbers.
struct Whole {
    /// For each pair of pixels, odd and even.
    taps: Vec<[i32; 2]>,
    unit: f32,
}

impl Whole {
    /// Rounds a filter of a window, and puts it back as it is then. What a constant background would add stays nothing.
    fn of(filters: &mut [[f64; 4]], which: usize) -> Self {
        /// Sum of taps by which pixels of 16 bits with a sign make no more than 32 bits.
        const LARGEST_SUM: f64 = u16::MAX as f64;
        const LARGEST: f64 = i16::MAX as f64;
        // What rounding adds to a tap's odd and even part at most.
        let added = 2.0 * filters.len() as f64;
        let (last, middle) = (filters.len() - 1, filters.len() / 2);
        let part = |k: usize, sign: f64| 0.5 * (filters[k][which] + sign * filters[last - k][which]);
        // The middle is such that the even part's sum is nothing: in the narrowest filters the inverse leaves a rest as large as a tap.
        let balance = -2.0 * (0..middle).map(|k| part(k, 1.0)).sum::<f64>();
        let even = |k: usize| if k == middle { balance } else { part(k, 1.0) };
        let size = |k: usize| part(k, -1.0).abs() + even(k).abs();
        let (sum, most) =
            (0..=last).map(size).fold((0.0f64, 0.0f64), |(sum, most), size| (sum + size, most.max(size)));
        let unit = (sum / (LARGEST_SUM - added).max(1.0)).max(most / (LARGEST - added).max(1.0));
        let whole = |value: f64| if unit > 0.0 { (value / unit).round() as i32 } else { 0 };
        let mut both: Vec<[i32; 2]> = (0..=last).map(|k| [whole(part(k, -1.0)), 0]).collect();
        // What rounding leaves of an even part goes to the next one: the flat ends of a wide filter would all be rounded the same way.
        let (mut sum, mut done) = (0.0, 0);
        for k in 0..middle {
            sum += part(k, 1.0);
            let next = whole(sum);
            (both[k][1], both[last - k][1]) = (next - done, next - done);
            done = next;
        }
        both[middle][1] = -2 * done;
        for (filter, [odd, even]) in filters.iter_mut().zip(&both) {
            filter[which] = f64::from(odd + even) * unit;
        }
        let taps = both
            .chunks(2)
            .map(|pair| {
                let second = pair.get(1).copied().unwrap_or_default();
                // The lower half as it is without a sign.
                std::array::from_fn(|part| (pair[0][part] & 0xffff) | (second[part] << 16))
            })
            .collect();
        Self { taps, unit: unit as f32 }
    }
}

/// What the filters read of a noise-free stripe of height 1, of that shift and width.
fn read(filters: &[[f64; 4]], half: usize, (shift, width): (f64, f64)) -> [f64; 4] {
    let mut read = [0.0; 4];
    for (i, f) in filters.iter().enumerate() {
        let g = profile(i as f64 - half as f64, shift, width).0;
        read.iter_mut().zip(f).for_each(|(sum, f)| *sum += f * g);
    }
    read
}

/// By how much of itself a shift beside the offset is read too small, by the logarithm of width that is read with it: of noise-free stripes a little wider
/// and narrower than the filters.
fn lacking(width: f64, half: usize, filters: &[[f64; 4]], (shift, wider): (&Polynomial, &Polynomial)) -> f32 {
    const AWAY: f64 = 0.25;
    const WIDER: f64 = 0.08;
    let value = |c: &Polynomial, t: f64| c.iter().rev().fold(0.0, |sum, c| sum * t + f64::from(*c));
    let one = |(away, by): (f64, f64)| {
        let [moment, height, _, widening] = read(filters, half, (PHASE + away, width * (1.0 + by)));
        let t = moment / height;
        let found = value(shift, t) - PHASE;
        (away / found - 1.0) / (widening / height - value(wider, t))
    };
    let all = [(AWAY, WIDER), (AWAY, -WIDER), (-AWAY, WIDER), (-AWAY, -WIDER)].map(one);
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    // Too narrow a filter tells no width.
    if mean.is_finite() { mean.clamp(0.0, 1.0) as f32 } else { 0.0 }
}

/// Polynomials in t = D/A for a stripe's shift and for what the extra filters read by its height, fitted to noise-free stripes, and the range
/// of t they were fitted to.
fn inversion(width: f64, half: usize, filters: &[[f64; 4]]) -> (Polynomial, [Polynomial; 2], [f32; 2]) {
    const STEPS: usize = 64;
    const TERMS: usize = DEGREE + 1;
    let reach = BELIEVED_WIDTHS * width;
    let (from, to) = (PHASE - 0.5 - reach, PHASE + 0.1 + reach);
    let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
    let mut right = SMatrix::<f64, TERMS, 3>::zeros();
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for step in 0..=STEPS {
        let shift = from + (to - from) * step as f64 / STEPS as f64;
        let [moment, height, slope, wider] = read(filters, half, (shift, width));
        let t = moment / height;
        (low, high) = (low.min(t), high.max(t));
        let powers = SVector::<f64, TERMS>::from_fn(|k, _| t.powi(k as i32));
        normal += powers * powers.transpose();
        right += powers * SMatrix::<f64, 1, 3>::new(shift, slope / height, wider / height);
    }
    let solution = normal.cholesky().map_or_else(SMatrix::zeros, |c| c.solve(&right));
    let column = |c: usize| std::array::from_fn(|k| solution[(k, c)] as f32);
    (column(0), [column(1), column(2)], [low as f32, high as f32])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn no_tap_is_off_by_more_than_its_neighbours_leave_it() {
        for width in [0.4, 2.0, 8.0, 50.0, 150.0] {
            let half = half(width);
            let profile: Vec<f64> =
                (0..=2 * half).map(|i| profile(i as f64 - half as f64, PHASE, width).0).collect();
            let even = profile.iter().sum::<f64>() / profile.len() as f64;
            let exact: Vec<[f64; 4]> = profile.iter().map(|value| [value - even; 4]).collect();
            let mut filters = exact.clone();
            let unit = f64::from(Whole::of(&mut filters, 0).unit);
            for (whole, exact) in filters.iter().zip(&exact) {
                assert!((whole[0] - exact[0]).abs() < 1.6 * unit, "{width}: {whole:?} for {exact:?}");
            }
        }
    }

    /// Neither a tap nor a sum of pixels by taps is more than its bits hold, and an even background is nothing.
    fn whole_numbers_fit(width: f64, rho: f64, kappa: f64) -> Result<(), TestCaseError> {
        let half = half(width);
        let kernel = Kernel::new(width, half, rho, kappa);
        for taps in [&kernel.taps, &kernel.extra] {
            prop_assert_eq!(taps.len(), half + 1);
            for which in 0..2 {
                let parts = [0, 1].map(|part| {
                    let both =
                        |pair: &[[i32; 2]; 2]| [pair[which][part] as i16, (pair[which][part] >> 16) as i16];
                    taps.iter().flat_map(both).map(i64::from).collect::<Vec<_>>()
                });
                let largest: i64 = parts.iter().flatten().map(|tap| tap.abs()).sum();
                prop_assert!(largest * i64::from(i16::MIN).abs() <= i64::from(i32::MAX), "{largest}");
                prop_assert!(parts.iter().all(|part| part.iter().sum::<i64>() == 0));
                prop_assert!(parts.iter().all(|part| part[2 * half + 1] == 0));
                let mirrored = |k: usize, sign: i64, part: &[i64]| part[k] == sign * part[2 * half - k];
                prop_assert!((0..=half).all(|k| mirrored(k, -1, &parts[0]) && mirrored(k, 1, &parts[1])));
            }
        }
        Ok(())
    }

    #[test]
    fn whole_numbers_fit_where_rounding_unbalances_a_filter() {
        whole_numbers_fit(0.05, 0.0, 1e-3).unwrap();
    }

    proptest! {
        #[test]
        fn whole_numbers_fit_whatever_the_filter(
            width in 0.05f64..120.0,
            rho in prop_oneof![Just(0.0), 1e-3f64..1e5],
            kappa in prop_oneof![Just(0.0), 1e-3f64..1e5],
        ) {
            whole_numbers_fit(width, rho, kappa)?;
        }
    }
}
