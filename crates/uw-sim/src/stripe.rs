//! The laser's light on surfaces, as the image plane receives it.

use crate::mask::Mask;
use crate::sight::{EDGE_SIGMAS, Glimpse, Sight};
use crate::speckle::Speckle;
use crate::spread::{Canvas, Collector, Kernel};
use crate::texture::Patch;
use nalgebra::Vector2;

/// Samples a pixel's side. The sheet's cross section is a Gaussian of a third of a pixel and more: sampled at a quarter, its sum is
/// the integral to 1e-5 (the comb's first overtone, exp(−2π² σ²/h²)).
pub(crate) const SAMPLES: usize = 4;
/// Nodes at half a pixel: those of three rows are kept.
const ROWS: usize = 3;

/// What is seen at a node, if it was looked at for this row.
#[derive(Clone, Copy)]
struct Node {
    row: usize,
    seen: Option<Glimpse>,
}

/// A lattice of half pixels that is looked at where it is needed.
struct Nodes<'s> {
    sight: &'s Sight<'s>,
    margin: f64,
    rows: [Vec<Node>; ROWS],
}

impl<'s> Nodes<'s> {
    fn new(sight: &'s Sight<'s>, margin: usize, width: usize) -> Self {
        let empty = vec![Node { row: usize::MAX, seen: None }; 2 * width + 1];
        Self { sight, margin: margin as f64, rows: [empty.clone(), empty.clone(), empty] }
    }

    fn at(&mut self, row: usize, column: usize) -> Option<Glimpse> {
        let node = &mut self.rows[row % ROWS][column];
        if node.row != row {
            let place = |k: usize| 0.5 * k as f64 - 0.5 - self.margin;
            *node = Node { row, seen: self.sight.look(&Vector2::new(place(column), place(row))) };
        }
        node.seen
    }
}

/// The image of the laser's light on surfaces, blurred and integrated over pixels; fractions of full scale.
pub(crate) fn render(sight: &Sight<'_>, kernel: &Kernel, speckle: Option<&Speckle>) -> Canvas {
    let margin = kernel.reach;
    let mask = Mask::new(sight, margin);
    let mut nodes = Nodes::new(sight, margin, mask.width);
    let size = sight.instrument.size.map(|n| n as usize);
    let mut collector = Collector::new(kernel, SAMPLES, margin, size);
    let mut cells: Vec<(usize, [[f32; SAMPLES]; SAMPLES])> = Vec::new();
    for row in 0..mask.height {
        cells.clear();
        for (first, end) in mask.runs(row) {
            for column in first..end {
                let seen: [[Option<Glimpse>; 3]; 3] =
                    std::array::from_fn(|j| std::array::from_fn(|i| nodes.at(2 * row + j, 2 * column + i)));
                let middle = Vector2::new(column as f64 - margin as f64, row as f64 - margin as f64);
                if let Some(mut light) = cell(sight, &seen, &middle) {
                    if let Some(speckle) = speckle {
                        speckle.grain(&middle, &mut light);
                    }
                    cells.push((column, light));
                }
            }
        }
        for k in 0..SAMPLES {
            for (column, light) in &cells {
                for (i, light) in light[k].iter().enumerate().filter(|(_, light)| **light > 0.0) {
                    collector.add(*column, i, *light);
                }
            }
            collector.end_row(row, k);
        }
    }
    collector.image
}

/// The samples of one pixel, from what is seen at its corners, sides and middle; `None` without light.
fn cell(
    sight: &Sight<'_>,
    seen: &[[Option<Glimpse>; 3]; 3],
    middle: &Vector2<f64>,
) -> Option<[[f32; SAMPLES]; SAMPLES]> {
    let all = seen.as_flattened();
    if all.iter().all(|g| g.is_none_or(|g| !g.lit || g.off_mm.abs() > EDGE_SIGMAS * g.sigma_mm)) {
        // Nothing near the sheet, unless it runs through between the nodes.
        let (mut low, mut high) = (false, false);
        all.iter().flatten().filter(|g| g.lit).for_each(|g| {
            low |= g.off_mm < 0.0;
            high |= g.off_mm > 0.0;
        });
        if !(low && high) {
            return None;
        }
    }
    let even = seen[1][1].filter(|g| all.iter().all(|other| other.is_some_and(|other| g.joins(&other))));
    match even {
        Some(g) if !g.lit => None,
        Some(g) => smooth(sight, seen, &g),
        None => broken(sight, middle),
    }
}

/// Weights of the values at −½, 0 and ½ in the parabola through them, at a sample's place.
fn weights(k: usize) -> [f64; 3] {
    let x = (k as f64 + 0.5) / SAMPLES as f64 - 0.5;
    [2.0 * x * (x - 0.5), (1.0 - 2.0 * x) * (1.0 + 2.0 * x), 2.0 * x * (x + 0.5)]
}

/// Samples of a pixel that shows one smooth surface, interpolated.
fn smooth(
    sight: &Sight<'_>,
    seen: &[[Option<Glimpse>; 3]; 3],
    centre: &Glimpse,
) -> Option<[[f32; SAMPLES]; SAMPLES]> {
    // Every node is there: the caller has seen to it.
    let node = |j: usize, i: usize| seen[j][i].as_ref().unwrap_or(centre);
    let surface = sight.world.surface(centre.object);
    // How the drawing runs through the pixel; its curvature there is far below a sample.
    let drawn = |j: usize, i: usize| node(j, i).drawn;
    let per = |from: [f64; 2], to: [f64; 2]| [to[0] - from[0], to[1] - from[1]];
    let (du, dv) = (per(drawn(1, 0), drawn(1, 2)), per(drawn(0, 1), drawn(2, 1)));
    let step = 1.0 / SAMPLES as f64;
    let sides = [du.map(|x| x * step), dv.map(|x| x * step)];
    let mut light = [[0.0_f32; SAMPLES]; SAMPLES];
    let mut any = false;
    for (j, line) in light.iter_mut().enumerate() {
        let wj = weights(j);
        let mut off = [0.0; 3];
        let (mut diffuse, mut gloss) = ([0.0; 3], [0.0; 3]);
        for i in 0..3 {
            for (k, w) in wj.iter().enumerate() {
                let g = node(k, i);
                off[i] += w * g.off_mm;
                diffuse[i] += w * g.diffuse;
                gloss[i] += w * g.gloss;
            }
        }
        for (i, out) in line.iter_mut().enumerate() {
            let wi = weights(i);
            let mix = |x: &[f64; 3]| wi[0] * x[0] + wi[1] * x[1] + wi[2] * x[2];
            let z = mix(&off) / centre.sigma_mm;
            if z.abs() > EDGE_SIGMAS {
                continue;
            }
            let place = |k: usize| (k as f64 + 0.5) * step - 0.5;
            let at = [0, 1].map(|c| centre.drawn[c] + du[c] * place(i) + dv[c] * place(j));
            let albedo = surface.albedo_over(&Patch { at, sides });
            *out = ((-0.5 * z * z).exp() * (albedo * mix(&diffuse) + mix(&gloss)).max(0.0)) as f32;
            any = true;
        }
    }
    any.then_some(light)
}

/// Samples of a pixel with an edge in it, each looked at by itself.
fn broken(sight: &Sight<'_>, middle: &Vector2<f64>) -> Option<[[f32; SAMPLES]; SAMPLES]> {
    let place = |k: usize| (k as f64 + 0.5) / SAMPLES as f64 - 0.5;
    let mut light = [[0.0_f32; SAMPLES]; SAMPLES];
    let mut any = false;
    for (j, line) in light.iter_mut().enumerate() {
        for (i, out) in line.iter_mut().enumerate() {
            let Some(g) = sight.look(&(middle + Vector2::new(place(i), place(j)))) else { continue };
            let z = g.off_mm / g.sigma_mm;
            if !g.lit || z.abs() > EDGE_SIGMAS {
                continue;
            }
            let surface = sight.world.surface(g.object);
            let albedo = surface.albedo_over(&Patch { at: g.drawn, sides: [[0.0; 2]; 2] });
            *out = ((-0.5 * z * z).exp() * (albedo * g.diffuse + g.gloss)) as f32;
            any = true;
        }
    }
    any.then_some(light)
}
