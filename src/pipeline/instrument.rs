//! What a vehicle file names → devices that are open, behind their interlock.

use crate::Error;
use crate::pipeline::record::plan::{self, Region};
use crate::pipeline::record::{Instrument, Motion, Plan};
use crate::pipeline::replay::Replay;
use std::path::PathBuf;
use uw_hw::galvo::serial::{Link, Port, SerialGalvo, SerialLaser, SharedLink};
use uw_hw::interlock::{Interlock, Report};
use uw_hw::sweep::{Continuous, Spacing};
use uw_hw::{Camera, Fault, Galvo, GuardedGalvo, Laser, Timeline};
use uw_io::vehicle::{CameraDriver, GalvoDriver, LaserDriver, SweepMode, Vehicle};
use uw_io::{Capture, Rig};

/// What a scan asks of a vehicle besides what its file says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wanted {
    /// How many sweeps.
    pub repeat: u32,
    /// Only the voltages in these; empty: all.
    pub regions: Vec<Region>,
    /// A coarse sweep first, then more voltages where the surface bends: how many times coarser it is than the file's; `None`: the
    /// file's sweep as it is.
    pub coarser: Option<u32>,
}

/// Opens a vehicle's devices. The laser is off from here on until something switches it on; `on_stop` is told when the interlock stops.
///
/// # Errors
/// [`Error::Instrument`] where a device can't be opened or doesn't answer, [`Error::File`] for a recording or dialect that can't be read.
pub fn open(
    vehicle: &Vehicle,
    rig: &Rig,
    on_stop: impl Fn(&Report) + Send + Sync + 'static,
) -> Result<(Instrument, Option<Vec<f64>>), Error> {
    let timeline = Timeline::system();
    let replay = match vehicle.camera.driver {
        CameraDriver::Replay => {
            let id = vehicle.camera.id.as_deref().unwrap_or_default();
            let capture = Capture::open(&vehicle.resolve(&PathBuf::from(id)))?;
            Some(Replay::new(capture, Some(rig), timeline.clone())?)
        }
        _ => None,
    };
    let within = vehicle.policy().within;
    let link = |port: Option<&str>, baud: Option<u32>, dialect| -> Result<SharedLink, Error> {
        let port = Port { name: port.unwrap_or_default().to_owned(), baud: baud.unwrap_or_default() };
        Ok(Link::open(port, dialect, timeline.clone(), within)?.shared())
    };
    let mut controller = None;
    let galvo: Box<dyn Galvo> = match vehicle.galvo.driver {
        GalvoDriver::Scpi => {
            let g = &vehicle.galvo;
            let shared = link(g.port.as_deref(), g.baud, vehicle.galvo_dialect()?)?;
            controller = Some(shared.clone());
            Box::new(SerialGalvo::new(shared, vehicle.settle()))
        }
        GalvoDriver::Replay => replay.as_ref().ok_or_else(|| absent("galvo"))?.galvo(),
        GalvoDriver::Simulated => return Err(absent("galvo").into()),
    };
    let laser: Box<dyn Laser> = match vehicle.laser.driver {
        LaserDriver::Galvo => Box::new(SerialLaser::new(controller.ok_or_else(|| absent("laser"))?)),
        LaserDriver::Scpi => {
            let l = &vehicle.laser;
            Box::new(SerialLaser::new(link(l.port.as_deref(), l.baud, vehicle.laser_dialect()?)?))
        }
        LaserDriver::Replay => replay.as_ref().ok_or_else(|| absent("laser"))?.laser(),
        LaserDriver::Simulated => return Err(absent("laser").into()),
    };
    let (galvo, laser): (Box<dyn Galvo>, Box<dyn Laser>) = match &replay {
        Some(replay) => (replay.seen_by_galvo(galvo), replay.seen_by_laser(laser)),
        None => (galvo, laser),
    };
    let limits = vehicle.limits().map_err(|reason| Fault::Open {
        device: "galvanometer".into(),
        reason,
        mend: "mend [galvo] in the vehicle file".into(),
    })?;
    let galvo = GuardedGalvo::new(galvo, limits, timeline);
    let interlock = Interlock::engage(laser, galvo, vehicle.policy(), on_stop)?;
    if let Some(power) = vehicle.laser.power {
        interlock.handle().set_power(power)?;
    }
    let camera: Box<dyn Camera> = match (vehicle.camera.driver, &replay) {
        (CameraDriver::Replay, Some(replay)) => replay.camera(),
        _ => return Err(absent("camera").into()),
    };
    let volts = replay.as_ref().map(Replay::volts);
    Ok((Instrument { interlock, camera, camera_settings: vehicle.camera_settings() }, volts))
}

fn absent(table: &str) -> Fault {
    Fault::Unsupported {
        device: format!("[{table}] of the vehicle file"),
        what: "be driven by this driver yet".into(),
        mend: format!(
            "choose another {table}.driver: controllers on serial ports and replayed captures are driven"
        ),
    }
}

/// The plan of a vehicle's sweep, cut down and repeated as wanted; `recorded` are the voltages that a replayed camera has.
///
/// # Errors
/// [`Error::Plan`] where nothing is left to visit.
pub fn plan(vehicle: &Vehicle, wanted: &Wanted, recorded: Option<Vec<f64>>) -> Result<Plan, Error> {
    let sweep = &vehicle.sweep;
    let Wanted { repeat, regions, coarser } = wanted;
    if let (SweepMode::Continuous, Some(ride)) = (sweep.mode, vehicle.continuous()) {
        let rate_hz = vehicle.camera.rate_hz.unwrap_or_default();
        let stretches = stretches(ride, regions)?;
        let motion = Motion::Continuous { stretches, rate_hz };
        return Ok(Plan { motion, repeat: *repeat, adaptive: None, background_every: 0 });
    }
    let every = coarser.unwrap_or(1).max(1);
    let schedule = vehicle.schedule().map_err(plan::PlanError::from)?;
    let fine = match recorded {
        Some(volts) => plan::within(volts, regions)?,
        None => {
            let spacing = Spacing::Count(schedule.volts().len());
            plan::voltages(sweep.from_v, sweep.to_v, spacing, regions)?
        }
    };
    let finest_v = fine.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(f64::INFINITY, f64::min);
    let adaptive = coarser
        .filter(|_| finest_v.is_finite())
        .map(|_| crate::pipeline::record::adaptive::Density { finest_v });
    let last = fine.len().saturating_sub(1);
    let kept = fine.iter().enumerate().filter(|(i, _)| i % every as usize == 0 || *i == last);
    let volts = kept.map(|(_, &volts)| volts).collect();
    Ok(Plan {
        motion: Motion::Steps { volts, settings: vehicle.step_and_settle() },
        repeat: *repeat,
        adaptive,
        background_every: sweep.background_every as usize,
    })
}

/// A continuous sweep cut down to regions.
fn stretches(ride: Continuous, regions: &[Region]) -> Result<Vec<Continuous>, Error> {
    if regions.is_empty() {
        return Ok(vec![ride]);
    }
    let (low, high) = (ride.from_v.min(ride.to_v), ride.from_v.max(ride.to_v));
    let part = |region: &Region| {
        let [a, b] = region.range_v();
        let (a, b) = (a.max(low), b.min(high));
        if a >= b {
            let (sweep_v, region_v) = ([ride.from_v, ride.to_v], region.range_v());
            return Err(plan::PlanError::Region { voltages: 2, sweep_v, region_v }.into());
        }
        let (from_v, to_v) = if ride.from_v <= ride.to_v { (a, b) } else { (b, a) };
        Ok(Continuous { from_v, to_v, ..ride })
    };
    regions.iter().map(part).collect()
}
