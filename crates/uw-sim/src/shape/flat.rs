//! Planes, rectangles and boxes.

use super::{Meeting, Span};
use nalgebra::Vector3;
use uw_geom::Ray;

pub(super) fn plane(ray: &Ray, span: Span) -> Option<Meeting> {
    let distance_mm = -ray.origin.z / ray.direction.z;
    span.holds(distance_mm).then(|| Meeting { distance_mm, normal: Vector3::z(), facet: 0 })
}

pub(super) fn rectangle(from: [f64; 2], to: [f64; 2], ray: &Ray, span: Span) -> Option<Meeting> {
    plane(ray, span).filter(|meeting| {
        let p = ray.at(meeting.distance_mm);
        p.x >= from[0] && p.x <= to[0] && p.y >= from[1] && p.y <= to[1]
    })
}

/// Slabs: a ray is inside the box where it is between all three pairs of faces.
pub(super) fn block(half: &[f64; 3], ray: &Ray, span: Span) -> Option<Meeting> {
    let (mut enter, mut leave) = ((f64::NEG_INFINITY, 0), (f64::INFINITY, 0));
    for (axis, h) in half.iter().enumerate() {
        let (o, d) = (ray.origin[axis], ray.direction[axis]);
        if d.abs() <= 0.0 {
            if o.abs() > *h {
                return None;
            }
            continue;
        }
        let (a, b) = ((-h - o) / d, (h - o) / d);
        if a.min(b) > enter.0 {
            enter = (a.min(b), axis);
        }
        if a.max(b) < leave.0 {
            leave = (a.max(b), axis);
        }
    }
    if enter.0 > leave.0 {
        return None;
    }
    let (distance_mm, axis) = [enter, leave].into_iter().find(|(t, _)| span.holds(*t))?;
    let side = ray.at(distance_mm)[axis].signum();
    let mut normal = Vector3::zeros();
    normal[axis] = side;
    Some(Meeting { distance_mm, normal, facet: 2 * axis as u32 + u32::from(side > 0.0) })
}
