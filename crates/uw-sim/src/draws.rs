//! Numbers that a seed draws.

use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};

/// Normal numbers in a fixed order from a seed, the same on every machine: what a real instrument differs by from its drawing.
#[derive(Debug)]
pub struct Draws(Option<Xoshiro256PlusPlus>);

/// Draws are cut off at this many standard deviations: an instrument that was built lies near its drawing.
const CUT: f64 = 2.0;

impl Draws {
    /// The draws of a seed; without one all are zero.
    pub fn new(seed: Option<u64>) -> Self {
        Self(seed.map(Xoshiro256PlusPlus::seed_from_u64))
    }

    /// The next: a normal number of this standard deviation, cut off at twice that.
    pub fn next(&mut self, sigma: f64) -> f64 {
        let Some(random) = &mut self.0 else { return 0.0 };
        // Twelve uniform numbers less six: mean 0, variance 1, and no function whose last digit differs between machines.
        let sum: f64 = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        sigma * sum.clamp(-CUT, CUT)
    }
}
