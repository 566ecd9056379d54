//! The scene at one moment, ready for rays.

use crate::scene::{Body, Scene, Surface};
use crate::shape::{Meeting, Shape, Span};
use nalgebra::{Matrix3, Vector3};
use uw_geom::frame::Camera;
use uw_geom::{Ray, Rigid};

/// Where a ray first meets the scene, camera frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    /// Number of the object.
    pub(crate) object: usize,
    /// Which smooth part of it.
    pub(crate) facet: u32,
    /// Distance along the ray, mm.
    pub(crate) distance_mm: f64,
    /// The point, mm.
    pub(crate) point: Vector3<f64>,
    /// Unit normal on the side that the ray came from.
    pub(crate) normal: Vector3<f64>,
    /// x and y in the object's own frame, mm: where its texture is drawn.
    pub(crate) drawn: [f64; 2],
}

/// The objects of a scene where they are at one moment.
pub(crate) struct World<'s> {
    things: Vec<Thing<'s>>,
}

struct Thing<'s> {
    shape: &'s Shape,
    pub(crate) surface: Surface,
    /// Rows take directions of the camera frame into the object's.
    body_from_camera: Matrix3<f64>,
    at: Vector3<f64>,
    /// Middle (camera frame) and squared radius.
    ball: Option<(Vector3<f64>, f64)>,
}

/// How far from a surface light's way to it must be clear, mm: farther than rounding, nearer than anything that casts a shadow.
const TOUCHING_MM: f64 = 1e-4;

impl<'s> World<'s> {
    pub(crate) fn new(scene: &'s Scene, seconds: f64) -> Self {
        let things = scene.objects.iter().map(|object| {
            let pose: Rigid<Camera, Body> = object.pose_at(seconds, &scene.instrument_velocity_mm_s);
            let ball = object.shape.bounds().map(|(middle, r)| {
                // A hair larger, so that rounding can't leave out what touches it.
                (pose.transform_point(&middle), (r * (1.0 + 1e-9) + 1e-9).powi(2))
            });
            Thing {
                shape: &object.shape,
                surface: object.surface,
                body_from_camera: pose.rotation_matrix().transpose(),
                at: pose.translation_mm(),
                ball,
            }
        });
        Self { things: things.collect() }
    }

    pub(crate) fn surface(&self, object: usize) -> &Surface {
        &self.things[object].surface
    }

    /// The first surface that a ray meets.
    pub(crate) fn hit(&self, ray: &Ray) -> Option<Hit> {
        let mut span = Span { beyond: 0.0, within: f64::INFINITY };
        let mut first: Option<(usize, Meeting)> = None;
        for (object, thing) in self.things.iter().enumerate() {
            if let Some(meeting) = thing.meet(ray, span) {
                span.within = meeting.distance_mm;
                first = Some((object, meeting));
            }
        }
        let (object, meeting) = first?;
        let thing = &self.things[object];
        let point = ray.at(meeting.distance_mm);
        let local = thing.body_from_camera * (point - thing.at);
        let normal = thing.body_from_camera.tr_mul(&meeting.normal);
        let normal = if normal.dot(&ray.direction) > 0.0 { -normal } else { normal };
        let drawn = [local.x, local.y];
        Some(Hit { object, facet: meeting.facet, distance_mm: meeting.distance_mm, point, normal, drawn })
    }

    /// Whether nothing stands between a point of a surface and another point.
    pub(crate) fn clear(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        let way = to - from;
        let length = way.norm();
        let ray = Ray { origin: *from, direction: way / length };
        let span = Span { beyond: TOUCHING_MM, within: length };
        !self.things.iter().any(|thing| thing.meet(&ray, span).is_some())
    }
}

impl Thing<'_> {
    fn meet(&self, ray: &Ray, span: Span) -> Option<Meeting> {
        if let Some((middle, squared)) = self.ball {
            let to = middle - ray.origin;
            let along = to.dot(&ray.direction);
            let aside = to.norm_squared() - along * along;
            // Reach along the ray: rounding of `aside` near a tangent only costs a test.
            let reach = (squared - aside).max(0.0).sqrt();
            if aside > squared * (1.0 + 1e-9) || along + reach < span.beyond || along - reach > span.within {
                return None;
            }
        }
        let local = Ray {
            origin: self.body_from_camera * (ray.origin - self.at),
            direction: self.body_from_camera * ray.direction,
        };
        self.shape.meet(&local, span)
    }
}
