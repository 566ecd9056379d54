//! Distances and angles between shapes, with their sigmas.

use crate::cloud::PointCloud;
use crate::shapes::{Shape, ShapeFit};
use nalgebra::{DMatrix, RowDVector, Vector3};

/// A distance (mm) or an angle (rad) between two shapes, by their places in the list.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relation {
    /// The one.
    pub a: usize,
    /// The other.
    pub b: usize,
    /// The distance, mm, or the angle, rad, from 0 to π/2.
    pub value: f64,
    /// Its standard deviation by the measurement: the points' noise, and what they share of it.
    pub sigma: f64,
    /// Its standard deviation with the errors that all points share; `None` where those were not given.
    pub sigma_total: Option<f64>,
}

/// What lies between shapes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Relations {
    /// Between centres; from a centre to a plane or an axis; between axes (their nearest points, or the lines where they are parallel);
    /// between planes that are parallel to within their sigmas, at the points' middle.
    pub distances_mm: Vec<Relation>,
    /// Between normals, between axes, and between an axis and a plane.
    pub angles_rad: Vec<Relation>,
}

/// Returns distances and angles between all pairs of shapes.
///
/// The fits' errors are independent, as no two shapes share a point, but for what the cloud says that its points share ([`PointCloud::shared_mm`]). `shared`, one matrix a shape, has the derivatives of its
/// parameters (in the order of [`ShapeFit::covariance`]) by what moves all points alike, in units of its sigma and independent of
/// each other: what it contributes to both shapes cancels in a distance where it moves them together.
pub fn relations(cloud: &PointCloud, shapes: &[Shape], shared: Option<&[DMatrix<f64>]>) -> Relations {
    let mut all = Relations::default();
    for (a, one) in shapes.iter().enumerate() {
        for (b, other) in shapes.iter().enumerate().skip(a + 1) {
            let pair = Pair { cloud, a, b, one, other, shared };
            let (distance, angle) = pair.measures();
            let angle = angle.map(|measure| pair.relation(&*measure));
            let planes = matches!((&one.fit, &other.fit), (ShapeFit::Plane(_), ShapeFit::Plane(_)));
            let parallel =
                angle.is_none_or(|angle| angle.value <= PARALLEL_SIGMAS * angle.sigma + PARALLEL_RAD);
            if !planes || parallel {
                all.distances_mm.extend(distance.map(|measure| pair.relation(&*measure)));
            }
            all.angles_rad.extend(angle);
        }
    }
    all
}

/// Planes have a distance where their angle is no larger than so many of its sigmas, and a part of a millimetre on a metre.
const PARALLEL_SIGMAS: f64 = 3.0;
const PARALLEL_RAD: f64 = 5e-4;

struct Pair<'a> {
    cloud: &'a PointCloud,
    a: usize,
    b: usize,
    one: &'a Shape,
    other: &'a Shape,
    shared: Option<&'a [DMatrix<f64>]>,
}

/// A figure as a function of the two shapes' parameters.
type Measure = Box<dyn Fn(&[f64], &[f64]) -> f64>;

impl Pair<'_> {
    /// Returns the distance and the angle that the two kinds have.
    fn measures(&self) -> (Option<Measure>, Option<Measure>) {
        use ShapeFit::{Cylinder, Plane, Sphere};
        let turned = |f: fn(&[f64], &[f64]) -> f64| -> Measure { Box::new(move |p, q| f(q, p)) };
        match (&self.one.fit, &self.other.fit) {
            (Sphere(_), Sphere(_)) => (Some(Box::new(|p, q| (xyz(p) - xyz(q)).norm())), None),
            (Sphere(_), Plane(_)) => (Some(Box::new(center_to_plane)), None),
            (Plane(_), Sphere(_)) => (Some(turned(center_to_plane)), None),
            (Sphere(_), Cylinder(_)) => (Some(Box::new(center_to_axis)), None),
            (Cylinder(_), Sphere(_)) => (Some(turned(center_to_axis)), None),
            (Plane(_), Plane(_)) => {
                let middle = (self.middle(self.one) + self.middle(self.other)) * 0.5;
                let apart = move |p: &[f64], q: &[f64]| {
                    let (m, n) = (xyz(p), xyz(q));
                    let off = |n: &Vector3<f64>, d: f64| (n.dot(&middle) + d) / n.norm();
                    (off(&m, p[3]) - off(&n, q[3]).copysign(off(&n, q[3]) * m.dot(&n))).abs()
                };
                (Some(Box::new(apart)), Some(Box::new(|p, q| angle(&xyz(p), &xyz(q)))))
            }
            (Cylinder(_), Cylinder(_)) => {
                (Some(Box::new(axis_to_axis)), Some(Box::new(|p, q| angle(&xyz(&p[3..]), &xyz(&q[3..])))))
            }
            (Plane(_), Cylinder(_)) => {
                (None, Some(Box::new(|p, q| std::f64::consts::FRAC_PI_2 - angle(&xyz(p), &xyz(&q[3..])))))
            }
            (Cylinder(_), Plane(_)) => {
                (None, Some(Box::new(|p, q| std::f64::consts::FRAC_PI_2 - angle(&xyz(&p[3..]), &xyz(q)))))
            }
        }
    }

    /// Returns the middle of a shape's points.
    fn middle(&self, shape: &Shape) -> Vector3<f64> {
        shape.points.iter().map(|&i| self.cloud.vector(i)).sum::<Vector3<f64>>()
            / shape.points.len().max(1) as f64
    }

    /// Returns a figure with its sigmas, by differences along the parameters.
    fn relation(&self, measure: &dyn Fn(&[f64], &[f64]) -> f64) -> Relation {
        let (p, q) = (parameters(&self.one.fit), parameters(&self.other.fit));
        let value = measure(&p, &q);
        let slope = |of_first: bool| {
            let base = if of_first { &p } else { &q };
            RowDVector::from_fn(base.len(), |_, i| {
                let step = 1e-5 * base[i].abs().max(1.0);
                let at = |by: f64| {
                    let mut moved = base.clone();
                    moved[i] += by;
                    if of_first { measure(&moved, &q) } else { measure(&p, &moved) }
                };
                (at(step) - at(-step)) / (2.0 * step)
            })
        };
        let (j, k) = (slope(true), slope(false));
        let alone = (&j * self.one.fit.covariance() * j.transpose())[0]
            + (&k * self.other.fit.covariance() * k.transpose())[0];
        // In the covariance of each, and with the same sign in both.
        let step = |slope: &RowDVector<f64>, shape: &Shape| {
            slope.iter().zip(&shape.fit.influence().shared).map(|(slope, step)| slope * step).sum::<f64>()
        };
        let own = alone + 2.0 * step(&j, self.one) * step(&k, self.other);
        let total = self.shared.and_then(|shared| {
            let common = &j * shared.get(self.a)? + &k * shared.get(self.b)?;
            Some((own + common.norm_squared()).max(0.0).sqrt())
        });
        Relation { a: self.a, b: self.b, value, sigma: own.max(0.0).sqrt(), sigma_total: total }
    }
}

/// Returns the parameters in the order of the covariance.
fn parameters(fit: &ShapeFit) -> Vec<f64> {
    match fit {
        ShapeFit::Sphere(fit) => [&fit.center_mm[..], &[fit.radius_mm]].concat(),
        ShapeFit::Plane(fit) => [&fit.normal[..], &[fit.offset_mm]].concat(),
        ShapeFit::Cylinder(fit) => {
            [&fit.axis_point_mm[..], &fit.axis_direction[..], &[fit.radius_mm]].concat()
        }
    }
}

fn xyz(values: &[f64]) -> Vector3<f64> {
    Vector3::new(values[0], values[1], values[2])
}

fn center_to_plane(sphere: &[f64], plane: &[f64]) -> f64 {
    ((xyz(plane).dot(&xyz(sphere)) + plane[3]) / xyz(plane).norm()).abs()
}

fn center_to_axis(sphere: &[f64], cylinder: &[f64]) -> f64 {
    let axis = xyz(&cylinder[3..]);
    (xyz(sphere) - xyz(cylinder)).cross(&axis).norm() / axis.norm()
}

/// Returns the distance of two lines, of their points where they are parallel to within rounding.
fn axis_to_axis(p: &[f64], q: &[f64]) -> f64 {
    let (u, v) = (xyz(&p[3..]), xyz(&q[3..]));
    let apart = xyz(q) - xyz(p);
    let across = u.cross(&v);
    if across.norm() > 1e-3 * u.norm() * v.norm() {
        apart.dot(&across).abs() / across.norm()
    } else {
        apart.cross(&u).norm() / u.norm()
    }
}

/// Returns the angle between two lines, 0 to π/2.
fn angle(u: &Vector3<f64>, v: &Vector3<f64>) -> f64 {
    u.cross(v).norm().atan2(u.dot(v).abs())
}
