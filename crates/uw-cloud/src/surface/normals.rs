//! Normals at a scan's points from the triangles about them, on one side of a step.

use super::delaunay::Flat;
use crate::neighbours::MANY;
use crate::robust::median;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Triangles that are tried as a face's, and normals whose spread tells that of most.
const CANDIDATES: usize = 40;
const MOST_SPREADS: usize = 5000;

/// Triangles that are counted side by side.
const LANES: usize = 8;

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

    /// Returns the mean, each of the normals spreading by so much at least; `None` of none.
    fn facing(&self, least_spread: f64) -> Option<Facing> {
        let length = self.normals.norm();
        let variance = self.spread().max(least_spread) / self.count;
        (length > 0.0).then(|| Facing { normal: self.normals / length, variance })
    }
}

/// The triangles at each vertex.
pub(super) struct Incident {
    starts: Vec<u32>,
    triangles: Vec<u32>,
    /// The corner after the vertex in each of these triangles.
    next: Vec<u32>,
}

impl Incident {
    pub(super) fn new(triangles: &[[u32; 3]], vertices: usize) -> Self {
        let mut starts = vec![0_u32; vertices + 1];
        triangles.iter().flatten().for_each(|&v| starts[v as usize + 1] += 1);
        (0..vertices).for_each(|v| starts[v + 1] += starts[v]);
        let mut filled = starts.clone();
        let mut sorted = vec![0_u32; 3 * triangles.len()];
        let mut next = sorted.clone();
        for (&[a, b, c], t) in triangles.iter().zip(0..) {
            for (v, after) in [(a, b), (b, c), (c, a)] {
                let at = &mut filled[v as usize];
                (sorted[*at as usize], next[*at as usize]) = (t, after);
                *at += 1;
            }
        }
        Self { starts, triangles: sorted, next }
    }

    pub(super) fn vertices(&self) -> u32 {
        self.starts.len() as u32 - 1
    }

    /// The triangles at a vertex.
    pub(super) fn of(&self, vertex: u32) -> &[u32] {
        &self.triangles[self.range(vertex)]
    }

    /// The corner after the vertex in each of these: going round, the vertex's neighbours.
    pub(super) fn next(&self, vertex: u32) -> &[u32] {
        &self.next[self.range(vertex)]
    }

    /// The triangles at some vertices, in order, each once.
    pub(super) fn about(&self, vertices: &[u32]) -> Vec<u32> {
        let mut about: Vec<u32> = vertices.iter().flat_map(|&v| self.of(v)).copied().collect();
        unique(&mut about);
        about
    }

    fn range(&self, vertex: u32) -> std::ops::Range<usize> {
        let v = vertex as usize;
        self.starts[v] as usize..self.starts[v + 1] as usize
    }
}

/// Puts numbers in order, each once.
pub(super) fn unique(list: &mut Vec<u32>) {
    list.sort_unstable();
    list.dedup();
}

/// Unit normals at vertices from the kept triangles about them; `None` where there are none. They are kept from one round of cutting to the next: only where triangles were cut are they made anew.
///
/// Where all of the triangles agree it is their mean. At a step it is that of the face that most triangles of the first two
/// rings belong to: those across the step, however large, are few and stand steeply, and those of the face beyond it are fewer
/// than those of the vertex's own.
pub(super) struct Faces<'a> {
    pub(super) flat: &'a Flat,
    pub(super) incident: &'a Incident,
    /// Of the triangles.
    normals: &'a [Vector3<f64>],
    pub(super) at: Vec<Option<Facing>>,
    /// The spread of the normals at a vertex, as it is at most: what one or two triangles say of their own is too little.
    typical: f64,
    /// Vertices whose normals have to be made anew.
    stale: Vec<u32>,
}

impl<'a> Faces<'a> {
    pub(super) fn new(
        flat: &'a Flat,
        incident: &'a Incident,
        normals: &'a [Vector3<f64>],
        kept: &[bool],
    ) -> Self {
        let mut faces = Self { flat, incident, normals, at: Vec::new(), typical: 0.0, stale: Vec::new() };
        let sharp = faces.sharp(kept);
        let vertices = incident.vertices();
        let sum = |near: &mut Near, v: u32| faces.sum(v, sharp[v as usize], near, kept);
        let sums: Vec<Sum> = if (vertices as usize) < MANY {
            let mut near = Near::new(vertices as usize);
            (0..vertices).map(|v| sum(&mut near, v)).collect()
        } else {
            let all = (0..vertices).into_par_iter().with_min_len(4096);
            all.map_init(|| Near::new(vertices as usize), sum).collect()
        };
        let many = || sums.iter().filter(|sum| sum.count > 3.0);
        let step = many().count().div_ceil(MOST_SPREADS).max(1);
        faces.typical = median(&mut many().step_by(step).map(Sum::spread).collect::<Vec<_>>());
        faces.at = sums.iter().map(|sum| sum.facing(faces.typical)).collect();
        faces
    }

    /// Returns whether kept neighbouring triangles at each vertex differ.
    fn sharp(&self, kept: &[bool]) -> Vec<bool> {
        let flat = self.flat;
        let mut sharp = vec![false; self.incident.vertices() as usize];
        for (t, across) in flat.across.iter().enumerate().filter(|(t, _)| kept[*t]) {
            for &other in across {
                // Each edge once; the triangle on its other side is later in the list, or not there.
                if t < other as usize && self.differ(t, other, kept) {
                    for corners in [flat.triangles[t], flat.triangles[other as usize]] {
                        corners.iter().for_each(|&v| sharp[v as usize] = true);
                    }
                }
            }
        }
        sharp
    }

    /// Returns whether a triangle differs from what is kept on the other side of an edge.
    fn differ(&self, triangle: usize, other: u32, kept: &[bool]) -> bool {
        let other = other as usize;
        other < kept.len() && kept[other] && self.normals[triangle].dot(&self.normals[other]) < SMOOTH_COS
    }

    /// Returns the sum of the normals of a vertex's own face.
    fn sum(&self, v: u32, sharp: bool, near: &mut Near, kept: &[bool]) -> Sum {
        let Self { flat, incident, normals, .. } = self;
        if sharp {
            near.gather(v, flat, incident, normals, kept);
            return near.face_of_most();
        }
        mean(incident.of(v).iter().filter(|t| kept[**t as usize]).map(|&t| &normals[t as usize]))
    }

    /// Tells of a triangle that was cut: it has a say in the normals at vertices up to two rings from it.
    pub(super) fn forget(&mut self, triangle: usize) {
        for &v in &self.flat.triangles[triangle] {
            let about = self.incident.of(v).iter().flat_map(|&t| self.flat.triangles[t as usize]);
            self.stale.extend(about);
        }
    }

    /// Makes those normals anew that triangles had a say in that were cut, and returns the triangles at these vertices, in order.
    pub(super) fn renew(&mut self, kept: &[bool]) -> Vec<u32> {
        let mut stale = std::mem::take(&mut self.stale);
        unique(&mut stale);
        let mut near = Near::new(self.at.len());
        for &v in &stale {
            let own = self.incident.of(v).iter().map(|t| *t as usize).filter(|t| kept[*t]);
            let sharp = own.flat_map(|t| self.flat.across[t].map(|other| (t, other)));
            let sharp = sharp.into_iter().any(|(t, other)| self.differ(t, other, kept));
            self.at[v as usize] = self.sum(v, sharp, &mut near, kept).facing(self.typical);
        }
        self.incident.about(&stale)
    }
}

fn mean<'a>(normals: impl Iterator<Item = &'a Vector3<f64>>) -> Sum {
    normals.fold(Sum { normals: Vector3::zeros(), count: 0.0 }, |sum, normal| Sum {
        normals: sum.normals + normal,
        count: sum.count + 1.0,
    })
}

/// How far two triangles count as of one face, by the cosine between them. Comparisons rather than `clamp`: each is one of the processor's instructions.
fn one_face(cosine: f32) -> f32 {
    const NONE: f32 = ONE_FACE_COS[1] as f32;
    const STEEP: f32 = 1.0 / (ONE_FACE_COS[0] - ONE_FACE_COS[1]) as f32;
    let share = (cosine - NONE) * STEEP;
    let share = if share > 0.0 { share } else { 0.0 };
    if share < 1.0 { share } else { 1.0 }
}

/// Some triangles' x, y and z of their normals, and weights: side by side in single precision, several of which fit into one of the processor's registers.
type Lanes = [[f32; LANES]; 4];

/// The triangles of the first two rings about a vertex.
struct Near {
    triangles: Vec<Lanes>,
    /// The vertex's neighbours, and how many of its triangles each vertex is a corner of.
    ring: Vec<u32>,
    times: Vec<f32>,
}

impl Near {
    fn new(vertices: usize) -> Self {
        Self { triangles: Vec::new(), ring: Vec::new(), times: vec![0.0; vertices] }
    }

    /// Takes the kept triangles of a vertex's first two rings in.
    ///
    /// A triangle counts once for each corner that one of the vertex's own triangles has, for each of these: nearer ones count for more.
    fn gather(&mut self, v: u32, flat: &Flat, incident: &Incident, normals: &[Vector3<f64>], kept: &[bool]) {
        self.ring.clear();
        let own = || incident.of(v).iter().filter(|t| kept[**t as usize]);
        for &t in own() {
            for &w in flat.triangles[t as usize].iter().filter(|w| **w != v) {
                if self.times[w as usize] == 0.0 {
                    self.ring.push(w);
                }
                self.times[w as usize] += 1.0;
            }
        }
        self.times[v as usize] = own().count() as f32;
        let most = own().count() + self.ring.iter().map(|&w| incident.of(w).len()).sum::<usize>();
        self.triangles.resize(most.div_ceil(LANES), Lanes::default());
        let mut count = 0;
        for &t in own() {
            let weight = flat.triangles[t as usize].map(|w| self.times[w as usize]).iter().sum();
            count += self.put(count, &normals[t as usize], weight, true);
        }
        // One that has two corners on the ring comes twice, each time with the weight of one.
        for at in 0..self.ring.len() {
            let w = self.ring[at];
            let weight = self.times[w as usize];
            for &t in incident.of(w).iter().filter(|t| kept[**t as usize]) {
                let [a, b, c] = flat.triangles[t as usize];
                count += self.put(count, &normals[t as usize], weight, (a != v) & (b != v) & (c != v));
            }
        }
        self.times[v as usize] = 0.0;
        self.ring.iter().for_each(|&w| self.times[w as usize] = 0.0);
        self.triangles.truncate(count.div_ceil(LANES));
        // What fills the last of the lanes has no weight.
        for at in count..LANES * self.triangles.len() {
            self.put(at, &Vector3::zeros(), 0.0, false);
        }
    }

    /// Writes a triangle, and returns 1 where it counts: else the next one takes its place, and no branch has to be guessed.
    fn put(&mut self, at: usize, normal: &Vector3<f64>, weight: f32, counts: bool) -> usize {
        let [x, y, z] = [normal.x, normal.y, normal.z].map(|value| value as f32);
        let lanes = &mut self.triangles[at / LANES];
        lanes.iter_mut().zip([x, y, z, weight]).for_each(|(list, value)| list[at % LANES] = value);
        usize::from(counts)
    }

    /// A triangle's normal; nil beyond the last one.
    fn normal(&self, at: usize) -> [f32; 3] {
        let [x, y, z, _] =
            self.triangles.get(at / LANES).map_or([0.0; 4], |lanes| lanes.map(|list| list[at % LANES]));
        [x, y, z]
    }

    /// Returns the sum of normals and weights, each by how far it agrees with a direction.
    fn agreeing(&self, [x, y, z]: [f32; 3]) -> [f32; 4] {
        self.sum(|other| one_face(x * other[0] + y * other[1] + z * other[2]))
    }

    /// Returns the sum of normals and weights, each by a share.
    fn sum(&self, share: impl Fn([f32; 3]) -> f32) -> [f32; 4] {
        let mut sums = Lanes::default();
        for [xs, ys, zs, weights] in &self.triangles {
            for k in 0..LANES {
                let weight = weights[k] * share([xs[k], ys[k], zs[k]]);
                sums[0][k] += weight * xs[k];
                sums[1][k] += weight * ys[k];
                sums[2][k] += weight * zs[k];
                sums[3][k] += weight;
            }
        }
        sums.map(|lanes| lanes.iter().sum())
    }

    /// Returns the triangle that most of the triangles agree with.
    ///
    /// Some of them, evenly taken, stand for candidates: of the largest face there are several among so many, and the mean that follows is the same from each.
    fn most_agreed(&self) -> usize {
        let count = LANES * self.triangles.len();
        let step = count.div_ceil(CANDIDATES).max(1);
        let (mut best, mut most) = (0, f32::NEG_INFINITY);
        for first in (0..count).step_by(LANES * step) {
            let at: [usize; LANES] = std::array::from_fn(|k| first + k * step);
            let normals = at.map(|at| self.normal(at));
            let [x, y, z] = [0, 1, 2].map(|axis| normals.map(|normal| normal[axis]));
            let mut scores = [0.0_f32; LANES];
            for [xs, ys, zs, weights] in &self.triangles {
                for (((other_x, other_y), other_z), weight) in xs.iter().zip(ys).zip(zs).zip(weights) {
                    for k in 0..LANES {
                        scores[k] += weight * one_face(x[k] * other_x + y[k] * other_y + z[k] * other_z);
                    }
                }
            }
            for (at, score) in at.into_iter().zip(scores) {
                if score > most {
                    (best, most) = (at, score);
                }
            }
        }
        best
    }

    /// Returns the normals of the largest group of one face.
    fn face_of_most(&self) -> Sum {
        /// All of a sum, to its rounding.
        const WHOLE: f32 = 1.0 - 1e-5;
        let of = |sum: [f32; 4]| {
            let [x, y, z, count] = sum.map(f64::from);
            Sum { normals: Vector3::new(x, y, z), count }
        };
        let unit = |[x, y, z, _]: [f32; 4]| Vector3::new(x, y, z).try_normalize(0.0).map(Into::into);
        // Noise alone makes neighbours differ, too: where all agree with the mean of all, that is the face.
        let all = self.sum(|_| 1.0);
        if let Some(agreed) = unit(all).map(|middle| self.agreeing(middle))
            && agreed[3] >= WHOLE * all[3]
        {
            return of(agreed);
        }
        let best = self.most_agreed();
        let mut middle = self.normal(best);
        let mut sum = [0.0; 4];
        // Thrice more about the mean, so that the noise of the one triangle does not stay.
        for _ in 0..3 {
            sum = self.agreeing(middle);
            middle = unit(sum).unwrap_or(middle);
        }
        of(sum)
    }
}
