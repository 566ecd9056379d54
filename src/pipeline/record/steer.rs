//! Steering a scan from other threads: held between two exposures, ended, the laser off.

use crate::pipeline::record::session::Observer;
use crate::pipeline::record::tally::Tally;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use uw_hw::interlock::{Handle, Reason, Report};
use uw_io::recording::Level;

/// How often a scan that is held looks whether it is to go on.
const LOOK: Duration = Duration::from_millis(2);

/// Where a scan is, for whoever watches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Frames come.
    Scanning,
    /// It is held: the laser is off, the mirror stays where it is.
    Held,
    /// Nothing is driven any more; the recording is finished, and the cloud made.
    Ending {
        /// Whether the laser went off.
        laser_off: bool,
    },
}

/// Steers one scan after another; a clone steers the same.
#[derive(Clone, Debug, Default)]
pub struct Steering {
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    /// What is driven now.
    handle: Option<Handle>,
    held: bool,
    /// What was asked, for the recording.
    asked: Vec<(Level, String)>,
    /// What the next scan's recording is to say first.
    next: Vec<(Level, String)>,
}

/// Why a scan can't be steered so.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SteerError {
    /// There is none.
    #[error("nothing is being scanned")]
    Nothing,
    /// It was asked to hold, and is held.
    #[error("the scan is held already")]
    Held,
    /// It was asked to go on, and does.
    #[error("the scan is not held")]
    NotHeld,
    /// It stops.
    #[error("the scan has stopped: {0}")]
    Stopped(String),
    /// The laser would not go off.
    #[error("{0}")]
    Alarm(String),
}

impl Steering {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Holds the scan before its next exposure, or after the one that is under way.
    ///
    /// # Errors
    /// [`SteerError`] where there is nothing to hold.
    pub fn hold(&self, who: &str) -> Result<(), SteerError> {
        self.set_held(true, SteerError::Held, format!("held, as {who} asked"))
    }

    /// Goes on where the scan was held.
    ///
    /// # Errors
    /// [`SteerError`] where it is not held.
    pub fn resume(&self, who: &str) -> Result<(), SteerError> {
        self.set_held(false, SteerError::NotHeld, format!("resumed, as {who} asked"))
    }

    fn set_held(&self, held: bool, already: SteerError, text: String) -> Result<(), SteerError> {
        let mut state = self.state();
        let handle = state.handle.as_ref().ok_or(SteerError::Nothing)?;
        if let Some(reason) = handle.reason() {
            return Err(SteerError::Stopped(reason.to_string()));
        }
        if state.held == held {
            return Err(already);
        }
        state.held = held;
        state.asked.push((Level::Info, text));
        Ok(())
    }

    /// Ends the scan, the laser off and the mirror parked when this returns; what was recorded is kept.
    ///
    /// # Errors
    /// [`SteerError::Nothing`] where nothing is scanned; [`SteerError::Alarm`] where the laser may still be on.
    pub fn stop(&self, who: &str) -> Result<(), SteerError> {
        self.end(Reason::Asked(format!("stopped, as {who} asked")))
    }

    /// As [`Steering::stop`], for the laser's sake: tried again where it would not go off before.
    ///
    /// # Errors
    /// As [`Steering::stop`].
    pub fn laser_off(&self, who: &str) -> Result<(), SteerError> {
        self.end(Reason::Asked(format!("laser switched off, as {who} asked")))
    }

    /// Stops what is driven, for a reason; false where nothing is.
    pub fn stop_for(&self, reason: Reason) -> bool {
        self.end(reason) != Err(SteerError::Nothing)
    }

    fn end(&self, reason: Reason) -> Result<(), SteerError> {
        let handle = {
            let mut state = self.state();
            let handle = state.handle.clone().ok_or(SteerError::Nothing)?;
            state.asked.push((Level::Warning, reason.to_string()));
            handle
        };
        // Without this lock: a laser that hangs keeps nobody from asking again.
        let report: Report = handle.stop(reason);
        match &report.laser_off {
            Ok(()) => Ok(()),
            Err(_) => Err(SteerError::Alarm(report.alarms().join("; "))),
        }
    }

    /// Has the log of the next scan begin with what it was made with, in place of what was said so before.
    pub fn say_next(&self, texts: impl IntoIterator<Item = String>) {
        self.state().next = texts.into_iter().map(|text| (Level::Info, text)).collect();
    }

    /// Steers what this drives, until [`Steering::detach`].
    pub(crate) fn attach(&self, handle: &Handle) {
        let mut state = self.state();
        let asked = std::mem::take(&mut state.next);
        *state = State { handle: Some(handle.clone()), asked, ..State::default() };
    }

    pub(crate) fn detach(&self) {
        self.state().handle = None;
    }

    pub(crate) fn is_held(&self) -> bool {
        self.state().held
    }

    /// What was asked since, for the recording.
    pub(crate) fn take_asked(&self) -> Vec<(Level, String)> {
        std::mem::take(&mut self.state().asked)
    }

    /// Puts the laser off, tells that the scan is held, and waits until it may go on or has stopped. `meanwhile` is called again and again.
    pub(crate) fn wait(
        &self,
        handle: &Handle,
        observer: &dyn Observer,
        tally: &Tally,
        meanwhile: &mut dyn FnMut(),
    ) {
        if handle.laser_off().is_err() {
            // It has stopped the interlock, which the sweep sees before its next exposure.
            return;
        }
        observer.phase(Phase::Held, tally);
        while self.is_held() && handle.reason().is_none() {
            handle.feed();
            meanwhile();
            std::thread::sleep(LOOK);
        }
        observer.phase(Phase::Scanning, tally);
    }
}
