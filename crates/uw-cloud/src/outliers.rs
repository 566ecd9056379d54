//! Points that are no part of a surface: lonely ones, and those that a scan's own neighbours in line and voltage disagree with.

use crate::cloud::PointCloud;
use crate::error::CloudError;
use crate::neighbours::{Hood, Neighbours};
use crate::robust::{median, scale_about_zero};
use nalgebra::{Matrix3, Vector3};
use std::collections::HashMap;

/// Neighbours whose distances tell how lonely a point is.
const NEIGHBOURS: usize = 12;

/// Returns whether each point lies apart from the others: the mean distance of its twelve nearest neighbours is larger than the median
/// of all points' by more than `limit` robust sigmas, both as logarithms, since spacing differs by factors.
///
/// The statistical outliers of R. Rusu et al. (Robotics and Autonomous Systems 56 (2008) 927), but for the logarithm and the median.
///
/// # Errors
/// [`CloudError`] for a position that is no finite number.
pub fn sparse_outliers(cloud: &PointCloud, limit: f64) -> Result<Vec<bool>, CloudError> {
    let neighbours = Neighbours::new(cloud.positions_mm())?;
    // Itself is among them, at no distance.
    let lonely = |hood: &Hood<'_>| {
        let others = hood.distances2.len().saturating_sub(1).max(1);
        let mean = hood.distances2.iter().map(|square| square.sqrt()).sum::<f64>() / others as f64;
        Some(mean.max(f64::MIN_POSITIVE).ln())
    };
    let told = neighbours.of_all(&[NEIGHBOURS + 1], lonely);
    let measures: Vec<f64> = told.into_iter().flatten().collect();
    let middle = median(&mut measures.clone());
    // A grid's spacing is all the same: then a point is lonely where it is half as far again.
    let sigma = scale_about_zero(measures.iter().map(|m| m - middle)).max(0.1);
    Ok(measures.iter().map(|m| m - middle > limit * sigma).collect())
}

/// Neighbours to either side in line and in frame.
const LINES: i32 = 3;
const FRAMES: i32 = 2;
/// Neighbours that must be there for a point to be judged by them.
const FEWEST: usize = 6;
/// Tangent of the angle between sight and surface from which on two points are not of one surface: 84° to the normal.
const STEEPEST: f64 = 10.0;

/// Returns whether each point of a sweep disagrees with its neighbours in line and voltage: it lies off the plane through those that
/// hang together with it by more than `limit` sigmas (its own and what the neighbours scatter by), or hangs together with fewer than
/// two of those that are there. `None` for a cloud without pixels and frame rows, or without sigmas.
///
/// Two points hang together where the line between them does not run along the sight (from the frame's origin). Points at the end of a surface have
/// neighbours to one side and are kept.
pub fn sheet_outliers(cloud: &PointCloud, limit: f64) -> Option<Vec<bool>> {
    let (pixels, frames, sigmas) = (cloud.pixels()?, cloud.frame_rows()?, cloud.sigmas_mm()?);
    // One centre a row has whole v, one a column whole u.
    let whole = |k: usize| pixels.iter().filter(|p| p[k].fract() == 0.0).count();
    let along = usize::from(whole(1) >= whole(0));
    let line = |i: usize| pixels[i][along].round() as i32;
    let mut ordered: Vec<u32> = frames.to_vec();
    ordered.sort_unstable();
    ordered.dedup();
    // Frames without a point, such as images with the laser off, are no steps.
    let frame = |i: usize| ordered.partition_point(|f| *f < frames[i]) as i32;
    let mut cells: HashMap<(i32, i32), Vec<usize>> = HashMap::with_capacity(cloud.len());
    for i in 0..cloud.len() {
        cells.entry((line(i), frame(i))).or_default().push(i);
    }
    let judge = |i: usize| {
        let place = cloud.vector(i);
        let Some(sight) = place.try_normalize(0.0) else { return false };
        let mut there = 0;
        let mut together: Vec<(usize, Vector3<f64>)> = Vec::with_capacity(34);
        for lines in -LINES..=LINES {
            for steps in -FRAMES..=FRAMES {
                if lines == 0 && steps == 0 {
                    continue;
                }
                let Some(cell) = cells.get(&(line(i) + lines, frame(i) + steps)) else { continue };
                there += 1;
                let arms = cell.iter().map(|&j| (j, cloud.vector(j) - place));
                let nearest = arms.min_by(|a, b| a.1.norm().total_cmp(&b.1.norm()));
                together.extend(nearest.filter(|(j, arm)| {
                    let depth = arm.dot(&sight);
                    let across = (arm - sight * depth).norm();
                    depth.abs() <= STEEPEST * across + limit * f64::from(sigmas[i].hypot(sigmas[*j]))
                }));
            }
        }
        if there < FEWEST {
            return false;
        }
        if together.len() < 2 {
            return true;
        }
        off_plane(&together, &sight)
            .is_some_and(|(residual, scatter)| residual.abs() > limit * scatter.hypot(f64::from(sigmas[i])))
    };
    Some((0..cloud.len()).map(judge).collect())
}

/// How far a place lies along the sight before the plane through its neighbours, and what these scatter by; `None` where they are too
/// few or on one line.
fn off_plane(arms: &[(usize, Vector3<f64>)], sight: &Vector3<f64>) -> Option<(f64, f64)> {
    if arms.len() < FEWEST {
        return None;
    }
    let side = sight.cross(&if sight.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() }).normalize();
    let up = sight.cross(&side);
    let rows: Vec<(Vector3<f64>, f64)> = arms
        .iter()
        .map(|(_, arm)| (Vector3::new(1.0, arm.dot(&side), arm.dot(&up)), arm.dot(sight)))
        .collect();
    let mut weights = vec![1.0; rows.len()];
    let (mut solution, mut scatter) = (Vector3::zeros(), 0.0);
    // Least absolute deviations by reweighting: a neighbour astray must not take the plane along.
    for _ in 0..6 {
        let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for ((row, depth), weight) in rows.iter().zip(&weights) {
            matrix += row * row.transpose() * *weight;
            right += row * (*weight * depth);
        }
        solution = matrix.cholesky()?.solve(&right);
        let residuals = || rows.iter().map(|(row, depth)| depth - row.dot(&solution));
        scatter = scale_about_zero(residuals());
        let least = scatter.max(f64::MIN_POSITIVE);
        weights = residuals().map(|r| 1.0 / r.abs().max(0.5 * least)).collect();
    }
    // Of six points and three unknowns the residuals are smaller than what they scatter by.
    let dof = rows.len() as f64 / (rows.len() as f64 - 3.0);
    solution.iter().all(|s| s.is_finite()).then(|| (-solution.x, scatter * dof.sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Frame;
    use crate::robust::Random;

    /// A sweep over a ball before a wall, with noise of 0.02 mm, and where which points were set astray.
    fn sweep() -> (PointCloud, Vec<usize>) {
        let mut random = Random::new(9);
        let mut gauss = || (0..12).map(|_| random.share()).sum::<f64>() - 6.0;
        let (mut points, mut pixels, mut frames) = (Vec::new(), Vec::new(), Vec::new());
        for f in 0..60 {
            for l in 0..80 {
                let (x, y) = ((f64::from(f) - 30.0) / 1000.0, (f64::from(l) - 40.0) / 1400.0);
                // Down the sight (x, y, 1) to a ball of 15 mm at 700 mm, or the wall at 740 mm.
                let (a, b, c) = (x * x + y * y + 1.0, 700.0, 700.0 * 700.0 - 225.0);
                let root = b * b - a * c;
                let z = if root > 0.0 { (b - root.sqrt()) / a } else { 740.0 } + 0.02 * gauss();
                points.push([x * z, y * z, z]);
                pixels.push([300.5 + f as f32, l as f32]);
                frames.push(f as u32 * 2);
            }
        }
        let astray: Vec<usize> = (0..points.len()).step_by(331).collect();
        for (n, &i) in astray.iter().enumerate() {
            let by = if n % 2 == 0 { -0.8 } else { 12.0 };
            points[i] = points[i].map(|c| c * (1.0 + by / 700.0));
        }
        let count = points.len();
        let cloud = PointCloud::new(Frame::Camera, points)
            .with_pixels(pixels)
            .and_then(|c| c.with_frame_rows(frames))
            .and_then(|c| c.with_sigmas_mm(vec![0.02; count]))
            .unwrap();
        (cloud, astray)
    }

    #[test]
    fn points_beside_their_sheet_are_found_and_the_surface_is_kept() {
        let (cloud, astray) = sweep();
        let found = sheet_outliers(&cloud, 5.0).unwrap();
        let missed = astray.iter().filter(|&&i| !found[i]).count();
        let wrong = (0..cloud.len()).filter(|i| found[*i] && !astray.contains(i)).count();
        // At the ball's limb the surface bends away from any plane.
        assert!(missed <= 2, "{missed} of {} missed", astray.len());
        assert!(wrong <= 8, "{wrong} of {} sound points", cloud.len());
        assert!(sheet_outliers(&PointCloud::new(Frame::Camera, vec![[0.0; 3]; 9]), 5.0).is_none());
    }

    #[test]
    fn lonely_points_are_found_whatever_the_spacing() {
        let mut points: Vec<[f64; 3]> =
            (0..1600).map(|i| [f64::from(i % 40), f64::from(i / 40), 500.0]).collect();
        points.extend((0..1600).map(|i| [100.0 + 0.5 * f64::from(i % 40), 0.5 * f64::from(i / 40), 500.0]));
        let sound = points.len();
        points.extend([[20.0, 20.0, 450.0], [70.0, 20.0, 500.0], [1e6, 0.0, 0.0]]);
        let found = sparse_outliers(&PointCloud::new(Frame::Camera, points), 4.0).unwrap();
        assert!(found[sound..].iter().all(|f| *f), "{:?}", &found[sound..]);
        assert!(found[..sound].iter().all(|f| !f));
    }
}
