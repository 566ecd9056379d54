//! Whichever side of the laser the camera is on, and whichever way the mirror's axis runs: what is calibrated is what was simulated.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use nalgebra::Vector3;
use serde_json::Value;
use std::fmt::Write;
use uwscan::calib::Method;
use uwscan::io::Overwrite;
use uwscan::pipeline::Silent;
use uwscan::pipeline::calibrate::{Settings, calibrate};
use uwscan::pipeline::simulate::simulate;

/// The bar: what a figure is off its truth, in its own standard deviations. Of 28 normal numbers one is beyond it once in 560 times.
const SIGMAS: f64 = 4.0;

/// Mirrors may lie up to 2 mm beside their axes here, so that their side shows: of the wrong side, axis and window are 5 to 7 sigma off.
const RIG: &str = "format = \"uwscan-rig\"\nversion = 1\n\n\
    [camera]\nwidth = 400\nheight = 400\npixel_um = [16.6, 16.6]\nfocal_mm = 12.0\nbits = 8\n\n\
    [camera.port]\ndistance_mm = 10.0\nthickness_mm = 8.0\nnormal = [0.0, 0.0, 1.0]\nindex = 1.5195\n\n\
    [laser]\nwavelength_nm = 532.0\napex_mm = 90.0\n\n\
    [laser.port]\ndistance_mm = 35.0\nthickness_mm = 8.0\nnormal = [0.0, 0.0, 1.0]\nindex = 1.5195\n\n\
    [water]\nindex = 1.3351\n\n[priors]\nmirror_offset_mm = 1.0\n\n\
    [galvo]\ndegrees_per_volt = 2.0\nrange_v = [-10.0, 10.0]\nreference_v = ";
/// One whose mirror lies far beside its axis: 1.7 mm.
const INSTRUMENT: u64 = 3;

/// Placements of boards for a laser to the camera's right: middles in mm, turns in degrees.
const IN_AIR: [[[f64; 3]; 2]; 6] = [
    [[-60.0, 0.0, 740.0], [0.0, 0.0, 4.0]],
    [[-110.0, 20.0, 950.0], [24.0, 0.0, -6.0]],
    [[-95.0, -25.0, 900.0], [-25.0, 8.0, 3.0]],
    [[-100.0, 10.0, 960.0], [4.0, 27.0, -3.0]],
    [[-85.0, -10.0, 860.0], [-5.0, -27.0, 8.0]],
    [[-105.0, -40.0, 1000.0], [26.0, -12.0, 5.0]],
];
const IN_WATER: [[[f64; 3]; 2]; 4] = [
    [[40.0, 0.0, 680.0], [0.0, 4.0, 3.0]],
    [[10.0, 15.0, 950.0], [25.0, -4.0, -5.0]],
    [[0.0, 5.0, 970.0], [3.0, 27.0, -3.0]],
    [[-10.0, 25.0, 1070.0], [20.0, 20.0, -9.0]],
];

/// A layout: the laser to the camera's right, turned about the line of sight by quarters, with its axis and the sign of its voltages.
struct Layout {
    name: &'static str,
    quarters: usize,
    axis: [f64; 3],
    sign: f64,
}

/// Both sides of both axes.
const LAYOUTS: [Layout; 4] = [
    Layout { name: "laser to the right", quarters: 0, axis: [0.0, -1.0, 0.0], sign: 1.0 },
    Layout { name: "laser below", quarters: 1, axis: [1.0, 0.0, 0.0], sign: 1.0 },
    Layout { name: "laser to the left", quarters: 2, axis: [0.0, -1.0, 0.0], sign: -1.0 },
    Layout { name: "laser above", quarters: 3, axis: [1.0, 0.0, 0.0], sign: -1.0 },
];

impl Layout {
    fn turned(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [x, y] = (0..self.quarters).fold([x, y], |[x, y], _| [-y, x]);
        [x, y, z]
    }

    fn scene(&self, medium: &str, square_mm: f64, volts: [f64; 2], boards: &[[[f64; 3]; 2]]) -> String {
        let [from, to] = volts.map(|v| self.sign * v);
        let mut text = format!(
            "format = \"uwscan-scene\"\nversion = 1\n\n[capture]\nkind = \"calibration\"\nmedium = \"{medium}\"\n\
             sweep = {{ from_v = {from:?}, to_v = {to:?}, steps = 4 }}\n\n\
             [capture.target]\npattern = \"chessboard\"\ninner_corners = [11, 8]\nsquare_mm = {square_mm:?}\n\n\
             [instrument]\nrig = \"rig.toml\"\ndiffers_by_seed = {INSTRUMENT}\naxis_direction = {:?}\n\
             axis_point_mm = {:?}\nbeam_direction = {:?}\n\n[beam]\nlevel = 1.3\n",
            self.axis,
            self.turned([430.0, 0.0, -13.0]),
            self.turned([-0.4355, 0.0, 0.9002]),
        );
        for [at, turn] in boards {
            let (at, turn) = (self.turned(*at), self.turned(*turn));
            write!(text, "\n[[pose]]\nposition_mm = {at:?}\nrotation_deg = {turn:?}\n").unwrap();
        }
        text
    }
}

fn three(value: &Value) -> Vector3<f64> {
    Vector3::from_fn(|i, _| value[i].as_f64().unwrap())
}

#[test]
fn a_mirror_is_found_on_the_side_where_it_was_simulated() {
    for layout in &LAYOUTS {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("rig.toml"), format!("{RIG}{:?}\n", -1.5 * layout.sign)).unwrap();
        let shoot = |medium: &str, square_mm, volts, boards: &[_]| {
            let scene = path(medium).with_extension("toml");
            std::fs::write(&scene, layout.scene(medium, square_mm, volts, boards)).unwrap();
            simulate(&scene, None, &path(medium), Overwrite::Refuse, &Silent).unwrap();
            path(medium)
        };
        let captures =
            [shoot("air", 24.0, [-2.1, 1.5], &IN_AIR), shoot("water", 18.0, [-1.5, 1.5], &IN_WATER)];
        let truth = std::fs::read_to_string(captures[0].join("truth/truth.json")).unwrap();
        let truth = &serde_json::from_str::<Value>(&truth).unwrap()["rig"];
        let point = three(&truth["galvo"]["axis_point_mm"]);
        let window = &truth["laser"]["port"];
        let offset = truth["galvo"]["mirror_offset_mm"].as_f64().unwrap();

        let made = calibrate(&captures, &Settings { rig: None, method: Method::Joint }, &Silent).unwrap();
        let found = made.file.calibration.quantities();
        let normal = three(&window["normal"]);
        for (name, true_value) in [
            ("galvo.axis_point_x_mm", point.x),
            ("galvo.axis_point_y_mm", point.y),
            ("galvo.axis_point_z_mm", point.z),
            ("galvo.mirror_offset_mm", offset),
            ("laser.port.distance_mm", window["distance_mm"].as_f64().unwrap()),
            ("laser.port.normal_x", normal.x),
            ("laser.port.normal_y", normal.y),
        ] {
            let q = found.iter().find(|q| q.name == name).unwrap();
            let sigmas = (q.value - true_value) / q.sigma;
            assert!(
                sigmas.abs() < SIGMAS,
                "{}: {name} is {} ± {}, in truth {true_value}: {sigmas:.1} sigma",
                layout.name,
                q.value,
                q.sigma
            );
        }

        // The body's side, told by where its light comes from: the camera's.
        let y = three(&truth["galvo_frame"]["rows_x_y_z_in_camera"][1]);
        let across = |place: Vector3<f64>| (place - point).dot(&y);
        let (body, camera) = (across(three(&truth["laser"]["apex_mm"])), across(Vector3::zeros()));
        assert!(body * camera > 0.0, "{}: body at {body} mm, camera at {camera} mm", layout.name);
    }
}
