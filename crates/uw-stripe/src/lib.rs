//! Sub-pixel laser stripe extraction with predicted uncertainty.
//!
//! An [`Extractor`] takes a [`View`] of an 8- or 16-bit image and gives a [`Stripe`]: along every row (or column) the
//! centre of the laser stripe, its standard deviation, height, width and background, with [`Flags`] that inform and a
//! [`Reject`] reason wherever there is no position.
//!
//! [`Method`] says how; RMS errors over the Cramér–Rao bound of a single line, on the scenes of `examples/accuracy.rs`:
//!
//! | method | for | clean | low signal | steep | haze | wrong among glints |
//! |---|---|---|---|---|---|---|
//! | `Fast` | kHz cameras, weak computers, clear water | 0.99 | 1.01 | 0.99 | 4.6 | 24 % |
//! | `Robust` | nearly everything | 0.99 | 1.01 | 0.99 | 0.98 | 0 |
//! | `Precise` | unknown noise, images that have nothing in common | 1.00 | 1.04 | 1.01 | 1.00 | 0 |
//! | `Ridge` | steep stripes and low signal, pooled along the stripe | 0.52 | 0.47 | 0.64 | 0.51 | 0 |
//!
//! `Fast` and `Robust` are vector kernels on the image as it lies in memory (`engine`, which see); with `Precise`, to which `Robust` hands
//! the lines that its filters do not suit, the steps are these:
//!
//! | step | module | decides |
//! |---|---|---|
//! | lines | `lines`, `lone` | rows or columns, background subtracted, which pixels are clipped, which stand alone |
//! | noise | `noise`, `flats` | variance of a grey value: given, read off the image, or off dark and flat frames |
//! | candidates | `peak` | box Laplacian of Gaussian at several widths, threshold from the noise |
//! | track | `track` | which candidate continues its neighbours' |
//! | ranks | `ranks` | which candidates are one stripe, where several are asked for |
//! | refinement | `mle` | maximum likelihood of a pixel-integrated Gaussian on a smooth background |
//! | neighbours | `edges`, `scatter` | albedo edges, speckle, ends: what only the lines together show |
//! | verdict | `precise`, `verdict` | flags and rejects |
//! | bends | `bend` | what blur moves along a bent stripe |
//!
//! Pixel (0, 0) is the centre of the top-left pixel. Grey values are in DN, positions, widths and sigmas in pixels.

mod bend;
mod edges;
mod engine;
mod error;
mod extractor;
mod flats;
mod lines;
mod lone;
mod median;
mod mle;
mod noise;
mod options;
mod peak;
mod pool;
mod precise;
mod profile;
mod ranks;
mod ridge;
mod scatter;
mod special;
mod track;
mod verdict;
mod view;

pub use bend::UNBENT_UNSURE;
pub use engine::{Tracking, brightest};
pub use error::StripeError;
pub use extractor::Extractor;
pub use flats::PhotonTransfer;
pub use noise::NoiseModel;
pub use options::{Method, Options};
pub use profile::{Flags, Measurement, Reject, Stripe};
pub use view::{Axis, Pixel, Roi, View};
