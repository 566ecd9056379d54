//! From a sweep's events to what is recorded: frames with their numbers, what was lost, and in what state the mirror was.
//!
//! In a stepped sweep the exposures are ours to pace, so nothing need be lost: a frame that was dropped, torn or late is exposed again, and
//! a recorder that falls behind is waited for. In a continuous one the camera runs by itself: what it drops, and what the recorder can't
//! take, is lost and counted.

use crate::pipeline::record::session::{Feed, Missing, Refused, Shot, unsigned};
use crate::pipeline::record::steer::Steering;
use crate::pipeline::record::tally::Loss;
use std::ops::ControlFlow;
use std::time::Duration;
use uw_hw::interlock::Handle;
use uw_hw::sweep::{Aim, Continuous, Event, Exposed, StepAndSettle, continuous, step_and_settle};
use uw_hw::{Camera, Fault, StepWatch};
use uw_io::recording::{GalvoState, Level};

/// Why acquisition ended before its plan did.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Ended {
    /// A device failed, or the interlock had stopped.
    #[error(transparent)]
    Fault(#[from] Fault),
    /// The recording could not go on; its own error says why.
    #[error("the recording could not go on")]
    Recording,
    /// The recorder took nothing for too long.
    #[error("the disk took nothing for {:.0} s: the scan was given up", (STALL * STALLS).as_secs_f64())]
    Stalled,
    /// The disk has less room than is to be left there.
    #[error(
        "the disk has {:.0} MB free, less than the {:.0} MB that disk.min_free_mb of the vehicle file leaves there: free some space",
        *free_bytes as f64 * 1e-6, *needed_bytes as f64 * 1e-6
    )]
    NoRoom {
        /// Bytes that are free.
        free_bytes: u64,
        /// Bytes that have to be.
        needed_bytes: u64,
    },
}

/// Longest that a triggered exposure waits for the recorder before the watchdog is fed. The mirror rests meanwhile.
pub(crate) const STALL: Duration = Duration::from_millis(500);
/// How many such waits there may be in a row.
pub(crate) const STALLS: u32 = 60;

impl From<Refused> for Ended {
    fn from(refused: Refused) -> Self {
        match refused {
            Refused::Failed => Self::Recording,
            Refused::Stalled => Self::Stalled,
            Refused::NoRoom { free_bytes, needed_bytes } => Self::NoRoom { free_bytes, needed_bytes },
        }
    }
}

/// Drives an instrument, and feeds what comes of it.
pub struct Acquisition<'a> {
    handle: &'a Handle,
    camera: &'a mut dyn Camera,
    clock: StepWatch,
    next: u32,
}

impl<'a> Acquisition<'a> {
    /// With a camera that is armed; its first image gets `number`.
    pub fn new(handle: &'a Handle, camera: &'a mut dyn Camera, number: u32) -> Self {
        Self { handle, camera, clock: StepWatch::new(handle.timeline().clone()), next: number }
    }

    /// The number of the next image.
    pub fn next_number(&self) -> u32 {
        self.next
    }

    /// Steps through positions; the images show placement `pose` of the target, or `None` in a scan.
    ///
    /// # Errors
    /// [`Ended`].
    pub fn step(
        &mut self,
        aims: impl IntoIterator<Item = Aim>,
        settings: &StepAndSettle,
        pose: Option<u32>,
        feed: &mut Feed<'_>,
    ) -> Result<(), Ended> {
        let Self { handle, camera, clock, next } = self;
        let mut refused = None;
        let mut lit = false;
        let observer = feed.observer();
        let tally = feed.tally();
        let aims = aims.into_iter().inspect(|aim| {
            if let Some(steering) = observer.steering().filter(|steering| steering.is_held()) {
                steering.wait(handle, observer, tally, &mut || {});
                if lit && handle.reason().is_none() {
                    // A fault stops the interlock, which is seen before the exposure.
                    let _ = handle.laser_on();
                }
            }
            lit = aim.laser_on;
        });
        let each = |event| {
            let taken = match event {
                Event::Exposed(exposed) => take(exposed, pose, handle, clock, next, feed),
                Event::Lost { fault: fault @ Fault::DuplicateFrame { .. }, .. } => {
                    again(&fault, handle, feed)
                }
                // What was dropped before a frame that came is known already: it was waited for, and exposed again.
                Event::Lost { fault: Fault::DroppedFrames { .. }, .. } => Ok(()),
                Event::Lost { fault, .. } => {
                    feed.tally().repeated();
                    feed.log(Level::Warning, format!("exposed again: {fault}"), now(handle))
                }
            };
            flow(taken, &mut refused)
        };
        let swept = step_and_settle(handle, *camera, aims, settings, each);
        match refused {
            Some(refused) => Err(refused),
            None => self.judge(swept, feed),
        }
    }

    /// Sweeps without stopping; where it is held, the rest of the way follows later, from the last image on.
    ///
    /// # Errors
    /// [`Ended`].
    pub fn ride(&mut self, settings: &Continuous, feed: &mut Feed<'_>) -> Result<(), Ended> {
        let mut rest = *settings;
        while let Some(from_v) = self.stretch(&rest, feed)? {
            let (observer, camera) = (feed.observer(), &mut self.camera);
            if let Some(steering) = observer.steering() {
                // It runs by itself: what it shows meanwhile is not wanted, and must not pile up.
                let mut empty = || while camera.next_frame(Duration::ZERO).is_ok() {};
                steering.wait(self.handle, observer, feed.tally(), &mut empty);
            }
            rest.from_v = from_v;
        }
        Ok(())
    }

    /// Sweeps to the end, or until it is held: then the voltage of the last image.
    fn stretch(&mut self, settings: &Continuous, feed: &mut Feed<'_>) -> Result<Option<f64>, Ended> {
        let Self { handle, camera, clock, next } = self;
        let mut refused = None;
        let mut held_v = None;
        let observer = feed.observer();
        let each = |event| {
            let taken = match event {
                Event::Exposed(exposed) => {
                    let volts = exposed.volts;
                    let taken = take(exposed, None, handle, clock, next, feed);
                    if taken.is_ok() && observer.steering().is_some_and(Steering::is_held) {
                        held_v = Some(volts);
                        return ControlFlow::Break(());
                    }
                    taken
                }
                Event::Lost { fault: fault @ Fault::DuplicateFrame { .. }, .. } => {
                    again(&fault, handle, feed)
                }
                Event::Lost { commanded_v, fault } => {
                    let (why, count) = match fault {
                        Fault::DroppedFrames { count, .. } => (Loss::CameraDropped, count),
                        _ => (Loss::Unusable, 1),
                    };
                    let at_ns = now(handle);
                    let one =
                        |number| Missing { number, laser_on: true, voltage_v: Some(commanded_v), why, at_ns };
                    let from = *next;
                    *next = next.saturating_add(u32::try_from(count).unwrap_or(u32::MAX));
                    (from..*next).try_for_each(|number| feed.missing(one(number)))
                }
            };
            flow(taken, &mut refused)
        };
        let swept = continuous(handle, *camera, settings, each);
        match refused {
            Some(refused) => Err(refused),
            None => self.judge(swept, feed).map(|()| held_v),
        }
    }

    /// Waits until something is so.
    ///
    /// # Errors
    /// [`Ended`] where the interlock has stopped.
    pub fn wait(&self, until: impl Fn() -> bool) -> Result<(), Ended> {
        while !until() {
            if let Some(reason) = self.handle.reason() {
                return Err(Fault::Stopped { reason: reason.to_string() }.into());
            }
            self.handle.feed();
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    }

    /// What a sweep's end means; a fault is logged.
    fn judge(&self, swept: Result<(), Fault>, feed: &mut Feed<'_>) -> Result<(), Ended> {
        let Err(fault) = swept else { return Ok(()) };
        let why = match &fault {
            Fault::FrameContent { .. } | Fault::FrameSize { .. } => Some(Loss::Unusable),
            Fault::Timeout { .. } if self.handle.reason().is_none() => Some(Loss::CameraSilent),
            _ => None,
        };
        // An exposure that was made and has no image is one that was not merely not reached.
        feed.tally().lost(why.unwrap_or(Loss::NotReached), usize::from(why.is_some()));
        feed.log(Level::Error, fault.to_string(), now(self.handle))?;
        Err(fault.into())
    }
}

fn now(handle: &Handle) -> i64 {
    handle.timeline().stamp_ns()
}

/// Goes on, or ends the sweep and keeps why.
fn flow(taken: Result<(), Refused>, refused: &mut Option<Ended>) -> ControlFlow<()> {
    match taken {
        Ok(()) => ControlFlow::Continue(()),
        Err(why) => {
            *refused = Some(why.into());
            ControlFlow::Break(())
        }
    }
}

/// Has the recording say what was asked of the scan.
pub(crate) fn tell_asked(feed: &mut Feed<'_>, handle: &Handle) -> Result<(), Refused> {
    let asked = feed.observer().steering().map(Steering::take_asked).unwrap_or_default();
    asked.into_iter().try_for_each(|(level, text)| feed.log(level, text, now(handle)))
}

fn again(fault: &Fault, handle: &Handle, feed: &mut Feed<'_>) -> Result<(), Refused> {
    feed.tally().duplicated();
    feed.log(Level::Info, fault.to_string(), now(handle))
}

fn take(
    exposed: Exposed,
    pose: Option<u32>,
    handle: &Handle,
    clock: &mut StepWatch,
    next: &mut u32,
    feed: &mut Feed<'_>,
) -> Result<(), Refused> {
    let Exposed { commanded_v, volts, settled, laser_on, frame } = exposed;
    if let Some(step) = clock.check() {
        let text = Fault::ClockStepped { by_ns: step.by_ns }.to_string();
        feed.log(Level::Warning, text, now(handle))?;
    }
    tell_asked(feed, handle)?;
    let number = *next;
    *next += 1;
    feed.galvo(GalvoState {
        stamp_ns: unsigned(frame.exposure().middle_ns()),
        frame: Some(number),
        commanded_v: Some(commanded_v),
        readback_v: Some(volts),
        settled: Some(settled),
    })?;
    let voltage_v = laser_on.then_some(volts);
    feed.shot(Shot { number, pose, laser_on, voltage_v, frame }, &|| handle.feed())
}
