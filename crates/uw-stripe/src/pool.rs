//! Pooling along the stripe: each centre from its neighbours' as well, against speckle, at the price of resolution.
//!
//! Speckle scatters the centre of every line by more than any camera noise, and nothing within one line tells by how much (Dorsch,
//! Häusler, Herrmann, Appl. Opt. 33 (1994) 1306). Grains are a few pixels long, so that lines further apart err independently and
//! their mean does better. A surface is followed to first order, and to second as far as its bend stands out of the noise; what is finer
//! than the kernel is smoothed away, and the caller asks for that knowingly.

use crate::profile::Stripe;
use std::ops::Range;

/// Reach of the kernel, in its sigmas.
const REACH: f64 = 3.0;
/// Variances of its noise that a bend's square must exceed to be followed at all.
const DOUBT: f64 = 2.0;
/// Lags, in lines, at which neighbouring errors are looked at.
const LAGS: usize = 3;
/// Least excess that is believed: an image without any noise does not make centres without any.
const LEAST_EXCESS: f64 = 0.01;
/// Differences that make a figure of the scatter.
const LEAST: usize = 30;

/// Centre, sigma and weight of a line before pooling.
#[derive(Debug, Clone, Copy)]
struct Own {
    position: f64,
    sigma: f64,
}

/// Reused memory of [`Pool::apply`].
#[derive(Debug, Default)]
pub(crate) struct Pool {
    own: Vec<Option<Own>>,
    differences: Vec<f64>,
}

/// How the errors of lines a few apart go together: scatter over predicted sigma, squared, and correlations.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Scatter {
    excess: f64,
    correlation: [f64; LAGS],
}

impl Pool {
    /// Replaces the positions of `lines` by local fits along the stripe under a Gaussian kernel of `sigma_lines`, and their sigmas by
    /// what the scatter along the stripe makes of these: correlated errors are pooled for less. Lines further than `reach` px (a
    /// line) from the next, or without a position, end a run; nothing is pooled across.
    pub fn apply(
        &mut self,
        stripe: &mut Stripe,
        lines: Range<usize>,
        sigma_lines: f64,
        reach: impl Fn(usize) -> f32,
    ) {
        if sigma_lines.is_nan() || sigma_lines <= 0.0 {
            return;
        }
        self.own.clear();
        self.own.extend(lines.clone().map(|i| {
            let own =
                Own { position: f64::from(stripe.position_px[i]), sigma: f64::from(stripe.sigma_px[i]) };
            (own.position.is_finite() && own.sigma > 0.0).then_some(own)
        }));
        let joined = |a: usize, b: usize| {
            let step = (stripe.position_px[lines.start + a] - stripe.position_px[lines.start + b]).abs();
            step <= reach(lines.start + a).max(reach(lines.start + b))
        };
        let runs = runs(&self.own, joined);
        let scatter = self.scatter(&runs);
        for run in runs {
            for i in run.clone() {
                if let Some((position, sigma)) = local(&self.own, run.clone(), i, sigma_lines, &scatter) {
                    stripe.position_px[lines.start + i] = position as f32;
                    stripe.sigma_px[lines.start + i] = sigma as f32;
                }
            }
        }
    }

    /// Scatter and correlation of the errors along the stripe, from third differences at several spacings: a smooth surface drops
    /// out of them, and at the widest spacing the errors count as independent.
    ///
    /// A third difference at spacing s has the variance 20 γ₀ − 30 γₛ + 12 γ₂ₛ − 2 γ₃ₛ of the autocovariance γ; from the widest
    /// spacing to the narrowest each gives one more γ.
    fn scatter(&mut self, runs: &[Range<usize>]) -> Scatter {
        /// Squares of more than so many medians are another surface.
        const OUTLIER: f64 = 16.0 / 0.455;
        let mut out = Scatter { excess: 1.0, correlation: [0.0; LAGS] };
        let mut covariance = [0.0; 3 * LAGS + 1];
        for spacing in (1..=LAGS).rev() {
            self.differences.clear();
            for run in runs {
                for i in run.start..run.end.saturating_sub(3 * spacing) {
                    let four = [0, 1, 2, 3].map(|k| self.own[i + k * spacing]);
                    let [Some(a), Some(b), Some(c), Some(d)] = four else { continue };
                    let difference = a.position - 3.0 * b.position + 3.0 * c.position - d.position;
                    let predicted =
                        a.sigma * a.sigma + 9.0 * (b.sigma * b.sigma + c.sigma * c.sigma) + d.sigma * d.sigma;
                    self.differences.push(difference * difference / predicted);
                }
            }
            let count = self.differences.len();
            if count < LEAST {
                return Scatter { excess: 1.0, correlation: [0.0; LAGS] };
            }
            let median = *self.differences.select_nth_unstable_by(count / 2, f64::total_cmp).1;
            let kept = || self.differences.iter().filter(|d| **d <= OUTLIER * median);
            let variance = kept().sum::<f64>() / kept().count().max(1) as f64;
            if spacing == LAGS {
                // Against a grain longer than that nothing is known.
                (covariance[0], out.excess) = (variance, variance.max(LEAST_EXCESS));
                continue;
            }
            let rest = 12.0 * covariance[2 * spacing] - 2.0 * covariance[3 * spacing];
            let lag = (20.0 * (covariance[0] - variance) + rest) / 30.0;
            // Correlations of a grain fall with the distance, and are not negative.
            covariance[spacing] = lag.clamp(0.0, covariance[0]);
        }
        if out.excess > 0.0 {
            for (to, from) in out.correlation.iter_mut().zip(covariance) {
                *to = from / out.excess;
            }
        }
        out
    }
}

/// Unbroken runs of lines.
fn runs(own: &[Option<Own>], joined: impl Fn(usize, usize) -> bool) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for i in (0..own.len()).filter(|i| own[*i].is_some()) {
        match runs.last_mut() {
            Some(run) if run.end == i && joined(i - 1, i) => run.end = i + 1,
            _ => runs.push(i..i + 1),
        }
    }
    runs
}

/// Position and sigma of line `i` from the members of its run under the kernel.
fn local(
    own: &[Option<Own>],
    run: Range<usize>,
    i: usize,
    sigma_lines: f64,
    scatter: &Scatter,
) -> Option<(f64, f64)> {
    let far = (REACH * sigma_lines).ceil() as usize;
    let near = i.saturating_sub(far).max(run.start)..(i + far + 1).min(run.end);
    let middle = own[i]?;
    let members = || {
        near.clone().filter_map(|j| {
            let (x, line) = (j as f64 - i as f64, own[j]?);
            let kernel = (-0.5 * (x / sigma_lines).powi(2)).exp();
            Some((j, x, line.position - middle.position, kernel / (line.sigma * line.sigma), line.sigma))
        })
    };
    let mut m = [0.0; 5];
    let mut p = [0.0; 3];
    for (_, x, u, weight, _) in members() {
        let mut power = weight;
        for k in 0..5 {
            m[k] += power;
            if k < 3 {
                p[k] += power * u;
            }
            power *= x;
        }
    }
    // A centre as a sum over the lines: the weights that a fit of `degree` gives them.
    let fit = |degree: usize| -> Option<[f64; 3]> {
        let normal = nalgebra::Matrix3::from_fn(|r, c| match (r <= degree, c <= degree) {
            (true, true) => m[r + c],
            _ => f64::from(u8::from(r == c)),
        });
        let row = normal.cholesky()?.solve(&nalgebra::Vector3::x());
        Some([row.x, row.y * f64::from(u8::from(degree > 0)), row.z * f64::from(u8::from(degree > 1))])
    };
    let variance = |g: &dyn Fn(f64) -> f64| {
        let mut sum = 0.0;
        for (j, x, _, weight, sigma) in members() {
            let here = weight * g(x) * sigma;
            sum += here * here;
            for (lag, correlation) in scatter.correlation.iter().enumerate().skip(1) {
                if let Some(other) = near.clone().contains(&(j + lag)).then(|| own[j + lag]).flatten() {
                    let y = x + lag as f64;
                    let kernel = (-0.5 * (y / sigma_lines).powi(2)).exp();
                    sum += 2.0 * correlation * here * kernel / other.sigma * g(y);
                }
            }
        }
        (scatter.excess * sum).max(0.0)
    };
    let line = fit(1).or_else(|| fit(0))?;
    let straight = |x: f64| line[0] + line[1] * x;
    let value = |g: &[f64; 3]| g[0] * p[0] + g[1] * p[1] + g[2] * p[2];
    let mut best = (value(&line), variance(&straight));
    if let Some(curve) = fit(2) {
        let bent = |x: f64| curve[0] + curve[1] * x + curve[2] * x * x;
        let (off, noise) = (value(&curve) - best.0, variance(&|x| bent(x) - straight(x)));
        // Shrunk towards a straight stripe as far as noise explains the bend (James and Stein); what is left may be bias.
        let share = (1.0 - DOUBT * noise / (off * off)).max(0.0);
        if share.is_finite() {
            let left = (1.0 - share).powi(2) * (off * off - noise).max(0.0);
            let mixed = |x: f64| straight(x) + share * (bent(x) - straight(x));
            best = (best.0 + share * off, variance(&mixed) + left);
        }
    }
    best.1.is_finite().then(|| (middle.position + best.0, best.1.sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::Stripe;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, StandardNormal};

    const LINES: usize = 600;

    /// A stripe of the given centres with errors of `sigma` that `grain` lines share, and its errors' scatter as predicted.
    fn noisy(centre: impl Fn(f64) -> f64, sigma: f64, grain: usize, seed: u64) -> Stripe {
        let mut rng = StdRng::seed_from_u64(seed);
        let white: Vec<f64> = (0..LINES + grain).map(|_| StandardNormal.sample(&mut rng)).collect();
        let mut stripe = Stripe::empty();
        stripe.reset(crate::Axis::PerRow, LINES);
        for i in 0..LINES {
            let error = white[i..i + grain].iter().sum::<f64>() / (grain as f64).sqrt();
            stripe.position_px[i] = (centre(i as f64) + sigma * error) as f32;
            (stripe.sigma_px[i], stripe.width_px[i], stripe.amplitude[i]) = (sigma as f32, 2.0, 100.0);
            stripe.reject[i] = None;
        }
        stripe
    }

    /// RMS error and RMS of error over sigma after pooling.
    fn pooled(centre: impl Fn(f64) -> f64, grain: usize, sigma_lines: f64) -> (f64, f64) {
        let (mut square, mut normal, mut count) = (0.0, 0.0, 0.0);
        for seed in 0..6 {
            let mut stripe = noisy(&centre, 0.1, grain, seed);
            Pool::default().apply(&mut stripe, 0..LINES, sigma_lines, |_| 7.0);
            for i in 0..LINES {
                let error = f64::from(stripe.position_px[i]) - centre(i as f64);
                square += error * error;
                normal += (error / f64::from(stripe.sigma_px[i])).powi(2);
                count += 1.0;
            }
        }
        ((square / count).sqrt(), (normal / count).sqrt())
    }

    #[test]
    fn independent_errors_fall_as_the_kernel_says_and_correlated_ones_less() {
        /// A Gaussian kernel of 2 lines holds √(4π) · 2 = 7.1 independent ones; being ready for a bend costs a tenth.
        const GAIN: f64 = 0.376;
        const READY: f64 = 1.15;
        let slanted = |v: f64| 100.0 + 0.7 * v;
        let (rms, honesty) = pooled(slanted, 1, 2.0);
        assert!((0.95..READY).contains(&(rms / (0.1 * GAIN))), "{rms}");
        assert!((0.9..1.1).contains(&honesty), "{honesty}");
        let (rms, honesty) = pooled(slanted, 3, 2.0);
        assert!(rms > 0.1 * GAIN * 1.3 && rms < 0.1, "{rms}");
        assert!((0.9..1.15).contains(&honesty), "{honesty}");
    }

    #[test]
    fn a_bend_is_followed() {
        let bent = |v: f64| 100.0 + 30.0 * (v / 25.0).sin();
        let (rms, honesty) = pooled(bent, 1, 3.0);
        assert!(rms < 0.06, "{rms}");
        assert!((0.85..1.15).contains(&honesty), "{honesty}");
    }

    #[test]
    fn nothing_is_pooled_across_a_break() {
        let step = |v: f64| if v < 300.0 { 50.0 } else { 90.0 };
        let mut stripe = noisy(step, 0.02, 1, 1);
        stripe.position_px[100] = f32::NAN;
        Pool::default().apply(&mut stripe, 0..LINES, 4.0, |_| 7.0);
        assert!(stripe.position_px[100].is_nan());
        for i in (0..LINES).filter(|i| *i != 100) {
            assert!((f64::from(stripe.position_px[i]) - step(i as f64)).abs() < 0.1, "line {i}");
        }
    }
}
