//! Values of this project as Foxglove's messages: metres, and their names of frames.

use foxglove::messages::{
    CameraCalibration, FrameTransform, FrameTransforms, Log, PackedElementField, PointCloud,
    Pose as PoseMessage, PoseInFrame, Quaternion, Vector3, log, packed_element_field::NumericType,
};
use prost::encoding::{
    WireType, encode_key, encode_varint, encoded_len_varint, message as nested, string as text,
};

use uw_calib::Across;

use super::{
    entries::{GalvoState, Level, Picture, Pose, Shot, Stripe},
    messages::{self, foxglove_stamp, stamp},
};
use crate::calibration_toml::CalibrationFile;

/// The frame of the camera in messages.
pub(crate) const CAMERA: &str = "camera";
/// Metres in a millimetre.
const METRES: f64 = 1e-3;

/// Appends a `foxglove.RawImage` or `foxglove.CompressedImage`; the image's bytes are copied once.
///
/// Returns the CRC-32 of its `data`.
pub(super) fn image(picture: &Picture<'_>, stamp_ns: u64, buffer: &mut Vec<u8>) -> u32 {
    let stamp = stamp(stamp_ns);
    match *picture {
        Picture::U8 { width, height, pixels } => {
            raw_head(&stamp, [width, height], ("mono8", width), buffer);
            data(6, pixels.len(), buffer);
            buffer.extend_from_slice(pixels);
            crc32fast::hash(pixels)
        }
        Picture::U16 { width, height, pixels } => {
            raw_head(&stamp, [width, height], ("mono16", width.saturating_mul(2)), buffer);
            data(6, pixels.len() * 2, buffer);
            let start = buffer.len();
            buffer.resize(start + pixels.len() * 2, 0);
            for (to, value) in buffer[start..].chunks_exact_mut(2).zip(pixels) {
                to.copy_from_slice(&value.to_le_bytes());
            }
            crc32fast::hash(&buffer[start..])
        }
        Picture::Png(bytes) => compressed(&stamp, "png", bytes, buffer),
        Picture::Jpeg(bytes) => compressed(&stamp, "jpeg", bytes, buffer),
    }
}

/// All fields of a `foxglove.RawImage` but its data.
fn raw_head(
    stamp: &prost_types::Timestamp,
    [width, height]: [u32; 2],
    (encoding, step): (&str, u32),
    buffer: &mut Vec<u8>,
) {
    nested::encode(1, stamp, buffer);
    prost::encoding::fixed32::encode(2, &width, buffer);
    prost::encoding::fixed32::encode(3, &height, buffer);
    text::encode(4, &encoding.to_owned(), buffer);
    prost::encoding::fixed32::encode(5, &step, buffer);
    text::encode(7, &CAMERA.to_owned(), buffer);
}

fn compressed(stamp: &prost_types::Timestamp, format: &str, bytes: &[u8], buffer: &mut Vec<u8>) -> u32 {
    nested::encode(1, stamp, buffer);
    text::encode(3, &format.to_owned(), buffer);
    text::encode(4, &CAMERA.to_owned(), buffer);
    data(2, bytes.len(), buffer);
    buffer.extend_from_slice(bytes);
    crc32fast::hash(bytes)
}

/// The key and length of a field of bytes, which the caller appends.
fn data(tag: u32, length: usize, buffer: &mut Vec<u8>) {
    buffer.reserve(length + 16 + encoded_len_varint(length as u64));
    encode_key(tag, WireType::LengthDelimited, buffer);
    encode_varint(length as u64, buffer);
}

pub(super) fn row(shot: &Shot<'_>, image_crc32: Option<u32>, lost: &str) -> messages::Frame {
    messages::Frame {
        timestamp: Some(stamp(shot.stamp_ns)),
        frame: shot.number,
        file: shot.file.to_owned(),
        pose: shot.pose,
        laser_on: shot.laser_on,
        voltage_v: shot.voltage_v,
        bits: shot.bits.into(),
        image_crc32,
        lost: lost.to_owned(),
    }
}

pub(super) fn galvo(state: &GalvoState) -> messages::GalvoState {
    messages::GalvoState {
        timestamp: Some(stamp(state.stamp_ns)),
        frame: state.frame,
        commanded_v: state.commanded_v,
        readback_v: state.readback_v,
        settled: state.settled,
    }
}

pub(super) fn profile(stripe: &Stripe<'_>) -> messages::Profile {
    messages::Profile {
        timestamp: Some(stamp(stripe.stamp_ns)),
        frame: stripe.frame,
        axis: match stripe.across {
            Across::U => "u".to_owned(),
            Across::V => "v".to_owned(),
        },
        line: stripe.lines.to_vec(),
        position_px: stripe.position_px.to_vec(),
        sigma_px: stripe.sigma_px.to_vec(),
        width_px: stripe.width_px.to_vec(),
        amplitude: stripe.amplitude.to_vec(),
    }
}

/// The points as a `foxglove.PointCloud`: x y z in metres (float64), and as far as the cloud has them brightness, frame, pixel, `sigma` and
/// `cov_…` in metres and square metres.
pub(super) fn points(cloud: &uw_cloud::PointCloud, stamp_ns: u64) -> PointCloud {
    let mut fields = Vec::new();
    let mut stride = 0_u32;
    let mut field = |name: &str, kind: NumericType, size: u32| {
        fields.push(PackedElementField { name: name.to_owned(), offset: stride, r#type: kind.into() });
        stride += size;
    };
    ["x", "y", "z"].iter().for_each(|name| field(name, NumericType::Float64, 8));
    let (intensities, rows) = (cloud.intensities(), cloud.frame_rows());
    let (pixels, sigmas, covariances) = (cloud.pixels(), cloud.sigmas_mm(), cloud.covariances_mm2());
    if intensities.is_some() {
        field("intensity", NumericType::Float32, 4);
    }
    if rows.is_some() {
        field("frame", NumericType::Uint32, 4);
    }
    if pixels.is_some() {
        ["u", "v"].iter().for_each(|name| field(name, NumericType::Float32, 4));
    }
    if sigmas.is_some() {
        field("sigma", NumericType::Float32, 4);
    }
    if covariances.is_some() {
        let names = ["cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"];
        names.iter().for_each(|name| field(name, NumericType::Float32, 4));
    }
    let mut data = Vec::with_capacity(cloud.len() * stride as usize);
    for (i, position) in cloud.positions_mm().iter().enumerate() {
        position.iter().for_each(|x| data.extend_from_slice(&(x * METRES).to_le_bytes()));
        let mut put = |value: f32| data.extend_from_slice(&value.to_le_bytes());
        intensities.iter().for_each(|v| put(v[i]));
        rows.iter().for_each(|v| data.extend_from_slice(&v[i].to_le_bytes()));
        let mut put = |value: f32| data.extend_from_slice(&value.to_le_bytes());
        pixels.iter().for_each(|v| v[i].iter().for_each(|x| put(*x)));
        sigmas.iter().for_each(|v| put((f64::from(v[i]) * METRES) as f32));
        covariances
            .iter()
            .for_each(|v| v[i].iter().for_each(|x| put((f64::from(*x) * METRES * METRES) as f32)));
    }
    PointCloud {
        timestamp: Some(foxglove_stamp(stamp_ns)),
        frame_id: cloud.frame().name().to_owned(),
        pose: Some(pose_message([0.0; 3], [0.0, 0.0, 0.0, 1.0])),
        point_stride: stride,
        fields,
        data: data.into(),
    }
}

fn pose_message(position_mm: [f64; 3], rotation: [f64; 4]) -> PoseMessage {
    PoseMessage { position: Some(metres(position_mm)), orientation: Some(quaternion(rotation)) }
}

fn metres([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x: x * METRES, y: y * METRES, z: z * METRES }
}

fn quaternion([x, y, z, w]: [f64; 4]) -> Quaternion {
    Quaternion { x, y, z, w }
}

pub(super) fn pose(pose: &Pose<'_>) -> PoseInFrame {
    PoseInFrame {
        timestamp: Some(foxglove_stamp(pose.stamp_ns)),
        frame_id: pose.parent.to_owned(),
        pose: Some(pose_message(pose.position_mm, pose.rotation_xyzw)),
    }
}

pub(super) fn transform(pose: &Pose<'_>) -> FrameTransforms {
    let transform = FrameTransform {
        timestamp: Some(foxglove_stamp(pose.stamp_ns)),
        parent_frame_id: pose.parent.to_owned(),
        child_frame_id: pose.child.to_owned(),
        translation: Some(metres(pose.position_mm)),
        rotation: Some(quaternion(pose.rotation_xyzw)),
    };
    FrameTransforms { transforms: vec![transform] }
}

/// The camera of a calibration as others use it: OpenCV's model of the camera behind its window.
pub(super) fn camera(file: &CalibrationFile, stamp_ns: u64) -> CameraCalibration {
    let c = &file.calibration;
    let camera = &c.instrument.scanner.camera;
    let d = &camera.distortion;
    let (fx, fy, cx, cy) = (camera.fx, camera.fy, camera.cx, camera.cy);
    CameraCalibration {
        timestamp: Some(foxglove_stamp(stamp_ns)),
        frame_id: CAMERA.to_owned(),
        width: c.image_size[0],
        height: c.image_size[1],
        distortion_model: "plumb_bob".to_owned(),
        d: vec![d.k1, d.k2, d.p1, d.p2, d.k3],
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
}

/// Where the calibration puts the galvanometer.
pub(super) fn galvo_in_camera(file: &CalibrationFile, stamp_ns: u64) -> Pose<'static> {
    let galvo = file.calibration.instrument.scanner.camera_from_galvo().isometry();
    let rotation = galvo.rotation.coords;
    Pose {
        stamp_ns,
        parent: CAMERA,
        child: uw_cloud::Frame::Galvo.name(),
        position_mm: galvo.translation.vector.into(),
        rotation_xyzw: [rotation.x, rotation.y, rotation.z, rotation.w],
    }
}

pub(super) fn log(level: Level, message: &str, stamp_ns: u64) -> Log {
    let level = match level {
        Level::Info => log::Level::Info,
        Level::Warning => log::Level::Warning,
        Level::Error => log::Level::Error,
    };
    Log {
        timestamp: Some(foxglove_stamp(stamp_ns)),
        level: level.into(),
        message: message.to_owned(),
        name: "uwscan".to_owned(),
        ..Log::default()
    }
}
