//! The instrument's unknowns: how a step changes it, and the figures that people read, as functions of it.
//!
//! A step has one local coordinate per [`Coordinate`], zero at the present instrument. Written once for every scalar: in
//! `f64` it moves the state, in dual numbers it gives the derivatives of whatever is computed from the moved instrument.

use nalgebra::{DMatrix, Matrix3, Vector3};
use uw_geom::{
    Camera, Distortion, Dual, Fan, Galvo, Medium, Port, Real, Scanner, lift, rotation_about_x, unit,
};

/// Number of shared unknowns.
pub const GLOBALS: usize = 34;

/// The shared unknowns, in the order of the normal matrix and of every covariance that is stored.
///
/// Tilts are about two directions square to the window's normal; turns and moves of the galvanometer are in its own frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
#[allow(missing_docs, reason = "the names say it, the units are in `NAMES`")]
pub enum Coordinate {
    Fx,
    Fy,
    Cx,
    Cy,
    K1,
    K2,
    P1,
    P2,
    K3,
    CameraPortTiltA,
    CameraPortTiltB,
    CameraPortDistance,
    CameraPortThickness,
    CameraPortIndex,
    WaterIndex,
    WaterDispersion,
    LaserPortTiltA,
    LaserPortTiltB,
    LaserPortDistance,
    LaserPortThickness,
    LaserPortIndex,
    AxisTurnX,
    AxisTurnY,
    AxisTurnZ,
    AxisMoveY,
    AxisMoveZ,
    ApexAlong,
    ApexAcross,
    ApexDistance,
    FanTilt,
    MirrorOffset,
    Gain,
    Quadratic,
    Cubic,
}

/// The shared unknowns that the camera's side of a residual depends on come first: pixels of a board need no more.
pub const CAMERA_SIDE: usize = Coordinate::WaterDispersion as usize + 1;

/// Names of the [`Coordinate`]s, as messages and files say them, with the unit.
pub const NAMES: [&str; GLOBALS] = [
    "camera.fx_px",
    "camera.fy_px",
    "camera.cx_px",
    "camera.cy_px",
    "camera.k1",
    "camera.k2",
    "camera.p1",
    "camera.p2",
    "camera.k3",
    "camera.port.tilt_a_rad",
    "camera.port.tilt_b_rad",
    "camera.port.distance_mm",
    "camera.port.thickness_mm",
    "camera.port.index",
    "water.index",
    "water.dispersion",
    "laser.port.tilt_a_rad",
    "laser.port.tilt_b_rad",
    "laser.port.distance_mm",
    "laser.port.thickness_mm",
    "laser.port.index",
    "galvo.turn_x_rad",
    "galvo.turn_y_rad",
    "galvo.turn_z_rad",
    "galvo.move_y_mm",
    "galvo.move_z_mm",
    "laser.apex_along_axis_mm",
    "laser.apex_across_mm",
    "laser.apex_distance_mm",
    "laser.fan_tilt_rad",
    "galvo.mirror_offset_mm",
    "galvo.radians_per_volt",
    "galvo.quadratic_rad_per_v2",
    "galvo.cubic_rad_per_v3",
];

/// The instrument and the water, as far as calibration changes them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instrument<T: nalgebra::Scalar = f64> {
    /// The scanner.
    pub scanner: Scanner<T>,
    /// Index of water at the laser's wavelength: estimate minus the captures' nominal one.
    pub water_offset: T,
    /// How much more the index differs from its nominal value at the board's illumination.
    pub dispersion_offset: T,
}

impl Instrument<f64> {
    /// The instrument moved by the local coordinates `d`.
    pub fn moved<T: Real>(&self, d: &[T; GLOBALS]) -> Instrument<T> {
        let at = |c: Coordinate| d[c as usize];
        let add = |value: f64, c: Coordinate| T::constant(value) + at(c);
        let s = &self.scanner;
        let k = &s.camera.distortion;
        let camera = Camera {
            fx: add(s.camera.fx, Coordinate::Fx),
            fy: add(s.camera.fy, Coordinate::Fy),
            cx: add(s.camera.cx, Coordinate::Cx),
            cy: add(s.camera.cy, Coordinate::Cy),
            distortion: Distortion {
                k1: add(k.k1, Coordinate::K1),
                k2: add(k.k2, Coordinate::K2),
                p1: add(k.p1, Coordinate::P1),
                p2: add(k.p2, Coordinate::P2),
                k3: add(k.k3, Coordinate::K3),
            },
        };
        let port = |p: &Port, first: Coordinate| {
            let i = first as usize;
            Port {
                normal: tilted(&p.normal, d[i], d[i + 1]),
                distance_mm: T::constant(p.distance_mm) + d[i + 2],
                thickness_mm: T::constant(p.thickness_mm) + d[i + 3],
                glass: Medium::of_index(T::constant(p.glass.index) + d[i + 4]),
            }
        };
        let turn = rotation_about_z(at(Coordinate::AxisTurnZ))
            * rotation_about_y(at(Coordinate::AxisTurnY))
            * rotation_about_x(at(Coordinate::AxisTurnX));
        let old_axes = s.galvo.axes.map(T::constant);
        let zero = T::constant(0.0);
        let shift = Vector3::new(zero, at(Coordinate::AxisMoveY), at(Coordinate::AxisMoveZ));
        let on_axis = lift::<T>(&s.galvo.origin_mm) + old_axes * shift;
        let axes = old_axes * turn;
        let x: Vector3<T> = axes.column(0).into_owned();
        let galvo = Galvo {
            // The origin stays the point of the axis closest to the optical centre.
            origin_mm: on_axis - x * x.dot(&on_axis),
            axes,
            radians_per_volt: add(s.galvo.radians_per_volt, Coordinate::Gain),
            quadratic: add(s.galvo.quadratic, Coordinate::Quadratic),
            cubic: add(s.galvo.cubic, Coordinate::Cubic),
            reference_v: s.galvo.reference_v,
        };
        let fan = Fan {
            apex_mm: Vector3::new(
                add(s.fan.apex_mm.x, Coordinate::ApexAlong),
                add(s.fan.apex_mm.y, Coordinate::ApexAcross),
                T::constant(s.fan.apex_mm.z) - at(Coordinate::ApexDistance),
            ),
            tilt_rad: add(s.fan.tilt_rad, Coordinate::FanTilt),
            mirror_offset_mm: add(s.fan.mirror_offset_mm, Coordinate::MirrorOffset),
            mirror_normal_rad: s.fan.mirror_normal_rad,
        };
        Instrument {
            scanner: Scanner {
                camera,
                camera_port: port(&s.camera_port, Coordinate::CameraPortTiltA),
                galvo,
                fan,
                laser_port: port(&s.laser_port, Coordinate::LaserPortTiltA),
            },
            water_offset: add(self.water_offset, Coordinate::WaterIndex),
            dispersion_offset: add(self.dispersion_offset, Coordinate::WaterDispersion),
        }
    }

    /// The instrument with its first `K` coordinates as the variables 0 … K − 1 of dual numbers, the others constant.
    pub fn variables<const N: usize, const K: usize>(&self) -> Instrument<Dual<N>> {
        let d = std::array::from_fn(|i| if i < K { Dual::variable(0.0, i) } else { Dual::constant(0.0) });
        self.moved(&d)
    }
}

/// `normal` tilted by two small components square to it.
fn tilted<T: Real>(normal: &Vector3<f64>, a: T, b: T) -> Vector3<T> {
    let (e, f) = square_to(normal);
    let n = lift::<T>(normal) + lift::<T>(&e) * a + lift::<T>(&f) * b;
    unit(&n).unwrap_or(n)
}

/// Two unit vectors square to `normal` and to each other.
pub(crate) fn square_to(normal: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    // The axis that the normal leans on least, so that the cross product can't vanish.
    let least = normal.map(f64::abs).imin();
    let helper = Vector3::ith(least, 1.0);
    let e = normal.cross(&helper);
    let e = e / e.norm();
    (e, normal.cross(&e))
}

fn rotation_about_y<T: Real>(angle: T) -> Matrix3<T> {
    let ((s, c), o, i) = (angle.sin_cos(), T::constant(0.0), T::constant(1.0));
    Matrix3::new(c, o, s, o, i, o, -s, o, c)
}

fn rotation_about_z<T: Real>(angle: T) -> Matrix3<T> {
    let ((s, c), o, i) = (angle.sin_cos(), T::constant(0.0), T::constant(1.0));
    Matrix3::new(c, -s, o, s, c, o, o, o, i)
}

/// One figure of the instrument that people read: its name with the unit, value and standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantity {
    /// Dotted name, unit last.
    pub name: &'static str,
    /// Value.
    pub value: f64,
    /// Standard deviation.
    pub sigma: f64,
}

/// Names of what [`readable`] returns, in its order.
const READABLE: [&str; 43] = [
    "camera.fx_px",
    "camera.fy_px",
    "camera.cx_px",
    "camera.cy_px",
    "camera.k1",
    "camera.k2",
    "camera.p1",
    "camera.p2",
    "camera.k3",
    "camera.port.normal_x",
    "camera.port.normal_y",
    "camera.port.normal_z",
    "camera.port.distance_mm",
    "camera.port.thickness_mm",
    "camera.port.index",
    "laser.port.normal_x",
    "laser.port.normal_y",
    "laser.port.normal_z",
    "laser.port.distance_mm",
    "laser.port.thickness_mm",
    "laser.port.index",
    "galvo.axis_point_x_mm",
    "galvo.axis_point_y_mm",
    "galvo.axis_point_z_mm",
    "galvo.axis_direction_x",
    "galvo.axis_direction_y",
    "galvo.axis_direction_z",
    "galvo.z_axis_x",
    "galvo.z_axis_y",
    "galvo.z_axis_z",
    "galvo.degrees_per_volt",
    "galvo.c2_deg_per_v2",
    "galvo.c3_deg_per_v3",
    "galvo.mirror_offset_mm",
    "laser.apex_along_axis_mm",
    "laser.apex_across_mm",
    "laser.apex_distance_mm",
    "laser.fan_tilt_deg",
    "water.index_offset",
    "water.dispersion_offset",
    "laser.plane_normal_x",
    "laser.plane_normal_y",
    "laser.plane_normal_z",
];

/// The figures that people read, as functions of the instrument; degrees where a person would want degrees.
fn readable<T: Real>(i: &Instrument<T>) -> [T; READABLE.len()] {
    let s = &i.scanner;
    let (c, g, f) = (&s.camera, &s.galvo, &s.fan);
    let degrees = |x: T| x.scale(180.0 / std::f64::consts::PI);
    let column = |k: usize| [g.axes[(0, k)], g.axes[(1, k)], g.axes[(2, k)]];
    let (x, z) = (column(0), column(2));
    let (sn, cs) = f.tilt_rad.sin_cos();
    let plane = g.axes * Vector3::new(sn, cs, T::constant(0.0));
    let (p, l) = (&s.camera_port, &s.laser_port);
    [
        c.fx,
        c.fy,
        c.cx,
        c.cy,
        c.distortion.k1,
        c.distortion.k2,
        c.distortion.p1,
        c.distortion.p2,
        c.distortion.k3,
        p.normal.x,
        p.normal.y,
        p.normal.z,
        p.distance_mm,
        p.thickness_mm,
        p.glass.index,
        l.normal.x,
        l.normal.y,
        l.normal.z,
        l.distance_mm,
        l.thickness_mm,
        l.glass.index,
        g.origin_mm.x,
        g.origin_mm.y,
        g.origin_mm.z,
        x[0],
        x[1],
        x[2],
        z[0],
        z[1],
        z[2],
        degrees(g.radians_per_volt),
        degrees(g.quadratic),
        degrees(g.cubic),
        f.mirror_offset_mm,
        f.apex_mm.x,
        f.apex_mm.y,
        -f.apex_mm.z,
        degrees(f.tilt_rad),
        i.water_offset,
        i.dispersion_offset,
        plane.x,
        plane.y,
        plane.z,
    ]
}

/// Every figure of the instrument with its standard deviation, from the covariance of the local coordinates
/// (`GLOBALS` × `GLOBALS`).
pub fn quantities(instrument: &Instrument, covariance: &DMatrix<f64>) -> Vec<Quantity> {
    let duals = readable(&instrument.variables::<GLOBALS, GLOBALS>());
    std::iter::zip(READABLE, duals)
        .map(|(name, q)| Quantity { name, value: q.re, sigma: variance(&q.eps, covariance).max(0.0).sqrt() })
        .collect()
}

/// gᵀ C g: the variance of a figure whose gradient by the local coordinates is g.
pub fn variance(gradient: &[f64; GLOBALS], covariance: &DMatrix<f64>) -> f64 {
    let g = nalgebra::DVector::from_column_slice(gradient);
    g.dot(&(covariance * &g))
}
