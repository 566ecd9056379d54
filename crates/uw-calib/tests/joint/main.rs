//! The joint calibration on synthetic corners and stripes, against the truth that they were made from.

mod accuracy;
mod degenerate;
mod synthetic;
