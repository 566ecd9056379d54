//! What comes of the neighbourhoods of all points at once.
//!
//! The points of a leaf are looked at together: whatever is near one of them is near the leaf's middle.

use super::candidates::Candidates;
use super::{LEAF, MANY, Near, Neighbours, ROUNDED_UP, Site, corners, square};
use rayon::prelude::*;

/// Candidates of a leaf's neighbourhoods by the points of one, and half its length by what one is guessed to reach, from which on each point is asked for alone.
const CROWDED: usize = 32;
const WIDE: f64 = 2.0;

/// Distance from a leaf's middle in units of the typical one, beyond which a point is asked for alone: one astray would make the leaf long.
const ASTRAY: f64 = 2.0;

/// By how much more than the leaf before, and than its middle's, a leaf's neighbourhoods are guessed to reach: where that is too little, they are looked for.
const GUESSED_MORE: f64 = 1.15;

/// What one leaf after the other is worked on in.
#[derive(Default)]
struct Scratch {
    best: Vec<Near>,
    ranges: Vec<(usize, usize)>,
    candidates: Candidates,
    near: Vec<[f64; 3]>,
    distances2: Vec<f64>,
    guess: f64,
}

impl Scratch {
    /// Takes what is nearest to a place, asked for alone.
    fn alone(&mut self, among: &Neighbours, place: &[f64; 3], count: usize) {
        let Self { best, near, distances2, .. } = self;
        among.nearest_into(place, count, best);
        near.clear();
        distances2.clear();
        near.extend(best.iter().map(|near| among.sites[near.slot as usize].at));
        distances2.extend(best.iter().map(|near| near.distance2));
    }

    /// Takes what was found among the candidates.
    fn found(&mut self) {
        let Self { candidates, near, distances2, .. } = self;
        near.clear();
        distances2.clear();
        near.extend(candidates.found.iter().map(|&(_, slot)| candidates.at(slot)));
        distances2.extend(candidates.found.iter().map(|&(distance2, _)| distance2));
    }

    /// The neighbourhood of a place of which that was taken.
    fn hood(&self, place: [f64; 3]) -> Hood<'_> {
        Hood { place, near: &self.near, distances2: &self.distances2 }
    }
}

/// The neighbourhood of one of the points.
pub(crate) struct Hood<'a> {
    /// The point.
    pub(crate) place: [f64; 3],
    /// Its nearest points, itself among them, in no order to rely on but always the same.
    pub(crate) near: &'a [[f64; 3]],
    /// Squared distances of these, mm².
    pub(crate) distances2: &'a [f64],
}

impl Neighbours {
    /// Returns what comes of each point's neighbourhood, in the order of the points: of its first so many neighbours, or where nothing
    /// comes of these, of so many as are named next.
    ///
    /// Large clouds are shared among threads; what comes of it is the same.
    pub(crate) fn of_all<T: Copy + Send>(
        &self,
        counts: &[usize],
        of: impl Fn(&Hood<'_>) -> Option<T> + Sync,
    ) -> Vec<Option<T>> {
        let leaves = self.leaves();
        let told = |leaves: &[(usize, usize)]| {
            let mut scratch = Scratch::default();
            let mut told = Vec::with_capacity(leaves.len() * LEAF);
            for &(from, to) in leaves {
                let first = told.len();
                told.resize(first + to - from, None);
                for &count in counts.iter().filter(|count| **count > 0) {
                    self.of_leaf(&self.sites[from..to], count, &of, &mut told[first..], &mut scratch);
                }
            }
            told
        };
        let in_order: Vec<Option<T>> = if self.len() < MANY {
            told(&leaves)
        } else {
            leaves.par_chunks(256).flat_map_iter(told).collect()
        };
        let mut all = vec![None; self.len()];
        for (site, told) in self.sites.iter().zip(in_order) {
            all[site.index as usize] = told;
        }
        all
    }

    /// Returns what comes of the neighbourhood of each leaf's middle, for each of the leaf's points, in the order of the points; counts as in [`Neighbours::of_all`]. Points astray from their
    /// leaf have their own neighbourhoods.
    pub(crate) fn of_leaves<T: Copy>(
        &self,
        counts: &[usize],
        of: impl Fn(&Hood<'_>) -> Option<T>,
    ) -> Vec<Option<T>> {
        // How far neighbourhoods are guessed to reach depends on how many there are of.
        let mut scratches: Vec<Scratch> = counts.iter().map(|_| Scratch::default()).collect();
        let mut about = |place: [f64; 3], alone: bool| {
            counts.iter().zip(&mut scratches).find_map(|(&count, scratch)| {
                let count = count.min(self.len());
                if alone {
                    scratch.alone(self, &place, count);
                } else {
                    let (own, _) = self.gather(&place, 0.0, count, scratch);
                    scratch.guess = GUESSED_MORE * own;
                    scratch.candidates.nearest(&place, count, own, own * ROUNDED_UP);
                    scratch.found();
                }
                of(&scratch.hood(place))
            })
        };
        let mut all = vec![None; self.len()];
        for (from, to) in self.leaves() {
            let leaf = &self.sites[from..to];
            let (middle, half) = bulk(leaf);
            let shared = about(middle, false);
            for site in leaf {
                let own = square(&site.at, &middle) <= (half * ROUNDED_UP).powi(2);
                all[site.index as usize] = if own { shared } else { about(site.at, true) };
            }
        }
        all
    }

    /// Returns from where to where each leaf's points lie.
    fn leaves(&self) -> Vec<(usize, usize)> {
        let mut ranges = vec![(0, self.len())];
        while ranges.len() <= self.cuts.len() {
            ranges = ranges.iter().flat_map(|&(a, b)| [(a, a + (b - a) / 2), (a + (b - a) / 2, b)]).collect();
        }
        ranges
    }

    /// Asks for those points of a leaf that nothing came of yet.
    fn of_leaf<T>(
        &self,
        leaf: &[Site],
        count: usize,
        of: &impl Fn(&Hood<'_>) -> Option<T>,
        told: &mut [Option<T>],
        scratch: &mut Scratch,
    ) {
        if told.iter().all(Option::is_some) {
            return;
        }
        let count = count.min(self.len());
        let (middle, half) = bulk(leaf);
        let wide = scratch.guess > 0.0 && half > WIDE * scratch.guess;
        let (own, reach) = if wide { (0.0, 0.0) } else { self.gather(&middle, half, count, scratch) };
        let alone = wide || scratch.candidates.len() > CROWDED * count.max(8);
        if !alone {
            scratch.guess = GUESSED_MORE * own;
        }
        let (mut bound, mut previous) = (f64::INFINITY, middle);
        for (site, told) in leaf.iter().zip(told).filter(|(_, told)| told.is_none()) {
            let arm = square(&site.at, &middle).sqrt();
            let mut complete = false;
            if !alone && arm <= half {
                // What was found for the point before bounds it as well; and only so far from it has everything been gathered.
                let bounds = (own + arm).min(bound + square(&site.at, &previous).sqrt()) * ROUNDED_UP;
                let bounds = bounds.min(reach - arm * ROUNDED_UP);
                scratch.candidates.nearest(&site.at, count, bounds, (bounds + arm) * ROUNDED_UP);
                complete = scratch.candidates.found.len() == count;
            }
            if complete {
                scratch.found();
            } else {
                scratch.alone(self, &site.at, count);
            }
            bound = scratch.distances2.iter().copied().fold(0.0, f64::max).sqrt();
            previous = site.at;
            *told = of(&scratch.hood(site.at));
        }
    }

    /// Gathers what is near a leaf's middle, its points being up to `half` away from there, and returns within what distance of the middle there are `count` points, and within what distance
    /// of it everything has been gathered.
    ///
    /// A place half away has as many within half more; but hardly ever are they farther from it than those of the middle are from that one, and somewhat. So far everything is gathered: where it is too
    /// little, a point is asked for alone. How far that is, the leaf before lets guess.
    fn gather(&self, middle: &[f64; 3], half: f64, count: usize, scratch: &mut Scratch) -> (f64, f64) {
        let Scratch { best, candidates, ranges, guess, .. } = scratch;
        let mut take = |own: f64| {
            let reach = own + half;
            ranges.clear();
            let all = (reach * ROUNDED_UP).powi(2);
            self.each_leaf_within(self.whole(), middle, all, &mut |from, to| ranges.push((from, to)));
            candidates.all.clear();
            for &(from, to) in ranges.iter() {
                candidates.all.extend_from_slice(&self.sites[from..to]);
            }
            candidates.arrange(middle, reach * ROUNDED_UP);
            candidates.radius_of(count).filter(|radius| *radius <= own).map(|radius| (radius, reach))
        };
        let guessed = if *guess > 0.0 { take(*guess) } else { None };
        guessed.unwrap_or_else(|| {
            self.nearest_into(middle, count, best);
            let exact = best.last().map_or(0.0, |last| last.distance2.sqrt()) * ROUNDED_UP;
            let own = GUESSED_MORE * exact;
            take(own);
            (exact, own + half)
        })
    }
}

/// Returns the middle of a leaf's points, and how far they are from it at most, those that are astray aside.
fn bulk(leaf: &[Site]) -> ([f64; 3], f64) {
    let mut values = [0.0; LEAF];
    let mut typical = |of: &dyn Fn(&Site) -> f64| {
        let values = &mut values[..leaf.len()];
        values.iter_mut().zip(leaf).for_each(|(value, site)| *value = of(site));
        *values.select_nth_unstable_by(leaf.len() / 2, f64::total_cmp).1
    };
    let rough: [f64; 3] = std::array::from_fn(|k| typical(&|site| site.at[k]));
    let limit = ASTRAY * ASTRAY * typical(&|site| square(&site.at, &rough));
    let own = || leaf.iter().filter(|site| square(&site.at, &rough) <= limit);
    let (low, high) = corners(own());
    let middle = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
    (middle, own().map(|site| square(&site.at, &middle)).fold(0.0, f64::max).sqrt())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clouds, nearest};
    use super::*;
    use crate::robust::Random;

    #[test]
    fn all_at_once_are_those_of_each() {
        for points in clouds() {
            let tree = Neighbours::new(&points).unwrap();
            // Nothing comes of eight for some of the points.
            let enough = |place: &[f64; 3]| !place[0].to_bits().count_ones().is_multiple_of(3);
            let of = |hood: &Hood<'_>| {
                let mut all: Vec<_> = hood
                    .distances2
                    .iter()
                    .zip(hood.near)
                    .map(|(d, p)| (d.to_bits(), p.map(f64::to_bits)))
                    .collect();
                all.sort_unstable();
                let known = all.iter().fold(0, |sum: u64, (d, p)| {
                    [*d, p[0], p[1], p[2]]
                        .iter()
                        .fold(sum, |sum, bits| sum.rotate_left(5).wrapping_add(*bits))
                });
                (enough(&hood.place) || hood.near.len() > 8 || points.len() < 9)
                    .then_some((hood.near.len(), known))
            };
            let told = tree.of_all(&[8, 30], of);
            for (i, told) in told.iter().enumerate() {
                let count = if enough(&points[i]) { 8 } else { 30 };
                let near = nearest(&points, &points[i], count);
                let hood = Hood {
                    place: points[i],
                    near: &near.iter().map(|n| points[n.1]).collect::<Vec<_>>(),
                    distances2: &near.iter().map(|n| n.0).collect::<Vec<_>>(),
                };
                assert_eq!(*told, of(&hood), "{i}");
            }
        }
    }

    #[test]
    fn points_of_a_leaf_share_what_its_middle_tells_and_those_astray_do_not() {
        let points = clouds().swap_remove(4);
        let tree = Neighbours::new(&points).unwrap();
        let told = tree.of_leaves(&[8], |hood| Some((hood.place, hood.distances2.len())));
        let place = |i: usize| {
            told[i].map_or([f64::NAN; 3], |(place, count)| if count == 8 { place } else { [f64::NAN; 3] })
        };
        assert!(square(&place(13), &points[13]) <= 0.0, "astray");
        let mut places: Vec<[f64; 3]> = (0..points.len()).map(place).collect();
        places.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        places.dedup();
        assert!(places.len() < points.len() / 3, "{} places of {} points", places.len(), points.len());
        // Nine points each of 900 over an area of 400 have a middle that most are within 2 of.
        let mut away: Vec<f64> = (0..points.len()).map(|i| square(&place(i), &points[i]).sqrt()).collect();
        away.sort_by(f64::total_cmp);
        assert!(away[points.len() * 9 / 10] < 2.0, "{}", away[points.len() * 9 / 10]);
    }

    #[test]
    fn a_large_tree_is_the_same_on_many_threads() {
        let mut random = Random::new(7);
        let points: Vec<[f64; 3]> =
            (0..2 * MANY + 7).map(|_| [random.share(), random.share(), 0.0]).collect();
        let tree = Neighbours::new(&points).unwrap();
        let farthest = |hood: &Hood<'_>| hood.distances2.iter().copied().max_by(f64::total_cmp);
        let told = tree.of_all(&[9], farthest);
        for i in (0..points.len()).step_by(997) {
            assert_eq!(told[i], tree.nearest(&points[i], 9).last().map(|near| near.0));
        }
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(told, one.install(|| tree.of_all(&[9], farthest)));
    }
}
