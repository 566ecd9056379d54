//! A tree of boxes around triangles.

use super::Span;
use nalgebra::Vector3;
use uw_geom::Ray;

/// Halves at the median along the longest side, down to a few triangles a leaf.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Bvh {
    nodes: Vec<Node>,
    /// Triangles in the order of the leaves.
    order: Vec<u32>,
}

#[derive(Clone, Debug, PartialEq)]
struct Node {
    low: Vector3<f64>,
    high: Vector3<f64>,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// Part of `order`.
    Leaf { start: u32, end: u32 },
    /// The left child comes next, the right one here.
    Fork { right: u32 },
}

const LEAF: usize = 4;

impl Bvh {
    pub(super) fn new(triangles: &[[Vector3<f64>; 3]]) -> Self {
        let middles: Vec<Vector3<f64>> = triangles.iter().map(|[a, b, c]| (a + b + c) / 3.0).collect();
        let mut tree = Self { nodes: Vec::new(), order: (0..triangles.len() as u32).collect() };
        // Depth grows with the logarithm of the number of triangles: halves are equal.
        tree.grow(triangles, &middles, 0, triangles.len());
        tree
    }

    fn grow(&mut self, triangles: &[[Vector3<f64>; 3]], middles: &[Vector3<f64>], start: usize, end: usize) {
        let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
        for p in self.order[start..end].iter().flat_map(|i| &triangles[*i as usize]) {
            low = low.inf(p);
            high = high.sup(p);
        }
        let at = self.nodes.len();
        let kind = Kind::Leaf { start: start as u32, end: end as u32 };
        self.nodes.push(Node { low, high, kind });
        if end - start <= LEAF {
            return;
        }
        let axis = (high - low).imax();
        let half = (end - start) / 2;
        let by_axis = |a: &u32, b: &u32| middles[*a as usize][axis].total_cmp(&middles[*b as usize][axis]);
        self.order[start..end].select_nth_unstable_by(half, by_axis);
        self.grow(triangles, middles, start, start + half);
        self.nodes[at].kind = Kind::Fork { right: self.nodes.len() as u32 };
        self.grow(triangles, middles, start + half, end);
    }

    /// Smallest and largest coordinates of all triangles.
    pub(super) fn bounds(&self) -> (Vector3<f64>, Vector3<f64>) {
        (self.nodes[0].low, self.nodes[0].high)
    }

    /// Calls `found` for every triangle whose box the ray enters within `span`, which `found` may shorten.
    pub(super) fn visit(&self, ray: &Ray, span: &mut Span, mut found: impl FnMut(usize, &mut Span)) {
        let inverse = ray.direction.map(f64::recip);
        // Halving 2³² triangles ends after 32 levels, each of which leaves one node open.
        let (mut open, mut count) = ([0_usize; 64], 1);
        while count > 0 {
            count -= 1;
            let at = open[count];
            let node = &self.nodes[at];
            let [a, b] = [node.low, node.high].map(|side| (side - ray.origin).component_mul(&inverse));
            // A ray along a face gives NaN there, which min and max pass over.
            let enter = (0..3).fold(span.beyond, |m, i| m.max(a[i].min(b[i])));
            let leave = (0..3).fold(span.within, |m, i| m.min(a[i].max(b[i])));
            if enter > leave {
                continue;
            }
            match node.kind {
                Kind::Leaf { start, end } => {
                    self.order[start as usize..end as usize].iter().for_each(|i| found(*i as usize, span));
                }
                Kind::Fork { right } => {
                    (open[count], open[count + 1]) = (right as usize, at + 1);
                    count += 2;
                }
            }
        }
    }
}
