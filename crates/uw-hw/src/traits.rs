//! What every galvanometer, laser and camera can be asked. Each call takes the time that it may use (`within`), and comes back by then:
//! with what was asked, or with a [`Fault`]. All traits are object-safe, and what implements them can move to another thread.

use std::time::Duration;

use crate::{AllowedVolts, Fault, Frame};

/// Who a device says it is. A field that it doesn't say is empty.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// The driver's name, as vehicle files have it: `scpi`, `genicam`, `mock`, …
    pub driver: String,
    /// Where it is: a port, an address, a device file.
    pub place: String,
    /// Its maker.
    pub vendor: String,
    /// Its model.
    pub model: String,
    /// Its serial number.
    pub serial: String,
    /// Its firmware's version.
    pub firmware: String,
}

/// A voltage that was read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadBack {
    /// The voltage.
    pub volts: f64,
    /// When: the middle between question and answer, nanoseconds since the Unix epoch.
    pub stamp_ns: i64,
    /// Half the time between question and answer: by how much `stamp_ns` may be wrong, ns.
    pub uncertainty_ns: u64,
}

/// A move that was acknowledged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moved {
    /// Where the drive was sent, V.
    pub commanded_v: f64,
    /// When the command was sent, nanoseconds since the Unix epoch.
    pub sent_ns: i64,
    /// What the drive said afterwards; the mirror may still be under way.
    pub read_back: ReadBack,
}

/// A galvanometer's drive. It takes only voltages that [`GuardedGalvo`](crate::GuardedGalvo) has allowed.
pub trait Galvo: Send {
    /// Who it is.
    fn identity(&self) -> Identity;

    /// Sends the drive to a voltage; comes back with the read-back once that was acknowledged. Does not wait for the mirror.
    ///
    /// # Errors
    /// The drive's [`Fault`].
    fn set(&mut self, volts: AllowedVolts, within: Duration) -> Result<Moved, Fault>;

    /// Where the drive says that the mirror is, V.
    ///
    /// # Errors
    /// The drive's [`Fault`].
    fn read_back(&mut self, within: Duration) -> Result<ReadBack, Fault>;

    /// How long the mirror takes to settle after a small step: the maker's figure, or what was configured. What it really takes,
    /// measure.
    fn settle_time(&self) -> Duration;
}

/// A laser.
pub trait Laser: Send {
    /// Who it is.
    fn identity(&self) -> Identity;

    /// Switches it on; comes back once that was acknowledged.
    ///
    /// # Errors
    /// The laser's [`Fault`]; it may then be on or off.
    fn on(&mut self, within: Duration) -> Result<(), Fault>;

    /// Switches it off; comes back once that was acknowledged. May be called at any time, whatever went wrong before.
    ///
    /// # Errors
    /// The laser's [`Fault`]; it may then still be on.
    fn off(&mut self, within: Duration) -> Result<(), Fault>;

    /// Whether it says it is on.
    ///
    /// # Errors
    /// The laser's [`Fault`].
    fn is_on(&mut self, within: Duration) -> Result<bool, Fault>;

    /// Sets the power as a fraction of the most it has, 0 to 1.
    ///
    /// # Errors
    /// [`Fault::OutOfRange`] outside 0 to 1, [`Fault::Unsupported`] where the power is fixed, else the laser's own.
    fn set_power(&mut self, fraction: f64, within: Duration) -> Result<(), Fault>;
}

/// What starts an exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trigger {
    /// [`Camera::trigger`].
    Software,
    /// A pulse on the camera's input.
    Hardware,
    /// The camera by itself, this many times a second.
    Free {
        /// Frames a second.
        rate_hz: f64,
    },
}

/// What a camera is asked for, and what it then does.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSettings {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// The camera's name of its pixel format, such as `Mono8`, `Mono12`; `None` for the driver's choice by `significant_bits`.
    pub pixel_format: Option<String>,
    /// Bits of a value that count.
    pub significant_bits: u8,
    /// How long each frame is exposed.
    pub exposure: Duration,
    /// Gain, decibels; `None` to leave it as it is.
    pub gain_db: Option<f64>,
    /// What starts an exposure.
    pub trigger: Trigger,
}

/// What came of a camera since it was armed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounts {
    /// Frames handed over.
    pub received: u64,
    /// Frames that never came, by the gaps in the camera's ids.
    pub dropped: u64,
    /// Frames that came again.
    pub duplicated: u64,
    /// Frames that came torn, or of a wrong size.
    pub unusable: u64,
}

/// A camera. The order is: configure, arm, (trigger, next frame) as often as wanted, disarm.
pub trait Camera: Send {
    /// Who it is.
    fn identity(&self) -> Identity;

    /// Sets the camera up; gives the settings that are then in force, which differ from those wanted where the camera rounds.
    ///
    /// # Errors
    /// [`Fault::Unsupported`] for what it can't do, else the camera's own.
    fn configure(&mut self, wanted: &CameraSettings, within: Duration) -> Result<CameraSettings, Fault>;

    /// Makes it ready to expose; ids and counts begin again at zero.
    ///
    /// # Errors
    /// The camera's [`Fault`].
    fn arm(&mut self, within: Duration) -> Result<(), Fault>;

    /// Starts an exposure; comes back without waiting for the frame.
    ///
    /// # Errors
    /// [`Fault::Unsupported`] where the trigger is not by software, else the camera's own.
    fn trigger(&mut self, within: Duration) -> Result<(), Fault>;

    /// The next frame.
    ///
    /// # Errors
    /// Where [`Fault::is_passing`], the camera goes on, and the next call gives what comes then: after
    /// [`Fault::DroppedFrames`] the frame that came after them.
    fn next_frame(&mut self, within: Duration) -> Result<Frame, Fault>;

    /// Ends exposing; frames that were not asked for are gone.
    ///
    /// # Errors
    /// The camera's [`Fault`].
    fn disarm(&mut self, within: Duration) -> Result<(), Fault>;

    /// What came since it was armed.
    fn counts(&self) -> FrameCounts;
}
