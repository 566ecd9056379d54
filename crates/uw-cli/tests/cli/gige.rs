//! `scan` with a GigE camera on a network of its own (`scripts/fake-camera.sh`) and a controller on a pseudo-terminal: nothing between the
//! command and these two is replayed or simulated. Where the machine may not have such a network, the tests skip themselves, saying so.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
    time::{Duration, Instant},
};

use assert_cmd::cargo::cargo_bin;
use serde_json::Value;
use tempfile::TempDir;
use uwscan::io::{Capture, Pixels, Reduce, images};

use crate::{
    controller::{Controller, Manner},
    job::{calibration, reconstruct},
    samples::{edit, fixture},
    scans::{config, replayed},
};

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scripts/fake-camera.sh");
/// The script's code where there is no fake camera.
const CANNOT: i32 = 77;
/// Three tries of a second each for a frame, and what a busy machine adds.
const LOST: Duration = Duration::from_secs(8);
/// Voltages are told with six decimals.
const SAME_V: f64 = 1e-6;

/// The ball's images before the camera: the one that was recorded where the mirror is, and darkness without the laser.
struct View {
    images: Vec<(f64, Vec<u8>)>,
    file: PathBuf,
}

impl View {
    fn new(dir: &Path) -> Self {
        let capture = Capture::open(&fixture("ball")).unwrap();
        let image =
            |file: &str| match images::read(&fixture("ball").join(file), Reduce::Luma, None).unwrap().data {
                Pixels::U8(values) => values,
                Pixels::U16(_) => panic!("the ball's images have 8 bits"),
            };
        let images =
            capture.present().map(|frame| (frame.voltage_v.unwrap(), image(&frame.file))).collect::<Vec<_>>();
        let view = Self { images, file: dir.join("view.raw") };
        view.show(f64::NAN, false);
        view
    }

    /// Puts another image before the camera, whole.
    fn show(&self, volts: f64, lit: bool) {
        let seen = self.images.iter().find(|(at, _)| lit && (at - volts).abs() < SAME_V);
        let dark = || vec![0; self.images[0].1.len()];
        let next = self.file.with_extension("next");
        fs::write(&next, seen.map_or_else(dark, |(_, image)| image.clone())).unwrap();
        fs::rename(next, &self.file).unwrap();
    }
}

/// A vehicle with a GigE camera and a controller at `port`, in a folder.
fn vehicle(dir: TempDir) -> TempDir {
    let camera = format!("driver = \"replay\"\nid = {:?}", fixture("ball"));
    edit(dir.path(), "vehicle.toml", &camera, "driver = \"genicam\"\nid = \"127.0.0.1\"");
    let sweep = "from_v = -1.0\nto_v = 1.0\ncount = 2";
    edit(dir.path(), "vehicle.toml", sweep, "from_v = 0.73\nto_v = 1.675\ncount = 43");
    dir
}

/// Scans beside the camera into scan.mcap, with the camera's process in the file `camera`; `None` where there is no such camera.
fn scan(dir: &Path, view: &Path) -> Option<Output> {
    let (recording, process) = (dir.join("scan.mcap"), dir.join("camera"));
    let ended = Command::new(SCRIPT)
        .arg("--sees")
        .arg(view)
        .args(["--", "sh", "-c", "echo $UWSCAN_FAKE_CAMERA > \"$0\" && exec \"$@\""])
        .arg(process)
        .arg(cargo_bin!("uwscan"))
        .args(["scan", "--config", &config(dir), "-o", recording.to_str().unwrap(), "--json"])
        .output()
        .unwrap();
    if ended.status.code() == Some(CANNOT) {
        use std::io::Write;
        // Written past the harness, which keeps what a test that passes prints.
        let said = String::from_utf8_lossy(&ended.stderr);
        let _ = writeln!(std::io::stderr(), "skipped: {}", said.trim());
        return None;
    }
    Some(ended)
}

#[test]
fn a_gige_camera_and_a_controllers_mirror_give_the_cloud_of_the_same_images_in_a_folder() {
    let calibration = calibration();
    let dir = TempDir::new().unwrap();
    let view = View::new(dir.path());
    let file = view.file.clone();
    let controller = Controller::watched(Manner::Good, move |volts, lit| view.show(volts, lit));
    let vehicle = vehicle(replayed(Some(&controller.port), Some(&calibration)));
    let Some(ended) = scan(vehicle.path(), &file) else { return };
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(0), "{said}");
    let scanned: Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert_eq!((&scanned["frames"], &scanned["laser_off"]), (&43.into(), &true.into()), "{scanned}");
    let by_folder = dir.path().join("ball.ply");
    reconstruct(&fixture("ball"), &by_folder, &[]).text();
    assert!(
        fs::read(vehicle.path().join("scan.ply")).unwrap() == fs::read(&by_folder).unwrap(),
        "the clouds differ"
    );
    assert!(controller.laser_was_on() && !controller.laser_is_on());
}

#[test]
fn a_gige_camera_that_is_lost_ends_the_scan_with_the_laser_off_and_what_was_recorded_kept() {
    /// The camera is lost once the mirror was sent to so many voltages.
    const AT: usize = 20;
    let dir = TempDir::new().unwrap();
    let view = View::new(dir.path());
    let file = view.file.clone();
    let (lost, when) = std::sync::mpsc::channel();
    let (mut moves, mut last_v) = (0, f64::NAN);
    let process = dir.path().join("process");
    let asked = process.clone();
    let controller = Controller::watched(Manner::Good, move |volts, lit| {
        view.show(volts, lit);
        moves += usize::from(lit && volts.total_cmp(&last_v).is_ne());
        last_v = volts;
        if moves == AT {
            let camera = fs::read_to_string(fs::read_to_string(&asked).unwrap()).unwrap();
            assert!(Command::new("kill").args(["-9", camera.trim()]).status().unwrap().success());
            lost.send(Instant::now()).unwrap();
            moves += 1;
        }
    });
    let vehicle = vehicle(replayed(Some(&controller.port), None));
    fs::write(process, vehicle.path().join("camera").to_str().unwrap()).unwrap();
    let Some(ended) = scan(vehicle.path(), &file) else { return };
    let took = when.try_recv().unwrap().elapsed();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(3), "{said}");
    let scanned: Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert_eq!((&scanned["frames"], &scanned["laser_off"]), (&(AT - 1).into(), &true.into()), "{scanned}");
    let fault = "the scan ended early: Fake at 127.0.0.1: no answer to";
    assert!(said.contains(fault), "{said}");
    assert!(controller.laser_was_on() && !controller.laser_is_on());
    let kept = Capture::open(&vehicle.path().join("scan.mcap")).unwrap();
    assert_eq!(kept.present().count(), AT - 1);
    assert!(took < LOST, "{took:?}");
}
