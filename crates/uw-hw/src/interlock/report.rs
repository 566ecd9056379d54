//! Why the interlock stopped, and what came of it.

use std::{fmt, time::Duration};

use crate::Fault;

/// Why the interlock stopped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The scan is done.
    Done,
    /// The scan returned without an end: an error further up.
    Abandoned,
    /// The program panicked.
    Panic,
    /// A signal came.
    Signal(i32),
    /// A device's link is gone.
    LinkLost(String),
    /// A device did something else than it was asked.
    Fault(String),
    /// The scan hung.
    Watchdog {
        /// How long nothing was heard of it.
        silent: Duration,
    },
    /// Somebody wanted it, and says why.
    Asked(String),
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Done => f.write_str("the scan is done"),
            Self::Abandoned => f.write_str("the scan was abandoned"),
            Self::Panic => f.write_str("the program panicked"),
            Self::Signal(2) => f.write_str("SIGINT (Ctrl-C)"),
            Self::Signal(15) => f.write_str("SIGTERM"),
            Self::Signal(number) => write!(f, "signal {number}"),
            Self::LinkLost(what) | Self::Fault(what) | Self::Asked(what) => f.write_str(what),
            Self::Watchdog { silent } => {
                write!(f, "the scan hung: nothing was heard of it for {:.1} s", silent.as_secs_f64())
            }
        }
    }
}

/// What stopping did.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Why.
    pub reason: Reason,
    /// Whether the laser acknowledged that it is off, and says so when asked; where not, the last try's fault.
    pub laser_off: Result<(), Fault>,
    /// How often switching off was tried.
    pub tries: u32,
    /// Where the mirror was sent to rest, V, as read back.
    pub parked: Result<f64, Fault>,
}

impl Report {
    /// What must be said aloud, the worst first; nothing where all is safe.
    pub fn alarms(&self) -> Vec<String> {
        let laser = self.laser_off.as_ref().err().map(|fault| {
            format!("THE LASER MAY STILL BE ON: cut its power. Switched off {} times: {fault}", self.tries)
        });
        let mirror = self.parked.as_ref().err().map(|fault| format!("the mirror is not parked: {fault}"));
        laser.into_iter().chain(mirror).collect()
    }
}
