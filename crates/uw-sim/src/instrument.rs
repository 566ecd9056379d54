//! The instrument that takes the pictures: geometry from `uw-geom`, and what its light, lens and sensor do besides.

use crate::error::{SimError, within};
use nalgebra::{Vector2, Vector3};
use uw_geom::{Medium, Scanner, Sheet, rotation_about_x};

/// A laser scanner down to its electrons. Millimetres, radians, pixels; what `uw-geom` says of light's ways holds here unchanged.
#[derive(Clone, Debug, PartialEq)]
pub struct Instrument {
    /// Where light goes: camera, windows, galvanometer, fan. The TRUE figures, not those that a calibration would find.
    pub scanner: Scanner,
    /// Width and height of an image, px.
    pub size: [u32; 2],
    /// The fan's light.
    pub beam: Beam,
    /// What the lens does to an image point.
    pub lens: Lens,
    /// What the sensor makes of light.
    pub sensor: Sensor,
}

/// The laser's light within its fan. Across the fan it is a Gaussian beam, w(z) = w₀ √(1 + ((z − z₀)/z_R)²), z_R = π w₀²/λ
/// (B. Saleh, M. Teich, Fundamentals of Photonics, 3rd ed., 2019, Eq 3.1-8), z counted from the apex along the ray; along
/// the fan it is even, as a Powell lens makes it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// Half of the fan's opening in air, radians.
    pub half_angle_rad: f64,
    /// From the direction of the galvanometer's z axis (at the reference voltage) to the fan's middle, in its plane, radians.
    pub middle_rad: f64,
    /// w₀: radius at which the irradiance falls to 1/e² of the middle's, at the waist, mm.
    pub waist_radius_mm: f64,
    /// z₀: path from the apex to the waist, mm.
    pub waist_at_mm: f64,
    /// Wavelength in air, nm.
    pub wavelength_nm: f64,
    /// Brightness of a white surface in clear water at [`REFERENCE_MM`], facing the light, in the stripe's middle and before any
    /// blur, as a fraction of full scale.
    pub level: f64,
}

/// The path from the apex that [`Beam::level`] refers to, mm.
pub const REFERENCE_MM: f64 = 1000.0;

/// What the lens, and the water's particles near the line of sight, do to an image point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Standard deviation of the point-spread, px.
    pub blur_px: f64,
    /// Share of the light that forward scatter spreads wider than that, 0 to 1.
    pub halo: f64,
    /// Standard deviation of that part, px.
    pub halo_px: f64,
    /// Loss of brightness in the image's corner against its middle, 0 to 1; grows with the square of the distance.
    pub vignetting: f64,
}

/// What the sensor makes of light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Bits of a grey value: full scale is 2^bits − 1.
    pub bits: u8,
    /// Electrons a grey value: shot noise. 0: no shot noise.
    pub electrons_per_dn: f64,
    /// Standard deviation of the read noise, grey values.
    pub read_noise_dn: f64,
    /// Grey value of darkness.
    pub offset_dn: f64,
    /// Contrast of the laser's speckle (standard deviation over mean), 0 to 1; 0: none.
    pub speckle: f64,
    /// Standard deviation of the speckle grain's amplitude point-spread, px.
    pub speckle_px: f64,
}

impl Sensor {
    /// The largest grey value.
    pub fn full_scale(&self) -> f64 {
        f64::from((1_u32 << self.bits) - 1)
    }
}

impl Instrument {
    /// Checks every figure.
    ///
    /// # Errors
    /// [`SimError::Invalid`] names the first that no instrument has.
    pub fn check(&self) -> Result<(), SimError> {
        let Self { size, beam, lens, sensor, .. } = self;
        let fraction = |what, value| within(what, "from 0 to 1", 0.0..=1.0, value).map(drop);
        let least_0 = |what, value| within(what, "0 or more", 0.0..=f64::MAX, value).map(drop);
        let positive = |what, value| within(what, "positive", f64::MIN_POSITIVE..=f64::MAX, value).map(drop);
        for side in size {
            within("an image's side", "from 8 to 16384 px", 8.0..=16384.0, f64::from(*side))?;
        }
        within("the fan's half angle", "below 80°", 1e-3..=1.4, beam.half_angle_rad)?;
        within("the fan's middle", "below 60°", -1.05..=1.05, beam.middle_rad)?;
        positive("the beam's waist radius", beam.waist_radius_mm)?;
        least_0("the way to the beam's waist", beam.waist_at_mm)?;
        positive("the laser's wavelength", beam.wavelength_nm)?;
        least_0("the laser's level", beam.level)?;
        within("the lens's blur", "from 0 to 20 px", 0.0..=20.0, lens.blur_px)?;
        fraction("the halo's share", lens.halo)?;
        within("the halo's width", "from 0 to 200 px", 0.0..=200.0, lens.halo_px)?;
        fraction("vignetting", lens.vignetting)?;
        within("a sensor's bits", "from 8 to 16", 8.0..=16.0, f64::from(sensor.bits))?;
        least_0("electrons a grey value", sensor.electrons_per_dn)?;
        least_0("read noise", sensor.read_noise_dn)?;
        within("the dark level", "within the sensor's range", 0.0..=sensor.full_scale(), sensor.offset_dn)?;
        fraction("the speckle's contrast", sensor.speckle)?;
        within("the speckle's grain", "from 0 to 10 px", 0.0..=10.0, sensor.speckle_px)?;
        Ok(())
    }

    /// The light at `voltage`.
    pub(crate) fn light(&self, voltage: f64, outside: Medium) -> Light {
        let Scanner { galvo, fan, .. } = &self.scanner;
        let turn = rotation_about_x(2.0 * galvo.mirror_angle(voltage));
        let (ts, tc) = fan.tilt_rad.sin_cos();
        let normal = Vector3::new(ts, tc, 0.0);
        let (ms, mc) = self.beam.middle_rad.sin_cos();
        let middle = Vector3::z() * mc + normal.cross(&Vector3::z()) * ms;
        Light {
            sheet: self.scanner.sheet(voltage, outside),
            middle: galvo.axes * (turn * middle),
            cos_half_angle: self.beam.half_angle_rad.cos(),
            beam: self.beam,
        }
    }

    /// Share of the light that vignetting leaves at a pixel.
    pub(crate) fn vignette(&self, pixel: &Vector2<f64>) -> f64 {
        let [w, h] = self.size.map(f64::from);
        let c = &self.scanner.camera;
        let corner = [0.0, w].map(|u| [0.0, h].map(|v| (u - c.cx).hypot(v - c.cy)));
        let farthest = corner.as_flattened().iter().fold(1.0_f64, |a, b| a.max(*b));
        let r = (pixel.x - c.cx).hypot(pixel.y - c.cy) / farthest;
        (1.0 - self.lens.vignetting * r * r).max(0.0)
    }
}

/// The laser's light at one voltage, camera frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Light {
    pub(crate) sheet: Sheet,
    /// Unit direction of the fan's middle in air.
    pub(crate) middle: Vector3<f64>,
    cos_half_angle: f64,
    beam: Beam,
}

impl Light {
    /// Whether light that left the apex in this air direction lies within the fan's opening.
    pub(crate) fn within_fan(&self, air: &Vector3<f64>) -> bool {
        let n = &self.sheet.normal;
        let flat = air - n * n.dot(air);
        self.middle.dot(&flat) >= self.cos_half_angle * flat.norm()
    }

    /// Standard deviation of the irradiance across the sheet at the end of a path from the apex, mm.
    pub(crate) fn sigma_mm(&self, path_mm: f64) -> f64 {
        let b = &self.beam;
        let rayleigh = std::f64::consts::PI * b.waist_radius_mm.powi(2) / (b.wavelength_nm * 1e-6);
        let w = b.waist_radius_mm * ((path_mm - b.waist_at_mm) / rayleigh).hypot(1.0);
        0.5 * w
    }

    /// Irradiance in the sheet's middle at the end of a path, square to the light, as a fraction of full scale; `lever_mm` is by
    /// how many millimetres a point moves for a radian at the apex. As the reference has no window its lever is its path.
    pub(crate) fn irradiance(&self, path_mm: f64, lever_mm: f64) -> f64 {
        self.beam.level * (REFERENCE_MM / lever_mm) * (self.sigma_mm(REFERENCE_MM) / self.sigma_mm(path_mm))
    }
}
