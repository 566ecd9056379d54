//! Sweeps on the mock: every frame has the voltage that the mirror had, whatever is lost on the way is told, and faults end with the laser off.

use std::{ops::ControlFlow, time::Duration};

use uw_hw::{
    Camera, CameraSettings, Fault, Frame, FrameCounts, GuardedGalvo, Identity, Limits, ManualClock, Pixels,
    Timeline, Trigger,
    interlock::{Handle, Interlock, Policy},
    mock::{Bench, Calls, Device, Mock, MockCamera, MockFault},
    sweep::{
        Aim, Continuous, Event, Exposed, Schedule, Spacing, StepAndSettle, continuous, feed, measure_lag,
        measure_settling, step_and_settle,
    },
};

const WITHIN: Duration = Duration::from_millis(50);
/// Images hold the mirror's voltage in the middle of the exposure: 0.1 mV a grey value, from -3 V.
const VOLTS_PER_DN: f64 = 1e-4;
const TIME_CONSTANT: Duration = Duration::from_millis(2);

fn bench() -> Bench {
    Bench {
        time_constant: TIME_CONSTANT,
        latency: Duration::from_micros(300),
        readout: Duration::from_millis(1),
        ..Bench::default()
    }
}

struct Scene {
    mock: Mock,
    interlock: Interlock,
    camera: MockCamera,
}

fn galvo(mock: &Mock, timeline: Timeline) -> GuardedGalvo {
    let limits = Limits::new([-3.0, 3.0], 200.0, 0.002).expect("these are limits");
    GuardedGalvo::new(Box::new(mock.galvo()), limits, timeline)
}

fn scene(trigger: Trigger) -> Scene {
    let timeline = Timeline::new(ManualClock::starting_at(0));
    let mock = Mock::with(timeline.clone(), bench());
    let policy = Policy { within: WITHIN, watchdog: None, ..Policy::default() };
    let interlock =
        Interlock::engage(Box::new(mock.laser()), galvo(&mock, timeline), policy, |_| ()).expect("it is off");
    let mut camera = mock.camera(|shot| {
        let value = if shot.laser_on { ((shot.volts + 3.0) / VOLTS_PER_DN).round() as u16 } else { 0 };
        vec![value; (shot.size[0] * shot.size[1]) as usize]
    });
    let settings = CameraSettings {
        size: [3, 2],
        pixel_format: None,
        significant_bits: 16,
        exposure: Duration::from_millis(3),
        gain_db: None,
        trigger,
    };
    camera.configure(&settings, WITHIN).expect("the mock takes any settings");
    camera.arm(WITHIN).expect("it is set up");
    Scene { mock, interlock, camera }
}

/// The voltage that an image shows; `None` for a dark one.
fn shown(exposed: &Exposed) -> Option<f64> {
    let Pixels::U16(pixels) = exposed.frame.pixels() else { panic!("16 bits were asked for") };
    (pixels[0] > 0).then(|| f64::from(pixels[0]) * VOLTS_PER_DN - 3.0)
}

fn stepped() -> StepAndSettle {
    StepAndSettle {
        // exp(-20/2) of a step of 0.1 V are 5 µV.
        settle: Duration::from_millis(20),
        frame_within: Duration::from_millis(40),
        retries: 2,
        stamp_slack: Duration::ZERO,
    }
}

/// Sweeps eleven voltages; frames, losses, and how it ended.
fn sweep(scene: &mut Scene) -> (Vec<Exposed>, Vec<Fault>, Result<(), Fault>) {
    sweep_by(&scene.interlock.handle(), &mut scene.camera, &stepped())
}

fn sweep_by(
    handle: &Handle,
    camera: &mut dyn Camera,
    settings: &StepAndSettle,
) -> (Vec<Exposed>, Vec<Fault>, Result<(), Fault>) {
    let schedule = Schedule::new(-0.5, 0.5, Spacing::Count(11)).expect("a sweep");
    let (mut frames, mut lost) = (Vec::new(), Vec::new());
    let aims: Vec<Aim> = schedule.aims(5).collect();
    let ended = step_and_settle(handle, camera, aims, settings, |event| {
        match event {
            Event::Exposed(exposed) => frames.push(exposed),
            Event::Lost { fault, .. } => lost.push(fault),
        }
        ControlFlow::Continue(())
    });
    (frames, lost, ended)
}

fn assert_true_voltages(frames: &[Exposed]) {
    for exposed in frames.iter().filter(|exposed| exposed.laser_on) {
        let error_v = shown(exposed).expect("it is lit") - exposed.volts;
        assert!(error_v.abs() < VOLTS_PER_DN, "{error_v} V at {} V", exposed.volts);
    }
}

#[test]
fn a_stepped_sweep_has_each_voltage_once_settled_and_its_backgrounds_dark() {
    let mut scene = scene(Trigger::Software);
    let (frames, lost, ended) = sweep(&mut scene);
    assert_eq!((ended, lost), (Ok(()), vec![]));
    assert_eq!(frames.iter().filter(|exposed| shown(exposed).is_none()).count(), 3);
    assert!(frames.iter().all(|exposed| exposed.settled && exposed.laser_on == shown(exposed).is_some()));
    let lit: Vec<f64> = frames.iter().filter(|e| e.laser_on).map(|e| e.commanded_v).collect();
    assert_eq!(lit, Schedule::new(-0.5, 0.5, Spacing::Count(11)).unwrap().volts());
    assert_true_voltages(&frames);
}

#[test]
fn frames_that_are_lost_torn_repeated_or_of_another_time_are_told_and_taken_again() {
    let mut scene = scene(Trigger::Software);
    for (fault, call) in [
        (MockFault::Dropped, 2),
        (MockFault::Torn, 4),
        (MockFault::Duplicated, 6),
        // Comes when the next one is waited for, whose voltage it must not get.
        (MockFault::Slow(Duration::from_millis(45)), 9),
    ] {
        scene.mock.inject(Device::Camera, fault, Calls::only(call));
    }
    let (frames, lost, ended) = sweep(&mut scene);
    assert_eq!(ended, Ok(()));
    assert_eq!(frames.len(), 14, "nothing is missing");
    assert_true_voltages(&frames);
    let of = |wanted: fn(&Fault) -> bool| lost.iter().filter(|fault| wanted(fault)).count();
    assert_eq!(of(|f| matches!(f, Fault::DroppedFrames { count: 1, .. })), 1, "{lost:?}");
    assert_eq!(of(|f| matches!(f, Fault::DuplicateFrame { .. })), 1, "{lost:?}");
    assert_eq!(of(|f| matches!(f, Fault::FrameContent { .. })), 2, "{lost:?}");
    assert_eq!(of(|f| matches!(f, Fault::Timeout { .. })), 2, "{lost:?}");
}

/// A camera that hears one of its triggers only with the next one.
struct HearsLate {
    camera: MockCamera,
    triggers: u32,
    late: u32,
}

impl Camera for HearsLate {
    fn identity(&self) -> Identity {
        self.camera.identity()
    }

    fn configure(&mut self, wanted: &CameraSettings, within: Duration) -> Result<CameraSettings, Fault> {
        self.camera.configure(wanted, within)
    }

    fn arm(&mut self, within: Duration) -> Result<(), Fault> {
        self.camera.arm(within)
    }

    fn trigger(&mut self, within: Duration) -> Result<(), Fault> {
        self.triggers += 1;
        if self.triggers == self.late {
            let (device, doing) = ("camera".into(), "a trigger".into());
            return Err(Fault::Timeout { device, doing, waited: within, got: String::new() });
        }
        if self.triggers == self.late + 1 {
            self.camera.trigger(within)?;
        }
        self.camera.trigger(within)
    }

    fn next_frame(&mut self, within: Duration) -> Result<Frame, Fault> {
        self.camera.next_frame(within)
    }

    fn disarm(&mut self, within: Duration) -> Result<(), Fault> {
        self.camera.disarm(within)
    }

    fn counts(&self) -> FrameCounts {
        self.camera.counts()
    }
}

#[test]
fn a_trigger_that_was_heard_late_gives_no_image_to_the_next_voltage() {
    let Scene { interlock, camera, .. } = scene(Trigger::Software);
    let mut camera = HearsLate { camera, triggers: 0, late: 5 };
    // Stamps alone don't tell the two exposures apart.
    let settings = StepAndSettle { stamp_slack: Duration::from_millis(100), ..stepped() };
    let (frames, lost, ended) = sweep_by(&interlock.handle(), &mut camera, &settings);
    assert_eq!((ended, frames.len()), (Ok(()), 14));
    assert!(matches!(lost[..], [Fault::Timeout { .. }]), "{lost:?}");
    assert_eq!(camera.counts().received, 15);
    assert_true_voltages(&frames);
}

#[test]
fn whatever_ends_a_sweep_keeps_the_frames_before_it_and_the_laser_goes_off() {
    for (device, fault) in [
        (Device::Camera, MockFault::Silent),
        (Device::Camera, MockFault::Unplugged),
        (Device::Camera, MockFault::WrongSize),
        (Device::Galvo, MockFault::Silent),
        (Device::Galvo, MockFault::WrongReply),
        (Device::Galvo, MockFault::Unplugged),
        (Device::Galvo, MockFault::Stuck),
        (Device::Laser, MockFault::Silent),
    ] {
        let mut scene = scene(Trigger::Software);
        let call = if device == Device::Laser { 2 } else { 6 };
        let calls = if device == Device::Laser { Calls::only(call) } else { Calls::from(call) };
        scene.mock.inject(device, fault, calls);
        let (frames, _, ended) = sweep(&mut scene);
        let typed = match fault {
            MockFault::Silent => matches!(ended, Err(Fault::Timeout { .. })),
            MockFault::WrongSize => matches!(ended, Err(Fault::FrameSize { .. })),
            MockFault::WrongReply => matches!(ended, Err(Fault::Protocol { .. })),
            MockFault::Stuck => matches!(ended, Err(Fault::NotFollowing { .. })),
            _ => matches!(ended, Err(Fault::Disconnected { .. })),
        };
        assert!(typed, "{device:?} {fault:?}: {ended:?}");
        assert!(!frames.is_empty(), "{device:?} {fault:?}");
        assert_true_voltages(&frames);
        drop(scene.interlock);
        assert!(!scene.mock.laser_is_on(), "{device:?} {fault:?}");
    }
}

#[test]
fn a_sweep_that_is_stopped_from_outside_ends_with_the_reason() {
    let mut scene = scene(Trigger::Software);
    let handle = scene.interlock.handle();
    let mut count = 0;
    let aims = std::iter::repeat(Aim::lit(0.1));
    let ended = step_and_settle(&handle.clone(), &mut scene.camera, aims, &stepped(), |_| {
        count += 1;
        if count == 3 {
            handle.stop(uw_hw::interlock::Reason::Signal(2));
        }
        ControlFlow::Continue(())
    });
    assert!(matches!(&ended, Err(Fault::Stopped { reason }) if reason.contains("SIGINT")), "{ended:?}");
    assert_eq!(count, 3);
    assert!(!scene.mock.laser_is_on());
}

#[test]
fn a_sweep_can_be_fed_by_what_it_sees() {
    let mut scene = scene(Trigger::Software);
    let (feeder, fed) = feed();
    let mut feeder = Some(feeder);
    // Halves the step for as long as it is told to, as an adaptive sweep does.
    let mut step = 0.4;
    let mut seen: Vec<f64> = Vec::new();
    assert!(feeder.as_ref().unwrap().give(Aim::lit(0.0)));
    step_and_settle(&scene.interlock.handle(), &mut scene.camera, fed, &stepped(), |event| {
        if let Event::Exposed(exposed) = event {
            seen.push(exposed.commanded_v);
            step /= 2.0;
            match &feeder {
                Some(open) if step > 0.04 => assert!(open.give(Aim::lit(exposed.commanded_v + step))),
                _ => feeder = None,
            }
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    assert_eq!(seen, [0.0, 0.2, 0.2 + 0.1, 0.2 + 0.1 + 0.05]);
}

fn ramp() -> Continuous {
    Continuous {
        from_v: -1.0,
        to_v: 1.0,
        rate_v_per_s: 2.0,
        command_every: Duration::from_millis(5),
        settle: Duration::from_millis(20),
        lag: Duration::ZERO,
        frame_within: Duration::from_millis(100),
    }
}

fn sweep_on(scene: &mut Scene, settings: &Continuous) -> (Vec<Exposed>, Vec<Fault>, Result<(), Fault>) {
    let (mut frames, mut lost) = (Vec::new(), Vec::new());
    let handle: Handle = scene.interlock.handle();
    let ended = continuous(&handle, &mut scene.camera, settings, |event| {
        match event {
            Event::Exposed(exposed) => frames.push(exposed),
            Event::Lost { fault, .. } => lost.push(fault),
        }
        ControlFlow::Continue(())
    });
    (frames, lost, ended)
}

/// The mirror's path between two read-backs is no line: commands of 10 mV, followed with a time constant of 2 ms, bow by less than this.
const BOW_V: f64 = 0.0025;

#[test]
fn a_continuous_sweep_gives_each_frame_the_voltage_of_its_middle() {
    let mut scene = scene(Trigger::Free { rate_hz: 97.0 });
    let (frames, lost, ended) = sweep_on(&mut scene, &ramp());
    assert_eq!((ended, lost), (Ok(()), vec![]));
    // One second at 97 Hz, less what overlaps the ends.
    assert!((95..=97).contains(&frames.len()), "{}", frames.len());
    assert!(frames.windows(2).all(|two| two[1].frame.id() == two[0].frame.id() + 1));
    let errors: Vec<f64> = frames.iter().map(|e| shown(e).unwrap() - e.volts).collect();
    let worst = errors.iter().fold(0.0_f64, |worst, e| worst.max(e.abs()));
    assert!(worst < BOW_V, "{worst} V");
    // Commands alone would be off by the mirror's lag and more: that is what reading back is for.
    let by_command = |e: &Exposed| shown(e).unwrap() - e.commanded_v;
    let mean = frames.iter().map(by_command).sum::<f64>() / frames.len() as f64;
    assert!(mean.abs() > 2.0 * BOW_V, "{mean} V");
}

#[test]
fn a_continuous_sweep_tells_of_lost_frames_and_ends_at_a_silent_camera() {
    let mut scene = scene(Trigger::Free { rate_hz: 100.0 });
    scene.mock.inject(Device::Camera, MockFault::Dropped, Calls::some(20, 3));
    scene.mock.inject(Device::Camera, MockFault::Silent, Calls::from(50));
    let (frames, lost, ended) = sweep_on(&mut scene, &ramp());
    assert!(matches!(lost[..], [Fault::DroppedFrames { count: 3, .. }]), "{lost:?}");
    let Err(Fault::Timeout { waited, .. }) = ended else { panic!("{ended:?}") };
    assert!((100..120).contains(&waited.as_millis()), "{waited:?}");
    assert!(frames.len() > 35, "what came is kept: {}", frames.len());
    drop(scene.interlock);
    assert!(!scene.mock.laser_is_on());
}

#[test]
fn what_a_camera_dropped_before_a_continuous_sweep_is_no_loss_of_it() {
    let mut scene = scene(Trigger::Free { rate_hz: 97.0 });
    // Nobody takes a frame while the mirror settles: more come than a camera has room for.
    let settle = Duration::from_secs(1);
    let (frames, lost, ended) = sweep_on(&mut scene, &Continuous { settle, ..ramp() });
    assert_eq!((ended, lost), (Ok(()), vec![]));
    assert!(scene.camera.counts().dropped > 20, "{:?}", scene.camera.counts());
    assert!((95..=97).contains(&frames.len()), "{}", frames.len());
}

#[test]
fn a_rate_above_the_slew_is_refused_before_anything_moves() {
    let mut scene = scene(Trigger::Free { rate_hz: 100.0 });
    let fast = Continuous { rate_v_per_s: 201.0, ..ramp() };
    let (_, _, ended) = sweep_on(&mut scene, &fast);
    assert!(matches!(ended, Err(Fault::OutOfRange { quantity: "rate", .. })), "{ended:?}");
    assert!(!scene.mock.laser_is_on() && scene.mock.volts().abs() < 1e-9);
}

/// A ramp made of commands every 1.3 ms is a stair: half of that either way.
const HALF_COMMAND_NS: i64 = 650_000;

#[test]
fn settling_and_lag_are_those_of_the_mirror() {
    let clock = ManualClock::starting_at(0);
    let timeline = Timeline::new(clock);
    let mock = Mock::with(timeline.clone(), bench());
    let mut galvo = galvo(&mock, timeline);
    let watch = Duration::from_millis(60);
    let settling = measure_settling(&mut galvo, [0.0, 0.5], 0.005, watch, WITHIN).unwrap();
    // One command moves it by 0.5 V, and 1 % of a step is left after ln(100) time constants: it is never found sooner, and at most two
    // read-backs later.
    let late = settling.settle.as_secs_f64() - TIME_CONSTANT.as_secs_f64() * 100_f64.ln();
    assert!((0.0..2.0 * settling.resolution.as_secs_f64()).contains(&late), "{late} s: {settling:?}");
    assert!(settling.resolution < Duration::from_micros(400), "{settling:?}");
    assert!(!settling.at_once && settling.offset_v.abs() < 1e-6 && settling.noise_v < 1e-6, "{settling:?}");

    let lag = measure_lag(&mut galvo, [-1.0, 1.0], 4.0, watch, WITHIN).unwrap();
    // A first-order mirror on a ramp is late by its time constant.
    let error_ns = lag.lag_ns - TIME_CONSTANT.as_nanos() as i64;
    assert!(error_ns.abs() < HALF_COMMAND_NS, "{lag:?}");
    mock.inject(Device::Galvo, MockFault::Stuck, Calls::from(0));
    let stuck = measure_settling(&mut galvo, [1.0, 0.5], 0.005, watch, WITHIN);
    assert!(matches!(stuck, Err(Fault::NotFollowing { .. })), "{stuck:?}");
}
