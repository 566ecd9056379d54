//! The time that scans are stamped with.

use super::Findings;
use super::files::Files;
use std::time::{Duration, SystemTime};
use uw_hw::StepWatch;

/// The first day of 2025: no clock that was ever set is before it. Seconds since the Unix epoch.
const NEVER_BEFORE: Duration = Duration::from_secs(1_735_689_600);
/// By how much files may be newer than now: two machines' clocks.
const APART: Duration = Duration::from_secs(120);

pub(super) fn examine(files: &Files, findings: &mut Findings<'_>) {
    findings.about("clock");
    let changed = |path: &std::path::PathBuf| path.metadata().and_then(|about| about.modified()).ok();
    let newest = files.paths.iter().filter_map(changed).max();
    judge(SystemTime::now(), newest, findings);
}

fn judge(now: SystemTime, newest: Option<SystemTime>, findings: &mut Findings<'_>) {
    let mend = "set the machine's clock: by network (NTP), GNSS or hand (`date`)";
    if now < SystemTime::UNIX_EPOCH + NEVER_BEFORE {
        findings.fault("the machine's clock was never set: it is before 2025", mend);
    } else if let Some(ahead) =
        newest.and_then(|newest| newest.duration_since(now).ok()).filter(|ahead| *ahead > APART)
    {
        let what = format!(
            "the machine's clock is behind: the vehicle's files were changed {:.0} s after now",
            ahead.as_secs_f64()
        );
        findings.fault(what, mend);
    } else {
        findings.good("set, and not behind the vehicle's files");
    }
}

/// Whether the clock was set during the examination.
pub(super) fn stepped(mut watch: StepWatch, findings: &mut Findings<'_>) {
    findings.about("clock");
    if let Some(step) = watch.check() {
        let what = format!(
            "the machine's clock stepped by {:+.3} s while it was looked at",
            step.by_ns as f64 * 1e-9
        );
        findings.warning(what, "let the time server slew instead of step, or start it before the scan");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::doctor::Verdict;

    #[test]
    fn a_clock_that_was_never_set_or_is_behind_is_found() {
        let at = |seconds| SystemTime::UNIX_EPOCH + Duration::from_secs(seconds);
        for (now, newest, verdict, said) in [
            (86_400, None, Verdict::Fault, "before 2025"),
            (1_800_000_000, Some(1_800_003_600), Verdict::Fault, "3600 s after now"),
            (1_800_000_000, Some(1_800_000_060), Verdict::Good, "not behind"),
            (1_800_000_000, None, Verdict::Good, "set"),
        ] {
            let mut findings = Findings::new(&|_| {});
            judge(at(now), newest.map(at), &mut findings);
            let all = findings.into_all();
            assert_eq!((all.len(), all[0].verdict), (1, verdict), "{all:?}");
            assert!(all[0].what.contains(said), "{all:?}");
        }
    }
}
