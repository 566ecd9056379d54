//! Recordings: one MCAP file a scan or a calibration, with messages that Foxglove, Lichtblick and the Python package `mcap` read
//! without our code.
//!
//! | topic | message | says |
//! |---|---|---|
//! | [`topics::FRAME`] | `uwscan.Frame` | an image's row of frames.csv, just before the image |
//! | [`topics::IMAGE`] | `foxglove.RawImage` or `foxglove.CompressedImage` | the image, lossless |
//! | [`topics::GALVO`] | `uwscan.GalvoState` | voltage commanded and read back, settled or not |
//! | [`topics::CALIBRATION`] | `foxglove.CameraCalibration` | the camera, without its window |
//! | [`topics::PROFILE`] | `uwscan.Profile` | the stripe's centres in one image |
//! | [`topics::POINTS`] | `foxglove.PointCloud` | points, metres |
//! | [`topics::TRANSFORMS`] | `foxglove.FrameTransforms` | the galvanometer in the camera's frame; where the instrument is |
//! | [`topics::POSE`] | `foxglove.PoseInFrame` | what a navigation system said |
//! | [`topics::ENVIRONMENT`] | `uwscan.Environment` | temperature, salinity, depth, index |
//! | [`topics::LOG`] | `foxglove.Log` | what went wrong, and when |
//!
//! [`stream`] has the same messages for whoever sends them on as they come.
//!
//! `log_time` is when a message was received, `publish_time` when its image was exposed. A [`Recorder`] writes;
//! [`crate::Capture`] reads, a file that was cut off, too.
//!
//! The types of the crates `mcap` and `foxglove` stay in here: their interfaces are not settled yet.

mod bytes;
mod encode;
mod entries;
mod head;
mod messages;
mod output;
pub(crate) mod reader;
mod recorder;
mod recover;
mod sink;
pub mod stream;
mod walk;

pub(crate) use encode::CAMERA;
pub use entries::{Environment, GalvoState, Level, Picture, Pose, Shot, Stripe};
pub use head::Head;
pub use output::{Compression, Counts, Options};
pub(crate) use output::{Output, Stamps};
pub(crate) use reader::Other;
pub use reader::Topic;
pub use recorder::Recorder;
pub use recover::{Recovered, recover};
pub use sink::{Sink, Through};
pub(crate) use walk::Channel;

/// The ending of a recording's name, without the dot.
pub const ENDING: &str = "mcap";

/// The topics of a recording.
pub mod topics {
    /// Rows of frames.csv.
    pub const FRAME: &str = "/scan/frame";
    /// Images.
    pub const IMAGE: &str = "/camera/image";
    /// The camera's calibration.
    pub const CALIBRATION: &str = "/camera/calibration";
    /// The galvanometer.
    pub const GALVO: &str = "/galvo/state";
    /// Stripes.
    pub const PROFILE: &str = "/scan/profile";
    /// Points.
    pub const POINTS: &str = "/scan/points";
    /// Frames in each other.
    pub const TRANSFORMS: &str = "/tf";
    /// The vehicle.
    pub const POSE: &str = "/nav/pose";
    /// The water.
    pub const ENVIRONMENT: &str = "/environment";
    /// Messages for people.
    pub const LOG: &str = "/log";
    /// The stripe as a line on the image; only in streams, as a recording's viewer can draw [`PROFILE`].
    pub const STRIPE: &str = "/camera/stripe";
    /// How the scan is; only in streams.
    pub const HEALTH: &str = "/scan/health";
}
