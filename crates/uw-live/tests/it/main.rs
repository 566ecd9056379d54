//! The server at its socket, by a plain WebSocket client.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]
#![allow(clippy::needless_pass_by_value, reason = "messages are written where they are said")]
#![allow(clippy::print_stdout, reason = "what was measured is said")]

mod attacks;
mod client;
mod encrypted;
mod links;
mod scenes;
mod sessions;
mod streams;
