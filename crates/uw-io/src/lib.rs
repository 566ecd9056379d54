//! Capture folders, recordings, rig files, images and point cloud formats.
//!
//! Everything here turns bytes into checked values and back; nothing computes. A reader refuses what it cannot
//! trust with an [`Error`] that names the file, the place in it, what is wrong and how to mend it. What can be
//! gone on without is a [`Problem`]: data, for the caller to count and to show.
//!
//! | module | file | value |
//! |---|---|---|
//! | [`capture`] | `capture.toml`, `frames.csv`; or a recording | [`Capture`] |
//! | [`recording`] | MCAP | a [`recording::Recorder`] writes it |
//! | [`convert`], [`ros2`] | capture folder ↔ recording; → rosbag2 | |
//! | [`rig`] | `rig.toml` | [`Rig`] |
//! | [`vehicle`] | `vehicle.toml` | [`Vehicle`] |
//! | [`calibration_toml`] | `calibration.toml` | [`CalibrationFile`] |
//! | [`camera_yaml`] | ROS's and OpenCV's camera files, written only | a calibration's camera |
//! | [`images`] | PNG, TIFF, JPEG, PNM | [`GrayImage`] |
//! | [`clouds`] ([`ply`], [`pcd`], [`xyz`], [`e57`], `las`) | PLY, PCD, XYZ and CSV, E57, LAS and LAZ (feature `las`) | [`uw_cloud::PointCloud`] |
//! | [`meshes`] ([`ply`], [`stl`], [`obj`], [`glb`]) | PLY, STL, OBJ; GLB, written only | [`uw_cloud::TriangleMesh`] |
//! | [`nominal`] | TOML or CSV, what an artefact should measure | [`Nominal`] |
//! | [`scene`] | `scene.toml`, what a simulation shows | [`scene::SceneFile`] |
//! | [`disk`] | room and names where files go | |
//! | [`batch`] | `.result.toml`, `table.csv`: what became of an archive's recordings | [`batch::ResultRecord`] |
//! | [`atomic`] | any output | written whole or not at all |

pub mod atomic;
pub mod batch;
pub mod calibration_toml;
pub mod camera_yaml;
pub mod capture;
pub mod clouds;
mod columns;
pub mod convert;
pub mod disk;
pub mod e57;
mod error;
mod folder;
mod frames;
pub mod glb;
pub mod images;
#[cfg(feature = "las")]
pub mod las;
pub mod meshes;
pub mod nominal;
pub mod obj;
pub mod pcd;
pub mod ply;
pub mod recording;
pub mod rig;
pub mod ros2;
pub mod scene;
pub mod stl;
mod text;
mod toml_file;
pub mod truth;
pub mod vehicle;
pub mod xyz;

pub use atomic::Overwrite;
pub use calibration_toml::{CalibrationFile, CaptureSource};
pub use capture::{Capture, FrameRecord, Kind, Medium, Target, file_hash};
pub use error::{Error, Place, Problem, SaidBy, Severity};
pub use folder::NewFolder;
pub use images::{Expect, GrayImage, Pixels, Reduce};
pub use nominal::Nominal;
pub use rig::{Priors, Rig, Water};
pub use vehicle::Vehicle;
