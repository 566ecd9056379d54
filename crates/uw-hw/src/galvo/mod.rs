//! Galvanometer controllers: [`proto`] turns commands into bytes and bytes into replies.

pub mod proto;
