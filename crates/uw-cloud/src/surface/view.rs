//! The plane that a scan's points are triangulated in: the image, or directions from the sensor.

use crate::cloud::PointCloud;
use crate::error::SurfaceError;
use nalgebra::{UnitQuaternion, Vector3};

/// The parameters that a surface was triangulated in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameters {
    /// Where the stripe was seen in the raw image, px.
    Image,
    /// Directions from the sensor, as tangents of angles about the middle one.
    Direction,
}

/// Returns each point's place in a plane in which no two points of what the scanner sees share a place.
///
/// The raw image is one, as a pixel shows one point of the scene (and a refracted, distorted one serves as well as any).
/// Without pixels it is the plane on which the sensor sees the points in central projection.
pub(super) fn places(
    cloud: &PointCloud,
    sensor_mm: Vector3<f64>,
    by_image: bool,
) -> Result<(Parameters, Vec<[f64; 2]>), SurfaceError> {
    if let Some(pixels) = cloud.pixels().filter(|_| by_image) {
        return Ok((Parameters::Image, pixels.iter().map(|p| p.map(f64::from)).collect()));
    }
    let rays = || cloud.positions_mm().iter().map(|p| Vector3::from(*p) - sensor_mm);
    let middle = rays().filter_map(|ray| ray.try_normalize(0.0)).sum::<Vector3<f64>>();
    let surrounded = |behind| SurfaceError::Surrounded { behind, points: cloud.len() };
    let middle = middle.try_normalize(1e-3 * cloud.len() as f64).ok_or_else(|| surrounded(cloud.len()))?;
    let turn = UnitQuaternion::rotation_between(&middle, &Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let mut behind = 0;
    let places = rays()
        .map(|ray| {
            let seen = turn * ray;
            // Within a degree of the plane through the sensor tangents say nothing.
            if seen.z <= ray.norm() * 0.017 {
                behind += 1;
            }
            [seen.x / seen.z, seen.y / seen.z]
        })
        .collect();
    if behind > 0 { Err(surrounded(behind)) } else { Ok((Parameters::Direction, places)) }
}
