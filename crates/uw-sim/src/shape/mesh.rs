//! Triangles.

use super::bvh::Bvh;
use super::{Meeting, Span};
use crate::error::SimError;
use nalgebra::Vector3;
use uw_geom::Ray;

/// A mesh of triangles with a tree to find them by. Either side of a triangle is seen.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    triangles: Vec<[Vector3<f64>; 3]>,
    tree: Bvh,
}

impl Mesh {
    /// The mesh of these triangles, each three numbers of vertices (mm).
    ///
    /// # Errors
    /// [`SimError::Mesh`] for a vertex that there is not; [`SimError::Invalid`] for none at all, or for one that is not finite.
    pub fn new(vertices_mm: &[[f64; 3]], triangles: &[[u32; 3]]) -> Result<Self, SimError> {
        let corner = |triangle: usize, vertex: u32| {
            let vertex = vertex as usize;
            let missing = SimError::Mesh { triangle, vertex, vertices: vertices_mm.len() };
            vertices_mm.get(vertex).map(|v| Vector3::from(*v)).ok_or(missing)
        };
        let triangles = triangles
            .iter()
            .enumerate()
            .map(|(i, [a, b, c])| Ok([corner(i, *a)?, corner(i, *b)?, corner(i, *c)?]))
            .collect::<Result<Vec<_>, SimError>>()?;
        if triangles.is_empty() {
            return Err(SimError::Invalid { what: "a mesh", needed: "one triangle or more", got: 0.0 });
        }
        if let Some(bad) = triangles.iter().flatten().flatten().find(|x| x.is_nan() || x.abs() > FARTHEST_MM)
        {
            return Err(SimError::Invalid { what: "a vertex", needed: "finite", got: *bad });
        }
        let tree = Bvh::new(&triangles);
        Ok(Self { triangles, tree })
    }

    pub(super) fn bounds(&self) -> (Vector3<f64>, f64) {
        let (low, high) = self.tree.bounds();
        (0.5 * (low + high), 0.5 * (high - low).norm())
    }

    pub(super) fn meet(&self, ray: &Ray, mut span: Span) -> Option<Meeting> {
        let mut first = None;
        self.tree.visit(ray, &mut span, |triangle, span| {
            if let Some(t) = crossing(&self.triangles[triangle], ray).filter(|t| span.holds(*t)) {
                span.within = t;
                first = Some((t, triangle));
            }
        });
        let (distance_mm, triangle) = first?;
        let [a, b, c] = self.triangles[triangle];
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0)?;
        Some(Meeting { distance_mm, normal, facet: triangle as u32 })
    }
}

/// Distance along the ray to a triangle (T. Möller, B. Trumbore, J. Graphics Tools 2 (1997) 21). An edge belongs to both of its
/// triangles, so that no ray slips through between them.
fn crossing([a, b, c]: &[Vector3<f64>; 3], ray: &Ray) -> Option<f64> {
    let (e1, e2) = (b - a, c - a);
    let p = ray.direction.cross(&e2);
    let determinant = e1.dot(&p);
    if determinant.abs() <= 0.0 {
        return None;
    }
    let s = ray.origin - a;
    let u = s.dot(&p) / determinant;
    let q = s.cross(&e1);
    let v = ray.direction.dot(&q) / determinant;
    (u >= -EDGE && v >= -EDGE && u + v <= 1.0 + EDGE).then(|| e2.dot(&q) / determinant)
}

/// A thousand kilometres: no vertex is farther.
const FARTHEST_MM: f64 = 1e9;
/// Rounding of barycentric coordinates.
const EDGE: f64 = 1e-12;
