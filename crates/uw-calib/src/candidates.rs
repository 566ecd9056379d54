//! Points that may be corners, from the `chess-corners` crate.
//!
//! The crate takes 8 bits, so the image is stretched to them; the loss does not matter, because positions are
//! fitted on the original. Its own positions are good to 0.03–0.06 px and its covariance has a built-in floor
//! of 0.053 px from one pair of cameras; both are left out.

use chess_corners::{ChessError, CornerDescriptor, Detector, DetectorConfig};

use crate::grid::Candidate;
use crate::view::GreyView;

/// How the image is shown to the detector.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Attempt {
    /// Stretched to its range of brightness.
    Plain,
    /// Local mean and contrast evened out: uneven light, haze.
    Evened,
    /// Averaged over squares of so many pixels: blur, and squares much larger than the detector's ring.
    Reduced(usize),
}

/// In the order in which they are worth trying.
pub(crate) const ATTEMPTS: [Attempt; 4] =
    [Attempt::Plain, Attempt::Evened, Attempt::Reduced(2), Attempt::Reduced(4)];

/// More candidates than this are texture; the strongest are kept. Bounds the time, which grows with their
/// square.
const MAX_CANDIDATES: usize = 3000;
/// Px; three times the detector's ring, so that it has somewhere to stand.
const MIN_SIDE_PX: usize = 16;
/// Share of the pixels that may lie beyond either end of the stretched range: glare and dead pixels.
const TAIL: f64 = 0.005;
/// Windows a side over which brightness is evened: about the size of a square, or several.
const EVENING_WINDOWS: usize = 24;

/// Returns the candidates of one attempt in pixels of the image; none when it is too small or uniform.
pub(crate) fn candidates(view: &GreyView<'_>, attempt: Attempt) -> Vec<Candidate> {
    let factor = if let Attempt::Reduced(factor) = attempt { factor } else { 1 };
    let (width, height) = (view.width() / factor, view.height() / factor);
    if width.min(height) < MIN_SIDE_PX {
        return Vec::new();
    }
    let mut image = reduce(view, factor);
    if attempt == Attempt::Evened {
        image = even(&image, width, height);
    }
    let Some(image) = stretch(&image) else { return Vec::new() };
    let mut found = find(&image, width, height).unwrap_or_default();
    found.sort_by(|a, b| b.response.total_cmp(&a.response));
    found.truncate(MAX_CANDIDATES);
    // The centre of the first averaged square lies (factor − 1)/2 beyond the centre of the first pixel.
    let full = |x: f32| f64::from(x) * factor as f64 + (factor as f64 - 1.0) / 2.0;
    found
        .iter()
        .filter_map(|corner| {
            let axes = corner.axes?.map(|axis| f64::from(axis.angle));
            Some(Candidate { pixel: [full(corner.x), full(corner.y)], axes })
        })
        .filter(|c| c.pixel.iter().chain(&c.axes).all(|x| x.is_finite()))
        .collect()
}

fn find(image: &[u8], width: usize, height: usize) -> Result<Vec<CornerDescriptor>, ChessError> {
    let (Ok(w), Ok(h)) = (u32::try_from(width), u32::try_from(height)) else { return Ok(Vec::new()) };
    Detector::new(DetectorConfig::chess())?.detect_u8(image, w, h)
}

/// Mean over squares of `factor` pixels.
fn reduce(view: &GreyView<'_>, factor: usize) -> Vec<f32> {
    let (width, height) = (view.width() / factor, view.height() / factor);
    let square = |col: usize, row: usize| {
        let mut sum = 0.0;
        for v in row * factor..(row + 1) * factor {
            for u in col * factor..(col + 1) * factor {
                sum += f32::from(view.get(u, v).unwrap_or(0));
            }
        }
        sum / (factor * factor) as f32
    };
    (0..height).flat_map(|row| (0..width).map(move |col| (col, row))).map(|(c, r)| square(c, r)).collect()
}

/// To 0–255 between the tails of the values; `None` for a uniform image.
fn stretch(image: &[f32]) -> Option<Vec<u8>> {
    let mut sorted = image.to_vec();
    let tail = (image.len() as f64 * TAIL) as usize;
    let high_at = image.len().checked_sub(1 + tail)?;
    let low = *sorted.select_nth_unstable_by(tail, f32::total_cmp).1;
    let high = *sorted.select_nth_unstable_by(high_at, f32::total_cmp).1;
    if high <= low {
        return None;
    }
    let scale = 255.0 / (high - low);
    Some(image.iter().map(|x| ((x - low) * scale).round().clamp(0.0, 255.0) as u8).collect())
}

/// Subtracts the local mean and divides by the local spread, over boxes of a fixed share of the image.
fn even(image: &[f32], width: usize, height: usize) -> Vec<f32> {
    let radius = (width.max(height) / EVENING_WINDOWS).max(8);
    // Sums of values and squares over everything above and to the left.
    let mut sums = vec![[0.0_f64; 2]; (width + 1) * (height + 1)];
    for row in 0..height {
        let mut line = [0.0; 2];
        for col in 0..width {
            let x = f64::from(image[row * width + col]);
            line = [line[0] + x, line[1] + x * x];
            let above = sums[row * (width + 1) + col + 1];
            sums[(row + 1) * (width + 1) + col + 1] = [above[0] + line[0], above[1] + line[1]];
        }
    }
    let total = sums[(width + 1) * (height + 1) - 1];
    let n = (width * height) as f64;
    let global = (total[1] / n - (total[0] / n).powi(2)).max(0.0);
    // A twentieth of the image's own spread keeps noise in flat parts down.
    let floor = global / 400.0;
    let mut out = Vec::with_capacity(image.len());
    for row in 0..height {
        let (top, bottom) = (row.saturating_sub(radius), (row + radius + 1).min(height));
        for col in 0..width {
            let (left, right) = (col.saturating_sub(radius), (col + radius + 1).min(width));
            let at = |r: usize, c: usize| sums[r * (width + 1) + c];
            let area = ((bottom - top) * (right - left)) as f64;
            let [mean, square] = [0, 1].map(|k| {
                (at(bottom, right)[k] - at(top, right)[k] - at(bottom, left)[k] + at(top, left)[k]) / area
            });
            let spread = (square - mean * mean).max(floor).sqrt();
            let x = f64::from(image[row * width + col]) - mean;
            out.push(if spread > 0.0 { (x / spread) as f32 } else { 0.0 });
        }
    }
    out
}
