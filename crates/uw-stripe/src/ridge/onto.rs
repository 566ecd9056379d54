//! The ridge put in place of what the filters found, with what they know of it: a skirt of haze, edges of brightness, speckle.

use super::{Ridge, RidgePoint};
use crate::Pixel;
use crate::View;
use crate::profile::{Flags, Reject, Stripe};

/// Lines to either side over which the ridge is compared with the filters' centres: haze is smooth along the stripe.
const REACH: usize = 16;
/// Lines that a comparison needs.
const LEAST: u32 = 8;
/// Sigmas below which a difference is left alone; above, it is shrunk towards them (James and Stein).
const SIGNIFICANT: f64 = 2.5;
/// Lines, in widths, that share an edge of brightness through the kernel.
const SHARED_WIDTHS: f32 = 1.5;

/// Reused memory.
#[derive(Debug, Default)]
pub(super) struct Onto {
    candidates: Vec<Option<f32>>,
    points: Vec<Option<RidgePoint>>,
    sigma: Vec<f32>,
    differences: Vec<Difference>,
}

/// The ridge's difference from the filters' centre on a line, px, by its weight, and the weight, 1/px²; nothing where there are not both.
#[derive(Debug, Default, Clone, Copy)]
struct Difference {
    weighted: f64,
    weight: f64,
    lines: u32,
}

impl Ridge {
    /// Replaces what the filters found by where the ridge next to it crosses each line; where there is nothing to pool, at the image's first
    /// and last lines, it stands.
    ///
    /// A background that slopes, as haze puts under a stripe, shifts the ridge, whose kernel knows none; the filters take it out. The mean
    /// difference of the two over neighbouring lines is taken back where it is more than chance.
    pub fn replace<P: Pixel>(&mut self, image: &View<'_, P>, stripe: &mut Stripe) {
        let Onto { mut candidates, mut points, mut sigma, mut differences } = std::mem::take(&mut self.onto);
        candidates.clear();
        candidates.extend(stripe.position_px.iter().map(|p| (!p.is_nan()).then_some(*p)));
        self.follow(image, stripe.axis, &candidates, &stripe.noise, &mut points);
        sigma.clear();
        sigma.extend_from_slice(&stripe.sigma_px);
        differences.clear();
        differences.extend((0..points.len()).map(|i| difference(&points[i], candidates[i], sigma[i])));
        for line in (0..points.len()).filter(|i| candidates[*i].is_some()) {
            let Some(point) = &points[line] else {
                if self.pools_at(line, points.len()) {
                    stripe.drop_line(line, Reject::NotConverged);
                }
                continue;
            };
            let near = line.saturating_sub(REACH)..(line + REACH + 1).min(points.len());
            let (shift, unsure) = offset(&differences[near.clone()]);
            // NaN is not less.
            let least = f64::from(sigma[near].iter().copied().fold(f32::INFINITY, f32::min));
            let shared = (SHARED_WIDTHS * stripe.width_px[line].max(0.0)).ceil() as usize;
            let edges = line.saturating_sub(shared)..(line + shared + 1).min(points.len());
            let edge = edges
                .filter(|i| stripe.flags[*i].contains(Flags::EDGE) && !sigma[*i].is_nan())
                .map(|i| (f64::from(sigma[i]).powi(2) - least * least).max(0.0).sqrt())
                .fold(0.0, f64::max);
            let speckle = f64::from(stripe.scatter_widths * stripe.width_px[line].max(0.0));
            stripe.position_px[line] = (point.position - shift) as f32;
            stripe.sigma_px[line] = point.sigma.hypot(unsure).hypot(edge).hypot(speckle) as f32;
            stripe.amplitude[line] = point.amplitude as f32;
            stripe.background[line] = point.background as f32;
        }
        self.onto = Onto { candidates, points, sigma, differences };
    }
}

fn difference(point: &Option<RidgePoint>, candidate: Option<f32>, sigma: f32) -> Difference {
    let (Some(point), Some(centre), true) = (point, candidate, sigma > 0.0) else {
        return Difference::default();
    };
    let weight = f64::from(sigma).powi(-2);
    Difference { weighted: weight * (point.position - f64::from(centre)), weight, lines: 1 }
}

/// Mean difference of the ridge from the filters' centres over some lines, as far as it is more than chance, and what that leaves unsure, px.
fn offset(lines: &[Difference]) -> (f64, f64) {
    let (mut sum, mut weights, mut count) = (0.0, 0.0, 0);
    for line in lines {
        sum += line.weighted;
        weights += line.weight;
        count += line.lines;
    }
    if count < LEAST {
        return (0.0, 0.0);
    }
    let (mean, chance) = (sum / weights, weights.sqrt().recip());
    let share = (1.0 - (SIGNIFICANT * chance / mean).powi(2)).max(0.0);
    if share.is_nan() || share <= 0.0 {
        return (0.0, 0.0);
    }
    (share * mean, (share * chance).hypot((1.0 - share) * mean))
}
