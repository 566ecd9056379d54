//! What replayed and simulated devices of a vehicle stand on.

use crate::Error;
use crate::pipeline::instrument::shadow::Seen;
use crate::pipeline::replay::Replay;
use crate::pipeline::simulate::{Placement, SimulatedCamera, simulated_camera};
use std::path::Path;
use uw_hw::mock::{self, Mock, Shot};
use uw_hw::{Camera, Clock, Fault, Galvo, Laser, ManualClock, Pixels, SystemClock, Timeline};
use uw_io::vehicle::{CameraDriver, GalvoDriver, LaserDriver, SweepMode, Vehicle};
use uw_io::{Capture, Problem, Rig};

/// The clock of a vehicle, and what is not real of it.
pub(crate) struct Bench {
    pub(crate) timeline: Timeline,
    pub(crate) recorded: Option<Vec<f64>>,
    pub(crate) placement: Option<Placement>,
    pub(crate) problems: Vec<Problem>,
    stand: Stand,
}

enum Stand {
    /// All is real.
    None,
    Replay(Replay),
    Simulated(Mock, Option<Sees>),
}

/// What a simulated camera sees; taken by the camera.
type Sees = Box<dyn FnMut(&Shot) -> Pixels + Send>;

impl Bench {
    /// The bench of a vehicle.
    ///
    /// # Errors
    /// [`Error::File`] for a recording or scene that can't be read; [`Error::SceneFile`] for a scene that can't be.
    pub(crate) fn new(vehicle: &Vehicle, rig: &Rig) -> Result<Self, Error> {
        let timeline = timeline(vehicle);
        let mut bench =
            Self { timeline, recorded: None, placement: None, problems: Vec::new(), stand: Stand::None };
        if vehicle.camera.driver == CameraDriver::Replay {
            let id = vehicle.camera.id.as_deref().unwrap_or_default();
            let capture = Capture::open(&vehicle.resolve(Path::new(id)))?;
            let replay = Replay::new(capture, Some(rig), bench.timeline.clone())?;
            bench.recorded = Some(replay.volts());
            bench.stand = Stand::Replay(replay);
        } else if simulated(vehicle).contains(&true) {
            let behaviour = mock::Bench { settle_time: vehicle.settle(), ..mock::Bench::default() };
            let mock = Mock::with(bench.timeline.clone(), behaviour);
            mock.keep_no_events();
            let mut sees = None;
            if let (CameraDriver::Simulated, Some(scene)) = (vehicle.camera.driver, &vehicle.scene) {
                let began_ns = bench.timeline.stamp_ns();
                let camera = simulated_camera(&vehicle.resolve(scene), began_ns).map_err(|e| *e.error)?;
                let SimulatedCamera { sees: what, size, bits, placement, problems } = camera;
                let c = &vehicle.camera;
                if (size, bits) != ([c.width, c.height], c.bits) {
                    return Err(Fault::Open {
                        device: "simulated camera".into(),
                        reason: format!(
                            "the scene's instrument has images of {} x {} pixels of {bits} bits, {} x {} of {} are asked for",
                            size[0], size[1], c.width, c.height, c.bits
                        ),
                        mend: "give the vehicle file and the scene file the same rig".into(),
                    }
                    .into());
                }
                (bench.placement, bench.problems) = (Some(placement), problems);
                sees = Some(what);
            }
            bench.stand = Stand::Simulated(mock, sees);
        }
        Ok(bench)
    }

    /// The bench's own galvanometer.
    pub(crate) fn galvo(&self) -> Result<Box<dyn Galvo>, Fault> {
        match &self.stand {
            Stand::None => Err(absent("galvo")),
            Stand::Replay(replay) => Ok(replay.galvo()),
            Stand::Simulated(mock, _) => Ok(Box::new(mock.galvo())),
        }
    }

    /// The bench's own laser.
    pub(crate) fn laser(&self) -> Result<Box<dyn Laser>, Fault> {
        match &self.stand {
            Stand::None => Err(absent("laser")),
            Stand::Replay(replay) => Ok(replay.laser()),
            Stand::Simulated(mock, _) => Ok(Box::new(mock.laser())),
        }
    }

    /// A real galvanometer, seen by the bench's camera if there is one.
    pub(crate) fn seen_galvo(&self, device: Box<dyn Galvo>) -> Box<dyn Galvo> {
        match self.galvo() {
            Ok(shadow) => Box::new(Seen { device, shadow }),
            Err(_) => device,
        }
    }

    /// A real laser, seen by the bench's camera if there is one.
    pub(crate) fn seen_laser(&self, device: Box<dyn Laser>) -> Box<dyn Laser> {
        match self.laser() {
            Ok(shadow) => Box::new(Seen { device, shadow }),
            Err(_) => device,
        }
    }

    /// The bench's own camera, once.
    pub(crate) fn camera(&mut self) -> Result<Box<dyn Camera>, Fault> {
        match &mut self.stand {
            Stand::Replay(replay) => Ok(replay.camera()),
            Stand::Simulated(mock, sees) => {
                let mut sees = sees.take().ok_or_else(|| absent("camera"))?;
                Ok(Box::new(mock.camera(move |shot| sees(shot))))
            }
            Stand::None => Err(absent("camera")),
        }
    }
}

/// Whether galvanometer, laser and camera are simulated.
fn simulated(vehicle: &Vehicle) -> [bool; 3] {
    [
        vehicle.galvo.driver == GalvoDriver::Simulated,
        // One that the galvanometer's controller switches is what that one is.
        vehicle.laser.driver == LaserDriver::Simulated
            || (vehicle.laser.driver == LaserDriver::Galvo && vehicle.galvo.driver == GalvoDriver::Simulated),
        vehicle.camera.driver == CameraDriver::Simulated,
    ]
}

/// The machine's time; but where all is simulated and the mirror moves on, a time that stands still while an image is made: that takes
/// longer than a camera's own pace, and the mirror would be sent on too seldom meanwhile.
fn timeline(vehicle: &Vehicle) -> Timeline {
    if simulated(vehicle) == [true; 3] && vehicle.sweep.mode == SweepMode::Continuous {
        return Timeline::new(ManualClock::starting_at(SystemClock::default().wall_ns()));
    }
    Timeline::system()
}

fn absent(table: &str) -> Fault {
    Fault::Open {
        device: format!("[{table}] of the vehicle file"),
        reason: "nothing stands behind its driver".into(),
        mend: "write driver = \"simulated\" or \"replay\" for the camera, too, or choose a real driver here"
            .into(),
    }
}
