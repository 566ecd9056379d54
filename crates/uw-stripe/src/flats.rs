//! A camera's noise from frames of even light and of none: photon transfer (J. Janesick, *Photon Transfer*, SPIE 2007).
//!
//! Frames of one exposure differ by noise alone: the variance of each pixel over them leaves out what is fixed in the sensor, and uneven light
//! gives many levels from one exposure. Variance over level is a line: read noise is its height in the dark, 1/gain its slope.

use crate::noise::QUANTISATION;
use crate::{NoiseModel, Pixel, StripeError, View};

/// Bins of level from none to full scale.
const BINS: usize = 256;
/// Pixels from which a bin is used.
const LEAST_PIXELS: f64 = 100.0;
/// Share of a bin's values at the floor or at full scale beyond which clipping has taken some of its noise.
const CLIPPED: f64 = 1e-3;
/// Relative sigma of the gain beyond which frames do not tell it.
const UNSURE: f64 = 0.2;
/// Sigmas below nothing of the dark variance that chance does not explain.
const BELOW: f64 = 4.0;

/// A camera's noise with the standard deviations of what was estimated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhotonTransfer {
    /// The noise; frames without a laser tell no speckle, whose contrast is 0.
    pub noise: NoiseModel,
    /// Standard deviation of the gain, e⁻/DN.
    pub sigma_gain_e_per_dn: f32,
    /// Standard deviation of the read noise, DN; as large as the read noise itself where the frames hold too little darkness to tell it.
    pub sigma_read_noise_dn: f32,
}

/// Sums of one bin of one exposure.
#[derive(Debug, Clone, Copy, Default)]
struct Bin {
    pixels: f64,
    level: f64,
    variance: f64,
    clipped: f64,
}

impl NoiseModel {
    /// The camera's noise from `exposures`: each some frames, at least two, taken one after the other of the same even light, or of none.
    /// Levels should reach from the dark to near full scale; `full_scale_dn` is where pixels are clipped, for example 4095 for 12 bits.
    ///
    /// Frames may be uneven (vignetting), and flicker from one to the next is taken out. Grey values must be proportional to light: of
    /// cameras that add a black level it has to be taken off first.
    ///
    /// # Errors
    /// [`StripeError::TooFewFrames`] for an exposure of a single frame, [`StripeError::FrameSize`] for frames of several sizes,
    /// [`StripeError::TooFewLevels`] where levels are too few or too alike to tell the gain, [`StripeError::BlackLevel`] where the noise
    /// vanishes above zero.
    ///
    /// # Examples
    /// ```
    /// use uw_stripe::{NoiseModel, StripeError, View};
    /// // Frames all of one level say nothing of the gain.
    /// let (a, b) = ([100u8, 101, 99, 100].repeat(100), [101u8, 99, 100, 100].repeat(100));
    /// let pair = [View::packed(&a, 20, 20)?, View::packed(&b, 20, 20)?];
    /// assert!(matches!(NoiseModel::from_flat_frames(&[&pair], 255.0), Err(StripeError::TooFewLevels { .. })));
    /// # Ok::<(), StripeError>(())
    /// ```
    pub fn from_flat_frames<P: Pixel>(
        exposures: &[&[View<'_, P>]],
        full_scale_dn: f32,
    ) -> Result<PhotonTransfer, StripeError> {
        if !(full_scale_dn.is_finite() && full_scale_dn > 0.0) {
            let got = f64::from(full_scale_dn);
            return Err(StripeError::InvalidOption {
                name: "full_scale_dn",
                needed: "finite and positive",
                got,
            });
        }
        let mut rows: Vec<[f64; 3]> = Vec::new();
        for frames in exposures {
            check(frames)?;
            let freedom = frames.len() as f64 - 1.0;
            for bin in bins(frames, full_scale_dn) {
                let clipped = bin.clipped > CLIPPED * bin.pixels * frames.len() as f64;
                if bin.pixels >= LEAST_PIXELS && !clipped {
                    let (level, variance) = (bin.level / bin.pixels, bin.variance / bin.pixels);
                    rows.push([level, variance, bin.pixels * freedom]);
                }
            }
        }
        let line = straight(&rows)
            .ok_or(StripeError::TooFewLevels { levels: rows.len(), relative_sigma: f64::INFINITY })?;
        let relative = line.sigma_slope / line.slope;
        if line.slope.is_nan() || line.slope <= 0.0 || relative.is_nan() || relative > UNSURE {
            let relative_sigma = if line.slope > 0.0 { relative } else { f64::INFINITY };
            return Err(StripeError::TooFewLevels { levels: rows.len(), relative_sigma });
        }
        let dark = line.dark - QUANTISATION;
        if line.dark < -BELOW * line.sigma_dark {
            return Err(StripeError::BlackLevel { level_dn: -line.dark / line.slope });
        }
        let read = dark.max(0.0).sqrt();
        // Near zero the root's own curve counts: the value that one sigma more would give.
        let sigma_read = (dark.max(0.0) + line.sigma_dark).sqrt() - read;
        Ok(PhotonTransfer {
            noise: Self {
                gain_e_per_dn: line.slope.recip() as f32,
                read_noise_dn: read as f32,
                speckle_contrast: 0.0,
                full_scale_dn,
            },
            sigma_gain_e_per_dn: (relative / line.slope) as f32,
            sigma_read_noise_dn: sigma_read as f32,
        })
    }
}

fn check<P: Pixel>(frames: &[View<'_, P>]) -> Result<(), StripeError> {
    let [first, _, ..] = frames else {
        return Err(StripeError::TooFewFrames { needed: 2, got: frames.len() });
    };
    let size = |v: &View<'_, P>| (v.width(), v.height());
    match frames.iter().find(|f| size(f) != size(first)) {
        Some(other) => Err(StripeError::FrameSize {
            needed_width: first.width(),
            needed_height: first.height(),
            got_width: other.width(),
            got_height: other.height(),
        }),
        None => Ok(()),
    }
}

/// Level and variance of the pixels of one exposure, by level.
fn bins<P: Pixel>(frames: &[View<'_, P>], full_scale_dn: f32) -> Vec<Bin> {
    let (width, height) = (frames[0].width(), frames[0].height());
    let n = frames.len() as f64;
    let mean = |f: &View<'_, P>| {
        (0..height).map(|y| f.row(y).iter().map(|p| f64::from(p.dn())).sum::<f64>()).sum::<f64>()
            / (width * height) as f64
    };
    let means: Vec<f64> = frames.iter().map(mean).collect();
    let all = means.iter().sum::<f64>() / n;
    // Frames are brought to the mean's light.
    let scale: Vec<f64> = means.iter().map(|m| if *m > 0.0 { all / m } else { 1.0 }).collect();
    let mut bins = vec![Bin::default(); BINS];
    for y in 0..height {
        let rows: Vec<&[P]> = frames.iter().map(|f| f.row(y)).collect();
        for x in 0..width {
            let (mut sum, mut squares, mut clipped) = (0.0, 0.0, 0.0);
            for (row, scale) in rows.iter().zip(&scale) {
                let raw = row[x].dn();
                let value = f64::from(raw) * scale;
                sum += value;
                squares += value * value;
                clipped += f64::from(u8::from(raw <= 0.0 || raw >= full_scale_dn));
            }
            let level = sum / n;
            let at = (level / f64::from(full_scale_dn) * BINS as f64) as usize;
            let bin = &mut bins[at.min(BINS - 1)];
            bin.pixels += 1.0;
            bin.level += level;
            bin.variance += (squares - sum * level).max(0.0) / (n - 1.0);
            bin.clipped += clipped;
        }
    }
    bins
}

/// A straight line of variance over level.
struct Line {
    dark: f64,
    slope: f64,
    sigma_dark: f64,
    sigma_slope: f64,
}

/// The line through (level, variance, degrees of freedom) by weights that follow it: a variance of n degrees is known to √(2/n) of itself.
fn straight(rows: &[[f64; 3]]) -> Option<Line> {
    const ROUNDS: usize = 4;
    let mut line: Option<Line> = None;
    for _ in 0..ROUNDS {
        let (mut s, mut x, mut xx, mut y, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for [level, variance, freedom] in rows {
            let expected = line.as_ref().map_or(*variance, |l| l.dark + l.slope * level).max(QUANTISATION);
            let weight = freedom / (2.0 * expected * expected);
            s += weight;
            x += weight * level;
            xx += weight * level * level;
            y += weight * variance;
            xy += weight * level * variance;
        }
        let determinant = s * xx - x * x;
        if determinant.is_nan() || determinant <= 1e-9 * s * xx {
            return None;
        }
        line = Some(Line {
            dark: (xx * y - x * xy) / determinant,
            slope: (s * xy - x * y) / determinant,
            sigma_dark: (xx / determinant).sqrt(),
            sigma_slope: (s / determinant).sqrt(),
        });
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal, Poisson};

    const SIZE: (usize, usize) = (120, 90);

    /// Frames of a camera of `gain` e⁻/DN and `read` DN in light of `level` DN that falls to a half in the corners, flickers by `flicker`,
    /// and on pixels that differ by 3 %.
    fn frames(
        level: f64,
        gain: f64,
        read: f64,
        flicker: f64,
        count: usize,
        full: f64,
        seed: u64,
    ) -> Vec<Vec<u16>> {
        let mut rng = StdRng::seed_from_u64(seed);
        let fixed: Vec<f64> =
            (0..SIZE.0 * SIZE.1).map(|_| Normal::new(1.0, 0.03).unwrap().sample(&mut rng)).collect();
        (0..count)
            .map(|k| {
                let now = 1.0 + flicker * if k % 2 == 0 { 1.0 } else { -1.0 };
                (0..SIZE.0 * SIZE.1)
                    .map(|i| {
                        let (x, y) = ((i % SIZE.0) as f64 / 60.0 - 1.0, (i / SIZE.0) as f64 / 45.0 - 1.0);
                        let electrons = level * gain * now * fixed[i] * (1.0 - 0.25 * (x * x + y * y));
                        let caught = if electrons > 0.0 {
                            Poisson::new(electrons).unwrap().sample(&mut rng)
                        } else {
                            0.0
                        };
                        let noise = Normal::new(0.0, read).unwrap().sample(&mut rng);
                        (caught / gain + noise).round().clamp(0.0, full) as u16
                    })
                    .collect()
            })
            .collect()
    }

    fn estimate(exposures: &[Vec<Vec<u16>>], full: f32) -> Result<PhotonTransfer, StripeError> {
        let views: Vec<Vec<View<'_, u16>>> = exposures
            .iter()
            .map(|e| e.iter().map(|f| View::packed(f, SIZE.0, SIZE.1).unwrap()).collect())
            .collect();
        let slices: Vec<&[View<'_, u16>]> = views.iter().map(Vec::as_slice).collect();
        NoiseModel::from_flat_frames(&slices, full)
    }

    #[test]
    fn gain_and_read_noise_come_back_within_their_sigmas() {
        /// Four figures in four sigmas: one failure in 4000 for honest ones.
        const SIGMAS: f32 = 4.0;
        for (gain, read, full) in [(2.5, 2.4, 4095.0), (40.0, 1.0, 255.0), (0.8, 6.0, 1023.0)] {
            let exposures: Vec<_> = [0.03, 0.1, 0.3, 0.6]
                .iter()
                .zip(0..)
                .map(|(share, seed)| frames(share * full, gain, read, 0.01, 4, full, seed))
                .collect();
            let got = estimate(&exposures, full as f32).unwrap();
            let (off, sigma) = ((got.noise.gain_e_per_dn - gain as f32).abs(), got.sigma_gain_e_per_dn);
            assert!(off < SIGMAS * sigma && sigma < 0.03 * gain as f32, "{gain}: {got:?}");
            let (off, sigma) = ((got.noise.read_noise_dn - read as f32).abs(), got.sigma_read_noise_dn);
            assert!(off < SIGMAS * sigma + 0.02 && sigma < 0.4 * read as f32, "{read}: {got:?}");
        }
    }

    #[test]
    fn frames_that_cannot_tell_are_refused_with_the_reason() {
        let dark = frames(5.0, 2.5, 0.5, 0.0, 3, 4095.0, 1);
        assert!(matches!(
            estimate(std::slice::from_ref(&dark), 4095.0),
            Err(StripeError::TooFewLevels { .. })
        ));
        assert!(matches!(estimate(&[], 4095.0), Err(StripeError::TooFewLevels { levels: 0, .. })));
        let single = frames(900.0, 2.5, 2.4, 0.0, 1, 4095.0, 2);
        let refused = estimate(&[dark, single], 4095.0);
        assert_eq!(refused.unwrap_err(), StripeError::TooFewFrames { needed: 2, got: 1 });
        // Clipped frames have no noise, and would pass for a camera of much light.
        let white = frames(9000.0, 2.5, 2.4, 0.0, 3, 4095.0, 3);
        assert!(matches!(estimate(&[white], 4095.0), Err(StripeError::TooFewLevels { .. })));
        let raised: Vec<Vec<Vec<u16>>> = [0.1, 0.3, 0.6]
            .iter()
            .map(|s| {
                let plain = frames(s * 3000.0, 2.5, 2.4, 0.0, 4, 4095.0, 4);
                plain.iter().map(|f| f.iter().map(|v| v + 200).collect()).collect()
            })
            .collect();
        let level = match estimate(&raised, 4095.0) {
            Err(StripeError::BlackLevel { level_dn }) => level_dn,
            other => panic!("{other:?}"),
        };
        assert!((level - 185.0).abs() < 25.0, "{level}");
    }
}
