//! Claims about whole images, on scenes whose truth is known.

#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene shall fail")]

mod accuracy;
mod bars;
mod behaviour;
mod optics;
mod others;
mod processors;
mod scene;
mod several;
mod suite;
