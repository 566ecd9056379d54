//! Several stripes an image: which candidates, line after line, are one stripe.
//!
//! Stripes are followed by their own direction: each takes the candidate nearest to where its last lines point. Where two come so close that
//! one candidate stands for both, neither takes it, and both go on as they pointed until they are apart again: so that stripes that
//! cross do cross, and do not turn back at each other.

use crate::peak::Candidate;
use crate::verdict::{LEAST_RUN, run_reach};

/// Lines that tell a stripe's direction, and those from which it is believed.
const TELL: usize = 16;
const DIRECTED: usize = 6;
/// Lines that a stripe may be missing on, and those for which one that is hidden behind another is waited for.
const GAP: usize = 12;
const HIDDEN: usize = 60;
/// Weight of a ratio of light e : 1, against a step as long as may be.
const LIGHT: f64 = 0.3;
/// Distance, in widths, within which one candidate may stand for two stripes.
const ONE_FOR_TWO: f64 = 6.0;
/// Lines of a piece that its rank may hold already, beside a third of its own.
const TWICE: usize = 40;
/// Lines between the pieces of a stripe within which its place and light say which it goes on from.
const NEAR_LINES: usize = 40;
/// Cost of a rank in which a piece has no such neighbour, and of every further rank.
const ALONE: f64 = 1.5;
const FURTHER: f64 = 0.1;

/// A stripe on its way through the lines.
#[derive(Debug, Default)]
struct Track {
    /// Line and candidate, in rising order.
    members: Vec<(usize, Candidate)>,
    /// Last line on which it was seen or known to be hidden.
    last: usize,
}

impl Track {
    fn first_line(&self) -> usize {
        self.members.first().map_or(0, |m| m.0)
    }

    fn last_line(&self) -> usize {
        self.members.last().map_or(0, |m| m.0)
    }

    fn flux(&self) -> f64 {
        self.members.iter().map(|m| f64::from(m.1.flux)).sum()
    }

    /// Where the last lines point to, px, and the light they hold.
    fn expected(&self, line: usize) -> (f64, f64) {
        let tail = &self.members[self.members.len().saturating_sub(TELL)..];
        let n = tail.len() as f64;
        let x = |m: &(usize, Candidate)| m.0 as f64 - line as f64;
        let (mx, my, light) = tail.iter().fold((0.0, 0.0, 0.0), |(a, b, c), m| {
            (a + x(m) / n, b + m.1.centre as f64 / n, c + f64::from(m.1.flux) / n)
        });
        if tail.len() < DIRECTED {
            return (tail.last().map_or(my, |m| m.1.centre as f64), light);
        }
        let (cross, square) = tail.iter().fold((0.0, 0.0), |(c, s), m| {
            let off = x(m) - mx;
            (c + off * (m.1.centre as f64 - my), s + off * off)
        });
        (my - cross / square * mx, light)
    }
}

/// The stripes' places: `ranks` lists of one entry a line; a list goes on with its stripe where others cross it.
pub(crate) fn follow(lines: &[Vec<Candidate>], ranks: usize, width_px: f64) -> Vec<Vec<Option<Candidate>>> {
    let mut done: Vec<Track> = Vec::new();
    let mut open: Vec<Track> = Vec::new();
    for (line, candidates) in lines.iter().enumerate() {
        step(&mut open, line, candidates, width_px);
        let (on, off) =
            open.into_iter().partition(|t: &Track| line - t.last <= GAP && line - t.last_line() <= HIDDEN);
        open = on;
        done.extend::<Vec<Track>>(off);
    }
    done.extend(open);
    done.retain(|t| t.members.len() >= LEAST_RUN.min(lines.len()));
    // By light; of equals the one that begins first.
    done.sort_by(|a, b| b.flux().total_cmp(&a.flux()).then(a.first_line().cmp(&b.first_line())));
    let mut out: Vec<Vec<Option<Candidate>>> = vec![vec![None; lines.len()]; ranks];
    for track in &done {
        let lines = track.first_line()..=track.last_line();
        // Where stripes part, one may be seen anew before it is known to have been hidden: a few lines twice are no second stripe.
        let twice = |r: &usize| out[*r][lines.clone()].iter().filter(|p| p.is_some()).count();
        let free = (0..ranks).filter(|r| twice(r) <= TWICE.min(track.members.len() / 3));
        let best =
            free.map(|r| (cost(&out[r], track) + FURTHER * r as f64, r)).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, rank)) = best {
            write(&mut out[rank], track);
        }
    }
    out
}

/// Gives candidates of a line to the stripes that point to them, the surest first; those left begin stripes of their own.
fn step(open: &mut Vec<Track>, line: usize, candidates: &[Candidate], width_px: f64) {
    let reach = f64::from(run_reach(width_px as f32));
    let expected: Vec<(f64, f64)> = open.iter().map(|t| t.expected(line)).collect();
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (t, track) in open.iter().enumerate() {
        // What a direction is worth falls with the distance.
        let far = reach * (1.0 + 0.1 * (line - track.last_line() - 1) as f64);
        for (k, c) in candidates.iter().enumerate() {
            let (off, light) = (c.centre as f64 - expected[t].0, (f64::from(c.flux) / expected[t].1).ln());
            if off.abs() <= far {
                pairs.push(((off / far).powi(2) + LIGHT * light.abs(), t, k));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut taken, mut has) = (vec![false; candidates.len()], vec![None; open.len()]);
    for (_, t, k) in pairs {
        if !taken[k] && has[t].is_none() {
            (taken[k], has[t]) = (true, Some(k));
        }
    }
    // A stripe that points to within a few widths of one that was seen, and was not itself: hidden, as that may be.
    let close = |a: usize, b: usize| (expected[a].0 - expected[b].0).abs() <= ONE_FOR_TWO * width_px;
    let established = |t: &Track| t.members.len() >= DIRECTED;
    let shares: Vec<bool> = (0..open.len())
        .map(|a| {
            (0..open.len()).any(|b| {
                a != b
                    && close(a, b)
                    && has[a].is_none() != has[b].is_none()
                    && established(&open[a])
                    && established(&open[b])
            })
        })
        .collect();
    for (t, track) in open.iter_mut().enumerate() {
        match has[t] {
            _ if shares[t] => track.last = line,
            Some(k) => {
                track.members.push((line, candidates[k]));
                track.last = line;
            }
            None => {}
        }
    }
    for (c, _) in candidates.iter().zip(&taken).filter(|(_, taken)| !**taken) {
        open.push(Track { members: vec![(line, *c)], last: line });
    }
}

/// How ill a piece goes on from what a rank holds before and after it.
fn cost(rank: &[Option<Candidate>], track: &Track) -> f64 {
    let (first, last) = (track.first_line(), track.last_line());
    let before = (first.saturating_sub(NEAR_LINES)..first).rev().find_map(|i| Some((i, rank[i]?)));
    let after = (last + 1..(last + 1 + NEAR_LINES).min(rank.len())).find_map(|i| Some((i, rank[i]?)));
    let ends = [(before, track.members.first()), (after, track.members.last())];
    ends.into_iter()
        .filter_map(|(place, end)| {
            let ((line, place), (own, candidate)) = (place?, end?);
            let reach = 6.0 * line.abs_diff(*own) as f64;
            let d = place.centre.abs_diff(candidate.centre) as f64;
            let light = f64::from(place.flux / candidate.flux).ln().abs();
            Some(2.0 * d * d / (d * d + reach * reach) + light)
        })
        .reduce(f64::min)
        .unwrap_or(ALONE)
}

/// Puts a stripe into its rank, on a straight way where it was missing.
fn write(rank: &mut [Option<Candidate>], track: &Track) {
    // Where a line is held already, who came with more light stays.
    let held: Vec<bool> = rank.iter().map(Option::is_some).collect();
    for pair in track.members.windows(2) {
        let [(from, a), (to, b)] = [pair[0], pair[1]];
        for (line, out) in rank.iter_mut().enumerate().take(to).skip(from + 1).filter(|(i, _)| !held[*i]) {
            let share = (line - from) as f64 / (to - from) as f64;
            let mixed = |a: f64, b: f64| a + share * (b - a);
            let centre = mixed(a.centre as f64, b.centre as f64).round() as usize;
            let flux = mixed(f64::from(a.flux), f64::from(b.flux)) as f32;
            let background = mixed(f64::from(a.background), f64::from(b.background)) as f32;
            *out = Some(Candidate { centre, flux, background, ..a });
        }
    }
    for (line, candidate) in track.members.iter().filter(|m| !held[m.0]) {
        rank[*line] = Some(*candidate);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(centre: f64, flux: f32) -> Candidate {
        Candidate { centre: centre.round() as usize, scale: 5, snr: 50.0, flux, background: 4.0 }
    }

    /// Candidates of stripes (place by line, light; NaN: none), those nearer than 6 px as one.
    fn seen(stripes: &[(&dyn Fn(f64) -> f64, f32)]) -> Vec<Vec<Candidate>> {
        (0..200)
            .map(|line| {
                let mut all: Vec<Candidate> = Vec::new();
                for (at, flux) in stripes.iter().map(|(f, flux)| (f(f64::from(line)), *flux)) {
                    match all.iter_mut().find(|c| (c.centre as f64 - at).abs() < 6.0) {
                        _ if at.is_nan() => {}
                        Some(c) => *c = candidate(0.5 * (c.centre as f64 + at), c.flux + flux),
                        None => all.push(candidate(at, flux)),
                    }
                }
                all
            })
            .collect()
    }

    #[test]
    fn crossing_stripes_cross() {
        let (a, b) = (|v: f64| 100.0 + 0.4 * (v - 90.0), |v: f64| 100.0 - 0.3 * (v - 90.0));
        for fluxes in [[500.0, 480.0], [300.0, 900.0]] {
            let ranks = follow(&seen(&[(&a, fluxes[0]), (&b, fluxes[1])]), 3, 2.0);
            let (first, second): (&dyn Fn(f64) -> f64, &dyn Fn(f64) -> f64) =
                if fluxes[0] > fluxes[1] { (&a, &b) } else { (&b, &a) };
            for (line, v) in (0..200).map(|l| (l, l as f64)) {
                let at = |r: usize| ranks[r][line].unwrap().centre as f64;
                assert!((at(0) - first(v)).abs() < 2.0 && (at(1) - second(v)).abs() < 2.0, "line {line}");
                assert!(ranks[2][line].is_none());
            }
        }
    }

    #[test]
    fn a_broken_stripe_keeps_its_rank_and_one_that_ends_leaves_it() {
        let broken = |v: f64| {
            if (80.0..84.0).contains(&v) { f64::NAN } else { 40.0 + if v < 80.0 { 0.0 } else { 25.0 } }
        };
        let whole = |_: f64| 120.0;
        let ends = |v: f64| if v < 150.0 { 160.0 + 0.1 * v } else { f64::NAN };
        let ranks = follow(&seen(&[(&broken, 400.0), (&whole, 900.0), (&ends, 200.0)]), 3, 2.0);
        for (line, first) in ranks[0].iter().enumerate() {
            assert_eq!(first.unwrap().centre, 120);
            let broken = if line < 80 {
                Some(40)
            } else if line < 84 {
                None
            } else {
                Some(65)
            };
            assert_eq!(ranks[1][line].map(|c| c.centre), broken, "line {line}");
            assert_eq!(ranks[2][line].is_some(), line < 150, "line {line}");
        }
        assert!(follow(&[], 2, 2.0).iter().all(Vec::is_empty));
    }
}
