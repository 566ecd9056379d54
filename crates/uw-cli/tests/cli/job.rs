//! The main job on committed captures, cut down so that it is quick.

use std::{
    fs,
    io::Read,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::LazyLock,
};

use serde_json::Value;
use tempfile::TempDir;

use crate::samples::{edit, fixture, has_numbers, keys, part_of, uwscan};

/// The ball's radius by its maker, mm.
const BALL_RADIUS_MM: f64 = 20.0175;
/// What a cut-down calibration leaves: ten times the accuracy of the whole one.
const RADIUS_TOLERANCE_MM: f64 = 0.3;

/// Whether a row of frames.csv is kept: of the first eight poses the boards, and every third image with a stripe.
pub fn thinned(row: usize, text: &str) -> bool {
    let pose: usize = text.split(',').nth(1).unwrap().parse().unwrap();
    pose < 8 && (text.contains(",off,") || row.is_multiple_of(3))
}

/// A calibration from parts of the fixtures in air and in water: the folder, and what the run printed.
static CALIBRATED: LazyLock<(TempDir, Value, String)> = LazyLock::new(|| {
    let (air, water, out) =
        (part_of("cal-air", thinned), part_of("cal-water", thinned), TempDir::new().unwrap());
    let (target, page) = (out.path().join("calibration.toml"), out.path().join("calibration-report.html"));
    let args = ["calibrate".as_ref(), air.path().as_os_str(), water.path().as_os_str(), "--json".as_ref()];
    let outputs = ["-o".as_ref(), target.as_os_str(), "--report".as_ref(), page.as_os_str()];
    let run = uwscan(args.into_iter().chain(outputs));
    (out, run.json(0), run.stderr)
});

pub fn calibration() -> String {
    CALIBRATED.0.path().join("calibration.toml").to_str().unwrap().to_owned()
}

/// The folder of the calibration's page.
pub fn calibration_report() -> PathBuf {
    CALIBRATED.0.path().to_owned()
}

#[test]
fn calibrate_prints_what_it_promises() {
    let (_, result, stderr) = &*CALIBRATED;
    assert_eq!(
        keys(result),
        [
            "camera",
            "corners",
            "corners_rejected",
            "correlated",
            "frames_used",
            "galvo",
            "lost",
            "method",
            "poses_used",
            "rejected",
            "reprojection_rms_px",
            "seconds",
            "sigmas",
            "stripe_points",
            "stripe_points_rejected",
            "stripe_rms_mm",
            "stripe_rms_px",
            "warnings",
            "worst"
        ]
    );
    for figures in [result, &result["sigmas"]] {
        assert_eq!(keys(&figures["camera"]), ["cx", "cy", "fx", "fy", "k1", "k2", "k3", "p1", "p2"]);
        assert_eq!(keys(&figures["galvo"]), ["axis_direction", "axis_point_mm", "degrees_per_volt"]);
        has_numbers(figures, &["/camera/fx", "/camera/k3", "/galvo/degrees_per_volt"]);
        has_numbers(figures, &["/galvo/axis_point_mm/0", "/galvo/axis_direction/2"]);
    }
    assert_eq!(keys(&result["sigmas"]), ["camera", "galvo"]);
    assert_eq!((&result["method"], &result["lost"]), (&"joint".into(), &serde_json::json!([])));
    let degrees_per_volt = result["galvo"]["degrees_per_volt"].as_f64().unwrap();
    assert!((degrees_per_volt - 2.0).abs() < 0.03, "{degrees_per_volt}, and 2 ± 0.5 % as drawn");
    assert_eq!(result["correlated"].as_array().unwrap().len(), 2);
    assert!(result["worst"][0]["file"].as_str().unwrap().contains("images/"));
    for stage in ["boards: ", "stripes: ", "adjustment"] {
        assert!(stderr.contains(stage), "{stage} in {stderr}");
    }
}

#[test]
fn a_calibration_is_told_by_info() {
    let info = uwscan(["info", &calibration(), "--json"]).json(0);
    assert_eq!((&info["kind"], &info["method"]), (&"calibration".into(), &"joint".into()));
    assert_eq!(info["captures"].as_array().unwrap().len(), 2);
    for key in ["camera", "sigmas", "poses_used", "worst"] {
        assert_eq!(info[key], CALIBRATED.1[key], "{key}");
    }
    let run = uwscan(["info", &calibration()]);
    for part in ["joint method", "camera.fx_px", "±", "galvo.axis_point_mm", "hardly told apart"] {
        assert!(run.stdout.contains(part), "{part} in {}", run.stdout);
    }
}

/// Reconstructs a capture into `target` with further arguments.
pub fn reconstruct(capture: &Path, target: &Path, more: &[&str]) -> crate::samples::Run {
    let (capture, calibration) = (capture.to_str().unwrap(), calibration());
    let args = ["reconstruct", capture, "-c", &calibration, "-o", target.to_str().unwrap()];
    uwscan(args.iter().chain(more))
}

#[test]
fn a_ball_is_reconstructed_and_measured() {
    let out = TempDir::new().unwrap();
    let ply = out.path().join("ball.ply");
    let result = reconstruct(&fixture("ball"), &ply, &["--json", "--threads", "1"]).json(0);
    assert_eq!(
        keys(&result),
        [
            "frame",
            "frames",
            "index",
            "lost",
            "points",
            "points_per_second",
            "refraction",
            "rejected",
            "seconds",
            "stripe",
            "thread_seconds",
            "warnings"
        ]
    );
    assert_eq!(keys(&result["thread_seconds"]), ["decode", "extract", "triangulate", "write"]);
    let stages = result["thread_seconds"].as_object().unwrap().values();
    assert!(stages.clone().all(|s| s.as_f64().unwrap() > 0.0), "{result}");
    // On one thread, the stages are parts of the whole.
    let sum: f64 = stages.map(|s| s.as_f64().unwrap()).sum();
    assert!(sum < result["seconds"].as_f64().unwrap(), "{result}");
    has_numbers(&result, &["/points", "/seconds", "/points_per_second", "/index"]);
    assert_eq!((&result["frame"], &result["refraction"]), (&"camera".into(), &"exact".into()));
    assert!(result["rejected"].as_object().unwrap().values().all(Value::is_u64), "{result}");
    let fit = uwscan(["fit", "sphere", ply.to_str().unwrap(), "--json"]).json(0);
    let radius = fit["radius_mm"].as_f64().unwrap();
    assert!((radius - BALL_RADIUS_MM).abs() < RADIUS_TOLERANCE_MM, "{radius}");
    let info = uwscan(["info", ply.to_str().unwrap(), "--json"]).json(0);
    assert_eq!(info["points"], result["points"]);
}

#[test]
fn every_stripe_method_measures_the_ball_and_says_so() {
    let out = TempDir::new().unwrap();
    let scan = part_of("ball", |row, _| row.is_multiple_of(2));
    let mut clouds = Vec::new();
    for method in ["fast", "robust", "precise", "ridge", "cog", "blais-rioux"] {
        let ply = out.path().join(format!("{method}.ply"));
        let more = ["--stripe", method, "--json"];
        let result = reconstruct(scan.path(), &ply, &more).json(0);
        assert_eq!(result["stripe"], method);
        let fit = uwscan(["fit", "sphere", ply.to_str().unwrap(), "--json"]).json(0);
        let radius = fit["radius_mm"].as_f64().unwrap();
        assert!((radius - BALL_RADIUS_MM).abs() < RADIUS_TOLERANCE_MM, "{method}: {radius}");
        let cloud = fs::read(&ply).unwrap();
        assert!(!clouds.contains(&cloud), "{method} gives another's cloud");
        // Whatever is learned from images does not depend on which thread comes to them first.
        let again = out.path().join("again.ply");
        reconstruct(scan.path(), &again, &["--stripe", method, "--force", "--threads", "1"]).text();
        assert!(cloud == fs::read(&again).unwrap(), "{method}: another cloud on one thread");
        clouds.push(cloud);
    }
    let run = reconstruct(scan.path(), &out.path().join("x.ply"), &["--stripe", "steger"]);
    run.is_misused(&["steger", "fast", "robust", "precise", "ridge", "cog", "blais-rioux"]);
}

#[test]
fn every_format_and_frame_holds_the_same_ball() {
    let out = TempDir::new().unwrap();
    let scan = part_of("ball", |row, _| row.is_multiple_of(2));
    let radius = |file: &Path| {
        let fit = uwscan(["fit", "sphere", file.to_str().unwrap(), "--json"]).json(0);
        (fit["radius_mm"].as_f64().unwrap(), fit["frame"].as_str().unwrap().to_owned())
    };
    let mut radii = Vec::new();
    for (name, more, frame) in [
        ("a.ply", &[][..], "camera"),
        ("b.ply", &["--ascii"], "camera"),
        ("c.xyz", &[], "camera"),
        ("d.csv", &["--frame", "galvo"], "galvo"),
    ] {
        let file = out.path().join(name);
        let run = reconstruct(scan.path(), &file, more);
        assert!(run.text().contains("points from 22 images"), "{}", run.stdout);
        assert!(run.text().contains("no_signal"), "{}", run.stdout);
        let (radius, told) = radius(&file);
        assert_eq!(told, frame);
        radii.push(radius);
    }
    // The same points through f32 covariances in another frame: equal to a thousandth of a sigma.
    assert!(radii.iter().all(|r| (r - radii[0]).abs() < 1e-5), "{radii:?}");
    assert!(fs::read_to_string(out.path().join("b.ply")).unwrap().starts_with("ply\nformat ascii 1.0\n"));
}

#[test]
fn lost_images_of_a_scan_end_with_3() {
    let out = TempDir::new().unwrap();
    let scan = part_of("ball", |row, _| (10..16).contains(&row));
    let images = crate::samples::names(&scan.path().join("images"));
    fs::remove_file(scan.path().join("images").join(&images[0])).unwrap();
    let torn = scan.path().join("images").join(&images[1]);
    let bytes = fs::read(&torn).unwrap();
    fs::write(&torn, &bytes[..200]).unwrap();
    let run = reconstruct(scan.path(), &out.path().join("a.ply"), &["--json"]);
    let result = run.json(3);
    assert_eq!(result["frames"], 4);
    let lost = result["lost"].as_array().unwrap();
    for image in &images[..2] {
        assert!(run.stderr.contains(image), "{image} in {}", run.stderr);
        assert!(lost.iter().any(|l| l["file"].as_str().unwrap().ends_with(image)), "{image} in {lost:?}");
    }
}

#[test]
fn a_scan_without_a_point_says_what_its_rows_lack() {
    let out = TempDir::new().unwrap();
    let ply = out.path().join("a.ply");
    let scan = part_of("ball", |row, _| (20..23).contains(&row));
    let frames = fs::read_to_string(scan.path().join("frames.csv")).unwrap();
    let with = |fields: [&str; 3]| {
        let rows = frames.lines().enumerate().map(|(i, line)| {
            let f: Vec<&str> = line.split(',').collect();
            if i == 0 { line.to_owned() } else { [f[0], fields[0], fields[1], fields[2], f[4]].join(",") }
        });
        fs::write(scan.path().join("frames.csv"), rows.collect::<Vec<_>>().join("\n")).unwrap();
        reconstruct(scan.path(), &ply, &[])
    };
    with(["", "off", ""]).fails(&["no image has the laser on", "frames.csv"]);
    let run = with(["", "on", "-47"]);
    run.fails(&["no point came out of 3 images", "no_intersection", "check voltages"]);
    assert!(run.stderr.contains("warning: ") && run.stderr.contains("range_v"), "{}", run.stderr);
    // Images of another camera than the calibration's: there is no --rig to mend that here.
    for image in crate::samples::names(&scan.path().join("images")) {
        crate::samples::write_grey(&scan.path().join("images").join(image), 64, 48);
    }
    let run = with(["", "on", "0.5"]);
    run.fails(&["64 x 48", "768 x 576 in the calibration", "calibration of this camera"]);
    assert!(!run.stderr.contains("--rig"), "{}", run.stderr);
    assert_eq!(crate::samples::names(out.path()), [""; 0]);
}

#[test]
fn a_water_index_that_is_not_used_or_not_likely_is_warned_of() {
    let out = TempDir::new().unwrap();
    let scan = part_of("ball", |row, _| (20..23).contains(&row));
    let warned = |name: &str, more: &[&str], part: &str| {
        let args: Vec<&str> = more.iter().copied().chain(["--json"]).collect();
        let run = reconstruct(scan.path(), &out.path().join(name), &args);
        let result = run.json(0);
        let warnings = result["warnings"].as_array().unwrap();
        assert!(warnings.iter().any(|w| w.as_str().unwrap().contains(part)), "{result}");
        assert!(run.stderr.contains(part), "{}", run.stderr);
    };
    warned("a.ply", &["--water-index", "2.0"], "2.00000 is unusual for water");
    warned("b.ply", &["--water-index", "1.34", "--refraction", "none"], "is not used");
    edit(scan.path(), "capture.toml", "\"water\"", "\"air\"");
    warned("c.ply", &["--water-index", "1.34"], "captured in air");
    let salt = ["--temperature", "12", "--salinity", "35", "--depth", "2"];
    warned("d.ply", &salt, "captured in air");
}

#[test]
fn a_background_that_cannot_be_read_is_a_loss() {
    let out = TempDir::new().unwrap();
    let scan = part_of("ball", |row, _| (20..24).contains(&row));
    let frames = fs::read_to_string(scan.path().join("frames.csv")).unwrap();
    let dark = frames.lines().nth(1).unwrap().split(',').next().unwrap().to_owned();
    let rows = frames.lines().map(|line| {
        let f: Vec<&str> = line.split(',').collect();
        if f[0] == dark { format!("{dark},,off,,{}", f[4]) } else { line.to_owned() }
    });
    fs::write(scan.path().join("frames.csv"), rows.collect::<Vec<_>>().join("\n")).unwrap();
    fs::write(scan.path().join(&dark), "torn").unwrap();
    let result = reconstruct(scan.path(), &out.path().join("a.ply"), &["--json"]).json(3);
    assert_eq!(result["frames"], 3);
    assert!(result["lost"][0]["file"].as_str().unwrap().ends_with(&dark), "{result}");
}

#[test]
fn a_run_that_is_cut_off_leaves_nothing() {
    let (ball, out) = (fixture("ball"), TempDir::new().unwrap());
    let target = out.path().join("cloud.ply");
    let mut child = Command::new(assert_cmd::cargo::cargo_bin!("uwscan"))
        .args(["reconstruct", ball.to_str().unwrap(), "-c", &calibration(), "-o", target.to_str().unwrap()])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Its first word on progress: the work has begun, and takes far longer than to kill it.
    let mut word = [0; 6];
    child.stderr.take().unwrap().read_exact(&mut word).unwrap();
    child.kill().unwrap();
    assert!(!child.wait().unwrap().success());
    assert_eq!((&word, crate::samples::names(out.path())), (b"frames", vec![]));
}

#[test]
fn an_output_is_replaced_only_with_force() {
    let out = TempDir::new().unwrap();
    let scan = part_of("ball", |row, _| (10..14).contains(&row));
    let target = out.path().join("cloud.xyz");
    fs::write(&target, "precious").unwrap();
    reconstruct(scan.path(), &target, &[]).fails(&["cloud.xyz", "--force"]);
    assert_eq!(fs::read_to_string(&target).unwrap(), "precious");
    reconstruct(scan.path(), &target, &["--force"]).text();
    assert!(fs::read_to_string(&target).unwrap().starts_with("# frame camera\n"));
    assert_eq!(crate::samples::names(out.path()), ["cloud.xyz"]);
}

#[test]
fn the_waters_index_is_the_one_that_is_asked_for() {
    let out = TempDir::new().unwrap();
    let scan = part_of("ball", |row, _| (10..14).contains(&row));
    let index = |more: &[&str]| {
        let more: Vec<&str> = more.iter().copied().chain(["--json", "--force"]).collect();
        reconstruct(scan.path(), &out.path().join("c.ply"), &more).json(0)["index"].as_f64().unwrap()
    };
    assert!((index(&["--water-index", "1.341"]) - 1.341).abs() < 1e-12);
    // Quan and Fry's own check value at 532 nm.
    let sea = ["--temperature", "20", "--salinity", "35", "--depth", "0"];
    assert!((index(&sea) - 1.341_510).abs() < 1e-6);
    assert!((index(&["--medium", "air"]) - 1.0).abs() < 1e-12);
    let calibrated = index(&[]);
    assert!((calibrated - 1.335).abs() < 2e-3, "{calibrated}");
}

#[test]
fn a_scan_and_a_calibration_are_not_taken_for_each_other() {
    let out = TempDir::new().unwrap();
    let target = out.path().join("out.ply");
    reconstruct(&fixture("cal-air"), &target, &[]).fails(&["cal-air", "a calibration", "a scan is needed"]);
    let ball = fixture("ball");
    let rig = ball.join("rig.toml");
    let args = ["reconstruct".as_ref(), ball.as_os_str(), "-c".as_ref(), rig.as_os_str()];
    uwscan(args.into_iter().chain(["-o".as_ref(), target.as_os_str()]))
        .fails(&["rig.toml", "uwscan-calibration"]);
    let torn = out.path().join("torn.toml");
    let text = fs::read_to_string(calibration()).unwrap();
    fs::write(&torn, &text[..text.len() / 2]).unwrap();
    let args = ["reconstruct".as_ref(), ball.as_os_str(), "-c".as_ref(), torn.as_os_str()];
    uwscan(args.into_iter().chain(["-o".as_ref(), target.as_os_str()])).fails(&["torn.toml"]);
    assert!(!target.exists());
}

#[test]
fn the_paper_method_says_so_and_is_not_traced_exactly() {
    let (air, out) = (part_of("cal-air", thinned), TempDir::new().unwrap());
    edit(air.path(), "capture.toml", "\"calibration\"", "\"calibration\" # by the paper");
    let target = out.path().join("paper.toml");
    let args = [
        "calibrate".as_ref(),
        air.path().as_os_str(),
        "--method".as_ref(),
        "paper".as_ref(),
        "--json".as_ref(),
    ];
    let result = uwscan(args.into_iter().chain(["-o".as_ref(), target.as_os_str()])).json(0);
    assert_eq!((&result["method"], &result["sigmas"]), (&"paper".into(), &Value::Null));
    let (ball, cloud) = (fixture("ball"), out.path().join("ball.ply"));
    let args = [
        "reconstruct".as_ref(),
        ball.as_os_str(),
        "-c".as_ref(),
        target.as_os_str(),
        "-o".as_ref(),
        cloud.as_os_str(),
    ];
    uwscan(args).fails(&["--refraction paper", "--method joint"]);
    let paper =
        uwscan(args.into_iter().chain(["--refraction".as_ref(), "paper".as_ref(), "--json".as_ref()]))
            .json(0);
    assert_eq!(paper["refraction"], "paper");
}
