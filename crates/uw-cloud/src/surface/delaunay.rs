//! Delaunay's triangulation of places in a plane, by `spade` and its exact predicates.

use crate::mesh::NONE;
use spade::{DelaunayTriangulation, HasPosition, Point2, Triangulation};

/// A place and the point that it is of.
#[derive(Debug, Clone, Copy)]
struct Site {
    at: Point2<f64>,
    point: u32,
}

impl HasPosition for Site {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.at
    }
}

/// Triangles of a plane, counter-clockwise, and what lies behind each of their sides.
pub(super) struct Flat {
    /// Corners, as positions in the places.
    pub(super) triangles: Vec<[u32; 3]>,
    /// The triangle on the other side of the edge from corner k to the next, [`NONE`] at the hull.
    pub(super) across: Vec<[u32; 3]>,
    /// Places that another one had taken.
    pub(super) shared: usize,
}

/// Returns Delaunay's triangulation, of no triangles where all places lie on one line.
pub(super) fn triangulate(places: &[[f64; 2]]) -> Flat {
    // About their middle and in units of their extent: what is then tiny is rounding, which the predicates needn't resolve.
    let count = places.len().max(1) as f64;
    let middle: [f64; 2] = std::array::from_fn(|k| places.iter().map(|p| p[k]).sum::<f64>() / count);
    let extent = places
        .iter()
        .flat_map(|p| [p[0] - middle[0], p[1] - middle[1]])
        .fold(0.0_f64, |most, offset| most.max(offset.abs()));
    let clean = |offset: f64| if offset.abs() <= 1e-15 * extent { 0.0 } else { offset };
    let sites = places
        .iter()
        .zip(0..)
        .map(|(p, point)| Site { at: Point2::new(clean(p[0] - middle[0]), clean(p[1] - middle[1])), point })
        .collect();
    // Only a coordinate that is no number, or beyond 2^201, is refused; neither comes this far.
    let Ok(plane) = DelaunayTriangulation::<Site>::bulk_load(sites) else {
        return Flat { triangles: Vec::new(), across: Vec::new(), shared: 0 };
    };
    let shared = places.len() - plane.num_vertices();
    let mut flat = Flat { triangles: Vec::new(), across: Vec::new(), shared };
    flat.triangles.reserve_exact(plane.num_inner_faces());
    flat.across.reserve_exact(plane.num_inner_faces());
    for face in plane.inner_faces() {
        // The outer face has the index 0, the inner ones follow.
        debug_assert_eq!(face.index(), flat.triangles.len() + 1);
        let edges = face.adjacent_edges();
        flat.triangles.push(edges.map(|edge| edge.from().data().point));
        flat.across.push(edges.map(|edge| match edge.rev().face().index() {
            0 => NONE,
            inner => inner as u32 - 1,
        }));
    }
    in_order(&flat, places.len())
}

/// Returns the triangles in the order of their least corners: points come in the order of the scan, and triangles that are asked for together then lie
/// together in memory.
fn in_order(flat: &Flat, places: usize) -> Flat {
    let least = |corners: &[u32; 3]| corners.iter().copied().fold(u32::MAX, u32::min) as usize;
    let mut starts = vec![0_u32; places + 1];
    flat.triangles.iter().for_each(|corners| starts[least(corners) + 1] += 1);
    (0..places).for_each(|v| starts[v + 1] += starts[v]);
    let number = |corners: &[u32; 3]| {
        let next = &mut starts[least(corners)];
        *next += 1;
        *next - 1
    };
    let numbers: Vec<u32> = flat.triangles.iter().map(number).collect();
    let mut sorted = Flat {
        triangles: vec![[0; 3]; numbers.len()],
        across: vec![[NONE; 3]; numbers.len()],
        shared: flat.shared,
    };
    for ((corners, across), &number) in flat.triangles.iter().zip(&flat.across).zip(&numbers) {
        sorted.triangles[number as usize] = *corners;
        let renumbered = across.map(|other| if other == NONE { NONE } else { numbers[other as usize] });
        sorted.across[number as usize] = renumbered;
    }
    sorted
}

/// Returns the squared radius of a triangle's circumcircle over that triangle's area times two, both in the plane's
/// units: (|a| |b| |c| / 4 A)² and 2 A. Infinite where the area is nil.
pub(super) fn circle(corners: [[f64; 2]; 3]) -> (f64, f64) {
    let [a, b, c] = corners;
    let square = |p: [f64; 2], q: [f64; 2]| (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
    let twice = ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs();
    let radius2 = square(a, b) * square(b, c) * square(c, a) / (4.0 * twice * twice);
    (if radius2.is_nan() { f64::INFINITY } else { radius2 }, twice)
}
