//! How thick the sheet of light is, as the widths of its stripes tell.

use super::derivatives::{Derivatives, SMOOTH};
use super::{Image, PIXEL_PX2, UNSURE, index, median, slope};

/// Steps from one to the other of the places whose widths are compared, from image to image or over so many lines; the least that they must differ by, as a
/// share; and the most of that from one step to the next, where a surface bends evenly and has no crease.
const APART: usize = 3;
const STEP_LINES: usize = 4;
const LEAST_CHANGE: f64 = 0.1;
const EVENLY: f64 = 0.48;
/// Images, as independent as those [`APART`] are, whose scatter tells how well they tell something.
const LEAST_COUNT: f64 = 2.0;
/// Share of lines that may be narrower than the sheet by chance, and mean and standard deviation of a share of which nothing is known.
const NARROWER: f64 = 0.1;
const ANY_SHARE: (f64, f64) = (0.5, 0.29);

/// How thick the sheet of light is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Thickness {
    /// Its variance, V².
    pub v2: f64,
    /// Standard deviation of that, V².
    pub sigma_v2: f64,
}

impl Thickness {
    /// What images say one by one, and the bound that widths set.
    pub fn of(images: &[Image], derivatives: &[Vec<Option<Derivatives>>], reach: f32) -> Self {
        let squares = squares(images, derivatives);
        let told = squares.iter().flatten().flatten().filter(|s| s.slant > 0.0 && s.width > 0.0);
        let mut bounds: Vec<(f64, f64)> = told.map(|s| ((s.width - PIXEL_PX2) / s.slant, 1.0)).collect();
        let Some([bound]) = quantiles(&mut bounds, [NARROWER]) else {
            return Self { v2: 0.0, sigma_v2: 0.0 };
        };
        let (mut v2, mut variance) = (ANY_SHARE.0 * bound, (ANY_SHARE.1 * bound).powi(2));
        let over_images = |n: usize| said_by(&images[n], |i| on_images(images, &squares, n, i, reach));
        let over_lines = |n: usize| said_by(&images[n], |i| on_lines(&images[n], &squares[n], i, reach));
        let mut said: Vec<(f64, f64)> =
            (0..images.len()).flat_map(|n| [over_images(n), over_lines(n)]).flatten().collect();
        if let Some([low, middle, high]) = quantiles(&mut said, [0.25, 0.5, 0.75]) {
            // As many as count, of which those near each other share images; quartiles of normal values are 1.35 sigmas apart.
            let sum = said.iter().map(|s| s.1).sum::<f64>();
            let count = sum * sum / said.iter().map(|s| s.1 * s.1).sum::<f64>() / APART as f64;
            let scatter = 1.25 * (high - low) / 1.35;
            let scatter = if count < LEAST_COUNT { scatter.max(UNSURE * middle.abs()) } else { scatter };
            let share = variance / (variance + scatter * scatter / count);
            v2 = (v2 + share * (middle - v2)).max(0.0);
            variance *= 1.0 - share;
        }
        Self { v2, sigma_v2: variance.sqrt() }
    }
}

/// What a place on a stripe tells: its squared width, pixels and all, is the lens's times 1 + p², as a line cuts a slope p obliquely, and the sheet's times u′².
#[derive(Clone, Copy, Debug)]
struct Squares {
    /// 1 + p².
    oblique: f64,
    /// u′², px²/V².
    slant: f64,
    /// Of the width, px².
    width: f64,
}

impl Squares {
    /// How unlike another's the share of lens and sheet is.
    fn unlike(&self, other: &Self) -> f64 {
        self.oblique * other.slant - other.oblique * self.slant
    }
}

/// The squares line by line of each image; `None` where they do not tell the sheet.
fn squares(images: &[Image], derivatives: &[Vec<Option<Derivatives>>]) -> Vec<Vec<Option<Squares>>> {
    let image = |(image, all): (&Image, &Vec<Option<Derivatives>>)| {
        let one = |i: usize| {
            let d = all[i].filter(|d| !d.outwards)?;
            let near = i.saturating_sub(SMOOTH)..(i + SMOOTH + 1).min(image.seen.len());
            let near = near.filter(|&k| image.seen[k].line.abs_diff(image.seen[i].line) <= SMOOTH);
            let width = f64::from(median(near.clone().map(|k| image.seen[k].width_px)));
            let slope = f64::from(median(near.map(|k| slope(image, k))));
            Some(Squares {
                oblique: 1.0 + slope * slope,
                slant: d.first * d.first,
                width: width * width + PIXEL_PX2,
            })
        };
        (0..image.seen.len()).map(one).collect()
    };
    images.iter().zip(derivatives).map(image).collect()
}

/// Places from one to another, of which each is on the surface of the one before.
type Path = [Squares; APART + 1];

/// The same line in the images that follow.
fn on_images(
    images: &[Image],
    squares: &[Vec<Option<Squares>>],
    n: usize,
    i: usize,
    reach: f32,
) -> Option<Path> {
    let mut before = &images[n].seen[i];
    let mut path = [squares[n][i]?; APART + 1];
    for (step, place) in path.iter_mut().enumerate().skip(1) {
        let image = images.get(n + step)?;
        let k = index(image, before)?;
        let far = (image.seen[k].position_px - before.position_px).abs() as f32 > reach;
        *place = squares[n + step][k].filter(|_| !far)?;
        before = &image.seen[k];
    }
    Some(path)
}

/// Lines that follow in the same image.
fn on_lines(image: &Image, squares: &[Option<Squares>], i: usize, reach: f32) -> Option<Path> {
    let mut path = [squares[i]?; APART + 1];
    for (step, place) in path.iter_mut().enumerate().skip(1) {
        let (before, k) = (i + (step - 1) * STEP_LINES, i + step * STEP_LINES);
        let (from, to) = (&image.seen[before], image.seen.get(k)?);
        let far = (to.position_px - from.position_px).abs() as f32 > reach * STEP_LINES as f32;
        *place = squares[k].filter(|_| !far && to.line == from.line + STEP_LINES)?;
    }
    Some(path)
}

/// What the widths at both ends of the paths from an image's places say of the sheet's variance, V², where distance and focus are nearly the same: the median of its
/// lines, which share its focus and its speckle, as heavy as the ends are unlike; and that weight.
fn said_by(image: &Image, path: impl Fn(usize) -> Option<Path>) -> Option<(f64, f64)> {
    let one = |i: usize| {
        let path = path(i)?;
        let (a, b) = (path[0], path[APART]);
        let unlike = a.unlike(&b);
        let most = path.windows(2).map(|step| step[0].unlike(&step[1]).abs()).fold(0.0, f64::max);
        let evenly = most <= EVENLY * unlike.abs() && unlike != 0.0;
        let least = LEAST_CHANGE * (a.oblique * b.slant).min(b.oblique * a.slant);
        let variance = (a.oblique * b.width - b.oblique * a.width) / unlike;
        (evenly && unlike.abs() >= least).then_some((variance, unlike.abs()))
    };
    // Widths that were taken are the same everywhere, and say nothing.
    let measured = (0..image.seen.len()).filter(|&i| image.seen[i].is_width_measured);
    let mut said: Vec<(f64, f64)> = measured.filter_map(one).collect();
    let heavy = said.iter().map(|s| s.1).sum();
    quantiles(&mut said, [0.5]).map(|[middle]| (middle, heavy))
}

/// Quantiles of values with weights; `None` of none.
fn quantiles<const N: usize>(values: &mut [(f64, f64)], shares: [f64; N]) -> Option<[f64; N]> {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let all = values.iter().map(|v| v.1).sum::<f64>();
    let last = values.last()?.0;
    Some(shares.map(|share| {
        let mut below = 0.0;
        let found = values.iter().find(|v| {
            below += v.1;
            below >= share * all
        });
        found.map_or(last, |v| v.0)
    }))
}
