//! How far a cloud or a mesh lies off a reference.

use crate::nearest::NearestOnMesh;
use crate::robust::{ranked, scale_about_zero};

/// Signed distances of points to a reference, and what they come to.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Comparison {
    /// Signed distance of each point, mm, positive on the side that the reference faces; not a number where the nearest point of the
    /// reference lies on a border of it, so that the point may be of what the reference does not have.
    pub deviations_mm: Vec<f32>,
    /// Points that were compared.
    pub compared: usize,
    /// Points beyond a border of the reference.
    pub beyond: usize,
    /// Their mean, mm.
    pub mean_mm: f64,
    /// Their root mean square, mm.
    pub rms_mm: f64,
    /// Their standard deviation as the median absolute deviation has it, mm.
    pub robust_sigma_mm: f64,
    /// The value that so many of them lie below: 2.5, 25, 50, 75, 97.5 %, mm.
    pub quantiles_mm: [f64; 5],
    /// The farthest inside and outside, mm.
    pub extremes_mm: [f64; 2],
    /// The distance, on either side, that 95 % of them keep, mm.
    pub within_95_mm: f64,
    /// Share of the points that lie off by no more than once, twice and three times their own sigma, where they have one: about 0.68,
    /// 0.95 and 0.997 where the form is the reference's and the sigmas are right.
    pub within_sigmas: Option<[f64; 3]>,
    /// Share of the points that lie off by more than twice their own sigma, where they have one: about 0.05 where the form is the
    /// reference's and the sigmas are right.
    pub beyond_two_sigma: Option<f64>,
}

/// Shares of the points for [`Comparison::quantiles_mm`].
const QUANTILES: [f64; 5] = [0.025, 0.25, 0.5, 0.75, 0.975];

/// Counts in bins of equal width.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Bins {
    /// Where the first bin begins, mm.
    pub from_mm: f64,
    /// Width of a bin, mm.
    pub width_mm: f64,
    /// Points in each; those beyond either end are in the last one there.
    pub counts: Vec<usize>,
}

/// Returns how far points lie off a reference; `None` where none of them lies beside it.
///
/// `sigmas_mm` are the points' own, one each.
pub fn compare(
    points_mm: &[[f64; 3]],
    sigmas_mm: Option<&[f32]>,
    reference: &NearestOnMesh<'_>,
) -> Option<Comparison> {
    let mut compared = Vec::with_capacity(points_mm.len());
    let mut within = [0_usize; 3];
    let mut deviations_mm = Vec::with_capacity(points_mm.len());
    for (at, point) in points_mm.iter().enumerate() {
        let near = reference.nearest(point);
        if near.on_border {
            deviations_mm.push(f32::NAN);
            continue;
        }
        if let Some(sigmas) = sigmas_mm {
            for (count, times) in within.iter_mut().zip([1.0, 2.0, 3.0]) {
                *count += usize::from(near.signed_mm.abs() <= times * f64::from(sigmas[at]));
            }
        }
        deviations_mm.push(near.signed_mm as f32);
        compared.push(near.signed_mm);
    }
    let count = compared.len() as f64;
    let mean_mm = compared.iter().sum::<f64>() / count;
    let rms_mm = (compared.iter().map(|d| d * d).sum::<f64>() / count).sqrt();
    let at = |share: f64| ((count - 1.0) * share).round() as usize;
    let mut sorted = compared.clone();
    let mut quantiles_mm = [0.0; 5];
    for (value, share) in quantiles_mm.iter_mut().zip(QUANTILES) {
        *value = ranked(&mut sorted, at(share))?;
    }
    Some(Comparison {
        beyond: points_mm.len() - compared.len(),
        compared: compared.len(),
        mean_mm,
        rms_mm,
        robust_sigma_mm: scale_about_zero(compared.iter().map(|d| d - quantiles_mm[2])),
        quantiles_mm,
        extremes_mm: [
            compared.iter().copied().fold(f64::INFINITY, f64::min),
            compared.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        ],
        within_95_mm: ranked(&mut compared.iter().map(|d| d.abs()).collect::<Vec<_>>(), at(0.95))?,
        within_sigmas: sigmas_mm.map(|_| within.map(|n| n as f64 / count)),
        beyond_two_sigma: sigmas_mm.map(|_| 1.0 - within[1] as f64 / count),
        deviations_mm,
    })
}

impl Comparison {
    /// Returns the deviations' histogram over ± four robust sigmas about their median (D. Freedman, P. Diaconis' width, 1981, at
    /// most a hundred bins).
    pub fn histogram(&self) -> Bins {
        let [_, lower, middle, upper, _] = self.quantiles_mm;
        let half = 4.0 * self.robust_sigma_mm.max(f64::MIN_POSITIVE);
        let width = 2.0 * (upper - lower) / (self.compared as f64).cbrt();
        let bins = (2.0 * half / width).ceil().clamp(1.0, 100.0);
        let mut histogram =
            Bins { from_mm: middle - half, width_mm: 2.0 * half / bins, counts: vec![0; bins as usize] };
        for &deviation in self.deviations_mm.iter().filter(|d| d.is_finite()) {
            let bin = (f64::from(deviation) - histogram.from_mm) / histogram.width_mm;
            histogram.counts[bin.clamp(0.0, bins - 1.0) as usize] += 1;
        }
        histogram
    }
}

/// Returns the colour of a deviation on a scale of ± `range_mm`: blue inside, white on the reference, red outside, told apart by the
/// colour-blind, too (C. Brewer, ColorBrewer 2.0, RdBu); grey where there is none.
pub fn deviation_color(deviation_mm: f32, range_mm: f64) -> [u8; 3] {
    const NONE: [u8; 3] = [128, 128, 128];
    const SCALE: [[u8; 3]; 11] = [
        [5, 48, 97],
        [33, 102, 172],
        [67, 147, 195],
        [146, 197, 222],
        [209, 229, 240],
        [247, 247, 247],
        [253, 219, 199],
        [244, 165, 130],
        [214, 96, 77],
        [178, 24, 43],
        [103, 0, 31],
    ];
    if !deviation_mm.is_finite() {
        return NONE;
    }
    let share = f64::from(deviation_mm) / range_mm.max(f64::MIN_POSITIVE);
    let at = (share.clamp(-1.0, 1.0) + 1.0) * 5.0;
    let lower = (at as usize).min(9);
    let part = at - lower as f64;
    std::array::from_fn(|k| {
        (f64::from(SCALE[lower][k]) * (1.0 - part) + f64::from(SCALE[lower + 1][k]) * part).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::deviation_color;

    #[test]
    fn colours_go_from_blue_through_white_to_red_and_stop_there() {
        assert_eq!(deviation_color(0.0, 0.5), [247, 247, 247]);
        assert_eq!(deviation_color(-0.5, 0.5), [5, 48, 97]);
        assert_eq!(deviation_color(-9.0, 0.5), [5, 48, 97]);
        assert_eq!(deviation_color(0.5, 0.5), [103, 0, 31]);
        assert_eq!(deviation_color(0.05, 0.5), [250, 233, 223], "half way to the next");
        assert_eq!(deviation_color(f32::NAN, 0.5), [128, 128, 128]);
        assert_eq!(deviation_color(0.1, 0.0), [103, 0, 31]);
    }
}
