//! Estimates at the candidates, and the verdicts on them.

use std::ops::Range;

use fearless_simd::{Simd, dispatch};

use super::fir::Estimates;
use super::front::NOWHERE;
use super::window::{GROUP, Group};
use super::{Buffers, Engine, Job, Kind, classic};
use crate::profile::{Flags, Reject, Stripe};
use crate::{Axis, Pixel};

/// Chi-square over the two shapes that the filters lack from which a line is refined (once in a hundred thousand lines by noise), if the shift
/// that goes with it is this many sigmas, or the logarithm of the width this large.
const LOPSIDED: f32 = 11.5;
const LEAN_SIGMAS: f32 = 1.0;
pub(super) const WIDENING: f32 = 0.1;
/// Least width by the filters', whose reading of it is a first order.
const NARROWEST: f32 = 0.25;

/// The width that filters of a width read by its logarithm.
#[inline(always)]
pub(super) fn read_width(width_px: f32, ln_width: f32) -> f32 {
    width_px * (1.0 + ln_width).max(NARROWEST)
}

/// Lines of the group that starts at `from`, counted from the region's first; the last group of columns overlaps the one before.
pub(super) fn group_from<P: Pixel>(job: &Job<'_, P>, from: usize) -> Range<usize> {
    let lines = job.lines();
    let first = match job.axis {
        Axis::PerRow => from,
        Axis::PerColumn => from.min(lines.saturating_sub(GROUP)),
    };
    first..(from + GROUP).min(lines)
}

impl Engine {
    /// Estimates and verdicts at the candidates of a rank, for one group of lines; with `EXTRA` also what the model of the filters lacks.
    #[inline(never)]
    pub(super) fn group<P: Pixel, const EXTRA: bool>(
        &mut self,
        job: &Job<'_, P>,
        buffers: &mut Buffers<P>,
        rank: usize,
        lines: Range<usize>,
        stripe: &mut Stripe,
    ) {
        let level = self.level;
        dispatch!(level, simd => self.group_here::<_, P, EXTRA>(simd, job, buffers, (rank, &lines), stripe));
    }

    #[inline(always)]
    fn group_here<S: Simd, P: Pixel, const EXTRA: bool>(
        &mut self,
        simd: S,
        job: &Job<'_, P>,
        buffers: &mut Buffers<P>,
        (rank, lines): (usize, &Range<usize>),
        stripe: &mut Stripe,
    ) {
        /// Times that windows are moved to where the estimate points.
        const ROUNDS: usize = 3;
        let (_, _, length) = job.origin();
        let Buffers { front, windows, .. } = buffers;
        let (first, count) = (lines.start, lines.len());
        let at = &mut front.places[rank].at[first..first + count];
        if at.iter().all(|a| *a == NOWHERE) {
            self.estimates = Estimates::default();
            self.write::<P, EXTRA>(job, first, (rank, at), stripe);
            return;
        }
        for round in 0..ROUNDS {
            let group = Group { first, at, half: self.bank.half };
            windows.load(simd, &job.image, (job.roi, job.axis), group);
            self.bank.estimate::<S, P, EXTRA>(simd, windows, count, &mut self.estimates);
            if round + 1 == ROUNDS || !self.recentre(at, length) {
                break;
            }
        }
        if !EXTRA && matches!(job.kind, Kind::Cog | Kind::BlaisRioux) {
            let values = windows.values(simd, self.bank.half);
            if job.kind == Kind::Cog {
                classic::centre_of_gravity(&self.bank, values, &mut self.estimates);
            } else {
                classic::blais_rioux(&self.bank, values, &mut self.estimates);
            }
        }
        self.write::<P, EXTRA>(job, first, (rank, at), stripe);
    }

    /// Moves the places whose stripe lies too far beside; true where one moved.
    #[inline(always)]
    fn recentre(&self, at: &mut [u32], length: usize) -> bool {
        let far = self.bank.recentre;
        let mut any = false;
        for shift in &self.estimates.shift[..at.len()] {
            any |= shift.abs() > far;
        }
        let mut moved = false;
        if any {
            for (at, shift) in at.iter_mut().zip(&self.estimates.shift) {
                if *at != NOWHERE && shift.abs() > far {
                    let to = (*at as f32 + shift.round()).clamp(0.0, (length - 1) as f32) as u32;
                    moved |= to != *at;
                    *at = to;
                }
            }
        }
        moved
    }

    /// Writes a group's estimates with their verdicts, and notes whether some strongest candidate looks as if a pixel was no light of a stripe.
    #[inline(always)]
    fn write<P: Pixel, const EXTRA: bool>(
        &mut self,
        job: &Job<'_, P>,
        first: usize,
        (rank, at): (usize, &[u32]),
        stripe: &mut Stripe,
    ) {
        let (first_line, first_pixel, length) = job.origin();
        let count = at.len();
        let e = &self.estimates;
        let width = self.bank.width;
        let out = first_line + first..first_line + first + count;
        let (low, high) = (width - 0.5, (length as f32 - 0.5) - width);
        let full = self.model.noise.full_scale_dn;
        let position = &mut stripe.position_px[out.clone()][..count];
        let (shift, excess) = (&e.shift[..count], &e.excess[..count]);
        let (sigma, top) = (&e.sigma[..count], &e.top[..count]);
        // Counted, in numbers as wide as the others: that goes sixteen lines at a time.
        let (mut doubtful, mut lacking) = (0u32, false);
        for l in 0..count {
            let local = at[l] as f32 + shift[l];
            position[l] = local + first_pixel as f32;
            // NaN is no success.
            let fine = (excess[l] >= 0.0)
                & (sigma[l] <= self.model.max_sigma_px)
                & (local >= 3.0 * low)
                & (local <= high - 2.0 * width)
                & (top[l] < full)
                & (at[l] != NOWHERE);
            doubtful += u32::from(!fine);
        }
        stripe.sigma_px[out.clone()].copy_from_slice(&e.sigma[..count]);
        stripe.amplitude[out.clone()].copy_from_slice(&e.amplitude[..count]);
        stripe.background[out.clone()].copy_from_slice(&e.background[..count]);
        stripe.width_px[out.clone()].fill(width);
        stripe.reject[out.clone()].fill(None);
        stripe.flags[out.clone()].fill(Flags::NONE);
        stripe.rival_ratio[out.clone()].fill(if EXTRA { 0.0 } else { f32::NAN });
        if !EXTRA {
            stripe.chi2[out.clone()].fill(f32::NAN);
        } else {
            for (found, ln_width) in stripe.width_px[out.clone()].iter_mut().zip(&e.ln_width) {
                *found = read_width(width, *ln_width);
            }
            for (chi2, l) in stripe.chi2[out.clone()].iter_mut().zip(0..GROUP) {
                *chi2 = e.shape_chi2(l);
                let leans = e.lean[l].abs() > LEAN_SIGMAS * e.sigma[l];
                let wider = e.ln_width[l].abs() > WIDENING;
                lacking |= (*chi2 > LOPSIDED) & (leans | wider);
            }
        }
        if lacking {
            for (l, line) in out.clone().enumerate() {
                let leans = e.lean[l].abs() > LEAN_SIGMAS * e.sigma[l];
                if stripe.chi2[line] > LOPSIDED && (leans || e.ln_width[l].abs() > WIDENING) {
                    stripe.flags[line] |= Flags::EDGE;
                }
            }
        }
        self.suspect |= rank == 0 && (lacking || self.estimates.spike);
        if doubtful == 0 {
            return;
        }
        let e = &self.estimates;
        for (l, (line, &at)) in out.zip(at).enumerate() {
            if at == NOWHERE {
                for array in [
                    &mut stripe.sigma_px,
                    &mut stripe.amplitude,
                    &mut stripe.width_px,
                    &mut stripe.background,
                    &mut stripe.chi2,
                    &mut stripe.rival_ratio,
                ] {
                    array[line] = f32::NAN;
                }
                stripe.drop_line(line, Reject::NoSignal);
                continue;
            }
            let local = at as f32 + e.shift[l];
            if e.top[l] >= full {
                stripe.flags[line] |= Flags::SATURATED;
            }
            if local < 3.0 * low || local > high - 2.0 * width {
                stripe.flags[line] |= Flags::BORDER;
            }
            let reason = if e.excess[l].is_nan() || e.excess[l] < 0.0 {
                Reject::BelowThreshold
            } else if !(low..=high).contains(&local) {
                Reject::AtBorder
            } else if e.sigma[l].is_nan() || e.sigma[l] > self.model.max_sigma_px {
                Reject::Imprecise
            } else {
                continue;
            };
            stripe.drop_line(line, reason);
        }
    }
}
