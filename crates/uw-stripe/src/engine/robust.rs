//! Two candidates a line, the neighbours' say in which is taken, and likelihood where the filters' model does not hold.

use super::front::{NOWHERE, Wanted};
use super::maxima::ROWS;
use super::measure::group_from;
use super::window::GROUP;
use super::{Buffers, Engine, Job, Model};
use crate::lines::{Clip, Line};
use crate::mle::{self, Common, Fit, Fitter, Seed, Source, WINDOW, WidthPrior};
use crate::peak::{Candidate, Candidates, stands_out};
use crate::profile::{Flags, Reject, Stripe, union};
use crate::track::{Tracker, go_on};
use crate::verdict::{self, LEAST_RUN, run_reach};
use crate::{Axis, Pixel};
use fearless_simd::Level;
use std::ops::Range;

/// Share of the taken peak's height from which another counts as a rival.
const RIVAL_SHARE: f32 = 0.15;
/// Length of the box, in widths, that best tells a stripe from what is beside it.
const BOX_WIDTHS: f32 = 2.5;
/// Prior sigma of ln width in the refinement: weak.
const WIDTH_SIGMA: f64 = 0.35;

/// Buffers for second candidates and refinement.
#[derive(Debug)]
pub(super) struct Second {
    pub(super) stripe: Stripe,
    candidates: Vec<Candidates>,
    tracker: Tracker,
    choice: Vec<Option<usize>>,
    keep: Vec<bool>,
    local: Local,
    seeds: Vec<Option<Seed>>,
    fitter: Fitter,
    fits: Vec<Option<Fit>>,
    shapes: Vec<Option<mle::surroundings::Shape>>,
}

impl Second {
    pub(super) fn new(level: Level) -> Self {
        Self {
            stripe: Stripe::empty(),
            candidates: Vec::new(),
            tracker: Tracker::default(),
            choice: Vec::new(),
            keep: Vec::new(),
            local: Local::default(),
            seeds: Vec::new(),
            fitter: Fitter::new(level),
            fits: Vec::new(),
            shapes: Vec::new(),
        }
    }
}

/// The pixels around the stripe on those lines that are refined, one after the other.
#[derive(Debug, Default)]
struct Local {
    value: Vec<f32>,
    clip: Vec<Clip>,
    /// Where a line's are.
    ranges: Vec<Range<usize>>,
}

impl Local {
    fn clear(&mut self) {
        self.value.clear();
        self.clip.clear();
        self.ranges.clear();
    }

    /// Copies the pixels that a fit on this line may come to, and says where it starts: at what the filters found.
    fn push<P: Pixel>(
        &mut self,
        job: &Job<'_, P>,
        line: usize,
        model: &Model,
        stripe: &Stripe,
    ) -> Option<Seed> {
        let (first_line, first_pixel, length) = job.origin();
        let centre = f64::from(stripe.position_px[line]) - first_pixel as f64;
        let amplitude = f64::from(stripe.amplitude[line]);
        if !centre.is_finite() || amplitude.is_nan() || amplitude <= 0.0 {
            self.skip();
            return None;
        }
        let before = self.value.len();
        let from = first_copied(model, centre, length);
        let to = (centre.round() as i64 + reach(model) + 1).clamp(0, length as i64) as usize;
        for i in from..to {
            let v = job.dn(line - first_line, i);
            self.value.push(v);
            self.clip.push(Clip::of(v, model.noise.full_scale_dn));
        }
        self.ranges.push(before..self.value.len());
        let width = f64::from(model.width_px);
        Some(Seed {
            centre: centre - from as f64,
            width,
            flux: amplitude * width * (2.0 * std::f64::consts::PI).sqrt(),
            background: f64::from(stripe.background[line]),
        })
    }

    /// A line of which nothing is needed.
    fn skip(&mut self) {
        self.ranges.push(0..0);
    }
}

/// Pixels on either side of the widest window that a fit may come to.
fn reach(model: &Model) -> i64 {
    (WINDOW.0 * f64::from(model.max_width_px) + WINDOW.1).ceil() as i64 + 4
}

/// First pixel that is copied for the refinement of a stripe at `centre`.
fn first_copied(model: &Model, centre: f64, length: usize) -> usize {
    (centre.round() as i64 - reach(model)).clamp(0, length as i64) as usize
}

impl Source for Local {
    fn line(&self, k: usize) -> Line<'_> {
        let range = self.ranges[k].clone();
        Line::plain(&self.value[range.clone()], &self.clip[range])
    }
}

impl Engine {
    /// Once the first candidates are measured: measures the second, takes the ones that make a stripe and refines what needs it.
    pub(super) fn robust<P: Pixel>(
        &mut self,
        job: Job<'_, P>,
        buffers: &mut Buffers<P>,
        stripe: &mut Stripe,
    ) {
        self.drop_steps(&job, stripe);
        if buffers.front.places[1].at.iter().fold(false, |any, at| any | (*at != NOWHERE)) {
            self.second_say(job, buffers, stripe);
        }
        if self.alone(&job, buffers, stripe) {
            self.second_say(job, buffers, stripe);
        }
        if self.goes_on(job, &mut buffers.front.places[1].at, stripe) {
            self.second_say(job, buffers, stripe);
        }
        self.by_width(&job, buffers, stripe);
        let (first_line, _, _) = job.origin();
        let lines = first_line..first_line + job.lines();
        let needs = |s: &Stripe, line: usize| {
            s.flags[line].contains(Flags::SATURATED)
                || (s.flags[line].contains(Flags::EDGE) && s.reject[line].is_none())
        };
        // Few images have any.
        let any = union(&stripe.flags[lines.clone()]);
        let unfit = Flags::SATURATED | Flags::EDGE;
        if any.without(unfit) == any || !lines.clone().any(|line| needs(stripe, line)) {
            return;
        }
        let Self { second, model, .. } = self;
        second.local.clear();
        second.seeds.clear();
        for line in lines.clone() {
            let seed = if needs(stripe, line) {
                second.local.push(&job, line, model, stripe)
            } else {
                second.local.skip();
                None
            };
            second.seeds.push(seed);
        }
        let prior = WidthPrior { ln_width: f64::from(model.width_px).ln(), sigma: WIDTH_SIGMA };
        let common = Common { noise: &model.noise, width: Some(prior) };
        second.fitter.fit(second.seeds.iter().copied(), &second.local, common, &mut second.fits);
        for (fit, seed) in second.fits.iter_mut().zip(&second.seeds) {
            // A fit that left its window found something else.
            let stayed =
                |f: &Fit, seed: &Seed| (f.centre - seed.centre).abs() <= WINDOW.0 * f.width + WINDOW.1;
            *fit = fit.filter(|fit| seed.is_some_and(|seed| stayed(fit, &seed)));
        }
        mle::surroundings::share(&mut second.fits, &mut second.shapes);
        for (line, fit) in lines.zip(&self.second.fits) {
            match fit {
                Some(fit) => self.replace(job, line, fit, stripe),
                None if stripe.flags[line].contains(Flags::SATURATED) && stripe.reject[line].is_none() => {
                    stripe.drop_line(line, Reject::NotConverged);
                }
                None => {}
            }
        }
    }

    /// Takes out what stands out of one side only: the filters answer to a step of brightness as well, if less than to a stripe of its height, and
    /// then lack what their model lacks of one.
    fn drop_steps<P: Pixel>(&self, job: &Job<'_, P>, stripe: &mut Stripe) {
        let (first_line, first_pixel, length) = job.origin();
        let lines = first_line..first_line + job.lines();
        let any = union(&stripe.flags[lines.clone()]);
        if any.without(Flags::EDGE) == any {
            return;
        }
        let half = (0.5 * BOX_WIDTHS * self.model.width_px).round().max(1.0) as i64;
        for line in lines {
            let flags = stripe.flags[line];
            let clipped = flags.contains(Flags::SATURATED);
            if !flags.contains(Flags::EDGE) || clipped || stripe.reject[line].is_some() {
                continue;
            }
            let centre = stripe.position_px[line].round() as i64 - first_pixel as i64;
            let dn = |i: i64| f64::from(job.dn(line - first_line, i as usize));
            let mean = |middle: i64| {
                let inside = middle >= half && middle + half < length as i64;
                inside.then(|| (middle - half..=middle + half).map(dn).sum::<f64>() / (2 * half + 1) as f64)
            };
            let beside = 2 * half + 1;
            let (left, right) = (mean(centre - beside), mean(centre + beside));
            // At the border the other side has to do.
            let sides = (mean(centre), left.or(right), right.or(left));
            if let (Some(middle), Some(left), Some(right)) = sides
                && !stands_out(middle, left, right)
            {
                // Not as dark lines, among which others' stripes are looked for.
                stripe.drop_line(line, Reject::Edge);
            }
        }
    }

    /// Looks at the rows on which nothing was found, each for itself, where other rows of their block may have hidden it, and fills the places of
    /// second rank; false if there is nothing new.
    pub(super) fn alone<P: Pixel>(
        &self,
        job: &Job<'_, P>,
        buffers: &mut Buffers<P>,
        stripe: &Stripe,
    ) -> bool {
        let (first_line, _, _) = job.origin();
        let lines = first_line..first_line + job.lines();
        let (position, reject) = (&stripe.position_px[lines.clone()], &stripe.reject[lines]);
        // Columns have candidates of their own anyway.
        if job.axis == Axis::PerColumn || !position.iter().fold(false, |any, p| any | p.is_nan()) {
            return false;
        }
        let dark =
            |reject: &Option<Reject>| matches!(reject, Some(Reject::NoSignal | Reject::BelowThreshold));
        let wanted = Wanted { width_px: self.model.width_px, second: None };
        let front = &mut buffers.front;
        front.places[1].at.fill(NOWHERE);
        let mut any = false;
        for (first, block) in (0..).step_by(ROWS).zip(reject.chunks(ROWS)) {
            if block.iter().all(dark) {
                continue;
            }
            for line in (first..).zip(block).filter_map(|(line, reject)| reject.map(|_| line)) {
                let found = front.row(self.level, &job.image, &job.roi, &wanted, line);
                if let Some(at) = found.filter(|at| *at != front.places[0].at[line]) {
                    front.places[1].at[line] = at;
                    any = true;
                }
            }
        }
        any
    }

    /// Takes the candidates of second rank where there is nothing yet.
    pub(super) fn take<P: Pixel>(&mut self, job: &Job<'_, P>, buffers: &mut Buffers<P>, stripe: &mut Stripe) {
        let mut second = self.seconds::<P, false>(job, buffers, stripe);
        let (first_line, _, _) = job.origin();
        for line in first_line..first_line + job.lines() {
            if stripe.position_px[line].is_nan() && !second.position_px[line].is_nan() {
                swap_line(stripe, &mut second, line);
            }
        }
        self.second.stripe = second;
    }

    /// Measures the candidates of second rank and takes those that make a stripe.
    #[inline(never)]
    fn second_say<P: Pixel>(&mut self, job: Job<'_, P>, buffers: &mut Buffers<P>, stripe: &mut Stripe) {
        let mut second = self.seconds::<P, true>(&job, buffers, stripe);
        self.drop_steps(&job, &mut second);
        self.arbitrate(job, stripe, &mut second);
        self.second.stripe = second;
    }

    /// Measures the candidates of second rank.
    #[inline(never)]
    fn seconds<P: Pixel, const EXTRA: bool>(
        &mut self,
        job: &Job<'_, P>,
        buffers: &mut Buffers<P>,
        stripe: &Stripe,
    ) -> Stripe {
        let mut second = std::mem::replace(&mut self.second.stripe, Stripe::empty());
        // Every line of the region is written.
        if second.len() != stripe.len() {
            second.reset(job.axis, stripe.len());
        }
        for from in (0..job.lines()).step_by(GROUP) {
            self.group::<P, EXTRA>(job, buffers, 1, group_from(job, from), &mut second);
        }
        second
    }

    /// Where the stripe breaks off, looks for it next to where it was, since something brighter may have kept it from being a candidate:
    /// fills `places`; false if there is nothing new.
    fn goes_on<P: Pixel>(&self, job: Job<'_, P>, places: &mut [u32], stripe: &Stripe) -> bool {
        /// Sigmas of a pixel that it must stand out by; the verdict falls on its height through the filter.
        const SIGMAS: f64 = 4.0;
        let (first_line, first_pixel, length) = job.origin();
        let position = &stripe.position_px[first_line..first_line + job.lines()];
        let reach = run_reach(self.model.width_px);
        if unbroken(position, reach) {
            return false;
        }
        places.fill(NOWHERE);
        let arm = (3.5 * self.model.width_px).ceil() as usize;
        let look = |line: usize, expected: f32| {
            let value = |i: usize| job.dn(line, i);
            let expected = expected - first_pixel as f32;
            let from = (expected - reach).ceil().max(0.0) as usize;
            let to = ((expected + reach).max(-1.0) + 1.0) as usize;
            let at = (from..to.min(length)).max_by(|&a, &b| value(a).total_cmp(&value(b)).then(b.cmp(&a)))?;
            let around = 0.5 * (value(at.saturating_sub(arm)) + value((at + arm).min(length - 1)));
            let noise = self.model.noise.variance(f64::from(around), 0.0).sqrt();
            (f64::from(value(at) - around) > SIGMAS * noise).then_some((at + first_pixel) as u32)
        };
        let any = go_on(position, reach, look, NOWHERE, places);
        places.iter_mut().filter(|at| **at != NOWHERE).for_each(|at| *at -= first_pixel as u32);
        any
    }

    /// Takes the second candidate where it continues the neighbours' stripe and the first does not.
    #[inline(never)]
    fn arbitrate<P: Pixel>(&mut self, job: Job<'_, P>, stripe: &mut Stripe, second: &mut Stripe) {
        let (first_line, _, _) = job.origin();
        let lines = first_line..first_line + job.lines();
        let scale = (BOX_WIDTHS * self.model.width_px).round().max(1.0) as usize;
        let buffers = &mut self.second;
        buffers.candidates.clear();
        let mut rivals = false;
        for line in lines.clone() {
            let mut found = Candidates::default();
            let apart =
                (stripe.position_px[line] - second.position_px[line]).abs() > 4.0 * self.model.width_px;
            let strong = |s: &Stripe| s.reject[line].is_none() || s.flags[line].contains(Flags::SATURATED);
            let rival = strong(second)
                && (!strong(stripe)
                    || apart && second.amplitude[line] > RIVAL_SHARE * stripe.amplitude[line]);
            rivals |= rival;
            for (s, used) in [(&*stripe, strong(stripe)), (&*second, rival)] {
                if used && s.position_px[line] >= 0.0 {
                    found.push(Candidate {
                        centre: s.position_px[line].round() as usize,
                        scale,
                        snr: s.amplitude[line] / s.sigma_px[line],
                        flux: s.amplitude[line],
                        background: s.background[line],
                    });
                }
            }
            buffers.candidates.push(found);
        }
        if !rivals {
            return;
        }
        buffers.tracker.choose(&buffers.candidates, &mut buffers.choice);
        for ((line, found), choice) in lines.zip(&buffers.candidates).zip(&buffers.choice) {
            let Some(taken) = choice.and_then(|k| found.as_slice().get(k)) else { continue };
            let is_second = |position: f32| position.round() as usize == taken.centre;
            if !is_second(stripe.position_px[line]) && is_second(second.position_px[line]) {
                swap_line(stripe, second, line);
            }
            if found.as_slice().len() > 1 {
                stripe.flags[line] |= Flags::SEVERAL_PEAKS;
                stripe.rival_ratio[line] = second.amplitude[line] / stripe.amplitude[line];
            }
        }
    }

    /// Writes a refined line, with the verdict on it.
    fn replace<P: Pixel>(&self, job: Job<'_, P>, line: usize, fit: &Fit, stripe: &mut Stripe) {
        let (_, first_pixel, length) = job.origin();
        let sigma = fit.sigma * verdict::chi2_scale(fit).sqrt();
        let filtered = f64::from(stripe.position_px[line]) - first_pixel as f64;
        let local = fit.centre + first_copied(&self.model, filtered, length) as f64;
        let position = local + first_pixel as f64;
        // What the filters lacked is in the fit, or was clipped.
        stripe.flags[line] = stripe.flags[line].without(Flags::EDGE) | verdict::flags(fit);
        stripe.position_px[line] = position as f32;
        stripe.sigma_px[line] = sigma as f32;
        verdict::write(stripe, line, fit);
        let pixel = self.model.noise.variance(fit.background.max(0.0), 0.0);
        let snr = verdict::snr(fit, pixel);
        stripe.reject[line] = None;
        let clipped = fit.saturated > 0;
        let reason = if snr.is_nan() || snr < f64::from(self.model.min_snr) {
            Some(if clipped { Reject::Saturated } else { Reject::BelowThreshold })
        } else if fit.width > f64::from(self.model.max_width_px) {
            Some(Reject::TooWide)
        } else if local - fit.width < -0.5 || local + fit.width > length as f64 - 0.5 {
            Some(Reject::AtBorder)
        } else if sigma.is_nan() || sigma > f64::from(self.model.max_sigma_px) {
            Some(if clipped { Reject::Saturated } else { Reject::Imprecise })
        } else {
            None
        };
        if let Some(reason) = reason {
            stripe.drop_line(line, reason);
        }
    }

    /// Takes out what no neighbours agree with.
    pub(super) fn company<P: Pixel>(&mut self, job: Job<'_, P>, stripe: &mut Stripe) {
        let (first_line, _, _) = job.origin();
        let lines = first_line..first_line + job.lines();
        let reach = run_reach(self.model.width_px);
        // Nearly always one run from end to end: then there is nothing to keep book of.
        let position = &stripe.position_px[lines.clone()];
        if position.len() >= LEAST_RUN && unbroken(position, reach) {
            return;
        }
        verdict::drop_lonely(stripe, lines, |_| true, &mut self.second.keep);
    }
}

/// Whether no step from a line to the next is longer than `reach`, and none is missing; without an early end, which vectors do not have.
fn unbroken(position: &[f32], reach: f32) -> bool {
    let mut unbroken = true;
    for pair in position.windows(2) {
        unbroken &= (pair[1] - pair[0]).abs() <= reach;
    }
    unbroken
}

/// Exchanges one line of two results.
fn swap_line(a: &mut Stripe, b: &mut Stripe, line: usize) {
    for (a, b) in [
        (&mut a.position_px, &mut b.position_px),
        (&mut a.sigma_px, &mut b.sigma_px),
        (&mut a.amplitude, &mut b.amplitude),
        (&mut a.width_px, &mut b.width_px),
        (&mut a.background, &mut b.background),
        (&mut a.chi2, &mut b.chi2),
        (&mut a.rival_ratio, &mut b.rival_ratio),
    ] {
        std::mem::swap(&mut a[line], &mut b[line]);
    }
    std::mem::swap(&mut a.flags[line], &mut b.flags[line]);
    std::mem::swap(&mut a.reject[line], &mut b.reject[line]);
}
