//! Sub-pixel laser stripe extraction with predicted uncertainty.
//!
//! An [`Extractor`] takes a [`View`] of an 8- or 16-bit image and gives a [`Stripe`]: along every row (or column) the
//! centre of the laser stripe, its standard deviation, height, width and background, with [`Flags`] that inform and a
//! [`Reject`] reason wherever there is no position.
//!
//! | step | module | decides |
//! |---|---|---|
//! | lines | `lines` | rows or columns, background subtracted, which pixels are clipped |
//! | noise | `noise` | variance of a grey value: given, or read off the image |
//! | candidates | `peak` | box Laplacian of Gaussian at several widths, threshold from the noise |
//! | track | `track` | which candidate continues its neighbours' |
//! | refinement | `mle` | maximum likelihood of a pixel-integrated Gaussian on a linear background |
//! | verdict | `extractor` | flags and rejects |
//!
//! Pixel (0, 0) is the centre of the top-left pixel. Grey values are in DN, positions, widths and sigmas in pixels.

mod bend;
mod error;
mod extractor;
mod lines;
mod mle;
mod noise;
mod peak;
#[allow(dead_code, reason = "the extractor is about to call it")]
mod pool;
mod profile;
#[allow(dead_code, reason = "the extractor is about to call it")]
mod ridge;
mod special;
mod track;
mod view;

pub use error::StripeError;
pub use extractor::{Extractor, Options};
pub use noise::NoiseModel;
pub use profile::{Flags, Measurement, Reject, Stripe};
pub use view::{Axis, Pixel, Roi, View};
