//! What a mesh leaves open: its outer borders, and the holes in it.

use crate::mesh::{Links, TriangleMesh};
use nalgebra::Vector3;

/// A closed chain of edges that have one triangle.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Boundary {
    /// The vertices along it, the triangles on the left as seen from where they face.
    pub vertices: Vec<u32>,
    /// Whether it goes round something open, rather than round a part of the mesh.
    pub is_hole: bool,
    /// Its length, mm.
    pub perimeter_mm: f64,
    /// The area that it encloses, flattened, mm²: |Σ pᵢ × pᵢ₊₁| / 2.
    pub area_mm2: f64,
    /// The middle of its vertices, mm.
    pub center_mm: [f64; 3],
}

impl TriangleMesh {
    /// Returns the outer borders and the holes, in the order of the triangles that they begin at.
    ///
    /// A hole goes round clockwise as seen from where the triangles along it face.
    pub fn boundaries(&self) -> Vec<Boundary> {
        let links = Links::new(self.triangles(), self.vertices_mm().len());
        links.loops().iter().map(|halves| self.boundary(halves)).collect()
    }

    fn boundary(&self, halves: &[u32]) -> Boundary {
        let vertices: Vec<u32> =
            halves.iter().map(|&h| self.triangles()[h as usize / 3][h as usize % 3]).collect();
        let at = |v: &u32| Vector3::from(self.vertices_mm()[*v as usize]);
        let center = vertices.iter().map(at).sum::<Vector3<f64>>() / vertices.len().max(1) as f64;
        let (mut perimeter_mm, mut twice) = (0.0, Vector3::zeros());
        for (a, b) in vertices.iter().zip(vertices.iter().cycle().skip(1)) {
            let (a, b) = (at(a) - center, at(b) - center);
            perimeter_mm += (b - a).norm();
            twice += a.cross(&b);
        }
        let faces: Vector3<f64> =
            halves.iter().filter_map(|&h| self.area_vector(h as usize / 3).try_normalize(0.0)).sum();
        Boundary {
            vertices,
            is_hole: twice.dot(&faces) < 0.0,
            perimeter_mm,
            area_mm2: 0.5 * twice.norm(),
            center_mm: center.into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Frame;

    /// Rounding of sums of a few numbers near ten.
    const ROUNDING: f64 = 1e-9;

    #[test]
    fn a_frame_has_an_outer_border_and_a_hole() {
        // A grid of 5 × 5 unit cells without its middle one, seen from below (towards −z).
        let vertices = (0..36).map(|i| [f64::from(i % 6), f64::from(i / 6), 700.0]).collect();
        let cells = (0..25).filter(|c| *c != 12).map(|c: u32| c / 5 * 6 + c % 5);
        let triangles = cells.flat_map(|v| [[v, v + 6, v + 1], [v + 1, v + 6, v + 7]]).collect();
        let mesh = TriangleMesh::new(Frame::Camera, vertices, triangles).unwrap();
        let mut all = mesh.boundaries();
        assert_eq!(all.len(), mesh.topology().boundary_loops);
        all.sort_by(|a, b| a.perimeter_mm.total_cmp(&b.perimeter_mm));
        let [hole, border] = &all[..] else { panic!("{all:?}") };
        assert!(hole.is_hole && !border.is_hole);
        for (loop_, perimeter, area) in [(hole, 4.0, 1.0), (border, 20.0, 25.0)] {
            assert!((loop_.perimeter_mm - perimeter).abs() < ROUNDING, "{loop_:?}");
            assert!((loop_.area_mm2 - area).abs() < ROUNDING, "{loop_:?}");
            assert_eq!(loop_.vertices.len(), perimeter as usize, "edges of one millimetre");
            let center = Vector3::from(loop_.center_mm) - Vector3::new(2.5, 2.5, 700.0);
            assert!(center.norm() < ROUNDING, "{loop_:?}");
        }
    }
}
