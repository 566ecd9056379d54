//! Where a recording's bytes go, and that they are made durable beside the writing.

use std::{
    fs::File,
    io::{self, Write},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering::Relaxed},
        mpsc::{SyncSender, TrySendError, sync_channel},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

/// Makes durable what was written so far.
pub type MakeDurable = Box<dyn FnMut() -> io::Result<()> + Send>;

/// Takes a recording's bytes, in order.
pub trait Sink: Write {
    /// What makes the bytes durable, called from another thread while more are written; `None` where nothing lasts.
    ///
    /// # Errors
    /// The operating system refused.
    fn durable(&self) -> io::Result<Option<MakeDurable>> {
        Ok(None)
    }

    /// Takes back all after the first `length` bytes, after a write that failed half way.
    ///
    /// # Errors
    /// The operating system refused.
    fn cut(&mut self, length: u64) -> io::Result<()> {
        let _ = length;
        Ok(())
    }
}

impl Sink for File {
    fn durable(&self) -> io::Result<Option<MakeDurable>> {
        let file = self.try_clone()?;
        Ok(Some(Box::new(move || file.sync_data())))
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)
    }
}

/// A writer that is nothing but that: what it wrote is made durable, or taken back, by whoever owns it.
pub struct Through<'w>(pub &'w mut dyn Write);

impl Write for Through<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Sink for Through<'_> {}

impl Sink for Vec<u8> {
    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.truncate(usize::try_from(length).unwrap_or(usize::MAX));
        Ok(())
    }
}

/// What the durable thread has seen.
#[derive(Debug, Default)]
struct Seen {
    syncs: u64,
    longest: Duration,
    error: Option<io::Error>,
}

/// A thread of its own that makes bytes durable: a slow disk then delays that, not the writing, until the system's own
/// buffers are full.
pub(super) struct Durable {
    ask: Option<SyncSender<()>>,
    seen: Arc<Mutex<Seen>>,
    thread: Option<JoinHandle<()>>,
}

impl Durable {
    pub fn start(mut make: MakeDurable) -> io::Result<Self> {
        let (ask, asked) = sync_channel::<()>(1);
        let seen = Arc::new(Mutex::new(Seen::default()));
        let theirs = Arc::clone(&seen);
        let thread = std::thread::Builder::new().name("uwscan-sync".to_owned()).spawn(move || {
            while asked.recv().is_ok() {
                let began = Instant::now();
                let made = make();
                let mut seen = theirs.lock().unwrap_or_else(PoisonError::into_inner);
                seen.syncs += 1;
                seen.longest = seen.longest.max(began.elapsed());
                if let Err(error) = made {
                    seen.error.get_or_insert(error);
                }
            }
        })?;
        Ok(Self { ask: Some(ask), seen, thread: Some(thread) })
    }

    /// Asks for all that was written by now; whether the thread is still busy with more than one earlier request.
    pub fn ask(&self) -> bool {
        let full = |ask: &SyncSender<()>| matches!(ask.try_send(()), Err(TrySendError::Full(())));
        self.ask.as_ref().is_some_and(full)
    }

    /// The first failure, once.
    pub fn error(&self) -> Option<io::Error> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).error.take()
    }

    /// How often it was made durable, and how long that took at worst.
    pub fn figures(&self) -> (u64, Duration) {
        let seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        (seen.syncs, seen.longest)
    }

    /// Asks once more, and waits until it is done.
    pub fn ask_and_wait(&mut self) {
        if let Some(ask) = self.ask.take() {
            // The thread only ends after this end of the channel does.
            let _ = ask.send(());
        }
        self.wait();
    }

    fn wait(&mut self) {
        self.ask = None;
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has nothing to say: what it was to do is then not done, which the last sync shows.
            let _ = thread.join();
        }
    }
}

impl Drop for Durable {
    fn drop(&mut self) {
        self.wait();
    }
}

/// What passed through a [`Counted`].
#[derive(Debug, Default)]
pub(super) struct Tally {
    pub bytes: AtomicU64,
    /// The longest that a write took.
    pub longest_ns: AtomicU64,
}

/// Counts what passes through.
pub(super) struct Counted<S> {
    pub sink: S,
    pub tally: Arc<Tally>,
}

impl<S: Sink> Write for Counted<S> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let began = Instant::now();
        let written = self.sink.write(bytes)?;
        self.tally.longest_ns.fetch_max(began.elapsed().as_nanos() as u64, Relaxed);
        self.tally.bytes.fetch_add(written as u64, Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
}
