//! The thread that stops a scan that hangs.

use std::{
    sync::{Arc, Condvar, Mutex, PoisonError},
    thread::JoinHandle,
    time::Duration,
};

use super::Handle;

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
