//! A recorded capture as an instrument: a camera that shows the recorded images, and a galvanometer and a laser to go with it. What drives
//! a real instrument drives this one, and gets what the real one gave.
//!
//! A trigger shows the next recorded image that was taken with the laser as it now is and, if it is on, at the very voltage that the mirror
//! is at; after the last image of that kind the first comes again, so that a sweep can be repeated. Stamps are those of the replay: the
//! recorded ones would lie before the moves that they follow.

use crate::Error;
use crate::pipeline::load::Reading;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use uw_hw::frame::Layout;
use uw_hw::{
    AllowedVolts, Camera, CameraSettings, Exposure, Fault, Frame, FrameCounts, Galvo, Identity, Laser, Moved,
    ReadBack, Timeline, Trigger,
};
use uw_io::{Capture, FrameRecord, Pixels, Rig, SaidBy};

/// Devices that replay one capture.
pub struct Replay {
    bench: Arc<Bench>,
}

struct Bench {
    capture: Capture,
    reading: Reading,
    timeline: Timeline,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    volts: f64,
    laser_on: bool,
    /// Place in the capture after the image that was shown last.
    next: usize,
}

impl Replay {
    /// The devices of a scan's capture; `rig` says how its images are where the capture has no rig of its own.
    ///
    /// # Errors
    /// [`Error::NoRig`] where nothing says how the images are; [`Error::LaserOff`] for a capture without a stripe.
    pub fn new(capture: Capture, rig: Option<&Rig>, timeline: Timeline) -> Result<Self, Error> {
        let Some(rig) = capture.rig.as_ref().or(rig) else {
            return Err(Error::NoRig { path: capture.path });
        };
        let reading = Reading::new(rig, SaidBy::Rig);
        let first = capture.frames.iter().find_map(|frame| frame.voltage_v);
        let Some(volts) = first else { return Err(Error::LaserOff { path: capture.path }) };
        let state = Mutex::new(State { volts, ..State::default() });
        Ok(Self { bench: Arc::new(Bench { capture, reading, timeline, state }) })
    }

    /// The recorded voltages in the order of capture, each image's.
    pub fn volts(&self) -> Vec<f64> {
        self.bench.capture.present().filter_map(|frame| frame.voltage_v).collect()
    }

    /// The capture's galvanometer.
    pub fn galvo(&self) -> Box<dyn Galvo> {
        Box::new(ReplayGalvo(self.bench.clone()))
    }

    /// The capture's laser.
    pub fn laser(&self) -> Box<dyn Laser> {
        Box::new(ReplayLaser(self.bench.clone()))
    }

    /// The capture's camera.
    pub fn camera(&self) -> Box<dyn Camera> {
        Box::new(ReplayCamera {
            bench: self.bench.clone(),
            settings: None,
            armed: false,
            shown: VecDeque::new(),
            triggered: 0,
            counts: FrameCounts::default(),
        })
    }
}

impl Bench {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn identity(&self) -> Identity {
        Identity {
            driver: "replay".into(),
            place: self.capture.path.display().to_string(),
            ..Identity::default()
        }
    }

    fn device(&self, what: &str) -> String {
        format!("replayed {what} of {}", self.capture.path.display())
    }

    /// The image that a trigger shows now.
    fn show(&self) -> Result<&FrameRecord, Fault> {
        let mut state = self.state();
        let fits = |frame: &&FrameRecord| {
            frame.laser_on == state.laser_on
                && frame.voltage_v.is_none_or(|volts| volts.to_bits() == state.volts.to_bits())
        };
        let after = self.capture.present().filter(|frame| frame.row >= state.next);
        let Some(frame) = after.chain(self.capture.present()).find(fits) else {
            let with = if state.laser_on {
                format!("the laser on at {} V", state.volts)
            } else {
                "the laser off".to_owned()
            };
            return Err(Fault::Refused {
                device: self.device("camera"),
                doing: "a trigger".into(),
                reason: format!("no image was recorded with {with}"),
            });
        };
        state.next = frame.row + 1;
        Ok(frame)
    }
}

struct ReplayGalvo(Arc<Bench>);

impl ReplayGalvo {
    fn read(&self) -> ReadBack {
        ReadBack { volts: self.0.state().volts, stamp_ns: self.0.timeline.stamp_ns(), uncertainty_ns: 0 }
    }
}

impl Galvo for ReplayGalvo {
    fn identity(&self) -> Identity {
        self.0.identity()
    }

    fn set(&mut self, volts: AllowedVolts, _: Duration) -> Result<Moved, Fault> {
        let sent_ns = self.0.timeline.stamp_ns();
        self.0.state().volts = volts.volts();
        Ok(Moved { commanded_v: volts.volts(), sent_ns, read_back: self.read() })
    }

    fn read_back(&mut self, _: Duration) -> Result<ReadBack, Fault> {
        Ok(self.read())
    }

    fn settle_time(&self) -> Duration {
        Duration::ZERO
    }
}

struct ReplayLaser(Arc<Bench>);

impl Laser for ReplayLaser {
    fn identity(&self) -> Identity {
        self.0.identity()
    }

    fn on(&mut self, _: Duration) -> Result<(), Fault> {
        self.0.state().laser_on = true;
        Ok(())
    }

    fn off(&mut self, _: Duration) -> Result<(), Fault> {
        self.0.state().laser_on = false;
        Ok(())
    }

    fn is_on(&mut self, _: Duration) -> Result<bool, Fault> {
        Ok(self.0.state().laser_on)
    }

    fn set_power(&mut self, _: f64, _: Duration) -> Result<(), Fault> {
        Err(Fault::Unsupported {
            device: self.0.device("laser"),
            what: "change its power: what was recorded stays as it is".into(),
            mend: "remove laser.power from the vehicle file".into(),
        })
    }
}

struct ReplayCamera {
    bench: Arc<Bench>,
    settings: Option<CameraSettings>,
    armed: bool,
    shown: VecDeque<Frame>,
    triggered: u64,
    counts: FrameCounts,
}

impl Camera for ReplayCamera {
    fn identity(&self) -> Identity {
        self.bench.identity()
    }

    fn configure(&mut self, wanted: &CameraSettings, _: Duration) -> Result<CameraSettings, Fault> {
        if wanted.trigger != Trigger::Software {
            return Err(Fault::Unsupported {
                device: self.bench.device("camera"),
                what: "run by itself, or by pulses: it shows the image of the mirror's voltage".into(),
                mend: "write camera.trigger = \"software\" and sweep.mode = \"step\"".into(),
            });
        }
        self.settings = Some(wanted.clone());
        Ok(wanted.clone())
    }

    fn arm(&mut self, _: Duration) -> Result<(), Fault> {
        if self.settings.is_none() {
            let device = self.bench.device("camera");
            return Err(Fault::Order { device, doing: "arming", needed: "settings" });
        }
        (self.armed, self.triggered, self.counts) = (true, 0, FrameCounts::default());
        self.shown.clear();
        Ok(())
    }

    fn trigger(&mut self, _: Duration) -> Result<(), Fault> {
        let device = self.bench.device("camera");
        let Some(settings) = self.settings.as_ref().filter(|_| self.armed) else {
            return Err(Fault::Order { device, doing: "triggering", needed: "arming" });
        };
        let bench = self.bench.clone();
        let stamp_ns = bench.timeline.stamp_ns();
        let record = bench.show()?;
        let id = self.triggered;
        self.triggered += 1;
        let unusable = |reason: String| Fault::FrameContent { device: device.clone(), id, reason };
        let image =
            bench.reading.stripe(&bench.capture, record).map_err(|error| unusable(error.to_string()))?;
        let got = [image.width, image.height];
        if got != settings.size {
            self.counts.unusable += 1;
            return Err(Fault::FrameSize { device, needed: settings.size, got });
        }
        let bits = (image.full_scale.checked_ilog2().unwrap_or(0) + 1) as u8;
        let layout = Layout::packed(image.width, image.height, bits);
        let exposure = Exposure { stamp_ns, exposure_ns: 0, received_ns: bench.timeline.stamp_ns() };
        let pixels = match image.data {
            Pixels::U8(values) => uw_hw::Pixels::from(values),
            Pixels::U16(values) => uw_hw::Pixels::from(values),
        };
        let frame = Frame::new(pixels, layout, id, exposure).map_err(|error| unusable(error.to_string()))?;
        self.shown.push_back(frame);
        Ok(())
    }

    fn next_frame(&mut self, within: Duration) -> Result<Frame, Fault> {
        let Some(frame) = self.shown.pop_front() else {
            let device = self.bench.device("camera");
            return Err(Fault::Timeout {
                device,
                doing: "a frame".into(),
                waited: within,
                got: String::new(),
            });
        };
        self.counts.received += 1;
        Ok(frame)
    }

    fn disarm(&mut self, _: Duration) -> Result<(), Fault> {
        self.armed = false;
        self.shown.clear();
        Ok(())
    }

    fn counts(&self) -> FrameCounts {
        self.counts
    }
}
