//! Whether a mesh stands between two places.

use super::{NearestOnMesh, Node};
use nalgebra::Vector3;

impl NearestOnMesh<'_> {
    /// Returns whether a triangle meets the line from one place to another, from either side; ends count.
    pub(crate) fn stands_between(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        let way = to - from;
        let inverse = way.map(|w| 1.0 / w);
        let mut open = [0_u32; 64];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let at = open[depth];
            let node = &self.nodes[at as usize];
            if !meets_box(node, from, &way, &inverse) {
                continue;
            }
            if node.count == 0 {
                (open[depth], open[depth + 1]) = (node.at, at + 1);
                depth += 2;
                continue;
            }
            let own = &self.order[node.at as usize..(node.at + node.count) as usize];
            if own.iter().any(|&t| meets_triangle(from, &way, self.mesh.corners(t as usize))) {
                return true;
            }
        }
        false
    }
}

/// Whether a line's piece meets a node's box: the shares of it that lie between each pair of sides overlap.
fn meets_box(node: &Node, from: &Vector3<f64>, way: &Vector3<f64>, inverse: &Vector3<f64>) -> bool {
    let (mut first, mut last) = (0.0_f64, 1.0_f64);
    for k in 0..3 {
        let (low, high) = (node.low[k] - from[k], node.high[k] - from[k]);
        if way[k].abs() > 0.0 {
            let (a, b) = (low * inverse[k], high * inverse[k]);
            (first, last) = (first.max(a.min(b)), last.min(a.max(b)));
        } else if low > 0.0 || high < 0.0 {
            return false;
        }
    }
    // A flat box is met by rounding only.
    first <= last + 1e-12
}

/// Whether a line's piece meets a triangle (T. Möller, B. Trumbore, J. Graphics Tools 2 (1997) 21).
fn meets_triangle(from: &Vector3<f64>, way: &Vector3<f64>, [a, b, c]: [Vector3<f64>; 3]) -> bool {
    let (ab, ac, arm) = (b - a, c - a, from - a);
    let across = way.cross(&ac);
    let volume = ab.dot(&across);
    if volume.abs() <= 1e-14 * way.norm() * ab.norm() * ac.norm() {
        return false;
    }
    let u = arm.dot(&across) / volume;
    let turned = arm.cross(&ab);
    let v = way.dot(&turned) / volume;
    let share = ac.dot(&turned) / volume;
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && (0.0..=1.0).contains(&share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Frame;
    use crate::mesh::TriangleMesh;
    use crate::robust::Random;

    #[test]
    fn the_tree_meets_what_a_look_at_every_triangle_meets() {
        let mut random = Random::new(8);
        let mut number = || random.share() * 10.0;
        let vertices: Vec<[f64; 3]> = (0..300).map(|_| [number(), number(), number()]).collect();
        let triangles = (0..100).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let mesh = TriangleMesh::new(Frame::Camera, vertices, triangles).unwrap();
        let tree = NearestOnMesh::new(&mesh).unwrap();
        let mut met = 0;
        for _ in 0..600 {
            let (from, to) =
                (Vector3::new(number(), number(), number()), Vector3::new(number(), number(), number()));
            // Short ones, too.
            let to = from + (to - from) * (number() / 10.0);
            let any = (0..100).any(|t| meets_triangle(&from, &(to - from), mesh.corners(t)));
            assert_eq!(tree.stands_between(&from, &to), any);
            met += usize::from(any);
        }
        assert!((100..580).contains(&met), "{met} of 600 are met: the test tells something");
    }

    #[test]
    fn a_wall_stands_between_its_sides_only() {
        let corners = vec![[-5.0, -5.0, 2.0], [5.0, -5.0, 2.0], [5.0, 5.0, 2.0], [-5.0, 5.0, 2.0]];
        let wall = TriangleMesh::new(Frame::Camera, corners, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        let tree = NearestOnMesh::new(&wall).unwrap();
        let origin = Vector3::zeros();
        // Along an axis, in which the box is flat; beside it; short of it; and from behind.
        assert!(tree.stands_between(&origin, &Vector3::new(0.0, 0.0, 3.0)));
        assert!(!tree.stands_between(&origin, &Vector3::new(0.0, 0.0, 1.9)));
        assert!(!tree.stands_between(&origin, &Vector3::new(20.0, 0.0, 3.0)));
        assert!(tree.stands_between(&Vector3::new(1.0, -1.0, 4.0), &origin));
    }
}
