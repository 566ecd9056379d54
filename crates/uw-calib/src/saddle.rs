//! Sub-pixel position of one chessboard corner, by a fit of the image of two crossing edges.
//!
//! Model of the image around the corner c, with d = x − c and uₖ the signed distance from the k-th edge:
//!
//! I(x) = b + g·d + (a + h·d) erf(u₁/√2s) erf(u₂/√2s),
//!
//! a saddle blurred by a Gaussian of width s under light that varies linearly. Both the model and a blurred
//! corner are symmetric about c, so that an inexact blur adds no bias. Edges are bent as the lens bends them:
//! uₖ = nₖ·d − κₖ (tₖ·d)²/2 with a curvature κₖ that the caller knows from the neighbouring corners. Unlike a
//! quadratic patch this uses the whole length of the edges, and its covariance comes from its own residuals.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

use crate::view::GreyView;

/// c (2), angles of the edges (2), blur, b, g (2), a, h (2).
const UNKNOWNS: usize = 11;
/// Pixels beyond the unknowns that a fit needs for its residuals to say anything.
const MIN_FREEDOM: usize = 16;
const MAX_STEPS: usize = 30;
/// Px; a step below it is far below any noise.
const STEP_PX: f64 = 1e-4;
/// Px; a Gaussian narrower than this is not resolved by pixels (their own box has a width of 0.29).
const MIN_BLUR_PX: f64 = 0.25;

/// What is known of a corner before the fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seed {
    /// Position, px.
    pub pixel: [f64; 2],
    /// Direction of the two edges, radians from u towards v.
    pub angles: [f64; 2],
    /// Curvature of the two edges, 1/px, positive when the edge bends to the side of its normal (−sin, cos).
    pub curvatures: [f64; 2],
    /// Pixels within this distance are used.
    pub radius: f64,
}

/// A fitted corner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Saddle {
    /// Position, px.
    pub pixel: [f64; 2],
    /// Covariance of the position from the residuals, px².
    pub covariance: Matrix2<f64>,
    /// Direction of the two edges, radians.
    pub angles: [f64; 2],
    /// Half the step of brightness between squares, in grey values, positive when the quadrant between the
    /// first and the second edge's directions is bright.
    pub amplitude: f64,
    /// Share of the window's variance that the model explains.
    pub explained: f64,
    /// Least bright quadrant less the least dark one, over the mean step: 1 for four even quadrants, 0 where
    /// three are alike (the outer corner of a dark square on a bright margin).
    pub gap: f64,
}

/// Returns the corner nearest to the seed, or `None` when there is too little image around it or the fit
/// leaves its window.
pub(crate) fn fit(view: &GreyView<'_>, seed: &Seed) -> Option<Saddle> {
    let window = window(view, seed)?;
    let mut fit = start(&window, seed);
    let mut lambda = 1e-3;
    let mut normal = Normal::at(&window, &fit, seed.curvatures);
    for _ in 0..MAX_STEPS {
        let step = normal.step(lambda)?;
        let mut next = fit + step;
        next[4] = next[4].clamp(MIN_BLUR_PX, seed.radius);
        let moved = (next.fixed_rows::<2>(0) - Vector2::from(seed.pixel)).norm();
        if !next.iter().all(|x| x.is_finite()) || moved > seed.radius {
            return None;
        }
        let at_next = Normal::at(&window, &next, seed.curvatures);
        if at_next.squares < normal.squares {
            let small = step.fixed_rows::<2>(0).norm() < STEP_PX;
            (fit, normal, lambda) = (next, at_next, (lambda * 0.2).max(1e-9));
            if small {
                break;
            }
        } else {
            if step.fixed_rows::<2>(0).norm() < STEP_PX {
                break;
            }
            lambda *= 8.0;
        }
    }

    let freedom = window.pixels.len().checked_sub(UNKNOWNS).filter(|&n| n >= MIN_FREEDOM)? as f64;
    let variance = (normal.squares / freedom).max(ROUNDING_VARIANCE);
    let covariance = normal.matrix.cholesky()?.inverse().fixed_view::<2, 2>(0, 0) * variance;
    let gap = gap(&window, &fit)?;
    Some(Saddle {
        gap,
        pixel: [fit[0], fit[1]],
        covariance,
        angles: [fit[2], fit[3]],
        amplitude: -fit[8],
        explained: 1.0 - normal.squares / window.squares,
    })
}

/// Grey values²: a value rounded to an integer is uncertain by that much even where the residuals don't show
/// it.
const ROUNDING_VARIANCE: f64 = 1.0 / 12.0;

struct Window {
    pixels: Vec<[f64; 3]>,
    saturation: f64,
    mean: f64,
    /// Sum of squares about the mean.
    squares: f64,
}

fn window(view: &GreyView<'_>, seed: &Seed) -> Option<Window> {
    let [u, v] = seed.pixel;
    let r = seed.radius;
    let inside = |x: f64, size: usize| x - r >= -0.5 && x + r <= size as f64 - 0.5;
    if !(inside(u, view.width()) && inside(v, view.height())) {
        return None;
    }
    let span = |x: f64| (x - r).ceil().max(0.0) as usize..=(x + r).floor() as usize;
    let mut pixels = Vec::new();
    for row in span(v) {
        for col in span(u) {
            if (col as f64 - u).hypot(row as f64 - v) <= r {
                pixels.push([col as f64, row as f64, f64::from(view.get(col, row)?)]);
            }
        }
    }
    let n = pixels.len() as f64;
    let mean = pixels.iter().map(|p| p[2]).sum::<f64>() / n;
    let squares = pixels.iter().map(|p| (p[2] - mean).powi(2)).sum();
    (squares > 0.0).then_some(Window { pixels, saturation: f64::from(view.saturation()), mean, squares })
}

/// See [`Saddle::gap`]; `None` when a quadrant holds no pixel.
fn gap(window: &Window, fit: &Unknowns) -> Option<f64> {
    let normals = [fit[2], fit[3]].map(|angle| Vector2::new(-angle.sin(), angle.cos()));
    let mut sums = [[0.0; 2]; 4];
    for p in &window.pixels {
        let d = Vector2::new(p[0] - fit[0], p[1] - fit[1]);
        let quadrant = usize::from(normals[0].dot(&d) > 0.0) + 2 * usize::from(normals[1].dot(&d) > 0.0);
        sums[quadrant][0] += p[2];
        sums[quadrant][1] += 1.0;
    }
    // 0 and 3 lie opposite each other, and so do 1 and 2.
    let [a, b, c, d] = sums.map(|[sum, count]| sum / count);
    let step = (a + d - b - c) / 2.0;
    let gap = if step > 0.0 { a.min(d) - b.max(c) } else { b.min(c) - a.max(d) };
    Some(gap / step.abs()).filter(|gap| gap.is_finite())
}

type Unknowns = SVector<f64, UNKNOWNS>;

fn start(window: &Window, seed: &Seed) -> Unknowns {
    let mut fit = Unknowns::zeros();
    fit[0] = seed.pixel[0];
    fit[1] = seed.pixel[1];
    fit[2] = seed.angles[0];
    fit[3] = seed.angles[1];
    fit[4] = 1.0;
    fit[5] = window.mean;
    let deviation = (window.squares / window.pixels.len() as f64).sqrt();
    let pattern: f64 = window
        .pixels
        .iter()
        .map(|p| {
            let d = Vector2::new(p[0], p[1]) - Vector2::from(seed.pixel);
            let side = |angle: f64| d.y * angle.cos() - d.x * angle.sin();
            (side(seed.angles[0]) * side(seed.angles[1])).signum() * (p[2] - window.mean)
        })
        .sum();
    fit[8] = deviation.copysign(pattern);
    fit
}

/// Gauss–Newton sums at one state.
struct Normal {
    matrix: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    gradient: Unknowns,
    squares: f64,
}

impl Normal {
    fn at(window: &Window, fit: &Unknowns, curvatures: [f64; 2]) -> Self {
        let mut sums = Self { matrix: SMatrix::zeros(), gradient: Unknowns::zeros(), squares: 0.0 };
        let edges = [0, 1].map(|k| {
            let (sin, cos) = fit[2 + k].sin_cos();
            (Vector2::new(-sin, cos), Vector2::new(cos, sin), curvatures[k])
        });
        let blur = fit[4];
        let gradient = Vector2::new(fit[6], fit[7]);
        let (amplitude, slope) = (fit[8], Vector2::new(fit[9], fit[10]));
        for p in &window.pixels {
            let d = Vector2::new(p[0] - fit[0], p[1] - fit[1]);
            // Of each edge: its step from −1 to 1, and the step's derivatives by c, angle and blur.
            let [first, second] = edges.map(|(n, t, curvature)| {
                let (across, along) = (n.dot(&d), t.dot(&d));
                let u = across - 0.5 * curvature * along * along;
                let (step, density) = erf_gauss(u / blur);
                let by_u = density / blur;
                let by_centre = (n - t * (curvature * along)) * -by_u;
                let by_angle = -(along + curvature * along * across) * by_u;
                (step, by_centre, by_angle, -by_u * u / blur)
            });
            let product = first.0 * second.0;
            let contrast = amplitude + slope.dot(&d);
            let model = fit[5] + gradient.dot(&d) + contrast * product;
            let residual = model - p[2];
            // A saturated pixel only says that the light was at least so strong.
            if p[2] >= window.saturation && residual > 0.0 {
                continue;
            }
            let by_centre = (first.1 * second.0 + second.1 * first.0) * contrast - gradient - slope * product;
            let row = Unknowns::from([
                by_centre.x,
                by_centre.y,
                contrast * first.2 * second.0,
                contrast * second.2 * first.0,
                contrast * (first.3 * second.0 + second.3 * first.0),
                1.0,
                d.x,
                d.y,
                product,
                d.x * product,
                d.y * product,
            ]);
            sums.matrix.syger(1.0, &row, &row, 1.0);
            sums.gradient += row * residual;
            sums.squares += residual * residual;
        }
        sums.matrix.fill_upper_triangle_with_lower_triangle();
        sums
    }

    fn step(&self, lambda: f64) -> Option<Unknowns> {
        let mut damped = self.matrix;
        for i in 0..UNKNOWNS {
            damped[(i, i)] *= 1.0 + lambda;
        }
        Some(-damped.cholesky()?.solve(&self.gradient))
    }
}

/// Returns erf(x/√2) and its derivative √(2/π) exp(−x²/2). Abramowitz and Stegun 7.1.26, error below 1.5e-7,
/// which shares its exponential with the derivative.
fn erf_gauss(x: f64) -> (f64, f64) {
    let gauss = (-0.5 * x * x).exp();
    let z = x.abs() * std::f64::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let series = ((((1.061_405_429 * t - 1.453_152_027) * t + 1.421_413_741) * t - 0.284_496_736) * t
        + 0.254_829_592)
        * t;
    ((1.0 - series * gauss).copysign(x), (2.0 / std::f64::consts::PI).sqrt() * gauss)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::{Layout, Samples};

    #[test]
    fn the_error_function_has_its_tabulated_values_and_slope() {
        // Abramowitz and Stegun, table 7.1: erf(0.5), erf(1), erf(2).
        for (z, erf) in [(0.5, 0.520_499_877_8), (1.0, 0.842_700_792_9), (2.0, 0.995_322_265_0)] {
            let x = z * std::f64::consts::SQRT_2;
            assert!((erf_gauss(x).0 - erf).abs() < 2e-7 && (erf_gauss(-x).0 + erf).abs() < 2e-7);
            // The series is good to 1.5e-7, so its difference over 0.02 is to 1.5e-5.
            let slope = (erf_gauss(x + 0.01).0 - erf_gauss(x - 0.01).0) / 0.02;
            assert!((erf_gauss(x).1 - slope).abs() < 5e-5);
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let data: Vec<u16> = (0..400_u16).map(|k| 1000 + (k * 37) % 501).collect();
        let layout = Layout { width: 20, height: 20, stride: 20 };
        let view = GreyView::new(Samples::U16(&data), layout, u16::MAX).unwrap();
        let curvatures = [0.02, -0.03];
        let seed = Seed { pixel: [9.3, 9.8], angles: [0.2, 1.9], curvatures, radius: 8.0 };
        let window = window(&view, &seed).unwrap();
        let at = Unknowns::from([9.4, 9.7, 0.25, 1.85, 1.3, 1200.0, 3.0, -2.0, 400.0, 5.0, 7.0]);
        let normal = Normal::at(&window, &at, curvatures);
        for i in 0..UNKNOWNS {
            let h = 1e-5 * at[i].abs().max(1.0);
            let moved = |by: f64| {
                let mut x = at;
                x[i] += by;
                Normal::at(&window, &x, curvatures).squares
            };
            let slope = (moved(h) - moved(-h)) / (4.0 * h);
            let scale = normal.squares.sqrt() * normal.matrix[(i, i)].sqrt();
            assert!((normal.gradient[i] - slope).abs() < 1e-4 * scale, "{i}: {} {slope}", normal.gradient[i]);
        }
    }
}
