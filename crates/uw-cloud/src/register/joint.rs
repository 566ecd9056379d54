//! Several sweeps at once: every one's points onto every other's surface.

use super::certainty::{bent, followed, form_inverse, patches};
use super::pose::Pose;
use super::refine::NOTHING_LEFT;
use super::sample::{Match, Sample, Samples, TUKEY};
use super::say::{WIDE, judge};
use super::sweep::{Known, SweepSurface};
use super::swing::Swing;
use crate::error::RegisterError;
use crate::merge::PairResidual;
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6,
};

const MAX_ROUNDS: usize = 40;
/// Of a motion's information, as of one sweep alone.
const DAMPING: f64 = 1e-6;

/// Poses that are settled together.
pub(crate) struct Joint {
    pub(crate) poses: Vec<Isometry3<f64>>,
    pub(crate) covariances: Vec<Matrix6<f64>>,
    pub(crate) pairs: Vec<PairResidual>,
    pub(crate) settled: bool,
}

/// One sweep's points on another one's surface.
struct Pair {
    points: usize,
    surface: usize,
    /// With arms about the middle of all, normals in the first frame.
    matches: Vec<Match>,
    floor2: f64,
    overlap: f64,
    rms: f64,
}

/// Returns the poses that bring all sweeps onto each other, from poses that nearly do; the first one stays.
pub(crate) fn joint(
    sweeps: &[SweepSurface<'_>],
    samples: &[Samples],
    mut poses: Vec<Isometry3<f64>>,
) -> Result<Joint, RegisterError> {
    let middles = samples.iter().zip(&poses).map(|(s, pose)| (pose * Point3::from(s.middle)).coords);
    let middle = middles.sum::<Vector3<f64>>() / samples.len() as f64;
    let radius = samples
        .iter()
        .zip(&poses)
        .map(|(s, pose)| ((pose * Point3::from(s.middle)).coords - middle).norm() + s.radius)
        .fold(0.0, f64::max);
    let laid = |pair: (usize, usize), poses: &[Isometry3<f64>], reach: f64| {
        laid(&samples[pair.0], &sweeps[pair.1], pair, poses, &middle, reach)
    };
    let mut reach = 0.02 * radius;
    let both: Vec<(usize, usize)> = (0..poses.len())
        .flat_map(|i| (0..poses.len()).map(move |j| (i, j)))
        .filter(|(i, j)| i != j)
        .collect();
    let chosen = denser(&both.iter().map(|&pair| laid(pair, &poses, reach)).collect::<Vec<_>>());
    let (mut swing, mut last) = (Swing::new(), DVector::zeros(6 * (poses.len() - 1)));
    let mut settled = false;
    let mut pairs = Vec::new();
    for _ in 0..MAX_ROUNDS {
        pairs = chosen.iter().map(|&pair| laid(pair, &poses, reach)).collect();
        let (mut matrix, gradient) = normal_equations(&pairs, poses.len(), radius);
        let damping = DAMPING * matrix.diagonal().amax().max(f64::MIN_POSITIVE);
        for k in 0..matrix.nrows() {
            matrix[(k, k)] += damping;
        }
        let Some(inverse) = matrix.try_inverse() else { break };
        // Pulls are weighed by the noise, which falls while the search narrows down.
        let noise = pairs.iter().filter(|p| p.overlap > 0.0).map(|p| p.rms).fold(0.0, f64::max);
        let share = swing.share(gradient.dot(&last) * noise * noise);
        last = -(inverse * &gradient);
        swing.begin(gradient.dot(&last) * noise * noise);
        let left = -gradient.dot(&last) * share * share;
        let step = &last * share;
        for (k, pose) in poses.iter_mut().enumerate().skip(1) {
            let turn = Vector3::from_fn(|r, _| step[6 * (k - 1) + r]) / radius;
            let shift = Vector3::from_fn(|r, _| step[6 * (k - 1) + 3 + r]);
            let about =
                Translation3::from(middle + shift) * UnitQuaternion::new(turn) * Translation3::from(-middle);
            *pose = about * *pose;
        }
        let next = (3.0 * TUKEY * noise).min(reach).max(0.5 * reach);
        let rests = step.amax() < 1e-3 * noise + 1e-12 * radius || left < NOTHING_LEFT;
        let narrower = next <= 0.9 * reach;
        settled = rests && !narrower;
        reach = next;
        if settled {
            break;
        }
        if narrower {
            // Other points pull, and otherwise.
            swing = Swing::new();
        }
    }
    let covariances = blocks(&covariance(&pairs, poses.len(), radius)?, radius);
    let told = |pair: Pair| PairResidual {
        points_of: pair.points,
        surface_of: pair.surface,
        overlap: pair.overlap,
        rms_mm: pair.rms,
        floor_mm: pair.floor2.sqrt(),
    };
    let pairs = both.into_iter().map(|pair| told(laid(pair, &poses, reach))).collect();
    Ok(Joint { poses, covariances, pairs, settled })
}

/// Which of each two sweeps' points are laid onto the other one's surface: those of the one that has more of them there. All points of both then have a say,
/// those of the other one as often as they are the nearest.
fn denser(pairs: &[Pair]) -> Vec<(usize, usize)> {
    let count = |points: usize, surface: usize| {
        pairs.iter().find(|p| (p.points, p.surface) == (points, surface)).map_or(0, |p| p.matches.len())
    };
    let forwards = pairs.iter().map(|pair| (pair.points, pair.surface)).filter(|(i, j)| i < j);
    forwards.map(|(i, j)| if count(i, j) < count(j, i) { (j, i) } else { (i, j) }).collect()
}

fn laid(
    samples: &Samples,
    surface: &SweepSurface<'_>,
    (i, j): (usize, usize),
    poses: &[Isometry3<f64>],
    middle: &Vector3<f64>,
    reach: f64,
) -> Pair {
    const ALIKE: f64 = 0.7;
    let surface_from_points = Pose::of(&(poses[j].inverse() * poses[i]), &samples.middle);
    let [moved, other] = [i, j].map(|k| Pose::of(&poses[k], middle));
    let of = |sample: &Sample| {
        let found = surface.matched(sample, &surface_from_points, reach, &mut Known::default())?;
        let arm = moved.place(&sample.place) - middle;
        let [normal, own] = [&found.normal, &found.own].map(|normal| other.direction(normal));
        (found.facing > ALIKE).then_some(Match { arm, normal, own, ..found })
    };
    let mut matches: Vec<Match> = samples.points.iter().filter_map(of).collect();
    let (floor2, _) = judge(&mut matches, reach, f64::MIN_POSITIVE);
    // By distance, not by chance: a search that follows the likeliest of points without noise narrows down to nothing.
    let on = matches.iter().map(|m| (m.residual * m.residual, m.variance));
    let squares: Vec<f64> = on.filter(|(square, v)| *square < WIDE * WIDE * v).map(|on| on.0).collect();
    Pair {
        points: i,
        surface: j,
        floor2,
        overlap: squares.len() as f64 / samples.points.len() as f64,
        rms: (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt(),
        matches,
    }
}

impl Pair {
    /// The poses that a match has to do with, from where their unknowns begin, and its sign: the surface moves the other way, and the first sweep
    /// does not move.
    fn sides(&self) -> impl Iterator<Item = (usize, f64)> + Clone {
        let sides = [(self.points, 1.0), (self.surface, -1.0)];
        sides.into_iter().filter(|(pose, _)| *pose > 0).map(|(pose, sign)| (6 * (pose - 1), sign))
    }
}

/// The normal matrix of all poses but the first, and its gradient.
fn normal_equations(pairs: &[Pair], poses: usize, radius: f64) -> (DMatrix<f64>, DVector<f64>) {
    let size = 6 * (poses - 1);
    let mut gradient = DVector::zeros(size);
    for pair in pairs {
        let pulls = pair.matches.iter().map(|m| m.row(radius) * (m.weight() * m.residual));
        let pull: Vector6<f64> = pulls.sum();
        for (at, sign) in pair.sides() {
            let mut part = gradient.rows_mut(at, 6);
            part += pull * sign;
        }
    }
    let square = |m: &Match| {
        let row = m.row(radius);
        row * row.transpose()
    };
    (information(pairs, poses, square), gradient)
}

/// The sum of matrices of all matches, each where its two poses have it.
fn information(pairs: &[Pair], poses: usize, of: impl Fn(&Match) -> Matrix6<f64>) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(6 * (poses - 1), 6 * (poses - 1));
    for pair in pairs {
        let own: Matrix6<f64> = pair.matches.iter().map(|m| of(m) * m.weight()).sum();
        for (at, sign_a) in pair.sides() {
            for (beside, sign_b) in pair.sides() {
                let mut block = matrix.view_mut((at, beside), (6, 6));
                block += own * (sign_a * sign_b);
            }
        }
    }
    matrix
}

/// The covariance of all poses but the first. The gradient's scatter is that of patches of all pairs' matches: a point that is laid onto two sweeps errs on both.
fn covariance(pairs: &[Pair], poses: usize, radius: f64) -> Result<DMatrix<f64>, RegisterError> {
    let size = 6 * (poses - 1);
    let mut weighed: Vec<(&Pair, &Match, f64)> = Vec::new();
    for pair in pairs {
        let bent = bent(&pair.matches);
        weighed.extend(pair.matches.iter().map(|m| (pair, m, m.weight() / bent)));
    }
    let places: Vec<Vector3<f64>> = weighed.iter().map(|(_, m, _)| m.arm).collect();
    let patches = patches(&places)?;
    let mut scatter = DMatrix::zeros(size, size);
    for patch in &patches {
        let mut sum = DVector::zeros(size);
        for &(pair, m, weight) in patch.iter().map(|&at| &weighed[at]) {
            let pull = m.row(radius) * (weight * m.residual);
            for (at, sign) in pair.sides() {
                let mut part = sum.rows_mut(at, 6);
                part += pull * sign;
            }
        }
        scatter.ger(1.0, &sum, &sum, 1.0);
    }
    let (squares, _) = normal_equations(pairs, poses, radius);
    let inverse = form_inverse(&squares, &information(pairs, poses, |m| m.product(radius)));
    Ok(&inverse * scatter * &inverse * followed(patches.len(), size))
}

/// The covariance of each pose, the first one's nil, turns in rad.
fn blocks(all: &DMatrix<f64>, radius: f64) -> Vec<Matrix6<f64>> {
    let unit = 1.0 / radius;
    let units = Matrix6::from_diagonal(&Vector6::new(unit, unit, unit, 1.0, 1.0, 1.0));
    let block = |k: usize| units * all.fixed_view::<6, 6>(6 * k, 6 * k) * units;
    std::iter::once(Matrix6::zeros()).chain((0..all.nrows() / 6).map(block)).collect()
}
