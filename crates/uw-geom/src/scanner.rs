//! The whole instrument: pixel and voltage → point, point → pixel, exact at both windows, with derivatives.

use crate::camera::Camera;
use crate::error::GeomError;
use crate::fan::{Fan, Galvo, Sheet};
use crate::frame::{self, Rigid};
use crate::port::Port;
use crate::ray::Ray;
use crate::real::{Real, lift, unit};
use crate::snell::Medium;
use nalgebra::{Matrix3, Scalar, Vector2, Vector3};

/// Camera, galvanometer and laser, each behind its window; all in the camera frame, millimetres and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scanner<T: Scalar = f64> {
    /// The camera in air.
    pub camera: Camera<T>,
    /// Its window, seen from the optical centre.
    pub camera_port: Port<T>,
    /// The galvanometer.
    pub galvo: Galvo<T>,
    /// The laser's fan.
    pub fan: Fan<T>,
    /// The laser's window; its distance is from the galvanometer frame's origin.
    pub laser_port: Port<T>,
}

/// A point on the sheet with its first derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangulated {
    /// The point, camera frame, mm.
    pub point_mm: Vector3<f64>,
    /// ∂point/∂u, mm per px.
    pub per_u: Vector3<f64>,
    /// ∂point/∂v, mm per px.
    pub per_v: Vector3<f64>,
    /// ∂point/∂voltage, mm per volt.
    pub per_volt: Vector3<f64>,
}

/// Where a point is seen, and how far it lies off the laser's sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observed<T: Scalar = f64> {
    /// Pixel (u, v).
    pub pixel: Vector2<T>,
    /// Sine of the angle in air between the fan's plane and the light to the point; zero on the sheet.
    pub off_sheet: T,
}

impl<T: Real> Scanner<T> {
    /// The ray outside the window that the camera sees at `pixel`: undistorted, refracted at both faces.
    ///
    /// # Errors
    /// [`GeomError`] where the pixel has no such ray.
    #[inline(always)]
    pub fn pixel_ray(&self, pixel: &Vector2<T>, outside: Medium<T>) -> Result<Ray<T>, GeomError> {
        let origin = Vector3::repeat(T::constant(0.0));
        self.camera_port.ray_out(&origin, &self.camera.unproject(pixel)?, outside)
    }

    /// The pixel at which the camera sees a point outside the window.
    ///
    /// # Errors
    /// [`GeomError`] where it sees it nowhere.
    pub fn project(&self, point_mm: &Vector3<T>, outside: Medium<T>) -> Result<Vector2<T>, GeomError> {
        let origin = Vector3::repeat(T::constant(0.0));
        self.camera.project(&self.camera_port.air_direction(&origin, point_mm, outside)?)
    }

    /// The sheet of light at `voltage`.
    pub fn sheet(&self, voltage: T, outside: Medium<T>) -> Sheet<T> {
        Sheet::new(&self.galvo, &self.fan, &self.laser_port, voltage, outside)
    }

    /// Pixel and voltage → the point of the sheet seen there, camera frame, mm.
    ///
    /// # Errors
    /// [`GeomError`] where the pixel's ray doesn't meet the sheet.
    pub fn triangulate(
        &self,
        pixel: &Vector2<T>,
        voltage: T,
        outside: Medium<T>,
    ) -> Result<Vector3<T>, GeomError> {
        self.sheet(voltage, outside).intersect(&self.pixel_ray(pixel, outside)?)
    }

    /// Point and voltage → the pixel where the camera sees the point, and how far it lies off the sheet.
    ///
    /// # Errors
    /// [`GeomError`] where the point is behind a window.
    pub fn observe(
        &self,
        point_mm: &Vector3<T>,
        voltage: T,
        outside: Medium<T>,
    ) -> Result<Observed<T>, GeomError> {
        Ok(Observed {
            pixel: self.project(point_mm, outside)?,
            off_sheet: self.sheet(voltage, outside).off_sheet(point_mm)?,
        })
    }
}

impl Scanner<f64> {
    /// The same instrument as constants of another scalar.
    pub fn lift<S: Real>(&self) -> Scanner<S> {
        let c = S::constant;
        let port = |p: &Port| Port {
            normal: lift(&p.normal),
            distance_mm: c(p.distance_mm),
            thickness_mm: c(p.thickness_mm),
            glass: Medium::of_index(c(p.glass.index)),
        };
        let d = &self.camera.distortion;
        Scanner {
            camera: Camera {
                fx: c(self.camera.fx),
                fy: c(self.camera.fy),
                cx: c(self.camera.cx),
                cy: c(self.camera.cy),
                distortion: crate::camera::Distortion {
                    k1: c(d.k1),
                    k2: c(d.k2),
                    p1: c(d.p1),
                    p2: c(d.p2),
                    k3: c(d.k3),
                },
            },
            camera_port: port(&self.camera_port),
            galvo: Galvo {
                origin_mm: lift(&self.galvo.origin_mm),
                axes: self.galvo.axes.map(c),
                radians_per_volt: c(self.galvo.radians_per_volt),
                quadratic: c(self.galvo.quadratic),
                cubic: c(self.galvo.cubic),
                reference_v: self.galvo.reference_v,
            },
            fan: Fan {
                apex_mm: lift(&self.fan.apex_mm),
                tilt_rad: c(self.fan.tilt_rad),
                mirror_offset_mm: c(self.fan.mirror_offset_mm),
                mirror_normal_rad: self.fan.mirror_normal_rad,
            },
            laser_port: port(&self.laser_port),
        }
    }

    /// [`Scanner::triangulate`] with the point's derivatives to pixel and voltage.
    ///
    /// # Errors
    /// As [`Scanner::triangulate`].
    pub fn triangulate_with_derivatives(
        &self,
        pixel: &Vector2<f64>,
        voltage: f64,
        outside: Medium,
    ) -> Result<Triangulated, GeomError> {
        self.exposure(voltage, outside)?.triangulate_with_derivatives(pixel)
    }

    /// `camera_from_galvo`: points of the galvanometer frame in the camera frame.
    pub fn camera_from_galvo(&self) -> Rigid<frame::Camera, frame::Galvo> {
        Rigid::from_matrix(&self.galvo.axes, self.galvo.origin_mm)
    }
}

/// The galvanometer frame's origin and axes (columns), from a point and direction of its axis and the normal of the laser
/// plane at the reference voltage, all in the camera frame: x along the axis, z perpendicular to it in the plane and
/// pointing `outwards`, y = z × x; the origin is the axis's point closest to the optical centre (FORMATS §3).
///
/// # Errors
/// [`GeomError::Invalid`] for an axis of length zero or one perpendicular to the plane.
pub fn galvo_frame(
    axis_point_mm: &Vector3<f64>,
    axis: &Vector3<f64>,
    plane_normal: &Vector3<f64>,
    outwards: &Vector3<f64>,
) -> Result<(Vector3<f64>, Matrix3<f64>), GeomError> {
    let invalid = |what, needed, got| GeomError::Invalid { what, needed, got };
    let x = unit(axis).ok_or_else(|| invalid("the galvanometer's axis", LONG, axis.norm()))?;
    let across = unit(plane_normal).map_or(Vector3::repeat(f64::NAN), |n| x.cross(&n));
    let z = unit(&across)
        .filter(|_| across.norm() > ALONG_AXIS)
        .ok_or_else(|| invalid("the laser plane's direction across the axis", LONG, across.norm()))?;
    let z = if z.dot(outwards) < 0.0 { -z } else { z };
    let origin = axis_point_mm - x * x.dot(axis_point_mm);
    if !origin.norm().is_finite() {
        return Err(invalid("a point of the galvanometer's axis", "finite", origin.norm()));
    }
    Ok((origin, Matrix3::from_columns(&[x, z.cross(&x), z])))
}

const LONG: &str = "finite and longer than 0";
/// Sine of the angle between axis and plane normal below which the plane has no direction across the axis.
const ALONG_AXIS: f64 = 1e-6;
