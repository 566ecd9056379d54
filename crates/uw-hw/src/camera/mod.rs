//! Cameras: what all drivers have in common, and a module each.

#[cfg(feature = "genicam")]
mod aside;
#[cfg(feature = "genicam")]
pub mod genicam;
mod intake;
#[cfg(all(feature = "v4l2", target_os = "linux"))]
pub mod v4l2;

pub use intake::{Ids, Intake};

/// A camera that answered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraInfo {
    /// What its driver opens it by.
    pub id: String,
    /// Who made it, and what it is.
    pub about: String,
    /// Network address, or place on the bus.
    pub address: String,
}
