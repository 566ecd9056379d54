//! The scanner's exact model: frames, rays, flat windows, camera, galvanometer and the curved sheet of laser light.
//!
//! Millimetres, radians, pixels, volts. Pixel (0, 0) is the centre of the top-left pixel. The camera frame is x right, y
//! down, z forward. Everything is generic over [`Real`]: in `f64` it computes, in [`Dual`] numbers it computes with exact
//! derivatives. The few functions between pixel and point are always inlined: handing their results on through memory costs a
//! fifth of the time. This crate opens no file, reads no clock, logs nothing and draws no random number.

pub mod approx;
mod camera;
mod error;
mod exposure;
mod fan;
pub mod frame;
mod plane;
mod port;
mod ray;
mod real;
mod scanner;
mod snell;
mod trace;
pub mod water;

pub use camera::{Camera, Distortion};
pub use error::GeomError;
pub use exposure::Exposure;
pub use fan::{Fan, Galvo, Sheet};
pub use frame::Rigid;
pub use plane::Plane;
pub use port::Port;
pub use ray::Ray;
pub use real::{Dual, Real, lift, lift2, norm, rotation_about_x, unit, values};
pub use scanner::{Observed, Scanner, Triangulated, galvo_frame};
pub use snell::{Medium, refract};
