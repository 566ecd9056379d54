//! Tests of the public fits: one binary.

mod bad_input;
mod monte_carlo;
mod properties;
mod registers;
mod round_shapes;
mod scene;
mod shapes;
mod surfaces;
