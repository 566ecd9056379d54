//! Real photographs with known answers. They are not part of the repository; the tests say so where the
//! folder is missing.

#![allow(clippy::print_stderr, reason = "a skipped test says so")]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use uw_calib::{
    BoardView, Chessboard, CornerPoint, Detection, GreyView, Layout, Outside, Pinhole, PinholeOptions,
    Rejection, Samples, calibrate_pinhole, closed_form, detect, label_capture,
};

/// Returns a folder of photographs, or says that it is missing.
fn folder(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/real").join(name);
    if !folder.is_dir() {
        eprintln!("skipped: no {}", folder.display());
        return None;
    }
    Some(folder)
}

fn photographs(folder: &Path, prefix: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let named = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        name.starts_with(prefix) && name.ends_with(".jpg")
    };
    let mut files: Vec<_> = entries.filter(named).collect();
    files.sort();
    files
}

fn find(image: &image::GrayImage, board: &Chessboard) -> Result<Detection, Rejection> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let layout = Layout { width, height, stride: width };
    detect(&GreyView::new(Samples::U8(image), layout, 255).unwrap(), board)
}

fn find_all(
    files: &[PathBuf],
    board: &Chessboard,
    turn: fn(image::GrayImage) -> image::GrayImage,
) -> (Vec<BoardView>, [u32; 2]) {
    let mut size = [0, 0];
    let found = files.iter().map(|file| {
        let image = turn(image::open(file).unwrap().to_luma8());
        size = [image.width(), image.height()];
        find(&image, board)
    });
    let found = label_capture(found.collect(), board).unwrap();
    let views = files.iter().zip(found).map(|(file, detection)| {
        let detection = detection.unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        assert!(detection.full, "{}: {:?}", file.display(), detection.seen);
        let corners = detection.corners.iter().map(|c| CornerPoint {
            board_mm: Vector2::new(board.corner_mm(c.index)[0], board.corner_mm(c.index)[1]),
            pixel: Vector2::from(c.pixel),
            covariance: c.covariance,
        });
        BoardView {
            file: file.display().to_string(),
            outside: Outside::Air,
            square_mm: board.square_mm(),
            corners: corners.collect(),
            stripes: Vec::new(),
        }
    });
    (views.collect(), size)
}

fn calibrate(views: &[BoardView], size: [u32; 2], options: PinholeOptions) -> Pinhole {
    let start = closed_form(views, size).unwrap();
    let result = calibrate_pinhole(views, &start, options).unwrap();
    let c = result.camera;
    eprintln!(
        "{size:?}: closed form f {:.1} {:.1}; f {:.3} {:.3} ± {:.3}, c {:.2} {:.2}, {:?}, RMS {:.4} px, model {:.4} px, {} outliers",
        start.fx,
        start.fy,
        c.fx,
        c.fy,
        result.sigmas()[0],
        c.cx,
        c.cy,
        c.distortion,
        result.rms_px,
        result.model_sigma_px,
        result.outliers.len()
    );
    result
}

#[test]
fn opencv_samples_give_the_published_focal_length() {
    let Some(folder) = folder("opencv_samples") else { return };
    let board = Chessboard::new(9, 6, 25.0).unwrap();
    let (right, _) = find_all(&photographs(&folder, "right"), &board, |image| image);
    assert_eq!(right.len(), 13);
    let (left, size) = find_all(&photographs(&folder, "left"), &board, |image| image);
    assert_eq!(left.len(), 13);
    assert!(left.iter().chain(&right).all(|view| view.corners.len() == board.corners()));
    let result = calibrate(&left, size, PinholeOptions { equal_focal: true, ..PinholeOptions::default() });
    // left_intrinsics_expected.yml: f 535.916, RMS 0.3926 px. That RMS comes from two photographs whose
    // corners the published refinement misplaced (1.18 and 0.38 px, 0.16 to 0.30 on the others), and moves f
    // by 3 px: OpenCV with a window of 7 instead of 11 gives 532.93 at 0.183 px, ours is 533.5 at 0.159.
    // Neither is the truth, so the difference is held against the uncertainty of both; the published one has
    // ours, times the ratio of the residuals.
    let published_sigma = result.sigmas()[0] * 0.392_59 / result.rms_px;
    let sigma = result.sigmas()[0].hypot(published_sigma);
    assert!((result.camera.fx - 535.92).abs() < 3.0 * sigma, "f {} ± {sigma}", result.camera.fx);
    assert!(result.rms_px <= 0.40);
    assert!(result.view_rms_px.iter().all(|rms| *rms < 1.0), "{:?}", result.view_rms_px);
}

#[test]
fn a_board_with_a_white_corner_square_is_found_on_every_photograph() {
    let Some(folder) = folder("jzx_structured_light/calib") else { return };
    let board = Chessboard::new(5, 7, 20.0).unwrap();
    let (views, size) = find_all(&photographs(&folder, ""), &board, |image| image);
    assert_eq!(views.len(), 10);
    // One corner square of the print is white, so that one inner corner is none.
    assert!(views.iter().all(|view| view.corners.len() >= board.corners() - 1));
    let result = calibrate(&views, size, PinholeOptions::default());
    assert!(result.rms_px < 0.5);
}

#[test]
fn a_scanner_of_others_has_its_published_intrinsics() {
    let Some(folder) = folder("3DScanScience/calib_frames") else { return };
    let board = Chessboard::new(11, 6, 13.0).unwrap();
    let upright = |image: image::GrayImage| image::imageops::rotate270(&image);
    let (views, size) = find_all(&photographs(&folder, "frame"), &board, upright);
    assert_eq!((views.len(), size), (16, [1280, 960]));
    let result = calibrate(&views, size, PinholeOptions::default());
    // Published from the same photographs with other corners, so about as uncertain as ours.
    let sigma = result.sigmas()[0] * std::f64::consts::SQRT_2;
    assert!((result.camera.fx - 1430.39).abs() < 3.0 * sigma);
}
