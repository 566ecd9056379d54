//! What the neighbouring lines know of a line's background.
//!
//! A background of degree 5 follows the skirt that turbid water puts under a stripe, but told from one line's pixels alone it costs
//! the centre 15 %. Light that was scattered is smooth along the stripe, too: so each line's background gets the mean of its
//! neighbours' as prior, as wide as these scatter beyond their own noise (empirical Bayes; B. Efron, C. Morris, J. Am. Stat. Assoc.
//! 68 (1973) 117). In clean water that leaves next to nothing to be told, in haze the shape and not its noise. The centres
//! themselves are not pooled. The update is the exact one for a likelihood that is Gaussian around its maximum.

#![allow(clippy::needless_range_loop, reason = "indices read as in the formulas")]

use super::dense::Symmetric;
use super::{CENTRE, DEGREE, FLUX, Fit, LEVEL, LN_WIDTH, MOST, background};

/// Neighbours asked on either side.
const REACH: usize = 16;
/// Neighbours whose scatter says something.
const LEAST: usize = 6;
/// Longest step of the centre from a line to the next along one stripe: pixels plus widths.
const STEP: (f64, f64) = (3.0, 2.0);
/// The level stays free: what is shared is the shape, degrees 1 to 5.
const SHAPE: usize = LEVEL + 1;

/// A line's own view of its background's shape: coefficients and their covariance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    coefficients: [f64; DEGREE],
    covariance: [[f64; DEGREE]; DEGREE],
    /// Chi-square per degree of freedom: noise beyond the model's scatters the coefficients, too.
    excess: f64,
    centre: f64,
    width: f64,
}

/// Brings the fits of successive lines up to what each and its neighbours say of the background. `shapes` is a buffer.
pub(crate) fn share(fits: &mut [Option<Fit>], shapes: &mut Vec<Option<Shape>>) {
    shapes.clear();
    shapes.extend(fits.iter().map(|f| f.as_ref().and_then(Shape::of)));
    for (i, fit) in fits.iter_mut().enumerate() {
        let Some(fit) = fit.as_mut().filter(|_| shapes[i].is_some()) else { continue };
        if let Some(better) = prior(shapes, i).and_then(|(mean, weight)| updated(fit, &mean, &weight)) {
            *fit = better;
        }
    }
}

impl Shape {
    fn of(fit: &Fit) -> Option<Self> {
        let s = &fit.solution;
        if s.size < MOST || !fit.converged {
            return None;
        }
        let factor = s.information.factor(0.0);
        if factor.soundness().is_nan() {
            return None;
        }
        let (mut coefficients, mut covariance) = ([0.0; DEGREE], [[0.0; DEGREE]; DEGREE]);
        coefficients.copy_from_slice(&s.at[SHAPE..]);
        for (k, row) in covariance.iter_mut().enumerate() {
            row.copy_from_slice(&factor.column(SHAPE + k)[SHAPE..]);
        }
        let excess = (fit.chi2 / fit.freedom.max(1.0)).max(1.0);
        Some(Self { coefficients, covariance, excess, centre: fit.centre, width: fit.width })
    }

    fn joins(&self, next: &Self) -> bool {
        (self.centre - next.centre).abs() <= STEP.0 + STEP.1 * self.width.max(next.width)
    }
}

/// Mean of the neighbours' coefficients and the inverse of its covariance; `None` with too few on the stripe's unbroken run.
fn prior(shapes: &[Option<Shape>], i: usize) -> Option<([f64; DEGREE], Symmetric<f64, DEGREE>)> {
    let mut members: [Option<&Shape>; 2 * REACH] = [None; 2 * REACH];
    let mut count = 0;
    let mut walk = |lines: &mut dyn Iterator<Item = usize>| {
        let mut last = shapes[i].as_ref();
        for shape in lines.map_while(|j| shapes[j].as_ref()) {
            if !last.is_some_and(|l| l.joins(shape)) {
                break;
            }
            members[count] = Some(shape);
            count += 1;
            last = Some(shape);
        }
    };
    walk(&mut (i.saturating_sub(REACH)..i).rev());
    walk(&mut (i + 1..(i + 1 + REACH).min(shapes.len())));
    if count < LEAST {
        return None;
    }
    let n = count as f64;
    let members = || members[..count].iter().copied().flatten();
    let excess = members().map(|s| s.excess).sum::<f64>() / n;
    let mut mean = [0.0; DEGREE];
    for (k, m) in mean.iter_mut().enumerate() {
        *m = members().map(|s| s.coefficients[k]).sum::<f64>() / n;
    }
    let mut covariance = Symmetric([[0.0; DEGREE]; DEGREE]);
    for r in 0..DEGREE {
        for c in 0..=r {
            covariance.0[r][c] = excess * members().map(|s| s.covariance[r][c]).sum::<f64>() / (n * n);
        }
        let scatter = members().map(|s| (s.coefficients[r] - mean[r]).powi(2)).sum::<f64>() / (n - 1.0);
        // A variance of n values is known to √(2/(n − 1)) of itself: only what is beyond counts as real.
        let own = n * covariance.0[r][r] * (1.0 + (2.0 / (n - 1.0)).sqrt());
        covariance.0[r][r] += (scatter - own).max(0.0);
    }
    let factor = covariance.factor(0.0);
    if factor.soundness().is_nan() {
        return None;
    }
    let mut weight = Symmetric([[0.0; DEGREE]; DEGREE]);
    for c in 0..DEGREE {
        let column = factor.column(c);
        (c..DEGREE).for_each(|r| weight.0[r][c] = column[r]);
    }
    Some((mean, weight))
}

/// The fit with a prior on the background's shape; `None` where that leads to no stripe.
fn updated(fit: &Fit, mean: &[f64; DEGREE], weight: &Symmetric<f64, DEGREE>) -> Option<Fit> {
    let mut solution = fit.solution;
    let mut step = [0.0; MOST];
    for r in 0..DEGREE {
        for c in 0..DEGREE {
            let w = weight.0[r.max(c)][r.min(c)];
            step[SHAPE + r] += w * (mean[c] - solution.at[SHAPE + c]);
            if c <= r {
                solution.information.0[SHAPE + r][SHAPE + c] += w;
            }
        }
    }
    let factor = solution.information.factor(0.0);
    factor.solve(&mut step);
    let flux = solution.at[FLUX];
    let at = &mut solution.at;
    at.iter_mut().zip(&step).for_each(|(a, s)| *a += s);
    if !at.iter().all(|v| v.is_finite()) || at[FLUX] <= 0.5 * flux {
        return None;
    }
    let sigma = |k: usize| factor.variance(k).max(0.0).sqrt();
    Some(Fit {
        centre: at[CENTRE],
        sigma: sigma(CENTRE),
        flux: at[FLUX],
        sigma_flux: sigma(FLUX),
        width: at[LN_WIDTH].exp(),
        background: background(&at[..solution.size], solution.pivot, solution.unit),
        solution,
        ..*fit
    })
}
