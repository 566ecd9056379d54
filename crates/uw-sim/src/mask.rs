//! Where in the image laser light can be: found forwards, from the laser.

use crate::sight::{EDGE_SIGMAS, Sight};
use nalgebra::Vector2;

/// Pixels that laser light may fall on, row by row, margin included: column and row 0 are the margin's first.
pub(crate) struct Mask {
    pub(crate) width: usize,
    pub(crate) height: usize,
    margin: usize,
    marked: Vec<bool>,
    /// First and last marked column of each row.
    spans: Vec<Option<(usize, usize)>>,
}

/// Planes of rays across the sheet's thickness, to each side of its middle.
const LAYERS: i32 = 2;
/// Pixels added around each, and within which two neighbouring rays are joined.
const GROWTH: isize = 2;
/// Neighbouring rays farther apart than this on the image, px, are not on one surface.
const JOINED_PX: f64 = 80.0;
/// Rays to each side of the fan's middle, a pixel of the image's larger side: some one and a half apart where the fan fills the image.
const RAYS_A_PIXEL: f64 = 0.7;
/// A point moves by less than its path for a radian at the apex, by the index of what is outside: no index is larger.
const LEVER: f64 = 1.6;
/// Off the sheet's middle a surface may be nearer to the laser than on it, by this factor.
const NEARER: f64 = 0.9;

/// Where a ray of the laser ends.
#[derive(Clone, Copy)]
struct Mark {
    object: usize,
    path_mm: f64,
    pixel: Option<Vector2<f64>>,
}

impl Mask {
    pub(crate) fn new(sight: &Sight<'_>, margin: usize) -> Self {
        let [width, height] = sight.instrument.size.map(|n| n as usize + 2 * margin);
        let mut mask =
            Self { width, height, margin, marked: vec![false; width * height], spans: vec![None; height] };
        let light = &sight.light;
        let half = sight.instrument.beam.half_angle_rad;
        let stations = (RAYS_A_PIXEL * width.max(height) as f64) as i32;
        let apex = light.sheet.apex_mm;
        let along = light.sheet.normal.cross(&light.middle);
        let trace = |tilt: f64| -> Vec<Option<Mark>> {
            let one = |station: i32| {
                let (s, c) = (half * f64::from(station) / f64::from(stations)).sin_cos();
                let air = light.middle * c + along * s + light.sheet.normal * tilt.tan();
                let ray = light.sheet.port.ray_out(&apex, &air, sight.water.laser).ok()?;
                let hit = sight.world.hit(&ray)?;
                let pixel = sight.instrument.scanner.project(&hit.point, sight.water.laser).ok();
                Some(Mark { object: hit.object, path_mm: (hit.point - apex).norm(), pixel })
            };
            (-stations..=stations).map(one).collect()
        };
        let middle = trace(0.0);
        // Layers tilt about the apex so far that at the nearest surface they reach the sheet's edge, and farther out beyond it.
        let nearest = middle.iter().flatten().map(|mark| mark.path_mm).fold(f64::INFINITY, f64::min);
        let nearest = if nearest.is_finite() { nearest } else { crate::instrument::REFERENCE_MM };
        let edge = LEVER * EDGE_SIGMAS * light.sigma_mm(nearest) / (NEARER * nearest);
        let mut last: Option<Vec<Option<Mark>>> = None;
        for layer in -LAYERS..=LAYERS {
            let marks =
                if layer == 0 { middle.clone() } else { trace(edge * f64::from(layer) / f64::from(LAYERS)) };
            for (i, mark) in marks.iter().enumerate() {
                let Some(Mark { object, pixel: Some(pixel), .. }) = mark else { continue };
                mask.mark(pixel);
                let before = i.checked_sub(1).and_then(|i| marks[i]);
                let beside = last.as_ref().and_then(|last| last[i]);
                for other in [before, beside].into_iter().flatten().filter(|m| m.object == *object) {
                    if let Some(from) = other.pixel {
                        mask.join(&from, pixel);
                    }
                }
            }
            last = Some(marks);
        }
        mask
    }

    fn join(&mut self, from: &Vector2<f64>, to: &Vector2<f64>) {
        let way = to - from;
        let length = way.norm();
        if length > JOINED_PX || length.is_nan() {
            return;
        }
        let steps = (length / GROWTH as f64).floor() as i32;
        (1..=steps).for_each(|k| self.mark(&(from + way * (f64::from(k) / f64::from(steps + 1)))));
    }

    fn mark(&mut self, pixel: &Vector2<f64>) {
        let margin = self.margin as f64;
        let (u, v) = ((pixel.x + margin).round(), (pixel.y + margin).round());
        let growth = GROWTH as f64;
        if !(u > -growth && v > -growth && u < self.width as f64 + growth && v < self.height as f64 + growth)
        {
            return;
        }
        let (u, v) = (u as isize, v as isize);
        let first = (u - GROWTH).max(0) as usize;
        let last = (u + GROWTH).min(self.width as isize - 1);
        if last < first as isize {
            return;
        }
        let last = last as usize;
        for row in (v - GROWTH).max(0)..=(v + GROWTH).min(self.height as isize - 1) {
            let row = row as usize;
            self.marked[row * self.width + first..=row * self.width + last].fill(true);
            let span = self.spans[row].get_or_insert((first, last));
            *span = (span.0.min(first), span.1.max(last));
        }
    }

    /// Runs of marked pixels of a row, as first and one past the last column.
    pub(crate) fn runs(&self, row: usize) -> Vec<(usize, usize)> {
        let Some((first, last)) = self.spans[row] else { return Vec::new() };
        runs(first, last, |column| self.marked[row * self.width + column])
    }

    /// Runs of marked pixels of a column, as first and one past the last row.
    pub(crate) fn column_runs(&self, column: usize) -> Vec<(usize, usize)> {
        runs(0, self.height - 1, |row| self.marked[row * self.width + column])
    }
}

fn runs(first: usize, last: usize, marked: impl Fn(usize) -> bool) -> Vec<(usize, usize)> {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for k in (first..=last).filter(|k| marked(*k)) {
        match runs.last_mut() {
            Some(run) if run.1 == k => run.1 = k + 1,
            _ => runs.push((k, k + 1)),
        }
    }
    runs
}
