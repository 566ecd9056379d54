//! Continuity along the stripe: which of a line's candidates belongs to it, and which stand alone.

use crate::peak::Candidates;

/// Chooses one candidate a line so that strength and continuity agree best (Viterbi's algorithm).
///
/// Gain of a candidate: ½ ln(flux / strongest flux of the line). Cost of a step of d px over g lines:
/// J · d² / (d² + (g · s)²), bounded by J, so that a step in depth stays possible while a reflection that is brighter
/// for a few lines only does not win.
#[derive(Debug, Default)]
pub(crate) struct Tracker {
    /// Score and predecessor of each candidate, four a line.
    score: Vec<[f32; crate::peak::KEPT]>,
    from: Vec<[u8; crate::peak::KEPT]>,
}

/// J: dearest step.
const STEP_COST: f32 = 2.0;
/// s: step a line at which half of that is due, px; stripes slope by up to 2 or so.
const STEP_SCALE: f32 = 6.0;
/// Weight of ln flux.
const FLUX_GAIN: f32 = 0.5;

impl Tracker {
    /// Fills `choice` with the index of the chosen candidate of each line, `None` where there is none.
    pub fn choose(&mut self, lines: &[Candidates], choice: &mut Vec<Option<usize>>) {
        choice.clear();
        choice.resize(lines.len(), None);
        self.score.clear();
        self.score.resize(lines.len(), [0.0; crate::peak::KEPT]);
        self.from.clear();
        self.from.resize(lines.len(), [0; crate::peak::KEPT]);
        let mut last: Option<usize> = None;
        for (i, candidates) in lines.iter().enumerate() {
            let here = candidates.as_slice();
            let Some(strongest) = here.first() else { continue };
            for (k, c) in here.iter().enumerate() {
                let gain = FLUX_GAIN * (c.flux / strongest.flux).max(f32::MIN_POSITIVE).ln();
                let (best, from) = last.map_or((0.0, 0), |j| self.best_step(lines, j, i, c.centre));
                self.score[i][k] = best + gain;
                self.from[i][k] = from;
            }
            last = Some(i);
        }
        let Some(mut i) = last else { return };
        let mut k = (0..lines[i].as_slice().len())
            .max_by(|&a, &b| self.score[i][a].total_cmp(&self.score[i][b]).then(b.cmp(&a)));
        while let Some(taken) = k {
            choice[i] = Some(taken);
            let Some(j) = (0..i).rev().find(|&j| !lines[j].as_slice().is_empty()) else { break };
            k = Some(usize::from(self.from[i][taken]));
            i = j;
        }
    }

    fn best_step(&self, lines: &[Candidates], j: usize, i: usize, centre: usize) -> (f32, u8) {
        let mut best = (f32::NEG_INFINITY, 0u8);
        for (k, c) in (0u8..).zip(lines[j].as_slice()) {
            let d = c.centre.abs_diff(centre) as f32;
            let reach = STEP_SCALE * (i - j) as f32;
            let score = self.score[j][usize::from(k)] - STEP_COST * d * d / (d * d + reach * reach);
            if score > best.0 {
                best = (score, k);
            }
        }
        best
    }
}

/// Marks what has enough company: `position` (NaN = none) joins its neighbours up to two lines away when the step is
/// at most `reach(i)` px a line; runs with fewer than `least` members that are `strong` are not kept.
pub(crate) fn keep_runs(
    position: &[f32],
    reach: impl Fn(usize) -> f32,
    strong: impl Fn(usize) -> bool,
    least: usize,
    keep: &mut Vec<bool>,
) {
    /// Lines that a run may skip.
    const GAP: usize = 2;
    keep.clear();
    keep.resize(position.len(), false);
    let (mut first, mut members, mut last) = (0, 0, None::<usize>);
    let mut close = |first: usize, last: Option<usize>, members: usize| {
        if let Some(last) = last.filter(|_| members >= least) {
            keep[first..=last].fill(true);
        }
    };
    for (i, &p) in position.iter().enumerate().filter(|(_, p)| !p.is_nan()) {
        let joins = last.is_some_and(|j| {
            i - j <= 1 + GAP && (p - position[j]).abs() <= reach(i).max(reach(j)) * (i - j) as f32
        });
        if !joins {
            close(first, last, members);
            (first, members) = (i, 0);
        }
        members += usize::from(strong(i));
        last = Some(i);
    }
    close(first, last, members);
}
