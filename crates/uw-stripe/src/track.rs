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

/// Goes on beyond the ends of runs: where `position` (NaN = none) leaves a stripe for something else or for nothing, the stripe is looked for
/// on the lines that follow, `look(line, expected)` telling its place there, until it is met again or lost. Places go to `found`, which
/// holds `nowhere` for the others; false if there are none.
pub(crate) fn go_on(
    position: &[f32],
    reach: f32,
    look: impl Fn(usize, f32) -> Option<u32>,
    nowhere: u32,
    found: &mut [u32],
) -> bool {
    /// Members of a run that is worth it, those that tell its slope, and lines on which it may not show.
    const LEAST: usize = 3;
    const SLOPE: usize = 4;
    const GAP: usize = 2;
    /// Weight of the newest step in the slope.
    const NEW: f32 = 0.2;
    let n = position.len().min(found.len());
    let near = |a: f32, b: f32| (a - b).abs() <= reach;
    let mut any = false;
    for forward in [true, false] {
        let line = |i: usize| if forward { i } else { n - 1 - i };
        let p = |i: usize| position[line(i)];
        let mut members = 0;
        for i in 0..n.saturating_sub(1) {
            members = match p(i) {
                here if here.is_nan() => 0,
                here if i > 0 && near(here, p(i - 1)) => members + 1,
                _ => 1,
            };
            if members < LEAST || near(p(i), p(i + 1)) {
                continue;
            }
            let back = (members - 1).min(SLOPE);
            let (mut last, mut slope) = ((i, p(i)), (p(i) - p(i - back)) / back as f32);
            for j in i + 1..n {
                let step = (j - last.0) as f32;
                let expected = last.1 + slope * step;
                if step > GAP as f32 + 1.0 || near(p(j), expected) || found[line(j)] != nowhere {
                    break;
                }
                if let Some(place) = look(line(j), expected) {
                    found[line(j)] = place;
                    slope += NEW * ((place as f32 - last.1) / step - slope);
                    last = (j, place as f32);
                    any = true;
                }
            }
        }
    }
    any
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_goes_on_behind_what_hides_it_and_no_further() {
        const NOWHERE: u32 = u32::MAX;
        let stripe = |i: usize| 50.0 + 0.7 * i as f32;
        // Hidden on lines 20 to 29, gone from line 60 on.
        let position: Vec<f32> = (0..80)
            .map(|i| match i {
                20..30 => 120.0,
                60.. => f32::NAN,
                _ => stripe(i),
            })
            .collect();
        let look = |line: usize, expected: f32| {
            let there = line < 60 && (expected - stripe(line)).abs() < 4.0;
            there.then(|| stripe(line).round() as u32)
        };
        let mut found = vec![NOWHERE; 80];
        assert!(go_on(&position, 5.0, look, NOWHERE, &mut found));
        for (line, place) in found.into_iter().enumerate() {
            let wanted = if (20..30).contains(&line) { stripe(line).round() as u32 } else { NOWHERE };
            assert_eq!(place, wanted, "line {line}");
        }
        assert!(!go_on(&[], 5.0, |_, _| None, NOWHERE, &mut []));
    }
}
