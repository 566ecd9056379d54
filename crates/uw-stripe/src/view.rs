//! Borrowed images: a strided view over 8- or 16-bit pixels, a region of it, and the scanning direction.

use crate::StripeError;

mod sealed {
    use super::View;
    use crate::engine::lanes::Lanes;
    use crate::{Extractor, NoiseModel, StripeError};

    /// The generic work under concrete names, so that it is compiled once, here, and not again in every crate that calls it.
    pub trait Sealed: Lanes {
        fn extract(
            extractor: &mut Extractor,
            image: View<'_, Self>,
            background: Option<View<'_, Self>>,
        ) -> Result<(), StripeError>;
        fn extract_all(
            extractor: &mut Extractor,
            image: View<'_, Self>,
            background: Option<View<'_, Self>>,
        ) -> Result<(), StripeError>;
        fn learn(extractor: &mut Extractor, image: View<'_, Self>) -> Result<bool, StripeError>;
        fn estimate_noise(
            extractor: &mut Extractor,
            images: &mut dyn Iterator<Item = View<'_, Self>>,
        ) -> Result<NoiseModel, StripeError>;
        fn brightest(image: &View<'_, Self>) -> f32;
    }

    macro_rules! concrete {
        ($pixel:ty) => {
            impl Sealed for $pixel {
                fn extract(
                    extractor: &mut Extractor,
                    image: View<'_, Self>,
                    background: Option<View<'_, Self>>,
                ) -> Result<(), StripeError> {
                    extractor.extract_pixels(image, background)
                }
                fn extract_all(
                    extractor: &mut Extractor,
                    image: View<'_, Self>,
                    background: Option<View<'_, Self>>,
                ) -> Result<(), StripeError> {
                    extractor.extract_all_pixels(image, background)
                }
                fn learn(extractor: &mut Extractor, image: View<'_, Self>) -> Result<bool, StripeError> {
                    extractor.learn_pixels(image)
                }
                fn estimate_noise(
                    extractor: &mut Extractor,
                    images: &mut dyn Iterator<Item = View<'_, Self>>,
                ) -> Result<NoiseModel, StripeError> {
                    extractor.estimate_noise_pixels(images)
                }
                fn brightest(image: &View<'_, Self>) -> f32 {
                    crate::engine::brightest_pixel(image)
                }
            }
        };
    }
    concrete!(u8);
    concrete!(u16);
}

/// A grey value as cameras deliver it: `u8`, or `u16` (right-justified where fewer bits are significant).
pub trait Pixel: Copy + Send + Sync + sealed::Sealed + 'static {
    /// Largest value the type holds, DN.
    const MAX_DN: f32;
    /// The grey value, DN, exact.
    fn dn(self) -> f32;
}

impl Pixel for u8 {
    const MAX_DN: f32 = 255.0;
    fn dn(self) -> f32 {
        f32::from(self)
    }
}

impl Pixel for u16 {
    const MAX_DN: f32 = 65535.0;
    fn dn(self) -> f32 {
        f32::from(self)
    }
}

/// A borrowed image: row `y` starts at `y * stride` of the slice. Pixel (0, 0) is the centre of the top-left pixel.
#[derive(Debug, Clone, Copy)]
pub struct View<'a, P> {
    data: &'a [P],
    width: usize,
    height: usize,
    stride: usize,
}

impl<'a, P: Pixel> View<'a, P> {
    /// A view of `width` × `height` pixels whose rows are `stride` pixels apart.
    ///
    /// # Errors
    /// [`StripeError`] when there are no pixels, the stride is shorter than a row, or the slice too short.
    pub fn new(data: &'a [P], width: usize, height: usize, stride: usize) -> Result<Self, StripeError> {
        if width == 0 || height == 0 {
            return Err(StripeError::EmptyImage { width, height });
        }
        if stride < width {
            return Err(StripeError::StrideTooShort { width, stride });
        }
        let needed = stride.saturating_mul(height - 1).saturating_add(width);
        if data.len() < needed {
            return Err(StripeError::SliceTooShort { needed, got: data.len() });
        }
        Ok(Self { data, width, height, stride })
    }

    /// A view of an image whose rows follow each other without gaps.
    ///
    /// # Errors
    /// As [`View::new`].
    pub fn packed(data: &'a [P], width: usize, height: usize) -> Result<Self, StripeError> {
        Self::new(data, width, height, width)
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Row `y`, `width` pixels; empty beyond the last row.
    pub fn row(&self, y: usize) -> &'a [P] {
        if y < self.height { &self.data[y * self.stride..y * self.stride + self.width] } else { &[] }
    }

    /// The pixels from (x, y) on, and how many apart rows are; empty beyond the image.
    pub(crate) fn starting_at(&self, x: usize, y: usize) -> (&'a [P], usize) {
        (self.data.get(y * self.stride + x..).unwrap_or(&[]), self.stride)
    }

    /// The whole image as a region.
    pub fn bounds(&self) -> Roi {
        Roi { x: 0, y: 0, width: self.width, height: self.height }
    }
}

/// A rectangle of pixels: columns `x .. x + width`, rows `y .. y + height`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Roi {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Roi {
    pub(crate) fn check(self, width: usize, height: usize) -> Result<Self, StripeError> {
        let fits = |start: usize, size: usize, limit: usize| {
            size > 0 && start.checked_add(size).is_some_and(|end| end <= limit)
        };
        if fits(self.x, self.width, width) && fits(self.y, self.height, height) {
            Ok(self)
        } else {
            Err(StripeError::RoiOutside { roi: self, width, height })
        }
    }
}

/// Along which lines of pixels the stripe is looked for: one measurement a line, its position along the line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Axis {
    /// One measurement a row, for a stripe that runs down the image: line = v, position = u.
    #[default]
    PerRow,
    /// One measurement a column, for a stripe that runs across the image: line = u, position = v.
    PerColumn,
}

impl Axis {
    /// Image coordinates (u, v), px, of a position on a line.
    pub fn uv(self, line: usize, position_px: f64) -> [f64; 2] {
        match self {
            Self::PerRow => [position_px, line as f64],
            Self::PerColumn => [line as f64, position_px],
        }
    }

    /// Number of lines in an image of the given size.
    pub fn lines(self, width: usize, height: usize) -> usize {
        match self {
            Self::PerRow => height,
            Self::PerColumn => width,
        }
    }
}
