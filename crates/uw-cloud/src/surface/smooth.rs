//! Smoothing that knows each point's sigma: vertices moved to what they and their neighbours say together.

use super::noise::Noise;
use super::normals::Incident;
use crate::cloud::PointCloud;
use crate::plane::square_to;
use crate::robust::{median, rejection_limit};
use nalgebra::{SMatrix, SVector, Unit, Vector3};

/// A quadratic height over a plane: 1, x, y, x², xy, y².
const TERMS: usize = 6;

/// Neighbours beyond the terms from which on a fit says how well it holds.
const LEAST_SPARE: usize = 4;

/// Rounds of leaving out what does not belong to the vertex's face.
const ROUNDS: usize = 3;

/// Cosine of the angle between a vertex's normal and the light beyond which its point, which moves along the light, says little of the surface's height.
const GRAZING_COS: f64 = 0.1;

/// A vertex's step along the direction in which its point is uncertain.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    pub(super) move_mm: Vector3<f64>,
    /// Sigma after it by the sigma before.
    pub(super) sigma_ratio: f64,
}

/// A quadratic surface through a vertex's neighbourhood, at the vertex.
struct Local {
    /// Its height over the vertex along the normal, mm.
    height_mm: f64,
    /// The share of the vertex's own error that is left.
    leverage: f64,
    chi2_by_dof: f64,
    dof: f64,
    normal: Vector3<f64>,
}

/// Returns how each vertex moves, `None` for those that stay: whose neighbours are few, or not on one smooth surface with it as far as
/// their sigmas tell.
///
/// Heights of two rings of neighbours over the tangent plane are fitted by a quadratic surface, each by its own variance along the normal; a curvature
/// is thus not flattened. Only triangles that were kept connect, so that nothing is smoothed across a step or a hole. A vertex moves along its
/// point's light and by what the surface says of it; its sigma shrinks by the root of its leverage. Sigmas that are too small or too large throughout are
/// made up for by the median of chi²/dof.
pub(super) fn steps(
    cloud: &PointCloud,
    points: &[u32],
    triangles: &[[u32; 3]],
    normals: &[[f32; 3]],
    noise: &Noise<'_>,
) -> Vec<Option<Step>> {
    let incident = Incident::new(triangles, points.len());
    let at = |v: u32| cloud.vector(points[v as usize] as usize);
    let mut ring: Vec<u32> = Vec::new();
    let fits: Vec<Option<Local>> = (0..points.len() as u32)
        .map(|v| {
            ring.clear();
            for &t in incident.of(v) {
                for &w in &triangles[t as usize] {
                    ring.extend(incident.of(w).iter().flat_map(|&t| triangles[t as usize]));
                }
            }
            ring.sort_unstable();
            ring.dedup();
            let normal = Unit::try_new(Vector3::from(normals[v as usize].map(f64::from)), 0.5)?;
            let sample = |&w: &u32| (at(w) - at(v), noise.along(points[w as usize], &normal), w == v);
            local(normal, ring.iter().map(sample).collect())
        })
        .collect();
    let scale = median(&mut fits.iter().flatten().map(|fit| fit.chi2_by_dof).collect::<Vec<_>>());
    let limit = rejection_limit(points.len());
    let step = |(v, fit): (usize, &Option<Local>)| {
        let fit = fit.as_ref()?;
        // chi² of d degrees of freedom spreads by sqrt(2 d).
        if fit.chi2_by_dof > scale * (1.0 + limit * (2.0 / fit.dof).sqrt()) {
            return None;
        }
        let along = noise.light(points[v]).unwrap_or(fit.normal);
        let cosine = along.dot(&fit.normal);
        (cosine.abs() > GRAZING_COS)
            .then(|| Step { move_mm: along * (fit.height_mm / cosine), sigma_ratio: fit.leverage.sqrt() })
    };
    fits.iter().enumerate().map(step).collect()
}

/// Returns the quadratic surface through neighbours, given by their places, variances along the normal and which is the vertex itself.
fn local(normal: Unit<Vector3<f64>>, mut sample: Vec<(Vector3<f64>, f64, bool)>) -> Option<Local> {
    let tangents = square_to(&normal);
    let reach = sample.iter().map(|(arm, ..)| arm.norm()).fold(0.0, f64::max);
    let terms = |arm: &Vector3<f64>| {
        let [x, y] = tangents.map(|t| t.dot(arm) / reach);
        SVector::<f64, TERMS>::from([1.0, x, y, x * x, x * y, y * y])
    };
    for round in 0..ROUNDS {
        if sample.len() < TERMS + LEAST_SPARE || sample.iter().any(|(_, variance, _)| *variance <= 0.0) {
            return None;
        }
        let mut matrix = SMatrix::<f64, TERMS, TERMS>::zeros();
        let mut right = SVector::<f64, TERMS>::zeros();
        for (arm, variance, _) in &sample {
            let row = terms(arm);
            matrix += row * row.transpose() / *variance;
            right += row * (normal.dot(arm) / variance);
        }
        let inverse = matrix.cholesky()?.inverse();
        let solution = inverse * right;
        let residual = |arm: &Vector3<f64>| normal.dot(arm) - terms(arm).dot(&solution);
        let chi2: f64 = sample.iter().map(|(arm, variance, _)| residual(arm).powi(2) / variance).sum();
        let dof = (sample.len() - TERMS) as f64;
        let worst = rejection_limit(sample.len()).powi(2) * (chi2 / dof).max(1.0);
        let before = sample.len();
        if round + 1 < ROUNDS {
            sample.retain(|(arm, variance, own)| *own || residual(arm).powi(2) <= worst * variance);
        }
        if sample.len() == before {
            let own = sample.iter().find(|(.., own)| *own)?;
            return Some(Local {
                height_mm: solution[0],
                leverage: (inverse[(0, 0)] / own.1).min(1.0),
                chi2_by_dof: chi2 / dof,
                dof,
                normal: normal.into_inner(),
            });
        }
    }
    None
}
