//! How a stripe's centre and its light change from image to image, and along the stripe.

use super::{Image, Seen, at};
use nalgebra::{Matrix3, Vector3};
use std::ops::Range;

/// Change of ln light from one image or line to the next beyond which the surface's brightness has an edge, whose light does not mix evenly.
const EDGE_STEP: f64 = 0.5;
/// Ratio of the voltage's steps before and after up to which differences tell derivatives.
const UNEVEN: f64 = 2.0;
/// Lines to either side over which derivatives are averaged, and how many of them must have some.
pub(super) const SMOOTH: usize = 4;
const LEAST_SMOOTH: usize = 5;
/// Lines to either side that a stripe's curve is fitted to, fewest first; how many of them it takes; and sigmas of chi-square beyond which a curve over more
/// lines does not fit.
const BEND: [usize; 3] = [3, 6, 12];
const LEAST_BEND: usize = 4;
const FITS_SIGMAS: f64 = 2.0;
/// Lines to either side that the change of its light is taken from.
const LIGHT: usize = 2;

/// How centre and light change with the voltage.
#[derive(Clone, Copy, Debug)]
pub(super) struct Derivatives {
    /// u′, px/V.
    pub first: f64,
    /// u″, px/V².
    pub second: f64,
    /// F′/F, 1/V.
    pub growth: f64,
    /// How u′ changes from line to line, px/V.
    pub twist: f64,
    /// From the images on one side alone.
    pub outwards: bool,
}

/// How centre and light change from line to line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Along {
    /// Of the centre, px.
    pub slope: f64,
    /// Half of its second derivative, px.
    pub bend: f64,
    /// F′/F.
    pub growth: f64,
    /// Variance of the bend, px².
    pub bend_px2: f64,
}

impl Along {
    /// A parabola through the centres as they were seen, over as many lines about one of them as it fits to within the noise, `sigma_px`, and a straight line through
    /// the logarithms of their light, over few: where a stripe ends it changes soon. `None` where the surface soon ends to both sides.
    pub fn at(image: &Image, i: usize, reach: f32, sigma_px: f64) -> Option<Self> {
        let (seen, about) = (&image.seen, &image.seen[i]);
        let variance = sigma_px * sigma_px;
        let mut found: Option<Self> = None;
        let mut before = 0;
        for lines in BEND {
            let near = &seen[run(seen, i, lines, |a, b| is_alike(a, b, reach))];
            if near.len() < LEAST_BEND || near.len() == before {
                break;
            }
            before = near.len();
            let (curve, inverse) = parabola(near, about)?;
            let off = |s: &Seen| s.seen_px() - about.seen_px() - powers(way(s, about)).dot(&curve);
            let chi2 = near.iter().map(|s| off(s).powi(2)).sum::<f64>() / variance;
            let freedom = before as f64 - 3.0;
            if found.is_some() && chi2 > freedom + FITS_SIGMAS * (2.0 * freedom).sqrt() {
                break;
            }
            let growth = found.map_or_else(|| growth(near, about), |shorter| shorter.growth);
            found = Some(Self { slope: curve.y, bend: curve.z, growth, bend_px2: inverse.m33 * variance });
        }
        found
    }
}

/// Lines from a centre to another.
fn way(seen: &Seen, about: &Seen) -> f64 {
    seen.line as f64 - about.line as f64
}

fn powers(x: f64) -> Vector3<f64> {
    Vector3::new(1.0, x, x * x)
}

/// Coefficients of the parabola through centres about one of them, by rising powers, and the inverse of its normal equations' matrix.
fn parabola(near: &[Seen], about: &Seen) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for seen in near {
        let powers = powers(way(seen, about));
        normal += powers * powers.transpose();
        right += powers * (seen.seen_px() - about.seen_px());
    }
    let inverse = normal.try_inverse()?;
    Some((inverse * right, inverse))
}

/// F′/F by a straight line through the logarithms of light about a centre.
fn growth(near: &[Seen], about: &Seen) -> f64 {
    let [mut count, mut x, mut y, mut xx, mut xy] = [0.0; 5];
    for seen in near.iter().filter(|s| s.line.abs_diff(about.line) <= LIGHT) {
        let (way, light) = (way(seen, about), f64::from(seen.flux() / about.flux()).ln());
        (count, x, y, xx, xy) = (count + 1.0, x + way, y + light, xx + way * way, xy + way * light);
    }
    (count * xy - x * y) / (count * xx - x * x)
}

/// Whether a centre is near the one before, a line without any between them or not.
fn is_near(a: &Seen, b: &Seen, reach: f32) -> bool {
    let lines = b.line - a.line;
    lines <= 2 && (b.seen_px() - a.seen_px()).abs() as f32 <= reach * lines as f32
}

/// Whether their light is alike, too.
fn is_alike(a: &Seen, b: &Seen, reach: f32) -> bool {
    is_near(a, b, reach) && f64::from(b.flux() / a.flux()).ln().abs() <= EDGE_STEP
}

/// The centres within so many lines that are joined one by one.
fn run(seen: &[Seen], i: usize, lines: usize, joined: impl Fn(&Seen, &Seen) -> bool) -> Range<usize> {
    let (mut first, mut last) = (i, i);
    while first > 0 && i - first < lines && joined(&seen[first - 1], &seen[first]) {
        first -= 1;
    }
    while last + 1 < seen.len() && last - i < lines && joined(&seen[last], &seen[last + 1]) {
        last += 1;
    }
    first..last + 1
}

/// The derivatives at each centre of each image, averaged over neighbouring lines.
pub(super) fn derivatives(images: &[Image], reach: f32) -> Vec<Vec<Option<Derivatives>>> {
    let of_image = |(n, image): (usize, &Image)| {
        let single = single(images, n, reach);
        (0..image.seen.len()).map(|i| smooth(image, &single, i, reach)).collect()
    };
    images.iter().enumerate().map(of_image).collect()
}

/// The derivatives at each centre of an image, from the images before and after, or from two on one side where the surface ends on the other, as at
/// an object's outline; `None` where the surface or its brightness breaks off.
fn single(images: &[Image], n: usize, reach: f32) -> Vec<Option<Derivatives>> {
    let here = &images[n];
    // An image so many further on, and its voltage from here.
    let image = |by: isize| {
        let other = images.get(n.checked_add_signed(by)?)?;
        Some((other, other.voltage_v - here.voltage_v))
    };
    let [back2, back, on, on2] = [-2, -1, 1, 2].map(image);
    let one = |seen: &Seen| {
        // Its voltage, centre and ln light from here, where the surface goes on to there.
        let joined = |other: Option<(&Image, f64)>, from: &Seen| {
            let (image, voltage_v) = other?;
            let other = at(image, seen)?;
            let step = (other.position_px - from.position_px).abs() as f32;
            let even = f64::from(other.flux() / from.flux()).ln().abs() <= EDGE_STEP;
            (step <= reach && even).then_some((voltage_v, *other))
        };
        let (a, b, outwards) = match (joined(back, seen), joined(on, seen)) {
            (Some(a), Some(b)) => (a, b, false),
            (Some(a), None) => (a, joined(back2, &a.1)?, true),
            (None, Some(b)) => (b, joined(on2, &b.1)?, true),
            (None, None) => return None,
        };
        // Steps from each of the three to the next.
        let steps = if outwards { [a.0, b.0 - a.0] } else { [-a.0, b.0] }.map(f64::abs);
        if !(steps[0] > 0.0 && steps[1] > 0.0 && steps[0].max(steps[1]) <= UNEVEN * steps[0].min(steps[1])) {
            return None;
        }
        // Newton's parabola through here and both.
        let newton = |of: fn(&Seen) -> f64| {
            let [to_a, to_b] = [a, b].map(|(v, other)| (of(&other) - of(seen)) / v);
            let second = (to_b - to_a) / (b.0 - a.0);
            (to_a - second * a.0, 2.0 * second)
        };
        let (first, second) = newton(Seen::seen_px);
        let (growth, _) = newton(|s| f64::from(s.flux()).ln());
        Some(Derivatives { first, second, growth, twist: 0.0, outwards })
    };
    here.seen.iter().map(one).collect()
}

/// Mean of the derivatives over neighbouring lines that tell them alike: a single one carries its own centre's noise, which would be fed back.
fn smooth(image: &Image, derivatives: &[Option<Derivatives>], i: usize, reach: f32) -> Option<Derivatives> {
    let about = &image.seen[i];
    let own = derivatives[i]?;
    let near = run(&image.seen, i, SMOOTH, |a, b| is_near(a, b, reach));
    let (mut sum, mut count, mut ways) = ([0.0; 4], 0.0, [0.0; 2]);
    for k in near.filter(|&k| image.seen[k].line.abs_diff(about.line) <= SMOOTH) {
        if let Some(d) = derivatives[k].filter(|d| d.outwards == own.outwards) {
            let way = way(&image.seen[k], about);
            sum = [sum[0] + d.first, sum[1] + d.second, sum[2] + d.growth, sum[3] + way * d.first];
            ways = [ways[0] + way, ways[1] + way * way];
            count += 1.0;
        }
    }
    let [mean, second, growth, moment] = sum.map(|s| s / count);
    let [way, square] = ways.map(|w| w / count);
    (count >= LEAST_SMOOTH as f64).then(|| {
        let twist = (moment - way * mean) / (square - way * way);
        Derivatives { first: mean - twist * way, second, growth, twist, ..own }
    })
}
