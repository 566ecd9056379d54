//! Triangles that span what was not sampled: in the image, and as the light sees them.

use super::delaunay::{Flat, circle};
use super::noise::Noise;
use super::normals::Incident;
use crate::cloud::PointCloud;
use crate::robust::median;

/// Chance that points thrown at random with a scan's density leave as large a void anywhere in it.
const CHANCE_OF_A_VOID: f64 = 0.01;

/// A circumcircle's squared radius over twice its triangle's area from which on the triangle is a sliver. In a grid whose spacings
/// differ tenfold it is 2.5.
const SLIVER: f64 = 4.0;

/// Median over mean of the areas of Delaunay's triangles of points thrown at random, slivers aside (by simulation).
const MEDIAN_OF_MEAN: f64 = 0.77;

/// Area in units of its surroundings' from which on a triangle spans more than neighbours. However the points of a regular grid are
/// joined, with nothing between them, each triangle has half a cell; it is a whole one where one stripe is left out. Half-way.
const INCOMPLETE: f64 = 1.5;

/// A triangle that the light sees from behind has minus half a cell at least; one along the light has none. Half-way.
const BEHIND: f64 = -0.5;

/// Rounds of telling voids from surroundings that are none.
const PASSES: usize = 10;

/// What the spacing of points tells of each triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Span {
    /// Its corners are neighbours.
    Neighbours,
    /// Something was not seen between its corners.
    Incomplete,
    /// It spans a void.
    Void,
    /// The light, which goes from corner to corner in the other order than the sight does, can't have lit it.
    Unlit,
}

/// Returns what each triangle spans.
///
/// Both the camera's image and the light's sheets sample a surface, and each sees voids that the other does not: behind an outline the
/// light goes on over what the camera can't see, and the image closes up; in a shadow it is the other way round. A
/// triangle's area as the light sees it, along the direction in which its points are least certain, does not depend on the surface's
/// slope, nor on the points' errors.
pub(super) fn spans(
    cloud: &PointCloud,
    places: &[[f64; 2]],
    flat: &Flat,
    incident: &Incident,
    noise: &Noise<'_>,
) -> Vec<Span> {
    let of = |corners: &[u32; 3]| circle(corners.map(|v| places[v as usize]));
    let circles: Vec<(f64, f64)> = flat.triangles.iter().map(of).collect();
    let sound = |t: u32| circles[t as usize].0 < SLIVER * circles[t as usize].1;
    let largest = (circles.len() as f64 / CHANCE_OF_A_VOID).ln() / std::f64::consts::PI;
    let mut spans = vec![Span::Neighbours; circles.len()];
    for _ in 0..PASSES {
        // Triangles across voids, which may be most of those at a corner, tell nothing of its surroundings.
        let tells = |t: u32| (sound(t) && spans[t as usize] != Span::Void).then(|| circles[t as usize].1);
        let about = surroundings(flat, incident, places.len(), tells);
        let in_image = |(corners, (radius2, twice)): (&[u32; 3], &(f64, f64))| {
            let [least, middle, most] = sorted(corners, &about);
            // Of two that are known, the denser one.
            let (denser, sparsest) =
                if most.is_finite() { (middle, most) } else { (least, middle.min(most)) };
            // The plane's area that falls to a point is that of two triangles.
            if !(denser.is_finite() && *radius2 <= largest * denser / MEDIAN_OF_MEAN) {
                Span::Void
            } else if *twice > INCOMPLETE * if sparsest.is_finite() { sparsest } else { least } {
                Span::Incomplete
            } else {
                Span::Neighbours
            }
        };
        let voids = |spans: &[Span]| spans.iter().filter(|span| **span == Span::Void).count();
        let before = voids(&spans);
        spans = flat.triangles.iter().zip(&circles).map(in_image).collect();
        if voids(&spans) == before {
            break;
        }
    }
    let Some(lit) = lit_areas(cloud, flat, noise) else { return spans };
    let tells = |t: u32| {
        let told = sound(t) && spans[t as usize] != Span::Void && lit[t as usize] > 0.0;
        told.then(|| lit[t as usize])
    };
    let about = surroundings(flat, incident, places.len(), tells);
    for ((span, corners), lit) in spans.iter_mut().zip(&flat.triangles).zip(&lit) {
        let known = sorted(corners, &about).into_iter().rev().find(|value| value.is_finite());
        let sparsest = known.unwrap_or(f64::INFINITY);
        match *span {
            Span::Void => {}
            _ if *lit < BEHIND * sparsest => *span = Span::Unlit,
            Span::Neighbours if *lit > INCOMPLETE * sparsest => *span = Span::Incomplete,
            _ => {}
        }
    }
    spans
}

/// Values of a triangle's corners, the least first.
fn sorted(corners: &[u32; 3], about: &[f64]) -> [f64; 3] {
    let mut three = corners.map(|v| about[v as usize]);
    three.sort_by(f64::total_cmp);
    three
}

/// Returns for each vertex what triangles near it are typically like: the median over its neighbours of the medians over their
/// triangles; infinite where none tells.
fn surroundings(
    flat: &Flat,
    incident: &Incident,
    vertices: usize,
    tells: impl Fn(u32) -> Option<f64>,
) -> Vec<f64> {
    let mut values = Vec::new();
    let mut middle = |found: &mut dyn Iterator<Item = f64>| {
        values.clear();
        values.extend(found);
        if values.is_empty() { f64::INFINITY } else { median(&mut values) }
    };
    let own: Vec<f64> =
        (0..vertices as u32).map(|v| middle(&mut incident.of(v).iter().filter_map(|&t| tells(t)))).collect();
    // Every neighbour comes twice, the vertex itself as often as it has triangles.
    let near = |v: u32| incident.of(v).iter().flat_map(|&t| flat.triangles[t as usize]);
    (0..vertices as u32)
        .map(|v| middle(&mut near(v).map(|w| own[w as usize]).filter(|value| value.is_finite())))
        .collect()
}

/// Returns twice the triangles' areas as the light sees them, mm², negative from behind; `None` where the cloud does not tell where
/// the light came from.
fn lit_areas(cloud: &PointCloud, flat: &Flat, noise: &Noise<'_>) -> Option<Vec<f64>> {
    if !noise.tells_light() {
        return None;
    }
    // Not a number, and so neither small nor large, where the cloud is silent about one point.
    let lit = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| cloud.vector(v as usize));
        noise.light(corners[0]).map_or(f64::NAN, |light| (b - a).cross(&(c - a)).dot(&light))
    };
    let mut areas: Vec<f64> = flat.triangles.iter().map(lit).collect();
    let towards: i64 = areas.iter().map(|area| if *area < 0.0 { -1 } else { 1 }).sum();
    if towards < 0 {
        areas.iter_mut().for_each(|area| *area = -*area);
    }
    Some(areas)
}
