//! Galvanometer and laser behind a link.

use std::time::Duration;

use super::link::{self, SharedLink};
use crate::{
    AllowedVolts, Deadline, Fault, Galvo, Identity, Laser, Moved, ReadBack,
    galvo::proto::{Command, Reply},
};

/// A galvanometer that a controller drives.
#[derive(Debug)]
pub struct SerialGalvo {
    link: SharedLink,
    settle: Duration,
}

impl SerialGalvo {
    /// The galvanometer of a controller; `settle` is how long it takes, as configured.
    pub fn new(link: SharedLink, settle: Duration) -> Self {
        Self { link, settle }
    }
}

fn read_back(link: &mut link::Link, deadline: Deadline) -> Result<ReadBack, Fault> {
    let asked_ns = link.timeline().stamp_ns();
    let reply = link.ask_by(Command::ReadVolts, deadline)?;
    let answered_ns = link.timeline().stamp_ns();
    let half_ns = (answered_ns - asked_ns).max(0) / 2;
    match reply {
        Some(Reply { number: Some(volts), .. }) => {
            Ok(ReadBack { volts, stamp_ns: asked_ns + half_ns, uncertainty_ns: half_ns.cast_unsigned() })
        }
        // A dialect without it can't be made.
        _ => Err(Fault::Unsupported {
            device: link.name(),
            what: "say where the mirror is".into(),
            mend: "add read_volts to its dialect".into(),
        }),
    }
}

impl Galvo for SerialGalvo {
    fn identity(&self) -> Identity {
        link::lock(&self.link).identity()
    }

    fn set(&mut self, volts: AllowedVolts, within: Duration) -> Result<Moved, Fault> {
        let mut link = link::lock(&self.link);
        let deadline = link.timeline().deadline(within);
        let sent_ns = link.timeline().stamp_ns();
        link.tell(Command::SetVolts(volts.volts()), deadline)?;
        let read_back = read_back(&mut link, deadline)?;
        Ok(Moved { commanded_v: volts.volts(), sent_ns, read_back })
    }

    fn read_back(&mut self, within: Duration) -> Result<ReadBack, Fault> {
        let mut link = link::lock(&self.link);
        let deadline = link.timeline().deadline(within);
        read_back(&mut link, deadline)
    }

    fn settle_time(&self) -> Duration {
        self.settle
    }
}

/// A laser that a controller switches.
#[derive(Debug)]
pub struct SerialLaser {
    link: SharedLink,
}

impl SerialLaser {
    /// The laser of a controller.
    pub fn new(link: SharedLink) -> Self {
        Self { link }
    }

    fn tell(&self, command: Command, within: Duration) -> Result<(), Fault> {
        let mut link = link::lock(&self.link);
        let deadline = link.timeline().deadline(within);
        link.tell(command, deadline)
    }
}

impl Laser for SerialLaser {
    fn identity(&self) -> Identity {
        link::lock(&self.link).identity()
    }

    fn on(&mut self, within: Duration) -> Result<(), Fault> {
        self.tell(Command::LaserOn, within)
    }

    fn off(&mut self, within: Duration) -> Result<(), Fault> {
        let mut link = link::lock(&self.link);
        let deadline = link.timeline().deadline(within);
        if link.is_disturbed() {
            // A line in disorder may take all the time there is to be put in order: the command goes out first.
            link.shout(Command::LaserOff, deadline)?;
        }
        link.tell(Command::LaserOff, deadline)
    }

    fn is_on(&mut self, within: Duration) -> Result<bool, Fault> {
        let mut link = link::lock(&self.link);
        let deadline = link.timeline().deadline(within);
        match link.ask_by(Command::LaserState, deadline)? {
            Some(Reply { on: Some(on), .. }) => Ok(on),
            _ => Err(Fault::Unsupported {
                device: link.name(),
                what: "say whether the laser is on".into(),
                mend: "add laser_state to its dialect, if the controller can".into(),
            }),
        }
    }

    fn set_power(&mut self, fraction: f64, within: Duration) -> Result<(), Fault> {
        if !(0.0..=1.0).contains(&fraction) {
            let device = link::lock(&self.link).name();
            let allowed = [0.0, 1.0];
            return Err(Fault::OutOfRange { device, quantity: "power", unit: "", value: fraction, allowed });
        }
        self.tell(Command::LaserPower(fraction), within)
    }
}
