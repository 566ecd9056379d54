//! Edges that lead across a step.

use super::delaunay::Flat;
use super::noise::Noise;
use super::normals::{Faces, Facing, Incident};
use super::void::Span;
use crate::cloud::PointCloud;
use crate::mesh::NONE;
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
    noise: &Noise<'_>,
    spans: &[Span],
    kept: &mut [bool],
    known: &mut Faces<'_>,
) -> Steps {
    let faces = known.one_sided(kept);
    let (flat, incident) = (known.flat, known.incident);
    let untold = 2.0 * untold_variance(cloud, flat, incident, &faces, noise, kept);
    let edges = || {
        let kept = &*kept;
        flat.triangles.iter().enumerate().filter(|(t, _)| kept[*t]).flat_map(move |(t, corners)| {
            let across = flat.across[t];
            // Each edge once, by the triangle that comes first.
            let first = move |k: &usize| {
                across[*k] == NONE || !kept[across[*k] as usize] || (across[*k] as usize) > t
            };
            (0..3).filter(first).map(move |k| (t, across[k], corners[k], corners[(k + 1) % 3]))
        })
    };
    let mut count = 0;
    let mut suspects = Vec::new();
    for (t, other, a, b) in edges() {
        let (Some(m), Some(n)) = (faces[a as usize], faces[b as usize]) else { continue };
        let other = if other == NONE || !kept[other as usize] { t } else { other as usize };
        // A triangle's edges count for each of the two.
        count += 1 + usize::from(other != t);
        let edge = cloud.vector(b as usize) - cloud.vector(a as usize);
        let Some(leaving) = Leaving::of(&m, &n, &edge) else { continue };
        let incomplete = [t, other].map(|t| spans[t] == Span::Incomplete);
        if leaving.steep {
            let chi2 = leaving.step(a, b, noise, untold);
            suspects
                .extend([t, other].into_iter().take(1 + usize::from(other != t)).map(|t| (t, true, chi2)));
        }
        if leaving.apart && (incomplete[0] || incomplete[1]) {
            let chi2 = leaving.fold(a, b, noise, untold);
            suspects.extend(
                [t, other].into_iter().zip(incomplete).filter(|(_, own)| *own).map(|(t, _)| (t, false, chi2)),
            );
        }
    }
    let limit = rejection_limit(count);
    let mut cut = Steps::default();
    // A triangle that is both counts as a step.
    suspects.sort_by_key(|(t, step, _)| (*t, !*step));
    for (t, step, chi2) in suspects {
        if chi2 > limit * limit && kept[t] {
            kept[t] = false;
            known.forget(t);
            *(if step { &mut cut.steps } else { &mut cut.unseen }) += 1;
        }
    }
    cut
}

/// How an edge leaves the faces of its ends.
struct Leaving {
    edge: Vector3<f64>,
    /// Variance of the two faces' normals together, rad².
    bend: f64,
    middle: Vector3<f64>,
    /// The face that it leaves the more.
    farther: Vector3<f64>,
    /// Whether it is a step but for noise.
    steep: bool,
    /// Whether it does not keep to both faces, but for noise.
    apart: bool,
}

impl Leaving {
    fn of(m: &Facing, n: &Facing, edge: &Vector3<f64>) -> Option<Self> {
        let (leaves, meets) = (m.normal.dot(edge), n.normal.dot(edge));
        let most = leaves.abs().max(meets.abs());
        let reach2 = STEP_SIN * STEP_SIN * edge.norm_squared();
        // Most edges keep to both faces, and to their middle, which they leave by twice as much at most.
        if 4.0 * most * most <= reach2 {
            return None;
        }
        let middle = (m.normal + n.normal).try_normalize(0.0)?;
        // Both ends' normals are noisier than their mean.
        let least = middle.dot(edge).abs().min(2.0 * leaves.abs().min(meets.abs()));
        Some(Self {
            edge: *edge,
            bend: m.variance + n.variance,
            middle,
            farther: if leaves.abs() > meets.abs() { m.normal } else { n.normal },
            steep: leaves * meets > 0.0 && least * least > reach2,
            apart: most * most > reach2,
        })
    }

    /// The step's height, squared, by its variance.
    fn step(&self, a: u32, b: u32, noise: &Noise<'_>, untold: f64) -> f64 {
        self.chi2(&self.middle, 0.25, [a, b], noise, untold)
    }

    /// How far the edge leads away from the face that it leaves the more, squared, by its variance.
    fn fold(&self, a: u32, b: u32, noise: &Noise<'_>, untold: f64) -> f64 {
        self.chi2(&self.farther, 1.0, [a, b], noise, untold)
    }

    fn chi2(&self, along: &Vector3<f64>, share: f64, ends: [u32; 2], noise: &Noise<'_>, untold: f64) -> f64 {
        let told: f64 = ends.iter().map(|&v| noise.along(v, along)).sum();
        along.dot(&self.edge).powi(2) / (told + share * self.bend * self.edge.norm_squared() + untold)
    }
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
