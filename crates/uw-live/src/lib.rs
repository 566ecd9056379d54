//! A scan seen and steered over the network: a page of our own and its WebSocket, and a stream for Foxglove's tools beside it.
//!
//! | module | |
//! |---|---|
//! | [`feed`] | where a scan puts what it has: never blocks, the latest wins |
//! | [`cloud`] | the points so far, in bounded memory |
//! | [`access`] | tokens, rights, origins, hosts |
//! | [`tls`] | a certificate and its key |
//! | [`control`] | what a client may ask for; asked over a channel, answered by who scans |
//! | [`wire`] | messages to bytes and back, as docs/live-protocol.md has them |
//! | [`pace`] | how fast a client's link is, and what that leaves room for |
//! | [`server`] | the socket, the page's files, one session a client |
//!
//! It decides nothing about a scan: what clients ask for is handed on, and what comes of it is shown. All of the network is on one
//! thread, and one more that compresses images.

pub mod access;
mod assets;
pub mod cloud;
pub mod control;
mod error;
pub mod feed;
mod foxglove;
mod http;
pub mod pace;
mod picture;
pub mod server;
mod session;
pub mod tls;
pub mod wire;

pub use access::{Access, Rights, Scheme, Token};
pub use control::{Action, Asked, Replay};
pub use error::Error;
pub use feed::{About, Feed, Laser, Level, Mode, Phase, State, Stripe, Timeline};
pub use server::{Options, Server};
pub use tls::{Tls, TlsFault};
