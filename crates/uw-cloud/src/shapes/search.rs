//! The search among a sample of oriented points: random pairs, nearby ones, the best shape, what it is connected to, and whether
//! chance explains it.

use crate::neighbours::Neighbours;
use crate::robust::{Random, median};
use crate::shapes::primitive::{KINDS, Oriented, Primitive};
use nalgebra::Vector3;

/// Pairs drawn in one search. A shape with a fiftieth of the points, of whose pairs every fourth is sound, is missed once in
/// 50 000 searches; one with a hundredth, once in 200.
const PAIRS: usize = 2200;

/// Pairs drawn at a time.
const DRAWN: usize = 200;

/// Share of a shape's pairs that are sound, and the logarithm of the chance that all of them were missed at which drawing ends: that of a shape with a
/// fiftieth of the points in [`PAIRS`].
const SOUND: f64 = 0.25;
const MISSED: f64 = -11.0;

/// Points of the sample from which on a shape may end the drawing: on free forms any patch is as good as the next, and the best of many has to stand trial.
const LARGE: f64 = 600.0;

/// Points after which a candidate's chances are looked at.
const GIVEN_UP: usize = 20;

/// Steps of the longest walk from a pair's first point to its second.
const LONGEST_WALK: usize = 24;

/// Points of a sample that candidates are compared on first, and how many of the best are looked at closely.
const SCREENED: usize = 160;
const CLOSE: usize = 24;

/// Neighbours in the sample that a point is connected to.
pub(super) const LINKS: usize = 10;

/// Cosine of the largest angle between a point's normal and the shape's: 20°.
pub(super) const FACING: f64 = 0.939_692_62;

/// Logarithm of the expected number of shapes that chance alone would bring (number of false alarms).
const FALSE_ALARMS: f64 = -6.9;

/// Share of the points of a more complicated shape that a simpler one must hold to be taken instead.
const AS_GOOD: f64 = 0.93;

/// Scatter in shares of the tolerance at which a search has come to its end: a fit by rounding alone would not.
const EXACT: f64 = 1e-6;

/// Points that every shape needs at least, times its parameters.
const LEAST_A_PARAMETER: usize = 3;

/// Oriented points, and which of them are near each other.
pub(super) struct Field {
    pub(super) points: Vec<Oriented>,
    pub(super) links: Vec<Vec<u32>>,
    pub(super) tree: Neighbours,
    /// Which points are still of no shape.
    pub(super) free: Vec<bool>,
    /// Scatter about a shape that is none, mm.
    resolution_mm: f64,
}

/// A shape and the points of the field that hold to it and hang together.
#[derive(Clone)]
pub(super) struct Candidate {
    pub(super) primitive: Primitive,
    pub(super) members: Vec<usize>,
}

impl Field {
    pub(super) fn new(points: Vec<Oriented>, tree: Neighbours) -> Self {
        let rows: Option<Vec<u32>> = points.iter().map(|o| o.row).collect();
        // Of one image alone there is no other to ask.
        let rows = rows.filter(|rows| rows.iter().any(|row| *row != rows[0]));
        let links = points.iter().enumerate().map(|(i, o)| {
            let near = tree.nearest_of_several(&o.point.into(), LINKS + 1, rows.as_deref());
            near.into_iter().filter(|&(_, j)| j != i).map(|(_, j)| j as u32).collect()
        });
        let links = links.collect();
        let free = vec![true; points.len()];
        let resolution_mm = EXACT * median(&mut points.iter().map(|o| o.tolerance).collect::<Vec<_>>());
        Self { points, links, tree, free, resolution_mm }
    }

    /// Returns the best shape among the free points that chance does not explain, `None` where there is none.
    ///
    /// Pairs are drawn until a better shape than the best so far would have been found as surely as the smallest is by all [`PAIRS`] (Schnabel's
    /// rule); where what was found turns out to be none, the others are drawn.
    pub(super) fn best(&self, random: &mut Random) -> Option<Candidate> {
        let free: Vec<usize> = (0..self.points.len()).filter(|&i| self.free[i]).collect();
        if free.len() < 4 * LEAST_A_PARAMETER {
            return None;
        }
        let screened: Vec<Oriented> =
            (0..SCREENED.min(free.len())).map(|_| self.points[free[random.below(free.len())]]).collect();
        let mut close: [Vec<(usize, Primitive)>; KINDS] = Default::default();
        // Whether so many points, found by so many pairs, are as sure to be the most as the smallest shape is to be found by all pairs.
        let is_sure = |points: f64, drawn: usize| {
            points >= LARGE && drawn as f64 * (1.0 - SOUND * points / free.len() as f64).ln() < MISSED
        };
        let (mut drawn, mut looked) = (0, false);
        while drawn < PAIRS {
            for _ in 0..DRAWN {
                self.draw(&free, &screened, random, &mut close);
            }
            drawn += DRAWN;
            // What was counted may lie all over the place: what hangs together decides, once.
            let most = close.iter().filter_map(|best| best.first()).map(|best| best.0).max().unwrap_or(0);
            if !looked && is_sure(most as f64 / screened.len() as f64 * free.len() as f64, drawn) {
                looked = true;
                let found = self.chosen(&close, &free);
                if found.as_ref().is_some_and(|found| is_sure(found.members.len() as f64, drawn)) {
                    return found;
                }
            }
        }
        self.chosen(&close, &free)
    }

    /// Draws one pair, and keeps the shapes through it that are among the best.
    fn draw(
        &self,
        free: &[usize],
        screened: &[Oriented],
        random: &mut Random,
        close: &mut [Vec<(usize, Primitive)>; KINDS],
    ) {
        let first = free[random.below(free.len())];
        let Some(second) = self.walk(first, random) else { return };
        for primitive in Primitive::through(&self.points[first], &self.points[second]).into_iter().flatten() {
            // A shape that its own surroundings contradict is none.
            let near = &self.links[first];
            let agreeing =
                near.iter().filter(|&&j| primitive.holds(&self.points[j as usize], FACING)).count();
            if 2 * agreeing < near.len() {
                continue;
            }
            let best = &mut close[primitive.kind()];
            // The last of the best, which it would have to surpass; given up as soon as it can't.
            let needed = best.get(CLOSE - 1).map_or(0, |last| last.0 + 1);
            let (mut score, mut left) = (0, screened.len());
            for some in screened.chunks(GIVEN_UP) {
                score += some.iter().filter(|o| primitive.holds(o, FACING)).count();
                left -= some.len();
                if score + left < needed {
                    break;
                }
            }
            if score >= needed {
                let place = best.partition_point(|(other, _)| *other >= score);
                best.insert(place, (score, primitive));
                best.truncate(CLOSE);
            }
        }
    }

    /// Returns the best of the shapes that were kept, grown and fitted.
    fn chosen(&self, close: &[Vec<(usize, Primitive)>; KINDS], free: &[usize]) -> Option<Candidate> {
        let points: Vec<Oriented> = free.iter().map(|&i| self.points[i]).collect();
        let count = |primitive: &Primitive| points.iter().filter(|o| primitive.holds(o, FACING)).count();
        let mut waiting: Vec<(usize, Primitive)> =
            close.iter().flatten().map(|(_, primitive)| (count(primitive), *primitive)).collect();
        waiting.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.kind().cmp(&a.1.kind())));
        // What hangs together is no more than what there is: only those are grown that may be the best.
        let mut grown: Vec<(f64, Candidate)> = Vec::new();
        for _ in 0..CLOSE {
            let best = |grown: &[(f64, Candidate)]| {
                // The most members first; of equals the simpler one.
                (0..grown.len()).max_by(|&a, &b| {
                    let kind = |i: usize| grown[i].1.primitive.kind();
                    grown[a].0.total_cmp(&grown[b].0).then(kind(b).cmp(&kind(a)))
                })
            };
            while let Some((count, primitive)) = waiting.last().copied()
                && best(&grown).is_none_or(|i| grown[i].0 <= count as f64)
            {
                waiting.pop();
                grown.extend(self.grown(primitive, free).map(|c| (self.closeness(&c), c)));
            }
            let (_, candidate) = grown.swap_remove(best(&grown)?);
            if let Some(settled) = self.settled(candidate, free)
                && self.is_no_chance(&settled, free)
            {
                return Some(self.simplest(settled, free));
            }
        }
        None
    }

    /// Returns a free point some steps away, along links between free points.
    fn walk(&self, from: usize, random: &mut Random) -> Option<usize> {
        let mut at = from;
        for _ in 0..=random.below(LONGEST_WALK) {
            let links = &self.links[at];
            let next = *links.get(random.below(links.len()))? as usize;
            if self.free[next] {
                at = next;
            }
        }
        (at != from).then_some(at)
    }

    /// Returns the shape with its largest connected group of members.
    fn grown(&self, primitive: Primitive, free: &[usize]) -> Option<Candidate> {
        let mut holds = vec![false; self.points.len()];
        for &i in free {
            holds[i] = primitive.holds(&self.points[i], FACING);
        }
        let mut largest: Vec<usize> = Vec::new();
        for &i in free {
            if !holds[i] {
                continue;
            }
            let mut group = vec![i];
            holds[i] = false;
            let mut next = 0;
            while let Some(&at) = group.get(next) {
                for &j in &self.links[at] {
                    let j = j as usize;
                    if holds[j] {
                        holds[j] = false;
                        group.push(j);
                    }
                }
                next += 1;
            }
            if group.len() > largest.len() {
                largest = group;
            }
        }
        (largest.len() >= 4 * LEAST_A_PARAMETER).then_some(Candidate { primitive, members: largest })
    }

    /// Returns the candidate fitted to its members, and to those that this brings, until there are no more.
    fn settled(&self, mut candidate: Candidate, free: &[usize]) -> Option<Candidate> {
        for _ in 0..6 {
            let points: Vec<Vector3<f64>> = candidate.members.iter().map(|&i| self.points[i].point).collect();
            let refined = candidate.primitive.refined(&points, self.resolution_mm)?;
            let next = self.grown(refined, free)?;
            if next.members.len() <= candidate.members.len() {
                return Some(if next.members.len() == candidate.members.len() { next } else { candidate });
            }
            candidate = next;
        }
        Some(candidate)
    }

    /// Returns how far normals of the members are averaged, mm.
    pub(super) fn reach(&self, members: &[usize]) -> f64 {
        median(&mut members.iter().map(|&i| self.points[i].reach).collect::<Vec<_>>())
    }

    /// Returns the number of members, each by how near it is: one for a point on the surface, none for one at its tolerance.
    fn closeness(&self, candidate: &Candidate) -> f64 {
        let share = |&i: &usize| {
            let o = &self.points[i];
            1.0 - (candidate.primitive.distance(&o.point) / o.tolerance).powi(2).min(1.0)
        };
        candidate.members.iter().map(share).sum()
    }

    /// Returns the candidate as the simplest kind that holds nearly all of its members.
    fn simplest(&self, candidate: Candidate, free: &[usize]) -> Candidate {
        let points: Vec<Vector3<f64>> = candidate.members.iter().map(|&i| self.points[i].point).collect();
        for kind in 0..candidate.primitive.kind() {
            let simpler = candidate
                .primitive
                .as_kind(kind, &points)
                .and_then(|p| p.refined(&points, self.resolution_mm));
            let simpler = simpler.and_then(|p| self.grown(p, free));
            if let Some(simpler) = simpler.and_then(|c| self.settled(c, free))
                && self.closeness(&simpler) >= AS_GOOD * self.closeness(&candidate)
            {
                return simpler;
            }
        }
        candidate
    }

    /// Returns whether points scattered at random, facing anywhere, would practically never hold to one shape in such number.
    ///
    /// A contrario (A. Desolneux, L. Moisan, J.-M. Morel, Int. J. Computer Vision 40 (2000) 7): of the n points in the ball about
    /// the members each holds by chance with probability p, the share of the ball that the shape's shell takes times that of
    /// directions near enough to the normal. The binomial tail is bounded by exp(−n D(k/n ‖ p)), and as many shapes are tried as
    /// there are pairs of points and kinds.
    fn is_no_chance(&self, candidate: &Candidate, free: &[usize]) -> bool {
        let members = candidate.members.len();
        let middle =
            candidate.members.iter().map(|&i| self.points[i].point).sum::<Vector3<f64>>() / members as f64;
        let reach2 = candidate
            .members
            .iter()
            .map(|&i| (self.points[i].point - middle).norm_squared())
            .fold(0.0, f64::max);
        let around = free
            .iter()
            .filter(|&&i| (self.points[i].point - middle).norm_squared() <= reach2)
            .count()
            .max(members);
        let tolerance =
            candidate.members.iter().map(|&i| self.points[i].tolerance).sum::<f64>() / members as f64;
        let share = shell_share(&candidate.primitive, &middle, reach2.sqrt(), tolerance) * (1.0 - FACING);
        let k = members as f64 / around as f64;
        if k <= share {
            return false;
        }
        let term = |a: f64, b: f64| if a > 0.0 { a * (a / b).ln() } else { 0.0 };
        let divergence = term(k, share) + term(1.0 - k, 1.0 - share);
        let tests = 2.0 * (free.len() as f64).ln() + (KINDS as f64).ln();
        tests - around as f64 * divergence < FALSE_ALARMS
    }
}

/// Returns the share of a ball's volume within a distance of a surface, on a lattice, of which the shape is never missed.
fn shell_share(primitive: &Primitive, middle: &Vector3<f64>, reach: f64, tolerance: f64) -> f64 {
    const HALF: i32 = 6;
    let step = reach / f64::from(HALF);
    let (mut inside, mut near) = (0.0_f64, 0.0_f64);
    for i in -HALF..=HALF {
        for j in -HALF..=HALF {
            for k in -HALF..=HALF {
                let offset = Vector3::new(f64::from(i), f64::from(j), f64::from(k)) * step;
                if offset.norm_squared() <= reach * reach {
                    inside += 1.0;
                    // A cell counts by how much of its width the shell takes.
                    let distance = primitive.distance(&(middle + offset)).abs();
                    let overlap = (0.5 * step + tolerance - distance).clamp(0.0, step.min(2.0 * tolerance));
                    near += if step > 0.0 { overlap / step } else { 1.0 };
                }
            }
        }
    }
    (near / inside.max(1.0)).clamp(1e-12, 1.0 - 1e-9)
}
