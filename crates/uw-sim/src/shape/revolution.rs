//! A profile of straight lines turned about the z axis: cylinders, cones, rings; with holes bored along z.

use super::{Meeting, Span};
use crate::error::{SimError, within};
use nalgebra::Vector3;
use std::f64::consts::TAU;
use uw_geom::Ray;

/// A profile turned about the z axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Revolution {
    /// Corners of the profile as (radius, z), in order, mm.
    pub profile_rz_mm: Vec<[f64; 2]>,
    /// Holes in one of its flat faces.
    pub holes: Option<Holes>,
}

/// Equal round holes on a circle about the axis, bored along −z from a flat face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Holes {
    /// How many; the first lies on the x axis.
    pub count: u32,
    /// Radius of the circle that their middles lie on, mm.
    pub circle_mm: f64,
    /// Radius of each, mm.
    pub radius_mm: f64,
    /// z of the face that they are bored into, mm.
    pub mouth_mm: f64,
    /// z of their floors, mm.
    pub floor_mm: f64,
}

/// How far from `mouth_mm` a face still is the one that the holes are in, mm.
const SAME_FACE_MM: f64 = 1e-6;

impl Revolution {
    pub(super) fn bounds(&self) -> (Vector3<f64>, f64) {
        let z = |f: fn(f64, f64) -> f64, start| self.profile_rz_mm.iter().fold(start, |m, p| f(m, p[1]));
        let middle = 0.5 * (z(f64::min, f64::INFINITY) + z(f64::max, f64::NEG_INFINITY));
        let reach = self.profile_rz_mm.iter().map(|p| p[0].hypot(p[1] - middle)).fold(0.0, f64::max);
        (Vector3::new(0.0, 0.0, middle), reach)
    }

    pub(super) fn check(&self) -> Result<(), SimError> {
        if self.profile_rz_mm.len() < 2 {
            let got = self.profile_rz_mm.len() as f64;
            return Err(SimError::Invalid { what: "a profile", needed: "two corners or more", got });
        }
        for [r, z] in &self.profile_rz_mm {
            within("a profile's radius", "from 0 to 1e6 mm", 0.0..=1e6, *r)?;
            within("a profile's z", "within 1e6 mm", -1e6..=1e6, *z)?;
        }
        if let Some(holes) = &self.holes {
            within("a number of holes", "from 1 to 1000", 1.0..=1000.0, f64::from(holes.count))?;
            within("a hole's radius", "positive", 1e-6..=1e6, holes.radius_mm)?;
            within("the holes' circle", "positive", 1e-6..=1e6, holes.circle_mm)?;
            let depth = holes.mouth_mm - holes.floor_mm;
            within("a hole's depth", "positive", 1e-6..=1e6, depth)?;
        }
        Ok(())
    }

    pub(super) fn meet(&self, ray: &Ray, mut span: Span) -> Option<Meeting> {
        let mut first = None;
        for (facet, pair) in self.profile_rz_mm.windows(2).enumerate() {
            if let Some(found) = self.side(pair[0], pair[1], ray, span) {
                span.within = found.distance_mm;
                first = Some(Meeting { facet: facet as u32, ..found });
            }
        }
        if let Some(holes) = &self.holes {
            let base = self.profile_rz_mm.len() as u32;
            if let Some(found) = holes.meet(ray, span) {
                first = Some(Meeting { facet: base + found.facet, ..found });
            }
        }
        first
    }

    /// The surface that the line from `a` to `b` (radius, z) sweeps.
    fn side(&self, a: [f64; 2], b: [f64; 2], ray: &Ray, span: Span) -> Option<Meeting> {
        let ([ra, za], [rb, zb]) = (a, b);
        let (o, d) = (&ray.origin, &ray.direction);
        let height = zb - za;
        if height.abs() <= 0.0 {
            // A ring.
            let t = (za - o.z) / d.z;
            let r2 = (o.x + t * d.x).powi(2) + (o.y + t * d.y).powi(2);
            let (inner, outer) = (ra.min(rb), ra.max(rb));
            let on = span.holds(t) && r2 >= inner * inner && r2 <= outer * outer;
            let bored = || self.holes.is_some_and(|h| h.open(za, &ray.at(t)));
            return (on && !bored()).then(|| Meeting { distance_mm: t, normal: Vector3::z(), facet: 0 });
        }
        // x² + y² = (r₀ + k z)², a quadratic in t; from the ray's point nearest the axis' height to keep digits.
        let k = (rb - ra) / height;
        let r0 = ra - k * za;
        let base = -(o.x * d.x + o.y * d.y) / (d.x * d.x + d.y * d.y).max(f64::MIN_POSITIVE);
        let base = if base.is_finite() { base } else { 0.0 };
        let p = ray.at(base);
        let (s, q) = (r0 + k * p.z, k * d.z);
        let qa = d.x * d.x + d.y * d.y - q * q;
        let qb = p.x * d.x + p.y * d.y - s * q;
        let qc = p.x * p.x + p.y * p.y - s * s;
        let roots = quadratic(qa, qb, qc)?;
        let (low, high) = (za.min(zb), za.max(zb));
        let distance_mm = roots.into_iter().map(|t| t + base).find(|&t| {
            let z = o.z + t * d.z;
            // Beyond the cone's apex lies its mirror image.
            span.holds(t) && z >= low && z <= high && r0 + k * z >= 0.0
        })?;
        let p = ray.at(distance_mm);
        let normal = Vector3::new(p.x, p.y, -k * (r0 + k * p.z)).try_normalize(0.0)?;
        Some(Meeting { distance_mm, normal, facet: 0 })
    }
}

/// Roots of a t² + 2 b t + c = 0, the smaller first.
fn quadratic(a: f64, b: f64, c: f64) -> Option<[f64; 2]> {
    let discriminant = b * b - a * c;
    if discriminant < 0.0 || discriminant.is_nan() {
        return None;
    }
    let q = -(b + discriminant.sqrt().copysign(b));
    let (t, u) = (q / a, c / q);
    Some(if t < u { [t, u] } else { [u, t] })
}

impl Holes {
    fn middle(&self, k: u32) -> [f64; 2] {
        let (s, c) = (TAU * f64::from(k) / f64::from(self.count)).sin_cos();
        [self.circle_mm * c, self.circle_mm * s]
    }

    /// The hole in whose mouth a point of the face lies.
    fn around(&self, p: &Vector3<f64>) -> Option<u32> {
        let count = f64::from(self.count);
        let nearest = (p.y.atan2(p.x) / TAU * count).round().rem_euclid(count) as u32;
        let [x, y] = self.middle(nearest);
        ((p.x - x).powi(2) + (p.y - y).powi(2) < self.radius_mm.powi(2)).then_some(nearest)
    }

    /// Whether a point of the face at `z` lies in a hole.
    fn open(&self, z: f64, p: &Vector3<f64>) -> bool {
        (z - self.mouth_mm).abs() <= SAME_FACE_MM && self.around(p).is_some()
    }

    /// The floor or wall that a ray meets: of the hole through whose mouth it goes, there being no other way in or out.
    fn meet(&self, ray: &Ray, mut span: Span) -> Option<Meeting> {
        let (o, d) = (&ray.origin, &ray.direction);
        let mouth = (self.mouth_mm - o.z) / d.z;
        let middle = if mouth.is_finite() { ray.at(mouth) } else { return None };
        let reach = self.circle_mm + self.radius_mm;
        if middle.x * middle.x + middle.y * middle.y > reach * reach {
            return None;
        }
        let k = self.around(&middle)?;
        let [x, y] = self.middle(k);
        let (px, py) = (o.x - x, o.y - y);
        let (a, b) = (d.x * d.x + d.y * d.y, px * d.x + py * d.y);
        let c = px * px + py * py - self.radius_mm * self.radius_mm;
        let mut first = None;
        let mut take = |t: f64, normal: Vector3<f64>, facet: u32| {
            if span.holds(t) {
                span.within = t;
                first = Some(Meeting { distance_mm: t, normal, facet });
            }
        };
        let floor = (self.floor_mm - o.z) / d.z;
        if (px + floor * d.x).powi(2) + (py + floor * d.y).powi(2) < self.radius_mm.powi(2) {
            take(floor, Vector3::z(), 2 * k);
        }
        for t in quadratic(a, b, c).into_iter().flatten() {
            let z = o.z + t * d.z;
            if z > self.floor_mm && z < self.mouth_mm {
                take(t, Vector3::new(px + t * d.x, py + t * d.y, 0.0) / self.radius_mm, 2 * k + 1);
            }
        }
        first
    }
}
