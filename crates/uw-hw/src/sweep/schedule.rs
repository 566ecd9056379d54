//! Which voltages, in which order.

use std::sync::mpsc;

/// One position of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aim {
    /// Where the mirror goes, V.
    pub volts: f64,
    /// Whether the laser is on; off for a background image.
    pub laser_on: bool,
}

impl Aim {
    /// A position with the laser on.
    pub fn lit(volts: f64) -> Self {
        Self { volts, laser_on: true }
    }

    /// A position for a background image.
    pub fn dark(volts: f64) -> Self {
        Self { volts, laser_on: false }
    }
}

/// How close positions are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Spacing {
    /// This far apart, V; the last position is the end, and the step is rounded so that it is.
    Step(f64),
    /// So many, both ends included.
    Count(usize),
}

/// Why there is no schedule.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScheduleError {
    /// An end is no number.
    #[error("a sweep from {from_v} V to {to_v} V: both ends must be finite")]
    Ends {
        /// Start, V.
        from_v: f64,
        /// End, V.
        to_v: f64,
    },
    /// A step that leads nowhere.
    #[error("a step of {step_v} V: it must be positive, whichever way the sweep goes")]
    Step {
        /// The step, V.
        step_v: f64,
    },
    /// No position, or more than a sweep has.
    #[error("{count} positions: a sweep has 1 to {most}")]
    Count {
        /// How many there would be.
        count: f64,
        /// How many there may be.
        most: usize,
    },
}

/// More positions than any drive resolves (18 bits).
const MOST: usize = 1 << 18;
/// A span that is so near to a whole number of steps is meant to be one.
const WHOLE_STEPS: f64 = 1e-6;

/// The voltages of a sweep in their order.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    volts: Vec<f64>,
}

impl Schedule {
    /// From one voltage to another, upwards or downwards, both included.
    ///
    /// # Errors
    /// [`ScheduleError`].
    pub fn new(from_v: f64, to_v: f64, spacing: Spacing) -> Result<Self, ScheduleError> {
        if !(from_v.is_finite() && to_v.is_finite()) {
            return Err(ScheduleError::Ends { from_v, to_v });
        }
        let span = to_v - from_v;
        let count = match spacing {
            Spacing::Count(count) => count as f64,
            Spacing::Step(step_v) if step_v.is_finite() && step_v > 0.0 => {
                let steps = span.abs() / step_v;
                (if (steps - steps.round()).abs() < WHOLE_STEPS { steps.round() } else { steps.ceil() }) + 1.0
            }
            Spacing::Step(step_v) => return Err(ScheduleError::Step { step_v }),
        };
        if !(1.0..=MOST as f64).contains(&count) {
            return Err(ScheduleError::Count { count, most: MOST });
        }
        let last = count as usize - 1;
        let at = |i: usize| {
            if i == last && last > 0 { to_v } else { from_v + span * (i as f64 / last.max(1) as f64) }
        };
        Ok(Self { volts: (0..=last).map(at).collect() })
    }

    /// Only the voltages from `low_v` to `high_v`.
    #[must_use]
    pub fn within(mut self, [low_v, high_v]: [f64; 2]) -> Self {
        self.volts.retain(|volts| (low_v..=high_v).contains(volts));
        self
    }

    /// The voltages.
    pub fn volts(&self) -> &[f64] {
        &self.volts
    }

    /// The positions: all lit, and before the first and after every `background` of them a dark one at the same voltage (0: none).
    pub fn aims(&self, background: usize) -> impl Iterator<Item = Aim> + '_ {
        let dark = move |i: usize| background > 0 && i.is_multiple_of(background);
        self.volts.iter().enumerate().flat_map(move |(i, &volts)| {
            dark(i).then_some(Aim::dark(volts)).into_iter().chain([Aim::lit(volts)])
        })
    }
}

/// Gives a sweep its positions while it runs: [`Fed`] waits for them, and ends when the feeder is dropped.
#[derive(Clone, Debug)]
pub struct Feeder {
    aims: mpsc::Sender<Aim>,
}

/// The positions that a [`Feeder`] gives.
#[derive(Debug)]
pub struct Fed {
    aims: mpsc::Receiver<Aim>,
}

/// A feeder and the positions that it gives, in its order: for a sweep that depends on what it sees.
pub fn feed() -> (Feeder, Fed) {
    let (sender, receiver) = mpsc::channel();
    (Feeder { aims: sender }, Fed { aims: receiver })
}

impl Feeder {
    /// Adds a position; whether the sweep still wants any.
    pub fn give(&self, aim: Aim) -> bool {
        self.aims.send(aim).is_ok()
    }
}

impl Iterator for Fed {
    type Item = Aim;

    fn next(&mut self) -> Option<Aim> {
        self.aims.recv().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of a position, V.
    const ROUNDING_V: f64 = 1e-12;

    fn close(schedule: &Schedule, expected: &[f64]) -> bool {
        schedule.volts.len() == expected.len()
            && schedule.volts.iter().zip(expected).all(|(a, b)| (a - b).abs() < ROUNDING_V)
    }

    #[test]
    fn both_ends_are_swept_whichever_way_and_whatever_the_spacing() {
        let of = |from, to, spacing| Schedule::new(from, to, spacing).unwrap();
        assert!(close(&of(-1.0, 1.0, Spacing::Step(0.5)), &[-1.0, -0.5, 0.0, 0.5, 1.0]));
        assert!(close(&of(1.0, -1.0, Spacing::Count(3)), &[1.0, 0.0, -1.0]));
        // 0.3 is no multiple of 0.1 in binary, and is meant as one.
        assert!(close(&of(0.0, 0.3, Spacing::Step(0.1)), &[0.0, 0.1, 0.2, 0.3]));
        // A step that doesn't fit is made smaller, not larger.
        assert!(close(&of(0.0, 1.0, Spacing::Step(0.4)), &[0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]));
        assert!(close(&of(0.7, 0.7, Spacing::Step(0.4)), &[0.7]));
        assert!(close(&of(0.7, 2.0, Spacing::Count(1)), &[0.7]));
        let fine = of(-4.1, 3.7, Spacing::Step(0.0001));
        assert_eq!((fine.volts.len(), fine.volts.last()), (78_001, Some(&3.7)));
    }

    #[test]
    fn what_is_no_sweep_is_refused() {
        for (from, to, spacing) in [
            (f64::NAN, 1.0, Spacing::Count(2)),
            (0.0, f64::INFINITY, Spacing::Step(0.1)),
            (0.0, 1.0, Spacing::Step(0.0)),
            (0.0, 1.0, Spacing::Step(-0.1)),
            (0.0, 1.0, Spacing::Step(f64::NAN)),
            (0.0, 1.0, Spacing::Step(1e-300)),
            (0.0, 1.0, Spacing::Count(0)),
            (0.0, 1.0, Spacing::Count(usize::MAX)),
        ] {
            assert!(Schedule::new(from, to, spacing).is_err(), "{from} {to} {spacing:?}");
        }
    }

    #[test]
    fn a_region_leaves_out_the_rest_and_backgrounds_come_in_between() {
        let schedule = Schedule::new(0.0, 1.0, Spacing::Count(11)).unwrap().within([0.25, 0.65]);
        assert!(close(&schedule, &[0.3, 0.4, 0.5, 0.6]));
        let lit: Vec<bool> = schedule.aims(2).map(|aim| aim.laser_on).collect();
        assert_eq!(lit, [false, true, true, false, true, true]);
        assert_eq!(schedule.aims(0).count(), 4);
    }

    #[test]
    fn a_fed_sweep_waits_for_its_positions_and_ends_with_its_feeder() {
        let (feeder, fed) = feed();
        let sweep = std::thread::spawn(move || fed.map(|aim| aim.volts).collect::<Vec<_>>());
        assert!((0..4).all(|i| feeder.give(Aim::lit(f64::from(i)))));
        drop(feeder);
        assert_eq!(sweep.join().unwrap(), [0.0, 1.0, 2.0, 3.0]);
        let (feeder, fed) = feed();
        drop(fed);
        assert!(!feeder.give(Aim::dark(0.0)));
    }
}
