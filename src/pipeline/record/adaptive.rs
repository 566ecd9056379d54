//! Where a sweep wants more voltages: dense where the surface bends, sparse where it is flat.
//!
//! Between two neighbouring images the surface is known only by what lies between their points on each line. On a surface of second
//! derivative x″ along the sweep, a straight line over an interval h is off by at most h² |x″| / 8. The points themselves tell x″: the
//! middle one of three in a row, with intervals a and b before and after it, lies d = a b |x″| / 2 beside the line through the other two.
//! So an interval h next to it is off by
//!
//! e = d h² / (4 a b)
//!
//! **Criterion.** An interval is cut into so many equal parts that e, which falls with their number squared, is no larger than the
//! standard deviation of a point: more images would then show noise, not surface. The parts are a power of two. Of all lines, the one
//! decides that 95 % of the lines stay below, and never fewer than five lines. An edge, where the surface jumps or
//! ends, has no e and asks for the most parts. Noise alone makes e 0.3 standard deviations and cuts nothing. Neighbouring intervals
//! differ by a factor of two at most, since the sweep stage needs even steps ([`crate::pipeline`]).

use std::collections::BTreeMap;

/// Share of the lines that may be worse than the one that decides.
const WORSE: f64 = 0.05;
/// Fewest lines that make an interval denser: fewer are outliers.
const LEAST_LINES: usize = 5;
/// An interval is never cut into more parts than this.
const MOST_PARTS: usize = 64;

/// A point of one line of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePoint {
    /// Row or column of the image.
    pub line: usize,
    /// Position, camera frame, mm.
    pub position_mm: [f64; 3],
    /// Standard deviation along its least certain direction, mm.
    pub sigma_mm: f64,
}

/// The points of one image of a sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// The galvanometer's voltage.
    pub voltage_v: f64,
    /// One a line.
    pub points: Vec<LinePoint>,
}

/// How dense a sweep may become.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Density {
    /// Steps smaller than this are never made, V.
    pub finest_v: f64,
}

/// The voltages to visit besides those of a first, coarse sweep, ascending.
pub fn further_voltages(coarse: &[Profile], density: Density) -> Vec<f64> {
    let mut sweep: Vec<&Profile> = coarse.iter().collect();
    sweep.sort_by(|a, b| a.voltage_v.total_cmp(&b.voltage_v));
    sweep.dedup_by(|a, b| a.voltage_v.total_cmp(&b.voltage_v).is_eq());
    let by_line: Vec<BTreeMap<usize, &LinePoint>> =
        sweep.iter().map(|profile| profile.points.iter().map(|p| (p.line, p)).collect()).collect();
    let volts: Vec<f64> = sweep.iter().map(|profile| profile.voltage_v).collect();
    let mut parts: Vec<usize> = (0..volts.len().saturating_sub(1))
        .map(|i| {
            let most = most_parts(volts[i + 1] - volts[i], density.finest_v);
            let wanted = deciding(ratios(&volts, &by_line, i)).sqrt().ceil();
            if wanted >= most as f64 {
                most
            } else {
                (wanted.max(1.0) as usize).next_power_of_two().min(most)
            }
        })
        .collect();
    grade(&mut parts);
    let inside = |i: usize| {
        let (from, step) = (volts[i], (volts[i + 1] - volts[i]) / parts[i] as f64);
        (1..parts[i]).map(move |k| from + k as f64 * step)
    };
    (0..parts.len()).flat_map(inside).collect()
}

/// The largest power of two that leaves steps of `finest_v` at least.
fn most_parts(interval_v: f64, finest_v: f64) -> usize {
    let fit = interval_v / finest_v * (1.0 + 1e-9);
    let mut parts = 1;
    while parts < MOST_PARTS && 2.0 * parts as f64 <= fit {
        parts *= 2;
    }
    parts
}

/// For each line with a point at an end of interval `i`: the predicted error of a straight line over it, by the sigma of a point.
fn ratios(volts: &[f64], by_line: &[BTreeMap<usize, &LinePoint>], i: usize) -> Vec<f64> {
    let lines: std::collections::BTreeSet<usize> =
        by_line[i].keys().chain(by_line[i + 1].keys()).copied().collect();
    let at = |n: Option<usize>, line: usize| by_line.get(n?)?.get(&line).copied();
    lines
        .into_iter()
        .map(|line| {
            // The surface ends within the interval; a single line or image without a point is a gap, and says nothing.
            let goes = |n: [Option<usize>; 2]| n.map(|n| at(n, line).is_some());
            let (before, after) = (goes([i.checked_sub(1), Some(i)]), goes([Some(i + 1), Some(i + 2)]));
            if (before == [true, true] && after == [false, false])
                || (before == [false, false] && after == [true, true])
            {
                return f64::INFINITY;
            }
            let h = volts[i + 1] - volts[i];
            let bend = |middle: usize| {
                let [p, q, r] = [middle.checked_sub(1), Some(middle), Some(middle + 1)].map(|n| at(n, line));
                let (p, q, r) = (p?, q?, r?);
                let (a, b) = (volts[middle] - volts[middle - 1], volts[middle + 1] - volts[middle]);
                let e = beside(q, p, r) * h * h / (4.0 * a * b);
                Some(e / q.sigma_mm)
            };
            [bend(i), bend(i + 1)].into_iter().flatten().fold(0.0, f64::max)
        })
        .collect()
}

/// Distance of a point from the line through two others, mm.
fn beside(q: &LinePoint, p: &LinePoint, r: &LinePoint) -> f64 {
    let [q, p, r] = [q, p, r].map(|point| nalgebra::Vector3::from(point.position_mm));
    let along = r - p;
    along.try_normalize(f64::MIN_POSITIVE).map_or(0.0, |unit| (q - p - unit * unit.dot(&(q - p))).norm())
}

/// The value that all but [`WORSE`] of the lines, and all but [`LEAST_LINES`] − 1, stay below.
fn deciding(mut ratios: Vec<f64>) -> f64 {
    let rank = ((WORSE * ratios.len() as f64) as usize).max(LEAST_LINES - 1);
    if rank >= ratios.len() {
        return 0.0;
    }
    ratios.sort_by(|a, b| b.total_cmp(a));
    ratios[rank]
}

/// Makes intervals denser until none is more than twice as dense as its neighbour.
fn grade(parts: &mut [usize]) {
    let raise = |from: usize, to: &mut usize| *to = (*to).max(from / 2);
    for i in 1..parts.len() {
        let (head, tail) = parts.split_at_mut(i);
        raise(head[i - 1], &mut tail[0]);
    }
    for i in (1..parts.len()).rev() {
        let (head, tail) = parts.split_at_mut(i);
        raise(tail[0], &mut head[i - 1]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    const SIGMA_MM: f64 = 0.05;
    const COARSE_V: f64 = 0.1;
    const DENSITY: Density = Density { finest_v: 0.001 };
    /// Millimetres across the scene a volt.
    const MM_PER_V: f64 = 70.0;
    const ROWS: usize = 100;

    /// A sweep over z(x, y) with Gaussian noise of `SIGMA_MM` (twelve uniform numbers) along z; where z is not finite there is no point.
    fn sweep(volts: &[f64], noise: f64, z: impl Fn(f64, f64) -> f64) -> Vec<Profile> {
        let mut rng = StdRng::seed_from_u64(7);
        let mut gauss = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let mut profile = |voltage_v: f64| {
            let x = voltage_v * MM_PER_V;
            let point = |line: usize, off: f64| LinePoint {
                line,
                position_mm: [x, line as f64, z(x, line as f64) + noise * off],
                sigma_mm: SIGMA_MM,
            };
            let points = (0..ROWS).map(|line| point(line, gauss()));
            Profile { voltage_v, points: points.filter(|p| p.position_mm[2].is_finite()).collect() }
        };
        volts.iter().map(|&v| profile(v)).collect()
    }

    fn coarse() -> Vec<f64> {
        (0..21).map(|k| -1.0 + COARSE_V * f64::from(k)).collect()
    }

    /// Largest distance of z from straight lines between the voltages visited, over a part of the sweep.
    fn worst_mm(volts: &[f64], within_mm: [f64; 2], z: impl Fn(f64) -> f64) -> f64 {
        let mut worst: f64 = 0.0;
        for pair in volts.windows(2) {
            let [a, b] = [pair[0] * MM_PER_V, pair[1] * MM_PER_V];
            for k in 0..=20 {
                let t = f64::from(k) / 20.0;
                let x = a + t * (b - a);
                if (within_mm[0]..=within_mm[1]).contains(&x) {
                    worst = worst.max((z(x) - (z(a) * (1.0 - t) + z(b) * t)).abs());
                }
            }
        }
        worst
    }

    #[test]
    fn a_slanted_noisy_plane_is_left_sparse() {
        let plane = sweep(&coarse(), SIGMA_MM, |x, y| 800.0 + 0.7 * x - 0.2 * y);
        assert_eq!(further_voltages(&plane, DENSITY), Vec::<f64>::new());
    }

    #[test]
    fn a_bend_is_followed_to_a_points_noise_with_fewer_images_than_everywhere() {
        // A cylinder's flank of 60 mm radius on a plane, whose tangent goes on: bent for |x| < 30 mm only.
        let bent = |x: f64| {
            let edge: f64 = 30.0;
            let arc = |x: f64| 60.0 - (3600.0 - x * x).sqrt();
            let outside = arc(edge) + (x.abs() - edge) * edge / (3600.0_f64 - edge * edge).sqrt();
            800.0 + if x.abs() <= edge { arc(x) } else { outside }
        };
        let first = sweep(&coarse(), SIGMA_MM, |x, _| bent(x));
        let mut volts = coarse();
        assert!(worst_mm(&volts, [-70.0, 70.0], bent) > 2.0 * SIGMA_MM);
        volts.extend(further_voltages(&first, DENSITY));
        volts.sort_by(f64::total_cmp);
        // In the arc and its neighbourhood; sigma is met, with what noise adds to a bend.
        assert!(
            worst_mm(&volts, [-70.0, 70.0], bent) < 1.1 * SIGMA_MM,
            "{}",
            worst_mm(&volts, [-70.0, 70.0], bent)
        );
        let finest = volts.windows(2).map(|p| p[1] - p[0]).fold(f64::MAX, f64::min);
        let everywhere = (2.0 / finest).round() as usize + 1;
        assert!(volts.len() * 5 < everywhere * 4, "{} of {everywhere}", volts.len());
        for pair in volts.windows(3) {
            let (a, b) = (pair[1] - pair[0], pair[2] - pair[1]);
            assert!(a.max(b) < 2.0001 * a.min(b), "even enough for the sweep stage: {a} {b}");
        }
    }

    #[test]
    fn jumps_and_ends_get_the_finest_steps_and_nothing_else() {
        let density = Density { finest_v: 0.02 };
        for (name, z) in [("jump", 20.0), ("end", f64::NAN)] {
            let edge = |x: f64| if x > 24.0 { 800.0 + z } else { 800.0 };
            let further = further_voltages(&sweep(&coarse(), SIGMA_MM, |x, _| edge(x)), density);
            let within: Vec<f64> = further.iter().copied().filter(|v| (0.3..0.4).contains(v)).collect();
            assert_eq!(within.len(), 3, "{name}: {further:?}");
            assert!(further.iter().all(|v| (0.0..0.7).contains(v)), "{name}: {further:?}");
        }
    }

    #[test]
    fn a_few_outliers_and_gaps_cut_nothing() {
        let mut plane = sweep(&coarse(), 0.0, |_, _| 800.0);
        for line in [3, 30, 60, 90] {
            plane[9].points[line].position_mm[2] += 40.0;
        }
        plane[5].points.retain(|p| p.line % 3 != 0);
        assert_eq!(further_voltages(&plane, DENSITY), Vec::<f64>::new());
    }

    #[test]
    fn nothing_seen_and_one_image_want_nothing() {
        assert!(further_voltages(&[], DENSITY).is_empty());
        assert!(further_voltages(&sweep(&[0.0], 0.0, |_, _| 1.0), DENSITY).is_empty());
        assert!(further_voltages(&sweep(&coarse(), 0.0, |_, _| f64::NAN), DENSITY).is_empty());
    }

    #[test]
    fn densities_are_graded() {
        let mut parts = [1, 1, 1, 16, 1, 1, 1, 1, 1];
        grade(&mut parts);
        assert_eq!(parts, [2, 4, 8, 16, 8, 4, 2, 1, 1]);
    }
}
