//! A borrowed grey image, as the corner detector takes it.

/// Pixels of an image, 8 bits or up to 16.
#[derive(Debug, Clone, Copy)]
pub enum Samples<'a> {
    /// 8 bits a pixel.
    U8(&'a [u8]),
    /// Up to 16 bits a pixel, right-justified.
    U16(&'a [u16]),
}

impl Samples<'_> {
    fn len(self) -> usize {
        match self {
            Self::U8(data) => data.len(),
            Self::U16(data) => data.len(),
        }
    }
}

/// A grey image by rows; pixel (0, 0) is the centre of the top-left pixel, u right, v down.
#[derive(Debug, Clone, Copy)]
pub struct GreyView<'a> {
    samples: Samples<'a>,
    width: usize,
    height: usize,
    stride: usize,
    saturation: u16,
}

/// Size of an image and the distance from one row's start to the next, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Samples from one row's start to the next; at least `width`.
    pub stride: usize,
}

/// Why a slice is no image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "an image of {width} x {height} pixels, {stride} apart a row, needs {needed} samples and a stride of at least its width; got {got} samples"
)]
pub struct ViewError {
    /// Pixels a row, as given.
    pub width: usize,
    /// Rows, as given.
    pub height: usize,
    /// Distance of rows, as given.
    pub stride: usize,
    /// Samples that this takes.
    pub needed: usize,
    /// Samples there are.
    pub got: usize,
}

impl<'a> GreyView<'a> {
    /// Returns a view of `samples`; `saturation` is the largest value the camera can give (255 for 8 bits,
    /// 4095 for 12), at which a pixel only says "at least this".
    ///
    /// # Errors
    /// [`ViewError`] when the slice does not hold the image. An image without pixels is one.
    pub fn new(samples: Samples<'a>, layout: Layout, saturation: u16) -> Result<Self, ViewError> {
        let Layout { width, height, stride } = layout;
        let needed = height.saturating_sub(1).saturating_mul(stride).saturating_add(width);
        let needed = if height == 0 { 0 } else { needed };
        if stride < width || samples.len() < needed {
            return Err(ViewError { width, height, stride, needed, got: samples.len() });
        }
        Ok(Self { samples, width, height, stride, saturation })
    }

    /// Returns the pixels a row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the number of rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Returns the value at which a pixel is saturated.
    #[must_use]
    pub fn saturation(&self) -> u16 {
        self.saturation
    }

    /// Returns the value of a pixel, or `None` outside the image.
    #[must_use]
    pub fn get(&self, col: usize, row: usize) -> Option<u16> {
        if col >= self.width || row >= self.height {
            return None;
        }
        let at = row * self.stride + col;
        match self.samples {
            Samples::U8(data) => data.get(at).copied().map(u16::from),
            Samples::U16(data) => data.get(at).copied(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_start_a_stride_apart_and_short_slices_are_refused() {
        let data: Vec<u16> = (0..11).collect();
        let layout = Layout { width: 3, height: 2, stride: 8 };
        let view = GreyView::new(Samples::U16(&data), layout, 4095).unwrap();
        assert_eq!((view.get(2, 1), view.get(3, 0), view.get(0, 2)), (Some(10), None, None));
        let short = GreyView::new(Samples::U16(&data[..10]), layout, 4095).unwrap_err();
        assert_eq!((short.needed, short.got), (11, 10));
        assert!(GreyView::new(Samples::U8(&[0; 9]), Layout { width: 3, height: 2, stride: 2 }, 255).is_err());
        let huge = Layout { width: usize::MAX, height: usize::MAX, stride: usize::MAX };
        assert!(GreyView::new(Samples::U8(&[]), huge, 255).is_err());
        assert!(GreyView::new(Samples::U8(&[]), Layout { width: 0, height: 0, stride: 0 }, 255).is_ok());
    }
}
