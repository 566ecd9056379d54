//! Files that are right, for the tests to spoil.

use std::{fs, path::Path};

use image::{GrayImage, Luma};
use tempfile::TempDir;

pub const CAPTURE: &str = r#"format  = "uwscan-capture"
version = 1
kind    = "calibration"
medium  = "water"

[target]
pattern       = "chessboard"
inner_corners = [11, 8]
square_mm     = 24.0
"#;

pub const RIG: &str = r#"format  = "uwscan-rig"
version = 1

[camera]
width  = 8
height = 6
pixel_um = [8.6, 8.3]
focal_mm = 12.0
bits = 8

[camera.port]
distance_mm  = 10.0
thickness_mm = 8.0
normal       = [0.0, 0.0, 1.0]
index        = 1.5195

[laser]
wavelength_nm = 532.0
apex_mm       = 90.0

[laser.port]
distance_mm  = 35.0
thickness_mm = 8.0
normal       = [0.0, 0.6, 0.8]
index        = 1.4906

[galvo]
degrees_per_volt = 2.0
range_v          = [-10.0, 10.0]
reference_v      = -1.61

[water]
index = 1.3351
"#;

pub const FRAMES: &str = "file,pose,laser,voltage_v,stamp_ns
images/0.png,0,off,,1700000000000000000
images/1.png,0,on,-2.2250,1700000000040000000
images/2.png,1,off,,1700000000080000000
images/3.png,1,on,1.5,1700000000120000000
";

/// A calibration of two poses in a new folder.
pub fn capture() -> TempDir {
    let dir = TempDir::new().unwrap();
    write(dir.path(), "capture.toml", CAPTURE);
    write(dir.path(), "rig.toml", RIG);
    write(dir.path(), "frames.csv", FRAMES);
    fs::create_dir(dir.path().join("images")).unwrap();
    for n in 0..4_u8 {
        let image = GrayImage::from_fn(8, 6, |u, v| Luma([(8 * v + u) as u8 + n]));
        image.save(dir.path().join(format!("images/{n}.png"))).unwrap();
    }
    dir
}

pub fn write(dir: &Path, name: &str, text: impl AsRef<[u8]>) {
    fs::write(dir.join(name), text).unwrap();
}

/// `text` with the first `from` as `to`, which must be there.
pub fn edit(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from:?} is not in the sample");
    text.replacen(from, to, 1)
}

/// Asserts that a message says all of this.
pub fn says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{part:?} is missing in: {message}");
    }
}
