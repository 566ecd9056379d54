//! Which way the surface faces at a point: the plane through its neighbours.

use crate::cloud::PointCloud;
use crate::eigen::least;
use crate::error::CloudError;
use crate::neighbours::{Hood, Neighbours};
use nalgebra::{Matrix3, Vector3};

/// Neighbours that a normal is taken from: on a scan, three stripes of eight.
pub const NORMAL_NEIGHBOURS: usize = 24;

/// Neighbours that lie along one line to within this share (their second principal spread over the first, squared) are of one
/// stripe and tell no plane.
const LEAST_BREADTH: f64 = 0.02;

/// The surface about a point, as its neighbours tell it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalPlane {
    /// Unit normal.
    pub normal: Vector3<f64>,
    /// Root mean square distance of the neighbours from their plane, mm: noise, and what the surface curves.
    pub roughness_mm: f64,
    /// Distance of the farthest neighbour, mm.
    pub reach_mm: f64,
}

/// Returns the plane through the neighbours of a place, its normal towards the sensor; `None` where they determine none.
///
/// Where the nearest ones lie on one line, as a stripe's points do that stand closer than the stripes, four times as many are
/// asked.
pub fn local_plane(
    positions_mm: &[[f64; 3]],
    neighbours: &Neighbours,
    place_mm: &[f64; 3],
    count: usize,
    sensor_mm: &[f64; 3],
) -> Option<LocalPlane> {
    counts(count).into_iter().find_map(|count| {
        let near = neighbours.nearest(place_mm, count);
        let reach_mm = near.last()?.0.sqrt();
        plane_of(near.iter().map(|&(_, i)| positions_mm[i]), place_mm, sensor_mm, reach_mm)
    })
}

/// Returns the plane through the neighbours of a place, as [`local_plane`], with some of them of other images than the nearest ones.
pub(crate) fn local_plane_of_several(
    positions_mm: &[[f64; 3]],
    neighbours: &Neighbours,
    rows: Option<&[u32]>,
    place_mm: &[f64; 3],
    count: usize,
    sensor_mm: &[f64; 3],
) -> Option<LocalPlane> {
    let near = neighbours.nearest_of_several(place_mm, count, rows);
    let reach_mm = near.last()?.0.sqrt();
    plane_of(near.iter().map(|&(_, i)| positions_mm[i]), place_mm, sensor_mm, reach_mm)
}

/// As many neighbours as are asked for first, and where these tell no plane.
fn counts(count: usize) -> [usize; 2] {
    let few = count.max(4);
    [few, 4 * few]
}

fn plane_of_hood(hood: &Hood<'_>, sensor_mm: &[f64; 3]) -> Option<LocalPlane> {
    let reach_mm = hood.distances2.iter().copied().fold(0.0, f64::max).sqrt();
    plane_of(hood.near.iter().copied(), &hood.place, sensor_mm, reach_mm)
}

/// Returns the plane of least squares through points near a place.
fn plane_of(
    points: impl ExactSizeIterator<Item = [f64; 3]>,
    place_mm: &[f64; 3],
    sensor_mm: &[f64; 3],
    reach_mm: f64,
) -> Option<LocalPlane> {
    let count = points.len() as f64;
    if count < 4.0 {
        return None;
    }
    // About the place, which is no farther from the points than they are from each other: no digits are lost.
    let (mut sum, mut squares) = ([0.0; 3], [0.0; 6]);
    for point in points {
        let [x, y, z]: [f64; 3] = std::array::from_fn(|k| point[k] - place_mm[k]);
        [x, y, z].iter().zip(&mut sum).for_each(|(arm, sum)| *sum += arm);
        let products = [x * x, x * y, x * z, y * y, y * z, z * z];
        products.iter().zip(&mut squares).for_each(|(product, sum)| *sum += product);
    }
    let [x, y, z] = sum.map(|sum| sum / count);
    let [xx, xy, xz, yy, yz, zz] = squares;
    let (xx, xy, xz) = (xx - x * sum[0], xy - x * sum[1], xz - x * sum[2]);
    let (yy, yz, zz) = (yy - y * sum[1], yz - y * sum[2], zz - z * sum[2]);
    let eigen = least(&Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz))?;
    let [least, middle, most] = eigen.values.map(|value| value.max(0.0));
    // Noise spreads points off their line as well as off their plane.
    if !(middle > LEAST_BREADTH * most && middle > 4.0 * least) {
        return None;
    }
    let towards = eigen.axis.dot(&(Vector3::from(*sensor_mm) - Vector3::from(*place_mm)));
    let normal = if towards < 0.0 { -eigen.axis } else { eigen.axis };
    Some(LocalPlane { normal, roughness_mm: (least / (count - 3.0)).sqrt(), reach_mm })
}

/// Returns the unit normal at every point of a cloud, towards the sensor (a place in the cloud's frame, mm), from `count`
/// neighbours; `None` for a point whose neighbours tell no plane.
///
/// # Errors
/// [`CloudError`] for a position that is no finite number.
pub fn normals(
    cloud: &PointCloud,
    count: usize,
    sensor_mm: &[f64; 3],
) -> Result<Vec<Option<[f64; 3]>>, CloudError> {
    let neighbours = Neighbours::new(cloud.positions_mm())?;
    Ok(neighbours.of_all(&counts(count), |hood| plane_of_hood(hood, sensor_mm).map(|l| l.normal.into())))
}

/// Returns the plane about every point of a tree, as [`local_plane`] does.
pub(crate) fn local_planes(
    neighbours: &Neighbours,
    count: usize,
    sensor_mm: &[f64; 3],
) -> Vec<Option<LocalPlane>> {
    neighbours.of_all(&counts(count), |hood| plane_of_hood(hood, sensor_mm))
}

/// Returns the plane about every point of a tree, roughly: of points in one leaf, of some ten, that through the neighbours of their middle.
pub(crate) fn shared_planes(
    neighbours: &Neighbours,
    count: usize,
    sensor_mm: &[f64; 3],
) -> Vec<Option<LocalPlane>> {
    neighbours.of_leaves(&counts(count), |hood| plane_of_hood(hood, sensor_mm))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Frame;

    /// A ball of 20 mm by a grid of a tenth of its radius: the chord's sag turns no normal by more than this.
    const CHORD_RAD: f64 = 0.1;

    #[test]
    fn normals_of_a_ball_point_to_the_sensor_along_its_radii() {
        let center = Vector3::new(5.0, -3.0, 600.0);
        let points: Vec<[f64; 3]> = (0..2000)
            .map(|i| (2.4 * f64::from(i), -1.0 + f64::from(i) / 2000.0))
            .map(|(t, z)| {
                (center
                    + 20.0 * Vector3::new((1.0 - z * z).sqrt() * t.cos(), (1.0 - z * z).sqrt() * t.sin(), z))
                .into()
            })
            .collect();
        let cloud = PointCloud::new(Frame::Camera, points.clone());
        let normals = normals(&cloud, NORMAL_NEIGHBOURS, &[0.0; 3]).unwrap();
        // At the limb neighbours lie to one side.
        for (point, normal) in points.iter().zip(normals).filter(|(p, _)| p[2] < 594.0) {
            let radial = (Vector3::from(*point) - center) / 20.0;
            assert!(Vector3::from(normal.unwrap()).dot(&radial) > CHORD_RAD.cos(), "{point:?} {normal:?}");
        }
    }

    #[test]
    fn points_on_a_line_have_no_normal() {
        let points: Vec<[f64; 3]> = (0..50).map(|i| [f64::from(i), 0.0, 500.0]).collect();
        let cloud = PointCloud::new(Frame::Camera, points);
        assert!(normals(&cloud, 8, &[0.0; 3]).unwrap().iter().all(Option::is_none));
        let cloud = PointCloud::new(Frame::Camera, vec![[1.0; 3]; 500]);
        assert!(normals(&cloud, 8, &[0.0; 3]).unwrap().iter().all(Option::is_none), "all in one place");
    }

    #[test]
    fn dense_stripes_far_apart_still_have_normals() {
        // 0.1 mm along a stripe, 2 mm between them: the 24 nearest are of one stripe.
        let points =
            (0..40).flat_map(|s| (0..200).map(move |i| [2.0 * f64::from(s), 0.1 * f64::from(i), 500.0]));
        let cloud = PointCloud::new(Frame::Camera, points.collect());
        let found = normals(&cloud, 24, &[0.0; 3]).unwrap();
        let facing = found.iter().flatten().filter(|n| n[2] < -0.999).count();
        assert_eq!(facing, found.iter().flatten().count());
        assert!(facing > 7900, "{facing} of 8000");
    }
}
