//! A calibration: the instrument, how well it is known, and what it was computed from.

use crate::data::{Across, Outside};
use crate::parameters::{GLOBALS, Instrument, Quantity, quantities, variance};
use nalgebra::{DMatrix, Vector2};
use uw_geom::{Dual, GeomError, Medium, Real, Scanner};

/// How a calibration was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// One joint adjustment of everything, exact refraction.
    Joint,
    /// As the paper does: intrinsics, planes, axis one after the other, on land, windows neglected until reconstruction.
    Paper,
}

/// The instrument, calibrated.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// How it was made.
    pub method: Method,
    /// The instrument as estimated.
    pub instrument: Instrument,
    /// Covariance of the local coordinates ([`crate::NAMES`]) at that instrument; without the paper's method.
    pub covariance: Option<DMatrix<f64>>,
    /// Nominal index at the laser's wavelength of the captures in water that took part.
    pub nominal_water_index: Option<f64>,
    /// Along which coordinate stripes were measured.
    pub across: Across,
    /// Image size, columns and rows, px.
    pub image_size: [u32; 2],
    /// What remained, and how many took part.
    pub statistics: Statistics,
    /// What to know before trusting it.
    pub warnings: Vec<String>,
}

/// What a calibration was computed from, and what remained.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Root mean square of corner residuals (distance in the image), px.
    pub reprojection_rms_px: f64,
    /// Root mean square of stripe residuals along the measured coordinate, px.
    pub stripe_rms_px: f64,
    /// Root mean square distance of stripe points on the board from their sheet, mm.
    pub stripe_rms_mm: f64,
    /// Corners that took part.
    pub corners: usize,
    /// Stripe measurements that took part.
    pub stripe_points: usize,
    /// Corners rejected as outliers.
    pub corners_rejected: usize,
    /// Stripe measurements left out: near an edge between squares, or outliers.
    pub stripe_points_rejected: usize,
    /// Placements of the board that took part.
    pub poses_used: usize,
    /// Images that took part, of the board and of stripes.
    pub frames_used: usize,
    /// Images left out, with the reason.
    pub rejected: Vec<Rejected>,
    /// The images with the largest residuals, worst first.
    pub worst: Vec<WorstImage>,
    /// The two most correlated pairs of parameters.
    pub correlated: Vec<CorrelatedPair>,
    /// By how much the corners scatter more than their predicted sigmas.
    pub corner_scale: f64,
    /// By how much the stripes scatter more than their predicted sigmas.
    pub stripe_scale: f64,
    /// Iterations of the last solve.
    pub iterations: usize,
}

/// An image that was left out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rejected {
    /// Which.
    pub file: String,
    /// Why.
    pub reason: String,
}

/// An image by its residuals.
#[derive(Clone, Debug, PartialEq)]
pub struct WorstImage {
    /// Which.
    pub file: String,
    /// Root mean square of its residuals, px.
    pub rms_px: f64,
    /// Largest residual, px.
    pub max_px: f64,
}

/// Two parameters that the data hardly tell apart.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrelatedPair {
    /// One.
    pub a: &'static str,
    /// The other.
    pub b: &'static str,
    /// Their correlation, −1 to 1.
    pub correlation: f64,
}

impl Calibration {
    /// The scanner as estimated.
    pub fn scanner(&self) -> &Scanner {
        &self.instrument.scanner
    }

    /// What is outside during a scan in water whose nominal index at the laser's wavelength is `nominal`: the calibration's
    /// estimate plus the difference of nominal indices (FORMATS §2). After a calibration on land, `nominal` itself.
    pub fn water(&self, nominal: f64) -> Medium {
        let offset = if self.nominal_water_index.is_some() { self.instrument.water_offset } else { 0.0 };
        Medium::of_index(nominal + offset)
    }

    /// Every figure of the instrument with its standard deviation (zero where there is no covariance).
    pub fn quantities(&self) -> Vec<Quantity> {
        let none = || DMatrix::zeros(GLOBALS, GLOBALS);
        quantities(&self.instrument, &self.covariance.clone().unwrap_or_else(none))
    }

    /// Standard deviation from calibration of the distance between the points of two pixels at two voltages, mm; `None`
    /// without a covariance.
    ///
    /// # Errors
    /// [`GeomError`] where a pixel's ray does not meet the sheet.
    pub fn length_sigma(
        &self,
        ends: [(Vector2<f64>, f64); 2],
        nominal: Outside,
    ) -> Result<Option<f64>, GeomError> {
        let Some(covariance) = &self.covariance else { return Ok(None) };
        let dual = self.instrument.variables::<GLOBALS, GLOBALS>();
        let medium = dual.laser_medium(nominal);
        let at = |(pixel, voltage): (Vector2<f64>, f64)| {
            dual.scanner.triangulate(&pixel.map(Dual::constant), Dual::constant(voltage), medium)
        };
        let length = uw_geom::norm(&(at(ends[0])? - at(ends[1])?));
        Ok(Some(variance(&length.eps, covariance).max(0.0).sqrt()))
    }
}
