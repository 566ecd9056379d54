//! What a scan asks of a vehicle, and the plan that follows.

use crate::Error;
use crate::pipeline::record::plan::{self, Region};
use crate::pipeline::record::{Motion, Plan};
use uw_hw::sweep::{Continuous, Spacing};
use uw_io::vehicle::{SweepMode, Vehicle};

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
