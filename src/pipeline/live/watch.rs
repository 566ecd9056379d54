//! A scan that is watched: what happens goes to the feed, and what is asked for comes back.

use super::without_folders;
use crate::live::{About, Action, Asked, Feed, Laser, Level, Mode, Phase, State, Stripe};
use crate::pipeline::record::session::{Observer, Shot, unsigned};
use crate::pipeline::record::{self, Counts, Plan, Scanned, SteerError, Steering, Tally};
use crossbeam_channel::Receiver;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use uw_calib::Across;
use uw_cloud::PointCloud;
use uw_hw::CameraSettings;
use uw_io::calibration_toml::CalibrationFile;
use uw_io::recording;
use uw_live::feed::{Picture, now_ns};

/// Frames, and the time, over which a rate is told.
const RATE_FRAMES: usize = 256;
const RATE_OVER: Duration = Duration::from_secs(2);

/// What is watched.
#[derive(Clone, Copy, Debug)]
pub struct Watched<'a> {
    /// One scan, or one of a station's.
    pub mode: Mode,
    /// The recording.
    pub recording: &'a Path,
    /// What is visited.
    pub plan: &'a Plan,
    /// How the camera is set up.
    pub camera: &'a CameraSettings,
    /// The instrument, calibrated.
    pub calibration: Option<&'a CalibrationFile>,
}

/// An observer that feeds a scan to whoever watches.
pub struct Watch {
    feed: Feed,
    steering: Steering,
    recording: PathBuf,
    bits: u8,
    lines: u32,
    calibrated: bool,
    running: Mutex<Running>,
}

struct Running {
    state: State,
    began: Instant,
    /// How long it was held, and since when it is.
    held: Duration,
    held_since: Option<Instant>,
    frames: VecDeque<Instant>,
    told_lost: usize,
}

impl Watch {
    /// Shows that a scan starts; `steering` is what it is steered by.
    pub fn new(feed: Feed, steering: Steering, watched: &Watched<'_>) -> Self {
        let Watched { mode, recording, plan, camera, calibration } = *watched;
        let volts = plan.range_v();
        let across = calibration.map_or(Across::U, |file| file.calibration.across);
        let [width, height] = camera.size;
        let mut parameters = vec![
            ("exposure_ms".to_owned(), camera.exposure.as_secs_f64() * 1e3),
            ("planned".to_owned(), plan.images() as f64),
        ];
        if let Some([from, to]) = volts {
            parameters.extend([("sweep.from_v".to_owned(), from), ("sweep.to_v".to_owned(), to)]);
        }
        feed.restart();
        feed.about(About {
            mode,
            image_size: camera.size,
            volts,
            across,
            calibration: calibration.cloned().map(Arc::new),
            captures: Vec::new(),
            parameters,
        });
        let state = State {
            phase: Phase::Starting,
            laser: Laser::Off,
            recording: recording.file_name().map(|name| name.to_string_lossy().into_owned()),
            planned: Some(plan.images()),
            ..State::default()
        };
        feed.state(state.clone());
        let running = Running {
            state,
            began: Instant::now(),
            held: Duration::ZERO,
            held_since: None,
            frames: VecDeque::new(),
            told_lost: 0,
        };
        Self {
            feed,
            steering,
            recording: recording.to_owned(),
            bits: camera.significant_bits,
            lines: match across {
                Across::U => height,
                Across::V => width,
            },
            calibrated: calibration.is_some(),
            running: Mutex::new(running),
        }
    }

    fn running(&self) -> MutexGuard<'_, Running> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells a phase that the scan itself does not know of.
    pub fn ended(&self, result: Result<&Scanned, &str>) {
        let mut running = self.running();
        match result {
            Ok(scanned) => {
                running.count(&scanned.counts);
                running.state.phase = Phase::Finished;
                running.state.left_s = None;
                running.state.laser =
                    if scanned.report.laser_off.is_ok() { Laser::Off } else { Laser::Unknown };
                running.state.ended = scanned.ended.as_ref().map(|ended| self.named(&ended.to_string()));
                scanned.report.alarms().iter().for_each(|text| self.note(Level::Error, text));
                scanned.warnings.iter().for_each(|text| self.note(Level::Warning, text));
                if let Some(error) = &scanned.recording_error {
                    self.note(Level::Error, &format!("the recording was cut off: {error}"));
                }
                if let Some(Err(failure)) = &scanned.made {
                    self.note(Level::Warning, &format!("no cloud: {failure}"));
                }
            }
            Err(why) => {
                running.state.phase = Phase::Failed;
                running.state.ended = Some(self.named(why));
                self.note(Level::Error, why);
            }
        }
        self.tell(&mut running);
    }

    /// What viewers get of a text.
    fn named(&self, text: &str) -> String {
        without_folders(text, &self.recording)
    }

    fn note(&self, level: Level, text: &str) {
        self.feed.note(level, self.named(text));
    }

    fn tell(&self, running: &mut Running) {
        let now = Instant::now();
        running.state.stamp_ns = now_ns();
        let held = running.held_since.map_or(Duration::ZERO, |since| now - since) + running.held;
        if running.state.phase != Phase::Finished {
            running.state.elapsed_s = (running.began.elapsed().saturating_sub(held)).as_secs_f64();
        }
        self.feed.state(running.state.clone());
    }
}

impl Running {
    fn count(&mut self, counts: &Counts) {
        self.state.frames = counts.recorded;
        self.state.planned = Some(counts.planned);
        self.state.points = counts.points;
        self.state.lost = counts.lost.iter().map(|(why, count)| ((*why).to_owned(), *count)).collect();
    }

    /// Frames a second over the last ones.
    fn frame(&mut self) {
        let now = Instant::now();
        self.frames.push_back(now);
        while self.frames.len() > RATE_FRAMES
            || self.frames.front().is_some_and(|first| now - *first > RATE_OVER && self.frames.len() > 2)
        {
            self.frames.pop_front();
        }
        if let (Some(first), true) = (self.frames.front(), self.frames.len() > 1) {
            let took = (now - *first).as_secs_f64().max(1e-6);
            self.state.rate_hz = (self.frames.len() - 1) as f64 / took;
        }
        let left = self.state.planned.map(|planned| planned.saturating_sub(self.state.frames));
        self.state.left_s = left.filter(|_| self.state.rate_hz > 0.0).map(|n| n as f64 / self.state.rate_hz);
    }
}

impl Observer for Watch {
    fn recorded(&self, tally: &Tally) {
        let counts = tally.counts();
        let mut running = self.running();
        running.count(&counts);
        running.frame();
        let lost = counts.lost_frames();
        if lost > running.told_lost {
            let more = lost - running.told_lost;
            running.told_lost = lost;
            let why: Vec<&str> = counts.lost.keys().copied().collect();
            self.feed.note(
                Level::Warning,
                format!("{more} more images are lost, {lost} in all: {}", why.join(", ").replace('_', " ")),
            );
        }
        self.tell(&mut running);
    }

    fn exposed(&self, shot: &Shot) {
        {
            let mut running = self.running();
            running.state.laser = if shot.laser_on { Laser::On } else { Laser::Off };
            running.state.voltage_v = shot.voltage_v.or(running.state.voltage_v);
        }
        let picture = Picture {
            frame: shot.number,
            stamp_ns: unsigned(shot.frame.exposure().stamp_ns),
            laser_on: shot.laser_on,
            voltage_v: shot.voltage_v,
            image: shot.frame.clone(),
        };
        if self.calibrated && shot.laser_on {
            self.feed.image(picture);
        } else {
            self.feed.bare_image(picture);
        }
    }

    fn traced(&self, stripe: &recording::Stripe<'_>, voltage_v: f64, cloud: &PointCloud) {
        self.feed.stripe(told(stripe, voltage_v, cloud, self.lines, self.bits));
    }

    fn phase(&self, phase: record::Phase, tally: &Tally) {
        let mut running = self.running();
        running.count(&tally.counts());
        let now = Instant::now();
        if let Some(since) = running.held_since.take() {
            running.held += now - since;
            running.frames.clear();
        }
        match phase {
            record::Phase::Scanning => running.state.phase = Phase::Scanning,
            record::Phase::Held => {
                running.state.phase = Phase::Paused;
                running.state.laser = Laser::Off;
                running.held_since = Some(now);
            }
            record::Phase::Ending { laser_off } => {
                running.state.phase = Phase::Stopping;
                running.state.laser = if laser_off { Laser::Off } else { Laser::Unknown };
                running.state.left_s = None;
            }
        }
        self.tell(&mut running);
    }

    fn steering(&self) -> Option<&Steering> {
        Some(&self.steering)
    }
}

/// A stripe as the feed takes it.
pub(super) fn told(
    stripe: &recording::Stripe<'_>,
    voltage_v: f64,
    cloud: &PointCloud,
    all_lines: u32,
    bits: u8,
) -> Stripe {
    Stripe {
        frame: stripe.frame,
        stamp_ns: stripe.stamp_ns,
        voltage_v,
        across: stripe.across,
        all_lines,
        lines: stripe.lines.to_vec(),
        position_px: stripe.position_px.to_vec(),
        sigma_px: stripe.sigma_px.to_vec(),
        width_px: stripe.width_px.to_vec(),
        amplitude: stripe.amplitude.to_vec(),
        full_scale: ((1_u32 << bits.min(16)) - 1) as f32,
        cloud: cloud.clone(),
    }
}

/// What can be asked for of who scans, besides what its steering does. None of it is to wait for a scan: the laser could not be put off meanwhile.
pub trait Station {
    /// Begins a scan.
    ///
    /// # Errors
    /// Why there is none.
    fn start(&mut self) -> Result<(), String>;

    /// Gives a setting ([`Feed::settings`]) another value, for whoever asked.
    ///
    /// # Errors
    /// Why it stays as it was.
    fn set(&mut self, name: &str, value: f64, who: &str) -> Result<(), String>;
}

/// A scan that was begun when the program was, and is as it was begun.
#[derive(Clone, Copy, Debug)]
pub struct OneScan;

impl Station for OneScan {
    fn start(&mut self) -> Result<(), String> {
        Err("there is one scan, and it runs already".to_owned())
    }

    fn set(&mut self, _: &str, _: f64, _: &str) -> Result<(), String> {
        Err("a scan is as it was begun".to_owned())
    }
}

/// Does what clients ask for of the scans that `steering` steers, until nobody can ask any more.
pub fn obey(asked: &Receiver<Asked>, steering: &Steering, feed: &Feed, station: &mut dyn Station) {
    for asked in asked {
        let who = asked.who.clone();
        let done = match &asked.action {
            Action::Start => station.start(),
            Action::Pause => steering.hold(&who).map_err(words),
            Action::Resume => steering.resume(&who).map_err(words),
            Action::Stop => steering.stop(&who).map_err(words),
            Action::LaserOff => laser_off(steering, &who),
            Action::Replay(_) => Err("this is a scan, not a recording".to_owned()),
            Action::Set { name, value } => station.set(name, *value, &who),
        };
        let name = match &asked.action {
            Action::Set { name, value } => format!("{name} = {value}"),
            action => action.name().to_owned(),
        };
        match done {
            Ok(()) => {
                let level =
                    if matches!(asked.action, Action::LaserOff) { Level::Warning } else { Level::Info };
                asked.done();
                feed.note(level, format!("{name}, asked for by {who}"));
            }
            Err(why) => {
                asked.refuse(&why);
                feed.note(Level::Warning, format!("{name}, asked for by {who}, is not done: {why}"));
            }
        }
    }
}

/// The laser is off where nothing is scanned, too.
fn laser_off(steering: &Steering, who: &str) -> Result<(), String> {
    match steering.laser_off(who) {
        Err(SteerError::Nothing) => Ok(()),
        done => done.map_err(words),
    }
}

#[expect(clippy::needless_pass_by_value, reason = "it is what map_err hands on")]
fn words(error: SteerError) -> String {
    error.to_string()
}
