use std::{fmt::Write, fs, path::PathBuf};

use serde_json::Value;
use tempfile::TempDir;

use crate::samples::{has_numbers, keys, uwscan};

const RADIUS_MM: f64 = 20.0175;
const CENTER_MM: [f64; 3] = [12.0, -21.5, 700.0];
/// Positions are written with 1e-9 mm and the plane's points are exact: what is left is rounding.
const EXACT_MM: f64 = 1e-6;
/// By how much the ball's points lie outside and inside, mm.
const ROUGHNESS_MM: f64 = 0.01;
/// Five sigma of the least certain of its figures (0.0012 mm, the centre's z) with that roughness at 600 points.
const BALL_MM: f64 = 0.006;

/// A spiral over the half of a ball that faces the camera, slightly rough, with a few strays, as an ascii PLY.
fn ball(dir: &TempDir) -> PathBuf {
    let mut points: Vec<[f64; 3]> = (0..600)
        .map(|i| {
            let (turn, z) = (2.4 * f64::from(i), -f64::from(i + 1) / 600.0);
            let r = (1.0 - z * z).sqrt();
            let outside_mm = ROUGHNESS_MM * f64::from(i * 5 % 7 - 3) / 2.0;
            [r * turn.cos(), r * turn.sin(), z].map(|c| (RADIUS_MM + outside_mm) * c)
        })
        .map(|p| std::array::from_fn(|i| p[i] + CENTER_MM[i]))
        .collect();
    points.extend(
        (0..12).map(|i| [f64::from(i) * 9.0 - 50.0, 40.0 - f64::from(i * i), 690.0 + f64::from(i * 7 % 5)]),
    );
    ply(dir, "ball.ply", &points)
}

fn ply(dir: &TempDir, name: &str, points: &[[f64; 3]]) -> PathBuf {
    let mut text = format!(
        "ply\nformat ascii 1.0\ncomment frame galvo\ncomment unit mm\nelement vertex {}\nproperty double x\n\
         property double y\nproperty double z\nend_header\n",
        points.len()
    );
    points.iter().for_each(|[x, y, z]| writeln!(text, "{x:.9} {y:.9} {z:.9}").unwrap());
    let path = dir.path().join(name);
    fs::write(&path, text).unwrap();
    path
}

#[track_caller]
fn close(got: &Value, expected: f64, tolerance: f64) {
    let got = got.as_f64().unwrap();
    assert!((got - expected).abs() < tolerance, "{got} is not {expected}");
}

#[test]
fn a_ball_is_measured_and_told_as_json() {
    let dir = TempDir::new().unwrap();
    let file = ball(&dir);
    let fit = uwscan(["fit".as_ref(), "sphere".as_ref(), file.as_os_str(), "--json".as_ref()]).json(0);
    assert_eq!(
        keys(&fit),
        [
            "center_mm",
            "duplicates",
            "floor_mm",
            "frame",
            "histogram",
            "max_inside_mm",
            "max_outside_mm",
            "outliers",
            "points",
            "radius_mm",
            "rms_mm",
            "scale",
            "sigma_center_mm",
            "sigma_radius_mm",
            "warnings"
        ]
    );
    close(&fit["radius_mm"], RADIUS_MM, BALL_MM);
    (0..3).for_each(|i| close(&fit["center_mm"][i], CENTER_MM[i], BALL_MM));
    assert_eq!((fit["points"].as_u64(), fit["outliers"].as_u64()), (Some(600), Some(12)));
    assert_eq!(fit["frame"], "galvo");
    has_numbers(
        &fit,
        &["/sigma_radius_mm", "/sigma_center_mm/2", "/rms_mm", "/max_outside_mm", "/max_inside_mm"],
    );
}

#[test]
fn a_ball_of_known_radius_and_text_for_people() {
    let dir = TempDir::new().unwrap();
    let file = ball(&dir);
    let file = file.to_str().unwrap();
    let fit = uwscan(["fit", "sphere", file, "--radius", "20.0175", "--json"]).json(0);
    close(&fit["radius_mm"], RADIUS_MM, EXACT_MM);
    close(&fit["sigma_radius_mm"], 0.0, EXACT_MM);
    close(&fit["center_mm"][2], CENTER_MM[2], BALL_MM);
    let run = uwscan(["fit", "sphere", file]);
    for part in ["sphere", "radius", "20.01", "±", "12 outliers", "galvo frame"] {
        assert!(run.text().contains(part), "{part} in {}", run.stdout);
    }
}

#[test]
fn a_plane_is_measured_from_text_files_too() {
    let dir = TempDir::new().unwrap();
    // z = 500 + 0.75 x: the normal towards the origin is (0.6, 0, -0.8), and it lies 400 mm away.
    let points =
        || (0..400).map(|i| (f64::from(i % 20), f64::from(i / 20))).map(|(x, y)| [x, y, 500.0 + 0.75 * x]);
    let lines = |separator: &str| -> String {
        points().map(|p| p.map(|c| c.to_string()).join(separator) + "\n").collect()
    };
    let (xyz, csv) = (dir.path().join("plane.xyz"), dir.path().join("plane.CSV"));
    fs::write(&xyz, lines(" ")).unwrap();
    fs::write(&csv, format!("x,y,z\n{}", lines(","))).unwrap();
    let ply = ply(&dir, "plane.ply", &points().collect::<Vec<_>>());
    for file in [xyz, csv, ply] {
        let fit = uwscan(["fit".as_ref(), "plane".as_ref(), file.as_os_str(), "--json".as_ref()]).json(0);
        assert_eq!(
            keys(&fit),
            [
                "duplicates",
                "floor_mm",
                "frame",
                "histogram",
                "max_inside_mm",
                "max_outside_mm",
                "normal",
                "offset_mm",
                "outliers",
                "points",
                "rms_mm",
                "scale",
                "sigma_normal",
                "sigma_normal_deg",
                "sigma_offset_mm",
                "warnings"
            ]
        );
        [0.6, 0.0, -0.8].into_iter().enumerate().for_each(|(i, n)| close(&fit["normal"][i], n, EXACT_MM));
        close(&fit["offset_mm"], 400.0, EXACT_MM);
        has_numbers(
            &fit,
            &["/sigma_normal/0", "/sigma_offset_mm", "/rms_mm", "/max_outside_mm", "/max_inside_mm"],
        );
        let run = uwscan(["fit".as_ref(), "plane".as_ref(), file.as_os_str()]);
        assert!(run.text().contains("normal") && run.text().contains("400.0"), "{}", run.stdout);
    }
}

#[test]
fn clouds_without_the_shape_fail_with_the_files_name() {
    let dir = TempDir::new().unwrap();
    let fit = |file: &PathBuf| uwscan(["fit".as_ref(), "sphere".as_ref(), file.as_os_str()]);
    fit(&dir.path().join("nothing.ply")).fails(&["nothing.ply", "check the path"]);
    fit(&ply(&dir, "few.ply", &[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
        .fails(&["few.ply", "needs 5 distinct points, got 3"]);
    let line: Vec<[f64; 3]> = (0..50).map(|i| [f64::from(i), 0.0, 500.0]).collect();
    fit(&ply(&dir, "line.ply", &line)).fails(&["line.ply", "sphere"]);
    let torn = ball(&dir);
    let text = fs::read_to_string(&torn).unwrap();
    fs::write(&torn, &text[..text.len() / 2]).unwrap();
    fit(&torn).fails(&["ball.ply"]);
    fs::write(&torn, text.replace("comment unit mm", "comment unit m")).unwrap();
    fit(&torn).fails(&["ball.ply", "millimetres"]);
    let csv = dir.path().join("words.csv");
    fs::write(&csv, "x,y,z\n1,2,three\n").unwrap();
    fit(&csv).fails(&["words.csv:2", "three"]);
}

/// The near half of a pipe about (0, 0, 700) along x, noisy by a rule, as long as 60 mm.
fn pipe(dir: &TempDir) -> PathBuf {
    let points: Vec<[f64; 3]> = (0..1200)
        .map(|i| {
            let (t, x) = (3.3 + 2.7 * f64::from(i % 40) / 40.0, 2.0 * f64::from(i / 40));
            let radius = 30.0 + ROUGHNESS_MM * f64::from(i * 5 % 7 - 3) / 2.0;
            [x, radius * f64::cos(t), 700.0 + radius * f64::sin(t)]
        })
        .collect();
    ply(dir, "pipe.ply", &points)
}

#[test]
fn a_pipe_is_measured_and_a_ring_too() {
    let dir = TempDir::new().unwrap();
    let file = pipe(&dir);
    let file = file.to_str().unwrap();
    let fit = uwscan(["fit", "cylinder", file, "--json"]).json(0);
    close(&fit["radius_mm"], 30.0, BALL_MM);
    close(&fit["axis_direction"][0], 1.0, 1e-6);
    close(&fit["axis_point_mm"][2], 700.0, BALL_MM);
    has_numbers(
        &fit,
        &["/sigma_radius_mm", "/sigma_axis_point_mm/2", "/sigma_axis_direction/1", "/rms_mm", "/extent_mm/0"],
    );
    assert!(fit.get("sigma_total_radius_mm").is_none(), "only with a calibration");
    let counts: u64 =
        fit["histogram"]["counts"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(Some(counts), fit["points"].as_u64());
    let known = uwscan(["fit", "cylinder", file, "--radius", "30", "--json"]).json(0);
    close(&known["sigma_radius_mm"], 0.0, EXACT_MM);
    let run = uwscan(["fit", "cylinder", file]);
    for part in ["cylinder", "radius", "axis", "direction", "±", "galvo frame"] {
        assert!(run.text().contains(part), "{part} in {}", run.stdout);
    }
    let ring: Vec<[f64; 3]> = (0..90)
        .map(|i| (0.05 * f64::from(i), 25.0 + ROUGHNESS_MM * f64::from(i * 5 % 7 - 3)))
        .map(|(t, r)| [r * t.cos(), r * t.sin(), 650.0])
        .collect();
    let ring = ply(&dir, "ring.ply", &ring);
    let fit = uwscan(["fit".as_ref(), "circle".as_ref(), ring.as_os_str(), "--json".as_ref()]).json(0);
    close(&fit["radius_mm"], 25.0, 0.02);
    close(&fit["normal"][2], -1.0, 1e-6);
    has_numbers(&fit, &["/sigma_radius_mm", "/sigma_center_mm/2", "/sigma_normal/0", "/max_outside_mm"]);
}

#[test]
fn shapes_are_found_and_told_apart() {
    let dir = TempDir::new().unwrap();
    let mut points: Vec<[f64; 3]> = Vec::new();
    for (x, radius) in [(-40.0, 20.0), (45.0, 25.0)] {
        points.extend((0..1500).map(|i| {
            let (turn, z) = (2.4 * f64::from(i), -f64::from(i + 1) / 1501.0);
            let r = (1.0 - z * z).sqrt();
            let size = radius + ROUGHNESS_MM * f64::from(i * 5 % 7 - 3) / 2.0;
            [x + size * r * turn.cos(), size * r * turn.sin(), 700.0 + size * z]
        }));
    }
    let file = ply(&dir, "balls.ply", &points);
    let file = file.to_str().unwrap();
    let found = uwscan(["shapes", file, "--json"]).json(0);
    let shapes = found["shapes"].as_array().unwrap();
    assert_eq!(shapes.len(), 2, "{found}");
    for shape in shapes {
        assert_eq!(shape["kind"], "sphere");
        let true_mm = if shape["center_mm"][0].as_f64().unwrap() < 0.0 { 20.0 } else { 25.0 };
        close(&shape["radius_mm"], true_mm, BALL_MM);
    }
    close(&found["distances_mm"][0]["distance_mm"], 85.0, BALL_MM);
    has_numbers(&found, &["/distances_mm/0/sigma_mm", "/unassigned_points", "/seconds"]);
    let one = uwscan(["shapes", file, "--max", "1", "--json"]).json(0);
    assert_eq!(one["shapes"].as_array().unwrap().len(), 1);
    assert!(one["unassigned_points"].as_u64() > found["unassigned_points"].as_u64());
    let run = uwscan(["shapes", file]);
    for part in ["2 shapes", "sphere", "distances", "0 (sphere) to 1 (sphere)", "±"] {
        assert!(run.text().contains(part), "{part} in {}", run.stdout);
    }
    uwscan(["shapes", file, "-c", "nothing.toml"]).fails(&["nothing.toml"]);
}
