//! What a calibration's errors do to a measurement: all points share them, so that they don't average out.
//!
//! A point is a function of its pixel, its image's voltage and the calibrated parameters. The pixel is in the cloud. The voltage is
//! the one whose sheet passes through the points of that image, and the index outside the one at which the pixels' rays pass through
//! their points: both are read off the cloud, and the cloud is refused where there are none. Dual numbers give the points'
//! derivatives by the parameters, a fit's [`Influence`] carries them over to the shape.

use crate::Error;
use nalgebra::{DMatrix, Isometry3, Matrix3xX, Point3, Vector2, Vector3};
use std::collections::HashMap;
use uw_calib::{Calibration, Coordinate, GLOBALS, Instrument};
use uw_cloud::{Frame, Influence, PointCloud};
use uw_geom::{Dual, Medium, Real, Scanner, Sheet};

/// How far a point may lie from its pixel's ray or from its image's sheet: pixels are stored in 32 bits (3e-5 px, as much in mm on a
/// metre), and other models of refraction are off by tenths of a millimetre and more.
const MOST_MISS_MM: f64 = 0.01;

/// Lowest and highest index of refraction that is looked for, apart from air's.
const INDICES: [f64; 2] = [1.2, 1.5];

/// Difference of indices that is none: so well is one read off the points.
const SAME_INDEX: f64 = 1e-5;

/// Points that the index is read from.
const ASKED: usize = 101;

/// Halvings (by the golden section) of the indices' range, and steps of the voltage.
const SECTIONS: usize = 60;
const VOLTAGE_STEPS: usize = 60;

/// The calibrated instrument in numbers with derivatives by its parameters.
type Varied = Instrument<Dual<GLOBALS>>;

/// The errors that the points of a cloud share because one calibration made them.
pub struct SharedErrors<'a> {
    cloud: &'a PointCloud,
    calibration: &'a Calibration,
    scanner: &'a Scanner,
    varied: Varied,
    medium: Medium,
    varied_medium: Medium<Dual<GLOBALS>>,
    camera_from_cloud: Isometry3<f64>,
    /// Derivatives of the parameters by independent causes of sigma 1: a root of their covariance.
    root: DMatrix<f64>,
    sheets: HashMap<u32, Option<(f64, Sheet<Dual<GLOBALS>>)>>,
}

impl<'a> SharedErrors<'a> {
    /// Returns the errors that a calibration brought into a cloud, which must have been reconstructed with it, exactly.
    ///
    /// # Errors
    /// [`Error::NoCovariance`] for a calibration that tells none, [`Error::NoPixels`] for a cloud without pixels and frames, and
    /// [`Error::OtherCalibration`] where the points do not lie on the rays of their pixels.
    pub fn new(cloud: &'a PointCloud, calibration: &'a Calibration) -> Result<Self, Error> {
        let covariance = calibration.covariance.as_ref().ok_or(Error::NoCovariance)?;
        if cloud.pixels().is_none() || cloud.frame_rows().is_none() {
            return Err(Error::NoPixels);
        }
        let scanner = calibration.scanner();
        let camera_from_cloud = match cloud.frame() {
            Frame::Camera => Isometry3::identity(),
            Frame::Galvo => scanner.camera_from_galvo().isometry(),
        };
        let varied = calibration.instrument.variables::<GLOBALS, GLOBALS>();
        let mut shared = Self {
            cloud,
            calibration,
            scanner,
            varied,
            medium: Medium::air(),
            varied_medium: Medium::of_index(Dual::constant(1.0)),
            camera_from_cloud,
            root: root(covariance),
            sheets: HashMap::new(),
        };
        shared.medium = shared.outside()?;
        if shared.medium.index > 1.0 {
            let nominal = shared.medium.index - calibration.instrument.water_offset;
            shared.varied_medium = Medium::of_index(Dual::constant(nominal) + shared.varied.water_offset);
        }
        Ok(shared)
    }

    /// Returns the same with a water's index that was not the calibration's, but told by whoever scanned, who knows it to `sigma`: its error is then
    /// independent of the calibration's, which are as uncertain as before.
    pub fn with_index_known_to(mut self, sigma: f64) -> Self {
        let index = Coordinate::WaterIndex as usize;
        if let Some(mut covariance) = self.calibration.covariance.clone() {
            covariance.row_mut(index).fill(0.0);
            covariance.column_mut(index).fill(0.0);
            covariance[(index, index)] = sigma * sigma;
            self.root = root(&covariance);
        }
        self
    }

    /// Returns the index of the water that the calibration knows, where the light was traced with another one: the scan's own water was, or was said to be, another.
    /// `None` where it is that one, in air, and after a calibration that knows no water.
    pub fn other_index(&self) -> Option<f64> {
        let known = self.calibration.water(self.calibration.nominal_water_index?).index;
        (self.medium.index > 1.0 && (self.medium.index - known).abs() > SAME_INDEX).then_some(known)
    }

    /// Returns the index that the light was traced with.
    pub fn index(&self) -> f64 {
        self.medium.index
    }

    /// Returns the derivatives of a fit's parameters (rows) by independent causes of sigma 1 (columns): its covariance from the
    /// calibration is this times its transpose, and of two shapes what one cause does to both is known.
    ///
    /// # Errors
    /// [`Error::OtherCalibration`] where a point is not on a sheet of light.
    pub fn of(&mut self, influence: &Influence) -> Result<DMatrix<f64>, Error> {
        let mut worst = 0.0_f64;
        let sensitivity = influence.sensitivity(GLOBALS, |index| {
            let (moves, miss_mm) = self.moves(index)?;
            worst = worst.max(miss_mm);
            Some(moves)
        });
        match sensitivity {
            Some(sensitivity) if worst <= MOST_MISS_MM => Ok(sensitivity * &self.root),
            Some(_) => Err(Error::OtherCalibration { miss_mm: worst }),
            None => Err(Error::OtherCalibration { miss_mm: f64::INFINITY }),
        }
    }

    /// Returns a fit's covariance from points and calibration.
    ///
    /// # Errors
    /// As [`SharedErrors::of`].
    pub fn total(&mut self, covariance: &DMatrix<f64>, influence: &Influence) -> Result<DMatrix<f64>, Error> {
        let causes = self.of(influence)?;
        Ok(covariance + &causes * causes.transpose())
    }

    /// Returns a point of the cloud in the camera frame, with its pixel and the row of its image.
    fn seen(&self, index: usize) -> Option<(Vector3<f64>, Vector2<f64>, u32)> {
        let position = self.camera_from_cloud * Point3::from(*self.cloud.positions_mm().get(index)?);
        let [u, v] = *self.cloud.pixels()?.get(index)?;
        Some((
            position.coords,
            Vector2::new(f64::from(u), f64::from(v)),
            *self.cloud.frame_rows()?.get(index)?,
        ))
    }

    /// Returns what is outside the windows: the index at which the pixels' rays pass nearest to their points.
    fn outside(&self) -> Result<Medium, Error> {
        let step = self.cloud.len().div_ceil(ASKED).max(1);
        let asked: Vec<_> = (0..self.cloud.len()).step_by(step).filter_map(|i| self.seen(i)).collect();
        let miss = |index: f64| {
            let off = |(point, pixel, _): &(Vector3<f64>, Vector2<f64>, u32)| {
                let ray = self.scanner.pixel_ray(pixel, Medium::of_index(index)).ok()?;
                Some((point - ray.origin).cross(&ray.direction).norm() / ray.direction.norm())
            };
            let mut all: Vec<f64> = asked.iter().map(|seen| off(seen).unwrap_or(f64::INFINITY)).collect();
            all.sort_by(f64::total_cmp);
            all.get(all.len() / 2).copied().unwrap_or(f64::INFINITY)
        };
        if miss(1.0) <= MOST_MISS_MM {
            return Ok(Medium::air());
        }
        let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
        let [mut low, mut high] = INDICES;
        for _ in 0..SECTIONS {
            let (a, b) = (high - golden * (high - low), low + golden * (high - low));
            if miss(a) < miss(b) { high = b } else { low = a }
        }
        let index = 0.5 * (low + high);
        let miss_mm = miss(index);
        if miss_mm <= MOST_MISS_MM {
            Ok(Medium::of_index(index))
        } else {
            Err(Error::OtherCalibration { miss_mm })
        }
    }

    /// Returns the derivatives of a point by the parameters, in the cloud's frame, mm, and how far it lies from where its pixel and its image's
    /// sheet put it.
    fn moves(&mut self, index: usize) -> Option<(Matrix3xX<f64>, f64)> {
        let (point, pixel, row) = self.seen(index)?;
        if !self.sheets.contains_key(&row) {
            let sheet = self.voltage(&point).map(|voltage| {
                (voltage, self.varied.scanner.sheet(Dual::constant(voltage), self.varied_medium))
            });
            self.sheets.insert(row, sheet);
        }
        let (_, sheet) = self.sheets.get(&row)?.as_ref()?;
        let ray = self.varied.scanner.pixel_ray(&pixel.map(Dual::constant), self.varied_medium).ok()?;
        let met = sheet.intersect(&ray).ok()?;
        let miss_mm = (met.map(Real::value) - point).norm();
        let met = match self.cloud.frame() {
            Frame::Camera => met,
            // The frame moves with the calibration as well.
            Frame::Galvo => {
                let galvo = &self.varied.scanner.galvo;
                galvo.axes.transpose() * (met - galvo.origin_mm)
            }
        };
        Some((Matrix3xX::from_fn(GLOBALS, |i, j| met[i].eps[j]), miss_mm))
    }

    /// Returns the voltage whose sheet passes through a point, by the secant's steps.
    fn voltage(&self, point: &Vector3<f64>) -> Option<f64> {
        let off = |voltage: f64| self.scanner.sheet(voltage, self.medium).off_sheet(point).ok();
        let mut before = self.scanner.galvo.reference_v;
        let mut at = before + 0.1;
        let (mut off_before, mut off_at) = (off(before)?, off(at)?);
        for _ in 0..VOLTAGE_STEPS {
            let slope = (off_at - off_before) / (at - before);
            let step = -off_at / slope;
            if !step.is_finite() {
                break;
            }
            (before, off_before) = (at, off_at);
            at += step;
            off_at = off(at)?;
            if step.abs() <= 1e-13 * at.abs().max(1.0) {
                break;
            }
        }
        at.is_finite().then_some(at)
    }
}

/// Returns a root R of a covariance, R Rᵀ, by the eigenvalues of the correlations: parameters have unlike units.
fn root(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let sigmas = covariance.diagonal().map(|v| v.max(0.0).sqrt());
    let unit = |s: f64| if s > 0.0 { 1.0 / s } else { 0.0 };
    let correlation = DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |i, j| {
        covariance[(i, j)] * unit(sigmas[i]) * unit(sigmas[j])
    });
    let eigen = correlation.symmetric_eigen();
    let spread = DMatrix::from_diagonal(&eigen.eigenvalues.map(|e| e.max(0.0).sqrt()));
    DMatrix::from_diagonal(&sigmas) * eigen.eigenvectors * spread
}
