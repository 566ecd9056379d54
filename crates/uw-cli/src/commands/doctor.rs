//! `uwscan doctor`: what is wrong with a vehicle's set-up, and how to mend it.

use std::{cell::Cell, path::PathBuf};

use serde::Serialize;
use uwscan::{
    hw::interlock::{Handle, Report},
    pipeline::doctor::{Finding, LaserUse, Verdict, examine},
};

use crate::{console::Console, exit::Outcome, output, signals, text::many};

/// Arguments of `doctor`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The mirror is driven from end to end of galvo.range_v, with the laser off. The laser is switched on only with \
    --laser, for a few images. Exit code 1: there is a fault, and no scan would be right."
)]
pub struct Args {
    /// Vehicle file: devices, limits, sweep
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Switch the laser on for a moment: nobody can look into it
    #[arg(long)]
    laser: bool,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Record {
    findings: Vec<FindingRecord>,
    faults: usize,
    warnings: usize,
}

#[derive(Serialize)]
struct FindingRecord {
    subject: &'static str,
    verdict: &'static str,
    what: String,
    mend: Option<String>,
}

/// Examines, and prints each finding as it is made.
///
/// # Errors
/// There is a fault, or standard output can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let printed = Cell::new(Ok(()));
    let subject = Cell::new("");
    let tell = |finding: &Finding| {
        if !args.json {
            let text = text(finding, subject.replace(finding.subject));
            let so_far = printed.replace(Ok(()));
            printed.set(so_far.and_then(|()| output::print(text)));
        }
    };
    let (alarm, signals) = (console.clone(), console.clone());
    let engaged = move |handle: Handle| {
        if let Err(error) = signals::stop_on_signals(handle) {
            signals.warn(format_args!("cannot listen for Ctrl-C: {error}"));
        }
    };
    let use_of_laser = if args.laser { LaserUse::Allowed } else { LaserUse::Off };
    let findings = examine(&args.config, use_of_laser, &tell, &engaged, move |report: &Report| {
        report.alarms().iter().for_each(|text| alarm.error(text));
    });
    printed.into_inner()?;
    let count = |verdict| findings.iter().filter(|finding| finding.verdict == verdict).count();
    let (faults, warnings) = (count(Verdict::Fault), count(Verdict::Warning));
    if args.json {
        let findings = findings.into_iter().map(|finding| FindingRecord {
            subject: finding.subject,
            verdict: finding.verdict.name(),
            what: finding.what,
            mend: Some(finding.mend).filter(|mend| !mend.is_empty()),
        });
        output::json(&Record { findings: findings.collect(), faults, warnings })?;
    }
    if faults > 0 {
        anyhow::bail!("{} and {}: mend these first", many(faults, "fault"), many(warnings, "warning"));
    }
    Ok(Outcome::Done)
}

/// A finding as a line, and its mend below; the subject is said once.
fn text(finding: &Finding, before: &str) -> String {
    let Finding { subject, verdict, what, mend } = finding;
    let said = if *subject == before { "" } else { subject };
    let verdict = match verdict {
        Verdict::Fault => "FAULT",
        other => other.name(),
    };
    let mut text = format!("{said:14}{verdict:9}{what}\n");
    if !mend.is_empty() {
        text += &format!("{:23}→ {mend}\n", "");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subject_is_said_once_and_a_mend_stands_below() {
        let mut finding = Finding {
            subject: "galvo",
            verdict: Verdict::Fault,
            what: "does not move".into(),
            mend: "free it".into(),
        };
        let mend = format!("{:23}→ free it\n", "");
        assert_eq!(text(&finding, "rig"), format!("galvo         FAULT    does not move\n{mend}"));
        (finding.verdict, finding.mend) = (Verdict::Good, String::new());
        assert_eq!(text(&finding, "galvo"), "              good     does not move\n");
    }
}
