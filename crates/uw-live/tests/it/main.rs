//! The server at its socket, by a plain WebSocket client.

mod attacks;
mod client;
mod links;
mod scenes;
mod sessions;
mod streams;
