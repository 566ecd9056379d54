//! Definitions of the ROS 2 messages that are written, as rosbag2 stores them beside the messages.

/// A type of messages: its name, its fields, and the types that these refer to.
pub(super) struct Definition {
    pub name: &'static str,
    fields: &'static str,
    parts: &'static [(&'static str, &'static str)],
}

impl Definition {
    /// The text in rosbag2's form: the type, then each part below a line of 80 equals signs.
    pub fn text(&self) -> String {
        let rule = "=".repeat(80);
        let parts = self.parts.iter().map(|(name, fields)| format!("{rule}\nMSG: {name}\n{fields}"));
        format!("{}{}", self.fields, parts.collect::<String>())
    }
}

const TIME: (&str, &str) = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const HEADER: (&str, &str) = ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n");
const POINT: (&str, &str) = ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n");
const VECTOR: (&str, &str) = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n");
const QUATERNION: (&str, &str) = ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n");

pub(super) const IMAGE: Definition = Definition {
    name: "sensor_msgs/msg/Image",
    fields: "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n",
    parts: &[HEADER, TIME],
};

pub(super) const VOLTAGE: Definition =
    Definition { name: "std_msgs/msg/Float64", fields: "float64 data\n", parts: &[] };

pub(super) const CAMERA: Definition = Definition {
    name: "sensor_msgs/msg/CameraInfo",
    fields: "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\n\
             float64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n",
    parts: &[
        HEADER,
        TIME,
        (
            "sensor_msgs/RegionOfInterest",
            "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n",
        ),
    ],
};

pub(super) const POINTS: Definition = Definition {
    name: "sensor_msgs/msg/PointCloud2",
    fields: "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n\
             uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
    parts: &[
        HEADER,
        TIME,
        ("sensor_msgs/PointField", "string name\nuint32 offset\nuint8 datatype\nuint32 count\n"),
    ],
};

pub(super) const TRANSFORMS: Definition = Definition {
    name: "tf2_msgs/msg/TFMessage",
    fields: "geometry_msgs/TransformStamped[] transforms\n",
    parts: &[
        (
            "geometry_msgs/TransformStamped",
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
        ),
        ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"),
        HEADER,
        TIME,
        VECTOR,
        QUATERNION,
    ],
};

pub(super) const POSE: Definition = Definition {
    name: "geometry_msgs/msg/PoseStamped",
    fields: "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    parts: &[
        ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"),
        HEADER,
        TIME,
        POINT,
        QUATERNION,
    ],
};
