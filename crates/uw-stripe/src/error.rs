//! What makes a call to the extractor useless (a rejected measurement is data, not an error).

/// Why an image or a setting could not be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StripeError {
    /// An image without pixels.
    #[error("an image needs at least one pixel, got {width} x {height}")]
    EmptyImage {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A stride shorter than a row.
    #[error("a row of {width} pixels needs a stride of at least that many, got {stride}")]
    StrideTooShort {
        /// Columns.
        width: usize,
        /// Pixels from the start of one row to the start of the next.
        stride: usize,
    },
    /// A slice too short for the size that was given with it.
    #[error("the image needs {needed} pixels, the slice holds {got}")]
    SliceTooShort {
        /// Pixels that size and stride ask for.
        needed: usize,
        /// Pixels in the slice.
        got: usize,
    },
    /// A background of another size than the image.
    #[error(
        "the background must be as large as the image, {needed_width} x {needed_height}, \
         got {got_width} x {got_height}"
    )]
    BackgroundSize {
        /// Columns of the image.
        needed_width: usize,
        /// Rows of the image.
        needed_height: usize,
        /// Columns of the background.
        got_width: usize,
        /// Rows of the background.
        got_height: usize,
    },
    /// A region of interest that has no pixels or leaves the image.
    #[error("the region of interest {roi:?} does not lie inside the image of {width} x {height} pixels")]
    RoiOutside {
        /// The region asked for.
        roi: crate::Roi,
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
    },
    /// A setting outside its range.
    #[error("{name} must be {needed}, got {got}")]
    InvalidOption {
        /// The setting's name.
        name: &'static str,
        /// What is allowed.
        needed: &'static str,
        /// What was given.
        got: f64,
    },
    /// Too few usable measurements to estimate the noise.
    #[error("the noise needs at least {needed} stripe measurements, the images hold {got}")]
    TooFewForNoise {
        /// Least number of measurements.
        needed: usize,
        /// Measurements found.
        got: usize,
    },
}
