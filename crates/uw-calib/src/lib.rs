//! Chessboard corners, camera start values and the joint calibration of camera, windows, galvanometer and laser.

pub mod lm;
mod normal;
