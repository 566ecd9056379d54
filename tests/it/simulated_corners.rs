//! Corners of a simulated board lie where projection puts them: what a pattern's averaging, the lens's blur and the rounding to grey values
//! add is no bias. Detection is not the simulator's; projection goes the other way through the window.

use crate::scan::CALIBRATION;
use nalgebra::{Matrix3, Vector2, Vector3};
use uwscan::calib::{Chessboard, GreyView, Layout, Samples, detect};
use uwscan::geom::Medium;
use uwscan::io::{Capture, Expect, Overwrite, Pixels, Reduce, SaidBy, calibration_toml};
use uwscan::pipeline::Silent;
use uwscan::pipeline::simulate::simulate;

/// The bar: mean offset of a placement's corners, px.
const BIAS_PX: f64 = 0.005;
/// Single corners in images without noise, rms, px: rounding to 256 grey values, and detection's own.
const SCATTER_PX: f64 = 0.02;

const SCENE: &str = "format = \"uwscan-scene\"\nversion = 1\nseed = 1\n\n[capture]\nkind = \"calibration\"\nmedium = \"air\"\n\
    voltages_v = [0.0]\n\n[capture.target]\npattern = \"chessboard\"\ninner_corners = [11, 8]\nsquare_mm = 24.0\n\n\
    [instrument]\ncalibration = \"calibration.toml\"\n\n[sensor]\nfull_well = 0.0\nread_noise = 0.0\n\n\
    [[pose]]\nposition_mm = [-60.0, 0.0, 740.0]\nrotation_deg = [0.0, 0.0, 4.0]\n\n\
    [[pose]]\nposition_mm = [-110.0, 20.0, 950.0]\nrotation_deg = [24.0, 0.0, -6.0]\n\n\
    [[pose]]\nposition_mm = [-85.0, -10.0, 860.0]\nrotation_deg = [-5.0, -27.0, 8.0]\n";

#[test]
fn corners_of_a_simulated_board_have_no_bias() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    calibration_toml::write(&path("calibration.toml"), Overwrite::Refuse, &CALIBRATION).unwrap();
    std::fs::write(path("scene.toml"), SCENE).unwrap();
    simulate(&path("scene.toml"), None, &path("capture"), Overwrite::Refuse, &Silent).unwrap();
    let capture = Capture::open(&path("capture")).unwrap();
    let rig = capture.rig.as_ref().unwrap();
    let truth = std::fs::read_to_string(path("capture/truth/truth.json")).unwrap();
    let truth: serde_json::Value = serde_json::from_str(&truth).unwrap();
    let scanner = CALIBRATION.calibration.scanner();
    let board = Chessboard::new(11, 8, 24.0).unwrap();
    let dark: Vec<_> = capture.present().filter(|frame| !frame.laser_on).collect();
    assert_eq!(dark.len(), 3);
    for frame in dark {
        let image = capture.image(frame, Reduce::Luma, Some(Expect::of(&rig.camera, SaidBy::Rig))).unwrap();
        let Pixels::U8(values) = &image.data else { panic!("8 bits") };
        let (width, height) = (image.width as usize, image.height as usize);
        let layout = Layout { width, height, stride: width };
        let view = GreyView::new(Samples::U8(values), layout, 255).unwrap();
        let found = detect(&view, &board).unwrap();
        assert_eq!(found.corners.len(), 88);
        let pose = &truth["board_poses"][frame.pose.unwrap() as usize];
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let rotation = Matrix3::from_fn(|i, k| number(&pose["rotation"][i][k]));
        let origin = Vector3::from_fn(|i, _| number(&pose["translation_mm"][i]));
        let corner = |[column, row]: [usize; 2]| {
            let [x, y, z] = board.corner_mm([column, row]);
            scanner.project(&(rotation * Vector3::new(x, y, z) + origin), Medium::air()).unwrap()
        };
        // Which of the board's two ways up detection took, nothing in the image tells.
        let turned = |[column, row]: [usize; 2]| [10 - column, 7 - row];
        let offsets = |way: &dyn Fn([usize; 2]) -> [usize; 2]| -> Vec<Vector2<f64>> {
            found.corners.iter().map(|c| Vector2::from(c.pixel) - corner(way(c.index))).collect()
        };
        let (as_is, upside_down) = (offsets(&|index| index), offsets(&turned));
        let offsets = if as_is[0].norm() < upside_down[0].norm() { as_is } else { upside_down };
        let mean = offsets.iter().sum::<Vector2<f64>>() / offsets.len() as f64;
        let rms =
            (offsets.iter().map(Vector2::norm_squared).sum::<f64>() / (2 * offsets.len()) as f64).sqrt();
        assert!(mean.amax() < BIAS_PX, "pose {:?}: corners are off by {mean:?} px", frame.pose);
        assert!(rms < SCATTER_PX, "pose {:?}: {rms} px", frame.pose);
    }
}
