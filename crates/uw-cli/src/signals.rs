//! Ctrl-C and SIGTERM while the laser may be on.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM},
    iterator::Signals,
};
use uwscan::{
    hw::interlock::{Handle, Reason},
    pipeline::record::Steering,
};

/// Stops the interlock at the first signal, so that the scan ends by itself and keeps what it has; leaves at the second, the laser
/// off once more.
///
/// # Errors
/// The system refuses.
pub fn stop_on_signals(handle: Handle) -> io::Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    std::thread::Builder::new().name("uwscan-signals".to_owned()).spawn(move || {
        let mut asked = false;
        for signal in signals.forever() {
            handle.stop(Reason::Signal(signal));
            if asked {
                std::process::exit(128 + signal);
            }
            asked = true;
        }
    })?;
    Ok(())
}

/// How often it is looked for signals, and for a scan that is to end and only just begins.
const AGAIN: Duration = Duration::from_millis(50);

/// Ends what is scanned at the first signal, and raises the flag; leaves at the second.
///
/// # Errors
/// The system refuses.
pub fn end_on_signals(steering: Steering) -> io::Result<Arc<AtomicBool>> {
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    let ending = Arc::new(AtomicBool::new(false));
    let flag = ending.clone();
    std::thread::Builder::new().name("uwscan-signals".to_owned()).spawn(move || {
        let mut first = None;
        let mut ended = false;
        loop {
            for signal in signals.pending() {
                if first.is_some() {
                    steering.stop_for(Reason::Signal(signal));
                    std::process::exit(128 + signal);
                }
                first = Some(signal);
                flag.store(true, Ordering::Release);
            }
            // Once: whoever scans next sees the flag before.
            if let Some(signal) = first.filter(|_| !ended) {
                ended = steering.stop_for(Reason::Signal(signal));
            }
            std::thread::sleep(AGAIN);
        }
    })?;
    Ok(ending)
}
