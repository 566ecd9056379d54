//! Another sweep as what points are laid onto: its points and the planes about them, not the faces between them.
//!
//! Faces between rough points hold whatever lies there: their slopes are by far more noise than form, and a point costs least where a face
//! happens to pass it, so that a pose stays short of where the form has it. A point's own place, and the plane through so many neighbours that
//! noise hardly tilts it, hold it only across the surface.

use super::sample::{Match, Own, Sample};
use crate::cloud::PointCloud;
use crate::error::CloudError;
use crate::nearest::NearestOnMesh;
use crate::neighbours::Neighbours;
use crate::normals::{LocalPlane, NORMAL_NEIGHBOURS, local_planes};
use crate::surface::Surface;
use nalgebra::{Isometry3, Point3, Vector3};

/// A sweep, seen from its frame's origin, that others are brought onto.
pub struct SweepSurface<'a> {
    pub(super) cloud: &'a PointCloud,
    pub(super) faces: NearestOnMesh<'a>,
    pub(super) planes: Vec<Option<LocalPlane>>,
    points: Neighbours,
    /// Points on a border of the surface or on none of its triangles: what lies nearest to these may lie beyond it.
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
        let Some(faces) = NearestOnMesh::new(&surface.mesh) else { return Ok(None) };
        let planes = local_planes(&points, NORMAL_NEIGHBOURS, &[0.0; 3]);
        let mut open = vec![true; cloud.len()];
        for (vertex, &point) in surface.points.iter().enumerate() {
            open[point as usize] = faces.is_open(vertex);
        }
        Ok(Some(Self { cloud, faces, planes, points, open }))
    }

    /// Returns what a point moved by a pose belongs to: the nearest of the sweep's points, and how far off it lies along the mean of both
    /// points' normals.
    ///
    /// Along the mean two points of one arc lie at no distance, wherever on it they are (S. Rusinkiewicz, ACM Trans. Graphics 38 (2019) 85): how far the
    /// two sweeps' points happen to lie apart on the surface does not matter. `known` is what was found before, of the same point moved by another pose, if anything.
    pub(super) fn matched(
        &self,
        sample: &Sample,
        pose: &Isometry3<f64>,
        middle: &Vector3<f64>,
        reach: f64,
        known: &mut Known,
    ) -> Option<Match> {
        /// Half, less the rounding of distances.
        const HALF: f64 = 0.5 - 1e-9;
        let moved = (pose * Point3::from(sample.place)).coords;
        if (moved - known.place).norm_squared() >= (HALF * known.farther).powi(2) {
            let (_, nearest, farther) = self.points.nearest_by(&moved.into())?;
            *known = Known { place: moved, nearest, farther };
        }
        let nearest = known.nearest;
        let square = (moved - self.cloud.vector(nearest)).norm_squared();
        let plane = self.planes[nearest].filter(|_| !self.open[nearest])?;
        // Neighbours on the surface may lie apart by more than what is looked for across it.
        if square > (reach + plane.reach_mm).powi(2) {
            return None;
        }
        let turned = sample.normal.map(|own| pose.rotation * own);
        let facing = turned.map_or(1.0, |own| own.dot(&plane.normal));
        let own = turned.map_or(plane.normal, |own| own * facing.signum());
        let normal = (own + plane.normal).try_normalize(0.0)?;
        let residual = normal.dot(&(moved - self.cloud.vector(nearest)));
        let back = pose.rotation.inverse_transform_vector(&normal);
        (residual.abs() < reach).then(|| Match {
            arm: moved - (pose * Point3::from(*middle)).coords,
            normal,
            normals: [own, plane.normal],
            residual,
            told: sample.own.along(&back) + Own::of(self.cloud, nearest).along(&normal),
            facing,
        })
    }
}
