//! Galvanometer controllers on a serial line: [`proto`] turns commands into bytes and bytes into replies, [`serial`] (feature `serial`)
//! sends and receives them.

pub mod proto;
#[cfg(feature = "serial")]
pub mod serial;
