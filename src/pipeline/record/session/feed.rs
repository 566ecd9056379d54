//! What acquisition hands on, and what becomes of it where the queues are full.

use super::Observer;
use super::room::Short;
use crate::pipeline::record::live::Traced;
use crate::pipeline::record::tally::{Loss, Tally};
use crossbeam_channel::{SendTimeoutError, Sender, TrySendError};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use uw_hw::{Frame, Timeline};
use uw_io::recording::{GalvoState, Level};

/// Small entries that may wait for room in the queue.
const MOST_OWED: usize = 100_000;

/// One exposure, as acquisition hands it on.
#[derive(Clone, Debug)]
pub struct Shot {
    /// From 0, one more an exposure that is wanted, lost or not: the `frame` of its points.
    pub number: u32,
    /// Which placement of the target it shows; `None` in a scan.
    pub pose: Option<u32>,
    /// Whether the laser was on.
    pub laser_on: bool,
    /// The galvanometer's voltage in the middle of the exposure; `None` where the laser was off.
    pub voltage_v: Option<f64>,
    /// The image.
    pub frame: Frame,
}

/// An exposure that was wanted and has no image.
#[derive(Clone, Debug)]
pub struct Missing {
    /// As [`Shot::number`].
    pub number: u32,
    /// Whether the laser was on.
    pub laser_on: bool,
    /// The galvanometer's voltage as commanded; `None` where the laser was off.
    pub voltage_v: Option<f64>,
    /// Why.
    pub why: Loss,
    /// When, nanoseconds since the Unix epoch.
    pub at_ns: i64,
}

/// What waits for the recorder.
pub(super) enum Entry {
    Shot(Shot),
    Missing(Missing),
    Galvo(GalvoState),
    Traced(Box<Traced>),
    Log(Level, String, i64),
}

/// What acquisition does where the recorder's queue is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pressure {
    /// Wait, and give the scan up in the end: for exposures that we trigger.
    Wait {
        /// How long, before whoever waits shows that it is alive.
        each: Duration,
        /// How often.
        times: u32,
    },
    /// Lose the frame, and count it: for a camera that runs by itself.
    Lose,
}

/// The recording can't go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// The recorder failed; its error comes with the session's end.
    Failed,
    /// The recorder took nothing for as long as [`Pressure::Wait`] says.
    Stalled,
    /// The disk has less room than it is to have; all until now is recorded.
    NoRoom {
        /// Bytes that are free.
        free_bytes: u64,
        /// Bytes that have to be.
        needed_bytes: u64,
    },
}

/// The queue to extraction.
pub(super) struct Offers {
    pub(super) queue: Sender<Shot>,
    /// Whether extraction is waited for.
    pub(super) every: bool,
    /// Frames that it took.
    pub(super) handed: usize,
}

impl Offers {
    fn offer(&mut self, shot: Shot) -> bool {
        let taken =
            if self.every { self.queue.send(shot).is_ok() } else { self.queue.try_send(shot).is_ok() };
        self.handed += usize::from(taken);
        taken
    }
}

/// Where acquisition puts what it got.
pub struct Feed<'s> {
    pub(super) tally: &'s Tally,
    pub(super) observer: &'s dyn Observer,
    pub(super) timeline: &'s Timeline,
    pub(super) pressure: Pressure,
    pub(super) record: Sender<Entry>,
    pub(super) preview: Option<Offers>,
    pub(super) failed: &'s AtomicBool,
    pub(super) short: &'s Short,
    /// Told of with the next entry for which there is room: what there was no room for.
    pub(super) owed: VecDeque<Entry>,
}

impl<'s> Feed<'s> {
    /// The scan's counts.
    pub fn tally(&self) -> &'s Tally {
        self.tally
    }

    /// Who is told.
    pub(crate) fn observer(&self) -> &'s dyn Observer {
        self.observer
    }

    /// The scan's clock.
    pub fn timeline(&self) -> &Timeline {
        self.timeline
    }

    /// Hands a frame on to the recorder and, if it is free, to extraction; `waiting` is called each time that
    /// [`Pressure::Wait`] has passed.
    ///
    /// # Errors
    /// [`Refused`]: nothing more will be recorded.
    pub fn shot(&mut self, shot: Shot, waiting: &dyn Fn()) -> Result<(), Refused> {
        self.tally.acquired();
        self.observer.exposed(&shot);
        let preview = (shot.laser_on && self.preview.is_some()).then(|| shot.clone());
        let missing = Missing {
            number: shot.number,
            laser_on: shot.laser_on,
            voltage_v: shot.voltage_v,
            why: Loss::RecorderBehind,
            at_ns: shot.frame.exposure().received_ns,
        };
        match self.put(Entry::Shot(shot), waiting) {
            Ok(true) => {
                if let (Some(shot), Some(queue)) = (preview, &mut self.preview)
                    && !queue.offer(shot)
                {
                    self.tally.skipped();
                }
                // Only now: this frame is in.
                self.short.check(self.record.len())
            }
            Ok(false) => self.missing(missing),
            Err(Refused::Stalled) => {
                self.tally.lost(Loss::RecorderBehind, 1);
                Err(Refused::Stalled)
            }
            Err(refused) => {
                self.tally.lost(Loss::RecorderFailed, 1);
                Err(refused)
            }
        }
    }

    /// Whether points of all that was handed on are made.
    pub fn previewed(&self) -> bool {
        self.preview.as_ref().is_none_or(|queue| queue.handed == self.tally.through())
    }

    /// Tells that an exposure has no image.
    ///
    /// # Errors
    /// As [`Feed::shot`].
    pub fn missing(&mut self, missing: Missing) -> Result<(), Refused> {
        self.tally.lost(missing.why, 1);
        let text = match missing.voltage_v {
            Some(volts) => {
                format!("frame {} at {volts:.4} V is lost: {}", missing.number, missing.why.name())
            }
            None => format!("frame {} is lost: {}", missing.number, missing.why.name()),
        };
        let at_ns = missing.at_ns;
        self.owe(Entry::Missing(missing))?;
        self.log(Level::Error, text, at_ns)
    }

    /// Hands on what the galvanometer said.
    ///
    /// # Errors
    /// As [`Feed::shot`].
    pub fn galvo(&mut self, state: GalvoState) -> Result<(), Refused> {
        self.owe(Entry::Galvo(state))
    }

    /// Hands on a line for people.
    ///
    /// # Errors
    /// As [`Feed::shot`].
    pub fn log(&mut self, level: Level, text: String, at_ns: i64) -> Result<(), Refused> {
        self.owe(Entry::Log(level, text, at_ns))
    }

    /// Whether the recorder is still there.
    ///
    /// # Errors
    /// [`Refused::Failed`] where it is not.
    pub fn check(&self) -> Result<(), Refused> {
        if self.failed.load(Ordering::Acquire) { Err(Refused::Failed) } else { Ok(()) }
    }

    /// Puts what is small, now or with the next entry for which there is room.
    fn owe(&mut self, entry: Entry) -> Result<(), Refused> {
        self.check()?;
        if self.owed.len() > MOST_OWED {
            return Err(Refused::Stalled);
        }
        self.owed.push_back(entry);
        self.pay()
    }

    /// Sends what is owed, as far as there is room.
    fn pay(&mut self) -> Result<(), Refused> {
        self.tally.queued(self.record.len());
        while let Some(entry) = self.owed.pop_front() {
            match self.record.try_send(entry) {
                Ok(()) => {}
                Err(TrySendError::Full(entry)) => {
                    self.owed.push_front(entry);
                    return Ok(());
                }
                Err(TrySendError::Disconnected(_)) => return Err(Refused::Failed),
            }
        }
        Ok(())
    }

    /// Sends an entry after all that is owed; false where there is no room for it and none is waited for.
    fn put(&mut self, entry: Entry, waiting: &dyn Fn()) -> Result<bool, Refused> {
        self.check()?;
        self.pay()?;
        self.owed.push_back(entry);
        let Pressure::Wait { each, times } = self.pressure else {
            self.pay()?;
            // The last one is the one: it is lost, what was owed before it is not.
            return Ok(self.owed.is_empty() || self.owed.pop_back().is_none());
        };
        let mut waits = 0;
        while let Some(first) = self.owed.pop_front() {
            match self.record.send_timeout(first, each) {
                Ok(()) => {}
                Err(SendTimeoutError::Disconnected(_)) => return Err(Refused::Failed),
                Err(SendTimeoutError::Timeout(_)) if waits == times => return Err(Refused::Stalled),
                Err(SendTimeoutError::Timeout(first)) => {
                    self.owed.push_front(first);
                    self.check()?;
                    waits += 1;
                    waiting();
                }
            }
        }
        Ok(true)
    }
}
