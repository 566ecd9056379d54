//! The joint adjustment: camera, windows, galvanometer, fan, indices and all board poses at once (PAPER §4).
//!
//! Residuals: corners in pixels, whitened by their covariance; stripes in pixels along the measured coordinate, from the
//! measurement to where the model puts the stripe in that row, whitened by their sigma; priors in sigmas. Corners' and
//! stripes' sigmas carry one common scale each, estimated from the residuals (variance components).

use crate::data::{Across, BoardView, Observations, Rig, StripeView};
use crate::lm::{self, Covariance, LmError, Loss, Model, Normal, Options, Report, Row, Shape, Step};
use crate::parameters::{CAMERA_SIDE, GLOBALS, Instrument};
use crate::priors;
use crate::sight::{Crossing, Pose, StripeOnBoard, moved_pose};
use nalgebra::{Matrix2, Vector2};
use std::borrow::Cow;
use uw_geom::frame::{Board, Camera};
use uw_geom::{Dual, Real, Rigid};

/// Variables of a corner's residual: the camera's side and its pose.
const OF_CORNER: usize = CAMERA_SIDE + 6;
/// Variables of a stripe's residual: all of the instrument and its pose.
const OF_STRIPE: usize = GLOBALS + 6;

/// The unknowns: instrument and poses (`camera_from_board`).
#[derive(Clone, Debug)]
pub(crate) struct State {
    pub(crate) instrument: Instrument,
    pub(crate) poses: Vec<Rigid<Camera, Board>>,
}

/// Which measurements take part: the same shape as the observations.
#[derive(Clone, Debug)]
pub(crate) struct Used {
    pub(crate) corners: Vec<Vec<bool>>,
    pub(crate) stripes: Vec<Vec<Vec<bool>>>,
}

impl Used {
    pub(crate) fn all(views: &[BoardView]) -> Self {
        Self {
            corners: views.iter().map(|v| vec![true; v.corners.len()]).collect(),
            stripes: views
                .iter()
                .map(|v| v.stripes.iter().map(|s| vec![true; s.points.len()]).collect())
                .collect(),
        }
    }
}

/// The common scales of the predicted sigmas.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scales {
    pub(crate) corner: f64,
    /// Of single stripe measurements: by it outliers are told.
    pub(crate) stripe: f64,
    /// Of neighbouring stripe measurements pooled, not below the single ones': by it they are weighted.
    pub(crate) stripe_pooled: f64,
}

/// The adjustment as the solver sees it.
pub(crate) struct Joint<'a> {
    pub(crate) rig: &'a Rig,
    pub(crate) observations: &'a Observations,
    pub(crate) used: Cow<'a, Used>,
    pub(crate) scales: Scales,
    pub(crate) loss: Loss,
    pub(crate) extent: Extent,
    /// Whether to give up.
    pub(crate) stop: &'a (dyn Fn() -> bool + Sync),
}

/// How much of the instrument is adjusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Extent {
    /// Camera, its window and poses, from the corners alone.
    CameraSide,
    /// Everything.
    Whole,
}

/// One piece of the sums, small enough to share out over threads.
enum Piece {
    Corners(usize),
    Stripe(usize, usize),
    Priors,
}

impl Joint<'_> {
    fn globals(&self) -> usize {
        match self.extent {
            Extent::CameraSide => CAMERA_SIDE,
            Extent::Whole => GLOBALS,
        }
    }

    fn dispersion_sigma(&self) -> f64 {
        priors::dispersion_sigma(&self.observations.views)
    }

    fn pieces(&self) -> Vec<Piece> {
        let views = self.observations.views.iter().enumerate();
        views
            .flat_map(|(i, view)| {
                let stripes = if self.extent == Extent::Whole { view.stripes.len() } else { 0 };
                std::iter::once(Piece::Corners(i)).chain((0..stripes).map(move |k| Piece::Stripe(i, k)))
            })
            .chain([Piece::Priors])
            .collect()
    }

    fn used_points(&self, view: usize, stripe: usize) -> impl Iterator<Item = &crate::data::StripePoint> {
        let points = &self.observations.views[view].stripes[stripe].points;
        std::iter::zip(points, &self.used.stripes[view][stripe]).filter_map(|(p, used)| used.then_some(p))
    }
}

/// W with WᵀW = C⁻¹, which turns a residual of covariance C into two of variance 1.
fn whitening(covariance: &Matrix2<f64>) -> Option<Matrix2<f64>> {
    covariance.cholesky().and_then(|c| c.l().try_inverse())
}

impl Model for Joint<'_> {
    type State = State;

    fn shape(&self) -> Shape {
        Shape { globals: self.globals(), poses: self.observations.views.len() }
    }

    fn linearize(&self, state: &State) -> Option<Normal> {
        let camera_side = state.instrument.variables::<OF_CORNER, CAMERA_SIDE>();
        let everything = state.instrument.variables::<OF_STRIPE, GLOBALS>();
        let views = &self.observations.views;
        Normal::accumulate(self.shape(), &self.pieces(), |piece, normal| match *piece {
            Piece::Corners(i) => {
                let pose = Pose::variables(&state.poses[i]);
                let medium = camera_side.board_medium(views[i].outside);
                for (corner, used) in std::iter::zip(&views[i].corners, &self.used.corners[i]) {
                    if !used {
                        continue;
                    }
                    let seen = camera_side.scanner.project(&pose.point(&corner.board_mm), medium).ok()?;
                    let whiten = whitening(&corner.covariance)? / self.scales.corner;
                    let mut gradients = [[0.0; GLOBALS]; 2];
                    let mut rows = [(0.0, [0.0; 6]); 2];
                    for (k, gradient) in gradients.iter_mut().enumerate() {
                        let (a, b) = (whiten[(k, 0)], whiten[(k, 1)]);
                        let by = |j: usize| a * seen.x.eps[j] + b * seen.y.eps[j];
                        gradient[..CAMERA_SIDE].iter_mut().enumerate().for_each(|(j, g)| *g = by(j));
                        let off = Vector2::new(seen.x.re, seen.y.re) - corner.pixel;
                        rows[k] = (a * off.x + b * off.y, std::array::from_fn(|j| by(CAMERA_SIDE + j)));
                    }
                    let row = |k: usize| Row {
                        residual: rows[k].0,
                        d_globals: &gradients[k][..self.globals()],
                        d_pose: rows[k].1,
                    };
                    normal.add(&[row(0), row(1)], Some(i), self.loss);
                }
                Some(())
            }
            Piece::Stripe(i, k) => {
                let stripe = &views[i].stripes[k];
                let search = searcher(state, i, &views[i], stripe, self.observations.across);
                let pose = Pose::variables(&state.poses[i]);
                let seen = StripeOnBoard::new(
                    everything,
                    pose,
                    views[i].outside,
                    stripe.voltage_v,
                    self.observations.across,
                );
                for point in self.used_points(i, k) {
                    let Crossing { pixel, slope } = search.crossing(&point.pixel).ok()?;
                    let off = seen.off_sheet(&pixel.map(Dual::constant)).ok()?;
                    let sigma = point.sigma_px * self.scales.stripe_pooled;
                    // The model's place in the row moves by −(∂g/∂p)/(∂g/∂u), where g is zero.
                    let by = |j: usize| -off.eps[j] / (slope * sigma);
                    let measured = self.observations.across.index();
                    let d_globals: [f64; GLOBALS] = std::array::from_fn(by);
                    let row = Row {
                        residual: (pixel[measured] - point.pixel[measured]) / sigma,
                        d_globals: &d_globals,
                        d_pose: std::array::from_fn(|j| by(GLOBALS + j)),
                    };
                    normal.add(&[row], Some(i), self.loss);
                }
                Some(())
            }
            Piece::Priors => {
                let variables = state.instrument.variables::<GLOBALS, GLOBALS>();
                for row in priors::residuals(&variables, self.rig, self.dispersion_sigma()) {
                    let row =
                        Row { residual: row.re, d_globals: &row.eps[..self.globals()], d_pose: [0.0; 6] };
                    normal.add(&[row], None, Loss::Squared);
                }
                Some(())
            }
        })
    }

    fn cost(&self, state: &State) -> Option<f64> {
        use rayon::prelude::*;
        let costs: Option<Vec<f64>> = self
            .pieces()
            .par_iter()
            .map(|piece| match *piece {
                Piece::Corners(i) => {
                    let mut sum = 0.0;
                    let rows = corner_residuals(state, i, &self.observations.views[i]);
                    for (row, used) in std::iter::zip(rows, &self.used.corners[i]) {
                        if *used {
                            sum += self
                                .loss
                                .evaluate(row?.whitened.norm_squared() / self.scales.corner.powi(2))
                                .0;
                        }
                    }
                    Some(sum)
                }
                Piece::Stripe(i, k) => {
                    let view = &self.observations.views[i];
                    let search = searcher(state, i, view, &view.stripes[k], self.observations.across);
                    let measured = self.observations.across.index();
                    let mut sum = 0.0;
                    for point in self.used_points(i, k) {
                        let off = search.crossing(&point.pixel).ok()?.pixel[measured] - point.pixel[measured];
                        sum += self
                            .loss
                            .evaluate((off / (point.sigma_px * self.scales.stripe_pooled)).powi(2))
                            .0;
                    }
                    Some(sum)
                }
                Piece::Priors => {
                    let rows = priors::residuals(&state.instrument, self.rig, self.dispersion_sigma());
                    Some(rows.iter().map(|r| r * r).sum())
                }
            })
            .collect();
        Some(costs?.iter().sum())
    }

    fn stopped(&self) -> bool {
        (self.stop)()
    }

    fn retract(&self, state: &State, step: &Step) -> State {
        let moves: [f64; GLOBALS] = std::array::from_fn(|i| step.globals.get(i).copied().unwrap_or(0.0));
        State {
            instrument: state.instrument.moved(&moves),
            poses: std::iter::zip(&state.poses, &step.poses).map(|(pose, d)| moved_pose(pose, d)).collect(),
        }
    }
}

fn searcher(
    state: &State,
    index: usize,
    view: &BoardView,
    stripe: &StripeView,
    across: Across,
) -> StripeOnBoard<Dual<1>> {
    StripeOnBoard::new(
        state.instrument.moved(&[Dual::constant(0.0); GLOBALS]),
        Pose::constant(&state.poses[index]),
        view.outside,
        stripe.voltage_v,
        across,
    )
}

/// A corner's residual: model minus measurement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CornerResidual {
    pub(crate) px: Vector2<f64>,
    /// In the predicted sigmas, before the common scale.
    pub(crate) whitened: Vector2<f64>,
}

/// Residuals of a view's corners; `None` for those that the model can't see.
pub(crate) fn corner_residuals(state: &State, index: usize, view: &BoardView) -> Vec<Option<CornerResidual>> {
    let pose = Pose::<f64>::constant(&state.poses[index]);
    let medium = state.instrument.board_medium(view.outside);
    view.corners
        .iter()
        .map(|corner| {
            let seen = state.instrument.scanner.project(&pose.point(&corner.board_mm), medium).ok()?;
            let px = seen - corner.pixel;
            Some(CornerResidual { px, whitened: whitening(&corner.covariance)? * px })
        })
        .collect()
}

/// A stripe measurement's residual: model minus measurement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StripeResidual {
    pub(crate) px: f64,
    /// Distance of the board's point seen there from the sheet, mm.
    pub(crate) mm: f64,
}

/// Residuals of a stripe's measurements; `None` for those that the model puts nowhere near.
pub(crate) fn stripe_residuals(
    state: &State,
    index: usize,
    view: &BoardView,
    stripe: &StripeView,
    across: Across,
) -> Vec<Option<StripeResidual>> {
    let search = searcher(state, index, view, stripe, across);
    let pose = Pose::<f64>::constant(&state.poses[index]);
    let sheet = search.sheet.value();
    stripe
        .points
        .iter()
        .map(|point| {
            let crossing = search.crossing(&point.pixel).ok()?;
            let medium = search.medium.value();
            let at = state.instrument.on_board(&point.pixel, &pose, medium).ok()?;
            let here: nalgebra::Vector3<Dual<3>> =
                nalgebra::Vector3::from_fn(|i, _| Dual::variable(at[i], i));
            let lifted = uw_geom::Sheet {
                apex_mm: uw_geom::lift(&sheet.apex_mm),
                normal: uw_geom::lift(&sheet.normal),
                port: sheet.port.lift(),
                outside: uw_geom::Medium::of_index(Dual::constant(sheet.outside.index)),
            };
            let off = lifted.off_sheet(&here).ok()?;
            let gradient = nalgebra::Vector3::from(off.eps).norm();
            let measured = across.index();
            Some(StripeResidual {
                px: crossing.pixel[measured] - point.pixel[measured],
                mm: off.re / gradient,
            })
        })
        .collect()
}

/// A minimum, with the covariance there of all local coordinates.
pub(crate) struct Solved {
    pub(crate) state: State,
    pub(crate) covariance: Covariance,
    pub(crate) report: Report,
}

/// The minimum that descent from `start` leads to.
pub(crate) fn solve(problem: &Joint<'_>, start: State) -> Result<Solved, LmError> {
    // Little damping: it slows the nearly undetermined directions (fan tilt against axis), and starts are good.
    let options = Options { max_iterations: 60, lambda: 1e-9, tolerance_sigmas: 1e-3 };
    let solution = lm::solve(problem, start, &options)?;
    let covariance = solution.normal.covariance()?;
    Ok(Solved { state: solution.state, covariance, report: solution.report })
}
