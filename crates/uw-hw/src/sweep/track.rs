//! Where the mirror was at a given time, from what was read back.

use std::collections::VecDeque;

use crate::ReadBack;

/// Read-backs in the order of time, and what lies between them.
#[derive(Clone, Debug, Default)]
pub struct VoltageTrack {
    samples: VecDeque<(i64, f64)>,
}

/// Samples that are kept: frames are looked up within the last few.
const KEPT: usize = 4096;

impl VoltageTrack {
    /// Adds a read-back; one that is not later than the last is left out.
    pub fn add(&mut self, read: ReadBack) {
        let later = self.samples.back().is_none_or(|(last_ns, _)| read.stamp_ns > *last_ns);
        if later && read.volts.is_finite() {
            if self.samples.len() == KEPT {
                self.samples.pop_front();
            }
            self.samples.push_back((read.stamp_ns, read.volts));
        }
    }

    /// The stamp of the last read-back, ns; `None` where there is none.
    pub fn last_ns(&self) -> Option<i64> {
        self.samples.back().map(|(stamp_ns, _)| *stamp_ns)
    }

    /// The voltage at a stamp, interpolated linearly between the read-backs around it; `None` before the first and after the last.
    pub fn volts_at(&self, stamp_ns: i64) -> Option<f64> {
        let after = self.samples.partition_point(|(at_ns, _)| *at_ns < stamp_ns);
        let &(to_ns, to_v) = self.samples.get(after)?;
        if to_ns == stamp_ns {
            return Some(to_v);
        }
        let &(from_ns, from_v) = self.samples.get(after.checked_sub(1)?)?;
        let share = (stamp_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
        Some(from_v + (to_v - from_v) * share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn voltages_lie_on_the_line_between_read_backs_and_nowhere_else() {
        let mut track = VoltageTrack::default();
        assert_eq!(track.volts_at(0), None);
        for (stamp_ns, volts) in [(100, 1.0), (200, 2.0), (200, 9.0), (150, 9.0), (250, f64::NAN), (400, 0.0)]
        {
            track.add(ReadBack { volts, stamp_ns, uncertainty_ns: 0 });
        }
        let at = [99, 100, 150, 200, 300, 400, 401].map(|stamp_ns| track.volts_at(stamp_ns));
        assert_eq!(at, [None, Some(1.0), Some(1.5), Some(2.0), Some(1.0), Some(0.0), None]);
        assert_eq!(track.last_ns(), Some(400));
    }
}
