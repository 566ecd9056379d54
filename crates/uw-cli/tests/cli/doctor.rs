//! `doctor`: each planted mistake is found and told with its mend, and nothing is found where nothing is wrong.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use serde_json::Value;
use tempfile::TempDir;

use crate::{
    controller::{Controller, Manner},
    job::calibration,
    samples::{edit, fixture, uwscan},
};

/// A vehicle with a controller on a port, and the cover's recording as its camera: files in a folder of its own.
fn vehicle(port: &str) -> TempDir {
    let dir = TempDir::new().unwrap();
    let cover = fixture("cover");
    fs::copy(cover.join("rig.toml"), dir.path().join("rig.toml")).unwrap();
    fs::copy(calibration(), dir.path().join("calibration.toml")).unwrap();
    let text = format!(
        "format = \"uwscan-vehicle\"\nversion = 1\nrig = \"rig.toml\"\ncalibration = \"calibration.toml\"\nscene = \"scene.toml\"\n\n\
         [galvo]\ndriver = \"scpi\"\nport = {port:?}\nbaud = 115200\nrange_v = [-4.0, 4.0]\nslew_v_per_s = 1000.0\nsettle_ms = 20.0\n\
         follow_v = 0.05\ntimeout_ms = 2000.0\npark_v = 0.0\n\n[laser]\ndriver = \"galvo\"\n\n\
         [camera]\ndriver = \"simulated\"\nwidth = 768\nheight = 576\nbits = 8\nexposure_ms = 1.0\ntimeout_ms = 500.0\n\n\
         [sweep]\nmode = \"step\"\nfrom_v = 0.5\nto_v = 1.4\ncount = 46\n\n[disk]\nfolder = \".\"\nmin_free_mb = 1.0\n"
    );
    fs::write(dir.path().join("vehicle.toml"), text).unwrap();
    let scene = fs::read_to_string(fixture("scenes").join("ball.toml")).unwrap();
    fs::write(dir.path().join("scene.toml"), scene).unwrap();
    dir
}

fn config(dir: &TempDir) -> PathBuf {
    dir.path().join("vehicle.toml")
}

/// What doctor finds that is not good, as `subject: what; mend`.
fn found(dir: &TempDir, code: i32, more: &[&str]) -> Vec<String> {
    let config = config(dir);
    let args = ["doctor", "--config", config.to_str().unwrap(), "--json"];
    let run = uwscan(args.iter().chain(more));
    assert_eq!(run.code, Some(code), "{}{}", run.stdout, run.stderr);
    let result = run.json(code);
    let findings = result["findings"].as_array().unwrap();
    let text = |finding: &Value, key: &str| finding[key].as_str().unwrap_or_default().to_owned();
    let bad = findings.iter().filter(|f| f["verdict"] == "fault" || f["verdict"] == "warning");
    let bad: Vec<String> =
        bad.map(|f| format!("{}: {}; {}", text(f, "subject"), text(f, "what"), text(f, "mend"))).collect();
    let counted = result["faults"].as_u64().unwrap() + result["warnings"].as_u64().unwrap();
    assert_eq!(counted, bad.len() as u64);
    assert!(bad.iter().all(|line| !line.ends_with("; ")), "each has its mend: {bad:?}");
    bad
}

/// That a single thing is found, which says all the parts.
#[track_caller]
fn alone(found: &[String], parts: &[&str]) {
    assert_eq!(found.len(), 1, "{found:?}");
    for part in parts {
        assert!(found[0].contains(part), "{part:?} is not in {:?}", found[0]);
    }
}

#[test]
fn nothing_is_found_where_nothing_is_wrong_and_the_laser_stays_off_until_it_may() {
    let controller = Controller::start(Manner::Lags(Duration::from_micros(300)));
    let dir = vehicle(&controller.port);
    assert_eq!(found(&dir, 0, &[]), [""; 0]);
    assert!(!controller.laser_was_on());
    assert!(controller.sent_to().abs() < 1e-9, "parked");
    assert_eq!(found(&dir, 0, &["--laser"]), [""; 0]);
    assert!(controller.laser_was_on() && !controller.laser_is_on());
    let text = uwscan(["doctor", "--config", config(&dir).to_str().unwrap()]);
    for said in [
        "ACME, Mirror 2",
        "goes from -4 V to 4 V",
        "was not switched on",
        "768 x 576 pixels of 8 bits",
        "room for",
    ] {
        assert!(text.text().contains(said), "{said} in {}", text.stdout);
    }
}

#[test]
fn files_that_do_not_fit_together_are_found() {
    let controller = Controller::start(Manner::Good);
    let wrong = |file: &str, from: &str, to: &str| {
        let dir = vehicle(&controller.port);
        edit(dir.path(), file, from, to);
        dir
    };
    // 1: a key that can't be meant. Nothing else can be looked at then.
    let dir = wrong("vehicle.toml", "park_v = 0.0", "park_v = 40.0");
    alone(
        &found(&dir, 1, &[]),
        &["vehicle file: ", "vehicle.toml:16", "galvo.park_v", "outside galvo.range_v"],
    );
    // 2: a rig file that is not there.
    let dir = wrong("vehicle.toml", "rig = \"rig.toml\"", "rig = \"rog.toml\"");
    alone(&found(&dir, 1, &[]), &["rig: ", "rog.toml", "check the path"]);
    // 3: a range that the drive doesn't have.
    let dir = wrong("vehicle.toml", "range_v = [-4.0, 4.0]", "range_v = [-12.0, 12.0]");
    alone(&found(&dir, 1, &[]), &["rig: ", "[-12, 12]", "[-10, 10]", "narrow galvo.range_v"]);
    // 4: the calibration of another instrument.
    let dir = wrong("calibration.toml", "focal_mm = 12.0", "focal_mm = 16.0");
    alone(
        &found(&dir, 1, &[]),
        &["calibration: ", "camera.focal_mm 16.0, not 12.0", "the calibration of this instrument"],
    );
    // 5: a folder for scans that is not there, 6: less room than is to be left.
    let dir = wrong("vehicle.toml", "folder = \".\"", "folder = \"scans\"");
    alone(&found(&dir, 1, &[]), &["disk: ", "there is no folder", "scans", "make it"]);
    let dir = wrong("vehicle.toml", "min_free_mb = 1.0", "min_free_mb = 1e12");
    alone(&found(&dir, 1, &[]), &["disk: ", "MB are free", "disk.min_free_mb", "free some space"]);
}

#[test]
fn controllers_that_are_absent_silent_or_speak_another_dialect_are_found() {
    // 7: no such port.
    let dir = vehicle("/dev/not-a-port");
    alone(&found(&dir, 1, &[]), &["galvo: /dev/not-a-port", "cannot be opened", "check cable and power"]);
    // 8: a port where nobody answers, as at another speed.
    let silent = Controller::start(Manner::Silent);
    let dir = vehicle(&silent.port);
    alone(&found(&dir, 1, &[]), &["galvo: ", "no answer to *IDN?", "baud"]);
    // 9: another dialect.
    let other = Controller::start(Manner::WrongReply);
    let dir = vehicle(&other.port);
    alone(&found(&dir, 1, &[]), &["galvo: ", "SOUR:VOLT?", "BANANA", "dialect"]);
    // 10: errors that somebody left in its queue: a warning.
    let controller = Controller::start(Manner::Good);
    controller.complain("-222,\"Data out of range\"");
    let dir = vehicle(&controller.port);
    alone(&found(&dir, 0, &[]), &["galvo: ", "queue held 1 errors: -222", "run doctor again"]);
    assert_eq!(found(&dir, 0, &[]), [""; 0]);
}

#[test]
fn mirrors_that_are_stuck_short_or_slow_are_found() {
    // 11
    let stuck = Controller::start(Manner::Stuck);
    alone(&found(&vehicle(&stuck.port), 1, &[]), &["galvo: ", "the mirror does not move", "is free"]);
    // 12
    let short = Controller::start(Manner::Reaches(3.2));
    let all = found(&vehicle(&short.port), 1, &[]);
    assert_eq!(all.len(), 2, "{all:?}");
    assert!(
        all[1].contains("sent to 4 V") && all[1].contains("3.2000 V") && all[1].contains("narrow"),
        "{all:?}"
    );
    // 13: 69 ms to a tenth of a step, by e-folds of 30 ms.
    let slow = Controller::start(Manner::Lags(Duration::from_millis(30)));
    let all = found(&vehicle(&slow.port), 1, &[]);
    alone(&all, &["galvo: ", "galvo.settle_ms says 20.0 ms", "write galvo.settle_ms = "]);
    let stated: f64 = all[0].rsplit("= ").next().unwrap().parse().unwrap();
    // Read back over a line that answers within a millisecond, on a machine that does other things besides.
    assert!((60.0..250.0).contains(&stated), "{stated}");
}

#[test]
fn lasers_that_do_not_do_as_they_say_are_found() {
    // 14
    let on = Controller::start(Manner::LaserStaysOn);
    let dir = vehicle(&on.port);
    let run = uwscan(["doctor", "--config", config(&dir).to_str().unwrap(), "--json"]);
    assert!(run.json(1).to_string().contains("cut the laser's power"), "{}", run.stdout);
    // 15
    let off = Controller::start(Manner::LaserStaysOff);
    let all = found(&vehicle(&off.port), 1, &["--laser"]);
    assert!(
        all.iter().any(|line| line.contains("laser: acknowledges that it goes on, and says that it is off")),
        "{all:?}"
    );
}

#[test]
fn a_stripe_that_does_not_show_is_found() {
    // 16: the beam's window is covered, as a scene without light.
    let controller = Controller::start(Manner::Good);
    let dir = vehicle(&controller.port);
    edit(dir.path(), "scene.toml", "level = 2.2", "level = 0.0");
    alone(&found(&dir, 1, &["--laser"]), &["camera: no stripe shows", "beam leaves its window"]);
    // Without leave to switch it on, nothing is said about it.
    assert_eq!(found(&dir, 0, &[]), [""; 0]);
}

#[test]
fn a_replay_is_looked_at_without_asking_for_what_it_does_not_have() {
    let dir = crate::scans::replayed(None, Some(&calibration()));
    // How fast the disk is while other tests run is not the replay's.
    let all = found(&dir, 0, &["--laser"]);
    assert!(all.iter().all(|line| line.starts_with("disk: ") && line.contains("MB/s")), "{all:?}");
    let run = uwscan(["doctor", "--config", config(&dir).to_str().unwrap()]);
    assert!(run.text().contains("replays 43 images"), "{}", run.stdout);
}

#[test]
fn cameras_that_are_not_there_are_found() {
    // 17
    let controller = Controller::start(Manner::Good);
    let dir = vehicle(&controller.port);
    let nowhere = "[camera]\ndriver = \"v4l2\"\nid = \"/dev/no-video\"";
    edit(dir.path(), "vehicle.toml", "[camera]\ndriver = \"simulated\"", nowhere);
    let told: &[&str] = if cfg!(feature = "v4l2") {
        &["camera /dev/no-video", "No such file", "group video"]
    } else {
        &["camera: ", "v4l2", "--features v4l2"]
    };
    alone(&found(&dir, 1, &[]), told);
    assert!(Path::new(&controller.port).exists());
}
