//! The maximum of the likelihood on some lines side by side: a first look, which is enough for most; iterations for the others, a few at a time, so
//! that those who are there need not wait in their vector for those who are not; and what is known at the end.

#![allow(clippy::needless_range_loop, reason = "indices read as in the formulas")]

use super::dense::Symmetric;
use super::likelihood::Group;
use super::pixels::Pixels;
use super::problem::Problem;
use super::wide::{Mask, Row, V, WIDE, exp, gather};
use super::{CENTRE, DAMPING, LN_WIDTH, MOST, STRAIGHT, Solution, Weights, background};
use fearless_simd::{Level, Select, Simd, SimdBase, SimdFloat, SimdMask, dispatch};

/// Rao's score statistic beyond which a background counts as bent: six coefficients that are zero exceed it once in 2000.
const BENT: f64 = 24.0;
/// Most iterations; three to five are usual.
pub(super) const ITERATIONS: usize = 30;
/// So many are made before those that need more are put together anew.
pub(super) const AT_A_TIME: usize = 3;
/// Iterations before the background is judged straight or bent.
const FIRST_LOOK: usize = 4;
/// Iterations after which the background's origin follows the centre no more.
const PIVOTING: usize = 2;
/// Step, in widths and of ln width, that one solution of the normal equations does as well as an iteration would.
const NEAR: f64 = 0.03;

/// A fit on its way.
#[derive(Debug, Clone)]
pub(super) struct Way {
    pub problem: Problem,
    /// Parameters, those of `size` in use.
    pub at: [f64; MOST],
    pub size: usize,
    /// Origin of the background's polynomials, px.
    pub pivot: f64,
    pub converged: bool,
}

/// Where a fit ended.
#[derive(Debug, Clone)]
pub(super) struct Ended {
    pub way: Way,
    /// The parameters with all that the window could tell.
    pub solution: Solution,
}

/// What becomes of the fit in a lane.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "taken apart at once, never kept")]
pub(super) enum Next {
    /// Iterations, until [`Way::converged`] or [`ITERATIONS`] are made.
    On(Way),
    Done(Ended),
}

impl Ended {
    /// The background at the centre, DN.
    pub fn background(&self) -> f64 {
        let Way { at, size, pivot, problem, .. } = &self.way;
        background(&at[..*size], *pivot, problem.unit)
    }
}

/// Looks at the lines of `problems`, whose windows are in `pixels`, and gives what becomes of each, with its lane, to `each`; not those where
/// there is no stripe to be had.
pub(super) fn look(
    level: Level,
    problems: [&Problem; WIDE],
    pixels: &Pixels,
    noise: Weights,
    each: &mut dyn FnMut(usize, Next),
) {
    dispatch!(level, simd => look_here(simd, problems, pixels, noise, each));
}

#[inline(always)]
fn look_here<S: Simd>(
    simd: S,
    problems: [&Problem; WIDE],
    pixels: &Pixels,
    noise: Weights,
    each: &mut dyn FnMut(usize, Next),
) {
    let middle = gather(simd, |lane| problems[lane].seed.centre);
    let mut group = Group::new(simd, problems, middle, pixels, noise);
    let none = V::splat(simd, 0.0);
    let straight = V::splat(simd, STRAIGHT as f64);
    let full = gather(simd, |lane| problems[lane].full as f64);
    let mut alive = Mask::splat(simd, true);
    // Close around the stripe, on a straight background.
    group.use_pixels(problems.map(|p| &p.close));
    let starts = problems.map(Problem::start);
    let mut first: [V<S>; STRAIGHT] = std::array::from_fn(|k| gather(simd, |lane| starts[lane][k]));
    let settled = group.iterate(&mut first, straight, (FIRST_LOOK, PIVOTING), &mut alive);
    // There, what is left to do in the whole window: by all parameters, and by those of a straight background.
    let mut at = [none; MOST];
    at[..STRAIGHT].copy_from_slice(&first);
    group.use_pixels(problems.map(|p| &p.window));
    let (information, step) = group.normal_equations(&at, full);
    let factor = information.factor(DAMPING);
    alive &= !factor.soundness().is_nan();
    let (mut white, mut rest) = (step, step);
    factor.whiten(&mut white);
    // The first entries are what a straight background has left to do.
    let bend = white[STRAIGHT..].iter().fold(none, |sum, w| sum + *w * *w);
    let bent = bend.simd_gt(BENT);
    factor.solve_first::<STRAIGHT>(&mut rest);
    let width = exp(simd, at[LN_WIDTH]);
    let near = rest[CENTRE].abs().simd_lt(width * NEAR) & rest[LN_WIDTH].abs().simd_lt(NEAR);
    let converged = settled & near & !bent;
    // Where one such step is enough, the fit ends there; `at` is where information and score were taken.
    let mut end = at;
    for k in 0..STRAIGHT {
        end[k] = converged.select(at[k] + rest[k], at[k]);
    }
    let (converged, alive) = (converged.to_bitmask(), alive.to_bitmask());
    let (sizes, pivot, end) =
        (Row::from(bent.select(full, straight)), Row::from(group.pivot), end.map(Row::from));
    let mut ways: [Option<Way>; WIDE] = std::array::from_fn(|lane| {
        (alive >> lane & 1 == 1).then(|| Way {
            problem: problems[lane].clone(),
            at: std::array::from_fn(|k| end[k].0[lane]),
            size: sizes.0[lane] as usize,
            pivot: pivot.0[lane],
            converged: converged >> lane & 1 == 1,
        })
    });
    for (lane, way) in ways.iter_mut().enumerate() {
        if let Some(way) = way.take_if(|way| !way.converged) {
            each(lane, Next::On(way));
        }
    }
    if converged & alive != 0 {
        finish(&at, information, step, &mut ways, &mut |lane, found| each(lane, Next::Done(found)));
    }
}

/// Some iterations, after `round` others, on the lines of `ways`, which go on in place; gives the lanes where there is no stripe to be had, one bit each.
pub(super) fn go_on(
    level: Level,
    round: usize,
    ways: &mut [Way; WIDE],
    pixels: &Pixels,
    noise: Weights,
) -> u64 {
    dispatch!(level, simd => go_on_here(simd, round, ways, pixels, noise))
}

#[inline(always)]
fn go_on_here<S: Simd>(
    simd: S,
    round: usize,
    ways: &mut [Way; WIDE],
    pixels: &Pixels,
    noise: Weights,
) -> u64 {
    let mut group = group(simd, ways.each_ref(), pixels, noise);
    let mut at: [V<S>; MOST] = std::array::from_fn(|k| gather(simd, |lane| ways[lane].at[k]));
    let sizes = gather(simd, |lane| ways[lane].size as f64);
    let mut alive = Mask::splat(simd, true);
    let rounds = (AT_A_TIME, PIVOTING.saturating_sub(round));
    let settled = group.iterate(&mut at, sizes, rounds, &mut alive).to_bitmask();
    let (at, pivot) = (at.map(Row::from), Row::from(group.pivot));
    for (lane, way) in ways.iter_mut().enumerate() {
        way.at = std::array::from_fn(|k| at[k].0[lane]);
        way.pivot = pivot.0[lane];
        way.converged = settled >> lane & 1 == 1;
    }
    !alive.to_bitmask()
}

/// What is known at the end of the ways, given to `each` with its lane.
pub(super) fn end(
    level: Level,
    ways: [&Way; WIDE],
    pixels: &Pixels,
    noise: Weights,
    each: &mut dyn FnMut(usize, Ended),
) {
    dispatch!(level, simd => end_here(simd, ways, pixels, noise, each));
}

#[inline(always)]
fn end_here<S: Simd>(
    simd: S,
    ways: [&Way; WIDE],
    pixels: &Pixels,
    noise: Weights,
    each: &mut dyn FnMut(usize, Ended),
) {
    let group = group(simd, ways, pixels, noise);
    let at: [V<S>; MOST] = std::array::from_fn(|k| gather(simd, |lane| ways[lane].at[k]));
    let full = gather(simd, |lane| ways[lane].problem.full as f64);
    let (information, step) = group.normal_equations(&at, full);
    finish(&at, information, step, &mut ways.map(|way| Some(way.clone())), each);
}

/// The lines of the ways, as far as these have come.
#[inline(always)]
pub(super) fn group<'a, S: Simd>(
    simd: S,
    ways: [&Way; WIDE],
    pixels: &'a Pixels,
    noise: Weights,
) -> Group<'a, S> {
    let pivot = gather(simd, |lane| ways[lane].pivot);
    Group::new(simd, ways.map(|way| &way.problem), pivot, pixels, noise)
}

/// Gives the ends of those ways that are there, with the information and score at `at` of all parameters.
#[inline(always)]
fn finish<S: Simd>(
    at: &[V<S>; MOST],
    information: Symmetric<V<S>, MOST>,
    mut step: [V<S>; MOST],
    ways: &mut [Option<Way>; WIDE],
    each: &mut dyn FnMut(usize, Ended),
) {
    let factor = information.factor(0.0);
    let sound = !factor.soundness().is_nan().to_bitmask();
    factor.solve(&mut step);
    let mut at = *at;
    for (at, step) in at.iter_mut().zip(step) {
        *at += step;
    }
    let at = at.map(Row::from);
    let information = information.0.map(|row| row.map(Row::from));
    for (lane, way) in ways.iter_mut().enumerate() {
        let Some(way) = way.take().filter(|_| sound >> lane & 1 == 1) else { continue };
        let of = |row: &Row| row.0[lane];
        let mut solution = Solution {
            at: std::array::from_fn(|k| of(&at[k])),
            information: Symmetric([[0.0; MOST]; MOST]),
            size: way.problem.full,
            pivot: way.pivot,
            unit: way.problem.unit,
        };
        for r in 0..MOST {
            for c in 0..=r {
                solution.information.0[r][c] = of(&information[r][c]);
            }
        }
        each(lane, Ended { way, solution });
    }
}
