//! Ctrl-C and SIGTERM while the laser may be on.

use std::io;

use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM},
    iterator::Signals,
};
use uwscan::hw::interlock::{Handle, Reason};

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
