//! Normals at a scan's points from the triangles about them, on one side of a step.

use super::delaunay::Flat;
use crate::robust::median;
use nalgebra::Vector3;

/// Cosine of the angle between neighbouring triangles beyond which a vertex may lie at a step: 20°.
const SMOOTH_COS: f64 = 0.939_692_620_785_908_4;

/// Cosines of the angles up to which triangles count as of one face (25°), and from which on they do not at all (40°): noise that
/// tilts the triangles of a face must not set them back against the few large ones across a step, which agree better.
const ONE_FACE_COS: [f64; 2] = [0.906_307_787_036_65, 0.766_044_443_118_978];

/// A normal, and its uncertainty.
#[derive(Debug, Clone, Copy)]
pub(super) struct Facing {
    pub(super) normal: Vector3<f64>,
    /// Variance of its direction, rad².
    pub(super) variance: f64,
}

/// The sum of unit normals, and how many they are.
struct Sum {
    normals: Vector3<f64>,
    count: f64,
}

impl Sum {
    /// Variance of one of the normals about their mean, rad².
    fn spread(&self) -> f64 {
        2.0 * (1.0 - self.normals.norm() / self.count).max(0.0)
    }
}

/// The triangles at each vertex.
pub(super) struct Incident {
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl Incident {
    pub(super) fn new(triangles: &[[u32; 3]], vertices: usize) -> Self {
        let mut starts = vec![0_u32; vertices + 1];
        triangles.iter().flatten().for_each(|&v| starts[v as usize + 1] += 1);
        (0..vertices).for_each(|v| starts[v + 1] += starts[v]);
        let mut filled = starts.clone();
        let mut sorted = vec![0_u32; 3 * triangles.len()];
        for (corners, t) in triangles.iter().zip(0..) {
            for &v in corners {
                let at = &mut filled[v as usize];
                sorted[*at as usize] = t;
                *at += 1;
            }
        }
        Self { starts, triangles: sorted }
    }

    pub(super) fn of(&self, vertex: u32) -> &[u32] {
        let v = vertex as usize;
        &self.triangles[self.starts[v] as usize..self.starts[v + 1] as usize]
    }
}

/// Returns a unit normal for each vertex from the kept triangles about it, `None` where there are none.
///
/// Where all of them agree it is their mean. At a step it is that of the face that most triangles of the first two
/// rings belong to: those across the step, however large, are few and stand steeply, and those of the face beyond it are fewer
/// than those of the vertex's own.
pub(super) fn one_sided(
    flat: &Flat,
    incident: &Incident,
    normals: &[Vector3<f64>],
    kept: &[bool],
    vertices: usize,
) -> Vec<Option<Facing>> {
    let mut sharp = vec![false; vertices];
    for (t, across) in flat.across.iter().enumerate().filter(|(t, _)| kept[*t]) {
        for &other in across {
            // Each edge once; the triangle on its other side is later in the list, or not there.
            if (other as usize) < kept.len()
                && kept[other as usize]
                && t < other as usize
                && normals[t].dot(&normals[other as usize]) < SMOOTH_COS
            {
                for corners in [flat.triangles[t], flat.triangles[other as usize]] {
                    corners.iter().for_each(|&v| sharp[v as usize] = true);
                }
            }
        }
    }
    let mut around: Vec<u32> = Vec::new();
    let mut counted: Vec<(u32, f64)> = Vec::new();
    let sums: Vec<Sum> = (0..vertices as u32)
        .map(|v| {
            let own = incident.of(v).iter().filter(|t| kept[**t as usize]);
            if !sharp[v as usize] {
                let normals = own.clone().map(|&t| normals[t as usize]).sum();
                return Sum { normals, count: own.count() as f64 };
            }
            around.clear();
            for &t in own {
                // A triangle comes once for each vertex of it that is near: nearer ones count for more.
                for &w in &flat.triangles[t as usize] {
                    around.extend(incident.of(w).iter().filter(|t| kept[**t as usize]));
                }
            }
            around.sort_unstable();
            counted.clear();
            counted.extend(around.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as f64)));
            face_of_most(&counted, normals)
        })
        .collect();
    // What one or two triangles say of their own spread is too little: it is at least that of most.
    let mut spreads: Vec<f64> = sums.iter().filter(|sum| sum.count > 3.0).map(Sum::spread).collect();
    let typical = median(&mut spreads);
    let facing = |sum: &Sum| {
        let variance = sum.spread().max(typical) / sum.count;
        sum.normals.try_normalize(0.0).map(|normal| Facing { normal, variance })
    };
    sums.iter().map(facing).collect()
}

/// The normals of the largest group of one face; triangles come with their weights.
fn face_of_most(around: &[(u32, f64)], normals: &[Vector3<f64>]) -> Sum {
    let [whole, none] = ONE_FACE_COS;
    let share =
        |a: &Vector3<f64>, t: u32| ((a.dot(&normals[t as usize]) - none) / (whole - none)).clamp(0.0, 1.0);
    let mut best = (0.0, Vector3::zeros());
    for &(t, _) in around {
        let own = normals[t as usize];
        let score: f64 = around.iter().map(|&(other, weight)| weight * share(&own, other)).sum();
        if score > best.0 {
            best = (score, own);
        }
    }
    // Thrice more about the mean, so that the noise of the one triangle does not stay.
    let mut middle = best.1;
    let mut sum = Sum { normals: Vector3::zeros(), count: 0.0 };
    for _ in 0..3 {
        sum = Sum { normals: Vector3::zeros(), count: 0.0 };
        for &(t, weight) in around {
            let weight = weight * share(&middle, t);
            sum.normals += normals[t as usize] * weight;
            sum.count += weight;
        }
        middle = sum.normals.try_normalize(0.0).unwrap_or(middle);
    }
    sum
}
