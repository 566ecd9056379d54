//! How noisy a grey value is: the model, and its estimate from the image itself.

use crate::StripeError;
use crate::lines::Lines;

/// Variance of rounding to whole DN, DN².
pub(crate) const QUANTISATION: f64 = 1.0 / 12.0;
/// Full well that a starting value of the gain assumes, e⁻; typical of industrial cameras, replaced by the estimate.
const TYPICAL_FULL_WELL_E: f32 = 1.0e4;

/// Noise of a grey value μ that holds a stripe's signal s: variance
/// `read_noise² + 1/12 + μ / gain + (speckle_contrast · s)²`, DN².
///
/// Photon transfer (J. Janesick, *Photon Transfer*, SPIE 2007) with the multiplicative term that speckle adds
/// (J. W. Goodman, *Speckle Phenomena in Optics*, 2007).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseModel {
    /// Electrons a DN.
    pub gain_e_per_dn: f32,
    /// Standard deviation in the dark, without rounding, DN.
    pub read_noise_dn: f32,
    /// Standard deviation over mean of the laser's speckle, per pixel.
    pub speckle_contrast: f32,
    /// Grey value at and above which pixels are clipped, DN.
    pub full_scale_dn: f32,
}

impl NoiseModel {
    /// A mid-range camera, to begin an estimate with.
    pub(crate) fn start(full_scale_dn: f32) -> Self {
        Self {
            gain_e_per_dn: TYPICAL_FULL_WELL_E / full_scale_dn,
            read_noise_dn: full_scale_dn / 255.0,
            speckle_contrast: 0.0,
            full_scale_dn,
        }
    }

    /// The model itself when all its values can be used.
    ///
    /// # Errors
    /// [`StripeError::InvalidOption`] for a value that is not finite or out of range.
    pub fn checked(self) -> Result<Self, StripeError> {
        let positive = |name, v: f32| {
            if v.is_finite() && v > 0.0 {
                Ok(())
            } else {
                Err(StripeError::InvalidOption { name, needed: "finite and positive", got: f64::from(v) })
            }
        };
        let not_negative = |name, v: f32| {
            if v.is_finite() && v >= 0.0 {
                Ok(())
            } else {
                Err(StripeError::InvalidOption { name, needed: "finite and not negative", got: f64::from(v) })
            }
        };
        positive("gain_e_per_dn", self.gain_e_per_dn)?;
        positive("full_scale_dn", self.full_scale_dn)?;
        not_negative("read_noise_dn", self.read_noise_dn)?;
        not_negative("speckle_contrast", self.speckle_contrast)?;
        Ok(self)
    }

    /// Variance, DN², of a pixel whose expected grey value is `level_dn`, `signal_dn` of it the stripe's.
    pub fn variance(&self, level_dn: f64, signal_dn: f64) -> f64 {
        let read = f64::from(self.read_noise_dn);
        let speckle = f64::from(self.speckle_contrast) * signal_dn;
        read * read + QUANTISATION + level_dn.max(0.0) / f64::from(self.gain_e_per_dn) + speckle * speckle
    }
}

/// The value at which the image is clipped, DN: its type's largest for 8 bits; for 16 bits the least 2ⁿ − 1, n ≥ 8,
/// that the image does not exceed, since cameras right-justify 10, 12 or 14 bits.
pub(crate) fn full_scale(type_max_dn: f32, image_max_dn: f32) -> f32 {
    let mut full = 255.0;
    while full < image_max_dn && full < type_max_dn {
        full = full * 2.0 + 1.0;
    }
    full
}

/// Standard deviation of the background from differences of neighbouring pixels, DN; 0 where the floor clips it all.
///
/// The median absolute difference ignores stripes and edges, and needs no flat area (Immerkær 1996, reduced to one
/// direction). Every seventh pixel is enough and keeps it cheap.
pub(crate) fn background_noise(lines: &Lines, scratch: &mut Vec<f32>) -> f32 {
    const STEP: usize = 7;
    /// Median of |N(0,1) − N(0,1)|.
    const MEDIAN_ABS_DIFFERENCE: f32 = 0.9539;
    scratch.clear();
    scratch.extend(lines.value.windows(2).step_by(STEP).map(|p| (p[1] - p[0]).abs()));
    if scratch.is_empty() {
        return 0.0;
    }
    let middle = scratch.len() / 2;
    let (_, median, _) = scratch.select_nth_unstable_by(middle, f32::total_cmp);
    *median / MEDIAN_ABS_DIFFERENCE
}

/// One unclipped pixel of a fitted stripe: what photon transfer is read from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Residual {
    /// Fitted grey value, DN.
    pub level: f64,
    /// The stripe's part of it, DN.
    pub signal: f64,
    /// Square of measured minus fitted, DN².
    pub square: f64,
    /// Variance that the fit assumed, DN².
    pub variance: f64,
    /// 1 − leverage: the share of the variance that the fit leaves in the residual.
    pub freedom: f64,
}

/// Largest full well that a camera is believed to have, e⁻: there is no light without shot noise, whatever else explains it.
const LARGEST_FULL_WELL_E: f64 = 2.0e5;

/// Mean noise of a level of grey: what (1, level, signal²) · (read noise², 1/gain, speckle contrast²) should add up to, and the weight.
#[derive(Debug, Clone, Copy)]
struct Row {
    terms: [f64; 3],
    /// Variance without rounding's, DN².
    target: f64,
    weight: f64,
}

impl Row {
    /// Square of what a model leaves, in sigmas of a mean variance up to a factor.
    fn cost(&self, x: &[f64; 3]) -> f64 {
        let model: f64 = self.terms.iter().zip(x).map(|(t, x)| t * x).sum();
        (self.weight * (model - self.target)).powi(2)
    }
}

/// Reads gain, read noise and speckle contrast off the residuals of stripe fits.
///
/// The residuals are binned by level; in each bin the assumed variance is rescaled by the median of r² / v (1 − h) over
/// that of χ²₁ (so that edges and reflections, a minority, do not count), and the model fitted to the bins by least
/// squares on relative errors with all three terms kept ≥ 0, and shot noise above that of the largest full well.
pub(crate) fn photon_transfer(residuals: &[Residual], now: &NoiseModel) -> NoiseModel {
    let rows = rows(residuals, now.full_scale_dn);
    let least_shot = f64::from(now.full_scale_dn) / LARGEST_FULL_WELL_E;
    let Some(x) = least_squares(&rows, least_shot) else { return *now };
    NoiseModel {
        read_noise_dn: x[0].sqrt() as f32,
        gain_e_per_dn: x[1].recip() as f32,
        speckle_contrast: x[2].sqrt() as f32,
        full_scale_dn: now.full_scale_dn,
    }
}

/// Whether `camera` explains the residuals: false where at most levels they are several times as large as it says, as speckle makes them.
pub(crate) fn explains(residuals: &[Residual], camera: &NoiseModel) -> bool {
    /// Ratio of variances beyond which a level is not explained.
    const ROUGH: f64 = 4.0;
    let rows = rows(residuals, camera.full_scale_dn);
    let rough = |r: &&Row| {
        let expected =
            camera.variance(r.terms[1], 0.0) + f64::from(camera.speckle_contrast).powi(2) * r.terms[2];
        r.target + QUANTISATION > ROUGH * expected
    };
    2 * rows.iter().filter(rough).count() <= rows.len()
}

/// Whether speckle clearly explains what the camera's own noise cannot, by the costs without and with it: a needless term takes weight from
/// the bright pixels, and shot noise passes for a little speckle.
fn speckled(plain: f64, with: f64, contrast_squared: f64) -> bool {
    /// Fall of the cost: five sigmas of a median-based variance (sigma 1.65 / √n), and a share of what the cost was.
    const LEAST_FALL: f64 = 25.0 * 1.65 * 1.65;
    const LEAST_SHARE: f64 = 0.5;
    /// Least contrast: a laser's on a rough surface is some tenths, what profiles lack of a Gaussian some hundredths.
    const LEAST_CONTRAST: f64 = 0.05;
    contrast_squared >= LEAST_CONTRAST * LEAST_CONTRAST
        && with < (LEAST_SHARE * plain).min(plain - LEAST_FALL)
}

/// The noise of each level that the residuals show enough of.
fn rows(residuals: &[Residual], full_scale_dn: f32) -> Vec<Row> {
    /// Sigmas below full scale from which only those are left that noise has lowered.
    const CLEAR_OF_CLIPPING: f64 = 3.0;
    /// Bins an octave of the level, and how many; from below one DN up to 16 bits.
    const PER_OCTAVE: f64 = 2.0;
    const BINS: usize = 40;
    /// Pixels below which a bin says nothing.
    const LEAST_PIXELS: usize = 12;
    /// Pixels that the fit follows almost wholly tell more of rounding than of noise.
    const LEAST_FREEDOM: f64 = 0.1;
    /// Median of χ² with one degree of freedom.
    const MEDIAN_CHI2: f64 = 0.4549;
    let mut bins: Vec<Vec<(f64, &Residual)>> = vec![Vec::new(); BINS];
    let clear = |r: &&Residual| r.level + CLEAR_OF_CLIPPING * r.variance.sqrt() < f64::from(full_scale_dn);
    for r in residuals.iter().filter(|r| r.freedom >= LEAST_FREEDOM && r.variance > 0.0).filter(clear) {
        let at = ((1.0 + r.level.max(0.0)).log2() * PER_OCTAVE) as usize;
        bins[at.min(BINS - 1)].push((r.square / (r.variance * r.freedom), r));
    }
    bins.iter_mut()
        .filter(|b| b.len() >= LEAST_PIXELS)
        .map(|bin| {
            let count = bin.len() as f64;
            let middle = bin.len() / 2;
            let ratio = bin.select_nth_unstable_by(middle, |a, b| a.0.total_cmp(&b.0)).1.0 / MEDIAN_CHI2;
            let mean = |value: fn(&Residual) -> f64| bin.iter().map(|(_, r)| value(r)).sum::<f64>() / count;
            let variance = mean(|r| r.variance) * ratio;
            Row {
                terms: [1.0, mean(|r| r.level.max(0.0)), mean(|r| r.signal * r.signal)],
                target: (variance - QUANTISATION).max(0.0),
                // The relative variance of a variance estimate falls with the count.
                weight: count.sqrt() / variance.max(QUANTISATION),
            }
        })
        .collect()
}

/// The least-squares solution with x ≥ 0 and at least so much shot noise: the best of the subsets whose plain solution holds to that, with
/// speckle only where [`speckled`]. `None` with fewer rows than columns.
fn least_squares(rows: &[Row], least_shot: f64) -> Option<[f64; 3]> {
    if rows.len() < 3 {
        return None;
    }
    let mut best = [None::<(f64, [f64; 3])>; 2];
    for subset in 1u8..8 {
        let mut normal = nalgebra::Matrix3::<f64>::zeros();
        let mut right = nalgebra::Vector3::<f64>::zeros();
        for row in rows {
            let used = nalgebra::Vector3::from_fn(|k, _| {
                if subset >> k & 1 == 1 { row.weight * row.terms[k] } else { 0.0 }
            });
            normal += used * used.transpose();
            right += used * (row.weight * (row.target - least_shot * row.terms[1]));
        }
        for k in 0..3 {
            if subset >> k & 1 == 0 {
                normal[(k, k)] = 1.0;
            }
        }
        // Levels spread over five decades: scale to a unit diagonal before factoring.
        let scale = nalgebra::Vector3::from_fn(|k, _| normal[(k, k)].max(f64::MIN_POSITIVE).sqrt().recip());
        let scaled = nalgebra::Matrix3::from_fn(|r, c| normal[(r, c)] * scale[r] * scale[c]);
        let Some(factor) = scaled.cholesky() else { continue };
        let x = factor.solve(&right.component_mul(&scale)).component_mul(&scale);
        if !x.iter().all(|v| v.is_finite() && *v >= 0.0) {
            continue;
        }
        let x = [x[0], x[1] + least_shot, x[2]];
        let cost: f64 = rows.iter().map(|r| r.cost(&x)).sum();
        let kind = &mut best[usize::from(subset >> 2)];
        if kind.is_none_or(|(least, _)| cost < least) {
            *kind = Some((cost, x));
        }
    }
    match best {
        [Some((plain, x)), Some((with, speckle))] => {
            Some(if speckled(plain, with, speckle[2]) { speckle } else { x })
        }
        [plain, with] => plain.or(with).map(|(_, x)| x),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: NoiseModel =
        NoiseModel { gain_e_per_dn: 40.0, read_noise_dn: 1.0, speckle_contrast: 0.0, full_scale_dn: 255.0 };

    /// Residuals as large as the noise's quantiles, of stripes up to 150 DN on 4 DN; `assumed` by the fits.
    fn residuals(noise: &NoiseModel, assumed: &NoiseModel) -> Vec<Residual> {
        // Squares of normal deviates with chances of exceeding them that lie a ninth apart.
        const SQUARES: [f64; 9] = [0.0049, 0.0443, 0.1264, 0.2586, 0.4549, 0.7424, 1.1779, 1.9127, 3.6653];
        (0..1800)
            .map(|i| {
                let signal = 150.0 * (-0.5 * (f64::from(i % 50) / 12.0).powi(2)).exp();
                let square = SQUARES[i as usize / 50 % 9] * noise.variance(signal + 4.0, signal);
                let variance = assumed.variance(signal + 4.0, signal);
                Residual { level: signal + 4.0, signal, square, variance, freedom: 1.0 }
            })
            .collect()
    }

    #[test]
    fn the_model_behind_residuals_is_found_with_speckle_and_without() {
        for contrast in [0.0, 0.3] {
            let noise = NoiseModel { speckle_contrast: contrast, ..CAMERA };
            let start = NoiseModel::start(255.0);
            let got = photon_transfer(&residuals(&noise, &start), &start);
            for signal in [0.0, 20.0, 150.0] {
                let ratio = got.variance(signal + 4.0, signal) / noise.variance(signal + 4.0, signal);
                assert!((0.8..1.25).contains(&ratio), "{contrast}, {signal}: {got:?}");
            }
            assert!((got.speckle_contrast - contrast).abs() < 0.02, "{got:?}");
            assert_eq!(explains(&residuals(&noise, &CAMERA), &CAMERA), contrast < 0.1);
        }
    }

    #[test]
    fn shot_noise_is_not_traded_for_a_little_speckle() {
        // Variance that rises a little faster than light, as what profiles lack of a Gaussian makes it.
        let lacking = NoiseModel { speckle_contrast: 0.01, ..CAMERA };
        let start = NoiseModel::start(255.0);
        let got = photon_transfer(&residuals(&lacking, &start), &start);
        assert!(got.speckle_contrast < 1e-3, "{got:?}");
        assert!((15.0..80.0).contains(&got.gain_e_per_dn), "{got:?}");
        // None at all is never believed.
        let none = NoiseModel { gain_e_per_dn: 1e9, ..CAMERA };
        let got = photon_transfer(&residuals(&none, &start), &start);
        assert!(f64::from(got.gain_e_per_dn) * 255.0 <= 1.001 * LARGEST_FULL_WELL_E, "{got:?}");
    }
}
