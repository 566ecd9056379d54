//! A sweep over three balls before a plate, for benches: a camera at the origin, a sheet of light that turns beside it, noise in the stripe's column.

use crate::cloud::{CloudPoint, Frame, PointCloud};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng, rngs::StdRng};

/// Position of the laser's axis on x, mm; focal length of the paper's camera in water, px; noise, px.
const BASELINE_MM: f64 = 400.0;
const FOCAL_PX: f64 = 1890.0;
const NOISE_PX: f64 = 0.06;

/// Balls: centre and radius, mm.
const BALLS: [([f64; 3], f64); 3] =
    [([60.0, -50.0, 860.0], 30.0), ([-70.0, -20.0, 880.0], 25.0), ([10.0, 60.0, 850.0], 20.0175)];

/// Sheets and rows of 36 000 points, and the field that they cover, as slopes.
const SHEETS: f64 = 150.0;
const ROWS: f64 = 240.0;
const FIELD: f64 = 0.24;
const HEIGHT: f64 = 0.2;

/// How a sweep of more points grows.
#[derive(Clone, Copy)]
pub enum Growth {
    /// Sheets and rows lie closer, by the root of the points: on the same scene, with the same noise.
    Finer,
    /// Scene, baseline and image are larger, by the root of the points: as dense, with the same noise.
    #[allow(dead_code, reason = "only one of those that share this module asks for it")]
    Larger,
}

/// Returns a cloud of about so many points, with pixels, frames and covariances.
pub fn sweep(points: usize, growth: Growth) -> PointCloud {
    let more = (points as f64 / (SHEETS * ROWS)).sqrt();
    let larger = match growth {
        Growth::Finer => 1.0,
        Growth::Larger => more,
    };
    let [sheets, rows] = [SHEETS, ROWS].map(|n| (n * more).round() as u32);
    let balls = BALLS.map(|(center, radius)| (center.map(|c| larger * c), larger * radius));
    let (baseline, focal) = (larger * BASELINE_MM, larger * FOCAL_PX);
    let mut random = StdRng::seed_from_u64(1);
    let mut measured = Vec::with_capacity(points);
    for sheet in 0..sheets {
        let slope = 0.46 + FIELD * (f64::from(sheet) / f64::from(sheets) - 0.5);
        for row in 0..rows {
            let across = HEIGHT * (f64::from(row) / f64::from(rows) - 0.5);
            // The plate is z = 920 + 0.1 x, with x = slope z − baseline.
            let plate = (larger * 920.0 - 0.1 * baseline) / (1.0 - 0.1 * slope);
            let met = balls.iter().filter_map(|ball| meets(baseline, slope, across, ball));
            let depth = met.fold(plate, f64::min);
            // Box and Muller.
            let (a, b): (f64, f64) = (1.0 - random.random::<f64>(), random.random());
            let shift = NOISE_PX * (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos();
            let depth = baseline / (baseline / depth - shift / focal);
            let along = Vector3::new(slope, across, 1.0) * (depth * depth / (baseline * focal) * NOISE_PX);
            let position = [slope * depth - baseline, across * depth, depth];
            measured.push(CloudPoint {
                position_mm: position,
                intensity: 100.0,
                frame_row: sheet,
                pixel: [position[0] / depth, position[1] / depth].map(|tangent| (tangent * focal) as f32),
                sigma_mm: along.norm() as f32,
                covariance_mm2: [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
                    .map(|(i, j)| (along[i] * along[j]) as f32),
                shared_mm: None,
            });
        }
    }
    PointCloud::from_points(Frame::Camera, &measured)
}

/// The depth at which a line of light first meets a ball, where the camera sees it there.
fn meets(baseline: f64, slope: f64, across: f64, (center, radius): &([f64; 3], f64)) -> Option<f64> {
    let (start, way) = (Vector3::new(-baseline, 0.0, 0.0), Vector3::new(slope, across, 1.0));
    let arm = start - Vector3::from(*center);
    let half = arm.dot(&way) / way.norm_squared();
    let root = half * half - (arm.norm_squared() - radius * radius) / way.norm_squared();
    let depth = -half - root.max(0.0).sqrt();
    let point = start + way * depth;
    (root >= 0.0 && (point - Vector3::from(*center)).dot(&point) < 0.0).then_some(depth)
}
