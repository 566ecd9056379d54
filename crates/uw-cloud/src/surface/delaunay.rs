//! Delaunay's triangulation of places in a plane.

mod halves;

use halves::{Edges, Strips};

/// Triangles of a plane, counter-clockwise, and what lies behind each of their sides.
pub(super) struct Flat {
    /// Corners, as positions in the places.
    pub(super) triangles: Vec<[u32; 3]>,
    /// The triangle on the other side of the edge from corner k to the next, [`crate::mesh::NONE`] at the hull.
    pub(super) across: Vec<[u32; 3]>,
    /// Places that another one had taken.
    pub(super) shared: usize,
}

/// Returns Delaunay's triangulation, of no triangles where all places lie on one line. Triangles come in the order of their least corners: points come in the order of
/// the scan, and what is asked for together then lies together in memory.
pub(super) fn triangulate(places: &[[f64; 2]]) -> Flat {
    // About their middle and in units of their extent: what is then tiny is rounding, which the predicates needn't resolve.
    let count = places.len().max(1) as f64;
    let middle: [f64; 2] = std::array::from_fn(|k| places.iter().map(|p| p[k]).sum::<f64>() / count);
    let extent = places
        .iter()
        .flat_map(|p| [p[0] - middle[0], p[1] - middle[1]])
        .fold(0.0_f64, |most, offset| most.max(offset.abs()));
    let clean = |offset: f64| if offset.abs() <= 1e-15 * extent { 0.0 } else { offset };
    let strips = Strips::of(places.iter().map(|p| [clean(p[0] - middle[0]), clean(p[1] - middle[1])]));
    let (triangles, across) = Edges::of(&strips).triangles(places.len());
    Flat { triangles, across, shared: places.len() - strips.len() }
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
