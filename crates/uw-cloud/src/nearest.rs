//! The point of a mesh that is nearest to a place: a tree of boxes over the triangles, and exact distances to them.

mod hit;

use crate::mesh::{Links, NONE, TriangleMesh, corner_angles};
use nalgebra::Vector3;
use std::sync::OnceLock;

/// Triangles in a leaf of the tree.
const LEAF: usize = 4;

/// A mesh that is asked for its nearest points.
pub struct NearestOnMesh<'a> {
    mesh: &'a TriangleMesh,
    /// Triangles in the order of the leaves.
    order: Vec<u32>,
    nodes: Vec<Node>,
    /// Made when a side is asked for first: a sweep's points are laid onto other points, and only its faces' places are.
    sides: OnceLock<Sides>,
}

/// Pseudonormals of the edges, three a triangle, and of the vertices; and what is open: edges of one triangle, of three or more, or of two that disagree, and
/// vertices on such an edge.
struct Sides {
    edges: Vec<Vector3<f64>>,
    vertices: Vec<Vector3<f64>>,
    links: Links,
    open_vertices: Vec<bool>,
}

struct Node {
    low: Vector3<f64>,
    high: Vector3<f64>,
    /// The first triangle of a leaf, or the second child; the first child follows its parent.
    at: u32,
    /// Triangles of a leaf, 0 for a branch.
    count: u32,
}

/// The nearest point of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Nearest {
    /// The point, mm.
    pub point_mm: [f64; 3],
    /// Distance to it, mm: positive outside, on the side that the triangles face.
    pub signed_mm: f64,
    /// Normal of the surface there: the triangle's, or on an edge or a vertex the pseudonormal.
    pub normal: [f64; 3],
    /// Which triangle, from 0.
    pub triangle: usize,
    /// Whether it lies on a border of the mesh: then what was measured may lie beyond the mesh, not off it.
    pub on_border: bool,
}

/// Where on a triangle a point lies.
#[derive(Clone, Copy)]
enum Part {
    Face,
    Edge(usize),
    Corner(usize),
}

impl<'a> NearestOnMesh<'a> {
    /// Returns the tree over a mesh's triangles; `None` where none of them has an area.
    ///
    /// Signs are those of angle-weighted pseudonormals (J. Bærentzen, H. Aanæs, IEEE TVCG 11 (2005) 243), which are right
    /// on edges and vertices, too.
    pub fn new(mesh: &'a TriangleMesh) -> Option<Self> {
        let low = Vector3::from(mesh.bounding_box_mm()?.0);
        let mut middles: Vec<Middle> =
            with_area(mesh, 0..mesh.triangles().len() as u32).map(|t| Middle::of(mesh, t, &low)).collect();
        halve(&mut middles);
        Self::of_order(mesh, middles.iter().map(|middle| middle.triangle).collect())
    }

    /// Returns the tree over a mesh's triangles, given in an order in which what is near is near in space; `None` where none of them has an area.
    pub(crate) fn in_order(mesh: &'a TriangleMesh, order: impl Iterator<Item = u32>) -> Option<Self> {
        Self::of_order(mesh, with_area(mesh, order).collect())
    }

    fn of_order(mesh: &'a TriangleMesh, order: Vec<u32>) -> Option<Self> {
        if order.is_empty() {
            return None;
        }
        let mut nodes = Vec::with_capacity(2 * order.len() / LEAF + 1);
        boxes(mesh, &order, 0, &mut nodes);
        Some(Self { mesh, order, nodes, sides: OnceLock::new() })
    }

    /// Returns the mesh.
    pub fn mesh(&self) -> &TriangleMesh {
        self.mesh
    }

    /// Returns the point of the mesh nearest to a place, mm; in time that grows with the logarithm of the triangles.
    pub fn nearest(&self, place_mm: &[f64; 3]) -> Nearest {
        let place = Vector3::from(*place_mm);
        self.told(&place, self.search(&place, f64::INFINITY))
    }

    /// Returns the point of the mesh nearest to a place, mm; `None` where it is no nearer than `reach_mm`, which is told sooner.
    pub fn nearest_within(&self, place_mm: &[f64; 3], reach_mm: f64) -> Option<Nearest> {
        let place = Vector3::from(*place_mm);
        let square = reach_mm * reach_mm;
        let found = self.search(&place, square);
        (found.0 < square).then(|| self.told(&place, found))
    }

    /// The nearest point that is nearer than the root of `square`, if any: its squared distance, place, part and triangle.
    fn search(&self, place: &Vector3<f64>, square: f64) -> (f64, Vector3<f64>, Part, u32) {
        let mut best = (square, Vector3::zeros(), Part::Face, self.order[0]);
        // A balanced tree of 2^32 triangles is 32 deep.
        let mut open = [(0_u32, 0.0_f64); 64];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (at, least) = open[depth];
            if least >= best.0 {
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.count > 0 {
                for &t in &self.order[node.at as usize..(node.at + node.count) as usize] {
                    let (point, part) = on_triangle(place, self.mesh.corners(t as usize));
                    let square = (place - point).norm_squared();
                    if square < best.0 {
                        best = (square, point, part, t);
                    }
                }
                continue;
            }
            let children = [at + 1, node.at].map(|child| (child, self.nodes[child as usize].reach(place)));
            // The nearer one is looked at first, so it goes on top.
            let [near, far] =
                if children[0].1 <= children[1].1 { children } else { [children[1], children[0]] };
            open[depth] = far;
            open[depth + 1] = near;
            depth += 2;
        }
        best
    }

    fn sides(&self) -> &Sides {
        self.sides.get_or_init(|| Sides::of(self.mesh))
    }

    /// What is to be said of a point that was found.
    fn told(
        &self,
        place: &Vector3<f64>,
        (square, point, part, t): (f64, Vector3<f64>, Part, u32),
    ) -> Nearest {
        let t = t as usize;
        let face = face(self.mesh, t);
        let corner = |k: usize| self.mesh.triangles()[t][k] as usize;
        let (normal, on_border) = match part {
            Part::Face => (face, false),
            Part::Edge(k) => {
                let sides = self.sides();
                (sides.edges[3 * t + k], sides.links.twins[3 * t + k] == NONE)
            }
            Part::Corner(k) => {
                let sides = self.sides();
                (sides.vertices[corner(k)], sides.open_vertices[corner(k)])
            }
        };
        let normal = normal.try_normalize(0.0).unwrap_or(face);
        let distance = square.sqrt();
        let signed_mm = if normal.dot(&(place - point)) < 0.0 { -distance } else { distance };
        Nearest { point_mm: point.into(), signed_mm, normal: normal.into(), triangle: t, on_border }
    }
}

impl Sides {
    fn of(mesh: &TriangleMesh) -> Self {
        let triangles = mesh.triangles();
        let links = Links::new(triangles, mesh.vertices_mm().len());
        let faces: Vec<_> = (0..triangles.len()).map(|t| face(mesh, t)).collect();
        let mut vertices = vec![Vector3::zeros(); mesh.vertices_mm().len()];
        let mut open_vertices = vec![false; vertices.len()];
        let mut edges = vec![Vector3::zeros(); 3 * faces.len()];
        for (t, corners) in triangles.iter().enumerate() {
            let angles = corner_angles(mesh.corners(t));
            for k in 0..3 {
                let angle = if angles[k].is_finite() { angles[k] } else { 0.0 };
                vertices[corners[k] as usize] += faces[t] * angle;
                edges[3 * t + k] = faces[t];
                let twin = links.twins[3 * t + k];
                if twin == NONE {
                    open_vertices[corners[k] as usize] = true;
                    open_vertices[corners[(k + 1) % 3] as usize] = true;
                } else {
                    edges[3 * t + k] += faces[twin as usize / 3];
                }
            }
        }
        Self { edges, vertices, links, open_vertices }
    }
}

/// Returns a triangle's unit normal; of no length for one without an area.
fn face(mesh: &TriangleMesh, triangle: usize) -> Vector3<f64> {
    mesh.area_vector(triangle).try_normalize(0.0).unwrap_or_default()
}

/// Returns those of some triangles that have an area.
fn with_area(mesh: &TriangleMesh, triangles: impl Iterator<Item = u32>) -> impl Iterator<Item = u32> {
    triangles.filter(|&t| mesh.area_vector(t as usize).norm_squared() > 0.0)
}

impl Node {
    /// Squared distance of a place to the box.
    fn reach(&self, place: &Vector3<f64>) -> f64 {
        (self.low - place).sup(&(place - self.high)).sup(&Vector3::zeros()).norm_squared()
    }
}

/// What a triangle is sorted by: its middle, thrice, from a corner of the mesh's box. Where a tree is halved needs no more digits.
#[derive(Clone, Copy)]
struct Middle {
    at: [f32; 3],
    triangle: u32,
}

impl Middle {
    fn of(mesh: &TriangleMesh, triangle: u32, low: &Vector3<f64>) -> Self {
        let [a, b, c] = mesh.corners(triangle as usize).map(|corner| corner - low);
        let sum = a + b + c;
        Self { at: [sum.x as f32, sum.y as f32, sum.z as f32], triangle }
    }
}

/// Puts triangles in the order of a tree's leaves: halved along the longest side of the box about their middles.
fn halve(order: &mut [Middle]) {
    if order.len() <= LEAF {
        return;
    }
    let axis = longest_side(order);
    let half = order.len() / 2;
    order.select_nth_unstable_by(half, |a, b| {
        a.at[axis].total_cmp(&b.at[axis]).then(a.triangle.cmp(&b.triangle))
    });
    let (lower, upper) = order.split_at_mut(half);
    halve(lower);
    halve(upper);
}

/// Appends the tree over triangles in the order of its leaves, and returns the box about them.
fn boxes(
    mesh: &TriangleMesh,
    order: &[u32],
    first: u32,
    nodes: &mut Vec<Node>,
) -> (Vector3<f64>, Vector3<f64>) {
    let at = nodes.len();
    if order.len() <= LEAF {
        let corners = || order.iter().flat_map(|&triangle| mesh.corners(triangle as usize));
        let low = corners().fold(Vector3::repeat(f64::INFINITY), |low, corner| low.inf(&corner));
        let high = corners().fold(Vector3::repeat(f64::NEG_INFINITY), |high, corner| high.sup(&corner));
        nodes.push(Node { low, high, at: first, count: order.len() as u32 });
        return (low, high);
    }
    nodes.push(Node { low: Vector3::zeros(), high: Vector3::zeros(), at: 0, count: 0 });
    let half = order.len() / 2;
    let (lower, upper) = order.split_at(half);
    let own = boxes(mesh, lower, first, nodes);
    let second = nodes.len() as u32;
    let other = boxes(mesh, upper, first + half as u32, nodes);
    let (low, high) = (own.0.inf(&other.0), own.1.sup(&other.1));
    nodes[at] = Node { low, high, at: second, count: 0 };
    (low, high)
}

/// Returns the axis along which middles spread most.
fn longest_side(middles: &[Middle]) -> usize {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for middle in middles {
        for k in 0..3 {
            low[k] = if middle.at[k] < low[k] { middle.at[k] } else { low[k] };
            high[k] = if middle.at[k] > high[k] { middle.at[k] } else { high[k] };
        }
    }
    let side = |k: usize| high[k] - low[k];
    (1..3).fold(0, |longest, k| if side(k) > side(longest) { k } else { longest })
}

/// The point of a triangle nearest to a place (C. Ericson, Real-Time Collision Detection, 2005, section 5.1.5).
fn on_triangle(p: &Vector3<f64>, [a, b, c]: [Vector3<f64>; 3]) -> (Vector3<f64>, Part) {
    let (ab, ac) = (b - a, c - a);
    let ap = p - a;
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (a, Part::Corner(0));
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (b, Part::Corner(1));
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (a + ab * (d1 / (d1 - d3)), Part::Edge(0));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (c, Part::Corner(2));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (a + ac * (d2 / (d2 - d6)), Part::Edge(2));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let share = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return (b + (c - b) * share, Part::Edge(1));
    }
    let whole = va + vb + vc;
    (a + ab * (vb / whole) + ac * (vc / whole), Part::Face)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Frame;
    use crate::robust::Random;

    /// Rounding of distances of a few units.
    const ROUNDING_MM: f64 = 1e-12;

    /// A unit cube, its triangles seen from outside.
    fn cube() -> TriangleMesh {
        let corners = (0..8_u8).map(|i| [i & 1, i >> 1 & 1, i >> 2 & 1].map(f64::from)).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        TriangleMesh::new(Frame::Camera, corners, triangles).unwrap()
    }

    #[test]
    fn distances_to_a_cube_are_those_of_its_formula() {
        let cube = cube();
        let tree = NearestOnMesh::new(&cube).unwrap();
        let mut random = Random::new(3);
        for _ in 0..5000 {
            let place: [f64; 3] = std::array::from_fn(|_| random.below(3001) as f64 / 1000.0 - 1.0);
            let beyond = place.map(|c| (c - 0.5).abs() - 0.5);
            let outside = beyond.map(|b| b.max(0.0)).iter().map(|b| b * b).sum::<f64>().sqrt();
            let inside = beyond.iter().fold(f64::MIN, |a, b| a.max(*b)).min(0.0);
            let found = tree.nearest(&place);
            assert!((found.signed_mm - (outside + inside)).abs() < ROUNDING_MM, "{place:?}: {found:?}");
            let apart = Vector3::from(found.point_mm) - Vector3::from(place);
            assert!((apart.norm() - found.signed_mm.abs()).abs() < ROUNDING_MM);
            assert!(!found.on_border);
        }
    }

    #[test]
    fn the_tree_finds_what_looking_at_every_triangle_finds() {
        let mut random = Random::new(5);
        let mut number = || random.below(10_000) as f64 / 1000.0;
        let vertices = (0..900).map(|_| [number(), number(), number()]).collect();
        let mesh = TriangleMesh::new(
            Frame::Camera,
            vertices,
            (0..300).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
        );
        let mesh = mesh.unwrap();
        let tree = NearestOnMesh::new(&mesh).unwrap();
        for _ in 0..300 {
            let place = [number(), number(), number()];
            let p = Vector3::from(place);
            let least =
                (0..300).map(|t| (p - on_triangle(&p, mesh.corners(t)).0).norm()).fold(f64::MAX, f64::min);
            assert!((tree.nearest(&place).signed_mm.abs() - least).abs() < ROUNDING_MM);
        }
    }

    #[test]
    fn beyond_a_border_is_told_and_a_mesh_without_area_is_none() {
        let corners = vec![[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [4.0, 4.0, 0.0]];
        let square = TriangleMesh::new(Frame::Camera, corners.clone(), vec![[0, 1, 2], [1, 3, 2]]).unwrap();
        let tree = NearestOnMesh::new(&square).unwrap();
        assert!(tree.nearest(&[5.0, 2.0, 1.0]).on_border && tree.nearest(&[-1.0, -1.0, 0.0]).on_border);
        assert!(!tree.nearest(&[2.0, 2.0, -1.0]).on_border, "the diagonal is no border");
        let flat = TriangleMesh::new(Frame::Camera, corners, vec![[0, 1, 1]]).unwrap();
        assert!(NearestOnMesh::new(&flat).is_none());
    }
}
