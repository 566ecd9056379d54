//! What a rig file can't say, and what it hardly means.

use super::{Galvo, Port, Rig, Water};
use crate::{
    error::{Error, Problem},
    toml_file::TomlFile,
};

/// The largest side of an image: larger than any sensor's, and small enough to multiply.
const LARGEST_SIDE: u32 = 1 << 16;
/// Rounding of a vector's length, without unit.
const ROUNDING: f64 = 8.0 * f64::EPSILON;
/// A normal this far from unit length was rounded in the file; farther, it was not meant as one.
const ROUNDED_NORMAL: f64 = 1e-3;

pub(super) struct Check<'a> {
    pub file: &'a TomlFile,
    pub prefix: &'a str,
    pub warnings: Vec<Problem>,
}

impl Check<'_> {
    fn error(&self, key: &str, what: impl Into<String>, mend: impl Into<String>) -> Error {
        self.file.error(&format!("{}{key}", self.prefix), what, mend)
    }

    fn warn(&mut self, key: &str, what: impl Into<String>, mend: impl Into<String>) {
        self.warnings.push(self.file.warning(&format!("{}{key}", self.prefix), what, mend));
    }

    pub fn rig(&mut self, rig: &mut Rig) -> Result<(), Error> {
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
        self.index(&format!("{key}.index"), port.index, 4.0, [1.3, 2.0])?;
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
            self.warn("galvo.reference_v", what, "check reference_v and range_v");
        }
        if galvo.degrees_per_volt * (high - low) > 180.0 {
            let what = format!(
                "the mirror would turn {} degrees over range_v",
                galvo.degrees_per_volt * (high - low)
            );
            self.warn("galvo.degrees_per_volt", what, "check degrees_per_volt and range_v");
        }
        Ok(())
    }

    fn water(&mut self, water: &Water) -> Result<(), Error> {
        let (temperature, salinity, depth) = match *water {
            Water::Index(index) => return self.index("water.index", index, 2.0, [1.30, 1.38]),
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

    /// Refuses what is no index relative to air, up to the largest of its kind; warns outside what is `likely`.
    fn index(&mut self, key: &str, value: f64, largest: f64, likely: [f64; 2]) -> Result<(), Error> {
        const MEND: &str = "give a number such as 1.5195 for glass, 1.3351 for water";
        if !(1.0..=largest).contains(&value) {
            let what = format!("{value} is no index of refraction relative to air (1 to {largest})");
            return Err(self.error(key, what, MEND));
        }
        if !(likely[0]..=likely[1]).contains(&value) {
            self.warn(key, format!("{value} is an unusual index"), MEND);
        }
        Ok(())
    }
}
