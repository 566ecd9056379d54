//! Fits whose windows suit the widths that they find, of many lines: as many side by side as a vector has lanes.

use super::judge::judge;
use super::pixels::Pixels;
use super::problem::{Problem, Seed};
use super::solve::{AT_A_TIME, Ended, ITERATIONS, Next, Way, end, go_on, look};
use super::wide::WIDE;
use super::{CENTRE, FLUX, Fit, LN_WIDTH, STRAIGHT, Weights, WidthPrior};
use crate::NoiseModel;
use crate::lines::Line;
use crate::noise::Residual;
use fearless_simd::Level;
use std::ops::Range;

/// Half a fit's window, in widths plus pixels: the further it reaches, the less does a background cost the centre.
pub(crate) const WINDOW: (f64, f64) = (8.0, 1.0);
/// Fits, each with the window of the one before.
const ROUNDS: usize = 3;
/// Ratio of window wanted to window used within which a fit stands.
const WINDOW_FITS: Range<f64> = 0.75..1.34;

/// Where fits find their pixels.
pub(crate) trait Source {
    /// The line of fit `k`.
    fn line(&self, k: usize) -> Line<'_>;

    /// The pixels of that line that may be used, of those within `half` of `centre`.
    fn window(&self, k: usize, centre: f64, half: f64) -> Range<usize> {
        within(centre, half, self.line(k).value.len())
    }
}

impl Source for Line<'_> {
    fn line(&self, _: usize) -> Line<'_> {
        *self
    }
}

/// Pixels within `half` of `centre` on a line of that length.
pub(crate) fn within(centre: f64, half: f64, length: usize) -> Range<usize> {
    let from = (centre - half).ceil().max(0.0) as usize;
    let to = (centre + half).floor().max(-1.0) + 1.0;
    from.min(length)..(to as usize).min(length)
}

/// What all lines have in common.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Common<'a> {
    pub noise: &'a NoiseModel,
    pub width: Option<WidthPrior>,
}

/// Fits lines; keeps its buffers, and nothing else, from call to call.
#[derive(Debug)]
pub(crate) struct Fitter {
    level: Level,
    pixels: Pixels,
    /// Fits whose window does not suit yet, and what they start from.
    pending: Vec<(usize, Seed)>,
    problems: Vec<(usize, Problem)>,
    /// Fits that need iterations, those that need more, and those that are there.
    going: Vec<(usize, Way)>,
    left: Vec<(usize, Way)>,
    there: Vec<(usize, Way)>,
    /// Fits that ended, with their lines; and where a line's is among them.
    ended: Vec<(usize, Ended)>,
    place: Vec<Option<usize>>,
    /// Those that are judged together.
    order: Vec<usize>,
    residuals: Vec<Vec<Residual>>,
    of_group: [Vec<Residual>; WIDE],
}

impl Ended {
    /// What to start from once more, where the window did not suit the width and the fit did not run out of it.
    fn again(&self) -> Option<Seed> {
        let Way { at, problem, .. } = &self.way;
        let [centre, flux, ln_width] = [CENTRE, FLUX, LN_WIDTH].map(|k| at[k]);
        let width = ln_width.exp();
        let inside = (problem.window.start as f64..problem.window.end as f64).contains(&centre);
        let suits = WINDOW_FITS.contains(&(half(width) / half(problem.seed.width)));
        (inside && !suits).then(|| Seed { centre, width, flux, background: self.background() })
    }
}

impl Fitter {
    pub fn new(level: Level) -> Self {
        Self {
            level,
            pixels: Pixels::default(),
            pending: Vec::new(),
            problems: Vec::new(),
            going: Vec::new(),
            left: Vec::new(),
            there: Vec::new(),
            ended: Vec::new(),
            place: Vec::new(),
            order: Vec::new(),
            residuals: Vec::new(),
            of_group: Default::default(),
        }
    }

    /// Fits line after line, each from its seed if it has one, and again in the window of the width that was found, into `fits`: `None` where the
    /// window or the seed cannot carry a fit. A fit that ran out of its window is the last, and for the caller to judge.
    pub fn fit(
        &mut self,
        seeds: impl Iterator<Item = Option<Seed>>,
        source: &impl Source,
        common: Common<'_>,
        fits: &mut Vec<Option<Fit>>,
    ) {
        self.settle(seeds, source, common);
        self.verdicts(source, common, fits, false);
    }

    /// The same, with the residuals of all pixels that are not clipped, by line.
    pub fn fit_with_residuals(
        &mut self,
        seeds: impl Iterator<Item = Option<Seed>>,
        source: &impl Source,
        common: Common<'_>,
        fits: &mut Vec<Option<Fit>>,
    ) -> &[Vec<Residual>] {
        self.settle(seeds, source, common);
        self.verdicts(source, common, fits, true);
        &self.residuals[..fits.len()]
    }

    /// The fit of one line.
    pub fn one(&mut self, seed: Seed, source: &impl Source, common: Common<'_>) -> Option<Fit> {
        let mut fits = Vec::with_capacity(1);
        self.fit(std::iter::once(Some(seed)), source, common, &mut fits);
        fits.pop().flatten()
    }

    /// Fills `ended` and `place`.
    fn settle(
        &mut self,
        seeds: impl Iterator<Item = Option<Seed>>,
        source: &impl Source,
        Common { noise, width }: Common<'_>,
    ) {
        let Self { level, pixels, pending, problems, going, left, there, ended, place, .. } = self;
        let weights = Weights::of(noise);
        ended.clear();
        place.clear();
        pending.clear();
        for seed in seeds {
            pending.extend(seed.map(|seed| (place.len(), seed)));
            place.push(None);
        }
        for _ in 0..ROUNDS {
            problems.clear();
            for (k, seed) in pending.drain(..) {
                let window = source.window(k, seed.centre, half(seed.width));
                let problem = Problem::new(source.line(k), noise, seed, window, width);
                problems.extend(problem.map(|problem| (k, problem)));
            }
            // Those of about the same length side by side: a group takes as long as its longest window.
            problems.sort_unstable_by_key(|(k, problem)| (problem.window.len(), *k));
            let mut done = |k: usize, found: Ended| {
                pending.extend(found.again().map(|seed| (k, seed)));
                match place[k] {
                    Some(at) => ended[at] = (k, found),
                    None => {
                        place[k] = Some(ended.len());
                        ended.push((k, found));
                    }
                }
            };
            going.clear();
            for (group, lanes) in groups(problems) {
                pixels.pack(lanes.map(|(k, problem)| (source.line(*k), &problem.window)), &weights);
                let each = &mut |lane: usize, next| match (group.get(lane), next) {
                    (Some((k, _)), Next::On(way)) => going.push((*k, way)),
                    (Some((k, _)), Next::Done(found)) => done(*k, found),
                    (None, _) => {}
                };
                look(*level, lanes.map(|(_, problem)| problem), pixels, weights, each);
            }
            there.clear();
            for round in (0..ITERATIONS).step_by(AT_A_TIME) {
                left.clear();
                for (group, lanes) in groups(going) {
                    pixels.pack(lanes.map(|(k, way)| (source.line(*k), &way.problem.window)), &weights);
                    let mut ways = lanes.map(|(_, way)| way.clone());
                    let lost = go_on(*level, round, &mut ways, pixels, weights);
                    for (lane, ((k, _), way)) in group.iter().zip(ways).enumerate() {
                        if lost >> lane & 1 == 0 {
                            if way.converged { &mut *there } else { &mut *left }.push((*k, way));
                        }
                    }
                }
                std::mem::swap(going, left);
            }
            there.append(going);
            for (group, lanes) in groups(there) {
                pixels.pack(lanes.map(|(k, way)| (source.line(*k), &way.problem.window)), &weights);
                let each = &mut |lane: usize, found| {
                    if let Some((k, _)) = group.get(lane) {
                        done(*k, found);
                    }
                };
                end(*level, lanes.map(|(_, way)| way), pixels, weights, each);
            }
        }
    }

    /// Makes fits of what has ended.
    fn verdicts(
        &mut self,
        source: &impl Source,
        Common { noise, .. }: Common<'_>,
        fits: &mut Vec<Option<Fit>>,
        with_residuals: bool,
    ) {
        let Self { level, pixels, ended, place, order, residuals, of_group, .. } = self;
        let weights = Weights::of(noise);
        fits.clear();
        fits.resize(place.len(), None);
        if with_residuals {
            residuals.iter_mut().for_each(Vec::clear);
            residuals.resize_with(place.len().max(residuals.len()), Vec::new);
        }
        for straight in [true, false] {
            order.clear();
            order.extend((0..ended.len()).filter(|at| (ended[*at].1.way.size <= STRAIGHT) == straight));
            for (group, lanes) in groups(order) {
                let all = lanes.map(|at| &ended[*at].1);
                pixels.pack(
                    lanes.map(|at| (source.line(ended[*at].0), &ended[*at].1.way.problem.window)),
                    &weights,
                );
                let wanted = with_residuals.then_some(&mut *of_group);
                let judged = judge(*level, all, pixels, weights, wanted);
                for (lane, (at, fit)) in group.iter().zip(judged).enumerate() {
                    let (k, _) = ended[*at];
                    fits[k] = Some(fit);
                    if with_residuals {
                        std::mem::swap(&mut residuals[k], &mut of_group[lane]);
                    }
                }
                of_group.iter_mut().for_each(Vec::clear);
            }
        }
    }
}

/// Half of the window that suits a width, px.
fn half(width: f64) -> f64 {
    WINDOW.0 * width + WINDOW.1
}

/// As many at a time as there are lanes, and what goes into them: those that are missing in the last group are copies of its first.
fn groups<T>(all: &[T]) -> impl Iterator<Item = (&[T], [&T; WIDE])> {
    all.chunks(WIDE).map(|group| (group, std::array::from_fn(|lane| group.get(lane).unwrap_or(&group[0]))))
}
