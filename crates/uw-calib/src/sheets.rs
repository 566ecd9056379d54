//! The laser's planes one voltage at a time, and the mirror's axis from them (PAPER §2, S4 and S5, mended).

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use uw_geom::{Medium, Plane, Port};

/// The laser's plane at one voltage, camera frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoltagePlane {
    /// The voltage.
    pub voltage_v: f64,
    /// The plane.
    pub plane: Plane,
    /// Middle of the points that it was fitted to, mm.
    pub middle_mm: Vector3<f64>,
}

/// Points of one board lie on a line: below this ratio of the second to the first standard deviation a plane through them is
/// open. Boards a hand's breadth apart give 0.1 and more.
const FLAT_RATIO: f64 = 0.01;
/// Rounds of reweighting.
const ROUNDS: usize = 12;
/// Residuals beyond so many robust sigmas count less (Huber).
const HUBER_SIGMAS: f64 = 2.0;
/// Rounds after which the plane is near enough for residuals beyond twice that not to count at all.
const ROUNDS_BEFORE_TRIMMING: usize = 6;

/// The plane closest to the points (total least squares, unit normal and offset, in place of the paper's Eq 4; robust by
/// reweighting); `None` where they don't determine one.
pub fn robust_plane(points: &[Vector3<f64>]) -> Option<Plane> {
    let mut weights = vec![1.0; points.len()];
    let mut plane = None;
    for round in 0..ROUNDS {
        let total: f64 = weights.iter().sum();
        let middle = std::iter::zip(points, &weights).map(|(p, w)| p * *w).sum::<Vector3<f64>>() / total;
        let spread = std::iter::zip(points, &weights)
            .map(|(p, w)| (p - middle) * (p - middle).transpose() * *w)
            .sum::<Matrix3<f64>>()
            / total;
        if points.len() < 3 || !spread.iter().all(|x| x.is_finite()) {
            return None;
        }
        let eigen = SymmetricEigen::new(spread);
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let [smallest, second, first] = order.map(|i| eigen.eigenvalues[i].max(0.0).sqrt());
        if second <= FLAT_RATIO * first || second <= 3.0 * smallest {
            return None;
        }
        let found = Plane::through(&middle, &eigen.eigenvectors.column(order[0]).into_owned()).ok()?;
        let residuals: Vec<f64> = points.iter().map(|p| found.distance_mm(p).abs()).collect();
        let mut sorted = residuals.clone();
        sorted.sort_by(f64::total_cmp);
        let limit = HUBER_SIGMAS * 1.4826 * sorted[sorted.len() / 2];
        for (w, r) in std::iter::zip(&mut weights, residuals) {
            *w = match r > limit {
                false => 1.0,
                true if round >= ROUNDS_BEFORE_TRIMMING && r > 2.0 * limit => 0.0,
                true => limit / r,
            };
        }
        plane = Some(found);
    }
    plane
}

/// Direction and a point of the line closest to all planes; `None` with fewer than two planes, or parallel ones.
///
/// The direction is the eigenvector of Σ n nᵀ with the smallest eigenvalue (the paper's Eq 6 is linear in it, and has its
/// minimum elsewhere); the point minimises Σ (n·p + d)².
pub fn axis_of(planes: &[VoltagePlane]) -> Option<(Vector3<f64>, Vector3<f64>)> {
    if planes.len() < 2 {
        return None;
    }
    let sum: Matrix3<f64> = planes.iter().map(|p| p.plane.normal * p.plane.normal.transpose()).sum();
    let eigen = SymmetricEigen::new(sum);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    // Planes that all but coincide turn about nothing: 1e-8 of variance is 0.1 mrad of turn.
    if eigen.eigenvalues[order[1]] <= 1e-8 * eigen.eigenvalues[order[2]] {
        return None;
    }
    let axis: Vector3<f64> = eigen.eigenvectors.column(order[0]).into_owned();
    let right: Vector3<f64> = planes.iter().map(|p| p.plane.normal * -p.plane.offset_mm).sum();
    // Along the axis the planes say nothing: take the point closest to the origin.
    let closed = sum + axis * axis.transpose();
    let point = closed.try_inverse()? * (right - axis * axis.dot(&right));
    Some((axis, point))
}

impl VoltagePlane {
    /// The plane in air of which this is the refraction in `outside`, about right: Snell's law in the plane square to its
    /// trace on the window, which is taken to lie as far out as the camera's.
    pub(crate) fn taken_to_air(&self, port: &Port, outside: Medium) -> Option<Self> {
        let n = port.normal;
        let trace = self.plane.normal.cross(&n).try_normalize(1e-9)?;
        let in_water = trace.cross(&self.plane.normal);
        let in_water = in_water * in_water.dot(&n).signum();
        let side = in_water - n * in_water.dot(&n);
        let sine = outside.index * side.norm();
        if sine >= 1.0 {
            return None;
        }
        let in_air = n * (1.0 - sine * sine).sqrt() + side * outside.index;
        // Where plane and outer face meet, closest to the middle of the points.
        let face = port.distance_mm + port.thickness_mm;
        let down = (self.middle_mm.dot(&n) - face) / in_water.dot(&n);
        let plane = Plane::through(&(self.middle_mm - in_water * down), &trace.cross(&in_air)).ok()?;
        Some(Self { plane, ..*self })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of sums of numbers near 1000 mm.
    const ROUNDING_MM: f64 = 1e-6;

    #[test]
    fn the_axis_of_planes_through_a_line_is_that_line() {
        let (axis, point) = (Vector3::new(0.02, -1.0, 0.01).normalize(), Vector3::new(400.0, 3.0, -12.0));
        let planes: Vec<VoltagePlane> = (0..5)
            .map(|i| {
                let turn = nalgebra::Rotation3::from_axis_angle(
                    &nalgebra::Unit::new_normalize(axis),
                    0.03 * f64::from(i),
                );
                let normal = turn * axis.cross(&Vector3::new(0.9, 0.1, 0.4));
                let plane = Plane::through(&point, &normal).unwrap();
                VoltagePlane { voltage_v: f64::from(i), plane, middle_mm: point }
            })
            .collect();
        let (a, p) = axis_of(&planes).unwrap();
        assert!(a.cross(&axis).norm() < 1e-9);
        assert!((p - point).cross(&axis).norm() < ROUNDING_MM);
        assert!(axis_of(&planes[..1]).is_none());
        assert!(axis_of(&[planes[0], planes[0]]).is_none());
    }

    #[test]
    fn a_plane_is_found_among_outliers_and_refused_on_a_line() {
        let on = |x: f64, y: f64| Vector3::new(x, y, 0.3 * x - 0.1 * y + 700.0);
        let mut points: Vec<_> =
            (0..200).map(|i| on(f64::from(i % 20) * 10.0, f64::from(i / 20) * 20.0)).collect();
        points.extend((0..30).map(|i| on(f64::from(i), 50.0) + Vector3::new(0.0, 0.0, 40.0)));
        let plane = robust_plane(&points).unwrap();
        let normal = Vector3::new(0.3, -0.1, -1.0).normalize();
        assert!(plane.normal.cross(&normal).norm() < 2e-3, "{plane:?}");
        let line: Vec<_> = (0..50).map(|i| on(f64::from(i), 2.0 * f64::from(i))).collect();
        assert!(robust_plane(&line).is_none());
        assert!(robust_plane(&[]).is_none());
    }
}
