//! A start that most of the points may contradict: the best of many shapes through random minimal samples.

use crate::fit::{Surface, refine};
use crate::robust::{Random, ranked};
use crate::sample::Sample;
use nalgebra::Vector3;

/// Share of the points, beyond those that any shape passes through, that has to agree with the start: up to seven
/// tenths may be outliers.
const AGREEING_SHARE: f64 = 0.3;

/// Samples tried. With seven tenths outliers one in 120 samples of four is sound; five of 600 are on average.
const TRIALS: usize = 600;

/// Points that hypotheses are compared on: the rank of a residual among so many is known to 2 %.
const COMPARED: usize = 500;

/// Concentration steps after the best sample (P. Rousseeuw, K. van Driessen, Technometrics 41 (1999) 212).
const CONCENTRATIONS: usize = 10;

/// Φ⁻¹ at (1 + 0.3) / 2: the residual that three tenths of a Gaussian stay below, in sigmas.
const AGREEING_QUANTILE: f64 = 0.385_320_466;

/// A shape to begin with and the orthogonal scatter of the points about it, mm (rather too large than too small).
pub(crate) struct Start<S> {
    /// The shape.
    pub(crate) surface: S,
    /// Scatter of its points, mm.
    pub(crate) scatter_mm: f64,
}

/// Returns the shape with the smallest 30 % quantile of orthogonal distances (least quantile of squares, Rousseeuw
/// 1984), out of shapes through random samples, improved by concentration; `None` where no sample gives a shape.
///
/// It needs no scale. Judged by three tenths of the points it stands seven tenths of outliers. `through` returns the
/// shapes through a minimal sample of `size` points.
pub(crate) fn consensus<S: Surface<P>, const P: usize>(
    sample: &Sample,
    size: usize,
    seed: u64,
    through: impl Fn(&[Vector3<f64>]) -> Vec<S>,
) -> Option<Start<S>> {
    let observations = &sample.observations;
    let mut random = Random::new(seed);
    let agreeing = |count: usize| {
        let excess = count.saturating_sub(P);
        P + ((excess as f64 * AGREEING_SHARE).ceil() as usize).max(excess.min(1))
    };
    let compared: Vec<Vector3<f64>> = if observations.len() <= COMPARED {
        observations.iter().map(|o| o.point).collect()
    } else {
        (0..COMPARED).map(|_| observations[random.below(observations.len())].point).collect()
    };
    let rank = agreeing(compared.len()).clamp(1, compared.len().max(1)) - 1;
    let mut distances = vec![0.0; compared.len()];
    let mut quantile = |surface: &S| {
        for (distance, point) in distances.iter_mut().zip(&compared) {
            *distance = surface.distance(point).abs();
        }
        ranked(&mut distances, rank).filter(|q| q.is_finite())
    };
    let mut best: Option<(f64, S)> = None;
    for _ in 0..TRIALS {
        let minimal: Vec<_> = (0..size)
            .filter_map(|_| observations.get(random.below(observations.len())))
            .map(|o| o.point)
            .collect();
        for surface in through(&minimal) {
            if let Some(q) = quantile(&surface)
                && best.as_ref().is_none_or(|(least, _)| q < *least)
            {
                best = Some((q, surface));
            }
        }
    }
    let (_, mut surface) = best?;
    let count = agreeing(observations.len()).min(observations.len());
    let mut scatter_mm = f64::INFINITY;
    let mut candidate = surface.clone();
    for _ in 0..CONCENTRATIONS {
        let mut nearest: Vec<(f64, usize)> =
            observations.iter().enumerate().map(|(i, o)| (candidate.distance(&o.point).abs(), i)).collect();
        let (_, last, _) = nearest.select_nth_unstable_by(count.checked_sub(1)?, |a, b| a.0.total_cmp(&b.0));
        if last.0 >= scatter_mm {
            break;
        }
        scatter_mm = last.0;
        let sound: Vec<_> = nearest[..count].iter().map(|&(_, i)| observations[i].bare()).collect();
        surface = candidate;
        match refine(surface.clone(), &sound.iter().collect::<Vec<_>>(), 1.0, sample.resolution_mm) {
            Some(refined) => candidate = refined,
            None => break,
        }
    }
    // With few points the sample passes through most of those that agree; Rousseeuw's 1 + 5/(n − p) makes up for it.
    let spare = observations.len().saturating_sub(P).max(1) as f64;
    Some(Start { surface, scatter_mm: scatter_mm / AGREEING_QUANTILE * (1.0 + 5.0 / spare) })
}
