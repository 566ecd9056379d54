//! What is known of the instrument before calibration: `rig.toml`.

mod check;
mod priors;
mod water;

use std::path::Path;

use serde::{Deserialize, Serialize};
use uw_geom::{GeomError, Medium};

use check::Check;
pub use priors::Priors;
pub use water::Water;

use crate::{
    error::{Error, Problem},
    toml_file::{TomlFile, exactly},
};

/// The `format` of a rig file.
pub const FORMAT: &str = "uwscan-rig";
/// The newest version of the rig file that is read, and the one that is written.
pub const VERSION: u32 = 1;

/// Drawing values of an instrument, with the sigmas that they are trusted to. Lengths in millimetres, angles in
/// degrees, as in the file; directions in the camera frame (x right, y down, z forward), of unit length.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// Sensor, lens and the window in front of them.
    pub camera: Camera,
    /// Fan and the window in front of the galvanometer.
    pub laser: Laser,
    /// The mirror's drive.
    pub galvo: Galvo,
    /// The water outside the windows; `None` for an instrument that is only used in air.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub water: Option<Water>,
    /// Standard deviations of the values above.
    #[serde(default)]
    pub priors: Priors,
}

/// Sensor, lens and window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Width of an image, pixels.
    pub width: u32,
    /// Height of an image, pixels.
    pub height: u32,
    /// Pitch of an image pixel along u and along v, micrometres.
    #[serde(deserialize_with = "exactly")]
    pub pixel_um: [f64; 2],
    /// Focal length as drawn.
    pub focal_mm: f64,
    /// Significant bits of an image's value, right-justified: 12 means 0 to 4095.
    pub bits: u8,
    /// The flat window in front of the camera; its distance counts from the optical centre.
    pub port: Port,
}

/// A flat window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Port {
    /// From the optical centre (camera) or the galvanometer frame's origin (laser) to the inner face, along the normal.
    pub distance_mm: f64,
    /// Thickness of the glass.
    pub thickness_mm: f64,
    /// Unit normal, camera frame, from the instrument outwards.
    #[serde(deserialize_with = "exactly")]
    pub normal: [f64; 3],
    /// Index of the glass at the laser's wavelength, relative to air.
    pub index: f64,
}

/// Fan and window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Laser {
    /// Wavelength in air, nanometres.
    pub wavelength_nm: f64,
    /// Geometric length from the fan's apex to the mirror axis; `None` where it is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub apex_mm: Option<f64>,
    /// The flat window in front of the galvanometer; its distance counts from the galvanometer frame's origin.
    pub port: Port,
}

/// The mirror's drive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Galvo {
    /// Mechanical turn of the mirror, degrees per volt, positive; the beam turns twice as far.
    pub degrees_per_volt: f64,
    /// Lowest and highest voltage of the drive.
    #[serde(deserialize_with = "exactly")]
    pub range_v: [f64; 2],
    /// The voltage that fixes the galvanometer frame.
    pub reference_v: f64,
}

impl Port {
    fn to_geom(&self) -> Result<uw_geom::Port, GeomError> {
        let glass = Medium::of_index(self.index);
        uw_geom::Port::new(self.normal.into(), self.distance_mm, self.thickness_mm, glass)
    }
}

impl Rig {
    /// The rig of a file, checked, its normals of unit length, with warnings about values that are possible but
    /// unlikely to be meant.
    ///
    /// # Errors
    /// [`Error`] where the file cannot be read, is of another format or a later version, holds an unknown key, or a
    /// value that no instrument has.
    pub fn read(path: &Path) -> Result<(Self, Vec<Problem>), Error> {
        Self::checked(&TomlFile::read(path, FORMAT, VERSION)?)
    }

    /// The rig in a file's text, as [`Rig::read`]; `path` names it in errors.
    ///
    /// # Errors
    /// As [`Rig::read`].
    pub fn parse(path: &Path, text: &str) -> Result<(Self, Vec<Problem>), Error> {
        Self::checked(&TomlFile::of_text(path, text.to_owned(), FORMAT, VERSION)?)
    }

    fn checked(file: &TomlFile) -> Result<(Self, Vec<Problem>), Error> {
        let mut rig: Self = file.parse()?;
        let warnings = rig.check(file, "")?;
        Ok((rig, warnings))
    }

    /// Where another rig differs, as `key: this, not that`, in the file's keys; what values are trusted to and the water's state, which
    /// changes from day to day, aside. None where both are the same instrument.
    pub fn differences(&self, other: &Self) -> Vec<String> {
        let table = |rig: &Self| {
            let mut table = toml::Table::try_from(rig).unwrap_or_default();
            table.remove("priors");
            table.remove("water");
            toml::Value::Table(table)
        };
        let mut found = Vec::new();
        differences("", Some(&table(self)), Some(&table(other)), &mut found);
        found
    }

    /// Refuses values that no instrument has and makes the normals' lengths 1, with the warnings; the rig's keys are
    /// found in `file` after `prefix`.
    pub(crate) fn check(&mut self, file: &TomlFile, prefix: &str) -> Result<Vec<Problem>, Error> {
        let mut check = Check { file, prefix, warnings: Vec::new() };
        check.rig(self)?;
        Ok(check.warnings)
    }

    /// The rig as calibration takes it: focal lengths in pixels, windows, radians.
    ///
    /// # Errors
    /// [`GeomError`] for a window that is none, which no rig that was read has.
    pub fn to_calib(&self) -> Result<uw_calib::Rig, GeomError> {
        let Self { camera, laser, galvo, priors: p, .. } = self;
        Ok(uw_calib::Rig {
            image_size: [camera.width, camera.height],
            focal_px: camera.pixel_um.map(|pitch_um| camera.focal_mm * 1000.0 / pitch_um),
            camera_port: camera.port.to_geom()?,
            laser_port: laser.port.to_geom()?,
            apex_mm: laser.apex_mm,
            radians_per_volt: galvo.degrees_per_volt.to_radians(),
            reference_v: galvo.reference_v,
            priors: uw_calib::Priors {
                camera_port_distance_mm: p.camera_port_distance_mm,
                laser_port_distance_mm: p.laser_port_distance_mm,
                thickness_mm: p.thickness_mm,
                normal_deg: p.normal_deg,
                glass_index: p.glass_index,
                water_index: p.water_index,
                apex_mm: p.apex_mm,
                degrees_per_volt_rel: p.degrees_per_volt_rel,
                galvo_c2: p.galvo_c2,
                galvo_c3: p.galvo_c3,
                mirror_offset_mm: p.mirror_offset_mm,
                fan_tilt_deg: p.fan_tilt_deg,
                fan_offset_mm: p.fan_offset_mm,
                apex_along_axis_mm: p.apex_along_axis_mm,
            },
        })
    }

    /// The water's nominal index at the laser's wavelength, relative to air; `None` for a rig without water.
    pub fn water_index(&self) -> Option<f64> {
        self.water.map(|water| water.index(self.laser.wavelength_nm))
    }

    /// The water's nominal index at another wavelength in air (nm), such as that of the light on a board, relative to
    /// air; `None` for a rig without water.
    ///
    /// Where the index itself is given, it is that at the laser's wavelength, and the difference between the two
    /// wavelengths is Quan and Fry's at 15 °C and 17.5 psu: it changes by less than 2.5 % of itself (2e-4 from 450 to
    /// 650 nm, 2e-5 from 532 to 550) over the temperatures and salinities of their formula.
    pub fn water_index_at(&self, wavelength_nm: f64) -> Option<f64> {
        Some(match self.water? {
            Water::Index(at_laser) => {
                let typical = |nm| uw_geom::water::index(15.0, 17.5, nm, 0.0);
                at_laser + (typical(wavelength_nm) - typical(self.laser.wavelength_nm))
            }
            properties => properties.index(wavelength_nm),
        })
    }

    /// The text of a rig file.
    ///
    /// # Errors
    /// [`Error::Content`] where the rig cannot be written as TOML, which none that was read meets.
    pub fn to_toml(&self) -> Result<String, Error> {
        let body = toml::to_string(self).map_err(|e| {
            Error::content(crate::Place::file(Path::new("rig.toml")), e.to_string(), "mend the rig's values")
        })?;
        Ok(format!("format = \"{FORMAT}\"\nversion = {VERSION}\n\n{body}"))
    }
}

fn differences(key: &str, a: Option<&toml::Value>, b: Option<&toml::Value>, found: &mut Vec<String>) {
    match (a, b) {
        (Some(toml::Value::Table(a)), Some(toml::Value::Table(b))) => {
            let keys: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            for name in keys {
                let key = if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
                differences(&key, a.get(name), b.get(name), found);
            }
        }
        (a, b) if a == b => {}
        (a, b) => {
            let text = |value: Option<&toml::Value>| value.map_or("nothing".to_owned(), ToString::to_string);
            found.push(format!("{key} {}, not {}", text(a), text(b)));
        }
    }
}
