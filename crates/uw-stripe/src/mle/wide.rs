//! Numbers side by side, one for each of the lines that are fitted together. Of plain operations only, so that a fit has the same bits on
//! every processor and whatever it shares its vector with.

use fearless_simd::{Select, Simd, SimdBase, SimdFloat, SimdMask, f64x8, mask64x8, u64x8};

/// One number for each of [`WIDE`] lines.
pub(crate) type V<S> = f64x8<S>;

/// One truth for each of them.
pub(super) type Mask<S> = mask64x8<S>;

/// Lines that are fitted together.
pub(super) const WIDE: usize = 8;

/// The same in memory.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
pub(super) struct Row(pub [f64; WIDE]);

impl Row {
    #[inline(always)]
    pub fn from<S: Simd>(values: V<S>) -> Self {
        let mut row = Self::default();
        values.store_slice(&mut row.0);
        row
    }

    #[inline(always)]
    pub fn load<S: Simd>(&self, simd: S) -> V<S> {
        V::from_slice(simd, &self.0)
    }
}

/// The numbers of `of`, by lane.
#[inline(always)]
pub(super) fn gather<S: Simd>(simd: S, of: impl Fn(usize) -> f64) -> V<S> {
    Row(std::array::from_fn(of)).load(simd)
}

/// eˣ to 1e-11 of itself; 0 for x below −100: smaller ones would square to denormal numbers, which processors take long over, and a pixel that
/// says nothing must not pass for one that says a little.
///
/// eˣ = 2ⁿ eʳ, for x up to 700, with n the whole number nearest to x / ln 2, and Taylor's series for |r| ≤ ½ ln 2.
#[inline(always)]
pub(super) fn exp<S: Simd>(simd: S, x: V<S>) -> V<S> {
    const LOWEST: f64 = -100.0;
    /// Added to a small number it leaves that one's whole part in its lowest bits.
    const ROUNDER: f64 = 1.5 * (1u64 << 52) as f64;
    /// ln 2 in two parts, of which the first has so few bits that its products with n are exact.
    const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
    let rounded = x * std::f64::consts::LOG2_E + ROUNDER;
    let n = rounded - ROUNDER;
    let r = x - n * LN_2[0] - n * LN_2[1];
    // In pairs, of which few wait for each other.
    let r2 = r * r;
    let r4 = r2 * r2;
    let low = pair(r, 1.0, 1.0) + pair(r, 0.5, 1.0 / 6.0) * r2;
    let middle = pair(r, 1.0 / 24.0, 1.0 / 120.0) + pair(r, 1.0 / 720.0, 1.0 / 5040.0) * r2;
    let sum = low + (middle + pair(r, 1.0 / 40_320.0, 1.0 / 362_880.0) * r4) * r4;
    let power = (rounded.to_bits() << 52) + u64x8::splat(simd, 1.0f64.to_bits());
    x.simd_lt(LOWEST).select(V::splat(simd, 0.0), sum * V::from_bits(power))
}

/// The line of r through `low` at 0 that rises by `high`.
#[inline(always)]
fn pair<S: Simd>(r: V<S>, low: f64, high: f64) -> V<S> {
    r * high + low
}

/// [`normal`](crate::special::normal) of each.
#[inline(always)]
pub(super) fn normal<S: Simd>(simd: S, t: V<S>) -> (V<S>, V<S>) {
    use crate::special::{CUMULATIVE, CUMULATIVE_SCALE};
    let gauss = exp(simd, t * t * -0.5);
    let k = V::splat(simd, 1.0) / (t.abs() * CUMULATIVE_SCALE + 1.0);
    let mut poly = V::splat(simd, CUMULATIVE[0]);
    for term in &CUMULATIVE[1..] {
        poly = poly * k + *term;
    }
    let tail = poly * k * gauss * 0.5;
    let below = t.simd_lt(0.0).select(tail, V::splat(simd, 1.0) - tail);
    (gauss * (2.0 * std::f64::consts::PI).sqrt().recip(), below)
}

/// φ(z) / Φ(z) of each, the inverse Mills ratio: the score of an observation that only says "below z".
#[inline(always)]
pub(super) fn mills<S: Simd>(simd: S, z: V<S>) -> V<S> {
    /// Beyond it the approximation of Φ loses relative accuracy and the asymptotic series has 1e-3.
    const TAIL: f64 = -4.0;
    let (density, below) = normal(simd, z);
    let ratio = density / below;
    let far = z.simd_lt(TAIL);
    if !far.any_true() {
        return ratio;
    }
    let y = V::splat(simd, -1.0) / z;
    far.select(y - z - y * y * y * 2.0, ratio)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};

    #[test]
    fn exponentials_and_normals_are_those_of_the_standard_library() {
        let both = |t: f64| {
            let of = Row([t; WIDE]);
            dispatch!(Level::new(), simd => {
                let (density, below) = normal(simd, of.load(simd));
                (Row::from(exp(simd, of.load(simd))).0[3], [Row::from(density).0[3], Row::from(below).0[5]])
            })
        };
        for i in -4000..4000 {
            let x = f64::from(i) * 0.0137;
            let (e, [density, below]) = both(x);
            assert!((e / x.exp() - 1.0).abs() < 1e-11, "{x}: {e}");
            let want = crate::special::normal(x);
            assert!((density - want.0).abs() < 1e-11 && (below - want.1).abs() < 1e-11, "{x}");
        }
        let ratio = |z: f64| dispatch!(Level::new(), simd => Row::from(mills(simd, V::splat(simd, z))).0[0]);
        /// φ(5)/Φ(−5) from 1.4867195e-6 / 2.8665157e-7.
        const AT_MINUS_FIVE: f64 = 5.186_504;
        assert!((ratio(-5.0) / AT_MINUS_FIVE - 1.0).abs() < 1e-3);
        assert!((ratio(-4.0 - 1e-9) / ratio(-4.0 + 1e-9) - 1.0).abs() < 5e-3);
        assert!((both(-99.9).0 / (-99.9f64).exp() - 1.0).abs() < 1e-11);
        for far in [-100.1, -1e5, -1e300, f64::NEG_INFINITY] {
            assert_eq!(both(far).0.to_bits(), 0, "{far}");
        }
        assert!(both(f64::NAN).0.is_nan());
    }
}
