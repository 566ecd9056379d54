//! What a simulation shows and takes: `scene.toml`.

mod check;
mod object;

use std::path::Path;

use serde::Deserialize;

pub use object::{KeyFault, ObjectRecord, ShapeRecord};

use crate::{
    capture::{Kind, Medium, Target},
    error::{Error, Problem},
    toml_file::{TomlFile, exactly},
};

/// The `format` of a scene file.
pub const FORMAT: &str = "uwscan-scene";
/// The newest version of the scene file that is read.
pub const VERSION: u32 = 1;

/// A scene file, checked. Millimetres, degrees, camera frame, as in the file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// Seed of all noise.
    #[serde(default = "one")]
    pub seed: u64,
    /// What to record.
    pub capture: CaptureRecord,
    /// What records it.
    pub instrument: InstrumentRecord,
    /// The laser's light.
    #[serde(default)]
    pub beam: BeamRecord,
    /// The lens.
    #[serde(default)]
    pub lens: LensRecord,
    /// The sensor.
    #[serde(default)]
    pub sensor: SensorRecord,
    /// What the water does to light; its index is the rig's.
    #[serde(default)]
    pub water: WaterRecord,
    /// Light beside the laser's.
    #[serde(default)]
    pub ambient: AmbientRecord,
    /// What is there. A calibration's target is besides.
    #[serde(default, rename = "object")]
    pub objects: Vec<ObjectRecord>,
    /// Placements of a calibration's target.
    #[serde(default, rename = "pose")]
    pub poses: Vec<PoseRecord>,
}

fn one() -> u64 {
    1
}

/// What to record.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureRecord {
    /// What it is for.
    pub kind: Kind,
    /// What is outside the windows.
    pub medium: Medium,
    /// Target of a calibration.
    pub target: Option<Target>,
    /// Voltages in the order of capture: at each pose of a calibration, or once in a scan.
    #[serde(default)]
    pub voltages_v: Vec<f64>,
    /// In their place: from, to, and how many, evenly spaced.
    pub sweep: Option<SweepRecord>,
    /// From the start of one exposure to the next, milliseconds.
    #[serde(default = "CaptureRecord::interval")]
    pub interval_ms: f64,
    /// Length of an exposure, milliseconds: things are shown where they are in its middle.
    #[serde(default = "CaptureRecord::exposure")]
    pub exposure_ms: f64,
    /// Start of the first exposure, nanoseconds since the Unix epoch.
    #[serde(default = "CaptureRecord::start")]
    pub start_ns: u64,
}

impl CaptureRecord {
    fn interval() -> f64 {
        40.0
    }
    fn exposure() -> f64 {
        10.0
    }
    fn start() -> u64 {
        1_700_000_000_000_000_000
    }

    /// The voltages, written out.
    pub fn voltages(&self) -> Vec<f64> {
        match self.sweep {
            Some(SweepRecord { from_v, to_v, steps }) => (0..steps)
                .map(|k| from_v + (to_v - from_v) * f64::from(k) / f64::from((steps - 1).max(1)))
                .collect(),
            None => self.voltages_v.clone(),
        }
    }
}

/// Evenly spaced voltages.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepRecord {
    /// The first.
    pub from_v: f64,
    /// The last.
    pub to_v: f64,
    /// How many.
    pub steps: u32,
}

/// What records: an instrument as drawn, with what the rig file can't say of it, or one that was calibrated.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InstrumentRecord {
    /// Rig file, relative to the scene file.
    pub rig: Option<String>,
    /// In its place: a calibration file, whose estimates are the truth.
    pub calibration: Option<String>,
    /// A point of the mirror's axis.
    pub axis_point_mm: Option<[f64; 3]>,
    /// The axis' direction, in the sense about which a rising voltage turns the beam.
    pub axis_direction: Option<[f64; 3]>,
    /// The fan's middle inside the housing at the reference voltage, out to the scene.
    pub beam_direction: Option<[f64; 3]>,
    /// The true instrument differs from its drawing by what this seed draws from the rig's priors; absent: by nothing.
    pub differs_by_seed: Option<u64>,
    /// The instrument's own velocity.
    #[serde(default, deserialize_with = "exactly")]
    pub velocity_mm_s: [f64; 3],
}

/// The laser's light.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BeamRecord {
    /// Half of the fan's opening in air.
    pub half_angle_deg: f64,
    /// Radius at which the irradiance falls to 1/e², at the waist.
    pub waist_radius_mm: f64,
    /// From the apex to the waist.
    pub waist_at_mm: f64,
    /// Brightness of a white surface at 1 m, of full scale.
    pub level: f64,
}

impl Default for BeamRecord {
    fn default() -> Self {
        Self { half_angle_deg: 15.0, waist_radius_mm: 0.5, waist_at_mm: 1000.0, level: 2.0 }
    }
}

/// The lens.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LensRecord {
    /// Standard deviation of its point-spread.
    pub blur_px: f64,
    /// Share of the light that forward scatter spreads wider.
    pub halo: f64,
    /// Standard deviation of that.
    pub halo_px: f64,
    /// Loss of light in the image's corner.
    pub vignetting: f64,
}

impl Default for LensRecord {
    fn default() -> Self {
        Self { blur_px: 0.6, halo: 0.0, halo_px: 6.0, vignetting: 0.0 }
    }
}

/// The sensor; its bits are the rig's.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorRecord {
    /// Electrons that full scale holds; 0: no shot noise.
    pub full_well: f64,
    /// Standard deviation of the read noise as a share of full scale.
    pub read_noise: f64,
    /// Grey value of darkness as a share of full scale.
    pub offset: f64,
    /// Contrast of speckle.
    pub speckle: f64,
    /// Standard deviation of its grain.
    pub speckle_px: f64,
}

impl Default for SensorRecord {
    fn default() -> Self {
        Self { full_well: 10_000.0, read_noise: 0.002, offset: 0.0, speckle: 0.0, speckle_px: 0.5 }
    }
}

/// What the water does to light.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WaterRecord {
    /// Attenuation.
    pub attenuation_per_m: f64,
    /// Share of the light that a metre throws back, as a white surface would.
    pub backscatter_per_m: f64,
}

/// Light beside the laser's: brightness of a white surface, of full scale.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AmbientRecord {
    /// While the laser is off.
    pub laser_off: f64,
    /// While it is on.
    pub laser_on: f64,
}

impl Default for AmbientRecord {
    fn default() -> Self {
        Self { laser_off: 0.75, laser_on: 0.0 }
    }
}

/// Where something is.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseRecord {
    /// Of the target: its middle, mm.
    #[serde(deserialize_with = "exactly")]
    pub position_mm: [f64; 3],
    /// Turn about the axis along this vector by its length, degrees.
    #[serde(default, deserialize_with = "exactly")]
    pub rotation_deg: [f64; 3],
}

impl SceneFile {
    /// The scene of a file, checked, with warnings.
    ///
    /// # Errors
    /// [`Error`] where the file cannot be read, is of another format or a later version, holds an unknown key, or a value that no
    /// scene has.
    pub fn read(path: &Path) -> Result<(Self, Vec<Problem>), Error> {
        Self::checked(&TomlFile::read(path, FORMAT, VERSION)?)
    }

    /// The scene of a text, as [`SceneFile::read`]; `path` names it in errors.
    ///
    /// # Errors
    /// As [`SceneFile::read`].
    pub fn parse(path: &Path, text: &str) -> Result<(Self, Vec<Problem>), Error> {
        Self::checked(&TomlFile::of_text(path, text.to_owned(), FORMAT, VERSION)?)
    }

    fn checked(file: &TomlFile) -> Result<(Self, Vec<Problem>), Error> {
        let scene: Self = file.parse()?;
        let warnings = check::check(file, &scene)?;
        Ok((scene, warnings))
    }
}
