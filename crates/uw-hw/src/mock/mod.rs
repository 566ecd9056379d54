//! Scripted devices for tests: a galvanometer, a laser and a camera that share one bench, and do wrong when they are told to.
//!
//! ```
//! use std::time::Duration;
//! use uw_hw::{Fault, GuardedGalvo, Limits, ManualClock, Timeline, mock::{Calls, Device, Mock, MockFault}};
//!
//! let timeline = Timeline::new(ManualClock::starting_at(0));
//! let mock = Mock::new(timeline.clone());
//! let mut galvo = GuardedGalvo::new(Box::new(mock.galvo()), Limits::new([-5.0, 5.0], 100.0, 0.01)?, timeline);
//! mock.inject(Device::Galvo, MockFault::Silent, Calls::from(1));
//! let within = Duration::from_millis(50);
//! assert_eq!(galvo.set(0.1, within).map(|moved| moved.commanded_v), Ok(0.1));
//! assert!(matches!(galvo.set(0.2, within), Err(Fault::Timeout { .. })));
//! # Ok::<(), String>(())
//! ```

mod camera;
mod drive;

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use crate::{Fault, Identity, Timeline};

pub use camera::{MockCamera, Shot};
pub use drive::{MockGalvo, MockLaser};

/// Which device of the bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Device {
    /// Its calls are counted by the moves that were asked for.
    Galvo,
    /// Its calls are counted by the switching that was asked for.
    Laser,
    /// Its calls are counted by the exposures.
    Camera,
}

/// What a device does instead of what is asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MockFault {
    /// Does nothing and says nothing.
    Silent,
    /// Does what is asked, and answers something else.
    WrongReply,
    /// Refuses.
    Refuses,
    /// Is no longer there, and stays away until [`Mock::mend`].
    Unplugged,
    /// Answers so much later: [`Fault::Timeout`] where that is more than the time allowed.
    Slow(Duration),
    /// The mirror stays where it is, though the move is acknowledged.
    Stuck,
    /// The laser acknowledges, and stays as it is.
    StaysAsItIs,
    /// The frame is lost, its id is not used again.
    Dropped,
    /// The frame comes twice.
    Duplicated,
    /// The frame has a column more.
    WrongSize,
    /// The frame has half its rows.
    Torn,
}

/// Which calls of a device a fault is about, counted from 0 at the bench's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Calls {
    from: u64,
    count: u64,
}

impl Calls {
    /// This call and all after it.
    pub fn from(call: u64) -> Self {
        Self { from: call, count: u64::MAX }
    }

    /// This call alone.
    pub fn only(call: u64) -> Self {
        Self { from: call, count: 1 }
    }

    /// So many calls from this one on.
    pub fn some(from: u64, count: u64) -> Self {
        Self { from, count }
    }

    fn covers(self, call: u64) -> bool {
        call.checked_sub(self.from).is_some_and(|after| after < self.count)
    }
}

/// What was done on the bench, in order, with its stamp.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The mirror was sent to a voltage.
    Sent(f64),
    /// The laser went on or off.
    Laser(bool),
    /// An exposure began.
    Exposed(u64),
}

/// How the bench behaves when nothing is wrong.
#[derive(Clone, Copy, Debug)]
pub struct Bench {
    /// Time constant of the mirror, which follows a step by 1 - exp(-t / constant).
    pub time_constant: Duration,
    /// How long a command takes to be acknowledged.
    pub latency: Duration,
    /// What [`Galvo::settle_time`](crate::Galvo::settle_time) says.
    pub settle_time: Duration,
    /// How long after its exposure a frame comes.
    pub readout: Duration,
    /// Frames that a camera holds when nobody takes them; older ones are dropped.
    pub buffers: u64,
}

impl Default for Bench {
    fn default() -> Self {
        Self {
            time_constant: Duration::ZERO,
            latency: Duration::ZERO,
            settle_time: Duration::ZERO,
            readout: Duration::ZERO,
            buffers: 64,
        }
    }
}

/// A move of the mirror: when, from where, where to.
#[derive(Clone, Copy, Debug)]
struct Leg {
    begin_ns: i64,
    from_v: f64,
    to_v: f64,
}

#[derive(Debug)]
struct State {
    bench: Bench,
    script: Vec<(Device, MockFault, Calls)>,
    calls: [u64; 3],
    legs: Vec<Leg>,
    laser_on: bool,
    power: f64,
    events: Vec<(i64, Event)>,
    log: bool,
}

/// Moves that are kept: a frame's middle is never older than this many.
const LEGS_KEPT: usize = 4096;

impl State {
    /// What is scripted for the call of a device that is being made.
    fn fault(&self, device: Device, call: u64) -> Option<MockFault> {
        let of = |(d, fault, calls): &(Device, MockFault, Calls)| {
            let gone = *fault == MockFault::Unplugged && call >= calls.from;
            (*d == device && (gone || calls.covers(call))).then_some(*fault)
        };
        self.script.iter().find_map(of)
    }

    /// The mirror's voltage at a stamp: first-order lag behind the moves.
    fn volts_at(&self, stamp_ns: i64) -> f64 {
        let after = self.legs.partition_point(|leg| leg.begin_ns <= stamp_ns);
        let Some(leg) = self.legs.get(after.saturating_sub(1)) else { return 0.0 };
        let constant_ns = self.bench.time_constant.as_nanos() as f64;
        let since_ns = (stamp_ns - leg.begin_ns).max(0) as f64;
        let left = if constant_ns > 0.0 { (-since_ns / constant_ns).exp() } else { 0.0 };
        leg.to_v + (leg.from_v - leg.to_v) * left
    }

    fn note(&mut self, stamp_ns: i64, event: Event) {
        if self.log {
            self.events.push((stamp_ns, event));
        }
    }
}

/// The bench that the mock devices stand on.
#[derive(Clone, Debug)]
pub struct Mock {
    state: Arc<Mutex<State>>,
    timeline: Timeline,
}

impl Mock {
    /// A bench whose mirror is at 0 V, whose laser is off, and on which everything is done at once.
    pub fn new(timeline: Timeline) -> Self {
        Self::with(timeline, Bench::default())
    }

    /// A bench of another behaviour.
    pub fn with(timeline: Timeline, bench: Bench) -> Self {
        let state = State {
            bench,
            script: Vec::new(),
            calls: [0; 3],
            legs: vec![Leg { begin_ns: i64::MIN / 2, from_v: 0.0, to_v: 0.0 }],
            laser_on: false,
            power: 1.0,
            events: Vec::new(),
            log: true,
        };
        Self { state: Arc::new(Mutex::new(state)), timeline }
    }

    /// Its galvanometer.
    pub fn galvo(&self) -> MockGalvo {
        MockGalvo::new(self.clone())
    }

    /// Its laser.
    pub fn laser(&self) -> MockLaser {
        MockLaser::new(self.clone())
    }

    /// Its camera; `image` makes the grey values of each exposure (width × height of the [`Shot`]).
    pub fn camera<P: Into<crate::Pixels>>(
        &self,
        mut image: impl FnMut(&Shot) -> P + Send + 'static,
    ) -> MockCamera {
        MockCamera::new(self.clone(), Box::new(move |shot| image(shot).into()))
    }

    /// Lets a device do wrong in some of its calls. Of several that cover one call the first injected counts.
    pub fn inject(&self, device: Device, fault: MockFault, calls: Calls) {
        self.lock().script.push((device, fault, calls));
    }

    /// Lets everything do right from now on; what was unplugged is plugged in again.
    pub fn mend(&self) {
        self.lock().script.clear();
    }

    /// How many calls of a device were made so far: the number of the next one.
    pub fn calls(&self, device: Device) -> u64 {
        self.lock().calls[device as usize]
    }

    /// Ends keeping [events](Self::events), for tests of many frames.
    pub fn keep_no_events(&self) {
        let mut state = self.lock();
        state.log = false;
        state.events = Vec::new();
    }

    /// Whether the laser is really on.
    pub fn laser_is_on(&self) -> bool {
        self.lock().laser_on
    }

    /// The laser's power, 0 to 1.
    pub fn power(&self) -> f64 {
        self.lock().power
    }

    /// Where the mirror really is, V.
    pub fn volts(&self) -> f64 {
        let now = self.timeline.stamp_ns();
        self.lock().volts_at(now)
    }

    /// What was done so far, with its stamp, ns.
    pub fn events(&self) -> Vec<(i64, Event)> {
        self.lock().events.clone()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts a call and gives what is scripted for it.
    fn call(&self, device: Device) -> (u64, Option<MockFault>) {
        let mut state = self.lock();
        let call = state.calls[device as usize];
        state.calls[device as usize] += 1;
        (call, state.fault(device, call))
    }

    /// What is scripted for a call that doesn't count.
    fn now(&self, device: Device) -> Option<MockFault> {
        let state = self.lock();
        state.fault(device, state.calls[device as usize])
    }

    /// Lets an answer take its time, and turns the faults that all devices have into what the caller sees.
    fn answer(
        &self,
        device: Device,
        fault: Option<MockFault>,
        doing: &str,
        within: Duration,
    ) -> Result<(), Fault> {
        let latency = self.lock().bench.latency;
        let (name, doing) = (identity(device).driver, doing.to_owned());
        let late = |mock: &Self, doing| {
            mock.timeline.sleep(within);
            Err(Fault::Timeout { device: name.clone(), doing, waited: within, got: String::new() })
        };
        match fault {
            Some(MockFault::Silent) => late(self, doing),
            Some(MockFault::Slow(by)) if by.saturating_add(latency) > within => late(self, doing),
            Some(MockFault::Unplugged) => {
                Err(Fault::Disconnected { device: name, doing, reason: "unplugged by the script".into() })
            }
            Some(MockFault::Refuses) => {
                Err(Fault::Refused { device: name, doing, reason: "refused by the script".into() })
            }
            Some(MockFault::WrongReply) => Err(Fault::Protocol {
                device: name,
                doing,
                needed: "an acknowledgement".into(),
                got: "BANANA".into(),
            }),
            Some(MockFault::Slow(by)) => {
                self.timeline.sleep(by.saturating_add(latency));
                Ok(())
            }
            _ if latency > within => late(self, doing),
            _ => {
                self.timeline.sleep(latency);
                Ok(())
            }
        }
    }
}

fn identity(device: Device) -> Identity {
    let driver = match device {
        Device::Galvo => "mock galvanometer",
        Device::Laser => "mock laser",
        Device::Camera => "mock camera",
    };
    Identity { driver: driver.into(), ..Identity::default() }
}
