//! The thread that stops a scan that hangs, and what is no hang though it takes long.

use std::{
    sync::{
        Arc, Condvar, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

use super::Handle;
use crate::Fault;

/// Looks several times in the watchdog's time.
const LOOKS: u32 = 8;
const LONGEST: Duration = Duration::from_millis(200);
const SHORTEST: Duration = Duration::from_millis(1);

/// Looks until it is dropped.
pub(super) struct Watch {
    ended: Arc<(Mutex<bool>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

impl Watch {
    pub fn start(handle: &Handle) -> Self {
        let ended = Arc::new((Mutex::new(false), Condvar::new()));
        let thread = handle.shared.policy.watchdog.map(|watchdog| {
            let (handle, ended) = (handle.clone(), ended.clone());
            std::thread::spawn(move || {
                let every = (watchdog / LOOKS).clamp(SHORTEST, LONGEST);
                let mut end = ended.0.lock().unwrap_or_else(PoisonError::into_inner);
                while !*end {
                    end = ended.1.wait_timeout(end, every).unwrap_or_else(PoisonError::into_inner).0;
                    if !*end {
                        handle.check_watchdog();
                    }
                }
            })
        });
        Self { ended, thread }
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        *self.ended.0.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.ended.1.notify_all();
        if let Some(thread) = self.thread.take() {
            // It panics only where a device or the report's listener does; then there is nothing left to do here.
            let _ = thread.join();
        }
    }
}

/// How often the watchdog is fed while something is waited for that is known to take long.
const FEED: Duration = Duration::from_millis(20);

/// How long a rest goes on after the interlock has stopped, at most.
const LOOK: Duration = Duration::from_millis(20);

impl Handle {
    /// Waits, as for a mirror that settles; comes back early once the interlock has stopped. Does not feed the watchdog.
    ///
    /// # Errors
    /// [`Fault::Stopped`].
    pub fn rest(&self, duration: Duration) -> Result<(), Fault> {
        let timeline = self.timeline();
        let until = timeline.deadline(duration);
        while let Some(left) = timeline.left(until) {
            timeline.sleep(left.min(LOOK));
            self.refuse_if_stopped()?;
        }
        Ok(())
    }

    /// Does what is known to take long, such as looking for a camera, and feeds the watchdog meanwhile. The laser is to be off.
    pub fn patiently<T>(&self, work: impl FnOnce() -> T) -> T {
        let done = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !done.load(Ordering::Acquire) {
                    self.feed();
                    std::thread::sleep(FEED);
                }
            });
            // On the way out of a panic, too: the scope waits for the feeder.
            let _ended = Ended(&done);
            work()
        })
    }
}

struct Ended<'a>(&'a AtomicBool);

impl Drop for Ended<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}
