//! Scans: galvanometer, laser and camera driven through a plan, recorded crash-safe, points made on the fly, the final cloud from the
//! recording.
//!
//! [`scan`] is the whole; its threads and queues are [`session`]'s. The final cloud is made by [`crate::pipeline::reconstruct`] from the
//! file that was just written, so it is the same as what `uwscan reconstruct` makes of that file at any later time, bit for bit.

pub mod acquire;
pub mod adaptive;
pub(crate) mod live;
pub mod plan;
pub mod session;
pub mod steer;
pub mod tally;

use crate::pipeline::Progress;
use crate::pipeline::reconstruct::{self, Reconstructed, outside, reconstruct};
use crate::{Error, Failure, Notes};
use acquire::{Acquisition, Ended, STALL, STALLS, tell_asked};
use adaptive::{Density, LinePoint, Profile};
pub use live::Preview;
use session::{Feed, Observer, Pressure, Room, Session};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
pub use steer::{Phase, SteerError, Steering};
pub use tally::{Counts, Loss, Tally};
use uw_calib::Across;
use uw_cloud::PointCloud;
use uw_hw::interlock::{Interlock, Reason, Report};
use uw_hw::sweep::{Aim, Continuous, StepAndSettle};
use uw_hw::{Camera, CameraSettings, Fault};
use uw_io::calibration_toml::CalibrationFile;
use uw_io::recording::{self, Head, Recorder};
use uw_io::{Capture, Overwrite, Rig};
use uw_stripe::Method;

/// What setting the camera up may take.
pub(crate) const SETUP: Duration = Duration::from_secs(5);

/// Galvanometer and laser behind their interlock, and a camera.
pub struct Instrument {
    /// Owns galvanometer and laser.
    pub interlock: Interlock,
    /// The camera.
    pub camera: Box<dyn Camera>,
    /// How the camera is set up.
    pub camera_settings: CameraSettings,
}

/// How the mirror goes from one voltage to the next.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// It comes to rest at each of these, and an image is exposed: those of a first, coarse sweep where more follow by
    /// [`Plan::adaptive`].
    Steps {
        /// The voltages, in order.
        volts: Vec<f64>,
        /// How it comes to rest.
        settings: StepAndSettle,
    },
    /// It goes on while the camera runs by itself.
    Continuous {
        /// One stretch after another.
        stretches: Vec<Continuous>,
        /// Images a second.
        rate_hz: f64,
    },
}

impl Motion {
    /// Images of one sweep; of a continuous one how many are expected.
    fn images(&self) -> usize {
        match self {
            Self::Steps { volts, .. } => volts.len(),
            Self::Continuous { stretches, rate_hz } => {
                let seconds = stretches.iter().map(|s| (s.to_v - s.from_v).abs() / s.rate_v_per_s);
                (seconds.sum::<f64>() * rate_hz) as usize
            }
        }
    }

    /// The lowest and the highest voltage.
    fn ends(&self) -> Vec<f64> {
        match self {
            Self::Steps { volts, .. } => volts.clone(),
            Self::Continuous { stretches, .. } => stretches.iter().flat_map(|s| [s.from_v, s.to_v]).collect(),
        }
    }
}

/// What a scan visits.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// One sweep.
    pub motion: Motion,
    /// How many sweeps.
    pub repeat: u32,
    /// Further voltages after each stepped sweep, where the surface asks for them; `None`: none.
    pub adaptive: Option<Density>,
    /// An image without the laser before the first and after so many images each of a stepped sweep, to be subtracted from those
    /// nearest to it; 0: none.
    pub background_every: usize,
}

impl Plan {
    /// Images of all sweeps, as far as is known before: without those that [`Plan::adaptive`] adds, and of a continuous one about so many.
    pub fn images(&self) -> usize {
        let one = match &self.motion {
            Motion::Steps { volts, .. } => self.aims(volts).len(),
            motion @ Motion::Continuous { .. } => motion.images(),
        };
        one * self.repeat as usize
    }

    /// The lowest and the highest voltage; `None` where it visits none.
    pub fn range_v(&self) -> Option<[f64; 2]> {
        let ends = self.motion.ends();
        let low = ends.iter().copied().reduce(f64::min)?;
        Some([low, ends.into_iter().fold(low, f64::max)])
    }

    /// Voltages as positions, with those for the background among them.
    fn aims(&self, volts: &[f64]) -> Vec<Aim> {
        let every = self.background_every;
        let dark = |i: usize| every > 0 && i.is_multiple_of(every);
        let at = |(i, &volts): (usize, &f64)| {
            dark(i).then_some(Aim::dark(volts)).into_iter().chain([Aim::lit(volts)])
        };
        volts.iter().enumerate().flat_map(at).collect()
    }
}

/// How a scan is recorded, and what is made of it.
#[derive(Clone, Copy, Debug)]
pub struct Settings<'a> {
    /// Where the recording goes.
    pub path: &'a Path,
    /// Whether it may replace another.
    pub overwrite: Overwrite,
    /// How it is written.
    pub recording: recording::Options,
    /// Room that has to be left on its disk, bytes: less is an error before the scan, and ends one. 0: any.
    pub min_free_bytes: u64,
    /// What the recording says of itself; scan id, planned frames, rig and calibration are filled in.
    pub head: &'a Head,
    /// What is known of the instrument.
    pub rig: Option<&'a Rig>,
    /// The instrument, calibrated; `None`: it is only recorded.
    pub calibration: Option<&'a CalibrationFile>,
    /// How the cloud is made.
    pub reconstruct: reconstruct::Settings,
    /// By which method stripes are found on the fly.
    pub preview: Method,
}

/// What became of a scan.
#[derive(Debug)]
pub struct Scanned {
    /// Frames and losses.
    pub counts: Counts,
    /// What the recorder counted; `None` where the recording could not be finished, and is one that was cut off.
    pub recorded: Option<recording::Counts>,
    /// Why the scan ended before its plan did.
    pub ended: Option<Ended>,
    /// Why the recording could not be finished.
    pub recording_error: Option<uw_io::Error>,
    /// What the interlock did at the end.
    pub report: Report,
    /// The cloud, made from the recording; `None` without a calibration.
    pub made: Option<Result<Reconstructed, Failure>>,
    /// What to know before trusting the result.
    pub warnings: Vec<String>,
    /// How long driving and recording took.
    pub took: Duration,
}

impl Scanned {
    /// Images recorded a second.
    pub fn frames_per_second(&self) -> f64 {
        self.counts.recorded as f64 / self.took.as_secs_f64().max(f64::MIN_POSITIVE)
    }

    /// Whether all that was planned is in the recording, and all made of it.
    pub fn whole(&self) -> bool {
        let cloud = self.made.as_ref().is_none_or(Result::is_ok);
        self.ended.is_none() && self.recording_error.is_none() && self.counts.lost_frames() == 0 && cloud
    }
}

/// A scan: what was planned is driven, recorded, and made into points. Whatever happens on the way, the laser is off and the mirror
/// parked when this returns, and what was recorded until then is kept.
///
/// # Errors
/// [`Failure`] where it could not begin: nothing was driven or recorded then. What goes wrong later is in [`Scanned`].
pub fn scan(
    instrument: Instrument,
    plan: &Plan,
    settings: &Settings<'_>,
    progress: &dyn Progress,
    observer: &dyn Observer,
) -> Result<Scanned, Failure> {
    let mut notes = Notes::default();
    match drive(instrument, plan, settings, &mut notes, progress, observer) {
        Ok(mut scanned) => {
            scanned.warnings = notes.warnings;
            scanned.made = made(settings, &scanned, progress);
            Ok(scanned)
        }
        Err(error) => Err(Failure { error: Box::new(error), notes }),
    }
}

/// The cloud of what was recorded.
fn made(
    settings: &Settings<'_>,
    scanned: &Scanned,
    progress: &dyn Progress,
) -> Option<Result<Reconstructed, Failure>> {
    let calibration = settings.calibration.filter(|_| scanned.counts.recorded > 0)?;
    Some(reconstruct(settings.path, calibration, &settings.reconstruct, progress))
}

fn drive(
    instrument: Instrument,
    plan: &Plan,
    settings: &Settings<'_>,
    notes: &mut Notes,
    progress: &dyn Progress,
    observer: &dyn Observer,
) -> Result<Scanned, Error> {
    let Instrument { interlock, mut camera, camera_settings } = instrument;
    let room = Room { path: settings.path, min_free_bytes: settings.min_free_bytes };
    if let Some(free_bytes) = room.shortage() {
        let (path, needed_bytes) = (settings.path.to_owned(), settings.min_free_bytes);
        return Err(Error::NoRoom { path, free_bytes, needed_bytes });
    }
    let handle = interlock.handle();
    handle.feed();
    let steered = observer.steering().map(|steering| Steered::new(steering, &handle));
    let timeline = handle.timeline().clone();
    let [low, high] = handle.limits().range_v();
    if let Some(&value) = plan.motion.ends().iter().find(|v| !(low..=high).contains(*v)) {
        let device = "galvanometer".to_owned();
        let outside =
            Fault::OutOfRange { device, quantity: "voltage", unit: "V", value, allowed: [low, high] };
        return Err(outside.into());
    }
    let in_force = handle.patiently(|| camera.configure(&camera_settings, SETUP))?;
    let stepped = matches!(plan.motion, Motion::Steps { .. });
    let planned = plan.images();
    let tally = Tally::default();
    tally.plan(planned);
    let preview = preview(settings, &in_force, notes)?;
    let across = settings.calibration.map_or(Across::U, |file| file.calibration.across);
    let watching =
        Watching { progress, observer, profiles: plan.adaptive.map(|_| Mutex::new(BTreeMap::new())), across };
    let began_ns = session::unsigned(timeline.stamp_ns());
    let mut head = settings.head.clone();
    if head.scan_id.is_empty() {
        head.scan_id = format!("scan-{began_ns}");
    }
    head.planned_frames = (stepped && plan.adaptive.is_none()).then(|| u32::try_from(planned).ok()).flatten();
    handle.patiently(|| camera.arm(SETUP))?;
    let recorder = Recorder::create(settings.path, settings.overwrite, &head, began_ns, settings.recording)?;
    let session = Session {
        recorder,
        preview,
        preview_every: plan.adaptive.is_some(),
        pressure: if stepped { Pressure::Wait { each: STALL, times: STALLS } } else { Pressure::Lose },
        frame_bytes: bytes(&in_force),
        timeline: &timeline,
        room,
        tally: &tally,
        observer: &watching,
    };
    progress.begin("scan", planned);
    let began = Instant::now();
    handle.feed();
    observer.phase(Phase::Scanning, &tally);
    let ((ended, report), recorded) = session::run(session, |feed| {
        let mut acquisition = Acquisition::new(&handle, camera.as_mut(), 0);
        let ended = sweeps(&mut acquisition, plan, &watching, feed).err();
        // Laser off and mirror parked before anything else is waited for.
        let report = match &ended {
            None => interlock.finish(),
            Some(why) => handle.stop(Reason::Asked(why.to_string())),
        };
        drop(steered);
        // Where the recording can't go on, it says so itself.
        let _ = tell_asked(feed, &handle);
        observer.phase(Phase::Ending { laser_off: report.laser_off.is_ok() }, &tally);
        (ended, report)
    });
    // It is done with: what it says to that changes nothing.
    let _ = camera.disarm(SETUP);
    if recorded.error.is_some() {
        // What the recorder had taken and could not write is not in the file: only the file says how much that is.
        let held = Capture::open(settings.path).map_or(0, |capture| capture.present().count());
        tally.found(held);
    }
    let counts = tally.counts();
    if stepped || ended.is_some() {
        tally.lost(Loss::NotReached, counts.planned.saturating_sub(counts.recorded + counts.lost_frames()));
    }
    Ok(Scanned {
        counts: tally.counts(),
        recorded: recorded.counts,
        ended,
        recording_error: recorded.error,
        report,
        made: None,
        warnings: Vec::new(),
        took: began.elapsed(),
    })
}

/// A scan that can be steered as long as this lives.
struct Steered<'a>(&'a Steering);

impl<'a> Steered<'a> {
    fn new(steering: &'a Steering, handle: &uw_hw::interlock::Handle) -> Self {
        steering.attach(handle);
        Self(steering)
    }
}

impl Drop for Steered<'_> {
    fn drop(&mut self) {
        self.0.detach();
    }
}

/// Bytes of a frame.
fn bytes(settings: &CameraSettings) -> usize {
    let [width, height] = settings.size;
    width as usize * height as usize * if settings.significant_bits > 8 { 2 } else { 1 }
}

/// What makes points on the fly.
fn preview<'a>(
    settings: &Settings<'a>,
    camera: &CameraSettings,
    notes: &mut Notes,
) -> Result<Option<Preview<'a>>, Error> {
    let Some(calibration) = settings.calibration else { return Ok(None) };
    let Settings { rig, reconstruct, path, .. } = settings;
    let water = rig.and_then(Rig::water_index);
    let medium = outside(settings.head.medium, water, path, calibration, reconstruct, &mut notes.warnings)?;
    Preview::new(calibration, medium, camera.significant_bits, settings.preview)
        .map(Some)
        .map_err(|source| Error::Stripe { path: path.to_path_buf(), source })
}

/// All sweeps of a plan.
fn sweeps(
    acquisition: &mut Acquisition<'_>,
    plan: &Plan,
    watching: &Watching<'_>,
    feed: &mut Feed<'_>,
) -> Result<(), Ended> {
    for _ in 0..plan.repeat {
        let (volts, settings) = match &plan.motion {
            Motion::Steps { volts, settings } => (volts, settings),
            Motion::Continuous { stretches, .. } => {
                stretches.iter().try_for_each(|stretch| acquisition.ride(stretch, feed))?;
                continue;
            }
        };
        let first = acquisition.next_number();
        let aims = plan.aims(volts);
        acquisition.step(aims.iter().copied(), settings, None, feed)?;
        if let (Some(density), Some(profiles)) = (plan.adaptive, &watching.profiles) {
            acquisition.wait(|| feed.previewed())?;
            let coarse = profiles_of(profiles, &aims, first);
            let further = adaptive::further_voltages(&coarse, density);
            let more = plan.aims(&further).len();
            feed.tally().plan(more);
            watching.progress.more(more);
            acquisition.step(plan.aims(&further), settings, None, feed)?;
        }
    }
    Ok(())
}

type Profiles = Mutex<BTreeMap<u32, Vec<LinePoint>>>;

/// The points of a coarse sweep whose images are numbered from `first`.
fn profiles_of(profiles: &Profiles, aims: &[Aim], first: u32) -> Vec<Profile> {
    let mut profiles = std::mem::take(&mut *profiles.lock().unwrap_or_else(PoisonError::into_inner));
    let numbered = (first..).zip(aims);
    numbered
        .filter_map(|(number, aim)| Some(Profile { voltage_v: aim.volts, points: profiles.remove(&number)? }))
        .collect()
}

/// Passes on what happens, and keeps the points of a coarse sweep.
struct Watching<'a> {
    progress: &'a dyn Progress,
    observer: &'a dyn Observer,
    profiles: Option<Profiles>,
    across: Across,
}

impl Observer for Watching<'_> {
    fn recorded(&self, tally: &Tally) {
        self.progress.step();
        self.progress.note(&tally.words());
        self.observer.recorded(tally);
    }

    fn points(&self, number: u32, cloud: &PointCloud) {
        if let (Some(profiles), Some(pixels), Some(sigmas)) =
            (&self.profiles, cloud.pixels(), cloud.sigmas_mm())
        {
            let along = 1 - self.across.index();
            let points = std::iter::zip(cloud.positions_mm(), std::iter::zip(pixels, sigmas));
            let points = points.map(|(&position_mm, (pixel, &sigma))| LinePoint {
                line: pixel[along].round() as usize,
                position_mm,
                sigma_mm: f64::from(sigma),
            });
            let points = points.collect();
            profiles.lock().unwrap_or_else(PoisonError::into_inner).insert(number, points);
        }
        self.observer.points(number, cloud);
    }

    fn exposed(&self, shot: &session::Shot) {
        self.observer.exposed(shot);
    }

    fn traced(&self, stripe: &recording::Stripe<'_>, voltage_v: f64, cloud: &PointCloud) {
        self.observer.traced(stripe, voltage_v, cloud);
    }

    fn phase(&self, phase: Phase, tally: &Tally) {
        self.observer.phase(phase, tally);
    }

    fn steering(&self) -> Option<&Steering> {
        self.observer.steering()
    }
}
