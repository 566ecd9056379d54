//! Galvanometer, laser and camera: what drives them, what keeps them safe, and what stands in for them.
//!
//! | module | is |
//! |---|---|
//! | [`traits`] | [`Galvo`], [`Laser`], [`Camera`]: every call with the time that it may take, every fault typed |
//! | [`frame`] | one image: pixels that are owned or shared, size, significant bits, id, exposure, receipt |
//! | [`fault`] | what hardware does instead of what was asked |
//! | [`clock`] | clocks that are given, not read: the system's, and one that a test moves |
//! | [`limits`] | voltage range and slew, enforced once: no voltage reaches a drive but through [`GuardedGalvo`] |
//! | [`galvo`] | controllers on a serial line, their dialect as data |
//! | [`camera`] | what cameras have in common: ids that roll over, losses counted |
//! | [`interlock`] | laser off and mirror parked on every way out |
//! | [`sweep`] | which voltages, in which way, and what the mirror makes of it |
//! | [`mock`] | scripted devices with faults |
//!
//! Nothing here decides what a scan is for, logs, or knows a file.

pub mod camera;
pub mod clock;
pub mod fault;
pub mod frame;
pub mod galvo;
pub mod interlock;
pub mod limits;
pub mod mock;
pub mod sweep;
pub mod traits;

pub use clock::{Clock, ClockStep, Deadline, ManualClock, StepWatch, SystemClock, Timeline};
pub use fault::Fault;
pub use frame::{Exposure, Frame, Pixels};
pub use limits::{AllowedVolts, GuardedGalvo, Limits};
pub use traits::{Camera, CameraSettings, FrameCounts, Galvo, Identity, Laser, Moved, ReadBack, Trigger};
