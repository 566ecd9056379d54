//! Buffers that start where a cache line does: vectors of 64 bytes in them never cross from one line into the next.

use std::ops::{Deref, DerefMut};

/// Bytes of a cache line.
const LINE: usize = 64;

/// Elements from the start of a cache line on.
#[derive(Debug, Default)]
pub(crate) struct Aligned<T> {
    all: Vec<T>,
    first: usize,
    len: usize,
}

impl<T: Copy + Default> Aligned<T> {
    /// Makes room for so many elements, which hold anything.
    pub fn resize(&mut self, len: usize) {
        if self.len == len {
            return;
        }
        self.all.resize(len + LINE / size_of::<T>().max(1), T::default());
        // Larger than the room only where alignment cannot be told: then the first element will do.
        self.first =
            Some(self.all.as_ptr().align_offset(LINE)).filter(|f| *f <= self.all.len() - len).unwrap_or(0);
        self.len = len;
    }
}

impl<T> Deref for Aligned<T> {
    type Target = [T];
    fn deref(&self) -> &[T] {
        &self.all[self.first..self.first + self.len]
    }
}

impl<T> DerefMut for Aligned<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.all[self.first..self.first + self.len]
    }
}
