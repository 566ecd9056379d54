//! The paper's approximations of refraction (S. Chi, Z. Xie, W. Chen, Sensors 16 (2016), Eqs 9 to 14), as named
//! alternatives to the exact model: for comparison, never a default.

use crate::camera::Camera;
use crate::error::GeomError;
use crate::fan::Sheet;
use crate::plane::Plane;
use crate::ray::Ray;
use crate::real::unit;
use crate::snell::Medium;
use nalgebra::{Vector2, Vector3};

/// Eqs 10 and 14: the ray that a pixel of an underwater image is taken to see, straight from the optical centre. The
/// undistorted image point is scaled by k = tan β / tan α, sin α = n sin β, α being its angle to the optical axis: the
/// window is taken to stand square to that axis, its glass and its distance are neglected.
///
/// That moves the viewpoint by h_c (1 − n) + t (1 − n/n_g), −2.4 mm in the paper's instrument.
///
/// # Errors
/// As [`Camera::unproject`]; [`GeomError::TotalReflection`] for an index below sin α.
pub fn scaled_pixel_ray(camera: &Camera, pixel: &Vector2<f64>, outside: Medium) -> Result<Ray, GeomError> {
    let d = camera.unproject(pixel)?;
    let tan_alpha = d.x.hypot(d.y);
    let sin_beta = tan_alpha / tan_alpha.hypot(1.0) / outside.index;
    // tan β / tan α, written without the division by tan α = 0 in the middle of the image.
    let k = 1.0 / (outside.index * tan_alpha.hypot(1.0) * (1.0 - sin_beta * sin_beta).sqrt());
    let direction = Vector3::new(k * d.x, k * d.y, 1.0);
    // An index below sin α makes k infinite or no number.
    let direction = unit(&direction).ok_or(GeomError::TotalReflection {
        from_index: 1.0,
        to_index: outside.index,
        incidence_deg: tan_alpha.atan().to_degrees(),
    })?;
    Ok(Ray { origin: Vector3::zeros(), direction })
}

/// Eq 9 and the text below it: the laser in water taken as a PLANE, through the exit point J of the ray that leaves the
/// apex square to the fan's trace on the window, with Snell's law at both faces.
///
/// # Errors
/// As [`Sheet::middle_plane`].
pub fn planar_sheet(sheet: &Sheet) -> Result<Plane, GeomError> {
    sheet.middle_plane()
}

/// Eq 8 with a planar sheet: the point where a ray meets a plane.
///
/// # Errors
/// [`GeomError::NoIntersection`] for a ray along the plane or away from it.
pub fn intersect_plane(ray: &Ray, plane: &Plane) -> Result<Vector3<f64>, GeomError> {
    match plane.distance_along(ray) {
        Some(t) if t > 0.0 => Ok(ray.at(t)),
        _ => Err(GeomError::NoIntersection),
    }
}
