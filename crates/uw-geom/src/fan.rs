//! The galvanometer, the laser fan it carries, and the curved sheet of light that leaves its window.

use crate::error::GeomError;
use crate::plane::Plane;
use crate::port::Port;
use crate::ray::Ray;
use crate::real::{Real, norm, rotation_about_x, unit, values};
use crate::snell::Medium;
use crate::trace::{Solver, Tracer};
use nalgebra::{Matrix3, Scalar, Vector3};
use std::f64::consts::FRAC_PI_4;

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

impl Galvo<f64> {
    /// Direction of the mirror's normal at the reference voltage by design, angle from z towards y, radians: ±π/4. The laser's
    /// body lies on the camera's side of the mirror, where a frame has room for it, and its beam arrives square to z. Images
    /// hardly tell the side, so that whoever has nothing better takes this: calibration's start, the simulator.
    pub fn mirror_normal_rad(&self) -> f64 {
        // What a normal at +π/4 turns into z comes from +y.
        let towards_camera = -self.axes.column(1).dot(&self.origin_mm);
        FRAC_PI_4.copysign(towards_camera)
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
    /// Direction of the mirror's normal at the reference voltage: angle from z towards y, radians. Only says where
    /// `mirror_offset_mm` moves the apex, so a design value will do; of the wrong sign, axis and window move along.
    /// [`Galvo::mirror_normal_rad`] is one.
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
        Ok(self.normal.dot(&d) / norm(&d))
    }

    /// The ray of the sheet that leaves the apex at `angle_rad` within the fan's plane, measured from the direction closest
    /// to the window's normal.
    ///
    /// # Errors
    /// As [`Port::ray_out`]; [`GeomError::NotThroughWindow`] for a fan that lies along the window.
    pub fn ray(&self, angle_rad: f64) -> Result<Ray<T>, GeomError> {
        let centre = across_trace(&self.port.normal, &self.normal)?;
        let across = self.normal.cross(&centre);
        let (s, c) = angle_rad.sin_cos();
        let direction = centre * T::constant(c) + across * T::constant(s);
        self.port.ray_out(&self.apex_mm, &direction, self.outside)
    }

    /// The point where `ray` meets the sheet, in front of where the ray begins and of the window. (A ray that grazes a curved
    /// sheet may meet it twice: then the meeting nearer the fan's middle.)
    ///
    /// # Errors
    /// [`GeomError::NoIntersection`] where it meets none there; as [`Sheet::ray`] for a sheet that has no light.
    pub fn intersect(&self, ray: &Ray<T>) -> Result<Vector3<T>, GeomError> {
        let tracer = Tracer::new(self)?;
        let fixed = Ray { origin: values(&ray.origin), direction: values(&ray.direction) };
        Ok(tracer.meet(ray, &Solver::new(&tracer.value()).solve(&fixed)?))
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

/// The unit vector along the part of `v` that is perpendicular to the unit vector `axis`.
///
/// # Errors
/// [`GeomError::NotThroughWindow`] when the two are parallel to rounding: a fan that lies along its window.
pub(crate) fn across_trace<T: Real>(v: &Vector3<T>, axis: &Vector3<T>) -> Result<Vector3<T>, GeomError> {
    let part = v - axis * axis.dot(v);
    unit(&part).filter(|_| norm(&part).value() > PARALLEL).ok_or(GeomError::NotThroughWindow { cosine: 0.0 })
}

/// Sine below which two unit vectors count as parallel: what remains is rounding.
const PARALLEL: f64 = 1e-9;

impl Sheet<f64> {
    /// The plane that best stands for the sheet near its middle: through the exit point of the ray closest to the window's
    /// normal, along the refracted ray and along the fan's trace on the window. Exact when the fan meets the window squarely;
    /// otherwise millimetres off in the field of view. The paper's sheet (Eq 9).
    ///
    /// # Errors
    /// As [`Sheet::ray`].
    pub fn middle_plane(&self) -> Result<Plane, GeomError> {
        let ray = self.ray(0.0)?;
        let trace = self.normal.cross(&self.port.normal);
        Plane::through(&ray.origin, &trace.cross(&ray.direction))
    }
}
