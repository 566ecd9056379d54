//! The laser is off and the mirror parked on every way out.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex},
    time::Duration,
};

use uw_hw::{
    Fault, GuardedGalvo, Identity, Laser, Limits, ManualClock, Timeline,
    interlock::{Handle, Interlock, Policy, Reason, Report},
    mock::{Calls, Device, Event, Mock, MockFault, MockLaser},
};

const POLICY: Policy = Policy {
    park_v: -1.5,
    within: Duration::from_millis(20),
    watchdog: Some(Duration::from_secs(1)),
    tries: 3,
    pause: Duration::from_millis(5),
};

fn limits() -> Limits {
    Limits::new([-3.0, 3.0], 1000.0, 0.01).expect("these are limits")
}

struct Scene {
    clock: Arc<ManualClock>,
    mock: Mock,
    told: Arc<Mutex<Vec<Report>>>,
}

fn scene() -> Scene {
    let clock = ManualClock::starting_at(0);
    Scene { mock: Mock::new(Timeline::new(clock.clone())), clock, told: Arc::default() }
}

impl Scene {
    /// An interlock with the laser on and the mirror somewhere else than parked.
    fn scanning(&self) -> Interlock {
        let galvo =
            GuardedGalvo::new(Box::new(self.mock.galvo()), limits(), Timeline::new(self.clock.clone()));
        let told = self.told.clone();
        let tell = move |report: &Report| told.lock().expect("no test panics in here").push(report.clone());
        let interlock =
            Interlock::engage(Box::new(self.mock.laser()), galvo, POLICY, tell).expect("it is off");
        let handle = interlock.handle();
        handle.set(1.25).expect("nothing is wrong yet");
        handle.laser_on().expect("nothing is wrong yet");
        assert!(self.mock.laser_is_on());
        interlock
    }

    /// That all is safe, in the right order, and was told once.
    fn assert_safe(&self, reason: &Reason) {
        assert!(!self.mock.laser_is_on(), "{reason}: the laser is on");
        assert!((self.mock.volts() + 1.5).abs() < 1e-9, "{reason}: the mirror is at {} V", self.mock.volts());
        let events: Vec<Event> = self.mock.events().into_iter().map(|(_, event)| event).collect();
        let order = [Event::Laser(true), Event::Laser(false), Event::Sent(-1.5)];
        let at = order.map(|event| events.iter().rposition(|e| *e == event));
        assert!(at.is_sorted() && at[0].is_some(), "{reason}: the laser goes off first: {events:?}");
        let told = self.told.lock().expect("no test panics in here");
        assert_eq!(told.iter().map(|report| &report.reason).collect::<Vec<_>>(), [reason]);
        assert_eq!(told[0].alarms(), [""; 0]);
    }
}

fn stays_off(handle: &Handle) {
    assert!(matches!(handle.laser_on(), Err(Fault::Stopped { .. })));
    assert!(matches!(handle.set(0.0), Err(Fault::Stopped { .. })));
}

#[test]
fn at_the_end() {
    let scene = scene();
    let report = scene.scanning().finish();
    assert_eq!((report.reason, report.tries), (Reason::Done, 1));
    scene.assert_safe(&Reason::Done);
}

#[test]
fn when_an_error_leaves_the_scan() {
    let scene = scene();
    let scan = || -> Result<(), String> {
        let _interlock = scene.scanning();
        Err("disk full".into())
    };
    assert!(scan().is_err());
    scene.assert_safe(&Reason::Abandoned);
}

#[test]
fn when_the_program_panics() {
    let scene = scene();
    let scan = catch_unwind(AssertUnwindSafe(|| {
        let _interlock = scene.scanning();
        panic!("as planned");
    }));
    assert!(scan.is_err());
    scene.assert_safe(&Reason::Panic);
}

/// A laser whose driver has a bug.
struct Panics(MockLaser);

impl Laser for Panics {
    fn identity(&self) -> Identity {
        self.0.identity()
    }

    fn on(&mut self, within: Duration) -> Result<(), Fault> {
        let _ = self.0.on(within);
        panic!("as planned");
    }

    fn off(&mut self, within: Duration) -> Result<(), Fault> {
        self.0.off(within)
    }

    fn is_on(&mut self, within: Duration) -> Result<bool, Fault> {
        self.0.is_on(within)
    }

    fn set_power(&mut self, fraction: f64, within: Duration) -> Result<(), Fault> {
        self.0.set_power(fraction, within)
    }
}

#[test]
fn when_a_thread_panics_while_it_holds_the_laser() {
    let scene = scene();
    let galvo = GuardedGalvo::new(Box::new(scene.mock.galvo()), limits(), Timeline::new(scene.clock.clone()));
    let told = scene.told.clone();
    let tell = move |report: &Report| told.lock().unwrap().push(report.clone());
    let interlock = Interlock::engage(Box::new(Panics(scene.mock.laser())), galvo, POLICY, tell).unwrap();
    let handle = interlock.handle();
    assert!(std::thread::spawn(move || handle.laser_on()).join().is_err());
    assert!(scene.mock.laser_is_on());
    drop(interlock);
    scene.assert_safe(&Reason::Abandoned);
}

#[test]
fn at_signals_and_a_second_one_changes_nothing() {
    for number in [2, 15] {
        let scene = scene();
        let interlock = scene.scanning();
        let handle = interlock.handle();
        let signals = handle.clone();
        std::thread::spawn(move || {
            [signals.stop(Reason::Signal(number)), signals.stop(Reason::Signal(number))]
        })
        .join()
        .unwrap();
        stays_off(&handle);
        drop(interlock);
        scene.assert_safe(&Reason::Signal(number));
    }
}

#[test]
fn when_the_drive_falls_silent_lies_or_is_unplugged() {
    for fault in [MockFault::Silent, MockFault::WrongReply, MockFault::Refuses] {
        let scene = scene();
        let interlock = scene.scanning();
        let handle = interlock.handle();
        let next = scene.mock.calls(Device::Galvo);
        scene.mock.inject(Device::Galvo, fault, Calls::only(next));
        let fault = handle.set(1.26).unwrap_err();
        stays_off(&handle);
        drop(interlock);
        scene.assert_safe(&Reason::Fault(fault.to_string()));
    }
    let scene = scene();
    let interlock = scene.scanning();
    let next = scene.mock.calls(Device::Galvo);
    scene.mock.inject(Device::Galvo, MockFault::Unplugged, Calls::from(next));
    let fault = interlock.handle().set(1.26).unwrap_err();
    assert!(!scene.mock.laser_is_on(), "the laser has a link of its own");
    let report = interlock.finish();
    assert_eq!(report.reason, Reason::LinkLost(fault.to_string()));
    assert_eq!(report.laser_off, Ok(()));
    assert!(report.alarms()[0].starts_with("the mirror is not parked"), "{:?}", report.alarms());
}

#[test]
fn when_the_mirror_sticks() {
    let scene = scene();
    let interlock = scene.scanning();
    let next = scene.mock.calls(Device::Galvo);
    scene.mock.inject(Device::Galvo, MockFault::Stuck, Calls::only(next));
    let handle = interlock.handle();
    handle.set(1.3).unwrap();
    let fault = handle.confirm().unwrap_err();
    assert!(matches!(fault, Fault::NotFollowing { .. }), "{fault}");
    scene.assert_safe(&Reason::Fault(fault.to_string()));
}

#[test]
fn when_the_scan_hangs() {
    let scene = scene();
    let interlock = scene.scanning();
    let handle = interlock.handle();
    for _ in 0..10 {
        scene.clock.advance(Duration::from_millis(900));
        handle.feed();
    }
    handle.check_watchdog();
    assert!(scene.mock.laser_is_on(), "a scan that goes on is let go on");
    scene.clock.advance(Duration::from_millis(1001));
    // Nobody calls: the interlock's own thread finds it.
    let waited = std::time::Instant::now();
    while handle.reason().is_none() && waited.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(1));
    }
    drop(interlock);
    let reason = handle.reason().unwrap();
    assert!(matches!(reason, Reason::Watchdog { .. }), "{reason}");
    scene.assert_safe(&reason);
}

#[test]
fn a_laser_that_goes_off_only_at_the_third_try_is_tried_three_times() {
    let scene = scene();
    let interlock = scene.scanning();
    let next = scene.mock.calls(Device::Laser);
    scene.mock.inject(Device::Laser, MockFault::Silent, Calls::only(next));
    scene.mock.inject(Device::Laser, MockFault::StaysAsItIs, Calls::only(next + 1));
    let report = interlock.finish();
    assert_eq!((report.tries, report.laser_off), (3, Ok(())));
    scene.assert_safe(&Reason::Done);
}

#[test]
fn a_laser_that_stays_on_is_told_aloud_and_tried_again_at_the_next_occasion() {
    let scene = scene();
    let interlock = scene.scanning();
    let next = scene.mock.calls(Device::Laser);
    scene.mock.inject(Device::Laser, MockFault::Unplugged, Calls::from(next));
    let handle = interlock.handle();
    let report = handle.stop(Reason::Signal(2));
    assert_eq!(report.tries, 3);
    assert!(report.alarms()[0].contains("THE LASER MAY STILL BE ON"), "{:?}", report.alarms());
    assert!((scene.mock.volts() + 1.5).abs() < 1e-9, "the mirror is parked all the same");
    scene.mock.mend();
    drop(interlock);
    assert!(!scene.mock.laser_is_on());
    let told = scene.told.lock().unwrap();
    assert_eq!(told.len(), 2);
    assert_eq!(told[1].alarms(), [""; 0]);
}

#[test]
fn nothing_begins_with_a_laser_that_does_not_go_off() {
    let scene = scene();
    scene.mock.inject(Device::Laser, MockFault::Unplugged, Calls::from(0));
    let galvo = GuardedGalvo::new(Box::new(scene.mock.galvo()), limits(), Timeline::new(scene.clock.clone()));
    let engaged = Interlock::engage(Box::new(scene.mock.laser()), galvo, POLICY, |_| ());
    assert!(matches!(engaged, Err(Fault::Disconnected { .. })));
}

#[test]
fn a_voltage_that_is_refused_stops_nothing() {
    let scene = scene();
    let interlock = scene.scanning();
    assert!(matches!(interlock.handle().set(3.1), Err(Fault::OutOfRange { .. })));
    assert_eq!(interlock.handle().reason(), None);
    assert!(scene.mock.laser_is_on());
}

#[test]
fn a_rest_ends_when_the_interlock_stops() {
    let timeline = Timeline::system();
    let mock = Mock::new(timeline.clone());
    let galvo = GuardedGalvo::new(Box::new(mock.galvo()), limits(), timeline.clone());
    let interlock =
        Interlock::engage(Box::new(mock.laser()), galvo, Policy { watchdog: None, ..POLICY }, |_| {})
            .expect("it is off");
    let handle = interlock.handle();
    let began = timeline.since_start();
    assert_eq!(handle.rest(Duration::from_millis(45)), Ok(()));
    assert!(timeline.since_start() - began >= Duration::from_millis(45));
    let long = Duration::from_secs(60);
    let ended = std::thread::scope(|scope| {
        let resting = scope.spawn(|| handle.rest(long));
        interlock.handle().stop(Reason::Signal(2));
        resting.join().expect("it does not panic")
    });
    assert!(matches!(ended, Err(Fault::Stopped { .. })), "{ended:?}");
    assert!(timeline.since_start() - began < long);
}
