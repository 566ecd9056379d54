//! Figures of a report that are not a single scan's: the calibration, and the errors of an artefact's balls.

use crate::pipeline::report::artefact::{self, Probed};
use crate::pipeline::report::record::{
    CalibrationRecord, FigureRecord, FileRecord, ProbingRecord, SourceRecord, SpacingRecord,
};
use crate::pipeline::report::scan::Scan;
use nalgebra::Vector3;
use uw_calib::{Calibration, Method};
use uw_cloud::ShapeFit;
use uw_io::{CalibrationFile, Nominal};

pub(crate) fn method(method: Method) -> &'static str {
    match method {
        Method::Joint => "joint",
        Method::Paper => "paper",
    }
}

/// Every figure of a calibration.
pub(crate) fn quantities(calibration: &Calibration) -> Vec<FigureRecord> {
    let known = calibration.covariance.is_some();
    let figure = |q: uw_calib::Quantity| FigureRecord {
        sigma: known.then_some(q.sigma),
        ..FigureRecord::new(q.name, q.value, q.sigma, None)
    };
    calibration.quantities().into_iter().map(figure).collect()
}

/// What a calibration was made from.
pub(crate) fn sources(of: &CalibrationFile) -> Vec<SourceRecord> {
    let one = |c: &uw_io::CaptureSource| SourceRecord {
        name: c.name.clone(),
        sha256: c.sha256.clone(),
        medium: c.medium.name(),
    };
    of.captures.iter().map(one).collect()
}

/// A calibration in short.
pub(crate) fn calibration(of: &CalibrationFile, file: FileRecord) -> CalibrationRecord {
    let CalibrationFile { calibration, software, .. } = of;
    let s = &calibration.statistics;
    CalibrationRecord {
        file,
        method: method(calibration.method),
        software: software.clone(),
        captures: sources(of),
        poses_used: s.poses_used,
        frames_used: s.frames_used,
        reprojection_rms_px: s.reprojection_rms_px,
        stripe_rms_px: s.stripe_rms_px,
        stripe_rms_mm: s.stripe_rms_mm,
        rejected: s.rejected.len(),
        warnings: calibration.warnings.clone(),
        figures: quantities(calibration),
    }
}

/// Probing errors of every ball, and sphere-spacing errors of those with nominal distances.
pub(crate) fn errors(scans: &[Scan], nominal: Option<&Nominal>) -> (Vec<ProbingRecord>, Vec<SpacingRecord>) {
    let (mut probing, mut spacing) = (Vec::new(), Vec::new());
    for (at, scan) in scans.iter().enumerate() {
        let probed: Vec<Option<Probed>> = scan
            .shapes
            .iter()
            .enumerate()
            .map(|(of, shape)| match &shape.fit {
                ShapeFit::Sphere(fit) => {
                    let taken: Vec<bool> = scan.shape_of.iter().map(|s| s.is_some_and(|s| s != of)).collect();
                    artefact::probed(&scan.cloud, &taken, fit)
                }
                _ => None,
            })
            .collect();
        for (of, probed) in probed.iter().enumerate() {
            let Some(probed) = probed else { continue };
            let ball = scan.balls.iter().position(|ball| *ball == Some(of));
            let radius = ball.and_then(|ball| Some(nominal?.spheres.get(ball)?.radius_mm));
            probing.push(ProbingRecord {
                scan: at,
                ball: scan.record.shapes[of].label.clone(),
                radius_mm: probed.radius_mm,
                center_mm: probed.center_mm,
                form_mm: probed.form_mm,
                size_mm: radius.map(|radius| 2.0 * (probed.radius_mm - radius)),
                points: probed.points,
                left_out: probed.left_out,
            });
        }
        for distance in nominal.iter().flat_map(|n| &n.distances) {
            let center = |name: &str| {
                let ball = nominal?.spheres.iter().position(|s| s.name == name)?;
                let shape = (*scan.balls.get(ball)?)?;
                Some(Vector3::from(probed.get(shape)?.as_ref()?.center_mm))
            };
            let (Some(a), Some(b)) = (center(&distance.a), center(&distance.b)) else { continue };
            let distance_mm = (a - b).norm();
            spacing.push(SpacingRecord {
                scan: at,
                a: distance.a.clone(),
                b: distance.b.clone(),
                distance_mm,
                nominal_mm: distance.distance_mm,
                error_mm: distance_mm - distance.distance_mm,
            });
        }
    }
    (probing, spacing)
}
