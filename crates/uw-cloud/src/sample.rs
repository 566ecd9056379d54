//! The points that a fit works on: distinct, checked, near the origin, with the principal axes of their covariances where there are any.

use crate::cloud::{PointCloud, unpacked};
use crate::error::{CloudError, FitError};
use crate::plane::square_to;
use crate::robust::median;
use nalgebra::{Matrix3, Vector3};

/// A covariance's negative eigenvalue, in shares of its largest, that its rounding to f32 explains.
const COVARIANCE_ROUNDING: f64 = 1e-5;

/// Points of which the middle is taken: anywhere among them is as good.
const CENTRING: usize = 4096;

/// What is told of a point's error: the principal axes of its covariance, as columns, and the variances along them, mm².
#[derive(Debug, Clone)]
pub(crate) struct Spread {
    axes: Matrix3<f64>,
    variances: Vector3<f64>,
}

/// A point, mm, and what is told of its error.
#[derive(Clone, Copy)]
pub(crate) struct Observation<'a> {
    pub(crate) point: Vector3<f64>,
    pub(crate) spread: Option<&'a Spread>,
}

impl Observation<'_> {
    /// Returns a vector in the principal axes of V = C + f² I; without a covariance any axes are.
    pub(crate) fn in_axes(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        self.spread.map_or(*vector, |spread| spread.axes.tr_mul(vector))
    }

    /// Returns a vector that is given in the principal axes.
    pub(crate) fn out_of_axes(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        self.spread.map_or(*vector, |spread| spread.axes * vector)
    }

    /// Returns the variances of V along the principal axes, mm².
    pub(crate) fn variances(&self, floor_mm: f64) -> Vector3<f64> {
        let floor_mm2 = floor_mm * floor_mm;
        self.spread.map_or(Vector3::repeat(floor_mm2), |spread| spread.variances.add_scalar(floor_mm2))
    }

    /// Returns V, mm².
    pub(crate) fn covariance(&self, floor_mm: f64) -> Matrix3<f64> {
        let variances = Matrix3::from_diagonal(&self.variances(floor_mm));
        self.spread.map_or(variances, |spread| spread.axes * variances * spread.axes.transpose())
    }
}

/// Points, mm, and where there are covariances what they tell of each.
///
/// Apart from each other, since points without covariances are many times as fast where they lie side by side.
pub(crate) struct Observations {
    pub(crate) points: Vec<Vector3<f64>>,
    spreads: Vec<Spread>,
}

impl Observations {
    /// Returns points of whose errors nothing is told.
    pub(crate) fn bare(points: Vec<Vector3<f64>>) -> Self {
        Self { points, spreads: Vec::new() }
    }

    /// Returns the number of points.
    pub(crate) fn len(&self) -> usize {
        self.points.len()
    }

    /// Returns one of them.
    pub(crate) fn get(&self, i: usize) -> Observation<'_> {
        Observation { point: self.points[i], spread: self.spreads.get(i) }
    }
}

/// The distinct points of a cloud, moved to the middle of them so that offsets cost no digits.
pub(crate) struct Sample<'a> {
    /// Where they are from.
    pub(crate) cloud: &'a PointCloud,
    /// The points, relative to the centre.
    pub(crate) observations: Observations,
    /// Which points of the cloud they are.
    pub(crate) order: Vec<usize>,
    /// What was subtracted from the positions, mm.
    pub(crate) centre: Vector3<f64>,
    /// Points left out because another one has the same position.
    pub(crate) duplicates: usize,
    /// Whether the points have covariances (all zero is none).
    pub(crate) has_covariances: bool,
    /// Distances below this are rounding of the coordinates, mm.
    pub(crate) resolution_mm: f64,
}

impl<'a> Sample<'a> {
    /// Returns the points of a cloud for a shape of `unknowns` parameters.
    pub(crate) fn new(cloud: &'a PointCloud, shape: &'static str, unknowns: usize) -> Result<Self, FitError> {
        check_positions(cloud)?;
        Self::of(cloud, (0..cloud.len()).collect(), shape, unknowns)
    }

    /// Returns some points of a cloud that was checked, by their indices.
    pub(crate) fn of(
        cloud: &'a PointCloud,
        mut order: Vec<usize>,
        shape: &'static str,
        unknowns: usize,
    ) -> Result<Self, FitError> {
        let given = order.len();
        order.sort_unstable();
        keep_first(&mut order, cloud.positions_mm());
        let covariances = cloud.covariances_mm2().filter(|all| all.iter().flatten().any(|&c| c != 0.0));
        let needed = unknowns + usize::from(covariances.is_none());
        if order.len() < needed {
            return Err(FitError::TooFewPoints { shape, needed, got: order.len() });
        }
        let some = || order.iter().step_by(order.len().div_ceil(CENTRING));
        let middle =
            |axis: usize| median(&mut some().map(|&i| cloud.positions_mm()[i][axis]).collect::<Vec<_>>());
        let centre = Vector3::new(middle(0), middle(1), middle(2));
        let mut largest = 0.0_f64;
        let mut points = Vec::with_capacity(order.len());
        let mut spreads = Vec::with_capacity(covariances.map_or(0, |_| order.len()));
        for &index in &order {
            let position = cloud.vector(index);
            largest = largest.max(position.amax());
            points.push(position - centre);
            if let Some(covariance) = covariances.map(|all| &all[index]) {
                let spread = principal(covariance);
                spreads.push(
                    spread.map_err(|variance_mm2| FitError::InvalidCovariance { index, variance_mm2 })?,
                );
            }
        }
        Ok(Self {
            duplicates: given - order.len(),
            cloud,
            observations: Observations { points, spreads },
            order,
            centre,
            has_covariances: covariances.is_some(),
            resolution_mm: 16.0 * f64::EPSILON * largest,
        })
    }
}

/// Keeps the first of the points that share a position, by a table of hashes: time grows as their number.
fn keep_first(order: &mut Vec<usize>, positions: &[[f64; 3]]) {
    // Plus nil, so that there is one nil.
    let key = |i: usize| positions[i].map(|c| (c + 0.0).to_bits());
    let slots = (2 * order.len()).next_power_of_two().max(2);
    let mut table = vec![usize::MAX; slots];
    order.retain(|&i| {
        let own = key(i);
        let mixed = own.iter().fold(0_u64, |hash, bits| {
            let mixed = (hash ^ bits).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            mixed ^ (mixed >> 29)
        });
        let mut slot = mixed as usize & (slots - 1);
        loop {
            match table[slot] {
                usize::MAX => {
                    table[slot] = i;
                    return true;
                }
                other if key(other) == own => return false,
                _ => slot = (slot + 1) & (slots - 1),
            }
        }
    });
}

impl Sample<'_> {
    /// Returns the positions of some of the observations.
    pub(crate) fn points(&self, chosen: &[usize]) -> Vec<Vector3<f64>> {
        chosen.iter().map(|&i| self.observations.points[i]).collect()
    }

    /// Returns which points of the cloud some of the observations are.
    pub(crate) fn indices(&self, chosen: &[usize]) -> Vec<usize> {
        chosen.iter().map(|&i| self.order[i]).collect()
    }
}

/// Returns what a covariance tells of its point; the negative variance where it is no covariance.
///
/// A scanner's is of rank one but for rounding, and then known without an eigenvalue problem.
fn principal(covariance: &[f32; 6]) -> Result<Spread, f64> {
    let matrix = unpacked(covariance);
    let column = matrix.column(matrix.diagonal().imax());
    if let Some(axis) = column.try_normalize(0.0) {
        let variance = axis.dot(&(matrix * axis));
        if variance > 0.0
            && (matrix - axis * axis.transpose() * variance).amax() <= COVARIANCE_ROUNDING * variance
        {
            let [first, second] = square_to(&axis);
            let axes = Matrix3::from_columns(&[axis, first, second]);
            return Ok(Spread { axes, variances: Vector3::new(variance, 0.0, 0.0) });
        }
    }
    let eigen = matrix.symmetric_eigen();
    let least = eigen.eigenvalues.min();
    if least < -COVARIANCE_ROUNDING * eigen.eigenvalues.max() {
        return Err(least);
    }
    Ok(Spread { axes: eigen.eigenvectors, variances: eigen.eigenvalues.map(|v| v.max(0.0)) })
}

/// Checks that all that a fit uses is finite, and small enough for squares of it to be.
pub(crate) fn check_positions(cloud: &PointCloud) -> Result<(), CloudError> {
    let usable = |value: f64| value.abs() < 1e100;
    let bad = |attribute, index| CloudError::NonFinite { attribute, index };
    if let Some(index) = cloud.positions_mm().iter().position(|p| !p.iter().all(|&c| usable(c))) {
        return Err(bad("position", index));
    }
    let covariances = cloud.covariances_mm2().unwrap_or_default();
    if let Some(index) = covariances.iter().position(|c| !c.iter().all(|c| c.is_finite())) {
        return Err(bad("covariance", index));
    }
    let shared = cloud.shared_mm().unwrap_or_default();
    match shared.iter().position(|s| !s.iter().all(|s| s.is_finite())) {
        Some(index) => Err(bad("shared error", index)),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn principal_axes_make_the_covariance_again() {
        let along = Vector3::new(0.3, -0.1, 1.2);
        let rank_one = along * along.transpose();
        let full = rank_one + Matrix3::from_diagonal(&Vector3::new(0.01, 0.02, 0.03));
        for matrix in [rank_one, full, Matrix3::zeros(), Matrix3::identity()] {
            let packed = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|at| matrix[at] as f32);
            let Spread { axes, variances } = principal(&packed).unwrap();
            let again = axes * Matrix3::from_diagonal(&variances) * axes.transpose();
            // f32 holds seven digits.
            assert!((again - matrix).amax() < 1e-6, "{matrix} {again}");
            assert!((axes.transpose() * axes - Matrix3::identity()).amax() < 1e-12);
        }
        assert!(principal(&[-1.0, 0.0, 0.0, 0.0, 0.0, 0.0]).is_err_and(|least| (least + 1.0).abs() < 1e-6));
        assert!(principal(&[1.0, 0.0, 0.0, 1.0, 0.0, -0.5]).is_err());
    }
}
