//! Candidates: where on a line something stands out of its surroundings like a stripe.

use fearless_simd::{Level, Simd, dispatch};

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
#[derive(Debug, Default)]
pub(crate) struct Search {
    sums: Vec<f64>,
    /// Highest value of each block, and the lowest of all.
    highest: Vec<f32>,
    lowest: f32,
    /// The best box on each pixel; none but those at `hits` holds one.
    best: Vec<Candidate>,
    hits: Vec<usize>,
}

impl Search {
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
        self.sums.clear();
        self.sums.push(0.0);
        let mut sum = 0.0;
        for &v in line.value {
            sum += f64::from(v);
            self.sums.push(sum);
        }
        self.highest.clear();
        let block_maxima =
            line.value.chunks(BLOCK).map(|b| b.iter().copied().fold(f32::NEG_INFINITY, f32::max));
        self.highest.extend(block_maxima);
        self.lowest = line.value.iter().copied().fold(f32::INFINITY, f32::min);
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

    /// Takes boxes of one length into the best ones.
    fn scan(&mut self, line: Line<'_>, noise: &NoiseModel, half: usize, least_snr: f32) {
        let n = line.value.len();
        let scale = 2 * half + 1;
        // Cheap test first, by multiplication only: most of an image is dark and fails it.
        let per_pixel = 1.0 / scale as f64;
        let least = f64::from(least_snr) * (noise.variance(0.0, 0.0) * per_pixel).sqrt();
        let margin = half + scale;
        // A box's mean is below its highest pixel, and its surroundings' above the line's lowest.
        let promising = f64::from(self.lowest) + least;
        let reach = half.div_ceil(BLOCK);
        let blocks = self.highest.len();
        let active = |block: usize, highest: &[f32]| {
            let near = block.saturating_sub(reach)..(block + reach + 1).min(blocks);
            highest[near].iter().any(|&v| f64::from(v) >= promising)
        };
        let test = Test { half, margin, per_pixel, least };
        let level = Level::new();
        for centre in (0..blocks)
            .filter(|&block| active(block, &self.highest))
            .filter(|&block| dispatch!(level, simd => test.block(simd, &self.sums, block * BLOCK)))
            .flat_map(|block| block * BLOCK..((block + 1) * BLOCK).min(n))
        {
            if test.fails(&self.sums, centre) {
                continue;
            }
            // At the border the boxes are cut; a side without pixels counts as the other.
            let (from, to) = (centre.saturating_sub(half), (centre + half + 1).min(n));
            let (before, after) = (from.saturating_sub(scale), (to + scale).min(n));
            let box_mean = (self.sums[to] - self.sums[from]) / (to - from) as f64;
            let left =
                (from > before).then(|| (self.sums[from] - self.sums[before]) / (from - before) as f64);
            let right = (after > to).then(|| (self.sums[after] - self.sums[to]) / (after - to) as f64);
            let (Some(left), Some(right)) = (left.or(right), right.or(left)) else { continue };
            let around = 0.5 * (left + right);
            let contrast = box_mean - around;
            if contrast <= 0.0 {
                continue;
            }
            let level = around.max(0.0) + line.pedestal(centre);
            let variance = noise.variance(level, 0.0)
                + if line.pedestal(centre) > 0.0 { noise.variance(level, 0.0) } else { 0.0 };
            let outside = ((from - before) + (after - to)).max(1);
            let sigma = (variance * (1.0 / (to - from) as f64 + 1.0 / outside as f64)).sqrt();
            let snr = (contrast / sigma) as f32;
            if snr > self.best[centre].snr && snr >= least_snr && box_mean - left.max(right) > 0.5 * contrast
            {
                let flux = (contrast * (to - from) as f64) as f32;
                if self.best[centre].snr <= 0.0 {
                    self.hits.push(centre);
                }
                self.best[centre] = Candidate { centre, scale, snr, flux, background: around as f32 };
            }
        }
    }
}

/// Whether a box stands out of its surroundings by what the dark's noise asks for: by multiplication only, since most of an image fails.
#[derive(Debug, Clone, Copy)]
struct Test {
    half: usize,
    /// Pixels of the box's surroundings on either side of its centre.
    margin: usize,
    per_pixel: f64,
    least: f64,
}

impl Test {
    /// True where the box at `centre` can't be a candidate; never at the border, where boxes are cut.
    fn fails(&self, sums: &[f64], centre: usize) -> bool {
        let within = centre >= self.margin && centre + self.margin + 1 < sums.len();
        within && self.contrast(sums, centre) < self.least
    }

    /// False where no box of the block that starts at `from` can be a candidate.
    #[inline(always)]
    fn block<S: Simd>(&self, _: S, sums: &[f64], from: usize) -> bool {
        let Self { half, margin, .. } = *self;
        if from < margin || from + BLOCK + margin >= sums.len() {
            return true;
        }
        let at = |offset: usize| &sums[offset..][..BLOCK];
        let (high, low) = (at(from + half + 1), at(from - half));
        let (after, before) = (at(from + margin + 1), at(from - margin));
        let mut any = 0u64;
        for i in 0..BLOCK {
            any += u64::from(self.of(high[i] - low[i], after[i] - before[i]) >= self.least);
        }
        any > 0
    }

    fn contrast(&self, sums: &[f64], centre: usize) -> f64 {
        let Self { half, margin, .. } = *self;
        self.of(
            sums[centre + half + 1] - sums[centre - half],
            sums[centre + margin + 1] - sums[centre - margin],
        )
    }

    /// Mean of the box minus that of its surroundings.
    #[inline(always)]
    fn of(&self, inner: f64, all: f64) -> f64 {
        (inner - 0.5 * (all - inner)) * self.per_pixel
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
