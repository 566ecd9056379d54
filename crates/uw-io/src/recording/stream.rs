//! A recording's messages one by one, as bytes, for whoever sends them on while they come: the same schemas, by the same encoders.

use foxglove::messages as fox;
use prost::Message;
use uw_calib::Across;
use uw_cloud::PointCloud;

use super::{
    encode,
    entries::{GalvoState, Level, Picture, Shot, Stripe},
    messages::{self, Schema, foxglove_stamp, own, stamp, well_known},
    topics,
};
use crate::calibration_toml::CalibrationFile;

/// A topic and what its messages are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Its name.
    pub name: &'static str,
    /// The name of the messages' schema.
    pub schema_name: String,
    /// In which language the schema is written.
    pub schema_encoding: String,
    /// The schema.
    pub schema: Vec<u8>,
    /// How the messages are encoded.
    pub message_encoding: &'static str,
}

/// How a scan is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Health<'a> {
    /// When it was so, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// In which phase, in a word.
    pub phase: &'a str,
    /// `on`, `off` or `unknown`.
    pub laser: &'a str,
    /// The galvanometer's voltage at the latest image.
    pub voltage_v: Option<f64>,
    /// Images that are recorded.
    pub frames: u32,
    /// Images that are wanted.
    pub planned: Option<u32>,
    /// Wanted exposures without an image.
    pub lost: u32,
    /// Points made on the fly.
    pub points: u32,
    /// Images a second.
    pub rate_hz: f64,
}

/// All topics of a stream.
pub fn topics() -> Vec<Topic> {
    let described: [(&'static str, Schema); 10] = [
        (topics::FRAME, own(messages::FRAME)),
        (topics::IMAGE, well_known::<fox::CompressedImage>()),
        (topics::STRIPE, well_known::<fox::ImageAnnotations>()),
        (topics::GALVO, own(messages::GALVO)),
        (topics::PROFILE, own(messages::PROFILE)),
        (topics::POINTS, well_known::<fox::PointCloud>()),
        (topics::CALIBRATION, well_known::<fox::CameraCalibration>()),
        (topics::TRANSFORMS, well_known::<fox::FrameTransforms>()),
        (topics::HEALTH, own(messages::HEALTH)),
        (topics::LOG, well_known::<fox::Log>()),
    ];
    let topic = |(name, schema): (&'static str, Schema)| Topic {
        name,
        schema_name: schema.name,
        schema_encoding: schema.encoding,
        schema: schema.data,
        message_encoding: schema.message_encoding,
    };
    described.into_iter().map(topic).collect()
}

/// On [`topics::IMAGE`], a JPEG file's bytes; and the CRC-32 that its row has.
pub fn image(jpeg: &[u8], stamp_ns: u64) -> (Vec<u8>, u32) {
    let mut bytes = Vec::new();
    let crc = encode::image(&Picture::Jpeg(jpeg), stamp_ns, &mut bytes);
    (bytes, crc)
}

/// On [`topics::FRAME`].
pub fn frame(shot: &Shot<'_>, image_crc32: u32) -> Vec<u8> {
    encode::row(shot, Some(image_crc32), "").encode_to_vec()
}

/// On [`topics::GALVO`].
pub fn galvo(state: &GalvoState) -> Vec<u8> {
    encode::galvo(state).encode_to_vec()
}

/// On [`topics::PROFILE`].
pub fn profile(stripe: &Stripe<'_>) -> Vec<u8> {
    encode::profile(stripe).encode_to_vec()
}

/// On [`topics::STRIPE`]: a line through the stripe's centres. Foxglove's pixels begin at the corner of the first one, ours in its middle.
pub fn annotation(stripe: &Stripe<'_>) -> Vec<u8> {
    let point = |(&line, &position): (&u32, &f64)| {
        let (position, line) = (position + 0.5, f64::from(line) + 0.5);
        match stripe.across {
            Across::U => fox::Point2 { x: position, y: line },
            Across::V => fox::Point2 { x: line, y: position },
        }
    };
    let stamp = Some(foxglove_stamp(stripe.stamp_ns));
    let centres = fox::PointsAnnotation {
        timestamp: stamp,
        r#type: fox::points_annotation::Type::Points.into(),
        points: std::iter::zip(stripe.lines, stripe.position_px).map(point).collect(),
        outline_color: Some(fox::Color { r: 0.0, g: 0.62, b: 0.45, a: 1.0 }),
        thickness: 1.0,
        ..fox::PointsAnnotation::default()
    };
    let all = fox::ImageAnnotations { timestamp: stamp, points: vec![centres], ..Default::default() };
    all.encode_to_vec()
}

/// On [`topics::POINTS`], metres.
pub fn points(cloud: &PointCloud, stamp_ns: u64) -> Vec<u8> {
    encode::points(cloud, stamp_ns).encode_to_vec()
}

/// On [`topics::CALIBRATION`].
pub fn camera(file: &CalibrationFile, stamp_ns: u64) -> Vec<u8> {
    encode::camera(file, stamp_ns).encode_to_vec()
}

/// On [`topics::TRANSFORMS`]: where the calibration puts the galvanometer.
pub fn transform(file: &CalibrationFile, stamp_ns: u64) -> Vec<u8> {
    encode::transform(&encode::galvo_in_camera(file, stamp_ns)).encode_to_vec()
}

/// On [`topics::HEALTH`].
pub fn health(health: &Health<'_>) -> Vec<u8> {
    let message = messages::Health {
        timestamp: Some(stamp(health.stamp_ns)),
        phase: health.phase.to_owned(),
        laser: health.laser.to_owned(),
        voltage_v: health.voltage_v,
        frames: health.frames,
        planned: health.planned,
        lost: health.lost,
        points: health.points,
        rate_hz: health.rate_hz,
    };
    message.encode_to_vec()
}

/// On [`topics::LOG`].
pub fn log(level: Level, text: &str, at_ns: u64) -> Vec<u8> {
    encode::log(level, text, at_ns).encode_to_vec()
}
