//! Candidates: where on a line something stands out of its surroundings like a stripe.

use fearless_simd::{Level, Select, Simd, SimdBase, SimdMask, SimdWiden, dispatch, f32x16, f64x8};

use crate::NoiseModel;
use crate::lines::Line;

/// Candidates kept a line.
pub(crate) const KEPT: usize = 4;

/// A stripe-like peak.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Candidate {
    /// Centre of the best box, pixels from the start of the line.
    pub centre: usize,
    /// Pixels of the box that fits best.
    pub scale: usize,
    /// Contrast of the box in units of its noise.
    pub snr: f32,
    /// Light in the box above its surroundings, DN · px.
    pub flux: f32,
    /// Mean of the surroundings, DN.
    pub background: f32,
}

/// The strongest candidates of a line, by flux in falling order.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Candidates {
    items: [Candidate; KEPT],
    len: usize,
}

impl Candidates {
    /// The candidates.
    pub fn as_slice(&self) -> &[Candidate] {
        &self.items[..self.len]
    }

    /// The same with those within `reach` px of a stronger one taken as parts of it.
    pub fn gathered(&self, reach: f64) -> Self {
        if reach <= 0.0 || self.len < 2 {
            return *self;
        }
        let mut wholes = [Candidate::default(); KEPT];
        let (mut moments, mut count) = ([0.0; KEPT], 0);
        for part in self.as_slice() {
            let moment = f64::from(part.flux) * part.centre as f64;
            // The strongest of each whole came first.
            let whole = (0..count).find(|k| wholes[*k].centre.abs_diff(part.centre) as f64 <= reach);
            if let Some(k) = whole {
                wholes[k].flux += part.flux;
                wholes[k].scale = wholes[k].scale.max(reach as usize);
                moments[k] += moment;
            } else {
                (wholes[count], moments[count]) = (*part, moment);
                count += 1;
            }
        }
        let mut out = Self::default();
        for (mut whole, moment) in wholes.into_iter().zip(moments).take(count) {
            whole.centre = (moment / f64::from(whole.flux)).round() as usize;
            out.push(whole);
        }
        out
    }

    pub fn push(&mut self, c: Candidate) {
        let at = self.as_slice().iter().position(|o| c.flux > o.flux).unwrap_or(self.len);
        if at < KEPT {
            self.len = (self.len + 1).min(KEPT);
            self.items.copy_within(at..self.len - 1, at + 1);
            self.items[at] = c;
        }
    }
}

/// Pixels of a block of which only the highest value is looked at first.
const BLOCK: usize = 16;

/// Reused buffers of the search.
#[derive(Debug)]
pub(crate) struct Search {
    level: Level,
    /// Sum of the pixels before each, and of all.
    sums: Vec<f64>,
    /// Highest value of each block and of those within `reach` blocks, and the lowest of all.
    highest: Vec<f32>,
    reach: usize,
    lowest: f32,
    /// Places where a box of the length at hand may be a candidate.
    places: Vec<usize>,
    /// The best box on each pixel; none but those at `hits` holds one.
    best: Vec<Candidate>,
    hits: Vec<usize>,
}

impl Search {
    pub fn new(level: Level) -> Self {
        Self {
            level,
            sums: Vec::new(),
            highest: Vec::new(),
            reach: 0,
            lowest: 0.0,
            places: Vec::new(),
            best: Vec::new(),
            hits: Vec::new(),
        }
    }

    /// Looks for candidates above `least_snr` that `widest` pixels' boxes can hold.
    ///
    /// Box Laplacian of Gaussian: mean of a box minus mean of the boxes of the same length on either side, at lengths
    /// 3, 5, 9, 17, …; its noise from the model at the surroundings' level, so that haze raises the threshold where it
    /// is. A step of brightness answers on one side only, so the box must stand out of both sides.
    pub fn candidates(
        &mut self,
        line: Line<'_>,
        noise: &NoiseModel,
        widest: usize,
        least_snr: f32,
    ) -> Candidates {
        let mut found = Candidates::default();
        self.each(line, noise, widest, least_snr, |c| found.push(c));
        found
    }

    /// The same, every one of them.
    pub fn each(
        &mut self,
        line: Line<'_>,
        noise: &NoiseModel,
        widest: usize,
        least_snr: f32,
        mut found: impl FnMut(Candidate),
    ) {
        let n = line.value.len();
        dispatch!(self.level, simd => self.sum_up(simd, line.value));
        self.best.resize(n, Candidate::default());
        let mut half = 1;
        // Boxes wider than the line are all the same.
        while 2 * half < widest.clamp(3, 2 * n + 3) {
            self.scan(line, noise, half, least_snr);
            half *= 2;
        }
        self.hits.sort_unstable();
        for &i in &self.hits {
            let c = self.best[i];
            // The peak of its own box's reach, and of the reach of any wider box that covers it.
            let reach = c.scale;
            let rival = |j: usize| self.best[j].snr.total_cmp(&c.snr).then(i.cmp(&j)).is_gt();
            if !(i.saturating_sub(reach)..(i + reach + 1).min(n)).any(rival) {
                match split(line, noise, &c) {
                    Some(pair) => pair.into_iter().for_each(&mut found),
                    None => found(c),
                }
            }
        }
        for i in self.hits.drain(..) {
            self.best[i] = Candidate::default();
        }
    }

    /// Fills sums, maxima and the minimum.
    #[inline(always)]
    fn sum_up<S: Simd>(&mut self, simd: S, values: &[f32]) {
        self.sums.clear();
        self.sums.resize(values.len() + 1, 0.0);
        self.highest.clear();
        self.reach = 0;
        let mut lowest = f32x16::splat(simd, f32::INFINITY);
        let mut before = 0.0;
        let (whole, rest) = values.as_chunks::<BLOCK>();
        let (sums, last) = self.sums[1..].split_at_mut(whole.len() * BLOCK);
        for (block, sums) in whole.iter().zip(sums.as_chunks_mut::<BLOCK>().0) {
            // A block's sums wait for those of no other: all of it is added up apart.
            let mut sum = before;
            for (total, v) in sums.iter_mut().zip(block) {
                sum += f64::from(*v);
                *total = sum;
            }
            let pixels = f32x16::from_slice(simd, block);
            let (low, high) = pixels.widen();
            before += (low + high).reduce_sum();
            self.highest.push(pixels.reduce_max());
            lowest = lowest.min(pixels);
        }
        self.lowest = rest.iter().copied().fold(lowest.reduce_min(), f32::min);
        if !rest.is_empty() {
            self.highest.push(rest.iter().copied().fold(f32::NEG_INFINITY, f32::max));
        }
        for (total, v) in last.iter_mut().zip(rest) {
            before += f64::from(*v);
            *total = before;
        }
    }

    /// Takes boxes of one length into the best ones.
    fn scan(&mut self, line: Line<'_>, noise: &NoiseModel, half: usize, least_snr: f32) {
        let n = line.value.len();
        let scale = 2 * half + 1;
        let test = Test::new(noise, half, least_snr);
        while self.reach < half.div_ceil(BLOCK) {
            dilate(&mut self.highest);
            self.reach += 1;
        }
        let Self { sums, highest, lowest, places, best, hits, .. } = self;
        places.clear();
        dispatch!(self.level, simd => test.places(simd, sums, (highest, *lowest), places));
        for &centre in places.iter() {
            // At the border the boxes are cut; a side without pixels counts as the other.
            let (from, to) = (centre.saturating_sub(half), (centre + half + 1).min(n));
            let (before, after) = (from.saturating_sub(scale), (to + scale).min(n));
            let box_mean = (sums[to] - sums[from]) / (to - from) as f64;
            let left = (from > before).then(|| (sums[from] - sums[before]) / (from - before) as f64);
            let right = (after > to).then(|| (sums[after] - sums[to]) / (after - to) as f64);
            let (Some(left), Some(right)) = (left.or(right), right.or(left)) else { continue };
            let around = 0.5 * (left + right);
            let contrast = box_mean - around;
            if !stands_out(box_mean, left, right) {
                continue;
            }
            let level = around.max(0.0) + line.pedestal(centre);
            let variance = noise.variance(level, 0.0)
                + if line.pedestal(centre) > 0.0 { noise.variance(level, 0.0) } else { 0.0 };
            let outside = ((from - before) + (after - to)).max(1);
            let sigma = (variance * (1.0 / (to - from) as f64 + 1.0 / outside as f64)).sqrt();
            let snr = (contrast / sigma) as f32;
            if snr > best[centre].snr && snr >= least_snr {
                let flux = (contrast * (to - from) as f64) as f32;
                if best[centre].snr <= 0.0 {
                    hits.push(centre);
                }
                best[centre] = Candidate { centre, scale, snr, flux, background: around as f32 };
            }
        }
    }
}

/// Whether the mean of a box stands out of those on both sides alike: a step of brightness answers on one side only.
pub(crate) fn stands_out(middle: f64, left: f64, right: f64) -> bool {
    let contrast = middle - 0.5 * (left + right);
    contrast > 0.0 && middle - left.max(right) > 0.5 * contrast
}

/// Each block's highest value and those of the blocks beside it.
fn dilate(highest: &mut [f32]) {
    let mut before = f32::NEG_INFINITY;
    for i in 0..highest.len() {
        let after = highest.get(i + 1).copied().unwrap_or(f32::NEG_INFINITY);
        let here = highest[i];
        highest[i] = here.max(before).max(after);
        before = here;
    }
}

/// Whether a box stands out of its surroundings by what the noise at their level asks for: by multiplication only, since most of an image fails.
#[derive(Debug, Clone, Copy)]
struct Test {
    half: usize,
    /// Pixels of the box's surroundings on either side of its centre.
    margin: usize,
    per_pixel: f64,
    /// Least square of the contrast where it is dark, and what a level adds to it.
    dark: f64,
    per_level: f64,
}

impl Test {
    fn new(noise: &NoiseModel, half: usize, least_snr: f32) -> Self {
        /// Rounding may not take out what the exact test would let pass.
        const ROUNDING: f64 = 1.0 - 1e-6;
        let scale = (2 * half + 1) as f64;
        // The noise of the box's mean and that of its surroundings', which are twice as long.
        let factor = ROUNDING * f64::from(least_snr).powi(2) * 1.5 / scale;
        let dark = noise.variance(0.0, 0.0);
        Self {
            half,
            margin: 3 * half + 1,
            per_pixel: 1.0 / scale,
            dark: factor * dark,
            per_level: factor / f64::from(noise.gain_e_per_dn),
        }
    }

    /// Adds the places that pass, and those at the border, where boxes are cut; `highest` are the highest values within reach of each block, beside
    /// the lowest of all.
    ///
    /// What was subtracted from the line is left out: its noise only raises what is asked for.
    #[inline(always)]
    fn places<S: Simd>(
        &self,
        simd: S,
        sums: &[f64],
        (highest, lowest): (&[f32], f32),
        places: &mut Vec<usize>,
    ) {
        let n = sums.len() - 1;
        // A box's mean is below its highest pixel, and its surroundings' above the line's lowest.
        let promising = f64::from(lowest) + self.dark.sqrt();
        for (from, high) in (0..n).step_by(BLOCK).zip(highest) {
            if f64::from(*high) < promising {
                continue;
            }
            if from < self.margin || from + BLOCK + self.margin > n {
                places.extend(from..(from + BLOCK).min(n));
                continue;
            }
            let mut bits = 0;
            for part in (0..BLOCK).step_by(8) {
                bits |= self.passes(simd, sums, from + part) << part;
            }
            while bits != 0 {
                places.push(from + bits.trailing_zeros() as usize);
                bits &= bits - 1;
            }
        }
    }

    /// Which of the eight places from one on pass, one bit each.
    #[inline(always)]
    fn passes<S: Simd>(&self, simd: S, sums: &[f64], from: usize) -> u64 {
        let Self { half, margin, .. } = *self;
        let at = |place: usize| f64x8::from_slice(simd, &sums[place..][..8]);
        let inner = at(from + half + 1) - at(from - half);
        let around = (at(from + margin + 1) - at(from - margin) - inner) * (0.5 * self.per_pixel);
        let contrast = inner * self.per_pixel - around;
        let level = around.simd_lt(0.0).select(f64x8::splat(simd, 0.0), around);
        let enough = (contrast * contrast).simd_ge(level * self.per_level + self.dark);
        (enough & contrast.simd_gt(0.0)).to_bitmask()
    }
}

/// The two peaks of a candidate whose box holds two, as where the stripe steps in depth.
///
/// They are the highest pixel and the one that stands highest above the valley between, if it does so by a quarter of
/// its own height (speckle on a wide stripe doesn't) and by more than noise.
fn split(line: Line<'_>, noise: &NoiseModel, c: &Candidate) -> Option<[Candidate; 2]> {
    const SHARE: f32 = 0.25;
    const SIGMAS: f64 = 3.0;
    let (from, to) = (c.centre.saturating_sub(c.scale), (c.centre + c.scale + 1).min(line.value.len()));
    let top = (from..to).max_by(|&a, &b| line.value[a].total_cmp(&line.value[b]).then(b.cmp(&a)))?;
    let mut second: Option<(usize, usize, f32)> = None;
    for side in [-1isize, 1] {
        let mut valley = top;
        let mut at = top;
        while let Some(next) = at.checked_add_signed(side).filter(|i| (from..to).contains(i)) {
            at = next;
            if line.value[at] < line.value[valley] {
                valley = at;
            }
            let rise = line.value[at] - line.value[valley];
            if second.is_none_or(|s| rise > s.2) {
                second = Some((at, valley, rise));
            }
        }
    }
    let (other, valley, rise) = second?;
    let level = |i: usize| (f64::from(line.value[i]) + line.pedestal(i)).max(0.0);
    let signal = |i: usize| f64::from(line.value[i] - c.background);
    let sigma =
        (noise.variance(level(other), signal(other)) + noise.variance(level(valley), signal(valley))).sqrt();
    if rise < SHARE * (line.value[other] - c.background) || f64::from(rise) < SIGMAS * sigma {
        return None;
    }
    let part = |peak: usize| {
        let range = if peak < valley { from..valley } else { valley + 1..to };
        let flux: f32 = line.value[range].iter().map(|v| (v - c.background).max(0.0)).sum();
        let scale = (2 * peak.abs_diff(valley) - 1).clamp(3, c.scale.max(3));
        Candidate { centre: peak, scale, flux, ..*c }
    };
    Some([part(top), part(other)])
}
