//! Underwater laser-line scanning: calibration, exact refraction, point clouds and measurements.
