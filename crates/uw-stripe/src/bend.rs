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

mod curves;

use crate::engine::lanes::CHUNK;
use crate::median::median_of_known;
use crate::profile::{Flags, Reject, Stripe, union};
use crate::special::ln;
use curves::{Curves, REACH_LINES};
use fearless_simd::{Level, Simd, dispatch};
use std::ops::Range;

/// Standard deviation of what is taken back where blur along the stripe bends it ([`Stripe::unbent_px`]), as a share of it: one image hardly tells how much of
/// the width is blur along the stripe. Part of every [`Stripe::sigma_px`].
pub const UNBENT_UNSURE: f32 = 0.5;
/// A correction beyond this share of the stripe's width is no longer believed: the measurement is taken out.
const LIMIT_WIDTHS: f32 = 0.15;

/// Below so many sigmas of its own noise a bend is left alone, above it is shrunk towards that (James and Stein): where there is none,
/// a correction would only add noise.
const SIGNIFICANT: f32 = 3.0;

/// Takes back what blur does where a stripe bends; keeps its buffers.
#[derive(Debug, Default)]
pub(crate) struct Bends {
    curves: Curves,
    /// By line: 1 where it tells how wide the stripe is, 0 elsewhere.
    plain: Vec<f32>,
    widths: Widths,
    upper: Vec<u16>,
    shift: Vec<f32>,
}

/// The lines' logarithms of width² and of 1 + slope², 0 where they tell nothing, and whether they do (1).
#[derive(Debug, Default)]
struct Widths {
    known: Vec<f32>,
    ln_square: Vec<f32>,
    ln_oblique: Vec<f32>,
}

/// What all bends of an image have in common.
#[derive(Debug, Clone, Copy)]
struct Blur {
    /// Variance along the stripe, px².
    variance: f32,
    /// Longest shift that is believed, px.
    limit: f32,
    /// The stripe's usual noise, px: single sigmas are wide where a fit is poor, which a bend itself makes it.
    sigma_px: f32,
}

impl Bends {
    /// Corrects the positions of `lines` for blur along a bent stripe, widens their sigmas by what that leaves unsure, and takes out those
    /// beyond belief.
    pub fn unbend(&mut self, level: Level, stripe: &mut Stripe, lines: Range<usize>) {
        let position = &stripe.position_px[lines.clone()];
        let width = &stripe.width_px[lines.clone()];
        let amplitude = &stripe.amplitude[lines.clone()];
        dispatch!(level, simd => self.curves.along(simd, position, width, amplitude));
        self.curves.near_breaks(position);
        let edges = union(&stripe.flags).contains(Flags::EDGE);
        self.tell(&stripe.flags, lines.clone(), edges);
        let sigma = &stripe.sigma_px[lines.clone()];
        let Some(blur) = dispatch!(level, simd => self.blur(simd, width, sigma)) else { return };
        let (position, sigma) = (&mut stripe.position_px[lines.clone()], &mut stripe.sigma_px[lines.clone()]);
        let beyond = dispatch!(level, simd => self.shift(simd, blur, position, sigma));
        stripe.unbent_px[lines.clone()].copy_from_slice(&self.shift);
        if beyond {
            for (line, _) in lines.clone().zip(&self.shift).filter(|(_, s)| s.abs() > blur.limit) {
                stripe.drop_line(line, Reject::Bent);
            }
        }
        if edges {
            // There a bend that noise would explain may be real all the same.
            for (i, line) in lines.enumerate() {
                let bend = self.curves.bend[i];
                if self.shift[i] == 0.0 && !bend.is_nan() && stripe.flags[line].contains(Flags::EDGE) {
                    stripe.sigma_px[line] = stripe.sigma_px[line].hypot(blur.variance * bend);
                }
            }
        }
    }

    /// Which lines tell how wide the stripe is: an edge of brightness widens and narrows what crosses it, and bends the curve as far as that reaches.
    fn tell(&mut self, flags: &[Flags], lines: Range<usize>, edges: bool) {
        self.plain.clear();
        self.plain.resize(lines.len(), 1.0);
        if edges {
            for (plain, line) in self.plain.iter_mut().zip(lines) {
                let near = line.saturating_sub(REACH_LINES)..(line + REACH_LINES + 1).min(flags.len());
                *plain = if flags[near].iter().any(|f| f.contains(Flags::EDGE)) { 0.0 } else { 1.0 };
            }
        }
    }

    /// The blur along the stripe; `None` where no line's curve is known.
    #[inline(always)]
    fn blur<S: Simd>(&mut self, simd: S, width: &[f32], sigma: &[f32]) -> Option<Blur> {
        let Self { curves, plain, widths, upper, .. } = self;
        let share = widths.blur_along(simd, curves, width, plain);
        // Width square to the stripe: a line cuts a steep one obliquely.
        let square = (curves.slope.iter().zip(width)).map(|(slope, w)| w * w / (1.0 + share * slope * slope));
        let square = median_of_known(&curves.bend, square, upper)?;
        let sigma_px = median_of_known(&curves.bend, sigma.iter().copied(), upper)?;
        Some(Blur { variance: share * square, limit: LIMIT_WIDTHS * square.sqrt(), sigma_px })
    }

    /// Takes back what is more than noise, and keeps it in `shift`; true if some of it is beyond belief: those lines stay as they were.
    #[inline(always)]
    fn shift<S: Simd>(&mut self, _: S, blur: Blur, position: &mut [f32], sigma: &mut [f32]) -> bool {
        let n = position.len();
        self.shift.clear();
        self.shift.resize(n, 0.0);
        let (bend, noise_gain) = (&self.curves.bend[..n], &self.curves.noise_gain[..n]);
        let (shift, sigma) = (&mut self.shift[..n], &mut sigma[..n]);
        let significant = (SIGNIFICANT * blur.sigma_px).powi(2);
        let noise = (blur.variance * blur.sigma_px).powi(2);
        let mut beyond = 0u32;
        for i in 0..n {
            let doubt = significant * noise_gain[i] / (bend[i] * bend[i]);
            let moved = if doubt < 1.0 { blur.variance * bend[i] * (1.0 - doubt) } else { 0.0 };
            let believed = moved.abs() <= blur.limit;
            beyond += u32::from(!believed);
            shift[i] = moved;
            position[i] -= if believed { moved } else { 0.0 };
            let unsure = (UNBENT_UNSURE * moved).powi(2) + noise * noise_gain[i];
            let wider = (sigma[i] * sigma[i] + unsure).sqrt();
            sigma[i] = if believed & (doubt < 1.0) { wider } else { sigma[i] };
        }
        beyond > 0
    }
}

impl Widths {
    /// Whether the stripe is blurred along as across (1), or only along its lines (0), as its widths tell: one cut obliquely by a line
    /// looks √(1 + f′²) as wide, a blur along the lines as wide everywhere. Without steep lines to tell by, the lens is believed.
    #[inline(always)]
    fn blur_along<S: Simd>(&mut self, _: S, curves: &Curves, width: &[f32], plain: &[f32]) -> f32 {
        /// Standard deviation of 1 beforehand, and of ln width² beyond its noise.
        const DOUBT: f32 = 0.5;
        const UNEVEN: f32 = 0.2;
        let count = width.len();
        for values in [&mut self.known, &mut self.ln_square, &mut self.ln_oblique] {
            values.clear();
            values.resize(count, 0.0);
        }
        let (bend, slope, plain) = (&curves.bend[..count], &curves.slope[..count], &plain[..count]);
        let (known, w, s) =
            (&mut self.known[..count], &mut self.ln_square[..count], &mut self.ln_oblique[..count]);
        for i in 0..count {
            // Logarithms of what is not known are anything.
            let used = !bend[i].is_nan() & (plain[i] > 0.0);
            known[i] = if used { 1.0 } else { 0.0 };
            w[i] = if used { 2.0 * ln(width[i]) } else { 0.0 };
            s[i] = if used { ln(1.0 + slope[i] * slope[i]) } else { 0.0 };
        }
        let n = sum(known, known);
        if n == 0.0 {
            return 1.0;
        }
        let (mean_w, mean_s) = (sum(w, known) / n, sum(s, known) / n);
        for i in 0..count {
            w[i] -= known[i] * mean_w;
            s[i] -= known[i] * mean_s;
        }
        let (cross, square) = (sum(w, s), sum(s, s));
        // Neighbours' widths go together: about one in ten lines says something of its own.
        let known = 0.1 * square / (UNEVEN * UNEVEN);
        let prior = DOUBT.powi(-2);
        let told = if square > 0.0 { cross / square } else { 1.0 };
        ((prior + known * told) / (prior + known)).clamp(0.0, 1.0)
    }
}

/// Σ a b, in sums that go beside each other and are the same ones on all processors.
#[inline(always)]
fn sum(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0f32; CHUNK];
    let (a, b) = (a.chunks_exact(CHUNK), b.chunks_exact(CHUNK));
    let rest: f32 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a.zip(b) {
        for l in 0..CHUNK {
            sums[l] += a[l] * b[l];
        }
    }
    sums.iter().sum::<f32>() + rest
}
