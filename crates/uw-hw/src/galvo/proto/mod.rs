//! What is said to a controller and what it answers, as bytes: no port, no clock.
//!
//! A [`Dialect`] is data: what is sent for each [`Command`], with `{v}` for the voltage (`{p}` for the laser's power), and the pattern of the
//! reply. [`Dialect::scpi`] is the IEEE 488.2 one; another controller needs a table, no code. [`Lines`] cuts what comes into lines.

mod dialect;
mod lines;
mod pattern;

pub use dialect::{Command, Dialect, DialectError, Exchange, Outgoing};
pub use lines::{Line, Lines};
pub use pattern::{Pattern, Reply};
