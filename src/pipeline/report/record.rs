//! What a report tells, as its JSON file has it. Lengths in millimetres, in each scan's own frame; `null`: not known.

use serde::Serialize;
use std::collections::BTreeMap;
use uw_cloud::Histogram;
use uw_io::calibration_toml;

/// The `format` of the JSON file.
pub const FORMAT: &str = "uwscan-report";
/// Its version: keys may be added, never renamed.
pub const VERSION: u32 = 1;

/// All of a report.
#[derive(Debug, Clone, Serialize)]
pub struct Record {
    /// [`FORMAT`] and [`VERSION`], and what made it.
    #[serde(flatten)]
    pub head: HeadRecord,
    /// The page's title.
    pub title: String,
    /// What to know before trusting it.
    pub warnings: Vec<String>,
    /// Inputs that were missing.
    pub lost: Vec<String>,
    /// The calibration that was given.
    pub calibration: Option<CalibrationRecord>,
    /// The reference that was given.
    pub reference: Option<FileRecord>,
    /// The nominal values that were given.
    pub nominal: Option<FileRecord>,
    /// The scans in the order given.
    pub scans: Vec<ScanRecord>,
    /// Each ball's probing errors.
    pub probing: Vec<ProbingRecord>,
    /// Each distance's sphere-spacing error.
    pub spacing: Vec<SpacingRecord>,
}

/// How the JSON file beside a page begins.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct HeadRecord {
    /// The file's format.
    pub format: &'static str,
    /// Its version: keys may be added, never renamed.
    pub version: u32,
    /// What made it.
    pub software: String,
    /// When, as it was told.
    pub made: Option<String>,
}

impl HeadRecord {
    /// A file of this format, made by this software.
    pub(crate) fn new(format: &'static str, version: u32, made: Option<String>) -> Self {
        Self { format, version, software: calibration_toml::SOFTWARE.to_owned(), made }
    }
}

/// A file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FileRecord {
    /// Its name as it was given.
    pub file: String,
    /// SHA-256 of its bytes.
    pub sha256: String,
}

/// A calibration: what it is, and how good.
#[derive(Debug, Clone, Serialize)]
pub struct CalibrationRecord {
    /// Its file.
    #[serde(flatten)]
    pub file: FileRecord,
    /// `joint` or `paper`.
    pub method: &'static str,
    /// What made it.
    pub software: String,
    /// What it was made from.
    pub captures: Vec<SourceRecord>,
    /// Placements of the board.
    pub poses_used: usize,
    /// Images.
    pub frames_used: usize,
    /// Of corners, px.
    pub reprojection_rms_px: f64,
    /// Of stripes on the board, px.
    pub stripe_rms_px: f64,
    /// The same, mm.
    pub stripe_rms_mm: f64,
    /// Images that were left out.
    pub rejected: usize,
    /// Its own warnings.
    pub warnings: Vec<String>,
    /// Its figures.
    pub figures: Vec<FigureRecord>,
}

/// A capture that a calibration was made from.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SourceRecord {
    /// Its name.
    pub name: String,
    /// Hash of its content.
    pub sha256: String,
    /// `air` or `water`.
    pub medium: &'static str,
}

/// A figure with how well it is known.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FigureRecord {
    /// Its name, unit last.
    pub name: String,
    /// What came out.
    pub value: f64,
    /// Its standard deviation by the measurement; of a calibration's figures, all of it.
    pub sigma: Option<f64>,
    /// With the calibration's part.
    pub sigma_total: Option<f64>,
    /// What it should be.
    pub nominal: Option<f64>,
    /// How far it is from that.
    pub error: Option<f64>,
}

impl FigureRecord {
    /// A figure that nothing was said about beforehand.
    pub(crate) fn new(name: impl Into<String>, value: f64, sigma: f64, sigma_total: Option<f64>) -> Self {
        let sigma = Some(sigma);
        Self { name: name.into(), value, sigma, sigma_total, nominal: None, error: None }
    }

    /// The same, beside what it should be.
    pub(crate) fn against(self, nominal: Option<f64>) -> Self {
        Self { nominal, error: nominal.map(|nominal| self.value - nominal), ..self }
    }

    /// The largest standard deviation that is known of it.
    pub(crate) fn whole_sigma(&self) -> Option<f64> {
        self.sigma_total.or(self.sigma)
    }
}

/// One scan, or cloud.
#[derive(Debug, Clone, Serialize)]
pub struct ScanRecord {
    /// Its name, from its file's.
    pub name: String,
    /// `capture` or `cloud`.
    pub kind: &'static str,
    /// Its file or folder, and its hash.
    #[serde(flatten)]
    pub file: FileRecord,
    /// `air` or `water`, as the capture says.
    pub medium: Option<&'static str>,
    /// Index of refraction that the points were made with.
    pub index: Option<f64>,
    /// How light was traced.
    pub refraction: Option<&'static str>,
    /// Points.
    pub points: usize,
    /// Their frame.
    pub frame: &'static str,
    /// Lowest and highest corner of the box around them.
    pub box_mm: Option<[[f64; 3]; 2]>,
    /// The points' own sigmas: median, and what 95 % are below.
    pub point_sigma_mm: Option<[f64; 2]>,
    /// Rows or columns of the images without a point, by reason.
    pub rejected: BTreeMap<String, usize>,
    /// The same, image by image.
    pub images: Vec<ImageRecord>,
    /// Spheres, planes and cylinders.
    pub shapes: Vec<ShapeRecord>,
    /// Distances between shapes.
    pub distances: Vec<RelationRecord>,
    /// Angles between shapes.
    pub angles: Vec<RelationRecord>,
    /// Points of no shape.
    pub unassigned_points: usize,
    /// Against the reference.
    pub deviations: Option<DeviationsRecord>,
}

/// One laser-on image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImageRecord {
    /// Its row in the capture.
    pub row: usize,
    /// Rows or columns with a point.
    pub points: usize,
    /// Those without, by reason.
    pub rejected: BTreeMap<String, usize>,
}

/// A shape.
#[derive(Debug, Clone, Serialize)]
pub struct ShapeRecord {
    /// Its name on the page: the ball's own, or kind and number.
    pub label: String,
    /// `sphere`, `plane` or `cylinder`.
    pub kind: &'static str,
    /// Whether it is one of the nominal balls.
    pub is_nominal: bool,
    /// Its figures.
    pub figures: Vec<FigureRecord>,
    /// Points that it was fitted to.
    pub points: usize,
    /// Points near it that were rejected.
    pub outliers: usize,
    /// Their distances' root mean square.
    pub rms_mm: f64,
    /// The farthest outside (of a plane: towards the sensor).
    pub max_outside_mm: f64,
    /// The farthest inside.
    pub max_inside_mm: f64,
    /// Their distances in classes of equal width.
    pub histogram: HistogramRecord,
}

impl ShapeRecord {
    /// The figure of this name.
    pub(crate) fn figure(&self, name: &str) -> Option<(usize, &FigureRecord)> {
        self.figures.iter().enumerate().find(|(_, f)| f.name == name)
    }
}

/// Counts in classes of equal width.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HistogramRecord {
    /// Where the first begins.
    pub from_mm: f64,
    /// Where the last ends.
    pub to_mm: f64,
    /// In each.
    pub counts: Vec<usize>,
}

impl From<&Histogram> for HistogramRecord {
    fn from(h: &Histogram) -> Self {
        Self { from_mm: -h.reach_mm, to_mm: h.reach_mm, counts: h.counts.to_vec() }
    }
}

/// A distance or an angle between two shapes of a scan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RelationRecord {
    /// The one's label.
    pub a: String,
    /// The other's.
    pub b: String,
    /// How far: `distance_mm` or `angle_deg`.
    #[serde(flatten)]
    pub figure: FigureRecord,
}

/// Deviations of a scan's points from the reference, after best fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DeviationsRecord {
    /// Points that were compared.
    pub compared: usize,
    /// Points beside the reference.
    pub beyond: usize,
    /// Mean.
    pub mean_mm: f64,
    /// Root mean square.
    pub rms_mm: f64,
    /// Standard deviation, as the median absolute deviation has it.
    pub robust_sigma_mm: f64,
    /// What 2.5, 25, 50, 75, 97.5 % are below.
    pub quantiles_mm: [f64; 5],
    /// Farthest inside and outside.
    pub extremes_mm: [f64; 2],
    /// Share of the points that came to lie on the reference.
    pub overlap: f64,
    /// Counts by class.
    pub histogram: HistogramRecord,
}

/// The probing errors on one ball, in the sense of VDI/VDE 2634 part 2.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProbingRecord {
    /// The scan's number, from 0.
    pub scan: usize,
    /// The ball's label.
    pub ball: String,
    /// Radius of the sphere of least squares.
    pub radius_mm: f64,
    /// Its centre.
    pub center_mm: [f64; 3],
    /// Form (PF): range of the points' radial distances from it.
    pub form_mm: f64,
    /// Size (PS): its diameter less the nominal one.
    pub size_mm: Option<f64>,
    /// Points that took part.
    pub points: usize,
    /// Points left out: at most 3 in 1000.
    pub left_out: usize,
}

/// The sphere-spacing error (SD) between two balls, in the sense of VDI/VDE 2634 part 2.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpacingRecord {
    /// The scan's number, from 0.
    pub scan: usize,
    /// The one's label.
    pub a: String,
    /// The other's.
    pub b: String,
    /// Between the centres of the spheres of least squares.
    pub distance_mm: f64,
    /// What it should be.
    pub nominal_mm: f64,
    /// The difference.
    pub error_mm: f64,
}
