//! How far points lie from a fitted shape, and how the shape follows them.

use crate::floor::Floor;
use nalgebra::{DMatrix, Matrix3xX};

/// How far the points lie from the fitted shape, and how many there are.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Deviations {
    /// Points that the shape was fitted to.
    pub points: usize,
    /// Points rejected: farther off than their sigma and the number of points explain.
    pub outliers: usize,
    /// Points left out because another one has the same position.
    pub duplicates: usize,
    /// Root mean square of the fitted points' orthogonal distances, mm.
    pub rms_mm: f64,
    /// Largest orthogonal distance of a fitted point on the outside (for a plane: the sensor's side), mm, not negative.
    pub max_outside_mm: f64,
    /// Largest orthogonal distance of a fitted point on the inside, mm, not negative.
    pub max_inside_mm: f64,
    /// How many fitted points lie how far off.
    pub histogram: Histogram,
    /// φ = chi² / dof against the covariances and the noise floor; above 1 the sigmas are widened by its root. `None`
    /// without covariances, where the points' scatter is the sigma.
    pub scale: Option<f64>,
    /// Standard deviation, mm, of what the covariances do not tell (roughness, form error), as estimated
    /// together with the scale; `None` without covariances.
    pub floor_mm: Option<f64>,
}

impl Deviations {
    /// Returns the statistics of the fitted points' signed distances, out of `distinct` points.
    pub(crate) fn new(
        distances_mm: &[f64],
        distinct: usize,
        duplicates: usize,
        floor: Option<Floor>,
    ) -> Self {
        let all = || distances_mm.iter().copied();
        Self {
            points: distances_mm.len(),
            outliers: distinct - distances_mm.len(),
            duplicates,
            rms_mm: (all().map(|d| d * d).sum::<f64>() / distances_mm.len().max(1) as f64).sqrt(),
            max_outside_mm: all().fold(0.0, f64::max),
            max_inside_mm: all().fold(0.0, |deepest, d| deepest.max(-d)),
            histogram: Histogram::new(distances_mm),
            scale: floor.map(|f| f.scale),
            floor_mm: floor.map(|f| f.likely_mm * f.scale.sqrt()),
        }
    }
}

/// Numbers of distances in classes of equal width, from −`reach_mm` to `reach_mm`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Histogram {
    /// The largest distance's size, mm.
    pub reach_mm: f64,
    /// Distances in each class, the most negative ones first.
    pub counts: [usize; Self::CLASSES],
}

impl Histogram {
    /// Number of classes; odd, so that the middle one is about zero.
    pub const CLASSES: usize = 31;

    fn new(distances_mm: &[f64]) -> Self {
        let reach_mm = distances_mm.iter().fold(0.0_f64, |reach, d| reach.max(d.abs()));
        let mut counts = [0; Self::CLASSES];
        for distance in distances_mm {
            let share = if reach_mm > 0.0 { 0.5 + 0.5 * distance / reach_mm } else { 0.5 };
            counts[((share * Self::CLASSES as f64) as usize).min(Self::CLASSES - 1)] += 1;
        }
        Self { reach_mm, counts }
    }

    /// Returns the classes mirrored: distances with the other sign.
    pub(crate) fn flipped(mut self) -> Self {
        self.counts.reverse();
        self
    }
}

/// How a fitted shape follows steps of its points: what turns errors that points share, such as a calibration's, into errors
/// of the shape.
///
/// A step δ of every point moves the parameters by Σ gain (normal · δ), summed over [`Influence::points`]; the parameters are
/// those of the fit's covariance, in its order. Where a shape has very many points, some stand for their neighbours.
#[derive(Clone, PartialEq, Default)]
pub struct Influence {
    /// The points.
    pub points: Vec<InfluencePoint>,
    /// The parameters' step where what the cloud's points share ([`PointCloud::shared_mm`](crate::PointCloud::shared_mm)) is off by one standard deviation; nil
    /// where they tell none.
    pub shared: Vec<f64>,
}

/// The influence of one point.
#[derive(Debug, Clone, PartialEq)]
pub struct InfluencePoint {
    /// Which point of the cloud, from 0.
    pub index: usize,
    /// The direction in which a step counts: the shape's unit normal.
    pub normal: [f64; 3],
    /// What a millimetre along it changes, by the parameters.
    pub gain: Vec<f64>,
}

impl std::fmt::Debug for Influence {
    /// Thousands of points would hide all else of a fit.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Influence of {} points", self.points.len())
    }
}

impl Influence {
    /// Returns the influence on other parameters, from their derivatives by these (`rows` × these).
    pub(crate) fn mapped(mut self, jacobian: &DMatrix<f64>) -> Self {
        let map = |of: &[f64]| (jacobian * nalgebra::DVector::from_column_slice(of)).as_slice().to_vec();
        for point in &mut self.points {
            point.gain = map(&point.gain);
        }
        self.shared = map(&self.shared);
        self
    }

    /// Returns the derivatives of the parameters (rows) by what moves the points (columns): `per_cause` gives the derivatives of
    /// a point's position, mm; `None` leaves the point out.
    pub fn sensitivity(
        &self,
        causes: usize,
        mut per_cause: impl FnMut(usize) -> Option<Matrix3xX<f64>>,
    ) -> Option<DMatrix<f64>> {
        let rows = self.points.first()?.gain.len();
        let mut total = DMatrix::zeros(rows, causes);
        for point in &self.points {
            let moves = per_cause(point.index)?;
            let along = nalgebra::RowVector3::from(point.normal) * moves;
            total += nalgebra::DVector::from_column_slice(&point.gain) * along;
        }
        Some(total)
    }
}
