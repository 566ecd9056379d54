//! What a scan or a replay tells of itself.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::Serialize;
use uw_calib::Across;
use uw_cloud::PointCloud;
use uw_io::calibration_toml::CalibrationFile;

/// What the server shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// One scan.
    #[default]
    Scan,
    /// One scan after another, when somebody asks for it.
    Station,
    /// Recordings.
    Replay,
}

/// Where a scan is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    /// Nothing is driven.
    #[default]
    Idle,
    /// Devices are opened.
    Starting,
    /// Frames come.
    Scanning,
    /// Held, the laser off.
    Paused,
    /// No more frames come, and the recording is finished.
    Stopping,
    /// Done.
    Finished,
    /// It could not begin.
    Failed,
    /// A recording is shown.
    Replaying,
}

/// What is known of the laser.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Laser {
    /// It shines.
    On,
    /// It does not.
    Off,
    /// Nobody has asked it.
    #[default]
    Unknown,
}

/// How much a note matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// All is well.
    Info,
    /// Something to know.
    Warning,
    /// Something was lost.
    Error,
}

/// How a scan is.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct State {
    /// Where it is.
    pub phase: Phase,
    /// The laser.
    pub laser: Laser,
    /// The galvanometer's voltage at the latest frame.
    pub voltage_v: Option<f64>,
    /// Frames that are recorded.
    pub frames: usize,
    /// Frames that are wanted.
    pub planned: Option<usize>,
    /// Points made on the fly.
    pub points: usize,
    /// Wanted frames without an image, by reason.
    pub lost: BTreeMap<String, usize>,
    /// Frames a second.
    pub rate_hz: f64,
    /// Since the scan began, s.
    pub elapsed_s: f64,
    /// Until it ends, s, as far as is known.
    pub left_s: Option<f64>,
    /// The recording's name.
    pub recording: Option<String>,
    /// Why it ended, in words.
    pub ended: Option<String>,
    /// When it was so, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
}

/// What stays as it is during a scan.
#[derive(Clone, Debug)]
pub struct About {
    /// What is shown.
    pub mode: Mode,
    /// Width and height of images; zeros before they are known.
    pub image_size: [u32; 2],
    /// The voltages of the sweep.
    pub volts: Option<[f64; 2]>,
    /// The coordinate of a stripe that is measured: `U`, one centre a row.
    pub across: Across,
    /// The instrument, calibrated.
    pub calibration: Option<Arc<CalibrationFile>>,
    /// Recordings that can be opened.
    pub captures: Vec<String>,
    /// What Foxglove's tools may read: names and values.
    pub parameters: Vec<(String, f64)>,
}

impl Default for About {
    fn default() -> Self {
        Self {
            mode: Mode::Scan,
            image_size: [0, 0],
            volts: None,
            across: Across::U,
            calibration: None,
            captures: Vec::new(),
            parameters: Vec::new(),
        }
    }
}

/// One image.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Its number.
    pub frame: u32,
    /// Start of its exposure, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// Whether the laser was on.
    pub laser_on: bool,
    /// The galvanometer's voltage; `None` where the laser was off.
    pub voltage_v: Option<f64>,
    /// The pixels, shared.
    pub image: uw_hw::Frame,
}

/// The stripe and the points of one image.
#[derive(Clone, Debug)]
pub struct Stripe {
    /// The image's number.
    pub frame: u32,
    /// Start of its exposure, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// The galvanometer's voltage.
    pub voltage_v: f64,
    /// The coordinate that was measured.
    pub across: Across,
    /// Lines of the image: rows where [`Stripe::across`] is `U`.
    pub all_lines: u32,
    /// Row or column of each centre.
    pub lines: Vec<u32>,
    /// Its coordinate, px.
    pub position_px: Vec<f64>,
    /// Standard deviation of that, px.
    pub sigma_px: Vec<f32>,
    /// Width of the stripe, px.
    pub width_px: Vec<f32>,
    /// Height above the background, grey levels.
    pub amplitude: Vec<f32>,
    /// The highest grey level.
    pub full_scale: f32,
    /// The points, camera frame, mm.
    pub cloud: PointCloud,
}

/// An image and its stripe, as far as it has one.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    pub picture: Arc<Picture>,
    pub stripe: Option<Arc<Stripe>>,
}

/// A line for people.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Note {
    pub level: Level,
    pub text: String,
    pub stamp_ns: u64,
}

/// Where a replay is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Timeline {
    /// The recording's name.
    pub capture: String,
    /// Of the first image, nanoseconds since the Unix epoch.
    pub start_ns: u64,
    /// Of the last.
    pub end_ns: u64,
    /// How many images.
    pub frames: usize,
    /// The image that is shown: its place, from 0.
    pub at_frame: usize,
    /// Whether it goes on.
    pub playing: bool,
    /// How many times as fast as it was recorded.
    pub rate: f64,
}
