//! From what a camera delivers to frames that can be trusted: ids that roll over, gaps, repetitions, sizes.

use crate::{Exposure, Fault, Frame, FrameCounts, Pixels, frame::Layout};

/// The numbers that a camera gives its frames, one after the other, `first` following `last`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ids {
    first: u64,
    last: u64,
}

impl Ids {
    /// GigE Vision's block ids of 16 bits: 0 is no id (GigE Vision 1.2, section 25.1).
    pub const GIGE_16: Self = Self { first: 1, last: 0xFFFF };
    /// Ids that don't roll over within a lifetime (USB3 Vision, GigE Vision's extended ids, V4L2 of 32 bits at 10 000 Hz for five days).
    pub const WIDE: Self = Self { first: 0, last: u64::MAX };
    /// Ids of 32 bits from zero.
    pub const U32: Self = Self { first: 0, last: 0xFFFF_FFFF };

    /// How many frames `to` is after `from`; `None` for an id that is none.
    fn steps(self, from: u64, to: u64) -> Option<u64> {
        if !(self.first..=self.last).contains(&to) {
            return None;
        }
        let cycle = (self.last - self.first).wrapping_add(1);
        let ahead = to.wrapping_sub(from);
        Some(if to >= from || cycle == 0 { ahead } else { ahead.wrapping_add(cycle) })
    }

    /// A jump further ahead than this is one back: a frame that came late, or again.
    fn half(self) -> u64 {
        (self.last - self.first) / 2
    }
}

/// Turns what a camera delivers into frames: numbers them from 0, notices gaps and repetitions, refuses other sizes, and counts.
#[derive(Debug)]
pub struct Intake {
    device: String,
    size: [u32; 2],
    ids: Ids,
    /// The camera's id of the last frame, and its number.
    last: Option<(u64, u64)>,
    pending: Option<Result<Frame, Fault>>,
    counts: FrameCounts,
}

impl Intake {
    /// An intake of frames of `size`; `device` names the camera in faults.
    pub fn new(device: String, size: [u32; 2], ids: Ids) -> Self {
        Self { device, size, ids, last: None, pending: None, counts: FrameCounts::default() }
    }

    /// Says that the next frame of the camera, if none is lost, has this id: so that a loss of the very first frames is noticed.
    pub fn expect_first(&mut self, id: u64) {
        let before = if id == self.ids.first { self.ids.last } else { id.wrapping_sub(1) };
        // The number before 0, so that the first frame gets 0.
        self.last = Some((before, u64::MAX));
    }

    /// What came after a gap that was told.
    pub fn take_pending(&mut self) -> Option<Result<Frame, Fault>> {
        let next = self.pending.take();
        self.counts.received += u64::from(matches!(next, Some(Ok(_))));
        next
    }

    /// What came so far.
    pub fn counts(&self) -> FrameCounts {
        self.counts
    }

    /// Takes what the camera delivered under its own `id`.
    ///
    /// # Errors
    /// [`Fault::DroppedFrames`] after a gap: what came after it is then [pending](Self::take_pending). [`Fault::DuplicateFrame`],
    /// [`Fault::FrameSize`], [`Fault::FrameContent`].
    pub fn admit(
        &mut self,
        id: u64,
        pixels: impl Into<Pixels>,
        layout: Layout,
        exposure: Exposure,
    ) -> Result<Frame, Fault> {
        let (number, dropped) = self.number(id)?;
        let got = [layout.width, layout.height];
        let next = if got == self.size {
            Frame::new(pixels, layout, number, exposure).map_err(|why| self.unusable(number, &why))
        } else {
            self.counts.unusable += 1;
            Err(Fault::FrameSize { device: self.device.clone(), needed: self.size, got })
        };
        self.after_gap(number, dropped, next)
    }

    /// Notes a frame that came torn under the camera's own `id`: what to tell of it.
    pub fn torn(&mut self, id: u64, why: &str) -> Fault {
        let told = self.number(id).and_then(|(number, dropped)| {
            let torn = self.unusable(number, &why);
            self.after_gap(number, dropped, Err(torn))
        });
        match told {
            Err(fault) => fault,
            Ok(frame) => self.unusable(frame.id(), &why),
        }
    }

    /// The gap is told first, and what came after it is kept for the next call.
    fn after_gap(&mut self, number: u64, dropped: u64, next: Result<Frame, Fault>) -> Result<Frame, Fault> {
        if dropped > 0 {
            self.pending = Some(next);
            return Err(Fault::DroppedFrames {
                device: self.device.clone(),
                count: dropped,
                next_id: number,
            });
        }
        self.counts.received += u64::from(next.is_ok());
        next
    }

    fn unusable(&mut self, id: u64, why: &dyn std::fmt::Display) -> Fault {
        self.counts.unusable += 1;
        Fault::FrameContent { device: self.device.clone(), id, reason: why.to_string() }
    }

    /// The frame's number from 0, and how many are missing before it.
    fn number(&mut self, id: u64) -> Result<(u64, u64), Fault> {
        let (number, dropped) = match self.last {
            None => (0, 0),
            Some((last_id, last)) => match self.ids.steps(last_id, id) {
                Some(steps @ 1..) if steps <= self.ids.half() => (last.wrapping_add(steps), steps - 1),
                Some(steps) => {
                    self.counts.duplicated += 1;
                    let back = if steps == 0 { 0 } else { self.ids.steps(id, last_id).unwrap_or(0) };
                    let id = last.saturating_sub(back);
                    return Err(Fault::DuplicateFrame { device: self.device.clone(), id });
                }
                None => {
                    let reason = format!("the camera gave it the id {id}, which is none");
                    return Err(self.unusable(last.wrapping_add(1), &reason));
                }
            },
        };
        self.last = Some((id, number));
        self.counts.dropped += dropped;
        Ok((number, dropped))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHEN: Exposure = Exposure { stamp_ns: 0, exposure_ns: 0, received_ns: 0 };

    fn admit(intake: &mut Intake, id: u64) -> Result<u64, Fault> {
        intake.admit(id, vec![0_u8; 6], Layout::packed(3, 2, 8), WHEN).map(|frame| frame.id())
    }

    fn intake(ids: Ids) -> Intake {
        Intake::new("camera".into(), [3, 2], ids)
    }

    #[test]
    fn ids_of_sixteen_bits_roll_over_past_zero_and_numbers_go_on() {
        let mut intake = intake(Ids::GIGE_16);
        intake.expect_first(1);
        let mut raw = 0;
        for number in 0..200_000_u64 {
            raw = if raw == 0xFFFF { 1 } else { raw + 1 };
            assert_eq!(admit(&mut intake, raw), Ok(number));
        }
        assert_eq!(intake.counts(), FrameCounts { received: 200_000, ..FrameCounts::default() });
    }

    #[test]
    fn a_gap_across_the_roll_over_is_counted_and_the_frame_after_it_kept() {
        let mut intake = intake(Ids::GIGE_16);
        assert_eq!(admit(&mut intake, 0xFFFE), Ok(0));
        let Err(Fault::DroppedFrames { count: 3, next_id: 4, .. }) = admit(&mut intake, 3) else {
            panic!("65535, 1 and 2 are missing");
        };
        assert_eq!(intake.take_pending().map(|next| next.map(|frame| frame.id())), Some(Ok(4)));
        assert_eq!(intake.take_pending(), None);
        assert_eq!(admit(&mut intake, 4), Ok(5));
        assert_eq!(intake.counts(), FrameCounts { received: 3, dropped: 3, ..FrameCounts::default() });
    }

    #[test]
    fn the_very_first_frames_may_be_missing_too() {
        let mut intake = intake(Ids::GIGE_16);
        intake.expect_first(1);
        assert!(matches!(admit(&mut intake, 3), Err(Fault::DroppedFrames { count: 2, next_id: 2, .. })));
        let mut wide = Intake::new("camera".into(), [3, 2], Ids::WIDE);
        wide.expect_first(0);
        assert_eq!(admit(&mut wide, 0), Ok(0));
    }

    #[test]
    fn repeated_late_and_misnumbered_frames_are_told_and_change_nothing() {
        let mut intake = intake(Ids::GIGE_16);
        assert_eq!([1, 2, 3].map(|id| admit(&mut intake, id)), [Ok(0), Ok(1), Ok(2)]);
        assert!(matches!(admit(&mut intake, 3), Err(Fault::DuplicateFrame { id: 2, .. })));
        assert!(matches!(admit(&mut intake, 2), Err(Fault::DuplicateFrame { id: 1, .. })));
        assert!(matches!(admit(&mut intake, 0), Err(Fault::FrameContent { .. })));
        assert_eq!(admit(&mut intake, 4), Ok(3));
        let counts = FrameCounts { received: 4, dropped: 0, duplicated: 2, unusable: 1 };
        assert_eq!(intake.counts(), counts);
    }

    #[test]
    fn another_size_is_refused_and_a_torn_frame_counted() {
        let mut intake = intake(Ids::U32);
        assert_eq!(admit(&mut intake, 7), Ok(0));
        let wrong = intake.admit(8, vec![0_u8; 8], Layout::packed(4, 2, 8), WHEN);
        let Err(Fault::FrameSize { needed: [3, 2], got: [4, 2], .. }) = wrong else { panic!("{wrong:?}") };
        assert!(matches!(intake.torn(9, "2 packets are missing"), Fault::FrameContent { id: 2, .. }));
        assert_eq!(admit(&mut intake, 10), Ok(3));
        // A gap before a torn frame is told as well as the frame.
        let gap = intake.torn(13, "1 packet is missing");
        assert!(matches!(gap, Fault::DroppedFrames { count: 2, next_id: 6, .. }), "{gap}");
        assert!(matches!(intake.take_pending(), Some(Err(Fault::FrameContent { id: 6, .. }))));
        assert_eq!(intake.counts(), FrameCounts { received: 2, dropped: 2, duplicated: 0, unusable: 3 });
    }
}
