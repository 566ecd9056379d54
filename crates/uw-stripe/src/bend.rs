//! What blur does to the centre where a stripe bends: found from the neighbouring lines, and taken back.
//!
//! A line cuts the stripe's curve u = f(v), of strength A(v), as blurred along the stripe as across it. Blur of variance w²
//! moves the centre of that cut, to second order, by
//!
//! δ = w² (½ f″ + f′ A′/A):
//!
//! curvature pulls it inwards, and a slope lets the brighter neighbour's light in. Both are large where a stripe runs out along
//! an object's outline, which is why the ends of stripes on balls and pipes are off by a tenth of a pixel and more, always to the
//! same side. A straight stripe, however steep, and one of even strength are left as they are.

use crate::precise::median;
use crate::profile::{Flags, Reject, Stripe};
use crate::verdict::run_reach;
use std::ops::Range;

/// Lines to either side that the local curve is fitted to.
const REACH_LINES: usize = 3;
/// Positions that a parabola needs to be more than drawn through its points.
const LEAST_LINES: usize = 4;
/// Standard deviation of the correction, as a share of it: what the second order leaves.
const UNSURE: f64 = 0.5;
/// A correction beyond this share of the stripe's width is no longer believed: the measurement is taken out.
const LIMIT_WIDTHS: f64 = 0.15;

/// Below so many sigmas of its own noise a bend is left alone, above it is shrunk towards that (James and Stein): where there is none,
/// a correction would only add noise.
const SIGNIFICANT: f64 = 3.0;
/// Change of ln strength from one line to the next beyond which the surface's brightness has an edge there, whose light does not mix as
/// that of an even change does.
const EDGE_STEP: f64 = 1.0;

/// The curve around one line.
#[derive(Clone, Copy, Debug)]
struct Local {
    line: usize,
    slope: f64,
    /// ½ f″ + f′ A′/A, 1/px.
    bend: f64,
    /// Standard deviation of the bend from positions of unit noise, 1/px².
    noise_gain: f64,
}

/// Takes back what blur does where a stripe bends; keeps its buffers.
#[derive(Debug, Default)]
pub(crate) struct Bends {
    /// Natural logarithm of each line's strength.
    ln_strength: Vec<f64>,
    found: Vec<Local>,
    squares: Vec<f64>,
    sigmas: Vec<f64>,
    /// Natural logarithms of width² and of 1 + slope².
    widths: Vec<(f64, f64)>,
}

impl Bends {
    /// Corrects the positions of `lines` for blur along a bent stripe, widens their sigmas by what that leaves unsure, and takes out those
    /// beyond belief.
    pub fn unbend(&mut self, stripe: &mut Stripe, lines: Range<usize>) {
        let Self { ln_strength, found, squares, sigmas, widths } = self;
        ln_strength.clear();
        ln_strength.extend(stripe.amplitude[lines.clone()].iter().map(|a| f64::from(*a).max(1e-6).ln()));
        found.clear();
        found.extend(lines.clone().filter_map(|line| local(stripe, (&lines, ln_strength), line)));
        let share = blur_along(found, stripe, widths);
        // Width square to the stripe: a line cuts a steep one obliquely.
        squares.clear();
        squares.extend(
            found
                .iter()
                .map(|at| f64::from(stripe.width_px[at.line]).powi(2) / (1.0 + share * at.slope * at.slope)),
        );
        if squares.is_empty() {
            return;
        }
        let variance = median(squares);
        let (variance, limit) = (share * variance, LIMIT_WIDTHS * variance.sqrt());
        // The stripe's usual noise: single sigmas are wide where a fit is poor, which a bend itself makes it.
        sigmas.clear();
        sigmas.extend(found.iter().map(|at| f64::from(stripe.sigma_px[at.line])));
        let sigma_px = median(sigmas);
        for at in found.iter() {
            let noise = sigma_px * at.noise_gain;
            let doubt = (SIGNIFICANT * noise / at.bend).powi(2);
            if doubt.is_nan() || doubt >= 1.0 {
                // At an edge of brightness it may be real all the same.
                if stripe.flags[at.line].contains(Flags::EDGE) {
                    let sigma = &mut stripe.sigma_px[at.line];
                    *sigma = f64::from(*sigma).hypot(variance * at.bend) as f32;
                }
                continue;
            }
            let shift = variance * at.bend * (1.0 - doubt);
            if shift.abs() > limit {
                stripe.drop_line(at.line, Reject::Bent);
            } else {
                let sigma = &mut stripe.sigma_px[at.line];
                *sigma = f64::from(*sigma).hypot(UNSURE * shift).hypot(variance * noise) as f32;
                stripe.position_px[at.line] = (f64::from(stripe.position_px[at.line]) - shift) as f32;
            }
        }
    }
}

/// Whether the stripe is blurred along as across (1), or only along its lines (0), as its widths tell: one cut obliquely by a line
/// looks √(1 + f′²) as wide, a blur along the lines as wide everywhere. Without steep lines to tell by, the lens is believed.
fn blur_along(found: &[Local], stripe: &Stripe, widths: &mut Vec<(f64, f64)>) -> f64 {
    /// Standard deviation of 1 beforehand, and of ln width² beyond its noise.
    const DOUBT: f64 = 0.5;
    const UNEVEN: f64 = 0.2;
    // An edge of brightness widens and narrows what crosses it, and bends the curve as far as that reaches.
    let plain = |at: &&Local| {
        let near = at.line.saturating_sub(REACH_LINES)..(at.line + REACH_LINES + 1).min(stripe.flags.len());
        !stripe.flags[near].iter().any(|flags| flags.contains(Flags::EDGE))
    };
    let both =
        |at: &Local| (f64::from(stripe.width_px[at.line]).powi(2).ln(), (1.0 + at.slope * at.slope).ln());
    widths.clear();
    widths.extend(found.iter().filter(plain).map(both));
    let n = widths.len() as f64;
    let (width, slope) = widths.iter().fold((0.0, 0.0), |(a, b), (w, s)| (a + w / n, b + s / n));
    let (cross, square) = widths
        .iter()
        .fold((0.0, 0.0), |(c, q), (w, s)| (c + (w - width) * (s - slope), q + (s - slope) * (s - slope)));
    // Neighbours' widths go together: about one in ten lines says something of its own.
    let known = 0.1 * square / (UNEVEN * UNEVEN);
    let prior = DOUBT.powi(-2);
    let told = if square > 0.0 { cross / square } else { 1.0 };
    ((prior + known * told) / (prior + known)).clamp(0.0, 1.0)
}

/// What [`local`] finds where all lines within reach belong to the run, as nearly everywhere: the offsets' odd moments are 0.
fn whole(position: &[f32], strength: &[f64], line: usize) -> Option<Local> {
    const COUNT: usize = 2 * REACH_LINES + 1;
    let (position, strength): (&[f32; COUNT], &[f64; COUNT]) =
        (position.try_into().ok()?, strength.try_into().ok()?);
    let (mut m, mut p, mut growth) = ([0.0; 3], [0.0; 3], 0.0);
    for i in 0..COUNT {
        let x = i as f64 - REACH_LINES as f64;
        let (u, square) = (f64::from(position[i] - position[REACH_LINES]), x * x);
        m = [m[0] + 1.0, m[1] + square, m[2] + square * square];
        p = [p[0] + u, p[1] + x * u, p[2] + square * u];
        growth += x * strength[i];
    }
    let determinant = m[0] * m[2] - m[1] * m[1];
    let (curvature, slope) = ((m[0] * p[2] - m[1] * p[0]) / determinant, p[1] / m[1]);
    let growth = growth / m[1];
    let bend = curvature + slope * growth;
    let noise_gain = (growth * growth / m[1] + m[0] / determinant).sqrt();
    (bend.is_finite() && noise_gain.is_finite()).then_some(Local { line, slope, bend, noise_gain })
}

/// A parabola through the positions and a straight line through the logarithm of the strengths around `line`, over the unbroken
/// run that it belongs to; `None` where that is too short.
fn local(stripe: &Stripe, (lines, strength): (&Range<usize>, &[f64]), line: usize) -> Option<Local> {
    let position = |i: usize| stripe.position_px[i];
    if position(line).is_nan() {
        return None;
    }
    let ln_strength = |i: usize| strength[i - lines.start];
    let even = |a: usize, b: usize| (ln_strength(a) - ln_strength(b)).abs() <= EDGE_STEP;
    let joined =
        |a: usize, b: usize| (position(b) - position(a)).abs() <= run_reach(stripe.width_px[a]) && even(a, b);
    let (mut first, mut last) = (line, line);
    while first > lines.start && line - first < REACH_LINES && joined(first, first - 1) {
        first -= 1;
    }
    while last + 1 < lines.end && last - line < REACH_LINES && joined(last, last + 1) {
        last += 1;
    }
    if last + 1 - first < LEAST_LINES {
        return None;
    }
    if first + REACH_LINES == line && line + REACH_LINES == last {
        return whole(
            &stripe.position_px[first..=last],
            &strength[first - lines.start..=last - lines.start],
            line,
        );
    }
    // Moments of the offsets from `line`, and of positions and strengths with them.
    let (mut m, mut p, mut s) = ([0.0; 5], [0.0; 3], [0.0; 2]);
    for i in first..=last {
        let x = i as f64 - line as f64;
        let powers = [1.0, x, x * x, x * x * x, x * x * x * x];
        let (u, strength) = (f64::from(position(i) - position(line)), ln_strength(i));
        (0..5).for_each(|k| m[k] += powers[k]);
        (0..3).for_each(|k| p[k] += powers[k] * u);
        (0..2).for_each(|k| s[k] += powers[k] * strength);
    }
    let normal = nalgebra::Matrix3::new(m[0], m[1], m[2], m[1], m[2], m[3], m[2], m[3], m[4]);
    let factor = normal.cholesky()?;
    let curve = factor.solve(&nalgebra::Vector3::from(p));
    let growth = (m[0] * s[1] - m[1] * s[0]) / (m[0] * m[2] - m[1] * m[1]);
    let bend = curve.z + curve.y * growth;
    // The bend is linear in the positions: its variance is gᵀ N⁻¹ g of theirs, g picking curvature and slope.
    let picked = nalgebra::Vector3::new(0.0, growth, 1.0);
    let noise_gain = picked.dot(&factor.solve(&picked)).max(0.0).sqrt();
    (bend.is_finite() && noise_gain.is_finite()).then_some(Local { line, slope: curve.y, bend, noise_gain })
}
