//! When a frame was exposed, from what the kernel says of its buffer.

use moq_v4l::{Timestamp, buffer::Flags};

use crate::{Exposure, Timeline, clock::nanoseconds};

/// From a device's stamps to those of a [`Timeline`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Stamps {
    /// The timeline less the kernel's monotonic clock, ns.
    offset_ns: i64,
    exposure_ns: i64,
    /// How long a frame takes to come once it is exposed, ns.
    coming_ns: i64,
}

impl Stamps {
    /// For frames that are exposed for so long, and take so long to come: a whole interval for an analogue signal.
    pub fn new(timeline: &Timeline, exposure: std::time::Duration, interval: std::time::Duration) -> Self {
        Self {
            offset_ns: offset_ns(timeline),
            exposure_ns: nanoseconds(exposure),
            coming_ns: nanoseconds(interval),
        }
    }

    /// The exposure of a frame: its stamp is that of the exposure's start, or of the last pixel's coming, as the driver says. A stamp of
    /// another clock is not used, but when the frame came.
    pub fn exposure(&self, flags: Flags, stamp: Timestamp, received_ns: i64) -> Exposure {
        let monotonic = flags & Flags::TIMESTAMP_MASK == Flags::TIMESTAMP_MONOTONIC;
        let kernel_ns =
            stamp.sec.saturating_mul(1_000_000_000).saturating_add(stamp.usec.saturating_mul(1000));
        let at_ns =
            if monotonic { kernel_ns.saturating_add(self.offset_ns).min(received_ns) } else { received_ns };
        let at_start = monotonic && flags & Flags::TSTAMP_SRC_MASK == Flags::TSTAMP_SRC_SOE;
        let before_ns = if at_start { 0 } else { self.exposure_ns.saturating_add(self.coming_ns) };
        Exposure {
            stamp_ns: at_ns.saturating_sub(before_ns),
            exposure_ns: self.exposure_ns.unsigned_abs(),
            received_ns,
        }
    }
}

/// The timeline less the kernel's monotonic clock, ns: the kernel's was read between two readings of the timeline, and of several such
/// readings that counts which nothing else came into.
fn offset_ns(timeline: &Timeline) -> i64 {
    const READINGS: usize = 8;
    let reading = || {
        let before_ns = timeline.stamp_ns();
        let kernel_ns = kernel_ns();
        let apart_ns = timeline.stamp_ns().saturating_sub(before_ns);
        (apart_ns, before_ns.saturating_add(apart_ns / 2).saturating_sub(kernel_ns))
    };
    (1..READINGS).fold(reading(), |best, _| best.min(reading())).1
}

/// The clock by which drivers stamp frames, ns.
fn kernel_ns() -> i64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec.saturating_mul(1_000_000_000).saturating_add(now.tv_nsec)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const STAMPS: Stamps =
        Stamps { offset_ns: 5_000_000_000, exposure_ns: 20_000_000, coming_ns: 40_000_000 };
    /// Of the kernel's clock: 7.25 s on the timeline.
    const STAMP: Timestamp = Timestamp { sec: 2, usec: 250_000 };
    const RECEIVED_NS: i64 = 7_251_000_000;

    #[test]
    fn a_stamp_at_the_end_of_a_frame_lies_after_exposure_and_transmission() {
        let end = STAMPS.exposure(Flags::TIMESTAMP_MONOTONIC, STAMP, RECEIVED_NS);
        let exposure =
            Exposure { stamp_ns: 7_190_000_000, exposure_ns: 20_000_000, received_ns: RECEIVED_NS };
        assert_eq!(end, exposure);
        let start = STAMPS.exposure(Flags::TIMESTAMP_MONOTONIC | Flags::TSTAMP_SRC_SOE, STAMP, RECEIVED_NS);
        assert_eq!(start, Exposure { stamp_ns: 7_250_000_000, ..exposure });
    }

    #[test]
    fn a_stamp_of_another_clock_or_from_the_future_gives_way_to_the_receipt() {
        for (flags, stamp) in [
            (Flags::TIMESTAMP_COPY, STAMP),
            (Flags::TIMESTAMP_UNKNOWN | Flags::TSTAMP_SRC_SOE, STAMP),
            (Flags::TIMESTAMP_MONOTONIC, Timestamp { sec: i64::MAX, usec: i64::MAX }),
        ] {
            let exposure = STAMPS.exposure(flags, stamp, RECEIVED_NS);
            assert_eq!(exposure.stamp_ns, RECEIVED_NS - 60_000_000, "{flags}");
        }
    }

    #[test]
    fn the_kernels_clock_is_found_on_the_timeline() {
        let timeline = Timeline::system();
        let stamps = Stamps::new(&timeline, Duration::from_millis(20), Duration::from_millis(40));
        let before_ns = timeline.stamp_ns();
        let micros = kernel_ns() / 1000;
        let after_ns = timeline.stamp_ns();
        let stamp = Timestamp { sec: micros / 1_000_000, usec: micros % 1_000_000 };
        let flags = Flags::TIMESTAMP_MONOTONIC | Flags::TSTAMP_SRC_SOE;
        let stamp_ns = stamps.exposure(flags, stamp, i64::MAX).stamp_ns;
        // The stamp is whole microseconds; the offset may be off by half of what two readings of the clock take.
        const OFF_NS: i64 = 100_000;
        assert!(
            (before_ns - OFF_NS..=after_ns + OFF_NS).contains(&stamp_ns),
            "{before_ns} {stamp_ns} {after_ns}"
        );
    }
}
