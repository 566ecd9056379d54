//! Several sweeps at once: every one's points onto every other's surface.

use super::sample::{Match, Samples, TUKEY, Target};
use crate::cloud::PointCloud;
use crate::error::RegisterError;
use crate::merge::PairResidual;
use crate::nearest::NearestOnMesh;
use crate::robust::{median, scale_about_zero};
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6,
};

/// Points of each sweep that have a say.
const POINTS: usize = 6000;
const MAX_ROUNDS: usize = 40;
/// Of a motion's information, as of one sweep alone.
const DAMPING: f64 = 1e-6;

/// Poses that are settled together.
pub(crate) struct Joint {
    pub(crate) poses: Vec<Isometry3<f64>>,
    pub(crate) covariances: Vec<Matrix6<f64>>,
    pub(crate) pairs: Vec<PairResidual>,
    pub(crate) settled: bool,
}

/// One sweep's points on another one's surface.
struct Pair {
    points: usize,
    surface: usize,
    /// With arms about the middle of all, normals in the first frame.
    matches: Vec<Match>,
    floor2: f64,
    overlap: f64,
    rms: f64,
}

/// Returns the poses that bring all sweeps onto each other, from poses that nearly do; the first one stays.
pub(crate) fn joint(
    clouds: &[PointCloud],
    trees: &[NearestOnMesh<'_>],
    mut poses: Vec<Isometry3<f64>>,
) -> Result<Joint, RegisterError> {
    let samples: Vec<Samples> = clouds.iter().map(Samples::new).collect::<Result<_, _>>()?;
    let middles = samples.iter().zip(&poses).map(|(s, pose)| (pose * Point3::from(s.middle)).coords);
    let middle = middles.sum::<Vector3<f64>>() / samples.len() as f64;
    let radius = samples
        .iter()
        .zip(&poses)
        .map(|(s, pose)| ((pose * Point3::from(s.middle)).coords - middle).norm() + s.radius)
        .fold(0.0, f64::max);
    let mut reach = 0.02 * radius;
    let mut settled = false;
    let mut covariances = Vec::new();
    let mut pairs = Vec::new();
    for _ in 0..MAX_ROUNDS {
        pairs = matched(&samples, trees, &poses, &middle, reach);
        let (matrix, gradient, scatter) = normal_equations(&pairs, poses.len(), radius);
        let Some(inverse) = matrix.clone().try_inverse() else { break };
        let step = -(&inverse * gradient);
        for (k, pose) in poses.iter_mut().enumerate().skip(1) {
            let turn = Vector3::from_fn(|r, _| step[6 * (k - 1) + r]) / radius;
            let shift = Vector3::from_fn(|r, _| step[6 * (k - 1) + 3 + r]);
            let about =
                Translation3::from(middle + shift) * UnitQuaternion::new(turn) * Translation3::from(-middle);
            *pose = about * *pose;
        }
        covariances = blocks(&(&inverse * scatter * &inverse), radius);
        let noise = pairs.iter().filter(|p| p.overlap > 0.0).map(|p| p.rms).fold(0.0, f64::max);
        let next = (3.0 * TUKEY * noise).min(reach).max(0.5 * reach);
        settled = step.amax() < 1e-3 * noise + 1e-12 * radius && next > 0.9 * reach;
        reach = next;
        if settled {
            break;
        }
    }
    let pairs = pairs.iter().map(|pair| PairResidual {
        points_of: pair.points,
        surface_of: pair.surface,
        overlap: pair.overlap,
        rms_mm: pair.rms,
        floor_mm: pair.floor2.sqrt(),
    });
    Ok(Joint { poses, covariances, pairs: pairs.collect(), settled })
}

fn matched(
    samples: &[Samples],
    trees: &[NearestOnMesh<'_>],
    poses: &[Isometry3<f64>],
    middle: &Vector3<f64>,
    reach: f64,
) -> Vec<Pair> {
    const ALIKE: f64 = 0.7;
    let orders = (0..poses.len()).flat_map(|i| (0..poses.len()).map(move |j| (i, j))).filter(|(i, j)| i != j);
    let pair = |(i, j): (usize, usize)| {
        let target = Target { mesh: &trees[j], middle: samples[i].middle, signed: samples[i].signed };
        let surface_from_points = poses[j].inverse() * poses[i];
        let points = samples[i].few(POINTS);
        let of = |sample: &&super::sample::Sample| {
            let found = target.matched(sample, &surface_from_points, reach).filter(|m| m.facing > ALIKE)?;
            let arm = (poses[i] * Point3::from(sample.place)).coords - middle;
            Some(Match { arm, normal: poses[j].rotation * found.normal, ..found })
        };
        let matches: Vec<Match> = points.iter().filter_map(of).collect();
        let told = median(&mut matches.iter().map(|m| m.told).collect::<Vec<_>>());
        let scatter = scale_about_zero(matches.iter().map(|m| m.residual));
        let floor2 = (scatter * scatter - told).max(1e-6 * scatter * scatter).max(f64::MIN_POSITIVE);
        let on = |m: &&Match| m.residual.powi(2) < TUKEY * TUKEY * (m.told + floor2);
        let squares: Vec<f64> = matches.iter().filter(on).map(|m| m.residual.powi(2)).collect();
        Pair {
            points: i,
            surface: j,
            floor2,
            overlap: squares.len() as f64 / points.len() as f64,
            rms: (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt(),
            matches,
        }
    };
    orders.map(pair).collect()
}

/// The normal matrix of all poses but the first, its gradient, and the gradient's scatter.
fn normal_equations(pairs: &[Pair], poses: usize, radius: f64) -> (DMatrix<f64>, DVector<f64>, DMatrix<f64>) {
    let size = 6 * (poses - 1);
    let mut matrix = DMatrix::zeros(size, size);
    let mut scatter = DMatrix::zeros(size, size);
    let mut gradient = DVector::zeros(size);
    for pair in pairs {
        let (mut own, mut noise, mut pull) = (Matrix6::zeros(), Matrix6::zeros(), Vector6::zeros());
        for m in &pair.matches {
            let variance = m.told + pair.floor2;
            let ratio = m.residual * m.residual / (variance * TUKEY * TUKEY);
            if ratio >= 1.0 {
                continue;
            }
            let weight = (1.0 - ratio).powi(2) / variance;
            let turn = m.arm.cross(&m.normal) / radius;
            let row = Vector6::new(turn.x, turn.y, turn.z, m.normal.x, m.normal.y, m.normal.z);
            own += row * row.transpose() * weight;
            noise += row * row.transpose() * (weight * m.residual).powi(2);
            pull += row * (weight * m.residual);
        }
        // The surface moves the other way; the first sweep does not move.
        let sides = [(pair.points, 1.0), (pair.surface, -1.0)];
        for (a, sign_a) in sides.iter().filter(|(a, _)| *a > 0) {
            let at = 6 * (a - 1);
            let mut part = gradient.rows_mut(at, 6);
            part += pull * *sign_a;
            for (b, sign_b) in sides.iter().filter(|(b, _)| *b > 0) {
                let sign = sign_a * sign_b;
                let mut block = matrix.view_mut((at, 6 * (b - 1)), (6, 6));
                block += own * sign;
                // Both directions of two sweeps tell of the same noise.
                let mut block = scatter.view_mut((at, 6 * (b - 1)), (6, 6));
                block += noise * (2.0 * sign);
            }
        }
    }
    let most = matrix.diagonal().amax().max(f64::MIN_POSITIVE);
    for k in 0..size {
        matrix[(k, k)] += DAMPING * most;
    }
    (matrix, gradient, scatter)
}

/// The covariance of each pose, the first one's nil, turns in rad.
fn blocks(all: &DMatrix<f64>, radius: f64) -> Vec<Matrix6<f64>> {
    let unit = 1.0 / radius;
    let units = Matrix6::from_diagonal(&Vector6::new(unit, unit, unit, 1.0, 1.0, 1.0));
    let block = |k: usize| units * all.fixed_view::<6, 6>(6 * k, 6 * k) * units;
    std::iter::once(Matrix6::zeros()).chain((0..all.nrows() / 6).map(block)).collect()
}
