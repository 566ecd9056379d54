//! Edges that lead across a step.

use super::noise::Noise;
use super::normals::{Faces, Facing};
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

/// What the noise of a surface is, and what therefore no step is.
pub(super) struct Limits {
    /// Variance of two points along a normal beyond what the cloud tells of them, mm².
    untold: f64,
    /// Squared heights that no edge of a smooth surface reaches, in units of their variance.
    chi2: f64,
}

impl Limits {
    /// Reads the noise off a surface before anything is cut at steps.
    pub(super) fn of(cloud: &PointCloud, noise: &Noise<'_>, faces: &Faces<'_>, kept: &[bool]) -> Self {
        let edges = 3 * kept.iter().filter(|kept| **kept).count();
        Self {
            untold: 2.0 * untold_variance(cloud, faces, noise, kept),
            chi2: rejection_limit(edges).powi(2),
        }
    }
}

/// Cuts those of the asked triangles, in order, that have a step for an edge, and those that close a gap in another way than the faces at its ends would, and returns how many.
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
    limits: &Limits,
    spans: &[Span],
    kept: &mut [bool],
    faces: &mut Faces<'_>,
    asked: &[u32],
) -> Steps {
    let flat = faces.flat;
    let mut suspects = Vec::new();
    for t in asked.iter().map(|t| *t as usize).filter(|t| kept[*t]) {
        let corners = flat.triangles[t];
        for k in 0..3 {
            let across = flat.across[t][k];
            let other = if across == NONE || !kept[across as usize] { t } else { across as usize };
            // Each edge once, by the triangle that comes first.
            if other < t {
                continue;
            }
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let (Some(m), Some(n)) = (&faces.at[a as usize], &faces.at[b as usize]) else { continue };
            let edge = cloud.vector(b as usize) - cloud.vector(a as usize);
            let Some(leaving) = Leaving::of(m, n, &edge) else { continue };
            let sides = [t, other].into_iter().take(1 + usize::from(other != t));
            if leaving.steep {
                let chi2 = leaving.step(a, b, noise, limits.untold);
                if chi2 > limits.chi2 {
                    suspects.extend(sides.clone().map(|t| (t, true)));
                }
            }
            let incomplete = sides.filter(|t| spans[*t] == Span::Incomplete);
            if leaving.apart && incomplete.clone().next().is_some() {
                let chi2 = leaving.fold(a, b, noise, limits.untold);
                if chi2 > limits.chi2 {
                    suspects.extend(incomplete.map(|t| (t, false)));
                }
            }
        }
    }
    let mut cut = Steps::default();
    // A triangle that is both counts as a step.
    suspects.sort_unstable_by_key(|(t, step)| (*t, !*step));
    for (t, step) in suspects {
        if std::mem::replace(&mut kept[t], false) {
            faces.forget(t);
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
    Faces { flat, incident, at: faces, .. }: &Faces<'_>,
    noise: &Noise<'_>,
    kept: &[bool],
) -> f64 {
    const MOST_POINTS: usize = 5000;
    let mut told = 0.0;
    let step = faces.len().div_ceil(MOST_POINTS).max(1);
    let mut offsets = Vec::with_capacity(faces.len() / step + 1);
    for v in (0..faces.len()).step_by(step) {
        let Some(face) = &faces[v] else { continue };
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
