//! From a start to the pose of least squares beside it.

use super::certainty::{bent, followed, form_inverse, patches};
use super::sample::{Match, Sample, TUKEY, Target};
use super::sweep::Known;
use crate::robust::{median, scale_about_zero};
use nalgebra::{DMatrix, Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6};

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
/// What is left to be won where a pose is a thirtieth of its sigma from where it is going: half its square.
pub(super) const NOTHING_LEFT: f64 = 1e-3;

/// A pose that came to rest, or ran out of rounds.
pub(super) struct Fitted {
    pub(super) pose: Isometry3<f64>,
    /// Of a small motion: turn about the moved middle in units of the radius, then shift, mm⁻².
    pub(super) information: Matrix6<f64>,
    /// Scatter of the normal equations' gradient, mm⁻², errors that neighbours share among it.
    scatter: Matrix6<f64>,
    /// As the information, of products of the two surfaces' normals.
    products: Matrix6<f64>,
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
        products: Matrix6::zeros(),
        floor: 0.0,
        rms: f64::INFINITY,
        rounds: 0,
    };
    let mut reach = bounds.reach;
    let mut matches = Vec::new();
    let mut known = vec![Known::default(); points.len()];
    for round in 1..=bounds.rounds {
        matches = target.matches(points, &fitted.pose, reach, &mut known);
        matches.retain(|m| m.facing > SAME_FACE);
        fitted.rounds = round;
        if matches.len() < 6 {
            fitted.rms = f64::INFINITY;
            return fitted;
        }
        let told = median(&mut matches.iter().map(|m| m.told).collect::<Vec<_>>());
        let scatter = scale_about_zero(matches.iter().map(|m| m.residual));
        let floor2 = (scatter * scatter - told).max(0.0).max((ROUNDING * radius).powi(2));
        fitted.floor = floor2.sqrt();
        let gradient = fitted.weigh(&matches, floor2, radius);
        let (mut step, left) = damped_step(&fitted.information, &gradient);
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
        let rests = step.norm() < SETTLED * noise + NO_STEP * radius || left < NOTHING_LEFT;
        let settled = rests && next > 0.9 * reach;
        reach = next.max(0.5 * reach);
        if settled {
            break;
        }
    }
    (fitted.scatter, fitted.products) = certainty(&matches, fitted.floor * fitted.floor, radius);
    fitted
}

impl Fitted {
    /// Takes the normal equations of some matches with Tukey's weights, and returns their gradient.
    fn weigh(&mut self, matches: &[Match], floor2: f64, radius: f64) -> Vector6<f64> {
        let (mut gradient, mut sum, mut count) = (Vector6::zeros(), 0.0, 0.0);
        self.information = Matrix6::zeros();
        for m in matches {
            let Some(weight) = m.weight(floor2) else { continue };
            let row = m.row(radius);
            gradient += row * (weight * m.residual);
            self.information += row * row.transpose() * weight;
            sum += m.residual * m.residual;
            count += 1.0;
        }
        self.rms = (sum / f64::max(count, 1.0)).sqrt();
        gradient
    }

    /// Returns the covariance of a small motion in the units of [`Fitted::information`]; along `unknown` motions, and others that
    /// nothing is known of, that of a motion by `anything`.
    pub(super) fn covariance(&self, unknown: &[Vector6<f64>], anything: f64) -> Matrix6<f64> {
        let dynamic = |matrix: &Matrix6<f64>| DMatrix::from_column_slice(6, 6, matrix.as_slice());
        let inverse = form_inverse(&dynamic(&self.information), &dynamic(&self.products));
        let inverse = Matrix6::from_column_slice(inverse.as_slice());
        let mut keep = Matrix6::identity();
        for way in unknown {
            keep -= way * way.transpose();
        }
        let known = keep * inverse * self.scatter * inverse * keep;
        known + (Matrix6::identity() - keep) * (anything * anything)
    }
}

/// Returns the scatter of the gradient of some matches, from that of patches of them, and the information of their normals' products.
fn certainty(matches: &[Match], floor2: f64, radius: f64) -> (Matrix6<f64>, Matrix6<f64>) {
    let weighed: Vec<(&Match, f64)> = matches.iter().filter_map(|m| Some((m, m.weight(floor2)?))).collect();
    let places: Vec<Vector3<f64>> = weighed.iter().map(|(m, _)| m.arm).collect();
    // Moved points are finite, and fewer than fit into a tree.
    let patches = patches(&places).unwrap_or_default();
    let mut scatter = Matrix6::zeros();
    for patch in &patches {
        let pulls = patch.iter().map(|&at| weighed[at]).map(|(m, w)| m.row(radius) * (w * m.residual));
        let sum: Vector6<f64> = pulls.sum();
        scatter += sum * sum.transpose();
    }
    let products = weighed.iter().map(|(m, weight)| m.product(radius) * *weight).sum();
    (scatter * (followed(patches.len(), 6) / bent(matches, floor2).powi(2)), products)
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

/// Returns a step, and what one without damping would win.
fn damped_step(information: &Matrix6<f64>, gradient: &Vector6<f64>) -> (Vector6<f64>, f64) {
    let eigen = information.symmetric_eigen();
    let most = eigen.eigenvalues.max();
    let (mut step, mut left) = (Vector6::zeros(), 0.0);
    for (value, way) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > 1e-9 * most {
            let along = way.dot(gradient);
            step -= way * (along / (value + DAMPING * most));
            left += along * along / value;
        }
    }
    (step, left)
}
