//! Images without their lone pixels, where estimates look as if there were some: those are looked at again. Other images cost nothing.

use fearless_simd::{Simd, SimdBase, SimdInt, SimdMask, dispatch};

use super::lanes::{splat, vector};
use super::{Engine, Job};
use crate::lone::Lone;
use crate::{Axis, Pixel, View};

/// A region without its lone pixels, in an image of its own; keeps its buffers.
#[derive(Debug, Default)]
pub(super) struct Cleaned<P> {
    pixels: Vec<P>,
    places: Vec<usize>,
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
        Cleaned { pixels, places, whole }: &'a mut Cleaned<P>,
    ) -> Option<View<'a, P>> {
        let lone = Lone::new(&self.model.noise, f64::from(self.model.width_px));
        let least = P::from_dn(lone.least());
        let (image, roi) = (&job.image, job.roi);
        let (width, height) = (image.width(), image.height());
        let row = |y: usize| &image.row(roi.y + y)[roi.x..][..roi.width];
        // By rows either way; the pixels beside one on its line are in the same row, or above and below.
        let (rows, first) = match job.axis {
            Axis::PerRow => (0..roi.height, 1),
            Axis::PerColumn => (1..roi.height.saturating_sub(1), 0),
        };
        let mut any = false;
        for y in rows {
            let three = match job.axis {
                Axis::PerRow if roi.width < 3 => return None,
                Axis::PerRow => [&row(y)[..roi.width - 2], &row(y)[1..roi.width - 1], &row(y)[2..]],
                Axis::PerColumn => [row(y - 1), row(y), row(y + 1)],
            };
            places.clear();
            dispatch!(self.level, simd => apart(simd, three, least, places));
            for &x in &*places {
                let [before, here, after] = three.map(|row| row[x].dn());
                if !lone.is(before, here, after) {
                    continue;
                }
                if !any {
                    pixels.resize(width * height, P::ZERO);
                    for y in 0..roi.height {
                        pixels[(roi.y + y) * width + roi.x..][..roi.width].copy_from_slice(row(y));
                    }
                    any = true;
                }
                pixels[(roi.y + y) * width + roi.x + first + x] = P::from_dn(0.5 * (before + after));
            }
        }
        if !any {
            return None;
        }
        *whole = (roi == image.bounds()).then_some((width, height));
        View::packed(pixels, width, height).ok()
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
        let [before, here, after] = [before, here, after].map(|row| vector(simd, &row[at..at + P::N]));
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

    /// What cleaning makes of an image of one line, many times over; `None`: it is left alone.
    fn cleaned(line: &[u8], axis: Axis) -> Option<Vec<u8>> {
        const LINES: usize = 70;
        let model =
            Model { noise: NOISE, width_px: 1.5, min_snr: 5.0, max_sigma_px: 1.0, max_width_px: 15.0 };
        let (width, height) = match axis {
            Axis::PerRow => (line.len(), LINES),
            Axis::PerColumn => (LINES, line.len()),
        };
        let pixels: Vec<u8> = match axis {
            Axis::PerRow => line.repeat(LINES),
            Axis::PerColumn => line.iter().flat_map(|v| [*v; LINES]).collect(),
        };
        let image = View::packed(&pixels, width, height).expect("sized");
        let job = Job { image, roi: image.bounds(), axis, kind: super::super::Kind::Robust };
        let mut buffer = Cleaned::default();
        let engine = Engine::new(fearless_simd::Level::new(), model);
        let cleaned = engine.cleaned(&job, &mut buffer)?;
        let line = |l: usize| -> Vec<u8> {
            match axis {
                Axis::PerRow => cleaned.row(l).to_vec(),
                Axis::PerColumn => (0..height).map(|y| cleaned.row(y)[l]).collect(),
            }
        };
        assert!((0..LINES).all(|l| line(l) == line(0)));
        Some(line(0))
    }

    #[test]
    fn a_stripe_is_left_alone_and_single_pixels_are_not() {
        for (centre, width) in [20.0, 20.3, 20.5].into_iter().flat_map(|c| [0.8, 1.5, 6.0].map(|w| (c, w))) {
            // Longer than a vector, and shorter.
            for (length, axis) in [(40, Axis::PerRow), (40, Axis::PerColumn), (130, Axis::PerRow)] {
                let stripe: Vec<u8> = (0..length)
                    .map(|k| (4.0 + 200.0 * profile(f64::from(k), centre, width).0).round() as u8)
                    .collect();
                assert_eq!(cleaned(&stripe, axis), None, "{width} px at {centre}");
                for (at, value) in [(1, 90), (8, 200), (30, 255), (38, 90), (20, 0)] {
                    // Of two pixels and a dark one between them nobody can tell.
                    if value == 0 && width < 1.0 {
                        continue;
                    }
                    let mut line = stripe.clone();
                    line[at] = value;
                    let found = cleaned(&line, axis).expect("a lone pixel");
                    line[at] = found[at];
                    assert_eq!(found, line, "others are left alone");
                    assert_eq!(
                        found[at],
                        stripe[at - 1].midpoint(stripe[at + 1]),
                        "{value} at {at}, {width} px"
                    );
                }
            }
        }
    }
}
