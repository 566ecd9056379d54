//! The stripe's width as many lines show it together: strong speckle breaks a single line's profile into grains, each as narrow as the lens
//! draws a point, and each a good stripe by itself. Summed along the stripe the grains make the stripe again.

use super::Precise;
use crate::NoiseModel;
use crate::lines::{Clip, Line};
use crate::median::median;
use crate::mle::{self, Common, Seed, WidthPrior};

/// Lines on either side of a stack's middle: some twenty grains, over which a parabola follows the stripe.
const HALF: usize = 12;
/// Members that a stack needs, and stacks that are believed.
const LEAST_LINES: usize = 16;
const LEAST_STACKS: usize = 5;
/// Stacks an image.
const STACKS: usize = 24;
/// Ratio of the stacks' width to the single lines' from which these show grains.
const WIDER: f64 = 1.2;
/// Scatter of single lines' places along the stripe, in stacked widths, that goes with it: a bend, a step or haze widens a sum as well.
const ROUGH: f64 = 0.2;
/// Sigma of ln width that is left to single lines.
const LEFT: f64 = 0.25;
/// Scatter of a sum of grains by its signal, times the root of the lines: what the sum's shape is trusted to.
const GRAINS: f64 = 0.5;
/// Variance of rounding to whole pixels, px².
const ROUNDING: f64 = 1.0 / 12.0;
/// Median absolute deviation to standard deviation.
const SPREAD: f64 = 1.4826;

impl Precise {
    /// The width that stacks of lines show, if it is clearly more than single lines do.
    pub(super) fn stacked_width(&mut self, noise: &NoiseModel, single: WidthPrior) -> Option<WidthPrior> {
        let lines = self.choice.len();
        let step = (lines / STACKS).max(HALF);
        let (mut widths, mut roughs): (Vec<f64>, Vec<f64>) = (HALF..lines.saturating_sub(HALF))
            .step_by(step)
            .filter_map(|middle| self.stack(middle, noise, single.ln_width.exp()))
            .unzip();
        if widths.len() < LEAST_STACKS {
            return None;
        }
        // Speckle is everywhere or nowhere: most stacks have to show it, not the middle one.
        let width = median(&mut widths);
        let (narrow, smooth) = (lower(&mut widths), lower(&mut roughs));
        let grains = narrow > WIDER * single.ln_width.exp() && smooth > ROUGH * width;
        grains.then_some(WidthPrior { ln_width: width.ln(), sigma: LEFT })
    }

    /// Width of the mean profile of the lines around one, and the scatter of their places along the stripe, px.
    fn stack(&mut self, middle: usize, noise: &NoiseModel, single: f64) -> Option<(f64, f64)> {
        let members: Vec<(usize, f64)> = (middle - HALF..=middle + HALF)
            .filter_map(|i| Some((i, self.candidates[i].as_slice().get(self.choice[i]?)?.centre as f64)))
            .collect();
        let (curve, rough) = parabola(&members, middle)?;
        let reach = (mle::WINDOW.0 * 2.0 * single + mle::WINDOW.1).ceil() as usize;
        let (mut sum, mut count) = (vec![0.0f64; 2 * reach + 1], 0);
        for &(i, _) in &members {
            let t = i as f64 - middle as f64;
            let at = (curve[0] + curve[1] * t + curve[2] * t * t).round();
            let line = self.lines.line(i);
            let Some(from) = (at >= reach as f64).then(|| at as usize - reach) else { continue };
            let Some(values) = line.value.get(from..from + sum.len()) else { continue };
            if line.clip[from..from + sum.len()].contains(&Clip::Full) {
                continue;
            }
            sum.iter_mut().zip(values).for_each(|(s, v)| *s += f64::from(*v));
            count += 1;
        }
        if count < LEAST_LINES {
            return None;
        }
        let n = f64::from(u32::try_from(count).ok()?);
        let mean: Vec<f32> = sum.iter().map(|s| (s / n) as f32).collect();
        let clip = vec![Clip::No; mean.len()];
        let (flux, background) = light(&mean);
        let steadier = NoiseModel {
            gain_e_per_dn: noise.gain_e_per_dn * n as f32,
            read_noise_dn: noise.read_noise_dn / n.sqrt() as f32,
            speckle_contrast: (GRAINS / n.sqrt()) as f32,
            ..*noise
        };
        // As a single line is fitted, so that a skirt of haze is background here as there.
        let seed = Seed { centre: reach as f64, width: single, flux, background };
        let common = Common { noise: &steadier, width: None };
        let fit = self.fitter.one(seed, &Line::plain(&mean, &clip), common)?;
        let sound = fit.converged
            && (fit.centre - reach as f64).abs() < reach as f64
            && fit.width < f64::from(self.options.max_width_px);
        // Lines were put together by whole pixels.
        sound.then(|| ((fit.width * fit.width - ROUNDING).max(single * single / 4.0).sqrt(), rough))
    }
}

/// Lower quartile.
fn lower(values: &mut [f64]) -> f64 {
    let at = values.len() / 4;
    *values.select_nth_unstable_by(at, f64::total_cmp).1
}

/// Light above the line through the ends, and the level of these.
fn light(profile: &[f32]) -> (f64, f64) {
    let level = 0.5 * (f64::from(profile[0]) + f64::from(profile[profile.len() - 1]));
    let flux: f64 = profile.iter().map(|v| f64::from(*v) - level).sum();
    (flux.max(f64::MIN_POSITIVE), level)
}

/// Coefficients, by rising powers of the line's distance from `middle`, of the parabola through the places, twice over without outliers, and
/// the scatter around it beyond rounding's, px; `None` where too few are left.
fn parabola(members: &[(usize, f64)], middle: usize) -> Option<([f64; 3], f64)> {
    /// Outliers, in median residuals.
    const OUTLIER: f64 = 4.0;
    let powers = |i: usize| {
        let t = i as f64 - middle as f64;
        nalgebra::Vector3::new(1.0, t, t * t)
    };
    let fit = |used: &dyn Fn(usize, f64) -> bool| {
        let (mut normal, mut right, mut count) = (nalgebra::Matrix3::zeros(), nalgebra::Vector3::zeros(), 0);
        for &(i, place) in members.iter().filter(|m| used(m.0, m.1)) {
            let p = powers(i);
            normal += p * p.transpose();
            right += p * place;
            count += 1;
        }
        (count >= LEAST_LINES).then(|| Some(normal.cholesky()?.solve(&right))).flatten()
    };
    let first = fit(&|_, _| true)?;
    let off = |i: usize, place: f64| (place - first.dot(&powers(i))).abs();
    let mut all: Vec<f64> = members.iter().map(|m| off(m.0, m.1)).collect();
    let usual = median(&mut all);
    let limit = OUTLIER * usual.max(0.5);
    let rough = ((SPREAD * usual).powi(2) - ROUNDING).max(0.0).sqrt();
    Some((fit(&|i, place| off(i, place) <= limit)?.into(), rough))
}
