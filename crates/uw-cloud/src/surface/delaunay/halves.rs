//! Delaunay's triangulation by halves (L. Guibas, J. Stolfi, ACM Trans. Graphics 4 (1985) 74), those of strips before those of the plane (R. Dwyer, Algorithmica 2 (1987) 137).
//!
//! Signs are exact (J. Shewchuk, Discrete Comput. Geom. 18 (1997) 305, by the crate `robust`), so that no places, however they lie, lead to anything but a triangulation.

use crate::mesh::NONE;
use robust::Coord;
use std::cmp::Ordering;

/// Sites of a strip side by side, typically: with fewer more is taken away again where strips are joined, with more where they are made.
const SITES_ACROSS: f64 = 2.0;

/// A place and the point that it is of.
#[derive(Debug, Clone, Copy)]
struct Site {
    at: [f64; 2],
    point: u32,
}

/// One direction of an edge; that in the other one is beside it in the list, at its number ^ 1.
#[derive(Debug, Clone, Copy)]
struct Edge {
    /// The site that it leads from, [`NONE`] for an edge that was taken away.
    from: u32,
    /// The next edge from there, counter-clockwise and clockwise.
    next: u32,
    before: u32,
}

/// Sites and the edges between them.
pub(super) struct Edges<'a> {
    sites: &'a [Site],
    edges: Vec<Edge>,
    free: Vec<u32>,
    /// An edge that has a face on its left and what is outside on its right.
    hull: u32,
}

/// Which coordinate sites are halved by. The other one settles ties, so that sites of one coordinate lie in order, too: turned by a right angle, the second is the first.
#[derive(Debug, Clone, Copy)]
enum Axis {
    X,
    Y,
}

impl Axis {
    fn order(self, a: &[f64; 2], b: &[f64; 2]) -> Ordering {
        match self {
            Self::X => a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])),
            Self::Y => a[1].total_cmp(&b[1]).then(b[0].total_cmp(&a[0])),
        }
    }
}

/// Sites in strips along y, in each in the order of y. A strip has two sites at least, unless there is but one.
pub(super) struct Strips {
    sites: Vec<Site>,
    ends: Vec<usize>,
}

impl Strips {
    /// Returns the strips of places, none of which may be minus nil. Of places that are the same, the first one's point stays.
    pub(super) fn of(places: impl ExactSizeIterator<Item = [f64; 2]> + Clone) -> Self {
        let count = (((places.len() as f64).sqrt() / SITES_ACROSS) as usize).max(1);
        let bounds = (f64::INFINITY, f64::NEG_INFINITY);
        let (low, high) = places.clone().fold(bounds, |(low, high), at| (at[0].min(low), at[0].max(high)));
        let scale = count as f64 / (high - low);
        let strip = |at: &[f64; 2]| (((at[0] - low) * scale) as usize).min(count - 1);
        let mut starts = vec![0; count + 1];
        places.clone().for_each(|at| starts[strip(&at) + 1] += 1);
        (0..count).for_each(|k| starts[k + 1] += starts[k]);
        let mut filled = starts.clone();
        let mut all = vec![Site { at: [0.0; 2], point: 0 }; places.len()];
        for (at, point) in places.zip(0..) {
            let next = &mut filled[strip(&at)];
            all[*next] = Site { at, point };
            *next += 1;
        }
        let mut strips = Self { sites: Vec::with_capacity(all.len()), ends: Vec::with_capacity(count) };
        for range in starts.windows(2) {
            let own = &mut all[range[0]..range[1]];
            own.sort_unstable_by(|a, b| Axis::Y.order(&a.at, &b.at).then(a.point.cmp(&b.point)));
            let first = strips.sites.len();
            for site in own {
                if strips.sites[first..].last().is_none_or(|last| Axis::Y.order(&last.at, &site.at).is_ne()) {
                    strips.sites.push(*site);
                }
            }
            strips.close();
        }
        if strips.sites.len() > strips.ends.last().copied().unwrap_or(0) {
            strips.ends.pop();
            strips.close();
        }
        strips
    }

    /// Ends the strip that was begun, if it has sites enough: else the next one belongs to it.
    fn close(&mut self) {
        let own = &mut self.sites[self.ends.last().copied().unwrap_or(0)..];
        if own.len() > 1 {
            own.sort_unstable_by(|a, b| Axis::Y.order(&a.at, &b.at));
            self.ends.push(self.sites.len());
        }
    }

    /// Returns the number of places.
    pub(super) fn len(&self) -> usize {
        self.sites.len()
    }
}

impl<'a> Edges<'a> {
    /// Returns the triangulation of sites in strips.
    pub(super) fn of(Strips { sites, ends }: &'a Strips) -> Self {
        let mut all =
            Self { sites, edges: Vec::with_capacity(6 * sites.len()), free: Vec::new(), hull: NONE };
        if !ends.is_empty() {
            all.hull = all.strips(0, ends);
        }
        all
    }

    /// Returns the triangles in the order of the least of the points that they have, which comes first; counter-clockwise, and the triangle on the other side of each edge, [`NONE`] at the hull.
    pub(super) fn triangles(&self, points: usize) -> (Vec<[u32; 3]>, Vec<[u32; 3]>) {
        /// Of the face outside.
        const OUTSIDE: u32 = NONE - 1;
        let mut faces = vec![NONE; self.edges.len()];
        if self.hull != NONE {
            let mut edge = self.hull;
            loop {
                faces[edge as usize ^ 1] = OUTSIDE;
                edge = self.edges[edge as usize ^ 1].next;
                if edge == self.hull {
                    break;
                }
            }
        }
        let mut starts = vec![NONE; points];
        for (edge, number) in self.edges.iter().zip(0..).filter(|(edge, _)| edge.from != NONE) {
            starts[self.sites[edge.from as usize].point as usize] = number;
        }
        let mut triangles = Vec::with_capacity(2 * self.sites.len());
        let mut sides = Vec::with_capacity(2 * self.sites.len());
        for (&start, point) in starts.iter().zip(0..).filter(|(start, _)| **start != NONE) {
            let mut edge = start;
            loop {
                if faces[edge as usize] == NONE {
                    let second = self.along_left(edge);
                    let edges = [edge, second, self.along_left(second)];
                    let corners = edges.map(|edge| self.sites[self.from(edge) as usize].point);
                    debug_assert!(self.along_left(edges[2]) == edge && corners[0] == point);
                    edges.iter().for_each(|&edge| faces[edge as usize] = triangles.len() as u32);
                    triangles.push(corners);
                    sides.push(edges);
                }
                edge = self.edges[edge as usize].next;
                if edge == start {
                    break;
                }
            }
        }
        let beyond =
            |edge: u32| Some(faces[edge as usize ^ 1]).filter(|face| *face != OUTSIDE).unwrap_or(NONE);
        let across = sides.into_iter().map(|edges| edges.map(beyond)).collect();
        (triangles, across)
    }

    /// Triangulates some of the strips and returns an edge of their hull, counter-clockwise.
    fn strips(&mut self, from: usize, ends: &[usize]) -> u32 {
        match ends {
            [] => NONE,
            [to] => self.strip(from, *to),
            _ => {
                let (low, high) = ends.split_at(ends.len() / 2);
                let middle = low[low.len() - 1];
                let (low, high) = (self.strips(from, low), self.strips(middle, high));
                self.merge(low, high, Axis::X)
            }
        }
    }

    /// Triangulates sites of one strip, two at least.
    fn strip(&mut self, from: usize, to: usize) -> u32 {
        let first = from as u32;
        match to - from {
            2 => self.edge(first, first + 1),
            3 => {
                let a = self.edge(first, first + 1);
                let b = self.edge(first + 1, first + 2);
                self.put_after(b, a ^ 1);
                let side = self.side(first, first + 1, first + 2);
                if side != 0.0 {
                    self.connect(b, a);
                }
                if side < 0.0 { a ^ 1 } else { a }
            }
            count => {
                let middle = from + count / 2;
                let (low, high) = (self.strip(from, middle), self.strip(middle, to));
                self.merge(low, high, Axis::Y)
            }
        }
    }

    /// Joins two triangulations, the first one's sites before the other one's, and returns an edge of their hull.
    fn merge(&mut self, low: u32, high: u32, axis: Axis) -> u32 {
        // The last site of the one and the first of the other: the edges from there that have what is outside to the left, and to the right.
        let last = self.outermost(low, |a, b| axis.order(a, b) == Ordering::Greater);
        let mut left = self.edges[last as usize].before;
        let mut right = self.outermost(high, |a, b| axis.order(a, b) == Ordering::Less);
        // Down to the edge below both.
        loop {
            if self.side(self.from(left), self.to(left), self.from(right)) > 0.0 {
                left = self.along_left(left);
            } else if self.side(self.to(right), self.from(right), self.from(left)) > 0.0 {
                right = self.edges[right as usize ^ 1].next;
            } else {
                break;
            }
        }
        // From there upwards, an edge across after the other: to that neighbour of either end whose circle with both is empty.
        let mut base = self.connect(right ^ 1, left);
        let below = base ^ 1;
        loop {
            let (r, l) = (self.from(base), self.to(base));
            let up = |all: &Self, edge: u32| all.side(l, r, all.to(edge)) > 0.0;
            let mut left = self.edges[base as usize ^ 1].next;
            let left_up = up(self, left);
            if left_up {
                loop {
                    let next = self.edges[left as usize].next;
                    if self.to(next) == r || !self.within([l, r, self.to(left)], self.to(next)) {
                        break;
                    }
                    self.take_away(left);
                    left = next;
                }
            }
            let mut right = self.edges[base as usize].before;
            let right_up = up(self, right);
            if right_up {
                loop {
                    let next = self.edges[right as usize].before;
                    if self.to(next) == l || !self.within([l, r, self.to(right)], self.to(next)) {
                        break;
                    }
                    self.take_away(right);
                    right = next;
                }
            }
            base = match (left_up, right_up) {
                (false, false) => return below,
                (true, true) if self.within([self.to(left), l, r], self.to(right)) => {
                    self.connect(right, base ^ 1)
                }
                (true, _) => self.connect(base ^ 1, left ^ 1),
                (false, true) => self.connect(right, base ^ 1),
            };
        }
    }

    /// The hull's edge from the site that comes before all others.
    fn outermost(&self, hull: u32, is_before: impl Fn(&[f64; 2], &[f64; 2]) -> bool) -> u32 {
        let (mut best, mut edge) = (hull, self.edges[hull as usize ^ 1].next);
        let place = |edge: u32| &self.sites[self.from(edge) as usize].at;
        while edge != hull {
            if is_before(place(edge), place(best)) {
                best = edge;
            }
            edge = self.edges[edge as usize ^ 1].next;
        }
        best
    }

    fn from(&self, edge: u32) -> u32 {
        self.edges[edge as usize].from
    }

    fn to(&self, edge: u32) -> u32 {
        self.edges[edge as usize ^ 1].from
    }

    /// The next edge of the face on an edge's left.
    fn along_left(&self, edge: u32) -> u32 {
        self.edges[edge as usize ^ 1].before
    }

    /// A new edge that hangs together with no other.
    fn edge(&mut self, from: u32, to: u32) -> u32 {
        let edge = self.free.pop().unwrap_or(self.edges.len() as u32);
        let both = [(from, edge), (to, edge ^ 1)].map(|(from, own)| Edge { from, next: own, before: own });
        if edge as usize == self.edges.len() {
            self.edges.extend(both);
        } else {
            self.edges[edge as usize..edge as usize + 2].copy_from_slice(&both);
        }
        edge
    }

    /// Puts a new edge after another one of its site.
    fn put_after(&mut self, edge: u32, other: u32) {
        let next = std::mem::replace(&mut self.edges[other as usize].next, edge);
        self.edges[next as usize].before = edge;
        let own = &mut self.edges[edge as usize];
        (own.next, own.before) = (next, other);
    }

    /// Connects the end of an edge with the start of another one of the same face, to the left of both.
    fn connect(&mut self, a: u32, b: u32) -> u32 {
        let after = self.along_left(a);
        let edge = self.edge(self.to(a), self.from(b));
        self.put_after(edge, after);
        self.put_after(edge ^ 1, b);
        edge
    }

    fn take_away(&mut self, edge: u32) {
        for own in [edge, edge ^ 1] {
            let Edge { next, before, .. } = self.edges[own as usize];
            self.edges[before as usize].next = next;
            self.edges[next as usize].before = before;
            self.edges[own as usize].from = NONE;
        }
        self.free.push(edge & !1);
    }

    /// Twice the area of a triangle, positive where its corners come counter-clockwise; its sign is exact.
    fn side(&self, a: u32, b: u32, c: u32) -> f64 {
        /// Of the rounding: Shewchuk's ccwerrboundA.
        const BOUND: f64 = 3.330_669_073_875_472e-16;
        let [a, b, c] = [a, b, c].map(|site| self.sites[site as usize].at);
        let (one, other) = ((a[0] - c[0]) * (b[1] - c[1]), (a[1] - c[1]) * (b[0] - c[0]));
        let area = one - other;
        if area.abs() > BOUND * (one.abs() + other.abs()) {
            return area;
        }
        let [a, b, c] = [a, b, c].map(|at| Coord { x: at[0], y: at[1] });
        robust::orient2d(a, b, c)
    }

    /// Whether a site lies within the circle through three, counter-clockwise; exact.
    fn within(&self, circle: [u32; 3], site: u32) -> bool {
        /// Of the rounding: Shewchuk's iccerrboundA.
        const BOUND: f64 = 1.110_223_024_625_157e-15;
        let d = self.sites[site as usize].at;
        let places = circle.map(|site| self.sites[site as usize].at);
        let [a, b, c] = places.map(|at| [at[0] - d[0], at[1] - d[1]]);
        let mut sum = 0.0;
        let mut size = 0.0;
        for [a, b, c] in [[a, b, c], [b, c, a], [c, a, b]] {
            let lift = a[0] * a[0] + a[1] * a[1];
            let (one, other) = (b[0] * c[1], b[1] * c[0]);
            sum += lift * (one - other);
            size += lift * (one.abs() + other.abs());
        }
        if sum.abs() > BOUND * size {
            return sum > 0.0;
        }
        let [a, b, c, d] = [places[0], places[1], places[2], d].map(|at| Coord { x: at[0], y: at[1] });
        robust::incircle(a, b, c, d) > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robust::Random;

    fn triangulated(places: &[[f64; 2]]) -> (Vec<[u32; 3]>, Vec<[u32; 3]>, usize) {
        let strips = Strips::of(places.iter().copied());
        let (triangles, across) = Edges::of(&strips).triangles(places.len());
        (triangles, across, places.len() - strips.len())
    }

    /// Places at random, on a grid, on a circle, in rows, in one row of either direction, many twice, and with one far astray.
    fn layouts() -> Vec<Vec<[f64; 2]>> {
        let mut random = Random::new(11);
        let anywhere: Vec<[f64; 2]> = (0..400).map(|_| [random.share(), random.share()]).collect();
        let grid: Vec<[f64; 2]> = (0..300).map(|k| [f64::from(k % 20), f64::from(k / 20)]).collect();
        let circle = (0..100).map(|k| (0.0628 * f64::from(k)).sin_cos()).map(|(y, x)| [x, y]);
        let rows = (0..240).map(|k| [f64::from(k / 12), 0.01 * f64::from(k % 12) + 0.001 * random.share()]);
        let row: Vec<[f64; 2]> = (0..40).map(|k| [f64::from(k * 7 % 40), 2.0]).collect();
        let column: Vec<[f64; 2]> = row.iter().map(|at| [2.0, at[0]]).collect();
        let corner: Vec<[f64; 2]> = column.iter().copied().chain([[3.0, 0.5]]).collect();
        let twice = (0..600).map(|k| grid[k * 7 % 300].map(|c| 0.1 * c)).chain([[0.05, 0.05]]).collect();
        let mut astray = anywhere.clone();
        astray[7] = [1e6, -3e5];
        let rows = rows.collect();
        let mut all = vec![anywhere, grid, circle.collect(), rows, row, column, corner, twice, astray];
        all.extend(
            (0..7).map(|count| (0..count).map(|k| [0.1 * f64::from(k), f64::from(k * k % 3)]).collect()),
        );
        all
    }

    #[test]
    fn no_place_lies_within_a_circle_and_all_of_the_hull_is_covered() {
        for places in layouts() {
            let (triangles, across, shared) = triangulated(&places);
            let at = |v: u32| Coord { x: places[v as usize][0], y: places[v as usize][1] };
            for &[a, b, c] in &triangles {
                assert!(a < b && a < c && robust::orient2d(at(a), at(b), at(c)) > 0.0);
                for d in 0..places.len() as u32 {
                    assert!(robust::incircle(at(a), at(b), at(c), at(d)) <= 0.0, "{a} {b} {c}: {d}");
                }
            }
            // Euler: 2 n − 2 − h triangles, of a hull of h edges, none of which has a place on its outer side.
            let mut hull = 0;
            for (corners, others) in triangles.iter().zip(&across) {
                for k in 0..3 {
                    let (from, to) = (corners[k], corners[(k + 1) % 3]);
                    if others[k] == NONE {
                        hull += 1;
                        let outside = |d| robust::orient2d(at(from), at(to), at(d)) < 0.0;
                        assert!(!(0..places.len() as u32).any(outside));
                    } else {
                        let other = triangles[others[k] as usize];
                        assert!((0..3).any(|m| (other[m], other[(m + 1) % 3]) == (to, from)));
                    }
                }
            }
            let unique = places.len() - shared;
            let line = (2..places.len() as u32).all(|d| robust::orient2d(at(0), at(1), at(d)).abs() <= 0.0);
            assert_eq!(triangles.len(), if line { 0 } else { 2 * unique - 2 - hull });
            assert!(triangles.is_sorted_by_key(|corners| corners[0]));
        }
    }

    #[test]
    fn of_places_that_are_the_same_the_first_point_stays() {
        let places = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
        assert_eq!(triangulated(&places), (vec![[0, 1, 2]], vec![[NONE; 3]], 2));
    }
}
