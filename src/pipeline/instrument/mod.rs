//! What a vehicle file names → devices that are open, behind their interlock.
//!
//! | driver | galvanometer | laser | camera |
//! |---|---|---|---|
//! | `scpi` | a controller on a serial port | the same or another | |
//! | `genicam` | | | GigE Vision, USB3 Vision (feature `genicam`) |
//! | `v4l2` | | | Video4Linux (feature `v4l2`) |
//! | `replay` | goes to recorded voltages | | shows recorded images |
//! | `simulated` | is at once where it is sent | | sees the scene file's scene |
//!
//! A real controller may stand before a replayed or simulated camera, which then sees where that one was sent.

mod bench;
mod shadow;
mod sweep;

use crate::Error;
use crate::pipeline::record::Instrument;
use crate::pipeline::simulate::Placement;
pub(crate) use bench::Bench;
use std::path::Path;
use std::sync::PoisonError;
pub use sweep::{Wanted, plan};
use uw_hw::galvo::serial::{Link, Port, SerialGalvo, SerialLaser, SharedLink};
use uw_hw::interlock::{Interlock, Report};
use uw_hw::{Camera, Fault, Galvo, GuardedGalvo, Laser, Timeline};
use uw_io::vehicle::{CameraDriver, GalvoDriver, LaserDriver, Vehicle};
use uw_io::{Place, Problem, Rig};

/// A vehicle whose devices are open.
pub struct Opened {
    /// Laser off, mirror where it was.
    pub instrument: Instrument,
    /// Voltages of a replayed camera, each image's, in the order of capture; `None` for any other.
    pub recorded: Option<Vec<f64>>,
    /// Which placement of the board a simulated camera sees; `None` for any other.
    pub placement: Option<Placement>,
    /// Warnings about the files of what is simulated, and about errors that controllers still held.
    pub problems: Vec<Problem>,
}

/// Galvanometer and laser, not yet behind their interlock.
pub(crate) struct Drives {
    pub(crate) galvo: Box<dyn Galvo>,
    pub(crate) laser: Box<dyn Laser>,
    /// The links of controllers on serial ports, with their tables in the vehicle file.
    pub(crate) links: Vec<(&'static str, SharedLink)>,
}

/// Opens a vehicle's devices. The laser is off from here on until something switches it on; `on_stop` is told when the interlock stops.
///
/// # Errors
/// [`Error::Instrument`] where a device can't be opened, doesn't answer, or images are not of the rig's size; [`Error::File`] for a
/// recording, scene or dialect that can't be read.
pub fn open(
    vehicle: &Vehicle,
    rig: &Rig,
    on_stop: impl Fn(&Report) + Send + Sync + 'static,
) -> Result<Opened, Error> {
    same_images(vehicle, rig)?;
    let mut bench = Bench::new(vehicle, rig)?;
    let timeline = bench.timeline.clone();
    let drives = open_drives(vehicle, &bench)?;
    let left = left_errors(&drives.links);
    let galvo = guard(vehicle, drives.galvo, &timeline)?;
    let interlock = Interlock::engage(drives.laser, galvo, vehicle.policy(), on_stop)?;
    if let Some(power) = vehicle.laser.power {
        interlock.handle().set_power(power)?;
    }
    // Looking for a camera takes seconds, in which nobody hangs, and the laser is off.
    let camera = interlock.handle().patiently(|| open_camera(vehicle, &mut bench, &timeline))?;
    let Bench { recorded, placement, mut problems, .. } = bench;
    problems.extend(left);
    let instrument = Instrument { interlock, camera, camera_settings: vehicle.camera_settings() };
    Ok(Opened { instrument, recorded, placement, problems })
}

/// Warnings about errors that an earlier program left in the controllers' queues.
fn left_errors(links: &[(&'static str, SharedLink)]) -> Vec<Problem> {
    let mut problems = Vec::new();
    for (_, link) in links {
        let link = link.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(first) = link.left_errors().first() {
            problems.push(Problem::warning(
                Place::file(Path::new(&link.identity().place)),
                format!("the controller's queue held {} errors, such as {first}", link.left_errors().len()),
                "they are read now; where they come again, the dialect sends what the controller doesn't know",
            ));
        }
    }
    problems
}

/// Refuses a camera that is set up for other images than the rig file's: nothing could be made of them.
fn same_images(vehicle: &Vehicle, rig: &Rig) -> Result<(), Fault> {
    let (c, r) = (&vehicle.camera, &rig.camera);
    if (c.width, c.height, c.bits) == (r.width, r.height, r.bits) {
        return Ok(());
    }
    Err(Fault::Open {
        device: "camera".into(),
        reason: format!(
            "the vehicle file sets it up for {} x {} pixels of {} bits, the rig file has {} x {} of {}",
            c.width, c.height, c.bits, r.width, r.height, r.bits
        ),
        mend: "mend width, height and bits of [camera] in the file that is wrong".into(),
    })
}

/// Opens galvanometer and laser.
///
/// # Errors
/// As [`open`].
pub(crate) fn open_drives(vehicle: &Vehicle, bench: &Bench) -> Result<Drives, Error> {
    let within = vehicle.policy().within;
    let link = |port: Option<&str>, baud: Option<u32>, dialect| -> Result<SharedLink, Error> {
        let port = Port { name: port.unwrap_or_default().to_owned(), baud: baud.unwrap_or_default() };
        Ok(Link::open(port, dialect, bench.timeline.clone(), within)?.shared())
    };
    let mut links = Vec::new();
    let galvo: Box<dyn Galvo> = match vehicle.galvo.driver {
        GalvoDriver::Scpi => {
            let g = &vehicle.galvo;
            let shared = link(g.port.as_deref(), g.baud, vehicle.galvo_dialect()?)?;
            links.push(("galvo", shared.clone()));
            bench.seen_galvo(Box::new(SerialGalvo::new(shared, vehicle.settle())))
        }
        GalvoDriver::Replay | GalvoDriver::Simulated => bench.galvo()?,
    };
    let laser: Box<dyn Laser> = match vehicle.laser.driver {
        LaserDriver::Galvo => match links.first() {
            Some((_, controller)) => bench.seen_laser(Box::new(SerialLaser::new(controller.clone()))),
            None => bench.laser()?,
        },
        LaserDriver::Scpi => {
            let l = &vehicle.laser;
            let shared = link(l.port.as_deref(), l.baud, vehicle.laser_dialect()?)?;
            links.push(("laser", shared.clone()));
            bench.seen_laser(Box::new(SerialLaser::new(shared)))
        }
        LaserDriver::Replay | LaserDriver::Simulated => bench.laser()?,
    };
    Ok(Drives { galvo, laser, links })
}

/// A galvanometer within the vehicle's limits.
///
/// # Errors
/// [`Fault::Open`] where they are none.
pub(crate) fn guard(
    vehicle: &Vehicle,
    galvo: Box<dyn Galvo>,
    timeline: &Timeline,
) -> Result<GuardedGalvo, Fault> {
    let limits = vehicle.limits().map_err(|reason| Fault::Open {
        device: "galvanometer".into(),
        reason,
        mend: "mend [galvo] in the vehicle file".into(),
    })?;
    Ok(GuardedGalvo::new(galvo, limits, timeline.clone()))
}

/// Opens the camera.
///
/// # Errors
/// [`Fault`] where there is none, or this build has no such driver.
pub(crate) fn open_camera(
    vehicle: &Vehicle,
    bench: &mut Bench,
    timeline: &Timeline,
) -> Result<Box<dyn Camera>, Fault> {
    match vehicle.camera.driver {
        CameraDriver::Genicam => genicam(vehicle.camera.id.as_deref(), timeline),
        CameraDriver::V4l2 => v4l2(vehicle.camera.id.as_deref(), timeline),
        CameraDriver::Replay | CameraDriver::Simulated => bench.camera(),
    }
}

#[cfg(feature = "genicam")]
fn genicam(id: Option<&str>, timeline: &Timeline) -> Result<Box<dyn Camera>, Fault> {
    Ok(Box::new(uw_hw::camera::genicam::GenicamCamera::open(id, timeline.clone())?))
}

#[cfg(not(feature = "genicam"))]
fn genicam(_: Option<&str>, _: &Timeline) -> Result<Box<dyn Camera>, Fault> {
    let mend = "build it with them: cargo install --locked --path crates/uw-cli --features genicam (Debian: libaravis-dev, \
                libusb-1.0-0-dev, pkg-config)";
    Err(not_compiled("genicam", mend))
}

#[cfg(all(feature = "v4l2", target_os = "linux"))]
fn v4l2(id: Option<&str>, timeline: &Timeline) -> Result<Box<dyn Camera>, Fault> {
    Ok(Box::new(uw_hw::camera::v4l2::V4l2Camera::open(id, timeline.clone())?))
}

#[cfg(not(all(feature = "v4l2", target_os = "linux")))]
fn v4l2(_: Option<&str>, _: &Timeline) -> Result<Box<dyn Camera>, Fault> {
    let mend = "build it with them, on Linux: cargo install --locked --path crates/uw-cli --features v4l2";
    Err(not_compiled("v4l2", mend))
}

#[cfg(not(all(feature = "genicam", feature = "v4l2", target_os = "linux")))]
fn not_compiled(driver: &str, mend: &str) -> Fault {
    Fault::Open {
        device: "camera".into(),
        reason: format!("this build of uwscan has no cameras by driver = \"{driver}\""),
        mend: mend.into(),
    }
}
