use crate::synthetic::{Plan, world};
use nalgebra::DMatrix;
use uw_calib::{Quantity, calibrate, quantities};

/// Trials in the suite; `UWSCAN_TRIALS` overrides it (`just monte-carlo` runs 200 and more).
const TRIALS: usize = 24;
/// Bars with 200 trials: scatter over prediction, and mean in standard errors.
const SCATTER: std::ops::RangeInclusive<f64> = 0.8..=1.2;
const MEAN_STANDARD_ERRORS: f64 = 3.5;
/// What 200 trials' scatter of a true sigma may do by chance, in relative standard deviations of 1/√(2·200) = 0.05: the bar's
/// 0.2 is four of them; fewer trials get the same four.
const SCATTER_DEVIATIONS: f64 = 4.0;

/// The components that a unit vector has along itself: 1 − (small)², of no use as an estimate of anything.
const DOMINANT: [&str; 4] =
    ["camera.port.normal_z", "laser.port.normal_z", "galvo.axis_direction_y", "galvo.z_axis_z"];

#[test]
fn every_predicted_sigma_is_true() {
    let trials = std::env::var("UWSCAN_TRIALS").ok().and_then(|t| t.parse().ok()).unwrap_or(TRIALS);
    let mut normalised: Vec<(&str, Vec<f64>)> = Vec::new();
    for seed in 0..trials {
        let world = world(&Plan::default(), seed as u64);
        let found = calibrate(&world.observations, &world.rig).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
        let truth = quantities(&world.truth, &DMatrix::zeros(34, 34));
        for (k, (Quantity { name, value, sigma }, truth)) in
            std::iter::zip(found.quantities(), truth).enumerate()
        {
            if normalised.len() <= k {
                normalised.push((name, Vec::new()));
            }
            normalised[k].1.push((value - truth.value) / sigma);
        }
    }
    let n = trials as f64;
    let slack = if trials >= 200 { 0.2 } else { SCATTER_DEVIATIONS / (2.0 * n).sqrt() };
    let mut short = Vec::new();
    for (name, z) in normalised.iter().filter(|(name, _)| !DOMINANT.contains(name)) {
        let mean = z.iter().sum::<f64>() / n;
        let scatter = (z.iter().map(|z| z * z).sum::<f64>() / n).sqrt();
        let standard_errors = mean.abs() * n.sqrt();
        println!("{name:<28} scatter/predicted {scatter:5.2}  |mean| {standard_errors:4.1} standard errors");
        let limits = if trials >= 200 { SCATTER } else { 1.0 - slack..=1.0 + slack };
        if !limits.contains(&scatter) || standard_errors > MEAN_STANDARD_ERRORS {
            short.push(*name);
        }
    }
    assert!(short.is_empty(), "sigmas not borne out: {short:?}");
}
