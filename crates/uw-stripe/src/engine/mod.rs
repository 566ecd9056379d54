//! The fast part of the extraction: vector kernels over the image as it lies in memory, without a copy of it.
//!
//! | step | module |
//! |---|---|
//! | block maxima, at the speed of a read | `maxima` |
//! | candidates: what stands out of them | `front`, `rows`, `columns` |
//! | windows around them, one register two offsets of many lines | `window` |
//! | shift, height, background, sigma: matched filters | `fir` |
//! | centre of gravity, Blais and Rioux: for comparison | `classic` |
//! | estimates to results, with verdicts | `measure` |
//! | hot and dead pixels, grains in the water | `spikes` |
//! | lines that differ in width alone | `widths` |
//! | two candidates a line, neighbours, what the filters cannot do | `robust` |
//! | edges of brightness, speckle, ends and bends: what only the lines together show | `along` |
//! | only around the last image's positions | `gate` |
//!
//! Every step works on vectors of a fixed number of pixels and in IEEE operations of a fixed order, so that all processors give the same
//! bits; [`Level`] chooses the instructions at run time.

mod aligned;
mod along;
pub(crate) mod classic;
mod columns;
pub(crate) mod fir;
mod front;
mod gate;
pub(crate) mod lanes;
mod maxima;
mod measure;
mod robust;
mod rows;
mod spikes;
#[cfg(test)]
mod tests;
mod widths;
mod window;

use fearless_simd::{Level, dispatch};

use crate::profile::Stripe;
use crate::{Axis, NoiseModel, Pixel, Roi, View};
use along::Along;
use fir::{Bank, Estimates};
use front::{Front, Wanted};
use gate::Gate;
pub use gate::Tracking;
use measure::group_from;
use robust::Second;
use spikes::Cleaned;
use widths::Widths;
use window::{GROUP, Windows};

/// What the kernels must know of stripe and camera, and what decides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Model {
    pub noise: NoiseModel,
    /// Standard deviation of the cross section, px.
    pub width_px: f32,
    pub min_snr: f32,
    pub max_sigma_px: f32,
    pub max_width_px: f32,
}

/// Which estimate is made at the candidates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Fast,
    Robust,
    Cog,
    BlaisRioux,
}

/// Buffers of one pixel type.
#[derive(Debug, Default)]
pub struct Buffers<P> {
    front: Front<P>,
    windows: Windows<P>,
    cleaned: Cleaned<P>,
}

impl<P: Pixel> Buffers<P> {
    /// The last image without its lone pixels, if it had any and all of it was looked at.
    pub(crate) fn cleaned(&self) -> Option<View<'_, P>> {
        self.cleaned.image()
    }
}

/// Buffers of both pixel types.
#[derive(Debug, Default)]
pub struct AllBuffers {
    pub(crate) bytes: Buffers<u8>,
    pub(crate) words: Buffers<u16>,
}

/// The kernels with their filters and buffers.
#[derive(Debug)]
pub(crate) struct Engine {
    level: Level,
    bank: Bank,
    model: Model,
    estimates: Estimates,
    widths: Widths,
    second: Second,
    along: Along,
    gate: Gate,
    /// Whether some pixel of the last look looked like no light of a stripe.
    suspect: bool,
}

/// One image and what to look for in it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Job<'a, P> {
    pub image: View<'a, P>,
    pub roi: Roi,
    pub axis: Axis,
    pub kind: Kind,
}

impl<P: Pixel> Job<'_, P> {
    /// First line and first pixel of the region, and the lines' length.
    fn origin(&self) -> (usize, usize, usize) {
        match self.axis {
            Axis::PerRow => (self.roi.y, self.roi.x, self.roi.width),
            Axis::PerColumn => (self.roi.x, self.roi.y, self.roi.height),
        }
    }

    /// Grey value of a pixel of a line, both counted from the region's first, DN.
    fn dn(&self, line: usize, pixel: usize) -> f32 {
        let (x, y) = match self.axis {
            Axis::PerRow => (pixel, line),
            Axis::PerColumn => (line, pixel),
        };
        self.image.row(self.roi.y + y)[self.roi.x + x].dn()
    }

    /// Lines in the region.
    fn lines(&self) -> usize {
        self.axis.lines(self.roi.width, self.roi.height)
    }
}

impl Engine {
    /// Kernels for a stripe and camera, in the instructions of `level`.
    pub fn new(level: Level, model: Model) -> Self {
        Self {
            level,
            bank: Bank::new(model.width_px, model.noise, model.min_snr),
            model,
            estimates: Estimates::default(),
            widths: Widths::default(),
            second: Second::new(level),
            along: Along::default(),
            gate: Gate::default(),
            suspect: false,
        }
    }

    /// What the kernels were made for.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Fills `stripe` with one entry a line.
    pub fn extract<P: Pixel>(
        &mut self,
        job: Job<'_, P>,
        tracking: Option<Tracking>,
        buffers: &mut Buffers<P>,
        stripe: &mut Stripe,
    ) {
        let total = job.axis.lines(job.image.width(), job.image.height());
        // Every entry of the region is written: only what lies outside needs clearing.
        if stripe.len() != total || stripe.axis != job.axis || job.lines() != total {
            stripe.reset(job.axis, total);
        }
        stripe.noise = self.model.noise;
        stripe.scatter_widths = 0.0;
        stripe.unbent_px.fill(0.0);
        buffers.cleaned.reset();
        match tracking {
            Some(tracking) => self.tracked(job, tracking, buffers, stripe),
            None => self.region(&job, false, buffers, stripe),
        }
        if job.kind == Kind::Robust {
            self.company(job, stripe);
            self.along(job, stripe);
        }
    }

    /// One region, by the kind of estimate asked for. `near`: there is nothing in the region but what lies around the stripe.
    #[inline(never)]
    fn region<P: Pixel>(
        &mut self,
        job: &Job<'_, P>,
        near: bool,
        buffers: &mut Buffers<P>,
        stripe: &mut Stripe,
    ) {
        self.look(job, near, buffers, stripe);
        // What others would make of the image is not ours to mend.
        if !self.suspect || !matches!(job.kind, Kind::Fast | Kind::Robust) {
            return self.second_look(job, near, buffers, stripe);
        }
        let mut cleaned = std::mem::take(&mut buffers.cleaned);
        let mut job = *job;
        if let Some(image) = self.cleaned(&job, &mut cleaned) {
            job.image = image;
            self.look(&job, near, buffers, stripe);
        }
        self.second_look(&job, near, buffers, stripe);
        buffers.cleaned = cleaned;
    }

    /// Strongest candidates and estimates at them.
    fn look<P: Pixel>(
        &mut self,
        job: &Job<'_, P>,
        near: bool,
        buffers: &mut Buffers<P>,
        stripe: &mut Stripe,
    ) {
        self.suspect = false;
        if job.kind == Kind::Robust {
            self.first::<P, true>(job, near, buffers, stripe);
        } else {
            self.first::<P, false>(job, near, buffers, stripe);
        }
    }

    /// What else there may be.
    fn second_look<P: Pixel>(
        &mut self,
        job: &Job<'_, P>,
        near: bool,
        buffers: &mut Buffers<P>,
        stripe: &mut Stripe,
    ) {
        if job.kind == Kind::Robust {
            self.robust(*job, buffers, stripe);
        } else if !near && self.alone(job, buffers, stripe) {
            self.take(job, buffers, stripe);
        }
    }

    /// Candidates and estimates at the strongest: of rows group by group, while their pixels are at hand. `near`: there is nothing in the region
    /// but what lies around the stripe.
    ///
    /// Each step takes the processor's instructions for itself, for a group of lines at a time: it is compiled once for each, not
    /// once for each way to it, and the choice costs nothing beside a group.
    #[inline(never)]
    fn first<P: Pixel, const EXTRA: bool>(
        &mut self,
        job: &Job<'_, P>,
        near: bool,
        buffers: &mut Buffers<P>,
        stripe: &mut Stripe,
    ) {
        let second = EXTRA.then_some(self.model.noise);
        let wanted = Wanted { width_px: self.model.width_px, second };
        let (level, lines) = (self.level, job.lines());
        let near = near && Front::<P>::numbers(job.roi.width);
        buffers.front.reset(lines);
        if job.axis == Axis::PerColumn {
            buffers.front.columns(level, &job.image, job.roi, wanted);
        }
        for from in (0..lines).step_by(GROUP) {
            let group = group_from(job, from);
            match job.axis {
                Axis::PerRow if near => {
                    buffers.front.rows_nearby(level, &job.image, job.roi, group.clone());
                }
                Axis::PerRow => buffers.front.rows(level, &job.image, &job.roi, &wanted, group.clone()),
                Axis::PerColumn => {}
            }
            self.group::<P, EXTRA>(job, buffers, 0, group, stripe);
        }
    }
}

/// The largest grey value of an image: nothing but a read, in the instructions of the processor at hand; what the kernels' speed is
/// compared with.
pub fn brightest<P: Pixel>(image: &View<'_, P>) -> f32 {
    P::brightest(image)
}

pub(crate) fn brightest_pixel<P: Pixel>(image: &View<'_, P>) -> f32 {
    let level = Level::new();
    dispatch!(level, simd => maxima::read(simd, image, image.bounds())).dn()
}
