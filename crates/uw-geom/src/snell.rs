//! Snell's law in vector form, and the media that light crosses.

use crate::error::GeomError;
use crate::real::Real;
use nalgebra::Vector3;

/// A transparent medium, by its index of refraction relative to air (air is 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Medium<T = f64> {
    /// Index of refraction relative to air.
    pub index: T,
}

impl<T: Real> Medium<T> {
    /// Air: index 1 by convention (all indices here are relative to air).
    pub fn air() -> Self {
        Self { index: T::constant(1.0) }
    }

    /// A medium of the given index relative to air.
    pub fn of_index(index: T) -> Self {
        Self { index }
    }

    /// The same medium without derivatives.
    pub fn value(&self) -> Medium<f64> {
        Medium { index: self.index.value() }
    }
}

/// The unit direction behind a flat interface of a ray with unit direction `direction`; `normal` is the interface's unit
/// normal on the far side (`direction · normal > 0`).
///
/// With r = n₁/n₂ and c = d·n: d′ = r d + (√(1 − r²(1 − c²)) − r c) n.
///
/// # Errors
/// [`GeomError::NotThroughWindow`] when the ray does not cross the interface, [`GeomError::TotalReflection`] beyond the
/// critical angle.
pub fn refract<T: Real>(
    direction: &Vector3<T>,
    normal: &Vector3<T>,
    from: Medium<T>,
    to: Medium<T>,
) -> Result<Vector3<T>, GeomError> {
    let cosine = direction.dot(normal);
    if cosine.value().is_nan() || cosine.value() <= 0.0 {
        return Err(GeomError::NotThroughWindow { cosine: cosine.value() });
    }
    let ratio = from.index / to.index;
    let one = T::constant(1.0);
    let squared = one - ratio * ratio * (one - cosine * cosine);
    if squared.value().is_nan() || squared.value() <= 0.0 {
        return Err(GeomError::TotalReflection {
            from_index: from.index.value(),
            to_index: to.index.value(),
            incidence_deg: cosine.value().min(1.0).acos().to_degrees(),
        });
    }
    Ok(direction * ratio + normal * (squared.sqrt() - ratio * cosine))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::unit;
    use proptest::prelude::*;

    #[test]
    fn snells_law_holds_and_the_ray_stays_in_its_plane() {
        let (glass, water) = (Medium::of_index(1.52), Medium::of_index(1.335));
        let angle = 0.7f64;
        let d = Vector3::new(angle.sin(), 0.0, angle.cos());
        let out = refract(&d, &Vector3::z(), glass, water).unwrap();
        assert!((1.52 * angle.sin() - 1.335 * out.x).abs() < 1e-15);
        assert!(out.y.abs() < 1e-15 && (out.norm() - 1.0).abs() < 1e-15);
    }

    #[test]
    fn beyond_the_critical_angle_is_an_error() {
        let d = Vector3::new(0.95, 0.0, (1.0f64 - 0.95 * 0.95).sqrt());
        let error = refract(&d, &Vector3::z(), Medium::of_index(1.335), Medium::air()).unwrap_err();
        assert!(matches!(error, GeomError::TotalReflection { .. }), "{error}");
    }

    #[test]
    fn away_from_the_window_and_nan_are_errors() {
        for d in [Vector3::new(0.0, 0.0, -1.0), Vector3::x(), Vector3::repeat(f64::NAN)] {
            assert!(refract(&d, &Vector3::z(), Medium::air(), Medium::of_index(1.3)).is_err());
        }
    }

    proptest! {
        /// Reversibility to 1e-12 up to 85°: what went in comes back.
        #[test]
        fn refraction_is_reversible(angle in 0.0..85f64, turn in 0.0..6.3f64, n1 in 1.0..1.8f64, n2 in 1.0..1.8f64) {
            let (s, c) = angle.to_radians().sin_cos();
            let d = Vector3::new(s * turn.cos(), s * turn.sin(), c);
            let n = unit(&Vector3::new(0.0, 0.0, 1.0)).unwrap();
            if let Ok(out) = refract(&d, &n, Medium::of_index(n1), Medium::of_index(n2))
                && out.z > 0.05
            {
                let back = refract(&-out, &-n, Medium::of_index(n2), Medium::of_index(n1)).unwrap();
                prop_assert!((back + d).norm() < 1e-12);
            }
        }
    }
}
