//! Another sweep as what points are laid onto: its points and the form of the surface about them, not the faces between them.
//!
//! Faces between rough points hold whatever lies there: their slopes are by far more noise than form, and a point costs least where a face
//! happens to pass it, so that a pose stays short of where the form has it. A point's own place, and a normal from so many neighbours that
//! noise hardly tilts it, hold it only across the surface.

use super::form::{Form, forms};
use super::pose::Pose;
use super::sample::{Match, Own, Sample};
use crate::cloud::PointCloud;
use crate::error::CloudError;
use crate::mesh::TriangleMesh;
use crate::nearest::NearestOnMesh;
use crate::neighbours::Neighbours;
use crate::robust::Random;
use crate::surface::Surface;
use nalgebra::Vector3;

/// A sweep, seen from its frame's origin, that others are brought onto.
pub struct SweepSurface<'a> {
    pub(super) cloud: &'a PointCloud,
    pub(super) faces: NearestOnMesh<'a>,
    pub(super) points: Neighbours,
    /// About each point that a triangle has as a corner.
    pub(super) forms: Vec<Option<Form>>,
    /// Points on a border of the surface: what lies nearest to these may lie beyond it.
    open: Vec<bool>,
}

/// What a point belonged to when it was looked for: while it is nearer to that place than half of what the next one was farther by, it belongs there still.
#[derive(Clone, Copy, Default)]
pub(super) struct Known {
    place: Vector3<f64>,
    nearest: usize,
    farther: f64,
}

impl<'a> SweepSurface<'a> {
    /// Returns what others are laid onto, of a cloud and its surface by [`triangulate`](crate::triangulate); `None` where that has no area.
    ///
    /// # Errors
    /// [`CloudError`] for a position that is no finite number.
    pub fn new(cloud: &'a PointCloud, surface: &'a Surface) -> Result<Option<Self>, CloudError> {
        let points = Neighbours::new(cloud.positions_mm())?;
        let order = about_points(surface, &points);
        let Some(faces) = NearestOnMesh::in_order(&surface.mesh, order.into_iter()) else { return Ok(None) };
        let mut of_points = vec![None; cloud.len()];
        let mut open = vec![true; cloud.len()];
        let beside = forms(&surface.mesh).into_iter().zip(open_vertices(&surface.mesh));
        for (&point, (form, is_open)) in surface.points.iter().zip(beside) {
            of_points[point as usize] = form;
            open[point as usize] = is_open;
        }
        Ok(Some(Self { cloud, faces, points, forms: of_points, open }))
    }

    /// Returns what a point moved by a pose belongs to: the nearest of the sweep's points, and how far off it lies along the mean of the
    /// surface's normals at both places.
    ///
    /// Along the mean two points of one arc lie at no distance, wherever on it they are (S. Rusinkiewicz, ACM Trans. Graphics 38 (2019) 85): how far the
    /// two sweeps' points happen to lie apart on the surface does not matter. He takes the other normal from the point's own neighbours; here it is the one that the surface bends to,
    /// so that both have it of the same neighbours. What a motion changes is told along the normal at the sweep's point alone: a point that stands out by its noise bends the surface about it, and along the
    /// mean its error would come into what it is multiplied by. `known` is what was found before, of the same point moved by another pose, if anything.
    pub(super) fn matched(
        &self,
        sample: &Sample,
        pose: &Pose,
        reach: f64,
        known: &mut Known,
    ) -> Option<Match> {
        /// Half, less the rounding of distances.
        const HALF: f64 = 0.5 - 1e-9;
        let moved = pose.place(&sample.place);
        if (moved - known.place).norm_squared() >= (HALF * known.farther).powi(2) {
            let (_, nearest, farther) = self.points.nearest_by(&moved.into())?;
            *known = Known { place: moved, nearest, farther };
        }
        let nearest = known.nearest;
        let off = moved - self.cloud.vector(nearest);
        let form = self.forms[nearest].as_ref()?;
        // What lies farther along the surface from a point on its border than inner points do from theirs may lie beyond it.
        if self.open[nearest] && off.norm_squared() - form.normal.dot(&off).powi(2) > form.own_mm2 {
            return None;
        }
        // Neighbours on the surface may lie apart by more than what is looked for across it.
        if off.norm_squared() > (reach + form.reach_mm).powi(2) {
            return None;
        }
        let normal = (form.normal + form.bend * off * 0.5).try_normalize(0.0)?;
        let residual = normal.dot(&off);
        let turned = sample.normal.map(|own| pose.direction(&own));
        let facing = turned.map_or(1.0, |own| own.dot(&form.normal));
        let own = turned.map_or(normal, |own| own * facing.signum());
        (residual.abs() < reach).then(|| Match {
            arm: moved - pose.middle,
            normal: form.normal,
            own,
            residual,
            told: sample.own.along(&pose.back(&normal)) + Own::of(self.cloud, nearest).along(&normal),
            variance: 0.0,
            chance: 0.0,
            bent: 0.0,
            facing,
        })
    }
}

/// Returns a surface's triangles in the order in which the tree over the cloud's points has their first corners: what is near in it is near in space, and nothing has to be
/// compared.
fn about_points(surface: &Surface, points: &Neighbours) -> Vec<u32> {
    let mut ranks = vec![0_u32; points.len()];
    points.in_order().zip(0..).for_each(|(point, rank)| ranks[point] = rank);
    let triangles = surface.mesh.triangles();
    let rank = |corners: &[u32; 3]| ranks[surface.points[corners[0] as usize] as usize] as usize;
    let mut starts = vec![0_u32; points.len() + 1];
    triangles.iter().for_each(|corners| starts[rank(corners) + 1] += 1);
    (0..points.len()).for_each(|rank| starts[rank + 1] += starts[rank]);
    let mut order = vec![0; triangles.len()];
    for (corners, t) in triangles.iter().zip(0..) {
        let next = &mut starts[rank(corners)];
        order[*next as usize] = t;
        *next += 1;
    }
    order
}

/// Returns which vertices lie on a border of a mesh whose triangles agree about their sides, no edge having more than two.
///
/// Round an inner vertex each neighbour follows it in one triangle and precedes it in another. Numbers drawn for the neighbours, added in the one case and taken away in the other, leave nothing then, and
/// something else with the chance of one in 2⁶³.
fn open_vertices(mesh: &TriangleMesh) -> Vec<bool> {
    let drawn: Vec<u64> = (0..mesh.vertices_mm().len() as u64).map(|v| Random::new(v).bits()).collect();
    let mut left = vec![0_u64; drawn.len()];
    for &[a, b, c] in mesh.triangles() {
        for [before, v, after] in [[a, b, c], [b, c, a], [c, a, b]].map(|all| all.map(|v| v as usize)) {
            left[v] = left[v].wrapping_add(drawn[after]).wrapping_sub(drawn[before]);
        }
    }
    left.into_iter().map(|left| left != 0).collect()
}
