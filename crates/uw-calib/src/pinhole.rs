//! A camera without windows from views of a plane: the paper's camera (S1), and the check on photographs
//! taken in air without a housing.

use crate::bundle::{Bundle, MAX_MODEL_PX, Spread, State};
use crate::data::BoardView;
use crate::error::CalibError;
use crate::lm::{self, LmError, Loss, Options, Report, Unknown};
use crate::zhang;
use nalgebra::DMatrix;
use uw_geom::frame::{Board, Camera as CameraFrame};
use uw_geom::{Camera, Rigid};

/// Fewest views: two determine a camera only with its principal point known.
const MIN_VIEWS: usize = 3;
/// A focal length less certain than this share of itself is none.
const MAX_FOCAL_SIGMA: f64 = 0.1;
/// Boards closer to parallel than this leave the focal length open (Zhang's fig. 8: errors explode below 5°).
const PARALLEL_DEG: f64 = 5.0;
/// Threshold of the robust loss while outliers are not yet known, sigmas.
const HUBER_SIGMAS: f64 = 2.5;
/// Rounds of solving and weighing; weights settle in three.
const ROUNDS: usize = 4;

/// Names of [`Pinhole::covariance`]'s rows.
pub const PINHOLE_NAMES: [&str; 9] = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"];

/// What is known of the camera beforehand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PinholeOptions {
    /// Whether the pixels are square: fx = fy.
    pub equal_focal: bool,
    /// Whether k₃ is left at zero.
    pub without_k3: bool,
}

/// A camera, where the boards stood, and how well both are known.
#[derive(Debug, Clone)]
pub struct Pinhole {
    /// The camera.
    pub camera: Camera,
    /// `camera_from_board`, one a view, mm.
    pub poses: Vec<Rigid<CameraFrame, Board>>,
    /// Covariance of the camera's figures in the order of [`PINHOLE_NAMES`]; zero for k₃ where it was left
    /// out.
    pub covariance: DMatrix<f64>,
    /// Root mean square distance between corners seen and predicted, px, of all corners that were kept.
    pub rms_px: f64,
    /// The same for each view.
    pub view_rms_px: Vec<f64>,
    /// Standard deviation by axis, px, that had to be added to the corners' own covariances to explain the
    /// residuals: what the board's print and the lens model leave. Estimated.
    pub model_sigma_px: f64,
    /// Corners left out as outliers: (view, index into its corners).
    pub outliers: Vec<(usize, usize)>,
    /// The last solve.
    pub report: Report,
}

impl Pinhole {
    /// Returns the standard deviations of the camera's figures in the order of [`PINHOLE_NAMES`].
    #[must_use]
    pub fn sigmas(&self) -> [f64; 9] {
        std::array::from_fn(|i| self.covariance[(i, i)].max(0.0).sqrt())
    }
}

/// Returns the camera and the poses that explain all corners best, by a bundle adjustment from `start` (see
/// [`crate::closed_form`]).
///
/// Each corner counts by its own covariance plus one variance common to all, which is estimated from the
/// residuals; corners that lie more than 4.8 sigmas off are left out. Windows are not modelled and what is
/// outside does not matter.
///
/// # Errors
/// [`CalibError::TooFewPoses`], [`CalibError::Pose`], [`CalibError::ParallelBoards`] (also when the focal
/// length stays uncertain by a tenth), [`CalibError::NotConverged`], [`CalibError::Adjustment`].
pub fn calibrate_pinhole(
    views: &[BoardView],
    start: &Camera,
    options: PinholeOptions,
) -> Result<Pinhole, CalibError> {
    if views.len() < MIN_VIEWS {
        return Err(CalibError::TooFewPoses { needed: MIN_VIEWS, got: views.len() });
    }
    let mut camera = *start;
    if options.equal_focal {
        camera.fx = (camera.fx * camera.fy).sqrt();
        camera.fy = camera.fx;
    }
    if options.without_k3 {
        camera.distortion.k3 = 0.0;
    }
    let poses: Result<Vec<_>, _> = views
        .iter()
        .map(|view| zhang::pose(view, &camera).ok_or_else(|| CalibError::Pose { file: view.file.clone() }))
        .collect();
    let mut state = State { camera, poses: poses? };
    let mut bundle = Bundle {
        views,
        used: views.iter().map(|view| vec![true; view.corners.len()]).collect(),
        options,
        model_variance: 0.0,
        loss: Loss::Squared,
    };
    // The first solve weighs all corners alike, whatever they say of themselves: the model is not yet known
    // to fit.
    bundle.model_variance = MAX_MODEL_PX.powi(2);
    let mut solved = None;
    for round in 0..ROUNDS {
        let solution = lm::solve(&bundle, state, &Options::default())
            .map_err(|error| undetermined(error, &bundle, start))?;
        state = solution.state.clone();
        solved = Some(solution);
        if round + 1 < ROUNDS {
            bundle.loss = Loss::Huber(HUBER_SIGMAS);
            bundle.model_variance = bundle.estimate_variance(&state, Spread::Median);
        }
        if round + 2 == ROUNDS {
            bundle.drop_outliers(&state);
            bundle.loss = Loss::Squared;
            bundle.model_variance = bundle.estimate_variance(&state, Spread::Mean);
        }
    }
    let Some(solution) = solved else {
        return Err(CalibError::TooFewPoses { needed: MIN_VIEWS, got: 0 });
    };
    finish(&bundle, solution)
}

/// A camera of which a figure is not determined at all sees its boards parallel.
fn undetermined(error: LmError, bundle: &Bundle<'_>, camera: &Camera) -> CalibError {
    match error {
        LmError::Singular { unknown: Unknown::Global(_), .. } => {
            let poses: Vec<_> = bundle.views.iter().filter_map(|view| zhang::pose(view, camera)).collect();
            CalibError::ParallelBoards { spread_deg: spread_deg(&poses) }
        }
        LmError::Singular { unknown: Unknown::Pose(index), .. } => CalibError::Pose {
            file: bundle.views.get(index).map_or_else(String::new, |view| view.file.clone()),
        },
        other => CalibError::Adjustment(other),
    }
}

/// Largest angle between two boards' normals, degrees.
fn spread_deg(poses: &[Rigid<CameraFrame, Board>]) -> f64 {
    let normal = |pose: &Rigid<CameraFrame, Board>| pose.rotation_matrix().column(2).into_owned();
    let mut sine = 0.0_f64;
    for (i, a) in poses.iter().enumerate() {
        for b in &poses[..i] {
            sine = sine.max(normal(a).cross(&normal(b)).norm());
        }
    }
    sine.min(1.0).asin().to_degrees()
}

fn finish(bundle: &Bundle<'_>, solution: lm::Solution<State>) -> Result<Pinhole, CalibError> {
    let lm::Solution { state, normal, report } = solution;
    let rms: Vec<(f64, usize)> = (0..bundle.views.len())
        .map(|v| {
            let corners = bundle.views[v].corners.iter().zip(&bundle.used[v]).filter(|(_, used)| **used);
            corners
                .filter_map(|(c, _)| bundle.residual(&state, v, c))
                .fold((0.0, 0), |(sum, n), r| (sum + r.norm_squared(), n + 1))
        })
        .collect();
    let view_rms_px: Vec<f64> = rms.iter().map(|(sum, n)| (sum / (*n).max(1) as f64).sqrt()).collect();
    let spread_deg = spread_deg(&state.poses);
    if !report.converged() && spread_deg < PARALLEL_DEG {
        return Err(CalibError::ParallelBoards { spread_deg });
    }
    if !report.converged() {
        let worst = view_rms_px.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        let worst_file = worst.map_or_else(String::new, |(v, _)| bundle.views[v].file.clone());
        return Err(CalibError::NotConverged { iterations: report.iterations, worst_file });
    }
    let solved = normal.covariance().map_err(|error| undetermined(error, bundle, &state.camera))?.globals;
    let moves = bundle.moves();
    let mut covariance = DMatrix::zeros(9, 9);
    for (i, a) in moves.iter().enumerate() {
        for (j, b) in moves.iter().enumerate() {
            for (&row, &col) in a.iter().flat_map(|row| b.iter().map(move |col| (row, col))) {
                covariance[(row, col)] = solved[(i, j)];
            }
        }
    }
    if covariance[(0, 0)].sqrt() > MAX_FOCAL_SIGMA * state.camera.fx {
        return Err(CalibError::ParallelBoards { spread_deg });
    }
    let (sum, count) = rms.iter().fold((0.0, 0), |(s, n), (t, m)| (s + t, n + m));
    let outliers = bundle
        .used
        .iter()
        .enumerate()
        .flat_map(|(v, used)| used.iter().enumerate().filter(|(_, used)| !**used).map(move |(c, _)| (v, c)))
        .collect();
    Ok(Pinhole {
        camera: state.camera,
        poses: state.poses,
        covariance,
        rms_px: (sum / count.max(1) as f64).sqrt(),
        view_rms_px,
        model_sigma_px: bundle.model_variance.sqrt(),
        outliers,
        report,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{CornerPoint, Outside};
    use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};
    use rand::{RngExt, SeedableRng, rngs::StdRng};
    use rand_distr::StandardNormal;
    use uw_geom::Distortion;

    const IMAGE: [u32; 2] = [768, 576];

    fn truth() -> Camera {
        let distortion = Distortion { k1: -0.21, k2: 0.08, p1: 4e-4, p2: -6e-4, k3: 0.0 };
        Camera { fx: 1416.0, fy: 1424.0, cx: 390.0, cy: 280.0, distortion }
    }

    /// Views of 11 × 8 corners, 24 mm, `tilt` radians to all sides, corners scattered by `sigma` px.
    fn views(count: usize, tilt: f64, sigma: f64, rng: &mut StdRng) -> Vec<BoardView> {
        (0..count)
            .map(|i| {
                let (sin, cos) = (i as f64 * 2.4).sin_cos();
                let turn = UnitQuaternion::from_scaled_axis(Vector3::new(tilt * sin, tilt * cos, 0.3 * sin));
                let middle = Vector3::new(120.0, 84.0, 0.0);
                let at = Vector3::new(90.0 * cos, 50.0 * sin, 850.0 + 25.0 * i as f64) - turn * middle;
                let pose: Rigid<CameraFrame, Board> = Rigid::new(turn, at);
                let corners = (0..88).map(|k| {
                    let board_mm = Vector2::new(f64::from(k % 11) * 24.0, f64::from(k / 11) * 24.0);
                    let seen = truth().project(&pose.transform_point(&board_mm.push(0.0))).unwrap();
                    let noise = Vector2::from_fn(|_, _| sigma * rng.sample::<f64, _>(StandardNormal));
                    // What corners say of themselves may be too small.
                    CornerPoint { board_mm, pixel: seen + noise, covariance: Matrix2::identity() * 1e-6 }
                });
                let corners = corners.collect();
                BoardView {
                    file: format!("{i}.png"),
                    outside: Outside::Air,
                    square_mm: 24.0,
                    corners,
                    stripes: Vec::new(),
                }
            })
            .collect()
    }

    fn figures(c: &Camera) -> [f64; 9] {
        let d = c.distortion;
        [c.fx, c.fy, c.cx, c.cy, d.k1, d.k2, d.p1, d.p2, d.k3]
    }

    #[test]
    fn exact_corners_give_the_camera() {
        let views = views(8, 0.4, 0.0, &mut StdRng::seed_from_u64(1));
        let start = zhang::closed_form(&views, IMAGE).unwrap();
        assert!((start.fx / truth().fx - 1.0).abs() < 0.05, "closed form {start:?}");
        let result = calibrate_pinhole(&views, &start, PinholeOptions::default()).unwrap();
        // A thousandth of a corner's claimed sigma, 1e-3 px, is far above rounding.
        assert!(result.rms_px < 1e-6, "{}", result.rms_px);
        assert!((result.camera.fx - truth().fx).abs() < 1e-3);
    }

    /// Errors over predicted sigmas have unit variance: chi² over 60 trials of each of nine figures. Its own
    /// scatter is √(2/60) = 0.18; correlated figures share it.
    #[test]
    fn predicted_sigmas_are_those_of_the_scatter() {
        let mut squares = [0.0; 9];
        const TRIALS: usize = 60;
        for seed in 0..TRIALS {
            let sigma = 0.05;
            let views = views(9, 0.4, sigma, &mut StdRng::seed_from_u64(seed as u64));
            let result = calibrate_pinhole(&views, &truth(), PinholeOptions::default()).unwrap();
            assert!((result.model_sigma_px / sigma - 1.0).abs() < 0.15, "{}", result.model_sigma_px);
            let (got, truth, sigmas) = (figures(&result.camera), figures(&truth()), result.sigmas());
            for i in 0..9 {
                squares[i] += ((got[i] - truth[i]) / sigmas[i]).powi(2) / TRIALS as f64;
            }
        }
        for (name, square) in PINHOLE_NAMES.iter().zip(squares) {
            assert!((0.45..1.8).contains(&square), "{name}: {square}");
        }
    }

    #[test]
    fn outliers_are_found_and_left_out() {
        let mut views = views(9, 0.4, 0.05, &mut StdRng::seed_from_u64(5));
        for (view, corner) in [(0, 3), (4, 80), (7, 44)] {
            views[view].corners[corner].pixel.x += 4.0;
        }
        let result = calibrate_pinhole(&views, &truth(), PinholeOptions::default()).unwrap();
        assert_eq!(result.outliers, [(0, 3), (4, 80), (7, 44)]);
        assert!((result.camera.fx - truth().fx).abs() < 4.0 * result.sigmas()[0]);
    }

    #[test]
    fn equal_focal_lengths_stay_equal() {
        let views = views(6, 0.4, 0.02, &mut StdRng::seed_from_u64(2));
        let options = PinholeOptions { equal_focal: true, without_k3: true };
        let result = calibrate_pinhole(&views, &truth(), options).unwrap();
        assert_eq!(result.camera.fx.to_bits(), result.camera.fy.to_bits());
        assert_eq!(result.camera.distortion.k3.to_bits(), 0.0_f64.to_bits());
        assert!((result.covariance[(0, 1)] / result.covariance[(0, 0)] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn parallel_boards_determine_no_camera() {
        let parallel = views(6, 0.0, 0.05, &mut StdRng::seed_from_u64(3));
        assert!(zhang::closed_form(&parallel[..2], IMAGE).is_none());
        let flat: Vec<BoardView> = parallel
            .iter()
            .map(|view| {
                let mut view = view.clone();
                let corner = |k: usize| Vector2::new((k % 11) as f64 * 24.0, (k / 11) as f64 * 24.0);
                for (k, c) in view.corners.iter_mut().enumerate() {
                    c.pixel = corner(k) * 1.5 + Vector2::new(100.0, 90.0);
                }
                view
            })
            .collect();
        assert!(zhang::closed_form(&flat, IMAGE).is_none());
        let refused = calibrate_pinhole(&flat, &truth(), PinholeOptions::default());
        assert!(
            matches!(refused, Err(CalibError::ParallelBoards { spread_deg }) if spread_deg < 5.0),
            "{refused:?}"
        );
    }

    #[test]
    fn too_few_views_are_refused() {
        let views = views(2, 0.4, 0.0, &mut StdRng::seed_from_u64(4));
        let refused = calibrate_pinhole(&views, &truth(), PinholeOptions::default());
        assert_eq!(refused.unwrap_err(), CalibError::TooFewPoses { needed: 3, got: 2 });
    }
}
