//! Which triangles of the plane are surface, and which only span what was not seen.

use super::delaunay::{Flat, circle};
use super::normals::{Facing, Incident, one_sided};
use crate::cloud::{PointCloud, unpacked};
use crate::robust::{median, rejection_limit, scale_about_zero};
use nalgebra::Vector3;

/// Chance that points thrown at random with a scan's density leave as large a void anywhere in it.
const CHANCE_OF_A_VOID: f64 = 0.01;

/// A circumcircle's squared radius over twice its triangle's area from which on the triangle is a sliver. In a grid whose spacings
/// differ tenfold it is 2.5.
const SLIVER: f64 = 4.0;

/// Median over mean of the areas of Delaunay's triangles of points thrown at random, slivers aside (by simulation).
const MEDIAN_OF_MEAN: f64 = 0.77;

/// Sine of the angle by which an edge has to leave the surface at both of its ends to be a step rather than a bend: 22.5°,
/// which is what a fold of a right angle comes to that a point lies in.
const STEP_SIN: f64 = 0.382_683_432_365_089_8;

/// Rounds of cutting steps: each has normals from what the one before left.
const STEP_ROUNDS: usize = 3;

/// Why triangles were left out, and how many.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Cut {
    /// They span a void: an empty circle that the density of points about it does not explain.
    pub voids: usize,
    /// They stand along the line of sight or along the laser's light, as the border of an occlusion does and no surface that was
    /// measured.
    pub grazing: usize,
    /// They lead from one face to another across a step in depth.
    pub steps: usize,
}

/// A cloud's errors of measurement.
struct Noise<'a> {
    covariances: Option<&'a [[f32; 6]]>,
    sigmas: Option<&'a [f32]>,
}

impl<'a> Noise<'a> {
    fn of(cloud: &'a PointCloud) -> Self {
        let told = cloud.covariances_mm2().filter(|all| all.iter().flatten().any(|&c| c != 0.0));
        Self { covariances: told, sigmas: cloud.sigmas_mm() }
    }

    /// Variance of a point's position along a direction, mm²; nil where the cloud does not tell.
    fn along(&self, point: u32, direction: &Vector3<f64>) -> f64 {
        match (self.covariances, self.sigmas) {
            (Some(all), _) => {
                let [xx, xy, xz, yy, yz, zz] = all[point as usize].map(f64::from);
                let d = direction;
                let mixed = xy * d.x * d.y + xz * d.x * d.z + yz * d.y * d.z;
                (xx * d.x * d.x + yy * d.y * d.y + zz * d.z * d.z + 2.0 * mixed).max(0.0)
            }
            (None, Some(sigmas)) => f64::from(sigmas[point as usize]).powi(2),
            (None, None) => 0.0,
        }
    }

    /// The direction that a point is least certain along: that of the laser's light, on which its stripe shifts it.
    fn light(&self, point: u32) -> Option<Vector3<f64>> {
        let matrix = unpacked(&self.covariances?[point as usize]);
        // Power iteration from the column of the largest variance: a scanner's covariance is all but of rank one.
        let mut axis = matrix.column(matrix.diagonal().imax()).into_owned();
        for _ in 0..4 {
            axis = matrix * axis.try_normalize(0.0)?;
        }
        axis.try_normalize(0.0)
    }
}

/// Returns which triangles are surface, and how many of the others there are.
pub(super) fn cut(
    cloud: &PointCloud,
    places: &[[f64; 2]],
    flat: &Flat,
    sensor_mm: Vector3<f64>,
    steepest_rad: f64,
) -> (Vec<bool>, Cut) {
    let incident = Incident::new(&flat.triangles, places.len());
    let noise = Noise::of(cloud);
    let mut cut = Cut::default();
    let mut kept = without_voids(places, flat, &incident);
    cut.voids = kept.iter().filter(|kept| !**kept).count();
    let normals = normals_to(cloud, flat, sensor_mm, &mut kept);
    let grazing = steepest_rad.cos();
    let limit = rejection_limit(flat.triangles.len());
    for (t, corners) in flat.triangles.iter().enumerate().filter(|(t, _)| kept[*t]).collect::<Vec<_>>() {
        let corner = corners.map(|v| cloud.vector(v as usize));
        let view = (sensor_mm - (corner[0] + corner[1] + corner[2]) / 3.0).try_normalize(0.0);
        let light = noise.light(corners[0]);
        // A small triangle that its points' noise has tipped over is no occlusion: it has to reach farther than that.
        let stands = |ray: &Vector3<f64>| {
            normals[t].dot(ray).abs() < grazing && {
                let depth = corner.map(|p| p.dot(ray));
                let reach = depth.iter().fold(f64::MIN, |a, b| a.max(*b))
                    - depth.iter().fold(f64::MAX, |a, b| a.min(*b));
                let variance: f64 = corners.iter().map(|&v| noise.along(v, ray)).sum();
                reach > limit * variance.sqrt()
            }
        };
        if [view, light].iter().flatten().any(stands) {
            kept[t] = false;
            cut.grazing += 1;
        }
    }
    for _ in 0..STEP_ROUNDS {
        let steps = cut_steps(cloud, flat, &incident, &normals, &noise, &mut kept);
        cut.steps += steps;
        if steps == 0 {
            break;
        }
    }
    (kept, cut)
}

/// Leaves out triangles whose empty circle is larger than chance explains: of n points thrown at random with density ρ, none is in a
/// given circle of radius R with probability exp(−π ρ R²), and there are 2 n circles. The density is the middle one of those
/// about its corners: the plane's area that falls to a point is twice the median area of the triangles there, and the median of that
/// over the corner's neighbours. Slivers, which border the whole, tell nothing of it.
fn without_voids(places: &[[f64; 2]], flat: &Flat, incident: &Incident) -> Vec<bool> {
    let of = |corners: &[u32; 3]| circle(corners.map(|v| places[v as usize]));
    let circles: Vec<(f64, f64)> = flat.triangles.iter().map(of).collect();
    let mut values = Vec::new();
    let share: Vec<f64> = (0..places.len() as u32)
        .map(|v| {
            let about = || incident.of(v).iter().map(|&t| circles[t as usize]);
            values.clear();
            values
                .extend(about().filter(|(radius2, twice)| *radius2 < SLIVER * twice).map(|(_, twice)| twice));
            if values.is_empty() { f64::INFINITY } else { median(&mut values) / MEDIAN_OF_MEAN }
        })
        .collect();
    let about: Vec<f64> = (0..places.len() as u32)
        .map(|v| {
            values.clear();
            // Every neighbour comes twice, the vertex itself as often as it has triangles.
            let near = incident.of(v).iter().flat_map(|&t| flat.triangles[t as usize]);
            values.extend(near.map(|w| share[w as usize]).filter(|share| share.is_finite()));
            if values.is_empty() { f64::INFINITY } else { median(&mut values) }
        })
        .collect();
    let largest = (circles.len() as f64 / CHANCE_OF_A_VOID).ln();
    let explained = |(corners, (radius2, _)): (&[u32; 3], &(f64, f64))| {
        let mut three = corners.map(|v| about[v as usize]);
        three.sort_by(f64::total_cmp);
        // Of two that are known, the denser one.
        let least = if three[2].is_finite() { three[1] } else { three[0] };
        std::f64::consts::PI * radius2 <= largest * least && least.is_finite()
    };
    flat.triangles.iter().zip(&circles).map(explained).collect()
}

/// Unit normals of the triangles in space, all on the side of the sensor as the plane's order of corners has it; those without an
/// area are left out.
fn normals_to(
    cloud: &PointCloud,
    flat: &Flat,
    sensor_mm: Vector3<f64>,
    kept: &mut [bool],
) -> Vec<Vector3<f64>> {
    let mut towards = 0_i64;
    let mut normals: Vec<Vector3<f64>> = flat
        .triangles
        .iter()
        .zip(kept)
        .map(|(corners, kept)| {
            let [a, b, c] = corners.map(|v| cloud.vector(v as usize));
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) else {
                *kept = false;
                return Vector3::zeros();
            };
            if *kept {
                towards += if normal.dot(&(sensor_mm - a)) < 0.0 { -1 } else { 1 };
            }
            normal
        })
        .collect();
    if towards < 0 {
        normals.iter_mut().for_each(|normal| *normal = -*normal);
    }
    normals
}

/// Cuts the triangles that have a step for an edge, and returns how many.
///
/// Along a step the edge from a to b leaves a's face on one side and b's on the other: with the faces' normals m and n, m·e and
/// n·e have the same sign and are both large. On a bend they have opposite signs, on a fold one of them is small, and along
/// an arc (m + n)·e vanishes. So s = (m + n)·e / |m + n| is the step's height, and in a surface that only bends it is noise: of
/// the two points, as the cloud tells and as it shows beyond that, and of the normals.
fn cut_steps(
    cloud: &PointCloud,
    flat: &Flat,
    incident: &Incident,
    normals: &[Vector3<f64>],
    noise: &Noise<'_>,
    kept: &mut [bool],
) -> usize {
    let faces = one_sided(flat, incident, normals, kept, cloud.len());
    let heights = |a: u32, b: u32| {
        let (m, n) = (faces[a as usize]?, faces[b as usize]?);
        let edge = cloud.vector(b as usize) - cloud.vector(a as usize);
        let middle = (m.normal + n.normal).try_normalize(0.0)?;
        let bend = m.variance + n.variance;
        let (m, n) = (m.normal, n.normal);
        let (leaves, meets) = (m.dot(&edge), n.dot(&edge));
        // Both ends' normals are noisier than their mean.
        let least = middle.dot(&edge).abs().min(2.0 * leaves.abs().min(meets.abs()));
        let same_side = leaves * meets > 0.0;
        let variance = noise.along(a, &middle) + noise.along(b, &middle) + 0.25 * bend * edge.norm_squared();
        Some((middle.dot(&edge), variance, same_side && least > STEP_SIN * edge.norm()))
    };
    let untold = untold_variance(cloud, flat, incident, &faces, noise, kept);
    let mut edges = 0;
    let mut suspects = Vec::new();
    for (t, corners) in flat.triangles.iter().enumerate().filter(|(t, _)| kept[*t]) {
        for k in 0..3 {
            let Some((height, variance, steep)) = heights(corners[k], corners[(k + 1) % 3]) else {
                continue;
            };
            edges += 1;
            if steep {
                suspects.push((t, height * height / (variance + 2.0 * untold)));
            }
        }
    }
    let limit = rejection_limit(edges);
    let mut steps = 0;
    for (t, chi2) in suspects {
        if chi2 > limit * limit && kept[t] {
            kept[t] = false;
            steps += 1;
        }
    }
    steps
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
