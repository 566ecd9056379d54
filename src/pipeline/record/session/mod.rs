//! The threads of a scan and the bounded queues between them.
//!
//! ```text
//!              ┌─► recorder ───────────────► file
//!   acquire ───┤      ▲
//!              └─► extract ─► triangulate ─► points, on the fly
//! ```
//!
//! The recording comes first. Where its queue is full, whoever paces the exposures waits; who can't, because the camera paces itself,
//! loses the frame: counted, logged and told of in the recording ([`Loss::RecorderBehind`](super::tally::Loss::RecorderBehind)), never silently. Extraction never holds the
//! recording up: a frame that finds it busy is recorded without points on the fly, and is counted; the final cloud, which is made from
//! the recording, has them.

mod feed;
mod room;
mod writer;

use crate::pipeline::record::live::Preview;
use crate::pipeline::record::steer::{Phase, Steering};
use crate::pipeline::record::tally::Tally;
use crossbeam_channel::bounded;
use feed::{Entry, Offers};
pub use feed::{Feed, Missing, Pressure, Refused, Shot};
pub use room::Room;
use room::Short;
use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64};
use uw_cloud::PointCloud;
use uw_hw::Timeline;
use uw_io::recording::{self, Recorder, Sink};
pub(crate) use writer::unsigned;
use writer::{Told, write};

/// Memory that frames waiting for the recorder may take: three seconds of 100 frames of 768 × 576 pixels, which a disk may stall.
const WAITING_BYTES: usize = 128 << 20;
/// Fewest and most frames that may wait, whatever their size.
const WAITING_FRAMES: (usize, usize) = (4, 512);
/// Frames that wait for extraction, and stripes for triangulation: more would only make points later.
const WAITING_PREVIEW: usize = 4;

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
