//! The joint calibration on synthetic corners and stripes, against the truth that they were made from.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a test may panic, and prints what it measured")]

mod accuracy;
mod degenerate;
mod synthetic;
