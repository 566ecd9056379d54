//! The adjustment behind [`crate::calibrate_pinhole`]: residuals, derivatives, weights.

use crate::data::{BoardView, CornerPoint};
use crate::lm::{Loss, Model, Normal, Row, Shape, Step};
use crate::pinhole::PinholeOptions;
use crate::sight::{Pose, moved_pose};
use nalgebra::{Matrix2, Vector2};
use uw_geom::frame::{Board, Camera as CameraFrame};
use uw_geom::{Camera, Distortion, Dual, Real, Rigid};

/// Residuals beyond this many sigmas are outliers: one corner in 10⁵ by chance (chi² with two degrees of
/// freedom).
const OUTLIER_SIGMAS: f64 = 4.8;
/// Px; a model can be wrong by no more than this and still be worth weighing.
pub(crate) const MAX_MODEL_PX: f64 = 100.0;

#[derive(Debug, Clone)]
pub(crate) struct State {
    pub camera: Camera,
    pub poses: Vec<Rigid<CameraFrame, Board>>,
}

/// The problem that the solver is given.
pub(crate) struct Bundle<'a> {
    pub views: &'a [BoardView],
    /// Of each view's corners, which count.
    pub used: Vec<Vec<bool>>,
    pub options: PinholeOptions,
    /// Px², added to every corner's own variance in both directions.
    pub model_variance: f64,
    pub loss: Loss,
}

/// Which property of the whitened residuals is brought to its expectation.
#[derive(Clone, Copy)]
pub(crate) enum Spread {
    /// Outliers don't count.
    Median,
    /// Degrees of freedom do.
    Mean,
}

type Number = Dual<15>;

/// The camera with its nine figures as the first nine variables.
fn variables(camera: &Camera) -> Camera<Number> {
    let d = camera.distortion;
    Camera {
        fx: Number::variable(camera.fx, 0),
        fy: Number::variable(camera.fy, 1),
        cx: Number::variable(camera.cx, 2),
        cy: Number::variable(camera.cy, 3),
        distortion: Distortion {
            k1: Number::variable(d.k1, 4),
            k2: Number::variable(d.k2, 5),
            p1: Number::variable(d.p1, 6),
            p2: Number::variable(d.p2, 7),
            k3: Number::variable(d.k3, 8),
        },
    }
}

impl Bundle<'_> {
    /// Of each unknown of the solver, which of the nine figures it moves.
    pub fn moves(&self) -> Vec<Vec<usize>> {
        let mut moves = if self.options.equal_focal { vec![vec![0, 1]] } else { vec![vec![0], vec![1]] };
        moves.extend((2..8).map(|i| vec![i]));
        if !self.options.without_k3 {
            moves.push(vec![8]);
        }
        moves
    }

    /// L⁻¹ of the corner's covariance with the model's share.
    fn whitening(&self, corner: &CornerPoint) -> Option<Matrix2<f64>> {
        (corner.covariance + Matrix2::identity() * self.model_variance).cholesky()?.l().try_inverse()
    }

    pub fn residual(&self, state: &State, view: usize, corner: &CornerPoint) -> Option<Vector2<f64>> {
        let point = state.poses[view].transform_point(&corner.board_mm.push(0.0));
        Some(state.camera.project(&point).ok()? - corner.pixel)
    }

    /// Residuals of the corners in use, with the corner.
    fn residuals<'b>(&'b self, state: &'b State) -> impl Iterator<Item = (Vector2<f64>, &'b CornerPoint)> {
        self.views.iter().enumerate().flat_map(move |(v, view)| {
            view.corners
                .iter()
                .zip(&self.used[v])
                .filter_map(move |(c, used)| self.residual(state, v, c).filter(|_| *used).map(|r| (r, c)))
        })
    }

    /// The variance that, added to the corners' own, makes the residuals as large as expected; zero where
    /// they are small enough without.
    pub fn estimate_variance(&self, state: &State, spread: Spread) -> f64 {
        let residuals: Vec<_> = self.residuals(state).collect();
        let freedom = 2.0 * residuals.len() as f64 - (self.moves().len() + 6 * self.views.len()) as f64;
        let excess = |variance: f64| {
            let squares = residuals.iter().map(|(r, c)| {
                let covariance = c.covariance + Matrix2::identity() * variance;
                covariance.try_inverse().map_or(0.0, |inverse| r.dot(&(inverse * r)))
            });
            match spread {
                Spread::Mean => squares.sum::<f64>() > freedom,
                Spread::Median => {
                    let mut squares: Vec<f64> = squares.collect();
                    squares.sort_by(f64::total_cmp);
                    // Median of chi² with two degrees of freedom: 2 ln 2.
                    squares.get(squares.len() / 2).is_some_and(|m| *m > 2.0 * std::f64::consts::LN_2)
                }
            }
        };
        if !excess(0.0) {
            return 0.0;
        }
        // Bisection over the standard deviation's logarithm: 60 halvings of 14 decades exhaust a double.
        let (mut low, mut high) = (1e-12_f64.ln(), MAX_MODEL_PX.ln());
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if excess((2.0 * middle).exp()) { low = middle } else { high = middle }
        }
        (2.0 * high).exp()
    }

    pub fn drop_outliers(&mut self, state: &State) {
        let kept = |v: usize, corner: &CornerPoint| {
            let whitened = self.residual(state, v, corner).zip(self.whitening(corner)).map(|(r, w)| w * r);
            whitened.is_some_and(|w| w.norm() < OUTLIER_SIGMAS)
        };
        let views = self.views.iter().enumerate();
        self.used = views.map(|(v, view)| view.corners.iter().map(|c| kept(v, c)).collect()).collect();
    }
}

impl Model for Bundle<'_> {
    type State = State;

    fn shape(&self) -> Shape {
        Shape { globals: self.moves().len(), poses: self.views.len() }
    }

    fn linearize(&self, state: &State) -> Option<Normal> {
        let camera = variables(&state.camera);
        let moves = self.moves();
        let views: Vec<usize> = (0..self.views.len()).collect();
        Normal::accumulate(self.shape(), &views, |&v, normal| {
            let pose = Pose::<Number>::variables(&state.poses[v]);
            for (corner, _) in self.views[v].corners.iter().zip(&self.used[v]).filter(|(_, used)| **used) {
                let seen = camera.project(&pose.point(&corner.board_mm)).ok()?;
                let whitening = self.whitening(corner)?;
                let residual = whitening * (seen.map(Real::value) - corner.pixel);
                let derivative = |row: usize, i: usize| {
                    whitening[(row, 0)] * seen.x.eps[i] + whitening[(row, 1)] * seen.y.eps[i]
                };
                let d_globals = [0, 1].map(|row| -> Vec<f64> {
                    moves.iter().map(|figures| figures.iter().map(|&i| derivative(row, i)).sum()).collect()
                });
                let rows = [0, 1].map(|row| Row {
                    residual: residual[row],
                    d_globals: &d_globals[row],
                    d_pose: std::array::from_fn(|i| derivative(row, 9 + i)),
                });
                normal.add(&rows, Some(v), self.loss);
            }
            Some(())
        })
    }

    fn cost(&self, state: &State) -> Option<f64> {
        let mut cost = 0.0;
        for (v, view) in self.views.iter().enumerate() {
            for (corner, _) in view.corners.iter().zip(&self.used[v]).filter(|(_, used)| **used) {
                let whitened = self.whitening(corner)? * self.residual(state, v, corner)?;
                cost += self.loss.evaluate(whitened.norm_squared()).0;
            }
        }
        Some(cost)
    }

    fn retract(&self, state: &State, step: &Step) -> State {
        let mut delta = [0.0; 9];
        for (figures, d) in self.moves().iter().zip(step.globals.iter()) {
            figures.iter().for_each(|&i| delta[i] = *d);
        }
        let c = state.camera;
        let d = c.distortion;
        State {
            camera: Camera {
                fx: c.fx + delta[0],
                fy: c.fy + delta[1],
                cx: c.cx + delta[2],
                cy: c.cy + delta[3],
                distortion: Distortion {
                    k1: d.k1 + delta[4],
                    k2: d.k2 + delta[5],
                    p1: d.p1 + delta[6],
                    p2: d.p2 + delta[7],
                    k3: d.k3 + delta[8],
                },
            },
            poses: state.poses.iter().zip(&step.poses).map(|(pose, step)| moved_pose(pose, step)).collect(),
        }
    }
}
