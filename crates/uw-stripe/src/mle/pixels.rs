//! The windows of the lines that are fitted together, pixel by pixel.

use super::Weights;
use super::wide::{Row, WIDE};
use crate::lines::{Clip, Line};
use std::ops::Range;

/// Each row holds the pixels at one distance from the windows' first ones; 0 beyond a window's end.
#[derive(Debug, Default)]
pub(super) struct Pixels {
    /// Grey values, DN.
    pub value: Vec<Row>,
    /// By lane, one bit each: at full scale, and at the floor.
    pub clip: Vec<[u8; 2]>,
    /// Light beyond the value that is known, DN, and variance that came with taking it away, DN²; empty where none was.
    pub known: Vec<[Row; 2]>,
    /// Place of the first pixel on its line.
    pub first: Row,
    /// Lanes with a clipped pixel, one bit each.
    pub clipped: u8,
}

impl Pixels {
    /// Takes the windows of as many lines as there are lanes.
    pub fn pack(&mut self, windows: [(Line<'_>, &Range<usize>); WIDE], noise: &Weights) {
        let rows = windows.iter().map(|(_, window)| window.len()).max().unwrap_or(0);
        self.value.clear();
        self.value.resize(rows, Row::default());
        self.clip.clear();
        self.clip.resize(rows, [0; 2]);
        self.known.clear();
        if windows.iter().any(|(line, _)| line.something_known()) {
            self.known.resize(rows, <[Row; 2]>::default());
        }
        self.clipped = 0;
        for (lane, (line, window)) in windows.into_iter().enumerate() {
            self.first.0[lane] = window.start as f64;
            for (row, value) in self.value.iter_mut().zip(&line.value[window.clone()]) {
                row.0[lane] = f64::from(*value);
            }
            for (bits, clip) in self.clip.iter_mut().zip(&line.clip[window.clone()]) {
                let bit = 1 << lane;
                match clip {
                    Clip::No => continue,
                    Clip::Full => bits[0] |= bit,
                    Clip::Floor => bits[1] |= bit,
                }
                self.clipped |= bit;
            }
            for (known, i) in self.known.iter_mut().zip(window.clone()) {
                let pedestal = line.pedestal(i);
                known[0].0[lane] = pedestal + line.light(i);
                known[1].0[lane] = if pedestal > 0.0 { noise.variance(pedestal, 0.0) } else { 0.0 };
            }
        }
    }
}
