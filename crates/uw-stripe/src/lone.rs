//! Pixels that stand alone on their line: hot and dead ones, and grains in the water that are smaller than the stripe is wide.
//!
//! A hot pixel outshines a faint stripe, and one beside the stripe pulls at its centre. No stripe lights a pixel so much more than both beside
//! it, and none leaves one so dark between them.

use crate::NoiseModel;
use crate::special::normal;

/// Sigmas of a grey value by which a pixel must stand alone: twice in a million by noise.
const SIGMAS: f32 = 5.0;
/// Width of the narrowest stripe that is left alone, by the usual one's.
const NARROWEST: f64 = 0.5;

/// How far a pixel must stand alone.
#[derive(Debug)]
pub(crate) struct Lone {
    /// Largest ratio, above nothing, of a stripe's grey value to the larger one beside it.
    ratio: f32,
    /// Variance of a grey value by a sigma's square: that of none, DN², and what each DN adds.
    dark: f32,
    shot: f32,
}

impl Lone {
    /// For a stripe of this width, px, in that noise.
    pub fn new(noise: &NoiseModel, width_px: f64) -> Self {
        let width = NARROWEST * width_px;
        // Light of a pixel on which a stripe is centred, and of the next one.
        let inner = normal(0.5 / width).1;
        let outer = normal(1.5 / width).1;
        Self {
            ratio: ((2.0 * inner - 1.0) / (outer - inner)) as f32,
            dark: SIGMAS * SIGMAS * noise.variance(0.0, 0.0) as f32,
            shot: SIGMAS * SIGMAS / noise.gain_e_per_dn,
        }
    }

    /// Whether the middle one of three grey values is more, or less, than a stripe could make it between the others, DN; `beneath` them light was taken off
    /// that left its noise.
    pub fn is(&self, [before, here, after]: [f32; 3], beneath: f32) -> bool {
        let (low, high) = (before.min(after), before.max(after));
        let beyond = |level: f32| (self.dark + (level.max(0.0) + beneath) * self.shot).sqrt();
        here - self.ratio * high.max(0.0) > beyond(high) || low - self.ratio * here.max(0.0) > beyond(low)
    }

    /// Whether some pixel of a line may be one: without a root and an early end, so that many are asked at a time.
    pub fn may_be(&self, line: &[f32]) -> bool {
        let least = self.least();
        let asked = line.iter().zip(line.get(1..).unwrap_or(&[])).zip(line.get(2..).unwrap_or(&[]));
        asked.fold(false, |any, ((before, here), after)| {
            let (low, high) = (before.min(*after), before.max(*after));
            any | (here - self.ratio * high.max(0.0) > least) | (low - self.ratio * here.max(0.0) > least)
        })
    }

    /// Difference that any of them has, DN.
    pub fn least(&self) -> f32 {
        self.dark.sqrt()
    }
}

/// Leaves of some pixels, line and place along it in order, those that have no company: what stands alone about there on the next line as well is a
/// stripe, narrower than was thought.
pub(crate) fn without_company(places: &mut Vec<(usize, usize)>) {
    /// Pixels that a stripe moves from a line to the next.
    const STEP: usize = 3;
    let beside = |(line, at): (usize, usize), (other, there): (usize, usize)| {
        line.abs_diff(other) == 1 && at.abs_diff(there) <= STEP
    };
    let close = |a: &(usize, usize), b: &(usize, usize)| a.0.abs_diff(b.0) <= 1;
    let alone: Vec<bool> = (0..places.len())
        .map(|i| {
            let before = places[..i].iter().rev().take_while(|p| close(p, &places[i]));
            let after = places[i + 1..].iter().take_while(|p| close(p, &places[i]));
            !before.chain(after).any(|p| beside(places[i], *p))
        })
        .collect();
    let mut alone = alone.iter();
    places.retain(|_| alone.next().is_some_and(|a| *a));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_of_lone_pixels_is_a_stripe() {
        let mut places = vec![(0, 50), (3, 20), (3, 80), (4, 21), (5, 60), (6, 23), (7, 25), (9, 26)];
        without_company(&mut places);
        assert_eq!(places, [(0, 50), (3, 80), (5, 60), (9, 26)]);
    }
}
