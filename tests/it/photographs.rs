//! A real camera from photographs that the repository holds, with a known answer.

use std::path::{Path, PathBuf};
use uwscan::calib::{CalibError, PinholeOptions};
use uwscan::pipeline::Silent;
use uwscan::pipeline::camera::calibrate_camera;
use uwscan::{Error, Failure};

/// Published for these photographs, px: focal length and residual (fixtures/README.md).
const PUBLISHED_PX: f64 = 535.916;
const PUBLISHED_RMS_PX: f64 = 0.392_59;
/// How far two answers may be apart, in standard deviations of both.
const SIGMAS: f64 = 3.0;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}

fn square() -> PinholeOptions {
    PinholeOptions { equal_focal: true, ..PinholeOptions::default() }
}

#[test]
fn photographs_give_the_published_focal_length() {
    let made = calibrate_camera(&fixture("photographs"), square(), &Silent).expect("the photographs serve");
    assert_eq!((made.files.len(), made.image_size), (13, [640, 480]));
    assert!(made.notes.rejected.is_empty() && made.corners.iter().all(|corners| corners.len() == 54));
    let camera = &made.pinhole;
    // The published one has our uncertainty, times the ratio of the residuals.
    let sigma_px = camera.sigmas()[0] * 1.0_f64.hypot(PUBLISHED_RMS_PX / camera.rms_px);
    let off_px = camera.camera.fx - PUBLISHED_PX;
    assert!(off_px.abs() < SIGMAS * sigma_px, "{off_px} px off, sigma {sigma_px}");
    assert!(camera.rms_px < PUBLISHED_RMS_PX && sigma_px < 3.0, "{} px rms, {sigma_px}", camera.rms_px);
    // What is told of each corner is what the figures are made of.
    let squares = made.corners.iter().flatten().map(|[[u, v], [x, y]]| (u - x).powi(2) + (v - y).powi(2));
    let count = made.corners.iter().map(Vec::len).sum::<usize>();
    let all_px = (squares.sum::<f64>() / count as f64).sqrt();
    let kept = 1.0 - camera.outliers.len() as f64 / count as f64;
    assert!(
        kept > 0.98 && all_px > 0.99 * camera.rms_px && all_px < 2.0 * camera.rms_px,
        "{all_px} px of all"
    );
}

#[test]
fn what_shows_no_camera_is_told() {
    let fails = |name: &str| {
        let Failure { error, .. } =
            calibrate_camera(&fixture(name), square(), &Silent).expect_err("no camera");
        *error
    };
    assert!(matches!(fails("ball"), Error::Kind { needed: "calibration", .. }));
    assert!(matches!(fails("cal-water"), Error::Kind { needed: "calibration in air", .. }));
    let folder = tempfile::tempdir().expect("a folder");
    let (from, to) = (fixture("photographs"), folder.path());
    std::fs::create_dir(to.join("images")).expect("a folder");
    std::fs::copy(from.join("capture.toml"), to.join("capture.toml")).expect("a copy");
    let table = std::fs::read_to_string(from.join("frames.csv")).expect("its table");
    let few: Vec<&str> = table.lines().take(3).collect();
    std::fs::write(to.join("frames.csv"), few.join("\n") + "\n").expect("a table");
    for row in &few[1..] {
        let file = row.split(',').next().expect("a file");
        std::fs::copy(from.join(file), to.join(file)).expect("a copy");
    }
    let failure = calibrate_camera(to, square(), &Silent).expect_err("two photographs");
    let Error::Calibration(CalibError::TooFewPoses { got: 2, .. }) = *failure.error else {
        panic!("{failure}")
    };
}
