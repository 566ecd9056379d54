//! Region of interest from image to image: only the pixels around the last positions are read.

use super::lanes::{CHUNK, MOST_LANES};
use super::{Buffers, Engine, Job, Kind};
use crate::profile::{Flags, Stripe};
use crate::{Axis, Pixel, Roi};

/// How the stripe is followed from image to image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tracking {
    /// Pixels looked at on either side of the last image's positions.
    pub reach_px: usize,
    /// Every how many images all pixels are looked at; 1: always.
    pub full_every: u32,
}

impl Default for Tracking {
    fn default() -> Self {
        Self { reach_px: 24, full_every: 100 }
    }
}

/// Share of a group's lines that must be found again where they were; otherwise the whole lines are searched.
const FOUND_AGAIN: f32 = 0.5;

/// What is kept of the last image.
#[derive(Debug, Default)]
pub(super) struct Gate {
    /// Lowest and highest position of each group of lines, and how many there were; `None`: to be searched for.
    groups: Vec<Option<Extent>>,
    /// Region and direction that the groups are of.
    of: Option<(Roi, Axis)>,
    age: u32,
}

#[derive(Debug, Clone, Copy)]
struct Extent {
    low: f32,
    high: f32,
    found: usize,
}

impl Engine {
    /// As without tracking, but only around the last positions; lines of groups that had to be searched for anew are flagged.
    pub(super) fn tracked<P: Pixel>(
        &mut self,
        job: Job<'_, P>,
        tracking: Tracking,
        buffers: &mut Buffers<P>,
        stripe: &mut Stripe,
    ) {
        let groups = job.lines().div_ceil(MOST_LANES);
        let all = self.gate.of != Some((job.roi, job.axis)) || self.gate.age + 1 >= tracking.full_every;
        self.gate.of = Some((job.roi, job.axis));
        self.gate.age = if all { 0 } else { self.gate.age + 1 };
        self.gate.groups.resize(groups, None);
        if all {
            self.region(&job, false, buffers, stripe);
            for group in 0..groups {
                self.gate.groups[group] = extent(&job, group, stripe);
            }
        } else {
            self.gated(job, tracking, buffers, stripe);
        }
    }

    /// Looks at the groups' parts one after the other, and at whole lines where they hold too little of the stripe.
    fn gated<P: Pixel>(
        &mut self,
        job: Job<'_, P>,
        tracking: Tracking,
        buffers: &mut Buffers<P>,
        stripe: &mut Stripe,
    ) {
        for group in 0..self.gate.groups.len() {
            let last = self.gate.groups[group];
            let (mut around, mut now) = (last, None);
            for again in [false, true] {
                let part = part(&job, group, around, tracking.reach_px);
                let near = around.is_some() && part.kind != Kind::Robust;
                self.region(&part, near, buffers, stripe);
                now = extent(&job, group, stripe);
                if again {
                    let (first, _, _) = part.origin();
                    for flags in &mut stripe.flags[first..first + part.lines()] {
                        *flags |= Flags::TRACK_LOST;
                    }
                }
                let found = now.map_or(0, |e| e.found);
                if last.is_none_or(|last| found as f32 >= FOUND_AGAIN * last.found as f32) {
                    break;
                }
                around = None;
            }
            self.gate.groups[group] = now;
        }
    }
}

/// Lines of a group in the image; the last group is moved back to hold as many as the others, where there are as many.
fn lines<P: Pixel>(job: &Job<'_, P>, group: usize) -> std::ops::Range<usize> {
    let (first, _, _) = job.origin();
    let count = job.lines();
    let from = (group * MOST_LANES).min(count.saturating_sub(MOST_LANES));
    first + from..first + (from + MOST_LANES).min(count)
}

/// The part of the region that a group's lines are looked for in.
fn part<'a, P: Pixel>(job: &Job<'a, P>, group: usize, last: Option<Extent>, reach: usize) -> Job<'a, P> {
    let (_, first_pixel, length) = job.origin();
    let lines = lines(job, group);
    let (from, size) = last.map_or((first_pixel, length), |e| {
        let low = (e.low - first_pixel as f32 - reach as f32).floor().max(0.0) as usize;
        let high = (e.high - first_pixel as f32 + reach as f32).ceil().max(0.0) as usize;
        // At least a vector, for which the kernels are made.
        let size = (high + 1).saturating_sub(low).max(MOST_LANES).min(length);
        (first_pixel + low.min(length - size), size)
    });
    let roi = match job.axis {
        Axis::PerRow => Roi { x: from, y: lines.start, width: size, height: lines.len() },
        Axis::PerColumn => Roi { x: lines.start, y: from, width: lines.len(), height: size },
    };
    Job { roi, ..*job }
}

/// Where a group's lines were found.
#[inline(always)]
fn extent<P: Pixel>(job: &Job<'_, P>, group: usize, stripe: &Stripe) -> Option<Extent> {
    // Lane by lane, so that it goes sixteen lines at a time.
    let (mut low, mut high) = ([f32::INFINITY; CHUNK], [f32::NEG_INFINITY; CHUNK]);
    let mut found = [0u32; CHUNK];
    let mut see = |l: usize, position: f32| {
        // NaN changes neither.
        low[l] = if position < low[l] { position } else { low[l] };
        high[l] = if position > high[l] { position } else { high[l] };
        found[l] += u32::from(!position.is_nan());
    };
    let (parts, rest) = stripe.position_px[lines(job, group)].as_chunks::<CHUNK>();
    for part in parts {
        for (l, position) in part.iter().enumerate() {
            see(l, *position);
        }
    }
    for (l, position) in rest.iter().enumerate() {
        see(l, *position);
    }
    let found = found.iter().sum::<u32>() as usize;
    let low = low.iter().copied().fold(f32::INFINITY, f32::min);
    let high = high.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    (found > 0).then_some(Extent { low, high, found })
}
