//! A calibration's figures with their sigmas, for JSON and for people.

use std::fmt::Write;

use serde::Serialize;
use uwscan::calib::{Calibration, Method, Quantity, Statistics};

use crate::output::plus_minus;

/// The method as arguments and JSON name it.
pub fn method_name(method: Method) -> &'static str {
    match method {
        Method::Joint => "joint",
        Method::Paper => "paper",
    }
}

/// The calibrated figures, or the standard deviation of each.
#[derive(Debug, Serialize)]
pub struct Figures {
    camera: Camera,
    galvo: Galvo,
}

#[derive(Debug, Serialize)]
struct Camera {
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    k3: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Galvo {
    axis_point_mm: Option<[f64; 3]>,
    axis_direction: Option<[f64; 3]>,
    degrees_per_volt: Option<f64>,
}

impl Figures {
    /// The values.
    pub fn values(quantities: &[Quantity]) -> Self {
        Self::of(quantities, |q| q.value)
    }

    /// The standard deviations; `None` for a calibration without a covariance.
    pub fn sigmas(calibration: &Calibration, quantities: &[Quantity]) -> Option<Self> {
        calibration.covariance.as_ref().map(|_| Self::of(quantities, |q| q.sigma))
    }

    fn of(quantities: &[Quantity], part: impl Fn(&Quantity) -> f64) -> Self {
        let get = |name: &str| quantities.iter().find(|q| q.name == name).map(&part);
        let vector = |[x, y, z]: [&str; 3]| Some([get(x)?, get(y)?, get(z)?]);
        let point = ["galvo.axis_point_x_mm", "galvo.axis_point_y_mm", "galvo.axis_point_z_mm"];
        let direction = ["galvo.axis_direction_x", "galvo.axis_direction_y", "galvo.axis_direction_z"];
        Self {
            camera: Camera {
                fx: get("camera.fx_px"),
                fy: get("camera.fy_px"),
                cx: get("camera.cx_px"),
                cy: get("camera.cy_px"),
                k1: get("camera.k1"),
                k2: get("camera.k2"),
                p1: get("camera.p1"),
                p2: get("camera.p2"),
                k3: get("camera.k3"),
            },
            galvo: Galvo {
                axis_point_mm: vector(point),
                axis_direction: vector(direction),
                degrees_per_volt: get("galvo.degrees_per_volt"),
            },
        }
    }
}

/// An image by its residuals, in JSON.
#[derive(Debug, Serialize)]
pub struct Worst<'a> {
    file: &'a str,
    rms_px: f64,
    max_px: f64,
}

/// A pair of parameters that the data hardly tell apart, in JSON.
#[derive(Debug, Serialize)]
pub struct Correlated<'a> {
    a: &'a str,
    b: &'a str,
    correlation: f64,
}

/// An image that was left out, in JSON.
#[derive(Debug, Serialize)]
pub struct Rejected<'a> {
    file: &'a str,
    reason: &'a str,
}

/// What remained, and how many took part, in JSON.
#[derive(Debug, Serialize)]
pub struct Remains<'a> {
    reprojection_rms_px: f64,
    stripe_rms_px: f64,
    stripe_rms_mm: f64,
    poses_used: usize,
    frames_used: usize,
    corners: usize,
    corners_rejected: usize,
    stripe_points: usize,
    stripe_points_rejected: usize,
    worst: Vec<Worst<'a>>,
    correlated: Vec<Correlated<'a>>,
    rejected: Vec<Rejected<'a>>,
}

impl<'a> Remains<'a> {
    /// Of a calibration.
    pub fn new(s: &'a Statistics) -> Self {
        let worst =
            |w: &'a uwscan::calib::WorstImage| Worst { file: &w.file, rms_px: w.rms_px, max_px: w.max_px };
        let rejected = |r: &'a uwscan::calib::Rejected| Rejected { file: &r.file, reason: &r.reason };
        let pairs = s.correlated.iter();
        Self {
            reprojection_rms_px: s.reprojection_rms_px,
            stripe_rms_px: s.stripe_rms_px,
            stripe_rms_mm: s.stripe_rms_mm,
            poses_used: s.poses_used,
            frames_used: s.frames_used,
            corners: s.corners,
            corners_rejected: s.corners_rejected,
            stripe_points: s.stripe_points,
            stripe_points_rejected: s.stripe_points_rejected,
            worst: s.worst.iter().map(worst).collect(),
            correlated: pairs.map(|p| Correlated { a: p.a, b: p.b, correlation: p.correlation }).collect(),
            rejected: s.rejected.iter().map(rejected).collect(),
        }
    }
}

/// Worst and rejected images listed unless all are asked for.
const LISTED: usize = 5;

/// What remained, for people: RMS, worst and rejected images, most correlated pairs.
pub fn remains_text(s: &Statistics, all: bool) -> String {
    let listed = if all { usize::MAX } else { LISTED };
    let mut text = format!(
        "residuals\n  corners  {:.4} px rms ({} used, {} rejected)\n  stripes  {:.4} px rms, {:.4} mm rms on the board \
         ({} used, {} left out)\n",
        s.reprojection_rms_px,
        s.corners,
        s.corners_rejected,
        s.stripe_rms_px,
        s.stripe_rms_mm,
        s.stripe_points,
        s.stripe_points_rejected
    );
    if !s.worst.is_empty() {
        text += "  worst images\n";
    }
    for worst in s.worst.iter().take(listed) {
        _ = writeln!(text, "    {:.3} px rms, {:.3} px at most  {}", worst.rms_px, worst.max_px, worst.file);
    }
    if !s.rejected.is_empty() {
        _ = writeln!(text, "rejected images: {}", s.rejected.len());
    }
    for rejected in s.rejected.iter().take(listed) {
        _ = writeln!(text, "  {}: {}", rejected.file, rejected.reason);
    }
    if let Some(more @ 1..) = s.rejected.len().checked_sub(listed) {
        _ = writeln!(text, "  and {more} more; --verbose names them");
    }
    if !s.correlated.is_empty() {
        text += "hardly told apart (correlation)\n";
    }
    for pair in &s.correlated {
        _ = writeln!(text, "  {:+.4}  {} and {}", pair.correlation, pair.a, pair.b);
    }
    text
}

/// Every figure beside its sigma, for people: a line each, the components of a vector on one.
pub fn figures_text(calibration: &Calibration, quantities: &[Quantity]) -> String {
    let known = calibration.covariance.is_some();
    let shown = |q: &Quantity| plus_minus(q.value, known.then_some(q.sigma));
    let mut text =
        String::from(if known { "figures ± 1 sigma\n" } else { "figures (this method gives no sigmas)\n" });
    let mut rest = quantities;
    while let [first, tail @ ..] = rest {
        let name = without_component(first.name);
        let width = match tail {
            [second, third, ..]
                if [second, third].iter().all(|q| without_component(q.name) == name && q.name != name) =>
            {
                3
            }
            _ => 1,
        };
        let (now, later) = rest.split_at(width);
        let values: Vec<String> = now.iter().map(shown).collect();
        let name = if width == 1 { first.name } else { &name };
        _ = writeln!(text, "  {name:<27} {}", values.join(",  "));
        rest = later;
    }
    text
}

/// A quantity's name without the component of the vector that it is: `galvo.axis_point_x_mm` → `galvo.axis_point_mm`.
fn without_component(name: &str) -> String {
    let is_component = |part: &&str| matches!(*part, "x" | "y" | "z");
    name.split('_').filter(|part| !is_component(part)).collect::<Vec<_>>().join("_")
}

#[cfg(test)]
mod tests {
    use super::without_component;

    #[test]
    fn components_lose_their_letter_and_nothing_else() {
        assert_eq!(without_component("galvo.axis_point_x_mm"), "galvo.axis_point_mm");
        assert_eq!(without_component("camera.port.normal_z"), "camera.port.normal");
        assert_eq!(without_component("camera.fx_px"), "camera.fx_px");
    }
}
