//! A controller over a pseudo-terminal: what it does wrong comes back as a typed fault within the deadline, and the laser goes off.
#![cfg(all(unix, feature = "serial"))]
#![allow(clippy::unwrap_used)]

use std::{
    io::{Read, Write},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use serialport::{SerialPort, TTYPort};
use uw_hw::{
    Fault, GuardedGalvo, Laser, Limits, Timeline,
    galvo::{
        proto::{Command, Dialect},
        serial::{Link, Port, SerialGalvo, SerialLaser, SharedLink},
    },
    interlock::{Handle, Interlock, Policy, Reason, Report},
};

const WITHIN: Duration = Duration::from_millis(300);
/// How much later than its deadline a call may come back on a machine that does other things besides.
const GRACE: Duration = Duration::from_millis(700);

/// How the controller misbehaves.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Manner {
    Good,
    /// Ends its lines with CR LF.
    CrLf,
    Silent,
    /// A byte each 50 ms.
    Drip,
    Garbage,
    /// Half an answer, and no end.
    Partial,
    /// Never an end of line.
    Endless,
    /// Every answer comes so much too late.
    Late(Duration),
    /// Refuses voltages, as its error queue says.
    Refuses,
    /// Answers a question about a voltage with a word.
    WrongReply,
}

#[derive(Debug, Default)]
struct State {
    volts: f64,
    laser: bool,
    heard: Vec<String>,
    error: Option<&'static str>,
}

/// A controller at the other end of a pseudo-terminal, as an instrument's firmware would do it.
struct Controller {
    state: Arc<Mutex<State>>,
    manner: Arc<Mutex<Manner>>,
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    port: String,
}

impl Controller {
    fn start() -> Self {
        let (mut master, slave) = TTYPort::pair().unwrap();
        let port = slave.name().unwrap();
        master.set_timeout(Duration::from_millis(5)).unwrap();
        let (state, manner): (Arc<Mutex<State>>, _) = (Arc::default(), Arc::new(Mutex::new(Manner::Good)));
        let end = Arc::new(AtomicBool::new(false));
        let thread = {
            let (state, manner, end) = (state.clone(), manner.clone(), end.clone());
            std::thread::spawn(move || {
                let mut line = Vec::new();
                // The other end is kept open until the port was opened by its name: else reading fails.
                let mut slave = Some(slave);
                while !end.load(Ordering::SeqCst) {
                    let mut byte = [0];
                    match master.read(&mut byte) {
                        Ok(1) if byte[0] == b'\n' => {
                            let text = String::from_utf8_lossy(&line).trim().to_owned();
                            line.clear();
                            slave = None;
                            let manner = *manner.lock().unwrap();
                            let answer = state.lock().unwrap().answer(&text, manner);
                            if let Some(answer) = answer {
                                say(&mut master, &answer, manner, &end);
                            }
                        }
                        Ok(1) => line.push(byte[0]),
                        _ => {}
                    }
                }
                drop(slave);
            })
        };
        Self { state, manner, end, thread: Some(thread), port }
    }

    fn behave(&self, manner: Manner) {
        *self.manner.lock().unwrap() = manner;
    }

    fn laser(&self) -> bool {
        self.state.lock().unwrap().laser
    }

    fn heard(&self, what: &str) -> bool {
        // What was written last may not have been read yet.
        let until = Instant::now() + Duration::from_secs(2);
        loop {
            if self.state.lock().unwrap().heard.iter().any(|line| line == what) {
                return true;
            }
            if Instant::now() > until {
                return false;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Pulls the plug.
    fn unplug(&mut self) {
        self.end.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }

    fn link(&self) -> SharedLink {
        let port = Port { name: self.port.clone(), baud: 115_200 };
        Link::open(port, Dialect::scpi(), Timeline::system(), Duration::from_secs(5)).unwrap().shared()
    }
}

impl Drop for Controller {
    fn drop(&mut self) {
        self.unplug();
    }
}

impl State {
    fn answer(&mut self, line: &str, manner: Manner) -> Option<String> {
        self.heard.push(line.to_owned());
        let answer = match line {
            "*IDN?" => "ACME,DAC-16,1234,2.1".to_owned(),
            "*OPC?" => "1".to_owned(),
            "SYST:ERR?" => self.error.take().unwrap_or("0,\"No error\"").to_owned(),
            "SOUR:VOLT?" if manner == Manner::WrongReply => "BANANA".to_owned(),
            "SOUR:VOLT?" => format!("{:+.6E}", self.volts),
            "OUTP?" => u8::from(self.laser).to_string(),
            "OUTP ON" | "OUTP OFF" => {
                self.laser = line == "OUTP ON";
                return None;
            }
            _ => {
                match line.strip_prefix("SOUR:VOLT ").map(str::parse) {
                    Some(Ok(_)) if manner == Manner::Refuses => {
                        self.error = Some("-222,\"Data out of range\"");
                    }
                    Some(Ok(volts)) => self.volts = volts,
                    _ if line.is_empty() => {}
                    _ => self.error = Some("-113,\"Undefined header\""),
                }
                return None;
            }
        };
        Some(answer)
    }
}

fn say(port: &mut TTYPort, answer: &str, manner: Manner, end: &AtomicBool) {
    let whole = format!("{answer}\n").into_bytes();
    let said = match manner {
        Manner::Good | Manner::Refuses | Manner::WrongReply => port.write_all(&whole),
        Manner::CrLf => port.write_all(format!("{answer}\r\n").as_bytes()),
        Manner::Silent => Ok(()),
        Manner::Garbage => port.write_all(b"\xFE\x80\x00\x1B\n"),
        Manner::Partial => port.write_all(&whole[..whole.len() / 2]),
        Manner::Endless => (0..64).try_for_each(|_| port.write_all(&[b'7'; 64])),
        Manner::Late(by) => {
            std::thread::sleep(by);
            port.write_all(&whole)
        }
        Manner::Drip => whole.iter().try_for_each(|byte| {
            if !end.load(Ordering::SeqCst) {
                std::thread::sleep(Duration::from_millis(50));
            }
            port.write_all(&[*byte])
        }),
    };
    // A reader that is gone is what some of these tests are about.
    let _ = said;
}

fn interlock(link: &SharedLink) -> (Interlock, Arc<Mutex<Vec<Report>>>) {
    let galvo = SerialGalvo::new(link.clone(), Duration::ZERO);
    let limits = Limits::new([-4.0, 4.0], 2000.0, 0.001).unwrap();
    let guarded = GuardedGalvo::new(Box::new(galvo), limits, Timeline::system());
    let policy = Policy { within: WITHIN, tries: 3, watchdog: None, ..Policy::default() };
    let told: Arc<Mutex<Vec<Report>>> = Arc::default();
    let tell = told.clone();
    let laser = Box::new(SerialLaser::new(link.clone()));
    (Interlock::engage(laser, guarded, policy, move |r| tell.lock().unwrap().push(r.clone())).unwrap(), told)
}

/// A controller in the middle of a sweep: the laser on, the mirror on its way.
fn sweeping() -> (Controller, Interlock, Handle, Arc<Mutex<Vec<Report>>>) {
    let controller = Controller::start();
    let (interlock, told) = interlock(&controller.link());
    let handle = interlock.handle();
    handle.laser_on().unwrap();
    for volts in [0.5, 1.0, 1.5] {
        handle.set(volts).unwrap();
    }
    assert!(controller.laser());
    (controller, interlock, handle, told)
}

#[test]
fn a_controller_is_driven_and_says_who_it_is() {
    for manner in [Manner::Good, Manner::CrLf] {
        let controller = Controller::start();
        controller.behave(manner);
        let link = controller.link();
        let identity = link.lock().unwrap().identity();
        assert_eq!((identity.vendor.as_str(), identity.model.as_str()), ("ACME", "DAC-16"));
        assert_eq!((identity.serial.as_str(), identity.firmware.as_str()), ("1234", "2.1"));
        let (interlock, _) = interlock(&link);
        let handle = interlock.handle();
        let moved = handle.set(-1.25).unwrap();
        assert!((moved.read_back.volts + 1.25).abs() < 1e-9);
        assert!(moved.read_back.stamp_ns >= moved.sent_ns);
        handle.laser_on().unwrap();
        assert_eq!((controller.laser(), handle.laser_is_on()), (true, Ok(true)));
        let report = interlock.finish();
        assert_eq!((report.reason.clone(), report.alarms()), (Reason::Done, vec![]));
        assert!(!controller.laser() && controller.state.lock().unwrap().volts.abs() < 1e-9);
    }
}

#[test]
fn whatever_the_controller_says_instead_is_a_typed_fault_in_time_and_the_laser_goes_off() {
    // Mostly waiting: all at the same time.
    let manners = [
        Manner::Silent,
        Manner::Drip,
        Manner::Garbage,
        Manner::Partial,
        Manner::Endless,
        Manner::Refuses,
        Manner::WrongReply,
        Manner::Late(WITHIN * 2),
    ];
    std::thread::scope(|scope| {
        for manner in manners {
            scope.spawn(move || fails_safe(manner));
        }
    });
}

fn fails_safe(manner: Manner) {
    let (controller, interlock, handle, told) = sweeping();
    controller.behave(manner);
    // The interlock's own tries are in here: three of the laser, one of the mirror.
    let began = Instant::now();
    let fault = handle.set(2.0).unwrap_err();
    let took = began.elapsed();
    assert!(took < WITHIN * 10 + GRACE, "{manner:?}: {took:?}");
    let typed = match manner {
        Manner::Silent | Manner::Partial | Manner::Drip | Manner::Late(_) => {
            matches!(&fault, Fault::Timeout { waited, .. } if *waited >= WITHIN && *waited < WITHIN + GRACE)
        }
        Manner::Endless => matches!(fault, Fault::Timeout { .. } | Fault::Protocol { .. }),
        Manner::Refuses => matches!(&fault, Fault::Refused { reason, .. } if reason.contains("-222")),
        _ => matches!(fault, Fault::Protocol { .. }),
    };
    assert!(typed, "{manner:?}: {fault}");
    if manner == Manner::Partial {
        assert!(fault.to_string().contains("only"), "what came is told: {fault}");
    }
    assert!(controller.heard("OUTP OFF") && !controller.laser(), "{manner:?}: the laser is on");
    assert!(handle.reason().is_some(), "{manner:?}");
    drop(interlock);
    let told = told.lock().unwrap();
    let confirmed = told.iter().any(|report| report.laser_off.is_ok());
    let loud = told.iter().any(|report| report.alarms().iter().any(|a| a.contains("MAY STILL BE ON")));
    assert!(confirmed || loud, "{manner:?}: neither off nor told: {told:?}");
}

#[test]
fn unplugging_in_mid_sweep_is_a_lost_link_at_once_and_told_aloud() {
    let (mut controller, interlock, handle, told) = sweeping();
    controller.unplug();
    let began = Instant::now();
    let fault = handle.set(2.0).unwrap_err();
    assert!(matches!(fault, Fault::Disconnected { .. }), "{fault}");
    assert!(began.elapsed() < WITHIN * 10 + GRACE);
    assert!(matches!(handle.reason(), Some(Reason::LinkLost(_))));
    drop(interlock);
    let told = told.lock().unwrap();
    assert!(told[0].alarms()[0].contains("THE LASER MAY STILL BE ON"), "{:?}", told[0].alarms());
    assert_eq!(told[0].tries, 3);
}

#[test]
fn answers_that_came_too_late_are_never_taken_for_later_ones() {
    let controller = Controller::start();
    let link = controller.link();
    let ask = |within| link.lock().unwrap().ask(Command::ReadVolts, within);
    for volts in [0.25, -3.5] {
        controller.state.lock().unwrap().volts = volts - 1.0;
        controller.behave(Manner::Late(Duration::from_millis(150)));
        assert!(matches!(ask(Duration::from_millis(60)), Err(Fault::Timeout { .. })));
        // The late answer, a voltage too, arrives while the next is being asked for.
        controller.behave(Manner::Good);
        controller.state.lock().unwrap().volts = volts;
        let reply = ask(Duration::from_secs(5)).unwrap().unwrap();
        assert_eq!(reply.number, Some(volts));
    }
}

#[test]
fn a_laser_is_shouted_off_though_the_line_is_in_disorder() {
    let controller = Controller::start();
    let link = controller.link();
    let mut laser = SerialLaser::new(link);
    laser.on(WITHIN).unwrap();
    assert!(controller.laser());
    controller.behave(Manner::Silent);
    assert!(matches!(laser.is_on(WITHIN), Err(Fault::Timeout { .. })));
    assert!(matches!(laser.off(WITHIN), Err(Fault::Timeout { .. })), "nobody confirms it");
    assert!(controller.heard("OUTP OFF") && !controller.laser());
    controller.behave(Manner::Good);
    assert_eq!((laser.off(WITHIN * 4), laser.is_on(WITHIN * 4)), (Ok(()), Ok(false)));
}

#[test]
fn a_port_that_is_missing_taken_or_silent_is_told_with_a_mend() {
    let open = |name: &str, within| {
        let port = Port { name: name.into(), baud: 115_200 };
        Link::open(port, Dialect::scpi(), Timeline::system(), within).unwrap_err()
    };
    let fault = open("/dev/no-such-port", WITHIN);
    assert!(matches!(&fault, Fault::Open { mend, .. } if mend.contains("uwscan devices")), "{fault}");
    let fault = open("/dev/null", WITHIN);
    assert!(matches!(&fault, Fault::Open { mend, .. } if mend.contains("serial port")), "{fault}");

    let controller = Controller::start();
    let _link = controller.link();
    let fault = open(&controller.port, WITHIN);
    assert!(
        matches!(&fault, Fault::Open { mend, .. } if mend.contains("program that has it open")),
        "{fault}"
    );

    let silent = Controller::start();
    silent.behave(Manner::Silent);
    let began = Instant::now();
    let fault = open(&silent.port, WITHIN);
    assert!(matches!(&fault, Fault::Timeout { doing, .. } if doing == "*IDN?"), "{fault}");
    assert!(began.elapsed() < WITHIN + GRACE);
}
