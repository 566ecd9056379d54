//! Triangles that span what was not sampled: in the image, and as the light sees them.

use super::delaunay::{Flat, circle};
use super::noise::Noise;
use super::normals::{Incident, unique};
use crate::cloud::PointCloud;
use crate::neighbours::MANY;
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
const PART: usize = 8192;

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
    let sound = |t: usize| circles[t].0 < SLIVER * circles[t].1;
    let largest = (circles.len() as f64 / CHANCE_OF_A_VOID).ln() / std::f64::consts::PI;
    let mut spans = vec![Span::Neighbours; circles.len()];
    // Triangles across voids, which may be most of those at a corner, tell nothing of its surroundings.
    let tells =
        |t: usize, span: Span| if sound(t) && span != Span::Void { circles[t].1 } else { f64::INFINITY };
    let mut telling: Vec<f64> = (0..circles.len()).map(|t| tells(t, spans[t])).collect();
    let mut about = Surroundings::new(incident, &telling);
    let in_image = |t: usize, typical: &[f64]| {
        let (radius2, twice) = circles[t];
        let [least, middle, most] = sorted(&flat.triangles[t], typical);
        // Of two that are known, the denser one.
        let (denser, sparsest) = if most.is_finite() { (middle, most) } else { (least, middle.min(most)) };
        // The plane's area that falls to a point is that of two triangles.
        if !(denser.is_finite() && radius2 <= largest * denser / MEDIAN_OF_MEAN) {
            Span::Void
        } else if twice > INCOMPLETE * if sparsest.is_finite() { sparsest } else { least } {
            Span::Incomplete
        } else {
            Span::Neighbours
        }
    };
    let mut asked: Vec<u32> = (0..circles.len() as u32).collect();
    for _ in 0..PASSES {
        let mut changed: Vec<u32> = Vec::new();
        for t in asked.iter().map(|t| *t as usize) {
            let next = in_image(t, &about.typical);
            let before = std::mem::replace(&mut spans[t], next);
            if (next == Span::Void) != (before == Span::Void) {
                telling[t] = tells(t, next);
                changed.extend(flat.triangles[t]);
            }
        }
        if changed.is_empty() {
            break;
        }
        asked = about.again(incident, changed, &telling);
    }
    // Few triangles tell little: what they call a void by chance is none to all those about it that are beyond doubt.
    let suspects: Vec<usize> = (0..spans.len()).filter(|&t| spans[t] == Span::Void).collect();
    about.widen(incident, suspects.iter().flat_map(|&t| flat.triangles[t]).collect(), &telling);
    suspects.iter().for_each(|&t| spans[t] = in_image(t, &about.typical));
    let Some(lit) = lit_areas(cloud, flat, noise) else { return spans };
    let tells = |t: usize| sound(t) && spans[t] != Span::Void && lit[t] > 0.0;
    let telling: Vec<f64> = (0..lit.len()).map(|t| if tells(t) { lit[t] } else { f64::INFINITY }).collect();
    let about = Surroundings::new(incident, &telling);
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
    let in_order = |a: f64, b: f64| if b < a { (b, a) } else { (a, b) };
    let [a, b, c] = *corners;
    let (a, b) = in_order(about[a as usize], about[b as usize]);
    let (b, c) = in_order(b, about[c as usize]);
    let (a, b) = in_order(a, b);
    [a, b, c]
}

/// What triangles near each vertex are typically like: the median over it and its neighbours of the medians over their triangles;
/// infinite where none tells.
struct Surroundings {
    own: Vec<f64>,
    typical: Vec<f64>,
}

impl Surroundings {
    /// `telling` is what each triangle tells, infinite where that is nothing.
    fn new(incident: &Incident, telling: &[f64]) -> Self {
        let vertices = incident.vertices();
        let of_all = |one: &(dyn Fn(u32) -> f64 + Sync)| -> Vec<f64> {
            if (vertices as usize) < MANY {
                return (0..vertices).map(one).collect();
            }
            (0..vertices).into_par_iter().with_min_len(PART).map(one).collect()
        };
        let own = of_all(&|v| own(v, incident, telling));
        let typical = of_all(&|v| typical(v, incident, &own));
        Self { own, typical }
    }

    /// Asks again where triangles tell something else now, given by their corners, and returns the triangles whose surroundings that may change.
    fn again(&mut self, incident: &Incident, mut changed: Vec<u32>, telling: &[f64]) -> Vec<u32> {
        unique(&mut changed);
        changed.iter().for_each(|&v| self.own[v as usize] = own(v, incident, telling));
        let mut near = changed.clone();
        near.extend(changed.iter().flat_map(|&v| incident.next(v)));
        unique(&mut near);
        near.iter().for_each(|&v| self.typical[v as usize] = typical(v, incident, &self.own));
        incident.about(&near)
    }

    /// Asks twice as far around some vertices.
    fn widen(&mut self, incident: &Incident, mut vertices: Vec<u32>, telling: &[f64]) {
        unique(&mut vertices);
        vertices.iter().for_each(|&v| self.typical[v as usize] = widely(v, incident, telling));
    }
}

/// Values that are put in order without a branch to be guessed; most vertices have no more triangles.
const FEW: usize = 8;

/// Returns what some values of a vertex's triangles or neighbours tell, in order with infinite ones last, and the number of finite ones.
fn ordered(values: impl ExactSizeIterator<Item = f64>, told: impl FnOnce(&[f64], usize) -> f64) -> f64 {
    if values.len() <= FEW {
        let mut few = [f64::INFINITY; FEW];
        values.zip(&mut few).for_each(|(value, few)| *few = value);
        in_order(&mut few);
        return told(&few, few.iter().filter(|value| value.is_finite()).count());
    }
    let mut many: Vec<f64> = values.collect();
    many.sort_unstable_by(f64::total_cmp);
    told(&many, many.partition_point(|value| value.is_finite()))
}

/// K. Batcher's network of nineteen exchanges (AFIPS 32 (1968) 307).
fn in_order(values: &mut [f64; FEW]) {
    let mut exchange = |a: usize, b: usize| {
        let (x, y) = (values[a], values[b]);
        (values[a], values[b]) = if y < x { (y, x) } else { (x, y) };
    };
    [(0, 1), (2, 3), (4, 5), (6, 7)].into_iter().for_each(|(a, b)| exchange(a, b));
    [(0, 2), (1, 3), (4, 6), (5, 7)].into_iter().for_each(|(a, b)| exchange(a, b));
    [(1, 2), (5, 6), (0, 4), (3, 7)].into_iter().for_each(|(a, b)| exchange(a, b));
    [(1, 5), (2, 6)].into_iter().for_each(|(a, b)| exchange(a, b));
    [(1, 4), (3, 6)].into_iter().for_each(|(a, b)| exchange(a, b));
    [(2, 4), (3, 5)].into_iter().for_each(|(a, b)| exchange(a, b));
    exchange(3, 4);
}

/// The median over a vertex's triangles, the lower one of an even number; infinite of none.
///
/// At a straight border half of them span what lies beyond it: the upper one would be that of the gap, and the gap the measure of itself.
fn own(v: u32, incident: &Incident, telling: &[f64]) -> f64 {
    let values = incident.of(v).iter().map(|&t| telling[t as usize]);
    ordered(values, |values, finite| {
        values.get(finite.saturating_sub(1) / 2).copied().unwrap_or(f64::INFINITY)
    })
}

/// The median over the triangles of a vertex and of its neighbours; infinite of none.
fn widely(v: u32, incident: &Incident, telling: &[f64]) -> f64 {
    let own = incident.of(v).iter();
    let all = own.chain(incident.next(v).iter().flat_map(|&w| incident.of(w)));
    let mut values: Vec<f64> = all.map(|&t| telling[t as usize]).filter(|value| value.is_finite()).collect();
    let middle = values.len() / 2;
    if values.is_empty() { f64::INFINITY } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// The median over a vertex, half as often as it has triangles, and its neighbours.
fn typical(v: u32, incident: &Incident, own: &[f64]) -> f64 {
    let (next, value) = (incident.next(v), own[v as usize]);
    ordered(next.iter().map(|&w| own[w as usize]), |values, finite| {
        let times = if value.is_finite() { next.len().div_ceil(2) } else { 0 };
        // As often as it is there it moves the middle down from that of the neighbours, and comes where it belongs.
        let middle = (finite + times) / 2;
        let at = |rank: Option<usize>| rank.and_then(|rank| values.get(rank).copied());
        let (low, high) = (at(middle.checked_sub(times)), at(Some(middle)));
        match times {
            0 => high.unwrap_or(f64::INFINITY),
            _ => value.max(low.unwrap_or(f64::NEG_INFINITY)).min(high.unwrap_or(f64::INFINITY)),
        }
    })
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_network_puts_all_in_order() {
        // A network that orders noughts and ones orders anything (Knuth, 5.3.4, theorem Z).
        for bits in 0_u32..1 << FEW {
            let mut values: [f64; FEW] = std::array::from_fn(|k| f64::from(bits >> k & 1));
            in_order(&mut values);
            assert!(values.is_sorted(), "{bits:b}: {values:?}");
        }
    }
}
