//! A flat window, seen from the centre of projection behind it.

use crate::error::GeomError;
use crate::ray::Ray;
use crate::real::{Real, unit};
use crate::snell::{Medium, refract};
use nalgebra::{Scalar, Vector3};

/// A flat glass window between air inside and a medium outside. All its lengths are along its normal, from the centre of
/// projection (optical centre, or fan apex) behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Port<T: Scalar = f64> {
    /// Unit normal, outwards.
    pub normal: Vector3<T>,
    /// Centre of projection to the inner face, mm.
    pub distance_mm: T,
    /// Thickness of the glass, mm.
    pub thickness_mm: T,
    /// The glass.
    pub glass: Medium<T>,
}

/// Newton steps after which forward projection is given up; three suffice within 20°, eight at 85°.
const MAX_STEPS: u32 = 50;

impl Port<f64> {
    /// A window with checked figures.
    ///
    /// # Errors
    /// [`GeomError::Invalid`] for a normal that is not of length 1, a negative distance or thickness, an index below 1.
    pub fn new(
        normal: Vector3<f64>,
        distance_mm: f64,
        thickness_mm: f64,
        glass: Medium,
    ) -> Result<Self, GeomError> {
        let invalid = |what, needed, got| Err(GeomError::Invalid { what, needed, got });
        if (normal.norm() - 1.0).abs() > 1e-9 || !normal.norm().is_finite() {
            return invalid("a window's normal", "of length 1", normal.norm());
        }
        if !(distance_mm >= 0.0 && distance_mm.is_finite()) {
            return invalid("a window's distance", "0 mm or more", distance_mm);
        }
        if !(thickness_mm >= 0.0 && thickness_mm.is_finite()) {
            return invalid("a window's thickness", "0 mm or more", thickness_mm);
        }
        if !(glass.index >= 1.0 && glass.index.is_finite()) {
            return invalid("a window's index", "1 or more", glass.index);
        }
        Ok(Self { normal, distance_mm, thickness_mm, glass })
    }
}

impl<T: Real> Port<T> {
    /// The same window as seen from a centre that lies `offset_mm` away from the present one.
    pub fn seen_from(&self, offset_mm: &Vector3<T>) -> Self {
        Self { distance_mm: self.distance_mm - self.normal.dot(offset_mm), ..*self }
    }

    /// The window without derivatives.
    pub fn value(&self) -> Port<f64> {
        Port {
            normal: self.normal.map(T::value),
            distance_mm: self.distance_mm.value(),
            thickness_mm: self.thickness_mm.value(),
            glass: self.glass.value(),
        }
    }

    /// The ray outside that leaves `centre` with direction `air_direction` (any length): traced through both faces by
    /// Snell's law in vector form; its origin lies on the outer face.
    ///
    /// # Errors
    /// As [`refract`].
    pub fn ray_out(
        &self,
        centre: &Vector3<T>,
        air_direction: &Vector3<T>,
        outside: Medium<T>,
    ) -> Result<Ray<T>, GeomError> {
        let in_air = unit(air_direction).ok_or(GeomError::NotThroughWindow { cosine: f64::NAN })?;
        let in_glass = refract(&in_air, &self.normal, Medium::air(), self.glass)?;
        let direction = refract(&in_glass, &self.normal, self.glass, outside)?;
        let origin = centre
            + in_air * (self.distance_mm / in_air.dot(&self.normal))
            + in_glass * (self.thickness_mm / in_glass.dot(&self.normal));
        Ok(Ray { origin, direction })
    }

    /// The direction in air (not of length 1: its part along the normal is 1) in which light leaves `centre` to reach
    /// `point` outside, exact through both faces. For a camera: the direction in which it sees the point.
    ///
    /// With q the tangent of the air angle, r the lateral distance, layers of depth hᵢ and index nᵢ:
    /// h₀q + Σ hᵢ q/√(nᵢ² + (nᵢ² − 1) q²) = r. Solved for s = q/r, which stays smooth on the normal itself: increasing and
    /// concave in s, so Newton from 1/(h₀ + Σ hᵢ/nᵢ) climbs monotonically.
    ///
    /// # Errors
    /// [`GeomError::BehindWindow`] for a point that is not outside, [`GeomError::NotConverged`] for figures that are not
    /// numbers.
    pub fn air_direction(
        &self,
        centre: &Vector3<T>,
        point: &Vector3<T>,
        outside: Medium<T>,
    ) -> Result<Vector3<T>, GeomError> {
        let to_point = point - centre;
        let height = to_point.dot(&self.normal);
        let lateral = to_point - self.normal * height;
        let depth = height - self.distance_mm - self.thickness_mm;
        if depth.value().is_nan() || depth.value() <= 0.0 {
            return Err(GeomError::BehindWindow { behind_mm: -depth.value() });
        }
        let squared = lateral.dot(&lateral);
        let layers = [(self.thickness_mm, self.glass.index), (depth, outside.index)];
        let fixed = layers.map(|(h, n)| (h.value(), n.value()));
        let (slope_in_air, rise) = solve_slope(self.distance_mm.value(), &fixed, squared.value(), None)?;
        // One step in the scalar: exact derivatives by the implicit function theorem.
        let s = T::constant(slope_in_air);
        let mut sum = self.distance_mm;
        for (h, n) in layers {
            let nn = n * n;
            sum += h / (nn + (nn - T::constant(1.0)) * squared.scale(slope_in_air * slope_in_air)).sqrt();
        }
        let excess = sum.scale(slope_in_air) - T::constant(1.0);
        Ok(self.normal + lateral * (s - excess.scale(1.0 / rise)))
    }
}

/// The root s of the forward projection's equation and the equation's slope there; `start` may be any value at or left of
/// the root.
pub(crate) fn solve_slope(
    air_mm: f64,
    layers: &[(f64, f64); 2],
    r_squared: f64,
    start: Option<f64>,
) -> Result<(f64, f64), GeomError> {
    let paraxial = || 1.0 / (air_mm + layers.iter().map(|(h, n)| h / n).sum::<f64>());
    let mut s = start.unwrap_or_else(paraxial);
    for step in 0..MAX_STEPS {
        let (excess, rise) = lateral_excess(s, air_mm, layers, r_squared);
        let change = excess / rise;
        s -= change;
        if !s.is_finite() {
            return Err(GeomError::NotConverged { what: PROJECTION, iterations: step });
        }
        // Newton doubles the digits at each step: behind this one, what remains is below rounding.
        if change.abs() <= 1e-9 * s.abs() {
            return Ok((s, rise));
        }
    }
    Err(GeomError::NotConverged { what: PROJECTION, iterations: MAX_STEPS })
}

const PROJECTION: &str = "forward projection through a window";

/// The forward projection's equation, divided by r, at s = q/r: its value and its derivative to s.
fn lateral_excess(s: f64, air_mm: f64, layers: &[(f64, f64); 2], r_squared: f64) -> (f64, f64) {
    let (mut sum, mut rise) = (air_mm, air_mm);
    for &(h, n) in layers {
        let w = n * n + (n * n - 1.0) * r_squared * s * s;
        let inverse = h / w.sqrt();
        sum += inverse;
        rise += inverse * n * n / w;
    }
    (s * sum - 1.0, rise)
}
