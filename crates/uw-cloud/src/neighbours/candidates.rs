//! Points near a leaf's middle, and which of them are nearest to each of the leaf's points.

use super::{Near, ROUNDED_UP, Site, square};

/// Rings of one area about a leaf's middle, in whose order candidates lie.
const RINGS: usize = 32;

/// Equal parts of squared distances, among which the last neighbour's is looked for: of points on a surface each has as many.
const PARTS: usize = 64;

/// Returns the nearest of the numbers from nought to 63 to a number that is no larger, and nought for what is no number: in two instructions, by where a large number's digits end.
#[inline]
fn rounded(number: f64) -> usize {
    const ENDS_AT_ONE: f64 = (1_u64 << 52) as f64;
    ((number + ENDS_AT_ONE).to_bits() & 63) as usize
}

/// Points near a leaf's middle, by rings about it; coordinates side by side, so that several distances are taken at once.
#[derive(Default)]
pub(super) struct Candidates {
    /// What was gathered.
    pub all: Vec<Site>,
    rings: Vec<u8>,
    coordinates: [Vec<f64>; 3],
    indices: Vec<u32>,
    /// Where each ring ends.
    ends: Vec<usize>,
    rings_by_distance2: f64,
    /// Squared distances from the place that was asked for last.
    distances2: Vec<f64>,
    /// Those that come into question, with their slots, and those that may be the last of the nearest.
    close: Vec<(f64, u32)>,
    last: Vec<Near>,
    /// The nearest to it, as (squared distance, slot), in no order.
    pub found: Vec<(f64, u32)>,
}

impl Candidates {
    pub fn len(&self) -> usize {
        self.ends.get(RINGS - 1).copied().unwrap_or(0)
    }

    pub fn at(&self, slot: u32) -> [f64; 3] {
        let ([xs, ys, zs], slot) = (&self.coordinates, slot as usize);
        [xs[slot], ys[slot], zs[slot]]
    }

    /// The ring that a squared distance from the middle lies in; one more than there are of what lies beyond.
    #[inline]
    fn ring(distance2: f64, rings_by_distance2: f64) -> usize {
        let ring = distance2 * rings_by_distance2;
        rounded(if ring > RINGS as f64 { RINGS as f64 } else { ring })
    }

    /// Puts what was gathered in the order of rings, and leaves out what is not within reach of a middle.
    pub fn arrange(&mut self, middle: &[f64; 3], reach: f64) {
        // Half a ring less, for rounding; infinite where all are in one place, and they in the first ring, as nought times that is no number.
        let scale = (RINGS as f64 - 0.5) / (reach * reach);
        self.rings_by_distance2 = scale;
        let mut starts = [0; RINGS + 2];
        self.rings.clear();
        self.rings.extend(self.all.iter().map(|site| Self::ring(square(&site.at, middle), scale) as u8));
        self.rings.iter().for_each(|&ring| starts[usize::from(ring) + 1] += 1);
        (0..=RINGS).for_each(|ring| starts[ring + 1] += starts[ring]);
        self.ends.clear();
        self.ends.extend(&starts[1..=RINGS]);
        let count = self.all.len();
        let [xs, ys, zs] = &mut self.coordinates;
        for list in [&mut *xs, &mut *ys, &mut *zs] {
            list.resize(count, 0.0);
        }
        self.indices.resize(count, 0);
        let (xs, ys, zs, indices) =
            (&mut xs[..count], &mut ys[..count], &mut zs[..count], &mut self.indices[..count]);
        for (site, &ring) in self.all.iter().zip(&self.rings) {
            let next = &mut starts[usize::from(ring)];
            let slot = *next;
            *next += 1;
            [xs[slot], ys[slot], zs[slot]] = site.at;
            indices[slot] = site.index;
        }
    }

    /// Returns within what distance of the middle there are so many; `None` where there are not.
    pub fn radius_of(&self, count: usize) -> Option<f64> {
        let ring = self.ends.iter().position(|end| *end >= count)?;
        Some(((ring as f64 + 0.5) / self.rings_by_distance2).sqrt() * ROUNDED_UP)
    }

    /// Finds the `count` candidates nearest to a place, which are all within a bound of it, and within another one of the middle.
    pub fn nearest(&mut self, place: &[f64; 3], count: usize, bound: f64, of_middle: f64) {
        let end = self.ends[Self::ring(of_middle * of_middle, self.rings_by_distance2).min(RINGS - 1)];
        let [xs, ys, zs] = self.coordinates.each_ref().map(|list| &list[..end]);
        self.distances2.clear();
        let places = xs.iter().zip(ys).zip(zs);
        self.distances2.extend(places.map(|((x, y), z)| square(&[*x, *y, *z], place)));
        // Each is written where the next one that is near enough belongs: no branch has to be guessed.
        let bound2 = bound * bound;
        self.close.resize(end, (0.0, 0));
        let mut close = 0;
        for (&distance2, slot) in self.distances2.iter().zip(0..) {
            self.close[close] = (distance2, slot);
            close += usize::from(distance2 <= bound2);
        }
        let close = &self.close[..close];
        self.found.clear();
        if close.len() <= count {
            return self.found.extend_from_slice(close);
        }
        let scale = (PARTS - 1) as f64 / bound2;
        let mut counts = [0_u32; PARTS];
        close.iter().for_each(|(distance2, _)| counts[rounded(distance2 * scale)] += 1);
        let (mut last, mut nearer) = (0, 0);
        while last < PARTS - 1 && nearer + (counts[last] as usize) < count {
            nearer += counts[last] as usize;
            last += 1;
        }
        self.last.clear();
        self.found.resize(close.len(), (0.0, 0));
        let mut found = 0;
        for &(distance2, slot) in close {
            let own = rounded(distance2 * scale);
            self.found[found] = (distance2, slot);
            found += usize::from(own < last);
            if own == last {
                self.last.push(Near { distance2, index: self.indices[slot as usize], slot });
            }
        }
        self.found.truncate(found);
        let more = count - found;
        if more < self.last.len() {
            self.last.select_nth_unstable_by(more - 1, Near::order);
        }
        self.found.extend(self.last[..more].iter().map(|near| (near.distance2, near.slot)));
    }
}
