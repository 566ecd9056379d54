//! Drives that a replayed or simulated camera sees, though they are others: what a controller makes of commands can be tried before a
//! recorded or simulated scene.

use std::time::Duration;
use uw_hw::{AllowedVolts, Fault, Galvo, Identity, Laser, Moved, ReadBack};

/// A device, and the one that the camera sees: what the first has done, the second does as well.
pub(super) struct Seen<D> {
    pub(super) device: D,
    pub(super) shadow: D,
}

impl Galvo for Seen<Box<dyn Galvo>> {
    fn identity(&self) -> Identity {
        self.device.identity()
    }

    fn set(&mut self, volts: AllowedVolts, within: Duration) -> Result<Moved, Fault> {
        let moved = self.device.set(volts, within)?;
        self.shadow.set(volts, within)?;
        Ok(moved)
    }

    fn read_back(&mut self, within: Duration) -> Result<ReadBack, Fault> {
        self.device.read_back(within)
    }

    fn settle_time(&self) -> Duration {
        self.device.settle_time()
    }
}

impl Laser for Seen<Box<dyn Laser>> {
    fn identity(&self) -> Identity {
        self.device.identity()
    }

    fn on(&mut self, within: Duration) -> Result<(), Fault> {
        self.device.on(within)?;
        self.shadow.on(within)
    }

    fn off(&mut self, within: Duration) -> Result<(), Fault> {
        self.device.off(within)?;
        self.shadow.off(within)
    }

    fn is_on(&mut self, within: Duration) -> Result<bool, Fault> {
        self.device.is_on(within)
    }

    fn set_power(&mut self, fraction: f64, within: Duration) -> Result<(), Fault> {
        self.device.set_power(fraction, within)
    }
}
