//! Images of a scene as an underwater laser scanner would take them, with the exact stripes beside them.
//!
//! Light's ways are `uw-geom`'s, the same functions that calibration and reconstruction evaluate, run the other way. An image is made
//! backwards: for places a quarter of a pixel apart the camera's ray is traced through its window to the first surface, and how far
//! that point lies from the sheet, through the laser's own window, says how much light it gets. Thickness, grazing incidence, shadows
//! on either side and edges of brightness follow by themselves. Point-spread and pixel area are one closed kernel.
//!
//! | module | does |
//! |---|---|
//! | `instrument`, `scene`, [`shape`] | what there is |
//! | `world` | the scene at one moment: hits, shadows |
//! | `sight` | what is seen at a place, and the laser's light there |
//! | `mask` | where in the image laser light can be |
//! | `stripe`, `ambient`, `haze` | light on the image plane |
//! | `spread`, `speckle`, `noise` | lens, grain, sensor |
//! | `curve` | the exact stripe |
//! | `bench` | the instrument behind `uw-hw`'s traits |
//!
//! Millimetres, radians, pixels, volts, seconds. Every frame's noise follows from the scene's seed and the frame's number alone.

mod ambient;
mod bench;
mod curve;
mod draws;
mod error;
mod haze;
mod instrument;
mod mask;
mod noise;
mod render;
mod scene;
pub mod shape;
mod sight;
mod speckle;
mod spread;
mod stripe;
mod texture;
mod world;

pub use bench::camera_sees;
pub use curve::{Along, CurvePoint};
pub use draws::Draws;
pub use error::SimError;
pub use instrument::{Beam, Instrument, Lens, REFERENCE_MM, Sensor};
pub use noise::Picture;
pub use render::{Exposed, Renderer, Shot};
pub use scene::{Ambient, Body, Motion, Object, Scene, Surface, Texture, Water};
pub use shape::Shape;
