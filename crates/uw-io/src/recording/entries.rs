//! What a recording is made of, in this project's units: the recorder turns it into messages.

use uw_calib::Across;

use crate::images::{GrayImage, Pixels};

/// One exposure: a row of frames.csv.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shot<'a> {
    /// Number of the image from 0, in the order of capture: the `frame` of its points. A number that is left out is an image
    /// that is missing.
    pub number: u32,
    /// Name in a capture folder; empty: made from the number when one is needed.
    pub file: &'a str,
    /// Which placement of the target it shows; `None` in a scan.
    pub pose: Option<u32>,
    /// Whether the laser was on.
    pub laser_on: bool,
    /// The galvanometer's voltage during the exposure; `None` where the laser was off.
    pub voltage_v: Option<f64>,
    /// Start of the exposure, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// Significant bits of a pixel's value, right-justified; 0 where they are not known.
    pub bits: u8,
}

/// An image without padding between its rows, or the bytes of an image file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Picture<'a> {
    /// Grey, 8 bits: `width * height` values, row by row.
    U8 {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
        /// The values.
        pixels: &'a [u8],
    },
    /// Grey, up to 16 bits, right-justified.
    U16 {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
        /// The values.
        pixels: &'a [u16],
    },
    /// A PNG file as it is.
    Png(&'a [u8]),
    /// A JPEG file as it is.
    Jpeg(&'a [u8]),
}

impl<'a> Picture<'a> {
    /// The image's values.
    pub fn of(image: &'a GrayImage) -> Self {
        let (width, height) = (image.width, image.height);
        match &image.data {
            Pixels::U8(pixels) => Self::U8 { width, height, pixels },
            Pixels::U16(pixels) => Self::U16 { width, height, pixels },
        }
    }
}

/// What the galvanometer was told, and what it said.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GalvoState {
    /// When it was so, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// Number of the image that it belongs to.
    pub frame: Option<u32>,
    /// Voltage commanded.
    pub commanded_v: Option<f64>,
    /// Voltage that the drive reported.
    pub readback_v: Option<f64>,
    /// Whether the mirror stood still.
    pub settled: Option<bool>,
}

/// The stripe of one image; the slices are of one length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stripe<'a> {
    /// Start of the image's exposure, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// Number of the image.
    pub frame: u32,
    /// The coordinate that was measured.
    pub across: Across,
    /// Row or column of each centre.
    pub lines: &'a [u32],
    /// Its coordinate in the raw image, px.
    pub position_px: &'a [f64],
    /// Standard deviation of that, px.
    pub sigma_px: &'a [f32],
    /// Width of the stripe (standard deviation of its profile), px.
    pub width_px: &'a [f32],
    /// Height above the background, grey levels.
    pub amplitude: &'a [f32],
}

/// The water around the instrument; what is not known is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Environment {
    /// When it was so, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// Degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Practical salinity, psu.
    pub salinity_psu: Option<f64>,
    /// Below the surface, m.
    pub depth_m: Option<f64>,
    /// Index of refraction at the laser's wavelength, relative to air.
    pub index: Option<f64>,
}

/// Where something is: a point p of its own frame is at `rotation * p + position_mm` in `parent`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose<'a> {
    /// When it was there, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// The frame that it is given in, such as `world` or `camera`.
    pub parent: &'a str,
    /// Its own frame, such as `vehicle`; not kept where a navigation system's pose is recorded.
    pub child: &'a str,
    /// Position, mm.
    pub position_mm: [f64; 3],
    /// Rotation as a unit quaternion x, y, z, w.
    pub rotation_xyzw: [f64; 4],
}

/// How much a line of the log matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// All is well.
    Info,
    /// Something to know before trusting the result.
    Warning,
    /// Something was lost.
    Error,
}
