//! Poses to begin with, from anywhere: pairs of oriented points of the cloud laid onto pairs of the mesh that look alike.
//!
//! Two oriented points fix a pose, and four numbers that no motion changes tell which pairs can be the same (the distance and three angles
//! of B. Drost et al., CVPR 2010); poses are tried in turn on a few points and given up early (C. Papazov, D. Burschka, ACCV 2010). Nothing
//! of it needs the cloud to show all of the mesh, or the reverse.

use super::sample::{Sample, Samples, Target};
use super::sweep::Known;
use crate::mesh::TriangleMesh;
use crate::robust::Random;
use std::ops::Range;

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// Classes of distances up to the cloud's widest, and of angles up to 180°.
const DISTANCES: f64 = 20.0;
const ANGLES: f64 = 18.0;
/// Oriented places on the mesh, and how far apart they should lie in units of the cloud's radius.
const FEWEST_PLACES: f64 = 400.0;
const MOST_PLACES: f64 = 1600.0;
const SPACING: f64 = 0.12;
/// Pairs of the cloud that are drawn, those of them that are looked up, being like few of the mesh, and poses that are tried for each.
const DRAWN: usize = 1500;
const PAIRS: usize = 600;
const POSES_A_PAIR: usize = 40;
/// Points that a pose is tried on: first, and if it is promising.
const FIRST: usize = 15;
const TRIED: usize = 120;
/// Scatter that a rough pose leaves, in units of the cloud's radius.
const ROUGH: f64 = 0.03;
/// Poses that differ by less are one, in units of the cloud's radius.
pub(super) const SAME_POSE: f64 = 0.15;

struct Oriented {
    place: Vector3<f64>,
    normal: Vector3<f64>,
}

/// A pair of the cloud, how many pairs of the mesh are like it, and where these are.
type Drawn = (usize, [Oriented; 2], Vec<Range<usize>>);

/// Returns up to `most` poses that bring many of the points near to the mesh, the best first.
pub(super) fn starts(samples: &Samples, target: &Target<'_, '_>, most: usize) -> Vec<Isometry3<f64>> {
    let mut random = Random::new(1);
    let mut trial = Trial::new(samples, target, &mut random);
    trial.take(Isometry3::identity());
    axes_onto_axes(samples, target.mesh()).into_iter().for_each(|pose| trial.take(pose));
    let with_normal: Vec<(&Sample, Vector3<f64>)> =
        samples.points.iter().filter_map(|s| Some((s, s.normal?))).collect();
    if with_normal.len() < 2 {
        return trial.best(most);
    }
    let places = places(target.mesh(), samples.radius, &mut random);
    let widest = 2.5 * samples.radius;
    let alike = Alike::new(&places, widest);
    let sides: &[(f64, f64)] =
        if target.signed { &[(1.0, 1.0)] } else { &[(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)] };
    let mut pairs: Vec<Vec<Drawn>> = sides.iter().map(|_| Vec::new()).collect();
    for _ in 0..20 * DRAWN {
        let mut draw = || with_normal[random.below(with_normal.len())];
        let ((a, own_a), (b, own_b)) = (draw(), draw());
        let apart = (b.place - a.place).norm();
        if !(0.3 * samples.radius..widest).contains(&apart) {
            continue;
        }
        for ((side_a, side_b), pairs) in sides.iter().zip(&mut pairs) {
            let pair = [
                Oriented { place: a.place, normal: own_a * *side_a },
                Oriented { place: b.place, normal: own_b * *side_b },
            ];
            let found = alike.of(&pair);
            let count = found.iter().map(ExactSizeIterator::len).sum::<usize>();
            if count > 0 {
                pairs.push((count, pair, found));
            }
        }
        if pairs[0].len() >= DRAWN {
            break;
        }
    }
    // A pair that is like few others is more likely to be laid where it belongs. Of each choice of sides as many: pairs of a wrong one are
    // like few others, too.
    pairs.iter_mut().for_each(|pairs| pairs.sort_by_key(|(count, ..)| *count));
    for (count, pair, found) in pairs.iter().flat_map(|pairs| pairs.iter().take(PAIRS)) {
        if trial.is_over() {
            break;
        }
        let Some(from) = frame(&pair[0], &pair[1]) else { continue };
        for _ in 0..(POSES_A_PAIR / sides.len().min(2)).min(*count) {
            let mut at = random.below(*count);
            let part = found.iter().find(|part| {
                let inside = at < part.len();
                at -= if inside { 0 } else { part.len() };
                inside
            });
            let Some((_, (i, j))) = part.map(|part| &alike.pairs[part.clone()][at]) else { continue };
            if let Some(to) = frame(&places[*i as usize], &places[*j as usize]) {
                trial.take(to * from.inverse());
            }
        }
    }
    trial.best(most)
}

/// The frame that two oriented points fix: along their line, and their normals' mean.
fn frame(a: &Oriented, b: &Oriented) -> Option<Isometry3<f64>> {
    let x = (b.place - a.place).try_normalize(0.0)?;
    let across = |n: Vector3<f64>| n - x * x.dot(&n);
    let mean = across(a.normal + b.normal);
    let up = if mean.norm() > 0.3 { mean } else { across(a.normal) };
    let y = up.try_normalize(0.1)?;
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, x.cross(&y)]));
    let middle = (a.place + b.place) / 2.0;
    Some(Isometry3::from_parts(middle.into(), UnitQuaternion::from_rotation_matrix(&rotation)))
}

/// Places evenly over the area of a mesh, with its normals.
fn places(mesh: &TriangleMesh, radius: f64, random: &mut Random) -> Vec<Oriented> {
    let mut sums = Vec::with_capacity(mesh.triangles().len());
    let mut area = 0.0;
    for t in 0..mesh.triangles().len() {
        area += 0.5 * mesh.area_vector(t).norm();
        sums.push(area);
    }
    let count = (area / (SPACING * radius).powi(2)).clamp(FEWEST_PLACES, MOST_PLACES) as usize;
    let place = |n: usize| {
        // One in each of as many equal shares of the area.
        let at = area * (n as f64 + random.share()) / count as f64;
        let t = sums.partition_point(|&sum| sum <= at).min(sums.len() - 1);
        let [a, b, c] = mesh.corners(t);
        let (mut p, mut q) = (random.share(), random.share());
        if p + q > 1.0 {
            (p, q) = (1.0 - p, 1.0 - q);
        }
        let smooth = mesh.normals().map(|normals| {
            let corner = |k: usize| Vector3::from(normals[mesh.triangles()[t][k] as usize].map(f64::from));
            corner(0) * (1.0 - p - q) + corner(1) * p + corner(2) * q
        });
        let normal = smooth.unwrap_or_else(|| mesh.area_vector(t)).try_normalize(0.0)?;
        Some(Oriented { place: a + (b - a) * p + (c - a) * q, normal })
    };
    (0..count).filter_map(place).collect()
}

/// Pairs of places by their four numbers.
struct Alike {
    widest: f64,
    /// By class, sorted.
    pairs: Vec<(u32, (u16, u16))>,
}

impl Alike {
    fn new(places: &[Oriented], widest: f64) -> Self {
        let mut pairs = Vec::new();
        for (i, a) in places.iter().enumerate() {
            for (j, b) in places.iter().enumerate() {
                if i != j
                    && (b.place - a.place).norm() < widest
                    && let Some(numbers) = numbers(a, b, widest)
                {
                    pairs.push((class(numbers.map(|x| x as u32)), (i as u16, j as u16)));
                }
            }
        }
        pairs.sort_unstable();
        Self { widest, pairs }
    }

    /// Where the pairs are whose numbers are those of a pair to within half a class or more.
    fn of(&self, [a, b]: &[Oriented; 2]) -> Vec<Range<usize>> {
        let Some(numbers) = numbers(a, b, self.widest) else { return Vec::new() };
        let part = |corner: u32| {
            let classes: [f64; 4] =
                std::array::from_fn(|k| (numbers[k] - 0.5).floor() + f64::from(corner >> k & 1));
            if classes.iter().any(|c| *c < 0.0) {
                return None;
            }
            let class = class(classes.map(|c| c as u32));
            let from = self.pairs.partition_point(|(other, _)| *other < class);
            let count = self.pairs[from..].partition_point(|(other, _)| *other == class);
            (count > 0).then_some(from..from + count)
        };
        (0..16).filter_map(part).collect()
    }
}

/// Distance and angles of a pair, in classes.
fn numbers(a: &Oriented, b: &Oriented, widest: f64) -> Option<[f64; 4]> {
    let line = b.place - a.place;
    let distance = line.norm();
    let line = line.try_normalize(0.0)?;
    let angle = |u: &Vector3<f64>, v: &Vector3<f64>| {
        (u.dot(v).clamp(-1.0, 1.0).acos() / std::f64::consts::PI * ANGLES).min(ANGLES - 1e-9)
    };
    Some([
        distance / widest * DISTANCES,
        angle(&a.normal, &line),
        angle(&b.normal, &line),
        angle(&a.normal, &b.normal),
    ])
}

fn class([d, a, b, c]: [u32; 4]) -> u32 {
    ((d * 32 + a) * 32 + b) * 32 + c
}

/// Poses on trial, and those that did best.
struct Trial<'a> {
    target: &'a Target<'a, 'a>,
    samples: &'a Samples,
    few: Vec<&'a Sample>,
    /// Still to be tried, together and on several threads.
    waiting: Vec<Isometry3<f64>>,
    /// By cost.
    kept: Vec<(f64, Isometry3<f64>)>,
    /// Costs of the worst pose that is sure to be looked at further.
    bar: f64,
}

/// Poses that are tried together, each against the bar that the last ones set.
const TOGETHER: usize = 128;
/// Poses that are kept.
const KEPT: usize = 300;
/// A bar below which no pose is better than those that are kept: the form looks the same wherever it is laid.
const ALL_ALIKE: f64 = 0.01;

impl<'a> Trial<'a> {
    fn new(samples: &'a Samples, target: &'a Target<'a, 'a>, random: &mut Random) -> Self {
        let few = (0..TRIED).map(|_| &samples.points[random.below(samples.points.len())]).collect();
        let (waiting, kept) = (Vec::with_capacity(TOGETHER), Vec::new());
        Self { target, samples, few, waiting, kept, bar: 1.0 }
    }

    fn take(&mut self, pose: Isometry3<f64>) {
        self.waiting.push(pose);
        if self.waiting.len() == TOGETHER {
            self.try_waiting();
        }
    }

    fn is_over(&self) -> bool {
        self.bar < ALL_ALIKE
    }

    fn try_waiting(&mut self) {
        /// A pose is given up where its first points cost more than the bar by this, two sigmas of their mean.
        const SLACK: f64 = 0.2;
        let cost = |pose: &Isometry3<f64>, points: &[&Sample]| {
            let known = &mut vec![Known::default(); points.len()];
            let costs = self.target.costs(points, pose, ROUGH * self.samples.radius, known);
            costs.iter().sum::<f64>() / costs.len() as f64
        };
        let tried = |pose: &Isometry3<f64>| {
            (cost(pose, &self.few[..FIRST]) <= self.bar + SLACK).then(|| (cost(pose, &self.few), *pose))
        };
        let tried: Vec<Option<(f64, Isometry3<f64>)>> = self.waiting.par_iter().map(tried).collect();
        self.waiting.clear();
        for (cost, pose) in tried.into_iter().flatten() {
            if cost < self.bar || self.kept.len() < KEPT {
                self.kept.push((cost, pose));
                if self.kept.len() >= 2 * KEPT {
                    self.kept.sort_by(|a, b| a.0.total_cmp(&b.0));
                    self.kept.truncate(KEPT);
                    self.bar = self.kept[KEPT - 1].0;
                }
            }
        }
    }

    fn best(mut self, most: usize) -> Vec<Isometry3<f64>> {
        self.try_waiting();
        self.kept.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut chosen: Vec<Isometry3<f64>> = Vec::new();
        for (_, pose) in &self.kept {
            if chosen.len() == most {
                break;
            }
            let (middle, radius) = (&self.samples.middle, self.samples.radius);
            if chosen.iter().all(|other| apart(pose, other, middle, radius) > SAME_POSE * radius) {
                chosen.push(*pose);
            }
        }
        chosen
    }
}

/// How far two poses bring a ball about the cloud's middle apart at most, about, mm.
pub(super) fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>, middle: &Vector3<f64>, radius: f64) -> f64 {
    let shift = (a * nalgebra::Point3::from(*middle) - b * nalgebra::Point3::from(*middle)).norm();
    shift + a.rotation.angle_to(&b.rotation) * radius
}

/// Middles and principal axes brought together every way round: right where the cloud shows the whole mesh.
fn axes_onto_axes(samples: &Samples, mesh: &TriangleMesh) -> Vec<Isometry3<f64>> {
    let (middle, own) = axes(samples.points.iter().map(|s| (s.place, 1.0)));
    let own = Matrix3::from_columns(&[own[0], own[1], own[0].cross(&own[1])]);
    let triangles = (0..mesh.triangles().len()).map(|t| {
        let [a, b, c] = mesh.corners(t);
        ((a + b + c) / 3.0, mesh.area_vector(t).norm())
    });
    let theirs = axes(triangles);
    let orders = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
    let turned = |[i, j, k]: [usize; 3], flip: usize| {
        let sign = |bit: usize| if flip >> bit & 1 == 1 { -1.0 } else { 1.0 };
        let (x, y, z) = (theirs.1[i] * sign(0), theirs.1[j] * sign(1), theirs.1[k]);
        let z = if x.cross(&y).dot(&z) < 0.0 { -z } else { z };
        let rotation = Matrix3::from_columns(&[x, y, z]) * own.transpose();
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        Isometry3::from_parts((theirs.0 - rotation * middle).into(), rotation)
    };
    orders
        .into_iter()
        .flat_map(|order| (0..4).map(move |flip| (order, flip)))
        .map(|(o, f)| turned(o, f))
        .collect()
}

/// The weighted middle of points and their principal axes, the longest first.
fn axes(points: impl Iterator<Item = (Vector3<f64>, f64)> + Clone) -> (Vector3<f64>, [Vector3<f64>; 3]) {
    let (sum, weight) =
        points.clone().fold((Vector3::zeros(), 0.0), |(s, w), (p, own)| (s + p * own, w + own));
    let middle = sum / weight;
    let spread =
        points.fold(Matrix3::zeros(), |s, (p, own)| s + (p - middle) * (p - middle).transpose() * own);
    let eigen = spread.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    (middle, order.map(|k| eigen.eigenvectors.column(k).into_owned()))
}
