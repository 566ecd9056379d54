//! The recorder's thread.

use super::Observer;
use super::feed::Entry;
use super::room::{Room, Short};
use crate::pipeline::record::tally::{Loss, Tally};
use crossbeam_channel::{Receiver, RecvTimeoutError};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use uw_hw::{Frame, Pixels, Timeline};
use uw_io::recording::{self, Picture, Recorder, Sink};

/// How often the recorder looks whether time alone asks for something to be written.
const TICK: Duration = Duration::from_millis(50);
/// How often it looks how much room there is left, and after how many bytes of images.
const LOOK: Duration = Duration::from_millis(250);
const LOOK_BYTES: usize = 8 << 20;

/// What the recorder's thread tells the others.
#[derive(Clone, Copy)]
pub(super) struct Told<'s> {
    pub tally: &'s Tally,
    pub observer: &'s dyn Observer,
    pub timeline: &'s Timeline,
    pub frame_bytes: usize,
    pub failed: &'s AtomicBool,
    pub error: &'s Mutex<Option<uw_io::Error>>,
    pub room: Room<'s>,
    pub short: &'s Short,
}

/// Writes what comes until nobody is left to send; after a failure takes what still comes, and counts it.
pub(super) fn write<S: Sink>(
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
