//! A cloud moved onto a mesh: rigid alignment in the metric of each point's covariance, and what of it is determined.
//!
//! Minimised is Σ ρ(r² / v) over the points p, ρ that of strays among them (`say`), with q the point of the mesh nearest to T p, n the surface's normal there, r = n·(T p − q) and
//! v = nᵀ R C Rᵀ n + s² + f²: C the point's own covariance, s the mesh's sigma there and f what the residuals scatter by beyond both.
//! That is generalised ICP (A. Segal, D. Haehnel, S. Thrun, RSS 2009) in the limit of flat surfaces. Points whose nearest point lies on a
//! border of the mesh are beyond it and have no say.
//!
//! | step | file | what it decides |
//! |---|---|---|
//! | points | `sample` | which points have a say, their normals; what a point costs under a pose |
//! | starts | `starts` | poses worth refining, from pairs of oriented points, where nothing is known of the pose |
//! | say | `say` | which points are of the surface, and what weight they have |
//! | refinement | `refine`, `certainty` | the pose of least squares beside a start, and its covariance |
//! | steps | `swing` | how far steps go where they would go back and forth |
//! | rough surfaces | `sweep`, `form` | what a point belongs to where it is laid onto another sweep; which way that faces and bends |
//! | several sweeps | `joint` | all poses at once, for `merge` |
//! | rivals | `rivals` | motions that nothing is lost along, and other poses that fit as well |

mod certainty;
mod form;
mod joint;
mod pose;
mod refine;
mod rivals;
mod sample;
mod say;
mod starts;
mod sweep;
mod swing;

use crate::cloud::PointCloud;
use crate::error::RegisterError;
use crate::nearest::NearestOnMesh;
pub(crate) use joint::{Joint, joint};
use nalgebra::{Isometry3, Matrix6, Vector3, Vector6};
use pose::Pose;
use rayon::prelude::*;
use refine::{Bounds, FARTHEST, Fitted, refine, unknown_along};
use rivals::Judge;
pub(crate) use sample::Samples;
use sample::{Onto, Sample, TUKEY, Target};
use sweep::Known;
pub use sweep::SweepSurface;

const MAX_ROUNDS: usize = 80;
/// Points that bring a pose near before all of them have a say.
const PREPARED: usize = 2500;
/// Scatter of a good fit beyond what points and mesh tell of, in units of the cloud's radius: wear and form errors are less. A wrong pose
/// scatters by more, and must not be taken for a good one of a bad form.
const MOST_SCATTER: f64 = 0.006;

/// Where the search begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Start {
    /// At this pose, which is right to within the reach, mm.
    Near(Isometry3<f64>, f64),
    /// Anywhere.
    Anywhere,
}

/// A rigid motion and how well it is known.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Registration {
    /// Moves the cloud onto the mesh.
    pub mesh_from_cloud: Isometry3<f64>,
    /// Covariance of a small further motion (turn about the moved [`Registration::middle_mm`] in rad, shift in mm, both along the mesh's
    /// axes). Along an undetermined motion it is that of a turn by a radian, or a shift by the cloud's radius. Errors that points share
    /// are not in it.
    pub covariance: Matrix6<f64>,
    /// Middle of the cloud in its own frame, mm.
    pub middle_mm: [f64; 3],
    /// Root mean square of the residuals that have a say, mm.
    pub rms_mm: f64,
    /// Share of the points that lie on the mesh, normals alike: to within what points and mesh tell of, and a floor that is the
    /// residuals' scatter but at most 0.6 % of the cloud's size.
    pub overlap: f64,
    /// What the residuals scatter by beyond the points' and the mesh's own sigmas, mm.
    pub floor_mm: f64,
    /// Motions that the points do not determine; along them the pose is as it was begun with.
    pub undetermined: Vec<Motion>,
    /// Other poses that were found, that no undetermined motion leads to, and that fit as well: of a form with several ways round.
    /// Looked for with [`Start::Anywhere`] only.
    pub rivals: Vec<Isometry3<f64>>,
    /// Whether the mesh's triangles face away from where the cloud was seen from: then signs are the wrong way round. Known only of
    /// clouds with pixels.
    pub reversed: bool,
    /// Rounds of estimation.
    pub rounds: usize,
}

/// A direction in which a pose is not known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Turn, as a share of the whole, about an axis through the cloud's middle.
    pub turn: [f64; 3],
    /// Shift, as a share of the whole.
    pub shift: [f64; 3],
}

impl std::fmt::Display for Motion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [turn, shift] = [self.turn, self.shift].map(Vector3::from);
        let (what, way) =
            if turn.norm() > shift.norm() { ("a turn about", turn) } else { ("a shift along", shift) };
        let way = way / way.norm();
        write!(f, "{what} ({:.2}, {:.2}, {:.2})", way.x, way.y, way.z)
    }
}

/// Returns the motion that brings a cloud onto a mesh.
///
/// With [`Start::Anywhere`] poses are looked for from pairs of oriented points, many are refined, and compared at one scale. Whether
/// there are others as good, and which motions are not determined, is told in the result: a form that looks the same in several ways (a
/// ball, a plate, a cube) has no one pose.
///
/// # Errors
/// [`RegisterError`] for fewer than six points, values that are not finite, where fewer than `least_overlap` of the points come to lie on the
/// mesh, and where those that do, of a start anywhere, scatter by more than 0.6 % of the cloud's size: no pose is believed that explains the points so badly.
pub fn register(
    cloud: &PointCloud,
    target: &NearestOnMesh<'_>,
    start: Start,
    least_overlap: f64,
) -> Result<Registration, RegisterError> {
    registered(&Samples::new(cloud)?, Onto::Mesh(target), start, least_overlap)
}

/// Returns the motion that brings a sweep that was seen from its frame's origin, pixels or not, onto the surface of another one: as [`register`],
/// but both are rough, and seen from outside.
///
/// # Errors
/// As [`register`].
pub fn register_sweep(
    cloud: &PointCloud,
    target: &SweepSurface<'_>,
    start: Start,
    least_overlap: f64,
) -> Result<Registration, RegisterError> {
    let samples = match start {
        Start::Near(..) => Samples::of_cloud(cloud)?,
        // Pairs of points by themselves tell a pose there, their normals among it.
        Start::Anywhere => Samples { signed: true, ..Samples::new(cloud)? },
    };
    registered(&samples, Onto::Sweep(target), start, least_overlap)
}

/// As [`register_sweep`], of a sweep whose points are taken already.
pub(crate) fn register_samples(
    samples: &Samples,
    target: &SweepSurface<'_>,
    start: Start,
    least_overlap: f64,
) -> Result<Registration, RegisterError> {
    registered(samples, Onto::Sweep(target), start, least_overlap)
}

fn registered(
    samples: &Samples,
    onto: Onto<'_, '_>,
    start: Start,
    least_overlap: f64,
) -> Result<Registration, RegisterError> {
    let allowed_mm = match start {
        Start::Near(..) => f64::INFINITY,
        Start::Anywhere => MOST_SCATTER * samples.radius,
    };
    // Where sides are known they are believed first: but a reference may be inside out.
    let sides: &[bool] = if samples.signed { &[true, false] } else { &[false] };
    let mut refused = RegisterError::LittleOverlap { overlap: 0.0, needed: least_overlap };
    for &signed in sides {
        let found = aligned(samples, &Target { onto, middle: samples.middle, signed }, start);
        let overlap = found.overlap;
        if !found.rms_mm.is_finite() || overlap < least_overlap {
            refused = RegisterError::LittleOverlap { overlap, needed: least_overlap };
        } else if found.floor_mm > allowed_mm {
            refused = RegisterError::Scattered { scatter_mm: found.floor_mm, allowed_mm };
        } else {
            return Ok(found);
        }
    }
    Err(refused)
}

fn aligned(samples: &Samples, target: &Target<'_, '_>, start: Start) -> Registration {
    let all = samples.all();
    let radius = samples.radius;
    let (pose, reach, others) = match start {
        Start::Near(pose, reach) => (pose, reach, Vec::new()),
        Start::Anywhere => anywhere(samples, target),
    };
    let bounds = Bounds { reach, rounds: MAX_ROUNDS };
    // Some of the points bring it near: the rest then takes few rounds.
    let near = refine(target, &samples.few(PREPARED), radius, pose, bounds, &[]);
    let (begun, short) = if near.rms.is_finite() && all.len() > 2 * PREPARED {
        let noise = near.rms.max(near.floor).max(1e-9 * radius);
        (near.pose, Bounds { reach: (FARTHEST * noise).min(reach), ..bounds })
    } else {
        (pose, bounds)
    };
    let mut fitted = refine(target, &all, radius, begun, short, &[]);
    let floor = fitted.floor.clamp(1e-6 * radius, MOST_SCATTER * radius);
    let judge = Judge::new(samples, target, rivals::COMPARED, floor);
    let (mut free, mut covariance) = (Vec::new(), fitted.covariance(radius));
    if fitted.rms.is_finite() {
        free = rivals::undetermined(samples, &judge, &fitted, &covariance);
        if !free.is_empty() {
            // What is not determined stays as it was begun with: of a start anywhere, as the cloud's own coordinates have it.
            let again = match start {
                Start::Near(..) => refine(target, &all, radius, pose, bounds, &free),
                Start::Anywhere => unmoved(samples, target, &all, &fitted, &free),
            };
            if again.rms.is_finite() && Judge::as_good(&judge.costs(&again.pose), &judge.costs(&fitted.pose))
            {
                free = rivals::carried(&free, &fitted.pose, &again.pose, samples);
                fitted = again;
                covariance = fitted.covariance(radius);
            }
        }
    }
    let rivals = rivals::rivals(samples, &judge, &fitted.pose, &others, &free);
    let reach = TUKEY * floor + 3.0 * TUKEY * fitted.rms.min(radius);
    let pose = Pose::of(&fitted.pose, &samples.middle);
    let facing = |(sample, known): (&&Sample, &mut Known)| {
        let turned = pose.direction(&sample.normal?);
        let near = Target { signed: true, ..*target }.matched(sample, &pose, reach, known)?;
        Some(turned.dot(&near.normal) < 0.0)
    };
    let some = all.iter().zip(&mut fitted.known).step_by(all.len().div_ceil(rivals::COMPARED));
    let sides: Vec<bool> = some.filter_map(facing).collect();
    let away = sides.iter().filter(|away| **away).count();
    let beside = all.iter().zip(&mut fitted.known);
    let on = beside.map(|(sample, known)| target.cost(sample, &pose, floor, known) < 1.0);
    let overlap = on.filter(|on| *on).count() as f64 / all.len() as f64;
    Registration {
        overlap,
        reversed: samples.signed && 2 * away > sides.len(),
        rivals,
        ..told(&fitted, &unknown_along(&free, &covariance, radius), samples, &free)
    }
}

/// Returns the pose that undetermined motions lead to from one that was found, nearest to where the cloud's own coordinates have it.
fn unmoved(
    samples: &Samples,
    target: &Target<'_, '_>,
    points: &[&Sample],
    found: &Fitted,
    free: &[Vector6<f64>],
) -> Fitted {
    let radius = samples.radius;
    let mut pose = found.pose;
    // A turn and a shift one after the other are a screw to first order only.
    for _ in 0..4 {
        let way = rivals::motion(&Isometry3::identity(), &pose, samples);
        let along: Vector6<f64> = free.iter().map(|free| free * free.dot(&way)).sum();
        pose = refine::moved(&pose, &samples.middle, radius, &along);
    }
    let bounds = Bounds { reach: (0.1 * radius).max(4.0 * TUKEY * found.rms), rounds: MAX_ROUNDS };
    let near = refine(target, &samples.few(PREPARED), radius, pose, bounds, free);
    refine(
        target,
        points,
        radius,
        near.pose,
        Bounds { reach: bounds.reach.min(20.0 * found.rms.max(1e-9 * radius)), ..bounds },
        free,
    )
}

fn told(
    fitted: &Fitted,
    covariance: &Matrix6<f64>,
    samples: &Samples,
    free: &[Vector6<f64>],
) -> Registration {
    let unit = 1.0 / samples.radius;
    let units = Matrix6::from_diagonal(&Vector6::new(unit, unit, unit, 1.0, 1.0, 1.0));
    let motion =
        |way: &Vector6<f64>| Motion { turn: [way[0], way[1], way[2]], shift: [way[3], way[4], way[5]] };
    Registration {
        mesh_from_cloud: fitted.pose,
        covariance: units * covariance * units,
        middle_mm: samples.middle.into(),
        rms_mm: fitted.rms,
        overlap: 0.0,
        floor_mm: fitted.floor,
        undetermined: free.iter().map(motion).collect(),
        rivals: Vec::new(),
        reversed: false,
        rounds: fitted.rounds,
    }
}

/// The best pose of many, how far off it may be, and the others that came near.
fn anywhere(samples: &Samples, target: &Target<'_, '_>) -> (Isometry3<f64>, f64, Vec<Isometry3<f64>>) {
    /// Poses, points and rounds of each step; few of many, then more of few.
    const FIRST: (usize, usize, usize) = (150, 150, 8);
    const ROUGH: (usize, usize, usize) = (40, 400, 20);
    const FINE: (usize, usize, usize) = (8, 1000, 40);
    let radius = samples.radius;
    let starts = starts::starts(samples, target, FIRST.0);
    let refined = |poses: Vec<Isometry3<f64>>, (_, points, rounds): (usize, usize, usize), reach: f64| {
        let points = samples.few(points);
        let bounds = Bounds { reach, rounds };
        let one = |pose| refine(target, &points, radius, pose, bounds, &[]);
        poses.into_par_iter().map(one).collect::<Vec<Fitted>>()
    };
    let judged = |fitted: Vec<Fitted>, points: usize, floor: f64| {
        let judge = Judge::new(samples, target, points, floor);
        let mean = |fitted: &Fitted| {
            let costs = judge.costs(&fitted.pose);
            costs.iter().sum::<f64>() / costs.len() as f64
        };
        let mut judged: Vec<(f64, Fitted)> = fitted.into_par_iter().map(|f| (mean(&f), f)).collect();
        judged.sort_by(|a, b| a.0.total_cmp(&b.0));
        judged
    };
    let best_of = |judged: Vec<(f64, Fitted)>, most: usize| {
        let mut poses: Vec<Isometry3<f64>> = Vec::new();
        for (_, fitted) in &judged {
            let other = |pose: &Isometry3<f64>| {
                starts::apart(pose, &fitted.pose, &samples.middle, radius) > 0.2 * starts::SAME_POSE * radius
            };
            if poses.len() < most && poses.iter().all(other) {
                poses.push(fitted.pose);
            }
        }
        poses
    };
    let first = judged(refined(starts, FIRST, 0.3 * radius), 300, 2.0 * MOST_SCATTER * radius);
    let rough = refined(best_of(first, ROUGH.0), ROUGH, 0.15 * radius);
    let rough = judged(rough, 500, MOST_SCATTER * radius);
    let poses = best_of(rough, FINE.0);
    let fine = judged(refined(poses, FINE, 0.1 * radius), FINE.1, MOST_SCATTER * radius);
    // All are compared at the scatter of the one that scatters least among the good ones.
    let good = fine.first().map_or(0.0, |best| best.0 * 1.1 + 0.01);
    let least = fine.iter().take_while(|f| f.0 <= good).map(|f| f.1.floor).fold(f64::INFINITY, f64::min);
    let floor = least.clamp(1e-6 * radius, MOST_SCATTER * radius);
    let fine = judged(fine.into_iter().map(|f| f.1).collect(), FINE.1, floor);
    let pose = fine.first().map_or_else(Isometry3::identity, |best| best.1.pose);
    (pose, (10.0 * TUKEY * floor).max(0.01 * radius), fine.iter().skip(1).map(|f| f.1.pose).collect())
}
