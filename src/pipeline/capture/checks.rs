//! What one placement's images show: the board, and the stripe on it.

use crate::Error;
use crate::pipeline::stripes::extractor;
use nalgebra::{Matrix3, Vector2};
use std::path::Path;
use uw_calib::{
    Across, Chessboard, CornerPoint, GreyView, Layout, Samples, apply_homography, detect, homography,
};
use uw_hw::{Frame, Pixels};
use uw_stripe::{Stripe, View};

/// Corners less certain than this (median) are blurred: the board moved, or is out of focus, px.
const BLURRED_PX: f64 = 0.15;
/// Above this share of pixels at full scale the board's white squares run into the black ones.
const CLIPPED: f64 = 0.25;
/// Above this share, something of the board is at full scale: worth saying.
const TOUCHED: f64 = 0.02;
/// Lines with a stripe on the board that make a stripe.
pub(super) const STRIPE_LINES: usize = 8;

/// The board in an image without the laser.
#[derive(Debug)]
pub(super) struct Board {
    pub(super) corners: Vec<CornerPoint>,
    /// Whether all of it was seen.
    pub(super) full: bool,
    /// Median standard deviation of a corner's coordinate, px.
    pub(super) sharp_px: f64,
    /// What is worth saying, though it does.
    pub(super) notes: Vec<String>,
    /// From pixels to the board, mm.
    board_from_pixel: Matrix3<f64>,
    last_corner_mm: Vector2<f64>,
}

/// The board of an image, or why it does not serve, said to whoever holds the board.
pub(super) fn board(frame: &Frame, board: &Chessboard) -> Result<Board, String> {
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let full_scale = ((1_u32 << frame.significant_bits()) - 1) as u16;
    let samples = match frame.pixels() {
        Pixels::U8(values) => Samples::U8(values),
        Pixels::U16(values) => Samples::U16(values),
    };
    let layout = Layout { width, height, stride: frame.stride() };
    let view = GreyView::new(samples, layout, full_scale).map_err(|e| e.to_string())?;
    let clipped = clipped(&view);
    let found = detect(&view, board).map_err(|reason| match clipped > CLIPPED {
        true => format!(
            "{reason}; {:.0} % of the image is at full scale: less light, or a shorter exposure",
            clipped * 100.0
        ),
        false => format!("{reason}: show all of it, evenly lit and still"),
    })?;
    let corners: Vec<CornerPoint> = found
        .corners
        .iter()
        .map(|corner| {
            let [x, y, _] = board.corner_mm(corner.index);
            CornerPoint {
                board_mm: Vector2::new(x, y),
                pixel: Vector2::from(corner.pixel),
                covariance: corner.covariance,
            }
        })
        .collect();
    let mut sigmas: Vec<f64> = corners.iter().map(|c| (0.5 * c.covariance.trace()).sqrt()).collect();
    sigmas.sort_by(f64::total_cmp);
    let sharp_px = sigmas.get(sigmas.len() / 2).copied().unwrap_or(f64::NAN);
    if sharp_px.is_nan() || sharp_px > BLURRED_PX {
        return Err(format!(
            "its corners are blurred (±{sharp_px:.2} px): hold it still, or see to focus and light"
        ));
    }
    let pairs: Vec<_> =
        corners.iter().map(|c| ([c.pixel.x, c.pixel.y], [c.board_mm.x, c.board_mm.y])).collect();
    let Some(board_from_pixel) = homography(&pairs) else {
        return Err("its corners lie on a line: turn it towards the camera".to_owned());
    };
    let mut notes = Vec::new();
    if clipped > TOUCHED {
        notes.push(format!(
            "{:.0} % of the image is at full scale: less light, or a shorter exposure, is better",
            clipped * 100.0
        ));
    }
    let whole = board.inner_cols() * board.inner_rows();
    if corners.len() < whole {
        notes.push(format!("{} of its {whole} corners are seen", corners.len()));
    }
    let [x, y, _] = board.corner_mm([board.inner_cols() - 1, board.inner_rows() - 1]);
    Ok(Board {
        corners,
        full: found.full,
        sharp_px,
        notes,
        board_from_pixel,
        last_corner_mm: Vector2::new(x, y),
    })
}

fn clipped(view: &GreyView<'_>) -> f64 {
    let (width, height, full) = (view.width(), view.height(), view.saturation());
    let at = |i: usize| view.get(i % width, i / width).is_some_and(|value| value >= full);
    (0..width * height).filter(|&i| at(i)).count() as f64 / (width * height) as f64
}

impl Board {
    /// Whether a pixel shows a place between the outermost corners.
    fn holds(&self, pixel: [f64; 2]) -> bool {
        apply_homography(&self.board_from_pixel, pixel).is_some_and(|[x, y]| {
            (0.0..=self.last_corner_mm.x).contains(&x) && (0.0..=self.last_corner_mm.y).contains(&y)
        })
    }

    /// Lines on which the stripe of an image lies on the board, whichever way it runs.
    ///
    /// # Errors
    /// [`Error::Stripe`] for an image that extraction can't take.
    pub(super) fn stripe_lines(&self, frame: &Frame) -> Result<usize, Error> {
        Ok(self.lines_across(frame, Across::U)?.max(self.lines_across(frame, Across::V)?))
    }

    fn lines_across(&self, frame: &Frame, across: Across) -> Result<usize, Error> {
        let path = Path::new("image");
        let failed = |source| Error::Stripe { path: path.to_owned(), source };
        let mut extractor = extractor(across, frame.significant_bits(), true).map_err(failed)?;
        let (width, height) = (frame.width() as usize, frame.height() as usize);
        let stripe: &Stripe = match frame.pixels() {
            Pixels::U8(values) => View::new(values, width, height, frame.stride())
                .and_then(|view| extractor.extract(view, None))
                .map_err(failed)?,
            Pixels::U16(values) => View::new(values, width, height, frame.stride())
                .and_then(|view| extractor.extract(view, None))
                .map_err(failed)?,
        };
        let on_board = |m: &uw_stripe::Measurement| self.holds(stripe.axis.uv(m.line, m.position_px));
        Ok(stripe.measurements().filter(on_board).count())
    }
}
