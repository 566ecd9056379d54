//! Start values of a camera from views of a plane, in closed form.
//!
//! Z. Zhang, "A flexible new technique for camera calibration", PAMI 22 (2000), §3.1 and Eq 13, with skew
//! zero. In water, and strictly also behind a window in air, a plane's image is no homography; as a start
//! that is good enough in air only.

use crate::data::{BoardView, CornerPoint};
use crate::homography::homography;
use crate::start::pose_of;
use nalgebra::{DMatrix, DVector, Matrix3, SVector, Vector2};
use uw_geom::{Camera, Distortion};

/// The system's smallest singular value must be this much below the next, or more than one camera explains
/// the views about as well: the boards are nearly parallel.
const DISTINCT: f64 = 0.5;
/// Below this share of the largest singular value, even exact views leave a second camera open.
const RANK: f64 = 1e-9;
/// No camera has pixels so oblong.
const MAX_ASPECT: f64 = 2.0;
/// Focal lengths (over the image's longer side) outside this range are a failed solution, not a lens.
const FOCAL_RANGE: std::ops::RangeInclusive<f64> = 0.2..=50.0;
/// A stronger k₁ means that the linear estimate has failed; no distortion is a better start.
const MAX_K1: f64 = 2.0;

/// Returns the camera that the views determine, or `None` where they don't: fewer than two, or all nearly
/// parallel. Then the drawing's focal length is the better start. Where the principal point is not
/// determined, it is taken at the image's centre.
#[must_use]
pub fn closed_form(views: &[BoardView], image_size: [u32; 2]) -> Option<Camera> {
    let [width, height] = image_size.map(f64::from);
    let centre = Vector2::new((width - 1.0) / 2.0, (height - 1.0) / 2.0);
    let side = width.max(height);
    let homographies: Vec<Matrix3<f64>> = views
        .iter()
        .filter_map(|view| {
            let pairs: Vec<_> = view
                .corners
                .iter()
                .map(|c| {
                    let p = (c.pixel - centre) / side;
                    ([c.board_mm.x, c.board_mm.y], [p.x, p.y])
                })
                .collect();
            let h = homography(&pairs)?;
            // Views count alike whatever their scale.
            let scale = (h.column(0).norm() * h.column(1).norm()).sqrt();
            (scale > 0.0).then(|| h / scale)
        })
        .collect();
    let [fx, fy, x, y] = intrinsics(&homographies, true).or_else(|| intrinsics(&homographies, false))?;
    let camera = Camera {
        fx: fx * side,
        fy: fy * side,
        cx: centre.x + x * side,
        cy: centre.y + y * side,
        distortion: Distortion::none(),
    };
    Some(Camera { distortion: radial(views, &camera).unwrap_or(Distortion::none()), ..camera })
}

/// fx, fy and the principal point (at the origin unless `free`) from the image of the absolute conic
/// B = [B₁₁ 0 B₁₃; 0 B₂₂ B₂₃; B₁₃ B₂₃ B₃₃], for which h₁ᵀB h₂ = 0 and h₁ᵀB h₁ = h₂ᵀB h₂.
fn intrinsics(homographies: &[Matrix3<f64>], free: bool) -> Option<[f64; 4]> {
    let unknowns = if free { 5 } else { 3 };
    if 2 * homographies.len() + 1 < unknowns {
        return None;
    }
    let form = |h: &Matrix3<f64>, i: usize, j: usize| {
        let (a, b) = (h.column(i), h.column(j));
        let all =
            [a[0] * b[0], a[1] * b[1], a[2] * b[2], a[0] * b[2] + a[2] * b[0], a[1] * b[2] + a[2] * b[1]];
        SVector::<f64, 5>::from(all)
    };
    // At least as many rows as columns, so that the decomposition holds the whole right-hand basis.
    let mut system = DMatrix::zeros((2 * homographies.len()).max(unknowns), unknowns);
    for (i, h) in homographies.iter().enumerate() {
        for (row, v) in [(2 * i, form(h, 0, 1)), (2 * i + 1, form(h, 0, 0) - form(h, 1, 1))] {
            for k in 0..unknowns {
                system[(row, k)] = v[k];
            }
        }
    }
    let svd = system.svd(false, true);
    let mut order: Vec<usize> = (0..unknowns).collect();
    order.sort_by(|&i, &j| svd.singular_values[i].total_cmp(&svd.singular_values[j]));
    let singular = |k: usize| order.get(k).map(|&i| svd.singular_values[i]);
    let (smallest, second, largest) = (singular(0)?, singular(1)?, singular(unknowns - 1)?);
    if smallest > DISTINCT * second || second < RANK * largest {
        return None;
    }
    let v_t = svd.v_t.as_ref()?;
    let b = v_t.row(order[0]);
    let (x, y) = if free { (-b[3] / b[0], -b[4] / b[1]) } else { (0.0, 0.0) };
    let scale = b[2] - x * x * b[0] - y * y * b[1];
    let (fx, fy) = ((scale / b[0]).sqrt(), (scale / b[1]).sqrt());
    let usable = FOCAL_RANGE.contains(&fx)
        && FOCAL_RANGE.contains(&fy)
        && (1.0 / MAX_ASPECT..=MAX_ASPECT).contains(&(fx / fy))
        && x.abs().max(y.abs()) < 0.5;
    usable.then_some([fx, fy, x, y])
}

/// k₁ and k₂ by linear least squares from what the pinhole's poses leave over (Zhang's Eq 13).
fn radial(views: &[BoardView], camera: &Camera) -> Option<Distortion> {
    let mut rows = Vec::new();
    let mut rest = Vec::new();
    for view in views {
        let Some(pose) = pose(view, camera) else { continue };
        for corner in &view.corners {
            let p = pose.transform_point(&corner.board_mm.push(0.0));
            let n = p.xy() / p.z;
            let seen = Vector2::new(
                (corner.pixel.x - camera.cx) / camera.fx,
                (corner.pixel.y - camera.cy) / camera.fy,
            );
            let r2 = n.norm_squared();
            for k in 0..2 {
                rows.extend([n[k] * r2, n[k] * r2 * r2]);
                rest.push(seen[k] - n[k]);
            }
        }
    }
    let system = DMatrix::from_row_slice(rest.len(), 2, &rows);
    let normal = system.tr_mul(&system);
    let k = normal.cholesky()?.solve(&system.tr_mul(&DVector::from_vec(rest)));
    (k[0].abs() < MAX_K1 && k[1].is_finite()).then(|| Distortion { k1: k[0], k2: k[1], ..Distortion::none() })
}

/// `camera_from_board` from the homography to undistorted image points; `None` where it is degenerate.
pub(crate) fn pose(
    view: &BoardView,
    camera: &Camera,
) -> Option<uw_geom::Rigid<uw_geom::frame::Camera, uw_geom::frame::Board>> {
    rough_pose(&view.corners, camera)
}

/// `camera_from_board` of a flat board from its corners in one image, by the camera as far as it is known: a start for an adjustment, or to
/// tell a person how the board stands. Windows are not in it: behind a flat one in water distances come out by about the index too small,
/// unless the focal length is given longer by that. `None` where the corners determine none.
pub fn rough_pose(
    corners: &[CornerPoint],
    camera: &Camera,
) -> Option<uw_geom::Rigid<uw_geom::frame::Camera, uw_geom::frame::Board>> {
    let pairs: Option<Vec<_>> = corners
        .iter()
        .map(|c| {
            let d = camera.unproject(&c.pixel).ok()?;
            Some(([c.board_mm.x, c.board_mm.y], [d.x / d.z, d.y / d.z]))
        })
        .collect();
    pose_of(&homography(&pairs?)?)
}
