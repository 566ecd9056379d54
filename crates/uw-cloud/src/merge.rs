//! Overlapping sweeps as one cloud: each brought onto the others' surfaces, all at once.
//!
//! Every sweep is triangulated ([`triangulate`]), which tells where its surface ends. Sweep by sweep joins those that are placed, by
//! [`register_sweep`](crate::register_sweep()). Then all poses together minimise the distances of every sweep's points from every other's, across the
//! surface and each in units of its own sigma (all-to-all generalised ICP), so that errors don't add up along a chain. The first sweep's frame stays.

use crate::cloud::PointCloud;
use crate::error::{MergeError, RegisterError, SurfaceError};
use crate::register::{Joint, Registration, Samples, Start, SweepSurface, joint, register_samples};
use crate::surface::{Surface, SurfaceOptions, triangulate};
use nalgebra::{Isometry3, Matrix6};

/// How sweeps are merged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MergeOptions {
    /// Share of a sweep's points that must lie on another one's surface for the two to be joined.
    pub least_overlap: f64,
    /// Where all clouds' coordinates agree already to within this distance, mm; `None`: they may have been taken from anywhere.
    pub near_mm: Option<f64>,
}

impl Default for MergeOptions {
    fn default() -> Self {
        Self { least_overlap: 0.2, near_mm: None }
    }
}

/// Sweeps brought together.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Merged {
    /// All points, in the frame of the first cloud, none averaged: attributes that all have, covariances turned along; no frame rows and
    /// no pixels, which belong to one capture.
    pub cloud: PointCloud,
    /// Moves each cloud into the first one's frame.
    pub poses: Vec<Isometry3<f64>>,
    /// Covariance of each pose beside the first one's (turn about the middle of all points in rad, shift in mm, the first cloud's
    /// axes). Errors that the points of a sweep share are not in it, and it is not added to the points' own.
    pub covariances: Vec<Matrix6<f64>>,
    /// What lies on what, for every two sweeps that overlap.
    pub pairs: Vec<PairResidual>,
    /// What to know before trusting it, in whole sentences.
    pub warnings: Vec<String>,
}

/// How one sweep's points lie on another's surface, when all poses are settled.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct PairResidual {
    /// The sweep whose points are looked at, from 0.
    pub points_of: usize,
    /// The sweep whose surface they lie on.
    pub surface_of: usize,
    /// Share of the points that lie on it.
    pub overlap: f64,
    /// Root mean square of their distances, mm.
    pub rms_mm: f64,
    /// What of it the two sweeps' own sigmas do not tell, mm.
    pub floor_mm: f64,
}

/// Returns clouds of one scene as one.
///
/// # Errors
/// [`MergeError`] for fewer than two clouds, one that has no surface, one of which no overlap with the others is found, and one whose
/// overlap tells several poses or a whole path of them.
pub fn merge(clouds: &[PointCloud], options: &MergeOptions) -> Result<Merged, MergeError> {
    if clouds.len() < 2 {
        return Err(MergeError::TooFew { got: clouds.len() });
    }
    let mut surfaces: Vec<Surface> = Vec::with_capacity(clouds.len());
    for (index, cloud) in clouds.iter().enumerate() {
        let surface = triangulate(cloud, &SurfaceOptions::default());
        surfaces.push(surface.map_err(|cause| MergeError::NoSurface { index, cause })?);
    }
    let mut sweeps: Vec<SweepSurface<'_>> = Vec::with_capacity(clouds.len());
    for (index, (cloud, surface)) in clouds.iter().zip(&surfaces).enumerate() {
        let sweep = SweepSurface::new(cloud, surface).map_err(RegisterError::from)?;
        sweeps.push(sweep.ok_or(MergeError::NoSurface { index, cause: SurfaceError::NoArea })?);
    }
    let samples: Vec<Samples> = sweeps.iter().map(Samples::of_sweep).collect::<Result<_, _>>()?;
    let mut warnings = Vec::new();
    let starts = placed(&samples, &sweeps, options, &mut warnings)?;
    let Joint { poses, covariances, pairs, settled } = joint(&sweeps, &samples, starts)?;
    if !settled {
        warnings.push("the poses had not settled when the rounds ran out".to_owned());
    }
    let moved: Vec<PointCloud> = clouds
        .iter()
        .zip(&poses)
        .map(|(cloud, pose)| cloud.clone().transformed(clouds[0].frame(), pose))
        .collect();
    let pairs: Vec<PairResidual> = pairs.into_iter().filter(|pair| pair.overlap > 0.0).collect();
    Ok(Merged { cloud: PointCloud::joined(&moved), poses, covariances, pairs, warnings })
}

/// Poses into the first cloud's frame, sweep by sweep: always the one that overlaps most with one that is placed.
fn placed(
    samples: &[Samples],
    sweeps: &[SweepSurface<'_>],
    options: &MergeOptions,
    warnings: &mut Vec<String>,
) -> Result<Vec<Isometry3<f64>>, MergeError> {
    let mut poses: Vec<Option<Isometry3<f64>>> = vec![None; samples.len()];
    poses[0] = Some(Isometry3::identity());
    // What was found of (cloud, onto), the best of each cloud that is not placed.
    let mut best: Vec<Option<(Registration, usize)>> = vec![None; samples.len()];
    let mut newest = 0;
    for _ in 1..samples.len() {
        for (index, own) in samples.iter().enumerate().filter(|(index, _)| poses[*index].is_none()) {
            let start = match (options.near_mm, poses[newest]) {
                (Some(near), Some(pose)) => Start::Near(pose.inverse(), near),
                _ => Start::Anywhere,
            };
            let Ok(found) = register_samples(own, &sweeps[newest], start, options.least_overlap) else {
                continue;
            };
            let better = |(other, _): &(Registration, usize)| rank(&found) > rank(other);
            if best[index].as_ref().is_none_or(better) {
                best[index] = Some((found, newest));
            }
        }
        let open = |index: &usize| poses[*index].is_none();
        let candidates = (0..samples.len()).filter(open).filter_map(|i| Some((i, best[i].as_ref()?)));
        let next = candidates.max_by(|a, b| rank(&a.1.0).total_cmp(&rank(&b.1.0)));
        let Some((index, (found, onto))) = next else {
            let index = (0..samples.len()).find(|i| poses[*i].is_none()).unwrap_or_default();
            return Err(MergeError::NoOverlap { index, needed: options.least_overlap });
        };
        if !found.rivals.is_empty() {
            return Err(MergeError::Ambiguous { index, poses: found.rivals.len() + 1 });
        }
        if !found.undetermined.is_empty() {
            let motions = found.undetermined.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
            if options.near_mm.is_none() {
                return Err(MergeError::Undetermined { index, motions });
            }
            warnings.push(format!(
                "cloud {} and {}: the overlap does not determine {motions}; the clouds' own coordinates are kept along it",
                index + 1,
                onto + 1
            ));
        }
        poses[index] = poses[*onto].map(|pose| pose * found.mesh_from_cloud);
        newest = index;
    }
    Ok(poses.into_iter().map(Option::unwrap_or_default).collect())
}

/// What is preferred: a pose that is the only one, then a large overlap.
fn rank(found: &Registration) -> f64 {
    let plain = found.rivals.is_empty() && found.undetermined.is_empty();
    found.overlap + f64::from(u8::from(plain))
}
