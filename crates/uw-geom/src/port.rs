//! A flat window, seen from the centre of projection behind it.

use crate::error::GeomError;
use crate::ray::Ray;
use crate::real::{Real, lift, unit};
use crate::snell::Medium;
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

/// Newton steps after which forward projection is given up; two suffice within 20°.
const MAX_STEPS: u32 = 50;
/// A step of forward projection, relative, behind which the last one (made in the scalar itself) ends below rounding:
/// Newton doubles the digits each time.
const NEARLY_SETTLED: f64 = 1e-5;
/// Most that the second term of the start may add to the first.
const LONGEST_START: f64 = 0.1;

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
        let length = normal.norm();
        if length.is_nan() || (length - 1.0).abs() > 1e-9 {
            return invalid("a window's normal", "of length 1", length);
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

    /// The same window as constants of another scalar.
    pub fn lift<S: Real>(&self) -> Port<S> {
        Port {
            normal: lift(&self.normal),
            distance_mm: S::constant(self.distance_mm),
            thickness_mm: S::constant(self.thickness_mm),
            glass: Medium::of_index(S::constant(self.glass.index)),
        }
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

    /// The ray outside that leaves `centre` with direction `air_direction` (any length), exact through both faces; its
    /// origin lies on the outer face.
    ///
    /// Snell's law in vector form for parallel faces: the part σ of n·direction that lies in the faces is the same in every
    /// layer, |σ| = sin α being that of the unit direction in air. So the ray leaves along
    /// (σ + √(n² − sin²α) normal) / n, having moved sideways by σ (h / cos α + t / √(n_g² − sin²α)).
    ///
    /// # Errors
    /// [`GeomError::NotThroughWindow`], [`GeomError::TotalReflection`]; [`GeomError::Invalid`] for a window behind the centre.
    #[inline(always)]
    pub fn ray_out(
        &self,
        centre: &Vector3<T>,
        air_direction: &Vector3<T>,
        outside: Medium<T>,
    ) -> Result<Ray<T>, GeomError> {
        self.is_ahead()?;
        let in_air = unit(air_direction).ok_or(GeomError::NotThroughWindow { cosine: f64::NAN })?;
        let cosine = in_air.dot(&self.normal);
        if cosine.value().is_nan() || cosine.value() <= 0.0 {
            return Err(GeomError::NotThroughWindow { cosine: cosine.value() });
        }
        let along_faces = in_air - self.normal * cosine;
        // n² − sin²α, without a difference of numbers near 1 at grazing incidence.
        let beyond_sine = |to: Medium<T>| to.index * to.index - T::constant(1.0) + cosine * cosine;
        let reflected = |from: f64, to: Medium<T>| GeomError::TotalReflection {
            from_index: from,
            to_index: to.index.value(),
            incidence_deg: (norm_value(&along_faces) / from).min(1.0).asin().to_degrees(),
        };
        let (in_glass, outdoors) = (beyond_sine(self.glass), beyond_sine(outside));
        if in_glass.value().is_nan() || in_glass.value() <= 0.0 {
            return Err(reflected(1.0, self.glass));
        }
        if outdoors.value().is_nan() || outdoors.value() <= 0.0 {
            return Err(reflected(self.glass.index.value(), outside));
        }
        let sideways = self.distance_mm / cosine + self.thickness_mm / in_glass.sqrt();
        Ok(Ray {
            origin: centre + self.normal * (self.distance_mm + self.thickness_mm) + along_faces * sideways,
            direction: (along_faces + self.normal * outdoors.sqrt()) / outside.index,
        })
    }

    /// The direction in air (not of length 1: its part along the normal is 1) in which light leaves `centre` to reach
    /// `point` outside, exact through both faces. For a camera: the direction in which it sees the point.
    ///
    /// With q the tangent of the air angle, r the lateral distance, layers of depth hᵢ and index nᵢ:
    /// h₀q + Σ hᵢ q/√(nᵢ² + (nᵢ² − 1) q²) = r. Solved for s = q/r, which stays smooth on the normal itself: increasing and
    /// concave in s, so Newton climbs monotonically to the root from its left, and lands there from a start right of it.
    ///
    /// # Errors
    /// [`GeomError::BehindWindow`] for a point that is not outside; [`GeomError::TotalReflection`] for one so far to the side
    /// that no light from a centre ON the window reaches it; [`GeomError::NotConverged`] for figures that are not numbers;
    /// [`GeomError::Invalid`] for a window behind the centre.
    #[inline(always)]
    pub fn air_direction(
        &self,
        centre: &Vector3<T>,
        point: &Vector3<T>,
        outside: Medium<T>,
    ) -> Result<Vector3<T>, GeomError> {
        self.is_ahead()?;
        let to_point = point - centre;
        let height = to_point.dot(&self.normal);
        let lateral = to_point - self.normal * height;
        let depth = height - self.distance_mm - self.thickness_mm;
        if depth.value().is_nan() || depth.value() <= 0.0 {
            return Err(GeomError::BehindWindow { behind_mm: -depth.value() });
        }
        let squared = lateral.dot(&lateral);
        let layers = [Layer::new(self.thickness_mm, self.glass), Layer::new(depth, outside)];
        let start = solve_slope(self.distance_mm.value(), &layers.map(Layer::value), squared.value())?;
        // The last step in the scalar: exact derivatives by the implicit function theorem.
        let scaled = squared.scale(start * start);
        let (mut sum, mut rise) = (self.distance_mm, self.distance_mm.value());
        for layer in layers {
            let w = layer.squared_index + layer.excess * scaled;
            let part = layer.depth / w.sqrt();
            sum += part;
            rise += part.value() * layer.squared_index.value() / w.value();
        }
        let excess = sum.scale(start) - T::constant(1.0);
        Ok(self.normal + lateral * (T::constant(start) - excess.scale(1.0 / rise)))
    }

    /// A centre behind the inner face: anything else has no meaning for what this type computes.
    pub(crate) fn is_ahead(&self) -> Result<(), GeomError> {
        let distance = self.distance_mm.value();
        if distance >= 0.0 {
            return Ok(());
        }
        Err(GeomError::Invalid { what: "a window's distance", needed: "0 mm or more", got: distance })
    }
}

fn norm_value<T: Real>(v: &Vector3<T>) -> f64 {
    v.map(T::value).norm()
}

/// A layer of a medium behind the air: its depth, n² and n² − 1.
#[derive(Clone, Copy)]
struct Layer<T> {
    depth: T,
    squared_index: T,
    excess: T,
}

impl<T: Real> Layer<T> {
    fn new(depth: T, medium: Medium<T>) -> Self {
        let squared_index = medium.index * medium.index;
        Self { depth, squared_index, excess: squared_index - T::constant(1.0) }
    }

    fn value(self) -> Layer<f64> {
        Layer {
            depth: self.depth.value(),
            squared_index: self.squared_index.value(),
            excess: self.excess.value(),
        }
    }
}

/// The root s of the forward projection's equation, a step short of rounding.
#[inline(always)]
fn solve_slope(air_mm: f64, layers: &[Layer<f64>; 2], r_squared: f64) -> Result<f64, GeomError> {
    if air_mm <= 0.0 {
        within_critical_angle(layers, r_squared)?;
    }
    // The paraxial root and the next term of its series in r², cut off where that stops being a good start.
    let (mut sum, mut cubic) = (air_mm, 0.0);
    for layer in layers {
        let inverse = 1.0 / layer.squared_index;
        let part = layer.depth * inverse.sqrt();
        sum += part;
        cubic += 0.5 * part * layer.excess * inverse;
    }
    let paraxial = 1.0 / sum;
    let mut s = paraxial + paraxial * (cubic * r_squared * paraxial * paraxial * paraxial).min(LONGEST_START);
    for step in 0..MAX_STEPS {
        let (mut sum, mut rise) = (air_mm, air_mm);
        for layer in layers {
            let inverse = 1.0 / (layer.squared_index + layer.excess * r_squared * s * s);
            let part = layer.depth * inverse.sqrt();
            sum += part;
            rise += part * layer.squared_index * inverse;
        }
        let change = (1.0 - s * sum) / rise;
        s += change;
        if s < paraxial {
            s = paraxial;
        }
        if !s.is_finite() {
            return Err(GeomError::NotConverged { what: PROJECTION, iterations: step });
        }
        if change.abs() <= NEARLY_SETTLED * s {
            return Ok(s);
        }
    }
    Err(GeomError::NotConverged { what: PROJECTION, iterations: MAX_STEPS })
}

/// With the centre on the window itself, light reaches no farther than the critical angle.
#[cold]
fn within_critical_angle(layers: &[Layer<f64>; 2], r_squared: f64) -> Result<(), GeomError> {
    let deep = layers.iter().filter(|l| l.depth > 0.0);
    let farthest: f64 = deep.map(|l| l.depth / l.excess.max(0.0).sqrt()).sum();
    let distance = r_squared.sqrt();
    if distance < farthest {
        return Ok(());
    }
    Err(GeomError::TotalReflection {
        from_index: layers[1].squared_index.sqrt(),
        to_index: 1.0,
        incidence_deg: (distance / layers[1].depth).atan().to_degrees(),
    })
}

const PROJECTION: &str = "forward projection through a window";
