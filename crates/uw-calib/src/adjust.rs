//! From observations to a calibration: start, robust solve, what to leave out, scales of the sigmas, final solve.

use crate::calibration::{Calibration, Method, Rejected, Statistics, WorstImage};
use crate::data::{BoardView, Observations, Outside, Rig};
use crate::diagnostics;
use crate::error::CalibError;
use crate::joint::{
    CornerResidual, Extent, Joint, Scales, Solved, State, StripeResidual, Used, corner_residuals, solve,
    stripe_residuals,
};
use crate::lm::{Loss, Model};
use crate::residuals::{ViewResiduals, remains};
use crate::sight::Pose;
use crate::start;
use nalgebra::{DMatrix, Vector2};
use std::borrow::Cow;

/// Threshold of the robust loss of the first solves, sigmas.
const HUBER_SIGMAS: f64 = 2.0;
/// Residuals beyond this many sigmas are outliers: one measurement in 10⁵ by chance.
const OUTLIER_SIGMAS: f64 = 4.5;
/// A stripe image of which less than this share survives is left out whole.
const MIN_SHARE: f64 = 0.3;
/// A stripe image with fewer measurements than this is left out whole.
const MIN_STRIPE_POINTS: usize = 10;
/// Stripe measurements within this many stripe sigmas of an edge between squares, plus [`EDGE_BLUR_PX`], are left out: a
/// step of brightness under the stripe's flank moves its centre.
const EDGE_WIDTHS: f64 = 2.5;
/// Blur of an edge, px.
const EDGE_BLUR_PX: f64 = 1.0;
/// Neighbouring stripe measurements whose errors are pooled: what they share (surface texture, an edge near by) is not white,
/// and doesn't average out as white noise would.
const BLOCK: usize = 16;
/// Fewer blocks than this say nothing about their scatter.
const LEAST_BLOCKS: usize = 30;
/// Rounds of solving and sorting out; the sets of outliers settle in two.
const ROUNDS: usize = 3;

/// A joint adjustment as the solver is given it.
#[derive(Clone, Debug)]
pub struct Adjustment<M: Model> {
    /// Residuals and derivatives; the globals are those of [`crate::NAMES`], the poses those of the board.
    pub model: M,
    /// Where the solver begins.
    pub start: M::State,
}

/// The first of the solves of the whole instrument that [`calibrate`] makes: for those who want to solve it by other means.
///
/// # Errors
/// As [`calibrate`].
pub fn adjustment<'a>(
    observations: &'a Observations,
    rig: &'a Rig,
) -> Result<Adjustment<impl Model + 'a>, CalibError> {
    let (start, used, scales) = begin(observations, rig, &never)?;
    let (used, loss) = (Cow::Owned(used), Loss::Huber(HUBER_SIGMAS));
    let model = Joint { rig, observations, used, scales, loss, extent: Extent::Whole, stop: &never };
    Ok(Adjustment { model, start })
}

/// Camera and boards from the corners, the rest as the rig says; which measurements take part at first, and their scales.
fn begin(
    observations: &Observations,
    rig: &Rig,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(State, Used, Scales), CalibError> {
    let mut state = start::start(observations, rig)?;
    diagnostics::refuse(&state)?;

    let mut used = Used::all(&observations.views);
    // Corners alone place camera and boards before stripes are judged by them.
    let scales = Scales { corner: 1.0, stripe: 1.0, stripe_pooled: 1.0 };
    let (all, loss) = (Cow::Borrowed(&used), Loss::Huber(HUBER_SIGMAS));
    let corners_only = Joint { rig, observations, used: all, scales, loss, extent: Extent::CameraSide, stop };
    state = solve(&corners_only, state)?.state;
    // Once more: an uncalibrated lens makes parallel boards look tilted.
    diagnostics::refuse(&state)?;
    mask_edges(observations, &state, &mut used);
    thin_out_invisible(observations, &state, &mut used);
    let scales = estimate(observations, &state, &used);
    Ok((state, used, scales))
}

/// The joint calibration of all observations.
///
/// # Errors
/// [`CalibError`] with what to capture, for sets that determine no calibration.
pub fn calibrate(observations: &Observations, rig: &Rig) -> Result<Calibration, CalibError> {
    calibrate_until(observations, rig, &never)
}

fn never() -> bool {
    false
}

/// As [`calibrate`], given up as soon as `stop` says so: it is asked before every iteration, from the calling thread.
///
/// # Errors
/// As [`calibrate`]; [`crate::lm::LmError::Stopped`] where it was given up.
pub fn calibrate_until(
    observations: &Observations,
    rig: &Rig,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Calibration, CalibError> {
    Ok(calibrate_in_full(observations, rig, stop)?.0)
}

/// As [`calibrate_until`], and what remained of each measurement.
///
/// # Errors
/// As [`calibrate_until`].
pub fn calibrate_in_full(
    observations: &Observations,
    rig: &Rig,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(Calibration, Vec<ViewResiduals>), CalibError> {
    let (mut state, mut used, mut scales) = begin(observations, rig, stop)?;
    let mut rejected = Vec::new();
    let mut solved = None;
    for round in 0..ROUNDS {
        let last = round + 1 == ROUNDS;
        if round > 0 {
            rejected = sort_out(observations, &state, scales, &mut used);
            scales = estimate(observations, &state, &used);
        }
        let loss = if last { Loss::Squared } else { Loss::Huber(HUBER_SIGMAS) };
        let kept = Cow::Borrowed(&used);
        let problem = Joint { rig, observations, used: kept, scales, loss, extent: Extent::Whole, stop };
        let result = solve(&problem, state)?;
        state = result.state.clone();
        solved = Some(result);
    }
    let Some(Solved { state, covariance, report }) = solved else {
        return Err(CalibError::TooFewPoses { needed: 1, got: 0 });
    };
    let mut statistics = statistics(observations, &state, &used);
    if !report.converged() {
        let worst_file = statistics.worst.first().map_or_else(String::new, |w| w.file.clone());
        return Err(CalibError::NotConverged { iterations: report.iterations, worst_file });
    }
    statistics.rejected = rejected;
    statistics.correlated = diagnostics::most_correlated(&covariance);
    statistics.corner_scale = scales.corner;
    statistics.stripe_scale = scales.stripe_pooled;
    statistics.iterations = report.iterations;
    let nominal = observations.views.iter().find_map(|v| match v.outside {
        Outside::Water { laser_index, .. } => Some(laser_index),
        Outside::Air => None,
    });
    let mut calibration = Calibration {
        method: Method::Joint,
        instrument: state.instrument,
        covariance: Some(DMatrix::from_column_slice(
            covariance.globals.nrows(),
            covariance.globals.ncols(),
            covariance.globals.as_slice(),
        )),
        nominal_water_index: nominal,
        across: observations.across,
        image_size: rig.image_size,
        statistics,
        warnings: Vec::new(),
    };
    calibration.warnings = diagnostics::warnings(observations, rig, &calibration, &state);
    let remains = remains(observations, &state, &used, scales);
    Ok((calibration, remains))
}

/// Residuals of every stripe measurement, the shape of the observations.
type StripeResiduals = Vec<Vec<Vec<Option<StripeResidual>>>>;

fn all_stripes(observations: &Observations, state: &State) -> StripeResiduals {
    use rayon::prelude::*;
    let views: Vec<(usize, &BoardView)> = observations.views.iter().enumerate().collect();
    views
        .par_iter()
        .map(|&(i, view)| {
            view.stripes.iter().map(|s| stripe_residuals(state, i, view, s, observations.across)).collect()
        })
        .collect()
}

fn all_corners(observations: &Observations, state: &State) -> Vec<Vec<Option<CornerResidual>>> {
    observations.views.iter().enumerate().map(|(i, view)| corner_residuals(state, i, view)).collect()
}

/// Scales by which corners and stripes scatter more than predicted: from medians, so that outliers don't count.
fn estimate(observations: &Observations, state: &State, used: &Used) -> Scales {
    let mut corners: Vec<f64> = std::iter::zip(all_corners(observations, state), &used.corners)
        .flat_map(|(rows, used)| {
            std::iter::zip(rows, used)
                .filter_map(|(r, used)| r.filter(|_| *used).map(|r| r.whitened.norm_squared()))
                .collect::<Vec<_>>()
        })
        .collect();
    let (mut single, mut pooled) = (Vec::new(), Vec::new());
    for ((view, rows), used) in
        std::iter::zip(std::iter::zip(&observations.views, all_stripes(observations, state)), &used.stripes)
    {
        for ((stripe, rows), used) in std::iter::zip(std::iter::zip(&view.stripes, rows), used) {
            let kept: Vec<f64> = std::iter::zip(std::iter::zip(&stripe.points, rows), used)
                .filter_map(|((point, row), used)| row.filter(|_| *used).map(|r| r.px / point.sigma_px))
                .collect();
            single.extend(kept.iter().map(|r| r * r));
            let sums = kept.chunks_exact(BLOCK).map(|block| block.iter().sum::<f64>());
            pooled.extend(sums.map(|sum| sum * sum / BLOCK as f64));
        }
    }
    // Medians of chi² with two degrees of freedom and with one.
    let stripe = median_scale(&mut single, 0.454_936);
    let pooled = if pooled.len() < LEAST_BLOCKS { stripe } else { median_scale(&mut pooled, 0.454_936) };
    Scales { corner: median_scale(&mut corners, 1.386_294), stripe, stripe_pooled: pooled.max(stripe) }
}

fn median_scale(squares: &mut [f64], expected: f64) -> f64 {
    if squares.is_empty() {
        return 1.0;
    }
    let middle = squares.len() / 2;
    let (_, median, _) = squares.select_nth_unstable_by(middle, f64::total_cmp);
    let scale = (*median / expected).sqrt();
    if scale > 0.0 && scale.is_finite() { scale } else { 1.0 }
}

/// Leaves out stripe measurements that the model can't place, so that the solver's domain is whole.
fn thin_out_invisible(observations: &Observations, state: &State, used: &mut Used) {
    for (rows, used) in std::iter::zip(all_stripes(observations, state), &mut used.stripes) {
        for (rows, used) in std::iter::zip(rows, used) {
            for (row, used) in std::iter::zip(rows, used) {
                *used &= row.is_some();
            }
        }
    }
}

/// Leaves out stripe measurements close to an edge between squares, or off the board.
fn mask_edges(observations: &Observations, state: &State, used: &mut Used) {
    for (i, view) in observations.views.iter().enumerate() {
        let pose = Pose::<f64>::constant(&state.poses[i]);
        let board_from_camera = state.poses[i].inverse();
        let medium = state.instrument.laser_medium(view.outside);
        let extent = |k: usize| {
            let along = || view.corners.iter().map(move |c| c.board_mm[k]);
            let (low, high) =
                (along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max));
            (low - view.square_mm, high + view.square_mm)
        };
        let extents = [extent(0), extent(1)];
        let on_board = |pixel: &Vector2<f64>| {
            let at = state.instrument.on_board(pixel, &pose, medium).ok()?;
            Some(board_from_camera.transform_point(&at))
        };
        let clear = |point: &crate::data::StripePoint| {
            let mut next = point.pixel;
            next[observations.across.index()] += 1.0;
            let (Some(at), Some(beside)) = (on_board(&point.pixel), on_board(&next)) else { return false };
            (0..2).all(|k| {
                let (low, high) = extents[k];
                let to_line = at[k] - (at[k] / view.square_mm).round() * view.square_mm;
                let per_px = (beside[k] - at[k]).abs();
                let reach = (EDGE_WIDTHS * point.width_px + EDGE_BLUR_PX) * per_px;
                (low + reach..=high - reach).contains(&at[k]) && to_line.abs() >= reach
            })
        };
        for (stripe, used) in std::iter::zip(&view.stripes, &mut used.stripes[i]) {
            for (point, used) in std::iter::zip(&stripe.points, used) {
                *used = clear(point);
            }
        }
    }
}

/// Decides anew which measurements take part, by edges and by residuals; returns the images left out whole.
fn sort_out(observations: &Observations, state: &State, scales: Scales, used: &mut Used) -> Vec<Rejected> {
    let mut rejected = Vec::new();
    mask_edges(observations, state, used);
    for (rows, used) in std::iter::zip(all_corners(observations, state), &mut used.corners) {
        for (row, used) in std::iter::zip(rows, used) {
            *used = row.is_some_and(|r| r.whitened.norm() <= OUTLIER_SIGMAS * scales.corner);
        }
    }
    let residuals = all_stripes(observations, state);
    for ((view, rows), used) in
        std::iter::zip(std::iter::zip(&observations.views, residuals), &mut used.stripes)
    {
        for ((stripe, rows), used) in std::iter::zip(std::iter::zip(&view.stripes, rows), used) {
            let candidates = used.iter().filter(|u| **u).count();
            for ((point, row), used) in std::iter::zip(std::iter::zip(&stripe.points, rows), used.iter_mut())
            {
                let limit = OUTLIER_SIGMAS * point.sigma_px * scales.stripe;
                *used &= row.is_some_and(|r| r.px.abs() <= limit);
            }
            let kept = used.iter().filter(|u| **u).count();
            let reason = if stripe.points.is_empty() {
                "no stripe found".to_owned()
            } else if candidates < MIN_STRIPE_POINTS {
                format!(
                    "only {candidates} of {} measurements lie on the board clear of edges",
                    stripe.points.len()
                )
            } else if (kept as f64) < MIN_SHARE * candidates as f64 {
                format!("only {kept} of {candidates} measurements on the board agree with the other images")
            } else {
                continue;
            };
            used.fill(false);
            rejected.push(Rejected { file: stripe.file.clone(), reason });
        }
    }
    rejected
}

fn statistics(observations: &Observations, state: &State, used: &Used) -> Statistics {
    let mut s = Statistics { poses_used: observations.views.len(), ..Statistics::default() };
    let (mut corner_sum, mut stripe_px, mut stripe_mm) = (0.0, 0.0, 0.0);
    let mut images = Vec::new();
    let corners = all_corners(observations, state);
    let stripes = all_stripes(observations, state);
    for (i, view) in observations.views.iter().enumerate() {
        let px: Vec<f64> = std::iter::zip(&corners[i], &used.corners[i])
            .filter_map(|(r, used)| r.filter(|_| *used).map(|r| r.px.norm()))
            .collect();
        corner_sum += px.iter().map(|r| r * r).sum::<f64>();
        s.corners += px.len();
        s.corners_rejected += used.corners[i].len() - px.len();
        images.push((view.file.clone(), px));
        for (k, stripe) in view.stripes.iter().enumerate() {
            let kept: Vec<StripeResidual> = std::iter::zip(&stripes[i][k], &used.stripes[i][k])
                .filter_map(|(r, used)| r.filter(|_| *used))
                .collect();
            stripe_px += kept.iter().map(|r| r.px * r.px).sum::<f64>();
            stripe_mm += kept.iter().map(|r| r.mm * r.mm).sum::<f64>();
            s.stripe_points += kept.len();
            s.stripe_points_rejected += stripe.points.len() - kept.len();
            images.push((stripe.file.clone(), kept.iter().map(|r| r.px.abs()).collect()));
        }
    }
    let rms = |sum: f64, n: usize| if n > 0 { (sum / n as f64).sqrt() } else { 0.0 };
    s.reprojection_rms_px = rms(corner_sum, s.corners);
    s.stripe_rms_px = rms(stripe_px, s.stripe_points);
    s.stripe_rms_mm = rms(stripe_mm, s.stripe_points);
    images.retain(|(_, px)| !px.is_empty());
    s.frames_used = images.len();
    s.worst = images
        .into_iter()
        .map(|(file, px)| WorstImage {
            file,
            rms_px: rms(px.iter().map(|r| r * r).sum(), px.len()),
            max_px: px.iter().copied().fold(0.0, f64::max),
        })
        .collect();
    s.worst.sort_by(|a, b| b.rms_px.total_cmp(&a.rms_px));
    s.worst.truncate(5);
    s
}
