//! The simulator against truth that it did not make, and against itself where there is none.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a test may panic, and says what it measured")]

mod behaviour;
mod bench;
mod rig;
mod samples;
mod truth;
