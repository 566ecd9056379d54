//! From a start to the pose of least squares beside it.

use super::certainty::{bent, followed, form_inverse, patch_size};
use super::sample::{Match, Sample, TUKEY, Target};
use super::say::judge;
use super::sweep::Known;
use super::swing::Swing;
use nalgebra::{DMatrix, Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6};

/// Normals of a point and of its place on the mesh that differ by more than 80° belong to different faces.
const SAME_FACE: f64 = 0.17;
/// Added to each motion's information, as a share of the best known one's, so that what is hardly known makes no leaps.
const DAMPING: f64 = 1e-4;
/// Steps of reweighted least squares are short by what reweighting hides of the curvature. Twice as long they still lead downhill, as theirs is a bound of the true cost.
const LEAST_BENT: f64 = 0.5;
/// The longest step, in units of the cloud's radius.
const LONGEST_STEP: f64 = 0.3;
/// The least scatter, in units of the cloud's radius: of numbers without noise.
const ROUNDING: f64 = 1e-9;

/// How far off a point is still looked for, in units of the points' noise: thrice as far as what has a say.
pub(super) const FARTHEST: f64 = 3.0 * TUKEY;
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
    /// What residuals scatter by beyond what points and mesh tell of, mm.
    pub(super) floor: f64,
    pub(super) rms: f64,
    pub(super) rounds: usize,
    /// What the points belonged to.
    pub(super) known: Vec<Known>,
    matches: Vec<Match>,
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
        floor: 0.0,
        rms: f64::INFINITY,
        rounds: 0,
        known: vec![Known::default(); points.len()],
        matches: Vec::new(),
    };
    let (mut reach, mut left_before) = (bounds.reach, 0.0);
    let (mut swing, mut last) = (Swing::new(), Vector6::zeros());
    let keep = without(frozen);
    for round in 1..=bounds.rounds {
        let mut matches = std::mem::take(&mut fitted.matches);
        matches.clear();
        let found = target.matches(points, &fitted.pose, reach, &mut fitted.known);
        matches.extend(found.filter(|m| m.facing > SAME_FACE));
        fitted.rounds = round;
        if matches.len() < 6 {
            fitted.rms = f64::INFINITY;
            return fitted;
        }
        let (floor2, told) = judge(&mut matches, reach, (ROUNDING * radius).powi(2));
        fitted.floor = floor2.sqrt();
        let gradient = keep * fitted.weigh(&matches, radius);
        // Pulls are weighed by the noise, which falls while the search narrows down.
        let noise2 = told + floor2;
        let share = swing.share(gradient.dot(&last) * noise2);
        let (step, left) = damped_step(&(keep * fitted.information * keep), &gradient);
        let mut step = step / bent(&matches).max(LEAST_BENT);
        let longest = LONGEST_STEP * radius;
        if step.norm() > longest {
            step *= longest / step.norm();
        }
        swing.begin(gradient.dot(&step) * noise2);
        last = step;
        fitted.pose = moved(&fitted.pose, &target.middle, radius, &(share * step));
        // What is farther off than anything that has a say is looked for no more.
        let noise = noise2.sqrt();
        let next = (FARTHEST * noise).min(reach);
        // The step leaves as little of it as the one before left.
        let shrunk = if round > 1 { (left / left_before).min(1.0) } else { 1.0 };
        let rests = step.norm() < SETTLED * noise + NO_STEP * radius || left * shrunk < NOTHING_LEFT;
        left_before = left;
        let narrower = next <= 0.9 * reach;
        if narrower {
            // Other points pull, and otherwise.
            swing = Swing::new();
        }
        reach = next.max(0.5 * reach);
        fitted.matches = matches;
        if rests && !narrower {
            break;
        }
    }
    fitted
}

impl Fitted {
    /// Takes the normal equations of some matches, and returns their gradient.
    fn weigh(&mut self, matches: &[Match], radius: f64) -> Vector6<f64> {
        let (mut gradient, mut sum, mut count) = (Vector6::zeros(), 0.0, 0.0);
        self.information = Matrix6::zeros();
        for m in matches {
            let weight = m.weight();
            let row = m.row(radius);
            gradient += row * (weight * m.residual);
            self.information += row * row.transpose() * weight;
            sum += m.chance * m.residual * m.residual;
            count += m.chance;
        }
        self.rms = (sum / count).sqrt();
        gradient
    }

    /// Returns the covariance of a small motion in the units of [`Fitted::information`], nil along motions that nothing is known of. What was near in the order of the
    /// points has to be near in space.
    pub(super) fn covariance(&self, radius: f64) -> Matrix6<f64> {
        let (scatter, products) = certainty(&self.matches, radius);
        let dynamic = |matrix: &Matrix6<f64>| DMatrix::from_column_slice(6, 6, matrix.as_slice());
        let inverse = form_inverse(&dynamic(&self.information), &dynamic(&products));
        let inverse = Matrix6::from_column_slice(inverse.as_slice());
        inverse * scatter * inverse
    }
}

/// Returns a covariance that along some orthonormal motions is that of one by the radius.
pub(super) fn unknown_along(
    motions: &[Vector6<f64>],
    covariance: &Matrix6<f64>,
    radius: f64,
) -> Matrix6<f64> {
    let keep = without(motions);
    keep * covariance * keep + (Matrix6::identity() - keep) * (radius * radius)
}

/// Returns the scatter of the gradient of some matches, from that of patches of them, and the information of their normals' products. What is near in their order
/// is near in space.
fn certainty(matches: &[Match], radius: f64) -> (Matrix6<f64>, Matrix6<f64>) {
    let patches = matches.chunks(patch_size(matches.len()));
    let unbiased = followed(patches.len(), 6) / bent(matches).powi(2);
    let mut scatter = Matrix6::zeros();
    for patch in patches {
        let sum: Vector6<f64> = patch.iter().map(|m| m.row(radius) * (m.weight() * m.residual)).sum();
        scatter += sum * sum.transpose();
    }
    let products = matches.iter().map(|m| m.product(radius) * m.weight()).sum();
    (scatter * unbiased, products)
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

/// Returns what leaves nothing of orthonormal motions in one, and the rest of it as it is.
fn without(motions: &[Vector6<f64>]) -> Matrix6<f64> {
    motions.iter().fold(Matrix6::identity(), |keep, way| keep - way * way.transpose())
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
