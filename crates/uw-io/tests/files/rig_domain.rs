//! What a rig file's figures become in calibration.

use tempfile::TempDir;
use uw_geom::{Medium, Port};
use uw_io::{Rig, Water};

use crate::samples::{RIG, edit, says, write};

/// Rounding of a few products of numbers below 10, without unit.
const ROUNDING: f64 = 1e-14;

fn read(text: &str) -> Rig {
    let dir = TempDir::new().unwrap();
    write(dir.path(), "rig.toml", text);
    Rig::read(&dir.path().join("rig.toml")).unwrap().0
}

#[test]
fn calibration_gets_pixels_windows_and_radians() {
    let rig = read(RIG).to_calib().unwrap();
    assert_eq!(rig.image_size, [8, 6]);
    // 12 mm over 8.6 and 8.3 µm.
    assert!((rig.focal_px[0] - 1_395.348_837_209_302_3).abs() < 1e-9);
    assert!((rig.focal_px[1] - 1_445.783_132_530_120_5).abs() < 1e-9);
    let port = |normal: [f64; 3], distance_mm, index| Port {
        normal: normal.into(),
        distance_mm,
        thickness_mm: 8.0,
        glass: Medium::of_index(index),
    };
    assert_eq!(rig.camera_port, port([0.0, 0.0, 1.0], 10.0, 1.5195));
    assert_eq!(rig.laser_port, port([0.0, 0.6, 0.8], 35.0, 1.4906));
    assert_eq!((rig.apex_mm, rig.reference_v), (Some(90.0), -1.61));
    assert!((rig.radians_per_volt - std::f64::consts::PI / 90.0).abs() < ROUNDING);
    assert_eq!(rig.priors, uw_calib::Priors::default());
}

#[test]
fn every_prior_reaches_calibration() {
    const KEYS: [&str; 14] = [
        "camera_port_distance_mm",
        "laser_port_distance_mm",
        "thickness_mm",
        "normal_deg",
        "glass_index",
        "water_index",
        "apex_mm",
        "degrees_per_volt_rel",
        "galvo_c2",
        "galvo_c3",
        "mirror_offset_mm",
        "fan_tilt_deg",
        "fan_offset_mm",
        "apex_along_axis_mm",
    ];
    let lines = KEYS.iter().enumerate().map(|(i, key)| format!("{key} = {}\n", i + 1));
    let rig = read(&format!("{RIG}\n[priors]\n{}", lines.collect::<String>()));
    // The domain's own names, in its own order, say which value went where.
    let got = format!("{:?}", rig.to_calib().unwrap().priors);
    for (i, key) in KEYS.iter().enumerate() {
        says(&got, &[&format!(" {key}: {}.0", i + 1)]);
    }
}

#[test]
fn a_window_that_is_none_is_an_error() {
    let mut rig = read(RIG);
    rig.laser.port.normal = [0.0, 0.0, 2.0];
    says(&rig.to_calib().unwrap_err().to_string(), &["normal", "length 1", "2"]);
}

#[test]
fn water_has_an_index_at_either_wavelength() {
    // The index itself is the laser's; elsewhere it moves with the dispersion of typical water.
    let rig = read(RIG);
    assert_eq!(rig.water_index(), Some(1.3351));
    assert_eq!(rig.water_index_at(532.0), Some(1.3351));
    // Quan and Fry by hand: 16.00668 (1/550 − 1/532) − 4382 (1/550² − 1/532²) + 1.1455e6 (1/550³ − 1/532³), 15 °C, 17.5 psu.
    let board = rig.water_index_at(550.0).unwrap();
    assert!((board - (1.3351 - 0.000_710_625)).abs() < 1e-9, "{board}");

    // What it follows from gives both; PAPER's check value for the laser's.
    let properties = "temperature_c = 20.0\nsalinity_psu = 35.0\ndepth_m = 0.0";
    let rig = read(&edit(RIG, "index = 1.3351", properties));
    assert!((rig.water_index().unwrap() - 1.341_510).abs() < 1e-6);
    let at_550 = rig.water_index_at(550.0).unwrap();
    assert!((at_550 - uw_geom::water::index(20.0, 35.0, 550.0, 0.0)).abs() < ROUNDING);
    // Either way the dispersion is nearly the same: within 2.5 % of itself.
    let (one, other) = (at_550 - rig.water_index().unwrap(), board - 1.3351);
    assert!((one / other - 1.0).abs() < 0.025, "{one} {other}");

    let deep = Water::Properties { temperature_c: 20.0, salinity_psu: 35.0, depth_m: 1000.0 };
    assert!(deep.index(532.0) > rig.water_index().unwrap() + 1e-3);

    let dry = read(&RIG[..RIG.find("[water]").unwrap()]);
    assert_eq!((dry.water_index(), dry.water_index_at(550.0)), (None, None));
}
