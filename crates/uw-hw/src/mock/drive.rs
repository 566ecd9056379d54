//! The bench's galvanometer and laser.

use std::time::Duration;

use super::{Device, Event, LEGS_KEPT, Leg, Mock, MockFault, identity};
use crate::{AllowedVolts, Fault, Galvo, Identity, Laser, Moved, ReadBack};

/// A galvanometer whose mirror lags behind by the bench's time constant, and whose read-back is the mirror's.
#[derive(Debug)]
pub struct MockGalvo {
    mock: Mock,
}

impl MockGalvo {
    pub(super) fn new(mock: Mock) -> Self {
        Self { mock }
    }

    fn read(&self) -> ReadBack {
        let stamp_ns = self.mock.timeline.stamp_ns();
        ReadBack { volts: self.mock.lock().volts_at(stamp_ns), stamp_ns, uncertainty_ns: 0 }
    }
}

impl Galvo for MockGalvo {
    fn identity(&self) -> Identity {
        identity(Device::Galvo)
    }

    fn set(&mut self, volts: AllowedVolts, within: Duration) -> Result<Moved, Fault> {
        let (_, fault) = self.mock.call(Device::Galvo);
        let sent_ns = self.mock.timeline.stamp_ns();
        let deaf = [MockFault::Silent, MockFault::Unplugged, MockFault::Refuses, MockFault::Stuck];
        if !fault.is_some_and(|fault| deaf.contains(&fault)) {
            let mut state = self.mock.lock();
            let from_v = state.volts_at(sent_ns);
            if state.legs.len() >= LEGS_KEPT {
                state.legs.drain(..LEGS_KEPT / 2);
            }
            state.legs.push(Leg { begin_ns: sent_ns, from_v, to_v: volts.volts() });
            state.note(sent_ns, Event::Sent(volts.volts()));
        }
        self.mock.answer(Device::Galvo, fault, "a move", within)?;
        Ok(Moved { commanded_v: volts.volts(), sent_ns, read_back: self.read() })
    }

    fn read_back(&mut self, within: Duration) -> Result<ReadBack, Fault> {
        let fault = self.mock.now(Device::Galvo);
        self.mock.answer(Device::Galvo, fault, "the read-back", within)?;
        Ok(self.read())
    }

    fn settle_time(&self) -> Duration {
        self.mock.lock().bench.settle_time
    }
}

/// A laser.
#[derive(Debug)]
pub struct MockLaser {
    mock: Mock,
}

impl MockLaser {
    pub(super) fn new(mock: Mock) -> Self {
        Self { mock }
    }

    fn switch(&self, on: bool, within: Duration) -> Result<(), Fault> {
        let (_, fault) = self.mock.call(Device::Laser);
        let deaf = [MockFault::Silent, MockFault::Unplugged, MockFault::Refuses, MockFault::StaysAsItIs];
        if !fault.is_some_and(|fault| deaf.contains(&fault)) {
            let now = self.mock.timeline.stamp_ns();
            let mut state = self.mock.lock();
            state.laser_on = on;
            state.note(now, Event::Laser(on));
        }
        self.mock.answer(Device::Laser, fault, if on { "switching on" } else { "switching off" }, within)
    }
}

impl Laser for MockLaser {
    fn identity(&self) -> Identity {
        identity(Device::Laser)
    }

    fn on(&mut self, within: Duration) -> Result<(), Fault> {
        self.switch(true, within)
    }

    fn off(&mut self, within: Duration) -> Result<(), Fault> {
        self.switch(false, within)
    }

    fn is_on(&mut self, within: Duration) -> Result<bool, Fault> {
        let fault = self.mock.now(Device::Laser);
        self.mock.answer(Device::Laser, fault, "whether it is on", within)?;
        Ok(self.mock.laser_is_on())
    }

    fn set_power(&mut self, fraction: f64, within: Duration) -> Result<(), Fault> {
        if !(0.0..=1.0).contains(&fraction) {
            let (device, allowed) = (identity(Device::Laser).driver, [0.0, 1.0]);
            return Err(Fault::OutOfRange { device, quantity: "power", unit: "", value: fraction, allowed });
        }
        let fault = self.mock.now(Device::Laser);
        self.mock.answer(Device::Laser, fault, "its power", within)?;
        self.mock.lock().power = fraction;
        Ok(())
    }
}
