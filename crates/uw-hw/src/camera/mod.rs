//! Cameras: what all drivers have in common, and a module each.

#[cfg(feature = "genicam")]
mod aside;
#[cfg(feature = "genicam")]
pub mod genicam;
mod intake;

pub use intake::{Ids, Intake};
