//! A shape as the search knows it: no covariance, only where its surface is.

use crate::cloud::PointCloud;
use crate::cylinder::{self, Tube};
use crate::error::FitError;
use crate::shapes::ShapeFit;
use crate::{plane, sphere};
use nalgebra::{Unit, Vector3};

/// A point and the normal that its neighbours tell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Oriented {
    pub(super) point: Vector3<f64>,
    pub(super) normal: Vector3<f64>,
    /// How far from a surface it may lie to be of it, mm.
    pub(super) tolerance: f64,
    /// How far away the neighbours are that the normal comes from, mm.
    pub(super) reach: f64,
    /// The image that it was seen in, if the cloud tells any.
    pub(super) row: Option<u32>,
}

/// A plane, a sphere or a cylinder.
#[derive(Debug, Clone, Copy)]
pub(super) enum Primitive {
    Plane { normal: Unit<Vector3<f64>>, anchor: Vector3<f64> },
    Sphere { center: Vector3<f64>, radius: f64 },
    Cylinder(Tube),
}

/// Whether a squared distance from a middle is the radius to within a tolerance.
#[inline]
fn within_shell(length2: f64, radius: f64, tolerance: f64) -> bool {
    let (low, high) = ((radius - tolerance).max(0.0), radius + tolerance);
    length2 >= low * low && length2 <= high * high
}

/// Kinds in the order of their number of parameters: of two that explain as much the first is the better.
pub(super) const KINDS: usize = 3;

/// A radius in units of the distance of the two points that it was taken from, beyond which they may as well be of a plane.
const FLATTEST: f64 = 30.0;

impl Primitive {
    pub(super) fn kind(&self) -> usize {
        match self {
            Self::Plane { .. } => 0,
            Self::Sphere { .. } => 1,
            Self::Cylinder(_) => 2,
        }
    }

    /// Returns the number of its parameters.
    pub(super) fn parameters(&self) -> usize {
        self.kind() + 3
    }

    /// Returns the shapes through two oriented points, of each kind at most one.
    pub(super) fn through(a: &Oriented, b: &Oriented) -> [Option<Self>; KINDS] {
        let apart = b.point - a.point;
        let distance = apart.norm();
        let tolerance = a.tolerance + b.tolerance;
        if distance.is_nan() || distance <= 0.0 {
            return [None; KINDS];
        }
        let plane = a.normal + b.normal;
        let plane = Unit::try_new(plane, 1.0)
            .filter(|n| n.dot(&apart).abs() <= tolerance)
            .map(|normal| Self::Plane { normal, anchor: a.point + apart * 0.5 });
        // Where the two normals' lines are nearest to each other.
        let cosine = a.normal.dot(&b.normal);
        let sine2 = 1.0 - cosine * cosine;
        if sine2 < 1e-4 {
            return [plane, None, None];
        }
        let (p, q) = (apart.dot(&a.normal), apart.dot(&b.normal));
        let s = (p - cosine * q) / sine2;
        let t = (cosine * p - q) / sine2;
        let (m, n) = (a.point + a.normal * s, b.point + b.normal * t);
        let radius = 0.5 * (s.abs() + t.abs());
        let round = s * t > 0.0
            && (s - t).abs() <= 0.25 * radius
            && (m - n).norm() <= 0.25 * radius
            && radius < FLATTEST * distance;
        let sphere = round.then(|| Self::Sphere { center: (m + n) * 0.5, radius });
        let cylinder = Tube::through([&a.point, &b.point], [&a.normal, &b.normal])
            .filter(|tube| tube.radius < FLATTEST * distance && s * t > 0.0)
            .map(Self::Cylinder);
        [plane, sphere, cylinder]
    }

    /// Returns the signed distance of a point, mm.
    pub(super) fn distance(&self, point: &Vector3<f64>) -> f64 {
        match self {
            Self::Plane { normal, anchor } => normal.dot(&(point - anchor)),
            Self::Sphere { center, radius } => (point - center).norm() - radius,
            Self::Cylinder(tube) => tube.distance(point),
        }
    }

    /// Returns the direction away from the surface at a point, its length not one.
    fn outward(&self, point: &Vector3<f64>) -> Vector3<f64> {
        match self {
            Self::Plane { normal, .. } => normal.into_inner(),
            Self::Sphere { center, .. } => point - center,
            Self::Cylinder(tube) => {
                let arm = point - tube.anchor;
                arm - tube.axis.into_inner() * tube.axis.dot(&arm)
            }
        }
    }

    /// Returns whether a point lies on the surface and faces as it does: its normal within the angle of this cosine.
    #[inline]
    pub(super) fn holds(&self, o: &Oriented, cosine: f64) -> bool {
        // Without roots: most points are far away.
        let (outward, length2) = match self {
            Self::Plane { normal, anchor } => {
                return normal.dot(&(o.point - anchor)).abs() <= o.tolerance
                    && normal.dot(&o.normal).abs() >= cosine;
            }
            Self::Sphere { center, radius } => {
                let arm = o.point - center;
                let length2 = arm.norm_squared();
                if !within_shell(length2, *radius, o.tolerance) {
                    return false;
                }
                (arm, length2)
            }
            Self::Cylinder(tube) => {
                let arm = o.point - tube.anchor;
                let along = tube.axis.dot(&arm);
                let length2 = arm.norm_squared() - along * along;
                if !within_shell(length2, tube.radius, o.tolerance) {
                    return false;
                }
                (arm - tube.axis.into_inner() * along, length2)
            }
        };
        let facing = outward.dot(&o.normal);
        facing * facing >= cosine * cosine * length2
    }

    /// Returns the shape of least squares of distances to points, from this one; a scatter below the resolution is none.
    pub(super) fn refined(&self, points: &[Vector3<f64>], resolution_mm: f64) -> Option<Self> {
        let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
        let near: Vec<Vector3<f64>> = points.iter().map(|p| p - middle).collect();
        match self {
            Self::Plane { normal, .. } => plane::least_squares(&near, *normal)
                .map(|(normal, anchor)| Self::Plane { normal, anchor: anchor + middle }),
            Self::Sphere { center, radius } => {
                sphere::least_squares(&near, center - middle, *radius, resolution_mm)
                    .map(|(center, radius)| Self::Sphere { center: center + middle, radius })
            }
            Self::Cylinder(tube) => {
                let moved = Tube { anchor: tube.anchor - middle, ..*tube };
                cylinder::least_squares(&near, moved, resolution_mm)
                    .map(|tube| Self::Cylinder(Tube { anchor: tube.anchor + middle, ..tube }))
            }
        }
    }

    /// Returns the shape of another kind that looks most like this one on points, to be refined.
    pub(super) fn as_kind(&self, kind: usize, points: &[Vector3<f64>]) -> Option<Self> {
        let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
        let normal = Unit::try_new(self.outward(&middle), 0.0)?;
        match (kind, self) {
            (0, _) => {
                Some(Self::Plane { normal, anchor: middle - normal.into_inner() * self.distance(&middle) })
            }
            (1, Self::Cylinder(tube)) => {
                let along = tube.axis.into_inner() * tube.axis.dot(&(middle - tube.anchor));
                Some(Self::Sphere { center: tube.anchor + along, radius: tube.radius })
            }
            _ => None,
        }
    }

    /// Returns the maximum-likelihood fit to those of the given points of a checked cloud that agree, and those points. The shape
    /// is relative to `origin`.
    pub(super) fn fitted(
        &self,
        cloud: &PointCloud,
        indices: Vec<usize>,
        origin: &Vector3<f64>,
        scatter_mm: f64,
        sensor: &Vector3<f64>,
    ) -> Result<(ShapeFit, Vec<usize>), FitError> {
        match self {
            Self::Plane { normal, anchor } => {
                let (fit, used) = plane::refit(cloud, indices, *normal, anchor + origin, scatter_mm, sensor)?;
                Ok((ShapeFit::Plane(fit), used))
            }
            Self::Sphere { center, radius } => {
                let (fit, used) = sphere::refit(cloud, indices, center + origin, *radius, scatter_mm)?;
                Ok((ShapeFit::Sphere(fit), used))
            }
            Self::Cylinder(tube) => {
                let anchor = tube.anchor + origin;
                let (fit, used) =
                    cylinder::refit(cloud, indices, anchor, tube.axis, tube.radius, scatter_mm)?;
                Ok((ShapeFit::Cylinder(fit), used))
            }
        }
    }

    /// Returns what a fit found, relative to `origin`.
    pub(super) fn of(fit: &ShapeFit, origin: &Vector3<f64>) -> Self {
        match fit {
            ShapeFit::Plane(fit) => {
                let normal = Unit::new_normalize(Vector3::from(fit.normal));
                let from_origin = normal.dot(origin) + fit.offset_mm;
                Self::Plane { normal, anchor: -normal.into_inner() * from_origin }
            }
            ShapeFit::Sphere(fit) => {
                Self::Sphere { center: Vector3::from(fit.center_mm) - origin, radius: fit.radius_mm }
            }
            ShapeFit::Cylinder(fit) => Self::Cylinder(Tube {
                anchor: Vector3::from(fit.axis_point_mm) - origin,
                axis: Unit::new_normalize(Vector3::from(fit.axis_direction)),
                radius: fit.radius_mm,
            }),
        }
    }
}
