//! Sweeps: which voltages ([`Schedule`], [`feed`]), in which way ([`step_and_settle`], [`continuous`]), and what the mirror makes of a
//! command ([`measure_settling`], [`measure_lag`]).
//!
//! A voltage that a frame is given was read back, never only commanded: after settling in a stepped sweep, interpolated to the middle of
//! the exposure in a continuous one.

mod continuous;
mod measure;
mod schedule;
mod step;
mod track;

pub use continuous::{Continuous, continuous};
pub use measure::{Lag, Settling, measure_lag, measure_settling};
pub use schedule::{Aim, Fed, Feeder, Schedule, ScheduleError, Spacing, feed};
pub use step::{Event, Exposed, StepAndSettle, step_and_settle};
pub use track::VoltageTrack;
