//! The points so far, for clients that come late: bounded, thinned when it is full.

/// Most points that are kept: 64 MiB.
pub const MOST: usize = 1 << 22;
/// Bits of an epoch below those that count scans: the density, of the store and of the client.
const DENSITY_BITS: u32 = 4;
/// Coarsest density of a client: every 2¹⁵th point.
pub const COARSEST: u32 = (1 << DENSITY_BITS) - 1;

/// A point, camera frame, mm, and its brightness as a share of 255.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// x, y, z, mm.
    pub position_mm: [f32; 3],
    /// 0 to 255.
    pub brightness: u8,
}

/// Points in the order in which they were made.
#[derive(Debug)]
pub struct Cloud {
    generation: u32,
    points: Vec<Point>,
    /// One of 2ⁿ points that came is kept.
    kept: u32,
    /// Points that came.
    came: u64,
    most: usize,
}

impl Cloud {
    /// Empty; `generation` tells it from those of other runs.
    pub fn new(generation: u32) -> Self {
        Self::with_room(generation, MOST)
    }

    /// Empty, for at most so many points.
    pub fn with_room(generation: u32, most: usize) -> Self {
        Self { generation, points: Vec::new(), kept: 0, came: 0, most: most.max(2) }
    }

    /// Empties it: what clients have is another cloud's from now on.
    pub fn restart(&mut self) {
        self.generation = self.generation.wrapping_add(1);
        (self.points, self.kept, self.came) = (Vec::new(), 0, 0);
    }

    /// Takes points; when there is no more room, every other one of all is left out, and clients begin anew.
    pub fn extend(&mut self, points: impl IntoIterator<Item = Point>) {
        for point in points {
            let wanted = self.came.is_multiple_of(1 << self.kept);
            self.came += 1;
            if !wanted {
                continue;
            }
            if self.points.len() == self.most {
                let mut at = 0;
                self.points.retain(|_| {
                    at += 1;
                    at % 2 == 1
                });
                self.kept += 1;
                self.generation = self.generation.wrapping_add(1);
                if !(self.came - 1).is_multiple_of(1 << self.kept) {
                    continue;
                }
            }
            self.points.push(point);
        }
    }

    /// Points that are kept.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// What a client that gets every 2^`density`th point knows this cloud by.
    pub fn epoch(&self, density: u32) -> u32 {
        (self.generation << DENSITY_BITS) | density.min(COARSEST)
    }

    /// The density of a client that has `epoch`; `None` where that is not of this cloud.
    pub fn density_of(&self, epoch: u32) -> Option<u32> {
        let density = epoch & COARSEST;
        (self.epoch(density) == epoch).then_some(density)
    }

    /// How many points there are at a density.
    pub fn count(&self, density: u32) -> u64 {
        self.points.len().div_ceil(1 << density.min(COARSEST)) as u64
    }

    /// At most `most` points of a density from the `first`th on.
    pub fn part(&self, density: u32, first: u64, most: usize) -> Vec<Point> {
        let step = 1_usize << density.min(COARSEST);
        let from = usize::try_from(first).ok().and_then(|first| first.checked_mul(step));
        let tail = from.and_then(|from| self.points.get(from..)).unwrap_or_default();
        tail.iter().step_by(step).take(most).copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbered(range: std::ops::Range<u32>) -> impl Iterator<Item = Point> {
        range.map(|i| Point { position_mm: [i as f32, 0.0, 0.0], brightness: 0 })
    }

    fn numbers(points: &[Point]) -> Vec<u32> {
        points.iter().map(|point| point.position_mm[0] as u32).collect()
    }

    #[test]
    fn parts_follow_each_other_at_every_density() {
        let mut cloud = Cloud::new(7);
        cloud.extend(numbered(0..1000));
        for density in 0..5 {
            let step = 1 << density;
            let mut got = Vec::new();
            while (got.len() as u64) < cloud.count(density) {
                got.extend(numbers(&cloud.part(density, got.len() as u64, 33)));
            }
            assert_eq!(got, (0..1000).step_by(step).collect::<Vec<u32>>());
            assert!(cloud.part(density, got.len() as u64, 33).is_empty());
            assert_eq!(cloud.density_of(cloud.epoch(density)), Some(density));
        }
        assert!(cloud.part(0, u64::MAX, 1).is_empty());
    }

    #[test]
    fn a_full_cloud_is_thinned_evenly_and_is_another_one() {
        let mut cloud = Cloud::with_room(0, 100);
        cloud.extend(numbered(0..100));
        let whole = cloud.epoch(0);
        cloud.extend(numbered(100..1000));
        assert_eq!(cloud.density_of(whole), None);
        assert_eq!(numbers(&cloud.part(0, 0, 1000)), (0..1000).step_by(16).collect::<Vec<u32>>());
        let thinned = cloud.epoch(0);
        cloud.restart();
        assert!(cloud.is_empty() && cloud.density_of(thinned).is_none());
        cloud.extend(numbered(0..3));
        assert_eq!(cloud.len(), 3);
    }
}
