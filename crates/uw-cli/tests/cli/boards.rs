//! `capture-calibration` on a simulated instrument: what it keeps calibrates that instrument.

use std::{
    fs,
    io::Write,
    path::Path,
    process::{Command, Stdio},
};

use assert_cmd::cargo::cargo_bin;
use tempfile::TempDir;

use crate::samples::{edit, uwscan};

/// The demo's instrument before its board in air: scene and vehicle file.
fn bench() -> TempDir {
    let dir = TempDir::new().unwrap();
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../src/pipeline/demo");
    for name in ["rig.toml", "cal-air.toml", "vehicle.toml"] {
        fs::copy(demo.join(name), dir.path().join(name)).unwrap();
    }
    edit(dir.path(), "vehicle.toml", "scene       = \"cover.toml\"", "scene = \"cal-air.toml\"");
    edit(dir.path(), "vehicle.toml", "calibration = \"calibration.toml\"\n", "");
    edit(dir.path(), "vehicle.toml", "from_v = -1.5", "from_v = -2.1");
    dir
}

fn args(dir: &TempDir, more: &[&str]) -> Vec<String> {
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let fixed = ["--board", "11x8", "--square", "24", "--medium", "air", "--json"];
    let mut args = vec!["capture-calibration".to_owned(), "--config".to_owned(), path("vehicle.toml")];
    args.extend(["-o".to_owned(), path("capture")]);
    args.extend(fixed.iter().chain(more).map(|word| (*word).to_owned()));
    args
}

#[test]
fn placements_are_kept_judged_and_calibrated_with() {
    let dir = bench();
    let result = uwscan(args(&dir, &["--poses", "9", "--every", "0", "--voltages", "4"])).json(0);
    assert_eq!((&result["poses"], &result["images"]), (&9.into(), &45.into()), "{result}");
    assert_eq!((&result["again"], &result["laser_off"]), (&0.into(), &true.into()));
    // The scene's first placement stands square to the camera, 740 mm away; its drawing's lens tells that to some per cent.
    let first = &result["placements"][0];
    assert!((first["distance_mm"].as_f64().unwrap() - 740.0).abs() < 30.0, "{first}");
    assert!(first["tilt_deg"].as_f64().unwrap() < 3.0, "{first}");
    assert_eq!(first["corners"], 88);
    // The demo's boards reach to all sides and distances, but not to the image's corners.
    let missing = result["missing"].to_string();
    assert!(missing.contains("3 more placements") && !missing.contains("tilted"), "{missing}");
    let capture = dir.path().join("capture");
    assert!(uwscan(["info", capture.to_str().unwrap()]).text().contains("9 poses"));
    let target = dir.path().join("calibration.toml");
    let calibrated =
        uwscan(["calibrate", capture.to_str().unwrap(), "-o", target.to_str().unwrap(), "--json"]).json(0);
    assert_eq!(calibrated["poses_used"], 9);
    // What the demo's seed makes of the drawing's 12 mm lens.
    let fx = calibrated["camera"]["fx"].as_f64().unwrap();
    assert!((fx - 1399.411).abs() < 0.5, "{fx}");
}

#[test]
fn a_board_that_is_not_there_is_not_kept_and_enter_asks_for_the_next() {
    let dir = bench();
    // Of the three placements the second shows the board from its edge, the third has gone out of the laser's way.
    let scene = fs::read_to_string(dir.path().join("cal-air.toml")).unwrap();
    let head = &scene[..scene.find("[[pose]]").unwrap()];
    let pose =
        |place: &str, turn: &str| format!("[[pose]]\nposition_mm = {place}\nrotation_deg = {turn}\n\n");
    let poses = pose("[-60.0, 0.0, 740.0]", "[0.0, 0.0, 4.0]")
        + &pose("[-60.0, 0.0, 740.0]", "[0.0, 86.0, 0.0]")
        + &pose("[-110.0, 20.0, 950.0]", "[24.0, 0.0, -6.0]");
    fs::write(dir.path().join("cal-air.toml"), head.to_owned() + &poses).unwrap();
    let mut child = Command::new(cargo_bin!("uwscan"))
        .args(args(&dir, &[]))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(b"\n\n\nq\n").unwrap();
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    let result: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&result["poses"], &result["again"]), (&2.into(), &1.into()), "{stderr}");
    for said in
        ["placement 1: hold the board still", "kept 1: 88 of 88 corners", "not kept: ", "missing: 10 more"]
    {
        assert!(stderr.contains(said), "{said} in {stderr}");
    }
    // An output that holds something is somebody's.
    uwscan(args(&dir, &["--poses", "1", "--every", "0"])).fails(&["capture", "new folder"]);
}

#[test]
fn a_wrong_board_ends_a_timed_capture_without_one() {
    let dir = bench();
    let run = uwscan(
        [&args(&dir, &["--poses", "1", "--every", "0"])[..], &["--board".to_owned(), "7x5".to_owned()]]
            .concat(),
    );
    run.is_misused(&["--board"]);
    let mut args = args(&dir, &["--poses", "1", "--every", "0"]);
    let at = args.iter().position(|word| word == "11x8").unwrap();
    args[at] = "7x5".to_owned();
    let run = uwscan(args);
    run.fails(&["no placement was kept"]);
    assert!(run.stderr.contains("7 x 5 were declared"), "{}", run.stderr);
}
