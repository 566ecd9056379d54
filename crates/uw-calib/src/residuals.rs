//! What remained of every measurement of a calibration: for maps and plots, where statistics hide what is systematic.

use crate::data::{Observations, Outside};
use crate::joint::{Scales, State, Used, corner_residuals, stripe_residuals};
use nalgebra::Vector2;
use uw_geom::Rigid;
use uw_geom::frame::{Board, Camera};

/// The residuals of one placement of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewResiduals {
    /// The image of the board.
    pub file: String,
    /// What is outside the windows.
    pub outside: Outside,
    /// Where the board was found to be.
    pub camera_from_board: Rigid<Camera, Board>,
    /// Its middle, by the corners that were seen, board frame, mm.
    pub middle_board_mm: Vector2<f64>,
    /// Its corners.
    pub corners: Vec<CornerRemains>,
    /// Its stripes.
    pub stripes: Vec<StripeRemains>,
}

/// What remained of a corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CornerRemains {
    /// Where it was seen, px.
    pub pixel: Vector2<f64>,
    /// Where the model puts it less where it was seen, px.
    pub residual_px: Vector2<f64>,
    /// The same in standard deviations, as it was weighted: along two axes that make its errors independent, of unit variance where the predicted
    /// covariance and the common scale are right.
    pub standardised: Vector2<f64>,
    /// Whether it took part.
    pub used: bool,
}

/// What remained of a stripe.
#[derive(Clone, Debug, PartialEq)]
pub struct StripeRemains {
    /// Its image.
    pub file: String,
    /// Voltage of the galvanometer.
    pub voltage_v: f64,
    /// Its measurements that the model can place.
    pub points: Vec<StripePointRemains>,
}

/// What remained of a measurement of a stripe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StripePointRemains {
    /// Where it was seen, px.
    pub pixel: Vector2<f64>,
    /// The model less the measurement, along the measured coordinate, px.
    pub residual_px: f64,
    /// Distance of the board's point seen there from the sheet, mm.
    pub off_sheet_mm: f64,
    /// The residual in standard deviations, as it was weighted.
    pub standardised: f64,
    /// Whether it took part.
    pub used: bool,
}

/// The residuals of all placements at a state.
pub(crate) fn remains(
    observations: &Observations,
    state: &State,
    used: &Used,
    scales: Scales,
) -> Vec<ViewResiduals> {
    observations
        .views
        .iter()
        .enumerate()
        .map(|(i, view)| {
            let corners = view.corners.iter().zip(corner_residuals(state, i, view)).zip(&used.corners[i]);
            let stripes = view.stripes.iter().zip(&used.stripes[i]).map(|(stripe, used)| {
                let rows = stripe_residuals(state, i, view, stripe, observations.across);
                let points = stripe.points.iter().zip(rows).zip(used).filter_map(|((point, row), used)| {
                    let row = row?;
                    Some(StripePointRemains {
                        pixel: point.pixel,
                        residual_px: row.px,
                        off_sheet_mm: row.mm,
                        standardised: row.px / (point.sigma_px * scales.stripe_pooled),
                        used: *used,
                    })
                });
                let (file, voltage_v) = (stripe.file.clone(), stripe.voltage_v);
                StripeRemains { file, voltage_v, points: points.collect() }
            });
            let middle = view.corners.iter().map(|c| c.board_mm).sum::<Vector2<f64>>();
            ViewResiduals {
                file: view.file.clone(),
                outside: view.outside,
                camera_from_board: state.poses[i],
                middle_board_mm: middle / view.corners.len().max(1) as f64,
                corners: corners
                    .filter_map(|((corner, row), used)| {
                        let row = row?;
                        Some(CornerRemains {
                            pixel: corner.pixel,
                            residual_px: row.px,
                            standardised: row.whitened / scales.corner,
                            used: *used,
                        })
                    })
                    .collect(),
                stripes: stripes.collect(),
            }
        })
        .collect()
}
