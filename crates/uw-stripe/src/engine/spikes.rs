//! Images without their lone pixels, where estimates look as if there were some: those are looked at again. Other images cost nothing.

use fearless_simd::{Simd, SimdBase, SimdInt, SimdMask, dispatch};

use super::lanes::{splat, vector};
use super::{Engine, Job};
use crate::lone::{Lone, without_runs};
use crate::{Axis, Pixel, View};

/// A region without its lone pixels, in an image of its own; keeps its buffers.
#[derive(Debug, Default)]
pub(super) struct Cleaned<P> {
    pixels: Vec<P>,
    /// Places in a row, and lone pixels by line and place along it.
    places: Vec<usize>,
    found: Vec<(usize, usize)>,
    /// Width and height of the image, where all of the last one is here.
    whole: Option<(usize, usize)>,
}

impl<P: Pixel> Cleaned<P> {
    /// Forgets the last image.
    pub fn reset(&mut self) {
        self.whole = None;
    }

    /// The last image, if all of it was cleaned.
    pub fn image(&self) -> Option<View<'_, P>> {
        let (width, height) = self.whole?;
        View::packed(&self.pixels, width, height).ok()
    }
}

impl Engine {
    /// The region with the mean of those beside it in place of every pixel that stands alone on its line; `None` if none does.
    pub(super) fn cleaned<'a, P: Pixel>(
        &self,
        job: &Job<'_, P>,
        Cleaned { pixels, places, found, whole }: &'a mut Cleaned<P>,
    ) -> Option<View<'a, P>> {
        let lone = Lone::new(&self.model.noise, f64::from(self.model.width_px));
        let least = P::from_dn(lone.least());
        let (image, roi) = (&job.image, job.roi);
        let (width, height) = (image.width(), image.height());
        found.clear();
        dispatch!(self.level, simd => all_apart(simd, job, least, places, found));
        found.retain(|&(line, at)| lone.is([at - 1, at, at + 1].map(|at| job.dn(line, at)), 0.0));
        without_runs(found);
        if found.is_empty() {
            return None;
        }
        pixels.resize(width * height, P::ZERO);
        for y in 0..roi.height {
            let row = &image.row(roi.y + y)[roi.x..][..roi.width];
            pixels[(roi.y + y) * width + roi.x..][..roi.width].copy_from_slice(row);
        }
        for &(line, at) in &*found {
            let (x, y) = match job.axis {
                Axis::PerRow => (at, line),
                Axis::PerColumn => (line, at),
            };
            let mean = 0.5 * (job.dn(line, at - 1) + job.dn(line, at + 1));
            pixels[(roi.y + y) * width + roi.x + x] = P::from_dn(mean);
        }
        *whole = (roi == image.bounds()).then_some((width, height));
        View::packed(pixels, width, height).ok()
    }
}

/// Adds the pixels, by line and place along it, that are more than `least` above both beside them on their line, or below both; `places` is a buffer.
#[inline(always)]
fn all_apart<S: Simd, P: Pixel>(
    simd: S,
    job: &Job<'_, P>,
    least: P,
    places: &mut Vec<usize>,
    found: &mut Vec<(usize, usize)>,
) {
    let roi = job.roi;
    let row = |y: usize| &job.image.row(roi.y + y)[roi.x..][..roi.width];
    match job.axis {
        Axis::PerRow if roi.width < 3 => {}
        Axis::PerRow => {
            for y in 0..roi.height {
                let row = row(y);
                let three = [&row[..roi.width - 2], &row[1..roi.width - 1], &row[2..]];
                places.clear();
                apart(simd, three, least, places);
                found.extend(places.iter().map(|x| (y, x + 1)));
            }
        }
        Axis::PerColumn => {
            for y in 1..roi.height.saturating_sub(1) {
                places.clear();
                apart(simd, [row(y - 1), row(y), row(y + 1)], least, places);
                found.extend(places.iter().map(|x| (*x, y)));
            }
            found.sort_unstable();
        }
    }
}

/// Adds the places at which the middle one of three rows is more than `least` above both others, or below both.
#[inline(always)]
fn apart<S: Simd, P: Pixel>(simd: S, [before, here, after]: [&[P]; 3], least: P, places: &mut Vec<usize>) {
    let length = here.len();
    if length < P::N {
        places.extend((0..length).filter(|&x| {
            let (low, high) = (before[x].min(after[x]), before[x].max(after[x]));
            here[x] - here[x].min(high) > least || low - low.min(here[x]) > least
        }));
        return;
    }
    let least = splat(simd, least);
    for from in (0..length).step_by(P::N) {
        let at = from.min(length - P::N);
        let before = vector(simd, &before[at..at + P::N]);
        let here = vector(simd, &here[at..at + P::N]);
        let after = vector(simd, &after[at..at + P::N]);
        let (low, high) = (before.min(after), before.max(after));
        let far = here.saturating_sub(high).max(low.saturating_sub(here));
        let mut lanes = far.simd_gt(least).to_bitmask() >> (from - at);
        let mut x = from;
        while lanes != 0 {
            let next = lanes.trailing_zeros() as usize;
            places.push(x + next);
            x += next + 1;
            lanes = lanes >> next >> 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Model, fir::profile};
    use super::*;
    use crate::NoiseModel;

    const NOISE: NoiseModel =
        NoiseModel { gain_e_per_dn: 40.0, read_noise_dn: 1.0, speckle_contrast: 0.0, full_scale_dn: 255.0 };

    /// What cleaning makes of one line of an image of stripes, with these grey values at these places on that line; `None`: it is left alone.
    fn cleaned(stripe: &[u8], axis: Axis, spots: &[(usize, u8)]) -> Option<Vec<u8>> {
        const LINES: usize = 70;
        const SPOTTED: usize = 33;
        let model =
            Model { noise: NOISE, width_px: 1.5, min_snr: 5.0, max_sigma_px: 1.0, max_width_px: 15.0 };
        let (width, height) = match axis {
            Axis::PerRow => (stripe.len(), LINES),
            Axis::PerColumn => (LINES, stripe.len()),
        };
        let index = |line: usize, at: usize| match axis {
            Axis::PerRow => line * width + at,
            Axis::PerColumn => at * width + line,
        };
        let mut pixels = vec![0; width * height];
        for (line, at) in (0..LINES).flat_map(|l| (0..stripe.len()).map(move |at| (l, at))) {
            pixels[index(line, at)] = stripe[at];
        }
        spots.iter().for_each(|(at, value)| pixels[index(SPOTTED, *at)] = *value);
        let image = View::packed(&pixels, width, height).expect("sized");
        let job = Job { image, roi: image.bounds(), axis, kind: super::super::Kind::Robust };
        let mut buffer = Cleaned::default();
        let engine = Engine::new(fearless_simd::Level::new(), model);
        let cleaned = engine.cleaned(&job, &mut buffer)?;
        let all: Vec<u8> = (0..height).flat_map(|y| cleaned.row(y).to_vec()).collect();
        spots.iter().for_each(|(at, _)| pixels[index(SPOTTED, *at)] = all[index(SPOTTED, *at)]);
        assert_eq!(all, pixels, "others are left alone");
        Some((0..stripe.len()).map(|at| all[index(SPOTTED, at)]).collect())
    }

    #[test]
    fn a_stripe_is_left_alone_and_single_pixels_are_not() {
        for (centre, width) in [20.0, 20.3, 20.5].into_iter().flat_map(|c| [0.8, 1.5, 6.0].map(|w| (c, w))) {
            // Longer than a vector, and shorter.
            for (length, axis) in [(40, Axis::PerRow), (40, Axis::PerColumn), (130, Axis::PerRow)] {
                let stripe: Vec<u8> = (0..length)
                    .map(|k| (4.0 + 200.0 * profile(f64::from(k), centre, width).0).round() as u8)
                    .collect();
                assert_eq!(cleaned(&stripe, axis, &[]), None, "{width} px at {centre}");
                for (at, value) in [(1, 90), (8, 200), (30, 255), (38, 90), (20, 0)] {
                    // Of two pixels and a dark one between them nobody can tell.
                    if value == 0 && width < 1.0 {
                        continue;
                    }
                    let found = cleaned(&stripe, axis, &[(at, value)]).expect("a lone pixel");
                    assert_eq!(
                        found[at],
                        stripe[at - 1].midpoint(stripe[at + 1]),
                        "{value} at {at}, {width} px"
                    );
                }
                // Far narrower than usual, but there on the next line, too.
                let narrow: Vec<u8> = (0..length)
                    .map(|k| (4.0 + 200.0 * profile(f64::from(k), centre, 0.3).0).round() as u8)
                    .collect();
                assert_eq!(cleaned(&narrow, axis, &[]), None, "{centre}");
            }
        }
    }
}
