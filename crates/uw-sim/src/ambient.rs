//! Surfaces under even light: images without the laser.

use crate::instrument::Instrument;
use crate::scene::Water;
use crate::spread::{Canvas, Collector, Kernel};
use crate::texture::Patch;
use crate::world::{Hit, World};
use nalgebra::Vector2;
use uw_geom::Ray;

/// Samples a side of a pixel that an edge of shape crosses; edges of patterns are averaged exactly.
const SAMPLES: usize = 4;

/// The scene under light that makes a white surface 1, blurred and integrated over pixels.
pub(crate) fn render(instrument: &Instrument, world: &World<'_>, water: &Water) -> Canvas {
    let (pixels, samples) =
        (Kernel::new(instrument.lens.blur_px, 1), Kernel::new(instrument.lens.blur_px, SAMPLES));
    let margin = pixels.reach;
    let size = instrument.size.map(|n| n as usize);
    let [width, height] = size.map(|n| n + 2 * margin);
    let exact = |u: f64, v: f64| {
        let pixel = Vector2::new(u - margin as f64, v - margin as f64);
        instrument.scanner.pixel_ray(&pixel, water.ambient).ok()
    };
    let corners = |row: usize| -> Vec<Option<Hit>> {
        let v = row as f64 - 0.5;
        let stations: Vec<Option<Ray>> =
            (0..width / STRIDE + 4).map(|k| exact((k * STRIDE) as f64 - 0.5, v)).collect();
        (0..=width).map(|column| world.hit(&between(&stations, column)?)).collect()
    };
    let brightness = |hit: &Hit, sides: [[f64; 2]; 2]| {
        let albedo = world.surface(hit.object).albedo_over(&Patch { at: hit.drawn, sides });
        albedo * (-water.attenuation_per_mm * hit.distance_mm).exp()
    };
    let mut even = Canvas::new(width, height);
    let mut edges = Collector::new(&samples, SAMPLES, margin, size);
    let mut broken: Vec<(usize, [[f32; SAMPLES]; SAMPLES])> = Vec::new();
    let mut above = corners(0);
    for row in 0..height {
        let below = corners(row + 1);
        broken.clear();
        for column in 0..width {
            let four = [above[column], above[column + 1], below[column], below[column + 1]];
            if four.iter().all(Option::is_none) {
                continue;
            }
            if let Some([a, b, c, d]) = one_surface(&four) {
                let cell = |hit: &Hit| world.surface(hit.object).cell(hit.drawn);
                let mean = 0.25 * [a, b, c, d].iter().map(|hit| brightness(hit, [[0.0; 2]; 2])).sum::<f64>();
                if [b, c, d].iter().all(|hit| cell(hit) == cell(&a)) {
                    even.data[row * width + column] = mean as f32;
                } else {
                    let surface = world.surface(a.object);
                    let fall = (-water.attenuation_per_mm * 0.5 * (a.distance_mm + d.distance_mm)).exp();
                    let drawn = [a, b, c, d].map(|hit| hit.drawn);
                    broken.push((column, pattern(&drawn, |patch| fall * surface.albedo_over(&patch))));
                }
                continue;
            }
            let mut cell = [[0.0; SAMPLES]; SAMPLES];
            for (j, line) in cell.iter_mut().enumerate() {
                for (i, out) in line.iter_mut().enumerate() {
                    let hit = exact(column as f64 + place(i), row as f64 + place(j))
                        .and_then(|ray| world.hit(&ray));
                    *out = hit.map_or(0.0, |hit| brightness(&hit, [[0.0; 2]; 2])) as f32;
                }
            }
            broken.push((column, cell));
        }
        for k in 0..SAMPLES {
            for (column, cell) in &broken {
                cell[k].iter().enumerate().for_each(|(i, light)| edges.add(*column, i, *light));
            }
            edges.end_row(row, k);
        }
        above = below;
    }
    let mut image = pixels.crop(&even, margin);
    image.data.iter_mut().zip(&edges.image.data).for_each(|(a, b)| *a += b);
    image
}

/// Columns from one exact ray to the next.
const STRIDE: usize = 4;

/// The ray at a column, by the parabola through the exact ones around it. A lens's and a window's third derivatives leave less than
/// 1e-5 px.
fn between(stations: &[Option<Ray>], column: usize) -> Option<Ray> {
    let first = column / (2 * STRIDE) * 2;
    let [a, b, c] = [stations[first]?, stations[first + 1]?, stations[first + 2]?];
    let x = (column - first * STRIDE) as f64 / STRIDE as f64;
    let [p, q, r] = [0.5 * (x - 1.0) * (x - 2.0), x * (2.0 - x), 0.5 * x * (x - 1.0)];
    let origin = a.origin * p + b.origin * q + c.origin * r;
    Some(Ray { origin, direction: a.direction * p + b.direction * q + c.direction * r })
}

/// A sample's place in its pixel.
fn place(k: usize) -> f64 {
    (k as f64 + 0.5) / SAMPLES as f64 - 0.5
}

/// The four hits, if all are of one object and facet.
fn one_surface(four: &[Option<Hit>; 4]) -> Option<[Hit; 4]> {
    let [Some(a), Some(b), Some(c), Some(d)] = *four else { return None };
    [b, c, d].iter().all(|hit| hit.object == a.object && hit.facet == a.facet).then_some([a, b, c, d])
}

/// The samples of a pixel from where its corners lie on the drawing, bilinear between them.
fn pattern([a, b, c, d]: &[[f64; 2]; 4], mut albedo: impl FnMut(Patch) -> f64) -> [[f32; SAMPLES]; SAMPLES] {
    let step = 1.0 / SAMPLES as f64;
    std::array::from_fn(|j| {
        std::array::from_fn(|i| {
            let (s, t) = (place(i) + 0.5, place(j) + 0.5);
            let mix = |k: usize| {
                let (top, bottom) = (a[k] + s * (b[k] - a[k]), c[k] + s * (d[k] - c[k]));
                top + t * (bottom - top)
            };
            let along = |k: usize| step * ((b[k] - a[k]) * (1.0 - t) + (d[k] - c[k]) * t);
            let down = |k: usize| step * ((c[k] - a[k]) * (1.0 - s) + (d[k] - b[k]) * s);
            let patch = Patch { at: [mix(0), mix(1)], sides: [[along(0), along(1)], [down(0), down(1)]] };
            albedo(patch) as f32
        })
    })
}
