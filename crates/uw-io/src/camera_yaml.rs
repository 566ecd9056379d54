//! A calibration's camera as ROS's and OpenCV's YAML files have it.
//!
//! Both know a camera with lens distortion, the same model as ours ("plumb_bob"; k1, k2, p1, p2, k3), and nothing of windows,
//! galvanometer, laser or water. What is written is the camera without its window; that so much is missing stands in the file.

use std::path::Path;

use crate::{
    atomic::{self, Overwrite},
    calibration_toml::CalibrationFile,
    error::Error,
};

/// Which of the two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// ROS's `camera_info` files, as `camera_info_manager` and `camera_calibration_parsers` read them.
    Ros,
    /// OpenCV's `FileStorage`, with the names that its calibration samples use.
    OpenCv,
}

/// What a file of this kind leaves out of a calibration, for people.
pub const LOST: &str = "the camera alone, without its window: galvanometer, laser, both windows, the water's index and all uncertainties are not in it; in water \
    it is wrong by what the window refracts";

/// Writes a calibration's camera, whole or not at all.
///
/// # Errors
/// As [`atomic::write`].
pub fn write(path: &Path, overwrite: Overwrite, file: &CalibrationFile, form: Form) -> Result<(), Error> {
    atomic::write(path, overwrite, |out| out.write_all(text(file, form).as_bytes()))
}

/// The text of such a file. Numbers have as many digits as tell them apart; pixel (0, 0) is the centre of the top-left pixel in all three.
pub fn text(file: &CalibrationFile, form: Form) -> String {
    let calibration = &file.calibration;
    let [width, height] = calibration.image_size;
    let camera = &calibration.instrument.scanner.camera;
    let (fx, fy, cx, cy) = (camera.fx, camera.fy, camera.cx, camera.cy);
    let d = &camera.distortion;
    let k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
    let d = [d.k1, d.k2, d.p1, d.p2, d.k3];
    let note = format!("# By {}: {LOST}.\n", file.software);
    match form {
        Form::Ros => {
            let r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
            let p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
            format!("{note}image_width: {width}\nimage_height: {height}\ncamera_name: uwscan\n")
                + &ros("camera_matrix", [3, 3], &k)
                + "distortion_model: plumb_bob\n"
                + &ros("distortion_coefficients", [1, 5], &d)
                + &ros("rectification_matrix", [3, 3], &r)
                + &ros("projection_matrix", [3, 4], &p)
        }
        Form::OpenCv => {
            format!("%YAML:1.0\n---\n{note}image_width: {width}\nimage_height: {height}\n")
                + &opencv("camera_matrix", [3, 3], &k)
                + &opencv("distortion_coefficients", [1, 5], &d)
                + &format!("avg_reprojection_error: {}\n", number(calibration.statistics.reprojection_rms_px))
        }
    }
}

/// A number that every reader of YAML takes for a real one.
fn number(value: f64) -> String {
    format!("{value:?}")
}

fn list(values: &[f64]) -> String {
    values.iter().map(|value| number(*value)).collect::<Vec<_>>().join(", ")
}

fn ros(name: &str, [rows, cols]: [usize; 2], values: &[f64]) -> String {
    format!("{name}:\n  rows: {rows}\n  cols: {cols}\n  data: [{}]\n", list(values))
}

fn opencv(name: &str, [rows, cols]: [usize; 2], values: &[f64]) -> String {
    let head = format!("{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n");
    format!("{head}   data: [ {} ]\n", list(values))
}
