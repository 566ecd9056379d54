//! What a scan leaves when its process is killed, signalled, or its controller unplugged.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use assert_cmd::cargo::cargo_bin;
use serde_json::Value;
use tempfile::TempDir;
use uwscan::io::{Capture, Expect, Reduce, SaidBy};

use crate::{
    controller::{Controller, Manner},
    job::calibration,
    samples::{edit, uwscan},
    scans::{config, replayed},
};

/// The most of a scan that a killed process may lose, s.
const LOSS_S: f64 = 1.0;
/// By how much the clock may be read late on a busy machine, s.
const LATE_S: f64 = 0.2;
/// A good part less than the time that the slowest mirror here takes to settle.
const SETTLES: Duration = Duration::from_secs(5);

/// A scan that goes on until something ends it.
struct Scanning {
    child: Child,
    recording: PathBuf,
    _dir: TempDir,
}

impl Scanning {
    /// Begins one at about a hundred images a second; `settle` after each move in place of that.
    fn begin(port: Option<&str>, settle: &str) -> Self {
        Self::calibrated(port, settle, None)
    }

    /// The same, with a cloud at the end.
    fn calibrated(port: Option<&str>, settle: &str, calibration: Option<&str>) -> Self {
        let dir = replayed(port, calibration);
        edit(dir.path(), "vehicle.toml", "settle_ms = 1.0", &format!("settle_ms = {settle}"));
        edit(dir.path(), "vehicle.toml", "[disk]", "[interlock]\nwatchdog_ms = 20000.0\n\n[disk]");
        let recording = dir.path().join("scan.mcap");
        let child = Command::new(cargo_bin!("uwscan"))
            .args(["scan", "--config", &config(dir.path()), "-o", recording.to_str().unwrap()])
            .args(["--repeat", "1000", "--json"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self { child, recording, _dir: dir }
    }

    /// Waits until the recording holds so many bytes.
    fn recorded(&mut self, bytes: u64) {
        while fs::metadata(&self.recording).map_or(0, |about| about.len()) < bytes {
            assert!(self.child.try_wait().unwrap().is_none(), "it ended before it recorded");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn signal(&self, name: &str) {
        let kill = format!("kill -{name} {}", self.child.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    }

    /// Waits for its end: exit code, what it printed, what it said.
    fn end(self) -> (Option<i32>, String, String, PathBuf, TempDir) {
        let output = self.child.wait_with_output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (output.status.code(), text(output.stdout), text(output.stderr), self.recording, self._dir)
    }
}

/// Images that a recording holds, in a row from the first; the last decoded. The stamp of the last, s.
fn held(recording: &Path) -> (usize, f64) {
    let Ok(capture) = Capture::open(recording) else { return (0, f64::NEG_INFINITY) };
    let rows: Vec<usize> = capture.present().map(|frame| frame.row).collect();
    assert_eq!(rows, (0..rows.len()).collect::<Vec<_>>());
    let Some(last) = capture.present().last() else { return (0, f64::NEG_INFINITY) };
    let expect = capture.rig.as_ref().map(|rig| Expect::of(&rig.camera, SaidBy::Rig));
    assert_eq!(capture.image(last, Reduce::Luma, expect).unwrap().width, 768);
    (rows.len(), last.stamp_ns as f64 * 1e-9)
}

fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// Numbers from 0 to 1 from a seed (splitmix64): the same moments in each run.
fn draw(seed: u64) -> f64 {
    let mut z = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

#[test]
fn twenty_kills_at_any_moment_lose_less_than_the_last_second_each() {
    let kill = |number: u64| {
        let mut scan = Scanning::begin(None, "8.0");
        // The head is there before the first image.
        scan.recorded(1);
        let began = now_s();
        std::thread::sleep(Duration::from_secs_f64(1.5 * draw(number)));
        scan.child.kill().unwrap();
        let killed = now_s();
        assert!(!scan.child.wait().unwrap().success());
        let (images, last) = held(&scan.recording);
        let lost = killed - last.max(began);
        assert!(lost < LOSS_S + LATE_S, "kill {number}: {lost:.3} s lost after {images} images");
        images
    };
    // Four at a time: a machine with two processors then shows slow recorders, too.
    let images: Vec<usize> = std::thread::scope(|scope| {
        let lanes: Vec<_> = (0..4_u64)
            .map(|lane| scope.spawn(move || (0..5_u64).map(|k| kill(5 * lane + k)).collect::<Vec<_>>()))
            .collect();
        lanes.into_iter().flat_map(|lane| lane.join().unwrap()).collect()
    });
    assert_eq!(images.len(), 20);
    assert!(images.iter().sum::<usize>() > 100, "{images:?}");
}

#[test]
fn one_signal_ends_a_scan_in_order_and_keeps_what_there_is() {
    for (name, said) in [("INT", "SIGINT"), ("TERM", "SIGTERM")] {
        let controller = Controller::start(Manner::Good);
        let mut scan = Scanning::begin(Some(&controller.port), "5.0");
        scan.recorded(5 << 20);
        assert!(controller.laser_was_on());
        scan.signal(name);
        let (code, stdout, stderr, recording, _dir) = scan.end();
        assert_eq!(code, Some(3), "{stderr}");
        assert!(stderr.contains("the scan ended early") && stderr.contains(said), "{stderr}");
        let result: Value = serde_json::from_str(&stdout).unwrap();
        assert_eq!((&result["laser_off"], &result["parked_v"]), (&true.into(), &(-0.5).into()), "{result}");
        assert!(!controller.laser_is_on() && (controller.sent_to() + 0.5).abs() < 1e-9);
        let images = held(&recording).0 as u64;
        assert_eq!(result["frames"], images);
        assert_eq!(result["lost"]["not_reached"].as_u64().unwrap() + images, 43_000);
        // It was finished: other readers open it.
        assert!(fs::read(&recording).unwrap().ends_with(b"\x89MCAP0\r\n"));
    }
}

#[test]
fn a_signal_ends_a_scan_while_its_mirror_settles() {
    let controller = Controller::start(Manner::Good);
    let scan = Scanning::begin(Some(&controller.port), "9000.0");
    while !controller.laser_was_on() {
        std::thread::sleep(Duration::from_millis(2));
    }
    let began = Instant::now();
    scan.signal("INT");
    let (code, _, stderr, ..) = scan.end();
    // It was the first image's.
    assert_eq!(code, Some(1), "{stderr}");
    assert!(stderr.contains("no image was recorded") && stderr.contains("SIGINT"), "{stderr}");
    assert!(!controller.laser_is_on());
    assert!(began.elapsed() < SETTLES, "it went on for {:?}", began.elapsed());
}

#[test]
fn a_second_signal_leaves_at_once_with_the_laser_off() {
    let controller = Controller::start(Manner::Good);
    let mut scan = Scanning::calibrated(Some(&controller.port), "1.0", Some(&calibration()));
    // So many images that their cloud takes far longer than the second signal to come.
    scan.recorded(160 << 20);
    scan.signal("INT");
    while controller.laser_is_on() {
        std::thread::sleep(Duration::from_millis(2));
    }
    // Two of the same kind that come together are one.
    std::thread::sleep(Duration::from_millis(100));
    scan.signal("INT");
    let (code, _, stderr, recording, _dir) = scan.end();
    assert_eq!(code, Some(128 + 2), "{stderr}");
    assert!(!controller.laser_is_on());
    assert!(held(&recording).0 > 40 && !recording.with_extension("ply").exists());
}

#[test]
fn a_controller_that_is_unplugged_is_an_alarm_and_what_was_recorded_is_kept() {
    let controller = Controller::start(Manner::Good);
    let mut scan = Scanning::begin(Some(&controller.port), "5.0");
    scan.recorded(3 << 20);
    drop(controller);
    let (code, stdout, stderr, recording, _dir) = scan.end();
    assert_eq!((code, stdout.as_str()), (Some(1), ""), "{stderr}");
    assert!(stderr.contains("THE LASER MAY STILL BE ON: cut its power"), "{stderr}");
    assert!(stderr.contains("the scan ended early"), "{stderr}");
    assert!(held(&recording).0 > 3);
    assert_eq!(uwscan(["info", recording.to_str().unwrap()]).code, Some(3), "planned images are missing");
}
