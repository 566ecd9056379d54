//! Derivatives against central differences, through every function that takes dual numbers and with respect to everything
//! the instrument is described by.
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use common::{WATER, scanner, stripe_pixel};
use nalgebra::{Matrix3, Vector2, Vector3};
use uw_geom::{
    Camera, Distortion, Dual, Fan, Galvo, Medium, Port, Real, Scanner, Triangulated, lift, norm,
    rotation_about_x, unit,
};

/// What central differences of figures near 1000 leave of 16 digits, relative to the derivative's scale.
const RELATIVE: f64 = 1e-6;
/// The instrument's figures that are varied, and the derivatives' names.
const FIGURES: [&str; 29] = [
    "fx",
    "fy",
    "cx",
    "cy",
    "k1",
    "k2",
    "p1",
    "p2",
    "k3",
    "camera window tilt x",
    "camera window tilt y",
    "camera window distance",
    "camera window thickness",
    "camera glass",
    "axis x",
    "axis y",
    "axis z",
    "axis turn",
    "gain",
    "quadratic",
    "cubic",
    "apex x",
    "apex y",
    "apex z",
    "tilt",
    "mirror offset",
    "laser window tilt",
    "laser window distance",
    "water",
];
const N: usize = FIGURES.len();
type D = Dual<N>;

/// Sizes over which each figure matters: steps of the differences are a fraction of them.
const SIZES: [f64; N] = [
    100.0, 100.0, 100.0, 100.0, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 10.0, 10.0, 0.1, 100.0, 100.0, 100.0, 0.1,
    0.01, 1e-3, 1e-3, 10.0, 10.0, 10.0, 0.1, 10.0, 0.1, 10.0, 0.1,
];

/// The instrument with its figures moved by `by`.
fn moved<T: Real>(by: &[T; N]) -> (Scanner<T>, Medium<T>) {
    let base = scanner();
    let c = T::constant;
    let d = base.camera.distortion;
    let port = |p: Port, tilt: Vector3<T>, distance: T, thickness: T, glass: T| Port {
        normal: unit(&(lift(&p.normal) + tilt)).unwrap(),
        distance_mm: c(p.distance_mm) + distance,
        thickness_mm: c(p.thickness_mm) + thickness,
        glass: Medium::of_index(c(p.glass.index) + glass),
    };
    let o = c(0.0);
    let axes: Matrix3<T> = base.galvo.axes.map(c);
    let scanner = Scanner {
        camera: Camera {
            fx: c(base.camera.fx) + by[0],
            fy: c(base.camera.fy) + by[1],
            cx: c(base.camera.cx) + by[2],
            cy: c(base.camera.cy) + by[3],
            distortion: Distortion {
                k1: c(d.k1) + by[4],
                k2: c(d.k2) + by[5],
                p1: c(d.p1) + by[6],
                p2: c(d.p2) + by[7],
                k3: c(d.k3) + by[8],
            },
        },
        camera_port: port(base.camera_port, Vector3::new(by[9], by[10], o), by[11], by[12], by[13]),
        galvo: Galvo {
            origin_mm: lift(&base.galvo.origin_mm) + Vector3::new(by[14], by[15], by[16]),
            axes: rotation_about_x(by[17]) * axes,
            radians_per_volt: c(base.galvo.radians_per_volt) + by[18],
            quadratic: c(base.galvo.quadratic) + by[19],
            cubic: c(base.galvo.cubic) + by[20],
            reference_v: base.galvo.reference_v,
        },
        fan: Fan {
            apex_mm: lift(&base.fan.apex_mm) + Vector3::new(by[21], by[22], by[23]),
            tilt_rad: c(base.fan.tilt_rad) + by[24],
            mirror_offset_mm: c(base.fan.mirror_offset_mm) + by[25],
            mirror_normal_rad: base.fan.mirror_normal_rad,
        },
        laser_port: port(base.laser_port, Vector3::new(by[26], o, o), by[27], o, o),
    };
    (scanner, Medium::of_index(c(WATER) + by[28]))
}

const VOLTAGE: f64 = -0.9;

/// Everything the model computes, at a pixel of the stripe and a point near the sheet.
fn outputs<T: Real>(by: &[T; N]) -> Vec<(&'static str, T)> {
    let (scanner, water) = moved(by);
    let pixel =
        stripe_pixel(&common::scanner(), VOLTAGE, 0.12, 820.0, Medium::of_index(WATER)).map(T::constant);
    let point = Vector3::new(-31.0, 95.0, 760.0).map(T::constant);
    let voltage = T::constant(VOLTAGE);
    let undistorted = scanner.camera.unproject(&pixel).unwrap();
    let ray = scanner.pixel_ray(&pixel, water).unwrap();
    let seen = scanner.observe(&point, voltage, water).unwrap();
    let air = scanner.camera_port.air_direction(&Vector3::repeat(T::constant(0.0)), &point, water).unwrap();
    let met = scanner.triangulate(&pixel, voltage, water).unwrap();
    let fan_ray = scanner.sheet(voltage, water).ray(0.1).unwrap();
    let mut all =
        vec![("project u", seen.pixel.x), ("project v", seen.pixel.y), ("off sheet", seen.off_sheet)];
    let vectors = [
        ("unproject", undistorted),
        ("ray origin", ray.origin),
        ("ray direction", ray.direction),
        ("air direction", air),
        ("triangulate", met),
        ("fan ray origin", fan_ray.origin),
        ("fan ray direction", fan_ray.direction),
    ];
    for (name, v) in vectors {
        all.extend(v.iter().map(|x| (name, *x)));
    }
    all
}

#[test]
fn every_derivative_is_that_of_central_differences() {
    let exact = outputs::<D>(&std::array::from_fn(|i| Dual::variable(0.0, i)));
    for (figure, size) in SIZES.into_iter().enumerate() {
        let at = |h: f64| outputs::<f64>(&std::array::from_fn(|i| if i == figure { h } else { 0.0 }));
        // Fourth order, so that a step large enough for the rounding is small enough for the curvature.
        let h = 1e-3 * size;
        let (a, b, c, d) = (at(-2.0 * h), at(-h), at(h), at(2.0 * h));
        for (i, (name, value)) in exact.iter().enumerate() {
            let difference = (a[i].1 - 8.0 * b[i].1 + 8.0 * c[i].1 - d[i].1) / (12.0 * h);
            let error = (value.eps[figure] - difference).abs();
            // Rounding of the values themselves, relative to a change of the figure by its size.
            let scale = difference.abs() + 1e-6 * value.re.abs() / size;
            assert!(
                error <= RELATIVE * scale,
                "∂({name})/∂({}): {} {difference}",
                FIGURES[figure],
                value.eps[figure]
            );
        }
    }
}

#[test]
fn points_carry_their_derivatives_to_pixel_and_voltage() {
    let (scanner, water) = (scanner(), Medium::of_index(WATER));
    for (angle, depth) in [(-0.2, 500.0), (0.0, 800.0), (0.15, 1200.0)] {
        let pixel = stripe_pixel(&scanner, VOLTAGE, angle, depth, water);
        let exact: Triangulated = scanner.triangulate_with_derivatives(&pixel, VOLTAGE, water).unwrap();
        let at = |u: f64, v: f64, volts: f64| {
            scanner.triangulate(&(pixel + Vector2::new(u, v)), VOLTAGE + volts, water).unwrap()
        };
        assert!((exact.point_mm - at(0.0, 0.0, 0.0)).norm() < 1e-9);
        let exposure = scanner.exposure(VOLTAGE, water).unwrap();
        assert_eq!(exposure.triangulate_with_derivatives(&pixel).unwrap(), exact);
        let difference = |f: &dyn Fn(f64) -> Vector3<f64>, h: f64| {
            (f(-2.0 * h) - f(-h) * 8.0 + f(h) * 8.0 - f(2.0 * h)) / (12.0 * h)
        };
        for (name, exact, expected) in [
            ("u", exact.per_u, difference(&|h| at(h, 0.0, 0.0), 0.3)),
            ("v", exact.per_v, difference(&|h| at(0.0, h, 0.0), 0.3)),
            ("voltage", exact.per_volt, difference(&|h| at(0.0, 0.0, h), 0.002)),
        ] {
            assert!((exact - expected).norm() <= RELATIVE * expected.norm(), "{name}: {exact} {expected}");
        }
    }
}

/// Operations on dual numbers that the model uses too little for the tests above.
#[test]
fn dual_numbers_follow_the_rules() {
    let f = |x: D, y: D| {
        let (s, c) = (x * y).sin_cos();
        let mut z = s / (c + x.scale(3.0)) - y.atan2(x) * (x + y).sqrt();
        z += x;
        z *= y;
        z -= D::constant(2.0);
        z /= -x;
        z + norm(&Vector3::new(x, y, z))
    };
    let at = |x: f64, y: f64| f(Dual::variable(x, 0), Dual::variable(y, 1));
    let (x, y, h) = (0.7, 1.3, 1e-5);
    let exact = at(x, y);
    for (i, difference) in
        [(at(x + h, y).re - at(x - h, y).re) / (2.0 * h), (at(x, y + h).re - at(x, y - h).re) / (2.0 * h)]
            .into_iter()
            .enumerate()
    {
        assert!((exact.eps[i] - difference).abs() < 1e-8, "{} {difference}", exact.eps[i]);
    }
    assert!(unit(&Vector3::<D>::repeat(D::constant(0.0))).is_none());
}
