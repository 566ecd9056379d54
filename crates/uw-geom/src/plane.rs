use crate::error::GeomError;
use crate::ray::Ray;
use nalgebra::Vector3;

/// The plane normal·p + offset = 0, |normal| = 1; millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit normal.
    pub normal: Vector3<f64>,
    /// Offset, mm: minus the distance of the plane from the frame's origin along the normal.
    pub offset_mm: f64,
}

impl Plane {
    /// The plane through a point with a normal of any length.
    ///
    /// # Errors
    /// [`GeomError::Invalid`] for a normal of length zero.
    pub fn through(point_mm: &Vector3<f64>, normal: &Vector3<f64>) -> Result<Self, GeomError> {
        let normal =
            normal.try_normalize(0.0).filter(|n| n.norm().is_finite()).ok_or(GeomError::Invalid {
                what: "a plane's normal",
                needed: "longer than 0",
                got: normal.norm(),
            })?;
        Ok(Self { normal, offset_mm: -normal.dot(point_mm) })
    }

    /// Signed distance of a point from the plane, mm.
    pub fn distance_mm(&self, point_mm: &Vector3<f64>) -> f64 {
        self.normal.dot(point_mm) + self.offset_mm
    }

    /// Distance along the ray to the plane, mm (negative behind its origin); `None` for a ray along the plane.
    pub fn distance_along(&self, ray: &Ray) -> Option<f64> {
        let t = -self.distance_mm(&ray.origin) / self.normal.dot(&ray.direction);
        t.is_finite().then_some(t)
    }
}
