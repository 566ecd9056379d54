//! Where the surface's brightness changes along the stripe, as the light of neighbouring lines tells: light of which the surface sends back
//! more on one side moves a centre by width² · d ln(albedo)/dx. The change across a line is not seen; along the stripe it is, and an edge may
//! run either way.

use crate::median::median;
use crate::profile::{Reject, Stripe};
use crate::verdict::run_reach;
use std::ops::Range;

/// Change of ln flux a line that counts as an albedo edge: at least this, and this many times the image's usual change.
pub(crate) const FLUX_STEP: (f64, f64) = (0.15, 4.0);
/// Lines to either side over which a step is told.
pub(crate) const STEP_REACH: usize = 2;
/// Lines within which two levels of flux count as an albedo edge's sides, their least ratio and its logarithm in usual steps (speckle alone
/// scatters a flux by a quarter), and the ratio within which a flux belongs to one of them.
pub(crate) const LEVELS_REACH: usize = 12;
pub(crate) const LEVELS_APART: f64 = 3.0;
const LEVELS_APART_STEPS: f64 = 8.0;
const LEVEL_MARGIN: f64 = 1.5;
/// Lines that make a level.
const LEVEL_LINES: usize = 3;
/// Sigma, in widths, of the shift by an edge that the stripe runs along: a Gaussian cut at its middle has its mean at
/// 0.8 widths, and half of the width is the lens's.
const LEAN_BETWEEN_LEVELS: f64 = 0.4;
/// Within two lines of a stripe's end, the share of the flux further in below which only part of the beam met the surface.
const PARTIAL: f64 = 0.5;

/// The stripe's light line by line, DN · px; NaN: no stripe there.
#[derive(Debug, Default)]
pub(crate) struct Edges {
    flux: Vec<f64>,
    /// Its logarithm, and the largest change of that a line, over two lines to either side; 0 without neighbours.
    ln_flux: Vec<f64>,
    step: Vec<f64>,
    /// The least and the most light within [`LEVELS_REACH`] lines.
    low: Vec<f64>,
    high: Vec<f64>,
    scratch: Vec<f64>,
    usual: f64,
}

impl Edges {
    /// Takes the light of successive lines, and what change of it is usual there: texture and speckle of the surface at hand.
    pub fn load(&mut self, flux: impl Iterator<Item = f64>) {
        let Self { flux: light, ln_flux, step, low, high, scratch, usual } = self;
        light.clear();
        light.extend(flux);
        ln_flux.clear();
        ln_flux.extend(light.iter().map(|f| f.ln()));
        step.clear();
        step.extend((0..light.len()).map(|i| {
            let change = |j: Option<usize>| {
                let other = j.and_then(|j| ln_flux.get(j)).copied().unwrap_or(f64::NAN);
                ((other - ln_flux[i]).abs() / STEP_REACH as f64).max(0.0)
            };
            change(i.checked_sub(STEP_REACH)).max(change(Some(i + STEP_REACH)))
        }));
        extremes(light, f64::INFINITY, f64::min, low);
        extremes(light, 0.0, f64::max, high);
        scratch.clear();
        scratch.extend(step.iter().filter(|s| **s > 0.0));
        *usual = median(scratch);
    }

    fn flux(&self, line: Option<usize>) -> Option<f64> {
        self.flux.get(line?).copied().filter(|f| !f.is_nan())
    }

    /// Change of ln flux a line that counts as an edge in the image at hand.
    fn least_step(&self) -> f64 {
        FLUX_STEP.0.max(FLUX_STEP.1 * self.usual)
    }

    /// Whether no edge crosses line `i`.
    pub fn smooth(&self, i: usize) -> bool {
        self.step[i] <= self.least_step()
    }

    /// Sigma of the shift, px, of a stripe `width` wide by the edges at line `i`; `None` where there is none. About half the width is the
    /// lens's, which moves nothing.
    pub fn lean(&self, i: usize, width: f64) -> Option<f64> {
        let step = self.step[i];
        let along = (step > self.least_step()).then(|| 0.5 * width * width * step.min(1.0 / width));
        let between = self.between_levels(i).then_some(LEAN_BETWEEN_LEVELS * width);
        along.into_iter().chain(between).reduce(f64::max)
    }

    /// True where the flux lies well between two levels that the stripe has nearby: it runs along an albedo edge, which
    /// shifts its centre without any sudden change.
    fn between_levels(&self, i: usize) -> bool {
        let here = self.flux[i];
        let apart = LEVELS_APART.max((LEVELS_APART_STEPS * self.usual).exp());
        let between = |low: f64, high: f64| {
            high > apart * low && here > LEVEL_MARGIN * low && here * LEVEL_MARGIN < high
        };
        // Of nearly all lines that is known by the least and the most light nearby.
        if !between(self.low[i], self.high[i]) {
            return false;
        }
        let nearby = i.saturating_sub(LEVELS_REACH)..(i + LEVELS_REACH + 1).min(self.flux.len());
        // A level is that of several lines: one that a hot pixel or a grain in the water brightens is none.
        let (mut low, mut high) = ([f64::INFINITY; LEVEL_LINES], [0.0f64; LEVEL_LINES]);
        for flux in nearby.filter_map(|j| self.flux(Some(j))) {
            let (mut least, mut most) = (flux, flux);
            low.iter_mut().for_each(|l| (*l, least) = (l.min(least), l.max(least)));
            high.iter_mut().for_each(|h| (*h, most) = (h.max(most), h.min(most)));
        }
        between(low[LEVEL_LINES - 1], high[LEVEL_LINES - 1])
    }

    /// Takes out the ends of runs at which only part of the beam met the surface; flux counts from the first of `lines`. All ends first, then
    /// out with them, lest an end be eaten up line by line; `ends` is a buffer.
    pub fn drop_partial(&self, stripe: &mut Stripe, lines: Range<usize>, ends: &mut Vec<usize>) {
        ends.clear();
        let position = &stripe.position_px[lines.clone()];
        let width = &stripe.width_px[lines.clone()];
        ends.extend(
            (0..position.len())
                .filter(|i| !position[*i].is_nan() && self.partial(position, *i, run_reach(width[*i]))),
        );
        for i in ends {
            stripe.drop_line(lines.start + *i, Reject::Edge);
        }
    }

    /// True at the end of a run where its light falls off: the beam's other part went past the surface. `position` is the
    /// lines', `reach` the longest step a line within a run, px.
    fn partial(&self, position: &[f32], line: usize, reach: f32) -> bool {
        let Some(&here) = position.get(line) else { return false };
        let flux = |j: usize| self.flux(Some(j)).unwrap_or(0.0);
        // NaN, a line without a position, is never near.
        let inside = |j: Option<usize>, gap: f32| {
            let near = |j: &usize| position.get(*j).is_some_and(|p| (p - here).abs() <= gap * reach);
            j.filter(near).map(flux)
        };
        let pair = |a, b| Some(inside(a, 1.0)?.max(inside(b, 2.0)?));
        match (pair(line.checked_sub(1), line.checked_sub(2)), pair(Some(line + 1), Some(line + 2))) {
            (Some(inside), None) | (None, Some(inside)) => flux(line) < PARTIAL * inside,
            _ => false,
        }
    }
}

/// Fills `out` with the extreme of the values within [`LEVELS_REACH`] of each, of those that are numbers; `none` is what any is more extreme than.
fn extremes(values: &[f64], none: f64, of: fn(f64, f64) -> f64, out: &mut Vec<f64>) {
    out.clear();
    out.resize(LEVELS_REACH, none);
    out.extend(values.iter().map(|v| if v.is_nan() { none } else { *v }));
    out.resize(values.len() + 2 * LEVELS_REACH, none);
    // Each of itself and those behind it, twice as many each time; in the end two runs make up the whole.
    const WHOLE: usize = 2 * LEVELS_REACH + 1;
    let mut run = 1;
    while run < WHOLE {
        let further = run.min(WHOLE - run);
        for i in 0..out.len() - further {
            out[i] = of(out[i], out[i + further]);
        }
        run += further;
    }
    out.truncate(values.len());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edges(flux: impl Fn(usize) -> f64) -> Edges {
        let mut edges = Edges::default();
        // No surface is without any texture.
        edges.load((0..80).map(|i| flux(i) * (1.0 + 0.01 * f64::from(i as u32 % 3))));
        edges
    }

    #[test]
    fn a_step_is_an_edge_and_shading_is_none() {
        let step = edges(|i| if i < 40 { 100.0 } else { 25.0 });
        let shaded = edges(|i| 100.0 * (0.03 * i as f64).exp());
        for i in 0..80 {
            assert_eq!(step.lean(i, 2.0).is_some(), (38..42).contains(&i), "line {i}");
            assert!(shaded.lean(i, 2.0).is_none() && shaded.smooth(i), "line {i}");
        }
        // ln 4 over two lines: more than a width may move.
        assert!((step.lean(39, 2.0).unwrap() - 1.0).abs() < 0.4);
    }

    #[test]
    fn a_stripe_along_an_edge_is_told_from_speckle() {
        let along = edges(|i| 100.0 - 80.0 * ((i as f64 - 30.0) / 12.0).clamp(0.0, 1.0));
        assert!(
            along.lean(37, 2.0).is_some() && along.lean(10, 2.0).is_none() && along.lean(70, 2.0).is_none()
        );
        // A quarter of scatter from line to line spans three to one now and then.
        let speckled = edges(|i| (0.6 * (12.9898 * i as f64).sin()).exp());
        assert!((0..80).filter(|i| speckled.lean(*i, 2.0).is_some()).count() < 8);
    }

    #[test]
    fn extremes_are_those_of_the_lines_nearby() {
        let values: Vec<f64> =
            (0..60).map(|i| if i % 7 == 3 { f64::NAN } else { f64::from(i * 37 % 60) + 1.0 }).collect();
        for length in [0, 1, 11, 12, 13, 25, 60] {
            let (values, mut low, mut high) = (&values[..length], Vec::new(), Vec::new());
            extremes(values, f64::INFINITY, f64::min, &mut low);
            extremes(values, 0.0, f64::max, &mut high);
            assert_eq!((low.len(), high.len()), (length, length));
            for i in 0..length {
                let near = &values[i.saturating_sub(LEVELS_REACH)..(i + LEVELS_REACH + 1).min(length)];
                let least = near.iter().copied().fold(f64::INFINITY, f64::min);
                let most = near.iter().copied().fold(0.0, f64::max);
                assert_eq!([low[i], high[i]].map(f64::to_bits), [least, most].map(f64::to_bits), "{i}");
            }
        }
    }

    #[test]
    fn an_end_that_fades_is_part_of_the_beam() {
        let mut position = [f32::NAN; 80];
        position[20..60].fill(7.0);
        let edges = edges(|i| if i == 20 || i == 40 { 30.0 } else { 100.0 });
        let partial: Vec<usize> = (0..80).filter(|i| edges.partial(&position, *i, 3.0)).collect();
        assert_eq!(partial, [20]);
    }
}
