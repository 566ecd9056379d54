//! Underwater laser-line scanning: calibration, exact refraction, point clouds and measurements.
//!
//! This crate is the pipeline on top of the crates that do the work, and the facade that the command line and Python share.
//! [`calibrate`](pipeline::calibrate::calibrate) turns recorded calibrations into a [`uw_calib::Calibration`],
//! [`reconstruct`](pipeline::reconstruct::reconstruct) a recorded sweep into a [`uw_cloud::PointCloud`],
//! and [`io::clouds`] reads and writes that by the ending of its file's name.

mod error;
pub mod pipeline;

pub use error::{Error, Failure, Notes};
pub use uw_calib as calib;
pub use uw_cloud as cloud;
pub use uw_geom as geom;
pub use uw_hw as hw;
pub use uw_io as io;
#[cfg(feature = "live")]
pub use uw_live as live;
pub use uw_report as report;
pub use uw_sim as sim;
pub use uw_stripe as stripe;
