//! The galvanometer, the laser fan it carries, and the curved sheet of light that leaves its window.

use crate::error::GeomError;
use crate::plane::Plane;
use crate::port::{Port, solve_slope};
use crate::ray::Ray;
use crate::real::{Real, rotation_about_x, unit, values};
use crate::snell::Medium;
use nalgebra::{Matrix3, Scalar, Vector3};

/// The galvanometer: its frame (FORMATS §3) in the camera's, and how far the mirror turns per volt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Galvo<T: Scalar = f64> {
    /// The frame's origin in the camera frame, mm: the point of the axis closest to the optical centre.
    pub origin_mm: Vector3<T>,
    /// The frame's axes x, y, z as columns, camera frame.
    pub axes: Matrix3<T>,
    /// Mechanical slope at 0 V, radians per volt; positive by the choice of the x axis.
    pub radians_per_volt: T,
    /// Quadratic term about 0 V, rad/V².
    pub quadratic: T,
    /// Cubic term about 0 V, rad/V³.
    pub cubic: T,
    /// The voltage that fixes the frame.
    pub reference_v: f64,
}

impl<T: Real> Galvo<T> {
    /// Mechanical angle of the mirror at `voltage`, radians from where it stands at the reference voltage.
    pub fn mirror_angle(&self, voltage: T) -> T {
        let at = |v: T| v * (self.radians_per_volt + v * (self.quadratic + v * self.cubic));
        at(voltage) - at(T::constant(self.reference_v))
    }

    /// The galvanometer without derivatives.
    pub fn value(&self) -> Galvo<f64> {
        Galvo {
            origin_mm: values(&self.origin_mm),
            axes: self.axes.map(T::value),
            radians_per_volt: self.radians_per_volt.value(),
            quadratic: self.quadratic.value(),
            cubic: self.cubic.value(),
            reference_v: self.reference_v,
        }
    }
}

/// The laser fan as the mirror shows it at the reference voltage: a plane of rays from a virtual apex, in the galvanometer
/// frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fan<T: Scalar = f64> {
    /// The virtual apex for a mirror surface that contains its axis, mm: x along the axis, y how far the plane misses the
    /// axis, −z the geometric length from apex to axis.
    pub apex_mm: Vector3<T>,
    /// Angle between the fan's plane and the axis, radians; the plane's normal is (sin, cos, 0).
    pub tilt_rad: T,
    /// Distance of the mirror's surface from its axis, mm: the virtual apex moves by twice this along the mirror's normal.
    pub mirror_offset_mm: T,
    /// Direction of the mirror's normal at the reference voltage: angle from z towards y, radians. Only scales what
    /// `mirror_offset_mm` does, so a design value will do.
    pub mirror_normal_rad: f64,
}

impl<T: Real> Fan<T> {
    /// The fan without derivatives.
    pub fn value(&self) -> Fan<f64> {
        Fan {
            apex_mm: values(&self.apex_mm),
            tilt_rad: self.tilt_rad.value(),
            mirror_offset_mm: self.mirror_offset_mm.value(),
            mirror_normal_rad: self.mirror_normal_rad,
        }
    }
}

/// The laser's light at one voltage, camera frame: rays from a virtual apex in a plane, refracted at the laser's window. A
/// CURVED surface outside, unless the plane meets the window squarely.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sheet<T: Scalar = f64> {
    /// Virtual apex, mm.
    pub apex_mm: Vector3<T>,
    /// Unit normal of the fan's plane in air.
    pub normal: Vector3<T>,
    /// The window as seen from the apex.
    pub port: Port<T>,
    /// What is outside the window.
    pub outside: Medium<T>,
}

impl<T: Real> Sheet<T> {
    /// The sheet that `fan` makes behind `port` when the galvanometer stands at `voltage`; the port's distance is from the
    /// galvanometer frame's origin.
    pub fn new(galvo: &Galvo<T>, fan: &Fan<T>, port: &Port<T>, voltage: T, outside: Medium<T>) -> Self {
        let mirror = galvo.mirror_angle(voltage);
        let turn = rotation_about_x(mirror.scale(2.0));
        let (ns, nc) = fan.mirror_normal_rad.sin_cos();
        let zero = T::constant(0.0);
        let mirror_normal = rotation_about_x(mirror) * Vector3::new(zero, T::constant(ns), T::constant(nc));
        let apex_from_origin =
            galvo.axes * (turn * fan.apex_mm + mirror_normal * fan.mirror_offset_mm.scale(2.0));
        let (s, c) = fan.tilt_rad.sin_cos();
        Self {
            apex_mm: galvo.origin_mm + apex_from_origin,
            normal: galvo.axes * (turn * Vector3::new(s, c, zero)),
            port: port.seen_from(&apex_from_origin),
            outside,
        }
    }

    /// Sine of the angle in air between the fan's plane and the light that reaches `point_mm`: zero on the sheet, its sign
    /// that of the side.
    ///
    /// # Errors
    /// As [`Port::air_direction`].
    pub fn off_sheet(&self, point_mm: &Vector3<T>) -> Result<T, GeomError> {
        let d = self.port.air_direction(&self.apex_mm, point_mm, self.outside)?;
        Ok(self.normal.dot(&d) / d.dot(&d).sqrt())
    }

    /// The ray of the sheet that leaves the apex at `angle_rad` within the fan's plane, measured from the direction closest
    /// to the window's normal.
    ///
    /// # Errors
    /// As [`Port::ray_out`].
    pub fn ray(&self, angle_rad: f64) -> Result<Ray<T>, GeomError> {
        let along = self.port.normal - self.normal * self.normal.dot(&self.port.normal);
        let centre = unit(&along).ok_or(GeomError::NotThroughWindow { cosine: 0.0 })?;
        let across = self.normal.cross(&centre);
        let (s, c) = angle_rad.sin_cos();
        self.port.ray_out(&self.apex_mm, &(centre.scale_by(c) + across.scale_by(s)), self.outside)
    }

    /// The point where `ray` meets the sheet, in front of where the ray begins.
    ///
    /// # Errors
    /// [`GeomError::NoIntersection`] where it meets none, [`GeomError::NotConverged`] for figures that are not numbers.
    pub fn intersect(&self, ray: &Ray<T>) -> Result<Vector3<T>, GeomError> {
        let sheet = self.value();
        let fixed = Ray { origin: values(&ray.origin), direction: values(&ray.direction) };
        let (distance, slope) = sheet.distance_along(&fixed)?;
        let at = ray.at(T::constant(distance));
        let d = self.port.air_direction(&self.apex_mm, &at, self.outside)?;
        Ok(at - ray.direction * self.normal.dot(&d).scale(1.0 / slope))
    }

    /// The sheet without derivatives.
    pub fn value(&self) -> Sheet<f64> {
        Sheet {
            apex_mm: values(&self.apex_mm),
            normal: values(&self.normal),
            port: self.port.value(),
            outside: self.outside.value(),
        }
    }
}

trait ScaleBy<T> {
    fn scale_by(&self, factor: f64) -> Self;
}

impl<T: Real> ScaleBy<T> for Vector3<T> {
    fn scale_by(&self, factor: f64) -> Self {
        self.map(|x| x.scale(factor))
    }
}

/// Steps after which the search along a ray is given up.
const MAX_STEPS: u32 = 40;
/// A step along the ray below which the next is below rounding, as a fraction of the distance.
const SETTLED: f64 = 1e-8;

impl Sheet<f64> {
    /// The plane that best stands for the sheet near its middle: through the exit point of the ray closest to the window's
    /// normal, along the refracted ray and along the fan's trace on the window. Exact when the fan meets the window squarely;
    /// otherwise millimetres off in the field of view. The start of [`Sheet::intersect`] and the paper's sheet (Eq 9).
    ///
    /// # Errors
    /// As [`Port::ray_out`].
    pub fn middle_plane(&self) -> Result<Plane, GeomError> {
        let ray = self.ray(0.0)?;
        let trace = self.normal.cross(&self.port.normal);
        let normal = match unit(&trace) {
            Some(trace) => trace.cross(&ray.direction),
            None => return Err(GeomError::NotThroughWindow { cosine: 0.0 }),
        };
        Plane::through(&ray.origin, &normal)
    }

    /// Distance along the ray to the sheet, mm, and there the slope of `normal · air direction` along the ray.
    pub(crate) fn distance_along(&self, ray: &Ray) -> Result<(f64, f64), GeomError> {
        let plane = self.middle_plane()?;
        let mut t = plane.distance_along(ray).unwrap_or(0.0).max(0.0);
        let p = &self.port;
        let from_apex = ray.origin - self.apex_mm;
        let (height0, rise) = (from_apex.dot(&p.normal), ray.direction.dot(&p.normal));
        let (side0, side_rise) = (from_apex - p.normal * height0, ray.direction - p.normal * rise);
        let (across0, across_lateral, across_rise) =
            (self.normal.dot(&p.normal), self.normal.dot(&side0), self.normal.dot(&side_rise));
        // The parts of the lateral distance squared: constant, linear, quadratic in t.
        let squares = (side0.dot(&side0), side0.dot(&side_rise), side_rise.dot(&side_rise));
        let (glass, water) = (p.glass.index, self.outside.index);
        // A ray may begin (camera's window) behind the laser's window: no light is found before its outer face.
        let first_outside = (p.distance_mm + p.thickness_mm - height0) / rise;
        let nearest = if rise > 0.0 && first_outside > 0.0 { first_outside } else { 0.0 };
        for step in 0..MAX_STEPS {
            let depth = height0 + rise * t - p.distance_mm - p.thickness_mm;
            if depth <= 0.0 {
                if t <= nearest || rise <= 0.0 {
                    return Err(GeomError::NoIntersection);
                }
                t = 0.5 * (t + nearest) + 1.0;
                continue;
            }
            let r_squared = squares.0 + t * (2.0 * squares.1 + t * squares.2);
            let layers = [(p.thickness_mm, glass), (depth, water)];
            let (s, slope_s) = solve_slope(p.distance_mm, &layers, r_squared, None)?;
            let across = across_lateral + across_rise * t;
            let value = across0 + across * s;
            // ds/dt by the implicit function theorem on s (h₀ + Σ hᵢ aᵢ) = 1, aᵢ = (nᵢ² + (nᵢ² − 1) r² s²)^(−1/2).
            let (mut by_r, mut by_depth) = (0.0, 0.0);
            for (i, (h, n)) in layers.into_iter().enumerate() {
                let a = 1.0 / (n * n + (n * n - 1.0) * r_squared * s * s).sqrt();
                by_r -= 0.5 * h * (n * n - 1.0) * s * s * s * a * a * a;
                if i == 1 {
                    by_depth = s * a;
                }
            }
            let ds = -(by_depth * rise + by_r * 2.0 * (squares.1 + t * squares.2)) / slope_s;
            let slope = across_rise * s + across * ds;
            let change = value / slope;
            if !change.is_finite() {
                return Err(GeomError::NoIntersection);
            }
            // The sheet is nearly a plane: a step that would leave the space in front goes half way back instead.
            let next = t - change;
            if next <= nearest {
                if t - nearest < 1e-6 {
                    return Err(GeomError::NoIntersection);
                }
                t = 0.5 * (t + nearest);
                continue;
            }
            t = next;
            if change.abs() <= SETTLED * t {
                return Ok((t, slope));
            }
            if t > 1e9 {
                return Err(GeomError::NoIntersection);
            }
            if step + 1 == MAX_STEPS {
                break;
            }
        }
        Err(GeomError::NotConverged { what: "the meeting of ray and sheet", iterations: MAX_STEPS })
    }
}
