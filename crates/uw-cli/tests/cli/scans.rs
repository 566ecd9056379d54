//! `scan` at the process boundary, on an instrument that is simulated.

use std::{fs, path::Path};

use tempfile::TempDir;

use crate::{
    job::{calibration, reconstruct},
    samples::{edit, fixture, keys, uwscan},
};

/// A vehicle file in a folder of its own, with everything of it simulated before the ball of the fixtures' scene: half the image, so that it
/// is quick, and without a calibration it is only recorded.
pub fn simulated(more: &str) -> TempDir {
    let dir = TempDir::new().unwrap();
    let scenes = fixture("scenes");
    for name in ["rig.toml", "ball.toml"] {
        fs::copy(scenes.join(name), dir.path().join(name)).unwrap();
    }
    edit(dir.path(), "rig.toml", "width  = 768", "width  = 384");
    edit(dir.path(), "rig.toml", "height = 576", "height = 288");
    edit(dir.path(), "rig.toml", "[8.6, 8.3]", "[17.2, 16.6]");
    let text = format!(
        "format = \"uwscan-vehicle\"\nversion = 1\nrig = \"rig.toml\"\nscene = \"ball.toml\"\n\n\
         [galvo]\ndriver = \"simulated\"\nrange_v = [-5.0, 5.0]\nslew_v_per_s = 1000.0\nsettle_ms = 1.0\n\
         follow_v = 0.001\npark_v = 0.0\n\n[laser]\ndriver = \"simulated\"\n\n\
         [camera]\ndriver = \"simulated\"\nwidth = 384\nheight = 288\nbits = 8\nexposure_ms = 2.0\ntimeout_ms = 500.0\n{more}\n\
         [disk]\nfolder = \".\"\nmin_free_mb = 1.0\n"
    );
    fs::write(dir.path().join("vehicle.toml"), text).unwrap();
    dir
}

pub const STEPS: &str = "\n[sweep]\nmode = \"step\"\nfrom_v = 0.8\nto_v = 1.1\ncount = 5\n";

pub fn config(dir: &Path) -> String {
    dir.join("vehicle.toml").to_str().unwrap().to_owned()
}

#[test]
fn a_simulated_instrument_is_scanned_like_a_real_one() {
    let dir = simulated(STEPS);
    let scanned = uwscan(["scan", "--config", &config(dir.path()), "--json"]).json(0);
    assert_eq!((&scanned["planned"], &scanned["frames"]), (&5.into(), &5.into()), "{scanned}");
    assert_eq!(scanned["laser_off"], true);
    // The next free name in the vehicle's folder is the recording's.
    let recording = dir.path().join("scan-0001.mcap");
    assert_eq!(Path::new(scanned["recording"].as_str().unwrap()), recording);
    assert!(uwscan(["scan", "--config", &config(dir.path())]).stdout.contains("scan-0002.mcap"));
    // What was recorded is what `simulate` shows at the same voltages: noise and all.
    edit(
        dir.path(),
        "ball.toml",
        "from_v = 0.5, to_v = 1.4, steps = 46",
        "from_v = 0.8, to_v = 1.1, steps = 5",
    );
    let (scene, images) = (dir.path().join("ball.toml"), dir.path().join("images"));
    uwscan(["simulate".as_ref(), scene.as_os_str(), "-o".as_ref(), images.as_os_str()]).text();
    let folder = dir.path().join("folder");
    // It has more than a folder can hold, and says so.
    assert_eq!(uwscan(["convert".as_ref(), recording.as_os_str(), folder.as_os_str()]).code, Some(0));
    let pixels = |folder: &Path, file: &str| {
        let expect = None;
        uwscan::io::images::read(&folder.join(file), uwscan::io::Reduce::Luma, expect).unwrap().data
    };
    let files = |folder: &Path| {
        let rows = fs::read_to_string(folder.join("frames.csv")).unwrap();
        rows.lines().skip(1).map(|row| row.split(',').next().unwrap().to_owned()).collect::<Vec<_>>()
    };
    for (scanned, simulated) in files(&folder).iter().zip(files(&images)) {
        assert!(pixels(&folder, scanned) == pixels(&images, &simulated), "{scanned} is not {simulated}");
    }
}

#[test]
fn a_simulated_camera_runs_by_itself_while_the_mirror_moves() {
    let dir = simulated(
        "trigger = \"free\"\nrate_hz = 100.0\n\n[sweep]\nmode = \"continuous\"\nfrom_v = 0.8\nto_v = 1.1\nrate_v_per_s = 3.0\n",
    );
    let scanned = uwscan(["scan", "--config", &config(dir.path()), "--json"]).json(0);
    let frames = scanned["frames"].as_u64().unwrap();
    assert!((8..=11).contains(&frames), "ten in a tenth of a second: {scanned}");
    assert_eq!(keys(&scanned["lost"]), [""; 0]);
    let folder = dir.path().join("folder");
    let recording = dir.path().join("scan-0001.mcap");
    // It has more than a folder can hold, and says so.
    assert_eq!(uwscan(["convert".as_ref(), recording.as_os_str(), folder.as_os_str()]).code, Some(0));
    let rows = fs::read_to_string(folder.join("frames.csv")).unwrap();
    let volts: Vec<f64> =
        rows.lines().skip(1).map(|row| row.split(',').nth(3).unwrap().parse().unwrap()).collect();
    // 100 frames a second at 3 V/s.
    for pair in volts.windows(2) {
        assert!((pair[1] - pair[0] - 0.03).abs() < 1e-3, "{volts:?}");
    }
}

#[test]
fn a_disk_without_the_room_that_is_to_be_left_is_told_before_anything_is_driven() {
    let dir = simulated(STEPS);
    edit(dir.path(), "vehicle.toml", "min_free_mb = 1.0", "min_free_mb = 1e12");
    uwscan(["scan", "--config", &config(dir.path())]).fails(&[
        "MB are free",
        "disk.min_free_mb",
        "free some space",
    ]);
    assert!(!dir.path().join("scan-0001.mcap").exists());
}

#[test]
fn what_does_not_fit_together_is_told_before_anything_is_driven() {
    let dir = simulated(STEPS);
    edit(dir.path(), "vehicle.toml", "width = 384", "width = 380");
    uwscan(["scan", "--config", &config(dir.path())]).fails(&["380 x 288", "384 x 288", "rig file"]);
    let camera = |driver: &str| format!("[camera]\ndriver = {driver:?}");
    for (driver, has) in [("v4l2", cfg!(feature = "v4l2")), ("genicam", cfg!(feature = "genicam"))] {
        if !has {
            let dir = simulated(STEPS);
            edit(dir.path(), "vehicle.toml", &camera("simulated"), &camera(driver));
            let mend = format!("--features {driver}");
            uwscan(["scan", "--config", &config(dir.path())]).fails(&[driver, &mend]);
        }
    }
}

/// A vehicle file in a folder of its own: the ball's images replayed, with a controller on a serial port if one is given.
pub fn replayed(port: Option<&str>, calibration: Option<&str>) -> TempDir {
    let dir = TempDir::new().unwrap();
    let ball = fixture("ball");
    let rig = ball.join("rig.toml");
    let calibration = calibration.map(|path| format!("calibration = {path:?}\n")).unwrap_or_default();
    let (galvo, laser) = match port {
        Some(port) => (format!("driver = \"scpi\"\nport = {port:?}\nbaud = 115200"), "galvo"),
        None => ("driver = \"replay\"".to_owned(), "replay"),
    };
    let text = format!(
        "format = \"uwscan-vehicle\"\nversion = 1\nrig = {rig:?}\n{calibration}\n\
         [galvo]\n{galvo}\nrange_v = [-10.0, 10.0]\nslew_v_per_s = 1000.0\nsettle_ms = 1.0\nfollow_v = 0.001\ntimeout_ms = 5000.0\n\
         park_v = -0.5\n\n[laser]\ndriver = {laser:?}\n\n[camera]\ndriver = \"replay\"\nid = {ball:?}\nwidth = 768\nheight = 576\n\
         bits = 8\nexposure_ms = 1.0\ntimeout_ms = 1000.0\n\n[sweep]\nmode = \"step\"\nfrom_v = -1.0\nto_v = 1.0\ncount = 2\n\n\
         [disk]\nfolder = \".\"\nmin_free_mb = 1.0\n"
    );
    fs::write(dir.path().join("vehicle.toml"), text).unwrap();
    dir
}

#[test]
fn a_replayed_capture_gives_its_own_cloud_by_its_own_drives_and_by_a_controllers() {
    let calibration = calibration();
    let clouds = TempDir::new().unwrap();
    let by_folder = clouds.path().join("ball.ply");
    reconstruct(&fixture("ball"), &by_folder, &[]).text();
    let same = |port: Option<&str>| {
        let dir = replayed(port, Some(&calibration));
        let target = dir.path().join("again.mcap");
        let scanned =
            uwscan(["scan", "--config", &config(dir.path()), "-o", target.to_str().unwrap(), "--json"])
                .json(0);
        assert_eq!((&scanned["frames"], &scanned["laser_off"]), (&43.into(), &true.into()));
        assert!(fs::read(dir.path().join("again.ply")).unwrap() == fs::read(&by_folder).unwrap(), "{port:?}");
    };
    same(None);
    #[cfg(unix)]
    {
        use crate::controller::{Controller, Manner};
        let controller = Controller::start(Manner::Good);
        // What an earlier program left is no answer to ours.
        controller.complain("-222,\"Data out of range\"");
        same(Some(&controller.port));
        assert!(controller.laser_was_on() && !controller.laser_is_on());
        assert!((controller.sent_to() + 0.5).abs() < 1e-9, "parked where the vehicle file says");
    }
}

#[cfg(unix)]
#[test]
fn a_controllers_mirror_is_swept_without_stopping_while_the_camera_runs_by_itself() {
    use crate::controller::{Controller, Manner};
    let controller = Controller::start(Manner::Good);
    let dir = simulated(
        "trigger = \"free\"\nrate_hz = 20.0\n\n[sweep]\nmode = \"continuous\"\nfrom_v = 0.8\nto_v = 1.1\nrate_v_per_s = 0.5\n",
    );
    let port = format!(
        "[galvo]\ndriver = \"scpi\"\nport = {:?}\nbaud = 115200\ntimeout_ms = 2000.0",
        controller.port
    );
    edit(dir.path(), "vehicle.toml", "[galvo]\ndriver = \"simulated\"", &port);
    edit(dir.path(), "vehicle.toml", "[laser]\ndriver = \"simulated\"", "[laser]\ndriver = \"galvo\"");
    let scanned = uwscan(["scan", "--config", &config(dir.path()), "--json"]);
    // On a busy machine the camera may lose a frame, which is told.
    assert!([Some(0), Some(3)].contains(&scanned.code), "{}", scanned.stderr);
    let capture = uwscan::io::Capture::open(&dir.path().join("scan-0001.mcap")).unwrap();
    let volts: Vec<f64> = capture.present().filter_map(|frame| frame.voltage_v).collect();
    assert!(volts.len() > 3 && volts.windows(2).all(|pair| pair[0] < pair[1]), "{volts:?}");
    assert!(volts.iter().all(|volts| (0.8..=1.1).contains(volts)), "{volts:?}");
    assert!(controller.laser_was_on() && !controller.laser_is_on());
}
