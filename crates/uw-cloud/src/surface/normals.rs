//! Normals at a scan's points from the triangles about them, on one side of a step.

use super::delaunay::Flat;
use crate::neighbours::MANY;
use crate::robust::median;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Triangles that are tried as a face's, and normals whose spread tells that of most.
const CANDIDATES: usize = 40;
/// Candidates whose scores are counted side by side.
const LANES: usize = 8;
const MOST_SPREADS: usize = 20_000;

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

    pub(super) fn vertices(&self) -> u32 {
        self.starts.len() as u32 - 1
    }

    pub(super) fn of(&self, vertex: u32) -> &[u32] {
        let v = vertex as usize;
        &self.triangles[self.starts[v] as usize..self.starts[v + 1] as usize]
    }
}

/// Unit normals at vertices, kept from one round of cutting to the next: only where triangles were cut are they made anew.
pub(super) struct Faces<'a> {
    pub(super) flat: &'a Flat,
    pub(super) incident: &'a Incident,
    /// Of the triangles.
    normals: &'a [Vector3<f64>],
    sums: Vec<Option<Sum>>,
}

impl<'a> Faces<'a> {
    pub(super) fn new(flat: &'a Flat, incident: &'a Incident, normals: &'a [Vector3<f64>]) -> Self {
        Self { flat, incident, normals, sums: (0..incident.vertices()).map(|_| None).collect() }
    }

    /// Returns whether kept neighbouring triangles at each vertex differ.
    fn sharp(&self, kept: &[bool]) -> Vec<bool> {
        let Self { flat, normals, .. } = self;
        let mut sharp = vec![false; self.sums.len()];
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
        sharp
    }

    /// Forgets what a triangle that was cut had a say in: the normals at vertices up to two rings from it.
    pub(super) fn forget(&mut self, triangle: usize) {
        for &v in &self.flat.triangles[triangle] {
            for &t in self.incident.of(v) {
                self.flat.triangles[t as usize].iter().for_each(|&w| self.sums[w as usize] = None);
            }
        }
    }

    /// Returns a unit normal for each vertex from the kept triangles about it, `None` where there are none.
    ///
    /// Where all of them agree it is their mean. At a step it is that of the face that most triangles of the first two
    /// rings belong to: those across the step, however large, are few and stand steeply, and those of the face beyond it are fewer
    /// than those of the vertex's own.
    pub(super) fn one_sided(&mut self, kept: &[bool]) -> Vec<Option<Facing>> {
        let sharp = self.sharp(kept);
        let Self { flat, incident, normals, sums } = self;
        let missing = |(v, own): (usize, &mut Option<Sum>)| {
            if own.is_none() {
                *own = Some(about(v as u32, sharp[v], flat, incident, normals, kept));
            }
        };
        if sums.len() < MANY {
            sums.iter_mut().enumerate().for_each(missing);
        } else {
            sums.par_iter_mut().with_min_len(4096).enumerate().for_each(missing);
        }
        // What one or two triangles say of their own spread is too little: it is at least that of most.
        let many = || sums.iter().flatten().filter(|sum| sum.count > 3.0);
        let step = many().count().div_ceil(MOST_SPREADS).max(1);
        let mut spreads: Vec<f64> = many().step_by(step).map(Sum::spread).collect();
        let typical = median(&mut spreads);
        let facing = |sum: &Option<Sum>| {
            let sum = sum.as_ref()?;
            let length = sum.normals.norm();
            let variance = sum.spread().max(typical) / sum.count;
            (length > 0.0).then(|| Facing { normal: sum.normals / length, variance })
        };
        sums.iter().map(facing).collect()
    }
}

/// The normals at a vertex.
fn about(
    v: u32,
    sharp: bool,
    flat: &Flat,
    incident: &Incident,
    normals: &[Vector3<f64>],
    kept: &[bool],
) -> Sum {
    let own = incident.of(v).iter().filter(|t| kept[**t as usize]);
    if !sharp {
        return own.fold(Sum { normals: Vector3::zeros(), count: 0.0 }, |sum, &t| Sum {
            normals: sum.normals + normals[t as usize],
            count: sum.count + 1.0,
        });
    }
    // A triangle counts once for each corner that one of the vertex's own triangles has, for each of these: nearer ones count for more.
    let own: Vec<u32> = own.copied().collect();
    let mut ring: Vec<(u32, f64)> = Vec::with_capacity(16);
    for &t in &own {
        for &w in flat.triangles[t as usize].iter().filter(|w| **w != v) {
            match ring.iter_mut().find(|(other, _)| *other == w) {
                Some((_, times)) => *times += 1.0,
                None => ring.push((w, 1.0)),
            }
        }
    }
    let times = |w: u32| ring.iter().position(|(other, _)| *other == w);
    let mut near: Vec<(Vector3<f64>, f64)> = Vec::with_capacity(64);
    for &t in &own {
        let others = flat.triangles[t as usize].iter().filter_map(|&w| times(w)).map(|at| ring[at].1);
        near.push((normals[t as usize], own.len() as f64 + others.sum::<f64>()));
    }
    for (at, &(w, _)) in ring.iter().enumerate() {
        for &t in incident.of(w).iter().filter(|t| kept[**t as usize]) {
            let corners = flat.triangles[t as usize];
            // Own ones are there already, and others come with the first of their corners on the ring.
            if corners.contains(&v) {
                continue;
            }
            let on_ring = corners.map(times);
            if on_ring.iter().flatten().min() == Some(&at) {
                let weight = on_ring.iter().flatten().map(|&at| ring[at].1).sum();
                near.push((normals[t as usize], weight));
            }
        }
    }
    face_of_most(&near)
}

/// The candidate that most of the triangles agree with.
///
/// All candidates' scores grow together, triangle by triangle, in single precision: several fit into one of the processor's registers.
fn most_agreed(near: &[(Vector3<f64>, f64)]) -> Vector3<f64> {
    let [whole, none] = ONE_FACE_COS.map(|cosine| cosine as f32);
    let steep = 1.0 / (whole - none);
    let step = near.len().div_ceil(CANDIDATES).max(1);
    let mut axes = [[0.0_f32; CANDIDATES]; 3];
    let mut candidates = 0;
    for (own, _) in near.iter().step_by(step) {
        axes.iter_mut().zip(own.iter()).for_each(|(axis, own)| axis[candidates] = *own as f32 * steep);
        candidates += 1;
    }
    let lanes = candidates.next_multiple_of(LANES).min(CANDIDATES);
    let [xs, ys, zs] = &axes;
    let (xs, ys, zs) = (&xs[..lanes], &ys[..lanes], &zs[..lanes]);
    let mut scores = [0.0_f32; CANDIDATES];
    for (other, weight) in near {
        let ([x, y, z], weight) = ([other.x as f32, other.y as f32, other.z as f32], *weight as f32);
        for (((score, a), b), c) in scores[..lanes].iter_mut().zip(xs).zip(ys).zip(zs) {
            *score += weight * (a * x + b * y + c * z - none * steep).clamp(0.0, 1.0);
        }
    }
    let best = (0..candidates).fold(0, |best, at| if scores[at] > scores[best] { at } else { best });
    near.get(best * step).map_or_else(Vector3::zeros, |(own, _)| *own)
}

/// The normals of the largest group of one face; triangles come with their weights.
///
/// Some of the triangles, evenly taken, stand for candidates: of the largest face there are several among so many, and the mean that follows is the same from each.
fn face_of_most(near: &[(Vector3<f64>, f64)]) -> Sum {
    let [whole, none] = ONE_FACE_COS;
    let share =
        |a: &Vector3<f64>, b: &Vector3<f64>| ((a.dot(b) - none) * (1.0 / (whole - none))).clamp(0.0, 1.0);
    // Thrice more about the mean, so that the noise of the one triangle does not stay.
    let mut middle = most_agreed(near);
    let mut sum = Sum { normals: Vector3::zeros(), count: 0.0 };
    for _ in 0..3 {
        sum = Sum { normals: Vector3::zeros(), count: 0.0 };
        for (normal, weight) in near {
            let weight = weight * share(&middle, normal);
            sum.normals += normal * weight;
            sum.count += weight;
        }
        middle = sum.normals.try_normalize(0.0).unwrap_or(middle);
    }
    sum
}
