//! Chessboards drawn with known corners: found, labelled and placed, or refused for the right reason.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

mod accuracy;
mod labelling;
mod refusal;
mod render;

use nalgebra::Vector2;
use render::{Image, Scene};
use uw_calib::{Chessboard, Detection, Rejection, detect};

fn find(image: &Image, inner: [usize; 2]) -> Result<Detection, Rejection> {
    detect(&image.view(), &Chessboard::new(inner[0], inner[1], 1.0).unwrap())
}

/// Distance of each corner from its truth, px, with its label translated to the scene's: labels may be turned
/// and shifted as a whole, never mirrored.
fn errors(scene: &Scene, detection: &Detection) -> Vec<Vector2<f64>> {
    let [cols, rows] = scene.inner.map(|n| n as i64);
    let mut best: Option<Vec<Vector2<f64>>> = None;
    for (a, b) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
        for shift_x in -cols..=2 * cols {
            for shift_y in -rows..=2 * rows {
                let errors: Option<Vec<_>> = detection
                    .corners
                    .iter()
                    .map(|corner| {
                        let [x, y] = corner.index.map(|n| n as i64);
                        let (col, row) = (a * x - b * y + shift_x, b * x + a * y + shift_y);
                        let inside = (0..cols).contains(&col) && (0..rows).contains(&row);
                        inside.then(|| Vector2::from(corner.pixel) - scene.corner(col as usize, row as usize))
                    })
                    .collect();
                let sum = |errors: &[Vector2<f64>]| errors.iter().map(Vector2::norm_squared).sum::<f64>();
                if let Some(errors) = errors
                    && best.as_ref().is_none_or(|b| sum(&errors) < sum(b))
                {
                    best = Some(errors);
                }
            }
        }
    }
    best.expect("more corners than the board has")
}

fn largest(errors: &[Vector2<f64>]) -> f64 {
    errors.iter().map(Vector2::norm).fold(0.0, f64::max)
}

fn rms(errors: &[Vector2<f64>]) -> f64 {
    (errors.iter().map(Vector2::norm_squared).sum::<f64>() / (2 * errors.len()) as f64).sqrt()
}
