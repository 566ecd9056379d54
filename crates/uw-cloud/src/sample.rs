//! The points that a fit works on: distinct, checked, near the origin, with the principal axes of their covariances.

use crate::cloud::{PointCloud, unpacked};
use crate::error::{CloudError, FitError};
use crate::plane::square_to;
use crate::robust::median;
use nalgebra::{Matrix3, Vector3};

/// A covariance's negative eigenvalue, in shares of its largest, that its rounding to f32 explains.
const COVARIANCE_ROUNDING: f64 = 1e-5;

/// One point, relative to the centre of its [`Sample`], with the principal axes of its covariance.
#[derive(Debug, Clone)]
pub(crate) struct Observation {
    /// Position, mm.
    pub(crate) point: Vector3<f64>,
    /// Principal axes of the covariance, as columns.
    pub(crate) axes: Matrix3<f64>,
    /// Variances along them, mm².
    pub(crate) variances: Vector3<f64>,
    /// Its step where the error that all points share is off by one standard deviation, mm.
    pub(crate) shared: Vector3<f64>,
    /// The image that it was seen in.
    pub(crate) image: Option<u32>,
    /// Which point of the cloud it is.
    pub(crate) index: usize,
}

impl Observation {
    /// Returns a position without anything else.
    pub(crate) fn at(point: Vector3<f64>) -> Self {
        Self {
            point,
            axes: Matrix3::identity(),
            variances: Vector3::zeros(),
            shared: Vector3::zeros(),
            image: None,
            index: 0,
        }
    }

    /// Returns whether nothing is told of its errors.
    pub(crate) fn is_bare(&self) -> bool {
        self.variances.iter().all(|variance| *variance <= 0.0)
    }

    /// Returns the same position without its covariance.
    pub(crate) fn bare(&self) -> Self {
        Self { axes: Matrix3::identity(), variances: Vector3::zeros(), ..self.clone() }
    }

    /// Returns V = C + f² I, mm².
    pub(crate) fn covariance(&self, floor_mm: f64) -> Matrix3<f64> {
        let variances = self.variances.add_scalar(floor_mm * floor_mm);
        self.axes * Matrix3::from_diagonal(&variances) * self.axes.transpose()
    }
}

/// The distinct points of a cloud, moved to the middle of them so that offsets cost no digits.
pub(crate) struct Sample {
    /// The points.
    pub(crate) observations: Vec<Observation>,
    /// What was subtracted from the positions, mm.
    pub(crate) centre: Vector3<f64>,
    /// Points left out because another one has the same position.
    pub(crate) duplicates: usize,
    /// Whether the points have covariances (all zero is none).
    pub(crate) has_covariances: bool,
    /// Distances below this are rounding of the coordinates, mm.
    pub(crate) resolution_mm: f64,
}

impl Sample {
    /// Returns the points of a cloud for a shape of `unknowns` parameters.
    pub(crate) fn new(cloud: &PointCloud, shape: &'static str, unknowns: usize) -> Result<Self, FitError> {
        check_positions(cloud)?;
        Self::of(cloud, (0..cloud.len()).collect(), shape, unknowns)
    }

    /// Returns some points of a cloud that was checked, by their indices.
    pub(crate) fn of(
        cloud: &PointCloud,
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
        let middle = |axis: usize| {
            median(&mut order.iter().map(|&i| cloud.positions_mm()[i][axis]).collect::<Vec<_>>())
        };
        let centre = Vector3::new(middle(0), middle(1), middle(2));
        let mut largest = 0.0_f64;
        let mut observations = Vec::with_capacity(order.len());
        for &index in &order {
            let position = cloud.vector(index);
            largest = largest.max(position.amax());
            let mut observation = Observation {
                point: position - centre,
                axes: Matrix3::identity(),
                variances: Vector3::zeros(),
                shared: cloud.shared_mm().map_or_else(Vector3::zeros, |all| all[index].map(f64::from).into()),
                image: cloud.frame_rows().map(|rows| rows[index]),
                index,
            };
            if let Some(covariance) = covariances.map(|all| &all[index]) {
                (observation.axes, observation.variances) = principal(covariance)
                    .map_err(|variance_mm2| FitError::InvalidCovariance { index, variance_mm2 })?;
            }
            observations.push(observation);
        }
        Ok(Self {
            duplicates: given - order.len(),
            observations,
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

impl Sample {
    /// Returns the positions of some of the observations.
    pub(crate) fn points(&self, chosen: &[usize]) -> Vec<Vector3<f64>> {
        chosen.iter().map(|&i| self.observations[i].point).collect()
    }

    /// Returns which points of the cloud some of the observations are.
    pub(crate) fn indices(&self, chosen: &[usize]) -> Vec<usize> {
        chosen.iter().map(|&i| self.observations[i].index).collect()
    }
}

/// Returns the principal axes of a covariance, as columns, and the variances along them, mm²; the negative variance where it is
/// no covariance.
///
/// A scanner's is of rank one but for rounding, and then known without an eigenvalue problem.
fn principal(covariance: &[f32; 6]) -> Result<(Matrix3<f64>, Vector3<f64>), f64> {
    let matrix = unpacked(covariance);
    let column = matrix.column(matrix.diagonal().imax());
    if let Some(axis) = column.try_normalize(0.0) {
        let variance = axis.dot(&(matrix * axis));
        if variance > 0.0
            && (matrix - axis * axis.transpose() * variance).amax() <= COVARIANCE_ROUNDING * variance
        {
            let [first, second] = square_to(&axis);
            return Ok((Matrix3::from_columns(&[axis, first, second]), Vector3::new(variance, 0.0, 0.0)));
        }
    }
    let eigen = matrix.symmetric_eigen();
    let least = eigen.eigenvalues.min();
    if least < -COVARIANCE_ROUNDING * eigen.eigenvalues.max() {
        return Err(least);
    }
    Ok((eigen.eigenvectors, eigen.eigenvalues.map(|v| v.max(0.0))))
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
            let (axes, variances) = principal(&packed).unwrap();
            let again = axes * Matrix3::from_diagonal(&variances) * axes.transpose();
            // f32 holds seven digits.
            assert!((again - matrix).amax() < 1e-6, "{matrix} {again}");
            assert!((axes.transpose() * axes - Matrix3::identity()).amax() < 1e-12);
        }
        assert!(principal(&[-1.0, 0.0, 0.0, 0.0, 0.0, 0.0]).is_err_and(|least| (least + 1.0).abs() < 1e-6));
        assert!(principal(&[1.0, 0.0, 0.0, 1.0, 0.0, -0.5]).is_err());
    }
}
