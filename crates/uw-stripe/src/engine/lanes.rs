//! Grey values in vector registers: one type of pixel, 64 bytes at a time whatever the processor's own width, so that results do
//! not depend on it.

use super::{AllBuffers, Buffers};
use fearless_simd::{
    Bytes, Simd, SimdBase, SimdCombine, SimdFrom, SimdInt, SimdIntElement, SimdWiden, f32x16, i32x16, u8x16,
    u8x64, u16x16, u16x32, u32x16,
};

/// Largest [`Lanes::N`].
pub(crate) const MOST_LANES: usize = 64;

/// Lines that are measured at a time: 32-bit lanes of a vector.
pub(crate) const CHUNK: usize = 16;

/// A pixel type with its vector.
pub trait Lanes: SimdIntElement + Default + Ord + Send + Sync + std::ops::Sub<Output = Self> {
    /// Pixels a vector.
    const N: usize;
    /// The vector.
    type V<S: Simd>: SimdBase<S, Element = Self> + SimdInt<S>;
    /// As wide a vector of lanes twice as wide, each with a grey value above a number: the largest tells where the largest value is.
    type Key<S: Simd>: SimdBase<S, Element = Self::Wide>;
    /// A lane of it.
    type Wide: Copy + Default + Ord + Into<u32>;
    /// The smallest grey value.
    const ZERO: Self;
    /// The largest grey value.
    const MAX: Self;
    /// The grey value nearest below `dn`, within the type's range; 0 for NaN.
    fn from_dn(dn: f32) -> Self;
    /// A lane's number as a grey value; lanes are fewer than 256.
    fn from_index(index: u8) -> Self;
    /// The grey value as a number to count with.
    fn index(self) -> u32;
    /// Grey values with numbers below them, in two halves.
    fn keys<S: Simd>(values: Self::V<S>, numbers: Self::V<S>) -> (Self::Key<S>, Self::Key<S>);
    /// As many grey values as numbers to measure with.
    fn floats<S: Simd>(simd: S, values: &[Self; CHUNK]) -> f32x16<S>;
    /// The buffers of this type.
    fn buffers(all: &mut AllBuffers) -> &mut Buffers<Self>;
}

/// A vector of exactly as many grey values as it holds. A function, since a closure may be left outside the processor's features.
#[inline(always)]
pub(super) fn vector<S: Simd, P: Lanes>(simd: S, pixels: &[P]) -> P::V<S> {
    P::V::<S>::from_slice(simd, pixels)
}

/// One grey value in all lanes.
#[inline(always)]
pub(super) fn splat<S: Simd, P: Lanes>(simd: S, value: P) -> P::V<S> {
    P::V::<S>::splat(simd, value)
}

impl Lanes for u8 {
    const N: usize = 64;
    type V<S: Simd> = u8x64<S>;
    type Key<S: Simd> = u16x32<S>;
    type Wide = u16;
    const ZERO: Self = 0;
    const MAX: Self = Self::MAX;
    fn from_dn(dn: f32) -> Self {
        dn as Self
    }
    fn from_index(index: u8) -> Self {
        index
    }
    fn index(self) -> u32 {
        u32::from(self)
    }
    #[inline(always)]
    fn keys<S: Simd>(values: Self::V<S>, numbers: Self::V<S>) -> (Self::Key<S>, Self::Key<S>) {
        // The first byte of two is the lower one on every processor there are vectors for.
        let (low, high) = numbers.interleave(values);
        (low.bitcast(), high.bitcast())
    }
    #[inline(always)]
    fn floats<S: Simd>(simd: S, values: &[Self; CHUNK]) -> f32x16<S> {
        let (low, high) = u8x16::simd_from(simd, *values).widen();
        let (low, high) = low.combine(high).widen();
        let wide: i32x16<S> = low.combine(high).bitcast();
        wide.to_float()
    }
    fn buffers(all: &mut AllBuffers) -> &mut Buffers<Self> {
        &mut all.bytes
    }
}

impl Lanes for u16 {
    const N: usize = 32;
    type V<S: Simd> = u16x32<S>;
    type Key<S: Simd> = u32x16<S>;
    type Wide = u32;
    const ZERO: Self = 0;
    const MAX: Self = Self::MAX;
    fn from_dn(dn: f32) -> Self {
        dn as Self
    }
    fn from_index(index: u8) -> Self {
        Self::from(index)
    }
    fn index(self) -> u32 {
        u32::from(self)
    }
    #[inline(always)]
    fn keys<S: Simd>(values: Self::V<S>, numbers: Self::V<S>) -> (Self::Key<S>, Self::Key<S>) {
        // The first byte of two is the lower one on every processor there are vectors for.
        let (low, high) = numbers.interleave(values);
        (low.bitcast(), high.bitcast())
    }
    #[inline(always)]
    fn floats<S: Simd>(simd: S, values: &[Self; CHUNK]) -> f32x16<S> {
        let (low, high) = u16x16::simd_from(simd, *values).widen();
        let wide: i32x16<S> = low.combine(high).bitcast();
        wide.to_float()
    }
    fn buffers(all: &mut AllBuffers) -> &mut Buffers<Self> {
        &mut all.words
    }
}
