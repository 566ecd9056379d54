//! The points that a pose is estimated from, and what each lies off the mesh.

use crate::cloud::{PointCloud, unpacked};
use crate::error::RegisterError;
use crate::nearest::{Nearest, NearestOnMesh};
use crate::neighbours::Neighbours;
use crate::normals::{NORMAL_NEIGHBOURS, local_plane};
use crate::robust::ranked;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

/// Tukey's constant: 95 % of a mean's efficiency with Gaussian noise, nothing from beyond it.
pub(super) const TUKEY: f64 = 4.685;
/// Points that a pose is estimated from; more don't make it better than what the instrument shares between them.
const MOST_POINTS: usize = 20_000;
/// Share of the points that the cloud's size is taken from: a few far astray don't make it large.
const SIZED_BY: f64 = 0.95;

/// What is known of a point's own error.
enum Own {
    Covariance(Matrix3<f64>),
    Variance(f64),
}

/// One point of the cloud.
pub(super) struct Sample {
    pub(super) place: Vector3<f64>,
    /// Normal of the surface about it; towards the sensor where [`Samples::signed`].
    pub(super) normal: Option<Vector3<f64>>,
    own: Own,
}

/// Points of a cloud, their middle and size.
pub(super) struct Samples {
    pub(super) points: Vec<Sample>,
    pub(super) middle: Vector3<f64>,
    /// Root mean square distance from the middle, mm.
    pub(super) radius: f64,
    /// Whether the normals' sides are known.
    pub(super) signed: bool,
}

impl Samples {
    /// Takes points evenly from a cloud.
    pub(super) fn new(cloud: &PointCloud) -> Result<Self, RegisterError> {
        cloud.check_finite()?;
        if cloud.len() < 6 {
            return Err(RegisterError::TooFewPoints { got: cloud.len() });
        }
        let step = cloud.len().div_ceil(MOST_POINTS);
        let positions = cloud.positions_mm();
        let neighbours = Neighbours::new(positions)?;
        let sample = |i: usize| Sample {
            place: cloud.vector(i),
            normal: local_plane(positions, &neighbours, &positions[i], NORMAL_NEIGHBOURS, &[0.0; 3])
                .map(|plane| plane.normal),
            own: match (cloud.covariances_mm2(), cloud.sigmas_mm()) {
                (Some(all), _) => Own::Covariance(unpacked(&all[i])),
                (None, Some(sigmas)) => Own::Variance(f64::from(sigmas[i]).powi(2)),
                (None, None) => Own::Variance(0.0),
            },
        };
        let points: Vec<Sample> = (0..cloud.len()).step_by(step).map(sample).collect();
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
        // Only of what one sweep saw is it known which side the sensor was on.
        Ok(Self { points, middle, radius, signed: cloud.pixels().is_some() })
    }

    /// Returns up to so many of the points, evenly taken.
    pub(super) fn few(&self, most: usize) -> Vec<&Sample> {
        self.points.iter().step_by(self.points.len().div_ceil(most)).collect()
    }
}

/// A point and the place of the mesh that it belongs to.
pub(super) struct Match {
    /// From the cloud's middle to the point, both moved.
    pub(super) arm: Vector3<f64>,
    pub(super) normal: Vector3<f64>,
    /// Along the normal, mm.
    pub(super) residual: f64,
    /// Variance that the cloud and the mesh tell of, mm².
    pub(super) told: f64,
    /// Cosine of the angle between the normals; 1 where the cloud's is not known.
    pub(super) facing: f64,
}

/// The mesh, and how normals are to be compared with it.
pub(super) struct Target<'a, 'm> {
    pub(super) mesh: &'a NearestOnMesh<'m>,
    pub(super) middle: Vector3<f64>,
    pub(super) signed: bool,
}

impl Target<'_, '_> {
    /// Returns what a point moved by a pose belongs to; `None` beyond the reach and where the nearest point lies on a border.
    pub(super) fn matched(&self, sample: &Sample, pose: &Isometry3<f64>, reach: f64) -> Option<Match> {
        let moved = (pose * Point3::from(sample.place)).coords;
        let near = self.mesh.nearest_within(&moved.into(), reach).filter(|near| !near.on_border)?;
        let (normal, mesh_variance) = self.surface(&near);
        let own = match &sample.own {
            Own::Covariance(all) => {
                let back = pose.rotation.inverse_transform_vector(&normal);
                back.dot(&(all * back)).max(0.0)
            }
            Own::Variance(own) => *own,
        };
        let facing = sample.normal.map_or(1.0, |n| (pose.rotation * n).dot(&normal));
        Some(Match {
            arm: moved - (pose * Point3::from(self.middle)).coords,
            normal,
            residual: normal.dot(&(moved - Vector3::from(near.point_mm))),
            told: own + mesh_variance,
            facing: if self.signed { facing } else { facing.abs() },
        })
    }

    /// The mesh's normal at a point, smoothed over the vertices of its triangle where the mesh is a measured one, and its variance.
    fn surface(&self, near: &Nearest) -> (Vector3<f64>, f64) {
        let own = Vector3::from(near.normal);
        let mesh = self.mesh.mesh();
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

    /// Returns what each point costs under a pose: from 0 on the mesh to 1 off it, beyond its border, or where the normals
    /// disagree. `floor` is the scatter beyond what is told of the points, mm, the same for poses that are to be compared.
    pub(super) fn costs<'s>(
        &self,
        points: impl IntoIterator<Item = &'s Sample>,
        pose: &Isometry3<f64>,
        floor: f64,
    ) -> Vec<f64> {
        /// Normals of a point and of its place on the mesh differ by less than 45°.
        const ALIKE: f64 = 0.7;
        let cost = |sample: &Sample| {
            let most = match &sample.own {
                Own::Covariance(all) => all.trace().max(0.0),
                Own::Variance(own) => *own,
            };
            // The mesh's own part is not known yet: as much again.
            let reach = TUKEY * (2.0 * most + floor * floor).sqrt();
            match self.matched(sample, pose, reach) {
                Some(m) if m.facing > ALIKE => {
                    let share = m.residual.powi(2) / (TUKEY * TUKEY * (m.told + floor * floor));
                    1.0 - (1.0 - share.min(1.0)).powi(3)
                }
                _ => 1.0,
            }
        };
        points.into_iter().map(cost).collect()
    }
}
