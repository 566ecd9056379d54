//! Grey values in vector registers: one type of pixel, 64 bytes at a time whatever the processor's own width, so that results do
//! not depend on it.

use super::{AllBuffers, Buffers};
use fearless_simd::{Simd, SimdBase, u8x64, u16x32};

/// Largest [`Lanes::N`].
pub(crate) const MOST_LANES: usize = 64;

/// A pixel type with its vector.
pub trait Lanes: Copy + Default + Ord + Send + Sync + std::ops::Sub<Output = Self> + 'static {
    /// Pixels a vector.
    const N: usize;
    /// The vector.
    type V<S: Simd>: SimdBase<S, Element = Self>;
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
    /// The buffers of this type.
    fn buffers(all: &mut AllBuffers) -> &mut Buffers<Self>;
}

impl Lanes for u8 {
    const N: usize = 64;
    type V<S: Simd> = u8x64<S>;
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
    fn buffers(all: &mut AllBuffers) -> &mut Buffers<Self> {
        &mut all.bytes
    }
}

impl Lanes for u16 {
    const N: usize = 32;
    type V<S: Simd> = u16x32<S>;
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
    fn buffers(all: &mut AllBuffers) -> &mut Buffers<Self> {
        &mut all.words
    }
}
