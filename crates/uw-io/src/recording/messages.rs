//! The messages of a recording: Foxglove's where there is a well-known one, ours for what only this instrument says.
//!
//! Ours are Protocol Buffers, too. Their fields are numbered by hand and never renumbered: a field is added at the end,
//! and one that is no longer written leaves its number unused.

use foxglove::Encode;
use prost::Message;
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FieldOptions, FileDescriptorProto, FileDescriptorSet, Timestamp,
    field_descriptor_proto::{Label, Type},
};

/// The row of frames.csv of one image: on the topic [`super::topics::FRAME`], just before the image.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Frame {
    /// Start of the exposure.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// Number of the image, from 0; the `sequence` of its message.
    #[prost(uint32, tag = "2")]
    pub frame: u32,
    /// Name of the image in a capture folder; empty where it has none.
    #[prost(string, tag = "3")]
    pub file: String,
    /// Which placement of the target the image shows; absent in a scan.
    #[prost(uint32, optional, tag = "4")]
    pub pose: Option<u32>,
    /// Whether the laser was on.
    #[prost(bool, tag = "5")]
    pub laser_on: bool,
    /// The galvanometer's voltage during the exposure; absent where the laser was off.
    #[prost(double, optional, tag = "6")]
    pub voltage_v: Option<f64>,
    /// Significant bits of a pixel's value; 0 where they are not known.
    #[prost(uint32, tag = "7")]
    pub bits: u32,
    /// CRC-32 (IEEE) of the image message's `data`; absent where there is no image.
    #[prost(fixed32, optional, tag = "8")]
    pub image_crc32: Option<u32>,
    /// Why there is no image; empty where there is one.
    #[prost(string, tag = "9")]
    pub lost: String,
}

/// What the galvanometer was told and what it said, on the topic [`super::topics::GALVO`].
#[derive(Clone, PartialEq, Message)]
pub(crate) struct GalvoState {
    /// When it was so.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// Number of the image that it belongs to; absent between images.
    #[prost(uint32, optional, tag = "2")]
    pub frame: Option<u32>,
    /// Voltage that was commanded.
    #[prost(double, optional, tag = "3")]
    pub commanded_v: Option<f64>,
    /// Voltage that the drive reported.
    #[prost(double, optional, tag = "4")]
    pub readback_v: Option<f64>,
    /// Whether the mirror stood still.
    #[prost(bool, optional, tag = "5")]
    pub settled: Option<bool>,
}

/// The stripe of one image, on the topic [`super::topics::PROFILE`]. All lists are of one length.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Profile {
    /// Start of the image's exposure.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// Number of the image.
    #[prost(uint32, tag = "2")]
    pub frame: u32,
    /// The coordinate that was measured: `u` (one centre a row) or `v` (one a column).
    #[prost(string, tag = "3")]
    pub axis: String,
    /// Row or column of each centre, px.
    #[prost(uint32, repeated, tag = "4")]
    pub line: Vec<u32>,
    /// The centre's coordinate in the raw image, px; 0 is the middle of the first pixel.
    #[prost(double, repeated, tag = "5")]
    pub position_px: Vec<f64>,
    /// Its standard deviation, px.
    #[prost(float, repeated, tag = "6")]
    pub sigma_px: Vec<f32>,
    /// Width of the stripe (standard deviation of its profile), px.
    #[prost(float, repeated, tag = "7")]
    pub width_px: Vec<f32>,
    /// Height of the stripe above its background, grey levels.
    #[prost(float, repeated, tag = "8")]
    pub amplitude: Vec<f32>,
}

/// The water around the instrument, on the topic [`super::topics::ENVIRONMENT`].
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Environment {
    /// When it was so.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// Degrees Celsius.
    #[prost(double, optional, tag = "2")]
    pub temperature_c: Option<f64>,
    /// Practical salinity, psu.
    #[prost(double, optional, tag = "3")]
    pub salinity_psu: Option<f64>,
    /// Below the surface, m.
    #[prost(double, optional, tag = "4")]
    pub depth_m: Option<f64>,
    /// Index of refraction at the laser's wavelength, relative to air.
    #[prost(double, optional, tag = "5")]
    pub index: Option<f64>,
}

/// How a scan is, on the topic [`super::topics::HEALTH`].
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Health {
    /// When it was so.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// `idle`, `starting`, `scanning`, `paused`, `stopping`, `finished`, `failed` or `replaying`.
    #[prost(string, tag = "2")]
    pub phase: String,
    /// `on`, `off` or `unknown`.
    #[prost(string, tag = "3")]
    pub laser: String,
    /// The galvanometer's voltage at the latest image.
    #[prost(double, optional, tag = "4")]
    pub voltage_v: Option<f64>,
    /// Images that are recorded.
    #[prost(uint32, tag = "5")]
    pub frames: u32,
    /// Images that are wanted.
    #[prost(uint32, optional, tag = "6")]
    pub planned: Option<u32>,
    /// Wanted exposures without an image.
    #[prost(uint32, tag = "7")]
    pub lost: u32,
    /// Points made on the fly.
    #[prost(uint32, tag = "8")]
    pub points: u32,
    /// Images a second.
    #[prost(double, tag = "9")]
    pub rate_hz: f64,
}

const PROTOBUF: &str = "protobuf";

/// A schema as an MCAP file holds it.
pub(crate) struct Schema {
    pub name: String,
    pub encoding: String,
    pub data: Vec<u8>,
    /// Of the messages.
    pub message_encoding: &'static str,
}

/// The schema of one of Foxglove's messages.
pub(crate) fn well_known<T: Encode>() -> Schema {
    let (name, encoding, data) = match T::get_schema() {
        Some(schema) => (schema.name, schema.encoding, schema.data.into_owned()),
        None => Default::default(),
    };
    Schema { name, encoding, data, message_encoding: PROTOBUF }
}

/// One message of ours: its name, and the name, number, kind and multiplicity of each field.
type Described = (&'static str, &'static [(&'static str, i32, Type, Label)]);

use Label::{Optional, Repeated};
use Type::{Bool, Double, Fixed32, Float, Message as Stamp, String as Text, Uint32};

pub(crate) const FRAME: Described = (
    "Frame",
    &[
        ("timestamp", 1, Stamp, Optional),
        ("frame", 2, Uint32, Optional),
        ("file", 3, Text, Optional),
        ("pose", 4, Uint32, Optional),
        ("laser_on", 5, Bool, Optional),
        ("voltage_v", 6, Double, Optional),
        ("bits", 7, Uint32, Optional),
        ("image_crc32", 8, Fixed32, Optional),
        ("lost", 9, Text, Optional),
    ],
);
pub(crate) const GALVO: Described = (
    "GalvoState",
    &[
        ("timestamp", 1, Stamp, Optional),
        ("frame", 2, Uint32, Optional),
        ("commanded_v", 3, Double, Optional),
        ("readback_v", 4, Double, Optional),
        ("settled", 5, Bool, Optional),
    ],
);
pub(crate) const PROFILE: Described = (
    "Profile",
    &[
        ("timestamp", 1, Stamp, Optional),
        ("frame", 2, Uint32, Optional),
        ("axis", 3, Text, Optional),
        ("line", 4, Uint32, Repeated),
        ("position_px", 5, Double, Repeated),
        ("sigma_px", 6, Float, Repeated),
        ("width_px", 7, Float, Repeated),
        ("amplitude", 8, Float, Repeated),
    ],
);
pub(crate) const ENVIRONMENT: Described = (
    "Environment",
    &[
        ("timestamp", 1, Stamp, Optional),
        ("temperature_c", 2, Double, Optional),
        ("salinity_psu", 3, Double, Optional),
        ("depth_m", 4, Double, Optional),
        ("index", 5, Double, Optional),
    ],
);

pub(crate) const HEALTH: Described = (
    "Health",
    &[
        ("timestamp", 1, Stamp, Optional),
        ("phase", 2, Text, Optional),
        ("laser", 3, Text, Optional),
        ("voltage_v", 4, Double, Optional),
        ("frames", 5, Uint32, Optional),
        ("planned", 6, Uint32, Optional),
        ("lost", 7, Uint32, Optional),
        ("points", 8, Uint32, Optional),
        ("rate_hz", 9, Double, Optional),
    ],
);

const STAMP_FILE: &str = "google/protobuf/timestamp.proto";

fn field(name: &str, number: i32, kind: Type, label: Label, message: Option<&str>) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        label: Some(label.into()),
        r#type: Some(kind.into()),
        type_name: message.map(str::to_owned),
        options: (label == Repeated).then(|| FieldOptions { packed: Some(true), ..FieldOptions::default() }),
        ..FieldDescriptorProto::default()
    }
}

fn proto_file(name: &str, package: &str, syntax: &str, message: DescriptorProto) -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some(name.to_owned()),
        package: Some(package.to_owned()),
        syntax: Some(syntax.to_owned()),
        message_type: vec![message],
        ..FileDescriptorProto::default()
    }
}

/// The schema of one of our messages: its descriptor, and that of the time it refers to.
pub(crate) fn own((name, fields): Described) -> Schema {
    let time = DescriptorProto {
        name: Some("Timestamp".to_owned()),
        field: vec![
            field("seconds", 1, Type::Int64, Optional, None),
            field("nanos", 2, Type::Int32, Optional, None),
        ],
        ..DescriptorProto::default()
    };
    let message = DescriptorProto {
        name: Some(name.to_owned()),
        field: fields
            .iter()
            .map(|&(name, number, kind, label)| {
                let refers = (kind == Stamp).then_some(".google.protobuf.Timestamp");
                field(name, number, kind, label, refers)
            })
            .collect(),
        ..DescriptorProto::default()
    };
    // In proto2 a field that is absent can be told from one that is zero, without more ado.
    let mut ours = proto_file(&format!("uwscan/{name}.proto"), "uwscan", "proto2", message);
    ours.dependency = vec![STAMP_FILE.to_owned()];
    let file = vec![proto_file(STAMP_FILE, "google.protobuf", "proto3", time), ours];
    Schema {
        name: format!("uwscan.{name}"),
        encoding: PROTOBUF.to_owned(),
        data: FileDescriptorSet { file }.encode_to_vec(),
        message_encoding: PROTOBUF,
    }
}

/// Nanoseconds since the Unix epoch as messages carry them, without loss.
pub(crate) fn stamp(ns: u64) -> Timestamp {
    Timestamp { seconds: (ns / 1_000_000_000) as i64, nanos: (ns % 1_000_000_000) as i32 }
}

/// The same for Foxglove's messages, whose seconds end in the year 2106.
pub(crate) fn foxglove_stamp(ns: u64) -> foxglove::messages::Timestamp {
    let seconds = u32::try_from(ns / 1_000_000_000);
    seconds.map_or(foxglove::messages::Timestamp::MAX, |sec| {
        foxglove::messages::Timestamp::new_checked(sec, (ns % 1_000_000_000) as u32)
            .unwrap_or(foxglove::messages::Timestamp::MAX)
    })
}

/// Nanoseconds since the Unix epoch of a message's time; `None` for what is no time after 1970, or after 2554.
pub(crate) fn stamp_ns(stamp: Option<&Timestamp>) -> Option<u64> {
    let stamp = stamp?;
    let seconds = u64::try_from(stamp.seconds).ok()?;
    let nanos = u64::try_from(stamp.nanos).ok()?;
    seconds.checked_mul(1_000_000_000)?.checked_add(nanos)
}
