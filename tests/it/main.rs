//! System tests: one binary, a module a subject.

mod house;
mod layers;
mod photographs;
mod real_scan;
mod scan;
mod shared_errors;
mod simulated_calibration;
mod simulated_corners;
mod simulated_sides;
