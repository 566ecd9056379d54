//! The truth beside simulated images: `truth/truth.json` and `truth/stripes.csv`.

use serde::Serialize;

/// What a simulation knows. Lengths in millimetres, camera frame; rotations as rows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Truth {
    /// Name of the capture.
    pub name: String,
    /// The true instrument.
    pub rig: TruthRig,
    /// Attenuation along both ways.
    pub attenuation_per_mm: f64,
    /// Inner corners and square of the target; absent in a scan.
    #[serde(flatten)]
    pub target: Option<TruthTarget>,
    /// The things that were there, at time 0.
    pub objects: Vec<TruthObject>,
    /// Voltage of each image; `None` without the laser.
    pub frames: Vec<TruthFrame>,
}

/// The true instrument. The fan and its apex are those before the mirror: as they are in the housing, not as the mirror shows them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthRig {
    /// `air` or `water`, and its index.
    pub medium: &'static str,
    /// At the laser's wavelength.
    pub medium_index: f64,
    /// Sensor and lens.
    pub camera: TruthCamera,
    /// Fan and window.
    pub laser: TruthLaser,
    /// Mirror.
    pub galvo: TruthGalvo,
    /// The galvanometer frame: its axes as rows, and its origin, the axis's point closest to the optical centre.
    pub galvo_frame: TruthFrameAxes,
}

/// Sensor and lens.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthCamera {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Camera matrix, rows.
    pub matrix: [[f64; 3]; 3],
    /// Distortion, OpenCV's meaning, in the order of the name.
    pub distortion_k1_k2_p1_p2_k3: [f64; 5],
    /// Its window.
    pub port: TruthPort,
}

/// A window.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthPort {
    /// Outwards.
    pub normal: [f64; 3],
    /// From the optical centre, or from the galvanometer frame's origin.
    pub distance_mm: f64,
    /// Of the glass.
    pub thickness_mm: f64,
    /// Of the glass.
    pub index: f64,
}

/// Fan and window.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthLaser {
    /// Apex before the mirror.
    pub apex_mm: [f64; 3],
    /// Normal of the fan's plane before the mirror.
    pub fan_normal: [f64; 3],
    /// Middle of the fan before the mirror.
    pub fan_centre: [f64; 3],
    /// Radius of the beam at its waist.
    pub waist_radius_mm: f64,
    /// From the apex to the waist.
    pub waist_at_mm: f64,
    /// In air.
    pub wavelength_nm: f64,
    /// Half of the fan's opening.
    pub half_angle_deg: f64,
    /// Its window.
    pub port: TruthPort,
}

/// Mirror.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthGalvo {
    /// A point of its axis.
    pub axis_point_mm: [f64; 3],
    /// The axis' direction.
    pub axis_direction: [f64; 3],
    /// The mirror's normal at 0 V.
    pub mirror_normal_at_0v: [f64; 3],
    /// Its surface beside its axis.
    pub mirror_offset_mm: f64,
    /// Slope at 0 V.
    pub degrees_per_volt: f64,
    /// Quadratic term, °/V².
    pub c2: f64,
    /// Cubic term, °/V³.
    pub c3: f64,
    /// The voltage that fixes the frame.
    pub reference_v: f64,
}

/// A frame in the camera's.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthFrameAxes {
    /// Axes x, y, z.
    pub rows_x_y_z_in_camera: [[f64; 3]; 3],
    /// Origin.
    pub origin_closest_to_camera_mm: [f64; 3],
}

/// The target.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthTarget {
    /// Along a row, along a column.
    pub inner_corners: [u32; 2],
    /// Side of a square.
    pub square_mm: f64,
    /// Where it was; its frame's origin is inner corner (0, 0).
    pub board_poses: Vec<TruthPose>,
}

/// A placement of the target.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthPose {
    /// Its number.
    pub pose: u32,
    /// Camera from board, rows.
    pub rotation: [[f64; 3]; 3],
    /// Camera from board.
    pub translation_mm: [f64; 3],
}

/// A thing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthObject {
    /// Its name.
    pub name: String,
    /// Camera from object, rows.
    pub rotation: [[f64; 3]; 3],
    /// Camera from object.
    pub translation_mm: [f64; 3],
    /// Its velocity.
    pub velocity_mm_s: [f64; 3],
    /// Radius of a sphere.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius_mm: Option<f64>,
    /// Profile of a surface of revolution, radius and z.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile_rz_mm: Option<Vec<[f64; 2]>>,
}

/// An image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TruthFrame {
    /// Its file.
    pub file: String,
    /// The placement that it shows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose: Option<u32>,
    /// The voltage, with the laser on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voltage_v: Option<f64>,
}

/// An exact stripe centre: row of frames.csv, pixel, surface point (mm, camera frame), and the number of its object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StripePoint {
    /// Row of frames.csv.
    pub frame: usize,
    /// Where it is seen, px.
    pub uv: [f64; 2],
    /// What is seen.
    pub xyz_mm: [f64; 3],
    /// In the order of the truth's objects.
    pub object: usize,
}

impl Truth {
    /// The text of truth.json.
    pub fn to_json(&self) -> String {
        // Records of numbers and names always serialise; what is no finite number is null.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

/// The text of stripes.csv.
pub fn stripes_csv(points: &[StripePoint]) -> String {
    let mut text = String::from("frame,u,v,x_mm,y_mm,z_mm,object\n");
    for StripePoint { frame, uv: [u, v], xyz_mm: [x, y, z], object } in points {
        text += &format!("{frame},{u:.6},{v:.6},{x:.6},{y:.6},{z:.6},{object}\n");
    }
    text
}
