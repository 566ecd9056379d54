//! Edges that lead across a step.

use super::delaunay::Flat;
use super::noise::Noise;
use super::normals::{Facing, Incident, one_sided};
use super::void::Span;
use crate::cloud::PointCloud;
use crate::robust::{rejection_limit, scale_about_zero};
use nalgebra::Vector3;

/// Sine of the angle by which an edge has to leave the surface at both of its ends to be a step rather than a bend: 22.5°,
/// which is what a fold of a right angle comes to that a point lies in.
const STEP_SIN: f64 = 0.382_683_432_365_089_8;

/// Triangles that were cut in one round.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Steps {
    /// Across a step.
    pub(super) steps: usize,
    /// Across what was not seen.
    pub(super) unseen: usize,
}

/// Cuts the triangles that have a step for an edge, and those that close a gap in another way than the faces at its ends would, and returns how many.
///
/// Along a step the edge from a to b leaves a's face on one side and b's on the other: with the faces' normals m and n, m·e and
/// n·e have the same sign and are both large. On a bend they have opposite signs, on a fold one of them is small, and along
/// an arc (m + n)·e vanishes. So s = (m + n)·e / |m + n| is the step's height, and in a surface that only bends it is noise: of
/// the two points, as the cloud tells and as it shows beyond that, and of the normals.
///
/// Where something was not seen between the corners, a fold may hide there as well, such as that between the outline of a pipe and the
/// floor behind it: then an edge has to keep to the faces of both of its ends.
pub(super) fn cut_steps(
    cloud: &PointCloud,
    flat: &Flat,
    incident: &Incident,
    normals: &[Vector3<f64>],
    noise: &Noise<'_>,
    spans: &[Span],
    kept: &mut [bool],
) -> Steps {
    let faces = one_sided(flat, incident, normals, kept, cloud.len());
    let leaving = |a: u32, b: u32| {
        let (m, n) = (faces[a as usize]?, faces[b as usize]?);
        let edge = cloud.vector(b as usize) - cloud.vector(a as usize);
        let middle = (m.normal + n.normal).try_normalize(0.0)?;
        let bend = m.variance + n.variance;
        let (m, n) = (m.normal, n.normal);
        let (leaves, meets) = (m.dot(&edge), n.dot(&edge));
        // Both ends' normals are noisier than their mean.
        let least = middle.dot(&edge).abs().min(2.0 * leaves.abs().min(meets.abs()));
        let farther = if leaves.abs() > meets.abs() { m } else { n };
        let variance = |along: &Vector3<f64>, share: f64| {
            noise.along(a, along) + noise.along(b, along) + share * bend * edge.norm_squared()
        };
        let reach = STEP_SIN * edge.norm();
        Some(Leaving {
            height_mm: middle.dot(&edge),
            variance_mm2: variance(&middle, 0.25),
            steep: leaves * meets > 0.0 && least > reach,
            farther_mm: farther.dot(&edge),
            farther_variance_mm2: variance(&farther, 1.0),
            apart: farther.dot(&edge).abs() > reach,
        })
    };
    let untold = 2.0 * untold_variance(cloud, flat, incident, &faces, noise, kept);
    let mut edges = 0;
    let mut suspects = Vec::new();
    for (t, corners) in flat.triangles.iter().enumerate().filter(|(t, _)| kept[*t]) {
        for k in 0..3 {
            let Some(edge) = leaving(corners[k], corners[(k + 1) % 3]) else { continue };
            edges += 1;
            if edge.steep {
                suspects.push((t, true, edge.height_mm.powi(2) / (edge.variance_mm2 + untold)));
            }
            if edge.apart && spans[t] == Span::Incomplete {
                suspects.push((t, false, edge.farther_mm.powi(2) / (edge.farther_variance_mm2 + untold)));
            }
        }
    }
    let limit = rejection_limit(edges);
    let mut cut = Steps::default();
    for (t, step, chi2) in suspects {
        if chi2 > limit * limit && kept[t] {
            kept[t] = false;
            *(if step { &mut cut.steps } else { &mut cut.unseen }) += 1;
        }
    }
    cut
}

/// How an edge leaves the faces of its ends.
struct Leaving {
    /// The step's height.
    height_mm: f64,
    variance_mm2: f64,
    /// Whether it is one but for noise.
    steep: bool,
    /// How far it leads away from the face that it leaves the more.
    farther_mm: f64,
    farther_variance_mm2: f64,
    /// Whether it does not keep to both faces, but for noise.
    apart: bool,
}

/// Variance of a point along its normal beyond what the cloud tells of it, mm²: from how far points lie from the middle of their
/// neighbours, in the middle half of the surface.
fn untold_variance(
    cloud: &PointCloud,
    flat: &Flat,
    incident: &Incident,
    faces: &[Option<Facing>],
    noise: &Noise<'_>,
    kept: &[bool],
) -> f64 {
    const MOST_POINTS: usize = 20_000;
    let mut told = 0.0;
    let step = faces.len().div_ceil(MOST_POINTS).max(1);
    let mut offsets = Vec::with_capacity(faces.len() / step + 1);
    for v in (0..faces.len()).step_by(step) {
        let Some(face) = faces[v] else { continue };
        let (mut sum, mut corners) = (Vector3::zeros(), 0.0);
        for &t in incident.of(v as u32).iter().filter(|t| kept[**t as usize]) {
            for &w in flat.triangles[t as usize].iter().filter(|w| **w as usize != v) {
                sum += cloud.vector(w as usize) - cloud.vector(v);
                corners += 1.0;
            }
        }
        // Each neighbour comes twice, and its own noise is in the sum.
        let neighbours: f64 = 0.5 * corners;
        if neighbours >= 2.0 {
            offsets.push(face.normal.dot(&sum) / corners / (1.0 + 1.0 / neighbours).sqrt());
            told += noise.along(v as u32, &face.normal);
        }
    }
    let told = told / offsets.len().max(1) as f64;
    (scale_about_zero(offsets.into_iter()).powi(2) - told).max(0.0)
}
