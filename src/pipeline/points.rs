//! Stripe centres → points in millimetres, each with its covariance.

use crate::pipeline::reconstruct::Refraction;
use crate::pipeline::stripes::axis;
use crate::pipeline::sweep::{Seen, Verdicts};
use nalgebra::{Vector2, Vector3};
use uw_calib::Across;
use uw_cloud::CloudPoint;
use uw_geom::{GeomError, Medium, Plane, Ray, Scanner, approx};
use uw_io::calibration_toml::CalibrationFile;

/// From stripes to points, for one scan.
pub(crate) struct Tracer<'a> {
    pub calibration: &'a CalibrationFile,
    pub refraction: Refraction,
    pub medium: Medium,
}

/// A point and its derivative by the measured coordinate, mm and mm per px.
type PointAndSlope = (Vector3<f64>, Vector3<f64>);

impl Tracer<'_> {
    pub(crate) fn scanner(&self) -> &Scanner {
        self.calibration.calibration.scanner()
    }

    /// The points of one image, `row` its number in the order of capture, and why others gave none.
    pub(crate) fn points(
        &self,
        row: u32,
        voltage_v: f64,
        verdicts: Verdicts,
    ) -> (Vec<CloudPoint>, Vec<&'static str>) {
        let sheet = self.scanner().sheet(voltage_v, self.medium);
        let exposure = self.scanner().exposure(voltage_v, self.medium);
        let plane = approx::planar_sheet(&sheet);
        let across = self.calibration.calibration.across;
        let trace = |pixel: &Vector2<f64>| match (self.refraction, plane) {
            (Refraction::Exact, _) => exposure.as_ref().map_err(|error| *error).and_then(|exposure| {
                let t = exposure.triangulate_with_derivatives(pixel)?;
                Ok((t.point_mm, if across == Across::U { t.per_u } else { t.per_v }))
            }),
            (_, Err(error)) => Err(error),
            (Refraction::Paper, Ok(plane)) => central(pixel, across, |pixel| {
                let ray = approx::scaled_pixel_ray(&self.scanner().camera, pixel, self.medium)?;
                approx::intersect_plane(&ray, &plane)
            }),
            (Refraction::None, Ok(_)) => central(pixel, across, |pixel| {
                let plane = Plane::through(&sheet.apex_mm, &sheet.normal)?;
                let direction = self.scanner().camera.unproject(pixel)?;
                approx::intersect_plane(&Ray { origin: Vector3::zeros(), direction }, &plane)
            }),
        };
        let (mut points, mut rejected) = (Vec::with_capacity(verdicts.len()), Vec::new());
        for verdict in verdicts {
            let point = verdict.and_then(|seen| {
                let pixel = Vector2::from(axis(across).uv(seen.line, seen.position_px));
                let (point, slope) = trace(&pixel).map_err(|_| "no_intersection")?;
                Ok(cloud_point(point, slope, &seen, row, &pixel))
            });
            match point {
                Ok(point) => points.push(point),
                Err(reason) => rejected.push(reason),
            }
        }
        (points, rejected)
    }
}

/// A point and its slope by central differences, for models without derivatives of their own.
fn central(
    pixel: &Vector2<f64>,
    across: Across,
    trace: impl Fn(&Vector2<f64>) -> Result<Vector3<f64>, GeomError>,
) -> Result<PointAndSlope, GeomError> {
    const HALF_STEP_PX: f64 = 0.5;
    let at = |by: f64| {
        let mut moved = *pixel;
        moved[across.index()] += by;
        trace(&moved)
    };
    Ok((trace(pixel)?, (at(HALF_STEP_PX)? - at(-HALF_STEP_PX)?) / (2.0 * HALF_STEP_PX)))
}

/// `slope`: the stripe's error moves the point along the sheet, mm/px.
fn cloud_point(
    point: Vector3<f64>,
    slope: Vector3<f64>,
    seen: &Seen,
    row: u32,
    pixel: &Vector2<f64>,
) -> CloudPoint {
    let along = slope * seen.sigma_px;
    let covariance = along * along.transpose();
    CloudPoint {
        position_mm: point.into(),
        intensity: seen.amplitude as f32,
        frame_row: row,
        pixel: [pixel.x as f32, pixel.y as f32],
        sigma_mm: along.norm() as f32,
        covariance_mm2: [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|at| covariance[at] as f32),
        shared_mm: seen.shared_px.map(|shared_px| [0, 1, 2].map(|axis| (slope[axis] * shared_px) as f32)),
    }
}
