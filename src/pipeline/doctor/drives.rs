//! Controllers on serial ports, the galvanometer and the laser.

use super::{Findings, LaserUse, ms};
use crate::Error;
use crate::pipeline::instrument::{Drives, guard};
use std::sync::{MutexGuard, PoisonError};
use std::time::Duration;
use uw_hw::galvo::proto::Command;
use uw_hw::galvo::serial::{Link, SharedLink};
use uw_hw::interlock::{Handle, Interlock, Report};
use uw_hw::sweep::measure_settling;
use uw_hw::{Fault, GuardedGalvo, Timeline};
use uw_io::vehicle::Vehicle;

/// How long the mirror gets to come to rest, of its stated settling time, and at least.
const PATIENCE: u32 = 10;
const LEAST_PATIENCE: Duration = Duration::from_millis(100);

const NO_ANSWER: &str = "check power and cable, that the port is the controller's (`uwscan devices`), and baud; a controller that knows no \
    *IDN? needs identify = { send = \"\" } in its dialect";
const WRONG_ANSWER: &str =
    "give what it really says in the dialect of the vehicle file (docs/formats.md, section 5)";
const MIRROR: &str =
    "check that the mirror is free, its drive has power, and read_volts of the dialect asks for the position";

/// What to do about a controller that can't be opened.
pub(super) fn not_opened(vehicle: &Vehicle, error: &Error, findings: &mut Findings<'_>) {
    let own_port = vehicle.laser.port.as_deref();
    match error {
        Error::Instrument(fault) => {
            if own_port.is_some_and(|port| fault.to_string().contains(port)) {
                findings.about("laser");
            }
            findings.device(fault, mend_of(fault));
        }
        other => findings.error(other),
    }
}

fn mend_of(fault: &Fault) -> &'static str {
    match fault {
        Fault::Timeout { got, .. } if got.is_empty() => NO_ANSWER,
        Fault::Timeout { .. } => {
            "check galvo.baud and the dialect's terminator: what came has no end of line"
        }
        Fault::Protocol { .. } => WRONG_ANSWER,
        Fault::NotFollowing { .. } => MIRROR,
        Fault::Refused { .. } => "check the command in the dialect, and that the controller allows the value",
        _ => "check cable and power",
    }
}

/// Looks at controllers and mirror with the laser off, and puts them behind their interlock; `None` where the laser can't be put off.
pub(super) fn examine(
    vehicle: &Vehicle,
    drives: Drives,
    timeline: &Timeline,
    alarm: impl Fn(&Report) + Send + Sync + 'static,
    findings: &mut Findings<'_>,
) -> Option<Interlock> {
    let Drives { galvo, mut laser, links } = drives;
    let policy = vehicle.policy();
    for (table, link) in &links {
        findings.about(table);
        complaints(locked(link).left_errors(), findings);
    }
    // Before anything moves.
    findings.about("laser");
    let off = laser.off(policy.within);
    if let Err(fault) = &off {
        findings.device(fault, "cut the laser's power: it may be on. Then check laser_off of the dialect");
    }
    let mut answers = true;
    for (table, link) in &links {
        findings.about(table);
        answers &= controller(link, *table == "galvo", policy.within, findings);
    }
    findings.about("galvo");
    let mut galvo = guard(vehicle, galvo, timeline).map_err(|fault| findings.device(&fault, "")).ok()?;
    if answers {
        mirror(vehicle, &mut galvo, timeline, findings);
    } else {
        findings.skipped("the mirror was not moved: its controller does not answer as it should", "");
    }
    findings.about("laser");
    off.ok()?;
    let engaged = Interlock::engage(laser, galvo, policy, alarm);
    engaged
        .map_err(|fault| {
            findings.device(&fault, "cut the laser's power: it may be on. Then check the dialect");
        })
        .ok()
}

/// What a controller answers to what changes nothing; whether it does.
fn controller(link: &SharedLink, reads_volts: bool, within: Duration, findings: &mut Findings<'_>) -> bool {
    let mut link = locked(link);
    let id = link.identity();
    let name = [id.vendor, id.model, id.serial, id.firmware];
    let name = name.iter().filter(|part| !part.is_empty()).cloned().collect::<Vec<_>>().join(", ");
    findings.good(format!("{}: {}", id.place, if name.is_empty() { "open" } else { &name }));
    let mut right = true;
    let asked = [(Command::Complete, true), (Command::ReadVolts, reads_volts), (Command::LaserState, true)];
    for (command, wanted) in asked {
        if wanted
            && link.dialect().has(command)
            && let Err(fault) = link.ask(command, within)
        {
            right = false;
            findings.device(&fault, mend_of(&fault));
        }
    }
    // What the questions made it complain of.
    right && errors(&mut link, within, findings)
}

fn locked(link: &SharedLink) -> MutexGuard<'_, Link> {
    link.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Empties a controller's queue of errors, and tells of them; whether the queue can be read.
fn errors(link: &mut Link, within: Duration, findings: &mut Findings<'_>) -> bool {
    match link.errors(within) {
        Ok(said) => complaints(&said, findings),
        Err(fault) => {
            findings.device(&fault, mend_of(&fault));
            return false;
        }
    }
    true
}

/// Tells of the errors that a controller's queue held.
fn complaints(said: &[String], findings: &mut Findings<'_>) {
    if said.is_empty() {
        return;
    }
    let what = format!("its queue held {} errors: {}", said.len(), said[..said.len().min(3)].join("; "));
    let mend = "they are read now: run doctor again; where they come again, the dialect sends what the controller doesn't know";
    findings.warning(what, mend);
}

/// Drives the mirror over its range, and sees how it settles.
fn mirror(vehicle: &Vehicle, galvo: &mut GuardedGalvo, timeline: &Timeline, findings: &mut Findings<'_>) {
    let within = vehicle.policy().within;
    let stated = vehicle.settle();
    let patience = (stated * PATIENCE).max(LEAST_PATIENCE);
    let [low, high] = galvo.limits().range_v();
    let mut reads = Vec::new();
    for volts in [low, high] {
        let read = galvo.set(volts, within).and_then(|_| {
            timeline.sleep(patience);
            galvo.read_back(within)
        });
        match read {
            Ok(read) => reads.push((volts, read.volts)),
            Err(fault) => return findings.device(&fault, mend_of(&fault)),
        }
    }
    let follow_v = vehicle.galvo.follow_v;
    let off: Vec<_> =
        reads.iter().filter(|(sent, read)| read.is_nan() || (sent - read).abs() > follow_v).collect();
    let still = reads.windows(2).all(|pair| (pair[0].1 - pair[1].1).abs() <= follow_v);
    if still && !off.is_empty() {
        let what =
            format!("the mirror does not move: sent from {low} V to {high} V it reads {:.4} V", reads[0].1);
        return findings.fault(what, MIRROR);
    }
    for (sent, read) in &off {
        findings.fault(
            format!("sent to {sent} V, {} later it reads {read:.4} V, farther than galvo.follow_v = {follow_v} V", ms(patience)),
            "narrow galvo.range_v to what the drive reaches, check its scale, or widen galvo.follow_v to what its read-back is off by",
        );
    }
    if off.is_empty() {
        findings.good(format!("goes from {low} V to {high} V, and reads so"));
        settling(vehicle, galvo, patience, findings);
    }
}

/// How the mirror settles after a step of the sweep, against what the file says.
fn settling(vehicle: &Vehicle, galvo: &mut GuardedGalvo, watch: Duration, findings: &mut Findings<'_>) {
    let within = vehicle.policy().within;
    let follow_v = vehicle.galvo.follow_v;
    let volts = vehicle.schedule().map(|schedule| schedule.volts().to_vec()).unwrap_or_default();
    let middle = volts.len() / 2;
    let (Some(&to), Some(&from)) = (volts.get(middle), middle.checked_sub(1).and_then(|i| volts.get(i)))
    else {
        return findings.skipped("settling: the sweep has a single voltage", "");
    };
    let stated = vehicle.settle();
    // Nearer than a step's tenth, or nothing would be seen of small steps.
    let near_v = follow_v.min((to - from).abs() * 0.1);
    let settling = match measure_settling(galvo, [from, to], near_v, watch, within) {
        Ok(settling) => settling,
        Err(fault) => return findings.device(&fault, mend_of(&fault)),
    };
    let took = format!(
        "after a step of {:.4} V it is within {near_v:.4} V in {}",
        (to - from).abs(),
        ms(settling.settle)
    );
    if settling.at_once {
        findings.good(format!(
            "{took}, at the first look: its read-back may repeat the command, and tell nothing of the mirror"
        ));
    } else if settling.settle > stated + settling.resolution {
        let longer = (settling.settle.as_secs_f64() * 1e3).ceil();
        findings.fault(
            format!("{took}, galvo.settle_ms says {}: images would show the mirror on its way", ms(stated)),
            format!("write galvo.settle_ms = {longer:.1}"),
        );
    } else {
        findings.good(format!("{took}; galvo.settle_ms says {}", ms(stated)));
    }
    if settling.noise_v > follow_v / 3.0 {
        let what = format!(
            "its read-back scatters by {:.4} V (1 sigma), and galvo.follow_v is {follow_v} V",
            settling.noise_v
        );
        findings.warning(what, "find the noise, or widen galvo.follow_v to three times that");
    }
}

/// Whether the laser goes off and, where that is allowed, on.
pub(super) fn laser(
    vehicle: &Vehicle,
    handle: Option<&Handle>,
    allowed: LaserUse,
    findings: &mut Findings<'_>,
) {
    findings.about("laser");
    let Some(handle) = handle else {
        return findings.skipped("not tried: it is not behind its interlock", "mend what is above first");
    };
    handle.feed();
    match handle.laser_is_on() {
        // Whether it went off was asked by the interlock already.
        Ok(_) => findings.good("goes off, and says so"),
        Err(Fault::Unsupported { .. }) => {
            findings.good("acknowledges that it goes off; it can't be asked whether it is");
        }
        Err(fault) => return findings.device(&fault, mend_of(&fault)),
    }
    if let Some(power) = vehicle.laser.power
        && let Err(fault) = handle.set_power(power)
    {
        findings.device(&fault, "remove laser.power, or give the dialect laser_power");
    }
    if allowed == LaserUse::Off {
        let mend = "run doctor with --laser once nobody can look into it";
        return findings.skipped("was not switched on", mend);
    }
    match handle.laser_on().and_then(|()| handle.laser_is_on()) {
        Ok(true) | Err(Fault::Unsupported { .. }) => findings.good("goes on"),
        Ok(false) => findings.fault(
            "acknowledges that it goes on, and says that it is off",
            "check its key switch and interlock loop, and laser_on of the dialect",
        ),
        Err(fault) => findings.device(&fault, mend_of(&fault)),
    }
    if let Err(fault) = handle.laser_off() {
        findings.device(&fault, "cut the laser's power");
    }
}
