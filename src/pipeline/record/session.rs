//! The threads of a scan and the bounded queues between them.
//!
//! ```text
//!              ┌─► recorder ───────────────► file
//!   acquire ───┤      ▲
//!              └─► extract ─► triangulate ─► points, on the fly
//! ```
//!
//! The recording comes first. Where its queue is full, whoever paces the exposures waits; who can't, because the camera paces itself,
//! loses the frame: counted, logged and told of in the recording ([`Loss::RecorderBehind`]), never silently. Extraction never holds the
//! recording up: a frame that finds it busy is recorded without points on the fly, and is counted; the final cloud, which is made from
//! the recording, has them.

use crate::pipeline::record::live::{Preview, Traced};
use crate::pipeline::record::steer::{Phase, Steering};
use crate::pipeline::record::tally::{Loss, Tally};
use crossbeam_channel::{Receiver, RecvTimeoutError, SendTimeoutError, Sender, TrySendError, bounded};
use std::collections::VecDeque;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use uw_cloud::PointCloud;
use uw_hw::{Frame, Pixels, Timeline};
use uw_io::recording::{self, GalvoState, Level, Picture, Recorder, Sink};

/// Memory that frames waiting for the recorder may take: three seconds of 100 frames of 768 × 576 pixels, which a disk may stall.
const WAITING_BYTES: usize = 128 << 20;
/// Fewest and most frames that may wait, whatever their size.
const WAITING_FRAMES: (usize, usize) = (4, 512);
/// Frames that wait for extraction, and stripes for triangulation: more would only make points later.
const WAITING_PREVIEW: usize = 4;
/// Small entries that may wait for room in the queue.
const MOST_OWED: usize = 100_000;
/// How often the recorder looks whether time alone asks for something to be written.
const TICK: Duration = Duration::from_millis(50);
/// How often it looks how much room there is left, and after how many bytes of images.
const LOOK: Duration = Duration::from_millis(250);
const LOOK_BYTES: usize = 8 << 20;

/// One exposure, as acquisition hands it on.
#[derive(Clone, Debug)]
pub struct Shot {
    /// From 0, one more an exposure that is wanted, lost or not: the `frame` of its points.
    pub number: u32,
    /// Which placement of the target it shows; `None` in a scan.
    pub pose: Option<u32>,
    /// Whether the laser was on.
    pub laser_on: bool,
    /// The galvanometer's voltage in the middle of the exposure; `None` where the laser was off.
    pub voltage_v: Option<f64>,
    /// The image.
    pub frame: Frame,
}

/// An exposure that was wanted and has no image.
#[derive(Clone, Debug)]
pub struct Missing {
    /// As [`Shot::number`].
    pub number: u32,
    /// Whether the laser was on.
    pub laser_on: bool,
    /// The galvanometer's voltage as commanded; `None` where the laser was off.
    pub voltage_v: Option<f64>,
    /// Why.
    pub why: Loss,
    /// When, nanoseconds since the Unix epoch.
    pub at_ns: i64,
}

/// What waits for the recorder.
enum Entry {
    Shot(Shot),
    Missing(Missing),
    Galvo(GalvoState),
    Traced(Box<Traced>),
    Log(Level, String, i64),
}

/// What acquisition does where the recorder's queue is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pressure {
    /// Wait, and give the scan up in the end: for exposures that we trigger.
    Wait {
        /// How long, before whoever waits shows that it is alive.
        each: Duration,
        /// How often.
        times: u32,
    },
    /// Lose the frame, and count it: for a camera that runs by itself.
    Lose,
}

/// The recording can't go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// The recorder failed; its error comes with the session's end.
    Failed,
    /// The recorder took nothing for as long as [`Pressure::Wait`] says.
    Stalled,
    /// The disk has less room than it is to have; all until now is recorded.
    NoRoom {
        /// Bytes that are free.
        free_bytes: u64,
        /// Bytes that have to be.
        needed_bytes: u64,
    },
}

/// Room that has to be left where the recording goes.
#[derive(Clone, Copy, Debug)]
pub struct Room<'a> {
    /// The recording.
    pub path: &'a Path,
    /// Bytes that have to stay free; 0: none.
    pub min_free_bytes: u64,
}

impl Room<'_> {
    /// What is free, where that is less than it has to be. A system that doesn't say has room.
    pub fn shortage(&self) -> Option<u64> {
        self.free().filter(|free| *free < self.min_free_bytes)
    }

    /// What is free, where it matters and the system says so.
    fn free(&self) -> Option<u64> {
        if self.min_free_bytes == 0 {
            return None;
        }
        uw_io::disk::free_bytes(self.path).ok().flatten()
    }
}

/// What became of the recording.
#[derive(Debug)]
pub struct Recorded {
    /// What the recorder counted; `None` where it failed.
    pub counts: Option<recording::Counts>,
    /// Why it failed.
    pub error: Option<uw_io::Error>,
}

/// Told of what happens while a scan runs; called from several threads.
pub trait Observer: Sync {
    /// A frame is in the recording.
    fn recorded(&self, _tally: &Tally) {}
    /// The points of one image, camera frame; none, too.
    fn points(&self, _number: u32, _cloud: &PointCloud) {}
    /// A frame came from the camera. Called by the thread that paces the exposures: it must not be kept.
    fn exposed(&self, _shot: &Shot) {}
    /// The stripe of one image that was lit at a voltage, and its points.
    fn traced(&self, _stripe: &recording::Stripe<'_>, _voltage_v: f64, _cloud: &PointCloud) {}
    /// The scan goes on, is held, or drives nothing any more.
    fn phase(&self, _phase: Phase, _tally: &Tally) {}
    /// What it is steered by from other threads; `None`: nothing.
    fn steering(&self) -> Option<&Steering> {
        None
    }
}

/// The queue to extraction.
struct Offers {
    queue: Sender<Shot>,
    /// Whether extraction is waited for.
    every: bool,
    /// Frames that it took.
    handed: usize,
}

impl Offers {
    fn offer(&mut self, shot: Shot) -> bool {
        let taken =
            if self.every { self.queue.send(shot).is_ok() } else { self.queue.try_send(shot).is_ok() };
        self.handed += usize::from(taken);
        taken
    }
}

/// Where acquisition puts what it got.
pub struct Feed<'s> {
    tally: &'s Tally,
    observer: &'s dyn Observer,
    timeline: &'s Timeline,
    pressure: Pressure,
    record: Sender<Entry>,
    preview: Option<Offers>,
    failed: &'s AtomicBool,
    short: &'s Short,
    /// Told of with the next entry for which there is room: what there was no room for.
    owed: VecDeque<Entry>,
}

impl<'s> Feed<'s> {
    /// The scan's counts.
    pub fn tally(&self) -> &'s Tally {
        self.tally
    }

    /// Who is told.
    pub(crate) fn observer(&self) -> &'s dyn Observer {
        self.observer
    }

    /// The scan's clock.
    pub fn timeline(&self) -> &Timeline {
        self.timeline
    }

    /// Hands a frame on to the recorder and, if it is free, to extraction; `waiting` is called each time that
    /// [`Pressure::Wait`] has passed.
    ///
    /// # Errors
    /// [`Refused`]: nothing more will be recorded.
    pub fn shot(&mut self, shot: Shot, waiting: &dyn Fn()) -> Result<(), Refused> {
        self.tally.acquired();
        self.observer.exposed(&shot);
        let preview = (shot.laser_on && self.preview.is_some()).then(|| shot.clone());
        let missing = Missing {
            number: shot.number,
            laser_on: shot.laser_on,
            voltage_v: shot.voltage_v,
            why: Loss::RecorderBehind,
            at_ns: shot.frame.exposure().received_ns,
        };
        match self.put(Entry::Shot(shot), waiting) {
            Ok(true) => {
                if let (Some(shot), Some(queue)) = (preview, &mut self.preview)
                    && !queue.offer(shot)
                {
                    self.tally.skipped();
                }
                // Only now: this frame is in.
                self.short.check(self.record.len())
            }
            Ok(false) => self.missing(missing),
            Err(Refused::Stalled) => {
                self.tally.lost(Loss::RecorderBehind, 1);
                Err(Refused::Stalled)
            }
            Err(refused) => {
                self.tally.lost(Loss::RecorderFailed, 1);
                Err(refused)
            }
        }
    }

    /// Whether points of all that was handed on are made.
    pub fn previewed(&self) -> bool {
        self.preview.as_ref().is_none_or(|queue| queue.handed == self.tally.through())
    }

    /// Tells that an exposure has no image.
    ///
    /// # Errors
    /// As [`Feed::shot`].
    pub fn missing(&mut self, missing: Missing) -> Result<(), Refused> {
        self.tally.lost(missing.why, 1);
        let text = match missing.voltage_v {
            Some(volts) => {
                format!("frame {} at {volts:.4} V is lost: {}", missing.number, missing.why.name())
            }
            None => format!("frame {} is lost: {}", missing.number, missing.why.name()),
        };
        let at_ns = missing.at_ns;
        self.owe(Entry::Missing(missing))?;
        self.log(Level::Error, text, at_ns)
    }

    /// Hands on what the galvanometer said.
    ///
    /// # Errors
    /// As [`Feed::shot`].
    pub fn galvo(&mut self, state: GalvoState) -> Result<(), Refused> {
        self.owe(Entry::Galvo(state))
    }

    /// Hands on a line for people.
    ///
    /// # Errors
    /// As [`Feed::shot`].
    pub fn log(&mut self, level: Level, text: String, at_ns: i64) -> Result<(), Refused> {
        self.owe(Entry::Log(level, text, at_ns))
    }

    /// Whether the recorder is still there.
    ///
    /// # Errors
    /// [`Refused::Failed`] where it is not.
    pub fn check(&self) -> Result<(), Refused> {
        if self.failed.load(Ordering::Acquire) { Err(Refused::Failed) } else { Ok(()) }
    }

    /// Puts what is small, now or with the next entry for which there is room.
    fn owe(&mut self, entry: Entry) -> Result<(), Refused> {
        self.check()?;
        if self.owed.len() > MOST_OWED {
            return Err(Refused::Stalled);
        }
        self.owed.push_back(entry);
        self.pay()
    }

    /// Sends what is owed, as far as there is room.
    fn pay(&mut self) -> Result<(), Refused> {
        self.tally.queued(self.record.len());
        while let Some(entry) = self.owed.pop_front() {
            match self.record.try_send(entry) {
                Ok(()) => {}
                Err(TrySendError::Full(entry)) => {
                    self.owed.push_front(entry);
                    return Ok(());
                }
                Err(TrySendError::Disconnected(_)) => return Err(Refused::Failed),
            }
        }
        Ok(())
    }

    /// Sends an entry after all that is owed; false where there is no room for it and none is waited for.
    fn put(&mut self, entry: Entry, waiting: &dyn Fn()) -> Result<bool, Refused> {
        self.check()?;
        self.pay()?;
        self.owed.push_back(entry);
        let Pressure::Wait { each, times } = self.pressure else {
            self.pay()?;
            // The last one is the one: it is lost, what was owed before it is not.
            return Ok(self.owed.is_empty() || self.owed.pop_back().is_none());
        };
        let mut waits = 0;
        while let Some(first) = self.owed.pop_front() {
            match self.record.send_timeout(first, each) {
                Ok(()) => {}
                Err(SendTimeoutError::Disconnected(_)) => return Err(Refused::Failed),
                Err(SendTimeoutError::Timeout(_)) if waits == times => return Err(Refused::Stalled),
                Err(SendTimeoutError::Timeout(first)) => {
                    self.owed.push_front(first);
                    self.check()?;
                    waits += 1;
                    waiting();
                }
            }
        }
        Ok(true)
    }
}

/// What a session works with.
pub struct Session<'s, S: Sink> {
    /// Writes the recording.
    pub recorder: Recorder<S>,
    /// Makes points on the fly; `None`: they are only made at the end.
    pub preview: Option<Preview<'s>>,
    /// Whether acquisition waits for extraction rather than to leave frames out of the points on the fly.
    pub preview_every: bool,
    /// What to do where the recorder does not keep up.
    pub pressure: Pressure,
    /// Bytes of one frame: how many may wait follows.
    pub frame_bytes: usize,
    /// The clock of all stamps.
    pub timeline: &'s Timeline,
    /// Room that has to be left.
    pub room: Room<'s>,
    /// Where it is counted.
    pub tally: &'s Tally,
    /// Who is told.
    pub observer: &'s dyn Observer,
}

/// Runs `acquire` on this thread, with the recorder, extraction and triangulation on threads of their own; comes back once all that
/// was acquired is through, and the recording is finished.
pub fn run<S: Sink + Send, T>(
    session: Session<'_, S>,
    acquire: impl FnOnce(&mut Feed<'_>) -> T,
) -> (T, Recorded) {
    let Session { recorder, preview, preview_every, pressure, frame_bytes, timeline, room, tally, observer } =
        session;
    let (fewest, most) = WAITING_FRAMES;
    let waiting = (WAITING_BYTES / frame_bytes.max(1)).clamp(fewest, most);
    let (record, to_record) = bounded::<Entry>(waiting);
    let failed = AtomicBool::new(false);
    let error = Mutex::new(None);
    let free_bytes = AtomicU64::new(room.free().unwrap_or(u64::MAX));
    let short = Short { needed_bytes: room.min_free_bytes, frame_bytes, free_bytes };
    std::thread::scope(|scope| {
        let recording = scope.spawn({
            let (failed, error, short) = (&failed, &error, &short);
            move || {
                let told = Told { tally, observer, timeline, frame_bytes, failed, error, room, short };
                write(recorder, &to_record, told)
            }
        });
        let shots = preview.map(|preview| {
            let (shots, to_extract) = bounded::<Shot>(WAITING_PREVIEW);
            let (stripes, to_trace) = bounded(WAITING_PREVIEW);
            let Preview { mut extract, trace } = preview;
            let record = record.clone();
            scope.spawn(move || {
                for shot in to_extract {
                    if let Some(seen) = extract.see(&shot)
                        && stripes.send(seen).is_err()
                    {
                        break;
                    }
                }
            });
            scope.spawn(move || {
                for seen in to_trace {
                    let traced = trace.points(seen);
                    let late_ns = timeline.stamp_ns().saturating_sub(traced.exposed_ns);
                    tally.previewed(traced.cloud.len(), u64::try_from(late_ns / 1000).unwrap_or(0));
                    observer.points(traced.frame, &traced.cloud);
                    observer.traced(&traced.stripe(), traced.voltage_v, &traced.cloud);
                    if record.send(Entry::Traced(Box::new(traced))).is_err() {
                        break;
                    }
                }
            });
            Offers { queue: shots, every: preview_every, handed: 0 }
        });
        let mut feed = Feed {
            tally,
            observer,
            timeline,
            pressure,
            record,
            preview: shots,
            failed: &failed,
            short: &short,
            owed: VecDeque::new(),
        };
        let made = acquire(&mut feed);
        // What is still owed waits for room: nobody paces anything any more. Where it fails, the recorder's error says why.
        feed.owed.into_iter().for_each(|entry| drop(feed.record.send(entry)));
        drop((feed.record, feed.preview));
        let counts = recording.join().ok().flatten();
        let error = error.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
        (made, Recorded { counts, error })
    })
}

/// What the recorder's thread tells the others.
#[derive(Clone, Copy)]
struct Told<'s> {
    tally: &'s Tally,
    observer: &'s dyn Observer,
    timeline: &'s Timeline,
    frame_bytes: usize,
    failed: &'s AtomicBool,
    error: &'s Mutex<Option<uw_io::Error>>,
    room: Room<'s>,
    short: &'s Short,
}

/// Told by the recorder, which looks, to acquisition, which ends.
struct Short {
    needed_bytes: u64,
    frame_bytes: usize,
    free_bytes: AtomicU64,
}

impl Short {
    /// `waiting` frames are still to be written: their room is taken.
    fn check(&self, waiting: usize) -> Result<(), Refused> {
        let taken = (waiting * self.frame_bytes) as u64;
        match self.free_bytes.load(Ordering::Relaxed).saturating_sub(taken) {
            free_bytes if free_bytes < self.needed_bytes => {
                Err(Refused::NoRoom { free_bytes, needed_bytes: self.needed_bytes })
            }
            _ => Ok(()),
        }
    }
}

/// Writes what comes until nobody is left to send; after a failure takes what still comes, and counts it.
fn write<S: Sink>(
    recorder: Recorder<S>,
    entries: &Receiver<Entry>,
    told: Told<'_>,
) -> Option<recording::Counts> {
    let Told { tally, observer, timeline, frame_bytes, failed, error, room, short } = told;
    let (mut looked, mut since_bytes) = (Instant::now(), 0);
    let mut recorder = Some(recorder);
    let fail = |e: uw_io::Error| {
        *error.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(e);
        failed.store(true, Ordering::Release);
    };
    loop {
        if since_bytes >= LOOK_BYTES || looked.elapsed() >= LOOK {
            (looked, since_bytes) = (Instant::now(), 0);
            if let Some(free) = room.free() {
                short.free_bytes.store(free, Ordering::Relaxed);
            }
        }
        let entry = match entries.recv_timeout(TICK) {
            Ok(entry) => Some(entry),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => break,
        };
        let Some(writer) = &mut recorder else {
            tally.lost(Loss::RecorderFailed, usize::from(matches!(entry, Some(Entry::Shot(_)))));
            continue;
        };
        let is_shot = matches!(entry, Some(Entry::Shot(_)));
        let written = match entry {
            Some(entry) => put(writer, entry, unsigned(timeline.stamp_ns())),
            None => writer.tick(),
        };
        match written {
            Ok(()) if is_shot => {
                since_bytes += frame_bytes;
                tally.recorded();
                observer.recorded(tally);
            }
            Ok(()) => {}
            Err(e) => {
                tally.lost(Loss::RecorderFailed, usize::from(is_shot));
                recorder = None;
                fail(e);
            }
        }
    }
    match recorder?.finish() {
        Ok(counts) => Some(counts),
        Err(e) => {
            fail(e);
            None
        }
    }
}

fn put<S: Sink>(recorder: &mut Recorder<S>, entry: Entry, now_ns: u64) -> Result<(), uw_io::Error> {
    match entry {
        Entry::Shot(shot) => {
            let frame = &shot.frame;
            let row = recording::Shot {
                number: shot.number,
                file: "",
                pose: shot.pose,
                laser_on: shot.laser_on,
                voltage_v: shot.voltage_v,
                stamp_ns: unsigned(frame.exposure().stamp_ns),
                bits: frame.significant_bits(),
            };
            let received_ns = unsigned(frame.exposure().received_ns);
            let (width, height) = (frame.width(), frame.height());
            match frame.pixels() {
                Pixels::U8(values) => {
                    let pixels = &packed(frame, values)[..];
                    recorder.frame(&row, &Picture::U8 { width, height, pixels }, received_ns)
                }
                Pixels::U16(values) => {
                    let pixels = &packed(frame, values)[..];
                    recorder.frame(&row, &Picture::U16 { width, height, pixels }, received_ns)
                }
            }
        }
        Entry::Missing(missing) => {
            let row = recording::Shot {
                number: missing.number,
                file: "",
                pose: None,
                laser_on: missing.laser_on,
                voltage_v: missing.voltage_v,
                stamp_ns: unsigned(missing.at_ns),
                bits: 0,
            };
            recorder.lost_frame(&row, missing.why.name(), now_ns)
        }
        Entry::Galvo(state) => recorder.galvo(&state, now_ns),
        Entry::Traced(traced) => {
            recorder.stripe(&traced.stripe(), now_ns)?;
            recorder.points(&traced.cloud, traced.stamp_ns, now_ns)
        }
        Entry::Log(level, text, at_ns) => recorder.log(level, &text, unsigned(at_ns)),
    }
}

/// The rows without what lies between them.
fn packed<'v, P: Copy>(frame: &Frame, values: &'v [P]) -> std::borrow::Cow<'v, [P]> {
    let (width, height, stride) = (frame.width() as usize, frame.height() as usize, frame.stride());
    if stride == width {
        return values[..width * height].into();
    }
    (0..height)
        .flat_map(|row| &values[row * stride..row * stride + width])
        .copied()
        .collect::<Vec<P>>()
        .into()
}

/// A stamp as recordings have it; those before 1970 are none.
pub(crate) fn unsigned(stamp_ns: i64) -> u64 {
    u64::try_from(stamp_ns).unwrap_or(0)
}
