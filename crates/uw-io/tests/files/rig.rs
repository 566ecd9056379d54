use std::path::Path;

use tempfile::TempDir;
use uw_io::{Error, Priors, Rig, Water, rig::Port};

use crate::samples::{RIG, edit, says, write};

fn read(text: impl AsRef<[u8]>) -> Result<(Rig, Vec<String>), Error> {
    let dir = TempDir::new().unwrap();
    write(dir.path(), "rig.toml", text);
    let (rig, warnings) = Rig::read(&dir.path().join("rig.toml"))?;
    Ok((rig, warnings.iter().map(ToString::to_string).collect()))
}

#[test]
fn a_sound_rig_is_read_whole() {
    let (rig, warnings) = read(RIG).unwrap();
    assert_eq!(warnings, [""; 0]);
    assert_eq!((rig.camera.width, rig.camera.height, rig.camera.bits), (8, 6, 8));
    assert_eq!(rig.camera.pixel_um.map(f64::to_bits), [8.6_f64, 8.3].map(f64::to_bits));
    let port = Port { distance_mm: 35.0, thickness_mm: 8.0, normal: [0.0, 0.6, 0.8], index: 1.4906 };
    assert_eq!(rig.laser.port, port);
    assert_eq!((rig.laser.wavelength_nm, rig.laser.apex_mm), (532.0, Some(90.0)));
    assert_eq!(
        (rig.galvo.degrees_per_volt, rig.galvo.range_v, rig.galvo.reference_v),
        (2.0, [-10.0, 10.0], -1.61)
    );
    assert_eq!(rig.water, Some(Water::Index(1.3351)));
    assert_eq!(rig.priors, Priors::default());
}

#[test]
fn what_may_be_absent_is_none_and_what_is_given_is_taken() {
    let text = edit(RIG, "apex_mm       = 90.0\n", "");
    let (rig, _) = read(&text[..text.find("[water]").unwrap()]).unwrap();
    assert_eq!((rig.laser.apex_mm, rig.water), (None, None));

    let properties = "temperature_c = 12\nsalinity_psu = 35.0\ndepth_m = 20.0";
    let text = edit(RIG, "index = 1.3351", properties) + "\n[priors]\napex_mm = 7\ngalvo_c2 = 1e-5\n";
    let (rig, _) = read(text).unwrap();
    assert_eq!(rig.water, Some(Water::Properties { temperature_c: 12.0, salinity_psu: 35.0, depth_m: 20.0 }));
    assert_eq!(rig.priors, Priors { apex_mm: 7.0, galvo_c2: 1e-5, ..Priors::default() });
}

#[test]
fn what_is_written_is_read_back() {
    let (mut rig, _) = read(RIG).unwrap();
    rig.priors.normal_deg = 0.125;
    for water in [
        None,
        Some(Water::Index(1.34)),
        Some(Water::Properties { temperature_c: 4.0, salinity_psu: 0.0, depth_m: 0.0 }),
    ] {
        for apex_mm in [None, Some(100.0 / 3.0)] {
            rig.water = water;
            rig.laser.apex_mm = apex_mm;
            assert_eq!(read(rig.to_toml().unwrap()).unwrap(), (rig.clone(), vec![]));
        }
    }
}

#[test]
fn each_slip_is_named_with_its_line_and_key() {
    let with = |from: &str, to: &str| edit(RIG, from, to);
    let priors = |line: &str| format!("{RIG}\n[priors]\n{line}\n");
    let cases: &[(String, &[&str])] = &[
        (with("uwscan-rig", "uwscan-capture"), &[":1:1: format", "\"uwscan-capture\"", "uwscan-rig"]),
        (with("version = 1", "version = 2"), &[":2:1: version", "newer"]),
        (with("focal_mm = 12.0", "focal_mm = nan"), &[":8:1: camera.focal_mm", "NaN", "mm"]),
        (with("focal_mm = 12.0", "focal_mm = inf"), &[":8:1: camera.focal_mm"]),
        (with("focal_mm = 12.0", "focal_mm = 0"), &[":8:1: camera.focal_mm", "positive"]),
        (with("focal_mm = 12.0", "focal_mm = -12.0"), &[":8:1: camera.focal_mm"]),
        (with("focal_mm = 12.0", "focal = 12.0"), &[":8:1", "did you mean `focal_mm`?"]),
        (with("focal_mm = 12.0\n", ""), &[":4:", "missing field `focal_mm`", "add a line: focal_mm"]),
        (with("width  = 8", "width  = 0"), &[":5:1: camera.width"]),
        (with("width  = 8", "width  = -8"), &[":5:10: camera.width", "whole number"]),
        (with("width  = 8", "width  = 8.5"), &[":5:", "8.5"]),
        (with("width  = 8", "width  = 4000000000"), &[":5:1: camera.width"]),
        (with("width  = 8", "width  = 99999999999"), &[":5:"]),
        (with("bits = 8", "bits = 17"), &[":9:1: camera.bits", "17"]),
        (with("bits = 8", "bits = 0"), &[":9:1: camera.bits"]),
        (with("[8.6, 8.3]", "[8.6, 0.0]"), &[":7:1: camera.pixel_um"]),
        (with("[8.6, 8.3]", "8.6"), &[":7:12: camera.pixel_um", "write a list"]),
        (with("[8.6, 8.3]", "[8.6, 8.3, 8.3]"), &[":7:12: camera.pixel_um", "2 values, no more"]),
        (with("[0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0]"), &[":14:1: camera.port.normal", "no direction"]),
        (with("[0.0, 0.0, 1.0]", "[nan, 0.0, 1.0]"), &[":14:1: camera.port.normal"]),
        (with("[0.0, 0.0, 1.0]", "[0.0, 0.0, -1.0]"), &[":14:1: camera.port.normal", "outwards"]),
        (with("thickness_mm = 8.0", "thickness_mm = 0.0"), &[":13:1: camera.port.thickness_mm"]),
        (with("1.4906", "0.9"), &[":25:1: laser.port.index", "0.9 is no index"]),
        (with("apex_mm       = 90.0", "apex_mm       = -90.0"), &[":19:1: laser.apex_mm"]),
        (
            with("wavelength_nm = 532.0", "wavelength_nm = \"green\""),
            &[":18:17: laser.wavelength_nm", "green", "write a number"],
        ),
        (with("= 2.0", "= -2.0"), &[":28:1: galvo.degrees_per_volt", "negative"]),
        (with("= 2.0", "= 0.0"), &[":28:1: galvo.degrees_per_volt"]),
        (with("[-10.0, 10.0]", "[10.0, -10.0]"), &[":29:1: galvo.range_v", "lower voltage first"]),
        (with("[-10.0, 10.0]", "[nan, 10.0]"), &[":29:1: galvo.range_v"]),
        (with("-1.61", "inf"), &[":30:1: galvo.reference_v"]),
        (RIG[..RIG.find("[galvo]").unwrap()].to_owned(), &["missing field `galvo`", "the table [galvo]"]),
        (with("index = 1.3351", "index = 3.0"), &[":33:1: water.index", "3 is no index"]),
        (with("index = 1.3351", "index = 0.5"), &[":33:1: water.index"]),
        (with("index = 1.3351", ""), &["[water]", "temperature_c"]),
        (with("index = 1.3351", "temperature_c = 12.0"), &["[water]", "salinity_psu"]),
        (with("index = 1.3351", "index = 1.33\ndepth_m = 2.0"), &["[water]", "both"]),
        (
            with("index = 1.3351", "temperature_c = 300.0\nsalinity_psu = 35.0\ndepth_m = 0.0"),
            &[":33:1: water.temperature_c"],
        ),
        (
            with("index = 1.3351", "temperature_c = 3.0\nsalinity_psu = nan\ndepth_m = 0.0"),
            &[":34:1: water.salinity_psu"],
        ),
        (with("[laser.port]", "[laser.prot]"), &["did you mean `port`?"]),
        (priors("glas_index = 0.001"), &[":36:1", "did you mean `glass_index`?"]),
        (priors("port_distance_mm = 0.1"), &[":36:1", "port_distance_mm`?"]),
        (priors("apex_mm = 0.0"), &[":36:1: priors.apex_mm", "1e-6"]),
        (priors("apex_mm = -1.0"), &[":36:1: priors.apex_mm"]),
        (priors("apex_mm = nan"), &[":36:1: priors.apex_mm"]),
        (priors("colour = 1.0"), &[":36:1", "colour"]),
        (format!("{RIG}\n[prior]\napex_mm = 1.0\n"), &[":35:2", "did you mean `priors`?"]),
    ];
    for (text, parts) in cases {
        let message = read(text).unwrap_err().to_string();
        says(&message, parts);
        says(&message, &["rig.toml"]);
    }
    let missing = Rig::read(Path::new("no/such/rig.toml")).unwrap_err();
    says(&missing.to_string(), &["no/such/rig.toml", "cannot open"]);
}

#[test]
fn values_that_are_possible_but_odd_are_warned_of() {
    for (from, to, parts) in [
        ("[8.6, 8.3]", "[0.0086, 8.3]", &[":7:1: camera.pixel_um", "0.0086 µm", "unit"][..]),
        ("focal_mm = 12.0", "focal_mm = 0.012", &[":8:1: camera.focal_mm"]),
        ("wavelength_nm = 532.0", "wavelength_nm = 0.532", &[":18:1: laser.wavelength_nm"]),
        ("[0.0, 0.6, 0.8]", "[0.0, 0.6, -0.8]", &[":24:1: laser.port.normal"]),
        ("-1.61", "11.0", &[":30:1: galvo.reference_v", "outside"]),
        ("= 2.0", "= 20.0", &[":28:1: galvo.degrees_per_volt", "400 degrees"]),
        ("index = 1.3351", "index = 1.0", &[":33:1: water.index"]),
    ] {
        let (_, warnings) = read(edit(RIG, from, to)).unwrap();
        assert_eq!(warnings.len(), 1, "{to}: {warnings:?}");
        says(&warnings[0], parts);
    }
}

#[test]
fn normals_come_out_with_unit_length() {
    /// Rounding of a quotient, without unit.
    const ROUNDING: f64 = 1e-15;
    for (given, warned) in [
        ("[0.0, 0.0, 2.0]", true),
        ("[0.0, 0.0087, 0.99996]", false),
        ("[1e-200, 0.0, 1e-200]", true),
        ("[1e200, 3e200, 1e200]", true),
    ] {
        let (rig, warnings) = read(edit(RIG, "[0.0, 0.0, 1.0]", given)).unwrap();
        let length = rig.camera.port.normal.iter().map(|x| x * x).sum::<f64>().sqrt();
        assert!((length - 1.0).abs() < ROUNDING, "{given}: {length}");
        assert_eq!(warnings.len(), usize::from(warned), "{given}: {warnings:?}");
    }
}
