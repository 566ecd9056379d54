//! What calibration is given: what is known of the instrument beforehand, and what its images showed.

use nalgebra::{Matrix2, Vector2};
use uw_geom::Port;

/// What is known before calibration (FORMATS §2): drawing values and how far to trust them.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// Image size, columns and rows, px.
    pub image_size: [u32; 2],
    /// First guess of fx, fy, px.
    pub focal_px: [f64; 2],
    /// The camera's window, from the optical centre.
    pub camera_port: Port,
    /// The laser's window, from the galvanometer frame's origin; normal in the camera frame.
    pub laser_port: Port,
    /// Geometric length from the fan's apex to the mirror's axis, mm, if known.
    pub apex_mm: Option<f64>,
    /// Mechanical, radians per volt; positive.
    pub radians_per_volt: f64,
    /// The voltage that fixes the galvanometer frame.
    pub reference_v: f64,
    /// Standard deviations of all that.
    pub priors: Priors,
}

/// Standard deviations of what a rig file says; the defaults are those of FORMATS §2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Priors {
    /// Optical centre to the camera's window, mm.
    pub camera_port_distance_mm: f64,
    /// Galvanometer origin to the laser's window, mm.
    pub laser_port_distance_mm: f64,
    /// Thickness of either window, mm.
    pub thickness_mm: f64,
    /// Each of the two tilts of either window, degrees.
    pub normal_deg: f64,
    /// Index of either glass.
    pub glass_index: f64,
    /// Index of water.
    pub water_index: f64,
    /// Apex to axis, mm.
    pub apex_mm: f64,
    /// Relative error of the mirror's degrees per volt.
    pub degrees_per_volt_rel: f64,
    /// Quadratic term, °/V².
    pub galvo_c2: f64,
    /// Cubic term, °/V³.
    pub galvo_c3: f64,
    /// Mirror surface to axis, mm.
    pub mirror_offset_mm: f64,
    /// Fan plane against axis, degrees.
    pub fan_tilt_deg: f64,
    /// By how much the fan's plane misses the axis, mm.
    pub fan_offset_mm: f64,
    /// Where along the axis the fan's apex lies, from the axis's point closest to the optical centre, mm.
    pub apex_along_axis_mm: f64,
}

impl Default for Priors {
    fn default() -> Self {
        Self {
            camera_port_distance_mm: 0.5,
            laser_port_distance_mm: 0.5,
            thickness_mm: 0.05,
            normal_deg: 0.5,
            glass_index: 5e-4,
            water_index: 5e-4,
            apex_mm: 3.0,
            degrees_per_volt_rel: 5e-3,
            galvo_c2: 3e-4,
            galvo_c3: 3e-4,
            mirror_offset_mm: 0.3,
            fan_tilt_deg: 0.3,
            fan_offset_mm: 0.5,
            apex_along_axis_mm: 30.0,
        }
    }
}

/// What is outside the windows during a capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outside {
    /// Air, index 1.
    Air,
    /// Water, by its nominal indices; what calibration finds is an offset common to all captures in water.
    Water {
        /// At the laser's wavelength.
        laser_index: f64,
        /// At the wavelength of the light on the board.
        board_index: f64,
    },
}

/// Along which pixel coordinate a stripe is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Across {
    /// One measurement a row: u is measured, v is the row (a stripe roughly along the columns).
    U,
    /// One measurement a column: v is measured.
    V,
}

impl Across {
    /// Index of the measured coordinate in a pixel (u, v).
    pub fn index(self) -> usize {
        match self {
            Self::U => 0,
            Self::V => 1,
        }
    }
}

/// A corner of the board in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CornerPoint {
    /// On the board, mm (z = 0).
    pub board_mm: Vector2<f64>,
    /// Where it was seen, px.
    pub pixel: Vector2<f64>,
    /// Covariance of that, px²; only its shape and ratios matter, the common scale is estimated.
    pub covariance: Matrix2<f64>,
}

/// A measurement of the stripe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StripePoint {
    /// Where it was seen: measured along [`Across`], exact along the other coordinate, px.
    pub pixel: Vector2<f64>,
    /// Predicted standard deviation along the measured coordinate, px; the common scale is estimated.
    pub sigma_px: f64,
    /// Half-width (Gaussian sigma) of the stripe, px.
    pub width_px: f64,
}

/// The stripe at one voltage on one placement of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct StripeView {
    /// The image, as messages name it.
    pub file: String,
    /// Galvanometer voltage.
    pub voltage_v: f64,
    /// What was measured.
    pub points: Vec<StripePoint>,
}

/// One placement of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardView {
    /// The image of the board, as messages name it.
    pub file: String,
    /// What is outside the windows.
    pub outside: Outside,
    /// Side of a square, mm.
    pub square_mm: f64,
    /// Corners found.
    pub corners: Vec<CornerPoint>,
    /// Stripes on it.
    pub stripes: Vec<StripeView>,
}

/// All that one calibration is computed from.
#[derive(Clone, Debug, PartialEq)]
pub struct Observations {
    /// Along which coordinate the stripes were measured.
    pub across: Across,
    /// Placements of the board, over all captures.
    pub views: Vec<BoardView>,
}
