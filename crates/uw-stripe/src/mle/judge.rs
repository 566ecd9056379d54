//! What a fit's residuals say of it.

#![allow(clippy::needless_range_loop, reason = "indices read as in the formulas")]

use super::dense::Symmetric;
use super::likelihood::{Form, Group};
use super::pixels::Pixels;
use super::solve::{Ended, group};
use super::wide::{Row, V, WIDE, exp, gather};
use super::{CENTRE, DEGREE, FLUX, Fit, LEVEL, LN_WIDTH, MOST, STRAIGHT, Weights};
use crate::noise::Residual;
use fearless_simd::{Level, Select, Simd, SimdBase, SimdFloat, dispatch};

/// Judges fits, whose windows are in `pixels`, and adds the residuals of their pixels that are not clipped to those of
/// their lines, if they are asked for.
pub(super) fn judge(
    level: Level,
    ended: [&Ended; WIDE],
    pixels: &Pixels,
    noise: Weights,
    residuals: Option<&mut [Vec<Residual>; WIDE]>,
) -> [Fit; WIDE] {
    if ended.iter().all(|e| e.way.size <= STRAIGHT) {
        dispatch!(level, simd => judge_here::<_, STRAIGHT>(simd, ended, pixels, noise, residuals))
    } else {
        dispatch!(level, simd => judge_here::<_, MOST>(simd, ended, pixels, noise, residuals))
    }
}

#[inline(always)]
fn judge_here<S: Simd, const N: usize>(
    simd: S,
    ended: [&Ended; WIDE],
    pixels: &Pixels,
    noise: Weights,
    mut residuals: Option<&mut [Vec<Residual>; WIDE]>,
) -> [Fit; WIDE] {
    let none = V::splat(simd, 0.0);
    let one = V::splat(simd, 1.0);
    let group = group(simd, ended.map(|e| &e.way), pixels, noise);
    let at: [V<S>; N] = std::array::from_fn(|k| gather(simd, |lane| ended[lane].way.at[k]));
    let sizes = gather(simd, |lane| ended[lane].way.size as f64);
    // In loops: closures may be left outside the processor's features.
    let mut information = Symmetric([[none; N]; N]);
    for r in 0..N {
        for c in 0..=r {
            let all = gather(simd, |lane| ended[lane].solution.information.0[r][c]);
            let other = if r == c { one } else { none };
            information.0[r][c] = sizes.simd_gt(r as f64).select(all, other);
        }
    }
    let factor = information.factor(0.0);
    // What the parameters took of each pixel's freedom is asked for, or clipped pixels gave them some; else the sum will do: the
    // trace of C (C⁻¹ − prior).
    let each = residuals.is_some() || pixels.clipped != 0;
    let mut form = Form::of(simd, &at);
    let mut polynomials = [none; 2 * DEGREE + 1];
    let (mut chi2, mut count, mut freedom) = (none, none, none);
    let (mut skew_score, mut skew_information, mut skew_cross) = (none, none, [none; N]);
    let mut saturated = [0; WIDE];
    for p in group.rows.clone() {
        let place = group.place(p);
        group.polynomials(place, N - 1 - LEVEL, &mut polynomials);
        let (profile, term) = group.pixel(p, place, &polynomials, &at, &mut form);
        let mut gradient = [none; N];
        for k in LEVEL..N {
            gradient[k] = sizes.simd_gt(k as f64).select(polynomials[k - LEVEL], none);
        }
        let mut by_skew = none;
        if let Some(profile) = profile {
            gradient[..LEVEL].copy_from_slice(&profile.gradient);
            by_skew = profile.by_skew;
        }
        let [full, floor] = pixels.clip[p];
        let shown = gather(simd, |lane| f64::from(!(full | floor) >> lane & 1));
        let shown = term.used.select(shown, none);
        let square = term.residual * term.residual;
        chi2 += shown * square / term.variance;
        count += shown;
        for (lane, saturated) in saturated.iter_mut().enumerate() {
            *saturated += usize::from(full >> lane & 1);
        }
        if each {
            let mut white = gradient;
            factor.whiten(&mut white);
            let leverage = white.iter().fold(none, |sum, w| sum + *w * *w) / term.variance;
            let left = one - leverage;
            let left = left.simd_gt(0.0).select(left, none);
            freedom += shown * left;
            if let Some(residuals) = residuals.as_deref_mut() {
                let [level, signal, square, variance, freedom, shown] =
                    [term.level, term.signal, square, term.variance, left, shown].map(Row::from);
                for (lane, residuals) in residuals.iter_mut().enumerate().filter(|(l, _)| shown.0[*l] > 0.0) {
                    residuals.push(Residual {
                        level: level.0[lane],
                        signal: signal.0[lane],
                        square: square.0[lane],
                        variance: variance.0[lane],
                        freedom: freedom.0[lane],
                    });
                }
            }
        }
        skew_score += by_skew * term.score;
        skew_information += by_skew * by_skew * term.information;
        for k in 0..N {
            skew_cross[k] += gradient[k] * by_skew * term.information;
        }
    }
    let mut taken = none;
    for k in LN_WIDTH..N {
        let (_, weight) = group.known(k);
        taken += sizes.simd_gt(k as f64).select(one - weight * factor.variance(k), none);
    }
    // Centre and flux, of which nothing is known beforehand, take one each.
    let rest = count - taken - LN_WIDTH as f64;
    let trace = Row::from(rest.simd_gt(0.0).select(rest, none));
    let freedom = Row::from(freedom);
    // Rao's score test for one more parameter, without fitting it.
    factor.whiten(&mut skew_cross);
    let left = skew_cross.iter().fold(skew_information, |left, w| left - *w * *w);
    let told = left.simd_gt(skew_information * 1e-9);
    let skew = Row::from(told.select(skew_score / left, none));
    let skew_snr = Row::from(told.select(skew_score / left.sqrt(), none));
    group.polynomials(at[CENTRE], N - 1 - LEVEL, &mut polynomials);
    let background = Row::from(Group::<S>::background(&at, &polynomials));
    let (chi2, width) = (Row::from(chi2), Row::from(exp(simd, at[LN_WIDTH])));
    let sigma = Row::from(factor.variance(CENTRE).sqrt());
    let sigma_flux = Row::from(factor.variance(FLUX).sqrt());
    std::array::from_fn(|lane| Fit {
        centre: ended[lane].way.at[CENTRE],
        sigma: sigma.0[lane],
        flux: ended[lane].way.at[FLUX],
        sigma_flux: sigma_flux.0[lane],
        width: width.0[lane],
        background: background.0[lane],
        chi2: chi2.0[lane],
        freedom: if residuals.is_some() || pixels.clipped >> lane & 1 == 1 { freedom } else { trace }.0[lane],
        skew: skew.0[lane],
        skew_snr: skew_snr.0[lane],
        saturated: saturated[lane],
        converged: ended[lane].way.converged,
        solution: ended[lane].solution,
    })
}
