use crate::real::Real;
use nalgebra::Vector3;

/// A ray in the medium outside the windows: where it leaves the glass, and its unit direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray<T: nalgebra::Scalar = f64> {
    /// A point of the ray, mm.
    pub origin: Vector3<T>,
    /// Unit direction, outwards.
    pub direction: Vector3<T>,
}

impl<T: Real> Ray<T> {
    /// The point at `distance_mm` along the ray.
    pub fn at(&self, distance_mm: T) -> Vector3<T> {
        self.origin + self.direction * distance_mm
    }
}
