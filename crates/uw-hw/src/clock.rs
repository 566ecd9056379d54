//! Clocks that are given, not read: the system's, and one that a test moves.
//!
//! A wall clock may step, back too, when somebody sets it or a time server does. So stamps come from a [`Timeline`]: the wall clock
//! read once, and a clock that never goes back since. What the wall clock did in the meantime, a [`StepWatch`] tells.

use std::{
    fmt,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

/// Tells the time, and waits.
pub trait Clock: Send + Sync + fmt::Debug {
    /// Nanoseconds since the Unix epoch, as the machine has them now; may step.
    fn wall_ns(&self) -> i64;
    /// Time since some moment that stays the same as long as the clock lives; never goes back.
    fn monotonic(&self) -> Duration;
    /// Waits.
    fn sleep(&self, duration: Duration);
}

/// The machine's clocks.
#[derive(Debug)]
pub struct SystemClock {
    began: Instant,
}

impl Default for SystemClock {
    fn default() -> Self {
        Self { began: Instant::now() }
    }
}

impl Clock for SystemClock {
    fn wall_ns(&self) -> i64 {
        match SystemTime::now().duration_since(UNIX_EPOCH) {
            Ok(since) => nanoseconds(since),
            Err(before) => -nanoseconds(before.duration()),
        }
    }

    fn monotonic(&self) -> Duration {
        self.began.elapsed()
    }

    fn sleep(&self, duration: Duration) {
        std::thread::sleep(duration);
    }
}

/// A clock for tests: it stands still but for [`ManualClock::advance`], [`ManualClock::step_wall`] and whoever sleeps on it.
#[derive(Debug, Default)]
pub struct ManualClock {
    /// Monotonic time, and by how much the wall clock is off it.
    now: Mutex<(Duration, i64)>,
}

impl ManualClock {
    /// A clock whose wall time is `wall_ns` and whose monotonic time is zero.
    pub fn starting_at(wall_ns: i64) -> Arc<Self> {
        Arc::new(Self { now: Mutex::new((Duration::ZERO, wall_ns)) })
    }

    /// Lets time pass.
    pub fn advance(&self, by: Duration) {
        self.now.lock().unwrap_or_else(PoisonError::into_inner).0 += by;
    }

    /// Sets the wall clock forward, or back where `by_ns` is negative; monotonic time is not touched.
    pub fn step_wall(&self, by_ns: i64) {
        self.now.lock().unwrap_or_else(PoisonError::into_inner).1 += by_ns;
    }
}

impl Clock for ManualClock {
    fn wall_ns(&self) -> i64 {
        let (monotonic, wall) = *self.now.lock().unwrap_or_else(PoisonError::into_inner);
        wall.saturating_add(nanoseconds(monotonic))
    }

    fn monotonic(&self) -> Duration {
        self.now.lock().unwrap_or_else(PoisonError::into_inner).0
    }

    fn sleep(&self, duration: Duration) {
        self.advance(duration);
    }
}

/// Stamps that never go back: the wall clock at the start, and monotonic time since. Clones share the start, so stamps of all devices
/// of one instrument compare: give each the same timeline.
#[derive(Clone, Debug)]
pub struct Timeline {
    clock: Arc<dyn Clock>,
    wall_ns: i64,
    monotonic: Duration,
}

impl Timeline {
    /// A timeline that begins now.
    pub fn new(clock: Arc<dyn Clock>) -> Self {
        let (wall_ns, monotonic) = (clock.wall_ns(), clock.monotonic());
        Self { clock, wall_ns, monotonic }
    }

    /// A timeline on the machine's clocks.
    pub fn system() -> Self {
        Self::new(Arc::new(SystemClock::default()))
    }

    /// Nanoseconds since the Unix epoch; never smaller than an earlier stamp.
    pub fn stamp_ns(&self) -> i64 {
        self.wall_ns.saturating_add(nanoseconds(self.since_start()))
    }

    /// Time since the timeline's start.
    pub fn since_start(&self) -> Duration {
        self.clock.monotonic().saturating_sub(self.monotonic)
    }

    /// Waits.
    pub fn sleep(&self, duration: Duration) {
        if !duration.is_zero() {
            self.clock.sleep(duration);
        }
    }

    /// The moment that is `within` from now.
    pub fn deadline(&self, within: Duration) -> Deadline {
        Deadline { began: self.since_start(), within }
    }

    /// How long is left until a deadline of this timeline; `None` once it has passed.
    pub fn left(&self, deadline: Deadline) -> Option<Duration> {
        let left = deadline.began.saturating_add(deadline.within).saturating_sub(self.since_start());
        (!left.is_zero()).then_some(left)
    }

    /// How long has been waited for a deadline of this timeline.
    pub fn waited(&self, deadline: Deadline) -> Duration {
        self.since_start().saturating_sub(deadline.began)
    }

    /// The wall clock less the timeline: zero but for steps and drift since the start.
    pub fn drift_ns(&self) -> i64 {
        self.clock.wall_ns().saturating_sub(self.stamp_ns())
    }
}

/// A moment on a [`Timeline`] after which an answer is too late.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Deadline {
    began: Duration,
    within: Duration,
}

/// The wall clock went elsewhere than time did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockStep {
    /// By how much; negative where the clock went back.
    pub by_ns: i64,
}

/// Two clocks read one after the other differ by as long as the process was stopped in between, ns.
const STEP_LEAST_NS: i64 = 50_000_000;
/// What time servers turn a clock by without stepping it: 500 ppm at most (ntpd, chrony and adjtimex(2)).
const TURN_PPM: i64 = 500;

/// Notices steps of the wall clock.
#[derive(Debug)]
pub struct StepWatch {
    timeline: Timeline,
    checked: Duration,
    drift_ns: i64,
}

impl StepWatch {
    /// Watches from now on.
    pub fn new(timeline: Timeline) -> Self {
        let (checked, drift_ns) = (timeline.since_start(), timeline.drift_ns());
        Self { timeline, checked, drift_ns }
    }

    /// The step that the wall clock made since the last call; `None` where it made none (less than 50 ms, and what a time server
    /// turns a clock by at most).
    pub fn check(&mut self) -> Option<ClockStep> {
        let (now, drift_ns) = (self.timeline.since_start(), self.timeline.drift_ns());
        let turned_ns = nanoseconds(now.saturating_sub(self.checked)) / 1_000_000 * TURN_PPM;
        let by_ns = drift_ns.saturating_sub(self.drift_ns);
        (self.checked, self.drift_ns) = (now, drift_ns);
        (by_ns.saturating_abs() > STEP_LEAST_NS.saturating_add(turned_ns)).then_some(ClockStep { by_ns })
    }
}

/// A duration in nanoseconds; the largest number for what is longer than 292 years.
pub(crate) fn nanoseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const START_NS: i64 = 1_760_000_000_000_000_000;

    #[test]
    fn stamps_go_on_when_the_wall_clock_steps_back_and_the_step_is_told_once() {
        let clock = ManualClock::starting_at(START_NS);
        let timeline = Timeline::new(clock.clone());
        let mut watch = StepWatch::new(timeline.clone());
        clock.advance(Duration::from_secs(10));
        assert_eq!(watch.check(), None);
        clock.step_wall(-3_600_000_000_000);
        clock.advance(Duration::from_secs(1));
        assert_eq!(timeline.stamp_ns(), START_NS + 11_000_000_000);
        assert_eq!(watch.check(), Some(ClockStep { by_ns: -3_600_000_000_000 }));
        assert_eq!(watch.check(), None);
        clock.step_wall(80_000_000);
        assert_eq!(watch.check(), Some(ClockStep { by_ns: 80_000_000 }));
    }

    #[test]
    fn a_clock_that_a_time_server_turns_has_not_stepped() {
        let clock = ManualClock::starting_at(START_NS);
        let mut watch = StepWatch::new(Timeline::new(clock.clone()));
        clock.advance(Duration::from_secs(1000));
        clock.step_wall(-500_000_000);
        assert_eq!(watch.check(), None);
    }

    #[test]
    fn deadlines_pass_and_say_how_long_was_waited() {
        let clock = ManualClock::starting_at(0);
        let timeline = Timeline::new(clock.clone());
        let deadline = timeline.deadline(Duration::from_millis(20));
        clock.advance(Duration::from_millis(15));
        assert_eq!(timeline.left(deadline), Some(Duration::from_millis(5)));
        clock.advance(Duration::from_millis(5));
        assert_eq!(timeline.left(deadline), None);
        assert_eq!(timeline.waited(deadline), Duration::from_millis(20));
    }

    #[test]
    fn the_systems_clock_is_of_this_century_and_goes_on() {
        let timeline = Timeline::system();
        let first = timeline.stamp_ns();
        timeline.sleep(Duration::from_millis(2));
        assert!(first > 1_700_000_000_000_000_000);
        assert!(timeline.stamp_ns() >= first + 2_000_000);
        assert!(timeline.drift_ns().abs() < STEP_LEAST_NS);
    }
}
