//! Writes a cloud and a mesh in every format into a folder, for readers that are not ours: scripts/clouds.py knows what must be in them.

use std::{error::Error, path::PathBuf};

use uw_cloud::{CloudPoint, Frame, PointCloud, TriangleMesh};
use uw_io::{Overwrite, clouds, meshes};

/// Images and lines of the sweep; every seventh place has no point.
const IMAGES: u32 = 12;
const LINES: u32 = 20;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args_os().nth(1).ok_or("give a folder")?);
    let mut points = Vec::new();
    for n in (0..IMAGES * LINES).filter(|n| n % 7 != 3) {
        let (image, line) = (n / LINES, n % LINES);
        points.push(CloudPoint {
            position_mm: [f64::from(line) - 10.0, f64::from(image) * 0.5, 900.0 + f64::from(n) / 16.0],
            intensity: n as f32,
            frame_row: image,
            pixel: [300.5 + image as f32, line as f32],
            sigma_mm: 0.25,
            covariance_mm2: [0.5, 0.0, 0.0, 0.25, 0.0, 0.125],
            shared_mm: Some([1e-3, 2e-3, -3e-3]),
        });
    }
    let colors = points.iter().map(|p| [p.frame_row as u8, 7, 255]).collect();
    let cloud = PointCloud::from_points(Frame::Camera, &points).with_colors(colors)?;
    for ending in ["ply", "pcd", "e57", "las", "laz", "xyz", "csv"] {
        let path = folder.join(format!("cloud.{ending}"));
        clouds::write(&path, Overwrite::Replace, &cloud, clouds::Format::of(&path)?)?;
    }
    let ascii = folder.join("ascii.pcd");
    clouds::write(&ascii, Overwrite::Replace, &cloud, clouds::Format::of(&ascii)?.as_text())?;
    let vertices = vec![[0.0; 3], [30.0, 0.0, 0.0], [0.0, 20.0, 0.0], [0.0, 0.0, 10.0]];
    let mesh = TriangleMesh::new(Frame::Camera, vertices, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])?;
    for ending in ["ply", "stl", "obj", "glb"] {
        let path = folder.join(format!("mesh.{ending}"));
        meshes::write(&path, Overwrite::Replace, &mesh, meshes::Format::of(&path)?)?;
    }
    Ok(())
}
