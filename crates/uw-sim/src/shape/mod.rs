//! Shapes that rays meet, each in its own frame.

mod bvh;
mod flat;
mod mesh;
mod revolution;

use crate::error::{SimError, within};
use nalgebra::Vector3;
use uw_geom::Ray;

pub use mesh::Mesh;
pub use revolution::{Holes, Revolution};

/// What a ray can meet. Millimetres, the object's own frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// The plane z = 0, without end.
    Plane,
    /// A rectangle in the plane z = 0.
    Rectangle {
        /// Smallest x and y.
        from_mm: [f64; 2],
        /// Largest x and y.
        to_mm: [f64; 2],
    },
    /// A sphere about the origin.
    Sphere {
        /// Its radius.
        radius_mm: f64,
    },
    /// A box about the origin.
    Block {
        /// Half of its sides.
        half_mm: [f64; 3],
    },
    /// A profile turned about the z axis.
    Revolution(Revolution),
    /// Triangles.
    Mesh(Mesh),
}

/// Where a ray meets a shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Meeting {
    /// Distance along the ray, mm.
    pub distance_mm: f64,
    /// Unit normal, of either sense.
    pub normal: Vector3<f64>,
    /// Which smooth part of the shape it is.
    pub facet: u32,
}

/// The part of a ray in which meetings count, mm.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    /// Meetings farther than this …
    pub beyond: f64,
    /// … and nearer than this.
    pub within: f64,
}

impl Span {
    /// Whether a distance lies in it; NaN does not.
    pub(crate) fn holds(&self, t: f64) -> bool {
        t > self.beyond && t < self.within
    }
}

impl Shape {
    /// The first meeting of a ray (unit direction) with the shape within `span`.
    pub fn meet(&self, ray: &Ray, span: Span) -> Option<Meeting> {
        match self {
            Self::Plane => flat::plane(ray, span),
            Self::Rectangle { from_mm, to_mm } => flat::rectangle(*from_mm, *to_mm, ray, span),
            Self::Sphere { radius_mm } => sphere(*radius_mm, ray, span),
            Self::Block { half_mm } => flat::block(half_mm, ray, span),
            Self::Revolution(revolution) => revolution.meet(ray, span),
            Self::Mesh(mesh) => mesh.meet(ray, span),
        }
    }

    /// A sphere around the shape: its centre and radius, mm; `None` for one without end.
    pub fn bounds(&self) -> Option<(Vector3<f64>, f64)> {
        match self {
            Self::Plane => None,
            Self::Rectangle { from_mm, to_mm } => {
                let [a, b] = [from_mm, to_mm].map(|p| Vector3::new(p[0], p[1], 0.0));
                Some((0.5 * (a + b), 0.5 * (b - a).norm()))
            }
            Self::Sphere { radius_mm } => Some((Vector3::zeros(), *radius_mm)),
            Self::Block { half_mm } => Some((Vector3::zeros(), Vector3::from(*half_mm).norm())),
            Self::Revolution(revolution) => Some(revolution.bounds()),
            Self::Mesh(mesh) => Some(mesh.bounds()),
        }
    }

    /// Checks every figure.
    ///
    /// # Errors
    /// [`SimError::Invalid`] names the first that no shape has.
    pub fn check(&self) -> Result<(), SimError> {
        let side = |what, value| within(what, "positive and below 1e6 mm", 1e-6..=1e6, value).map(drop);
        match self {
            Self::Plane | Self::Mesh(_) => Ok(()),
            Self::Rectangle { from_mm, to_mm } => {
                (0..2).try_for_each(|i| side("a rectangle's side", to_mm[i] - from_mm[i]))
            }
            Self::Sphere { radius_mm } => side("a sphere's radius", *radius_mm),
            Self::Block { half_mm } => half_mm.iter().try_for_each(|h| side("a box's half side", *h)),
            Self::Revolution(revolution) => revolution.check(),
        }
    }
}

fn sphere(radius: f64, ray: &Ray, span: Span) -> Option<Meeting> {
    // Of t² + 2 b t + c = 0 the root that loses no digits first.
    let b = ray.origin.dot(&ray.direction);
    let nearest = ray.origin - ray.direction * b;
    let squared = radius * radius - nearest.norm_squared();
    if squared < 0.0 {
        return None;
    }
    let half = squared.sqrt();
    let distance_mm = [-b - half, -b + half].into_iter().find(|t| span.holds(*t))?;
    Some(Meeting { distance_mm, normal: ray.at(distance_mm) / radius, facet: 0 })
}
