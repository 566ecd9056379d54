//! The paper's calibration, step after step (S. Chi, Z. Xie, W. Chen, Sensors 16 (2016), §3), with its slips mended as
//! docs/ say: intrinsics by Zhang's method, stripe points through the board's pose, a plane a voltage, the axis from the
//! planes. On land, windows neglected. For comparison.

use crate::calibration::{Calibration, Method, Statistics};
use crate::data::{Observations, Outside, Rig};
use crate::error::CalibError;
use crate::parameters::Instrument;
use crate::pinhole::{PinholeOptions, calibrate_pinhole};
use crate::sheets::VoltagePlane;
use crate::sight::Pose;
use crate::start::{drawn_instrument, galvo, planes_in, zhang_camera};
use uw_geom::Medium;

/// The calibration that the paper's method gives from the captures in air among `observations`; figures of the windows
/// are the rig file's.
///
/// Steps: S1 intrinsics (Eq 1; five distortion terms), S3 stripe pixel → board → camera frame (Eqs 2, 3), S4 one plane a voltage (Eq 4, by
/// total least squares), S5 the axis (Eqs 5, 6, by the smallest eigenvector), S6 the galvanometer's frame (Eq 7, as a rigid
/// transform). It has no covariance: steps taken one after the other don't carry one.
///
/// # Errors
/// As [`crate::calibrate`].
pub fn calibrate_by_paper(observations: &Observations, rig: &Rig) -> Result<Calibration, CalibError> {
    let mut on_land = observations.clone();
    on_land.views.retain(|v| v.outside == Outside::Air);
    let pinhole = calibrate_pinhole(&on_land.views, &zhang_camera(&on_land, rig), PinholeOptions::default())?;

    let drawn = drawn_instrument(rig, pinhole.camera);
    let mut bare = drawn;
    for port in [&mut bare.scanner.camera_port, &mut bare.scanner.laser_port] {
        port.glass = Medium::air();
    }
    let planes = planes_in(&on_land, &bare, &pinhole.poses, |_| true);
    let mut instrument = drawn;
    instrument.scanner.galvo = galvo(rig, &planes)?;

    let mut warnings = vec![
        "calibrated by the paper's method, for comparison: windows are neglected, there are no standard deviations".to_owned(),
    ];
    let in_water = observations.views.len() - on_land.views.len();
    if in_water > 0 {
        warnings.push(format!("the paper calibrates on land: {in_water} poses in water were left out"));
    }
    let (stripe_rms_mm, stripe_points) = plane_rms(&on_land, &bare, &pinhole.poses, &planes);
    let frames_used = on_land.views.iter().map(|v| 1 + v.stripes.len()).sum();
    let statistics = Statistics {
        reprojection_rms_px: pinhole.rms_px,
        stripe_rms_mm,
        stripe_points,
        corners: on_land.views.iter().map(|v| v.corners.len()).sum::<usize>() - pinhole.outliers.len(),
        corners_rejected: pinhole.outliers.len(),
        poses_used: on_land.views.len(),
        frames_used,
        corner_scale: 1.0,
        stripe_scale: 1.0,
        iterations: pinhole.report.iterations,
        ..Statistics::default()
    };
    Ok(Calibration {
        method: Method::Paper,
        instrument,
        covariance: None,
        nominal_water_index: None,
        across: observations.across,
        image_size: rig.image_size,
        statistics,
        warnings,
    })
}

/// Root mean square distance of all stripe points from their voltage's plane, mm, and how many they are.
fn plane_rms(
    observations: &Observations,
    instrument: &Instrument,
    poses: &[uw_geom::Rigid<uw_geom::frame::Camera, uw_geom::frame::Board>],
    planes: &[VoltagePlane],
) -> (f64, usize) {
    let (mut sum, mut count) = (0.0, 0);
    for (view, pose) in std::iter::zip(&observations.views, poses) {
        let pose = Pose::constant(pose);
        for stripe in &view.stripes {
            let Some(plane) = planes.iter().find(|p| (p.voltage_v - stripe.voltage_v).abs() < 1e-6) else {
                continue;
            };
            for point in &stripe.points {
                if let Ok(at) = instrument.on_board(&point.pixel, &pose, Medium::air()) {
                    sum += plane.plane.distance_mm(&at).powi(2);
                    count += 1;
                }
            }
        }
    }
    (if count > 0 { (sum / count as f64).sqrt() } else { 0.0 }, count)
}
