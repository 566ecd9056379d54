//! Synthetic measurements of a triangulating scanner: a camera at the origin, a laser sheet turned about an axis along y
//! beside it, and noise where it arises, in the stripe's column.

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use uw_cloud::{Frame, PointCloud};

/// Position of the laser's axis on x, mm.
pub const BASELINE_MM: f64 = 400.0;
/// Focal length of the paper's camera in px times the index of water.
pub const FOCAL_PX: f64 = 1416.0 * 1.335;

/// A line of sight of one sheet and one image row: x = −baseline + slope z, y = row z.
#[derive(Debug, Clone, Copy)]
pub struct Line {
    pub slope: f64,
    pub row: f64,
}

impl Line {
    /// Returns its point at depth z, mm.
    pub fn at(self, z: f64) -> [f64; 3] {
        [self.slope * z - BASELINE_MM, self.row * z, z]
    }

    /// Returns the depth at which it first meets a sphere.
    pub fn meets(self, center: [f64; 3], radius: f64) -> Option<f64> {
        // |a + b z|² = R² with the line relative to the centre.
        let a = [-BASELINE_MM - center[0], -center[1], -center[2]];
        let b = [self.slope, self.row, 1.0];
        let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
        let (bb, ab, aa) = (dot(b, b), dot(a, b), dot(a, a) - radius * radius);
        let root = ab * ab - bb * aa;
        (root >= 0.0).then(|| (-ab - root.sqrt()) / bb)
    }

    /// Returns the point that a stripe centre off by `shift_px` gives, and its covariance, of rank one.
    pub fn measured(self, z: f64, shift_px: f64, sigma_px: f64) -> ([f64; 3], [f32; 6]) {
        // z = baseline / (slope − u/f).
        let parallax = BASELINE_MM / z - shift_px / FOCAL_PX;
        let z = BASELINE_MM / parallax;
        let depth_sigma = z * z / (BASELINE_MM * FOCAL_PX) * sigma_px;
        let [x, y, z_share] = [self.slope, self.row, 1.0].map(|share| share * depth_sigma);
        let covariance = [x * x, x * y, x * z_share, y * y, y * z_share, z_share * z_share];
        (self.at(z), covariance.map(|c| c as f32))
    }
}

/// Returns the seeded generator of a test.
pub fn random(seed: u64) -> StdRng {
    StdRng::seed_from_u64(seed)
}

/// Returns a Gaussian number of sigma 1.
pub fn gauss(random: &mut StdRng) -> f64 {
    StandardNormal.sample(random)
}

/// Returns a number from low to high.
pub fn uniform(random: &mut StdRng, low: f64, high: f64) -> f64 {
    low + (high - low) * random.random::<f64>()
}

/// A ball as the scanner sees it: the lines that meet it where camera and laser see it, up to grazing.
pub fn ball_lines(center: [f64; 3], radius: f64, sheet_step_deg: f64) -> Vec<(Line, f64)> {
    let towards = ((center[0] + BASELINE_MM) / center[2]).atan();
    let half = 1.5 * radius / center[2];
    let sheets = (2.0 * half / sheet_step_deg.to_radians()) as i32;
    let rows = (half * FOCAL_PX) as i32;
    let middle_row = (center[1] / center[2] * FOCAL_PX).round() as i32;
    let mut lines = Vec::new();
    for sheet in -sheets / 2..=sheets / 2 {
        let slope = (towards + f64::from(sheet) * sheet_step_deg.to_radians()).tan();
        for row in middle_row - rows..=middle_row + rows {
            let line = Line { slope, row: f64::from(row) / FOCAL_PX };
            let Some(z) = line.meets(center, radius) else { continue };
            let point = line.at(z);
            let seen: f64 = (0..3).map(|k| (point[k] - center[k]) * point[k]).sum();
            if seen < 0.0 {
                lines.push((line, z));
            }
        }
    }
    lines
}

/// Returns a cloud of noisy measurements with their covariances.
pub fn cloud(lines: &[(Line, f64)], sigma_px: f64, random: &mut StdRng) -> PointCloud {
    let (points, covariances): (Vec<_>, Vec<_>) =
        lines.iter().map(|(line, z)| line.measured(*z, sigma_px * gauss(random), sigma_px)).unzip();
    PointCloud::new(Frame::Camera, points).with_covariances_mm2(covariances).expect("one a point")
}

/// Returns the cloud without its covariances.
pub fn bare(cloud: &PointCloud) -> PointCloud {
    PointCloud::new(cloud.frame(), cloud.positions_mm().to_vec())
}

/// Mean and spread of errors, and of errors over their sigmas.
#[derive(Debug, Default)]
pub struct Errors {
    errors: Vec<f64>,
    ratios: Vec<f64>,
}

impl Errors {
    pub fn add(&mut self, error: f64, sigma: f64) {
        self.errors.push(error);
        self.ratios.push(error / sigma);
    }

    pub fn mean(&self) -> f64 {
        self.errors.iter().sum::<f64>() / self.errors.len() as f64
    }

    /// Standard deviation of the errors.
    pub fn spread(&self) -> f64 {
        let mean = self.mean();
        (self.errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / (self.errors.len() - 1) as f64).sqrt()
    }

    pub fn standard_error(&self) -> f64 {
        self.spread() / (self.errors.len() as f64).sqrt()
    }

    /// Root mean square of error over sigma.
    pub fn normalised(&self) -> f64 {
        (self.ratios.iter().map(|r| r * r).sum::<f64>() / self.ratios.len() as f64).sqrt()
    }

    /// Mean of error over sigma.
    pub fn normalised_mean(&self) -> f64 {
        self.ratios.iter().sum::<f64>() / self.ratios.len() as f64
    }
}
