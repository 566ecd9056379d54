//! Point clouds and robust shape fits with covariance.
//!
//! A [`PointCloud`] holds positions in millimetres and, where its maker gave them, what was measured with each
//! point and the covariance of its measurement. [`fit_sphere`] and [`fit_plane`] turn one into a shape with
//! sigmas. How points were made, and the files that they come from, are no concern of this crate.
//!
//! # How a shape is fitted
//!
//! | step | file | what it decides |
//! |---|---|---|
//! | start | `consensus` | a shape from random minimal samples that the densest share of the points agrees with |
//! | refinement | `fit` | maximum likelihood with errors in variables; noise floor; scale; which points are outliers |
//! | covariance | `fit` | sigmas, and whether the points determine the shape at all |
//!
//! A shape is a `fit::Surface`: its signed distance, the foot of a point under that point's own covariance, and
//! the derivatives there. Everything else is shared between shapes.

mod cloud;
mod consensus;
mod error;
mod fit;
mod floor;
mod newton;
mod plane;
mod robust;
mod sample;
mod sphere;

pub use cloud::{CloudPoint, Frame, PointCloud};
pub use error::{CloudError, FitError};
pub use fit::Deviations;
pub use plane::{PlaneFit, PlaneOptions, fit_plane};
pub use sphere::{SphereFit, SphereOptions, fit_sphere};
