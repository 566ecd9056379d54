//! Tests of the public fits: one binary.

mod bad_input;
mod monte_carlo;
mod properties;
mod round_shapes;
mod scene;
mod shapes;
