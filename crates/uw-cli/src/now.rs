//! The time, as pages say it.

use std::time::{Duration, SystemTime};

/// The last second of the year 9999, which pages can still say.
const LAST_S: u64 = 253_402_300_799;

/// Now in UTC, such as `2026-11-28T18:20:00Z`; where `SOURCE_DATE_EPOCH` is set (reproducible-builds.org), that many seconds after 1970, so that
/// the same input gives the same page. `None` for a clock that shows no such time.
pub fn now() -> Option<String> {
    let seconds = match std::env::var("SOURCE_DATE_EPOCH") {
        Ok(text) => text.trim().parse().ok()?,
        Err(_) => SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).ok()?.as_secs(),
    };
    (seconds <= LAST_S).then(|| {
        humantime::format_rfc3339_seconds(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds)).to_string()
    })
}
