//! How well a pose is known: what neighbours share of their errors is counted once, and what noise adds to the slopes not at all.

use super::sample::Match;
use crate::error::CloudError;
use crate::neighbours::Neighbours;
use nalgebra::{DMatrix, Vector3};

/// Points of a patch, where there are enough for so many patches. Points that are laid onto the same few of another sweep, or whose normals come of the same
/// neighbours, have errors in common; those of a patch of twice the size have hardly more.
const OF_A_PATCH: usize = 48;
const PATCHES: usize = 100;
/// The least share of an information that is believed to be form rather than noise of the normals.
const LEAST_FORM: f64 = 0.3;
/// The least information that is any, as a share of the best known motion's.
const ANY: f64 = 1e-9;

/// Returns points, by their index, in patches.
pub(super) fn patches(places: &[Vector3<f64>]) -> Result<Vec<Vec<usize>>, CloudError> {
    let places: Vec<[f64; 3]> = places.iter().map(|place| (*place).into()).collect();
    let order: Vec<usize> = Neighbours::new(&places)?.in_order().collect();
    Ok(order.chunks(patch_size(order.len())).map(<[usize]>::to_vec).collect())
}

/// Returns how many of so many points are a patch, where what is near in their order is near in space.
pub(super) fn patch_size(points: usize) -> usize {
    (points / PATCHES).clamp(1, OF_A_PATCH)
}

/// Returns by how much a scatter of so many patches' sums is too small, the solution having followed them with so many unknowns.
pub(super) fn followed(patches: usize, unknowns: usize) -> f64 {
    patches as f64 / patches.saturating_sub(unknowns).max(1) as f64
}

/// Returns the mean slope of the influence over the mean weight: what reweighting hides of the curvature (P. Huber, Robust Statistics, 1981, section 7.6).
pub(super) fn bent(matches: &[Match]) -> f64 {
    let (weights, slopes) =
        matches.iter().fold((0.0, 0.0), |(weights, slopes), m| (weights + m.weight(), slopes + m.slope()));
    if weights > 0.0 { (slopes / weights).max(0.1) } else { 1.0 }
}

/// Returns what a gradient's scatter becomes a pose's by from both sides: the inverse of the information of the forms.
///
/// Noisy normals tell more of a motion than the form does: their squares have the noise's in them. Products of the two surfaces' normals, whose errors
/// have nothing to do with each other, don't; but they need not be positive where there is nothing but noise. So they are taken as shares of the former.
pub(super) fn form_inverse(squares: &DMatrix<f64>, products: &DMatrix<f64>) -> DMatrix<f64> {
    let eigen = squares.clone().symmetric_eigen();
    let most = eigen.eigenvalues.max();
    let known: Vec<usize> =
        (0..eigen.eigenvalues.len()).filter(|&k| eigen.eigenvalues[k] > ANY * most).collect();
    if known.is_empty() {
        return DMatrix::zeros(squares.nrows(), squares.nrows());
    }
    let unit = DMatrix::from_fn(squares.nrows(), known.len(), |row, k| {
        eigen.eigenvectors[(row, known[k])] / eigen.eigenvalues[known[k]].sqrt()
    });
    let shares = (unit.transpose() * products * &unit).symmetric_eigen();
    let inverse = DMatrix::from_diagonal(&shares.eigenvalues.map(|share| 1.0 / share.clamp(LEAST_FORM, 1.0)));
    let ways = unit * shares.eigenvectors;
    &ways * inverse * ways.transpose()
}
