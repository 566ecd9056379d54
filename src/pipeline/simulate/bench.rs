//! A scene file before a vehicle's simulated camera.

use crate::pipeline::simulate::{Plan, of_scene};
use crate::{Error, Failure, Notes};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use uw_hw::Pixels;
use uw_hw::mock::Shot;
use uw_io::Problem;

/// What a vehicle's simulated camera sees of a scene file.
pub struct SimulatedCamera {
    /// What [`uw_hw::mock::Mock::camera`] takes.
    pub sees: Box<dyn FnMut(&Shot) -> Pixels + Send>,
    /// Size of its images, px.
    pub size: [u32; 2],
    /// Their significant bits.
    pub bits: u8,
    /// Which placement of a calibration's board it sees.
    pub placement: Placement,
    /// Warnings about the scene's files.
    pub problems: Vec<Problem>,
}

impl std::fmt::Debug for SimulatedCamera {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SimulatedCamera")
            .field("size", &self.size)
            .field("bits", &self.bits)
            .field("placement", &self.placement)
            .finish_non_exhaustive()
    }
}

/// Which placement of a calibration's board a simulated camera sees: the hand that holds the board. Clones move the same one.
#[derive(Clone, Debug)]
pub struct Placement {
    now: Arc<AtomicUsize>,
    count: usize,
}

impl Placement {
    /// How many there are; a scan has one.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Puts the board where the scene file's placement of this number, from 0, has it; after the last comes the first again.
    pub fn put(&self, number: usize) {
        self.now.store(number % self.count.max(1), Ordering::Relaxed);
    }
}

/// The simulated camera of a scene file. Time 0 of things that move is `began_ns`. The scene's own voltages are not used: the bench has its
/// mirror where it was sent. A calibration's board is in its first placement until it is [put](Placement::put) elsewhere.
///
/// # Errors
/// [`Failure`] where a file is wrong, or says what can't be.
pub fn simulated_camera(scene: &Path, began_ns: i64) -> Result<SimulatedCamera, Failure> {
    let mut notes = Notes::default();
    let made = Plan::read(scene, None, &mut notes.problems).and_then(|plan| {
        let (size, bits) = (plan.instrument.size, plan.instrument.sensor.bits);
        let exposure_s = plan.file.capture.exposure_ms / 1000.0;
        let see = |scene| uw_sim::camera_sees(plan.instrument.clone(), scene, began_ns, exposure_s);
        let seen: Result<Vec<_>, _> = plan.scenes.into_iter().map(see).collect();
        let mut seen = seen.map_err(Error::Simulation)?;
        let placement = Placement { now: Arc::default(), count: seen.len() };
        let now = placement.now.clone();
        let sees = Box::new(move |shot: &Shot| seen[now.load(Ordering::Relaxed)](shot));
        Ok((sees, size, bits, placement))
    });
    match made.map_err(of_scene(scene)) {
        Ok((sees, size, bits, placement)) => {
            Ok(SimulatedCamera { sees, size, bits, placement, problems: notes.problems })
        }
        Err(error) => Err(Failure { error: Box::new(error), notes }),
    }
}
