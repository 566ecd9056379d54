//! Fitting any surface to points that each have their own covariance: maximum likelihood with errors in variables.
//!
//! A point p with covariance C was measured of a point q of the surface. Besides its measurement error it carries
//! what no covariance tells: roughness, form error, what the calibration leaves between neighbouring stripes. That is
//! taken as isotropic, with one standard deviation f for all points (the noise floor), and one factor φ (the scale)
//! stands for covariances that are too small or too large throughout: the error of p has covariance φ V, V = C + f² I.
//!
//! *Distance.* A point's share of the likelihood is its squared Mahalanobis distance to the surface,
//! d² = min (p − q)ᵀ V⁻¹ (p − q) over the surface's points q. At that foot q, with the unit normal n and p − q = λ V n,
//! d² = λ² nᵀVn and, as the minimum over q has no slope along q, ∂d/∂θ = F_θ(q) / sqrt(nᵀVn) for the signed distance
//! F(x; θ). These are exact. A scanner's covariance is all but singular (a point moves along its laser ray), and
//! weighting the orthogonal distance by nᵀCn instead fails where a ray grazes the surface: there nᵀCn vanishes at
//! the point as measured, and with the weight following the error the fit is biased.
//!
//! *Floor and scale.* To first order about the feet the residual along the normal, r = λ nᵀVn, is Gaussian with variance
//! φ (nᵀCn + f²). φ is chi²/dof at any f. The f of largest likelihood is the estimate that is reported; the weights
//! take the largest f whose likelihood lies within one sigma (twice its logarithm is 1 lower), as grazing points,
//! which say nearly nothing of f as long as they are few, would otherwise be believed without limit. To nᵀCn there comes, for the floor, what a round
//! surface bends away within the foot's own uncertainty.
//!
//! *Sigmas.* With A = Σ g gᵀ / v over the inliers (g = F_θ at the feet, v the variance used as weight) the covariance is
//! A⁻¹ (Σ g gᵀ ṽ / v²) A⁻¹ with ṽ = max(φ, 1) (nᵀCn + f²) at the f of largest likelihood: larger than predicted where
//! the points scatter more than their covariances say, never smaller. Without covariances ṽ is the scatter itself,
//! and with few degrees of freedom the sigmas are widened to the 68 % interval of Student's t.
//!
//! *Shared errors.* Neighbours on one stripe share errors: of the sheet's thickness at a grazing surface, of an edge of brightness,
//! of the calibration. Where the clouds tell which image a point is of, the middle factor is therefore also summed over blocks
//! of neighbours, Σ (Σ g r / v)(Σ g r / v)ᵀ (K.-Y. Liang, S. Zeger, Biometrika 73 (1986) 13), and takes its place in those directions
//! in which it is larger than chance lets the largest eigenvalue of so many blocks be (V. Marchenko, L. Pastur, 1967).
//!
//! What the points of a cloud are known to share ([`PointCloud::shared_mm`](crate::PointCloud::shared_mm)) is a step of each of them, and of the parameters by
//! their [`Influence`]; its square is added.
//!
//! *Undetermined shapes.* Noise moves the feet, hence g, and feigns information: Σ G Q Gᵀ / v on average, with G = ∂g/∂q and
//! Q the covariance of the foot along the surface. Where that reaches half of A in any direction, the points do not
//! determine the shape and there is no result; below that it is taken off A.

use crate::deviations::{Deviations, Influence, InfluencePoint};
use crate::error::FitError;
use crate::floor::{Floor, noise_floor};
use crate::newton::{MAX_ITERATIONS, Normal, minimise};
use crate::robust::{rejection_limit, scale_about_zero, student_widening};
use crate::round::refuse_filling;
use crate::sample::{Observation, Observations, Sample};
use nalgebra::{DMatrix, Matrix3, SMatrix, SVector, Vector3};

/// Share of feigned information that is refused.
const MAX_NOISE_SHARE: f64 = 0.5;

/// Rounds of choosing inliers and floor; they mostly settle within six.
const MAX_ROUNDS: usize = 30;

/// Neighbours on a stripe that may share errors, and blocks of them from which their sums' scatter is known.
const BLOCK: usize = 32;
const LEAST_BLOCKS: usize = 30;

/// Points that a fit of more than twice as many begins with, and goes on with: then all of them take one round or two.
const PREPARED: [usize; 2] = [3000, 60_000];

/// Change of the floor's logarithm that no longer matters: less than a step of its search.
const FLOOR_TOLERANCE: f64 = 0.2;

/// Points that a fit tells the influence of: so many, evenly spread, stand for all.
const INFLUENTIAL: usize = 4096;

/// Where a point belongs on a surface, under its own covariance.
#[derive(Clone, Copy)]
pub(crate) struct Foot<const P: usize> {
    /// Residual along the normal, λ nᵀVn, mm; positive where the point is on the normal's side.
    pub(crate) residual_mm: f64,
    /// nᵀVn, mm².
    pub(crate) variance_mm2: f64,
    /// Unit normal of the surface there.
    pub(crate) normal: Vector3<f64>,
    /// ∂F/∂θ of the signed distance there.
    pub(crate) gradient: SVector<f64, P>,
}

impl<const P: usize> Foot<P> {
    /// Returns the signed Mahalanobis distance.
    fn distance(&self) -> f64 {
        self.residual_mm / self.variance_mm2.sqrt()
    }
}

/// Returns the Mahalanobis distance of a point's feet, not negative.
fn distance<const P: usize>(feet: &[Foot<P>]) -> f64 {
    feet.iter().map(|f| f.distance().powi(2)).sum::<f64>().sqrt()
}

/// Returns the distance of a point's feet in space, mm.
fn residual_mm<const P: usize>(feet: &[Foot<P>]) -> f64 {
    feet.iter().map(|f| f.residual_mm.powi(2)).sum::<f64>().sqrt()
}

/// A surface (or curve) with `P` free parameters θ.
pub(crate) trait Surface<const P: usize>: Clone {
    /// A point's foot; of a curve, which a point can miss in two directions, one for each.
    type Feet: AsRef<[Foot<P>]> + Copy;
    /// What it is called in messages.
    const NAME: &'static str;

    /// Returns the radius of what is round, mm.
    fn radius_mm(&self) -> Option<f64> {
        None
    }

    /// Returns the signed orthogonal distance F of a point, mm.
    fn distance(&self, point: &Vector3<f64>) -> f64;

    /// Returns the surface point that is nearest in the metric of C + f² I, and its residuals in each direction, independent of each other.
    fn feet(&self, observation: Observation<'_>, floor_mm: f64) -> Self::Feet;

    /// Returns G, the derivatives of ∂F/∂θ by the foot's position along the surface.
    fn gradient_change(&self, foot: &Foot<P>) -> SMatrix<f64, P, 3>;

    /// Returns the derivatives of the unit normal by the foot's position: nil of a plane.
    fn normal_change(&self, _: &Foot<P>) -> Matrix3<f64> {
        Matrix3::zeros()
    }

    /// Returns what gives a foot's derivatives by the steps that [`Surface::moved`] takes: those of θ, where the way to the minimum is not bent in it.
    fn lever(&self) -> impl Fn(&Foot<P>) -> SVector<f64, P> {
        |foot| foot.gradient
    }

    /// Returns the surface moved by a step.
    fn moved(&self, step: &SVector<f64, P>) -> Self;
}

/// A fitted surface with the covariance of its parameters.
pub(crate) struct Fitted<S, const P: usize> {
    pub(crate) surface: S,
    pub(crate) covariance: SMatrix<f64, P, P>,
    pub(crate) deviations: Deviations,
    /// How it follows its points, by the parameters.
    pub(crate) influence: Influence,
    /// Positions in the sample of the points that were used.
    pub(crate) inliers: Vec<usize>,
    /// Noise floor and scale that it was fitted with.
    floor: Floor,
}

/// Returns the surface of least Σ d² over the chosen points, from a start; `None` where there is none.
pub(crate) fn refine<S: Surface<P>, const P: usize>(
    start: S,
    points: &Observations,
    chosen: &[usize],
    floor_mm: f64,
    resolution_mm: f64,
) -> Option<S> {
    let negligible = chosen.len() as f64 * (resolution_mm / floor_mm).powi(2);
    minimise(start, negligible, |s| normal_equations(s, points, chosen, floor_mm), S::moved)
}

/// Returns Σ d² and its derivatives.
fn normal_equations<S: Surface<P>, const P: usize>(
    surface: &S,
    points: &Observations,
    chosen: &[usize],
    floor_mm: f64,
) -> Normal<P> {
    let lever = surface.lever();
    let mut normal = Normal::zero();
    for &i in chosen {
        for foot in surface.feet(points.get(i), floor_mm).as_ref() {
            let lever = lever(foot);
            let weighted = lever / foot.variance_mm2;
            normal.cost += foot.residual_mm * foot.residual_mm / foot.variance_mm2;
            normal.gradient += weighted * foot.residual_mm;
            normal.matrix += weighted * lever.transpose();
        }
    }
    normal
}

/// Returns the standard deviation of distances in units of their own, half of which may be anything: the larger one of the two directions that a curve is missed in. Where points lie in one plane to the
/// last digit there is none in the one, and together the median would be nil.
fn scatter<F: AsRef<[Foot<P>]>, const P: usize>(feet: &[&F]) -> f64 {
    let directions = feet.first().map_or(0, |feet| feet.as_ref().len());
    let of = |direction: usize| scale_about_zero(feet.iter().map(|feet| feet.as_ref()[direction].distance()));
    (0..directions).map(of).fold(0.0, f64::max)
}

/// Returns what belongs to the sound points.
fn those<'a, T>(all: &'a [T], sound: &'a [bool]) -> impl Iterator<Item = &'a T> {
    all.iter().zip(sound).filter(|(_, sound)| **sound).map(|(own, _)| own)
}

/// Where a fit stands: the surface, its floor, which points are sound, and their residuals.
struct Stand<S: Surface<P>, const P: usize> {
    surface: S,
    floor: Floor,
    inliers: Vec<bool>,
    feet: Vec<S::Feet>,
}

/// Returns the maximum-likelihood surface for the points that agree with it, beginning at a start whose points
/// scatter by `scatter_mm`.
///
/// Of many points every so many-th brings it near first, and more of them nearer: the rest then takes few rounds.
pub(crate) fn fit<S: Surface<P>, const P: usize>(
    start: &S,
    scatter_mm: f64,
    sample: &Sample<'_>,
) -> Result<Fitted<S, P>, FitError> {
    let all = &sample.observations;
    let limit = rejection_limit(all.len());
    let reach = limit * scatter_mm.max(sample.resolution_mm);
    let first = if sample.has_covariances { scatter_mm.max(sample.resolution_mm) } else { 1.0 };
    let first = Floor { likely_mm: first, used_mm: first, scale: 1.0 };
    let near = |i: &usize| start.distance(&all.points[*i]).abs() <= reach;
    let from = |before: Option<Stand<S, P>>, points: &[usize]| {
        let Some(Stand { surface, floor, inliers, feet }) = before else {
            return settled(start.clone(), first, points.iter().map(near).collect(), points, limit, sample);
        };
        let accepted = scatter(&those(&feet, &inliers).collect::<Vec<_>>());
        let accepted = if sample.has_covariances { accepted.max(1.0) } else { accepted };
        let sound = |i: &usize| {
            let feet = surface.feet(all.get(*i), floor.used_mm);
            distance(feet.as_ref()) <= limit * accepted || residual_mm(feet.as_ref()) <= sample.resolution_mm
        };
        let inliers = points.iter().map(sound).collect();
        settled(surface, floor, inliers, points, limit, sample)
    };
    let mut prepared = None;
    for count in PREPARED.into_iter().filter(|count| all.len() >= 2 * count) {
        let few: Vec<usize> = (0..all.len()).step_by(all.len().div_ceil(count)).collect();
        prepared = from(prepared, &few).ok();
    }
    let stand = from(prepared, &(0..all.len()).collect::<Vec<_>>());
    let Stand { surface, floor, inliers, feet } = stand?;
    let inliers: Vec<usize> = (0..all.len()).filter(|&i| inliers[i]).collect();
    let (covariance, influence) = covariance(&surface, sample, &feet, &inliers, floor)?;
    let distances: Vec<f64> = inliers.iter().map(|&i| surface.distance(&all.points[i])).collect();
    if let Some(radius_mm) = surface.radius_mm() {
        refuse_filling(S::NAME, radius_mm, &distances)?;
    }
    let known = sample.has_covariances.then_some(floor);
    let deviations = Deviations::new(&distances, all.len(), sample.duplicates, known);
    Ok(Fitted { surface, covariance, deviations, influence, inliers, floor })
}

/// Returns where rounds of refining, and of choosing inliers and floor by what is left, come to rest.
fn settled<S: Surface<P>, const P: usize>(
    mut surface: S,
    mut floor: Floor,
    mut inliers: Vec<bool>,
    points: &[usize],
    limit: f64,
    sample: &Sample<'_>,
) -> Result<Stand<S, P>, FitError> {
    let needed = P + usize::from(!sample.has_covariances);
    // One piece of memory for all rounds: the system takes longer to give a new one than a round takes.
    let mut feet: Vec<S::Feet> = Vec::with_capacity(points.len());
    for round in 1.. {
        let count = inliers.iter().filter(|&&sound| sound).count();
        if count < needed {
            return Err(FitError::NoConsensus { shape: S::NAME, needed, got: count, points: points.len() });
        }
        let sound: Vec<usize> = those(points, &inliers).copied().collect();
        surface = refine(surface, &sample.observations, &sound, floor.used_mm, sample.resolution_mm)
            .ok_or(FitError::NotConverged { shape: S::NAME, iterations: MAX_ITERATIONS })?;
        feet.clear();
        feet.extend(points.iter().map(|&i| surface.feet(sample.observations.get(i), floor.used_mm)));
        let kept: Vec<_> = those(&feet, &inliers).collect();
        let residuals = || kept.iter().flat_map(AsRef::as_ref);
        let mut accepted = scatter(&kept);
        let next_floor = if sample.has_covariances {
            // A covariance that is too large by all appearances still says what error was to be expected.
            accepted = accepted.max(1.0);
            let used2 = floor.used_mm * floor.used_mm;
            let mut residuals = Vec::with_capacity(count);
            for (&i, feet) in sound.iter().zip(&kept) {
                let feet = feet.as_ref();
                let bend = bend_variance(&surface, sample.observations.get(i), &feet[0], floor.used_mm);
                let told = |f: &Foot<P>| (f.residual_mm, (f.variance_mm2 - used2).max(0.0) + bend);
                residuals.extend(feet.iter().map(told));
            }
            noise_floor(&residuals, P, sample.resolution_mm)
        } else {
            let chi2: f64 = residuals().map(|f| f.distance().powi(2)).sum();
            Floor { scale: chi2 / residuals().count().saturating_sub(P).max(1) as f64, ..floor }
        };
        let sound = |f: &[Foot<P>]| distance(f) <= limit * accepted || residual_mm(f) <= sample.resolution_mm;
        let next: Vec<bool> = feet.iter().map(|feet| sound(feet.as_ref())).collect();
        let settled = next == inliers && (next_floor.used_mm / floor.used_mm).ln().abs() < FLOOR_TOLERANCE;
        if settled || round == MAX_ROUNDS {
            // Inliers and weights are those that the surface was fitted with; the estimates are the latest.
            let floor = Floor { used_mm: floor.used_mm, ..next_floor };
            return Ok(Stand { surface, floor, inliers, feet });
        }
        (inliers, floor) = (next, next_floor);
    }
    Err(FitError::NotConverged { shape: S::NAME, iterations: MAX_ROUNDS })
}

/// Returns the variance of a residual, mm², that is of second order in the point's error: ½ tr (H S)² with the normal's derivatives H and the foot's covariance S along the
/// surface.
///
/// Where light grazes a round surface nᵀCn vanishes, and the likelihood of the floor would have no bound as it goes to nil with the one point that lies
/// on the surface by chance. But the foot of such a point may be anywhere along the light, and the surface bends away from that.
fn bend_variance<S: Surface<P>, const P: usize>(
    surface: &S,
    observation: Observation<'_>,
    foot: &Foot<P>,
    floor_mm: f64,
) -> f64 {
    let bent = surface.normal_change(foot) * sliding(&observation.covariance(floor_mm), &foot.normal);
    0.5 * (bent * bent).trace().max(0.0)
}

/// Returns the covariance of a foot along the surface, mm², of a point with a covariance.
fn sliding(covariance: &Matrix3<f64>, normal: &Vector3<f64>) -> Matrix3<f64> {
    let along = covariance * normal;
    let across = normal.dot(&along);
    if across > 0.0 { covariance - along * along.transpose() / across } else { *covariance }
}

/// Returns Σ d²/φ over all points, each at most at the rejection limit, in a given floor and scale.
fn bounded_chi2<S: Surface<P>, const P: usize>(surface: &S, sample: &Sample<'_>, floor: Floor) -> f64 {
    let limit = rejection_limit(sample.observations.len());
    let share = |i: usize| {
        let chi2 = |foot: &Foot<P>| {
            let variance = (floor.scale * foot.variance_mm2).max(sample.resolution_mm.powi(2));
            foot.residual_mm * foot.residual_mm / variance
        };
        let feet = surface.feet(sample.observations.get(i), floor.used_mm);
        feet.as_ref().iter().map(chi2).sum::<f64>().min(limit * limit)
    };
    (0..sample.observations.len()).map(share).sum()
}

/// Returns the fit from another start, and by how much more chi² it is worse than `fitted`; `None` where it comes to
/// rest nowhere or, with the inliers of `fitted`, is worse by more than `decisive`.
pub(crate) fn rival<S: Surface<P>, const P: usize>(
    start: S,
    fitted: &Fitted<S, P>,
    sample: &Sample<'_>,
    decisive: f64,
) -> Option<(Fitted<S, P>, f64)> {
    let all = &sample.observations;
    let start = refine(start, all, &fitted.inliers, fitted.floor.used_mm, sample.resolution_mm)?;
    let worse = |surface: &S, floor| {
        bounded_chi2(surface, sample, floor) - bounded_chi2(&fitted.surface, sample, floor)
    };
    if worse(&start, fitted.floor) > decisive {
        return None;
    }
    let nearness = |surface: &S| scale_about_zero(all.points.iter().map(|point| surface.distance(point)));
    let other = fit(&start, fitted.deviations.rms_mm, sample).ok()?;
    // Both in the floor and the scale of the one that is nearer to most points: a bad fit forgives too much.
    let nearer = if nearness(&other.surface) < nearness(&fitted.surface) { &other } else { fitted };
    let difference = worse(&other.surface, nearer.floor);
    Some((other, difference))
}

/// Returns the covariance of the parameters, as the module's documentation describes, and how they follow the points.
fn covariance<S: Surface<P>, const P: usize>(
    surface: &S,
    sample: &Sample<'_>,
    feet: &[S::Feet],
    inliers: &[usize],
    floor: Floor,
) -> Result<(SMatrix<f64, P, P>, Influence), FitError> {
    let scale = if sample.has_covariances { floor.scale.max(1.0) } else { floor.scale };
    let (used2, likely2) = (floor.used_mm * floor.used_mm, floor.likely_mm * floor.likely_mm);
    let mut information = SMatrix::<f64, P, P>::zeros();
    let mut feigned = SMatrix::<f64, P, P>::zeros();
    let mut scatter = SMatrix::<f64, P, P>::zeros();
    for &i in inliers {
        let v = sample.observations.get(i).covariance(floor.likely_mm) * scale;
        for foot in feet[i].as_ref() {
            let expected = scale * ((foot.variance_mm2 - used2).max(0.0) + likely2);
            let square = foot.gradient * foot.gradient.transpose() / foot.variance_mm2;
            information += square;
            scatter += square * (expected / foot.variance_mm2);
            let change = surface.gradient_change(foot);
            feigned += change * sliding(&v, &foot.normal) * change.transpose() / foot.variance_mm2;
        }
    }
    let undetermined =
        |noise_share| FitError::Undetermined { shape: S::NAME, noise_share, allowed: MAX_NOISE_SHARE };
    // Each parameter in units of its own information, so that mm and radians compare.
    let units = information.diagonal().map(|d| 1.0 / d.sqrt());
    if !units.iter().all(|u| u.is_finite()) {
        return Err(undetermined(1.0));
    }
    let units = SMatrix::<f64, P, P>::from_diagonal(&units);
    let scaled = dynamic(&(units * information * units)).symmetric_eigen();
    // Below this, rounding of the sums is all there is.
    let singular = 1e-14 * inliers.len() as f64;
    let least = scaled.eigenvalues.min();
    if least.is_nan() || least <= singular.min(1e-9) {
        return Err(undetermined(1.0));
    }
    let whitened = &scaled.eigenvectors * DMatrix::from_diagonal(&scaled.eigenvalues.map(|e| 1.0 / e.sqrt()));
    let noise = whitened.transpose() * dynamic(&(units * feigned * units)) * &whitened;
    let noise_share = noise.symmetric_eigenvalues().max();
    if noise_share.is_nan() || noise_share > MAX_NOISE_SHARE {
        return Err(undetermined(noise_share.min(1.0)));
    }
    let inverse = (information - feigned).try_inverse().ok_or_else(|| undetermined(noise_share))?;
    let influence = influence(sample, feet, inliers, &(feigned / inliers.len().max(1) as f64))
        .ok_or_else(|| undetermined(noise_share))?;
    let scatter = with_shared_errors(scatter, sample, feet, inliers);
    let dof = inliers.iter().map(|&i| feet[i].as_ref().len()).sum::<usize>().saturating_sub(P);
    let widening =
        if sample.has_covariances && floor.scale <= 1.0 { 1.0 } else { student_widening(dof).powi(2) };
    let shared = SVector::<f64, P>::from_column_slice(&influence.shared);
    let covariance = inverse * scatter * inverse * widening + shared * shared.transpose();
    if !covariance.iter().all(|c| c.is_finite()) {
        return Err(undetermined(noise_share));
    }
    Ok(((covariance + covariance.transpose()) * 0.5, influence))
}

/// Returns how the parameters follow the points: by the implicit function theorem on Σ g r / v = 0, a point's step δ moves
/// them by −A⁻¹ g nᵀδ / v. Every so many-th point stands for its neighbours. Besides, how they follow what the points share.
fn influence<F: AsRef<[Foot<P>]>, const P: usize>(
    sample: &Sample<'_>,
    feet: &[F],
    inliers: &[usize],
    feigned_a_point: &SMatrix<f64, P, P>,
) -> Option<Influence> {
    let chosen = || inliers.iter().step_by(inliers.len().div_ceil(INFLUENTIAL).max(1));
    let mut information = SMatrix::<f64, P, P>::zeros();
    for foot in chosen().flat_map(|&i| feet[i].as_ref()) {
        information += foot.gradient * foot.gradient.transpose() / foot.variance_mm2;
    }
    let inverse = (information - feigned_a_point * chosen().count() as f64).try_inverse()?;
    let mut shared = SVector::<f64, P>::zeros();
    let one = |(&i, foot): (&usize, &Foot<P>)| {
        let index = sample.order[i];
        let gain = -(inverse * foot.gradient) / foot.variance_mm2;
        let step =
            sample.cloud.shared_mm().map_or_else(Vector3::zeros, |all| all[index].map(f64::from).into());
        shared += gain * foot.normal.dot(&step);
        InfluencePoint { index, normal: foot.normal.into(), gain: gain.iter().copied().collect() }
    };
    let points =
        chosen().flat_map(|i| feet[*i].as_ref().iter().map(move |foot| (i, foot))).map(one).collect();
    Some(Influence { points, shared: shared.iter().copied().collect() })
}

/// Returns the scatter of Σ g r / v, larger where blocks of neighbours on a stripe show more of it than single points.
fn with_shared_errors<F: AsRef<[Foot<P>]>, const P: usize>(
    scatter: SMatrix<f64, P, P>,
    sample: &Sample<'_>,
    feet: &[F],
    inliers: &[usize],
) -> SMatrix<f64, P, P> {
    let images = sample.cloud.frame_rows();
    let image = |i: &usize| images.map(|images| images[sample.order[*i]]);
    let mut blocks = 0;
    let mut shared = SMatrix::<f64, P, P>::zeros();
    let stripes = inliers.chunk_by(|a, b| image(a) == image(b)).filter(|stripe| image(&stripe[0]).is_some());
    for block in stripes.flat_map(|stripe| stripe.chunks(BLOCK)) {
        let pull = |f: &Foot<P>| f.gradient * (f.residual_mm / f.variance_mm2);
        let sum = block
            .iter()
            .flat_map(|&i| feet[i].as_ref())
            .map(pull)
            .fold(SVector::<f64, P>::zeros(), |a, b| a + b);
        shared += sum * sum.transpose();
        blocks += 1;
    }
    if blocks < LEAST_BLOCKS {
        return scatter;
    }
    let chance = (1.0 + (P as f64 / blocks as f64).sqrt()).powi(2);
    let Some(factor) = dynamic(&scatter).cholesky() else { return scatter };
    let root = factor.l();
    let Some(inverse) = root.clone().try_inverse() else { return scatter };
    let eigen = (&inverse * dynamic(&shared) * inverse.transpose()).symmetric_eigen();
    let widened = eigen.eigenvalues.map(|e| if e > chance { e } else { 1.0 });
    let turned = root * eigen.eigenvectors;
    let whole = &turned * DMatrix::from_diagonal(&widened) * turned.transpose();
    SMatrix::from_fn(|i, j| whole[(i, j)])
}

/// Returns the matrix with its size in the value, for decompositions that the size in the type rules out.
fn dynamic<const P: usize>(m: &SMatrix<f64, P, P>) -> DMatrix<f64> {
    DMatrix::from_fn(P, P, |i, j| (m[(i, j)] + m[(j, i)]) * 0.5)
}
