//! The thread that takes a device's buffers as they fill: copies of them wait for whoever wants frames, so that the device always has room.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    thread::JoinHandle,
    time::Duration,
};

use moq_v4l::{
    Device,
    buffer::{Metadata, Type},
    io::{
        mmap,
        traits::{CaptureStream, Stream as _},
    },
};

use crate::Timeline;

/// Buffers that the device fills; drivers may give fewer.
const BUFFERS: u32 = 8;
/// Copies that wait. Beyond them the device finds no empty buffer, and counts what it drops.
const WAITING: usize = 16;
/// How long the thread waits for a frame before it looks whether it is to end, ms.
const LOOK_MS: i32 = 50;
/// `POLLIN` of poll(2): there is something to take.
const POLLIN: i16 = 1;
/// `ENODEV`: the device is gone.
const GONE: i32 = 19;

/// A buffer that was filled.
pub(super) struct Filled {
    pub bytes: Vec<u8>,
    pub about: Metadata,
    pub received_ns: i64,
}

/// Reads until it is dropped, or the device fails.
pub(super) struct Reader {
    filled: Receiver<Result<Filled, String>>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Reader {
    /// Has the device stream.
    ///
    /// # Errors
    /// What the system says.
    pub fn start(device: &Device, timeline: Timeline) -> io::Result<Self> {
        let mut stream = mmap::Stream::with_buffers(device, Type::VideoCapture, BUFFERS)?;
        let mut queued = 0;
        for index in 0..BUFFERS as usize {
            match CaptureStream::queue(&mut stream, index) {
                Ok(()) => queued += 1,
                // Where there are fewer than asked for, and one can be filled while another is copied.
                Err(_) if queued >= 2 => break,
                Err(e) => return Err(e),
            }
        }
        stream.start()?;
        let (fill, filled) = sync_channel(WAITING);
        let ended = Arc::new(AtomicBool::new(false));
        let end = ended.clone();
        let thread = std::thread::Builder::new()
            .name("uwscan-v4l2".into())
            .spawn(move || read(stream, &fill, &end, &timeline))?;
        Ok(Self { filled, ended, thread: Some(thread) })
    }

    /// The next buffer; `Ok(None)` where none came in time.
    ///
    /// # Errors
    /// Why there will be none any more.
    pub fn next(&self, within: Duration) -> Result<Option<Filled>, String> {
        match self.filled.recv_timeout(within) {
            Ok(Ok(filled)) => Ok(Some(filled)),
            Ok(Err(why)) => Err(why),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err("its stream has ended".into()),
        }
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        // The thread may wait for room.
        while self.filled.try_recv().is_ok() {}
        if let Some(thread) = self.thread.take() {
            // It panics only where the bindings do; the stream has ended then, too.
            let _ = thread.join();
        }
    }
}

fn read(
    mut stream: mmap::Stream<'_>,
    fill: &SyncSender<Result<Filled, String>>,
    ended: &AtomicBool,
    timeline: &Timeline,
) {
    let handle = stream.handle();
    let mut first = true;
    while !ended.load(Ordering::Acquire) {
        match handle.poll(POLLIN, LOOK_MS) {
            Ok(0) => continue,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
            // A fault shows where the buffer is taken.
            Ok(_) | Err(_) => {}
        }
        let received_ns = timeline.stamp_ns();
        // The bindings hand a buffer out only after they gave one back, so the very first frame is not seen.
        let taken = if std::mem::take(&mut first) {
            CaptureStream::dequeue(&mut stream).map(|_| None)
        } else {
            stream.next().map(|(bytes, about)| {
                let used = bytes.len().min(about.bytesused as usize);
                Some(Filled { bytes: bytes[..used].to_vec(), about: *about, received_ns })
            })
        };
        let told = match taken {
            Ok(None) => continue,
            Ok(Some(filled)) => fill.send(Ok(filled)),
            Err(e) => {
                let _ = fill.send(Err(e.to_string()));
                break;
            }
        };
        if told.is_err() {
            break;
        }
    }
    if let Err(e) = stream.stop()
        && e.raw_os_error() != Some(GONE)
    {
        // The bindings would stop it once more, and panic where that fails.
        std::mem::forget(stream);
    }
}
