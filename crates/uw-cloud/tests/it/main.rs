//! Tests of the public fits: one binary.

mod bad_input;
mod degenerate;
mod hunts;
mod merges;
mod monte_carlo;
mod no_shapes;
mod poses;
mod properties;
mod registers;
mod round_shapes;
mod scene;
mod shapes;
mod shared;
mod surfaces;
