//! Fitted shapes as JSON and as text.

use nalgebra::DMatrix;
use serde::Serialize;
use uwscan::{
    cloud::{CircleFit, CylinderFit, Deviations, PlaneFit, ShapeFit, SphereFit},
    pipeline::report::HistogramRecord,
};

use crate::output::{decimals, plus_minus};

/// A covariance of a fit's parameters.
pub type Matrix = DMatrix<f64>;

/// A fitted shape, in JSON.
#[allow(missing_docs, reason = "the names are those of the JSON")]
#[derive(Serialize)]
#[serde(untagged)]
pub enum Record {
    /// A sphere.
    Sphere {
        radius_mm: f64,
        center_mm: [f64; 3],
        sigma_radius_mm: f64,
        sigma_center_mm: [f64; 3],
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_radius_mm: Option<f64>,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_center_mm: Option<[f64; 3]>,
        #[serde(flatten)]
        rest: Rest,
    },
    /// A plane.
    Plane {
        normal: [f64; 3],
        offset_mm: f64,
        sigma_normal: [f64; 3],
        sigma_normal_deg: f64,
        sigma_offset_mm: f64,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_normal: Option<[f64; 3]>,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_normal_deg: Option<f64>,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_offset_mm: Option<f64>,
        #[serde(flatten)]
        rest: Rest,
    },
    /// A cylinder.
    Cylinder {
        radius_mm: f64,
        axis_point_mm: [f64; 3],
        axis_direction: [f64; 3],
        extent_mm: [f64; 2],
        sigma_radius_mm: f64,
        sigma_axis_point_mm: [f64; 3],
        sigma_axis_direction: [f64; 3],
        sigma_axis_direction_deg: f64,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_radius_mm: Option<f64>,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_axis_point_mm: Option<[f64; 3]>,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_axis_direction: Option<[f64; 3]>,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_axis_direction_deg: Option<f64>,
        #[serde(flatten)]
        rest: Rest,
    },
    /// A circle.
    Circle {
        radius_mm: f64,
        center_mm: [f64; 3],
        normal: [f64; 3],
        sigma_radius_mm: f64,
        sigma_center_mm: [f64; 3],
        sigma_normal: [f64; 3],
        sigma_normal_deg: f64,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_radius_mm: Option<f64>,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_center_mm: Option<[f64; 3]>,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_normal: Option<[f64; 3]>,
        #[serde(skip_serializing_if = "Option::is_none")]
        sigma_total_normal_deg: Option<f64>,
        #[serde(flatten)]
        rest: Rest,
    },
}

/// What the fits of all shapes tell.
#[derive(Serialize)]
pub struct Rest {
    points: usize,
    outliers: usize,
    duplicates: usize,
    rms_mm: f64,
    max_outside_mm: f64,
    max_inside_mm: f64,
    scale: Option<f64>,
    floor_mm: Option<f64>,
    histogram: HistogramRecord,
}

impl Rest {
    fn new(d: &Deviations) -> Self {
        Self {
            points: d.points,
            outliers: d.outliers,
            duplicates: d.duplicates,
            rms_mm: d.rms_mm,
            max_outside_mm: d.max_outside_mm,
            max_inside_mm: d.max_inside_mm,
            scale: d.scale,
            floor_mm: d.floor_mm,
            histogram: (&d.histogram).into(),
        }
    }
}

/// A covariance's part: the standard deviations of three components, and of a direction that they are.
fn sigmas(covariance: &Matrix, first: usize) -> [f64; 3] {
    std::array::from_fn(|i| sigma(covariance, first + i))
}

fn sigma(covariance: &Matrix, at: usize) -> f64 {
    covariance[(at, at)].max(0.0).sqrt()
}

fn degrees(covariance: &Matrix, first: usize) -> f64 {
    let part = covariance.view((first, first), (3, 3)).into_owned();
    part.symmetric_eigenvalues().max().max(0.0).sqrt().to_degrees()
}

/// A sphere; `total` is its covariance with the calibration's part.
pub fn sphere(fit: &SphereFit, total: Option<&Matrix>) -> Record {
    Record::Sphere {
        radius_mm: fit.radius_mm,
        center_mm: fit.center_mm,
        sigma_radius_mm: fit.sigma_radius_mm,
        sigma_center_mm: fit.sigma_center_mm,
        sigma_total_radius_mm: total.map(|c| sigma(c, 3)),
        sigma_total_center_mm: total.map(|c| sigmas(c, 0)),
        rest: Rest::new(&fit.deviations),
    }
}

/// A plane, as [`sphere`].
pub fn plane(fit: &PlaneFit, total: Option<&Matrix>) -> Record {
    Record::Plane {
        normal: fit.normal,
        offset_mm: fit.offset_mm,
        sigma_normal: std::array::from_fn(|i| fit.covariance[(i, i)].max(0.0).sqrt()),
        sigma_normal_deg: fit.sigma_normal_rad.to_degrees(),
        sigma_offset_mm: fit.sigma_offset_mm,
        sigma_total_normal: total.map(|c| sigmas(c, 0)),
        sigma_total_normal_deg: total.map(|c| degrees(c, 0)),
        sigma_total_offset_mm: total.map(|c| sigma(c, 3)),
        rest: Rest::new(&fit.deviations),
    }
}

/// A cylinder, as [`sphere`].
pub fn cylinder(fit: &CylinderFit, total: Option<&Matrix>) -> Record {
    Record::Cylinder {
        radius_mm: fit.radius_mm,
        axis_point_mm: fit.axis_point_mm,
        axis_direction: fit.axis_direction,
        extent_mm: fit.extent_mm,
        sigma_radius_mm: fit.sigma_radius_mm,
        sigma_axis_point_mm: fit.sigma_axis_point_mm,
        sigma_axis_direction: std::array::from_fn(|i| fit.covariance[(3 + i, 3 + i)].max(0.0).sqrt()),
        sigma_axis_direction_deg: fit.sigma_direction_rad.to_degrees(),
        sigma_total_radius_mm: total.map(|c| sigma(c, 6)),
        sigma_total_axis_point_mm: total.map(|c| sigmas(c, 0)),
        sigma_total_axis_direction: total.map(|c| sigmas(c, 3)),
        sigma_total_axis_direction_deg: total.map(|c| degrees(c, 3)),
        rest: Rest::new(&fit.deviations),
    }
}

/// A circle, as [`sphere`].
pub fn circle(fit: &CircleFit, total: Option<&Matrix>) -> Record {
    Record::Circle {
        radius_mm: fit.radius_mm,
        center_mm: fit.center_mm,
        normal: fit.normal,
        sigma_radius_mm: fit.sigma_radius_mm,
        sigma_center_mm: fit.sigma_center_mm,
        sigma_normal: std::array::from_fn(|i| fit.covariance[(3 + i, 3 + i)].max(0.0).sqrt()),
        sigma_normal_deg: fit.sigma_normal_rad.to_degrees(),
        sigma_total_radius_mm: total.map(|c| sigma(c, 6)),
        sigma_total_center_mm: total.map(|c| sigmas(c, 0)),
        sigma_total_normal: total.map(|c| sigmas(c, 3)),
        sigma_total_normal_deg: total.map(|c| degrees(c, 3)),
        rest: Rest::new(&fit.deviations),
    }
}

/// A shape of any kind, as [`sphere`]; `None` for a kind that this version has no record for.
pub fn shape(fit: &ShapeFit, total: Option<&Matrix>) -> Option<Record> {
    match fit {
        ShapeFit::Sphere(fit) => Some(sphere(fit, total)),
        ShapeFit::Plane(fit) => Some(plane(fit, total)),
        ShapeFit::Cylinder(fit) => Some(cylinder(fit, total)),
        _ => None,
    }
}

/// A value with its sigma, and with the calibration's part where that is known.
pub fn with_total(value: f64, sigma: f64, total: Option<f64>) -> String {
    let text = plus_minus(value, Some(sigma));
    match total {
        Some(total) => format!("{text} (± {total:.*} with the calibration)", decimals(total)),
        None => text,
    }
}

fn vector(values: [f64; 3], sigmas: [f64; 3]) -> String {
    let components: Vec<String> =
        std::iter::zip(values, sigmas).map(|(value, sigma)| plus_minus(value, Some(sigma))).collect();
    components.join(",  ")
}

fn direction(values: [f64; 3], sigmas: [f64; 3], degrees: f64, total: Option<f64>) -> String {
    let total = total.map_or_else(String::new, |total| format!(", {total:.4}° with the calibration"));
    format!("{} (± {degrees:.4}° in its least certain direction{total})", vector(values, sigmas))
}

fn place(values: [f64; 3], sigmas: [f64; 3], total: Option<[f64; 3]>) -> String {
    let total = total.map_or_else(String::new, |[x, y, z]| {
        format!("\n              with the calibration ± {x:.4},  {y:.4},  {z:.4}")
    });
    format!("{} mm{total}", vector(values, sigmas))
}

impl Record {
    /// The figures for people, a line each, without the shape's name; `known`: the radius was given.
    pub fn text(&self, known: bool, frame: &str) -> String {
        let radius = |value: f64, sigma: f64, total: Option<f64>| match known {
            true => format!("{value} mm, as given"),
            false => format!("{} mm", with_total(value, sigma, total)),
        };
        match self {
            Self::Sphere {
                radius_mm,
                center_mm,
                sigma_radius_mm,
                sigma_center_mm,
                sigma_total_radius_mm,
                sigma_total_center_mm,
                rest,
            } => format!(
                "  radius      {}\n  centre      {}\n{}",
                radius(*radius_mm, *sigma_radius_mm, *sigma_total_radius_mm),
                place(*center_mm, *sigma_center_mm, *sigma_total_center_mm),
                rest.text("outside", "inside", frame)
            ),
            Self::Plane {
                normal,
                offset_mm,
                sigma_normal,
                sigma_normal_deg,
                sigma_offset_mm,
                sigma_total_normal_deg,
                sigma_total_offset_mm,
                rest,
                ..
            } => format!(
                "  normal      {}\n  offset      {} mm\n{}",
                direction(*normal, *sigma_normal, *sigma_normal_deg, *sigma_total_normal_deg),
                with_total(*offset_mm, *sigma_offset_mm, *sigma_total_offset_mm),
                rest.text("on the sensor's side", "behind", frame)
            ),
            Self::Cylinder {
                radius_mm,
                axis_point_mm,
                axis_direction,
                extent_mm,
                sigma_radius_mm,
                sigma_axis_point_mm,
                sigma_axis_direction,
                sigma_axis_direction_deg,
                sigma_total_radius_mm,
                sigma_total_axis_point_mm,
                sigma_total_axis_direction_deg,
                rest,
                ..
            } => format!(
                "  radius      {}\n  axis        {}\n  direction   {}\n  length      {:.2} mm seen\n{}",
                radius(*radius_mm, *sigma_radius_mm, *sigma_total_radius_mm),
                place(*axis_point_mm, *sigma_axis_point_mm, *sigma_total_axis_point_mm),
                direction(
                    *axis_direction,
                    *sigma_axis_direction,
                    *sigma_axis_direction_deg,
                    *sigma_total_axis_direction_deg
                ),
                extent_mm[1] - extent_mm[0],
                rest.text("outside", "inside", frame)
            ),
            Self::Circle {
                radius_mm,
                center_mm,
                normal,
                sigma_radius_mm,
                sigma_center_mm,
                sigma_normal,
                sigma_normal_deg,
                sigma_total_radius_mm,
                sigma_total_center_mm,
                sigma_total_normal_deg,
                rest,
                ..
            } => format!(
                "  radius      {}\n  centre      {}\n  normal      {}\n{}",
                radius(*radius_mm, *sigma_radius_mm, *sigma_total_radius_mm),
                place(*center_mm, *sigma_center_mm, *sigma_total_center_mm),
                direction(*normal, *sigma_normal, *sigma_normal_deg, *sigma_total_normal_deg),
                rest.text("farther from the axis", "nearer to it", frame)
            ),
        }
    }
}

impl Rest {
    fn text(&self, outside: &str, inside: &str, frame: &str) -> String {
        let mut text = format!(
            "  deviations  {:.4} mm rms, {:.4} mm at most {outside}, {:.4} mm {inside}\n  points      {} ({} outliers, {} \
             duplicates left out), {frame} frame\n",
            self.rms_mm, self.max_outside_mm, self.max_inside_mm, self.points, self.outliers, self.duplicates,
        );
        match (self.scale, self.floor_mm) {
            (Some(scale), Some(floor_mm)) => {
                text += &format!(
                    "  scatter     {:.2} times what the points' covariances and a floor of {floor_mm:.4} mm explain\n",
                    scale.sqrt()
                );
            }
            _ => text += "  scatter     is the sigma: the points have no covariances\n",
        }
        text
    }
}
