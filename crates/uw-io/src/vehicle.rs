//! What is on the vehicle and how it is driven: `vehicle.toml`.

mod check;
mod dialect;
mod domain;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

pub use dialect::{DialectTable, ExchangeTable};

use crate::{
    error::{Error, Problem},
    toml_file::{TomlFile, exactly},
};

/// The `format` of a vehicle file.
pub const FORMAT: &str = "uwscan-vehicle";
/// The newest version of the vehicle file that is read, and the one that is written.
pub const VERSION: u32 = 1;

/// Devices, sweep and files of a vehicle. Paths are as in the file; [`Vehicle::resolve`] makes them findable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vehicle {
    /// The rig file.
    pub rig: PathBuf,
    /// The calibration file; `None` as long as there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
    /// The scene that the simulated devices see.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<PathBuf>,
    /// The mirror's drive.
    pub galvo: Galvo,
    /// The laser.
    pub laser: Laser,
    /// The camera.
    pub camera: Camera,
    /// The sweep that is made where none is asked for.
    pub sweep: Sweep,
    /// Where scans go.
    pub disk: Disk,
    /// What keeps people safe.
    #[serde(default)]
    pub interlock: Interlock,
    /// The folder that relative paths count from.
    #[serde(skip)]
    folder: PathBuf,
}

/// What drives the mirror.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GalvoDriver {
    /// A controller on a serial port that speaks a [dialect](DialectTable).
    Scpi,
    /// A recording's, with the replayed camera.
    Replay,
    /// The simulator's.
    Simulated,
}

/// The mirror's drive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Galvo {
    /// What drives it.
    pub driver: GalvoDriver,
    /// Serial port, with `scpi`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub port: Option<String>,
    /// Its speed, with `scpi`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub baud: Option<u32>,
    /// A file with the dialect; neither this nor `dialect`: SCPI.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dialect_file: Option<PathBuf>,
    /// Where the dialect differs from SCPI.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dialect: Option<DialectTable>,
    /// Lowest and highest voltage that the mirror is driven to.
    #[serde(deserialize_with = "exactly")]
    pub range_v: [f64; 2],
    /// The fastest change.
    pub slew_v_per_s: f64,
    /// How long the mirror takes to settle after a step.
    pub settle_ms: f64,
    /// By how much the mirror lags behind its read-back on a ramp.
    #[serde(default)]
    pub lag_ms: f64,
    /// How far a settled read-back may be from the command.
    pub follow_v: f64,
    /// Where the mirror is left.
    pub park_v: f64,
    /// What an answer may take.
    #[serde(default = "default_timeout_ms")]
    pub timeout_ms: f64,
}

/// What drives the laser.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LaserDriver {
    /// The galvanometer's controller.
    Galvo,
    /// A controller of its own on a serial port.
    Scpi,
    /// A recording's, with the replayed camera.
    Replay,
    /// The simulator's.
    Simulated,
}

/// The laser.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Laser {
    /// What drives it.
    pub driver: LaserDriver,
    /// Serial port, with `scpi`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub port: Option<String>,
    /// Its speed, with `scpi`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub baud: Option<u32>,
    /// As the galvanometer's, with `scpi`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dialect_file: Option<PathBuf>,
    /// As the galvanometer's, with `scpi`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dialect: Option<DialectTable>,
    /// Power as a fraction of the most it has; `None` to leave it as it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub power: Option<f64>,
}

/// Where images come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraDriver {
    /// GigE Vision or USB3 Vision.
    Genicam,
    /// A V4L2 device.
    V4l2,
    /// A recording.
    Replay,
    /// The simulator's.
    Simulated,
}

/// What starts an exposure.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraTrigger {
    /// A command.
    #[default]
    Software,
    /// A pulse.
    Hardware,
    /// The camera itself, `rate_hz` times a second.
    Free,
}

/// The camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Where images come from.
    pub driver: CameraDriver,
    /// Which one: a GenICam id or address, a device file, a recording; `None` for the only one there is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// Width of an image, pixels.
    pub width: u32,
    /// Height of an image, pixels.
    pub height: u32,
    /// Significant bits of an image's value.
    pub bits: u8,
    /// The camera's name of its pixel format; `None` for the one that fits `bits`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel_format: Option<String>,
    /// How long a frame is exposed.
    pub exposure_ms: f64,
    /// Gain; `None` to leave it as it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain_db: Option<f64>,
    /// What starts an exposure.
    #[serde(default)]
    pub trigger: CameraTrigger,
    /// Frames a second, with `free`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<f64>,
    /// How long a frame may take from its trigger, or from the one before it.
    pub timeout_ms: f64,
}

/// In which way the mirror goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SweepMode {
    /// It stands still for each frame.
    Step,
    /// It moves on.
    Continuous,
}

/// A sweep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sweep {
    /// In which way.
    pub mode: SweepMode,
    /// Where it begins.
    pub from_v: f64,
    /// Where it ends.
    pub to_v: f64,
    /// Between two images, with `step`; or `count`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step_v: Option<f64>,
    /// How many images, both ends included, with `step`; or `step_v`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub count: Option<u32>,
    /// How fast, with `continuous`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_v_per_s: Option<f64>,
    /// A background image before the first and after so many images each, with `step`; 0: none.
    #[serde(default)]
    pub background_every: u32,
}

/// Where scans go.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Disk {
    /// The folder.
    pub folder: PathBuf,
    /// Less room than this is a fault before a scan, and ends one.
    pub min_free_mb: f64,
}

/// What keeps people safe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Interlock {
    /// A scan that nothing is heard of for so long is stopped.
    #[serde(default = "default_watchdog_ms")]
    pub watchdog_ms: f64,
}

impl Default for Interlock {
    fn default() -> Self {
        Self { watchdog_ms: default_watchdog_ms() }
    }
}

fn default_timeout_ms() -> f64 {
    250.0
}

fn default_watchdog_ms() -> f64 {
    2000.0
}

impl Vehicle {
    /// The vehicle of a file, checked, with warnings about values that are possible but unlikely to be meant.
    ///
    /// # Errors
    /// [`Error`] where the file cannot be read, is of another format or a later version, holds an unknown key, or a
    /// value that no vehicle has.
    pub fn read(path: &Path) -> Result<(Self, Vec<Problem>), Error> {
        let file = TomlFile::read(path, FORMAT, VERSION)?;
        let mut vehicle: Self = file.parse()?;
        vehicle.folder = path.parent().map(Path::to_owned).unwrap_or_default();
        let warnings = check::check(&vehicle, &file)?;
        Ok((vehicle, warnings))
    }

    /// A path of the file, which counts from the file's folder.
    pub fn resolve(&self, path: &Path) -> PathBuf {
        // Without the dots that a folder named "." would leave in messages and names.
        self.folder.join(path).components().collect()
    }

    /// The text of a vehicle file.
    ///
    /// # Errors
    /// [`Error::Content`] where it cannot be written as TOML, which none that was read meets.
    pub fn to_toml(&self) -> Result<String, Error> {
        let body = toml::to_string(self).map_err(|e| {
            let place = crate::Place::file(Path::new("vehicle.toml"));
            Error::content(place, e.to_string(), "mend the vehicle's values")
        })?;
        Ok(format!("format = \"{FORMAT}\"\nversion = {VERSION}\n\n{body}"))
    }
}
