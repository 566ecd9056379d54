//! Points on the fly: the stripe of each frame as it comes, and its points one by one.
//!
//! They are what can be had within milliseconds, not the result: the quicker method of extraction, no background, and without the stage
//! that needs the whole sweep. The final cloud comes from the recording by [`crate::pipeline::reconstruct`].

use crate::pipeline::points::Tracer;
use crate::pipeline::reconstruct::Refraction;
use crate::pipeline::record::session::{Shot, unsigned};
use crate::pipeline::stripes::axis;
use crate::pipeline::sweep::Seen;
use uw_calib::Across;
use uw_cloud::{Frame as CloudFrame, PointCloud};
use uw_geom::Medium;
use uw_hw::Pixels;
use uw_io::calibration_toml::CalibrationFile;
use uw_io::recording;
use uw_stripe::{Extractor, Method, Options, StripeError, View};

/// Extraction and triangulation, each for its own thread.
pub struct Preview<'a> {
    pub(crate) extract: Extract,
    pub(crate) trace: Trace<'a>,
}

impl<'a> Preview<'a> {
    /// A preview by `method`, for images of `bits` significant bits, with `outside` the windows.
    ///
    /// # Errors
    /// [`StripeError`] where the method can't be had.
    pub fn new(
        calibration: &'a CalibrationFile,
        outside: Medium,
        bits: u8,
        method: Method,
    ) -> Result<Self, StripeError> {
        let across = calibration.calibration.across;
        // A calibration by the paper's method has no windows to trace through.
        let refraction = match calibration.calibration.method {
            uw_calib::Method::Joint => Refraction::Exact,
            uw_calib::Method::Paper => Refraction::Paper,
        };
        let tracer = Tracer { calibration, refraction, medium: outside };
        let options = Options {
            method,
            axis: axis(across),
            full_scale_dn: Some(((1u32 << bits) - 1) as f32),
            ..Options::default()
        };
        Ok(Self { extract: Extract { extractor: Extractor::new(options)? }, trace: Trace { tracer, across } })
    }
}

/// The stripe of a frame.
pub(crate) struct SeenFrame {
    number: u32,
    voltage_v: f64,
    stamp_ns: u64,
    exposed_ns: i64,
    seen: Vec<Seen>,
}

/// Finds stripes.
pub(crate) struct Extract {
    extractor: Extractor,
}

impl Extract {
    /// The stripe of a frame; `None` where it has no voltage, or no such view.
    pub(crate) fn see(&mut self, shot: &Shot) -> Option<SeenFrame> {
        let voltage_v = shot.voltage_v?;
        let (frame, method) = (&shot.frame, self.extractor.options().method);
        let (width, height) = (frame.width() as usize, frame.height() as usize);
        let stripe = match frame.pixels() {
            Pixels::U8(values) => {
                let view = View::new(values, width, height, frame.stride()).ok()?;
                self.extractor.extract(view, None).ok()?
            }
            Pixels::U16(values) => {
                let view = View::new(values, width, height, frame.stride()).ok()?;
                self.extractor.extract(view, None).ok()?
            }
        };
        let seen = Seen::of(stripe, method);
        let exposure = frame.exposure();
        let length_ns = i64::try_from(exposure.exposure_ns).unwrap_or(i64::MAX);
        Some(SeenFrame {
            number: shot.number,
            voltage_v,
            stamp_ns: unsigned(exposure.stamp_ns),
            exposed_ns: exposure.stamp_ns.saturating_add(length_ns),
            seen,
        })
    }
}

/// Makes points.
pub(crate) struct Trace<'a> {
    tracer: Tracer<'a>,
    across: Across,
}

/// The stripe and the points of one frame.
pub(crate) struct Traced {
    /// The frame's number.
    pub frame: u32,
    /// Start of its exposure.
    pub stamp_ns: u64,
    /// End of its exposure.
    pub exposed_ns: i64,
    /// The galvanometer's voltage.
    pub voltage_v: f64,
    /// Its points, camera frame.
    pub cloud: PointCloud,
    across: Across,
    lines: Vec<u32>,
    position_px: Vec<f64>,
    sigma_px: Vec<f32>,
    width_px: Vec<f32>,
    amplitude: Vec<f32>,
}

impl Trace<'_> {
    pub(crate) fn points(&self, seen: SeenFrame) -> Traced {
        let SeenFrame { number, voltage_v, stamp_ns, exposed_ns, seen } = seen;
        let all = |value: fn(&Seen) -> f32| seen.iter().map(value).collect();
        let mut traced = Traced {
            frame: number,
            stamp_ns,
            exposed_ns,
            voltage_v,
            cloud: PointCloud::default(),
            across: self.across,
            lines: seen.iter().map(|s| s.line as u32).collect(),
            position_px: seen.iter().map(|s| s.position_px).collect(),
            sigma_px: all(|s| s.sigma_px as f32),
            width_px: all(|s| s.width_px),
            amplitude: all(|s| s.amplitude as f32),
        };
        let (points, _) = self.tracer.points(number, voltage_v, seen.into_iter().map(Ok).collect());
        traced.cloud = PointCloud::from_points(CloudFrame::Camera, &points);
        traced
    }
}

impl Traced {
    pub(crate) fn stripe(&self) -> recording::Stripe<'_> {
        recording::Stripe {
            stamp_ns: self.stamp_ns,
            frame: self.frame,
            across: self.across,
            lines: &self.lines,
            position_px: &self.position_px,
            sigma_px: &self.sigma_px,
            width_px: &self.width_px,
            amplitude: &self.amplitude,
        }
    }
}
