//! Triangles that span what was not sampled: in the image, and as the light sees them.

use super::delaunay::{Flat, circle};
use super::noise::Noise;
use super::normals::Incident;
use crate::cloud::PointCloud;
use crate::neighbours::MANY;
use crate::robust::median;
use rayon::prelude::*;

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

/// Vertices that a thread looks at in one go.
const PART: u32 = 8192;

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
    let mut about = Surroundings::new(flat, incident, |t| sound(t).then(|| circles[t as usize].1));
    let mut asked: Vec<u32> = (0..circles.len() as u32).collect();
    for _ in 0..PASSES {
        let in_image = |t: u32| {
            let (radius2, twice) = circles[t as usize];
            let [least, middle, most] = sorted(&flat.triangles[t as usize], &about.typical);
            // Of two that are known, the denser one.
            let (denser, sparsest) =
                if most.is_finite() { (middle, most) } else { (least, middle.min(most)) };
            // The plane's area that falls to a point is that of two triangles.
            if !(denser.is_finite() && radius2 <= largest * denser / MEDIAN_OF_MEAN) {
                Span::Void
            } else if twice > INCOMPLETE * if sparsest.is_finite() { sparsest } else { least } {
                Span::Incomplete
            } else {
                Span::Neighbours
            }
        };
        // Triangles across voids, which may be most of those at a corner, tell nothing of its surroundings.
        let mut changed: Vec<u32> = Vec::new();
        for &t in &asked {
            let next = in_image(t);
            let before = std::mem::replace(&mut spans[t as usize], next);
            if (next == Span::Void) != (before == Span::Void) {
                changed.extend(flat.triangles[t as usize]);
            }
        }
        if changed.is_empty() {
            break;
        }
        let tells = |t: u32| (sound(t) && spans[t as usize] != Span::Void).then(|| circles[t as usize].1);
        asked = about.again(flat, incident, changed, tells);
    }
    let Some(lit) = lit_areas(cloud, flat, noise) else { return spans };
    let about = Surroundings::new(flat, incident, |t| {
        let told = sound(t) && spans[t as usize] != Span::Void && lit[t as usize] > 0.0;
        told.then(|| lit[t as usize])
    });
    for ((span, corners), lit) in spans.iter_mut().zip(&flat.triangles).zip(&lit) {
        let known = sorted(corners, &about.typical).into_iter().rev().find(|value| value.is_finite());
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

/// What triangles near each vertex are typically like: the median over it and its neighbours of the medians over their triangles;
/// infinite where none tells.
struct Surroundings {
    own: Vec<f64>,
    typical: Vec<f64>,
}

impl Surroundings {
    fn new(flat: &Flat, incident: &Incident, tells: impl Fn(u32) -> Option<f64> + Sync) -> Self {
        let vertices = incident.vertices();
        let of_all = |one: &(dyn Fn(u32, &mut Vec<f64>) -> f64 + Sync)| -> Vec<f64> {
            let some = |range: std::ops::Range<u32>| {
                let mut values = Vec::new();
                range.map(|v| one(v, &mut values)).collect::<Vec<f64>>()
            };
            if (vertices as usize) < MANY {
                return some(0..vertices);
            }
            let parts = (0..vertices.div_ceil(PART)).into_par_iter();
            parts.flat_map_iter(|p| some(p * PART..vertices.min((p + 1) * PART))).collect()
        };
        let own = of_all(&|v, values| own(v, incident, &tells, values));
        let typical = of_all(&|v, values| typical(v, flat, incident, &own, values));
        Self { own, typical }
    }

    /// Asks again where triangles tell something else now, given by their corners, and returns the triangles whose surroundings that may change.
    fn again(
        &mut self,
        flat: &Flat,
        incident: &Incident,
        mut changed: Vec<u32>,
        tells: impl Fn(u32) -> Option<f64>,
    ) -> Vec<u32> {
        let mut values = Vec::new();
        let unique = |list: &mut Vec<u32>| {
            list.sort_unstable();
            list.dedup();
        };
        unique(&mut changed);
        changed.iter().for_each(|&v| self.own[v as usize] = own(v, incident, &tells, &mut values));
        let corners = |v: &u32| incident.of(*v).iter().flat_map(|&t| flat.triangles[t as usize]);
        let mut near: Vec<u32> = changed.iter().flat_map(corners).collect();
        unique(&mut near);
        for &v in &near {
            self.typical[v as usize] = typical(v, flat, incident, &self.own, &mut values);
        }
        let mut asked: Vec<u32> = near.iter().flat_map(|&v| incident.of(v)).copied().collect();
        unique(&mut asked);
        asked
    }
}

/// The median over a vertex's triangles.
fn own(v: u32, incident: &Incident, tells: &impl Fn(u32) -> Option<f64>, values: &mut Vec<f64>) -> f64 {
    values.clear();
    values.extend(incident.of(v).iter().filter_map(|&t| tells(t)));
    middle(values)
}

/// The median over a vertex, half as often as it has triangles, and its neighbours.
fn typical(v: u32, flat: &Flat, incident: &Incident, own: &[f64], values: &mut Vec<f64>) -> f64 {
    values.clear();
    for (n, &t) in incident.of(v).iter().enumerate() {
        let corners = flat.triangles[t as usize];
        // Going round, each triangle has the next neighbour.
        let next = if corners[0] == v {
            corners[1]
        } else if corners[1] == v {
            corners[2]
        } else {
            corners[0]
        };
        values.extend(Some(own[next as usize]).filter(|value| value.is_finite()));
        values.extend(Some(own[v as usize]).filter(|value| n % 2 == 0 && value.is_finite()));
    }
    middle(values)
}

/// The median, the upper one of an even number; infinite of none.
fn middle(values: &mut [f64]) -> f64 {
    const FEW: usize = 24;
    match values.len() {
        0 => f64::INFINITY,
        // All are numbers: of so few that are put in order one by one.
        1..=FEW => {
            for sorted in 1..values.len() {
                let own = values[sorted];
                let mut at = sorted;
                while at > 0 && values[at - 1] > own {
                    values[at] = values[at - 1];
                    at -= 1;
                }
                values[at] = own;
            }
            values[values.len() / 2]
        }
        _ => median(values),
    }
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
