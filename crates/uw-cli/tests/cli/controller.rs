//! A controller at the other end of a pseudo-terminal, as an instrument's firmware would do it, with what can be wrong with one.

use std::{
    collections::VecDeque,
    io::{Read, Write},
    os::fd::AsRawFd,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use serialport::{SerialPort, TTYPort};

/// What is wrong with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Manner {
    Good,
    Silent,
    /// Answers the question for a voltage with a word.
    WrongReply,
    /// The mirror stays where it is.
    Stuck,
    /// The mirror goes no farther than this, V.
    Reaches(f64),
    /// The mirror comes to its place with this time constant.
    Lags(Duration),
    /// The laser acknowledges, and stays off.
    LaserStaysOff,
    /// The laser acknowledges, and stays on.
    LaserStaysOn,
}

#[derive(Debug)]
struct State {
    manner: Manner,
    from_v: f64,
    to_v: f64,
    sent: Instant,
    laser: bool,
    /// Whether the laser was ever on.
    lit: bool,
    errors: VecDeque<String>,
}

/// Serves until it is dropped.
pub struct Controller {
    pub port: String,
    state: Arc<Mutex<State>>,
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Controller {
    pub fn start(manner: Manner) -> Self {
        Self::watched(manner, |_, _| {})
    }

    /// `seen` is told, before the command is answered, where the mirror was sent, V, and whether the laser is on then.
    pub fn watched(manner: Manner, mut seen: impl FnMut(f64, bool) + Send + 'static) -> Self {
        let (mut master, slave) = TTYPort::pair().unwrap();
        for end in [master.as_raw_fd(), slave.as_raw_fd()] {
            // Or the programs that tests start would hold the line, and never see it unplugged.
            fcntl(end, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).unwrap();
        }
        let port = slave.name().unwrap();
        master.set_timeout(Duration::from_millis(5)).unwrap();
        let state = State {
            manner,
            from_v: 0.0,
            to_v: 0.0,
            sent: Instant::now(),
            laser: manner == Manner::LaserStaysOn,
            lit: false,
            errors: VecDeque::new(),
        };
        let (state, end) = (Arc::new(Mutex::new(state)), Arc::new(AtomicBool::new(false)));
        let thread = {
            let (state, end) = (state.clone(), end.clone());
            std::thread::spawn(move || {
                // Kept open, so that reading does not fail while no program has the port open.
                let _slave = slave;
                let (mut line, mut byte) = (Vec::new(), [0]);
                while !end.load(Ordering::SeqCst) {
                    match master.read(&mut byte) {
                        Ok(1) if byte[0] == b'\n' => {
                            let text = String::from_utf8_lossy(&line).trim().to_owned();
                            line.clear();
                            let answer = {
                                let mut state = state.lock().unwrap();
                                let answer = state.answer(&text);
                                if text.starts_with("SOUR:VOLT ") || text.starts_with("OUTP ") {
                                    seen(state.to_v, state.laser);
                                }
                                answer
                            };
                            if let Some(answer) = answer {
                                master.write_all(format!("{answer}\n").as_bytes()).unwrap();
                            }
                        }
                        Ok(1) => line.push(byte[0]),
                        _ => {}
                    }
                }
            })
        };
        Self { port, state, end, thread: Some(thread) }
    }

    /// Puts an error into its queue, as an earlier program would have left one.
    pub fn complain(&self, error: &str) {
        self.state.lock().unwrap().errors.push_back(error.to_owned());
    }

    pub fn laser_is_on(&self) -> bool {
        self.state.lock().unwrap().laser
    }

    pub fn laser_was_on(&self) -> bool {
        self.state.lock().unwrap().lit
    }

    /// Where its mirror was sent last, V.
    pub fn sent_to(&self) -> f64 {
        self.state.lock().unwrap().to_v
    }
}

impl Drop for Controller {
    fn drop(&mut self) {
        self.end.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl State {
    fn volts(&self) -> f64 {
        match self.manner {
            Manner::Stuck => 0.0,
            Manner::Reaches(most) => self.to_v.clamp(-most, most),
            Manner::Lags(constant) => {
                let left = (-self.sent.elapsed().as_secs_f64() / constant.as_secs_f64()).exp();
                self.to_v + (self.from_v - self.to_v) * left
            }
            _ => self.to_v,
        }
    }

    fn answer(&mut self, line: &str) -> Option<String> {
        if self.manner == Manner::Silent {
            return None;
        }
        if let Some(volts) = line.strip_prefix("SOUR:VOLT ") {
            (self.from_v, self.to_v, self.sent) = (self.volts(), volts.parse().unwrap(), Instant::now());
            return None;
        }
        match line {
            "" | "*RST" => None,
            "*IDN?" => Some("ACME,Mirror 2,0042,1.3".into()),
            "*OPC?" => Some("1".into()),
            "SOUR:VOLT?" if self.manner == Manner::WrongReply => Some("BANANA".into()),
            "SOUR:VOLT?" => Some(format!("{:.6}", self.volts())),
            "SYST:ERR?" => Some(self.errors.pop_front().unwrap_or_else(|| "0,\"No error\"".into())),
            "OUTP?" => Some(u8::from(self.laser).to_string()),
            "OUTP ON" | "OUTP OFF" => {
                let stays = [Manner::LaserStaysOff, Manner::LaserStaysOn].contains(&self.manner);
                if !stays {
                    self.laser = line == "OUTP ON";
                }
                self.lit |= self.laser;
                None
            }
            other => {
                self.errors.push_back(format!("-113,\"Undefined header: {other}\""));
                None
            }
        }
    }
}
