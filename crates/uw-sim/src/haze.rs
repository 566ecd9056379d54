//! Light that the water in the sheet throws back to the camera before any surface does.

use crate::sight::Sight;
use crate::spread::Canvas;
use nalgebra::Vector2;
use uw_geom::{Exposure, GeomError};

/// Side of a cell whose inside is interpolated where its corners agree, px.
const CELL: usize = 8;

/// Haze at one place: brightness, and whether all of the sheet's thickness is in front of the surface.
#[derive(Clone, Copy)]
struct Veil {
    light: f32,
    /// 1 where the surface lies far behind the sheet, 0 where it hides it; between, by the share of the thickness in front.
    shown: f32,
}

/// The image of the haze, margin included, before blur; fractions of full scale.
///
/// # Errors
/// As [`uw_geom::Scanner::exposure`].
pub(crate) fn render(sight: &Sight<'_>, voltage: f64, margin: usize) -> Result<Canvas, GeomError> {
    let [width, height] = sight.instrument.size.map(|n| n as usize + 2 * margin);
    let exposure = sight.instrument.scanner.exposure(voltage, sight.water.laser)?;
    let mut out = Canvas::new(width, height);
    let (columns, rows) = (width.div_ceil(CELL), height.div_ceil(CELL));
    let look = |u: usize, v: usize| {
        veil(sight, &exposure, &Vector2::new(u as f64 - margin as f64, v as f64 - margin as f64))
    };
    let corners: Vec<Vec<Veil>> =
        (0..=rows).map(|r| (0..=columns).map(|c| look(c * CELL, r * CELL)).collect()).collect();
    for r in 0..rows {
        for c in 0..columns {
            let four = [corners[r][c], corners[r][c + 1], corners[r + 1][c], corners[r + 1][c + 1]];
            let all = |test: fn(&Veil) -> bool| four.iter().all(test);
            if all(|veil| veil.shown * veil.light <= 0.0) {
                continue;
            }
            let even = all(|veil| veil.shown >= 1.0 && veil.light > 0.0);
            for v in (r * CELL)..((r + 1) * CELL).min(height) {
                for u in (c * CELL)..((c + 1) * CELL).min(width) {
                    let (s, t) = ((u - c * CELL) as f32 / CELL as f32, (v - r * CELL) as f32 / CELL as f32);
                    out.data[v * width + u] = if even {
                        let [a, b, c, d] = four.map(|veil| veil.light);
                        let (top, bottom) = (a + s * (b - a), c + s * (d - c));
                        top + t * (bottom - top)
                    } else {
                        let veil = look(u, v);
                        veil.light * veil.shown
                    };
                }
            }
        }
    }
    Ok(out)
}

fn veil(sight: &Sight<'_>, exposure: &Exposure, pixel: &Vector2<f64>) -> Veil {
    let none = Veil { light: 0.0, shown: 0.0 };
    let (Some(ray), Ok(point)) = (sight.ray(pixel), exposure.triangulate(pixel)) else { return none };
    let distance = (point - ray.origin).norm();
    let shown = match sight.world.hit(&ray) {
        // Before the surface there is as much of the sheet's thickness as the normal distribution has on that side of it.
        Some(hit) if hit.distance_mm < distance + FAR_MM => {
            let Ok(arrival) = sight.arrival(&hit.point) else { return none };
            let sigma = sight.light.sigma_mm(distance);
            let depth = arrival.off_mm.abs() / sigma * (hit.distance_mm - distance).signum();
            crate::spread::normal_cdf(depth)
        }
        _ => 1.0,
    };
    if shown < 1e-9 {
        return none;
    }
    let light = sight.haze(&point, &ray, distance).unwrap_or(0.0);
    Veil { light: light as f32, shown: if shown > 1.0 - 1e-9 { 1.0 } else { shown as f32 } }
}

/// Beyond this distance behind the sheet's middle a surface leaves all of its thickness in front, mm.
const FAR_MM: f64 = 100.0;
