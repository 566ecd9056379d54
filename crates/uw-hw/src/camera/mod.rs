//! Cameras: what all drivers have in common, and a module each.

mod intake;

pub use intake::{Ids, Intake};
