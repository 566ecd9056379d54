//! What the reproduction tells, as its JSON file has it. Lengths in millimetres, centres in each calibration's galvanometer frame.

use crate::pipeline::report::{HeadRecord, HistogramRecord};
use serde::Serialize;

/// The `format` of the JSON file.
pub const FORMAT: &str = "uwscan-reproduction";
/// Its version: keys may be added, never renamed.
pub const VERSION: u32 = 1;

/// All of it.
#[derive(Debug, Clone, Serialize)]
pub struct Record {
    /// [`FORMAT`] and [`VERSION`], and what made it.
    #[serde(flatten)]
    pub head: HeadRecord,
    /// What the instrument and all noise were drawn by.
    pub seed: u64,
    /// Images that were simulated.
    pub images: usize,
    /// What to know before trusting it.
    pub warnings: Vec<String>,
    /// The two calibrations.
    pub calibrations: Both<CalibrationInShort>,
    /// Table 1 and Figures 8 and 9.
    pub balls: Vec<BallRecord>,
    /// Table 2.
    pub three_balls: Vec<ThreeRecord>,
    /// Figure 10: distances of the points from the sphere at position 6.
    pub figure_10: Both<HistogramRecord>,
    /// Figure 11.
    pub cover: CoverRecord,
    /// In short.
    pub summary: Both<Summary>,
}

/// The paper's method and ours, on the same images.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Both<T> {
    /// The paper's: calibrated on land step by step, refraction approximated, fits with equal weights.
    pub paper: T,
    /// Ours: one adjustment of poses on land and in water, refraction exact, fits weighted by covariances.
    pub ours: T,
}

/// A calibration in short.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CalibrationInShort {
    /// Placements of the board.
    pub poses_used: usize,
    /// Of corners, px.
    pub reprojection_rms_px: f64,
    /// Of stripes on the board, mm.
    pub stripe_rms_mm: f64,
}

/// The ball in one position.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BallRecord {
    /// The paper's number of it.
    pub position: usize,
    /// What the paper printed: z of the centre.
    pub published_z_mm: f64,
    /// The same, error of the radius.
    pub published_error_mm: f64,
    /// The same, points.
    pub published_points: usize,
    /// Distance of the true centre from that in position 1.
    pub true_from_first_mm: f64,
    /// What came out.
    #[serde(flatten)]
    pub found: Both<BallFigures>,
}

/// A ball as it was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BallFigures {
    /// Centre.
    pub center_mm: [f64; 3],
    /// Radius.
    pub radius_mm: f64,
    /// Less the true one.
    pub error_mm: f64,
    /// Standard deviation, with the calibration's part; not known to the paper's method.
    pub sigma_mm: Option<f64>,
    /// Points.
    pub points: usize,
    /// The farthest point outside.
    pub max_outside_mm: f64,
    /// The farthest point inside.
    pub max_inside_mm: f64,
    /// Distance of the centre from that in position 1, less the true one.
    pub from_first_error_mm: f64,
}

/// A figure of the three balls in one orientation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ThreeRecord {
    /// The paper's number of it.
    pub orientation: usize,
    /// Which.
    pub quantity: &'static str,
    /// Standard value.
    pub nominal_mm: f64,
    /// What the paper printed, less that.
    pub published_error_mm: f64,
    /// What came out less that, by the paper's method.
    pub paper_error_mm: Option<f64>,
    /// By ours.
    pub ours_error_mm: Option<f64>,
    /// Its standard deviation, with the calibration's part.
    pub ours_sigma_mm: Option<f64>,
}

/// The cover.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CoverRecord {
    /// Images of the sweep.
    pub images: usize,
    /// Points, and the paper's.
    pub points: usize,
    /// The paper's number of them.
    pub published_points: usize,
    /// Vertices of the mesh.
    pub vertices: usize,
    /// Its triangles.
    pub triangles: usize,
}

/// Errors in short.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Least and largest error of the ball's radius.
    pub ball_radius_mm: [f64; 2],
    /// Largest error of a distance between the ball's places.
    pub ball_places_mm: f64,
    /// Largest error of the three balls' radii.
    pub three_radius_mm: f64,
    /// Largest error of the distances between them.
    pub three_distance_mm: f64,
}

/// The columns of the table beside the page.
const HEADER: &str =
    "experiment,position,quantity,nominal_mm,published_error_mm,paper_error_mm,ours_error_mm,ours_sigma_mm\n";

impl Record {
    /// The figures as a table.
    pub fn csv(&self) -> String {
        let number = |v: Option<f64>| v.map(|v| v.to_string()).unwrap_or_default();
        let mut text = HEADER.to_owned();
        for b in &self.balls {
            let (paper, ours) = (&b.found.paper, &b.found.ours);
            text += &format!(
                "ball,{},radius,{},{},{},{},{}\n",
                b.position,
                super::published::BALL_RADIUS_MM,
                b.published_error_mm,
                paper.error_mm,
                ours.error_mm,
                number(ours.sigma_mm)
            );
            text += &format!(
                "ball,{},distance from position 1,{},,{},{},\n",
                b.position, b.true_from_first_mm, paper.from_first_error_mm, ours.from_first_error_mm
            );
        }
        for t in &self.three_balls {
            text += &format!(
                "three-ball,{},{},{},{},{},{},{}\n",
                t.orientation,
                t.quantity,
                t.nominal_mm,
                t.published_error_mm,
                number(t.paper_error_mm),
                number(t.ours_error_mm),
                number(t.ours_sigma_mm)
            );
        }
        text
    }
}
