//! What a calibration tells of itself: the record that its JSON file is, and the page that shows it.

mod page;

use crate::Error;
use crate::pipeline::calibrate::Calibrated;
use crate::pipeline::report::record::{FigureRecord, HeadRecord, SourceRecord};
use crate::pipeline::report::{figures, json, write_all};
use nalgebra::DMatrix;
use serde::Serialize;
use std::path::{Path, PathBuf};
use uw_calib::{GLOBALS, NAMES, Outside, ViewResiduals};
use uw_io::calibration_toml::{CorrelatedRecord, RejectedRecord, WorstRecord};
use uw_io::{Overwrite, Problem, Severity};

pub use page::calibration_page;

/// The `format` of the JSON file.
pub const FORMAT: &str = "uwscan-calibration-report";
/// Its version: keys may be added, never renamed.
pub const VERSION: u32 = 1;
/// Pairs of parameters are listed from this correlation.
const CORRELATED: f64 = 0.95;
const MOST_PAIRS: usize = 12;

/// What the page of a calibration tells, as its JSON file has it.
#[derive(Debug, Clone, Serialize)]
pub struct CalibrationReport {
    /// `"uwscan-calibration-report"` and its version, and what made it.
    #[serde(flatten)]
    pub head: HeadRecord,
    /// `joint` or `paper`.
    pub method: &'static str,
    /// What to know before trusting it, and what to capture next.
    pub warnings: Vec<String>,
    /// Inputs that were missing.
    pub lost: Vec<String>,
    /// What it was made from.
    pub captures: Vec<SourceRecord>,
    /// Of corners, px.
    pub reprojection_rms_px: f64,
    /// Of stripes, px.
    pub stripe_rms_px: f64,
    /// Of stripes on the board, mm.
    pub stripe_rms_mm: f64,
    /// Corners that took part, and that did not.
    pub corners: [usize; 2],
    /// Measurements of stripes that took part, and that did not.
    pub stripe_points: [usize; 2],
    /// By how much corners and stripes scatter more than predicted.
    pub scales: [f64; 2],
    /// Placements of the board.
    pub poses: Vec<PoseRecord>,
    /// Figures of the instrument.
    pub figures: Vec<FigureRecord>,
    /// Pairs of parameters that the data hardly tell apart.
    pub correlated: Vec<CorrelatedRecord>,
    /// Images left out, with reasons.
    pub rejected: Vec<RejectedRecord>,
    /// Images with the largest residuals.
    pub worst: Vec<WorstRecord>,
}

/// A placement of the board.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PoseRecord {
    /// Its image.
    pub file: String,
    /// `air` or `water`.
    pub medium: &'static str,
    /// The board's middle, camera frame.
    pub middle_mm: [f64; 3],
    /// Angle between the board's normal and the optical axis.
    pub tilt_deg: f64,
    /// The normal's part along x and along y.
    pub tilt_xy_deg: [f64; 2],
    /// Corners that took part.
    pub corners: usize,
    /// Their residuals' root mean square, px.
    pub rms_px: f64,
    /// Stripes with measurements that took part.
    pub stripes: usize,
}

impl CalibrationReport {
    /// What there is to tell of a calibration.
    pub fn new(calibrated: &Calibrated, made: Option<String>) -> Self {
        let calibration = &calibrated.file.calibration;
        let s = &calibration.statistics;
        let said = |severity: Severity| {
            let of = calibrated.problems.iter().filter(move |p: &&Problem| p.severity == severity);
            of.map(ToString::to_string)
        };
        Self {
            head: HeadRecord::new(FORMAT, VERSION, made),
            method: figures::method(calibration.method),
            warnings: calibration.warnings.iter().cloned().chain(said(Severity::Warning)).collect(),
            lost: said(Severity::Loss).collect(),
            captures: figures::sources(&calibrated.file),
            reprojection_rms_px: s.reprojection_rms_px,
            stripe_rms_px: s.stripe_rms_px,
            stripe_rms_mm: s.stripe_rms_mm,
            corners: [s.corners, s.corners_rejected],
            stripe_points: [s.stripe_points, s.stripe_points_rejected],
            scales: [s.corner_scale, s.stripe_scale],
            poses: calibrated.remains.iter().map(pose).collect(),
            figures: figures::quantities(calibration),
            correlated: calibration.covariance.as_ref().map(pairs).unwrap_or_default(),
            rejected: s.rejected.iter().map(Into::into).collect(),
            worst: s.worst.iter().map(Into::into).collect(),
        }
    }

    fn csv(&self) -> String {
        let number = |v: Option<f64>| v.map(|v| v.to_string()).unwrap_or_default();
        let row = |f: &FigureRecord| format!("{},{},{}\n", f.name, f.value, number(f.sigma));
        "figure,value,sigma\n".to_owned() + &self.figures.iter().map(row).collect::<String>()
    }
}

/// Writes the page of a calibration, and its figures beside it as JSON and CSV; the files that there are then.
///
/// # Errors
/// [`Error`] where they can't be written, or exist and may not be replaced.
pub fn write_calibration_report(
    calibrated: &Calibrated,
    made: Option<String>,
    path: &Path,
    overwrite: Overwrite,
) -> Result<[PathBuf; 3], Error> {
    let report = CalibrationReport::new(calibrated, made);
    let page = calibration_page(&report, calibrated).html().map_err(Error::Plot)?;
    write_all(path, overwrite, [&page, &json(&report), &report.csv()])
}

fn medium(outside: Outside) -> &'static str {
    if outside == Outside::Air { "air" } else { "water" }
}

fn rms(squares: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = squares.fold((0.0, 0_usize), |(sum, count), square| (sum + square, count + 1));
    if count > 0 { (sum / count as f64).sqrt() } else { 0.0 }
}

fn pose(view: &ViewResiduals) -> PoseRecord {
    let normal = view.camera_from_board.rotation_matrix().column(2).into_owned();
    // The board is looked at from its front or its back: its normal is taken away from the camera.
    let normal = if normal.z < 0.0 { -normal } else { normal };
    let used = || view.corners.iter().filter(|c| c.used);
    PoseRecord {
        file: view.file.clone(),
        medium: medium(view.outside),
        middle_mm: view.camera_from_board.transform_point(&view.middle_board_mm.push(0.0)).into(),
        tilt_deg: normal.xy().norm().atan2(normal.z).to_degrees(),
        tilt_xy_deg: [normal.x, normal.y].map(|v| v.asin().to_degrees()),
        corners: used().count(),
        rms_px: rms(used().map(|c| c.residual_px.norm_squared())),
        stripes: view.stripes.iter().filter(|s| s.points.iter().any(|p| p.used)).count(),
    }
}

fn correlation(covariance: &DMatrix<f64>, i: usize, j: usize) -> f64 {
    let size = (covariance[(i, i)] * covariance[(j, j)]).sqrt();
    if size > 0.0 { covariance[(i, j)] / size } else { 0.0 }
}

fn pairs(covariance: &DMatrix<f64>) -> Vec<CorrelatedRecord> {
    let each = (0..GLOBALS).flat_map(|i| (0..i).map(move |j| (i, j)));
    let record = |(i, j): (usize, usize)| CorrelatedRecord {
        a: NAMES[j].to_owned(),
        b: NAMES[i].to_owned(),
        correlation: correlation(covariance, i, j),
    };
    let mut pairs: Vec<CorrelatedRecord> =
        each.map(record).filter(|p: &CorrelatedRecord| p.correlation.abs() >= CORRELATED).collect();
    pairs.sort_by(|p, q| q.correlation.abs().total_cmp(&p.correlation.abs()));
    pairs.truncate(MOST_PAIRS);
    pairs
}
