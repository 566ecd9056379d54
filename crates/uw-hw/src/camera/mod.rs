//! Cameras: what all drivers have in common, and a module each.

#[cfg(feature = "genicam")]
mod aside;
#[cfg(feature = "genicam")]
pub mod genicam;
mod intake;
#[cfg(all(feature = "v4l2", target_os = "linux"))]
pub mod v4l2;

pub use intake::{Ids, Intake};
