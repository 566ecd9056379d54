//! A cloud against a reference: brought onto it, then how far each point lies off, and what to know before trusting it.

use crate::cloud::PointCloud;
use crate::compare::{Comparison, compare};
use crate::error::ReferenceError;
use crate::mesh::{Topology, TriangleMesh};
use crate::nearest::NearestOnMesh;
use crate::register::{Registration, Start, register};

/// How a cloud is compared with a reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceOptions {
    /// Where the cloud is brought onto the reference from; `None` compares it where it is.
    pub align: Option<Start>,
    /// Share of the points that have to lie on the reference for the alignment to be believed.
    pub least_overlap: f64,
}

impl Default for ReferenceOptions {
    fn default() -> Self {
        Self { align: Some(Start::Anywhere), least_overlap: 0.2 }
    }
}

/// A cloud's deviations from a reference.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AgainstReference {
    /// The alignment; `None` where the cloud was compared where it is.
    pub registration: Option<Registration>,
    /// The deviations, one a point, and what they come to.
    pub comparison: Comparison,
    /// What the reference's edges tell of it.
    pub topology: Topology,
    /// What to know before trusting the figures, in whole sentences.
    pub warnings: Vec<String>,
}

/// Returns how far a cloud lies off a reference, after best-fit alignment unless `options` say otherwise.
///
/// Distances are those to the nearest point of the reference's triangles, with the sign of the side that they face. Points whose nearest
/// point lies on a border of an open reference are counted as beyond it, and have no deviation. The alignment takes every form error
/// with it that a rigid motion can: what is left is the best fit's, not a datum's.
///
/// # Errors
/// [`ReferenceError`] for a reference without area, a cloud that does not come to lie on it, and where no point lies beside it.
pub fn compare_with_reference(
    cloud: &PointCloud,
    reference: &TriangleMesh,
    options: &ReferenceOptions,
) -> Result<AgainstReference, ReferenceError> {
    let tree = NearestOnMesh::new(reference).ok_or(ReferenceError::NoArea)?;
    cloud.check_finite()?;
    let size = sizes(cloud, reference);
    let registration = match options.align {
        None => None,
        Some(start) => {
            let found = register(cloud, &tree, start, options.least_overlap);
            Some(found.map_err(|cause| ReferenceError::NotAligned { cause, hint: size.hint() })?)
        }
    };
    let moved = registration.as_ref().map(|r| cloud.clone().transformed(cloud.frame(), &r.mesh_from_cloud));
    let moved = moved.as_ref().unwrap_or(cloud);
    let sigmas = normal_sigmas(moved, &tree);
    let comparison = compare(moved.positions_mm(), sigmas.as_deref(), &tree)
        .ok_or(ReferenceError::NothingBeside { points: cloud.len() })?;
    let topology = reference.topology();
    let mut warnings = doubts(reference, &topology);
    if size.suspicious() {
        warnings.push(size.hint());
    }
    if let Some(found) = &registration {
        warnings.extend(pose_doubts(found));
    }
    Ok(AgainstReference { registration, comparison, topology, warnings })
}

/// Sigmas along the reference's normal where the cloud has covariances; else its sigmas along the least certain direction.
fn normal_sigmas(cloud: &PointCloud, tree: &NearestOnMesh<'_>) -> Option<Vec<f32>> {
    let Some(covariances) = cloud.covariances_mm2() else { return cloud.sigmas_mm().map(<[f32]>::to_vec) };
    let sigma = |(place, covariance): (&[f64; 3], &[f32; 6])| {
        let normal = nalgebra::Vector3::from(tree.nearest(place).normal);
        normal.dot(&(crate::cloud::unpacked(covariance) * normal)).max(0.0).sqrt() as f32
    };
    Some(cloud.positions_mm().iter().zip(covariances).map(sigma).collect())
}

fn doubts(reference: &TriangleMesh, topology: &Topology) -> Vec<String> {
    let mut said = Vec::new();
    if topology.flipped_edges > 0 {
        said.push(format!(
            "at {} edges the reference's triangles disagree about which side is out: signs there are not to be trusted",
            topology.flipped_edges
        ));
    }
    if topology.boundary_edges > 0 {
        said.push(format!(
            "the reference is open ({} loops of {} edges): signs are those of the side that its triangles face, and points beyond a border \
             are left out",
            topology.boundary_loops, topology.boundary_edges
        ));
    } else if topology.is_closed() && reference.volume_mm3() < 0.0 {
        said.push("the reference's triangles face inwards: signs are the other way round".to_owned());
    }
    said
}

fn pose_doubts(found: &Registration) -> Vec<String> {
    let mut said = Vec::new();
    if found.reversed {
        said.push(
            "the reference's triangles face away from where the cloud was seen from: signs are the other way round".to_owned(),
        );
    }
    if !found.undetermined.is_empty() {
        let motions: Vec<String> = found.undetermined.iter().map(ToString::to_string).collect();
        said.push(format!("the points do not determine {}: nothing along it is told", motions.join(", ")));
    }
    if !found.rivals.is_empty() {
        said.push(format!(
            "{} other poses fit as well: the form looks the same in several ways round, and which one this is cannot be told",
            found.rivals.len()
        ));
    }
    said
}

/// Sizes of cloud and reference, the diagonals of their boxes, mm.
struct Sizes {
    cloud: f64,
    reference: f64,
}

fn sizes(cloud: &PointCloud, reference: &TriangleMesh) -> Sizes {
    let diagonal = |corners: Option<([f64; 3], [f64; 3])>| {
        let (low, high) = corners.unwrap_or_default();
        std::iter::zip(low, high).map(|(l, h)| (h - l) * (h - l)).sum::<f64>().sqrt()
    };
    Sizes { cloud: diagonal(cloud.bounding_box_mm()), reference: diagonal(reference.bounding_box_mm()) }
}

impl Sizes {
    /// Whether one is so much larger than the other that a unit may be the cause: a scan is rarely ten times what it is of.
    fn suspicious(&self) -> bool {
        self.cloud > 10.0 * self.reference || self.reference > 300.0 * self.cloud
    }

    fn hint(&self) -> String {
        let sizes =
            format!("the cloud is {:.4} mm across, the reference {:.4} mm", self.cloud, self.reference);
        let ratio = self.cloud / self.reference.max(f64::MIN_POSITIVE);
        let unit = match ratio {
            100.0.. => "the reference may be in metres",
            10.0..100.0 => "the reference may be in inches or centimetres",
            0.0..0.003 => "the reference may be in micrometres, or the cloud in metres",
            _ => return sizes,
        };
        format!("{sizes}: {unit}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Frame;

    /// A cube from 0 to `side` mm, seen from outside.
    fn cube(side: f64) -> TriangleMesh {
        let corners = (0..8_u8).map(|i| [i & 1, i >> 1 & 1, i >> 2 & 1].map(|b| side * f64::from(b)));
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        TriangleMesh::new(Frame::Camera, corners.collect(), triangles).unwrap()
    }

    /// A grid on three faces of a cube of 40 mm.
    fn corner() -> PointCloud {
        let grid =
            (0..20).flat_map(|i| (0..20).map(move |j| (2.0 * f64::from(i) + 1.0, 2.0 * f64::from(j) + 1.0)));
        let points = grid.flat_map(|(a, b)| [[a, b, 0.0], [0.0, a, b], [a, 0.0, b]]).collect();
        PointCloud::new(Frame::Camera, points)
    }

    #[test]
    fn a_cube_is_aligned_and_its_many_ways_round_are_told() {
        let found = compare_with_reference(&corner(), &cube(40.0), &ReferenceOptions::default()).unwrap();
        assert!(found.comparison.rms_mm < 1e-3, "{:?}", found.comparison.rms_mm);
        assert!(found.warnings.iter().any(|w| w.contains("other poses")), "{:?}", found.warnings);
        assert!(found.topology.is_closed());
    }

    #[test]
    fn where_it_is_compared_where_it_is_nothing_moves() {
        let options = ReferenceOptions { align: None, ..Default::default() };
        let shifted: Vec<[f64; 3]> =
            corner().positions_mm().iter().map(|p| [p[0], p[1], p[2] - 0.5]).collect();
        let cloud = PointCloud::new(Frame::Camera, shifted);
        let found = compare_with_reference(&cloud, &cube(40.0), &options).unwrap();
        assert!(found.registration.is_none());
        assert!((found.comparison.extremes_mm[1] - 0.5).abs() < 1e-9, "{:?}", found.comparison.extremes_mm);
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
    }

    #[test]
    fn a_reference_in_metres_is_suspected() {
        let options = ReferenceOptions { align: None, ..Default::default() };
        let found = compare_with_reference(&corner(), &cube(0.04), &options).unwrap();
        assert!(found.warnings.iter().any(|w| w.contains("in metres")), "{:?}", found.warnings);
        let refused = compare_with_reference(&corner(), &cube(0.04), &ReferenceOptions::default());
        assert!(refused.unwrap_err().to_string().contains("in metres"));
    }
}
