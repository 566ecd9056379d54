//! A capture as a rosbag2: an MCAP file of the profile `ros2` with CDR messages, and its metadata.yaml, in a folder of its own.
//!
//! Messages of Foxglove and of ROS in one file break readers of either. What has no message in ROS's own packages is left out,
//! but for the voltage: `std_msgs/Float64` on the topic [`VOLTAGE`], with the time of the image.

mod cdr;
mod definitions;

use std::{collections::BTreeMap, fs::File, path::Path};

use foxglove::messages as fox;
use prost::Message;

use crate::{
    capture::Capture,
    convert::{Converted, new_folder, put},
    error::{Error, Place, Problem},
    images::{GrayImage, Pixels, Reduce},
    recording::{CAMERA, Channel, Options, Other, Output, Stamps, topics},
};
use cdr::Cdr;
use definitions::Definition;

/// The topic of the galvanometer's voltage at each image.
pub const VOLTAGE: &str = "/galvo/voltage";
/// Name of the file in the folder.
const FILE: &str = "recording.mcap";

/// Writes a capture as a rosbag2 into a new folder, whole or not at all: images, voltages, and of a recording the camera's
/// calibration, points, transforms and poses.
///
/// # Errors
/// [`Error`] where a file can't be read or written. An image that is missing or damaged is a loss in
/// [`Converted::problems`].
pub fn to_ros2(capture: &Capture, out: &Path) -> Result<Converted, Error> {
    new_folder(out, |folder| {
        let path = folder.join(FILE);
        let file = File::create(&path).map_err(Error::file(&path, "write"))?;
        let mut bag = Bag {
            output: Output::begin(file, &path, "ros2", Options::default())?,
            topics: BTreeMap::new(),
            span: None,
        };
        let mut converted = Converted::default();
        images(capture, &mut bag, &mut converted)?;
        let mut left: Vec<String> = Vec::new();
        capture.others(&mut |other: Other<'_>| {
            match message(&other) {
                Some((topic, definition, data)) => {
                    bag.put(topic, definition, other.log_ns, other.publish_ns, &data)?;
                }
                None if !left.iter().any(|topic| topic == other.topic) => left.push(other.topic.to_owned()),
                None => {}
            }
            Ok(())
        })?;
        if !left.is_empty() {
            let path = capture.path.display();
            converted.warnings.push(format!(
                "{path}: ROS's own packages have no message for {}: left out",
                left.join(", ")
            ));
        }
        let Bag { output, topics, span } = bag;
        output.finish()?;
        put(&folder.join("metadata.yaml"), metadata(&topics, span).as_bytes())?;
        Ok(converted)
    })
}

/// A bag in the making.
struct Bag {
    output: Output<File>,
    /// Type, number of the channel and of messages, by topic.
    topics: BTreeMap<&'static str, (&'static str, u16, u64)>,
    /// The first and the last time of a message.
    span: Option<[u64; 2]>,
}

impl Bag {
    fn put(
        &mut self,
        topic: &'static str,
        definition: &Definition,
        log_ns: u64,
        publish_ns: u64,
        data: &[u8],
    ) -> Result<(), Error> {
        self.output.room()?;
        let (_, channel, count) = match self.topics.entry(topic) {
            std::collections::btree_map::Entry::Occupied(known) => known.into_mut(),
            std::collections::btree_map::Entry::Vacant(new) => {
                let channel = self.output.channel_like(&Channel {
                    topic: topic.to_owned(),
                    message_encoding: "cdr".to_owned(),
                    metadata: [("offered_qos_profiles".to_owned(), String::new())].into(),
                    schema_name: definition.name.to_owned(),
                    schema_encoding: "ros2msg".to_owned(),
                    schema_data: definition.text().into_bytes(),
                })?;
                new.insert((definition.name, channel, 0))
            }
        };
        *count += 1;
        let channel = *channel;
        self.span = Some(self.span.map_or([log_ns; 2], |[a, b]| [a.min(log_ns), b.max(log_ns)]));
        self.output.message(channel, Stamps { log_ns, publish_ns, sequence: None }, data)
    }
}

fn images(capture: &Capture, bag: &mut Bag, converted: &mut Converted) -> Result<(), Error> {
    for frame in capture.present() {
        let ns = frame.stamp_ns;
        let image = match capture.image(frame, Reduce::Luma, None) {
            Ok(image) => image,
            Err(error @ Error::File { .. }) => return Err(error),
            Err(error) => {
                converted.problems.push(Problem::loss(frame.row, error));
                continue;
            }
        };
        bag.put(topics::IMAGE, &definitions::IMAGE, ns, ns, &image_message(&image, ns))?;
        if let Some(volts) = frame.voltage_v {
            let mut cdr = Cdr::new();
            cdr.f64(volts);
            bag.put(VOLTAGE, &definitions::VOLTAGE, ns, ns, &cdr.finish())?;
        }
        converted.images += 1;
    }
    if converted.images == 0 {
        let what = "holds no image that can be used";
        return Err(Error::content(Place::file(&capture.path), what, "check that this is the capture meant"));
    }
    Ok(())
}

fn image_message(image: &GrayImage, stamp_ns: u64) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.header(stamp_ns, CAMERA);
    cdr.u32(image.height);
    cdr.u32(image.width);
    let (encoding, sample) = match image.data {
        Pixels::U8(_) => ("mono8", 1),
        Pixels::U16(_) => ("mono16", 2),
    };
    cdr.text(encoding);
    cdr.u8(0);
    cdr.u32(image.width * sample);
    match &image.data {
        Pixels::U8(values) => cdr.bytes(values),
        Pixels::U16(values) => {
            let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
            cdr.bytes(&bytes);
        }
    }
    cdr.finish()
}

/// The message of ROS for one of ours; `None` where there is none.
fn message(other: &Other<'_>) -> Option<(&'static str, &'static Definition, Vec<u8>)> {
    let ns = other.publish_ns;
    match other.topic {
        topics::CALIBRATION => {
            let camera = <fox::CameraCalibration as Message>::decode(other.data).ok()?;
            Some(("/camera/camera_info", &definitions::CAMERA, camera_message(&camera, ns)))
        }
        topics::POINTS => {
            let cloud = <fox::PointCloud as Message>::decode(other.data).ok()?;
            Some((topics::POINTS, &definitions::POINTS, points_message(&cloud, ns)))
        }
        topics::TRANSFORMS => {
            let transforms = <fox::FrameTransforms as Message>::decode(other.data).ok()?;
            Some((topics::TRANSFORMS, &definitions::TRANSFORMS, transforms_message(&transforms, ns)))
        }
        topics::POSE => {
            let pose = <fox::PoseInFrame as Message>::decode(other.data).ok()?;
            let at = pose.pose.unwrap_or_default();
            let mut cdr = Cdr::new();
            cdr.header(ns, &pose.frame_id);
            place(&mut cdr, at.position, at.orientation);
            Some((topics::POSE, &definitions::POSE, cdr.finish()))
        }
        _ => None,
    }
}

fn place(cdr: &mut Cdr, position: Option<fox::Vector3>, rotation: Option<fox::Quaternion>) {
    let p = position.unwrap_or_default();
    cdr.f64s(&[p.x, p.y, p.z]);
    let q = rotation.unwrap_or(fox::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 });
    cdr.f64s(&[q.x, q.y, q.z, q.w]);
}

fn camera_message(camera: &fox::CameraCalibration, ns: u64) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.header(ns, &camera.frame_id);
    cdr.u32(camera.height);
    cdr.u32(camera.width);
    cdr.text(&camera.distortion_model);
    cdr.length(camera.d.len());
    cdr.f64s(&camera.d);
    for (values, count) in [(&camera.k, 9), (&camera.r, 9), (&camera.p, 12)] {
        (0..count).for_each(|i| cdr.f64(values.get(i).copied().unwrap_or(0.0)));
    }
    // No binning, and the whole image.
    (0..6).for_each(|_| cdr.u32(0));
    cdr.u8(0);
    cdr.finish()
}

fn points_message(cloud: &fox::PointCloud, ns: u64) -> Vec<u8> {
    // Foxglove's numbers of types → ROS's: unsigned and signed are the other way round.
    const TYPES: [u8; 9] = [0, 2, 1, 4, 3, 6, 5, 7, 8];
    let points = cloud.data.len() as u32 / cloud.point_stride.max(1);
    let mut cdr = Cdr::new();
    cdr.header(ns, &cloud.frame_id);
    cdr.u32(1);
    cdr.u32(points);
    cdr.length(cloud.fields.len());
    for field in &cloud.fields {
        cdr.text(&field.name);
        cdr.u32(field.offset);
        cdr.u8(usize::try_from(field.r#type).ok().and_then(|t| TYPES.get(t)).copied().unwrap_or(0));
        cdr.u32(1);
    }
    cdr.u8(0);
    cdr.u32(cloud.point_stride);
    cdr.u32(cloud.point_stride.saturating_mul(points));
    cdr.bytes(&cloud.data);
    cdr.u8(1);
    cdr.finish()
}

fn transforms_message(transforms: &fox::FrameTransforms, ns: u64) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.length(transforms.transforms.len());
    for transform in &transforms.transforms {
        cdr.header(ns, &transform.parent_frame_id);
        cdr.text(&transform.child_frame_id);
        place(&mut cdr, transform.translation, transform.rotation);
    }
    cdr.finish()
}

/// metadata.yaml, version 5 of rosbag2.
fn metadata(topics: &BTreeMap<&'static str, (&'static str, u16, u64)>, span: Option<[u64; 2]>) -> String {
    let [first, last] = span.unwrap_or_default();
    let duration = last - first;
    let count: u64 = topics.values().map(|(.., count)| count).sum();
    let listed: String = topics
        .iter()
        .map(|(topic, (name, _, count))| {
            format!(
                "    - topic_metadata:\n        name: {topic}\n        type: {name}\n        serialization_format: cdr\n        \
                 offered_qos_profiles: \"\"\n      message_count: {count}\n"
            )
        })
        .collect();
    format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  duration:\n    nanoseconds: {duration}\n  \
         starting_time:\n    nanoseconds_since_epoch: {first}\n  message_count: {count}\n  topics_with_message_count:\n{listed}  \
         compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - {FILE}\n  files:\n    - path: {FILE}\n      \
         starting_time:\n        nanoseconds_since_epoch: {first}\n      duration:\n        nanoseconds: {duration}\n      \
         message_count: {count}\n"
    )
}
