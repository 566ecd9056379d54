//! Recordings shown as if they were scanned now, with a time line.

use super::watch::told;
use super::without_folders;
use crate::Error;
use crate::live::{About, Action, Asked, Feed, Level, Mode, Phase, Replay, State, Stripe, Timeline};
use crate::pipeline::load::Reading;
use crate::pipeline::reconstruct::{Settings, outside};
use crate::pipeline::record::live::Preview;
use crate::pipeline::record::session::Shot;
use crossbeam_channel::{Receiver, RecvTimeoutError};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use uw_calib::Across;
use uw_hw::frame::Layout;
use uw_hw::{Exposure, Frame};
use uw_io::calibration_toml::{self, CalibrationFile};
use uw_io::{Capture, FrameRecord, GrayImage, Kind, Pixels, Rig, SaidBy};
use uw_live::feed::{Picture, now_ns};
use uw_stripe::Method;

/// Shortest and longest time from an image to the next.
const BETWEEN: (Duration, Duration) = (Duration::from_millis(10), Duration::from_secs(2));
/// How often it looks whether it is to end.
const LOOK: Duration = Duration::from_millis(200);
/// The setting of how many times as fast as it was recorded.
const RATE: &str = "replay.rate";
/// Points that are kept to be shown again after a jump.
const KEPT: usize = 1 << 20;

/// A recording that can be shown.
#[derive(Clone, Debug)]
pub struct Source {
    /// By which name it is asked for.
    pub name: String,
    /// The folder or file.
    pub path: PathBuf,
}

/// How a replay ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Replayed {
    /// It was asked to.
    Stopped,
    /// The server is gone.
    ServerGone,
}

/// Shows recordings, the first one to begin with, until `stop` says so. Points are made with `calibration`, or with what a recording has
/// attached.
///
/// # Errors
/// [`Error`] where the first recording can't be read; another one's is told to who asked for it.
pub fn replay(
    sources: &[Source],
    calibration: Option<&CalibrationFile>,
    feed: &Feed,
    asked: &Receiver<Asked>,
    stop: &dyn Fn() -> bool,
) -> Result<Replayed, Error> {
    let Some(first) = sources.first() else { return Ok(Replayed::Stopped) };
    let names: Vec<String> = sources.iter().map(|source| source.name.clone()).collect();
    let mut shown = first;
    let mut request = None;
    loop {
        let opened = Opened::new(shown, calibration);
        let (opened, warnings) = match (opened, request.take()) {
            (Ok(opened), request) => {
                if let Some(request) = request {
                    Asked::done(request);
                }
                opened
            }
            (Err(error), None) => return Err(error),
            (Err(error), Some(request)) => {
                let why = without_folders(&error.to_string(), &shown.path);
                Asked::refuse(request, &why);
                feed.note(Level::Error, why);
                shown = first;
                continue;
            }
        };
        warnings.iter().for_each(|text| feed.note(Level::Warning, without_folders(text, &shown.path)));
        let calibration = opened.calibration.clone();
        let mut player = Player::new(opened, calibration.as_ref(), shown, &names, feed)?;
        match player.play(asked, stop) {
            Next::End(end) => return Ok(end),
            Next::Open(at, asked) => (shown, request) = (&sources[at], Some(asked)),
        }
    }
}

enum Next {
    End(Replayed),
    Open(usize, Asked),
}

/// A recording and what it is read with.
struct Opened {
    capture: Capture,
    reading: Reading,
    calibration: Option<CalibrationFile>,
    rig: Rig,
}

impl Opened {
    fn new(source: &Source, given: Option<&CalibrationFile>) -> Result<(Self, Vec<String>), Error> {
        let mut capture = Capture::open(&source.path)?;
        let mut warnings: Vec<String> = capture.take_problems().iter().map(ToString::to_string).collect();
        let attached = capture.head().and_then(|head| head.calibration.clone());
        let calibration = match (given, attached) {
            (Some(given), _) => Some(given.clone()),
            (None, Some(text)) => Some(calibration_toml::parse(&source.path, &text)?.0),
            (None, None) => None,
        };
        let calibration = calibration.filter(|_| capture.kind == Kind::Scan);
        let (rig, said_by) = match (&calibration, &capture.rig) {
            (Some(file), _) => (file.rig.clone(), SaidBy::Calibration),
            (None, Some(rig)) => (rig.clone(), SaidBy::Rig),
            (None, None) => return Err(Error::NoRig { path: capture.path }),
        };
        if calibration.is_none() && capture.kind == Kind::Scan {
            warnings.push(format!(
                "{}: no calibration, so there are images and no points (-c gives one)",
                source.name
            ));
        }
        let reading = Reading::new(&rig, said_by);
        Ok((Self { capture, reading, calibration, rig }, warnings))
    }
}

struct Player<'a> {
    capture: Capture,
    reading: Reading,
    frames: Vec<FrameRecord>,
    preview: Option<Preview<'a>>,
    across: Across,
    feed: &'a Feed,
    name: &'a str,
    names: &'a [String],
    /// The stripe of each frame, where it was made and there is room for it.
    made: Vec<Option<Arc<Stripe>>>,
    kept: usize,
    /// Whether the cloud has the points of a frame.
    has: Vec<bool>,
    points: usize,
    /// The frame that is shown.
    at: usize,
    due: Instant,
    playing: bool,
    rate: f64,
    began: Instant,
}

impl<'a> Player<'a> {
    fn new(
        opened: Opened,
        calibration: Option<&'a CalibrationFile>,
        source: &'a Source,
        names: &'a [String],
        feed: &'a Feed,
    ) -> Result<Self, Error> {
        let Opened { capture, reading, rig, .. } = opened;
        let preview = calibration.map(|file| preview(&capture, file, feed)).transpose()?;
        let frames: Vec<FrameRecord> = capture.present().cloned().collect();
        let volts = frames.iter().filter_map(|frame| frame.voltage_v);
        let range = volts.clone().reduce(f64::min).zip(volts.reduce(f64::max));
        let across = calibration.map_or(Across::U, |file| file.calibration.across);
        feed.restart();
        feed.about(About {
            mode: Mode::Replay,
            image_size: [rig.camera.width, rig.camera.height],
            volts: range.map(|(from, to)| [from, to]),
            across,
            calibration: calibration.cloned().map(Arc::new),
            captures: names.to_vec(),
            parameters: vec![("frames".to_owned(), frames.len() as f64)],
        });
        feed.settings(vec![(RATE.to_owned(), 1.0)]);
        let count = frames.len();
        Ok(Self {
            capture,
            reading,
            frames,
            preview,
            across,
            feed,
            name: &source.name,
            names,
            made: vec![None; count],
            kept: 0,
            has: vec![false; count],
            points: 0,
            at: 0,
            due: Instant::now(),
            playing: true,
            rate: 1.0,
            began: Instant::now(),
        })
    }

    fn play(&mut self, asked: &Receiver<Asked>, stop: &dyn Fn() -> bool) -> Next {
        let mut shown = false;
        loop {
            if !shown {
                self.show();
                shown = true;
            }
            let last = self.at + 1 >= self.frames.len();
            if last && self.playing {
                self.playing = false;
                self.tell();
            }
            let left = self.due.saturating_duration_since(Instant::now());
            let mut wait = if self.playing { left.min(LOOK) } else { LOOK };
            // What was jumped over is made while there is time.
            if wait > BETWEEN.0 && self.fill() {
                wait = Duration::ZERO;
            }
            match asked.recv_timeout(wait) {
                Ok(asked) => match self.hear(asked) {
                    Heard::Open(at, asked) => return Next::Open(at, asked),
                    Heard::Show => shown = false,
                    Heard::Done => {}
                },
                Err(RecvTimeoutError::Disconnected) => return Next::End(Replayed::ServerGone),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if stop() {
                return Next::End(Replayed::Stopped);
            }
            if self.playing && shown && Instant::now() >= self.due {
                self.at += 1;
                shown = false;
            }
        }
    }

    fn hear(&mut self, asked: Asked) -> Heard {
        let frames = self.frames.len();
        let heard = match &asked.action {
            Action::Replay(Replay::Open(name)) => match self.names.iter().position(|other| other == name) {
                Some(at) => return Heard::Open(at, asked),
                None => Err(format!("there is no recording of the name {name}")),
            },
            Action::Replay(Replay::Play) | Action::Resume => {
                self.playing = true;
                if self.at + 1 >= frames {
                    self.jump(0);
                }
                Ok(Heard::Show)
            }
            Action::Replay(Replay::Pause) | Action::Pause => {
                self.playing = false;
                Ok(Heard::Done)
            }
            Action::Replay(Replay::Seek(to)) if (*to as usize) < frames => {
                self.jump(*to as usize);
                Ok(Heard::Show)
            }
            Action::Replay(Replay::Seek(_)) => Err(format!("it has {frames} images, counted from 0")),
            Action::Replay(Replay::Rate(rate)) => {
                self.play_at(*rate);
                Ok(Heard::Done)
            }
            Action::Set { name, value } if name == RATE => match Replay::rate(*value) {
                Some(Replay::Rate(rate)) => {
                    self.play_at(rate);
                    Ok(Heard::Done)
                }
                _ => Err("a rate is from 0.01 to 100".to_owned()),
            },
            Action::Set { .. } => Err("this is not to be set in a recording".to_owned()),
            // Nothing shines: that is what was asked for.
            Action::LaserOff => Ok(Heard::Done),
            Action::Start | Action::Stop => Err("this is a recording, not a scan".to_owned()),
        };
        match heard {
            Ok(heard) => {
                asked.done();
                self.tell();
                heard
            }
            Err(why) => {
                asked.refuse(&why);
                Heard::Done
            }
        }
    }

    fn play_at(&mut self, rate: f64) {
        self.rate = rate;
        self.due = Instant::now() + self.between();
        self.feed.settings(vec![(RATE.to_owned(), rate)]);
    }

    /// Goes to a frame: the cloud is what it was then.
    fn jump(&mut self, to: usize) {
        self.at = to;
        self.feed.restart();
        self.has.fill(false);
        self.points = 0;
        for at in 0..to {
            if let Some(stripe) = self.made[at].clone() {
                self.has[at] = true;
                self.points += stripe.cloud.len();
                self.feed.points(&stripe);
            }
        }
    }

    /// Makes the points of one frame before the one that is shown; false where all are there.
    fn fill(&mut self) -> bool {
        if self.preview.is_none() {
            return false;
        }
        let Some(at) = (0..self.at).find(|at| !self.has[*at]) else { return false };
        self.has[at] = true;
        if let Some((_, Some(stripe))) = self.make(at) {
            self.points += stripe.cloud.len();
            self.feed.points(&stripe);
            self.tell();
        }
        true
    }

    /// Shows the frame where it is, and says when the next is due.
    fn show(&mut self) {
        if self.at < self.frames.len()
            && let Some((picture, stripe)) = self.make(self.at)
        {
            match stripe {
                Some(stripe) if !std::mem::replace(&mut self.has[self.at], true) => {
                    self.points += stripe.cloud.len();
                    self.feed.image(picture);
                    self.feed.stripe(stripe);
                }
                _ => self.feed.bare_image(picture),
            }
        }
        self.due = Instant::now() + self.between();
        self.tell();
    }

    /// From the frame that is shown to the next.
    fn between(&self) -> Duration {
        let stamp = |at: usize| self.frames.get(at).map(|frame| frame.stamp_ns);
        let Some((this, next)) = stamp(self.at).zip(stamp(self.at + 1)) else { return BETWEEN.1 };
        let apart = Duration::from_nanos(next.saturating_sub(this)).div_f64(self.rate);
        apart.clamp(BETWEEN.0, BETWEEN.1)
    }

    /// A frame's image and stripe; `None` where it can't be read, which is told.
    fn make(&mut self, at: usize) -> Option<(Picture, Option<Arc<Stripe>>)> {
        let record = &self.frames[at];
        let image = match self.reading.stripe(&self.capture, record) {
            Ok(image) => image,
            Err(error) => {
                let text = without_folders(&error.to_string(), &self.capture.path);
                self.feed.note(Level::Warning, text);
                return None;
            }
        };
        let image = frame(image, record.stamp_ns)?;
        let number = u32::try_from(record.row).unwrap_or(u32::MAX);
        let picture = Picture {
            frame: number,
            stamp_ns: record.stamp_ns,
            laser_on: record.laser_on,
            voltage_v: record.voltage_v,
            image: image.clone(),
        };
        if let Some(stripe) = &self.made[at] {
            return Some((picture, Some(stripe.clone())));
        }
        let shot = Shot {
            number,
            pose: record.pose,
            laser_on: record.laser_on,
            voltage_v: record.voltage_v,
            frame: image,
        };
        let lines = match self.across {
            Across::U => shot.frame.height(),
            Across::V => shot.frame.width(),
        };
        let stripe = self.preview.as_mut().zip(record.voltage_v).and_then(|(preview, voltage_v)| {
            let traced = preview.trace.points(preview.extract.see(&shot)?);
            let bits = shot.frame.significant_bits();
            Some(Arc::new(told(&traced.stripe(), voltage_v, &traced.cloud, lines, bits)))
        });
        if let Some(stripe) = stripe.as_ref().filter(|stripe| self.kept + stripe.cloud.len() <= KEPT) {
            self.kept += stripe.cloud.len();
            self.made[at] = Some(stripe.clone());
        }
        Some((picture, stripe))
    }

    fn tell(&self) {
        let stamp = |frame: Option<&FrameRecord>| frame.map_or(0, |frame| frame.stamp_ns);
        self.feed.timeline(Timeline {
            capture: self.name.to_owned(),
            start_ns: stamp(self.frames.first()),
            end_ns: stamp(self.frames.last()),
            frames: self.frames.len(),
            at_frame: self.at,
            playing: self.playing,
            rate: self.rate,
        });
        let left = self.frames.len().saturating_sub(self.at + 1);
        self.feed.state(State {
            phase: if self.playing { Phase::Replaying } else { Phase::Paused },
            voltage_v: self.frames.get(self.at).and_then(|frame| frame.voltage_v),
            frames: (self.at + 1).min(self.frames.len()),
            planned: Some(self.frames.len()),
            points: self.points,
            rate_hz: if self.playing { 1.0 / self.between().as_secs_f64() } else { 0.0 },
            elapsed_s: self.began.elapsed().as_secs_f64(),
            left_s: self.playing.then(|| left as f64 * self.between().as_secs_f64()),
            recording: Some(self.name.to_owned()),
            stamp_ns: now_ns(),
            ..State::default()
        });
    }
}

enum Heard {
    Done,
    Show,
    Open(usize, Asked),
}

/// Extraction and triangulation for a recording.
fn preview<'a>(capture: &Capture, file: &'a CalibrationFile, feed: &Feed) -> Result<Preview<'a>, Error> {
    let mut warnings = Vec::new();
    let nominal = capture.rig.as_ref().and_then(Rig::water_index);
    let settings = Settings::default();
    let medium = outside(capture.medium, nominal, &capture.path, file, &settings, &mut warnings)?;
    warnings.iter().for_each(|text| feed.note(Level::Warning, without_folders(text, &capture.path)));
    let bits = file.rig.camera.bits;
    Preview::new(file, medium, bits, Method::Robust)
        .map_err(|source| Error::Stripe { path: capture.path.clone(), source })
}

/// An image as a camera would have given it.
fn frame(image: GrayImage, stamp_ns: u64) -> Option<Frame> {
    let bits = (image.full_scale.checked_ilog2().unwrap_or(0) + 1) as u8;
    let layout = Layout::packed(image.width, image.height, bits);
    let stamp_ns = i64::try_from(stamp_ns).unwrap_or(i64::MAX);
    let exposure = Exposure { stamp_ns, exposure_ns: 0, received_ns: stamp_ns };
    let pixels = match image.data {
        Pixels::U8(values) => uw_hw::Pixels::from(values),
        Pixels::U16(values) => uw_hw::Pixels::from(values),
    };
    Frame::new(pixels, layout, 0, exposure).ok()
}
