//! Pixels that stand alone on their line: hot and dead ones, and grains in the water that are smaller than the stripe is wide.
//!
//! A hot pixel outshines a faint stripe, and one beside the stripe pulls at its centre. No stripe lights a pixel so much more than both beside
//! it, and none leaves one so dark between them.

use crate::NoiseModel;
use crate::engine::fir::profile;

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
        Self {
            // Of a stripe centred on a pixel to the next one.
            ratio: (profile(0.0, 0.0, width).0 / profile(1.0, 0.0, width).0) as f32,
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

/// Leaves of some pixels, line and place along it in order, those that are not of a run of three at least on lines that follow each other or the next but
/// one: what stands alone there again and again is a stripe, narrower than was thought.
pub(crate) fn without_runs(places: &mut Vec<(usize, usize)>) {
    /// Lines to the next of a run, and pixels that a stripe moves a line.
    const REACH: usize = 2;
    const STEP: usize = 3;
    let joins = |i: usize, j: usize| {
        let lines = places[i].0.abs_diff(places[j].0);
        (1..=REACH).contains(&lines) && places[i].1.abs_diff(places[j].1) <= STEP * lines
    };
    let near = |i: usize, j: &usize| places[i].0.abs_diff(places[*j].0) <= REACH;
    let before = |i: usize| (0..i).rev().take_while(move |j| near(i, j)).find(move |j| joins(i, *j));
    let after = |i: usize| (i + 1..places.len()).take_while(move |j| near(i, j)).find(move |j| joins(i, *j));
    let mut run = vec![false; places.len()];
    for i in 0..places.len() {
        if let (Some(before), Some(after)) = (before(i), after(i)) {
            [before, i, after].into_iter().for_each(|k| run[k] = true);
        }
    }
    let mut run = run.iter();
    places.retain(|_| run.next().is_some_and(|r| !*r));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_of_lone_pixels_is_a_stripe() {
        let mut places =
            vec![(0, 50), (1, 52), (3, 20), (3, 80), (4, 21), (5, 60), (5, 23), (6, 25), (9, 26)];
        places.sort_unstable();
        without_runs(&mut places);
        assert_eq!(places, [(0, 50), (1, 52), (3, 80), (5, 60), (9, 26)]);
    }
}
