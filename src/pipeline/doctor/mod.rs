//! A vehicle's set-up → what is wrong with it, where, and how to mend it.
//!
//! | module | looks at |
//! |---|---|
//! | `files` | vehicle file, rig file, calibration: sound, and of one instrument |
//! | `disk`, `clock` | where scans go, and the time they are stamped with |
//! | `drives` | controllers on serial ports, galvanometer, laser |
//! | `camera` | settings in force, a frame in time, the stripe in it |
//!
//! One fault does not end the examination: what doesn't depend on it is looked at all the same. The laser is switched on only where that
//! is allowed, behind the interlock, and for as long as a few images take.

mod camera;
mod clock;
mod disk;
mod drives;
mod files;

use crate::Error;
use crate::pipeline::instrument::{Bench, open_camera, open_drives};
use std::path::Path;
use std::time::Duration;
use uw_hw::interlock::{Handle, Interlock, Report};
use uw_hw::{Fault, StepWatch};

/// What was found about one thing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What it is about: `vehicle file`, `rig`, `calibration`, `disk`, `clock`, `galvo`, `laser`, `camera`.
    pub subject: &'static str,
    /// How it stands.
    pub verdict: Verdict,
    /// What was found, and where.
    pub what: String,
    /// What to do; empty where nothing is to be done.
    pub mend: String,
}

/// How a thing stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// As it has to be.
    Good,
    /// Was not looked at, and why.
    Skipped,
    /// A scan can be made, but hardly as it is meant.
    Warning,
    /// A scan can't be made, or not a right one.
    Fault,
}

impl Verdict {
    /// Stable name for reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Skipped => "skipped",
            Self::Warning => "warning",
            Self::Fault => "fault",
        }
    }
}

/// Whether the laser may be switched on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LaserUse {
    /// It stays off.
    #[default]
    Off,
    /// Whoever asks has made sure that nobody looks into it.
    Allowed,
}

/// Collects what is found, and passes it on.
pub(crate) struct Findings<'a> {
    subject: &'static str,
    all: Vec<Finding>,
    tell: &'a dyn Fn(&Finding),
}

impl<'a> Findings<'a> {
    pub(crate) fn new(tell: &'a dyn Fn(&Finding)) -> Self {
        Self { subject: "", all: Vec::new(), tell }
    }

    /// What follows is about this.
    pub(crate) fn about(&mut self, subject: &'static str) {
        self.subject = subject;
    }

    fn add(&mut self, verdict: Verdict, what: impl Into<String>, mend: impl Into<String>) {
        let finding = Finding { subject: self.subject, verdict, what: what.into(), mend: mend.into() };
        (self.tell)(&finding);
        self.all.push(finding);
    }

    pub(crate) fn good(&mut self, what: impl Into<String>) {
        self.add(Verdict::Good, what, "");
    }

    pub(crate) fn skipped(&mut self, what: impl Into<String>, mend: impl Into<String>) {
        self.add(Verdict::Skipped, what, mend);
    }

    pub(crate) fn warning(&mut self, what: impl Into<String>, mend: impl Into<String>) {
        self.add(Verdict::Warning, what, mend);
    }

    pub(crate) fn fault(&mut self, what: impl Into<String>, mend: impl Into<String>) {
        self.add(Verdict::Fault, what, mend);
    }

    /// A device's fault; `mend` where it has none of its own.
    pub(crate) fn device(&mut self, fault: &Fault, mend: &str) {
        match fault {
            Fault::Open { device, reason, mend } => {
                self.fault(format!("{device}: cannot be opened: {reason}"), mend);
            }
            Fault::Unsupported { device, what, mend } => self.fault(format!("{device}: cannot {what}"), mend),
            other => self.fault(other.to_string(), mend),
        }
    }

    /// An error of the pipeline, with its mend apart where it has one.
    pub(crate) fn error(&mut self, error: &Error) {
        match error {
            Error::Instrument(fault) => self.device(fault, "check cable, power and the vehicle file"),
            Error::File(error) => self.file(error),
            other => self.fault(other.to_string(), "mend the file that it names"),
        }
    }

    /// A file's error, whose mend stands after its last semicolon.
    pub(crate) fn file(&mut self, error: &uw_io::Error) {
        let said = error.to_string();
        match said.rsplit_once("; ") {
            Some((what, mend)) => self.fault(what, mend),
            None => self.fault(said, "check the path in the vehicle file, and the file"),
        }
    }

    #[cfg(test)]
    pub(crate) fn into_all(self) -> Vec<Finding> {
        self.all
    }
}

/// Examines the vehicle of a file. `tell` hears of each finding as it is made; `engaged` gets what stops the laser, before it is ever
/// on, and `alarm` hears where it would not go off.
pub fn examine(
    config: &Path,
    laser: LaserUse,
    tell: &dyn Fn(&Finding),
    engaged: &dyn Fn(Handle),
    alarm: impl Fn(&Report) + Send + Sync + 'static,
) -> Vec<Finding> {
    let mut findings = Findings::new(tell);
    let Some(files) = files::examine(config, &mut findings) else { return findings.all };
    disk::examine(&files.vehicle, &mut findings);
    clock::examine(&files, &mut findings);
    let Some(rig) = &files.rig else {
        findings.about("camera");
        findings
            .skipped("devices: without a rig file nothing can be made of their images", "mend the rig file");
        return findings.all;
    };
    let vehicle = &files.vehicle;
    findings.about("camera");
    let mut bench = match Bench::new(vehicle, rig) {
        Ok(bench) => bench,
        Err(error) => {
            findings.error(&error);
            return findings.all;
        }
    };
    let timeline = bench.timeline.clone();
    let clock = StepWatch::new(timeline.clone());

    findings.about("galvo");
    let interlock = match open_drives(vehicle, &bench) {
        Ok(drives) => drives::examine(vehicle, drives, &timeline, alarm, &mut findings),
        Err(error) => {
            drives::not_opened(vehicle, &error, &mut findings);
            None
        }
    };
    let handle = interlock.as_ref().map(Interlock::handle);
    handle.iter().cloned().for_each(engaged);
    let lit = handle.as_ref().filter(|_| laser == LaserUse::Allowed);
    drives::laser(vehicle, handle.as_ref(), laser, &mut findings);

    findings.about("camera");
    match &bench.recorded {
        // It shows an image only where one was recorded: no voltage and no darkness can be tried.
        Some(volts) => findings.good(format!("replays {} images with the laser on", volts.len())),
        None => {
            let setting = camera::Setting {
                vehicle,
                rig,
                calibration: files.calibration.as_ref(),
                timeline: &timeline,
            };
            look_through(&setting, &mut bench, handle.as_ref(), lit, &mut findings);
        }
    }
    drop(interlock);
    clock::stepped(clock, &mut findings);
    findings.all
}

/// Opens the camera, and looks through it: first in the dark, then, where the laser may be on, by its light.
fn look_through(
    setting: &camera::Setting<'_>,
    bench: &mut Bench,
    handle: Option<&Handle>,
    lit: Option<&Handle>,
    findings: &mut Findings<'_>,
) {
    let mut open = || open_camera(setting.vehicle, bench, setting.timeline);
    let opened = match handle {
        Some(handle) => handle.patiently(open),
        None => open(),
    };
    let mut camera = match opened {
        Ok(camera) => camera,
        Err(fault) => return findings.device(&fault, "`uwscan devices` lists what is there"),
    };
    let mut look = || camera::examine(camera.as_mut(), setting, findings);
    let ready = match handle {
        Some(handle) => handle.patiently(look),
        None => look(),
    };
    match (ready, lit) {
        (Some(in_force), Some(handle)) => {
            camera::stripe(camera.as_mut(), setting, &in_force, handle, findings);
        }
        (Some(_), None) => {
            let mend = "run doctor with --laser once nobody can look into it";
            findings.skipped("whether the stripe shows: the laser stays off", mend);
        }
        (None, _) => {}
    }
    // It is done with: what it says to that changes nothing.
    let _ = camera.disarm(SETUP);
}

/// What setting a camera up may take.
const SETUP: Duration = Duration::from_secs(5);

/// A time as people write it.
fn ms(time: Duration) -> String {
    format!("{:.1} ms", time.as_secs_f64() * 1e3)
}
