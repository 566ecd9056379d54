//! A cloud in space, as the page carries it: thinned, and coloured by what it tells.

use crate::pipeline::report::scan::Scan;
use uw_cloud::{Frame, PointCloud, TriangleMesh};
use uw_report::{Colouring, Rgb, Scale, View};

/// Points that a page carries of one cloud: with two colourings a third of a megabyte.
const MOST_POINTS: usize = 24_000;

/// Colours of shapes, in their order: Okabe and Ito's, without black.
const SHAPES: [Rgb; 7] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [240, 228, 66],
];
const NO_SHAPE: Rgb = [130, 130, 130];

/// Which way is up, and towards whoever stands at the sensor.
fn stance(frame: Frame) -> ([f64; 3], [f64; 3]) {
    match frame {
        Frame::Camera => ([0.0, -1.0, 0.0], [0.0, 0.0, -1.0]),
        Frame::Galvo => ([1.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
    }
}

/// Every so-manieth point is carried, so that density shows as it is.
pub(crate) fn step(points: usize) -> usize {
    points.div_ceil(MOST_POINTS).max(1)
}

/// The points that a page carries.
fn thinned(points: usize) -> Vec<usize> {
    (0..points).step_by(step(points)).collect()
}

/// A round number that is not less: 1, 2 or 5 times a power of ten.
pub(crate) fn rounded_up(value: f64) -> f64 {
    if !(value > 0.0 && value.is_finite()) {
        return 1.0;
    }
    let ten = 10_f64.powf(value.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|n| n * ten).find(|n| *n >= value * (1.0 - 1e-9)).unwrap_or(value)
}

/// How far a scale of deviations goes: what 97 of 100 are within, rounded up.
pub(crate) fn reach(deviations_mm: &[f32]) -> Option<f64> {
    let mut sizes: Vec<f32> = deviations_mm.iter().map(|d| d.abs()).filter(|d| d.is_finite()).collect();
    sizes.sort_by(f32::total_cmp);
    let at = (0.97 * (sizes.len().checked_sub(1)? as f64)).round() as usize;
    Some(rounded_up(f64::from(*sizes.get(at)?)))
}

fn by_depth(points: &[[f64; 3]]) -> Colouring {
    let depths: Vec<f64> = points.iter().map(|p| p[2]).collect();
    let (low, high) =
        depths.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), d| (l.min(*d), h.max(*d)));
    // Near is light.
    let scale = Scale::sequential([low, high]);
    let colours = depths.iter().map(|d| scale.colour(low + high - d)).collect();
    Colouring { name: format!("depth: {low:.0} mm (light) to {high:.0} mm (dark)"), colours, scale: None }
}

/// A scan's points by deviation, where they have any, by shape, and by depth.
pub(crate) fn scan(scan: &Scan, of: &str) -> View {
    let kept = thinned(scan.cloud.len());
    let points_mm: Vec<[f64; 3]> = kept.iter().map(|&i| scan.cloud.positions_mm()[i]).collect();
    let mut colourings = Vec::new();
    if let Some(reach) = reach(&scan.deviations_mm) {
        let scale = Scale::diverging(reach);
        let colours = kept.iter().map(|&i| scale.colour(f64::from(scan.deviations_mm[i]))).collect();
        let scale = Some((scale, "mm".to_owned()));
        colourings.push(Colouring { name: format!("deviation from {of}"), colours, scale });
    }
    if !scan.shapes.is_empty() {
        let colour = |shape: Option<usize>| shape.map_or(NO_SHAPE, |at| SHAPES[at % SHAPES.len()]);
        let colours = kept.iter().map(|&i| colour(scan.shape_of[i])).collect();
        colourings.push(Colouring { name: "shape".to_owned(), colours, scale: None });
    }
    colourings.push(by_depth(&points_mm));
    let (up, towards_eye) = stance(scan.cloud.frame());
    View {
        caption: format!("{}: {} of {} points.", scan.record.name, kept.len(), scan.cloud.len()),
        description: format!(
            "The points of {} in space, seen from the sensor at first; the figures in the tables say what they measure.",
            scan.record.name
        ),
        points_mm,
        triangles: Vec::new(),
        colourings,
        up,
        towards_eye,
    }
}

/// A cloud's points by depth.
pub(crate) fn cloud(cloud: &PointCloud, caption: String, description: String) -> View {
    let points_mm: Vec<[f64; 3]> =
        thinned(cloud.len()).into_iter().map(|i| cloud.positions_mm()[i]).collect();
    let (up, towards_eye) = stance(cloud.frame());
    let colourings = vec![by_depth(&points_mm)];
    View { caption, description, points_mm, triangles: Vec::new(), colourings, up, towards_eye }
}

/// A surface by depth.
pub(crate) fn surface(mesh: &TriangleMesh, caption: String, description: String) -> View {
    let points_mm = mesh.vertices_mm().to_vec();
    let (up, towards_eye) = stance(mesh.frame());
    let colourings = vec![by_depth(&points_mm)];
    View {
        caption,
        description,
        triangles: mesh.triangles().to_vec(),
        points_mm,
        colourings,
        up,
        towards_eye,
    }
}

/// A cloud's points across the view: to the right and up, mm, as whoever stands at the sensor sees them.
pub(crate) fn across(cloud: &PointCloud) -> (Vec<[f64; 2]>, [&'static str; 2]) {
    let of = |p: &[f64; 3]| match cloud.frame() {
        Frame::Camera => [p[0], -p[1]],
        Frame::Galvo => [p[1], p[0]],
    };
    let labels = match cloud.frame() {
        Frame::Camera => ["x, mm", "−y, mm"],
        Frame::Galvo => ["y, mm", "x, mm"],
    };
    (cloud.positions_mm().iter().map(of).collect(), labels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_end_at_round_numbers() {
        for (value, round) in
            [(0.034, 0.05), (0.1, 0.1), (0.11, 0.2), (7.0, 10.0), (0.0, 1.0), (f64::NAN, 1.0)]
        {
            assert!((rounded_up(value) - round).abs() < 1e-12, "{value}");
        }
        assert_eq!(reach(&[f32::NAN]), None);
        assert!((reach(&[0.01, -0.02, f32::NAN]).unwrap() - 0.02).abs() < 1e-9);
    }

    #[test]
    fn large_clouds_are_thinned_evenly() {
        assert_eq!(thinned(100).len(), 100);
        assert_eq!(thinned(0).len(), 0);
        let many = thinned(1_000_000);
        assert!(many.len() <= MOST_POINTS && many.len() > MOST_POINTS / 2);
    }
}
