//! Which points are near: a k-d tree over positions, asked for one place or for all of its own points at once.
//!
//! The points lie in the order of the tree's leaves, which hold some ten each, so that what is near in space is near in memory. Each branch
//! halves its points along the longest side of their box; where the halves lie follows from their number, and only the cut is stored. Points at
//! one distance are taken by their index, so that an answer does not depend on how the tree was made.

mod candidates;
mod hoods;

use crate::error::CloudError;
pub(crate) use hoods::Hood;

/// Points of a leaf at most. Neighbourhoods of a leaf's points are looked for together.
const LEAF: usize = 12;

/// Times as many points that are looked through for some of other images.
const FURTHER: usize = 64;

/// Points from which on work is shared among threads.
pub(crate) const MANY: usize = 50_000;

/// A k-d tree over a cloud's positions.
pub struct Neighbours {
    /// The points in the order of the leaves.
    sites: Vec<Site>,
    /// The branches' cuts; the children of the i-th are 2 i + 1 and 2 i + 2.
    cuts: Vec<Cut>,
}

#[derive(Clone, Copy)]
struct Site {
    at: [f64; 3],
    index: u32,
}

#[derive(Clone, Copy, Default)]
struct Cut {
    at: f64,
    axis: u32,
}

/// A point near a place: squared distance, mm², index and place in the tree.
#[derive(Clone, Copy)]
struct Near {
    distance2: f64,
    index: u32,
    slot: u32,
}

impl Near {
    fn is_before(&self, other: &Self) -> bool {
        self.distance2 < other.distance2 || self.distance2 <= other.distance2 && self.index < other.index
    }

    fn order(&self, other: &Self) -> std::cmp::Ordering {
        self.distance2.total_cmp(&other.distance2).then(self.index.cmp(&other.index))
    }
}

/// A node and its points, and how far its part of space is from a place at least: squared, along each axis.
#[derive(Clone, Copy)]
struct Part {
    node: usize,
    from: usize,
    to: usize,
    off2: [f64; 3],
}

impl Neighbours {
    /// Returns the tree over positions, mm.
    ///
    /// # Errors
    /// [`CloudError::NonFinite`] for a position that is no finite number, [`CloudError::TooMany`] for more than fit into it.
    pub fn new(positions_mm: &[[f64; 3]]) -> Result<Self, CloudError> {
        let usable = |p: &[f64; 3]| p.iter().all(|c| c.abs() < 1e100);
        if let Some(index) = positions_mm.iter().position(|p| !usable(p)) {
            return Err(CloudError::NonFinite { attribute: "position", index });
        }
        if u32::try_from(positions_mm.len()).is_err() {
            return Err(CloudError::TooMany { got: positions_mm.len() });
        }
        let mut sites: Vec<Site> =
            positions_mm.iter().zip(0..).map(|(at, index)| Site { at: *at, index }).collect();
        let mut branches = 0;
        while sites.len() > LEAF * (branches + 1) {
            branches = 2 * branches + 1;
        }
        let mut cuts = vec![Cut::default(); branches];
        let depth = (branches + 1).ilog2();
        let mut levels = Vec::new();
        let mut rest = cuts.as_mut_slice();
        for level in 0..depth {
            let (own, deeper) = rest.split_at_mut(1 << level);
            levels.push(own);
            rest = deeper;
        }
        halve(&mut sites, levels);
        Ok(Self { sites, cuts })
    }

    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.sites.len()
    }

    /// Returns whether there are none.
    pub fn is_empty(&self) -> bool {
        self.sites.is_empty()
    }

    /// Returns the points' indices in the order of the leaves: what is near in it is near in space.
    pub(crate) fn in_order(&self) -> impl Iterator<Item = usize> {
        self.sites.iter().map(|site| site.index as usize)
    }

    /// Returns the `count` points nearest to a place, as (squared distance in mm², index), the nearest first, of equals the one of lower index.
    pub fn nearest(&self, place_mm: &[f64; 3], count: usize) -> Vec<(f64, usize)> {
        let mut best = Vec::new();
        self.nearest_into(place_mm, count, &mut best);
        best.into_iter().map(|near| (near.distance2, near.index as usize)).collect()
    }

    /// Returns the points nearest to a place as [`Neighbours::nearest`], at most three quarters of them of one image where `rows` tells each point's: of a quick sweep,
    /// whose stripes lie many times as far apart as their points, the nearest are all of one stripe.
    pub(crate) fn nearest_of_several(
        &self,
        place_mm: &[f64; 3],
        count: usize,
        rows: Option<&[u32]>,
    ) -> Vec<(f64, usize)> {
        let Some(rows) = rows else { return self.nearest(place_mm, count) };
        let most = count - count / 4;
        let mut asked = count;
        loop {
            let mut taken: Vec<(u32, usize)> = Vec::new();
            let is_wanted = |&(_, i): &(f64, usize)| {
                let row = rows[i];
                let at = taken.iter().position(|(r, _)| *r == row).unwrap_or_else(|| {
                    taken.push((row, 0));
                    taken.len() - 1
                });
                taken[at].1 += 1;
                taken[at].1 <= most
            };
            let near = self.nearest(place_mm, asked);
            let (all, found) = (near.len() < asked, near.into_iter().filter(is_wanted).take(count));
            let found: Vec<(f64, usize)> = found.collect();
            if all || found.len() == count || asked >= FURTHER * count {
                return found;
            }
            asked *= 4;
        }
    }

    /// Fills `best` with the `count` points nearest to a place, the nearest first.
    fn nearest_into(&self, place_mm: &[f64; 3], count: usize, best: &mut Vec<Near>) {
        best.clear();
        let count = count.min(self.len());
        if count > 0 {
            best.reserve(count + 1);
            self.nearer(self.whole(), place_mm, count, best);
        }
    }

    /// Returns the point nearest to a place, as (squared distance in mm², index); `None` of no points.
    pub fn nearest_one(&self, place_mm: &[f64; 3]) -> Option<(f64, usize)> {
        let mut best = NOWHERE;
        self.nearest_of(self.whole(), place_mm, &mut best);
        (!self.is_empty()).then_some((best.distance2, best.index as usize))
    }

    /// Returns the point nearest to a place, as (squared distance in mm², index), and how much farther the next one is, mm; `None` of no points.
    pub(crate) fn nearest_by(&self, place_mm: &[f64; 3]) -> Option<(f64, usize, f64)> {
        let mut best = [NOWHERE; 2];
        self.nearest_two(self.whole(), place_mm, &mut best);
        let [first, second] = best;
        let farther = second.distance2.sqrt() - first.distance2.sqrt();
        (!self.is_empty()).then_some((first.distance2, first.index as usize, farther))
    }

    /// Returns the points within a distance of a place, as (squared distance in mm², index), in no order to rely on but always the same.
    pub fn within(&self, place_mm: &[f64; 3], reach_mm: f64) -> Vec<(f64, usize)> {
        let mut found = Vec::new();
        if reach_mm.is_finite() {
            self.each_within(self.whole(), place_mm, reach_mm * reach_mm, &mut |near| {
                found.push((near.distance2, near.index as usize));
            });
        }
        found
    }

    fn whole(&self) -> Part {
        Part { node: 0, from: 0, to: self.len(), off2: [0.0; 3] }
    }

    /// Returns the halves of a part, the one that a place is in first; `None` of a leaf.
    #[inline]
    fn halves(&self, part: &Part, place: &[f64; 3]) -> Option<(Part, Part)> {
        let cut = self.cuts.get(part.node)?;
        let middle = part.from + (part.to - part.from) / 2;
        let beyond = place[cut.axis as usize] - cut.at;
        // Chosen one by one: a part that is written by an index into memory, and read back as a whole, has the processor wait.
        let off2 =
            std::array::from_fn(|k| if k == cut.axis as usize { beyond * beyond } else { part.off2[k] });
        let (low, high) = (2 * part.node + 1, 2 * part.node + 2);
        Some(if beyond < 0.0 {
            (Part { node: low, to: middle, ..*part }, Part { node: high, from: middle, off2, ..*part })
        } else {
            (Part { node: high, from: middle, ..*part }, Part { node: low, to: middle, off2, ..*part })
        })
    }

    /// Returns the points of a leaf as they are from a place.
    #[inline]
    fn seen<'a>(&'a self, part: &Part, place: &'a [f64; 3]) -> impl Iterator<Item = Near> + 'a {
        let sites = self.sites[part.from..part.to].iter().zip(part.from as u32..);
        sites.map(|(site, slot)| Near { distance2: square(&site.at, place), index: site.index, slot })
    }

    fn nearer(&self, part: Part, place: &[f64; 3], count: usize, best: &mut Vec<Near>) {
        match self.halves(&part, place) {
            Some((own, other)) => {
                self.nearer(own, place, count, best);
                if best.len() < count || other.off2.iter().sum::<f64>() <= best[count - 1].distance2 {
                    self.nearer(other, place, count, best);
                }
            }
            None => {
                for near in self.seen(&part, place) {
                    if best.len() == count {
                        if !near.is_before(&best[count - 1]) {
                            continue;
                        }
                        best.pop();
                    }
                    best.push(near);
                    let mut at = best.len() - 1;
                    while at > 0 && near.is_before(&best[at - 1]) {
                        best[at] = best[at - 1];
                        at -= 1;
                    }
                    best[at] = near;
                }
            }
        }
    }

    fn nearest_of(&self, part: Part, place: &[f64; 3], best: &mut Near) {
        match self.halves(&part, place) {
            Some((own, other)) => {
                self.nearest_of(own, place, best);
                if other.off2.iter().sum::<f64>() <= best.distance2 {
                    self.nearest_of(other, place, best);
                }
            }
            None => {
                for near in self.seen(&part, place) {
                    if near.is_before(best) {
                        *best = near;
                    }
                }
            }
        }
    }

    fn nearest_two(&self, part: Part, place: &[f64; 3], best: &mut [Near; 2]) {
        match self.halves(&part, place) {
            Some((own, other)) => {
                self.nearest_two(own, place, best);
                if other.off2.iter().sum::<f64>() <= best[1].distance2 {
                    self.nearest_two(other, place, best);
                }
            }
            None => {
                for near in self.seen(&part, place) {
                    if near.is_before(&best[0]) {
                        *best = [near, best[0]];
                    } else if near.is_before(&best[1]) {
                        best[1] = near;
                    }
                }
            }
        }
    }

    fn each_within(&self, part: Part, place: &[f64; 3], reach2: f64, found: &mut impl FnMut(Near)) {
        self.each_leaf_within(part, place, reach2, &mut |from, to| {
            let seen = self.seen(&Part { from, to, ..part }, place);
            seen.filter(|near| near.distance2 <= reach2).for_each(&mut *found);
        });
    }

    /// Visits the leaves whose part of space is within reach of a place.
    fn each_leaf_within(
        &self,
        part: Part,
        place: &[f64; 3],
        reach2: f64,
        found: &mut impl FnMut(usize, usize),
    ) {
        match self.halves(&part, place) {
            Some((own, other)) => {
                self.each_leaf_within(own, place, reach2, found);
                if other.off2.iter().sum::<f64>() <= reach2 {
                    self.each_leaf_within(other, place, reach2, found);
                }
            }
            None => found(part.from, part.to),
        }
    }
}

/// What is farther than anything.
const NOWHERE: Near = Near { distance2: f64::INFINITY, index: u32::MAX, slot: 0 };

/// A bound of a few sums and roots, rounded up.
const ROUNDED_UP: f64 = 1.0 + 1e-12;

/// Puts points in the order of leaves, and fills the branches' cuts, by level.
fn halve(sites: &mut [Site], mut levels: Vec<&mut [Cut]>) {
    let Some((cut, _)) = levels.first_mut().and_then(|own| own.split_first_mut()) else { return };
    let (low, high) = corners(sites.iter());
    let side = |axis: usize| high[axis] - low[axis];
    let axis = (1..3).fold(0, |longest, axis| if side(axis) > side(longest) { axis } else { longest });
    let middle = sites.len() / 2;
    let order = |a: &Site, b: &Site| a.at[axis].total_cmp(&b.at[axis]).then(a.index.cmp(&b.index));
    let (_, first, _) = sites.select_nth_unstable_by(middle, order);
    *cut = Cut { at: first.at[axis], axis: axis as u32 };
    let (mut low, mut high) = (Vec::with_capacity(levels.len()), Vec::with_capacity(levels.len()));
    for own in levels.into_iter().skip(1) {
        let half = own.len() / 2;
        let (first, second) = own.split_at_mut(half);
        low.push(first);
        high.push(second);
    }
    let (first, second) = sites.split_at_mut(middle);
    if first.len() < MANY {
        halve(first, low);
        halve(second, high);
    } else {
        rayon::join(|| halve(first, low), || halve(second, high));
    }
}

fn corners<'a>(sites: impl Iterator<Item = &'a Site>) -> ([f64; 3], [f64; 3]) {
    // Comparisons rather than `min` and `max`: each is one of the processor's instructions.
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for Site { at, .. } in sites {
        for k in 0..3 {
            low[k] = if at[k] < low[k] { at[k] } else { low[k] };
            high[k] = if at[k] > high[k] { at[k] } else { high[k] };
        }
    }
    (low, high)
}

#[inline]
fn square(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robust::Random;

    /// Points on a grid, at random, on a line, all in one place, and with one far astray.
    pub(super) fn clouds() -> Vec<Vec<[f64; 3]>> {
        let mut random = Random::new(5);
        let mut number = || random.share() * 20.0 - 10.0;
        let grid = (0..700).map(|i| [i % 10, i / 10 % 10, i / 100].map(f64::from)).collect();
        let line = (0..300).map(|i| [0.1 * f64::from(i), 0.0, 5.0]).collect();
        let anywhere: Vec<_> = (0..900).map(|_| [number(), number(), 0.1 * number()]).collect();
        let mut astray = anywhere.clone();
        astray[13] = [1e7, -3.0, 2.0];
        vec![grid, anywhere, line, vec![[1.0, 2.0, 3.0]; 200], astray, vec![[0.5; 3]; 3], Vec::new()]
    }

    /// What is nearest by looking at all of them.
    pub(super) fn nearest(points: &[[f64; 3]], place: &[f64; 3], count: usize) -> Vec<(f64, usize)> {
        let mut all: Vec<_> = points.iter().zip(0..).map(|(p, i)| (square(p, place), i)).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        all.truncate(count);
        all
    }

    #[test]
    fn neighbours_are_those_that_a_look_at_all_finds() {
        for points in clouds() {
            let tree = Neighbours::new(&points).unwrap();
            let mut random = Random::new(6);
            let places = (0..60).map(|_| [0, 1, 2].map(|_| random.share() * 24.0 - 12.0));
            for place in places.chain(points.iter().copied().take(40)) {
                for count in [1, 7, 24, 2000] {
                    assert_eq!(tree.nearest(&place, count), nearest(&points, &place, count));
                }
                assert_eq!(tree.nearest_one(&place), nearest(&points, &place, 1).first().copied());
                let two = nearest(&points, &place, 2);
                let by = |two: &[(f64, usize)]| two.get(1).map_or(f64::INFINITY, |next| next.0.sqrt());
                let told = two.first().map(|first| (first.0, first.1, by(&two) - first.0.sqrt()));
                assert_eq!(tree.nearest_by(&place), told);
                let mut within = tree.within(&place, 3.0);
                within.sort_by_key(|near| near.1);
                let all = nearest(&points, &place, points.len());
                let mut near: Vec<_> = all.into_iter().filter(|near| near.0 <= 9.0).collect();
                near.sort_by_key(|near| near.1);
                assert_eq!(within, near);
            }
        }
    }
}
