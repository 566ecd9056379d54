//! From a start to the pose of least squares beside it.

use super::sample::{Match, Sample, TUKEY, Target};
use crate::robust::{median, scale_about_zero};
use nalgebra::{Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6};

/// Normals of a point and of its place on the mesh that differ by more than 80° belong to different faces.
const SAME_FACE: f64 = 0.17;
/// Added to each motion's information, as a share of the best known one's, so that what is hardly known makes no leaps.
const DAMPING: f64 = 1e-4;
/// The longest step, in units of the cloud's radius.
const LONGEST_STEP: f64 = 0.3;
/// The least scatter, in units of the cloud's radius: of numbers without noise.
const ROUNDING: f64 = 1e-9;

/// A step that is the last, in units of the points' noise (a pose from thousands of them is known to about a hundredth of it) and of the cloud's radius.
const SETTLED: f64 = 3e-4;
const NO_STEP: f64 = 1e-9;

/// A pose that came to rest, or ran out of rounds.
pub(super) struct Fitted {
    pub(super) pose: Isometry3<f64>,
    /// Of a small motion: turn about the moved middle in units of the radius, then shift, mm⁻².
    pub(super) information: Matrix6<f64>,
    /// Scatter of the normal equations' gradient, mm⁻².
    pub(super) scatter: Matrix6<f64>,
    /// What residuals scatter by beyond what points and mesh tell of, mm.
    pub(super) floor: f64,
    pub(super) rms: f64,
    pub(super) rounds: usize,
}

/// How far a search goes.
#[derive(Clone, Copy)]
pub(super) struct Bounds {
    /// Farthest place of the mesh that a point may belong to at first, mm.
    pub(super) reach: f64,
    pub(super) rounds: usize,
}

/// Returns the pose that iteratively reweighted least squares ends at. `frozen` are motions, in the units of
/// [`Fitted::information`] and orthonormal, that it makes no steps along.
pub(super) fn refine(
    target: &Target<'_, '_>,
    points: &[&Sample],
    radius: f64,
    start: Isometry3<f64>,
    bounds: Bounds,
    frozen: &[Vector6<f64>],
) -> Fitted {
    let mut fitted = Fitted {
        pose: start,
        information: Matrix6::zeros(),
        scatter: Matrix6::zeros(),
        floor: 0.0,
        rms: f64::INFINITY,
        rounds: 0,
    };
    let mut reach = bounds.reach;
    for round in 1..=bounds.rounds {
        let near = points.iter().filter_map(|p| target.matched(p, &fitted.pose, reach));
        let matches: Vec<Match> = near.filter(|m| m.facing > SAME_FACE).collect();
        fitted.rounds = round;
        if matches.len() < 6 {
            fitted.rms = f64::INFINITY;
            break;
        }
        let told = median(&mut matches.iter().map(|m| m.told).collect::<Vec<_>>());
        let scatter = scale_about_zero(matches.iter().map(|m| m.residual));
        let floor2 = (scatter * scatter - told).max(0.0).max((ROUNDING * radius).powi(2));
        fitted.floor = floor2.sqrt();
        let gradient = fitted.weigh(&matches, floor2, radius);
        let mut step = damped_step(&fitted.information, &gradient);
        for way in frozen {
            step -= way * way.dot(&step);
        }
        let longest = LONGEST_STEP * radius;
        if step.norm() > longest {
            step *= longest / step.norm();
        }
        fitted.pose = moved(&fitted.pose, &target.middle, radius, &step);
        // What is farther off than anything that has a say is looked for no more.
        let noise = (told + floor2).sqrt();
        let next = (3.0 * TUKEY * noise).min(reach);
        let settled = step.norm() < SETTLED * noise + NO_STEP * radius && next > 0.9 * reach;
        reach = next.max(0.5 * reach);
        if settled {
            break;
        }
    }
    fitted
}

impl Fitted {
    /// Takes the normal equations of some matches with Tukey's weights, and returns their gradient.
    fn weigh(&mut self, matches: &[Match], floor2: f64, radius: f64) -> Vector6<f64> {
        let (mut gradient, mut sum, mut count) = (Vector6::zeros(), 0.0, 0.0);
        let (mut weights, mut slopes) = (0.0, 0.0);
        (self.information, self.scatter) = (Matrix6::zeros(), Matrix6::zeros());
        for m in matches {
            let variance = m.told + floor2;
            let ratio = m.residual * m.residual / (variance * TUKEY * TUKEY);
            if ratio >= 1.0 {
                continue;
            }
            let weight = (1.0 - ratio).powi(2) / variance;
            // A turn by ω about the middle and a shift by t move the point by ω × arm + t.
            let turn = m.arm.cross(&m.normal) / radius;
            let row = Vector6::new(turn.x, turn.y, turn.z, m.normal.x, m.normal.y, m.normal.z);
            gradient += row * (weight * m.residual);
            self.information += row * row.transpose() * weight;
            self.scatter += row * row.transpose() * (weight * m.residual).powi(2);
            weights += weight;
            slopes += (1.0 - ratio) * (1.0 - 5.0 * ratio) / variance;
            sum += m.residual * m.residual;
            count += 1.0;
        }
        // The mean slope of the influence over the mean weight: what reweighting hides of the curvature (P. Huber, Robust
        // Statistics, 1981, section 7.6).
        let share = if weights > 0.0 { (slopes / weights).max(0.1) } else { 1.0 };
        self.scatter /= share * share;
        self.rms = (sum / f64::max(count, 1.0)).sqrt();
        gradient
    }

    /// Returns the covariance of a small motion in the units of [`Fitted::information`]; along `unknown` motions, and others that
    /// nothing is known of, that of a motion by `anything`.
    pub(super) fn covariance(&self, unknown: &[Vector6<f64>], anything: f64) -> Matrix6<f64> {
        let eigen = self.information.symmetric_eigen();
        let most = eigen.eigenvalues.max();
        let inverse = eigen.eigenvalues.map(|value| if value > 1e-9 * most { 1.0 / value } else { 0.0 });
        let pseudo = eigen.eigenvectors * Matrix6::from_diagonal(&inverse) * eigen.eigenvectors.transpose();
        let mut keep = Matrix6::identity();
        for way in unknown {
            keep -= way * way.transpose();
        }
        let known = keep * pseudo * self.scatter * pseudo * keep;
        known + (Matrix6::identity() - keep) * (anything * anything)
    }
}

/// Returns a pose followed by a small motion: a turn about the moved middle in units of the radius, and a shift.
pub(super) fn moved(
    pose: &Isometry3<f64>,
    middle: &Vector3<f64>,
    radius: f64,
    motion: &Vector6<f64>,
) -> Isometry3<f64> {
    let turn = Vector3::new(motion[0], motion[1], motion[2]) / radius;
    let shift = Vector3::new(motion[3], motion[4], motion[5]);
    let middle = (pose * Point3::from(*middle)).coords;
    Translation3::from(middle + shift) * UnitQuaternion::new(turn) * Translation3::from(-middle) * pose
}

fn damped_step(information: &Matrix6<f64>, gradient: &Vector6<f64>) -> Vector6<f64> {
    let eigen = information.symmetric_eigen();
    let most = eigen.eigenvalues.max();
    let mut step = Vector6::zeros();
    for (value, way) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > 1e-9 * most {
            step -= way * (way.dot(gradient) / (value + DAMPING * most));
        }
    }
    step
}
