//! Claims about whole images, on scenes whose truth is known.

mod accuracy;
mod behaviour;
mod scene;
