//! What a scene's calibration says is the simulation's truth: its stripes, triangulated with it, are where the simulator says that they are.

use crate::scan::CALIBRATION;
use nalgebra::{Vector2, Vector3};
use uwscan::io::{Overwrite, calibration_toml};
use uwscan::pipeline::Silent;
use uwscan::pipeline::simulate::simulate;

/// Stripe centres are written to 1e-6 px, points to 1e-6 mm.
const ROUNDING_MM: f64 = 1e-4;

const VOLTAGE_V: f64 = -0.3;
const SCENE: &str = "format = \"uwscan-scene\"\nversion = 1\n\n[capture]\nkind = \"scan\"\nmedium = \"water\"\nvoltages_v = [-0.3]\n\n\
    [instrument]\ncalibration = \"calibration.toml\"\n\n\
    [[object]]\nname = \"wall\"\nshape = \"plane\"\nposition_mm = [0.0, 0.0, 900.0]\nrotation_deg = [10.0, 20.0, 0.0]\n";

#[test]
fn a_calibration_is_the_truth_with_its_water() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    calibration_toml::write(&path("calibration.toml"), Overwrite::Refuse, &CALIBRATION).unwrap();
    std::fs::write(path("scene.toml"), SCENE).unwrap();
    simulate(&path("scene.toml"), None, &path("capture"), Overwrite::Refuse, &Silent).unwrap();

    let calibration = &CALIBRATION.calibration;
    assert!(calibration.instrument.water_offset.abs() > 1e-5, "an offset that counts");
    let water = calibration.water(calibration.nominal_water_index.unwrap());
    let sheet = calibration.scanner().sheet(VOLTAGE_V, water);
    let stripes = std::fs::read_to_string(path("capture/truth/stripes.csv")).unwrap();
    let rows: Vec<&str> = stripes.lines().skip(1).collect();
    assert!(rows.len() > 400, "{}", rows.len());
    for row in rows {
        let numbers: Vec<f64> = row.split(',').map(|number| number.parse().unwrap()).collect();
        let [_, u, v, x, y, z, _] = numbers[..] else { panic!("{row}") };
        let ray = calibration.scanner().pixel_ray(&Vector2::new(u, v), water).unwrap();
        let met = sheet.intersect(&ray).unwrap();
        assert!((met - Vector3::new(x, y, z)).norm() < ROUNDING_MM, "{row}: {met}");
    }
}
