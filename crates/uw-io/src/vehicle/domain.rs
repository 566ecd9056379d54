//! A vehicle file as the instrument takes it.

use std::time::Duration;

use uw_hw::{
    CameraSettings, Limits, Trigger,
    galvo::proto::Dialect,
    interlock::Policy,
    sweep::{Continuous, Schedule, Spacing, StepAndSettle},
};

use super::{CameraTrigger, DialectTable, SweepMode, Vehicle};
use crate::error::Error;

/// How often the drive is sent on in a continuous sweep.
const COMMAND_EVERY: Duration = Duration::from_millis(5);
/// How often a frame that did not come is exposed again.
const RETRIES: u32 = 2;
/// By how much a camera's clock may be off the vehicle's once they were compared.
const STAMP_SLACK: Duration = Duration::from_millis(1);

/// A duration of the file; the check has refused what is none.
pub(super) fn milliseconds(value: f64) -> Duration {
    Duration::try_from_secs_f64(value * 1e-3).unwrap_or_default()
}

impl Vehicle {
    /// Within what the mirror is driven.
    ///
    /// # Errors
    /// What is wrong with them; nothing for a vehicle that was read.
    pub fn limits(&self) -> Result<Limits, String> {
        Limits::new(self.galvo.range_v, self.galvo.slew_v_per_s, self.galvo.follow_v)
    }

    /// How the interlock works.
    pub fn policy(&self) -> Policy {
        Policy {
            park_v: self.galvo.park_v,
            within: milliseconds(self.galvo.timeout_ms),
            watchdog: Some(milliseconds(self.interlock.watchdog_ms)),
            ..Policy::default()
        }
    }

    /// What the camera is asked for.
    pub fn camera_settings(&self) -> CameraSettings {
        let c = &self.camera;
        CameraSettings {
            size: [c.width, c.height],
            pixel_format: c.pixel_format.clone(),
            significant_bits: c.bits,
            exposure: milliseconds(c.exposure_ms),
            gain_db: c.gain_db,
            trigger: match c.trigger {
                CameraTrigger::Software => Trigger::Software,
                CameraTrigger::Hardware => Trigger::Hardware,
                CameraTrigger::Free => Trigger::Free { rate_hz: c.rate_hz.unwrap_or_default() },
            },
        }
    }

    /// How long a frame may take.
    pub fn frame_within(&self) -> Duration {
        milliseconds(self.camera.timeout_ms)
    }

    /// How long the mirror takes to settle, as the file has it.
    pub fn settle(&self) -> Duration {
        milliseconds(self.galvo.settle_ms)
    }

    /// The voltages of the file's sweep, the two ends alone where it is continuous.
    ///
    /// # Errors
    /// What is wrong with them; nothing for a vehicle that was read.
    pub fn schedule(&self) -> Result<Schedule, uw_hw::sweep::ScheduleError> {
        let s = &self.sweep;
        let spacing = match (s.mode, s.step_v, s.count) {
            (SweepMode::Step, Some(step_v), _) => Spacing::Step(step_v),
            (SweepMode::Step, None, Some(count)) => Spacing::Count(count as usize),
            _ => Spacing::Count(2),
        };
        Schedule::new(s.from_v, s.to_v, spacing)
    }

    /// How the file's sweep goes by steps.
    pub fn step_and_settle(&self) -> StepAndSettle {
        StepAndSettle {
            settle: self.settle(),
            frame_within: self.frame_within(),
            retries: RETRIES,
            stamp_slack: STAMP_SLACK,
        }
    }

    /// How the file's sweep goes without stopping; `None` where it goes by steps.
    pub fn continuous(&self) -> Option<Continuous> {
        Some(Continuous {
            from_v: self.sweep.from_v,
            to_v: self.sweep.to_v,
            rate_v_per_s: self.sweep.rate_v_per_s.filter(|_| self.sweep.mode == SweepMode::Continuous)?,
            command_every: COMMAND_EVERY,
            settle: self.settle(),
            lag: milliseconds(self.galvo.lag_ms),
            frame_within: self.frame_within(),
        })
    }

    /// The galvanometer's dialect.
    ///
    /// # Errors
    /// [`Error`] for a dialect's file that cannot be read.
    pub fn galvo_dialect(&self) -> Result<Dialect, Error> {
        self.dialect(self.galvo.dialect_file.as_deref(), self.galvo.dialect.as_ref())
    }

    /// The laser's dialect, where it has a controller of its own.
    ///
    /// # Errors
    /// As [`Vehicle::galvo_dialect`].
    pub fn laser_dialect(&self) -> Result<Dialect, Error> {
        self.dialect(self.laser.dialect_file.as_deref(), self.laser.dialect.as_ref())
    }

    fn dialect(
        &self,
        file: Option<&std::path::Path>,
        table: Option<&DialectTable>,
    ) -> Result<Dialect, Error> {
        let path = file.map(|file| self.resolve(file));
        let read = path.as_deref().map(DialectTable::read).transpose()?;
        let table = read.or_else(|| table.cloned()).unwrap_or_default();
        table.to_dialect().map_err(|e| {
            let place = crate::Place::file(path.as_deref().unwrap_or(&self.folder));
            Error::content(place, e.what, e.mend)
        })
    }
}
