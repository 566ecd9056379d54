//! Chessboard corners, camera start values and the joint calibration of camera, windows, galvanometer and laser.

pub mod lm;
mod normal;
mod schur;

mod adjust;
mod calibration;
mod data;
mod diagnostics;
mod error;
mod joint;
mod paper;
mod parameters;
mod priors;
mod residuals;
mod sheets;
mod sight;
mod start;

pub use adjust::{Adjustment, adjustment, calibrate, calibrate_in_full, calibrate_until};
pub use calibration::{Calibration, CorrelatedPair, Method, Rejected, Statistics, WorstImage};
pub use data::{Across, BoardView, CornerPoint, Observations, Outside, Priors, Rig, StripePoint, StripeView};
pub use error::CalibError;
pub use paper::calibrate_by_paper;
pub use parameters::{Coordinate, GLOBALS, Instrument, NAMES, Quantity, quantities, variance};
pub use residuals::{CornerRemains, StripePointRemains, StripeRemains, ViewResiduals};
pub use sheets::{VoltagePlane, axis_of, robust_plane};

mod board;
mod bundle;
mod candidates;
mod capture;
mod complete;
mod corners;
mod grid;
mod homography;
mod pinhole;
mod saddle;
mod view;
mod zhang;

pub use board::{BoardError, Chessboard};
pub use capture::{CaptureError, label_capture};
pub use corners::{BoardCorner, Detection, Rejection, detect};
pub use homography::{apply as apply_homography, homography};
pub use pinhole::{PINHOLE_NAMES, Pinhole, PinholeOptions, calibrate_pinhole};
pub use view::{GreyView, Layout, Samples, ViewError};
pub use zhang::{closed_form, rough_pose};
