//! A start that most of the points may contradict: the best of many shapes through random minimal samples.

use crate::fit::{Surface, refine};
use crate::robust::{Random, ranked};
use crate::sample::{Observations, Sample};
use nalgebra::Vector3;

/// A share of the points, beyond those that any shape passes through, and Φ⁻¹ at (1 + share) / 2: the residual that so many of a
/// Gaussian stay below, in sigmas.
#[derive(Clone, Copy)]
struct Share {
    of_points: f64,
    quantile: f64,
}

/// What has to agree with the start: up to seven tenths may be outliers.
const AGREEING: Share = Share { of_points: 0.3, quantile: 0.385_320_466 };

/// What has to agree where three tenths do exactly.
const MAJORITY: Share = Share { of_points: 0.55, quantile: 0.755_415_026 };

/// Scatter in units of the coordinates' rounding up to which a fit is exact.
const EXACT: f64 = 4.0;

/// Samples tried. With seven tenths outliers one in 120 samples of four is sound; five of 600 are on average.
const TRIALS: usize = 600;

/// Points that hypotheses are compared on: the rank of a residual among so many is known to 2 %.
const COMPARED: usize = 500;

/// Concentration steps after the best sample (P. Rousseeuw, K. van Driessen, Technometrics 41 (1999) 212).
const CONCENTRATIONS: usize = 10;

/// Points that they are made on: a quantile of so many is known to 2 %.
const CONCENTRATED: usize = 4000;

/// A shape to begin with and the orthogonal scatter of the points about it, mm (rather too large than too small).
pub(crate) struct Start<S> {
    /// The shape.
    pub(crate) surface: S,
    /// Scatter of its points, mm.
    pub(crate) scatter_mm: f64,
}

/// How starts are searched.
#[derive(Clone, Copy)]
pub(crate) struct Search {
    /// Points of a minimal sample.
    pub(crate) size: usize,
    /// Best samples that are improved by concentration, to take the best of those.
    pub(crate) starts: usize,
    /// Seed of the samples.
    pub(crate) seed: u64,
}

/// Returns the shape with the smallest 30 % quantile of orthogonal distances (least quantile of squares, Rousseeuw
/// 1984), out of shapes through random samples, improved by concentration; `None` where no sample gives a shape.
///
/// It needs no scale. Judged by three tenths of the points it stands seven tenths of outliers. `through` returns the
/// shapes through a minimal sample, given by the positions of its points in the sample.
///
/// Coordinates that stand on a grid lie on shapes exactly by chance, in groups: an exact fit says nothing of the others'
/// scatter. One is believed of a majority only, or else the shape is judged by a majority's quantile.
pub(crate) fn consensus<S: Surface<P>, const P: usize>(
    sample: &Sample<'_>,
    search: Search,
    through: impl Fn(&[usize]) -> Vec<S>,
) -> Option<Start<S>> {
    let start = judged_by(sample, search, AGREEING, &through)?;
    if start.scatter_mm > EXACT * sample.resolution_mm {
        return Some(start);
    }
    let exact = |point: &&Vector3<f64>| start.surface.distance(point).abs() <= sample.resolution_mm;
    let agreeing = sample.observations.points.iter().filter(exact).count().saturating_sub(P);
    if 2 * agreeing > sample.observations.len().saturating_sub(P) {
        return Some(start);
    }
    judged_by(sample, search, MAJORITY, &through)
}

/// Returns the start of least quantile at a share of the points.
fn judged_by<S: Surface<P>, const P: usize>(
    sample: &Sample<'_>,
    search: Search,
    share: Share,
    through: &impl Fn(&[usize]) -> Vec<S>,
) -> Option<Start<S>> {
    let points = &sample.observations.points;
    let mut random = Random::new(search.seed);
    let agreeing = |count: usize| {
        let excess = count.saturating_sub(P);
        P + ((excess as f64 * share.of_points).ceil() as usize).max(excess.min(1))
    };
    let compared: Vec<Vector3<f64>> = if points.len() <= COMPARED {
        points.clone()
    } else {
        (0..COMPARED).map(|_| points[random.below(points.len())]).collect()
    };
    let rank = agreeing(compared.len()).clamp(1, compared.len().max(1)) - 1;
    let mut distances = vec![0.0; compared.len()];
    let mut quantile = |surface: &S, limit: f64| {
        for (distance, point) in distances.iter_mut().zip(&compared) {
            *distance = surface.distance(point).abs();
        }
        // Most are worse than what there is, which is sooner counted than the quantile found.
        let better = distances.iter().filter(|distance| **distance < limit).count();
        (better > rank).then(|| ranked(&mut distances, rank)).flatten()
    };
    let mut best: Vec<(f64, S)> = Vec::new();
    for _ in 0..TRIALS {
        let minimal: Vec<usize> = (0..search.size).map(|_| random.below(points.len())).collect();
        for surface in through(&minimal) {
            let limit = best.get(search.starts - 1).map_or(f64::INFINITY, |(worst, _)| *worst);
            let Some(q) = quantile(&surface, limit) else { continue };
            let place = best.partition_point(|(other, _)| *other <= q);
            best.insert(place, (q, surface));
            best.truncate(search.starts);
        }
    }
    // Of many points some are enough: the fit that follows has all of them.
    let step = points.len().div_ceil(CONCENTRATED).max(1);
    let some = Observations::bare(points.iter().step_by(step).copied().collect());
    let count = agreeing(some.len()).min(some.len());
    let concentrated =
        best.into_iter().filter_map(|(_, surface)| concentrate(&some, surface, count, sample.resolution_mm));
    let (scatter_mm, surface) = concentrated.min_by(|a, b| a.0.total_cmp(&b.0))?;
    // With few points the sample passes through most of those that agree; Rousseeuw's 1 + 5/(n − p) makes up for it.
    let spare = points.len().saturating_sub(P).max(1) as f64;
    Some(Start { surface, scatter_mm: scatter_mm / share.quantile * (1.0 + 5.0 / spare) })
}

/// Returns the shape fitted again and again to the `count` points nearest to it, and the distance of the farthest of them.
fn concentrate<S: Surface<P>, const P: usize>(
    bare: &Observations,
    start: S,
    count: usize,
    resolution_mm: f64,
) -> Option<(f64, S)> {
    let mut surface = start.clone();
    let mut scatter_mm = f64::INFINITY;
    let mut candidate = start;
    for _ in 0..CONCENTRATIONS {
        let mut nearest: Vec<(f64, usize)> =
            bare.points.iter().enumerate().map(|(i, p)| (candidate.distance(p).abs(), i)).collect();
        let (_, last, _) = nearest.select_nth_unstable_by(count.checked_sub(1)?, |a, b| a.0.total_cmp(&b.0));
        if last.0 >= scatter_mm {
            break;
        }
        scatter_mm = last.0;
        let sound: Vec<usize> = nearest[..count].iter().map(|&(_, i)| i).collect();
        surface = candidate;
        match refine(surface.clone(), bare, &sound, 1.0, resolution_mm) {
            Some(refined) => candidate = refined,
            None => break,
        }
    }
    Some((scatter_mm, surface))
}
