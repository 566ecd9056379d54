//! One image as a camera delivered it.

use std::sync::Arc;

/// Grey values, 8 bits or 16 of which [`Frame::significant_bits`] count (right-justified). A clone shares them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pixels {
    /// One byte a pixel.
    U8(Arc<Vec<u8>>),
    /// Two bytes a pixel, in the machine's order.
    U16(Arc<Vec<u16>>),
}

impl Pixels {
    /// How many values there are, padding of rows included.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U16(values) => values.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bits that a value has room for.
    pub fn depth(&self) -> u8 {
        match self {
            Self::U8(_) => 8,
            Self::U16(_) => 16,
        }
    }
}

impl From<Vec<u8>> for Pixels {
    fn from(values: Vec<u8>) -> Self {
        Self::U8(Arc::new(values))
    }
}

impl From<Vec<u16>> for Pixels {
    fn from(values: Vec<u16>) -> Self {
        Self::U16(Arc::new(values))
    }
}

/// When a frame was exposed and when it came, on the instrument's [`Timeline`](crate::Timeline).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exposure {
    /// Start of the exposure, nanoseconds since the Unix epoch.
    pub stamp_ns: i64,
    /// How long the exposure was, nanoseconds.
    pub exposure_ns: u64,
    /// When the frame had come whole, nanoseconds since the Unix epoch.
    pub received_ns: i64,
}

impl Exposure {
    /// The middle of the exposure, nanoseconds since the Unix epoch: where the mirror was then is where the stripe is.
    pub fn middle_ns(&self) -> i64 {
        self.stamp_ns.saturating_add(i64::try_from(self.exposure_ns / 2).unwrap_or(i64::MAX))
    }
}

/// How the values of a frame lie in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Values from the start of a row to the start of the next.
    pub stride: usize,
    /// Bits of a value that count, right-justified: 12 means 0 to 4095.
    pub significant_bits: u8,
}

impl Layout {
    /// Rows that follow each other without gaps.
    pub fn packed(width: u32, height: u32, significant_bits: u8) -> Self {
        Self { width, height, stride: width as usize, significant_bits }
    }
}

/// Values that don't make an image.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LayoutError {
    /// There are no pixels.
    #[error("an image of {width} x {height} pixels has none")]
    Empty {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Rows overlap.
    #[error("rows of {width} pixels don't fit in a stride of {stride}")]
    Stride {
        /// Columns.
        width: u32,
        /// Values from row to row.
        stride: usize,
    },
    /// There are fewer values than pixels.
    #[error("{got} values came, {needed} are needed")]
    TooFew {
        /// Values that the layout needs.
        needed: usize,
        /// Values that there are.
        got: usize,
    },
    /// More bits count than a value has, or none.
    #[error("{significant_bits} bits cannot count of values of {depth} bits")]
    Bits {
        /// Bits said to count.
        significant_bits: u8,
        /// Bits that there are.
        depth: u8,
    },
}

/// One image as a camera delivered it. Pixel (0, 0) is the centre of the top-left pixel. Cheap to clone: pixels are shared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    pixels: Pixels,
    layout: Layout,
    id: u64,
    exposure: Exposure,
}

impl Frame {
    /// A frame whose values fit its layout.
    ///
    /// # Errors
    /// [`LayoutError`] where they don't.
    pub fn new(
        pixels: impl Into<Pixels>,
        layout: Layout,
        id: u64,
        exposure: Exposure,
    ) -> Result<Self, LayoutError> {
        let pixels = pixels.into();
        let Layout { width, height, stride, significant_bits } = layout;
        if width == 0 || height == 0 {
            return Err(LayoutError::Empty { width, height });
        }
        if stride < width as usize {
            return Err(LayoutError::Stride { width, stride });
        }
        let needed = stride.saturating_mul(height as usize - 1).saturating_add(width as usize);
        if pixels.len() < needed {
            return Err(LayoutError::TooFew { needed, got: pixels.len() });
        }
        let depth = pixels.depth();
        if !(1..=depth).contains(&significant_bits) {
            return Err(LayoutError::Bits { significant_bits, depth });
        }
        Ok(Self { pixels, layout, id, exposure })
    }

    /// The grey values, row by row, rows [`Frame::stride`] apart.
    pub fn pixels(&self) -> &Pixels {
        &self.pixels
    }

    /// Gives the grey values back, to be used again where nobody else holds them.
    pub fn into_pixels(self) -> Pixels {
        self.pixels
    }

    /// Columns.
    pub fn width(&self) -> u32 {
        self.layout.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.layout.height
    }

    /// Values from the start of a row to the start of the next.
    pub fn stride(&self) -> usize {
        self.layout.stride
    }

    /// Bits of a value that count, right-justified: 12 means 0 to 4095.
    pub fn significant_bits(&self) -> u8 {
        self.layout.significant_bits
    }

    /// How the values lie.
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// The frame's number, from 0 at arming, one more a frame that was exposed, whether or not it came; never rolls over.
    pub fn id(&self) -> u64 {
        self.id
    }

    /// When it was exposed and when it came.
    pub fn exposure(&self) -> Exposure {
        self.exposure
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHEN: Exposure = Exposure { stamp_ns: 1_000, exposure_ns: 501, received_ns: 2_000 };

    #[test]
    fn values_that_make_no_image_are_refused() {
        let of = |layout| Frame::new(vec![0_u8; 12], layout, 0, WHEN).map(|f| f.layout());
        let good = Layout { width: 3, height: 3, stride: 4, significant_bits: 8 };
        assert_eq!(of(good), Ok(good));
        assert_eq!(of(Layout { height: 0, ..good }), Err(LayoutError::Empty { width: 3, height: 0 }));
        assert_eq!(of(Layout { stride: 2, ..good }), Err(LayoutError::Stride { width: 3, stride: 2 }));
        assert_eq!(of(Layout { height: 4, ..good }), Err(LayoutError::TooFew { needed: 15, got: 12 }));
        let bits = LayoutError::Bits { significant_bits: 9, depth: 8 };
        assert_eq!(of(Layout { significant_bits: 9, ..good }), Err(bits));
        let huge = Layout { height: u32::MAX, stride: usize::MAX, ..good };
        assert_eq!(of(huge), Err(LayoutError::TooFew { needed: usize::MAX, got: 12 }));
    }

    #[test]
    fn a_clone_shares_the_pixels_and_the_middle_is_the_exposures() {
        let frame = Frame::new(vec![7_u16; 6], Layout::packed(3, 2, 12), 5, WHEN).unwrap();
        let (Pixels::U16(a), Pixels::U16(b)) = (frame.pixels().clone(), frame.clone().into_pixels()) else {
            panic!("16-bit pixels stay that");
        };
        assert!(Arc::ptr_eq(&a, &b));
        assert_eq!(frame.exposure().middle_ns(), 1_250);
    }
}
