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
    /// An exposure with too few frames to tell noise from what is fixed.
    #[error(
        "an exposure needs at least {needed} frames, so that noise is told from what is fixed; got {got}"
    )]
    TooFewFrames {
        /// Least number of frames.
        needed: usize,
        /// Frames given.
        got: usize,
    },
    /// Frames of one exposure that differ in size.
    #[error(
        "the frames of an exposure must be of one size, {needed_width} x {needed_height}, \
         got {got_width} x {got_height}"
    )]
    FrameSize {
        /// Columns of the first.
        needed_width: usize,
        /// Rows of the first.
        needed_height: usize,
        /// Columns of another.
        got_width: usize,
        /// Rows of another.
        got_height: usize,
    },
    /// Frames whose levels are too few, or too alike, to tell the gain.
    #[error(
        "{levels} usable levels of light do not tell the gain (its sigma would be {relative_sigma:.2} of it); \
         give frames from the dark to near full scale, not clipped"
    )]
    TooFewLevels {
        /// Levels that were not clipped and had pixels enough.
        levels: usize,
        /// Standard deviation of the gain by the gain.
        relative_sigma: f64,
    },
    /// Noise that vanishes above grey value 0.
    #[error(
        "the noise vanishes at {level_dn:.0} DN, above 0: take the camera's black level off the frames first"
    )]
    BlackLevel {
        /// Where the line of variance over level meets zero, DN.
        level_dn: f64,
    },
}
