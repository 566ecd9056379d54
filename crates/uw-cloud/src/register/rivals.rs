//! Whether another pose fits as well: then the one that was found is one of several, or a place on a path of them.

use super::refine::{Bounds, Fitted, moved, refine};
use super::sample::{Sample, Samples, TUKEY, Target};
use super::starts::{SAME_POSE, apart};
use super::sweep::Known;
use nalgebra::{Isometry3, Matrix6, Point3, Vector3, Vector6};
use std::cell::LazyCell;

/// Patches of a cloud whose deviations have to do with each other no more: what two poses differ by is tested with no more of them,
/// however many points there are.
const PATCHES: f64 = 200.0;
/// Standard errors that tell a worse pose from an equal one.
const WORSE: f64 = 3.0;
/// Mean cost that no pose is preferred for.
const NO_MATTER: f64 = 0.005;
/// Points that poses are compared by.
pub(super) const COMPARED: usize = 1500;
/// Points that tell a pose that fits by far worse, and by how much more than needed they have to tell it: the others are not asked then.
const FEW: usize = 150;
const BY_FAR: f64 = 2.0;
/// Displacements along a motion that are tried, in units of the cloud's radius.
const DISPLACED: [f64; 3] = [0.1, 0.05, 0.02];
/// A motion is known well without a trial where its information is at least this share of the best known one's.
const PLAIN: f64 = 0.2;

/// What poses are compared by: costs of the same points at the same scatter.
pub(super) struct Judge<'a, 'm> {
    pub(super) target: &'a Target<'a, 'm>,
    pub(super) points: Vec<&'a Sample>,
    pub(super) floor: f64,
    /// How far before a point, as seen from the sensor, the mesh must not stand, mm: else the point would not have been seen. `None` where nobody knows
    /// where the sensor was.
    pub(super) clear_mm: Option<f64>,
}

/// Scatters before a point that are its own surface's, and the share of the cloud's radius that a form may err by.
const CLEAR_SCATTERS: f64 = 10.0;
const CLEAR_SHARE: f64 = 0.02;

impl<'a, 'm> Judge<'a, 'm> {
    pub(super) fn new(samples: &'a Samples, target: &'a Target<'a, 'm>, points: usize, floor: f64) -> Self {
        // Of a sweep that was seen from its frame's origin.
        let clear_mm = samples.signed.then_some(CLEAR_SCATTERS * floor + CLEAR_SHARE * samples.radius);
        Self { target, points: samples.few(points), floor, clear_mm }
    }

    /// Returns one of fewer points.
    fn of_few(&self, points: usize) -> Self {
        let step = self.points.len().div_ceil(points).max(1);
        Self { points: self.points.iter().step_by(step).copied().collect(), ..*self }
    }

    pub(super) fn costs(&self, pose: &Isometry3<f64>) -> Vec<f64> {
        self.costs_of(pose, &mut vec![Known::default(); self.points.len()])
    }

    /// As [`Judge::costs`]; `known` is of the judge's points, from before.
    fn costs_of(&self, pose: &Isometry3<f64>, known: &mut [Known]) -> Vec<f64> {
        let mut costs = self.target.costs(&self.points, pose, self.floor, known);
        if let Some(clear_mm) = self.clear_mm {
            let sensor = pose.translation.vector;
            for (cost, sample) in costs.iter_mut().zip(&self.points) {
                let place = (pose * Point3::from(sample.place)).coords;
                let sight = place - sensor;
                let length = sight.norm();
                // What lies as near before a point may be the surface that it is of.
                if *cost < 1.0
                    && length > clear_mm
                    && self.target.faces().stands_between(&sensor, &(place - sight * (clear_mm / length)))
                {
                    *cost = 1.0;
                }
            }
        }
        costs
    }

    /// Whether a pose with some costs fits as well as one with others.
    pub(super) fn as_good(other: &[f64], best: &[f64]) -> bool {
        Self::worse(other, best) < 1.0
    }

    /// By how much a pose with some costs fits worse than one with others, in units of what tells them apart.
    fn worse(other: &[f64], best: &[f64]) -> f64 {
        let count = other.len() as f64;
        let differences = || other.iter().zip(best).map(|(o, b)| o - b);
        let mean = differences().sum::<f64>() / count;
        let variance = differences().map(|d| (d - mean).powi(2)).sum::<f64>() / count;
        mean / NO_MATTER.max(WORSE * (variance / count.min(PATCHES)).sqrt())
    }
}

/// Returns an orthonormal set of small motions (in the units of [`Fitted::information`]) along which the cloud can be displaced, and
/// fits as well.
pub(super) fn undetermined(
    samples: &Samples,
    judge: &Judge<'_, '_>,
    fitted: &Fitted,
    covariance: &Matrix6<f64>,
) -> Vec<Vector6<f64>> {
    let few = judge.of_few(FEW);
    let best = [&few, judge].map(|judge| LazyCell::new(|| judge.costs(&fitted.pose)));
    let eigen = fitted.information.symmetric_eigen();
    let most = eigen.eigenvalues.max();
    let free = |at: &usize| {
        let way: Vector6<f64> = eigen.eigenvectors.column(*at).into_owned();
        let value = eigen.eigenvalues[*at];
        if value <= 1e-9 * most {
            return true;
        }
        if value >= PLAIN * most {
            return false;
        }
        let sigma = way.dot(&(covariance * way)).sqrt();
        let as_good = |size: f64, side: f64| {
            let by = (size * samples.radius).max(5.0 * sigma);
            if by > 0.5 * samples.radius {
                return true;
            }
            // Held there: the facets of a mesh hold a smooth surface, too, but it costs next to nothing to pass over them.
            let from = moved(&fitted.pose, &samples.middle, samples.radius, &(way * (side * by)));
            let bounds = Bounds { reach: by + 3.0 * TUKEY * judge.floor, rounds: 12 };
            let worse = |judge: &Judge<'_, '_>, best: &[f64]| {
                let mut end = refine(judge.target, &judge.points, samples.radius, from, bounds, &[way]);
                Judge::worse(&judge.costs_of(&end.pose, &mut end.known), best)
            };
            worse(&few, &best[0]) < BY_FAR && worse(judge, &best[1]) < 1.0
        };
        DISPLACED.iter().all(|&size| as_good(size, 1.0) || as_good(size, -1.0))
    };
    (0..6).filter(free).map(|at| eigen.eigenvectors.column(at).into_owned()).collect()
}

/// Returns the poses among some that fit as well as the best one and are others, not counting those that undetermined motions lead to.
pub(super) fn rivals(
    samples: &Samples,
    judge: &Judge<'_, '_>,
    best: &Isometry3<f64>,
    others: &[Isometry3<f64>],
    free: &[Vector6<f64>],
) -> Vec<Isometry3<f64>> {
    let costs = LazyCell::new(|| judge.costs(best));
    let mut found: Vec<Isometry3<f64>> = Vec::new();
    for pose in others {
        let seen = std::iter::once(best).chain(&found).any(|other| {
            let mut way = motion(pose, other, samples);
            for free in free {
                way -= free * free.dot(&way);
            }
            apart(pose, other, &samples.middle, samples.radius) < SAME_POSE * samples.radius
                || way.norm() < SAME_POSE * samples.radius
        });
        if !seen && Judge::as_good(&judge.costs(pose), &costs) {
            found.push(*pose);
        }
    }
    found
}

/// Returns motions of what one pose has moved as ones of what another has: the same screws in space, about where that one brings the middle. Orthonormal, as they were.
pub(super) fn carried(
    motions: &[Vector6<f64>],
    from: &Isometry3<f64>,
    to: &Isometry3<f64>,
    samples: &Samples,
) -> Vec<Vector6<f64>> {
    let middle = Point3::from(samples.middle);
    let way = (to * middle - from * middle) / samples.radius;
    let mut all: Vec<Vector6<f64>> = Vec::new();
    for motion in motions {
        let turn = motion.fixed_rows::<3>(0).into_owned();
        let mut carried = *motion;
        let mut shift = carried.fixed_rows_mut::<3>(3);
        shift += turn.cross(&way);
        for other in &all {
            carried -= other * other.dot(&carried);
        }
        all.extend(carried.try_normalize(0.0));
    }
    all
}

/// The motion that leads from one pose to another along one screw: turn in units of the radius about where the second one brings the
/// cloud's middle, and shift, both at the start.
pub(super) fn motion(to: &Isometry3<f64>, from: &Isometry3<f64>, samples: &Samples) -> Vector6<f64> {
    let between = to * from.inverse();
    let middle = from * Point3::from(samples.middle);
    let shift = (between * middle) - middle;
    let turn = between.rotation.scaled_axis();
    let angle = turn.norm();
    // The inverse of the integral of the turn (R. Murray, Z. Li, S. Sastry, A Mathematical Introduction to Robotic Manipulation, 1994,
    // equation 2.36 and following).
    let part =
        if angle < 1e-6 { 1.0 / 12.0 } else { (1.0 - 0.5 * angle / (0.5 * angle).tan()) / (angle * angle) };
    let start: Vector3<f64> = shift - turn.cross(&shift) * 0.5 + turn.cross(&turn.cross(&shift)) * part;
    let turn = turn * samples.radius;
    Vector6::new(turn.x, turn.y, turn.z, start.x, start.y, start.z)
}
