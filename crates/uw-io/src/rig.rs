//! What is known of the instrument before calibration: `rig.toml`.

use std::path::Path;

use serde::{Deserialize, Serialize};
use uw_geom::{GeomError, Medium};

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

/// What tells the index of the water, relative to air at the laser's wavelength.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "WaterRecord", into = "WaterRecord")]
pub enum Water {
    /// The index itself.
    Index(f64),
    /// What it follows from.
    Properties {
        /// Temperature, degrees Celsius.
        temperature_c: f64,
        /// Practical salinity.
        salinity_psu: f64,
        /// Depth below the surface, metres.
        depth_m: f64,
    },
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WaterRecord {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    index: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    temperature_c: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    salinity_psu: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    depth_m: Option<f64>,
}

impl TryFrom<WaterRecord> for Water {
    type Error = &'static str;

    fn try_from(r: WaterRecord) -> Result<Self, Self::Error> {
        match (r.index, r.temperature_c, r.salinity_psu, r.depth_m) {
            (Some(index), None, None, None) => Ok(Self::Index(index)),
            (None, Some(temperature_c), Some(salinity_psu), Some(depth_m)) => {
                Ok(Self::Properties { temperature_c, salinity_psu, depth_m })
            }
            (Some(_), ..) => Err("invalid [water]: it has both its index and what the index follows from"),
            (None, None, None, None) => Err(
                "invalid [water]: it is empty, but needs index, or all of temperature_c, salinity_psu and depth_m",
            ),
            (None, ..) => Err(
                "invalid [water]: it needs all of temperature_c, salinity_psu and depth_m, or index alone",
            ),
        }
    }
}

impl From<Water> for WaterRecord {
    fn from(water: Water) -> Self {
        let none = Self { index: None, temperature_c: None, salinity_psu: None, depth_m: None };
        match water {
            Water::Index(index) => Self { index: Some(index), ..none },
            Water::Properties { temperature_c, salinity_psu, depth_m } => Self {
                temperature_c: Some(temperature_c),
                salinity_psu: Some(salinity_psu),
                depth_m: Some(depth_m),
                ..none
            },
        }
    }
}

impl Water {
    /// The index relative to air: of water known by its index, that index, which is the one at the laser's wavelength;
    /// else Quan and Fry's at `wavelength_nm` (in air), with a term for depth ([`uw_geom::water::index`]).
    /// [`Rig::water_index_at`] serves any wavelength.
    pub fn index(&self, wavelength_nm: f64) -> f64 {
        match *self {
            Self::Index(index) => index,
            Self::Properties { temperature_c, salinity_psu, depth_m } => {
                uw_geom::water::index(temperature_c, salinity_psu, wavelength_nm, depth_m)
            }
        }
    }
}

impl Port {
    fn to_geom(&self) -> Result<uw_geom::Port, GeomError> {
        let glass = Medium::of_index(self.index);
        uw_geom::Port::new(self.normal.into(), self.distance_mm, self.thickness_mm, glass)
    }
}

/// Standard deviations of a rig's drawing values, one key each in `[priors]`; all positive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Priors {
    /// Of the camera's port's distance.
    pub camera_port_distance_mm: f64,
    /// Of the laser's port's distance.
    pub laser_port_distance_mm: f64,
    /// Of either window's thickness.
    pub thickness_mm: f64,
    /// Of either window's normal, along each of the two directions across it.
    pub normal_deg: f64,
    /// Of the glass's index.
    pub glass_index: f64,
    /// Of the water's index.
    pub water_index: f64,
    /// Of the apex's distance.
    pub apex_mm: f64,
    /// Of the degrees per volt, as a fraction of them: 0.005 is half a per cent.
    pub degrees_per_volt_rel: f64,
    /// Of the galvanometer's quadratic term, degrees per square volt.
    pub galvo_c2: f64,
    /// Of the galvanometer's cubic term, degrees per cubic volt.
    pub galvo_c3: f64,
    /// Of the mirror's surface beside its axis.
    pub mirror_offset_mm: f64,
    /// Of the fan's plane against the axis.
    pub fan_tilt_deg: f64,
    /// By how much the fan's plane misses the mirror's axis.
    pub fan_offset_mm: f64,
    /// Of where along the axis the fan's apex lies, from the axis's point closest to the optical centre.
    pub apex_along_axis_mm: f64,
}

impl Default for Priors {
    fn default() -> Self {
        Self {
            camera_port_distance_mm: 0.5,
            laser_port_distance_mm: 0.5,
            thickness_mm: 0.05,
            normal_deg: 0.5,
            glass_index: 0.0005,
            water_index: 0.0005,
            apex_mm: 3.0,
            degrees_per_volt_rel: 0.005,
            galvo_c2: 3e-4,
            galvo_c3: 3e-4,
            mirror_offset_mm: 0.3,
            fan_tilt_deg: 0.3,
            fan_offset_mm: 0.5,
            apex_along_axis_mm: 30.0,
        }
    }
}

impl Priors {
    /// Each sigma with its key.
    fn named(&self) -> [(&'static str, f64); 14] {
        [
            ("camera_port_distance_mm", self.camera_port_distance_mm),
            ("laser_port_distance_mm", self.laser_port_distance_mm),
            ("thickness_mm", self.thickness_mm),
            ("normal_deg", self.normal_deg),
            ("glass_index", self.glass_index),
            ("water_index", self.water_index),
            ("apex_mm", self.apex_mm),
            ("degrees_per_volt_rel", self.degrees_per_volt_rel),
            ("galvo_c2", self.galvo_c2),
            ("galvo_c3", self.galvo_c3),
            ("mirror_offset_mm", self.mirror_offset_mm),
            ("fan_tilt_deg", self.fan_tilt_deg),
            ("fan_offset_mm", self.fan_offset_mm),
            ("apex_along_axis_mm", self.apex_along_axis_mm),
        ]
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
        let file = TomlFile::read(path, FORMAT, VERSION)?;
        let mut rig: Self = file.parse()?;
        let warnings = rig.check(&file, "")?;
        Ok((rig, warnings))
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

/// The largest side of an image: larger than any sensor's, and small enough to multiply.
const LARGEST_SIDE: u32 = 1 << 16;
/// Rounding of a vector's length, without unit.
const ROUNDING: f64 = 8.0 * f64::EPSILON;
/// A normal this far from unit length was rounded in the file; farther, it was not meant as one.
const ROUNDED_NORMAL: f64 = 1e-3;

struct Check<'a> {
    file: &'a TomlFile,
    prefix: &'a str,
    warnings: Vec<Problem>,
}

impl Check<'_> {
    fn error(&self, key: &str, what: impl Into<String>, mend: impl Into<String>) -> Error {
        self.file.error(&format!("{}{key}", self.prefix), what, mend)
    }

    fn warn(&mut self, key: &str, what: impl Into<String>, mend: impl Into<String>) {
        self.warnings.push(self.file.warning(&format!("{}{key}", self.prefix), what, mend));
    }

    fn rig(&mut self, rig: &mut Rig) -> Result<(), Error> {
        let c = &mut rig.camera;
        for (key, side) in [("camera.width", c.width), ("camera.height", c.height)] {
            if !(1..=LARGEST_SIDE).contains(&side) {
                let what = format!("{side} pixels are no image's size");
                return Err(self.error(key, what, "give the size of the images in pixels"));
            }
        }
        if !(1..=16).contains(&c.bits) {
            let what = format!("{} significant bits can't be read", c.bits);
            return Err(self.error("camera.bits", what, "give 8 for 8-bit images, 9 to 16 for 16-bit ones"));
        }
        for pitch in c.pixel_um {
            self.positive("camera.pixel_um", pitch, "µm", [0.2, 100.0])?;
        }
        self.positive("camera.focal_mm", c.focal_mm, "mm", [0.5, 2000.0])?;
        self.port("camera.port", &mut c.port)?;
        if c.port.normal[2] <= 0.0 {
            let what = "the normal points back into the camera";
            return Err(self.error(
                "camera.port.normal",
                what,
                "turn its sign: it points outwards, z forward",
            ));
        }

        self.positive("laser.wavelength_nm", rig.laser.wavelength_nm, "nm", [200.0, 2000.0])?;
        if let Some(apex) = rig.laser.apex_mm {
            self.positive("laser.apex_mm", apex, "mm", [0.5, 5000.0])?;
        }
        self.port("laser.port", &mut rig.laser.port)?;
        if rig.laser.port.normal[2] <= 0.0 {
            let what = "the normal points away from what the camera sees";
            self.warn("laser.port.normal", what, "it is in the camera frame, outwards");
        }
        self.galvo(&rig.galvo)?;
        if let Some(water) = &rig.water {
            self.water(water)?;
        }
        for (key, sigma) in rig.priors.named() {
            if !(sigma > 0.0 && sigma.is_finite()) {
                let what = format!("a standard deviation is a positive number, not {sigma}");
                let mend =
                    "to hold the value fixed, give a sigma far below what can be measured, such as 1e-6";
                return Err(self.error(&format!("priors.{key}"), what, mend));
            }
        }
        Ok(())
    }

    fn port(&mut self, key: &str, port: &mut Port) -> Result<(), Error> {
        self.positive(&format!("{key}.distance_mm"), port.distance_mm, "mm", [0.01, 2000.0])?;
        self.positive(&format!("{key}.thickness_mm"), port.thickness_mm, "mm", [0.01, 500.0])?;
        self.index(&format!("{key}.index"), port.index, [1.3, 2.0])?;
        let at = format!("{key}.normal");
        // The largest component first, so that no length overflows or vanishes.
        let largest = port.normal.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        if !(port.normal.iter().all(|x| x.is_finite()) && largest > 0.0) {
            let what = format!("{:?} is no direction", port.normal);
            return Err(self.error(&at, what, "give the normal's three components, such as [0.0, 0.0, 1.0]"));
        }
        let length = largest * port.normal.iter().map(|x| (x / largest).powi(2)).sum::<f64>().sqrt();
        if (length - 1.0).abs() > ROUNDED_NORMAL {
            let what = format!("the normal's length is {length:.6}, not 1");
            self.warn(&at, what, "it is taken as a direction; check its components");
        }
        // What is 1 but for rounding stays as it is, so that a normal that was read and written is the same again.
        if (length - 1.0).abs() > ROUNDING {
            port.normal = port.normal.map(|x| x / length);
        }
        Ok(())
    }

    fn galvo(&mut self, galvo: &Galvo) -> Result<(), Error> {
        let [low, high] = galvo.range_v;
        if galvo.degrees_per_volt < 0.0 {
            let what = format!("{} is negative", galvo.degrees_per_volt);
            let mend = "give the amount; the axis's sense is found by the calibration";
            return Err(self.error("galvo.degrees_per_volt", what, mend));
        }
        self.positive("galvo.degrees_per_volt", galvo.degrees_per_volt, "°/V", [1e-3, 1e3])?;
        if !(low.is_finite() && high.is_finite()) {
            let what = format!("[{low}, {high}] must be two finite voltages");
            return Err(self.error("galvo.range_v", what, "give the drive's lowest and highest voltage"));
        }
        if low >= high {
            let what = format!("[{low}, {high}] is no range");
            return Err(self.error(
                "galvo.range_v",
                what,
                "give the lower voltage first, then the higher one",
            ));
        }
        if !galvo.reference_v.is_finite() {
            let what = format!("{} is no voltage", galvo.reference_v);
            return Err(self.error("galvo.reference_v", what, "give a finite number"));
        }
        if !(low..=high).contains(&galvo.reference_v) {
            let what = format!("{} V is outside range_v [{low}, {high}]", galvo.reference_v);
            self.warn("galvo.reference_v", what, "check both");
        }
        if galvo.degrees_per_volt * (high - low) > 180.0 {
            let what = format!(
                "the mirror would turn {} degrees over range_v",
                galvo.degrees_per_volt * (high - low)
            );
            self.warn("galvo.degrees_per_volt", what, "check both");
        }
        Ok(())
    }

    fn water(&mut self, water: &Water) -> Result<(), Error> {
        let (temperature, salinity, depth) = match *water {
            Water::Index(index) => return self.index("water.index", index, [1.30, 1.38]),
            Water::Properties { temperature_c, salinity_psu, depth_m } => {
                (temperature_c, salinity_psu, depth_m)
            }
        };
        // Liquid water in the sea, in a tank, in the deepest trench; NaN is in no range.
        for (key, value, range) in [
            ("water.temperature_c", temperature, -5.0..=100.0),
            ("water.salinity_psu", salinity, 0.0..=350.0),
            ("water.depth_m", depth, 0.0..=12_000.0),
        ] {
            if !range.contains(&value) {
                let what = format!("{value} is no water that an instrument meets");
                let mend = format!("give a number from {} to {}", range.start(), range.end());
                return Err(self.error(key, what, mend));
            }
        }
        Ok(())
    }

    /// Refuses what is not a positive finite number; warns outside what is `likely`.
    fn positive(&mut self, key: &str, value: f64, unit: &str, likely: [f64; 2]) -> Result<(), Error> {
        if !(value > 0.0 && value.is_finite()) {
            return Err(self.error(
                key,
                format!("{value} must be positive and finite"),
                format!("give it in {unit}"),
            ));
        }
        if !(likely[0]..=likely[1]).contains(&value) {
            let what = format!("{value} {unit} is an unusual value");
            self.warn(key, what, "check the unit");
        }
        Ok(())
    }

    /// Refuses what is no index relative to air; warns outside what is `likely`.
    fn index(&mut self, key: &str, value: f64, likely: [f64; 2]) -> Result<(), Error> {
        if !(1.0..=4.0).contains(&value) {
            let what = format!("{value} is no index of refraction relative to air");
            return Err(self.error(key, what, "give a number such as 1.5195 for glass, 1.3351 for water"));
        }
        if !(likely[0]..=likely[1]).contains(&value) {
            let what = format!("{value} is an unusual index");
            self.warn(key, what, "check it");
        }
        Ok(())
    }
}
