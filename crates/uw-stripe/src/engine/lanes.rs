//! Grey values in vector registers: one type of pixel, 64 bytes at a time whatever the processor's own width, so that results do
//! not depend on it.

use super::{AllBuffers, Buffers};
use fearless_simd::{
    Bytes, Simd, SimdBase, SimdCombine, SimdInt, SimdIntElement, SimdWiden, f32x16, i16x32, i32x16, u8x16,
    u8x32, u8x64, u16x16, u16x32, u32x16,
};

/// Largest [`Lanes::N`].
pub(crate) const MOST_LANES: usize = 64;

/// Longest span of which places are numbered by a byte.
pub(crate) const NUMBERED: usize = 256;

/// Lines that are measured at a time: 32-bit lanes of a vector.
pub(crate) const CHUNK: usize = 16;

/// Most vectors of a square matrix of as many rows.
pub(crate) const SQUARE: usize = 8;

/// A pixel type with its vector.
pub trait Lanes: SimdIntElement + Default + Ord + Send + Sync + std::ops::Sub<Output = Self> {
    /// Pixels a vector.
    const N: usize;
    /// The vector.
    type V<S: Simd>: SimdBase<S, Element = Self> + SimdInt<S>;
    /// As wide a vector of lanes twice as wide, each with a grey value above a number: the largest tells where the largest value is.
    type Keys<S: Simd>: SimdBase<S, Element = Self::Wide> + SimdInt<S>;
    /// A lane of it.
    type Wide: SimdIntElement + Copy + Default + Ord;
    /// What is taken from grey values so that 16 bits hold them with a sign, DN.
    const BIAS: f32;
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
    /// As many pixels of one row, then of another, as half a vector holds.
    fn join<S: Simd>(simd: S, first: &[Self], second: &[Self]) -> Self::V<S>;
    /// What [`Self::keys`] takes for a vector of which each `period` pixels begin at this place of a row: numbers that fall from 255 on, of the even
    /// places and the odd. The period is a vector or half of one.
    fn numbers<S: Simd>(simd: S, from: u8, period: usize) -> [Self::Keys<S>; 2];
    /// Grey values above their places' numbers, the larger ones of each even place and the odd one after it.
    fn keys<S: Simd>(simd: S, values: Self::V<S>, numbers: [Self::Keys<S>; 2]) -> Self::Keys<S>;
    /// The larger of neighbours among four bytes' keys, of one vector and then of another.
    fn larger<S: Simd>(simd: S, first: Self::Keys<S>, second: Self::Keys<S>) -> Self::Keys<S>;
    /// The places that the largest keys of each four bytes tell.
    fn places<S: Simd>(simd: S, keys: Self::Keys<S>) -> u32x16<S>;
    /// The vectors of a square matrix of so many rows and pixels, of two bytes a pixel at most; the first ones where they are fewer. Pixels that follow
    /// each other by four bytes stay together when rows become columns.
    fn square<S: Simd>(simd: S, rows: &[&[Self; CHUNK]; CHUNK]) -> [u32x16<S>; SQUARE];
    /// Pairs of pixels of as many lines as [`CHUNK`], from each of which [`Self::BIAS`] is taken, of what follows by four bytes; of two bytes a pixel the first only.
    fn pairs<S: Simd>(simd: S, units: u32x16<S>) -> [i16x32<S>; 2];
    /// The same from a pixel of each line and another.
    fn pair<S: Simd>(simd: S, first: &[Self; CHUNK], second: &[Self; CHUNK]) -> i16x32<S>;
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

/// As many numbers as [`CHUNK`] from one on.
#[inline(always)]
pub(crate) fn part<S: Simd>(simd: S, values: &[f32], from: usize) -> f32x16<S> {
    f32x16::from_slice(simd, &values[from..][..CHUNK])
}

/// One grey value in all lanes.
#[inline(always)]
pub(super) fn splat<S: Simd, P: Lanes>(simd: S, value: P) -> P::V<S> {
    P::V::<S>::splat(simd, value)
}

/// 255, 254, …, from there on again after so many: of equal values the first has the largest key. Those of the even places, and of the odd.
const fn numbers(period: usize) -> [[u16; 32]; 2] {
    let mut numbers = [[0; 32]; 2];
    let mut i = 0;
    while i < 64 {
        numbers[i % 2][i / 2] = (NUMBERED - 1 - i % period) as u16;
        i += 1;
    }
    numbers
}

/// The same for wider lanes.
const fn wide_numbers(period: usize) -> [[u32; 16]; 2] {
    let mut numbers = [[0; 16]; 2];
    let mut i = 0;
    while i < 32 {
        numbers[i % 2][i / 2] = (NUMBERED - 1 - i % period) as u32;
        i += 1;
    }
    numbers
}

/// Bytes as numbers.
#[inline(always)]
fn widened_bytes<S: Simd>(simd: S, values: &[u8; CHUNK]) -> u32x16<S> {
    let (low, high) = u8x16::load_array_ref(simd, values).widen();
    let (low, high) = low.combine(high).widen();
    low.combine(high)
}

/// Words as numbers.
#[inline(always)]
fn widened_words<S: Simd>(simd: S, values: &[u16; CHUNK]) -> u32x16<S> {
    let (low, high) = u16x16::load_array_ref(simd, values).widen();
    low.combine(high)
}

impl Lanes for u8 {
    const N: usize = 64;
    type V<S: Simd> = u8x64<S>;
    type Keys<S: Simd> = u16x32<S>;
    type Wide = u16;
    const BIAS: f32 = 0.0;
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
    fn join<S: Simd>(simd: S, first: &[u8], second: &[u8]) -> u8x64<S> {
        u8x32::from_slice(simd, &first[..32]).combine(u8x32::from_slice(simd, &second[..32]))
    }
    #[inline(always)]
    fn numbers<S: Simd>(simd: S, from: u8, period: usize) -> [u16x32<S>; 2] {
        const NUMBERS: [[[u16; 32]; 2]; 2] = [numbers(32), numbers(64)];
        let from = u16x32::splat(simd, u16::from(from));
        let [even, odd] = &NUMBERS[usize::from(period == Self::N)];
        [u16x32::load_array_ref(simd, even) - from, u16x32::load_array_ref(simd, odd) - from]
    }
    #[inline(always)]
    fn keys<S: Simd>(simd: S, values: u8x64<S>, [even, odd]: [u16x32<S>; 2]) -> u16x32<S> {
        // The first byte of two is the lower one on every processor there are vectors for.
        let pairs: u16x32<S> = values.bitcast();
        ((pairs << 8) | even).max((pairs & u16x32::splat(simd, 0xff00)) | odd)
    }
    #[inline(always)]
    fn larger<S: Simd>(_: S, first: u16x32<S>, second: u16x32<S>) -> u16x32<S> {
        let (first, second): (u32x16<S>, u32x16<S>) = (first.bitcast(), second.bitcast());
        let (even, odd) = first.deinterleave(second);
        let (even, odd): (u16x32<S>, u16x32<S>) = (even.bitcast(), odd.bitcast());
        even.max(odd)
    }
    #[inline(always)]
    fn places<S: Simd>(simd: S, keys: u16x32<S>) -> u32x16<S> {
        let pairs: u32x16<S> = keys.bitcast();
        let upper = pairs >> 16;
        u32x16::splat(simd, NUMBERED as u32 - 1)
            - (upper.max(pairs & u32x16::splat(simd, 0xffff)) & u32x16::splat(simd, NUMBERED as u32 - 1))
    }
    #[inline(always)]
    fn square<S: Simd>(simd: S, rows: &[&[u8; CHUNK]; CHUNK]) -> [u32x16<S>; SQUARE] {
        // Those that will be a pair lie apart, so that to mask the others is all it takes.
        const APART: [u8; 16] = [0, 2, 1, 3, 4, 6, 5, 7, 8, 10, 9, 11, 12, 14, 13, 15];
        let apart = u8x16::load_array_ref(simd, &APART);
        let apart = apart.combine(apart);
        let apart = apart.combine(apart);
        let mut vectors = [u32x16::splat(simd, 0); SQUARE];
        for (vector, rows) in vectors.iter_mut().zip(rows.as_chunks::<4>().0) {
            let [a, b, c, d] = rows.map(|row| u8x16::load_array_ref(simd, row));
            *vector = a.combine(b).combine(c.combine(d)).swizzle_dyn_within_blocks(apart).bitcast();
        }
        vectors
    }
    #[inline(always)]
    fn pairs<S: Simd>(simd: S, units: u32x16<S>) -> [i16x32<S>; 2] {
        let byte = u32x16::splat(simd, 0x00ff_00ff);
        [(units & byte).bitcast(), ((units >> 8) & byte).bitcast()]
    }
    #[inline(always)]
    fn pair<S: Simd>(simd: S, first: &[u8; CHUNK], second: &[u8; CHUNK]) -> i16x32<S> {
        (widened_bytes(simd, first) | (widened_bytes(simd, second) << 16)).bitcast()
    }
    #[inline(always)]
    fn floats<S: Simd>(simd: S, values: &[Self; CHUNK]) -> f32x16<S> {
        let wide: i32x16<S> = widened_bytes(simd, values).bitcast();
        wide.to_float()
    }
    fn buffers(all: &mut AllBuffers) -> &mut Buffers<Self> {
        &mut all.bytes
    }
}

impl Lanes for u16 {
    const N: usize = 32;
    type V<S: Simd> = u16x32<S>;
    type Keys<S: Simd> = u32x16<S>;
    type Wide = u32;
    const BIAS: f32 = 32768.0;
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
    fn join<S: Simd>(simd: S, first: &[u16], second: &[u16]) -> u16x32<S> {
        u16x16::from_slice(simd, &first[..16]).combine(u16x16::from_slice(simd, &second[..16]))
    }
    #[inline(always)]
    fn numbers<S: Simd>(simd: S, from: u8, period: usize) -> [u32x16<S>; 2] {
        const NUMBERS: [[[u32; 16]; 2]; 2] = [wide_numbers(16), wide_numbers(32)];
        let from = u32x16::splat(simd, u32::from(from));
        let [even, odd] = &NUMBERS[usize::from(period == Self::N)];
        [u32x16::load_array_ref(simd, even) - from, u32x16::load_array_ref(simd, odd) - from]
    }
    #[inline(always)]
    fn keys<S: Simd>(simd: S, values: u16x32<S>, [even, odd]: [u32x16<S>; 2]) -> u32x16<S> {
        // As for bytes.
        let pairs: u32x16<S> = values.bitcast();
        ((pairs << 16) | even).max((pairs & u32x16::splat(simd, 0xffff_0000)) | odd)
    }
    #[inline(always)]
    fn larger<S: Simd>(_: S, first: u32x16<S>, second: u32x16<S>) -> u32x16<S> {
        let (even, odd) = first.deinterleave(second);
        even.max(odd)
    }
    #[inline(always)]
    fn places<S: Simd>(simd: S, keys: u32x16<S>) -> u32x16<S> {
        u32x16::splat(simd, NUMBERED as u32 - 1) - (keys & u32x16::splat(simd, NUMBERED as u32 - 1))
    }
    #[inline(always)]
    fn square<S: Simd>(simd: S, rows: &[&[u16; CHUNK]; CHUNK]) -> [u32x16<S>; SQUARE] {
        let mut vectors = [u32x16::splat(simd, 0); SQUARE];
        for (vector, [a, b]) in vectors.iter_mut().zip(rows.as_chunks::<2>().0) {
            *vector = u16x16::load_array_ref(simd, a).combine(u16x16::load_array_ref(simd, b)).bitcast();
        }
        vectors
    }
    #[inline(always)]
    fn pairs<S: Simd>(simd: S, units: u32x16<S>) -> [i16x32<S>; 2] {
        let pair: i16x32<S> = (units ^ u32x16::splat(simd, 0x8000_8000)).bitcast();
        [pair; 2]
    }
    #[inline(always)]
    fn pair<S: Simd>(simd: S, first: &[u16; CHUNK], second: &[u16; CHUNK]) -> i16x32<S> {
        Self::pairs(simd, widened_words(simd, first) | (widened_words(simd, second) << 16))[0]
    }
    #[inline(always)]
    fn floats<S: Simd>(simd: S, values: &[Self; CHUNK]) -> f32x16<S> {
        let wide: i32x16<S> = widened_words(simd, values).bitcast();
        wide.to_float()
    }
    fn buffers(all: &mut AllBuffers) -> &mut Buffers<Self> {
        &mut all.words
    }
}
