//! Levenberg–Marquardt over shared parameters and poses: the loop; the algebra is in `normal` and `schur`.
//!
//! The state and how a step changes it belong to the caller ([`Model`]); derivatives are by the local
//! parameters of [`Model::retract`] at zero. Damping is Marquardt's, λ diag(H), so that units of parameters
//! do not matter, with Nielsen's update of λ by the gain ratio (Madsen, Nielsen, Tingleff, "Methods for
//! non-linear least squares problems", 2004, Eq 2.21).

pub use crate::normal::{Loss, Normal, Row, Shape, Step, Unknown};
pub use crate::schur::{Covariance, Proposal};

/// A least-squares problem as the solver sees it. Residuals are whitened (in sigmas).
pub trait Model {
    /// All unknowns; poses as the caller likes.
    type State: Clone;

    /// Returns the number of unknowns, the same for every state.
    fn shape(&self) -> Shape;

    /// Returns the normal equations at `state`, or `None` where the model is not defined (behind the camera,
    /// total reflection).
    fn linearize(&self, state: &Self::State) -> Option<Normal>;

    /// Returns Σρ at `state`, the value of [`Normal::cost`]; override it where it is cheaper without
    /// derivatives.
    fn cost(&self, state: &Self::State) -> Option<f64> {
        self.linearize(state).map(|normal| normal.cost())
    }

    /// Returns the state moved by `step`.
    fn retract(&self, state: &Self::State, step: &Step) -> Self::State;

    /// Returns whether to give up; asked before every iteration.
    fn stopped(&self) -> bool {
        false
    }
}

/// Limits of the iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Linearisations at most.
    pub max_iterations: usize,
    /// First damping, relative to the diagonal of the normal matrix.
    pub lambda: f64,
    /// Converged when the undamped step's length, in the metric of the covariance, is below this many sigmas.
    pub tolerance_sigmas: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { max_iterations: 100, lambda: 1e-4, tolerance_sigmas: 1e-6 }
    }
}

/// Why the iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// The remaining step is below the tolerance.
    Step,
    /// No step decreases the cost any more, and what one could promise is below the rounding of the cost.
    Rounding,
    /// The limit of iterations was met first: the state is the best so far, not a minimum.
    Iterations,
    /// Steps stopped to decrease the cost though the model promised more: derivatives and residuals disagree,
    /// or the minimum lies at the edge of the model's domain.
    Stalled,
}

/// What the iteration did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Linearisations made.
    pub iterations: usize,
    /// Σρ at the start.
    pub cost_start: f64,
    /// Σρ at the end.
    pub cost: f64,
    /// Length of the undamped step that remains, in sigmas.
    pub remaining_sigmas: f64,
    /// Why it ended.
    pub stop: Stop,
}

impl Report {
    /// Returns whether the state is a minimum.
    #[must_use]
    pub fn converged(&self) -> bool {
        matches!(self.stop, Stop::Step | Stop::Rounding)
    }
}

/// The best state, the normal equations there (for [`Normal::covariance`]) and the report.
#[derive(Debug, Clone)]
pub struct Solution<S> {
    /// State of least cost.
    pub state: S,
    /// Normal equations at that state, undamped.
    pub normal: Normal,
    /// What the iteration did.
    pub report: Report,
}

/// Why a least-squares problem has no solution.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LmError {
    /// The start lies where the model is not defined, or has residuals that are not finite.
    #[error("the start values lie outside the model's domain")]
    Start,
    /// [`Model::stopped`] said so.
    #[error("given up before the end, as asked")]
    Stopped,
    /// A parameter is not determined.
    #[error(
        "{unknown} is not determined by the data: {share:.1e} of its information is its own, needed 1e-13"
    )]
    Singular {
        /// Which one.
        unknown: Unknown,
        /// Share of the parameter's information that the parameters before it don't explain.
        share: f64,
    },
}

/// Damping beyond which a step is too short to change anything.
const LAMBDA_MAX: f64 = 1e12;
/// Damping below which it makes no difference; keeps λ from underflowing.
const LAMBDA_MIN: f64 = 1e-15;

/// Returns the local minimum of Σρ that descent from `start` leads to.
///
/// # Errors
/// [`LmError::Start`]; [`LmError::Stopped`]; [`LmError::Singular`] when even the damped equations have no solution (a parameter
/// without any residual).
pub fn solve<M: Model>(model: &M, start: M::State, options: &Options) -> Result<Solution<M::State>, LmError> {
    let mut state = start;
    let mut normal = model.linearize(&state).filter(Normal::is_finite).ok_or(LmError::Start)?;
    let cost_start = normal.cost();
    let mut lambda = options.lambda.max(LAMBDA_MIN);
    let mut iterations = 1;
    loop {
        if model.stopped() {
            return Err(LmError::Stopped);
        }
        // −gᵀδ of the undamped step is its squared length in sigmas; a singular matrix has no such length
        // yet.
        let remaining_sigmas = normal.solve(0.0).map_or(f64::INFINITY, |full| full.decrease.max(0.0).sqrt());
        let end = |stop| Report { iterations, cost_start, cost: normal.cost(), remaining_sigmas, stop };
        if remaining_sigmas <= options.tolerance_sigmas {
            let report = end(Stop::Step);
            return Ok(Solution { state, normal, report });
        }
        if iterations >= options.max_iterations {
            let report = end(Stop::Iterations);
            return Ok(Solution { state, normal, report });
        }

        let mut growth = 2.0;
        let accepted = loop {
            let proposal = normal.solve(lambda)?;
            let candidate = model.retract(&state, &proposal.step);
            let gain = model.cost(&candidate).filter(|c| c.is_finite()).map(|c| normal.cost() - c);
            if let Some(gain) = gain.filter(|&g| g > 0.0)
                && let Some(next) = model.linearize(&candidate).filter(Normal::is_finite)
            {
                let ratio = gain / proposal.decrease;
                let factor = (1.0 - (2.0 * ratio - 1.0).powi(3)).clamp(1.0 / 3.0, 2.0);
                lambda = (lambda * factor).max(LAMBDA_MIN);
                break Some((candidate, next));
            }
            // Within rounding of the cost a decrease cannot be seen: that is a minimum, not a failure.
            if proposal.decrease <= 64.0 * f64::EPSILON * normal.cost() {
                break None;
            }
            lambda *= growth;
            growth *= 2.0;
            if lambda > LAMBDA_MAX {
                break None;
            }
        };
        let Some((next_state, next_normal)) = accepted else {
            let stop = if lambda > LAMBDA_MAX { Stop::Stalled } else { Stop::Rounding };
            let report = end(stop);
            return Ok(Solution { state, normal, report });
        };
        state = next_state;
        normal = next_normal;
        iterations += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = a·exp(−b t) + c + d·t + …: two globals (a, b), a pose's six coefficients of a polynomial in t.
    struct Decay {
        data: Vec<(usize, f64, f64)>,
        poses: usize,
        loss: Loss,
        sigma: f64,
    }

    type State = ([f64; 2], Vec<[f64; 6]>);

    fn predict(globals: &[f64; 2], pose: &[f64; 6], t: f64) -> f64 {
        let polynomial = pose.iter().rev().fold(0.0, |sum, c| sum * t + c);
        globals[0] * (-globals[1] * t).exp() * (6.0 * t).cos() + polynomial
    }

    impl Model for Decay {
        type State = State;

        fn shape(&self) -> Shape {
            Shape { globals: 2, poses: self.poses }
        }

        fn linearize(&self, (globals, poses): &State) -> Option<Normal> {
            if globals[1] < 0.0 {
                return None;
            }
            Normal::accumulate(self.shape(), &self.data, |&(pose, t, y), normal| {
                let wave = (-globals[1] * t).exp() * (6.0 * t).cos() / self.sigma;
                let d_pose = std::array::from_fn(|i| t.powi(i as i32) / self.sigma);
                let residual = (predict(globals, &poses[pose], t) - y) / self.sigma;
                let d_globals = &[wave, -globals[0] * t * wave];
                normal.add(&[Row { residual, d_globals, d_pose }], Some(pose), self.loss);
                Some(())
            })
        }

        fn retract(&self, (globals, poses): &State, step: &Step) -> State {
            let moved = poses.iter().zip(&step.poses);
            (
                [globals[0] + step.globals[0], globals[1] + step.globals[1]],
                moved.map(|(p, d)| std::array::from_fn(|i| p[i] + d[i])).collect(),
            )
        }
    }

    /// White noise of unit variance, uniform: the k-th output of SplitMix64.
    fn white(k: u64) -> f64 {
        let mut z = (k + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) as f64 / u64::MAX as f64 - 0.5) * 12.0_f64.sqrt()
    }

    const TRUTH: [f64; 2] = [4.0, 0.7];

    fn problem(noise: f64, outliers: bool, loss: Loss) -> Decay {
        let mut data = Vec::new();
        for k in 0..300_usize {
            let pose = k % 3;
            let t = (k as f64 * 0.618_033_988_749_895).fract() * 3.0;
            let coefficients = std::array::from_fn(|i| 1.0 / (1 + i + pose) as f64);
            let wobble = noise * white(k as u64);
            let outlier = if outliers && k % 17 == 0 { 5.0 } else { 0.0 };
            data.push((pose, t, predict(&TRUTH, &coefficients, t) + wobble + outlier));
        }
        Decay { data, poses: 3, loss, sigma: noise.max(1e-3) }
    }

    fn run(problem: &Decay) -> Solution<State> {
        solve(problem, ([1.0, 0.1], vec![[0.0; 6]; 3]), &Options::default()).unwrap()
    }

    #[test]
    fn exact_data_gives_the_truth() {
        let solution = run(&problem(0.0, false, Loss::Squared));
        assert!(solution.report.converged(), "{:?}", solution.report);
        // Within a millionth of the assumed sigma of 1e-3.
        for (got, truth) in solution.state.0.iter().zip(TRUTH) {
            assert!((got - truth).abs() < 1e-8);
        }
    }

    #[test]
    fn errors_are_within_their_predicted_sigma() {
        let solution = run(&problem(0.02, false, Loss::Squared));
        let covariance = solution.normal.covariance().unwrap();
        for (i, truth) in TRUTH.iter().enumerate() {
            assert!((solution.state.0[i] - truth).abs() < 3.5 * covariance.sigma(i));
        }
        let freedom = (solution.normal.rows() - 2 - 18) as f64;
        assert!((solution.report.cost / freedom - 1.0).abs() < 0.3, "chi2 {}", solution.report.cost);
    }

    #[test]
    fn a_robust_loss_withstands_outliers_that_ruin_the_squared_one() {
        let error = |loss| (run(&problem(0.02, true, loss)).state.0[0] - TRUTH[0]).abs();
        let (squared, cauchy) = (error(Loss::Squared), error(Loss::Cauchy(2.0)));
        assert!(cauchy < 0.03 && cauchy < 0.2 * squared, "Cauchy {cauchy}, squared {squared}");
    }

    #[test]
    fn a_start_outside_the_domain_is_refused() {
        let problem = problem(0.0, false, Loss::Squared);
        let outside = solve(&problem, ([1.0, -1.0], vec![[0.0; 6]; 3]), &Options::default());
        assert_eq!(outside.unwrap_err(), LmError::Start);
        let not_finite = solve(&problem, ([f64::NAN, 1.0], vec![[0.0; 6]; 3]), &Options::default());
        assert_eq!(not_finite.unwrap_err(), LmError::Start);
    }

    #[test]
    fn too_few_iterations_are_reported() {
        let options = Options { max_iterations: 2, ..Options::default() };
        let solution =
            solve(&problem(0.02, false, Loss::Squared), ([1.0, 0.1], vec![[0.0; 6]; 3]), &options).unwrap();
        assert_eq!(solution.report.stop, Stop::Iterations);
        assert!(!solution.report.converged() && solution.report.cost < solution.report.cost_start);
    }
}
