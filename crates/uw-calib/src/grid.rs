//! Labels corner candidates with their place in a chessboard's lattice.
//!
//! Each candidate knows the directions of its two edges, ordered so that the sector from the first to the
//! second is dark. Going along an edge to the next corner, dark and bright swap sides: what was a first axis
//! there is a second axis here. Candidates are linked where both agree on that and are each other's nearest
//! in that direction; links that close a square of four are trusted and walked. This needs no model of the
//! lens, so distortion and refraction don't matter, and background texture rarely closes a square.

use std::collections::{HashMap, VecDeque};

/// A possible corner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Candidate {
    /// Position, px.
    pub pixel: [f64; 2],
    /// Directions of the edges, radians from u towards v, second = first + (0, π), the sector between them
    /// dark.
    pub axes: [f64; 2],
}

/// Place in the lattice, of any origin and one of four rotations; x to y turns from u towards v.
pub(crate) type Place = [i32; 2];

/// How far a neighbour's direction, or its axis, may differ from this corner's axis. Bent by strong
/// distortion, edges of one square differ by some 5°; the axes' own error on small or blurred squares is of
/// the same size.
const ANGLE_TOLERANCE: f64 = 0.35;
/// Px; closer candidates are the same corner twice.
const MIN_DISTANCE_PX: f64 = 3.0;

/// Steps along +x, +y, −x, −y.
const STEPS: [Place; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];

/// A link to a neighbour and the neighbour's own direction that leads back.
type Link = Option<(usize, usize)>;

/// Returns the places of all connected sets of candidates, each a map from place to candidate, largest first.
pub(crate) fn lattices(candidates: &[Candidate]) -> Vec<HashMap<Place, usize>> {
    let links = keep_squares(&mutual_links(candidates));
    let mut seen = vec![false; candidates.len()];
    let mut lattices = Vec::new();
    for start in 0..candidates.len() {
        if seen[start] || links[start].iter().all(Option::is_none) {
            continue;
        }
        lattices.push(walk(&links, start, &mut seen));
    }
    lattices.sort_by_key(|lattice| std::cmp::Reverse(lattice.len()));
    lattices
}

/// Nearest candidate in each direction whose axes fit. Direction 0 and 1 of a corner lead along its axes, 2
/// and 3 against them, in order of rising angle.
fn nearest_links(candidates: &[Candidate]) -> Vec<[Link; 4]> {
    let units: Vec<[[f64; 2]; 2]> =
        candidates.iter().map(|c| c.axes.map(|angle| [angle.cos(), angle.sin()])).collect();
    // The axis's direction (0 along, 2 against) in which `d` of squared length `square` leads, if it does.
    let steepest = ANGLE_TOLERANCE.sin().powi(2);
    let heads = |axis: [f64; 2], d: [f64; 2], square: f64| {
        let across = axis[0] * d[1] - axis[1] * d[0];
        let along = axis[0] * d[0] + axis[1] * d[1];
        (across * across < steepest * square).then_some(if along > 0.0 { 0 } else { 2 })
    };
    let mut links = Vec::with_capacity(candidates.len());
    for (i, a) in candidates.iter().enumerate() {
        let mut nearest = [f64::INFINITY; 4];
        let mut link: [Link; 4] = [None; 4];
        for (j, b) in candidates.iter().enumerate() {
            let d = [b.pixel[0] - a.pixel[0], b.pixel[1] - a.pixel[1]];
            let square = d[0] * d[0] + d[1] * d[1];
            if square < MIN_DISTANCE_PX * MIN_DISTANCE_PX || nearest.iter().all(|n| *n <= square) {
                continue;
            }
            for kind in 0..2 {
                let Some(ahead) = heads(units[i][kind], d, square) else { continue };
                let k = kind + ahead;
                // Only an axis of the other kind may lead back.
                if square < nearest[k]
                    && let Some(along) = heads(units[j][1 - kind], d, square)
                {
                    nearest[k] = square;
                    link[k] = Some((j, 1 - kind + 2 - along));
                }
            }
        }
        links.push(link);
    }
    links
}

fn mutual_links(candidates: &[Candidate]) -> Vec<[Link; 4]> {
    let nearest = nearest_links(candidates);
    nearest
        .iter()
        .enumerate()
        .map(|(i, links)| {
            std::array::from_fn(|k| links[k].filter(|&(j, back)| nearest[j][back] == Some((i, k))))
        })
        .collect()
}

/// Keeps the links that are a side of at least one closed square.
fn keep_squares(links: &[[Link; 4]]) -> Vec<[Link; 4]> {
    let mut kept = vec![[None; 4]; links.len()];
    for i in 0..links.len() {
        for k in 0..4 {
            // Four sides, a quarter turn at each corner.
            let mut side = (i, k);
            let mut sides = Vec::with_capacity(4);
            while sides.len() < 4 {
                let Some((j, back)) = links[side.0][side.1] else { break };
                sides.push(side);
                side = (j, (back + 3) % 4);
            }
            if sides.len() == 4 && side == (i, k) {
                for (corner, k) in sides {
                    kept[corner][k] = links[corner][k];
                    if let Some((j, back)) = links[corner][k] {
                        kept[j][back] = links[j][back];
                    }
                }
            }
        }
    }
    kept
}

/// Labels everything that links reach from `start`; where two ways disagree, the first to arrive holds.
fn walk(links: &[[Link; 4]], start: usize, seen: &mut [bool]) -> HashMap<Place, usize> {
    let mut places = HashMap::from([([0, 0], start)]);
    seen[start] = true;
    // Of each corner: its place, and which of its directions is the lattice's +x.
    let mut queue = VecDeque::from([(start, [0, 0], 0)]);
    while let Some((i, [x, y], frame)) = queue.pop_front() {
        for (m, [dx, dy]) in STEPS.into_iter().enumerate() {
            let Some((j, back)) = links[i][(frame + m) % 4] else { continue };
            let place = [x + dx, y + dy];
            if seen[j] || places.contains_key(&place) {
                continue;
            }
            seen[j] = true;
            places.insert(place, j);
            queue.push_back((j, place, (back + 6 - m) % 4));
        }
    }
    places
}
