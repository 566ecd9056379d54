use std::{fs, path::Path};

use nalgebra::{DMatrix, Rotation3, Vector3};
use proptest::prelude::*;
use tempfile::TempDir;
use uw_calib::{
    Across, Calibration, CorrelatedPair, GLOBALS, Instrument, Method, NAMES, Rejected, Statistics, WorstImage,
};
use uw_geom::{Camera, Distortion, Fan, Galvo, Medium, Port, Scanner};
use uw_io::{CalibrationFile, CaptureSource, Overwrite, Rig, calibration_toml};

use crate::samples::{RIG, edit, says, write};

/// One unit in the last place of a number, relative to it.
const LAST_PLACE: f64 = f64::EPSILON;
/// Rounding of making unit vectors of unit vectors and closest points of closest points, of lengths below 1000 mm.
const ROUNDING: f64 = 1e-12;
/// Half of the fourth digit of a standard deviation, relative to it.
const FOUR_DIGITS: f64 = 5.01e-4;

/// Width and height of the camera's images.
const SIZE: [u32; 2] = [768, 576];

/// A calibration made of these numbers, which each are within −1 to 1.
fn calibration(numbers: &[f64]) -> CalibrationFile {
    let mut numbers = numbers.iter().copied().cycle();
    let mut next = || numbers.next().unwrap();
    let mut vector = || Vector3::from_fn(|_, _| next());
    let axes = Rotation3::from_scaled_axis(vector() * 3.0).into_inner();
    let normals = [vector(), vector()].map(|v| Rotation3::from_scaled_axis(v) * Vector3::z());
    let (on_axis, apex_mm) = (vector() * 400.0, vector() * 100.0);
    let x: Vector3<f64> = axes.column(0).into_owned();
    let origin_mm = on_axis - x * x.dot(&on_axis);
    let port = |normal, a: f64, b: f64, c: f64| Port {
        normal,
        distance_mm: 20.0 + a,
        thickness_mm: 8.0 + b,
        glass: Medium::of_index(1.5 + 0.01 * c),
    };
    let instrument = Instrument {
        scanner: Scanner {
            camera: Camera {
                fx: 1400.0 + next(),
                fy: 1450.0 + next(),
                cx: 380.0 + next(),
                cy: 290.0 + next(),
                distortion: Distortion {
                    k1: next(),
                    k2: next(),
                    p1: 1e-5 * next(),
                    p2: 1e-9 * next(),
                    k3: -0.0,
                },
            },
            camera_port: port(normals[0], next(), next(), next()),
            galvo: Galvo {
                origin_mm,
                axes,
                radians_per_volt: 0.03 + 0.01 * next(),
                quadratic: 1e-6 * next(),
                cubic: 1e-7 * next(),
                reference_v: next(),
            },
            fan: Fan {
                apex_mm,
                tilt_rad: 0.01 * next(),
                mirror_offset_mm: next(),
                mirror_normal_rad: next(),
            },
            laser_port: port(normals[1], next(), next(), next()),
        },
        water_offset: 1e-4 * next(),
        dispersion_offset: 1e-5 * next(),
    };
    let root = DMatrix::from_fn(GLOBALS, GLOBALS, |i, j| {
        10f64.powi(-(i as i32 % 7)) * (next() + f64::from(u8::from(i == j)))
    });
    let rig = {
        let dir = TempDir::new().unwrap();
        write(dir.path(), "rig.toml", RIG);
        let mut rig = Rig::read(&dir.path().join("rig.toml")).unwrap().0;
        [rig.camera.width, rig.camera.height] = SIZE;
        rig
    };
    CalibrationFile {
        calibration: Calibration {
            method: Method::Joint,
            instrument,
            covariance: Some(&root * root.transpose()),
            nominal_water_index: Some(1.3351),
            across: Across::U,
            image_size: SIZE,
            statistics: Statistics {
                reprojection_rms_px: 0.0567,
                stripe_rms_px: 0.1,
                stripe_rms_mm: 1.0 / 3.0,
                corners: 1320,
                stripe_points: 60_000,
                corners_rejected: 2,
                stripe_points_rejected: 1234,
                poses_used: 25,
                frames_used: 205,
                rejected: vec![Rejected { file: "images/ \"é\\\n.png".into(), reason: "no board".into() }],
                worst: vec![WorstImage { file: "images/7.png".into(), rms_px: 0.2, max_px: 0.9 }],
                correlated: vec![CorrelatedPair { a: NAMES[21], b: NAMES[29], correlation: -0.998 }],
                corner_scale: 1.04,
                stripe_scale: 0.97,
                iterations: 9,
            },
            warnings: vec!["the boards differ in tilt by only 15°".into(), "# \"second\"\nline".into()],
        },
        rig,
        captures: vec![
            CaptureSource {
                name: "cal-air".into(),
                sha256: "0123456789abcdef".repeat(4),
                medium: uw_io::Medium::Air,
            },
            CaptureSource { name: "cal-water".into(), sha256: "f".repeat(64), medium: uw_io::Medium::Water },
        ],
        software: calibration_toml::SOFTWARE.into(),
    }
}

fn sample() -> CalibrationFile {
    calibration(&std::array::from_fn::<_, 101, _>(|i| (i as f64 * 0.754_877_666).sin()))
}

/// What was read of what was written, and its text.
fn round_trip(file: &CalibrationFile) -> (CalibrationFile, String) {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("calibration.toml");
    calibration_toml::write(&path, Overwrite::Refuse, file).unwrap();
    let (read, problems) = calibration_toml::read(&path).unwrap();
    assert!(problems.is_empty(), "{problems:?}");
    (read, fs::read_to_string(&path).unwrap())
}

fn read(text: &str) -> Result<CalibrationFile, String> {
    let dir = TempDir::new().unwrap();
    write(dir.path(), "calibration.toml", text);
    calibration_toml::read(&dir.path().join("calibration.toml"))
        .map(|(file, _)| file)
        .map_err(|e| e.to_string())
}

/// The figures that the file holds in degrees.
fn angles(file: &mut CalibrationFile) -> [&mut f64; 5] {
    let Scanner { galvo, fan, .. } = &mut file.calibration.instrument.scanner;
    [
        &mut galvo.radians_per_volt,
        &mut galvo.quadratic,
        &mut galvo.cubic,
        &mut fan.tilt_rad,
        &mut fan.mirror_normal_rad,
    ]
}

/// All of it, each number's bits to be told from any other's: 0.0 and -0.0 print differently.
fn whole(file: &CalibrationFile) -> String {
    format!("{file:?}")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_calibration_reads_back_bit_for_bit(numbers in prop::collection::vec(-1.0..1.0f64, 211)) {
        let mut written = calibration(&numbers);
        let (mut read, _) = round_trip(&written);
        let (again, _) = round_trip(&read);
        prop_assert_eq!(whole(&again), whole(&read));
        for (was, is) in angles(&mut written).into_iter().zip(angles(&mut read)) {
            prop_assert!((*was - *is).abs() <= LAST_PLACE * was.abs(), "{was} {is}");
            *was = *is;
        }
        prop_assert_eq!(whole(&read), whole(&written));
    }
}

#[test]
fn without_covariance_water_and_captures_it_reads_back_too() {
    let mut file = sample();
    file.calibration.method = Method::Paper;
    file.calibration.across = Across::V;
    file.calibration.covariance = None;
    file.calibration.nominal_water_index = None;
    file.calibration.statistics = Statistics::default();
    file.calibration.warnings.clear();
    file.captures.clear();
    let (first, text) = round_trip(&file);
    assert_eq!(whole(&round_trip(&first).0), whole(&first));
    assert_eq!(first.calibration.method, Method::Paper);
    assert_eq!(first.calibration.across, Across::V);
    assert_eq!((first.calibration.covariance, first.calibration.nominal_water_index), (None, None));
    assert!(!text.contains("sigma_"), "{text}");
}

#[test]
fn every_estimate_has_the_sigma_of_the_covariance_beside_it() {
    let file = sample();
    let (_, text) = round_trip(&file);
    let table: toml::Table = text.parse().unwrap();
    let number = |path: &str, axis: Option<usize>| {
        let value = path.split('.').fold(None, |at: Option<&toml::Value>, key| match at {
            None => table.get(key),
            Some(value) => value.get(key),
        });
        let value = value.unwrap_or_else(|| panic!("{path} is missing"));
        axis.map_or(value, |k| &value[k]).as_float().unwrap()
    };
    let mut checked = 0;
    for q in file.calibration.quantities() {
        // A function of the others, not stored.
        if q.name.starts_with("laser.plane_normal") {
            continue;
        }
        // Components x, y, z are elements 0, 1, 2.
        let (stem, key) = q.name.rsplit_once('.').unwrap();
        let (key, axis) = ["x", "y", "z"]
            .iter()
            .enumerate()
            .find_map(|(k, axis)| {
                let inner = key.strip_suffix(&format!("_{axis}"));
                let inner = inner.map(str::to_owned);
                let with_unit = || key.strip_suffix(&format!("_{axis}_mm")).map(|s| format!("{s}_mm"));
                inner.or_else(with_unit).map(|key| (key, Some(k)))
            })
            .unwrap_or((key.to_owned(), None));
        let value = number(&format!("{stem}.{key}"), axis);
        assert!((value - q.value).abs() <= ROUNDING, "{}: {value} {}", q.name, q.value);
        let sigma = number(&format!("{stem}.sigma_{key}"), axis);
        assert!(
            sigma > 0.0 && (sigma / q.sigma - 1.0).abs() < FOUR_DIGITS,
            "{}: {sigma} {}",
            q.name,
            q.sigma
        );
        checked += 1;
    }
    // All but the three of the plane.
    assert_eq!(checked, 40);
}

#[test]
fn each_slip_is_named_with_its_key() {
    let (file, text) = round_trip(&sample());
    let line = |key: &str| {
        let line = text.lines().find(|l| l.starts_with(&format!("{key} = "))).unwrap();
        line.to_owned()
    };
    let set = |key: &str, value: &str| edit(&text, &line(key), &format!("{key} = {value}"));
    let variance = file.calibration.covariance.as_ref().unwrap()[(0, 0)];
    let off_diagonal = file.calibration.covariance.as_ref().unwrap()[(0, 1)];
    let cases: &[(String, &[&str])] = &[
        (edit(&text, calibration_toml::FORMAT, "uwscan-rig"), &[":1:1: format", "uwscan-calibration"]),
        (edit(&text, "version = 1", "version = 2"), &["newer"]),
        (set("fx_px", "nan"), &["camera.fx_px", "NaN"]),
        (set("fx_px", "-1400.0"), &["camera.fx_px", "positive"]),
        (set("fx_px", "1e308"), &["camera.fx_px", "focal length", "768 px wide"]),
        (set("fy_px", "1e-300"), &["camera.fy_px", "focal length"]),
        (set("cx_px", "-1e9"), &["camera.cx_px", "principal point"]),
        (set("k1", "1e30"), &["camera.k1", "distortion"]),
        (set("index_offset", "-0.9"), &["water.index_offset", "waters"]),
        (edit(&text, "[galvo]", "[galvo_]"), &["did you mean `galvo`?"]),
        (text[..text.find("[laser]").unwrap()].to_owned(), &["missing field `laser`", "the table [laser]"]),
        (set("sigma_k1", "-0.1"), &["camera.sigma_k1", "negative"]),
        (edit(&text, "sigma_fx_px", "sigma_fx"), &["unknown field `sigma_fx`", "did you mean"]),
        (edit(&text, "axis_point_mm", "axis_point"), &["did you mean `axis_point_mm`?"]),
        (set("axis_direction", "[1.0, 0.0, 0.0]"), &["galvo.axis_direction", "frame"]),
        (set("axis_direction", "[1e200, 0.0, 0.0]"), &["galvo.axis_direction", "frame"]),
        (set("axis_direction", "[1.0, 0.0]"), &["3 values"]),
        (set("degrees_per_volt", "inf"), &["galvo.degrees_per_volt", "inf"]),
        (set("normal", "[0.0, 0.0, 1.1]"), &["camera.port", "normal", "1.1"]),
        (set("thickness_mm", "-8.0"), &["camera.port", "thickness"]),
        (set("method", "\"join\""), &["did you mean \"joint\"?"]),
        (set("stripe_measured_along", "\"x\""), &["unknown variant `x`"]),
        (set("width", "9"), &["camera.width", "9 x 576", "768 x 576"]),
        (set("wavelength_nm", "550.0"), &["laser.wavelength_nm", "550 nm", "532 nm"]),
        (set("nominal_index", "0.5"), &["water.nominal_index"]),
        (set("sha256", "\"abc\""), &["captures.sha256", "64"]),
        (set("medium", "\"oil\""), &["unknown variant `oil`"]),
        (set("a", "\"galvo.turn_x\""), &["statistics.correlated", "did you mean \"galvo.turn_x_rad\"?"]),
        (set("focal_mm", "-12.0"), &["rig.camera.focal_mm", "positive"]),
        (set("glass_index", "0.0"), &["rig.priors.glass_index"]),
        (edit(&text, "focal_mm", "focal"), &["did you mean `focal_mm`?"]),
        (edit(&text, "    \"camera.fx_px\",\n", ""), &["covariance.names", "34", "33"]),
        (edit(&text, "\"camera.fx_px\"", "\"camera.fz_px\""), &["covariance.names", "did you mean"]),
        (
            edit(&text, "\"camera.fx_px\",\n    \"camera.fy_px\"", "\"camera.fy_px\",\n    \"camera.fx_px\""),
            &["covariance.names", "order"],
        ),
        (edit(&text, &format!("[{variance:?}, "), "["), &["covariance.rows", "camera.fx_px", "33"]),
        (edit(&text, &format!("[{variance:?}, "), "[-1.0, "), &["covariance.rows", "negative"]),
        (edit(&text, &format!("[{variance:?}, "), "[nan, "), &["covariance.rows", "NaN"]),
        (edit(&text, &format!("[{variance:?}, "), "[0.0, "), &["covariance.rows", "variances allow"]),
        (
            edit(
                &text,
                &format!("[{variance:?}, {off_diagonal:?}"),
                &format!("[{variance:?}, {:?}", -off_diagonal),
            ),
            &["covariance.rows", "symmetric"],
        ),
        (text[..text.find("[covariance]").unwrap()].into(), &["covariance", "missing"]),
        (text[..text.len() - 40].into(), &["calibration.toml"]),
        (text[..text.len() / 3].into(), &["calibration.toml"]),
        (String::new(), &["uwscan-calibration"]),
    ];
    for (text, parts) in cases {
        let message = read(text).unwrap_err();
        says(&message, parts);
        says(&message, &["calibration.toml:"]);
    }
}

#[test]
fn an_indefinite_covariance_is_refused() {
    // Three parameters that each go against the two others can't be: the least eigenvalue is 1 − 2 · 0.9.
    let mut file = sample();
    let mut covariance = DMatrix::identity(GLOBALS, GLOBALS);
    for (i, j) in [(0, 1), (0, 2), (1, 2)] {
        covariance[(i, j)] = -0.9;
        covariance[(j, i)] = -0.9;
    }
    file.calibration.covariance = Some(covariance.clone());
    let path = Path::new("calibration.toml");
    let message = calibration_toml::write(path, Overwrite::Refuse, &file).unwrap_err().to_string();
    says(&message, &["covariance.rows", "positive semidefinite"]);
    // Exactly dependent ones can.
    for (i, j) in [(0, 1), (0, 2), (1, 2)] {
        covariance[(i, j)] = 1.0;
        covariance[(j, i)] = 1.0;
    }
    covariance.row_mut(3).fill(0.0);
    covariance.column_mut(3).fill(0.0);
    file.calibration.covariance = Some(covariance.clone());
    assert_eq!(round_trip(&file).0.calibration.covariance, Some(covariance));
}

#[test]
fn what_could_not_be_read_is_not_written() {
    type Spoil = fn(&mut CalibrationFile);
    let spoiled: [(&str, Spoil); 6] = [
        ("camera.fx_px", |f| f.calibration.instrument.scanner.camera.fx = f64::NAN),
        ("galvo.axis_direction", |f| f.calibration.instrument.scanner.galvo.axes *= 2.0),
        ("statistics.stripe_scale", |f| f.calibration.statistics.stripe_scale = f64::INFINITY),
        ("camera.width", |f| f.calibration.image_size = [9, 9]),
        ("covariance.rows", |f| f.calibration.covariance = Some(DMatrix::zeros(3, 3))),
        ("laser.port", |f| f.calibration.instrument.scanner.laser_port.distance_mm = -1.0),
    ];
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("calibration.toml");
    for (key, spoil) in spoiled {
        let mut file = sample();
        spoil(&mut file);
        let message = calibration_toml::write(&path, Overwrite::Replace, &file).unwrap_err().to_string();
        says(&message, &[key, "can't be stored"]);
        assert!(!path.exists(), "{key}");
    }
    calibration_toml::write(&path, Overwrite::Refuse, &sample()).unwrap();
    let message = calibration_toml::write(&path, Overwrite::Refuse, &sample()).unwrap_err().to_string();
    says(&message, &["exists already", "--force"]);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damage_never_panics(at in 0.0..1.0f64, byte in any::<u8>(), torn in any::<bool>()) {
        static WHOLE: std::sync::LazyLock<String> = std::sync::LazyLock::new(|| round_trip(&sample()).1);
        let mut bytes = WHOLE.clone().into_bytes();
        let at = (at * bytes.len() as f64) as usize;
        bytes[at] = byte;
        if torn {
            bytes.truncate(at);
        }
        let dir = TempDir::new().unwrap();
        let path = dir.path().join("calibration.toml");
        fs::write(&path, bytes).unwrap();
        match calibration_toml::read(&path) {
            // One byte may well leave a sound file; one that ends early may not, its covariance being last.
            Ok(_) => prop_assert!(!torn || at + 2 >= WHOLE.len(), "torn at {at}"),
            Err(e) => says(&e.to_string(), &["calibration.toml"]),
        }
    }
}
