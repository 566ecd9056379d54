//! What a scan counts while it runs, from all its threads.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Why an exposure that was wanted has no image in the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Loss {
    /// The camera exposed, and the frame never came: a gap in its numbers.
    CameraDropped,
    /// No frame came in time, and none was told of as lost.
    CameraSilent,
    /// The frame came torn, or of another size.
    Unusable,
    /// The queue to the recorder was full: disk or processor did not keep up with the camera.
    RecorderBehind,
    /// The recorder had failed: it was acquired, and could not be written.
    RecorderFailed,
    /// Planned, and not reached before the scan ended.
    NotReached,
}

impl Loss {
    /// Stable name for reports, in snake case.
    pub fn name(self) -> &'static str {
        match self {
            Self::CameraDropped => "camera_dropped",
            Self::CameraSilent => "camera_silent",
            Self::Unusable => "unusable",
            Self::RecorderBehind => "recorder_behind",
            Self::RecorderFailed => "recorder_failed",
            Self::NotReached => "not_reached",
        }
    }
}

/// Counts that threads share.
#[derive(Debug, Default)]
pub struct Tally {
    planned: AtomicUsize,
    acquired: AtomicUsize,
    recorded: AtomicUsize,
    previewed: AtomicUsize,
    skipped: AtomicUsize,
    duplicated: AtomicUsize,
    repeated: AtomicUsize,
    points: AtomicUsize,
    longest_queue: AtomicUsize,
    latency: Latency,
    lost: Mutex<BTreeMap<Loss, usize>>,
}

/// The counts at one moment.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Exposures that are wanted.
    pub planned: usize,
    /// Frames that came from the camera.
    pub acquired: usize,
    /// Frames that are in the recording.
    pub recorded: usize,
    /// Frames whose points were made while scanning.
    pub previewed: usize,
    /// Frames that were recorded without: extraction was busy. The final cloud has them.
    pub skipped: usize,
    /// Frames that came twice.
    pub duplicated: usize,
    /// Exposures made again, because their frame was dropped, torn or late: nothing is lost by that.
    pub repeated: usize,
    /// Points made while scanning.
    pub points: usize,
    /// Most that ever waited for the recorder.
    pub longest_queue: usize,
    /// Wanted exposures without an image in the recording, by reason.
    pub lost: BTreeMap<&'static str, usize>,
    /// From the end of the exposure to its points, microseconds: median and 99th percentile; `None` before the first.
    pub latency_us: Option<[u64; 2]>,
}

impl Counts {
    /// How many wanted exposures have no image in the recording.
    pub fn lost_frames(&self) -> usize {
        self.lost.values().sum()
    }
}

impl Tally {
    pub(crate) fn plan(&self, more: usize) {
        self.planned.fetch_add(more, Ordering::Relaxed);
    }

    pub(crate) fn acquired(&self) {
        self.acquired.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn recorded(&self) -> usize {
        1 + self.recorded.fetch_add(1, Ordering::Relaxed)
    }

    pub(crate) fn duplicated(&self) {
        self.duplicated.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn skipped(&self) {
        self.skipped.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn queued(&self, length: usize) {
        self.longest_queue.fetch_max(length, Ordering::Relaxed);
    }

    pub(crate) fn previewed(&self, points: usize, latency_us: u64) {
        self.points.fetch_add(points, Ordering::Relaxed);
        self.latency.add(latency_us);
        // Last: who sees it counted finds its points with it.
        self.previewed.fetch_add(1, Ordering::Release);
    }

    pub(crate) fn lost(&self, why: Loss, count: usize) {
        if count > 0 {
            *self.lost.lock().unwrap_or_else(PoisonError::into_inner).entry(why).or_default() += count;
        }
    }

    pub(crate) fn repeated(&self) {
        self.repeated.fetch_add(1, Ordering::Relaxed);
    }

    /// Frames whose points were made.
    pub(crate) fn through(&self) -> usize {
        self.previewed.load(Ordering::Acquire)
    }

    /// So many frames are in a recording that failed: what else was taken for it is lost.
    pub(crate) fn found(&self, held: usize) {
        let taken = self.recorded.swap(held, Ordering::Relaxed);
        self.lost(Loss::RecorderFailed, taken.saturating_sub(held));
    }

    /// What there is to say besides the number of frames.
    pub(crate) fn words(&self) -> String {
        let lost: usize = self.lost.lock().unwrap_or_else(PoisonError::into_inner).values().sum();
        format!("{} points, {lost} lost", self.points.load(Ordering::Relaxed))
    }

    /// The counts as they are now.
    pub fn counts(&self) -> Counts {
        let of = |count: &AtomicUsize| count.load(Ordering::Relaxed);
        let lost = self.lost.lock().unwrap_or_else(PoisonError::into_inner);
        Counts {
            planned: of(&self.planned),
            acquired: of(&self.acquired),
            recorded: of(&self.recorded),
            previewed: of(&self.previewed),
            skipped: of(&self.skipped),
            duplicated: of(&self.duplicated),
            repeated: of(&self.repeated),
            points: of(&self.points),
            longest_queue: of(&self.longest_queue),
            lost: lost.iter().map(|(why, count)| (why.name(), *count)).collect(),
            latency_us: self.latency.quantiles([0.5, 0.99]),
        }
    }
}

/// Buckets of a histogram to an octave, and octaves: to 2³² µs, over an hour.
const FINE: u64 = 128;
const OCTAVES: u64 = 32;

/// A histogram of times in constant memory, each to less than a hundredth of itself.
#[derive(Debug)]
struct Latency {
    buckets: Vec<AtomicU64>,
}

impl Default for Latency {
    fn default() -> Self {
        Self { buckets: (0..FINE * OCTAVES).map(|_| AtomicU64::new(0)).collect() }
    }
}

impl Latency {
    /// Below [`FINE`] each value has a bucket; above, each octave has as many.
    fn bucket(us: u64) -> usize {
        let octave = us.checked_ilog2().unwrap_or(0).saturating_sub(FINE.ilog2());
        let index = u64::from(octave) * FINE + (us >> octave);
        index.min(FINE * OCTAVES - 1) as usize
    }

    /// The largest value of a bucket.
    fn value(bucket: usize) -> u64 {
        let bucket = bucket as u64;
        let octave = (bucket / FINE).saturating_sub(1);
        ((bucket - octave * FINE + 1) << octave) - 1
    }

    fn add(&self, us: u64) {
        self.buckets[Self::bucket(us)].fetch_add(1, Ordering::Relaxed);
    }

    fn quantiles<const N: usize>(&self, shares: [f64; N]) -> Option<[u64; N]> {
        let counts: Vec<u64> = self.buckets.iter().map(|b| b.load(Ordering::Relaxed)).collect();
        let total: u64 = counts.iter().sum();
        (total > 0).then(|| {
            shares.map(|share| {
                let rank = ((share * total as f64).ceil() as u64).max(1);
                let mut below = 0;
                let at = counts.iter().position(|count| {
                    below += count;
                    below >= rank
                });
                at.map_or(0, Self::value)
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_right_to_a_hundredth() {
        let latency = Latency::default();
        assert_eq!(latency.quantiles([0.5]), None);
        (1..=100_000).for_each(|us| latency.add(us));
        let [middle, late] = latency.quantiles([0.5, 0.99]).unwrap();
        assert!((50_000..=50_500).contains(&middle), "{middle}");
        assert!((99_000..=100_000).contains(&late), "{late}");
        for us in [0, 1, 127, 128, 129, 255, 256, 257, 1000, 123_456_789] {
            let value = Latency::value(Latency::bucket(us));
            assert!(value >= us && value - us <= us / 128, "{us} as {value}");
        }
    }

    #[test]
    fn losses_are_kept_by_reason() {
        let tally = Tally::default();
        tally.lost(Loss::CameraDropped, 2);
        tally.lost(Loss::RecorderBehind, 0);
        tally.lost(Loss::CameraDropped, 1);
        let counts = tally.counts();
        assert_eq!(counts.lost, BTreeMap::from([("camera_dropped", 3)]));
        assert_eq!(counts.lost_frames(), 3);
    }
}
