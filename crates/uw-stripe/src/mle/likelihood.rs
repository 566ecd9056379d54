//! The likelihood of some lines side by side: its gradient, its information, and the way to its maximum.

#![allow(clippy::needless_range_loop, reason = "indices read as in the formulas")]

use super::dense::Symmetric;
use super::pixels::Pixels;
use super::problem::{Prior, Problem};
use super::wide::{Mask, V, WIDE, exp, gather, mills, normal};
use super::{CENTRE, DAMPING, DEGREE, FLUX, LEVEL, LN_WIDTH, Weights};
use fearless_simd::{Select, Simd, SimdBase, SimdFloat, SimdMask};
use std::ops::Range;

/// Beyond so many widths from the centre there is no stripe: less than 1e-7 of its height.
const STRIPE_WIDTHS: f64 = 5.7;
/// Step of the centre, in widths, and of ln width, below which the iteration has settled.
const SETTLED: f64 = 3e-4;
/// Steps are cut to these: centre in widths, ln width, so that a bad start cannot throw the fit off its candidate.
const LONGEST_STEP: [f64; 2] = [0.7, 0.35];

/// Lines in one window each, with their noise and what is known beforehand.
pub(super) struct Group<'a, S: Simd> {
    simd: S,
    pixels: &'a Pixels,
    noise: Weights,
    /// Place of the first pixel, and origin and reciprocal half-length of the background's polynomials, px.
    first: V<S>,
    pub pivot: V<S>,
    per_unit: V<S>,
    /// First pixel in use and the one after the last, as places; and the rows where any line has one.
    used: [V<S>; 2],
    pub rows: Range<usize>,
    prior: [V<S>; 5],
}

/// The stripe's share of a pixel, and its derivatives.
pub(super) struct Profile<S: Simd> {
    pub signal: V<S>,
    /// By centre, flux and ln width.
    pub gradient: [V<S>; LEVEL],
    /// By the third Hermite coefficient.
    pub by_skew: V<S>,
}

/// What a pixel says at some parameters.
pub(super) struct Term<S: Simd> {
    /// The stripe's light that is expected, and all light, DN.
    pub signal: V<S>,
    pub level: V<S>,
    pub residual: V<S>,
    pub variance: V<S>,
    /// Whether it is in use.
    pub used: Mask<S>,
    /// Derivative of the log likelihood by the expected value, and its information; both 0 for one that is not in use.
    pub score: V<S>,
    pub information: V<S>,
}

/// A stripe's place and form.
pub(super) struct Form<S: Simd> {
    centre: V<S>,
    flux: V<S>,
    /// Reciprocal width.
    inverse: V<S>,
    reach: V<S>,
    /// Density and distribution at the right edge of the pixel before.
    left: Option<(V<S>, V<S>)>,
}

impl<S: Simd> Form<S> {
    #[inline(always)]
    pub fn of<const N: usize>(simd: S, at: &[V<S>; N]) -> Self {
        let width = exp(simd, at[LN_WIDTH]);
        let inverse = V::splat(simd, 1.0) / width;
        Self { centre: at[CENTRE], flux: at[FLUX], inverse, reach: width * STRIPE_WIDTHS + 0.5, left: None }
    }

    /// The stripe in the pixels at `place`, which follow on the ones of the last call; `None` where it reaches none of them.
    #[inline(always)]
    pub fn profile(&mut self, simd: S, place: V<S>) -> Option<Profile<S>> {
        let x = place - self.centre;
        let near = x.abs().simd_lt(self.reach);
        if !near.any_true() {
            self.left = None;
            return None;
        }
        let low = (x - 0.5) * self.inverse;
        let high = (x + 0.5) * self.inverse;
        // The edge between two pixels has one place, whichever it is worked out from: places and halves are exact. So a line's bits do not
        // depend on whether one beside it had the pixel before.
        let (density_low, below_low) = match self.left {
            Some(left) => left,
            None => normal(simd, low),
        };
        let (density_high, below_high) = normal(simd, high);
        self.left = Some((density_high, below_high));
        let none = V::splat(simd, 0.0);
        let share = near.select(below_high - below_low, none);
        let flux = near.select(self.flux, none);
        let skewed = (high * high - 1.0) * density_high - (low * low - 1.0) * density_low;
        Some(Profile {
            signal: flux * share,
            gradient: [
                -flux * (density_high - density_low) * self.inverse,
                share,
                -flux * (high * density_high - low * density_low),
            ],
            by_skew: flux * (-1.0 / 6.0) * skewed,
        })
    }
}

impl<'a, S: Simd> Group<'a, S> {
    /// The lines of some problems, whose windows are in `pixels` and in use; `pivot` is the origin of the background's polynomials.
    #[inline(always)]
    pub fn new(simd: S, problems: [&Problem; WIDE], pivot: V<S>, pixels: &'a Pixels, noise: Weights) -> Self {
        let each = |of: fn(&Prior) -> f64| gather(simd, |lane| of(&problems[lane].prior));
        let mut group = Self {
            simd,
            pixels,
            noise,
            first: pixels.first.load(simd),
            pivot,
            per_unit: V::splat(simd, 1.0) / gather(simd, |lane| problems[lane].unit),
            used: [V::splat(simd, 0.0); 2],
            rows: 0..0,
            prior: [
                each(|p| p.level),
                each(|p| p.level_weight),
                each(|p| p.slope_weight),
                each(|p| p.ln_width),
                each(|p| p.ln_width_weight),
            ],
        };
        group.use_pixels(problems.map(|p| &p.window));
        group
    }

    /// Uses these pixels of each line from here on.
    pub fn use_pixels(&mut self, windows: [&Range<usize>; WIDE]) {
        let row = |place: usize, lane: usize| place.saturating_sub(self.pixels.first.0[lane] as usize);
        let ends = |lane: usize| (row(windows[lane].start, lane), row(windows[lane].end, lane));
        let (start, end) = (0..WIDE)
            .map(ends)
            .fold((usize::MAX, 0), |(start, end), (from, to)| (start.min(from), end.max(to)));
        self.rows = start..end.min(self.pixels.value.len());
        self.used = [
            gather(self.simd, |lane| windows[lane].start as f64),
            gather(self.simd, |lane| windows[lane].end as f64),
        ];
    }

    #[inline(always)]
    pub fn none(&self) -> V<S> {
        V::splat(self.simd, 0.0)
    }

    /// The pixels of row `p`, as places on their lines.
    #[inline(always)]
    pub fn place(&self, p: usize) -> V<S> {
        self.first + p as f64
    }

    /// T₀, T₁, … at the place, up to `degree`.
    #[inline(always)]
    pub fn polynomials(&self, place: V<S>, degree: usize, polynomials: &mut [V<S>; 2 * DEGREE + 1]) {
        // T₂ₖ = 2 Tₖ² − 1 and T₂ₖ₊₁ = 2 Tₖ Tₖ₊₁ − T₁: few wait for each other.
        let t = (place - self.pivot) * self.per_unit;
        polynomials[0] = V::splat(self.simd, 1.0);
        polynomials[1] = t;
        for k in 2..=degree {
            let product = polynomials[k / 2] * polynomials[k.div_ceil(2)];
            polynomials[k] = product + product - polynomials[k % 2];
        }
    }

    /// The background with the coefficients of `at`.
    #[inline(always)]
    pub fn background<const N: usize>(at: &[V<S>; N], polynomials: &[V<S>]) -> V<S> {
        let mut sum = at[LEVEL];
        for k in LEVEL + 1..N {
            sum += at[k] * polynomials[k - LEVEL];
        }
        sum
    }

    /// The stripe in the pixels of row `p`, at `place` and with the polynomials there, and what they say at the parameters `at`.
    #[inline(always)]
    pub fn pixel<const N: usize>(
        &self,
        p: usize,
        place: V<S>,
        polynomials: &[V<S>],
        at: &[V<S>; N],
        form: &mut Form<S>,
    ) -> (Option<Profile<S>>, Term<S>) {
        let (simd, none) = (self.simd, self.none());
        let background = Self::background(at, polynomials);
        let profile = form.profile(simd, place);
        let signal = profile.as_ref().map_or(none, |profile| profile.signal);
        let value = signal + background;
        let mut level = value;
        if let Some([light, _]) = self.pixels.known.get(p) {
            level += light.load(simd);
        }
        let lit = level.simd_lt(none).select(none, level);
        let mut variance =
            lit * self.noise.per_level + signal * signal * self.noise.per_square + self.noise.dark;
        if let Some([_, known]) = self.pixels.known.get(p) {
            variance += known.load(simd);
        }
        let residual = self.pixels.value[p].load(simd) - value;
        let weight = V::splat(simd, 1.0) / variance;
        let (mut score, mut information) = (residual * weight, weight);
        let [full, floor] = self.pixels.clip[p];
        if full | floor != 0 {
            // One says only that the light was beyond half a DN from the clip.
            let mask = |bits: u8| Mask::from_bitmask(simd, u64::from(bits));
            let (one, full, clipped) = (V::splat(simd, 1.0), mask(full), mask(full | floor));
            let per_sigma = variance.sqrt() * weight;
            let z = (full.select(-residual, residual) + 0.5) * per_sigma;
            let m = mills(simd, z);
            let slope = m * (m + z);
            let slope = slope.simd_gt(1.0).select(one, slope.simd_lt(0.0).select(none, slope));
            score = clipped.select(full.select(m, -m) * per_sigma, score);
            information = clipped.select(slope * weight, information);
        }
        let used = place.simd_ge(self.used[0]) & place.simd_lt(self.used[1]);
        let (score, information) = (used.select(score, none), used.select(information, none));
        (profile, Term { signal, level, residual, variance, used, score, information })
    }

    /// Fisher information and score of the parameters; those of a line beyond its own `sizes` are held where they are.
    #[inline(always)]
    pub fn normal_equations<const N: usize>(
        &self,
        at: &[V<S>; N],
        sizes: V<S>,
    ) -> (Symmetric<V<S>, N>, [V<S>; N]) {
        // A function of its own in the processor's instructions, not a copy wherever it is called.
        self.simd.vectorize(
            #[inline(always)]
            || self.normal_equations_here(at, sizes),
        )
    }

    #[inline(always)]
    fn normal_equations_here<const N: usize>(
        &self,
        at: &[V<S>; N],
        sizes: V<S>,
    ) -> (Symmetric<V<S>, N>, [V<S>; N]) {
        let (simd, none) = (self.simd, self.none());
        // Tᵢ Tⱼ = (Tᵢ₊ⱼ + T|ᵢ₋ⱼ|) / 2: sums over single polynomials give all of the background's block.
        let mut sums = [none; 2 * DEGREE + 1];
        let degree = N - 1 - LEVEL;
        let mut polynomials = [none; 2 * DEGREE + 1];
        let (mut stripe, mut score) = ([[none; N]; LEVEL], [none; N]);
        let mut form = Form::of(simd, at);
        for p in self.rows.clone() {
            let place = self.place(p);
            self.polynomials(place, 2 * degree, &mut polynomials);
            let (profile, term) = self.pixel(p, place, &polynomials, at, &mut form);
            for k in 0..=2 * degree {
                sums[k] += term.information * polynomials[k];
            }
            for k in LEVEL..N {
                score[k] += term.score * polynomials[k - LEVEL];
            }
            if let Some(Profile { gradient, .. }) = profile {
                for r in 0..LEVEL {
                    let weighted = term.information * gradient[r];
                    score[r] += term.score * gradient[r];
                    for c in 0..=r {
                        stripe[c][r] += weighted * gradient[c];
                    }
                    for c in LEVEL..N {
                        stripe[r][c] += weighted * polynomials[c - LEVEL];
                    }
                }
            }
        }
        let mut information = Symmetric([[none; N]; N]);
        for r in 0..N {
            let (mean, weight) = self.known(r);
            let free = sizes.simd_gt(r as f64);
            score[r] = free.select(score[r] + weight * (mean - at[r]), none);
            for c in 0..r {
                let entry =
                    if c < LEVEL { stripe[c][r] } else { (sums[r + c - 2 * LEVEL] + sums[r - c]) * 0.5 };
                information.0[r][c] = free.select(entry, none);
            }
            let own = if r < LEVEL { stripe[r][r] } else { (sums[2 * (r - LEVEL)] + sums[0]) * 0.5 };
            information.0[r][r] = free.select(own + weight, V::splat(simd, 1.0));
        }
        (information, score)
    }

    /// Mean and inverse variance of what is known beforehand of parameter `k`.
    #[inline(always)]
    pub fn known(&self, k: usize) -> (V<S>, V<S>) {
        let [level, level_weight, slope_weight, ln_width, ln_width_weight] = self.prior;
        match k {
            LN_WIDTH => (ln_width, ln_width_weight),
            LEVEL => (level, level_weight),
            k if k == LEVEL + 1 => (self.none(), slope_weight),
            k if k > LEVEL => (self.none(), level_weight),
            _ => (self.none(), self.none()),
        }
    }

    /// Moves `at` towards the maximum of the likelihood, in `rounds.0` iterations at most; tells where it settled there, and takes those out of
    /// `alive` where it ran away. For the first `rounds.1` the background's origin follows the centre.
    #[inline(always)]
    pub fn iterate<const N: usize>(
        &mut self,
        at: &mut [V<S>; N],
        sizes: V<S>,
        rounds: (usize, usize),
        alive: &mut Mask<S>,
    ) -> Mask<S> {
        let mut settled = Mask::splat(self.simd, false);
        for round in 0..rounds.0 {
            let active = *alive & !settled;
            if !active.any_true() {
                break;
            }
            let (information, mut step) = self.normal_equations(at, sizes);
            information.factor(DAMPING).solve(&mut step);
            let width = exp(self.simd, at[LN_WIDTH]);
            let one = V::splat(self.simd, 1.0);
            let by_centre = step[CENTRE].abs() / (width * LONGEST_STEP[0]);
            let by_width = step[LN_WIDTH].abs() / LONGEST_STEP[1];
            let longest = by_width.simd_gt(by_centre).select(by_width, by_centre);
            let cut = longest.simd_gt(1.0);
            let share = cut.select(one / longest, one);
            let least = at[FLUX] * 0.5;
            let mut sum = self.none();
            for k in 0..N {
                let next = at[k] + step[k] * share;
                at[k] = active.select(next, at[k]);
                sum += next * 0.0;
            }
            // Flux stays positive: halfway down at most.
            at[FLUX] = (active & at[FLUX].simd_lt(least)).select(least, at[FLUX]);
            *alive &= !active | sum.simd_eq(0.0);
            let near =
                step[CENTRE].abs().simd_lt(width * SETTLED) & step[LN_WIDTH].abs().simd_lt(SETTLED * 10.0);
            let done = active & near & !cut;
            settled |= done;
            if round < rounds.1 {
                self.pivot = (active & !done).select(at[CENTRE], self.pivot);
            }
        }
        settled & *alive
    }
}
