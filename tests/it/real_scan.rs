//! A turntable scanner of others: its photographs, its laser on a board and its published calibration. The data are not part
//! of the repository; the tests say so where the folder is missing.
//!
//! Conventions, as found: camera matrix, laser plane and axis are published for the images as they are stored (960 × 1280,
//! upright). Turned to landscape, fx and fy change places: the 1430.39 that is quoted as fx belongs to the columns.

#![allow(clippy::print_stderr, reason = "a skipped test says so, and what is found is told")]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use nalgebra::{Matrix3, Vector2, Vector3};
use rand::{RngExt, SeedableRng, rngs::StdRng};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use uw_calib::{
    BoardView, Chessboard, CornerPoint, Detection, GreyView, Layout, Outside, Pinhole, PinholeOptions,
    Rejection, Samples, apply_homography, calibrate_pinhole, closed_form, detect, homography, label_capture,
    robust_plane,
};
use uw_cloud::{Frame, PlaneOptions, PointCloud, fit_plane};
use uw_geom::{Camera, Plane, Ray};
use uw_io::images::{Reduce, read};
use uw_io::{GrayImage, Pixels};
use uw_stripe::{Extractor, Options, Roi, View};

/// Published with the photographs: fx, fy, cx, cy of the images as stored, px.
const CAMERA: [f64; 4] = [1429.663, 1430.392, 478.033, 642.596];
/// Published laser plane n·p = d, in camera axes as stored; d in mm.
const LASER: ([f64; 3], f64) = ([0.85111, -0.00123, 0.52499], 159.527);
/// Published root mean square distance of the cloud that the laser plane was fitted to, mm.
const LASER_SCATTER_MM: f64 = 0.0884;
/// Published rotation axis, radius and radial scatter, mm.
const TURNTABLE: ([f64; 3], f64, f64) = ([0.00721, -0.99925, -0.03792], 81.42, 0.016);
/// Figures agree within this many of their own standard deviations.
const SIGMAS: f64 = 3.0;
/// Half a unit of the last digit that is published, of directions, with a margin for the other components'.
const ROUNDING: f64 = 1e-5;
/// Focal length with which the published cloud was computed, px: neither the one published nor that of the photographs.
const CLOUD_FOCAL_PX: f64 = 1435.0;
/// How far the laser's lines on the board may lie from the published plane, mm, beyond what scatter explains (0.4 mm).
/// The published cloud was made with another camera matrix: its focal length alone moves the lines by half a millimetre,
/// and 5 px in its principal point, which is not recorded, by the other half. A wrong convention is tens of millimetres off.
const OTHER_CAMERA_MM: f64 = 1.5;
/// Resamplings of the corners' residuals.
const DRAWS: usize = 100;
/// The laser's colour.
const RED: Reduce = Reduce::Wavelength(650.0);

/// Returns the folder of the data, or says that it is missing.
fn folder() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/real/3DScanScience");
    if !folder.is_dir() {
        eprintln!("skipped: no {}", folder.display());
        return None;
    }
    Some(folder)
}

fn bytes(image: &GrayImage) -> &[u8] {
    let Pixels::U8(data) = &image.data else { panic!("8 bits") };
    data
}

fn board() -> Chessboard {
    Chessboard::new(11, 6, 13.0).unwrap()
}

fn find(file: &Path, reduce: Reduce) -> Result<Detection, Rejection> {
    let image = read(file, reduce, None).unwrap();
    let (width, height) = (image.width as usize, image.height as usize);
    let layout = Layout { width, height, stride: width };
    detect(&GreyView::new(Samples::U8(bytes(&image)), layout, 255).unwrap(), &board())
}

/// The camera from the sixteen photographs, as they are stored.
fn camera(folder: &Path) -> Pinhole {
    let files: Vec<_> = (0..16).map(|i| folder.join(format!("calib_frames/frame{i:02}.jpg"))).collect();
    let found = files.par_iter().map(|file| find(file, Reduce::Luma)).collect();
    let views: Vec<BoardView> = std::iter::zip(&files, label_capture(found, &board()).unwrap())
        .map(|(file, found)| {
            let corners = found.unwrap().corners.into_iter().map(|c| CornerPoint {
                board_mm: Vector3::from(board().corner_mm(c.index)).xy(),
                pixel: c.pixel.into(),
                covariance: c.covariance,
            });
            BoardView {
                file: file.display().to_string(),
                outside: Outside::Air,
                square_mm: board().square_mm(),
                corners: corners.collect(),
                stripes: Vec::new(),
            }
        })
        .collect();
    let start = closed_form(&views, [960, 1280]).unwrap();
    calibrate_pinhole(&views, &start, PinholeOptions::default()).unwrap()
}

/// Root mean square.
fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0.0), |(sum, n), x| (sum + x * x, n + 1.0));
    (sum / n).sqrt()
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0.0), |(sum, n), x| (sum + x, n + 1.0));
    sum / n
}

/// The standard deviation of values whose scatter about their mean is multiplied by `root`.
fn sigma(values: &[[f64; 4]], root: f64) -> [f64; 4] {
    std::array::from_fn(|k| {
        let middle = mean(values.iter().map(|v| v[k]));
        rms(values.iter().map(|v| v[k] - middle)) * root
    })
}

/// n and d of n·p = d, n towards larger depths.
fn figures(plane: &Plane) -> [f64; 4] {
    let sign = plane.normal.z.signum();
    let [x, y, z] = (plane.normal * sign).into();
    [x, y, z, -plane.offset_mm * sign]
}

fn published_plane() -> Plane {
    Plane { normal: LASER.0.into(), offset_mm: -LASER.1 }
}

#[test]
fn the_photographs_give_the_published_camera() {
    let Some(folder) = folder() else { return };
    let result = camera(&folder);
    let (c, sigmas) = (result.camera, result.sigmas());
    eprintln!("{c:?} ± {sigmas:.3?}, RMS {:.4} px, {} outliers", result.rms_px, result.outliers.len());
    for (k, got) in [c.fx, c.fy, c.cx, c.cy].into_iter().enumerate() {
        // From the same photographs by other corners, of which the published error is no less than ours.
        let sigma = sigmas[k] * std::f64::consts::SQRT_2;
        assert!((got - CAMERA[k]).abs() < SIGMAS * sigma, "{got} {} ± {sigma}", CAMERA[k]);
    }
}

/// The published cloud, and where each of its profiles starts.
fn cloud(folder: &Path) -> Vec<Vec<Vector3<f64>>> {
    let (cloud, _) = uw_io::ply::read(&folder.join("laser-pc.ply")).unwrap();
    let points: Vec<Vector3<f64>> = cloud.positions_mm().iter().map(|&p| p.into()).collect();
    // Profiles run downwards, a millimetre at most from point to point.
    points.chunk_by(|a, b| b.y > a.y).map(<[_]>::to_vec).collect()
}

/// How well the cloud's profiles determine the plane: the jackknife over them, for within a profile the published points lie on
/// a line to a micrometre, so that all scatter is from profile to profile.
fn published_sigma(profiles: &[Vec<Vector3<f64>>]) -> [f64; 4] {
    let without = |k: usize| -> Vec<_> {
        let others = profiles.iter().enumerate().filter(|(i, _)| *i != k);
        others.flat_map(|(_, profile)| profile).copied().collect()
    };
    let planes: Vec<_> = (0..profiles.len()).map(|k| figures(&robust_plane(&without(k)).unwrap())).collect();
    sigma(&planes, (profiles.len() as f64 - 1.0).sqrt())
}

fn middle(points: &[Vector3<f64>]) -> Vector3<f64> {
    points.iter().sum::<Vector3<f64>>() / points.len() as f64
}

/// How far planes through two of the published profiles, at least so far apart, scatter about the published plane: what its
/// scatter does to a plane through two lines.
fn pair_sigma(profiles: &[Vec<Vector3<f64>>], apart_mm: f64) -> [f64; 4] {
    let pairs = profiles.iter().enumerate().flat_map(|(i, a)| profiles[..i].iter().map(move |b| (a, b)));
    let pairs = pairs.filter(|(a, b)| (middle(a) - middle(b)).norm() >= apart_mm);
    let off = pairs.map(|(a, b)| {
        let ([x, y, z], d) = LASER;
        let found = figures(&robust_plane(&[&a[..], &b[..]].concat()).unwrap());
        [found[0] - x, found[1] - y, found[2] - z, found[3] - d]
    });
    let off: Vec<_> = off.collect();
    assert!(off.len() >= 10, "{} pairs", off.len());
    std::array::from_fn(|k| rms(off.iter().map(|o| o[k])))
}

#[test]
fn the_published_cloud_gives_the_published_plane_and_shows_its_camera() {
    let Some(folder) = folder() else { return };
    let profiles = cloud(&folder);
    let points: Vec<_> = profiles.concat();
    let scatter = rms(points.iter().map(|p| published_plane().distance_mm(p)));
    assert!((scatter - LASER_SCATTER_MM).abs() < 1e-3, "{scatter}");
    let sigmas = published_sigma(&profiles);
    let fitted = figures(&robust_plane(&points).unwrap());
    eprintln!("{} profiles, {} points: {fitted:.5?} ± {sigmas:.5?}", profiles.len(), points.len());
    let (n, d) = LASER;
    for (k, published) in [n[0], n[1], n[2], d].into_iter().enumerate() {
        assert!((fitted[k] - published).abs() < SIGMAS * sigmas[k], "{k}: {}", fitted[k]);
    }
    // One point a row: y/z grows by 1/f from point to point, to the rounding of single precision.
    let steps = profiles.iter().flat_map(|p| p.windows(2).map(|w| w[1].y / w[1].z - w[0].y / w[0].z));
    let mut steps: Vec<f64> = steps.collect();
    steps.sort_by(f64::total_cmp);
    let focal_px = 1.0 / steps[steps.len() / 2];
    assert!((focal_px - CLOUD_FOCAL_PX).abs() < 0.01, "{focal_px}");
}

/// A placement of the board with the laser on it.
struct Placement {
    /// Board, mm, and the direction that its corner was seen in (x/z, y/z).
    corners: Vec<([f64; 2], [f64; 2])>,
    /// The right-hand laser's line, as directions.
    line: Vec<Vector3<f64>>,
}

fn placement(folder: &Path, name: &str, camera: &Camera) -> Placement {
    let file = |kind: &str| folder.join(format!("laser_pattern/laser-{kind}0-255-255-8{name}.png"));
    let found = find(&file("background-"), RED).unwrap();
    assert!(found.full);
    let towards = |pixel: [f64; 2]| camera.unproject(&pixel.into()).unwrap();
    let corners = found.corners.iter().map(|c| {
        let [x, y, _] = board().corner_mm(c.index);
        ([x, y], towards(c.pixel).xy().into())
    });
    // Of two lasers, left and right of the board's middle, the right-hand one is published.
    let pixels = |k: usize| found.corners.iter().map(move |c| c.pixel[k]);
    let right = pixels(0).fold(0.0, f64::max) as usize;
    let middle = mean(pixels(0)) as usize;
    let (top, bottom) = (pixels(1).fold(f64::MAX, f64::min) as usize, pixels(1).fold(0.0, f64::max) as usize);
    let roi = Roi { x: middle, y: top, width: right - middle, height: bottom - top };
    let (lit, dark) = (read(&file(""), RED, None).unwrap(), read(&file("background-"), RED, None).unwrap());
    let view = |image| View::packed(bytes(image), 960, 1280).unwrap();
    let options = Options { roi: Some(roi), full_scale_dn: Some(255.0), ..Options::default() };
    let mut extractor = Extractor::new(options).unwrap();
    let stripe = extractor.extract(view(&lit), Some(view(&dark))).unwrap();
    let line = stripe.measurements().map(|m| towards(stripe.axis.uv(m.line, m.position_px))).collect();
    eprintln!(
        "board{name}: {} corners, {} of {} rows with a stripe",
        found.corners.len(),
        stripe.found(),
        roi.height
    );
    Placement { corners: corners.collect(), line }
}

impl Placement {
    /// The laser's line in space, mm, for a board seen where `corners` are, with a focal length `zoom` times the camera's.
    fn points(&self, corners: &[([f64; 2], [f64; 2])], zoom: f64) -> Vec<Vector3<f64>> {
        let scale = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, zoom));
        let h = scale * homography(corners).unwrap();
        let h = h * (h[(2, 2)].signum() / (h.column(0).norm() * h.column(1).norm()).sqrt());
        let plane = Plane::through(&h.column(2).into(), &h.column(0).cross(&h.column(1))).unwrap();
        let ray = |direction: &Vector3<f64>| Ray { origin: Vector3::zeros(), direction: scale * direction };
        self.line.iter().map(|d| ray(d).at(plane.distance_along(&ray(d)).unwrap())).collect()
    }

    /// Corners where the board's homography puts them, each with the residual of another one drawn by chance.
    fn resampled(&self, rng: &mut StdRng) -> Vec<([f64; 2], [f64; 2])> {
        let h = homography(&self.corners).unwrap();
        let ideal = |p: [f64; 2]| Vector2::from(apply_homography(&h, p).unwrap());
        let residual = |(p, q): ([f64; 2], [f64; 2])| Vector2::from(q) - ideal(p);
        let draw = |&(p, _): &([f64; 2], [f64; 2])| {
            let other = self.corners[rng.random_range(0..self.corners.len())];
            (p, (ideal(p) + residual(other)).into())
        };
        self.corners.iter().map(draw).collect()
    }
}

#[test]
fn the_laser_on_the_board_lies_as_published() {
    let Some(folder) = folder() else { return };
    let camera = camera(&folder).camera;
    let places = ["", "-x"].map(|name| placement(&folder, name, &camera));
    let solve = |corners: [&[_]; 2], zoom: f64| {
        let lines = [0, 1].map(|k| places[k].points(corners[k], zoom));
        let gaps = lines.each_ref().map(|l| mean(l.iter().map(|p| published_plane().distance_mm(p))));
        let points = lines.concat();
        let plane = robust_plane(&points).unwrap();
        let apart_mm = (middle(&lines[0]) - middle(&lines[1])).norm();
        (figures(&plane), gaps, rms(points.iter().map(|p| plane.distance_mm(p))), apart_mm)
    };
    let seen = [&places[0].corners[..], &places[1].corners[..]];
    let (found, gaps, scatter, apart_mm) = solve(seen, 1.0);
    let mut rng = StdRng::seed_from_u64(1);
    let draws: Vec<_> = (0..DRAWS)
        .map(|_| {
            let [a, b] = places.each_ref().map(|place| place.resampled(&mut rng));
            solve([&a, &b], 1.0)
        })
        .collect();
    let own = sigma(&draws.iter().map(|d| d.0).collect::<Vec<_>>(), 1.0);
    let gap_sigma = sigma(&draws.iter().map(|d| [d.1[0], d.1[1], 0.0, 0.0]).collect::<Vec<_>>(), 1.0);
    let published = pair_sigma(&cloud(&folder), apart_mm);
    let (_, refocused, ..) = solve(seen, CLOUD_FOCAL_PX / camera.fx);
    eprintln!(
        "plane {found:.5?} ± {own:.5?} (published ± {published:.5?}), scatter {scatter:.3} mm; lines {gaps:.3?} ± \
         {gap_sigma:.3?} mm from the published plane, {refocused:.3?} with the cloud's focal length"
    );
    let (n, d) = LASER;
    for (k, expected) in [n[0], n[1], n[2], d].into_iter().enumerate() {
        let sigma = own[k].hypot(published[k]);
        assert!((found[k] - expected).abs() < SIGMAS * sigma, "{k}: {} ± {sigma}", found[k]);
    }
    for (gap, sigma) in std::iter::zip(gaps, gap_sigma) {
        let explained = SIGMAS * sigma.hypot(LASER_SCATTER_MM).hypot(scatter);
        assert!(gap.abs() < OTHER_CAMERA_MM + explained, "{gap} ± {sigma}");
    }
    // The cloud's focal length takes both lines nearer to the published plane.
    assert!(std::iter::zip(gaps, refocused).all(|(ours, theirs)| theirs.abs() < ours.abs()));
}

#[test]
fn the_turntable_has_its_published_axis_and_radius() {
    let Some(folder) = folder() else { return };
    let text = std::fs::read_to_string(folder.join("turntable_points_mm.csv")).unwrap();
    let rows = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
    let points: Vec<[f64; 3]> = rows
        .map(|row| {
            let values: Vec<f64> = row.split(',').map(|x| x.trim().parse().unwrap()).collect();
            values.try_into().unwrap()
        })
        .collect();
    assert_eq!(points.len(), 24);
    let fit = fit_plane(&PointCloud::new(Frame::Camera, points.clone()), &PlaneOptions::default()).unwrap();
    let axis = Vector3::from(fit.normal);
    let (expected, radius_mm, scatter_mm) = TURNTABLE;
    let tilt = axis.cross(&Vector3::from(expected)).norm();
    assert!(tilt < SIGMAS * fit.sigma_normal_rad + ROUNDING, "{axis:?} ± {}", fit.sigma_normal_rad);

    // The circle in that plane by Gauss-Newton: centre (two tangents) and radius.
    let first = axis.cross(&Vector3::z()).normalize();
    let flat = |p: &[f64; 3]| {
        let p = Vector3::from(*p);
        Vector2::new(first.dot(&p), axis.cross(&first).dot(&p))
    };
    let flat: Vec<Vector2<f64>> = points.iter().map(flat).collect();
    let mut circle = flat.iter().sum::<Vector2<f64>>().push(0.0) / flat.len() as f64;
    let mut information = Matrix3::zeros();
    for _ in 0..50 {
        let mut right = Vector3::zeros();
        information = Matrix3::zeros();
        for p in &flat {
            let from = p - circle.xy();
            let gradient = (-from.normalize()).push(-1.0);
            information += gradient * gradient.transpose();
            right -= gradient * (from.norm() - circle.z);
        }
        circle += information.try_inverse().unwrap() * right;
    }
    let scatter = rms(flat.iter().map(|p| (p - circle.xy()).norm() - circle.z));
    let freedom = flat.len() as f64 - 3.0;
    let sigma = scatter * (information.try_inverse().unwrap()[(2, 2)] * flat.len() as f64 / freedom).sqrt();
    eprintln!(
        "axis {axis:.5?} ± {:.5}, {} outliers, radius {:.3} ± {sigma:.3} mm, scatter {scatter:.4} mm",
        fit.sigma_normal_rad, fit.deviations.outliers, circle.z
    );
    assert!((circle.z - radius_mm).abs() < SIGMAS * sigma + 0.005);
    assert!((scatter - scatter_mm).abs() < 0.001);
}
