//! The laser is off and the mirror parked on every way out.
//!
//! An [`Interlock`] owns laser and galvanometer, and everybody drives them through it. It stops once, for the first [`Reason`] there is:
//! laser off, read back, tried again until it is; then the mirror parked. After that the laser can't be switched on any more.
//!
//! | way out | noticed by |
//! |---|---|
//! | end of the scan | [`Interlock::finish`] |
//! | an error's `?`, a return | the interlock is dropped |
//! | panic | the interlock is dropped while unwinding (build with `panic = "unwind"`, the default) |
//! | SIGINT, SIGTERM | whoever catches signals calls [`Handle::stop`] from an ordinary thread |
//! | lost link, silence, a stuck mirror | any fault of laser or galvanometer that is not a refused value |
//! | a scan that hangs | nobody calls [`Handle::feed`] in time: the interlock's own thread stops it |
//!
//! What no program can: switch off after `kill -9` or a crash of the machine. Wire the laser's own interlock to the port's DTR line, which
//! falls when the port's owner is gone, or let the controller keep a watchdog.

mod report;
mod watch;

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use crate::{Fault, GuardedGalvo, Laser, Moved, ReadBack, Timeline};

pub use report::{Reason, Report};
use watch::Watch;

/// How the interlock does its work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Policy {
    /// Where the mirror is left, V.
    pub park_v: f64,
    /// What each call of a device may take.
    pub within: Duration,
    /// How long a scan may go without [`Handle::feed`]; `None` for no watchdog.
    pub watchdog: Option<Duration>,
    /// How often switching off is tried before it is given up.
    pub tries: u32,
    /// Between two tries.
    pub pause: Duration,
}

impl Default for Policy {
    fn default() -> Self {
        Self {
            park_v: 0.0,
            within: Duration::from_millis(250),
            watchdog: Some(Duration::from_secs(2)),
            tries: 5,
            pause: Duration::from_millis(20),
        }
    }
}

/// Told once, when the interlock has stopped: on the thread that stopped it.
type OnStop = Box<dyn Fn(&Report) + Send + Sync>;

struct Shared {
    laser: Mutex<Box<dyn Laser>>,
    galvo: Mutex<GuardedGalvo>,
    state: Mutex<State>,
    policy: Policy,
    timeline: Timeline,
    on_stop: OnStop,
}

struct State {
    reason: Option<Reason>,
    report: Option<Report>,
    fed: Duration,
}

/// Owns laser and galvanometer; stops when it is dropped.
pub struct Interlock {
    handle: Handle,
    _watch: Watch,
}

/// Drives what an [`Interlock`] owns, from any thread.
#[derive(Clone)]
pub struct Handle {
    shared: Arc<Shared>,
}

impl std::fmt::Debug for Interlock {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.handle.fmt(f)
    }
}

impl std::fmt::Debug for Handle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Interlock").field("stopped", &self.reason()).finish_non_exhaustive()
    }
}

impl Interlock {
    /// Takes over laser and galvanometer, and makes sure that the laser is off. `on_stop` is told when it has stopped, so that a laser
    /// that may still be on is never silent.
    ///
    /// # Errors
    /// The laser's [`Fault`], where it can't be switched off: nothing must be begun then.
    pub fn engage(
        laser: Box<dyn Laser>,
        galvo: GuardedGalvo,
        policy: Policy,
        on_stop: impl Fn(&Report) + Send + Sync + 'static,
    ) -> Result<Self, Fault> {
        let timeline = galvo.timeline().clone();
        let fed = timeline.since_start();
        let shared = Arc::new(Shared {
            laser: Mutex::new(laser),
            galvo: Mutex::new(galvo),
            state: Mutex::new(State { reason: None, report: None, fed }),
            policy,
            timeline,
            on_stop: Box::new(on_stop),
        });
        let handle = Handle { shared };
        let (off, _) = handle.switch_off();
        off?;
        let watch = Watch::start(&handle);
        Ok(Self { handle, _watch: watch })
    }

    /// Drives the instrument.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }

    /// Ends in order: laser off, mirror parked.
    pub fn finish(self) -> Report {
        self.handle.stop(Reason::Done)
    }
}

impl Drop for Interlock {
    fn drop(&mut self) {
        self.handle.stop(if std::thread::panicking() { Reason::Panic } else { Reason::Abandoned });
    }
}

impl Handle {
    /// Switches the laser on.
    ///
    /// # Errors
    /// [`Fault::Stopped`] once the interlock has stopped; the laser's own, which stops it.
    pub fn laser_on(&self) -> Result<(), Fault> {
        let mut laser = self.laser();
        // Asked under the laser's lock: who stops gives the reason first and takes this lock then, so that no switching on comes after.
        self.refuse_if_stopped()?;
        let done = laser.on(self.shared.policy.within);
        drop(laser);
        self.watch_fault(done)
    }

    /// Switches the laser off.
    ///
    /// # Errors
    /// The laser's [`Fault`], which stops the interlock.
    pub fn laser_off(&self) -> Result<(), Fault> {
        let done = self.laser().off(self.shared.policy.within);
        self.watch_fault(done)
    }

    /// Whether the laser says it is on.
    ///
    /// # Errors
    /// The laser's [`Fault`], which stops the interlock.
    pub fn laser_is_on(&self) -> Result<bool, Fault> {
        let on = self.laser().is_on(self.shared.policy.within);
        self.watch_fault(on)
    }

    /// Sets the laser's power as a fraction of the most it has, 0 to 1.
    ///
    /// # Errors
    /// As [`Laser::set_power`].
    pub fn set_power(&self, fraction: f64) -> Result<(), Fault> {
        let set = self.laser().set_power(fraction, self.shared.policy.within);
        self.watch_fault(set)
    }

    /// As [`GuardedGalvo::set`].
    ///
    /// # Errors
    /// [`Fault::Stopped`] once the interlock has stopped; the drive's own, which, a refused value aside, stops it.
    pub fn set(&self, volts: f64) -> Result<Moved, Fault> {
        let mut galvo = self.galvo();
        self.refuse_if_stopped()?;
        let moved = galvo.set(volts, self.shared.policy.within);
        drop(galvo);
        self.watch_fault(moved)
    }

    /// As [`GuardedGalvo::confirm`].
    ///
    /// # Errors
    /// As [`Handle::set`].
    pub fn confirm(&self) -> Result<ReadBack, Fault> {
        let read = self.galvo().confirm(self.shared.policy.within);
        self.watch_fault(read)
    }

    /// As [`GuardedGalvo::read_back`].
    ///
    /// # Errors
    /// As [`Handle::set`].
    pub fn read_back(&self) -> Result<ReadBack, Fault> {
        let read = self.galvo().read_back(self.shared.policy.within);
        self.watch_fault(read)
    }

    /// The limits of the galvanometer.
    pub fn limits(&self) -> crate::Limits {
        self.galvo().limits()
    }

    /// As [`Galvo::settle_time`](crate::Galvo::settle_time).
    pub fn settle_time(&self) -> Duration {
        self.galvo().settle_time()
    }

    /// The timeline of all stamps.
    pub fn timeline(&self) -> &Timeline {
        &self.shared.timeline
    }

    /// What each call of a device may take.
    pub fn within(&self) -> Duration {
        self.shared.policy.within
    }

    /// Says that the scan goes on: at least once in the watchdog's time.
    pub fn feed(&self) {
        self.state().fed = self.shared.timeline.since_start();
    }

    /// Why it has stopped; `None` as long as it hasn't.
    pub fn reason(&self) -> Option<Reason> {
        self.state().reason.clone()
    }

    /// Stops: laser off, then the mirror parked. A further call changes nothing, but tries again where the laser would not go off.
    pub fn stop(&self, reason: Reason) -> Report {
        {
            let mut state = self.state();
            if let Some(report) = &state.report
                && report.laser_off.is_ok()
            {
                return report.clone();
            }
            state.reason.get_or_insert(reason);
        }
        let (laser_off, tries) = self.switch_off();
        let parked = self.galvo().set(self.shared.policy.park_v, self.shared.policy.within);
        let mut state = self.state();
        let reason = state.reason.clone().unwrap_or(Reason::Abandoned);
        let report = Report { reason, laser_off, tries, parked: parked.map(|moved| moved.read_back.volts) };
        let news = state.report.as_ref() != Some(&report);
        state.report = Some(report.clone());
        drop(state);
        if news {
            (self.shared.on_stop)(&report);
        }
        report
    }

    /// Stops where nobody has fed the watchdog in time; called by the interlock's own thread, several times in that time.
    pub fn check_watchdog(&self) {
        let Some(watchdog) = self.shared.policy.watchdog else { return };
        let silent = {
            let state = self.state();
            if state.reason.is_some() {
                return;
            }
            self.shared.timeline.since_start().saturating_sub(state.fed)
        };
        if silent > watchdog {
            self.stop(Reason::Watchdog { silent });
        }
    }

    /// Switches off until the laser says so; how often it was tried.
    fn switch_off(&self) -> (Result<(), Fault>, u32) {
        let Policy { within, tries, pause, .. } = self.shared.policy;
        let mut tried = 0;
        loop {
            tried += 1;
            let mut laser = self.laser();
            let off = laser.off(within).and_then(|()| match laser.is_on(within) {
                Ok(false) | Err(Fault::Unsupported { .. }) => Ok(()),
                Ok(true) => Err(Fault::Refused {
                    device: crate::limits::name(&laser.identity()),
                    doing: "switching off".into(),
                    reason: "it acknowledges, but says that it is still on".into(),
                }),
                Err(fault) => Err(fault),
            });
            drop(laser);
            if off.is_ok() || tried >= tries.max(1) {
                return (off, tried);
            }
            self.shared.timeline.sleep(pause);
        }
    }

    fn refuse_if_stopped(&self) -> Result<(), Fault> {
        match self.reason() {
            Some(reason) => Err(Fault::Stopped { reason: reason.to_string() }),
            None => Ok(()),
        }
    }

    /// Stops for a fault of laser or galvanometer; a value that was refused before it was sent is none.
    fn watch_fault<T>(&self, done: Result<T, Fault>) -> Result<T, Fault> {
        match &done {
            Ok(_) | Err(Fault::OutOfRange { .. } | Fault::Unsupported { .. } | Fault::Stopped { .. }) => {}
            Err(lost @ Fault::Disconnected { .. }) => {
                self.stop(Reason::LinkLost(lost.to_string()));
            }
            Err(fault) => {
                self.stop(Reason::Fault(fault.to_string()));
            }
        }
        done
    }

    // A panic while one of these was held leaves a device in an unknown state, and the laser must go off all the same.
    fn laser(&self) -> MutexGuard<'_, Box<dyn Laser>> {
        self.shared.laser.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn galvo(&self) -> MutexGuard<'_, GuardedGalvo> {
        self.shared.galvo.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.shared.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
