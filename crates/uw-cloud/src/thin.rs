//! Fewer points: one a cell, averaged a cell, or many where the surface bends and few where it is flat.

use crate::cloud::{PointCloud, packed, unpacked};
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;

/// Returns which points to keep so that about one is left a cube of `spacing_mm`: of each cube the one nearest to its points' middle. They
/// are what they were, sigmas too. In ascending order.
pub fn thinned(cloud: &PointCloud, spacing_mm: f64) -> Vec<usize> {
    let mut kept: Vec<usize> =
        cells(cloud, spacing_mm).into_values().map(|points| nearest_to_middle(cloud, &points)).collect();
    kept.sort_unstable();
    kept
}

/// Returns the cloud with the points of each cube of `spacing_mm` made one, at their mean.
///
/// What is told of the mean's error has two parts. Points of one image in a cube are neighbours on a stripe, whose errors hang together: no
/// number of them is better than their mean covariance. Points of different images err each on its own: of n images in equal parts the
/// variance is an n-th, but for what all points share ([`PointCloud::shared_mm`]). A cloud without frame rows (a merged one) is taken as one image. Where the points of a cube scatter about their
/// plane by more than their own sigmas, for the surface curves or two sweeps lie beside each other, that is added along the plane's
/// normal. Intensities are means, frame rows and pixels those of the point nearest to the middle, shared errors are means, normals are dropped with deviations and colours.
pub fn averaged(cloud: &PointCloud, spacing_mm: f64) -> PointCloud {
    let cells = cells(cloud, spacing_mm);
    let groups: Vec<Vec<usize>> = cells.into_values().collect();
    let nearest: Vec<usize> = groups.iter().map(|points| nearest_to_middle(cloud, points)).collect();
    let middles = groups.iter().map(|points| middle(cloud, points).into()).collect();
    let mut made = PointCloud::new(cloud.frame(), middles);
    // One entry a group each: lengths agree.
    let with = |made: PointCloud, result: Result<PointCloud, _>| result.unwrap_or(made);
    if let Some(values) = cloud.intensities() {
        let mean = |points: &Vec<usize>| points.iter().map(|&i| values[i]).sum::<f32>() / points.len() as f32;
        let means = groups.iter().map(mean).collect();
        made = with(made.clone(), made.with_intensities(means));
    }
    if let Some(values) = cloud.frame_rows() {
        made = with(made.clone(), made.with_frame_rows(nearest.iter().map(|&i| values[i]).collect()));
    }
    if let Some(values) = cloud.pixels() {
        made = with(made.clone(), made.with_pixels(nearest.iter().map(|&i| values[i]).collect()));
    }
    if let Some(values) = cloud.shared_mm() {
        let mean = |points: &Vec<usize>| {
            let part =
                |axis: usize| points.iter().map(|&i| values[i][axis]).sum::<f32>() / points.len() as f32;
            [0, 1, 2].map(part)
        };
        made = with(made.clone(), made.with_shared_mm(groups.iter().map(mean).collect()));
    }
    if cloud.covariances_mm2().is_some() || cloud.sigmas_mm().is_some() {
        let all: Vec<Matrix3<f64>> = groups.iter().map(|points| covariance(cloud, points)).collect();
        let sigmas = all.iter().map(|c| c.symmetric_eigenvalues().max().max(0.0).sqrt() as f32).collect();
        made = with(made.clone(), made.with_sigmas_mm(sigmas));
        if cloud.covariances_mm2().is_some() {
            made = with(made.clone(), made.with_covariances_mm2(all.iter().map(packed).collect()));
        }
    }
    made
}

/// The covariance of the mean of some points.
fn covariance(cloud: &PointCloud, points: &[usize]) -> Matrix3<f64> {
    let step =
        |i: usize| cloud.shared_mm().map_or_else(Vector3::zeros, |all| Vector3::from(all[i].map(f64::from)));
    let own = |i: usize| match (cloud.covariances_mm2(), cloud.sigmas_mm()) {
        (Some(all), _) => {
            let mut own = (unpacked(&all[i]) - step(i) * step(i).transpose()).symmetric_eigen();
            own.eigenvalues.iter_mut().for_each(|variance| *variance = variance.max(0.0));
            own.recompose()
        }
        (None, Some(sigmas)) => {
            let own = f64::from(sigmas[i]).powi(2) - step(i).norm_squared();
            Matrix3::identity() * own.max(0.0)
        }
        (None, None) => Matrix3::zeros(),
    };
    let count = points.len() as f64;
    let shared = points.iter().map(|&i| step(i)).sum::<Vector3<f64>>() / count;
    let mut images: BTreeMap<u32, (f64, Matrix3<f64>)> = BTreeMap::new();
    for &i in points {
        let image = images.entry(cloud.frame_rows().map_or(0, |rows| rows[i])).or_default();
        *image = (image.0 + 1.0, image.1 + own(i));
    }
    // (n_f / n)² times the image's mean covariance.
    let mut sum: Matrix3<f64> = images.values().map(|(n, all)| all * (n / (count * count))).sum();
    if points.len() >= 6 {
        let mean = middle(cloud, points);
        let arms = points.iter().map(|&i| cloud.vector(i) - mean);
        let spread: Matrix3<f64> = arms.map(|a| a * a.transpose()).sum::<Matrix3<f64>>() / (count - 3.0);
        let eigen = spread.symmetric_eigen();
        let least = eigen.eigenvalues.imin();
        let normal: Vector3<f64> = eigen.eigenvectors.column(least).into_owned();
        let told = points.iter().map(|&i| normal.dot(&(own(i) * normal))).sum::<f64>() / count;
        sum += normal * normal.transpose() * (eigen.eigenvalues[least] - told).max(0.0);
    }
    sum + shared * shared.transpose()
}

/// Returns which points to keep so that a surface through them stays within `tolerance_mm` of those that are left out: cubes are halved
/// until the points of each lie on a plane to within that (and twice their own sigmas); of each the point nearest to the middle, and of
/// flat ones the corners' nearest, are kept. In ascending order.
pub fn thinned_by_curvature(cloud: &PointCloud, tolerance_mm: f64) -> Vec<usize> {
    let Some((low, high)) = cloud.bounding_box_mm() else { return (0..cloud.len()).collect() };
    let size = std::iter::zip(low, high).map(|(l, h)| h - l).fold(0.0, f64::max);
    let mut kept = Vec::new();
    let mut open =
        vec![(Vector3::from(low), size.max(f64::MIN_POSITIVE), (0..cloud.len()).collect::<Vec<_>>())];
    while let Some((corner, size, points)) = open.pop() {
        if points.len() <= 3 || size < 0.1 * tolerance_mm {
            kept.extend(points);
            continue;
        }
        if is_flat(cloud, &points, tolerance_mm) {
            kept.push(nearest_to_middle(cloud, &points));
            kept.extend(outermost(cloud, &points));
            continue;
        }
        let half = size / 2.0;
        let mut parts: [Vec<usize>; 8] = Default::default();
        for i in points {
            let beyond = (cloud.vector(i) - corner).map(|c| usize::from(c >= half));
            parts[beyond.x + 2 * beyond.y + 4 * beyond.z].push(i);
        }
        for (at, part) in parts.into_iter().enumerate().filter(|(_, part)| !part.is_empty()) {
            let step = Vector3::new(at & 1, at >> 1 & 1, at >> 2).map(|b| b as f64 * half);
            open.push((corner + step, half, part));
        }
    }
    kept.sort_unstable();
    kept.dedup();
    kept
}

/// Whether all points lie on one plane to within a tolerance.
fn is_flat(cloud: &PointCloud, points: &[usize], tolerance: f64) -> bool {
    let mean = middle(cloud, points);
    let spread: Matrix3<f64> =
        points.iter().map(|&i| cloud.vector(i) - mean).map(|a| a * a.transpose()).sum();
    let eigen = spread.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let normal: Vector3<f64> = eigen.eigenvectors.column(least).into_owned();
    let sigma = |i: usize| cloud.sigmas_mm().map_or(0.0, |sigmas| f64::from(sigmas[i]));
    points.iter().all(|&i| {
        // Noise of three sigmas is no curvature.
        normal.dot(&(cloud.vector(i) - mean)).abs() <= tolerance.max(3.0 * sigma(i))
    })
}

/// The points farthest out along the two directions that a patch spreads in, both ways.
fn outermost(cloud: &PointCloud, points: &[usize]) -> Vec<usize> {
    let mean = middle(cloud, points);
    let spread: Matrix3<f64> =
        points.iter().map(|&i| cloud.vector(i) - mean).map(|a| a * a.transpose()).sum();
    let eigen = spread.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let mut found = Vec::new();
    for k in (0..3).filter(|k| *k != least) {
        let way: Vector3<f64> = eigen.eigenvectors.column(k).into_owned();
        let along = |i: &&usize| way.dot(&cloud.vector(**i));
        found.extend(points.iter().max_by(|a, b| along(a).total_cmp(&along(b))));
        found.extend(points.iter().min_by(|a, b| along(a).total_cmp(&along(b))));
    }
    found
}

/// The points of each cube that has some, cubes in order.
fn cells(cloud: &PointCloud, spacing_mm: f64) -> BTreeMap<[i64; 3], Vec<usize>> {
    let low = cloud.bounding_box_mm().unwrap_or_default().0;
    let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for (i, p) in cloud.positions_mm().iter().enumerate() {
        let cell = std::array::from_fn(|k| ((p[k] - low[k]) / spacing_mm).floor() as i64);
        cells.entry(cell).or_default().push(i);
    }
    cells
}

fn middle(cloud: &PointCloud, points: &[usize]) -> Vector3<f64> {
    // About the first one, so that far from the origin no digits are lost.
    let first = cloud.vector(points[0]);
    first + points.iter().map(|&i| cloud.vector(i) - first).sum::<Vector3<f64>>() / points.len() as f64
}

fn nearest_to_middle(cloud: &PointCloud, points: &[usize]) -> usize {
    let middle = middle(cloud, points);
    let off = |i: usize| (cloud.vector(i) - middle).norm_squared();
    points.iter().copied().min_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or_default()
}

/// Returns which points lie in a box, its faces included, in ascending order.
pub fn cropped(cloud: &PointCloud, low_mm: &[f64; 3], high_mm: &[f64; 3]) -> Vec<usize> {
    let inside = |p: &[f64; 3]| (0..3).all(|k| (low_mm[k]..=high_mm[k]).contains(&p[k]));
    (0..cloud.len()).filter(|&i| inside(&cloud.positions_mm()[i])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Frame;
    use crate::robust::Random;

    /// A flat plate of 100 × 60 points, 0.5 mm apart, with a ball's cap of 8 mm in its middle.
    fn plate() -> PointCloud {
        let point = |i: i32, j: i32| {
            let (x, y) = (f64::from(i) * 0.5 - 25.0, f64::from(j) * 0.5 - 15.0);
            [x, y, 500.0 - (64.0 - x * x - y * y).max(0.0).sqrt()]
        };
        PointCloud::new(Frame::Camera, (0..100).flat_map(|i| (0..60).map(move |j| point(i, j))).collect())
    }

    #[test]
    fn cells_keep_one_point_each() {
        let kept = thinned(&plate(), 5.0);
        let cells: std::collections::BTreeSet<[i64; 3]> = plate()
            .positions_mm()
            .iter()
            .map(|p| {
                [(p[0] + 25.0) / 5.0, (p[1] + 15.0) / 5.0, (p[2] - 492.0) / 5.0].map(|c| c.floor() as i64)
            })
            .collect();
        assert_eq!(kept.len(), cells.len());
        assert!(kept.windows(2).all(|w| w[0] < w[1]));
    }

    #[test]
    fn curved_parts_keep_more_points_than_flat_ones() {
        let cloud = plate();
        let kept = thinned_by_curvature(&cloud, 0.05);
        let on_ball = |i: &usize| cloud.positions_mm()[*i][2] < 499.9;
        let ball = kept.iter().filter(|i| on_ball(i)).count();
        let all_ball = (0..cloud.len()).filter(on_ball).count();
        let (flat, all_flat) = (kept.len() - ball, cloud.len() - all_ball);
        assert!(
            ball as f64 / all_ball as f64 > 3.0 * flat as f64 / all_flat as f64,
            "{ball}/{all_ball}, {flat}/{all_flat}"
        );
        assert!(kept.len() < cloud.len() / 2, "{}", kept.len());
    }

    #[test]
    fn a_mean_is_as_good_as_its_images_are_many_and_says_what_it_scatters_by() {
        // 12 points of noise 0.1 mm along z in one cell: of one image, of twelve, and of two layers 1 mm apart.
        let mut random = Random::new(3);
        let mut points: Vec<[f64; 3]> = Vec::new();
        for _ in 0..12 {
            points.push([5.0 * random.share(), 5.0 * random.share(), 0.05]);
        }
        let covariance = [1e-6, 0.0, 0.0, 1e-6, 0.0, 0.01];
        let cloud = |points: &[[f64; 3]], rows: Vec<u32>| {
            PointCloud::new(Frame::Camera, points.to_vec())
                .with_covariances_mm2(vec![covariance; 12])
                .and_then(|c| c.with_frame_rows(rows))
                .unwrap()
        };
        let sigma_z = |cloud: &PointCloud| {
            let mean = averaged(cloud, 10.0);
            assert_eq!(mean.len(), 1);
            f64::from(mean.covariances_mm2().unwrap()[0][5]).sqrt()
        };
        assert!((sigma_z(&cloud(&points, vec![7; 12])) - 0.1).abs() < 1e-6);
        assert!((sigma_z(&cloud(&points, (0..12).collect())) - 0.1 / 12_f64.sqrt()).abs() < 1e-6);
        // What they share, 0.06 mm of the 0.1, stays.
        let shared = cloud(&points, (0..12).collect()).with_shared_mm(vec![[0.0, 0.0, 0.06]; 12]).unwrap();
        assert!((sigma_z(&shared).powi(2) - (0.0064 / 12.0 + 0.0036)).abs() < 1e-7);
        assert_eq!(averaged(&shared, 10.0).shared_mm().unwrap(), [[0.0, 0.0, 0.06]]);
        // Of which it can be no more than all.
        let all = cloud(&points, (0..12).collect()).with_shared_mm(vec![[0.3, 0.0, 0.1]; 12]).unwrap();
        let [xx, _, _, yy, _, zz] = averaged(&all, 10.0).covariances_mm2().unwrap()[0];
        assert!(xx >= 0.09 && yy > 0.0 && zz >= 0.01, "{xx} {yy} {zz}");
        points.iter_mut().step_by(2).for_each(|p| p[2] += 0.6);
        let layers = sigma_z(&cloud(&points, (0..12).collect()));
        assert!(layers > 0.25, "half of the layers' distance, {layers}");
    }

    #[test]
    fn a_box_takes_what_lies_in_it() {
        let cloud = plate();
        let inside = cropped(&cloud, &[-1.0, -1.0, f64::NEG_INFINITY], &[1.0, 1.0, f64::INFINITY]);
        assert_eq!(inside.len(), 25);
        assert!(thinned_by_curvature(&PointCloud::default(), 1.0).is_empty());
        assert!(averaged(&PointCloud::default(), 1.0).is_empty());
    }
}
