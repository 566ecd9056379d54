//! Controllers on serial ports: a galvanometer, and a laser that the same or another controller switches.

mod devices;
mod link;
mod ports;

pub use devices::{SerialGalvo, SerialLaser};
pub use link::{Link, SharedLink};
pub use ports::{Port, PortInfo, ports};
