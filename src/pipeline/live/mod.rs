//! Scans and recordings shown over the network, and steered from there: what ties [`crate::live`] to the pipeline.

mod replay;
mod watch;

pub use replay::{Replayed, Source, replay};
pub use watch::{Watch, Watched, obey};

/// What clients ask for, as it comes.
pub type Requests = crossbeam_channel::Receiver<crate::live::Asked>;
