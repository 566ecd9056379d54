//! Room on the disk, looked at by the recorder's thread and seen by acquisition.

use super::Refused;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Room that has to be left where the recording goes.
#[derive(Clone, Copy, Debug)]
pub struct Room<'a> {
    /// The recording.
    pub path: &'a Path,
    /// Bytes that have to stay free; 0: none.
    pub min_free_bytes: u64,
}

impl Room<'_> {
    /// What is free, where that is less than it has to be. A system that doesn't say has room.
    pub fn shortage(&self) -> Option<u64> {
        self.free().filter(|free| *free < self.min_free_bytes)
    }

    /// What is free, where it matters and the system says so.
    pub(super) fn free(&self) -> Option<u64> {
        if self.min_free_bytes == 0 {
            return None;
        }
        uw_io::disk::free_bytes(self.path).ok().flatten()
    }
}

/// Told by the recorder, which looks, to acquisition, which ends.
pub(super) struct Short {
    pub needed_bytes: u64,
    pub frame_bytes: usize,
    pub free_bytes: AtomicU64,
}

impl Short {
    /// `waiting` frames are still to be written: their room is taken.
    pub fn check(&self, waiting: usize) -> Result<(), Refused> {
        let taken = (waiting * self.frame_bytes) as u64;
        match self.free_bytes.load(Ordering::Relaxed).saturating_sub(taken) {
            free_bytes if free_bytes < self.needed_bytes => {
                Err(Refused::NoRoom { free_bytes, needed_bytes: self.needed_bytes })
            }
            _ => Ok(()),
        }
    }
}
