//! From a lattice of candidates to accurate corners: sub-pixel fits, growth into gaps, removal of what does
//! not belong.

use std::collections::{BTreeMap, HashMap};

use crate::grid::{Candidate, Place};
use crate::homography::{apply, homography};
use crate::saddle::{self, Saddle, Seed};
use crate::view::GreyView;

/// Labelled corners by place. Ordered, so that results do not depend on a hash.
pub(crate) type Corners = BTreeMap<Place, Saddle>;

/// Neighbours from which a corner is predicted; twice as many as a homography needs, few enough to follow the
/// lens.
const NEIGHBOURS: usize = 12;
/// Share of the distance to the next parallel edge that the window reaches: that edge's blur stays outside.
const WINDOW_SHARE: f64 = 0.42;
/// Px; less holds too few pixels for the fit.
const MIN_RADIUS_PX: f64 = 3.0;
/// Px; beyond this the edges' length gains little, and light and lens vary in ways that the fit does not
/// know.
const MAX_RADIUS_PX: f64 = 12.0;
/// Share of the pitch by which a corner may differ from its neighbours' prediction.
const MAX_OFFSET: f64 = 0.2;
/// Radians by which an edge may differ from the direction that the neighbours predict.
const MAX_TURN: f64 = 0.35;
/// Least share of the window's variance that two crossing edges explain.
const MIN_EXPLAINED: f64 = 0.6;
/// Least [`Saddle::gap`]: half of what even light gives.
const MIN_GAP: f64 = 0.5;
/// Least contrast against the median of the neighbours; light may fall off, but not at once.
const MIN_CONTRAST: f64 = 0.2;
/// Px; a corner known worse than this is of no use, and mostly none.
const MAX_SIGMA_PX: f64 = 0.5;
/// Rounds of growth; each reaches one place further.
const MAX_ROUNDS: usize = 64;

/// What the neighbours say about a place: pixel, and the steps to the next place in x and y, px.
struct Prediction {
    pixel: [f64; 2],
    dx: [f64; 2],
    dy: [f64; 2],
}

impl Prediction {
    fn pitch(&self) -> f64 {
        self.dx[0].hypot(self.dx[1]).min(self.dy[0].hypot(self.dy[1]))
    }

    /// Distance from the corner to the next edge of its squares.
    fn clearance(&self) -> f64 {
        let area = (self.dx[0] * self.dy[1] - self.dx[1] * self.dy[0]).abs();
        area / self.dx[0].hypot(self.dx[1]).max(self.dy[0].hypot(self.dy[1]))
    }
}

/// Returns the accurate corners of the board that `lattice` is part of.
pub(crate) fn complete(
    view: &GreyView<'_>,
    candidates: &[Candidate],
    lattice: &HashMap<Place, usize>,
) -> Corners {
    let rough: BTreeMap<Place, [f64; 2]> =
        lattice.iter().map(|(place, &i)| (*place, candidates[i].pixel)).collect();
    let mut corners = Corners::new();
    for (&place, &pixel) in &rough {
        let others = rough.iter().filter(|(p, _)| **p != place).map(|(p, x)| (*p, *x));
        if let Some(prediction) = predict(place, others)
            && let Some(saddle) = measure(view, place, pixel, &prediction, [0.0; 2])
        {
            corners.insert(place, saddle);
        }
    }
    drop_misfits(&mut corners);
    grow(view, &mut corners);
    drop_misfits(&mut corners);
    refine(view, &corners)
}

/// Prediction from the nearest of the other corners by a local homography.
fn predict(place: Place, others: impl Iterator<Item = (Place, [f64; 2])>) -> Option<Prediction> {
    let mut others: Vec<_> = others
        .map(|(p, pixel)| {
            let d = [f64::from(p[0] - place[0]), f64::from(p[1] - place[1])];
            (d[0] * d[0] + d[1] * d[1], d, pixel)
        })
        .collect();
    others.sort_by(|a, b| a.0.total_cmp(&b.0));
    let pairs: Vec<_> = others.iter().take(NEIGHBOURS).map(|(_, d, pixel)| (*d, *pixel)).collect();
    let h = homography(&pairs)?;
    let pixel = apply(&h, [0.0, 0.0])?;
    let step = |a: [f64; 2], b: [f64; 2]| [a[0] - b[0], a[1] - b[1]];
    let dx = step(apply(&h, [0.5, 0.0])?, apply(&h, [-0.5, 0.0])?);
    let dy = step(apply(&h, [0.0, 0.5])?, apply(&h, [0.0, -0.5])?);
    // A lattice turns from u towards v; anything else is a homography gone wrong.
    (dx[0] * dy[1] - dx[1] * dy[0] > 0.0).then_some(Prediction { pixel, dx, dy })
}

/// Fits the corner near `pixel` and holds it against the prediction.
fn measure(
    view: &GreyView<'_>,
    place: Place,
    pixel: [f64; 2],
    prediction: &Prediction,
    curvatures: [f64; 2],
) -> Option<Saddle> {
    let angles = [prediction.dx, prediction.dy].map(|d| d[1].atan2(d[0]));
    let to_border = |x: f64, size: usize| (x + 0.5).min(size as f64 - 0.5 - x);
    let border = to_border(pixel[0], view.width()).min(to_border(pixel[1], view.height()));
    let radius = (WINDOW_SHARE * prediction.clearance()).min(MAX_RADIUS_PX).min(border);
    if radius < MIN_RADIUS_PX {
        return None;
    }
    let saddle = saddle::fit(view, &Seed { pixel, angles, curvatures, radius })?;
    let offset = [0, 1].map(|i| saddle.pixel[i] - prediction.pixel[i]);
    let turned = [0, 1].map(|k| (saddle.angles[k] - angles[k]).abs());
    // Where the sum of the indices is even, the sector from +x to +y is dark: the lattice's first corner says
    // so.
    let bright = (place[0] + place[1]).rem_euclid(2) == 1;
    let fits = offset[0].hypot(offset[1]) < MAX_OFFSET * prediction.pitch()
        && turned.iter().all(|t| *t < MAX_TURN)
        && (saddle.amplitude > 0.0) == bright
        && saddle.explained > MIN_EXPLAINED
        && saddle.gap > MIN_GAP
        && saddle.covariance.diagonal().max().sqrt() < MAX_SIGMA_PX;
    fits.then_some(saddle)
}

/// Looks for corners at the free places beside known ones, until none is found.
fn grow(view: &GreyView<'_>, corners: &mut Corners) {
    let mut tried: BTreeMap<Place, usize> = BTreeMap::new();
    for _ in 0..MAX_ROUNDS {
        let mut found = Corners::new();
        let free: std::collections::BTreeSet<Place> = corners
            .keys()
            .flat_map(|&[x, y]| [[x + 1, y], [x, y + 1], [x - 1, y], [x, y - 1]])
            .filter(|place| !corners.contains_key(place))
            .collect();
        for place in free {
            // A place is tried again only when more of its neighbours are known.
            let around = around(corners, place).count();
            if tried.insert(place, around).is_some_and(|before| before >= around) {
                continue;
            }
            let others = corners.iter().map(|(p, s)| (*p, s.pixel));
            if let Some(prediction) = predict(place, others)
                && let Some(saddle) = measure(view, place, prediction.pixel, &prediction, [0.0; 2])
                && contrasts(corners, place, &saddle)
            {
                found.insert(place, saddle);
            }
        }
        if found.is_empty() {
            return;
        }
        corners.append(&mut found);
    }
}

/// Known corners among the 24 around a place.
fn around(corners: &Corners, [x, y]: Place) -> impl Iterator<Item = &Saddle> {
    (-2..=2)
        .flat_map(|dx| (-2..=2).map(move |dy| [dx, dy]))
        .filter(|d| *d != [0, 0])
        .filter_map(move |[dx, dy]| corners.get(&[x + dx, y + dy]))
}

fn contrasts(corners: &Corners, place: Place, saddle: &Saddle) -> bool {
    let mut others: Vec<f64> = around(corners, place).map(|s| s.amplitude.abs()).collect();
    others.sort_by(f64::total_cmp);
    others.get(others.len() / 2).is_none_or(|median| saddle.amplitude.abs() > MIN_CONTRAST * median)
}

/// Removes, worst first, the corners that their neighbours predict elsewhere or with another contrast.
fn drop_misfits(corners: &mut Corners) {
    while !corners.is_empty() {
        let worst = corners
            .iter()
            .map(|(&place, saddle)| {
                let others = corners.iter().filter(|(p, _)| **p != place).map(|(p, s)| (*p, s.pixel));
                let misfit = predict(place, others).map_or(f64::INFINITY, |prediction| {
                    let offset = [0, 1].map(|i| saddle.pixel[i] - prediction.pixel[i]);
                    offset[0].hypot(offset[1]) / prediction.pitch()
                });
                (if contrasts(corners, place, saddle) { misfit } else { f64::INFINITY }, place)
            })
            .max_by(|a, b| a.0.total_cmp(&b.0));
        match worst {
            Some((misfit, place)) if misfit > MAX_OFFSET => corners.remove(&place),
            _ => return,
        };
    }
}

/// Fits every corner again, now with the bend of its edges as the corners themselves show it.
fn refine(view: &GreyView<'_>, corners: &Corners) -> Corners {
    let bend = |place: Place, step: Place| -> Option<f64> {
        let at = |k: i32| corners.get(&[place[0] + k * step[0], place[1] + k * step[1]]).map(|s| s.pixel);
        let (before, here, after) = (at(-1)?, at(0)?, at(1)?);
        let back = [before[0] - here[0], before[1] - here[1]];
        let ahead = [after[0] - here[0], after[1] - here[1]];
        let along = [after[0] - before[0], after[1] - before[1]];
        let length = along[0].hypot(along[1]);
        // Offset of the two neighbours to the side of the normal (−sin, cos), each κ L²/2.
        let side = (along[0] * (back[1] + ahead[1]) - along[1] * (back[0] + ahead[0])) / length;
        let squares = back[0].powi(2) + back[1].powi(2) + ahead[0].powi(2) + ahead[1].powi(2);
        Some(2.0 * side / squares)
    };
    // At the end of a row the next corner inwards says how the edge bends.
    let bend = |[x, y]: Place, step: Place| {
        let [dx, dy] = step;
        [[x, y], [x + dx, y + dy], [x - dx, y - dy]]
            .into_iter()
            .find_map(|place| bend(place, step))
            .unwrap_or(0.0)
    };
    corners
        .iter()
        .filter_map(|(&place, saddle)| {
            let others = corners.iter().filter(|(p, _)| **p != place).map(|(p, s)| (*p, s.pixel));
            let prediction = predict(place, others)?;
            let curvatures = [bend(place, [1, 0]), bend(place, [0, 1])];
            Some((place, measure(view, place, saddle.pixel, &prediction, curvatures)?))
        })
        .collect()
}
