//! The points that a pose is estimated from, and what each lies off the mesh.

use super::pose::Pose;
use super::sweep::{Known, SweepSurface};
use crate::cloud::{PointCloud, unpacked};
use crate::error::RegisterError;
use crate::mesh::TriangleMesh;
use crate::nearest::{Nearest, NearestOnMesh};
use crate::neighbours::Neighbours;
use crate::normals::{NORMAL_NEIGHBOURS, local_plane, local_planes, shared_planes};
use crate::robust::ranked;
use nalgebra::{Isometry3, Matrix3, Matrix6, Vector3, Vector6};

/// Tukey's constant: 95 % of a mean's efficiency with Gaussian noise, nothing from beyond it. What lies on a surface does not lie farther off.
pub(super) const TUKEY: f64 = 4.685;
/// Points that a pose is estimated from; more don't make it better than what the instrument shares between them.
const MOST_POINTS: usize = 50_000;
/// Share of the points that the cloud's size is taken from: a few far astray don't make it large.
const SIZED_BY: f64 = 0.95;

/// What is known of a point's own error.
pub(super) enum Own {
    Covariance(Matrix3<f64>),
    Variance(f64),
}

impl Own {
    /// What a cloud tells of a point.
    pub(super) fn of(cloud: &PointCloud, point: usize) -> Self {
        match (cloud.covariances_mm2(), cloud.sigmas_mm()) {
            (Some(all), _) => Self::Covariance(unpacked(&all[point])),
            (None, Some(sigmas)) => Self::Variance(f64::from(sigmas[point]).powi(2)),
            (None, None) => Self::Variance(0.0),
        }
    }

    /// The variance along a direction, mm².
    pub(super) fn along(&self, direction: &Vector3<f64>) -> f64 {
        match self {
            Self::Covariance(all) => direction.dot(&(all * direction)).max(0.0),
            Self::Variance(own) => *own,
        }
    }

    /// The variance along all directions together, or along any where they are alike, mm².
    fn most(&self) -> f64 {
        match self {
            Self::Covariance(all) => all.trace().max(0.0),
            Self::Variance(own) => *own,
        }
    }
}

/// One point of the cloud.
pub(super) struct Sample {
    pub(super) place: Vector3<f64>,
    /// Normal of the surface about it; towards the sensor where [`Samples::signed`].
    pub(super) normal: Option<Vector3<f64>>,
    pub(super) own: Own,
}

/// Points of a cloud, their middle and size.
pub(crate) struct Samples {
    pub(super) points: Vec<Sample>,
    /// The points by their index, what is near in space near in it.
    pub(super) order: Vec<usize>,
    pub(super) middle: Vector3<f64>,
    /// Root mean square distance from the middle, mm.
    pub(super) radius: f64,
    /// Whether the normals' sides are known.
    pub(super) signed: bool,
}

impl Samples {
    /// Takes points evenly from a cloud, each with the normal that its own neighbours tell.
    pub(super) fn new(cloud: &PointCloud) -> Result<Self, RegisterError> {
        let neighbours = tree(cloud)?;
        let positions = cloud.positions_mm();
        // Only of what one sweep saw is it known which side the sensor was on.
        let signed = cloud.pixels().is_some();
        if cloud.len() <= MOST_POINTS {
            let planes = local_planes(&neighbours, NORMAL_NEIGHBOURS, &[0.0; 3]);
            return Self::with_normals(cloud, &neighbours, |i| planes[i].map(|plane| plane.normal), signed);
        }
        let normal = |i: usize| {
            local_plane(positions, &neighbours, &positions[i], NORMAL_NEIGHBOURS, &[0.0; 3])
                .map(|plane| plane.normal)
        };
        Self::with_normals(cloud, &neighbours, normal, signed)
    }

    /// Takes points evenly from a sweep, which was seen from its frame's origin, pixels or not; the few about one place with one normal.
    ///
    /// That tells which face a point is of, and how much of a form there is; where on the other surface it lies, that surface's own form tells.
    pub(super) fn of_cloud(cloud: &PointCloud) -> Result<Self, RegisterError> {
        let neighbours = tree(cloud)?;
        let planes = shared_planes(&neighbours, NORMAL_NEIGHBOURS, &[0.0; 3]);
        Self::with_normals(cloud, &neighbours, |i| planes[i].map(|plane| plane.normal), true)
    }

    /// Takes points evenly from a sweep that has a surface.
    pub(crate) fn of_sweep(sweep: &SweepSurface<'_>) -> Result<Self, RegisterError> {
        let normal = |i: usize| sweep.forms[i].as_ref().map(|form| form.normal);
        Self::with_normals(sweep.cloud, &sweep.points, normal, true)
    }

    fn with_normals(
        cloud: &PointCloud,
        neighbours: &Neighbours,
        normal: impl Fn(usize) -> Option<Vector3<f64>>,
        signed: bool,
    ) -> Result<Self, RegisterError> {
        let sample = |i: usize| Sample { place: cloud.vector(i), normal: normal(i), own: Own::of(cloud, i) };
        let step = cloud.len().div_ceil(MOST_POINTS).max(1);
        let points: Vec<Sample> = (0..cloud.len()).step_by(step).map(sample).collect();
        if points.len() < 6 {
            return Err(RegisterError::TooFewPoints { got: cloud.len() });
        }
        let middle = Vector3::from_fn(|axis, _| {
            let mut values: Vec<f64> = points.iter().map(|p| p.place[axis]).collect();
            let half = values.len() / 2;
            ranked(&mut values, half).unwrap_or_default()
        });
        let mut squares: Vec<f64> = points.iter().map(|p| (p.place - middle).norm_squared()).collect();
        let sized = ((points.len() as f64 * SIZED_BY) as usize).max(1);
        let _ = ranked(&mut squares, sized - 1);
        let radius = (squares[..sized].iter().sum::<f64>() / sized as f64).sqrt();
        if radius <= 1e-12 * middle.norm() {
            return Err(RegisterError::OnePlace);
        }
        let taken = neighbours.in_order().filter(|i| i % step == 0).map(|i| i / step);
        Ok(Self { order: taken.collect(), points, middle, radius, signed })
    }

    /// Returns all of the points; what is near in space is near in their order.
    pub(super) fn all(&self) -> Vec<&Sample> {
        self.order.iter().map(|&at| &self.points[at]).collect()
    }

    /// Returns up to so many of the points, evenly taken.
    pub(super) fn few(&self, most: usize) -> Vec<&Sample> {
        self.points.iter().step_by(self.points.len().div_ceil(most)).collect()
    }
}

/// Returns the tree over a cloud's points, of which there have to be six, with finite values.
fn tree(cloud: &PointCloud) -> Result<Neighbours, RegisterError> {
    cloud.check_finite()?;
    if cloud.len() < 6 {
        return Err(RegisterError::TooFewPoints { got: cloud.len() });
    }
    Ok(Neighbours::new(cloud.positions_mm())?)
}

/// A point and the place of the mesh that it belongs to.
pub(super) struct Match {
    /// From the cloud's middle to the point, both moved.
    pub(super) arm: Vector3<f64>,
    /// What a motion is told along: the normal of the surface that the point belongs to.
    pub(super) normal: Vector3<f64>,
    /// That of the point's own surface; the same where the other one has no errors, or it is not known.
    pub(super) own: Vector3<f64>,
    /// How far off the surface, mm.
    pub(super) residual: f64,
    /// Variance that the cloud and the mesh tell of, mm².
    pub(super) told: f64,
    /// That and what residuals scatter by beyond it, mm², the chance that the point is of the surface, and what that times the residual changes by with it: as [`judge`](super::say::judge)
    /// finds them among all matches.
    pub(super) variance: f64,
    pub(super) chance: f64,
    pub(super) bent: f64,
    /// Cosine of the angle between the normals; 1 where the cloud's is not known.
    pub(super) facing: f64,
}

impl Match {
    /// The chance of being of the surface over the variance, mm⁻².
    pub(super) fn weight(&self) -> f64 {
        self.chance / self.variance
    }

    /// What the residual's pull on a pose, its weight times itself, changes by with it, mm⁻².
    pub(super) fn slope(&self) -> f64 {
        self.bent / self.variance
    }

    /// What the residual changes by with a small turn about the middle, in units of the radius, and a shift: the point moves by ω × arm + t.
    pub(super) fn row(&self, radius: f64) -> Vector6<f64> {
        self.row_along(&self.normal, radius)
    }

    /// The product of what it changes by along the one surface's normal and along the other's.
    pub(super) fn product(&self, radius: f64) -> Matrix6<f64> {
        let [own, other] = [&self.own, &self.normal].map(|normal| self.row_along(normal, radius));
        let product = own * other.transpose();
        (product + product.transpose()) * 0.5
    }

    fn row_along(&self, normal: &Vector3<f64>, radius: f64) -> Vector6<f64> {
        let turn = self.arm.cross(normal) / radius;
        Vector6::new(turn.x, turn.y, turn.z, normal.x, normal.y, normal.z)
    }
}

/// What points are laid onto.
#[derive(Clone, Copy)]
pub(super) enum Onto<'a, 'm> {
    /// A form without errors of measurement.
    Mesh(&'a NearestOnMesh<'m>),
    Sweep(&'a SweepSurface<'m>),
}

/// What points are laid onto, and how normals are to be compared with it.
#[derive(Clone, Copy)]
pub(super) struct Target<'a, 'm> {
    pub(super) onto: Onto<'a, 'm>,
    pub(super) middle: Vector3<f64>,
    pub(super) signed: bool,
}

impl<'a, 'm> Target<'a, 'm> {
    /// The faces of what points are laid onto.
    pub(super) fn faces(&self) -> &'a NearestOnMesh<'m> {
        match self.onto {
            Onto::Mesh(mesh) => mesh,
            Onto::Sweep(sweep) => &sweep.faces,
        }
    }

    pub(super) fn mesh(&self) -> &'a TriangleMesh {
        self.faces().mesh()
    }

    /// Returns what a point moved by a pose belongs to; `None` beyond the reach and where the nearest point lies on a border. `known` is of the same point, from
    /// before.
    pub(super) fn matched(
        &self,
        sample: &Sample,
        pose: &Pose,
        reach: f64,
        known: &mut Known,
    ) -> Option<Match> {
        let mut found = match self.onto {
            Onto::Mesh(mesh) => self.matched_on(mesh, sample, pose, reach),
            Onto::Sweep(sweep) => sweep.matched(sample, pose, reach, known),
        };
        if let Some(found) = found.as_mut().filter(|_| !self.signed) {
            found.facing = found.facing.abs();
        }
        found
    }

    /// Returns what those of some points belong to that have something within the reach, in their order; `known` is of the same points.
    pub(super) fn matches<'s>(
        &'s self,
        points: &'s [&Sample],
        pose: &Isometry3<f64>,
        reach: f64,
        known: &'s mut [Known],
    ) -> impl Iterator<Item = Match> + 's {
        let pose = Pose::of(pose, &self.middle);
        let all = points.iter().zip(known);
        all.filter_map(move |(point, known)| self.matched(point, &pose, reach, known))
    }

    fn matched_on(
        &self,
        mesh: &NearestOnMesh<'_>,
        sample: &Sample,
        pose: &Pose,
        reach: f64,
    ) -> Option<Match> {
        let moved = pose.place(&sample.place);
        let near = mesh.nearest_within(&moved.into(), reach).filter(|near| !near.on_border)?;
        let (normal, mesh_variance) = self.surface(&near);
        Some(Match {
            arm: moved - pose.middle,
            normal,
            own: normal,
            residual: normal.dot(&(moved - Vector3::from(near.point_mm))),
            told: sample.own.along(&pose.back(&normal)) + mesh_variance,
            variance: 0.0,
            chance: 0.0,
            bent: 0.0,
            facing: sample.normal.map_or(1.0, |own| pose.direction(&own).dot(&normal)),
        })
    }

    /// The mesh's normal at a point, smoothed over the vertices of its triangle where the mesh is a measured one, and its variance.
    fn surface(&self, near: &Nearest) -> (Vector3<f64>, f64) {
        let own = Vector3::from(near.normal);
        let mesh = self.mesh();
        let Some(sigmas) = mesh.sigmas_mm() else { return (own, 0.0) };
        let corners = mesh.triangles()[near.triangle];
        let variance = corners.iter().map(|&v| f64::from(sigmas[v as usize]).powi(2)).sum::<f64>() / 3.0;
        let smooth = mesh.normals().and_then(|normals| {
            let sum: Vector3<f64> =
                corners.iter().map(|&v| Vector3::from(normals[v as usize].map(f64::from))).sum();
            sum.try_normalize(0.0)
        });
        (smooth.unwrap_or(own), variance)
    }

    /// Returns what each point costs under a pose, as [`Target::cost`].
    pub(super) fn costs(
        &self,
        points: &[&Sample],
        pose: &Isometry3<f64>,
        floor: f64,
        known: &mut [Known],
    ) -> Vec<f64> {
        let pose = Pose::of(pose, &self.middle);
        points.iter().zip(known).map(|(point, known)| self.cost(point, &pose, floor, known)).collect()
    }

    /// Returns what a point costs under a pose: from 0 on the mesh to 1 off it, beyond its border, or where the normals
    /// disagree. `floor` is the scatter beyond what is told of the points, mm, the same for poses that are to be compared.
    pub(super) fn cost(&self, sample: &Sample, pose: &Pose, floor: f64, known: &mut Known) -> f64 {
        /// Normals of a point and of its place on the mesh differ by less than 45°.
        const ALIKE: f64 = 0.7;
        // The other surface's own part is not known yet: as much again.
        let reach = TUKEY * (2.0 * sample.own.most() + floor * floor).sqrt();
        match self.matched(sample, pose, reach, known) {
            Some(m) if m.facing > ALIKE => {
                let share = m.residual.powi(2) / (TUKEY * TUKEY * (m.told + floor * floor));
                1.0 - (1.0 - share.min(1.0)).powi(3)
            }
            _ => 1.0,
        }
    }
}
