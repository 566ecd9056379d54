//! Voltage range and slew, enforced in one place.
//!
//! [`Galvo::set`] takes an [`AllowedVolts`], and only [`GuardedGalvo`] makes one: whatever implements the trait
//! can be driven in no other way.

use std::time::Duration;

use crate::{Fault, Galvo, Identity, Moved, ReadBack, Timeline, clock::Deadline};

/// A voltage that the limits allow; made by [`GuardedGalvo`] only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AllowedVolts(f64);

impl AllowedVolts {
    /// The voltage.
    pub fn volts(self) -> f64 {
        self.0
    }
}

/// How a large move is cut up: a command each so often.
const RAMP_EVERY: Duration = Duration::from_millis(5);

/// Within what a mirror may be driven.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    range_v: [f64; 2],
    slew_v_per_s: f64,
    follow_v: f64,
}

impl Limits {
    /// Limits: lowest and highest voltage; the fastest change, V/s; how far the read-back may be from the command once the mirror has
    /// settled, V.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn new(range_v: [f64; 2], slew_v_per_s: f64, follow_v: f64) -> Result<Self, String> {
        let [low, high] = range_v;
        if !(low.is_finite() && high.is_finite() && low < high) {
            return Err(format!("[{low}, {high}] V is no range: the lower voltage first, both finite"));
        }
        for (name, value) in [("slew in V/s", slew_v_per_s), ("tolerance of the read-back in V", follow_v)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(format!("{value} is no {name}: a positive number is needed"));
            }
        }
        Ok(Self { range_v, slew_v_per_s, follow_v })
    }

    /// Lowest and highest voltage.
    pub fn range_v(&self) -> [f64; 2] {
        self.range_v
    }

    /// The fastest change, V/s.
    pub fn slew_v_per_s(&self) -> f64 {
        self.slew_v_per_s
    }

    /// How far the read-back may be from the command once the mirror has settled, V.
    pub fn follow_v(&self) -> f64 {
        self.follow_v
    }

    /// The largest change that one command makes, V.
    pub fn largest_step_v(&self) -> f64 {
        self.slew_v_per_s * RAMP_EVERY.as_secs_f64()
    }

    fn allow(&self, device: &dyn Galvo, volts: f64) -> Result<AllowedVolts, Fault> {
        let [low, high] = self.range_v;
        if (low..=high).contains(&volts) {
            return Ok(AllowedVolts(volts));
        }
        Err(Fault::OutOfRange {
            device: name(&device.identity()),
            quantity: "voltage",
            unit: "V",
            value: volts,
            allowed: self.range_v,
        })
    }
}

/// A galvanometer that is driven within its limits: the only way to drive one.
pub struct GuardedGalvo {
    galvo: Box<dyn Galvo>,
    limits: Limits,
    timeline: Timeline,
    /// The last voltage that the drive was sent to or read at, and when it may be sent further.
    at: Option<(f64, Deadline)>,
}

impl std::fmt::Debug for GuardedGalvo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { galvo, limits, at, .. } = self;
        f.debug_struct("GuardedGalvo")
            .field("galvo", &galvo.identity())
            .field("limits", limits)
            .field("at", at)
            .finish()
    }
}

impl GuardedGalvo {
    /// A galvanometer within limits.
    pub fn new(galvo: Box<dyn Galvo>, limits: Limits, timeline: Timeline) -> Self {
        Self { galvo, limits, timeline, at: None }
    }

    /// The limits.
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// Who it is.
    pub fn identity(&self) -> Identity {
        self.galvo.identity()
    }

    /// As [`Galvo::settle_time`].
    pub fn settle_time(&self) -> Duration {
        self.galvo.settle_time()
    }

    /// The timeline of its stamps.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    /// Where the drive says that the mirror is, V.
    ///
    /// # Errors
    /// The drive's [`Fault`].
    pub fn read_back(&mut self, within: Duration) -> Result<ReadBack, Fault> {
        self.galvo.read_back(within)
    }

    /// Sends the mirror to a voltage, in as many commands as the slew needs, and comes back once the last was acknowledged. `within` is
    /// for each command; a large move takes as long as the slew makes it.
    ///
    /// # Errors
    /// [`Fault::OutOfRange`] before anything is sent; the drive's own.
    pub fn set(&mut self, volts: f64, within: Duration) -> Result<Moved, Fault> {
        let target = self.limits.allow(self.galvo.as_ref(), volts)?;
        loop {
            let from = match self.at {
                Some((from, free)) => {
                    self.timeline.sleep(self.timeline.left(free).unwrap_or_default());
                    from
                }
                // Where the mirror is before the first command only the drive knows.
                None => self.galvo.read_back(within)?.volts,
            };
            let change = target.0 - from;
            let largest = self.limits.largest_step_v();
            let [low, high] = self.limits.range_v;
            let last = change.abs() <= largest || !from.is_finite();
            let next = if last {
                target
            } else {
                // A drive that starts outside the range comes in by its edge.
                AllowedVolts((from + largest.copysign(change)).clamp(low, high))
            };
            let took = Duration::from_secs_f64((next.0 - from).abs().min(largest) / self.limits.slew_v_per_s);
            // Held even where the command fails: it may have arrived.
            self.at = Some((next.0, self.timeline.deadline(took)));
            let moved = self.galvo.set(next, within)?;
            if last {
                return Ok(moved);
            }
        }
    }

    /// The read-back, once it is where the mirror was last sent.
    ///
    /// # Errors
    /// [`Fault::NotFollowing`] where it is elsewhere; the drive's own.
    pub fn confirm(&mut self, within: Duration) -> Result<ReadBack, Fault> {
        let read = self.galvo.read_back(within)?;
        let near = |volts: f64| (read.volts - volts).abs() <= self.limits.follow_v;
        match self.at {
            // Not "farther": a read-back that is no number is nowhere near.
            Some((commanded_v, _)) if !near(commanded_v) => Err(Fault::NotFollowing {
                device: name(&self.identity()),
                commanded_v,
                read_back_v: read.volts,
                tolerance_v: self.limits.follow_v,
            }),
            _ => Ok(read),
        }
    }
}

/// A device as messages name it.
pub(crate) fn name(identity: &Identity) -> String {
    let Identity { driver, place, model, .. } = identity;
    let what = if model.is_empty() { driver } else { model };
    if place.is_empty() { what.clone() } else { format!("{what} at {place}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        ManualClock,
        mock::{Bench, Calls, Device, Event, Mock, MockFault},
    };

    const WITHIN: Duration = Duration::from_millis(50);
    /// Rounding of a sum of a few hundred steps, V.
    const ROUNDING_V: f64 = 1e-9;

    fn guarded(bench: Bench) -> (Mock, GuardedGalvo) {
        let timeline = Timeline::new(ManualClock::starting_at(0));
        let mock = Mock::with(timeline.clone(), bench);
        let limits = Limits::new([-2.0, 3.0], 10.0, 0.01).unwrap();
        let galvo = GuardedGalvo::new(Box::new(mock.galvo()), limits, timeline);
        (mock, galvo)
    }

    fn sent(mock: &Mock) -> Vec<(i64, f64)> {
        let volts = |(at, event)| match event {
            Event::Sent(volts) => Some((at, volts)),
            _ => None,
        };
        mock.events().into_iter().filter_map(volts).collect()
    }

    #[test]
    fn nothing_outside_the_range_is_sent() {
        let (mock, mut galvo) = guarded(Bench::default());
        for volts in [-2.000_001, 3.000_001, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let fault = galvo.set(volts, WITHIN).unwrap_err();
            assert!(matches!(fault, Fault::OutOfRange { allowed: [-2.0, 3.0], .. }), "{fault}");
        }
        assert_eq!(sent(&mock), []);
        assert!(galvo.set(3.0, WITHIN).is_ok_and(|moved| (moved.read_back.volts - 3.0).abs() < ROUNDING_V));
    }

    #[test]
    fn no_way_across_the_range_is_faster_than_the_slew() {
        let (mock, mut galvo) = guarded(Bench::default());
        for volts in [3.0, -2.0, -1.99, 0.7, 0.7, -2.0] {
            assert_eq!(galvo.set(volts, WITHIN).map(|moved| moved.commanded_v), Ok(volts));
        }
        let sent = sent(&mock);
        assert!(sent.len() > 200, "ramps are cut up: {}", sent.len());
        let largest = galvo.limits().largest_step_v();
        for from in 0..sent.len() {
            for to in from + 1..sent.len() {
                let seconds = (sent[to].0 - sent[from].0) as f64 * 1e-9;
                let change = (sent[to].1 - sent[from].1).abs();
                assert!(change <= 10.0 * seconds + largest + ROUNDING_V, "{from} to {to}: {change} V");
            }
        }
    }

    #[test]
    fn a_mirror_found_outside_the_range_comes_in_by_its_edge() {
        let (mock, mut wide) = guarded(Bench::default());
        wide.limits.range_v = [-9.0, 9.0];
        wide.set(8.0, WITHIN).unwrap();
        let before = sent(&mock).len();
        let limits = Limits::new([-2.0, 3.0], 10.0, 0.01).unwrap();
        let mut galvo = GuardedGalvo::new(Box::new(mock.galvo()), limits, wide.timeline.clone());
        galvo.set(0.0, WITHIN).unwrap();
        assert!(sent(&mock)[before..].iter().all(|(_, volts)| (-2.0..=3.0).contains(volts)));
        assert!(mock.volts().abs() < ROUNDING_V);
    }

    #[test]
    fn a_stuck_mirror_is_found_and_one_under_way_is_let_come() {
        let slow = Bench { time_constant: Duration::from_millis(2), ..Bench::default() };
        let (mock, mut galvo) = guarded(slow);
        galvo.set(0.05, WITHIN).unwrap();
        assert!(matches!(galvo.confirm(WITHIN), Err(Fault::NotFollowing { commanded_v: 0.05, .. })));
        galvo.timeline().sleep(Duration::from_millis(20));
        assert!(galvo.confirm(WITHIN).is_ok());
        mock.inject(Device::Galvo, MockFault::Stuck, Calls::from(0));
        galvo.set(0.1, WITHIN).unwrap();
        galvo.timeline().sleep(Duration::from_secs(1));
        let fault = galvo.confirm(WITHIN).unwrap_err();
        assert!(matches!(fault, Fault::NotFollowing { commanded_v: 0.1, tolerance_v: 0.01, .. }), "{fault}");
    }

    #[test]
    fn limits_that_are_none_are_refused() {
        for (range, slew, follow) in [
            ([1.0, 1.0], 1.0, 0.1),
            ([2.0, 1.0], 1.0, 0.1),
            ([f64::NAN, 1.0], 1.0, 0.1),
            ([0.0, 1.0], 0.0, 0.1),
            ([0.0, 1.0], f64::INFINITY, 0.1),
            ([0.0, 1.0], 1.0, -0.1),
        ] {
            assert!(Limits::new(range, slew, follow).is_err(), "{range:?} {slew} {follow}");
        }
    }
}
