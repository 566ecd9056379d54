//! Scans that are held, resumed and ended from other threads.

use crate::scan::{BALL, camera_settings, held, mock_instrument, plan, record_watched};
use std::path::Path;
use std::sync::Mutex;
use std::time::{Duration, Instant};
use uwscan::hw::mock::Mock;
use uwscan::hw::sweep::Continuous;
use uwscan::hw::{Timeline, Trigger};
use uwscan::pipeline::record::session::{Observer, Shot};
use uwscan::pipeline::record::{Motion, Phase, Plan, Scanned, SteerError, Steering, Tally};

/// Asks for something once so many frames are exposed.
struct Asks<'m> {
    steering: Steering,
    mock: &'m Mock,
    at: usize,
    ask: fn(&Steering) -> Result<(), SteerError>,
    /// Each phase, and whether the laser was on when it was told.
    phases: Mutex<Vec<(Phase, bool)>>,
}

impl<'m> Asks<'m> {
    fn new(mock: &'m Mock, at: usize, ask: fn(&Steering) -> Result<(), SteerError>) -> Self {
        Self { steering: Steering::default(), mock, at, ask, phases: Mutex::default() }
    }

    fn phases(self) -> Vec<(Phase, bool)> {
        self.phases.into_inner().unwrap()
    }
}

impl Observer for Asks<'_> {
    fn exposed(&self, shot: &Shot) {
        if shot.number as usize + 1 == self.at {
            (self.ask)(&self.steering).unwrap();
        }
    }

    fn phase(&self, phase: Phase, _: &Tally) {
        if phase == Phase::Held {
            // Somebody else resumes it, once it was seen to be dark.
            let steering = self.steering.clone();
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(200));
                steering.resume("the test").unwrap();
            });
        }
        self.phases.lock().unwrap().push((phase, self.mock.laser_is_on()));
    }

    fn steering(&self) -> Option<&Steering> {
        Some(&self.steering)
    }
}

fn bytes_hold(path: &Path, text: &str) -> bool {
    std::fs::read(path).unwrap().windows(text.len()).any(|window| window == text.as_bytes())
}

fn hold(steering: &Steering) -> Result<(), SteerError> {
    steering.hold("the test")?;
    assert_eq!(steering.hold("the test"), Err(SteerError::Held));
    Ok(())
}

#[test]
fn a_scan_that_is_held_goes_on_where_it_was() {
    let timeline = Timeline::system();
    let mock = Mock::new(timeline.clone());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("held.mcap");
    let asks = Asks::new(&mock, 10, hold);
    assert_eq!(asks.steering.hold("nobody"), Err(SteerError::Nothing));
    let began = Instant::now();
    let scanned = record_watched(mock_instrument(&mock, &timeline), &plan(), &path, &asks);
    assert!(scanned.whole(), "{scanned:?}");
    assert!(began.elapsed() >= Duration::from_millis(200));
    // Each voltage once, in order, all of them lit: the images are the very ones of a scan that was not held.
    let volts: Vec<f64> = held(&path).into_iter().map(|(_, volts)| volts.unwrap()).collect();
    assert_eq!(volts, BALL.volts);
    assert!(bytes_hold(&path, "held, as the test asked") && bytes_hold(&path, "resumed, as the test asked"));
    assert_eq!(asks.steering.resume("nobody"), Err(SteerError::Nothing));
    assert_held_once(&asks.phases());
}

/// Scanned, held, scanned to its end; and the laser was off before anybody was told so.
#[track_caller]
fn assert_held_once(told: &[(Phase, bool)]) {
    let phases: Vec<Phase> = told.iter().map(|(phase, _)| *phase).collect();
    assert_eq!(phases, [Phase::Scanning, Phase::Held, Phase::Scanning, Phase::Ending { laser_off: true }]);
    assert!(!told[1].1 && !told[3].1, "{told:?}");
}

/// The laser's state while a scan is held, and what it ends with.
fn ended_by(ask: fn(&Steering) -> Result<(), SteerError>) -> (Scanned, bool, String) {
    let timeline = Timeline::system();
    let mock = Mock::new(timeline.clone());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ended.mcap");
    let asks = Asks::new(&mock, 5, ask);
    let scanned = record_watched(mock_instrument(&mock, &timeline), &plan(), &path, &asks);
    let why = scanned.ended.as_ref().map(ToString::to_string).unwrap_or_default();
    assert!(bytes_hold(&path, &why), "{why}");
    assert_eq!(held(&path).len(), scanned.counts.recorded);
    (scanned, mock.laser_is_on(), why)
}

#[test]
fn a_scan_that_is_ended_keeps_what_it_has_and_leaves_the_laser_off() {
    for (ask, words) in [
        ((|steering| steering.stop("the test")) as fn(&Steering) -> _, "stopped, as the test asked"),
        (|steering| steering.laser_off("the test"), "laser switched off, as the test asked"),
    ] {
        let (scanned, laser_is_on, why) = ended_by(ask);
        assert!(!laser_is_on && !scanned.whole());
        assert_eq!(scanned.counts.recorded, 5, "{:?}", scanned.counts);
        assert!(why.contains(words), "{why}");
    }
}

#[test]
fn a_continuous_sweep_that_is_held_goes_on_from_its_last_image() {
    let timeline = Timeline::system();
    let mock = Mock::new(timeline.clone());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ride.mcap");
    let asks = Asks::new(&mock, 4, hold);
    let mut instrument = mock_instrument(&mock, &timeline);
    let rate_hz = 50.0;
    instrument.camera_settings.trigger = Trigger::Free { rate_hz };
    assert_eq!(instrument.camera_settings.size, camera_settings(BALL.size()).size);
    let ride = Continuous {
        from_v: 0.0,
        to_v: 1.0,
        rate_v_per_s: 2.0,
        command_every: Duration::from_millis(2),
        settle: Duration::ZERO,
        lag: Duration::ZERO,
        frame_within: Duration::from_millis(500),
    };
    let motion = Motion::Continuous { stretches: vec![ride], rate_hz };
    let plan = Plan { motion, repeat: 1, adaptive: None, background_every: 0 };
    let scanned = record_watched(instrument, &plan, &path, &asks);
    assert!(scanned.ended.is_none(), "{scanned:?}");
    let volts: Vec<f64> = held(&path).into_iter().map(|(_, volts)| volts.unwrap()).collect();
    // Rising throughout, to the end, with no gap where it was held that is wider than a slow machine's.
    assert!(volts.windows(2).all(|pair| pair[0] < pair[1]), "{volts:?}");
    assert!(volts.len() > 10 && volts[volts.len() - 1] > 0.85, "{volts:?}");
    assert_held_once(&asks.phases());
}
