//! Chessboard corners, camera start values and the joint calibration of camera, windows, galvanometer and laser.

pub mod lm;
mod normal;

mod adjust;
mod calibration;
mod data;
mod diagnostics;
mod error;
mod joint;
mod parameters;
mod priors;
mod sheets;
mod sight;
mod start;

pub use adjust::calibrate;
pub use calibration::{Calibration, CorrelatedPair, Method, Rejected, Statistics, WorstImage};
pub use data::{Across, BoardView, CornerPoint, Observations, Outside, Priors, Rig, StripePoint, StripeView};
pub use error::CalibError;
pub use parameters::{Coordinate, GLOBALS, Instrument, NAMES, Quantity, quantities, variance};
pub use sheets::{VoltagePlane, axis_of, robust_plane};

mod board;
mod candidates;
mod complete;
mod corners;
mod grid;
mod homography;
mod saddle;
mod view;

pub use board::{BoardError, Chessboard};
pub use corners::{BoardCorner, Detection, Rejection, detect};
pub use homography::{apply as apply_homography, homography};
pub use view::{GreyView, Layout, Samples, ViewError};

mod capture;

pub use capture::{CaptureError, label_capture};

mod pinhole;
mod zhang;

pub use pinhole::{PINHOLE_NAMES, Pinhole, PinholeOptions, calibrate_pinhole};
pub use zhang::closed_form;
