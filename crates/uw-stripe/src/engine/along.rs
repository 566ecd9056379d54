//! What only the lines together show, for the filters as for the likelihood: edges of brightness, speckle, ends, bends. Most images show none
//! of it, which one pass over the lines tells.

use fearless_simd::{Simd, dispatch};

use super::{Engine, Job};
use crate::Pixel;
use crate::bend::Bends;
use crate::edges::{self, Edges};
use crate::profile::{Flags, Reject, Stripe};
use crate::scatter::{self, Centre, Scatter, parts};

/// Buffers.
#[derive(Debug, Default)]
pub(super) struct Along {
    edges: Edges,
    scatter: Scatter,
    ends: Vec<usize>,
    bends: Bends,
}

/// What is worth a closer look.
#[derive(Debug, Clone, Copy)]
struct Signs {
    edges: bool,
    rough: bool,
    bent: bool,
}

impl Engine {
    /// Widens sigmas by what edges of brightness and speckle do to a centre, takes out the stripe's fading ends and what blur moves where it bends.
    pub(super) fn along<P: Pixel>(&mut self, job: Job<'_, P>, stripe: &mut Stripe) {
        let (first_line, _, _) = job.origin();
        let lines = first_line..first_line + job.lines();
        let level = self.level;
        let (position, sigma) = (&stripe.position_px[lines.clone()], &stripe.sigma_px[lines.clone()]);
        let amplitude = &stripe.amplitude[lines.clone()];
        let signs = dispatch!(level, simd => signs(simd, position, sigma, amplitude));
        let Along { edges, scatter, ends, .. } = &mut self.along;
        if signs.edges {
            edges.load(lines.clone().map(|i| f64::from(stripe.amplitude[i]) * f64::from(stripe.width_px[i])));
        }
        let scatter = if signs.rough {
            scatter.of(
                level,
                lines.clone().enumerate().map(|(i, line)| {
                    let unsound = Flags::SATURATED | Flags::NOT_CONVERGED;
                    let told = !stripe.position_px[line].is_nan()
                        && stripe.flags[line].without(unsound) == stripe.flags[line]
                        && (!signs.edges || edges.smooth(i));
                    told.then(|| Centre {
                        position: stripe.position_px[line],
                        sigma: stripe.sigma_px[line],
                        width: stripe.width_px[line],
                    })
                }),
            )
        } else {
            0.0
        };
        stripe.scatter_widths = scatter as f32;
        if signs.edges || scatter > 0.0 {
            for (i, line) in lines.clone().enumerate().filter(|(_, l)| stripe.reject[*l].is_none()) {
                let width = f64::from(stripe.width_px[line]);
                let edge = if signs.edges { edges.lean(i, width) } else { None };
                if edge.is_none() && scatter <= 0.0 {
                    continue;
                }
                let sigma =
                    f64::from(stripe.sigma_px[line]).hypot(scatter * width).hypot(edge.unwrap_or(0.0));
                stripe.sigma_px[line] = sigma as f32;
                if edge.is_some() {
                    stripe.flags[line] |= Flags::EDGE;
                }
            }
        }
        if signs.edges {
            edges.drop_partial(stripe, lines.clone(), ends);
        }
        if signs.bent || signs.edges {
            self.along.bends.unbend(level, stripe, lines.clone());
        }
        if !(signs.edges || signs.rough || signs.bent) {
            return;
        }
        let most = self.model.max_sigma_px;
        if stripe.sigma_px[lines.clone()].iter().fold(false, |any, sigma| any | (*sigma > most)) {
            for line in lines {
                if stripe.reject[line].is_none() && stripe.sigma_px[line] > most {
                    stripe.drop_line(line, Reject::Imprecise);
                }
            }
        }
    }
}

/// Looks over the lines in sums and counts alone; NaN, a line without a stripe, counts as nothing.
#[inline(always)]
fn signs<S: Simd>(_: S, position: &[f32], sigma: &[f32], amplitude: &[f32]) -> Signs {
    Signs { edges: uneven(amplitude), rough: rough(position, sigma), bent: bent(position, sigma, amplitude) }
}

/// Whether light jumps, or drifts as far as an edge's levels lie apart.
#[inline(always)]
fn uneven(amplitude: &[f32]) -> bool {
    let leap = (edges::FLUX_STEP.0 * edges::STEP_REACH as f64).exp();
    let mut jumps = 0u32;
    for (reach, ratio) in [(edges::STEP_REACH, leap), (edges::LEVELS_REACH, edges::LEVELS_APART.sqrt())] {
        let (ratio, [before, after]) = (ratio as f32, parts(amplitude, reach));
        for (a, b) in before.iter().zip(after) {
            jumps += u32::from((a * ratio < *b) | (b * ratio < *a));
        }
    }
    jumps > 0
}

/// Whether more centres than chance allows are further from their neighbours' curve than their sigmas say.
#[inline(always)]
fn rough(position: &[f32], sigma: &[f32]) -> bool {
    let [a, b, c, d] = parts(position, scatter::SPACING);
    let [sa, sb, sc, sd] = parts(sigma, scatter::SPACING);
    let limit = (scatter::SHARE_NORMAL * scatter::significant(a.len())).powi(2) as f32;
    let (mut beyond, mut all) = (0u32, 0u32);
    for i in 0..a.len() {
        let difference = scatter::third_difference([a[i], b[i], c[i], d[i]]);
        let variance = scatter::weighted_squares([sa[i], sb[i], sc[i], sd[i]]);
        let square = difference * difference;
        all += u32::from(square >= 0.0);
        beyond += u32::from(square > limit * variance);
    }
    all as usize >= scatter::LEAST && f64::from(beyond) > (1.0 - scatter::SHARE) * f64::from(all)
}

/// Whether some lines bend by more than their noise lets a correction tell: the parabola that `bend` fits, and what it takes to be more than
/// chance, which a slight bend helps on.
#[inline(always)]
fn bent(position: &[f32], sigma: &[f32], amplitude: &[f32]) -> bool {
    /// Sigmas of a bend of which a share of the lines, and of which few, are no chance.
    const USUAL: (f32, usize) = (3.5, 64);
    const STRONG: (f32, u32) = (5.0, 3);
    let [p3, p2, p1, p, q1, q2, q3] = parts(position, 1);
    let [a3, a2, a1, a, b1, b2, b3] = parts(amplitude, 1);
    let [_, _, _, sigma, ..] = parts::<7>(sigma, 1);
    let (mut usual, mut strong) = (0u32, 0u32);
    for i in 0..p.len() {
        let curvature = (5.0 * (p3[i] + q3[i]) - 3.0 * (p1[i] + q1[i]) - 4.0 * p[i]) / 84.0;
        let slope = (3.0 * (q3[i] - p3[i]) + 2.0 * (q2[i] - p2[i]) + (q1[i] - p1[i])) / 28.0;
        let growth = (3.0 * (b3[i] - a3[i]) + 2.0 * (b2[i] - a2[i]) + (b1[i] - a1[i])) / (28.0 * a[i]);
        let bend = curvature + slope * growth;
        let variance = sigma[i] * sigma[i] * (1.0 / 84.0 + growth * growth / 28.0);
        usual += u32::from(bend * bend > USUAL.0 * USUAL.0 * variance);
        strong += u32::from(bend * bend > STRONG.0 * STRONG.0 * variance);
    }
    strong >= STRONG.1 || usual as usize >= p.len() / USUAL.1 + STRONG.1 as usize
}
