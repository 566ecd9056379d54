//! What a set of observations can and can't determine, and what to capture next.

use crate::calibration::{Calibration, CorrelatedPair};
use crate::data::{Observations, Outside, Rig};
use crate::error::CalibError;
use crate::joint::State;
use crate::lm::Covariance;
use crate::parameters::{GLOBALS, NAMES};
use nalgebra::{Vector2, Vector3};

/// Fewer placements than this leave nothing to check the camera's nine figures with.
const MIN_POSES: usize = 3;
/// Boards closer to parallel than this leave the focal length open (Zhang, PAMI 22 (2000), fig. 8: errors explode below 5°).
const MIN_SPREAD_DEG: f64 = 5.0;
/// A set that varies less in tilt than this works, but badly.
const GOOD_SPREAD_DEG: f64 = 20.0;
/// A set that varies less in distance than this (farthest over nearest board) leaves sheets badly held along the depth.
const GOOD_DEPTH_RATIO: f64 = 1.15;
/// Fewer voltages leave the mirror's non-linearity to its prior.
const GOOD_VOLTAGES: usize = 4;
/// Length along the depth for which accuracy is forecast, mm.
const FORECAST_LENGTH_MM: f64 = 400.0;

/// Refuses what has no solution, once poses are known.
pub(crate) fn refuse(state: &State) -> Result<(), CalibError> {
    let poses = state.poses.len();
    if poses < MIN_POSES {
        return Err(CalibError::TooFewPoses { needed: MIN_POSES, got: poses });
    }
    let spread_deg = tilt_spread_deg(state);
    if spread_deg < MIN_SPREAD_DEG {
        return Err(CalibError::ParallelBoards { spread_deg });
    }
    Ok(())
}

/// Largest angle between the normals of two boards, degrees.
fn tilt_spread_deg(state: &State) -> f64 {
    let normals: Vec<Vector3<f64>> =
        state.poses.iter().map(|p| p.rotation_matrix().column(2).into_owned()).collect();
    let pairs =
        normals.iter().enumerate().flat_map(|(i, a)| normals[..i].iter().map(move |b| a.cross(b).norm()));
    pairs.fold(0.0, f64::max).min(1.0).asin().to_degrees()
}

/// What to tell the user about the set, with what to capture next.
pub(crate) fn warnings(
    observations: &Observations,
    rig: &Rig,
    calibration: &Calibration,
    state: &State,
) -> Vec<String> {
    let mut said = Vec::new();
    let spread = tilt_spread_deg(state);
    if spread < GOOD_SPREAD_DEG {
        said.push(format!(
            "the boards differ in tilt by only {spread:.0}°: capture poses tilted by 20 to 40° to all sides"
        ));
    }
    let depths = depths(observations, state);
    let (near, far) = depths.iter().fold((f64::INFINITY, 0.0_f64), |(n, f), &d| (n.min(d), f.max(d)));
    if far < near * GOOD_DEPTH_RATIO {
        said.push(format!(
            "all boards stand {near:.0} to {far:.0} mm away: capture some nearer and some farther, over the whole working range"
        ));
    }
    let mut voltages: Vec<f64> =
        observations.views.iter().flat_map(|v| &v.stripes).map(|s| s.voltage_v).collect();
    voltages.sort_by(f64::total_cmp);
    voltages.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    if voltages.len() < GOOD_VOLTAGES {
        said.push(format!(
            "the laser was captured at {} voltages only: capture at least {GOOD_VOLTAGES}, from one end of the scan to the other",
            voltages.len()
        ));
    }
    if observations.views.iter().all(|v| v.outside == Outside::Air) {
        let forecast =
            depth_forecast(rig, calibration, &depths, &voltages).map_or(String::new(), |sigma_mm| {
                format!(" (expect ±{sigma_mm:.1} mm, 1 sigma, on {FORECAST_LENGTH_MM:.0} mm along the depth)")
            });
        said.push(format!(
            "calibrated on land only: under water the windows and the index of water rest on the rig file's figures{forecast}; \
             poses of the board in water are worth more than anything else: capture 6 to 10"
        ));
    } else if observations.views.iter().all(|v| v.outside != Outside::Air) {
        said.push(
            "calibrated in water only: the windows' part can't be told from the lens's as well as with poses in air; \
             capture 10 to 15 on land"
                .to_owned(),
        );
    }
    said
}

/// Distance of each board's middle along the camera's axis, mm.
fn depths(observations: &Observations, state: &State) -> Vec<f64> {
    std::iter::zip(&observations.views, &state.poses)
        .map(|(view, pose)| {
            let middle =
                view.corners.iter().map(|c| c.board_mm).sum::<Vector2<f64>>() / view.corners.len() as f64;
            pose.transform_point(&middle.push(0.0)).z
        })
        .collect()
}

/// Standard deviation from calibration of a length along the depth in water, through the middle of the image, from the
/// working range's middle.
fn depth_forecast(rig: &Rig, calibration: &Calibration, depths: &[f64], voltages: &[f64]) -> Option<f64> {
    let nominal = 1.335;
    let water = Outside::Water { laser_index: nominal, board_index: nominal };
    let depth = depths.iter().sum::<f64>() / depths.len() as f64;
    let [width, height] = rig.image_size.map(f64::from);
    let middle = Vector2::new(0.5 * width, 0.5 * height);
    let scanner = calibration.scanner();
    let medium = calibration.instrument.laser_medium(water);
    let ray = scanner.pixel_ray(&middle, medium).ok()?;
    // The voltages whose sheets cross the middle ray half the length before and behind the middle: bisection over the range.
    let voltage_at = |z: f64| {
        let point = ray.at((z - ray.origin.z) / ray.direction.z);
        let before = |v: f64| scanner.sheet(v, medium).off_sheet(&point).ok().map(f64::is_sign_positive);
        let (low, high) = (*voltages.first()?, *voltages.last()?);
        let reach = (high - low).max(1e-3);
        let (mut a, mut b) = (low - 3.0 * reach, high + 3.0 * reach);
        let side = before(a)?;
        if before(b)? == side {
            return None;
        }
        for _ in 0..60 {
            let m = 0.5 * (a + b);
            if before(m)? == side {
                a = m;
            } else {
                b = m;
            }
        }
        Some(0.5 * (a + b))
    };
    let half = 0.5 * FORECAST_LENGTH_MM.min(depth);
    let ends = [(middle, voltage_at(depth - half)?), (middle, voltage_at(depth + half)?)];
    let sigma = calibration.length_sigma(ends, water).ok()??;
    Some(sigma * FORECAST_LENGTH_MM / (2.0 * half))
}

/// The two most correlated pairs of shared unknowns.
pub(crate) fn most_correlated(covariance: &Covariance) -> Vec<CorrelatedPair> {
    let mut pairs: Vec<CorrelatedPair> = (0..GLOBALS)
        .flat_map(|i| (0..i).map(move |j| (i, j)))
        .map(|(i, j)| CorrelatedPair { a: NAMES[j], b: NAMES[i], correlation: covariance.correlation(i, j) })
        .collect();
    pairs.sort_by(|p, q| q.correlation.abs().total_cmp(&p.correlation.abs()));
    pairs.truncate(2);
    pairs
}
